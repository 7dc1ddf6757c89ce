"""Checks a recording with PyPI's rosbags: python check_recording.py DRIVE.mcap STEPS STEP_S [PACKAGE]

Every message must decode with the file's own definitions and encode to the same bytes, times must be the drive's and run
forward, text must be text. With PACKAGE, a folder that `mirror messages` wrote, its definitions must be those in the file.
"""

import datetime
import sys
import warnings
from collections import defaultdict
from pathlib import Path

from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

warnings.simplefilter("error")


def text_fields(message, typestore, out):
    """Every string in a message, the nested ones included."""
    for name in message.__dataclass_fields__:
        value = getattr(message, name)
        if isinstance(value, str) and name != "__msgtype__":
            out.append(value)
        elif hasattr(value, "__dataclass_fields__"):
            text_fields(value, typestore, out)
        elif isinstance(value, (list, tuple)):
            for item in value:
                if hasattr(item, "__dataclass_fields__"):
                    text_fields(item, typestore, out)
    return out


def package_types(folder):
    types = {}
    for path in sorted((folder / "msg").glob("*.msg")):
        types.update(get_types_from_msg(path.read_text(), f"mirror_msgs/msg/{path.stem}"))
    return types


def main(recording, steps, step_s, package=None):
    times, texts = defaultdict(list), defaultdict(set)
    before = 0
    with AnyReader([Path(recording)]) as reader:
        qos = {c.topic: c.ext.offered_qos_profiles for c in reader.connections}
        for topic, profiles in qos.items():
            wanted = QosDurability.TRANSIENT_LOCAL if topic == "/viz/road" else QosDurability.VOLATILE
            assert [p.durability for p in profiles] == [wanted], (topic, profiles)
        for connection, time, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            again = reader.typestore.serialize_cdr(message, connection.msgtype)
            assert bytes(again) == bytes(data), f"{connection.topic}: other bytes"
            assert time >= before, f"{connection.topic}: time runs backwards"
            before = time
            times[connection.topic].append(time)
            texts[connection.topic].update(text_fields(message, reader.typestore, []))
            if connection.topic == "/clock":
                assert message.clock.sec * 10**9 + message.clock.nanosec == time
        if package is not None:
            ours = get_typestore(Stores.EMPTY)
            ours.register(package_types(Path(package)))
            for name, definition in ours.fielddefs.items():
                assert reader.typestore.fielddefs.get(name, definition) == definition, name
            recorded = {n for n in reader.typestore.fielddefs if n.startswith("mirror_msgs/")}
            assert recorded <= set(ours.fielddefs), recorded - set(ours.fielddefs)
            print(f"{sum(name.startswith('mirror_msgs/') for name in ours.fielddefs)} definitions")
    sensed = times["/world/lidar"]
    assert len(sensed) == int(steps), (len(sensed), steps)
    step = round(float(step_s) * 1e9)
    gaps = [b - a for a, b in zip(sensed, sensed[1:])]
    # Within an episode a step; to the next, the step that ended this one and one more.
    assert set(gaps) <= {step, 2 * step}, sorted(set(gaps))
    today = datetime.datetime.now(datetime.timezone.utc).timestamp()
    assert abs(today - sensed[0] / 1e9) < 3600, sensed[0]
    assert "self" in texts["/belief/human"], texts["/belief/human"]
    assert {"world", "driver"} <= texts["/run/report"], texts["/run/report"]
    print(f"{sum(map(len, times.values()))} messages of {len(times)} topics")


if __name__ == "__main__":
    main(*sys.argv[1:])
