"""Reads a recording with mcap, mcap-ros2-support and rosbags, and compares cycles with the table that cdcrctl made of it.

    python3 check_recording.py FILE.mcap telemetry.csv
"""

import csv
import struct
import sys
from pathlib import Path

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader


def bits(number):
    """Of every NaN the same."""
    return "nan" if number != number else struct.pack("<d", number)


def row(message):
    return (message.cycle, bits(message.bend_rad[0]), bits(message.clearance_m), bits(message.position_error_m))


def main(path, table):
    with open(table, newline="") as file:
        names = "bend_rad[0]", "clearance_m", "position_error_m"
        expected = [(int(r["cycle"]), *(bits(float(r[name])) for name in names)) for r in csv.DictReader(file)]
    with open(path, "rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        decoded = list(reader.iter_decoded_messages())
        by_mcap = [row(message) for schema, _, _, message in decoded if schema.name == "cdcr_msgs/msg/Telemetry"]
        attached = {attachment.name for attachment in reader.iter_attachments()}
        schemas = {schema.name for schema, _, _, _ in decoded}
        about = next(m.metadata for m in reader.iter_metadata() if m.name == "cdcr")
        count = reader.get_summary().statistics.message_count
    with AnyReader([path]) as reader:
        messages = [(reader.deserialize(raw, c.msgtype), c.msgtype) for c, _, raw in reader.messages()]
    by_rosbags = [row(message) for message, name in messages if name == "cdcr_msgs/msg/Telemetry"]
    found = {
        "mcap finds other cycles": sorted(by_mcap) == sorted(expected),
        "rosbags finds other cycles": sorted(by_rosbags) == sorted(expected),
        "the index counts other messages": count == len(decoded) == len(messages),
        "an attachment is missing": attached >= {"settings.toml", "status.json"},
        "a message for viewers is missing": schemas >= {
            "tf2_msgs/msg/TFMessage", "geometry_msgs/msg/PoseStamped", "sensor_msgs/msg/JointState",
            "visualization_msgs/msg/MarkerArray", "rcl_interfaces/msg/Log",
        },
        "the offset of its clock is missing": int(about["unix_minus_monotonic_ns"]) > 0,
        "no cycle": len(expected) > 0,
    }
    bad = [text for text, is_good in found.items() if not is_good]
    print(f"{len(expected)} cycles of a recording, {len(bad)} differences", *bad, sep="\n")
    sys.exit(bool(bad))


main(Path(sys.argv[1]), Path(sys.argv[2]))
