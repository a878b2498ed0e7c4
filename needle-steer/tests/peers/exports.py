"""Opens a log and what was exported of it with the readers of others: the log by `mcap`, the bags by `rosbags`
and `mcap-ros2-support`, the tables by `pandas`. Arguments: log, ROS 1 bag, ROS 2 bag, CSV, Parquet, the
wall-clock time before the run and after it [s]. Prints "passed" at the end."""

import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pandas as pd
from mcap.reader import make_reader
from mcap_ros1.decoder import DecoderFactory as Ros1Decoder
from mcap_ros2.decoder import DecoderFactory as Ros2Decoder
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

log, bag1, bag2, csv, parquet = map(Path, sys.argv[1:6])
before, after = map(float, sys.argv[6:8])


def decoded(file, factory):
    with file.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[factory])
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        return metadata, [
            (channel.topic, schema.name, message.log_time, decoded)
            for schema, channel, message, decoded in reader.iter_decoded_messages()
        ]


metadata, logged = decoded(log, Ros1Decoder())
began = int(metadata["run"]["began_unix_ns"])
assert before <= began * 1e-9 <= after, (before, began, after)
count = Counter(topic for topic, *_ in logged)
print(dict(count), file=sys.stderr)
for topic in [
    "/needle/step", "/needle/tip", "/needle/markers", "/tf", "/tf_static", "/joint_states", "/left/image_raw",
    "/right/image_raw", "/left/camera_info", "/right/camera_info", "/robot_description", "/rosout",
]:
    assert count[topic] > 0, topic
newest = {topic: message for topic, _, _, message in logged}
assert "<robot" in newest["/robot_description"].data
frames = {(t.header.frame_id, t.child_frame_id) for t in newest["/tf_static"].transforms}
assert ("world", "left_camera_optical_frame") in frames, frames
assert ("world", "base_link") in frames, frames
info = newest["/left/camera_info"]
assert (info.width, info.height) == (newest["/left/image_raw"].width, newest["/left/image_raw"].height)
assert info.K[0] > 100.0 and info.header.frame_id == "left_camera_optical_frame"


def same(a, b):
    """Fields of a message of ROS 1 against those of one of ROS 2 or of a bag, whatever the classes."""
    if hasattr(a, "nsecs"):
        assert (a.secs, a.nsecs) == (b.sec, b.nanosec), (a, b)
    elif hasattr(a, "__slots__") or hasattr(a, "__dataclass_fields__"):
        here, there = fields(a), fields(b)
        names = set(here) & set(there)
        assert names, (a, b)
        for name in names:
            if name not in ("stamp", "seq") and not name.endswith("_stamp"):
                same(getattr(a, here[name]), getattr(b, there[name]))
    elif isinstance(a, (str, bytes, bool)):
        assert bytes(a) == bytes(b) if isinstance(a, bytes) else a == b, (a, b)
    elif isinstance(a, (list, tuple, np.ndarray)):
        assert len(a) == len(b), (a, b)
        if len(a) and isinstance(a[0], (int, float, np.number)):
            assert np.array_equal(np.asarray(a), np.asarray(b), equal_nan=True), (a, b)
        else:
            for x, y in zip(a, b):
                same(x, y)
    elif isinstance(a, (int, float, np.number)):
        assert a == b or (a != a and b != b), (a, b)


def fields(message):
    names = getattr(message, "__dataclass_fields__", None) or getattr(message, "__slots__", [])
    # ROS 2 has CameraInfo's D, K, R and P small.
    return {n.lower() if len(n) == 1 else n: n for n in names if not n.startswith("_")}


STEP = "/needle/step"
steps = [(time, message) for topic, _, time, message in logged if topic == STEP]

# ROS 1.
with AnyReader([bag1]) as reader:
    bagged = [
        (connection.topic, time, reader.deserialize(raw, connection.msgtype))
        for connection, time, raw in reader.messages()
    ]
    sums = {connection.topic: connection.digest for connection in reader.connections}
assert sums["/tf"] == "94810edda583a504dfda3829e70d7eec", sums
assert sums["/left/camera_info"] == "c9a58c1b0b154e0e6da7578cb991d214", sums
assert Counter(topic for topic, *_ in bagged) == count
found = [(time, message) for topic, time, message in bagged if topic == STEP]
assert [time for time, _ in found] == [time + began for time, _ in steps]
for (time, there), (_, here) in zip(found, steps):
    assert there.header.stamp.sec * 10**9 + there.header.stamp.nanosec == time
    assert there.depth == here.depth or there.depth != there.depth
ends = {topic: message for topic, _, message in bagged}
assert bytes(ends["/left/image_raw"].data) == newest["/left/image_raw"].data

# ROS 2, once by each reader.
assert (bag2 / "metadata.yaml").is_file()
[file] = bag2.glob("*.mcap")
_, converted = decoded(file, Ros2Decoder())
assert Counter(topic for topic, *_ in converted) == count
types = {topic: name for topic, name, *_ in converted}
assert types["/tf"] == "tf2_msgs/msg/TFMessage" and types["/rosout"] == "rcl_interfaces/msg/Log", types
found = [(time, message) for topic, _, time, message in converted if topic == STEP]
assert [time for time, _ in found] == [time + began for time, _ in steps]
last = {topic: message for topic, _, _, message in converted}
for topic in count:
    if topic != "/rosout":
        same(newest[topic], last[topic])
assert last["/rosout"].msg == newest["/rosout"].msg and last["/rosout"].level in (20, 40)
assert list(last["/left/camera_info"].k) == list(info.K)
with AnyReader([bag2], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
    assert reader.message_count == sum(count.values())
    again = {
        connection.topic: reader.deserialize(raw, connection.msgtype)
        for connection, _, raw in reader.messages()
    }
# With the definitions of ROS 2 Humble itself, where it has the type.
store = get_typestore(Stores.ROS2_HUMBLE)
with AnyReader([bag2], default_typestore=store) as reader:
    for connection, _, raw in reader.messages():
        if connection.msgtype in store.types:
            own = store.deserialize_cdr(raw, connection.msgtype)
            if connection.topic == "/needle/markers":
                assert all(m.mesh_resource == "" and m.texture_resource == "" for m in own.markers)
                assert len(own.markers) == len(newest["/needle/markers"].markers) or own.markers
assert again["/robot_description"].data == newest["/robot_description"].data
assert list(again["/joint_states"].position) == list(newest["/joint_states"].position)

# Tables.
left, right = pd.read_csv(csv), pd.read_parquet(parquet)
assert list(left.columns) == list(right.columns) and len(left) == len(right) == len(steps)
for name in left.columns:
    if right[name].dtype == np.float64:
        assert np.array_equal(left[name].astype(float), right[name], equal_nan=True), name
    else:
        assert list(left[name].fillna("")) == list(right[name]), name
assert right["t_s"].is_monotonic_increasing
assert np.allclose(right["unix_s"], began * 1e-9 + right["t_s"], atol=1e-6)
assert np.isclose(right["t_s"].iloc[-1], steps[-1][0] * 1e-9)
print("passed")
