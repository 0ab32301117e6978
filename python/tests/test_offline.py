"""The controller from Python: the same numbers as in Rust, with the array shapes of the arguments."""

import csv
import io
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import cdcr
from conftest import PROGRAMS, PROJECT

GOLDEN = json.loads((PROJECT / "controller/tests/suite/golden/kinematics.json").read_text())["cases"]


def bends_of(angles: list[list[float]]) -> np.ndarray:
    theta, phi = np.array(angles).T
    return np.stack([theta * np.cos(phi), theta * np.sin(phi)], axis=-1).ravel()


@pytest.mark.parametrize("case", GOLDEN, ids=lambda case: str(case["theta_phi"]))
def test_kinematics_are_those_that_an_independent_program_computed(case: dict) -> None:
    """The tolerances are those of controller/tests/suite/kinematics_golden.rs; the file is in millimetres."""
    bend = bends_of(case["theta_phi"])
    robot = cdcr.Robot.paper(len(case["theta_phi"]))
    assert np.abs(1e3 * robot.forward(bend) - case["p"]).max() < 3e-13
    assert np.abs(robot.orientation(bend, "matrix") - case["R"]).max() < 6e-16
    # At Θ = ±90° only Φ ∓ Ψ is defined; both sides take Φ = 0 there.
    assert np.abs(robot.orientation(bend, "zyx") - case["euler_zyx"]).max() < 2e-15
    assert np.abs(1e3 * robot.cables(bend) - np.ravel(case["cables"])).max() < 3e-13
    jacobian = robot.jacobian(bend)
    assert np.abs(1e3 * jacobian[:3] - np.array(case["J_uv"])[:3]).max() < 3e-12
    assert np.abs(jacobian[3:] - np.array(case["J_uv"])[3:]).max() < 1e-14
    assert np.abs(robot.bend_from_cables(robot.cables(bend)) - bend).max() < 1e-13


def test_many_configurations_are_one_call_and_the_same_bits() -> None:
    robot = cdcr.Robot()
    bends = np.random.default_rng(1).uniform(-1.5, 1.5, (4, 5, 6))
    ball = cdcr.Obstacle.sphere([0.3, 0.1, 0.4], 0.05)
    functions = {
        robot.forward: (3,),
        robot.orientation: (4,),
        robot.jacobian: (6, 6),
        robot.cables: (9,),
        robot.backbone: (50, 3),
        lambda bend: robot.clearance(bend, [ball]): (),
    }
    for function, row in functions.items():
        together = function(bends)
        assert together.shape == (4, 5, *row)
        for i in range(4):
            for j in range(5):
                assert (together[i, j] == function(bends[i, j])).all()
        assert function(np.zeros((0, 6))).shape == (0, *row)


def test_backbone_begins_at_the_base_ends_at_the_tip_and_has_the_robots_length() -> None:
    robot = cdcr.Robot([0.1, 0.25, 0.4])
    bend = np.array([0.3, -0.5, 1.0, 0.2, -0.7, 0.9])
    for count in (1, 100_001, 10**12):
        with pytest.raises(cdcr.ArgumentError, match="points is"):
            robot.backbone(bend, count)
    points = robot.backbone(bend, 2001)
    assert (points[0] == 0).all() and np.abs(points[-1] - robot.forward(bend)).max() < 1e-15
    assert abs(np.linalg.norm(np.diff(points, axis=0), axis=1).sum() - 0.75) < 1e-6
    assert abs(robot.reach_m - 0.75) < 1e-15 and (robot.length_m == [0.1, 0.25, 0.4]).all()


def test_orientations_agree_and_the_jacobian_is_the_derivative() -> None:
    robot = cdcr.Robot()
    bend = np.random.default_rng(2).uniform(-1, 1, 6)
    x, y, z, w = robot.orientation(bend)
    matrix = robot.orientation(bend, form="matrix")
    tip_axis = [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)]
    assert np.abs(matrix[:, 2] - tip_axis).max() < 1e-15 and w >= 0
    step = 1e-6 * np.eye(6)
    difference = (robot.forward(bend + step) - robot.forward(bend - step)) / 2e-6
    assert np.abs(difference.T - robot.jacobian(bend)[:3]).max() < 1e-9


