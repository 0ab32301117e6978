"""Accepted and rejected arguments, and Python protocols of the classes: text, help, pickle, version."""

import copy
import inspect
import multiprocessing
import pickle
import re
import threading
from collections.abc import Callable, Iterator
from importlib.metadata import PackageNotFoundError, version

import numpy as np
import pytest

import cdcr
from conftest import PROJECT

ROBOT = cdcr.Robot()
BALL = cdcr.Obstacle.sphere([0.5, 0, 0.5], 0.05)
XYZ = np.array([[0, 0, 0.9], [0, 0.1, 0.89]])


def arrays() -> Iterator[tuple[str, np.ndarray, Callable[[object], object]]]:
    """Every argument that is an array: its name, a value, and a call."""
    nmpc, spiral, bend = cdcr.Nmpc(ROBOT), cdcr.Trajectory.spiral(ROBOT), np.full(6, 0.1)
    quaternion, axis = np.array([[0, 0, 0, 1.0]] * 2), np.array([[0, 0, 1.0]] * 2)
    for function in (ROBOT.forward, ROBOT.orientation, ROBOT.jacobian, ROBOT.cables, ROBOT.backbone):
        yield "bend", bend, function
    yield "bend", bend, lambda bend: ROBOT.clearance(bend, [BALL])
    yield "length", ROBOT.cables(bend), ROBOT.bend_from_cables
    for name in ("length_m", "cable_radius_m", "cable_offset_rad", "bend_max_rad", "rate_max_rad_s", "body_radius_m"):
        yield name, np.full(3, 0.3 if name == "length_m" else 0.01), lambda value, name=name: cdcr.Robot(**{name: value})
    yield "bend", bend, lambda bend: nmpc.solve(bend, XYZ)
    yield "window", XYZ, lambda window: nmpc.solve(bend, window)
    yield "quaternion", quaternion, lambda value: nmpc.solve(bend, XYZ, quaternion=value)
    yield "axis", axis, lambda value: nmpc.solve(bend, XYZ, axis=value)
    yield "previous_rates", bend, lambda value: nmpc.solve(bend, XYZ, previous_rates=value)
    yield "start", bend, lambda start: cdcr.simulate(ROBOT, spiral, start=start, duration_s=0.01)
    yield "t", np.arange(2.0), lambda t: cdcr.Trajectory.from_arrays(t, XYZ)
    yield "xyz", XYZ, lambda xyz: cdcr.Trajectory.from_arrays([0, 1], xyz)
    yield "quaternion", quaternion, lambda value: cdcr.Trajectory.from_arrays([0, 1], XYZ, quaternion=value)
    yield "axis", axis, lambda value: cdcr.Trajectory.from_arrays([0, 1], XYZ, axis=value)
    yield "t", np.arange(2.0), spiral.position
    yield "centre_m", XYZ[0], lambda centre: cdcr.Trajectory.helix(centre, 0.1, rise_m=0.1, speed_m_s=0.1)
    yield "centre_m", XYZ[0], lambda centre: cdcr.Obstacle.sphere(centre, 0.1)
    yield "velocity_m_s", XYZ[0], lambda velocity: cdcr.Obstacle.sphere([1, 0, 0], 0.1, velocity)
    yield "start_m", XYZ[0], lambda start: cdcr.Obstacle.capsule(start, [0, 0, 1], 0.1)
    yield "end_m", XYZ[0], lambda end: cdcr.Obstacle.capsule([0, 0, 1], end, 0.1)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("name", "value", "call"), list(arrays()), ids=lambda part: part if isinstance(part, str) else "")
def test_masked_numbers_are_refused_and_a_mask_of_nothing_is_none(name: str, value: np.ndarray, call: Callable[[object], object]) -> None:
    mask = np.zeros(value.shape, bool)
    call(np.ma.array(value, mask=mask))
    mask.flat[-1] = True
    masked = np.ma.array(value, mask=mask)
    for given in (masked, list(masked), masked.astype(np.float32), tuple(masked)):
        with pytest.raises(cdcr.ArgumentError, match=f"{name} has masked") as refused:
            call(given)
        assert ".filled(" in refused.value.remedy
    call(masked.filled(value.flat[-1]))


@pytest.mark.parametrize(("name", "value", "call"), list(arrays()), ids=lambda part: part if isinstance(part, str) else "")
def test_what_is_no_array_of_numbers_is_refused_by_its_name(name: str, value: np.ndarray, call: Callable[[object], object]) -> None:
    for given in ((number for number in value), "text", None if name in ("bend", "xyz", "window") else {}, object(), np.datetime64(0, "s"), b"1"):
        with pytest.raises(cdcr.ArgumentError, match=name) as refused:
            call(given)
        assert refused.value.remedy


