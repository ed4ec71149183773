#!/usr/bin/env python3
"""The Python package beside SysIdentPy: Silverbox, Cascaded Tanks, EMPS, with the splits and the error measure (free-run RMSE after the
initial window) of nonlinear_benchmarks. Both get the same lags, the same degree and the same records; each selects its terms by its own
orthogonal forward regression, the number of terms (ours: and least squares of one step or of the free run) being what runs best on the
last quarter of the estimation record. The test records are used once, at the end.

Then the price of the binding: a free run over 1e6 samples and a short call from arrays, against the same run of a record that the core
holds already.

    bench/peers/.venv-python/bin/python bench/peers/python_sysidentpy.py    # that environment has the wheel and SysIdentPy
"""

import os

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"

import inspect
import pathlib
import sys
import time
import warnings

import numpy as np
import sysidentpy
from sysidentpy.basis_function import Polynomial
from sysidentpy.model_structure_selection import FROLS
from sysidentpy.parameter_estimation import LeastSquares

import dynocal

TERMS = (5, 10, 15, 20)
FOLDER = pathlib.Path(os.environ.get("DYNOCAL_REFERENCE_DIR", ".")) / "data" / "sysid"

# Name, estimation file and columns, tests, initial samples, lags of output and input, degree, factor to the unit of the error.
CASES = [
    ("Silverbox", ("silverbox_train.parquet", "u", "y"), [
        ("multisine", "silverbox_test_multisine.parquet", "u", "y"),
        ("arrow", "silverbox_test_arrow_full.parquet", "u", "y"),
        ("arrow, no extrapolation", "silverbox_test_arrow_no_extrap.parquet", "u", "y"),
    ], 50, 3, 3, 3, 1e3, "mV", 0.0016384),
    ("Cascaded Tanks", ("cascaded_tanks.csv.gz", "uEst", "yEst"), [
        ("test", "cascaded_tanks.csv.gz", "uVal", "yVal"),
    ], 5, 4, 4, 2, 1.0, "V", 4.0),
    ("EMPS", ("emps_train.parquet", "vir", "qm"), [
        ("test", "emps_test.parquet", "vir", "qm"),
    ], 20, 4, 4, 1, 1e3, "mm", 0.001),
]


def record(file, u, y, ts_s):
    return dynocal.read(FOLDER / file, {"u": u, "y": y}, ts_s=ts_s, outputs="y")


def rmse(y, run, first):
    error = y[first:] - run[first:]
    return float(np.sqrt(np.mean(error**2))) if np.isfinite(error).all() else float("inf")


def ours(train, tests, ylag, xlag, degree, terms, first, estimator):
    model = dynocal.Narx(ylag=ylag, xlag=xlag, degree=degree, terms=terms, estimator=estimator).fit(train)
    return [rmse(t["y"], model.simulate(t["u"], y0=t["y"][:first]), first) for t in tests]


def peer(train, tests, ylag, xlag, degree, terms, first, estimator):
    model = FROLS(order_selection=False, n_terms=terms, ylag=ylag, xlag=xlag, basis_function=Polynomial(degree=degree), estimator=estimator)
    model.fit(X=train["u"].reshape(-1, 1), y=train["y"].reshape(-1, 1))
    runs = []
    for t in tests:
        lag = model.max_lag
        whole = model.predict(X=t["u"][first - lag:].reshape(-1, 1), y=t["y"][first - lag:first].reshape(-1, 1))
        runs.append(rmse(t["y"][first:], np.asarray(whole).ravel()[lag:], 0))
    return runs


def lines(function):
    return len([line for line in inspect.getsource(function).splitlines()[1:] if line.strip()])


def chosen(side, train, size, first, estimator):
    """The number of terms that runs best on the last quarter of the estimation record."""
    part, held = train.split(fraction=0.75)
    ylag, xlag, degree = size
    found = {}
    for terms in TERMS:
        try:
            found[terms] = side(part, [held], ylag, xlag, degree, terms, first, estimator)[0]
        except Exception as error:  # A model that cannot be run is no candidate, on either side.
            print(f"    {terms} terms: {type(error).__name__}: {str(error)[:90]}")
    terms = min(found, key=lambda k: (found[k], k))
    return terms, found[terms]