def test_clearance_is_that_of_the_straight_robot_beside_a_ball_and_a_capsule() -> None:
    robot = cdcr.Robot()
    ball = cdcr.Obstacle.sphere([0.2, 0, 0.45], 0.05)
    pole = cdcr.Obstacle.capsule([0.1, -1, 0.6], [0.1, 1, 0.6], 0.02)
    straight = np.zeros(6)
    assert abs(robot.clearance(straight, [ball]) - (0.2 - 0.05 - 0.015)) < 1e-15
    assert abs(robot.clearance(straight, [ball, pole]) - (0.1 - 0.02 - 0.015)) < 1e-12
    assert np.isinf(robot.clearance(straight, []))
    moving = cdcr.Obstacle.sphere([0.2, 0, 0.45], 0.05, velocity_m_s=[-0.1, 0, 0])
    assert abs(robot.clearance(straight, [moving.moved(1.0)]) - 0.035) < 1e-15
    assert (moving.axis_m == [[0.2, 0, 0.45]] * 2).all() and moving.radius_m == 0.05


@pytest.mark.parametrize(
    ("bend", "words"),
    [
        (np.zeros((5, 4)), ["(5, 4)", "(..., 6)", "3 sections"]),
        (np.zeros(7), ["(7,)", "(..., 6)"]),
        (3.0, ["()", "(..., 6)"]),
        (np.zeros(6, complex), ["complex128", "real"]),
        (["a"] * 6, ["<U1", "real"]),
        ([[1, 2], [3]], ["uneven"]),
        (np.array([None] * 6), ["object"]),
    ],
)
def test_wrong_shapes_and_kinds_are_refused_with_both_shapes(bend: object, words: list[str]) -> None:
    with pytest.raises(cdcr.ArgumentError) as refused:
        cdcr.Robot().forward(bend)
    assert all(word in str(refused.value) for word in words), refused.value
    assert refused.value.remedy and isinstance(refused.value, ValueError)


def test_any_real_array_is_taken_wherever_it_lies() -> None:
    robot = cdcr.Robot()
    bends = np.random.default_rng(3).uniform(-1, 1, (8, 6))
    wanted = robot.forward(bends)
    packed = np.zeros(8, dtype=[("one", "u1"), ("bend", "f8", 6)])
    packed["bend"] = bends
    others = [
        np.asfortranarray(bends),
        bends.tolist(),
        bends.astype(">f8"),
        np.repeat(bends, 2, axis=0)[::2],
        np.ascontiguousarray(bends[:, ::-1])[:, ::-1],
        packed["bend"],
        np.frombuffer(b"\0" + bends.tobytes(), dtype="f8", count=48, offset=1).reshape(8, 6),
    ]
    for other in others:
        assert (robot.forward(other) == wanted).all()
    frozen = bends.copy()
    frozen.flags.writeable = False
    assert (robot.forward(frozen) == wanted).all()
    assert np.abs(robot.forward(bends.astype(np.float32)) - wanted).max() < 1e-6
    assert (robot.forward(np.zeros(6, int)) == [0, 0, robot.reach_m]).all()


def test_nan_comes_through_kinematics_and_is_refused_by_the_solver() -> None:
    robot = cdcr.Robot()
    bend = np.array([0.1, np.nan, 0, 0, 0, 0])
    assert np.isnan(robot.forward(bend)).any()
    ball = cdcr.Obstacle.sphere([0.3, 0, 0.4], 0.05)
    assert np.isnan(robot.clearance(bend, [ball]))
    nmpc = cdcr.Nmpc(robot)
    for arguments in [(bend, np.zeros((2, 3))), (np.zeros(6), [[0, 0, np.inf]])]:
        with pytest.raises(cdcr.ArgumentError, match="holds (NaN|inf)"):
            nmpc.solve(*arguments)
    with pytest.raises(cdcr.ArgumentError, match="xyz holds NaN"):
        cdcr.Trajectory.from_arrays([0, 1], [[0, 0, 1], [0, np.nan, 1]])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"length_m": 0.3, "bend_max_rad": 4.0}, "bend_max_rad = 4"),
        ({"length_m": [0.3] * 7}, "7 sections"),
        ({"length_m": [0.3, 0.3], "cable_radius_m": [0.01] * 3}, "2 numbers"),
        ({"length_m": [0.3, np.nan]}, "NaN"),
        ({"length_m": 300.0}, "SI units"),
        ({"length_m": [[0.3]]}, "shape"),
        ({"length_m": []}, "shape"),
    ],
)
def test_what_is_no_robot_is_refused(arguments: dict, words: str) -> None:
    with pytest.raises(cdcr.ArgumentError, match=words):
        cdcr.Robot(**arguments)


