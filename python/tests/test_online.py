"""Requests and feeds in Python with a real daemon."""

import multiprocessing
import os
import signal
import sys
import threading
import time
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest

import cdcr
from cdcr._wire import EventKind, RequestKind
from conftest import TIMEOUT_S, Daemon, curve, eventually, mode, newest


def test_status_is_a_dictionary_and_the_robot_is_the_daemons(daemon: Daemon) -> None:
    with daemon.connect() as connection:
        status = connection.status()
        assert status["mode"] is cdcr.Mode.HOLDING and status["link"] is cdcr.RobotLink.SIMULATED
        assert status["robot_name"] == "cdcr" and status["process_id"] == daemon.process.pid
        assert status["period_ns"] == 5_000_000 and status["robot"]["sections"] == 3
        assert len(status["robot"]["section"]) == 6 and status["robot"]["section"][0]["length_m"] == 0.3
        assert connection.robot() == cdcr.Robot()


def test_a_reference_is_followed_and_the_with_ends_in_hold(daemon: Daemon) -> None:
    with daemon.connect() as connection:
        t, xyz = curve(connection.robot(), 1.5)
        with connection.feed(t, xyz, track=True) as feed:
            assert feed.tracking and mode(connection) is cdcr.Mode.TRACKING
            records = connection.telemetry(0.4)
            report = feed.wait()
            assert report.played and report.tracked and report.points == len(t) and report.chunks >= 3
            assert feed.wait() is not None and abs(feed.played_s - 1.5) < 1.0
        assert mode(connection) is cdcr.Mode.HOLDING
        assert records.dtype.names[:3] == ("header", "cycle", "release_ns") and records.dtype == cdcr.dtype("Telemetry")
        assert (np.diff(records["cycle"]) >= 1).all()
        used = records[records["mode"] == cdcr.Mode.TRACKING]
        # After a release lost to the machine, the robot is off its reference.
        assert np.median(used["position_error_m"]) < 1e-6 and (used["robot"]["sections"] == 3).all()
        tip = cdcr.Robot().forward(used["present_rad"][:, :6])
        assert np.abs(tip - used["tip_position_m"]).max() < 1e-12


def test_an_exception_in_the_with_ends_the_feed_and_comes_through(daemon: Daemon) -> None:
    with daemon.connect() as connection:
        t, xyz = curve(connection.robot(), 600.0)
        for enter in (lambda: connection.feed(t, xyz), connection.stream):
            with pytest.raises(ZeroDivisionError):
                with enter() as feeding:
                    if isinstance(feeding, cdcr.FeedStream):
                        feeding.send(feeding.now() + 1.0 + np.arange(60), xyz[:60])
                    eventually(lambda: mode(connection) is cdcr.Mode.TRACKING)
                    1 / 0
            assert mode(connection) is cdcr.Mode.HOLDING
            # The lease is free again.
            with connection.feed(t, xyz, track=False):
                pass


def test_a_second_client_does_not_get_the_lease(daemon: Daemon) -> None:
    with daemon.connect() as one, daemon.connect() as other:
        t, xyz = curve(one.robot(), 600.0)
        with one.feed(t, xyz):
            for enter in (other.feed(t, xyz), other.stream()):
                with pytest.raises(cdcr.RequestError, match="another client holds the reference lease") as refused:
                    enter.__enter__()
                assert "other client" in refused.value.remedy
            assert mode(one) is cdcr.Mode.TRACKING


def test_requests_are_carried_out_or_refused_with_a_remedy(daemon: Daemon) -> None:
    with daemon.connect() as connection:
        with pytest.raises(cdcr.RequestError, match="no client feeds a reference") as refused:
            connection.track()
        assert isinstance(refused.value, cdcr.Error)
        remedy = refused.value.remedy
        assert remedy and remedy not in str(refused.value)
        if sys.version_info >= (3, 11):
            assert refused.value.__notes__ == [remedy]
        connection.home()
        connection.stop()
        assert mode(connection) is cdcr.Mode.STOPPED
        with pytest.raises(cdcr.RequestError, match="the daemon is stopped"):
            connection.home()
        connection.reset()
        assert mode(connection) is cdcr.Mode.HOLDING
        connection.hold()
        connection.reset_statistics()


