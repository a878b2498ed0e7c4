"""Plays the part of 3D Slicer with pyigtl: watches a run that waits, gives it targets, starts, pauses,
resumes and stops it. The argument is the port. Prints "passed" at the end."""

import json
import sys
import time

import numpy as np
import pyigtl

client = pyigtl.OpenIGTLinkClient("127.0.0.1", int(sys.argv[1]))
seen = {}


def look():
    for message in client.get_latest_messages():
        seen[message.device_name] = message


def wait(what, found, seconds=20.0):
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        look()
        result = found()
        if result:
            return result
        time.sleep(0.005)
    raise SystemExit(f"no {what}; seen: {sorted(seen)}; answer: {seen.get('Answer')}")


def state():
    return json.loads(seen["State"].string)


def ask(message):
    seen.pop("Answer", None)
    client.send_message(message)
    wait("answer", lambda: "Answer" in seen)
    return json.loads(seen["Answer"].string)


def say(text):
    return ask(pyigtl.StringMessage(text, device_name="Command"))


def phase_is(*phases):
    return lambda: "State" in seen and state()["phase"] in phases


names = {"NeedleTip", "NeedleBase", "LeftCamera", "State"}
if "images" in sys.argv:
    names.add("RightCamera")
wait("transforms", lambda: names <= set(seen))
assert state()["phase"] == "Idle", state()
tip = seen["NeedleTip"].matrix
# Straight down, 126 mm in front of the base, on the surface of the default configuration.
assert np.allclose(tip[:3, 2], [0, 0, -1], atol=1e-3), tip
assert np.allclose(tip[:3, 3], [400, 0, 250], atol=1.0), tip
assert abs(seen["NeedleBase"].matrix[2, 3] - 376) < 1.0

# What is no target is refused in words, and what is no command.
bad = np.eye(4)
bad[0, 0] = 2.0
for message, told in [
    (pyigtl.TransformMessage(bad, device_name="NewTarget"), "no rotation"),
    (pyigtl.StringMessage("TARGET nan 0 0"), "not a number"),
    (pyigtl.StringMessage("TARGET 0.4 0 0.2e9"), "5 m"),
    (pyigtl.StringMessage("JUMP"), "no command"),
    (pyigtl.PointMessage([[400, 0, 300]], device_name="NewTarget"), "behind"),
    (pyigtl.StringMessage("PAUSE"), "no insertion"),
]:
    answer = ask(message)
    assert not answer["accepted"] and told in answer["text"], answer

# A target 60 mm down and 2 mm aside, each way in which one can be given.
target = [402.0, 0.0, 190.0]
matrix = np.eye(4)
matrix[:3, 3] = target
for message in [
    pyigtl.PointMessage([target], device_name="NewTarget"),
    pyigtl.TransformMessage(matrix, device_name="newtarget"),
    pyigtl.StringMessage("TARGET 402 0 190"),
]:
    answer = ask(message)
    assert answer["accepted"] and "60.0 mm ahead" in answer["text"], answer

answer = say("START")
assert answer["accepted"], answer
wait("insertion", phase_is("PreInsertion", "Steering"))
wait("target", lambda: "Target" in seen)
assert np.allclose(seen["Target"].matrix[:3, 3], target, atol=1e-2), seen["Target"].matrix

assert say("PAUSE")["accepted"]
wait("pause", phase_is("Paused"))
depth = state()["depth_mm"]
time.sleep(1.0)
look()
assert abs(state()["depth_mm"] - depth) < 0.1, (depth, state())
assert say("RESUME")["accepted"]
wait("going on", phase_is("PreInsertion", "Steering"))

# Poses at the rate that the configuration holds, each with a time of its own.
stamps = []
until = time.monotonic() + 3.0
while time.monotonic() < until:
    look()
    if not stamps or seen["NeedleTip"].timestamp != stamps[-1]:
        stamps.append(seen["NeedleTip"].timestamp)
    time.sleep(0.001)
rate = (len(stamps) - 1) / (stamps[-1] - stamps[0])
print(f"{rate:.1f} poses a second", file=sys.stderr)
assert 20.0 < rate < 40.0, rate
if "images" in sys.argv:
    image = wait("image", lambda: seen.get("LeftImage"))
    assert image.image.shape == (1, 480, 640, 3), image.image.shape
    # The drawn needle is not grey.
    assert (image.image[..., 0] != image.image[..., 1]).any()

answer = say("STOP")
assert answer["accepted"], answer
wait("end", phase_is("Ended", "Faulted"))
dropped = state()["dropped"]
assert dropped["unknown command"] == 1 and dropped["no rotation"] == 1, dropped
client.stop()
print("passed")
