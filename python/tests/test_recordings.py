"""Recordings as arrays, and plots of them."""

import itertools
import subprocess
from pathlib import Path

import numpy as np
import pytest

import cdcr
from conftest import PROGRAMS, Daemon

matplotlib = pytest.importorskip("matplotlib")
matplotlib.use("Agg")

import matplotlib.pyplot as plt  # noqa: E402
from mpl_toolkits.mplot3d import Axes3D  # noqa: E402

from cdcr import plot  # noqa: E402


def record(daemon: Daemon, file: Path) -> subprocess.CompletedProcess[str]:
    return daemon.run(str(PROGRAMS / "cdcrctl"), "record", "-o", str(file), "--duration", "1.5s")


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A daemon that tracks a curve."""
    file = tmp_path_factory.mktemp("recording") / "run.mcap"
    daemon = Daemon()
    try:
        with daemon.connect() as connection:
            connection.set_obstacles({3: cdcr.Obstacle.sphere([0.6, 0, 0.5], 0.1)})
            t = np.linspace(0, 600, 1201)
            xyz = np.stack([0.1 * np.cos(t), 0.1 * np.sin(t), np.full_like(t, 0.8)], axis=-1)
            with connection.feed(t, xyz):
                done = record(daemon, file)
                assert done.returncode == 0, done.stderr
    finally:
        daemon.end()
    return file


def test_a_recording_is_a_dictionary_of_structured_arrays(recording: Path) -> None:
    found = cdcr.read(recording)
    assert {"telemetry", "status"} <= set(found) <= {"telemetry", "reference", "obstacles", "status", "incidents"}
    telemetry = found["telemetry"]
    assert telemetry.dtype == cdcr.dtype("Telemetry") and len(telemetry) > 50
    assert (np.diff(telemetry["cycle"].astype(int)) >= 1).all() and (telemetry["header"]["sender_id"] != 0).all()
    assert (telemetry["mode"] == cdcr.Mode.TRACKING).all()
    # Tip and clearance in the record agree with its shape and obstacle.
    tip = cdcr.Robot().forward(telemetry["present_rad"][:, :6])
    assert np.abs(tip - telemetry["tip_position_m"]).max() < 1e-12
    one = cdcr.message(telemetry[0])
    assert one["mode"] is cdcr.Mode.TRACKING and one["robot"]["sections"] == 3
    ball = one["obstacles"][0]
    obstacle = cdcr.Obstacle.sphere(ball["start_m"], ball["radius_m"])
    assert abs(cdcr.Robot().clearance(one["present_rad"][:6], [obstacle]) - one["clearance_m"]) < 1e-9
    few = cdcr.read(str(recording), every=10)["telemetry"]
    assert (few == telemetry[::10]).all()
    status = cdcr.message(found["status"][0])
    assert status["robot_name"] == "cdcr"


def test_all_words_of_a_figure_are_in_it() -> None:
    robot = cdcr.Robot.paper(1)
    simulation = cdcr.simulate(robot, cdcr.Trajectory.line(robot), duration_s=0.1)
    for draw in (plot.timing, plot.error):
        ax = draw(simulation)
        ax.figure.canvas.draw()
        picture = ax.figure.bbox
        for word in (ax.xaxis.label, ax.yaxis.label, *([ax.title] if ax.get_title() else [])):
            box = word.get_window_extent()
            assert picture.x0 <= box.x0 and box.x1 <= picture.x1, word
            assert picture.y0 <= box.y0 and box.y1 <= picture.y1, word


@pytest.mark.parametrize("sections", [1, 3, 6])
def test_no_words_of_a_path_lie_over_others(sections: int) -> None:
    robot = cdcr.Robot.paper(sections)
    for trajectory in (cdcr.Trajectory.line(robot), cdcr.Trajectory.spiral(robot)):
        ax = plot.path(cdcr.simulate(robot, trajectory, duration_s=0.5))
        ax.figure.canvas.draw()
        words = [axis.label for axis in (ax.xaxis, ax.yaxis, ax.zaxis)]
        for axis, (low, high) in ((ax.xaxis, ax.get_xlim()), (ax.yaxis, ax.get_ylim()), (ax.zaxis, ax.get_zlim())):
            words += [tick.label1 for tick in axis.get_major_ticks() if low <= tick.get_loc() <= high]
        boxes = [ax.get_legend().get_window_extent(), *(word.get_window_extent() for word in words)]
        assert len(boxes) > 10
        for k, box in enumerate(boxes):
            assert not any(box.overlaps(other) for other in boxes[:k]), words[k - 1]
        plt.close("all")


def test_a_path_leads_from_the_shapes_to_the_tip_that_was_measured_beside_them(recording: Path) -> None:
    records = cdcr.read(recording)["telemetry"].copy()
    assert len(plot.path(records).get_lines()) == plot.SHAPES + 2
    records["tip_position_m"] += [0.0, 0.017, 0.0]
    ax = plot.path(records)
    dotted = [line for line in ax.get_lines() if line.get_linestyle() == ":"]
    assert len(dotted) == plot.SHAPES
    last = np.array(dotted[-1].get_data_3d()).T
    assert np.allclose(last[-1], records["tip_position_m"][-1]) and np.allclose(np.linalg.norm(last[-1] - last[0]), 0.017, atol=1e-4)
    assert [text.get_text() for text in ax.get_legend().get_texts()].count("tip offset") == 1
    plt.close("all")


def test_what_is_no_recording_is_refused_and_a_cut_one_gives_what_is_whole(recording: Path, tmp_path: Path) -> None:
    whole = recording.read_bytes()
    file = tmp_path / "some.mcap"
    for content, words in [(b"", "empty"), (b"PK\x03\x04 something else", "not an MCAP"), (whole[:600], "contains no message of cdcrd"), (whole[:-9000][:5000] + bytes(4000) + whole[9000:], "LZ4|damaged|cut")]:
        file.write_bytes(content)
        with pytest.raises(cdcr.RecordingError, match=words) as refused:
            cdcr.read(file)
        assert refused.value.remedy and isinstance(refused.value, OSError)
    with pytest.raises(cdcr.RecordingError, match="No such file"):
        cdcr.read(tmp_path / "none.mcap")
    with pytest.raises(cdcr.ArgumentError, match="every"):
        cdcr.read(recording, every=0)
    file.write_bytes(whole[: len(whole) // 2])
    with pytest.warns(UserWarning, match="repair"):
        part = cdcr.read(file)["telemetry"]
    telemetry = cdcr.read(recording)["telemetry"]
    assert 0 < len(part) < len(telemetry) and part.tobytes() == telemetry[: len(part)].tobytes()


def overlapping_numbers(ax: Axes3D) -> list[tuple[str, str]]:
    ax.figure.canvas.draw()
    shown = []
    for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
        low, high = sorted(axis.get_view_interval())
        shown += [number for number, place in zip(axis.get_ticklabels(), axis.get_ticklocs()) if low <= place <= high]
        shown.append(axis.label)
    pairs = itertools.combinations(shown, 2)
    return [(one.get_text(), other.get_text()) for one, other in pairs if one.get_window_extent().overlaps(other.get_window_extent())]


def test_the_error_without_the_measured_tip_is_named_so(recording: Path) -> None:
    telemetry = cdcr.read(recording)["telemetry"].copy()
    assert plot.error(telemetry).get_legend() is None
    has_reference = np.isfinite(telemetry["position_error_m"])
    telemetry["tip_measured_ns"] = telemetry["release_ns"]
    telemetry["tip_measured_m"] = telemetry["reference"]["position_m"] + [0.0, 0.161, 0.0]
    for cause, words in [(0, "estimated"), (1, "by the model (measured tip not in use: 100.0 % of the time)")]:
        telemetry["tip_cause"] = cause
        ax = plot.error(telemetry)
        drawn, measured = ax.get_lines()
        assert (drawn.get_label(), measured.get_label()) == (words, "as measured")
        assert len(measured.get_xdata()) > has_reference.sum() / 2 and np.allclose(measured.get_ydata(), 161.0)
    # A sensor that has been silent for longer than a second.
    telemetry["tip_cause"] = 0
    telemetry["tip_measured_ns"] = telemetry["release_ns"].min() - 2_000_000_000
    assert plot.error(telemetry).get_lines()[0].get_label() == words
    plt.close("all")


def test_stray_tips_are_no_measured_error(recording: Path) -> None:
    telemetry = cdcr.read(recording)["telemetry"].copy()
    telemetry["tip_measured_ns"] = telemetry["release_ns"]
    telemetry["tip_measured_m"] = telemetry["reference"]["position_m"] + [0.0, 0.001, 0.0]
    telemetry["measurement_jump_limit"] = 3
    tracked = np.flatnonzero(np.isfinite(telemetry["position_error_m"]))
    strays = tracked[len(tracked) // 2 :][[0, 1, 3, 7]]
    telemetry["tip_cause"][strays] = [3, 3, 1, 3]
    telemetry["tip_measured_m"][strays] += 0.3
    drawn, measured = plot.error(telemetry).get_lines()
    assert drawn.get_label() == "estimated" and np.allclose(measured.get_ydata(), 1.0)
    # As many in a row as the daemon takes for a wrong sensor.
    telemetry["tip_cause"][strays[1] + 1] = 4
    drawn, measured = plot.error(telemetry).get_lines()
    assert "by the model" in drawn.get_label() and np.max(measured.get_ydata()) > 300.0
    plt.close("all")


def test_each_figure_is_drawn_of_each_source(recording: Path) -> None:
    robot = cdcr.Robot()
    daemon = Daemon()
    try:
        with daemon.connect() as connection:
            live = connection
            found = cdcr.read(recording)
            sources = [found, found["telemetry"], cdcr.simulate(robot, cdcr.Trajectory.spiral(robot), duration_s=0.5), live]
            for source in sources:
                points = len(source) if isinstance(source, cdcr.Simulation) else len(found["telemetry"])
                line = plot.error(source, seconds=0.3).get_lines()[0]
                assert len(line.get_xdata()) > 10 and (source is live or len(line.get_xdata()) == points)
                path = plot.path(source, seconds=0.3)
                assert len(path.get_lines()) == plot.SHAPES + 2
                assert overlapping_numbers(path) == []
                histogram = plot.timing(source, seconds=0.3)
                _, labels = histogram.get_legend_handles_labels()
                assert labels == ([] if isinstance(source, cdcr.Simulation) else ["deadline, 5000 µs"])
                assert sum(bar.get_height() for bar in histogram.patches) > 10 and "µs" in histogram.get_title()
                plt.close("all")
    finally:
        daemon.end()
    with pytest.raises(cdcr.ArgumentError, match="no records"):
        plot.error({})
    nothing = cdcr.simulate(robot, cdcr.Trajectory.spiral(robot), duration_s=0)
    for wrong in (nothing, None, [1, 2], np.zeros(3), np.zeros(3, cdcr.dtype("Status")), {"telemetry": 1}):
        with pytest.raises(cdcr.ArgumentError, match="cannot be drawn|no periods") as refused:
            plot.timing(wrong)
        assert refused.value.remedy