def compare():
    sides = [
        ("dynocal, ols", ours, "ols"),
        ("dynocal, sem", ours, "sem"),
        ("SysIdentPy, FROLS", peer, LeastSquares()),
    ]
    met = True
    for case, (file, u, y), tests, first, ylag, xlag, degree, factor, unit, ts_s in CASES:
        train = record(file, u, y, ts_s)
        records = [record(f, cu, cy, ts_s) for _, f, cu, cy in tests]
        print(f"\n{case}: {len(train)} samples, lags {ylag} and {xlag}, degree {degree}")
        errors, held = {}, {}
        for name, side, estimator in sides:
            terms, held[name] = chosen(side, train, (ylag, xlag, degree), first, estimator)
            start = time.perf_counter()
            found = side(train, records, ylag, xlag, degree, terms, first, estimator)
            took = time.perf_counter() - start
            errors[name] = found
            text = ", ".join(f"{label} {factor * e:.4g} {unit}" for (label, *_), e in zip(tests, found, strict=True))
            print(f"  {name:18} {terms:3} terms  {text}  fit and runs {took:.2f} s, {lines(side)} lines")
        taken = min(("dynocal, ols", "dynocal, sem"), key=lambda name: held[name])
        worse = [t[0] for t, a, b in zip(tests, errors[taken], errors["SysIdentPy, FROLS"], strict=True) if a > 1.001 * b]
        print(f"  the held-out quarter takes {taken}: no worse on every test: {not worse}" + (f" (worse: {', '.join(worse)})" if worse else ""))
        same = [a <= 1.001 * b for a, b in zip(errors["dynocal, ols"], errors["SysIdentPy, FROLS"], strict=True)]
        print(f"  by least squares of one step no worse on every test (asked): {all(same)}")
        met &= all(same)
    return met


def least_s(calls, repeats):
    """Least time of each call, in turns: what else the machine does makes a call longer, never shorter."""
    least = [np.inf] * len(calls)
    for _ in range(repeats):
        for k, call in enumerate(calls):
            start = time.perf_counter()
            call()
            least[k] = min(least[k], time.perf_counter() - start)
    return least


def binding():
    """What a call costs beyond the computation: a run over 1e6 samples against the same record inside of the core, and a short call."""
    u = np.random.default_rng(1).standard_normal(1_000_000)
    y = np.zeros_like(u)
    for t in range(2, 2000):
        y[t] = 1.5 * y[t - 1] - 0.7 * y[t - 2] + u[t - 1]
    model = dynocal.Narx(ylag=2, xlag=4, degree=3).fit(u[:2000], y[:2000], ts_s=0.01).model_
    inner = model._models[0]
    held = dynocal.Dataset({"u": u}, ts_s=0.01)
    whole, core = least_s([lambda: model.simulate(u), lambda: inner.simulate(held._record, "rest")], 15)
    short, held_short = u[:10].copy(), dynocal.Dataset({"u": u[:10]}, ts_s=0.01)
    call, inside = least_s([lambda: model.simulate(short), lambda: inner.simulate(held_short._record, "rest")], 5001)
    over, extra = 100 * (whole / core - 1), 1e6 * (call - inside)
    print(f"\nfree run of 1e6 samples, {len(model.parameters)} terms: {1e3 * whole:.1f} ms, of a record in the core {1e3 * core:.1f} ms: {over:.1f} % more")
    print(f"a call over 10 samples: {1e6 * call:.1f} us, of a record in the core {1e6 * inside:.1f} us: {extra:.1f} us more")
    return over < 5.0 and extra < 20.0


def main():
    warnings.filterwarnings("ignore")
    print(f"dynocal {dynocal.__version__}, SysIdentPy {sysidentpy.__version__}, {os.cpu_count()} processors")
    good = [compare(), binding()]
    print("\ndemands:", "met" if all(good) else "MISSED")
    sys.exit(0 if all(good) else 1)


if __name__ == "__main__":
    main()
