#!/usr/bin/env python3
"""Orthogonal forward regression of ten terms: sysidentpy's FROLS, in one thread, where it can hold the candidate matrix.

Candidates are all products up to a degree of ten lags of the input and ten of the output. The largest case, 25 000
samples, would be a matrix of 2.1 GB: ours alone, wall time on all processors.
"""

from common import Verdict, measure, ours  # noqa: I001

import os
import time

import numpy as np
import sysidentpy  # noqa: F401
from sysidentpy.basis_function import Polynomial
from sysidentpy.model_structure_selection import FROLS
from sysidentpy.parameter_estimation import LeastSquares

LAGS, TERMS = 10, 10
RATIO, WALL_S = 0.02, 2.0


def record(n):
    """A resonance with cubic stiffness and a product with the input; equation noise."""
    rng = np.random.default_rng(7)
    u, e, y = rng.uniform(-1, 1, n), 0.05 * rng.standard_normal(n), np.zeros(n)
    for t in range(2, n):
        y[t] = (1.2 * y[t - 1] - 0.5 * y[t - 2] + 0.4 * u[t - 1] - 0.1 * y[t - 1] ** 3
                + 0.1 * u[t - 2] * y[t - 2] + e[t])
    return u, y


def peer(u, y, degree):
    model = FROLS(order_selection=False, n_terms=TERMS, ylag=LAGS, xlag=LAGS, basis_function=Polynomial(degree=degree),
                  estimator=LeastSquares())
    model.fit(X=u.reshape(-1, 1), y=y.reshape(-1, 1))
    return model


def text(codes):
    """sysidentpy's code of a term (1000 + lag: output, 2000 + lag: input) in our writing."""
    channels = sorted((("u" if code >= 2000 else "y"), int(code % 1000)) for code in codes if code)
    parts = []
    for key in dict.fromkeys(channels):
        power = channels.count(key)
        parts.append(f"{key[0]}(t-{key[1]})" + (f"^{power}" if power > 1 else ""))
    return "*".join(parts) or "1"


def compare(verdict, n, degree):
    u, y = record(n)
    mine = ours("selection", {"u": u, "y": y, "lags": LAGS, "degree": degree, "terms": TERMS})
    seconds, found = measure(lambda: peer(u, y, degree))
    own = mine["time"]["cpu_s"]
    size = f"{mine['candidates']} candidates, {n} samples"
    verdict.row(f"dynocal, {size}", own)
    verdict.row(f"sysidentpy, {size}", seconds, own)
    theirs = [text(codes) for codes in found.final_model]
    verdict.check(f"the same {TERMS} terms in the same order, {size}", theirs == mine["regressors"], mine["regressors"])
    worst = np.max(np.abs(found.err[:TERMS] - mine["err"]) / mine["err"])
    verdict.check("error reduction ratios within 1e-6", worst < 1e-6, f"{worst:.1e}")
    verdict.check(f"at most {RATIO} of its time", own <= RATIO * seconds, f"{own / seconds:.3g}")


def large(verdict):
    u, y = record(25_000)
    os.environ.pop("RAYON_NUM_THREADS")
    problem = {"u": u, "y": y, "lags": LAGS, "degree": 4, "terms": TERMS}
    ours("selection", problem)
    before = time.perf_counter()
    mine = ours("selection", problem)
    # What the program repeats, start, reading and its own check of the build are in it.
    calls = mine["time"]["calls"] + 1
    wall = (time.perf_counter() - before) / calls
    verdict.row(f"dynocal, {mine['candidates']} candidates, 25000 samples, CPU", mine["time"]["cpu_s"])
    verdict.check(f"at most {WALL_S} s wall on {os.cpu_count()} processors", wall <= WALL_S, f"{wall:.3g} s")


def main():
    verdict = Verdict("Orthogonal forward regression, ten terms of ten and ten lags",
                      f"sysidentpy {sysidentpy.__version__}, FROLS, order_selection off, least squares")
    compare(verdict, 2000, 3)
    compare(verdict, 2000, 4)
    large(verdict)
    verdict.end()


if __name__ == "__main__":
    main()
