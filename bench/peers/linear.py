#!/usr/bin/env python3
"""Prediction-error estimation of ARX, ARMAX, OE and BJ models: SciPy's MINPACK with the exact gradient, and SIPPY.

Records and orders are those of `part2` of the reference numbers, each peer in its own environment (SIPPY pins an older
NumPy: `setup.sh` makes `.venv-sippy`). SciPy gets the least-squares start and the gradient by `lfilter`; SIPPY its own.
"""

from common import Verdict, measure, ours, reference, table  # noqa: I001

import json
import pathlib
import subprocess

import numpy as np
import scipy
import scipy.optimize
from scipy.signal import lfilter

# Orders na, nb, nc, nd, nf and the delay of each case.
CASES = {
    "arx1": (2, 2, 0, 0, 0, 1), "arx2": (3, 2, 0, 0, 0, 3), "armax1": (2, 2, 2, 0, 0, 1), "armax2": (1, 2, 1, 0, 0, 2),
    "oe1": (0, 2, 0, 0, 2, 1), "bj1": (0, 2, 1, 1, 2, 1), "cl_arx": (2, 2, 0, 0, 0, 1), "cl_oe": (0, 2, 0, 0, 2, 1),
    "firarma": (0, 2, 1, 1, 0, 1), "arma1": (0, 0, 1, 2, 0, 1),
}
SIPPY = pathlib.Path(__file__).resolve().parent / ".venv-sippy/bin/python"


class Peer:
    """eps = D/C (A y - B/F u) and its gradient."""

    def __init__(self, u, y, orders):
        self.u, self.y = u, y
        self.na, self.nb, self.nc, self.nd, self.nf, self.nk = orders

    def polynomials(self, theta):
        ends = np.cumsum([self.na, self.nb, self.nc, self.nd])
        a, b, c, d, f = np.split(theta, ends)
        one = [1.0]
        return (np.r_[one, a], np.r_[np.zeros(self.nk), b] if self.nb else np.zeros(1), np.r_[one, c], np.r_[one, d],
                np.r_[one, f])

    def signals(self, theta):
        a, b, c, d, f = polynomials = self.polynomials(theta)
        w = lfilter(b, f, self.u)
        x = lfilter(a, 1.0, self.y) - w
        return polynomials, w, x, lfilter(d, c, x)

    def error(self, theta):
        return self.signals(theta)[3]

    def jacobian(self, theta):
        (a, b, c, d, f), w, x, eps = self.signals(theta)
        n = len(self.y)
        jac = np.zeros((n, len(theta)))
        groups = []
        if self.na:
            groups.append((lfilter(d, c, self.y), 1, self.na))
        if self.nb:
            groups.append((-lfilter(d, np.convolve(c, f), self.u), self.nk, self.nb))
        if self.nc:
            groups.append((-lfilter([1.0], c, eps), 1, self.nc))
        if self.nd:
            groups.append((lfilter([1.0], c, x), 1, self.nd))
        if self.nf:
            groups.append((lfilter(d, np.convolve(c, f), w), 1, self.nf))
        k = 0
        for signal, first, count in groups:
            for lag in range(first, first + count):
                jac[lag:, k] = signal[:n - lag]
                k += 1
        return jac

    def least_squares_start(self):
        """A (or F) and B by least squares, nothing of the noise model."""
        poles = self.na or self.nf
        n, lag = len(self.y), max(self.na, self.nf, self.nk + self.nb - 1 if self.nb else 0)
        columns = [-self.y[lag - j:n - j] for j in range(1, poles + 1)]
        columns += [self.u[lag - self.nk - j:n - self.nk - j] for j in range(self.nb)]
        theta = np.zeros(self.na + self.nb + self.nc + self.nd + self.nf)
        if columns:
            found = np.linalg.lstsq(np.column_stack(columns), self.y[lag:], rcond=None)[0]
            theta[:self.na] = found[:self.na]
            theta[self.na:self.na + self.nb] = found[poles:]
            if self.nf:
                theta[-self.nf:] = found[:self.nf]
        return theta

    def estimate(self):
        return scipy.optimize.least_squares(self.error, self.least_squares_start(), self.jacobian, method="lm",
                                            x_scale="jac", ftol=1e-12, xtol=1e-12, gtol=1e-12)


