"""What the comparisons share: the reference inputs, our program, CPU time, the torque model of eq. (4.17)."""

import os

# One thread on both sides; must be set before the numerical libraries are loaded.
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "RAYON_NUM_THREADS"):
    os.environ[name] = "1"

import json
import pathlib
import platform
import subprocess
import sys
import tempfile
import time

import numpy as np

ROOT = pathlib.Path(__file__).resolve().parents[2]
LEAST_CPU_S = 1.0
# Box (4.16): fuel pulse width, air bleed valve (fraction), speed.
LOWER, UPPER = np.array([2000.0, 0.4, 1000.0]), np.array([6000.0, 0.6, 2000.0])
THETA = np.array([
    64.17, -0.025, 0.062, -4.06e-7, 2.73e-6, -0.0069, 8.5e-7, 1.54e-6, -327.7, 0.0016, -1.52e-5, -4.22e-8, 0.069,
    -0.014, -1.56e-6, -2.25e-6, 0.029, 5.67e-7, 6.4e-7, 0.0021, 8.71e-7, -1.36e-6, 0.15,
])
# Regressors 1 to 22 of eq. (4.17) as lists of (input, lag); the 23rd is y(t-10).
REGRESSORS = [
    [], [(0, 0)], [(0, 0), (1, 10)], [(0, 0), (2, 0)], [(0, 0), (2, 3)], [(0, 10), (1, 10)], [(0, 10), (2, 9)],
    [(0, 10), (0, 10)], [(1, 10), (1, 10)], [(1, 10), (2, 9)], [(2, 0), (2, 0)], [(2, 2), (2, 4)], [(1, 10), (2, 0)],
    [(0, 10)], [(2, 0), (2, 5)], [(2, 1), (2, 10)], [(1, 10), (2, 5)], [(2, 2), (2, 9)], [(2, 2), (2, 6)],
    [(0, 6), (1, 7)], [(0, 6), (0, 10)], [(0, 6), (0, 0)],
]
START = 10


def reference(name):
    """Path of a file of the reference set."""
    folder = os.environ.get("DYNOCAL_REFERENCE_DIR")
    if not folder:
        sys.exit("error: DYNOCAL_REFERENCE_DIR is not set: it names the folder with the reference inputs")
    return pathlib.Path(folder, "reference", name)


def table(name):
    """A CSV file of the reference set, N x columns; a first line without numbers is a header."""
    path = reference(name)
    first = path.read_text(encoding="utf-8").split("\n", 1)[0]
    header = any(c.isalpha() and c not in "eE" for c in first)
    return np.genfromtxt(path, delimiter=",", skip_header=int(header))


def ours(what, problem):
    """Runs our program on the same problem and gives back what it printed."""
    subprocess.run(["cargo", "build", "--quiet", "--release", "--workspace", "--example", "peer"],
                   cwd=ROOT, check=True)
    target = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder, "problem.json")
        path.write_text(json.dumps(problem, default=lambda a: a.tolist()), encoding="utf-8")
        done = subprocess.run([target / "release/examples/peer", what, path], check=True, stdout=subprocess.PIPE)
    return json.loads(done.stdout)


def measure(work, least=LEAST_CPU_S):
    """CPU time in s of one call of `work` (mean over at least `least` seconds), and its result."""
    result = work()
    calls, batch, before = 0, 1, time.process_time()
    while True:
        for _ in range(batch):
            result = work()
        calls += batch
        spent = time.process_time() - before
        if spent >= least:
            return spent / calls, result
        batch *= 4 if spent < 0.1 * least else 1


def factors(term, value):
    """Product of the factors of one regressor; `value(input, lag)` gives a factor."""
    product = 1.0
    for channel, lag in term:
        product = product * value(channel, lag)
    return product


class Verdict:
    """Lines of one comparison: what was asked, found, and whether it holds."""

    def __init__(self, title, options):
        self.bad = 0
        versions = ", ".join(f"{m.__name__} {m.__version__}" for m in map(sys.modules.get, ("numpy", "scipy", "casadi"))
                             if m is not None)
        print(f"\n== {title}\n   python {platform.python_version()}, {versions}; one thread, CPU seconds")
        print(f"   peer options: {options}")

    def row(self, name, seconds, against=None):
        ratio = "" if against is None else f"   ours / peer = {against / seconds:.3g}"
        print(f"   {name:58} {seconds:12.6f} s{ratio}")

    def check(self, what, holds, found):
        self.bad += not holds
        print(f"   {'holds' if holds else 'MISSED'}: {what} (found {found})")

    def end(self):
        sys.exit(1 if self.bad else 0)
