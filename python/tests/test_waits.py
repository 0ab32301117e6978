"""Waits: their duration, their end, and their errors after the end of a daemon."""

import ctypes
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import cdcr
from conftest import TIMEOUT_S, Daemon, curve, eventually, mode

NEVER = [float("nan"), float("inf"), -float("inf"), -1.0, -1e-9, 1e19, 1e300]
POINTS = [0.0, 600.0], [[0, 0, 0.9], [0, 0.1, 0.89]]


def test_a_time_that_none_can_wait_for_is_refused_everywhere(daemon: Daemon) -> None:
    robot = cdcr.Robot()
    nmpc, spiral, ball = cdcr.Nmpc(robot), cdcr.Trajectory.spiral(robot), cdcr.Obstacle.sphere([1, 0, 0], 0.1)
    with daemon.connect() as c, c.feed(*POINTS, track=False) as feed, c.driver() as driver:
        calls: dict[str, Callable[[float], object]] = {
            "connect": lambda time_s: daemon.connect(timeout_s=time_s),
            "status": c.status,
            "telemetry": c.telemetry,
            "live": c.live,
            "incidents": c.incidents,
            "lifetime_s": lambda time_s: c.set_obstacles({1: ball}, lifetime_s=time_s),
            "lead_s": lambda time_s: c.feed(*POINTS, lead_s=time_s),
            "lead_s of a trajectory": lambda time_s: c.feed_trajectory(spiral, lead_s=time_s),
            "wait": feed.wait,
            "next_command": driver.next_command,
            "budget_s": lambda time_s: nmpc.solve(np.zeros(6), [[0, 0, 0.9]], budget_s=time_s),
            "period_s": lambda time_s: cdcr.Nmpc(robot, period_s=time_s),
            "duration_s": lambda time_s: cdcr.simulate(robot, spiral, duration_s=time_s),
            "estimator": lambda time_s: cdcr.simulate(robot, spiral, estimator_time_constant_s=time_s),
        }
        for name, call in calls.items():
            for time_s in NEVER:
                with pytest.raises(cdcr.ArgumentError, match=r"_s|seconds") as refused:
                    call(time_s)
                assert refused.value.remedy and isinstance(refused.value, ValueError), name
        for time_s in NEVER[:3] + NEVER[5:]:
            with pytest.raises(cdcr.ArgumentError, match="dt_s"):
                ball.moved(time_s)
        # The longest allowed wait does not panic, either.
        assert feed.wait(0.0) is None and nmpc.solve(np.zeros(6), [[0, 0, 0.9]], budget_s=1e9)[2].status
        assert c.status(1e9)["process_id"] == daemon.process.pid
    with daemon.connect() as c, c.stream(track=False) as stream:
        for time_s in NEVER:
            with pytest.raises(cdcr.ArgumentError, match="t h"):
                stream.send(time_s, [0, 0, 0.9])


def test_what_has_not_begun_asks_for_with_and_what_has_ended_keeps_its_outcome(daemon: Daemon) -> None:
    with daemon.connect() as connection:
        t, xyz = curve(connection.robot(), 0.3)
        feed, stream = connection.feed(t, xyz), connection.stream()
        for too_early in (feed.wait, lambda: feed.wait(1.0), stream.now, lambda: stream.send(1.0, [0, 0, 0.9])):
            with pytest.raises(cdcr.FeedError, match="not begun|not open") as refused:
                too_early()
            assert "with" in refused.value.remedy
        with feed:
            first = feed.wait()
        assert first.played and feed.wait().points == first.points and feed.wait(0.0).chunks == first.chunks
        with pytest.raises(cdcr.FeedError, match="begun before"):
            feed.__enter__()
        with stream:
            with pytest.raises(cdcr.FeedError, match="begun before"):
                stream.__enter__()
            assert stream.now() >= 0
        # The error is kept.
        far = connection.feed([0, 1], [[0, 0, 5.0], [0, 0, 5.0]])
        for again in (far.__enter__, far.wait, lambda: far.wait(0.0)):
            with pytest.raises(cdcr.FeedError, match="reachable"):
                again()


def test_a_feed_may_be_asked_from_a_thread_while_another_waits(daemon: Daemon) -> None:
    with daemon.connect() as connection, connection.feed(*POINTS, track=False) as feed:
        waiting = threading.Thread(target=lambda: feed.wait(TIMEOUT_S))
        waiting.start()
        eventually(lambda: feed.played_s > 0)
        assert feed.wait(0.0) is None and waiting.is_alive()
        feed.__exit__()
        waiting.join()


def test_closing_while_another_thread_waits_ends_that_wait_by_an_error(daemon: Daemon) -> None:
    connection = daemon.connect()
    raised: list[BaseException] = []

    def watch() -> None:
        try:
            connection.telemetry(600)
        except cdcr.Error as error:
            raised.append(error)

    waiting = threading.Thread(target=watch)
    waiting.start()
    time.sleep(0.1)
    connection.close()
    waiting.join(TIMEOUT_S)
    assert len(raised) == 1 and "closed" in str(raised[0]) and isinstance(raised[0], cdcr.LinkError)