def test_every_setting_has_a_text_with_its_range() -> None:
    texts = cdcr.setting_texts()
    assert texts.keys() == cdcr.default_settings().keys()
    assert "1 to 50" in texts["horizon_steps"] and not any("{range}" in text for text in texts.values())


def test_a_robot_comes_from_a_configuration(tmp_path: Path) -> None:
    assert cdcr.Robot.from_toml(PROJECT / "configs/default.toml") == cdcr.Robot() == cdcr.Robot.paper(3)
    assert cdcr.Robot.from_toml(PROJECT / "configs/two-sections.toml").sections == 2
    assert cdcr.settings_from_toml(str(PROJECT / "configs/default.toml")) == cdcr.default_settings()
    file = tmp_path / "robot.toml"
    file.write_text("[controller]\nhorizon_steps = 9\n")
    assert cdcr.settings_from_toml(file)["horizon_steps"] == 9 and cdcr.Robot.from_toml(file) == cdcr.Robot()
    for text, words in [("[robot]\nlenght = 1", "lenght"), ("[robot", "TOML"), ("[controller]\nseed = 'x'", "seed|integer|string")]:
        file.write_text(text)
        with pytest.raises(cdcr.ArgumentError, match=words):
            cdcr.Robot.from_toml(file)
            cdcr.settings_from_toml(file)
    with pytest.raises(cdcr.ArgumentError, match="cannot read"):
        cdcr.Robot.from_toml(tmp_path / "none.toml")


def test_a_solve_gives_rates_that_reach_the_window_and_a_status() -> None:
    robot = cdcr.Robot()
    nmpc = cdcr.Nmpc(robot, {"solver": "gauss-newton", "horizon_steps": 3}, period_s=0.01)
    bend = np.full(6, 0.3)
    window = robot.forward(bend) + [[0, 1e-4, 0], [0, 2e-4, 0], [0, 3e-4, 0]]
    rates, plan, report = nmpc.solve(bend, window)
    assert rates.shape == (6,) and plan.shape == (3, 6) and (plan[0] == rates).all()
    assert np.linalg.norm(robot.forward(bend + 0.01 * rates) - window[0]) < 1e-12
    assert report.status == "converged" and report.cost <= report.warm_cost and report.evaluations > 0
    assert nmpc.settings["solver"] == "gauss-newton" and nmpc.period_s == 0.01
    nmpc.configure(horizon_steps=5)
    assert nmpc.solve(bend, window)[1].shape == (5, 6)
    for change in [{"horizon_steps": 99}, {"horizn": 1}, {"solver": "best"}, {"inertia": np.nan}, {"seed": None}]:
        with pytest.raises(cdcr.ArgumentError):
            nmpc.configure(**change)
    assert nmpc.settings["horizon_steps"] == 5


