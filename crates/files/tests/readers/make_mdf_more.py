"""asammdf writes a file for each of the conversions 3 (formula), 6 (ranges to values), 7 (values to words) and 8 (ranges to
words), and a file is put together byte by byte in which the records of two rasters lie between each other (unsorted);
asammdf reads that one first, so that it is a file and no invention. What is in them is computed here. argv: folder"""
import json
import struct
import sys

import numpy as np
from asammdf import MDF, Signal

folder = sys.argv[1]
n = 300
time = np.arange(n) * 0.02
raw = (np.arange(n) * 7 % 60).astype(np.int16)
x = raw.astype(float)
# Values in no range take the default.
conversions = {
    "formula": ({"formula": "X * X / 8 - 3 * X + 1"}, (x * x / 8 - 3 * x + 1).tolist()),
    "ranges": (
        {"lower_0": 0, "upper_0": 9, "phys_0": 1.5, "lower_1": 10, "upper_1": 49, "phys_1": -2.0, "default": 7.25},
        np.where(x <= 9, 1.5, np.where(x <= 49, -2.0, 7.25)).tolist(),
    ),
    "words": (
        {"val_0": 0, "text_0": "neutral", "val_1": 7, "text_1": "drive", "default_addr": "unknown"},
        [{0: "neutral", 7: "drive"}.get(int(r), "unknown") for r in raw],
    ),
    "range_words": (
        {"lower_0": 0, "upper_0": 19, "text_0": "low", "lower_1": 20, "upper_1": 39, "text_1": "middle", "default_addr": "high"},
        ["low" if r <= 19 else "middle" if r <= 39 else "high" for r in raw],
    ),
}
wanted = []
for name, (conversion, physical) in conversions.items():
    for compression in (0, 2):
        mdf = MDF(version="4.10")
        mdf.append([Signal(raw, time, name="x", unit="Nm", conversion=dict(conversion))])
        file = f"{name}_{compression}.mf4"
        mdf.save(f"{folder}/{file}", compression=compression, overwrite=True)
        mdf.close()
        wanted.append({"file": file, "channels": {"x": {"time_s": time.tolist(), "values": physical}}})


def block(kind, links, data):
    """Header (id, reserved, length, number of links), links, data; to a whole number of 8 bytes."""
    length = 24 + 8 * len(links) + len(data)
    body = struct.pack("<4sIQQ", kind, 0, length, len(links)) + struct.pack(f"<{len(links)}Q", *links) + data
    return body + bytes(-len(body) % 8)


class File:
    """Blocks one after the other; each is put behind those that it points to."""

    def __init__(self):
        self.bytes = bytearray(b"MDF     " + b"4.10    " + b"byhand  " + bytes(4) + struct.pack("<H", 410) + bytes(34))
        self.bytes += bytes(104)  # the header block, written last

    def put(self, body):
        at = len(self.bytes)
        self.bytes += body
        return at

    def text(self, text):
        return self.put(block(b"##TX", [], text.encode() + b"\0"))

    def channel(self, following, name, unit, kind, sync, data_type, offset, bits):
        links = [following, 0, self.text(name), 0, 0, 0, self.text(unit), 0]
        head = struct.pack("<BBBBIIIIBBHdddddd", kind, sync, data_type, 0, offset, bits, 0, 0, 0, 0, 0, *[0.0] * 6)
        return self.put(block(b"##CN", links, head))

    def group(self, following, first, name, record_id, cycles, size):
        links = [following, first, self.text(name), 0, 0, 0]
        return self.put(block(b"##CG", links, struct.pack("<QQHHIII", record_id, cycles, 0, 0, 0, size, 0)))


# Two rasters in one data group: 0.01 s with a 16-bit channel, 0.05 s with a float, records in the order of their stamps.
FLOAT, UNSIGNED, SIGNED = 4, 0, 2
fast = [(k * 0.01, (k * 37) % 1000 - 500) for k in range(40_000)]
slow = [(k * 0.05 + 0.001, 80.0 + 0.25 * (k % 100)) for k in range(8_000)]
records = [(t, struct.pack("<Bdh", 1, t, v)) for t, v in fast] + [(t, struct.pack("<Bdd", 2, t, v)) for t, v in slow]
data = b"".join(r for _, r in sorted(records, key=lambda r: r[0]))
f = File()
oil = f.channel(0, "oil", "degC", 0, 0, FLOAT, 8, 64)
second = f.group(0, f.channel(oil, "time", "s", 2, 1, FLOAT, 0, 64), "slow", 2, len(slow), 16)
torque = f.channel(0, "torque", "Nm", 0, 0, SIGNED, 8, 16)
first = f.group(second, f.channel(torque, "time", "s", 2, 1, FLOAT, 0, 64), "fast", 1, len(fast), 10)
dt = f.put(block(b"##DT", [], data))
dg = f.put(block(b"##DG", [0, first, dt, 0], struct.pack("<B7x", 1)))
note = f.put(block(b"##MD", [], b"<FHcomment><TX>by hand</TX><tool_id>-</tool_id><tool_vendor>-</tool_vendor>"
                   b"<tool_version>-</tool_version></FHcomment>\0"))
history = f.put(block(b"##FH", [0, note], struct.pack("<QhhB3x", 0, 0, 0, 0)))
head = block(b"##HD", [dg, history, 0, 0, 0, 0], struct.pack("<QhhBBBBdd", 0, 0, 0, 0, 0, 0, 0, 0.0, 0.0))
f.bytes[64 : 64 + len(head)] = head
path = f"{folder}/unsorted.mf4"
open(path, "wb").write(f.bytes)
channels = {
    "torque": {"time_s": [t for t, _ in fast], "values": [v for _, v in fast]},
    "oil": {"time_s": [t for t, _ in slow], "values": [v for _, v in slow]},
}
with MDF(path) as mdf:
    for name, want in channels.items():
        got = mdf.get(name)
        assert np.array_equal(got.timestamps, want["time_s"]) and np.array_equal(got.samples, want["values"]), name
wanted.append({"file": "unsorted.mf4", "channels": channels})
json.dump(wanted, open(f"{folder}/wanted.json", "w"))
print(f"asammdf wrote {len(wanted) - 1} files and reads the unsorted one")
