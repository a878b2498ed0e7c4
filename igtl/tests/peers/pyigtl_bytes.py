"""Reads messages of OpenIGTLink on standard input with pyigtl and writes them again, packed anew,
after a line of what was read for each. It packs POLYDATA, but does not read it; its POSITION is not
the protocol's, and STATUS and TRAJ it does not know."""

import json
import struct
import sys

import numpy as np
import pyigtl
from pyigtl import messages

data = sys.stdin.buffer.read()
out = sys.stdout.buffer
while data:
    header, data = data[:58], data[58:]
    fields = messages.MessageBase.parse_header(header)
    size = fields["body_size"]
    body, data = data[:size], data[size:]
    crc = struct.unpack("> Q", header[50:58])[0]
    assert crc == messages.CRC64(body), "checksum"
    kind = fields["message_type"]
    if kind == "POLYDATA":
        message = pyigtl.PolyDataMessage(
            points=np.array([[0, 0, 0], [0, 0, 1], [0.5, 0, 2], [1, 1, 1], [2, 2, 2]]),
            lines=np.array([3, 0, 1, 2, 2, 3, 4]),
        )
        message.header_version = fields["header_version"]
        message.device_name = fields["device_name"]
        message.timestamp = fields["timestamp"]
        content = {}
    else:
        message = messages.MessageBase.create_message(kind)
        if message is None or kind == "POSITION":
            out.write(json.dumps({"kind": kind, "known": False}).encode() + b"\n")
            out.write(struct.pack("> I", 0))
            continue
        message.unpack(fields, body)
        content = {
            "TRANSFORM": lambda m: {"matrix": m.matrix.tolist()},
            "POINT": lambda m: {"names": m.names, "positions": m.positions},
            "IMAGE": lambda m: {
                "shape": m.image.shape,
                "sum": int(m.image.sum()),
                "matrix": m.ijk_to_world_matrix.tolist(),
                "system": m.world_coordinate_system,
            },
            "STRING": lambda m: {"string": m.string},
        }[kind](message)
    content.update(kind=kind, known=True, device=message.device_name, time=message.timestamp)
    content.update(id=message.message_id, metadata=message.metadata)
    packed = message.pack()
    out.write(json.dumps(content).encode() + b"\n")
    out.write(struct.pack("> I", len(packed)) + packed)
