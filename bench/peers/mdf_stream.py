"""One of 15 channels of a 1 GB MDF 4 file: asammdf beside our streaming reader, time and peak memory in the same run.

    cargo build --release -p dynocal-files --example mdf_channel
    target/readers/bin/python bench/peers/mdf_stream.py [ROWS]

Needs asammdf (scripts/readers.sh). 8 000 000 rows make 1 GB plain."""
import os
import subprocess
import sys
import tempfile
import time

import numpy as np

ROOT = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..")
OURS = os.path.join(ROOT, "target", "release", "examples", "mdf_channel")
PEER = """
import sys, resource
from asammdf import MDF
s = MDF(sys.argv[1]).get(sys.argv[2]).samples
print(f"{len(s)} rows, mean {s.mean()}, {s.min()} to {s.max()}")
print("VmHWM:", resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, "kB")
"""


def make(path, rows, compression):
    from asammdf import MDF, Signal

    t = np.arange(rows) * 1e-3
    signals = [Signal(np.round(np.sin(t * (k + 1)) * 1000) / 10, t, name=f"c{k}", unit="Nm") for k in range(15)]
    m = MDF(version="4.10")
    m.append(signals)
    m.save(path, overwrite=True, compression=compression)
    m.close()


def timed(command):
    start = time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return time.perf_counter() - start, done.stdout.strip().splitlines()


rows = int(sys.argv[1]) if len(sys.argv) > 1 else 8_000_000
with tempfile.TemporaryDirectory() as folder:
    for name, compression in (("plain", 0), ("transposed deflate", 2)):
        path = os.path.join(folder, "a.mf4")
        make(path, rows, compression)
        size = os.path.getsize(path) / 1e6
        for who, command in (("asammdf", [sys.executable, "-c", PEER, path, "c7"]), ("dynocal", [OURS, path, "c7"])):
            seconds, said = timed(command)
            print(f"{name}, {size:.0f} MB, {who}: {seconds:.2f} s, {said[0]}, {said[-1]}")