def test_a_closed_connection_moves_nothing(daemon: Daemon) -> None:
    """But a stop is not refused."""
    connection = daemon.connect()
    t, xyz = curve(connection.robot(), 60.0)
    running, early, late = connection.feed(t, xyz), connection.feed(t, xyz), connection.stream()
    running.__enter__()
    connection.close()
    assert not running.wait(TIMEOUT_S).played
    calls = [connection.__enter__, early.__enter__, late.__enter__, lambda: connection.feed(t, xyz), connection.stream]
    calls += [lambda: connection.feed_trajectory(cdcr.Trajectory.from_arrays(t, xyz)), connection.track, connection.driver]
    calls += [connection.live, connection.change_settings, lambda: connection.set_obstacles({}), connection.lost_records]
    for call in calls:
        with pytest.raises(cdcr.LinkError, match="the connection or driver is closed"):
            call()
    with daemon.connect() as other:
        assert mode(other) is cdcr.Mode.HOLDING
        with other.stream() as stream:
            stream.send(stream.now() + 0.3 + t[:400], xyz[:400])
            eventually(lambda: other.status()["mode"] is cdcr.Mode.TRACKING)
            other.close()
            with pytest.raises(cdcr.LinkError, match="closed"):
                stream.send(stream.now() + 5.0, xyz[0])
    connection.stop()
    with daemon.connect() as other:
        eventually(lambda: other.status()["mode"] is cdcr.Mode.STOPPED)


def test_a_close_waits_for_its_feeds(daemon: Daemon) -> None:
    """A daemon that does not answer delays their end."""
    connection = daemon.connect()
    t, xyz = curve(connection.robot(), 60.0)
    feed = connection.feed(t, xyz)
    feed.__enter__()
    daemon.process.send_signal(signal.SIGSTOP)
    os.waitpid(daemon.process.pid, os.WUNTRACED)
    try:
        connection.close()
        with pytest.raises(cdcr.Error):
            feed.wait(0.3)
    finally:
        daemon.process.send_signal(signal.SIGCONT)


def test_what_the_daemon_says_to_the_last_points_is_raised_by_leaving(daemon: Daemon) -> None:
    with daemon.connect() as connection:
        for track in (True, False):
            with pytest.raises(cdcr.FeedError, match="reachable"):
                with connection.stream(track=track) as stream:
                    stream.send(stream.now() + 1.0, [0, 0, 5.0])
            # Every point was sent, and an exception is not replaced.
            with connection.stream(track=track) as stream:
                begin_s = stream.now() + 2.0
                for k in range(40):
                    stream.send(begin_s + 0.02 * k, [0, 0, 0.89])
            assert stream.accepted_chunks == stream.sent_chunks > 0
            with pytest.raises(ZeroDivisionError):
                with connection.stream(track=track) as stream:
                    stream.send(stream.now() + 1.0, [0, 0, 5.0])
                    raise ZeroDivisionError


def ended(call: Callable[[], object]) -> None:
    """The error reports the end of the daemon, and has a remedy."""
    with pytest.raises(cdcr.LinkError, match="it has ended") as raised:
        call()
    assert "cdcrd run" in raised.value.remedy


def test_a_killed_daemon_is_reported_by_every_wait_and_the_next_one_is_found(daemon: Daemon) -> None:
    with daemon.connect() as connection:
        live = connection.live(0.01)
        assert len(next(live)) > 0
        daemon.kill()
        ended(lambda: connection.telemetry(0.1))
        ended(lambda: connection.telemetry(600))
        ended(lambda: [batch for batch in live])
        ended(connection.incidents)
        ended(connection.settings)
        eventually(lambda: pytest.raises(cdcr.LinkError, connection.status, 0.0))
        ended(lambda: connection.status(0.1))
        ended(connection.robot)
        with pytest.raises(cdcr.RequestError, match="it has ended") as refused:
            connection.hold()
        assert "cdcrd run" in refused.value.remedy
        with pytest.raises(cdcr.ConnectError, match="nothing was stopped: no daemon is running") as unstopped:
            connection.stop()
        assert "emergency stop" in unstopped.value.remedy and "cdcrd run" not in unstopped.value.remedy
        with pytest.raises(cdcr.ConnectError) as missing:
            daemon.connect(timeout_s=0.1)
        assert "cdcrd run" in str(missing.value) and isinstance(missing.value, ConnectionError)
        assert "it has ended" in str(missing.value)
        daemon.start()
        with daemon.connect() as fresh:
            assert fresh.status()["process_id"] == daemon.process.pid
        eventually(lambda: connection.status(TIMEOUT_S)["process_id"] == daemon.process.pid)
        eventually(lambda: len(connection.telemetry(0.05)) > 0)


