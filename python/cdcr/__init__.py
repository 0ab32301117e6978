"""Real-time control of cable-driven continuum robots, from Python.

Offline: Robot (kinematics), Nmpc (the solver), simulate() (a closed loop), Trajectory.
Online: connect() to a running daemon cdcrd, feed, watch, drive.
Recordings: read() an MCAP file, cdcr.plot.

SI units; the unit ends each name. Positions are in the base frame of the robot, its z along the straight robot. Errors are subclasses of
Error: what was wrong is the message, what to do about it `.remedy`. It installs no logger. docs/python.md of the project is the guide.
"""

# Arguments are searched for masked numbers: the first one of a feed must not wait until this is loaded, 24 ms on an idle machine.
import numpy.ma as _numpy_ma  # noqa: F401

from ._cdcr import (
    Connection,
    Driver,
    Feed,
    FeedReport,
    FeedStream,
    Live,
    Nmpc,
    Obstacle,
    Robot,
    Simulation,
    SolveReport,
    Trajectory,
    __version__,
    connect,
    default_settings,
    dtype,
    read,
    setting_texts,
    settings_from_toml,
    simulate,
)
from ._errors import ArgumentError, ConnectError, Error, FeedError, LinkError, RecordingError, RequestError
from ._records import message
from ._types import Doubles, Records
from ._wire import Interface, LateCause, MeasurementState, Mode, Outcome, Reason, RobotLink, Settings, SolverStatus

__all__ = [
    "ArgumentError",
    "ConnectError",
    "Connection",
    "Doubles",
    "Driver",
    "Error",
    "Feed",
    "FeedError",
    "FeedReport",
    "FeedStream",
    "Interface",
    "LateCause",
    "LinkError",
    "Live",
    "MeasurementState",
    "Mode",
    "Nmpc",
    "Obstacle",
    "Outcome",
    "Reason",
    "RecordingError",
    "Records",
    "RequestError",
    "Robot",
    "RobotLink",
    "Settings",
    "Simulation",
    "SolveReport",
    "SolverStatus",
    "Trajectory",
    "__version__",
    "connect",
    "default_settings",
    "dtype",
    "message",
    "read",
    "setting_texts",
    "settings_from_toml",
    "simulate",
]