def test_settings_change_by_name_and_the_others_stay(daemon: Daemon) -> None:
    with daemon.connect() as connection:
        before = connection.settings()
        assert before == {**cdcr.default_settings(), "rate_weight": 0.0}
        connection.change_settings(horizon_steps=4, solver="gauss-newton", safe_distance_m=0.02)
        assert connection.settings() == {**before, "horizon_steps": 4, "solver": "gauss-newton", "safe_distance_m": 0.02}
        connection.change_settings()
        connection.change_settings(budget_ms=1.5)
        assert connection.telemetry(0.5)[-1]["settings"]["budget_ns"] == 1_500_000
        assert connection.settings()["horizon_steps"] == 4
        with pytest.raises(cdcr.RequestError, match="budget_ms = 50 is longer than the period of the daemon"):
            connection.change_settings(budget_ms=50)
        for wrong in [{"budget_ms": -1.0}, {"budget_ms": np.nan}, {"horizon_steps": 51}, {"horizn": 1}, {"solver": "best"}, {"damping": np.nan}]:
            with pytest.raises(cdcr.ArgumentError):
                connection.change_settings(**wrong)
        # Less than the configured distance, which only the daemon knows.
        with pytest.raises(cdcr.RequestError, match="safe_distance_m = 0.001 is below the configured 0.01: use at least that"):
            connection.change_settings(safe_distance_m=0.001)
        assert connection.settings()["horizon_steps"] == 4


def test_a_safe_distance_above_the_clearance_is_warned_of(daemon: Daemon) -> None:
    with daemon.connect() as connection:
        tip = connection.status()["tip_position_m"]
        connection.set_obstacles({1: cdcr.Obstacle.sphere([tip[0] + 0.1, tip[1], tip[2]], 0.02)})
        eventually(lambda: connection.status()["clearance_m"] < 1.0)
        distance = connection.settings()["safe_distance_m"]
        try:
            with pytest.warns(UserWarning, match="is more than the present clearance of 0.0"):
                connection.change_settings(safe_distance_m=0.5)
        finally:
            connection.change_settings(safe_distance_m=distance)
            connection.clear_obstacles()


def test_a_rate_weight_that_is_auto_is_the_number_of_the_robot() -> None:
    daemon = Daemon("--set", "link.simulated=laboratory")
    try:
        with daemon.connect() as connection:
            assert connection.settings()["rate_weight"] == 1e-10
            connection.change_settings(rate_weight=1e-3)
            connection.change_settings(rate_weight="auto")
            assert connection.settings()["rate_weight"] == 1e-10
    finally:
        daemon.end()


def test_obstacles_are_seen_until_they_are_removed(daemon: Daemon) -> None:
    with daemon.connect() as connection:
        ball = cdcr.Obstacle.sphere([0.5, 0, 0.5], 0.05, velocity_m_s=[0, 0.01, 0])
        pole = cdcr.Obstacle.capsule([0.6, 0, 0], [0.6, 0, 1], 0.02)
        connection.set_obstacles({7: ball, 9: pole})
        record = newest(connection)
        known = record["obstacles"][: record["obstacle_count"]]
        assert known["id"].tolist() == [7, 9] and (known["start_m"][1] == [0.6, 0, 0]).all()
        assert abs(record["clearance_m"] - cdcr.Robot().clearance(np.zeros(6), [ball, pole])) < 0.01
        with pytest.raises(cdcr.RequestError, match="no obstacle 5, 8 was known") as refused:
            connection.remove_obstacles([8, 7, 5, 8])
        assert refused.value.remedy
        assert newest(connection)["obstacle_count"] == 1
        connection.clear_obstacles()
        assert newest(connection)["obstacle_count"] == 0
        millimetres = cdcr.Obstacle.sphere([500, 0, 500], 50)
        with pytest.raises(cdcr.ArgumentError, match="obstacle 3 is .* are these millimetres?"):
            connection.set_obstacles({1: ball, 3: millimetres})
        assert newest(connection)["obstacle_count"] == 0
        connection.set_obstacles({3: millimetres}, far=True)
        many = MappingProxyType({number: ball for number in range(64)})
        connection.set_obstacles(many)
        with pytest.raises(cdcr.RequestError, match="full"):
            connection.set_obstacles({64: ball})


