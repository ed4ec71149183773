#!/usr/bin/env python3
"""A whole map as one program beside SciPy: 20 x 10 cells, six inputs, five limits in each cell, smoothness between neighbours.

    minimise    mean_k m(x_k) / |m(start_k)| + rho / 2 sum_pairs |u_k - u_j|^2,   rho = smooth / pairs
    subject to  r_l(x_k) <= upper_l, 0 <= u <= 1

All responses are quadratic functions of two axes and six inputs, so that both sides have the same functions with exact
derivatives. Peer: `minimize` with `trust-constr`, its Jacobian and Hessians sparse.

Then the same map on what a day gives: Gaussian processes that were learnt from 90 noisy points, limits with 1.28 standard deviations and
half of one on what is minimised. No peer; the time is ours alone, the true responses judge.
"""

from common import Verdict, measure, ours  # noqa: F401, I001

import time

import numpy as np
import scipy
from scipy.optimize import Bounds, NonlinearConstraint, minimize
from scipy.sparse import block_diag, coo_array, csr_array

ROWS, COLUMNS, AXES, FREE, LIMITS, SMOOTH = 20, 10, 2, 6, 5, 0.05
DIM = AXES + FREE
CELLS = ROWS * COLUMNS


def problem():
    """One valley whose floor moves with the axes, and five curved limits that cut it for many cells."""
    rng = np.random.default_rng(1)
    # (u - o)' K (u - o) with o = o0 + O a: a quadratic of (a, u).
    o0, slope = rng.uniform(0.3, 0.7, FREE), rng.uniform(-0.4, 0.4, (FREE, AXES))
    root = rng.normal(size=(FREE, FREE)) * 0.5
    curve = root @ root.T + 0.3 * np.eye(FREE)
    join = np.hstack([-slope, np.eye(FREE)])
    fuel = {"constant": 4.0 + o0 @ curve @ o0, "hessian": 2 * join.T @ curve @ join, "gradient": -2 * join.T @ curve @ o0}
    fuel["gradient"][0] += 6.0
    responses, upper = [fuel], []
    places = np.array([[i / (ROWS - 1), j / (COLUMNS - 1)] for i in range(ROWS) for j in range(COLUMNS)])
    best = np.hstack([places, np.clip(o0 + places @ slope.T, 0, 1)])
    for _ in range(LIMITS):
        g = rng.normal(size=DIM) * 0.5
        b = rng.normal(size=(DIM, 2)) * 0.4
        response = {"constant": 0.0, "gradient": g, "hessian": b @ b.T}
        values = best @ g + 0.5 * np.einsum("ki,ij,kj->k", best, response["hessian"], best)
        responses.append(response)
        # A quarter of the cells would pass it.
        upper.append(float(np.quantile(values, 0.75)))
    pairs = [(i * COLUMNS + j, (i + 1) * COLUMNS + j) for i in range(ROWS - 1) for j in range(COLUMNS)]
    pairs += [(i * COLUMNS + j, i * COLUMNS + j + 1) for i in range(ROWS) for j in range(COLUMNS - 1)]
    starts = np.hstack([places, np.full((CELLS, FREE), 0.5)])
    return responses, np.array(upper), np.array(pairs), starts


def value(response, x):
    return response["constant"] + x @ response["gradient"] + 0.5 * np.einsum("ki,ij,kj->k", x, response["hessian"], x)


def processes(responses, upper, pairs, starts):
    """The map on Gaussian processes of 90 points; time, and what the true responses say of it."""
    rng = np.random.default_rng(2)
    x = rng.uniform(size=(90, DIM))
    noisy = [value(r, x) * (1 + 0.003 * rng.normal(size=len(x))) for r in responses]
    flat = [{**r, "hessian": r["hessian"].ravel()} for r in responses]
    return ours("whole_map", {"responses": flat, "upper": upper, "dim": DIM, "axes": AXES, "starts": starts.ravel(), "pairs": pairs,
                              "smooth": SMOOTH, "points": x.ravel(), "values": noisy, "z": 1.28, "caution": 0.5})


