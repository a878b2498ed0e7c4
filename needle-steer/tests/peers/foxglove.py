"""Plays a viewer's part over Foxglove's WebSocket protocol with the library `websockets`: subscribes to
everything of a run that waits, checks schemas and messages, calls each service. The argument is the
port. Prints "passed" at the end."""

import json
import struct
import sys
import time
from contextlib import ExitStack
from pathlib import Path

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

stack = ExitStack()
socket = stack.enter_context(
    connect(
        f"ws://127.0.0.1:{sys.argv[1]}",
        subprotocols=["foxglove.sdk.v1"],
        max_size=None,
        compression=None,
    )
)
channels, services, newest, count, answers, assets = {}, {}, {}, {}, {}, {}


def take(message):
    if isinstance(message, str):
        message = json.loads(message)
        if message["op"] == "advertise":
            channels.update({c["topic"]: c for c in message["channels"]})
        elif message["op"] == "advertiseServices":
            services.update({s["name"]: s for s in message["services"]})
        elif message["op"] == "serviceCallFailure":
            answers[message["callId"]] = message
    elif message[0] == 1:
        subscription, stamp = struct.unpack_from("<IQ", message, 1)
        newest[subscription] = (stamp, message[13:])
        count[subscription] = count.get(subscription, 0) + 1
    elif message[0] == 4:
        request, status, length = struct.unpack_from("<IBI", message, 1)
        assets[request] = (status, message[10 + length :] if status == 0 else message[10 : 10 + length])
    elif message[0] == 3:
        _, call, length = struct.unpack_from("<III", message, 1)
        assert message[13 : 13 + length] == b"json"
        answers[call] = json.loads(message[13 + length :])


def look(seconds):
    until = time.monotonic() + seconds
    while (left := until - time.monotonic()) > 0:
        try:
            take(socket.recv(timeout=left))
        except TimeoutError:
            return


def wait(what, found, seconds=20.0):
    until = time.monotonic() + seconds
    while not found():
        assert time.monotonic() < until, f"no {what}"
        look(0.02)


calls = 0


def call(name, arguments=None):
    global calls
    calls += 1
    request = json.dumps(arguments or {}).encode()
    number = services["/needle_steer/" + name]["id"]
    header = struct.pack("<BIII", 2, number, calls, 4)
    socket.send(header + b"json" + request)
    wait("answer of " + name, lambda: calls in answers)
    return answers[calls]


def text(data, at):
    length = struct.unpack_from("<I", data, at)[0]
    return data[at + 4 : at + 4 + length].decode(), at + 4 + length


def body(data):
    """What follows the header of a ROS 1 message."""
    return text(data, 12)[1]


wait("channels", lambda: len(channels) == 13 and len(services) == 10)
types = {
    "/joint_states": "sensor_msgs/JointState",
    "/needle/tip": "geometry_msgs/PoseStamped",
    "/needle/state": "needle_steer_msgs/State",
    "/needle/markers": "visualization_msgs/MarkerArray",
    "/tf": "tf2_msgs/TFMessage",
    "/tf_static": "tf2_msgs/TFMessage",
    "/left/image_raw": "sensor_msgs/Image",
    "/right/image_raw": "sensor_msgs/Image",
    "/left/camera_info": "sensor_msgs/CameraInfo",
    "/right/camera_info": "sensor_msgs/CameraInfo",
    "/overlay": "sensor_msgs/Image",
    "/rosout": "rosgraph_msgs/Log",
    "/robot_description": "std_msgs/String",
}
for topic, kind in types.items():
    channel = channels[topic]
    assert channel["schemaName"] == kind, channel
    assert channel["encoding"] == "ros1" and channel["schemaEncoding"] == "ros1msg", channel
    assert len(channel["schema"]) > 10, channel


def named(node):
    """What a layout names: topics with their fields, services."""
    if isinstance(node, dict):
        node = list(node) + list(node.values())
    if isinstance(node, list):
        return set().union(*map(named, node))
    return {node} if isinstance(node, str) and node.startswith("/") else set()