def test_live_gives_every_record_and_incidents_what_was_bad(daemon: Daemon) -> None:
    with daemon.connect() as connection:
        batches = [batch for _, batch in zip(range(4), connection.live(0.1))]
        sequences = np.concatenate(batches)["header"]["sequence"]
        assert (np.diff(sequences) == 1).all() or connection.lost_records() > 0
        daemon.process.send_signal(signal.SIGSTOP)
        time.sleep(0.1)
        daemon.process.send_signal(signal.SIGCONT)
        eventually(lambda: len(connection.incidents()) > 0)
        assert connection.incidents().dtype == cdcr.dtype("Incident")


def test_points_can_be_sent_as_they_come_and_what_is_refused_is_reported(daemon: Daemon) -> None:
    with daemon.connect() as connection:
        robot = connection.robot()
        with connection.stream() as stream:
            stream.send(stream.now() + 1.0 + np.arange(400) * 0.005, curve(robot, 1.995)[1])
            eventually(lambda: stream.accepted_chunks == 4)
            eventually(lambda: mode(connection) is cdcr.Mode.TRACKING)
            assert stream.sent_chunks == 4
        assert mode(connection) is cdcr.Mode.HOLDING
        for points, words in [(([1e-9], [[0, 0, 0.9]]), "past"), (([10.0], [[0, 0, 5.0]]), "reachable")]:
            with pytest.raises(cdcr.FeedError, match=words) as refused:
                with connection.stream() as stream:
                    time.sleep(0.05)
                    while True:
                        stream.send(*points)
                        time.sleep(0.02)
            assert refused.value.remedy and refused.value.remedy not in str(refused.value)
        assert "positions are in m" in refused.value.remedy
        with connection.stream(track=False) as stream:
            for t, xyz in [(1.0, [0, 0]), ([1.0, 2.0], [[0, 0, 1]]), ([-1.0], [[0, 0, 1]]), (np.nan, [0, 0, 1])]:
                with pytest.raises(cdcr.ArgumentError):
                    stream.send(t, xyz)
        with pytest.raises(cdcr.FeedError, match="not open"):
            stream.send(1.0, [0, 0, 1])


def test_points_of_a_stream_wait_while_the_daemon_is_held_up(daemon: Daemon) -> None:
    """Far more chunks than the daemon's queue holds: 100 single points."""
    with daemon.connect() as connection:
        xyz = curve(connection.robot(), 1.0)[1][:100]
        with connection.stream(track=False) as stream:
            times = stream.now() + 30 + np.arange(100) * 0.005
            daemon.process.send_signal(signal.SIGSTOP)
            try:
                for time_s, point in zip(times, xyz):
                    stream.send(time_s, point)
                    time.sleep(0.005)
            finally:
                daemon.process.send_signal(signal.SIGCONT)
            # The points that waited meanwhile share chunks.
            eventually(lambda: 4 <= stream.accepted_chunks == stream.sent_chunks < 32)
            eventually(lambda: connection.status()["reference_points"] == 100)


def test_points_that_come_at_once_share_chunks(daemon: Daemon) -> None:
    """As single chunks, they would fill the number allowed under way, and the rest would wait for events of the daemon."""
    with daemon.connect() as connection:
        xyz = curve(connection.robot(), 1.0)[1]
        with connection.stream(track=False) as stream:
            daemon.process.send_signal(signal.SIGSTOP)
            try:
                for k in range(40):
                    stream.send(30 + 0.005 * k, xyz[k])
                time.sleep(0.1)
                assert 1 <= stream.sent_chunks < 12
            finally:
                daemon.process.send_signal(signal.SIGCONT)
            eventually(lambda: connection.status()["reference_points"] == 40)


def test_a_stream_whose_chunks_are_accepted_does_not_renew_its_lease_by_requests(daemon: Daemon) -> None:
    """A request blocks until its answer, and the points with it."""
    with daemon.connect() as connection:
        xyz = curve(connection.robot(), 1.0)[1]
        watch = connection.live(0.02)

        def renewals() -> int:
            with connection.stream(track=False) as stream:
                records = []
                for k in range(80):
                    stream.send(30 + 0.02 * k, xyz[k])
                    records.append(next(watch))
                # Then no chunk is accepted for longer than the lease lasts, and the lease is kept.
                time.sleep(1.5)
                stream.send(60, xyz[80])
                eventually(lambda: stream.accepted_chunks == stream.sent_chunks)
            used = [event for row in np.concatenate(records) for event in row["events"][: row["event_count"]]]
            assert sum(event["kind"] == EventKind.REFERENCE for event in used) > 20
            return sum(event["kind"] == EventKind.REQUEST and event["detail"] == RequestKind.ACQUIRE_LEASE for event in used)

        # One request at the begin; by time alone there would be 15. A stalled machine causes some: repeated.
        assert any(renewals() < 6 for _ in range(3))