class Program:
    """Objective, limits and their derivatives over the free inputs of all cells."""

    def __init__(self, responses, upper, pairs, starts):
        self.responses, self.upper, self.pairs, self.starts = responses, upper, pairs, starts
        self.share = 1 / (CELLS * np.abs(value(responses[0], starts)))
        self.rho = SMOOTH / len(pairs)
        rows = np.repeat(np.arange(len(pairs) * FREE), 2)
        columns = (pairs[:, :, None] * FREE + np.arange(FREE)).transpose(0, 2, 1).ravel()
        self.difference = csr_array((np.tile([1.0, -1.0], len(pairs) * FREE), (rows, columns)))
        smooth = self.rho * self.difference.T @ self.difference
        own = block_diag([s * responses[0]["hessian"][AXES:, AXES:] for s in self.share])
        self.second = csr_array(own + smooth)
        self.blocks = [r["hessian"][AXES:, AXES:] for r in responses]

    def full(self, u):
        return np.hstack([self.starts[:, :AXES], u.reshape(CELLS, FREE)])

    def objective(self, u):
        d = self.difference @ u
        return float(self.share @ value(self.responses[0], self.full(u)) + 0.5 * self.rho * d @ d)

    def gradient(self, u):
        r, x = self.responses[0], self.full(u)
        own = self.share[:, None] * (r["gradient"] + x @ r["hessian"])[:, AXES:]
        return own.ravel() + self.rho * self.difference.T @ (self.difference @ u)

    def limits(self, u):
        return np.column_stack([value(r, self.full(u)) for r in self.responses[1:]]).ravel()

    def jacobian(self, u):
        x = self.full(u)
        each = np.stack([(r["gradient"] + x @ r["hessian"])[:, AXES:] for r in self.responses[1:]], axis=1)
        rows = np.repeat(np.arange(CELLS * LIMITS), FREE)
        columns = (np.arange(CELLS)[:, None, None] * FREE + np.arange(FREE) + np.zeros((1, LIMITS, 1), int)).ravel()
        return csr_array(coo_array((each.ravel(), (rows, columns)), shape=(CELLS * LIMITS, CELLS * FREE)))

    def curvature(self, _, multipliers):
        m = multipliers.reshape(CELLS, LIMITS)
        return csr_array(block_diag([sum(w * b for w, b in zip(row, self.blocks[1:])) for row in m]))

    def passed(self, u):
        return float((self.limits(u) - np.tile(self.upper, CELLS)).max())


def main():
    verdict = Verdict(f"map of {CELLS} cells, {FREE} inputs, {LIMITS} limits in each, smoothness",
                      "trust-constr, exact sparse derivatives, gtol 1e-9, at most 1000 iterations")
    responses, upper, pairs, starts = problem()
    program = Program(responses, upper, pairs, starts)
    flat = [{**r, "hessian": r["hessian"].ravel()} for r in responses]
    mine = ours("whole_map", {"responses": flat, "upper": upper, "dim": DIM, "axes": AXES, "starts": starts.ravel(),
                              "pairs": pairs, "smooth": SMOOTH})
    own = mine["time"]["cpu_s"]
    u = np.array(mine["x"])[:, AXES:].ravel()
    before = time.process_time()
    limit = NonlinearConstraint(program.limits, -np.inf, np.tile(upper, CELLS), jac=program.jacobian, hess=program.curvature)
    found = minimize(program.objective, starts[:, AXES:].ravel(), jac=program.gradient, hess=lambda _: program.second,
                     bounds=Bounds(0, 1), constraints=[limit], method="trust-constr",
                     options={"maxiter": 1000, "gtol": 1e-9, "xtol": 1e-12})
    peer = time.process_time() - before
    a, b = program.objective(u), program.objective(found.x)
    free = program.objective(np.clip(np.linalg.lstsq(program.second.toarray(), -program.gradient(np.zeros(u.size)), rcond=None)[0], 0, 1))
    verdict.row(f"dynocal, {mine['iterations']} iterations, {mine['status']}", own)
    verdict.row(f"SciPy trust-constr, {found.nit} iterations, {found.message}", peer, own)
    print(f"   objective: ours {a:.8f}, peer {b:.8f}, without limits about {free:.8f}")
    verdict.check("ours at most 1e-6 above the peer's (NumPy judges)", a <= b + 1e-6, f"{a - b:.1e}")
    verdict.check("limits kept to 1e-6", program.passed(u) <= 1e-6, f"{program.passed(u):.1e}, peer {program.passed(found.x):.1e}")
    verdict.check("under 10 s", own < 10, f"{own:.3f} s")
    verdict.check("at most 1/10 of the peer's time", own <= peer / 10, f"1/{peer / own:.1f}")
    learnt = processes(responses, upper, pairs, starts)
    u = np.array(learnt["x"])[:, AXES:].ravel()
    seconds = learnt["time"]["cpu_s"]
    verdict.row(f"dynocal on Gaussian processes, {learnt['iterations']} iterations, {learnt['status']}", seconds)
    print(f"   true objective {program.objective(u):.6f} ({a:.6f} where the responses are known), limits passed by {program.passed(u):.3f}")
    verdict.check("under 10 s on Gaussian processes", seconds < 10, f"{seconds:.3f} s")
    verdict.end()


if __name__ == "__main__":
    print(f"SciPy {scipy.__version__}")
    main()