def test_late_records_are_waited_for_while_commands_arrive(daemon: Daemon) -> None:
    """As on a machine that stalls: the thread that sends the records is stopped for longer than a second."""
    seize, interrupt, detach, wait_all = 0x4206, 0x4207, 17, 0x40000000
    ptrace = ctypes.CDLL(None).ptrace
    ptrace.argtypes = [ctypes.c_long, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p]
    threads = Path(f"/proc/{daemon.process.pid}/task").iterdir()
    reporter = next(int(thread.name) for thread in threads if (thread / "comm").read_text() == "cdcr-reporter\n")
    with daemon.connect() as connection, ThreadPoolExecutor() as pool:
        if ptrace(seize, reporter, None, None) != 0:
            pytest.skip("a single thread cannot be stopped here: kernel.yama.ptrace_scope")
        ptrace(interrupt, reporter, None, None)
        os.waitpid(reporter, wait_all)
        records = pool.submit(connection.telemetry, 4.0)
        time.sleep(2.5)
        ptrace(detach, reporter, None, None)
        assert len(records.result()) > 0


@pytest.mark.parametrize("what", ["feed", "stream"])
def test_a_daemon_that_is_killed_during_a_feed_has_ended_and_no_lease_is_to_blame(daemon: Daemon, what: str) -> None:
    with daemon.connect() as connection:
        t, xyz = curve(connection.robot(), 60.0)

        def feed() -> None:
            if what == "feed":
                with connection.feed(t, xyz) as feeding:
                    daemon.kill()
                    feeding.wait()
            else:
                with connection.stream() as feeding:
                    begin = feeding.now() + 0.3
                    daemon.kill()
                    for k in range(10**6):
                        feeding.send(begin + 0.005 * k, xyz[k % len(xyz)])
                        time.sleep(0.005)

        for _ in range(3):
            with pytest.raises(cdcr.LinkError, match="has ended") as raised:
                feed()
            assert "lease" not in str(raised.value) and "cdcrd run" in raised.value.remedy
            daemon.start()
            with daemon.connect():
                pass


def test_a_driver_hears_of_the_end_and_goes_on_with_the_next_daemon() -> None:
    daemon = Daemon("--set", "link.kind=driver")
    try:
        with daemon.connect() as connection, connection.driver() as driver:
            lengths = driver.robot.cables(np.zeros(6))

            def is_commanded() -> bool:
                # A measurement that a stall made stale is rejected; the next one may be accepted.
                driver.send(cable_length=lengths)
                try:
                    return driver.next_command(0.1) is not None
                except cdcr.LinkError:
                    return False

            # Without a measurement there is no command, although the daemon runs.
            assert driver.next_command(0.05) is None
            eventually(is_commanded)
            daemon.kill()
            # Pending commands have been taken or have expired.
            with pytest.raises(cdcr.LinkError, match="has ended"):
                while True:
                    driver.next_command(0.05)
            assert (driver.cable_speeds() == 0).all()
            daemon.start()
            with daemon.connect():
                pass

            eventually(is_commanded)
    finally:
        daemon.end()


WAITS = {
    "connect": "cdcr.connect('nobody', timeout_s=600)",
    "status": "c.status(600)",
    "telemetry": "c.telemetry(600)",
    "live": "[len(batch) for batch in c.live(600)]",
    "feed": "c.feed([0, 600], [[0, 0, .9], [0, 0.1, .89]], track=False).__enter__().wait()",
    "feed, at most": "c.feed([0, 600], [[0, 0, .9], [0, 0.1, .89]], track=False).__enter__().wait(600)",
    "with of a feed": "f = c.feed([0, 600], [[0, 0, .9], [0, 0.1, .89]], track=False)\n    with f: f.wait()",
    "driver": "c.driver('position').next_command(600)",
    "simulate": "cdcr.simulate(cdcr.Robot(), cdcr.Trajectory.from_arrays([0, 80000], [[0, 0, .9]] * 2), settings={'horizon_steps': 50})",
    # Consecutive waits, because each of them is short.
    "requests": "while True: c.hold()",
    "incidents": "while True: c.incidents(2)",
    "obstacles": "while True: c.clear_obstacles()",
    "settings": "while True: c.settings()",
}


@pytest.mark.parametrize("what", WAITS)
def test_ctrl_c_ends_every_wait(daemon: Daemon, what: str) -> None:
    text = f"import os, signal, cdcr\nsignal.signal(signal.SIGINT, signal.default_int_handler)\nwith cdcr.connect(timeout_s={TIMEOUT_S}) as c:\n    "
    if what == "status":
        # From a stopped daemon, whose last status is stale.
        text += f"os.kill({daemon.process.pid}, signal.SIGSTOP); __import__('time').sleep(1.5)\n    "
    text += f"print('waits', flush=True)\n    {WAITS[what]}"
    program = subprocess.Popen([sys.executable, "-c", text], env=daemon.environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert program.stdout.readline() == "waits\n"
        time.sleep(0.5)
        assert program.poll() is None, program.stderr.read()
        program.send_signal(signal.SIGINT)
        _, error = program.communicate(timeout=TIMEOUT_S)
    finally:
        program.kill()
        daemon.process.send_signal(signal.SIGCONT)
    assert "KeyboardInterrupt" in error and "panicked" not in error and program.returncode != 0