def test_closing_twice_has_no_effect_and_use_after_it_is_refused(daemon: Daemon) -> None:
    connection = daemon.connect()
    connection.close()
    connection.close()
    with pytest.raises(cdcr.LinkError, match="closed"):
        connection.status()
    for wrong in [{"timeout_s": -1.0}, {"timeout_s": float("nan")}]:
        with pytest.raises(cdcr.ArgumentError):
            daemon.connect(**wrong)
    with pytest.raises(cdcr.ConnectError, match="letters"):
        cdcr.connect("a/b", root=daemon.root, prefix="cdcr_python_")


def test_any_thread_may_ask_while_another_waits(daemon: Daemon) -> None:
    with daemon.connect() as connection:
        found: list[int] = []
        threads = [threading.Thread(target=lambda: found.append(connection.status()["process_id"])) for _ in range(8)]
        waiting = threading.Thread(target=lambda: found.append(len(connection.telemetry(0.5))))
        waiting.start()
        for thread in threads:
            thread.start()
        for thread in [*threads, waiting]:
            thread.join()
        assert found.count(daemon.process.pid) == 8 and len(found) == 9


def child(root: Path, answer) -> None:
    with cdcr.connect("cdcr", root=root, prefix="cdcr_python_", timeout_s=TIMEOUT_S) as connection:
        answer.put(connection.status()["process_id"])


def test_a_forked_process_is_refused_and_a_spawned_one_works(daemon: Daemon) -> None:
    with daemon.connect() as connection:
        t, xyz = curve(connection.robot(), 600.0)
        read, write = os.pipe()
        with connection.feed(t, xyz, track=False) as feed:
            process = os.fork()
            if process == 0:
                reported = []
                for attempt in (connection.status, daemon.connect, feed.wait, connection.stop):
                    try:
                        attempt()
                        reported.append("nothing")
                    except cdcr.LinkError as error:
                        reported.append(f"{error} {error.remedy}")
                del connection, feed
                os.write(write, "\n".join(reported).encode())
                os._exit(0)
            os.waitpid(process, 0)
        lines = os.read(read, 10_000).decode().splitlines()
        assert len(lines) == 4 and all("forked" in line and "spawn" in line for line in lines), lines
        assert connection.status()["process_id"] == daemon.process.pid
        context = multiprocessing.get_context("spawn")
        answer = context.Queue()
        spawned = context.Process(target=child, args=(daemon.root, answer))
        spawned.start()
        assert answer.get(timeout=TIMEOUT_S) == daemon.process.pid
        spawned.join()


def test_a_removal_that_ends_the_wait_for_a_silent_source_is_no_error() -> None:
    """All that it sent has expired: the newest counts."""
    daemon = Daemon("--set", "obstacles.source_timeout_ms=1500")
    try:
        with daemon.connect() as connection, daemon.connect() as source:
            source.set_obstacles({7: cdcr.Obstacle.sphere([0.5, 0, 0.5], 0.05)}, lifetime_s=0.5)
            time.sleep(0.6)
            source.set_obstacles({})
            eventually(lambda: newest(connection)["obstacle_count"] == 0)
            eventually(lambda: connection.status()["silent_obstacle_source"] != 0)
            with pytest.raises(cdcr.RequestError, match="no obstacle 8 was known"):
                connection.remove_obstacles([8])
            assert connection.status()["silent_obstacle_source"] != 0
            connection.remove_obstacles([7])
            assert connection.status()["silent_obstacle_source"] == 0
            with pytest.raises(cdcr.RequestError, match="no obstacle 7 was known"):
                connection.remove_obstacles([7])
    finally:
        daemon.end()


def test_nothing_is_printed(daemon: Daemon) -> None:
    text = "import cdcr\nwith cdcr.connect() as c: c.telemetry(0.1); c.set_obstacles({1: cdcr.Obstacle.sphere([1, 0, 0], 0.1)})"
    ran = daemon.run(sys.executable, "-c", "import time; time.sleep(0.5)\n" + text.replace("connect()", f"connect(timeout_s={TIMEOUT_S})"))
    assert (ran.returncode, ran.stdout, ran.stderr) == (0, "", "")
