"""Exceptions of this package. What was wrong is the message; what to do about it is `.remedy`."""

import sys


class Error(Exception):
    """Any error of this package."""

    remedy: str
    """What to do about it, in a sentence."""

    def __init__(self, message: str, remedy: str = "") -> None:
        super().__init__(message)
        self.remedy = remedy
        # Shown below the message where nobody catches the error.
        if remedy and sys.version_info >= (3, 11):
            self.add_note(remedy)


class ArgumentError(Error, ValueError):
    """An argument has the wrong shape or kind, or a value outside its range."""


class ConnectError(Error, ConnectionError):
    """No connection to a daemon could be made."""


class LinkError(Error, ConnectionError):
    """An open connection carried nothing, or the daemon is silent."""


class RequestError(Error):
    """The daemon refused a request, or did not answer."""

    section: int = 0
    """Of a reset that has to accept the pose: the section measured farthest from where the last command left it, 1 next to the base; otherwise 0."""
    distance_rad: float = 0.0
    """How far [rad]."""


class FeedError(Error):
    """A reference was not followed to its end."""


class RecordingError(Error, OSError):
    """A recording cannot be read."""
