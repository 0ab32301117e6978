"""Drivers in Python with a real daemon."""

import contextlib
import os
import signal
import threading
import time

import numpy as np
import pytest

import cdcr
from conftest import TIMEOUT_S, Daemon, curve, eventually, mode


@pytest.mark.parametrize("interface", ["velocity", "position"])
def test_a_driver_moves_its_robot_along_a_reference(interface: str) -> None:
    """A robot in numpy that is equal to its model."""
    daemon = Daemon("--set", "link.kind=driver", "--set", f"link.interface={interface}", "--set", "link.measurement_timeout_ms=2000")
    try:
        with daemon.connect() as connection, connection.driver(interface) as driver:
            robot = driver.robot
            lengths = robot.cables(np.zeros(6))
            over = threading.Event()

            def loop() -> None:
                nonlocal lengths
                last = time.monotonic()
                while not over.is_set():
                    now = time.monotonic()
                    if interface == "velocity":
                        lengths = lengths + (now - last) * driver.cable_speeds()
                    else:
                        goal = driver.cable_lengths()
                        lengths = lengths if goal is None else goal
                    last = now
                    driver.send(cable_length=lengths)
                    time.sleep(0.002)

            with pytest.raises(cdcr.ArgumentError):
                driver.send(cable_length=lengths[:3])
            with pytest.raises(cdcr.ArgumentError, match="one at a time|more than one"):
                driver.send(cable_length=lengths, bend=np.zeros(6))
            assert (driver.cable_speeds() == 0).all() and driver.cable_lengths() is None
            thread = threading.Thread(target=loop)
            thread.start()
            try:
                command = driver.next_command(TIMEOUT_S)
                assert command is not None and command["interface"].name.lower() == interface
                eventually(lambda: mode(connection) is cdcr.Mode.HOLDING)
                t, xyz = curve(robot, 2.0)
                # On a stalled machine this driver is late: then the feed is repeated.
                for attempt in range(5):
                    try:
                        with connection.feed(t, xyz) as feed:
                            assert feed.wait().played
                        break
                    except cdcr.Error:
                        if mode(connection) in {cdcr.Mode.FAULTED, cdcr.Mode.STOPPED}:
                            connection.reset()
                        if attempt == 4:
                            raise
                reached = robot.forward(robot.bend_from_cables(lengths))
                assert np.linalg.norm(reached - xyz[-1]) < 0.02
                # Commands that expired in a stall were rejected; this one is accepted.
                refusals = driver.refusals()
                assert refusals < driver.next_command(TIMEOUT_S)["header"]["sequence"]
            finally:
                over.set()
                thread.join()
    finally:
        daemon.end()


def test_a_driver_that_forgets_rests_until_the_next_command() -> None:
    daemon = Daemon("--set", "link.kind=driver", "--set", "link.interface=position", "--set", "link.measurement_timeout_ms=2000")
    try:
        with daemon.connect() as connection, connection.driver("position") as driver:

            def follows() -> bool:
                driver.send(cable_length=driver.robot.cables(np.zeros(6)))
                if mode(connection) is cdcr.Mode.FAULTED:
                    connection.reset()
                return driver.cable_lengths() is not None

            eventually(follows)
            # No command arrives meanwhile.
            daemon.process.send_signal(signal.SIGSTOP)
            os.waitpid(daemon.process.pid, os.WUNTRACED)
            assert driver.cable_lengths() is not None
            driver.forget()
            assert driver.cable_lengths() is None and (driver.cable_speeds() == 0).all()
            daemon.process.send_signal(signal.SIGCONT)
            eventually(follows)
    finally:
        daemon.end()


