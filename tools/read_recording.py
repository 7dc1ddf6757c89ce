#!/usr/bin/env python3
"""Opens a recording with readers that we did not write (PyPI: mcap, mcap-ros2-support) and decodes every message in it.

    /tmp/venv/bin/python tools/read_recording.py run.mcap --sample 3

Prints one JSON object: per topic its schema, the count of decoded messages, what the sequence numbers of the messages'
headers say about loss, and `--sample` messages spread from first to last with their values. Numbers that JSON has no
word for are the strings "nan", "inf", "-inf". Exit status 1, with the reason on standard error, if anything does not
open, decode or agree with the file's own statistics; with --complete also if a sequence has a gap.
"""

import argparse
import json
import math
import sys
from pathlib import Path


def plain(value, elements):
    """A decoded message as what JSON can carry; arrays are cut after `elements` (0: never)."""
    if hasattr(value, "__slots__"):
        return {name: plain(getattr(value, name), elements) for name in value.__slots__}
    if isinstance(value, float):
        return value if math.isfinite(value) else str(value)
    if isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, (bytes, bytearray, list, tuple)) or hasattr(value, "tolist"):
        items = value.tolist() if hasattr(value, "tolist") else list(value)
        return [plain(item, elements) for item in (items[:elements] if elements else items)]
    raise TypeError(f"a decoded value of type {type(value).__name__}")


class Sequence:
    """Follows `header.sequence` of one topic."""

    def __init__(self):
        self.first = self.last = None
        self.gaps = self.lost = self.steps_back = 0

    def take(self, number):
        if self.last is None:
            self.first = number
        elif number > self.last + 1:
            self.gaps += 1
            self.lost += number - self.last - 1
        elif number <= self.last:
            self.steps_back += 1  # a sender that was replaced counts from 0 again
        self.last = number


def spread(count, sample):
    """`sample` indices from 0 to count − 1, the ends among them."""
    if sample <= 1:
        return {0} if sample else set()
    return {round(i * (count - 1) / (sample - 1)) for i in range(sample)}


def read(path, sample, elements):
    from mcap.reader import make_reader
    from mcap_ros2._dynamic import serialize_dynamic
    from mcap_ros2.decoder import DecoderFactory

    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        header = reader.get_header()
        summary = reader.get_summary()
        if summary is None or summary.statistics is None:
            raise ValueError("no summary section with statistics: the recording was not closed")
        expected = {}
        for channel, count in summary.statistics.channel_message_counts.items():
            topic = summary.channels[channel].topic
            expected[topic] = expected.get(topic, 0) + count
        topics = {}
        for schema, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
            topic = topics.get(channel.topic)
            if topic is None:
                topic = topics[channel.topic] = dict(
                    schema=schema.name,
                    encoding=f"{schema.encoding}/{channel.message_encoding}",
                    messages=0,
                    bytes=0,
                    sequence=Sequence(),
                    wanted=spread(expected.get(channel.topic, 0), sample),
                    sample=[],
                )
            values = plain(decoded, elements) if topic["messages"] in topic["wanted"] else None
            if values is not None:
                # A definition that says less than the body holds would decode, too: written again it must be the same.
                encode = serialize_dynamic(schema.name, schema.data.decode())[schema.name]
                if encode(decoded) != message.data:
                    raise ValueError(f"{channel.topic}: message {topic['messages']} encodes to other bytes than it has")
                topic["sample"].append(dict(index=topic["messages"], log_time=message.log_time, values=values))
            topic["messages"] += 1
            topic["bytes"] += len(message.data)
            own_header = getattr(decoded, "header", None)
            if hasattr(own_header, "sequence"):
                topic["sequence"].take(own_header.sequence)
        counted = {name: topic["messages"] for name, topic in topics.items()}
        if counted != {name: count for name, count in expected.items() if count}:
            raise ValueError(f"decoded {counted}, but the file's statistics say {expected}")
        metadata = {record.name: dict(record.metadata) for record in reader.iter_metadata()}
    for topic in topics.values():
        del topic["wanted"]
        sequence = vars(topic.pop("sequence"))
        if sequence["first"] is not None:
            topic["sequence"] = sequence
    return dict(
        file=str(path),
        profile=header.profile,
        library=header.library,
        messages=sum(counted.values()),
        metadata=metadata,
        topics=dict(sorted(topics.items())),
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--sample", type=int, default=0, help="messages per topic to print")
    parser.add_argument("--elements", type=int, default=8, help="array elements to print; 0 for all")
    parser.add_argument("--complete", action="store_true", help="fail if a sequence has a gap")
    arguments = parser.parse_args()
    try:
        report = read(arguments.recording, arguments.sample, arguments.elements)
    except Exception as error:  # whatever a reader throws at a bad file is a failure to report, not a traceback
        sys.exit(f"{arguments.recording}: {type(error).__name__}: {error}")
    print(json.dumps(report, allow_nan=False))
    gaps = [name for name, topic in report["topics"].items() if topic.get("sequence", {}).get("gaps")]
    if arguments.complete and gaps:
        sys.exit(f"{arguments.recording}: sequence gaps on {', '.join(gaps)}")


if __name__ == "__main__":
    main()