def test_whole_numbers_of_any_size_are_refused_by_their_names() -> None:
    nmpc, spiral, bend = cdcr.Nmpc(ROBOT), cdcr.Trajectory.spiral(ROBOT), np.zeros(6)

    def helix(**given: int) -> object:
        return cdcr.Trajectory.helix([0, 0, 1], 0.1, rise_m=0.1, speed_m_s=0.1, **given)

    calls: dict[str, Callable[[int], object]] = {
        "sections": cdcr.Robot.paper,
        "points": lambda number: ROBOT.backbone(bend, number),
        "turns": lambda number: helix(turns=number),
        "rounds": lambda number: helix(rounds=number),
        "budget_quanta": lambda number: nmpc.solve(bend, XYZ, budget_quanta=number),
        "elapsed_periods": lambda number: nmpc.solve(bend, XYZ, elapsed_periods=number),
        "seed": lambda number: nmpc.solve(bend, XYZ, seed=number),
        "seed ": lambda number: cdcr.simulate(ROBOT, spiral, seed=number, duration_s=0.01),
        "every": lambda number: cdcr.read("none.mcap", every=number),
    }
    for name, call in calls.items():
        for number in (-1, 2**64, -(2**100)):
            with pytest.raises(cdcr.ArgumentError, match=f"{name.strip()} is {number}") as refused:
                call(number)
            assert refused.value.remedy, name
    nmpc.solve(bend, XYZ, seed=2**64 - 1, elapsed_periods=2**32 - 1)


def test_more_than_64_obstacles_are_refused_alike_by_all() -> None:
    from conftest import Daemon

    many = [BALL] * 65
    daemon = Daemon()
    try:
        with daemon.connect() as connection:
            calls = [
                lambda balls: ROBOT.clearance(np.zeros(6), balls),
                lambda balls: cdcr.Nmpc(ROBOT).solve(np.zeros(6), XYZ, balls),
                lambda balls: cdcr.simulate(ROBOT, cdcr.Trajectory.spiral(ROBOT), obstacles=balls, duration_s=0.01),
                lambda balls: connection.set_obstacles(dict(enumerate(balls))),
                lambda balls: connection.remove_obstacles(range(len(balls))),
            ]
            texts = set()
            for call in calls:
                call(many[:64])
                with pytest.raises(cdcr.ArgumentError) as refused:
                    call(many)
                texts.add(f"{refused.value} {refused.value.remedy}")
            assert len(texts) == 1 and "there are 65 obstacles; allowed are 64" in texts.pop()
            for wrong in ({-1: BALL}, {2**32: BALL}, {"one": BALL}, {1: "ball"}):
                with pytest.raises(cdcr.ArgumentError, match="obstacle") as refused:
                    connection.set_obstacles(wrong)
                assert refused.value.remedy
            with pytest.raises(cdcr.ArgumentError, match="number of an obstacle is -1"):
                connection.remove_obstacles([-1])
    finally:
        daemon.end()


def test_sizes_that_no_memory_holds_are_refused() -> None:
    with pytest.raises(cdcr.ArgumentError, match="memory"):
        ROBOT.backbone(np.zeros((10**7, 6)), 100_000)
    with pytest.raises(cdcr.ArgumentError, match="periods"):
        cdcr.simulate(ROBOT, cdcr.Trajectory.spiral(ROBOT), duration_s=86_400, period_s=1e-6)
    for number in (0, -1e-7, 1e7, float("nan"), float("inf")):
        for name in ("radius_m", "speed_m_s"):
            with pytest.raises(cdcr.ArgumentError, match=name):
                cdcr.Trajectory.helix(**{"centre_m": [0, 0, 1], "radius_m": 0.1, "rise_m": 0.1, "speed_m_s": 0.1, name: number})


def test_a_trajectory_is_a_day_long_at_most() -> None:
    assert cdcr.Trajectory.from_arrays([5, 7, 86_285], XYZ[[0, 1, 1]]).duration_s == 86_280
    # A daemon does not take a point that is so far ahead.
    with pytest.raises(cdcr.ArgumentError, match="from one t to the next is 86400"):
        cdcr.Trajectory.from_arrays([5, 86_405], XYZ)
    for t in ([0, 86_401], [0, 1e300], [-1e308, 1e308]):
        with pytest.raises(cdcr.ArgumentError, match="86400"):
            cdcr.Trajectory.from_arrays(t, XYZ)


def test_a_row_is_no_array_of_them() -> None:
    rows = np.zeros(2, cdcr.dtype("Status"))
    assert cdcr.message(rows[0])["mode"] is cdcr.Mode.STARTING
    for wrong in (rows, 3, None, {}):
        with pytest.raises(cdcr.ArgumentError, match="is not a row of") as refused:
            cdcr.message(wrong)
        assert "records[0]" in refused.value.remedy


def test_settings_and_flaws_of_wrong_kinds_are_refused() -> None:
    spiral = cdcr.Trajectory.spiral(ROBOT)
    for settings in ({1: 2}, {"horizon_steps": [1]}, {"horizon_steps": 2.5}, {"horizon_steps": True}, {"horizon_steps": 2**70}):
        with pytest.raises(cdcr.ArgumentError) as refused:
            cdcr.Nmpc(ROBOT, settings)
        assert refused.value.remedy
    for flaws in ({1: 2}, {"play_m": "much"}, {"play_m": None}):
        with pytest.raises(cdcr.ArgumentError, match="flaws holds") as refused:
            cdcr.simulate(ROBOT, spiral, flaws=flaws)
        assert refused.value.remedy


