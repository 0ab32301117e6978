"""The paper's spiral with solvers of others, beside cdcr-bench solver in the same run.

    cargo build --release -p cdcr-bench
    python3 -m venv peers && peers/bin/pip install -r bench/peers/requirements.txt
    peers/bin/python bench/peers/peers.py target/release/cdcr-bench docs/results/peers.json

Needs a C compiler (the variable CC, or cc). Takes one to three minutes. Writes the table from which docs/results.md is generated;
that page says what is the same problem and what is not.
"""

import json
import math
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

import casadi as ca
import numpy as np

PERIOD_S = 0.005
LENGTH_M = 0.3
RATE_MAX_RAD_S = 2.0
# Of the step of least change, in metres and rad/s.
DAMPING = 1e-14
ROUNDS = 3
# Solves that are not timed, as in cdcr-bench.
WARM_UP = 10
# A bound that no bend reaches; HPIPM takes no infinite ones.
FREE = 1e3
HERE = pathlib.Path(__file__).parent


def curve(speed, sections, cycles):
    """Points of Eq. 8, one a period, and the bends at its begin."""
    begin_s = math.radians(5.0)
    times_s = begin_s + speed * PERIOD_S * np.arange(cycles)
    bend, direction = 2.0 * times_s / 15.0, times_s
    across = LENGTH_M * (1.0 - np.cos(bend)) / bend
    along = LENGTH_M * np.sin(bend) / bend + (sections - 1) * LENGTH_M
    points = np.stack([across * np.cos(direction), across * np.sin(direction), along], axis=-1)
    start = np.zeros(2 * sections)
    start[-2:] = bend[0] * np.array([np.cos(direction[0]), np.sin(direction[0])])
    return start, points


def tip(bends):
    """Position of the tip (docs/model.md 1), by series of 8 terms: exact for the small bends of the spiral."""
    position, rotation = ca.SX.zeros(3), ca.SX.eye(3)
    for u, v in zip(bends[0::2], bends[1::2]):
        w, f, g = u * u + v * v, 0, 0
        for k in reversed(range(8)):
            f = (-1) ** k / math.factorial(2 * k + 1) + w * f
            g = (-1) ** k / math.factorial(2 * k + 2) + w * g
        position = position + LENGTH_M * (rotation @ ca.vertcat(u * g, v * g, f))
        rotation = rotation @ ca.vertcat(
            ca.horzcat(1 - u * u * g, -u * v * g, u * f),
            ca.horzcat(-u * v * g, 1 - v * v * g, v * f),
            ca.horzcat(-u * f, -v * f, 1 - w * g),
        )
    return position


def problem(sections, steps):
    """Bends now, rates of all steps, points, and the errors of the tip at the ends of the steps."""
    bends = ca.SX.sym("bends", 2 * sections)
    rates = ca.SX.sym("rates", 2 * sections, steps)
    points = ca.SX.sym("points", 3, steps)
    at, errors = bends, []
    for step in range(steps):
        at = at + PERIOD_S * rates[:, step]
        errors.append(tip(ca.vertsplit(at)) - points[:, step])
    return bends, rates, points, ca.vertcat(*errors)


def generated_c(sections, steps, cycles):
    """One Gauss-Newton step from the held command, as C that CasADi generates: p50, p99 in microseconds, mean error in mm."""
    bends, rates, points, errors = problem(sections, steps)
    jacobian = ca.jacobian(errors, ca.vec(rates))
    normal = jacobian @ jacobian.T + DAMPING * ca.SX.eye(errors.numel())
    change = -jacobian.T @ ca.ldl_solve(errors, *ca.ldl(normal))
    held = ca.SX.sym("held", 2 * sections)
    first = ca.substitute(rates[:, 0] + change[: 2 * sections], rates, ca.repmat(held, 1, steps))
    code = ca.CodeGenerator("step", {"with_header": True})
    code.add(ca.Function("step", [bends, held, points], [first], {"cse": True}))
    code.add(ca.Function("tip_of", [bends], [tip(ca.vertsplit(bends))]))
    with tempfile.TemporaryDirectory() as folder:
        code.generate(folder + "/")
        compiler = [os.environ.get("CC", "cc"), "-O3", "-march=native", "-I", folder]
        program = folder + "/loop"
        subprocess.run([*compiler, HERE / "loop.c", folder + "/step.c", "-lm", "-o", program], check=True)
        start, curve_m = curve(1, sections, cycles + steps + 1)
        numbers = " ".join(map(repr, [*map(float, start), *map(float, curve_m[1:].ravel())]))
        counts = map(str, [2 * sections, steps, cycles, 10])
        output = subprocess.run([program, *counts], input=numbers, capture_output=True, text=True, check=True)
    return tuple(map(float, output.stdout.split()))


