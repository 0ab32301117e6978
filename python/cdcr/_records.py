"""Messages as dictionaries."""

from functools import lru_cache
from typing import Any

import numpy as np

from . import _cdcr, _wire
from ._errors import ArgumentError


@lru_cache
def _codes() -> dict[tuple[str, ...], dict[str, type[_wire.Code]]]:
    """By the names of a message's fields: which of them hold codes, and of which enumeration."""
    found = {}
    for name in _cdcr.messages():
        fields = _cdcr.fields(name)
        codes = {field: getattr(_wire, code) for field, _, code, _ in fields if code}
        found[tuple(field for field, *_ in fields)] = codes
    return found


def message(record: np.void) -> dict[str, Any]:
    """A row of a structured array as a dictionary: nested messages too, codes as members of their enumerations, texts as str."""
    if not isinstance(record, np.void):
        raise ArgumentError(f"{type(record).__name__} is not a row of a structured array", "Give one row, such as records[0].")
    names = record.dtype.names or ()
    codes = _codes().get(names, {})
    return {name: _value(record[name], codes.get(name)) for name in names}


def _value(value: Any, codes: type[_wire.Code] | None) -> Any:
    if isinstance(value, np.void):
        return message(value)
    if isinstance(value, np.ndarray):
        return [message(part) for part in value] if value.dtype.names else value.copy()
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    if codes is not None:
        number = int(value)
        return codes(number) if number in codes._value2member_map_ else number
    return value.item()
