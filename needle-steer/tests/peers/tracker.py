"""Plays an electromagnetic tracker with pyigtl: takes the phantom's true tip from a run over OpenIGTLink,
adds noise of its own, and sends the sensor's pose in the tracker's frame as PLUS does.

Arguments: the port of the run; the port at which to serve as PLUS, or 0 to send over the connection to
the run; origin [mm] and roll, pitch, yaw [deg] of the tracker's frame in World, seven blanks between.
Options after that: "silent=S" stops sending for good after S seconds of the insertion; "gap=S" pauses
for 0.6 s once. Says START until that is accepted, ends when the run does, prints "passed"."""

import json
import math
import sys
import time

import numpy as np
import pyigtl

run, own = int(sys.argv[1]), int(sys.argv[2])
place = [float(x) for x in sys.argv[3:9]]
options = dict(option.split("=") for option in sys.argv[9:])
DEVICE = "NeedleTipToTracker"
NOISE_MM, AXIS_NOISE = 0.1, 3e-3
noise = np.random.default_rng(1)


def rotation(roll, pitch, yaw):
    (sr, cr), (sp, cp), (sy, cy) = [(math.sin(a), math.cos(a)) for a in (roll, pitch, yaw)]
    x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return z @ y @ x


world_from_tracker = np.eye(4)
world_from_tracker[:3, :3] = rotation(*np.radians(place[3:]))
world_from_tracker[:3, 3] = place[:3]
tracker_from_world = np.linalg.inv(world_from_tracker)


def measured(tip):
    """The tip as the tracker sees it: turned about its axis anyhow, as a coil is."""
    turn = rotation(*(noise.normal(size=3) * [AXIS_NOISE, AXIS_NOISE, 0]))
    about = rotation(0, 0, noise.uniform(0, 2 * math.pi))
    seen = np.eye(4)
    seen[:3, :3] = tip[:3, :3] @ turn @ about
    seen[:3, 3] = tip[:3, 3] + noise.normal(size=3) * NOISE_MM
    return tracker_from_world @ seen


client = pyigtl.OpenIGTLinkClient("127.0.0.1", run)
server = pyigtl.OpenIGTLinkServer(port=own, local_server=True) if own else None
begun, sent, paused, last, asked = None, 0, False, None, 0.0
quiet = time.monotonic()
while time.monotonic() - quiet < 3.0:
    for message in client.get_latest_messages():
        quiet = time.monotonic()
        if message.device_name == "Answer":
            answer = json.loads(message.string)
            print(answer, file=sys.stderr)
            if answer["accepted"]:
                begun = quiet
        if message.device_name != "TrueTip" or message.timestamp == last:
            continue
        last = message.timestamp
        since = 0.0 if begun is None else time.monotonic() - begun
        if since > float(options.get("silent", "inf")):
            continue
        if since > float(options.get("gap", "inf")) and not paused:
            paused = True
            time.sleep(0.6)
            continue
        matrix = measured(np.array(message.matrix))
        transform = pyigtl.TransformMessage(matrix, device_name=DEVICE, timestamp=message.timestamp)
        (server or client).send_message(transform)
        sent += 1
    if begun is None and time.monotonic() > asked + 0.4:
        asked = time.monotonic()
        client.send_message(pyigtl.StringMessage("START", device_name="Command"))
    time.sleep(0.001)
client.stop()
if server:
    server.stop()
print(f"passed: {sent} sent")
