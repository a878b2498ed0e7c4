"""Writes what pyigtl sends in one session to standard output: commands, targets, a tracker's poses, an image
and lines. `tests/samples/pyigtl.igtl` is what pyigtl 0.3.4 wrote."""

import sys

import numpy as np
import pyigtl

messages = [pyigtl.StringMessage("TARGET 402 0 190", device_name="Command")]
target = np.eye(4)
target[:3, 3] = [402.0, 0.0, 190.0]
messages.append(pyigtl.TransformMessage(target, device_name="NewTarget"))
messages.append(pyigtl.PointMessage([[402.0, 0.0, 190.0]], names=["target"], device_name="NewTarget"))
messages.append(pyigtl.StringMessage("START", device_name="Command"))
for k in range(20):
    pose = np.eye(4)
    pose[:3, 3] = [400.0 + 0.01 * k, -0.5, 250.0 - 0.4 * k]
    messages.append(pyigtl.TransformMessage(pose, device_name="NeedleTipToTracker"))
image = np.arange(24, dtype=np.uint8).reshape(1, 4, 6, 1)
messages.append(pyigtl.ImageMessage(image, device_name="Ultrasound"))
points, lines = np.array([[0.0, 0, 0], [0, 0, 1], [0.5, 0, 2]]), np.array([3, 0, 1, 2])
messages.append(pyigtl.PolyDataMessage(points=points, lines=lines, device_name="Vessel"))
messages.append(pyigtl.StringMessage("STOP", device_name="Command"))
for k, message in enumerate(messages):
    message.timestamp = 1_800_000_000 + 0.025 * k
    sys.stdout.buffer.write(message.pack())
