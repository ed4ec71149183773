"""asammdf writes 40 files, types x conversions x compression, every other one with invalid samples; what is in them is
computed here from the raw values, not by asammdf's conversions. argv: folder"""
import json
import sys

import numpy as np
from asammdf import MDF, Signal

folder = sys.argv[1]
n = 500
time = np.arange(n) * 0.02
ramp = np.arange(n)
types = {"u1": np.uint8, "i2": np.int16, "u4": np.uint32, "f4": np.float32, "f8": np.float64}
conversions = {
    "none": (None, lambda x: x),
    "linear": ({"a": 0.25, "b": -3.0}, lambda x: 0.25 * x - 3.0),
    # y = (p1 x^2 + p2 x + p3) / (p4 x^2 + p5 x + p6)
    "rational": (
        {"P1": 0.0, "P2": 2.0, "P3": 1.0, "P4": 0.0, "P5": 0.5, "P6": 200.0},
        lambda x: (2.0 * x + 1.0) / (0.5 * x + 200.0),
    ),
    "table": (
        {"raw_0": 0.0, "phys_0": 10.0, "raw_1": 50.0, "phys_1": 20.0, "raw_2": 200.0, "phys_2": 17.0, "interpolation": True},
        lambda x: np.interp(x, [0.0, 50.0, 200.0], [10.0, 20.0, 17.0]),
    ),
}
wanted = []
for t, (kind, dtype) in enumerate(types.items()):
    raw = (ramp * 7 % 200).astype(dtype)
    if kind in ("i2", "f4", "f8"):
        raw = (raw - dtype(60)).astype(dtype)
    for c, (name, (conversion, physical)) in enumerate(conversions.items()):
        for compression in (0, 2):
            invalid = (ramp % 11 == 3) if (t + c + compression // 2) % 2 else np.zeros(n, bool)
            signal = Signal(raw, time, name="x", unit="Nm", conversion=conversion)
            if invalid.any():
                signal.invalidation_bits = invalid
            other = Signal(ramp.astype(np.float32) * 0.5, time, name="y", unit="rpm")
            slow = Signal(ramp[:50].astype(np.int16), time[::10], name="slow", unit="degC")
            mdf = MDF(version="4.10")
            mdf.append([signal, other], comment="fast")
            mdf.append([slow], comment="slow")
            file = f"{kind}_{name}_{compression}.mf4"
            mdf.save(f"{folder}/{file}", compression=compression, overwrite=True)
            mdf.close()
            x = [None if bad else float(v) for v, bad in zip(physical(raw.astype(float)), invalid)]
            wanted.append({"file": file, "time_s": time.tolist(), "x": x, "y": (ramp * 0.5).tolist(), "slow": ramp[:50].tolist()})
json.dump(wanted, open(f"{folder}/wanted.json", "w"))
print(f"asammdf wrote {len(wanted)} files")