def test_a_wrong_kind_is_pythons_own_error() -> None:
    """docs/python.md, Errors: these alone have no remedy."""
    for call in (
        lambda: ROBOT.backbone(np.zeros(6), "many"),
        lambda: ROBOT.backbone(np.zeros(6), 2.0),
        lambda: cdcr.Obstacle.sphere([0, 0, 0], "wide"),
        lambda: ROBOT.clearance(np.zeros(6), BALL),
        lambda: cdcr.Nmpc("robot"),
        lambda: cdcr.Robot(lenght_m=1),
        lambda: cdcr.read(3),
        lambda: cdcr.connect(3),
        lambda: ROBOT.orientation(np.zeros(6), 3),
    ):
        with pytest.raises(TypeError) as refused:
            call()
        assert not isinstance(refused.value, cdcr.Error)
    with pytest.raises(OverflowError):
        cdcr.Obstacle.sphere([0, 0, 0], 10**400)
    with pytest.raises(OverflowError):
        ROBOT.backbone(np.zeros(6), 2**127)


def test_robots_and_obstacles_are_pickled_and_copied() -> None:
    robots = [ROBOT, cdcr.Robot([0.1, 0.2], cable_offset_rad=[0.1, 1 / 3], body_radius_m=0.002, cable_stroke_max_m=0.1), cdcr.Robot(0.3, tip_speed_max_m_s=0.1), cdcr.Robot(0.3, self_overlap_max_m=0.01)]
    for robot in robots:
        for other in (pickle.loads(pickle.dumps(robot)), copy.copy(robot), copy.deepcopy(robot)):
            assert other == robot and isinstance(other, cdcr.Robot)
    pole = cdcr.Obstacle.capsule([0.1, -1, 0.6], [0.1, 1, 1 / 3], 0.02, [0, 0, 0.1])
    for obstacle in (BALL, pole):
        for other in (pickle.loads(pickle.dumps(obstacle)), copy.deepcopy(obstacle)):
            assert repr(other) == repr(obstacle) and isinstance(other, cdcr.Obstacle)


def work(robot: cdcr.Robot, balls: list[cdcr.Obstacle]) -> float:
    return float(robot.clearance(np.zeros(6), balls))


@pytest.mark.parametrize("method", ["spawn", "forkserver", "fork"])
@pytest.mark.filterwarnings("ignore:.*multi-threaded.*:DeprecationWarning")
def test_a_pool_of_processes_computes_offline(method: str) -> None:
    with multiprocessing.get_context(method).Pool(2) as pool:
        assert pool.starmap(work, [(ROBOT, [BALL])] * 4) == [work(ROBOT, [BALL])] * 4


def test_threads_share_a_solver_one_after_the_other() -> None:
    nmpc, solved = cdcr.Nmpc(ROBOT, {"horizon_steps": 10}), []

    def run() -> None:
        for _ in range(20):
            solved.append(nmpc.solve(np.full(6, 0.3), XYZ, [BALL])[2].seed)
            nmpc.configure(horizon_steps=10)
            nmpc.forget_plan()

    threads = [threading.Thread(target=run) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    # Every solve increments the counter of the seed, so each one has a different seed.
    assert len(solved) == len(set(solved)) == 80


def test_the_version_is_that_of_the_project() -> None:
    [number] = re.findall(r'^version = "(.*)"$', (PROJECT / "Cargo.toml").read_text(), re.MULTILINE)
    assert cdcr.__version__ == number
    try:
        assert version("cdcr") == number
    except PackageNotFoundError:
        pytest.skip("the package is not installed")


CLASSES = [value for value in vars(cdcr).values() if inspect.isclass(value) and value.__module__ == "cdcr"]


@pytest.mark.parametrize("kind", CLASSES, ids=lambda kind: kind.__name__)
def test_every_class_has_a_text_and_every_function_a_help(kind: type) -> None:
    assert kind.__repr__ is not object.__repr__ and inspect.getdoc(kind)
    for name, member in vars(kind).items():
        if not name.startswith("_"):
            assert inspect.getdoc(member), f"{kind.__name__}.{name}"


def test_texts_show_what_an_object_is() -> None:
    spiral = cdcr.Trajectory.spiral(ROBOT)
    report = cdcr.Nmpc(ROBOT).solve(np.zeros(6), XYZ)[2]
    objects = [ROBOT, BALL, spiral, cdcr.Nmpc(ROBOT), report, cdcr.simulate(ROBOT, spiral, duration_s=0.01)]
    for thing in objects:
        assert type(thing).__name__ in repr(thing) and " at 0x" not in repr(thing)
    assert eval(repr(BALL), {"Obstacle": cdcr.Obstacle}).radius_m == BALL.radius_m