def test_the_same_solve_gives_the_same_bits_and_a_budget_ends_it() -> None:
    robot = cdcr.Robot()
    bend, window = np.full(6, 0.3), [[0.1, 0.1, 0.8]]
    balls = [cdcr.Obstacle.sphere([0.2, 0.1, 0.6], 0.05)]
    one, other = cdcr.Nmpc(robot, {"horizon_steps": 10}), cdcr.Nmpc(robot, {"horizon_steps": 10})
    for _ in range(3):
        first, second = one.solve(bend, window, balls), other.solve(bend, window, balls)
        assert (first[0] == second[0]).all() and first[2].seed == second[2].seed
    whole = cdcr.Nmpc(robot, {"horizon_steps": 10}).solve(bend, window, balls, seed=7)[2]
    part = cdcr.Nmpc(robot, {"horizon_steps": 10}).solve(bend, window, balls, seed=7, budget_quanta=whole.quanta // 2)[2]
    assert part.budget_spent and part.quanta == whole.quanta // 2 and part.cost >= whole.cost
    assert cdcr.Nmpc(robot).solve(bend, window, budget_s=0.0)[2].budget_spent
    with pytest.raises(cdcr.ArgumentError, match="budget_s"):
        one.solve(bend, window, budget_s=-1.0)
    with pytest.raises(cdcr.ArgumentError, match="empty"):
        one.solve(bend, np.zeros((0, 3)))


def test_an_orientation_is_followed_and_must_be_of_unit_length() -> None:
    robot = cdcr.Robot()
    bend = np.array([0.3, 0.2, -0.1, 0.4, 0.2, 0.1])
    goal = bend + 1e-3
    tip, quaternion, axis = robot.forward(goal), robot.orientation(goal), robot.orientation(goal, "matrix")[:, 2]
    for orientation in [{"quaternion": [quaternion]}, {"axis": [axis]}]:
        rates, _, _ = cdcr.Nmpc(robot, {"horizon_steps": 1}).solve(bend, [tip], **orientation)
        reached = robot.orientation(bend + 0.005 * rates, "matrix")[:, 2]
        assert np.linalg.norm(reached - axis) < 1e-6
    nmpc = cdcr.Nmpc(robot)
    with pytest.raises(cdcr.ArgumentError, match="unit length"):
        nmpc.solve(bend, [tip], quaternion=[[1, 1, 1, 1]])
    with pytest.raises(cdcr.ArgumentError, match="both"):
        nmpc.solve(bend, [tip], quaternion=[quaternion], axis=[axis])
    with pytest.raises(cdcr.ArgumentError, match=r"\(1, 4\).*\(2, 4\)"):
        nmpc.solve(bend, [tip, tip], quaternion=[quaternion])


@pytest.mark.parametrize("plant", ["ideal", "laboratory", "sloppy", "slow", "blind"])
def test_simulate_has_the_bits_of_the_closed_loop_in_rust(plant: str) -> None:
    program = PROGRAMS / "closed_loop_csv"
    text = subprocess.run([program, plant], capture_output=True, text=True, check=True).stdout
    header, *rows = csv.reader(io.StringIO(text))
    table = np.array(rows, float)
    column = {name: index for index, name in enumerate(header)}
    robot = cdcr.Robot()
    # The horizon of the last rows includes points beyond the table, and the point at 0 belongs to no other sample.
    xyz = np.vstack([table[:1, 1:4], table[:, 1:4], table[-1:, 1:4]])
    table = table[:-3]
    trajectory = cdcr.Trajectory.from_arrays(0.005 * np.arange(402), xyz)
    ran = cdcr.simulate(robot, trajectory, plant=plant, start=[0, 0, 0.3, 0, 0.4, 0], duration_s=0.005 * len(table))
    assert len(ran) == len(table) == 397
    assert (ran.time_s == table[:, 0]).all()
    assert (ran.reference_position_m == table[:, 1:4]).all()
    assert (ran.bend_rad == table[:, column["bend_rad_0"] : column["rate_rad_s_0"]]).all()
    assert (ran.bend_rate_rad_s == table[:, column["rate_rad_s_0"] : column["tip_x_m"]]).all()
    assert (ran.tip_position_m == table[:, column["tip_x_m"] : column["error_m"]]).all()
    assert (ran.position_error_m == table[:, column["error_m"]]).all()


def test_simulate_keeps_clear_and_obeys_its_arguments() -> None:
    robot = cdcr.Robot.paper(2)
    start = np.array([0.4, 0, 0.5, 0])
    tip = robot.forward(start)
    t = np.arange(0, 3, 0.005)
    circle = np.stack([tip[0] * np.cos(t), tip[0] * np.sin(t), np.full_like(t, tip[2])], axis=-1)
    ball = cdcr.Obstacle.sphere(circle[300] + [0, 0.02, 0.03], 0.02)
    arguments = {"start": start, "obstacles": [ball], "settings": {"horizon_steps": 20, "safe_distance_m": 0.01}}
    ran = cdcr.simulate(robot, cdcr.Trajectory.from_arrays(t, circle), **arguments)
    assert ran.clearance_m.min() > 0.01 - 1e-6 and ran.position_error_m.max() > 1e-3 and ran.position_error_m[-1] < 1e-6
    assert len(ran.status) == len(ran.guarded) == len(ran) and set(ran.status) <= {"converged", "iterations-spent"}
    # A known lag is compensated.
    eight = cdcr.Trajectory.helix([0, 0, 0.5], 0.06, rise_m=0.04, speed_m_s=0.08)
    error = {}
    for known_s in (0.0, 0.1):
        slow = cdcr.simulate(robot, eight, flaws={"time_constant_s": 0.1}, actuator_time_constant_s=known_s, start=[0.3, 0, -0.05, 0])
        error[known_s] = slow.position_error_m[-100:].mean()
    assert error[0.1] < 0.5 * error[0.0]
    for wrong in [{"plant": "best"}, {"flaws": {"plya": 1}}, {"flaws": {"play_m": 1}}, {"sensor": "eye"}, {"interface": "force"},
                  {"duration_s": -1}, {"period_s": 0}, {"start": [0, 0]}, {"actuator_delay_s": 9}, {"acceleration_rad_s2": np.nan}]:
        with pytest.raises(cdcr.ArgumentError):
            cdcr.simulate(robot, eight, **wrong)


def test_trajectories_are_what_they_say() -> None:
    robot = cdcr.Robot()
    spiral = cdcr.Trajectory.spiral(robot)
    t = 5 / 180 * np.pi + np.linspace(0, spiral.duration_s, 20)
    bends = np.zeros((20, 6))
    bends[:, 4], bends[:, 5] = 2 * t / 15 * np.cos(t), 2 * t / 15 * np.sin(t)
    assert np.abs(spiral.position(t - t[0]) - robot.forward(bends)).max() < 1e-14
    assert abs(spiral.duration_s - 4.97) < 1e-12
    helix = cdcr.Trajectory.helix([0, 0, 0.7], 0.05, rise_m=0.03, speed_m_s=0.05, turns=2)
    places = helix.position(np.linspace(0, helix.duration_s, 500))
    assert np.abs(np.hypot(places[:, 0], places[:, 1]) - 0.05).max() < 1e-6
    assert abs(places[-1, 2] - places[0, 2] - 0.03) < 1e-12
    points = cdcr.Trajectory.from_arrays([5.0, 6.0, 7.5], [[0, 0, 0.8], [0.1, 0, 0.8], [0.1, 0.1, 0.8]], interpolation="linear")
    assert points.duration_s == 2.5 and np.abs(points.position(0.5) - [0.05, 0, 0.8]).max() < 1e-12
    for t, xyz in [([0, 1], np.zeros((3, 3))), ([], np.zeros((0, 3))), ([0, 0], np.zeros((2, 3))), ([0, 1], np.zeros((2, 2)))]:
        with pytest.raises(cdcr.ArgumentError):
            cdcr.Trajectory.from_arrays(t, xyz)
    for wrong in [{"radius_m": 0}, {"speed_m_s": -1}, {"turns": 0}, {"rounds": 0}]:
        with pytest.raises(cdcr.ArgumentError):
            cdcr.Trajectory.helix(**{"centre_m": [0, 0, 1], "radius_m": 0.1, "rise_m": 0.1, "speed_m_s": 0.1, **wrong})


def test_the_first_call_loads_no_module() -> None:
    """A late import would delay the first points of a feed."""
    program = """
import sys, cdcr
loaded = set(sys.modules)
robot = cdcr.Robot(length_m=[0.3, 0.2])
tip = robot.forward([0.1, 0, 0, 0.2])
cdcr.Nmpc(robot).solve([0.0] * 4, [tip], [cdcr.Obstacle.sphere([1, 0, 0], 0.1)])
cdcr.simulate(robot, cdcr.Trajectory.from_arrays([0, 0.1], [[0, 0, 0.4], [0, 0.01, 0.4]]))
assert set(sys.modules) == loaded, set(sys.modules) - loaded
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