def test_a_driver_that_is_started_again_and_states_where_its_motors_stand_moves_no_drooping_robot() -> None:
    """A shape sensor measures the robot beside its motors."""
    daemon = Daemon("--set", "link.kind=driver", "--set", "link.interface=position", "--set", "link.measurement_timeout_ms=1000")
    try:
        with daemon.connect() as connection:
            robot = cdcr.Robot()
            droop = np.array([0, 0, 0, 0, 0.08, 0])
            motors = robot.cables(np.array([0.5, 0.2, 0, 0.3, 0, 0]))

            def turn(driver: cdcr.Driver) -> bool:
                """Whether they follow."""
                nonlocal motors
                goal = driver.cable_lengths()
                motors = motors if goal is None else goal
                driver.send(bend=robot.bend_from_cables(motors) + droop)
                time.sleep(0.005)
                return goal is not None

            def start(driver: cdcr.Driver) -> None:
                def follows() -> bool:
                    if not turn(driver) and connection.status()["mode"] is cdcr.Mode.FAULTED:
                        # Refused until a measurement of this driver was accepted.
                        with contextlib.suppress(cdcr.RequestError):
                            connection.reset(accept_pose=True)
                    return driver.cable_lengths() is not None

                eventually(follows)
                for _ in range(50):
                    turn(driver)

            def move(driver: cdcr.Driver) -> None:
                begin = motors
                connection.home()
                eventually(lambda: turn(driver) and abs(motors - begin).max() > 0.001)
                connection.hold()
                for _ in range(50):
                    turn(driver)

            with connection.driver("position") as driver:
                start(driver)
                move(driver)
            stood = motors
            with connection.driver("position") as driver:
                with pytest.raises(cdcr.ArgumentError, match="cable_length"):
                    driver.stand_at(stood[:3])
                for wrong in (np.full(9, np.nan), 1e3 * stood, np.zeros(9), stood + 0.01):
                    with pytest.raises(cdcr.ArgumentError):
                        driver.stand_at(wrong)
                driver.stand_at(stood)
                start(driver)
                assert abs(motors - stood).max() < 1e-9
                with pytest.raises(cdcr.ArgumentError, match="obeys a command already") as late:
                    driver.stand_at(stood)
                assert late.value.remedy
                move(driver)
            # Without it they go to where the robot is measured, and the robot by as much.
            stood = motors
            with connection.driver("position") as driver:
                start(driver)
                assert abs(robot.bend_from_cables(motors) - robot.bend_from_cables(stood) - droop).max() < 0.01
    finally:
        daemon.end()


def test_a_reset_where_the_last_command_did_not_leave_the_robot_has_to_accept_the_pose() -> None:
    """The robot is moved by hand while it is stopped."""
    daemon = Daemon("--set", "link.kind=driver", "--set", "link.measurement_timeout_ms=2000")
    try:
        with daemon.connect() as connection, connection.driver("velocity") as driver:
            bend = np.zeros(6)

            def status_of(key: str) -> object:
                driver.send(bend=bend)
                return connection.status()[key]

            eventually(lambda: status_of("mode") is cdcr.Mode.HOLDING)
            connection.stop()
            bend[2] = 0.5
            eventually(lambda: status_of("reset_refused_by") is cdcr.Reason.POSE_DIFFERS)
            with pytest.raises(cdcr.RequestError, match="section 2 by 0.50 rad") as refused:
                connection.reset()
            assert "accept" in (refused.value.remedy or "")
            assert refused.value.section == 2
            assert refused.value.distance_rad == pytest.approx(0.5, abs=0.01)
            connection.reset(accept_pose=True)
            eventually(lambda: status_of("mode") is cdcr.Mode.HOLDING)
    finally:
        daemon.end()


def test_commands_that_a_driver_must_not_follow_are_refused_and_counted() -> None:
    """The second driver has a position interface, and the daemon commands speeds."""
    daemon = Daemon("--set", "link.kind=driver", "--set", "link.interface=velocity")
    try:
        with daemon.connect() as connection, connection.driver("velocity") as right, connection.driver("position") as wrong:

            def commanded() -> bool:
                # A measurement that a stall made stale is rejected; the next one may be accepted.
                right.send(cable_length=right.robot.cables(np.zeros(6)))
                return right.next_command(0.1) is not None

            eventually(commanded)
            assert wrong.next_command(0.0) is None and wrong.cable_lengths() is None
            eventually(lambda: wrong.cable_lengths() is not None or wrong.refusals() > 0)
            assert wrong.cable_lengths() is None and (wrong.cable_speeds() == 0).all()
            # A command that a stall made late is refused, too.
            assert "set link.interface" in (wrong.last_refusal() or "") and "link.interface" not in (right.last_refusal() or "")
    finally:
        daemon.end()


def test_refused_measurements_are_counted_by_their_cause() -> None:
    """Millimetres: there is no command, and so no refused one."""
    daemon = Daemon("--set", "link.kind=driver")
    try:
        with daemon.connect() as connection, connection.driver() as driver:
            driver.send(cable_length=1e3 * driver.robot.cables(np.zeros(6)))
            eventually(lambda: connection.status()["outcomes"][cdcr.Outcome.CABLE_MEAN] > 0)
            assert driver.next_command(0.1) is None and driver.last_refusal() is None
    finally:
        daemon.end()