SIPPY_SCRIPT = """
import contextlib, io, json, sys, time, warnings
import numpy as np
warnings.filterwarnings("ignore")
from sippy_unipi import system_identification
problem = json.load(sys.stdin)
u, y = np.array(problem["u"]), np.array(problem["y"])
na, nb, nc, nd, nf, nk = problem["orders"]
kind = problem["kind"]
orders = {"ARX": [na, nb, nk], "ARMAX": [na, nb, nc, nk], "OE": [nb, nf, nk], "BJ": [nb, nc, nd, nf, nk]}[kind]
def run():
    with contextlib.redirect_stdout(io.StringIO()):
        return system_identification(y, u, kind, **{kind + "_orders": orders})
run()
before, calls = time.process_time(), 0
while calls < 2 or time.process_time() - before < 0.5:
    model = run()
    calls += 1
print(json.dumps({"cpu_s": (time.process_time() - before) / calls}))
"""
KINDS = {"arx1": "ARX", "arx2": "ARX", "cl_arx": "ARX", "armax1": "ARMAX", "armax2": "ARMAX", "oe1": "OE", "cl_oe": "OE",
         "bj1": "BJ"}


def sippy(case, orders, u, y):
    """CPU seconds of SIPPY, or the reason why there are none."""
    if case not in KINDS:
        return "has no such structure"
    if not SIPPY.exists():
        return "not installed (setup.sh)"
    problem = {"u": u.tolist(), "y": y.tolist(), "orders": orders, "kind": KINDS[case]}
    done = subprocess.run([SIPPY, "-c", SIPPY_SCRIPT], input=json.dumps(problem), text=True, capture_output=True)
    return json.loads(done.stdout)["cpu_s"] if done.returncode == 0 else done.stderr.strip().splitlines()[-1]


def main():
    verdict = Verdict("Prediction error of ARX, ARMAX, OE, BJ models, 2000 samples, from the least-squares start",
                      "least_squares method lm, x_scale jac, ftol = xtol = gtol = 1e-12, exact gradient by lfilter; "
                      "SIPPY 1.0.1 with its defaults")
    stored = json.loads(reference("estimation_fuel_reference.json").read_text(encoding="utf-8"))["part2"]
    total, of_scipy, of_sippy, beside_sippy = 0.0, 0.0, 0.0, 0.0
    for case, orders in CASES.items():
        record = table(f"estimation_inputs/lin_{case}.csv")
        u, y = record[:, 0], record[:, 1]
        peer = Peer(u, y, orders)
        mine = ours("linear", {"u": u, "y": y, "orders": orders})
        own = mine["time"]["cpu_s"]
        seconds, found = measure(peer.estimate)
        other = sippy(case, orders, u, y)
        verdict.row(f"{case}: dynocal ({mine['evaluations']} evaluations)", own)
        verdict.row(f"{case}: SciPy MINPACK ({found.nfev} evaluations)", seconds, own)
        if isinstance(other, float):
            verdict.row(f"{case}: SIPPY", other, own)
            of_sippy += other
            beside_sippy += own
        else:
            print(f"   {case}: SIPPY {other}")
        total += own
        of_scipy += seconds
        # Judged from the parameters, by the peer's own errors.
        cost = float(np.mean(peer.error(np.array(mine["theta"])) ** 2))
        best = min(stored[case]["pem"]["V"], float(np.mean(peer.error(found.x) ** 2)))
        verdict.check(f"{case}: cost <= the best of reference and SciPy (1 + 1e-8)", cost <= best * (1 + 1e-8),
                      f"{cost / best - 1:.1e}")
    verdict.row("all cases: dynocal", total)
    verdict.check("all cases: at most 0.3 of SciPy", total <= 0.3 * of_scipy, f"{total / of_scipy:.3g}")
    if of_sippy > 0:
        verdict.check("all cases it has: at most 0.02 of SIPPY", beside_sippy <= 0.02 * of_sippy,
                      f"{beside_sippy / of_sippy:.3g}")
    verdict.end()


if __name__ == "__main__":
    main()
