#!/usr/bin/env python3
"""Free run and sensitivities of eq. (4.17): NumPy with SciPy's filter, a plain NumPy recursion, CasADi mapaccum."""

from common import LOWER, REGRESSORS, START, THETA, UPPER, Verdict, factors, measure, ours  # noqa: I001

import casadi as ca
import numpy as np
import scipy
import scipy.signal

P, LAG = len(THETA), 10
DENOMINATOR = np.r_[1.0, np.zeros(LAG - 1), -THETA[-1]]


def regressors(u):
    """Regressors 1 to 22 for t = START.., one row each."""
    n = len(u)
    columns = [np.ones(n - START)]
    columns += [factors(term, lambda c, lag: u[START - lag:n - lag, c]) for term in REGRESSORS[1:]]
    return np.column_stack(columns)


def by_filter(u):
    """The output recursion has one lag, so both recursions are one filter over all columns."""
    n, phi = len(u), regressors(u)
    y, s = np.zeros(n), np.zeros((n, P))
    y[START:] = scipy.signal.lfilter([1.0], DENOMINATOR, phi @ THETA[:-1])
    phi = np.column_stack([phi, y[:n - LAG]])
    s[START:] = scipy.signal.lfilter([1.0], DENOMINATOR, phi, axis=0)
    return y, s


def by_blocks(u):
    """Recursion in blocks of the output lag: everything inside a block is one vector operation."""
    n, phi, a = len(u), regressors(u), THETA[-1]
    y, s, x = np.zeros(n), np.zeros((n, P)), phi @ THETA[:-1]
    for t in range(START, n, LAG):
        e = min(t + LAG, n)
        y[t:e] = x[t - START:e - START] + a * y[t - LAG:e - LAG]
        s[t:e, :-1] = phi[t - START:e - START]
        s[t:e, -1] = y[t - LAG:e - LAG]
        s[t:e] += a * s[t - LAG:e - LAG]
    return y, s


def casadi_function(n):
    """mapaccum over blocks of ten samples; the state is the last ten rows of output and sensitivities."""
    state, theta = ca.SX.sym("state", LAG, P + 1), ca.DM(THETA)
    window = ca.SX.sym("window", 2 * LAG, 3)
    rows = []
    for k in range(LAG):
        phi = [factors(term, lambda c, lag: window[LAG + k - lag, c]) for term in REGRESSORS]
        y = ca.dot(ca.vertcat(*phi), theta[:-1]) + theta[-1] * state[k, 0]
        s = ca.horzcat(*phi, state[k, 0]) + theta[-1] * state[k, 1:]
        rows.append(ca.horzcat(y, s))
    step = ca.Function("step", [state, window], [ca.densify(ca.vertcat(*rows))])
    blocks = (n - START) // LAG
    run = step.mapaccum(blocks)
    buffers, call = run.buffer()
    # CasADi is column-major: these arrays are the transposes of what it sees.
    start, out = np.zeros((P + 1, LAG)), np.zeros((blocks, P + 1, LAG))
    windows = np.zeros((blocks, 3, 2 * LAG))
    buffers.set_arg(0, memoryview(start))
    buffers.set_arg(1, memoryview(windows))
    buffers.set_res(0, memoryview(out))

    def evaluate(u):
        for b in range(blocks):
            windows[b] = u[b * LAG:b * LAG + 2 * LAG].T
        call()
        both = np.zeros((n, P + 1))
        both[START:] = out.transpose(0, 2, 1).reshape(-1, P + 1)
        return both[:, 0], both[:, 1:]

    evaluate.keep = (run, buffers, start)  # the buffers hold bare addresses
    return evaluate


def main():
    verdict = Verdict("Simulation and sensitivities of eq. (4.17), 23 parameters",
                      "lfilter over all columns; recursion in vectorised blocks; mapaccum of an SX step of ten samples")
    for n in (100, 1000):
        u = np.random.default_rng(1).uniform(LOWER, UPPER, (n, 3))
        mine = ours("sensitivities", {"u": u.ravel()})
        y, s = np.array(mine["y"]), np.array(mine["s"]).reshape(n, P)
        own = mine["time"]["cpu_s"]
        print(f"   {n} samples")
        verdict.row("dynocal", own)
        times = []
        for name, peer in (("NumPy + SciPy lfilter", by_filter), ("NumPy recursion in blocks", by_blocks),
                           ("CasADi mapaccum", casadi_function(n))):
            seconds, (yp, sp) = measure(lambda: peer(u))
            times.append(seconds)
            verdict.row(name, seconds, own)
            mine_all, peer_all = np.column_stack([y, s]), np.column_stack([yp, sp])
            worst = (np.abs(mine_all - peer_all).max(axis=0) / np.abs(peer_all).max(axis=0)).max()
            verdict.check("equal to 1e-12 of each column", worst <= 1e-12, f"{worst:.1e}")
        verdict.check("no slower than the fastest peer", own <= min(times), f"{own / min(times):.3g} of its time")
    verdict.end()


if __name__ == "__main__":
    main()
