#!/usr/bin/env python3
"""Simulation-error estimation of eqs. (5.3), (5.4): SciPy's MINPACK with the exact Jacobian, from the least-squares start.

The free run starts from measured values; the cost is the mean squared error over samples 7..999.
"""

from common import Verdict, measure, ours, table  # noqa: I001

import numpy as np
import scipy
import scipy.optimize
import scipy.signal

START, OUTPUT_LAGS = 7, 4
# Regressors (input, lag) of eq. (5.3) after the constant; then y(t-1) .. y(t-4).
INPUTS = [(0, 5), (0, 6), (0, 7), (1, 1), (2, 5), (2, 6), (2, 7)]
ASKED_MSE = 0.501210980607983


def past(y, n):
    return np.column_stack([y[START - k:n - k] for k in range(1, OUTPUT_LAGS + 1)])


class Peer:
    def __init__(self, u, z):
        n = len(z)
        self.u, self.z, self.n = u, z, n
        self.known = np.column_stack([np.ones(n - START)] + [u[START - k:n - k, c] for c, k in INPUTS])

    def free_run(self, theta):
        denominator = np.r_[1.0, -theta[-OUTPUT_LAGS:]]
        before = scipy.signal.lfiltic([1.0], denominator, self.z[START - 1:START - 1 - OUTPUT_LAGS:-1])
        y = self.z.copy()
        y[START:] = scipy.signal.lfilter([1.0], denominator, self.known @ theta[:-OUTPUT_LAGS], zi=before)[0]
        return y, denominator

    def error(self, theta):
        return self.free_run(theta)[0][START:] - self.z[START:]

    def jacobian(self, theta):
        y, denominator = self.free_run(theta)
        return scipy.signal.lfilter([1.0], denominator, np.column_stack([self.known, past(y, self.n)]), axis=0)

    def estimate(self):
        phi = np.column_stack([self.known, past(self.z, self.n)])
        start = np.linalg.lstsq(phi, self.z[START:], rcond=None)[0]
        return scipy.optimize.least_squares(self.error, start, self.jacobian, method="lm", x_scale="jac",
                                            ftol=1e-10, xtol=1e-10, gtol=1e-10)


def main():
    record = table("estimation_inputs/ch5_ident.csv")
    u, z = record[:, :3], record[:, 4]
    peer = Peer(u, z)
    verdict = Verdict("Simulation-error estimation of eqs. (5.3), (5.4), 1000 samples, 12 parameters",
                      "least_squares method lm, x_scale jac, ftol = xtol = gtol = 1e-10, exact Jacobian by lfilter")
    mine = ours("estimation", {"u": u.ravel(), "y": z})
    own = mine["time"]["cpu_s"]
    seconds, found = measure(peer.estimate)
    mse = [float(np.mean(peer.error(np.array(theta)) ** 2)) for theta in (mine["theta"], found.x)]
    verdict.row(f"dynocal ({mine['evaluations']} evaluations)", own)
    verdict.row(f"SciPy MINPACK ({found.nfev} evaluations)", seconds, own)
    for name, value in zip(("dynocal", "SciPy"), mse):
        print(f"   {name}: mean squared error {value:.15f}")
    verdict.check(f"MSE <= {ASKED_MSE} (1 + 1e-9)", mse[0] <= ASKED_MSE * (1 + 1e-9), f"{mse[0]:.15f}")
    verdict.check("MSE no worse than the peer's by more than 1e-9", mse[0] <= mse[1] * (1 + 1e-9), f"{mse[0] / mse[1] - 1:.1e}")
    verdict.check("at most 10 evaluations", mine["evaluations"] <= 10, mine["evaluations"])
    verdict.check("at most 0.3 of the peer's time", own <= 0.3 * seconds, f"{own / seconds:.3g} of its time")
    verdict.end()


if __name__ == "__main__":
    main()
