"""Reads a recording with `mcap` and `mcap-ros2-support`: python read_recording.py DRIVE.mcap [SENT.jsonl]

Every message must decode, and encode again to the bytes that were recorded. With SENT.jsonl (a line per message sent:
topic, log_time, publish_time, values by dotted name) counts, order, times and every value must be equal.
"""

import json
import math
import sys
from collections import Counter, defaultdict

from mcap.reader import make_reader
from mcap_ros2._dynamic import serialize_dynamic
from mcap_ros2.decoder import DecoderFactory


def is_message(value):
    return hasattr(value, "__slots__")


def flatten(message, prefix, out):
    """The values of a decoded message by dotted name, arrays of numbers as lists."""
    for name in message.__slots__:
        value = getattr(message, name)
        if is_message(value):
            flatten(value, f"{prefix}{name}.", out)
        elif isinstance(value, (list, tuple)) and value and is_message(value[0]):
            for index, item in enumerate(value):
                flatten(item, f"{prefix}{name}.{index}.", out)
        elif isinstance(value, (int, float, str, bool)):
            out[f"{prefix}{name}"] = value
        else:
            out[f"{prefix}{name}"] = list(value)
    return out


def main(recording, sent=None):
    counts = Counter()
    decoded = defaultdict(list)
    encoders = {}
    with open(recording, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        records = list(reader.iter_metadata())
        assert [record.name for record in records] == ["mirror.setup", "mirror"], records
        head, metadata = (record.metadata for record in records)
        json.loads(head.pop("setup"))
        assert head.items() <= metadata.items(), (head, metadata)
        for schema, channel, message, value in reader.iter_decoded_messages(log_time_order=False):
            assert schema.encoding == "ros2msg" and channel.message_encoding == "cdr"
            if schema.id not in encoders:
                text = schema.data.decode()
                encoders[schema.id] = serialize_dynamic(schema.name, text)[schema.name]
            assert encoders[schema.id](value) == message.data, f"{channel.topic}: other bytes"
            counts[channel.topic] += 1
            decoded[channel.topic].append((message, value))
        indexed = reader.get_summary()
    if indexed is not None:
        for channel_id, count in indexed.statistics.channel_message_counts.items():
            assert counts[indexed.channels[channel_id].topic] == count
    for topic, count in counts.items():
        if f"written {topic[1:]}" in metadata:
            assert count == int(metadata[f"written {topic[1:]}"]), topic
    for topic in sorted(counts):
        print(f"{counts[topic]:8} {topic}")
    if sent is not None:
        compare(decoded, sent)


def compare(decoded, sent):
    expected = defaultdict(list)
    with open(sent) as file:
        for line in file:
            line = json.loads(line)
            expected[line["topic"]].append(line)
    for topic, lines in expected.items():
        assert len(decoded[topic]) == len(lines), f"{topic}: {len(decoded[topic])} of {len(lines)}"
        for (message, value), line in zip(decoded[topic], lines):
            assert message.log_time == line["log_time"], topic
            assert message.publish_time == line["publish_time"], topic
            assert flatten(value, "", {}) == line["values"], topic
    scenes = expected["/world/scene"]
    transforms = decoded["/tf"]
    assert len(transforms) == len(scenes)
    for (_, value), line in zip(transforms, scenes):
        first = value.transforms[0]
        assert (first.header.frame_id, first.child_frame_id) == ("map", "base_link")
        assert first.transform.translation.x == line["values"]["ego.x_m"]
        rotation = first.transform.rotation
        heading = 2.0 * math.atan2(rotation.z, rotation.w)
        turns = (heading - line["values"]["ego.heading_rad"]) / math.tau
        assert abs(turns - round(turns)) < 1e-9
    for band, name in enumerate(["low", "mid", "high"]):
        scans = decoded[f"/viz/scan_{name}"]
        frames = expected["/world/lidar"]
        assert len(scans) == len(frames)
        for (_, scan), line in zip(scans, frames):
            ranges = line["values"]["range"][36 * band : 36 * band + 36]
            for got, normalised in zip(scan.ranges, ranges, strict=True):
                assert math.isinf(got) if normalised >= 1.0 else abs(got - 40.0 * normalised) < 1e-4
    (_, road), = decoded["/viz/road"]
    assert [len(marker.points) for marker in road.markers] == [10, 10, 10]
    ticks = [message.log_time for message, _ in decoded["/clock"]]
    assert ticks == sorted({message.log_time for message, _ in decoded["/world/lidar"]})
    for message, value in decoded["/clock"]:
        assert value.clock.sec * 10**9 + value.clock.nanosec == message.log_time
    for message, value in decoded["/viz/scan_low"]:
        stamp = value.header.stamp
        assert stamp.sec * 10**9 + stamp.nanosec == message.log_time
    total = sum(map(len, expected.values()))
    print(f"{total} messages of {len(expected)} topics equal what was sent")


if __name__ == "__main__":
    main(*sys.argv[1:])
