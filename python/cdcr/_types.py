"""Types that the signatures of this package use."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._wire import Settings
from ._words import Form, Interface, Interpolation, Plant, Sensor

if TYPE_CHECKING:
    # Of the standard library from Python 3.11 on.
    from typing_extensions import Unpack

__all__ = [
    "Any",
    "ArrayLike",
    "Doubles",
    "Form",
    "Interface",
    "Interpolation",
    "Mapping",
    "Message",
    "Plant",
    "Records",
    "Sensor",
    "Sequence",
    "Settings",
    "np",
]

if TYPE_CHECKING:
    __all__ += ["Unpack"]

Doubles: TypeAlias = NDArray[np.float64]
"""An array of doubles."""
Records: TypeAlias = NDArray[np.void]
"""A structured array: a row for each message, a field for each of its fields."""
Message: TypeAlias = dict[str, Any]
"""A message as a dictionary: its fields by name, codes as members of their enumerations, texts as str."""
