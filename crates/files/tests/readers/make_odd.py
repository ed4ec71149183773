"""Files of other tools with what others write: `make_odd.py FOLDER`. Names, units, empty channels, huge words, types that we do not
read, tables of plain HDF5, compressions of Parquet where its writer is installed."""
import os
import sys

import h5py
import numpy as np
import scipy.io
from asammdf import MDF, Signal

os.chdir(sys.argv[1])
n = 500
t = np.arange(n) * 0.01


def mdf(name, *groups, version="4.10", compression=0):
    m = MDF(version=version)
    for group in groups:
        m.append(group)
    m.save(name, overwrite=True, compression=compression)
    m.close()


def s(samples, name, unit="", stamps=t, **more):
    return Signal(samples, stamps, name=name, unit=unit, **more)


mdf("names.mf4", [s(t, "Drehzahl [1/min]", "1/min"), s(t, "Öl Temperatur", "°C"), s(t, 'a,b;c"d', "%"), s(t, "速度", "km/h"), s(t, "two\nlines", "Nm")])
mdf("empty.mf4", [s(np.array([], dtype=float), "e", stamps=np.array([]))], [s(t, "x", "Nm")])
words = np.array([b"x" * 5000 if k % 2 else b"on" for k in range(n)])
structure = np.array(list(zip(t, 2 * t)), dtype=[("a", "<f8"), ("b", "<f8")])
table = np.array([(row,) for row in np.arange(n * 3.0).reshape(n, 3)], dtype=[("array", "(3,)<f8")])
array = s(table, "array")
half = s((t * 100).astype("f2"), "half", "V")
mdf("odd.mf4", [s(words, "huge", encoding="utf-8"), half, s(structure, "structure"), array, s(t, "x", "Nm")])
mdf("old.mdf", [s(t, "x", "Nm"), s((t * 10).astype("u2"), "y", "°C")], version="3.30")
kinds = [s((t * 1000 - 1).astype(d), f"c_{d}") for d in ("u1", "u2", "u4", "u8", "i1", "i2", "i4", "i8", "f4", "f8")]
for compression in (0, 1, 2):
    mdf(f"kinds_{compression}.mf4", kinds, compression=compression)
scipy.io.savemat("odd.mat", {"time": t, "x": t, "m": np.arange(n * 3.0).reshape(n, 3), "txt": "hello", "cells": np.array(["a", "bb"], dtype=object), "empty": np.zeros((0, 0)), "c": t + 1j * t})
with h5py.File("plain.h5", "w") as f:
    f["time"] = t
    f["x"] = 3 * t
    f["m"] = np.arange(n * 2.0).reshape(n, 2)
    f["names"] = np.array(["a", "b"], dtype=h5py.string_dtype())
