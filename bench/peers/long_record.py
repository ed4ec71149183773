#!/usr/bin/env python3
"""The fuel task over ever longer records in one batch: time, memory and how they grow. The record is repeated, one thread."""

from common import Verdict, ours, table  # noqa: I001

import numpy as np

from fuel import BOUNDS, FIRST, LAMBDA, RATE, TORQUE

SAMPLES = (2000, 5000, 10000, 20000)
ASKED_S, ASKED_GIB, ASKED_GROWTH = 10.0, 2.0, 1.15


def main():
    record = table("estimation_inputs/engine_opt.csv")
    torque, lambda_ = table("estimation_inputs/poly_T_sem.csv"), table("estimation_inputs/poly_lambda_sem.csv")
    verdict = Verdict("Fuel over up to 20 000 samples (600 s) in one batch, |dSA| <= 1 deg", "no peer")
    seconds, last = [], 0.0
    for n in SAMPLES:
        rows = np.tile(record, (-(-n // len(record)), 1))[:n]
        found = ours("fuel", {
            "u": rows[:, :4].ravel(), "first": FIRST, "rate": RATE, "bounds": BOUNDS,
            "torque": {"regressors": TORQUE, "theta": torque, "y": rows[:, 4]},
            "lambda": {"regressors": LAMBDA, "theta": lambda_, "y": rows[:, 5]},
        })
        seconds.append(found["time"]["cpu_s"])
        last = found["peak_gib"]
        verdict.row(f"{n} samples, {found['status']}, {found['iterations']} iterations, {last:.2f} GiB",
                    seconds[-1])
        verdict.check("solved", found["status"] == "Converged", found["status"])
    # Iterations differ from record to record: growth is that of the time by length.
    growth = np.polyfit(np.log(SAMPLES), np.log(seconds), 1)[0]
    verdict.check(f"20 000 samples within {ASKED_S} s of CPU time", seconds[-1] <= ASKED_S, f"{seconds[-1]:.2f} s")
    verdict.check(f"within {ASKED_GIB} GiB of memory", last <= ASKED_GIB, f"{last:.2f} GiB")
    verdict.check(f"time grows at most as n^{ASKED_GROWTH}", growth <= ASKED_GROWTH, f"n^{growth:.2f}")
    verdict.end()


if __name__ == "__main__":
    main()
