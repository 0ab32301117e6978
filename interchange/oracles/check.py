"""Reads the samples in a folder with rosbags and mcap-ros2-support, and compares what they hold, and their type hashes.

    python3 check.py FOLDER
"""

import json
import math
import sys
from pathlib import Path

from mcap_ros2._dynamic import generate_dynamic
from rosbags.typesys import Stores, get_types_from_msg, get_typestore


def plain(value):
    """Arrays as lists, messages as dictionaries."""
    if isinstance(value, (str, bool, int, float)):
        return value
    if isinstance(value, (bytes, list, tuple)) or hasattr(value, "tolist"):
        return [plain(element) for element in (value.tolist() if hasattr(value, "tolist") else value)]
    names = getattr(value, "__slots__", None) or value.__dataclass_fields__
    return {name: plain(getattr(value, name)) for name in names if name != "__msgtype__"}


def differs(expected, found, place):
    """Where two values differ first, or None."""
    if isinstance(expected, dict) and isinstance(found, dict):
        if set(expected) != set(found):
            return f"{place}: {set(expected) ^ set(found)}"
        parts = [(expected[name], found[name], f"{place}.{name}") for name in expected]
    elif isinstance(expected, list) and isinstance(found, list):
        if len(expected) != len(found):
            return f"{place}: {len(expected)} and {len(found)} elements"
        parts = [(a, b, f"{place}[{i}]") for i, (a, b) in enumerate(zip(expected, found))]
    else:
        if isinstance(expected, str) and isinstance(found, (int, float)):
            expected = float(expected) if isinstance(found, float) else int(expected)
        same = expected == found and math.copysign(1, expected) == math.copysign(1, found) if isinstance(
            found, float) else expected == found
        both_nan = isinstance(found, float) and math.isnan(found) and math.isnan(expected)
        return None if same or both_nan else f"{place}: {expected!r} and {found!r}"
    return next((d for d in (differs(*part) for part in parts) if d), None)


def main(folder):
    bad = count = 0
    known = get_typestore(Stores.ROS2_JAZZY)
    for path in sorted(folder.glob("*.msg")):
        name = path.stem.replace(".", "/")
        text, content = path.read_text(), path.with_suffix(".cdr").read_bytes()
        expected = json.loads(path.with_suffix(".json").read_text())
        store = get_typestore(Stores.EMPTY)
        store.register(get_types_from_msg(text, name))
        # Of a standard message, the definition that others have.
        hashes = [store.hash_rihs01(name)] + ([known.hash_rihs01(name)] if name in known.types else [])
        decoder = generate_dynamic(name.replace("/msg/", "/"), text)[name.replace("/msg/", "/")]
        ours = path.with_suffix(".hash").read_text()
        found = [
            differs(expected, plain(store.deserialize_cdr(content, name)), "rosbags"),
            differs(expected, plain(decoder(content)), "mcap-ros2-support"),
            *[f"hash {other}, not {ours}" for other in hashes if other != ours],
        ]
        for line in filter(None, found):
            print(f"{name}: {line}")
            bad += 1
        count += 1
    print(f"{count} messages, {bad} differences")
    sys.exit(bad > 0 or count == 0)


main(Path(sys.argv[1]))