def followed(sections, steps, speed, cycles, solve):
    """The same of a solver that is called from Python: `solve(bends, plan, points)` returns the rates of all steps."""
    start, curve_m = curve(speed, sections, cycles + steps + 1)
    bends = ca.SX.sym("bends", 2 * sections)
    tip_of = ca.Function("tip_of", [bends], [tip(ca.vertsplit(bends))])
    at, plan, times_us, errors_mm = start, np.zeros((2 * sections, steps)), [], []
    for cycle in range(cycles):
        points = curve_m[cycle + 1 : cycle + 1 + steps].T
        begin_s = time.perf_counter()
        plan = np.array(solve(at, plan, points)).reshape((2 * sections, steps), order="F")
        times_us.append(1e6 * (time.perf_counter() - begin_s))
        at = at + PERIOD_S * plan[:, 0]
        errors_mm.append(1e3 * float(ca.norm_2(tip_of(at) - points[:, 0])))
        plan = np.hstack([plan[:, 1:], plan[:, -1:]])
    times_us = times_us[WARM_UP:]
    return statistics.median(times_us), float(np.quantile(times_us, 0.99)), statistics.fmean(errors_mm)


def nonlinear(sections, steps, name):
    """The whole nonlinear program, until it has converged."""
    bends, rates, points, errors = problem(sections, steps)
    # In millimetres; the weight on rates decides among motions that do the same.
    cost = 1e6 * ca.sumsqr(errors) + 1e-6 * ca.sumsqr(rates)
    data = ca.vertcat(bends, ca.vec(points))
    quiet = {"ipopt": {"ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-10}}
    options = {"print_time": False, "error_on_fail": True, **quiet.get(name, {})}
    solver = ca.nlpsol("solver", name, {"x": ca.vec(rates), "p": data, "f": cost}, options)

    def solve(at, plan, curve_m):
        given = np.concatenate([at, curve_m.ravel(order="F")])
        guess = plan.ravel(order="F")
        return solver(x0=guess, p=given, lbx=-RATE_MAX_RAD_S, ubx=RATE_MAX_RAD_S)["x"]

    return solve


def structured(sections, steps):
    """One quadratic program a cycle around the last plan, in the structure of the horizon, by HPIPM (real-time iteration)."""
    n = 2 * sections
    bends, plan = ca.SX.sym("bends", n), ca.SX.sym("plan", n, steps)
    points = ca.SX.sym("points", 3, steps)
    at, blocks, slopes, lower, upper = bends, [], [], [], []
    for step in range(steps + 1):
        if step == 0:
            blocks.append(ca.SX.zeros(n, n))
            slopes.append(ca.SX.zeros(n))
        else:
            error = 1e3 * (tip(ca.vertsplit(at)) - points[:, step - 1])
            # Its derivative at a symbol, because `at` is a sum.
            free = ca.SX.sym("free", n)
            slope = ca.substitute(ca.jacobian(1e3 * tip(ca.vertsplit(free)), free), free, at)
            blocks.append(slope.T @ slope)
            slopes.append(slope.T @ error)
        lower.append(-FREE * np.ones(n) if step else np.zeros(n))
        upper.append(FREE * np.ones(n) if step else np.zeros(n))
        if step < steps:
            blocks.append(1e-6 * ca.SX.eye(n))
            slopes.append(1e-6 * plan[:, step])
            lower.append(-RATE_MAX_RAD_S - plan[:, step])
            upper.append(RATE_MAX_RAD_S - plan[:, step])
            at = at + PERIOD_S * plan[:, step]
    rows = np.zeros((n * steps, n * (2 * steps + 1)))
    for step in range(steps):
        these, first = slice(n * step, n * (step + 1)), 2 * n * step
        rows[these, first : first + n] = np.eye(n)
        rows[these, first + n : first + 2 * n] = PERIOD_S * np.eye(n)
        rows[these, first + 2 * n : first + 3 * n] = -np.eye(n)
    linear = ca.sparsify(ca.DM(rows))
    quadratic = ca.diagcat(*blocks)
    shape = {"h": quadratic.sparsity(), "a": linear.sparsity()}
    sizes = {"N": steps, "nx": [n] * (steps + 1), "nu": [n] * steps + [0], "ng": [0] * (steps + 1)}
    program = ca.conic("program", "hpipm", shape, {**sizes, "hpipm": {"iter_max": 50}})
    data = ca.Function(
        "data",
        [bends, plan, points],
        [quadratic, ca.vertcat(*slopes), ca.vertcat(*lower), ca.vertcat(*upper)],
        {"cse": True},
    )

    def solve(at, plan, curve_m):
        h, g, low, high = data(at, plan, curve_m)
        found = np.array(program(h=h, g=g, a=linear, lbx=low, ubx=high, lba=0, uba=0)["x"]).ravel()
        changes = np.append(found, np.zeros(n)).reshape(steps + 1, 2 * n)[:steps, n:]
        return plan + changes.T

    return solve


def ours(program):
    """The same of cdcr-bench solver, by problem and solver."""
    output = subprocess.run([program, "solver", "--format", "json"], capture_output=True, text=True, check=True).stdout
    results = json.loads(output)
    found = {}
    for row in results["cases"]:
        paper = (row["curve"], row["horizon"], row["swarm"], row["iterations"], row["obstacles"]) == ("spiral", 2, 6, 30, 0)
        if paper and row["sections"] <= 3 and row["solver"] != "kpso":
            key = (row["sections"], 2, 1, "cdcr " + row["solver"])
            found[key] = min(found.get(key, (math.inf,)), (row["p50_us"], row["p99_us"], math.nan))
    for row in results["hard"]:
        if row["obstacles"] == 0 and row["speed"] in (1, 10):
            found[3, 20, row["speed"], "cdcr " + row["solver"]] = (row["p50_us"], row["p99_us"], row["mean_error_mm"])
    return found


def one_round(program):
    """p50, p99 in microseconds, mean error in mm, by sections, steps, speed and solver."""
    found = ours(program)
    for sections in (1, 2, 3):
        found[sections, 2, 1, "CasADi, generated C, one Gauss-Newton step"] = generated_c(sections, 2, 400)
    for steps, speed in ((2, 1), (20, 1), (20, 10)):
        for name, make in (
            ("HPIPM, one quadratic program", structured),
            ("IPOPT until converged", lambda *size: nonlinear(*size, "ipopt")),
        ):
            found[3, steps, speed, name + ", called from Python"] = followed(3, steps, speed, 90, make(3, steps))
    return found


def main():
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    rounds = []
    for number in range(ROUNDS):
        print(f"round {number + 1} of {ROUNDS}", file=sys.stderr)
        rounds.append(one_round(sys.argv[1]))
    lines = []
    for key in sorted(rounds[0], key=lambda key: (key[1], key[0], key[2], key[3])):
        p50_us, p99_us, error_mm = (statistics.median(values) for values in zip(*(found[key] for found in rounds)))
        error = "-" if math.isnan(error_mm) else f"{error_mm:.1e}"
        times = [f"{time_us:.{0 if time_us >= 10 else 2}f}" for time_us in (p50_us, p99_us)]
        lines.append([*map(str, key), *times, error])
    heads = ["sections", "steps", "speed", "solver", "p50 µs", "p99 µs", "mean error mm"]
    table = {
        "title": f"The spiral by cdcr and by others: medians of {ROUNDS} rounds",
        "heads": heads,
        "words": [head == "solver" for head in heads],
        "lines": lines,
    }
    pathlib.Path(sys.argv[2]).write_text(json.dumps({"tables": [table]}, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main()