layout = json.loads((Path(__file__).parents[3] / "docs/live_layout.json").read_text())
wanted = named(layout)
assert {"/needle/markers", "/overlay", "/needle_steer/start"} <= wanted, wanted
for path in wanted - set(services):
    topic, _, field = path.partition(".")
    assert topic in channels, path
    assert not field or f" {field} " in channels[topic]["schema"].replace("\n", " \n"), path
numbers = {topic: i + 1 for i, topic in enumerate(sorted(types))}
subscriptions = [{"id": i, "channelId": channels[t]["id"]} for t, i in numbers.items()]
socket.send(json.dumps({"op": "subscribe", "subscriptions": subscriptions}))


def phase():
    data = newest[numbers["/needle/state"]][1]
    return text(data, body(data) + 8)[0]


def phase_is(*phases):
    return lambda: numbers["/needle/state"] in newest and phase() in phases


wait("tip", lambda: numbers["/needle/tip"] in newest)
data = newest[numbers["/needle/tip"]][1]
x, y, z = struct.unpack_from("<3d", data, body(data))
assert abs(x - 0.4) < 1e-3 and abs(y) < 1e-3 and abs(z - 0.25) < 1e-3, (x, y, z)
wait("state", phase_is("Idle"))
wait("description", lambda: numbers["/robot_description"] in newest)
assert "<robot" in text(newest[numbers["/robot_description"]][1], 0)[0]

# Meshes that the description names are fetched, and nothing else.
for uri in ["package://pytest/meshes/none.stl", "file:///etc/passwd", "../../../etc/passwd"]:
    socket.send(json.dumps({"op": "fetchAsset", "uri": uri, "requestId": 7}))
    assets.clear()
    wait("asset", lambda: 7 in assets)
    assert assets[7][0] == 1 and b"not named" in assets[7][1], assets
for name in [a.removeprefix("mesh=") for a in sys.argv if a.startswith("mesh=")]:
    socket.send(json.dumps({"op": "fetchAsset", "uri": name, "requestId": 8}))
    wait("mesh", lambda: 8 in assets)
    assert assets[8] == (0, b"solid of a test"), assets

for name, arguments, told in [
    ("target", {"x": 0.4, "y": 0, "z": 0.3}, "behind"),
    ("target", {"x": 0.4, "y": 0, "z": 0.2, "frame_id": "tool0"}, "tool0"),
    ("target", {"x": "deep"}, "no such JSON"),
    ("pause", None, "no insertion"),
    ("retract", None, "nothing is inserted"),
    ("home", None, "needs ROS"),
]:
    answer = call(name, arguments)
    assert not answer["success"] and told in answer["message"], answer
answer = call("target", {"x": 0.402, "y": 0, "z": 0.19, "frame_id": "world"})
assert answer["success"] and "60.0 mm ahead" in answer["message"], answer
for name, arguments in [
    ("clear_fault", None),
    ("enable", {"data": False}),
    ("enable", {"data": True}),
    ("dead_man", None),
]:
    assert call(name, arguments)["success"], name

assert call("start")["success"]
wait("insertion", phase_is("PreInsertion", "Steering"))
assert call("pause")["success"]
wait("pause", phase_is("Paused"))
assert call("resume")["success"]
wait("going on", phase_is("PreInsertion", "Steering"))
count.clear()
look(4.0)
rates = {topic: count.get(i, 0) / 4.0 for topic, i in numbers.items()}
print(rates, file=sys.stderr)
assert rates["/needle/tip"] >= 30.0 and rates["/tf"] >= 30.0, rates
assert rates["/needle/markers"] >= 10.0 and rates["/joint_states"] >= 30.0, rates
if "images" in sys.argv:
    assert rates["/overlay"] >= 15.0 and rates["/left/image_raw"] >= 15.0, rates
    data = newest[numbers["/overlay"]][1]
    at = body(data)
    height, width = struct.unpack_from("<II", data, at)
    assert (height, width) == (480, 640) and text(data, at + 8)[0] == "rgb8"
assert call("retract")["success"]
wait("withdrawal", phase_is("Retracting"))
assert call("stop")["success"]
try:
    wait("end", phase_is("Ended", "Faulted"))
except ConnectionClosed:
    # The run has ended, and its server with it; the last snapshot need not have come.
    pass
stack.close()
print("passed")
