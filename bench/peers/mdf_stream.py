"""One of 15 channels of a 1 GB MDF 4 file: asammdf beside our streaming reader in the same run. Wall time, processor time
(which other work on the machine disturbs less) and peak memory are taken alike for both, times from outside, memory as the
system tells it to each (a peak taken by the parent would hold the parent's own image); the least of the repeated times counts, and
the largest memory. Both read the file from the cache: it has just been written. Rows, mean and range
must agree. Ends with 1 where ours takes more processor time than 0.5 s (plain) or 3 s (compressed), or 20 MB or more.

    cargo build --release -p dynocal-files --example mdf_channel
    target/readers/bin/python bench/peers/mdf_stream.py [ROWS] [REPEATS]

Needs asammdf (scripts/readers.sh); DYNOCAL_MDF_CHANNEL names another program. 8 000 000 rows make 1 GB plain, in a temporary
folder that is removed."""
import os
import re
import subprocess
import sys
import tempfile
import time

import numpy as np

ROOT = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..")
OURS = os.environ.get("DYNOCAL_MDF_CHANNEL", os.path.join(ROOT, "target", "release", "examples", "mdf_channel"))
PEER = """
import sys
from asammdf import MDF
s = MDF(sys.argv[1]).get(sys.argv[2]).samples
print(f"{len(s)} rows, mean {s.mean()}, {s.min()} to {s.max()}")
print(next(l for l in open("/proc/self/status") if l.startswith("VmHWM")))
"""


def make(path, rows, compression):
    from asammdf import MDF, Signal

    t = np.arange(rows) * 1e-3
    signals = [Signal(np.round(np.sin(t * (k + 1)) * 1000) / 10, t, name=f"c{k}", unit="Nm") for k in range(15)]
    m = MDF(version="4.10")
    m.append(signals)
    m.save(path, overwrite=True, compression=compression)
    m.close()


def once(command):
    """Wall s, processor s, peak MB, first line of the output."""
    start = time.perf_counter()
    child = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    said = child.stdout.read()
    _, status, used = os.wait4(child.pid, 0)
    assert status == 0, said
    peak = int(re.search(r"VmHWM:\s*(\d+) kB", said)[1]) / 1024
    return time.perf_counter() - start, used.ru_utime + used.ru_stime, peak, said.splitlines()[0]


DEMANDS = {0: 0.5, 2: 3.0}  # s of processor time at 8 000 000 rows
MOST_MB = 20.0


def numbers(line):
    """Rows, mean, least and greatest value as printed."""
    return [float(x) for x in re.findall(r"[-+]?\d+\.?\d*(?:e[-+]?\d+)?", line.split(":")[-1])]


rows = int(sys.argv[1]) if len(sys.argv) > 1 else 8_000_000
repeats = int(sys.argv[2]) if len(sys.argv) > 2 else 3
missed = False
with tempfile.TemporaryDirectory() as folder:
    for name, compression in (("plain", 0), ("transposed deflate", 2)):
        path = os.path.join(folder, "a.mf4")
        if os.fork() == 0:  # what writes the file must not be in the memory of what is measured
            make(path, rows, compression)
            os._exit(0)
        assert os.wait()[1] == 0
        size = os.path.getsize(path) / 1e6
        found = {}
        for who, command in (("asammdf", [sys.executable, "-c", PEER, path, "c7"]), ("dynocal", [OURS, path, "c7"])):
            wall, busy, peak, said = zip(*(once(command) for _ in range(repeats)))
            print(f"{name}, {size:.0f} MB, {who}: {min(wall):.2f} s, of it {min(busy):.2f} s at work, {max(peak):.0f} MB; {said[0]}")
            found[who] = (min(busy), max(peak), numbers(said[0]))
        theirs, (busy, peak, ours) = found["asammdf"][2], found["dynocal"]
        assert len(ours) == 4 and np.allclose(ours, theirs, rtol=1e-9, atol=1e-9), (ours, theirs)
        missed |= peak >= MOST_MB or busy >= DEMANDS[compression] * max(1.0, rows / 8e6)
        os.remove(path)
sys.exit(1 if missed else 0)
