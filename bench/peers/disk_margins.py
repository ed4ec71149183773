#!/usr/bin/env python3
"""Disk margins: python-control with Slycot (AB13MD) on the same loops in the same run, in its own environment (`.venv-control`, `setup.sh`).

The published loops to 1e-6, then ten coupled sampled loops with delay (as powers of z^-1) out of the 25 set points with 100 draws
that our side judges whole: gain margins of each loop with the other closed and the disk margin of both outputs.
"""

import json
import os
import pathlib
import subprocess
import sys
import time

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "RAYON_NUM_THREADS"):
    os.environ[name] = "1"

import control
import numpy as np
import slycot  # noqa: F401  without it python-control has no upper bound for several loops

ROOT = pathlib.Path(__file__).resolve().parents[2]
DT = 0.05


def ours():
    run = ["cargo", "run", "--quiet", "--release", "-p", "dynocal-control", "--example", "control_peer"]
    subprocess.run(run[:1] + ["build"] + run[2:], cwd=ROOT, check=True)
    before = os.times()
    found = json.loads(subprocess.run(run, cwd=ROOT, check=True, capture_output=True, text=True).stdout)
    after = os.times()
    # All that the children took, cargo's start included: other processes on the machine do not count.
    found["cpu_s"] = after.children_user + after.children_system - before.children_user - before.children_system
    return found


def published():
    s = control.tf("s")
    third = control.ss(25 / (s**3 + 10 * s**2 + 10 * s + 10))
    satellite = control.ss([[0, 10], [-10, 0]], np.eye(2), [[1, 10], [-10, 1]], np.zeros((2, 2)))
    better = satellite * control.ss([], [], [], [[1, -2], [0, 1]])
    return {"third": third, "satellite": satellite, "better": better}


def sampled(plant):
    rows = []
    for row in range(2):
        cells = []
        for col in range(2):
            g = plant[2 * row + col]
            n = max(len(g["num"]), len(g["den"]))
            pad = lambda c: list(c) + [0.0] * (n - len(c))  # powers of z^-1 to powers of z
            cells.append(control.tf(pad(g["num"]), pad(g["den"]), DT))
        rows.append(cells)
    pi = [control.tf([kp + ki * DT, -kp], [1, -1], DT) for kp, ki in [(0.3, 0.9), (0.25, 0.7)]]
    return [[rows[r][c] * pi[c] for c in range(2)] for r in range(2)]


def response(loop, omega):
    x = np.exp(1j * omega * DT)
    return np.array([[[loop[r][c](v) for c in range(2)] for r in range(2)] for v in x])


def alpha_of(l, omega):
    """Upper bound by AB13MD at each frequency, as disk_margins does it."""
    worst = 0.0
    for at in l:
        s = np.linalg.inv(np.eye(2) + at)
        worst = max(worst, slycot.ab13md(s - 0.5 * np.eye(2), np.array([1, 1]), np.array([2, 2]))[0])
    return 1 / worst


def main():
    mine = ours()
    missed = False
    start = time.process_time()
    for name, loop in published().items():
        for skew in (0.0, 1.0, -1.0):
            omega = np.logspace(-4, 4, 20000) if name != "third" else np.logspace(-1, 1.2, 20000)
            theirs = float(np.min(control.disk_margins(loop, omega, skew=skew)[0]))
            own = mine[f"{name} {skew:g}"]
            # A grid of theirs gives a margin that is too large, never too small.
            apart = abs(own / theirs - 1)
            missed |= apart > 1e-6
            print(f"{name:10} skew {skew:+.0f}: ours {own:.8f}, theirs {theirs:.8f}, apart {apart:.1e}")
    print(f"published loops: ours {mine['published_s']:.3f} s, theirs {time.process_time() - start:.1f} s (20000 frequencies each)")
    start = time.process_time()
    omega = np.linspace(1e-3, np.pi / DT, 3000)
    for plant, own in zip(mine["plants"], mine["first"]):
        theirs = alpha_of(response(sampled(plant), omega), omega)
        if own is None:
            continue
        apart = abs(own / theirs - 1)
        missed |= apart > 1e-4 or own > theirs * (1 + 1e-6)
        print(f"sampled: ours {own:.8f}, theirs {theirs:.8f} on {len(omega)} frequencies, apart {apart:.1e}")
    each = (time.process_time() - start) / len(mine["plants"])
    print(f"sampled loops: ours {mine['loops']} with all their margins in {mine['cpu_s']:.2f} s of CPU on one thread (asked: 2 s), published loops "
          f"included, {mine['stable']} stable; theirs {each:.2f} s a loop for the disk margin alone")
    missed |= mine["cpu_s"] > 2.0
    sys.exit(1 if missed else 0)


if __name__ == "__main__":
    main()
