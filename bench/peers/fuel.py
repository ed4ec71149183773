#!/usr/bin/env python3
"""Fuel over 2000 samples with exact torque and lambda and a spark rate limit: CasADi with IPOPT.

Demand: free run of the models on the record's inputs. Decisions: INJ, SA, throttle of samples 3 to n-2; equalities at
samples 4 to n-1; |dSA| <= 1 deg at every decision sample, the first against the record. Jacobian and Hessian are
assembled by hand from the blocks of each sample's window, so that nothing is coloured or differentiated as a whole. Shown beside
it is the same over generated C, its build apart.
"""

from common import Verdict, measure, ours, table  # noqa: I001

import tempfile

import casadi as ca
import numpy as np
from windows import COMPILER, Block, Windows

FIRST, RATE = 3, 1.0
BOUNDS = [[0.0, 30.0], [5.0, 30.0], [0.0, 90.0]]  # (7.14)
ASKED_FUEL, ASKED_VIOLATION = 2.3903178, 1e-6
# Regressors of (7.8) in the order of the parameter files.
TORQUE = ["1", "inj(t-1)", "inj(t-2)", "inj(t-3)", "spark(t-1)", "spark(t-2)", "throttle(t-1)", "throttle(t-2)",
          "speed(t-1)", "inj(t-1)*spark(t-1)", "inj(t-1)*throttle(t-1)", "spark(t-1)^2", "spark(t-1)*throttle(t-1)",
          "throttle(t-2)^2", "throttle(t-2)^3", "torque(t-1)"]
LAMBDA = ["1", "inj(t-1)", "inj(t-2)", "spark(t-1)", "throttle(t-3)", "speed(t-1)", "lambda(t-1)"]
COMMON = {"ipopt.tol": 1e-8, "ipopt.print_level": 0, "print_time": False, "ipopt.sb": "yes",
          "ipopt.linear_solver": "mumps", "ipopt.max_iter": 3000}


def torque(p, w, speed, y):
    """(7.8); w[k] holds (INJ, SA, throttle) at lag k + 1."""
    (a, s, h), (b, r, g), (c, _, _) = w
    return (p[0] + p[1] * a + p[2] * b + p[3] * c + p[4] * s + p[5] * r + p[6] * h + p[7] * g + p[8] * speed
            + p[9] * a * s + p[10] * a * h + p[11] * s**2 + p[12] * s * h + p[13] * g**2 + p[14] * g**3 + p[15] * y)


def lambda_(p, w, speed, y):
    (a, s, _), (b, _, _), (_, _, k) = w
    return p[0] + p[1] * a + p[2] * b + p[3] * s + p[4] * k + p[5] * speed + p[6] * y


def free_run(model, p, inputs, speed, y, first):
    y = np.array(y)
    for t in range(first, len(y)):
        y[t] = model(p, [inputs[t - k] for k in (1, 2, 3)], speed[t - 1], y[t - 1])
    return y


class Peer:
    """The program as CasADi sees it: variables sample by sample; rows torque, lambda, spark increment."""

    def __init__(self, record, p_torque, p_lambda, options):
        self.inputs, self.speed = record[:, :3], record[:, 3]
        self.demand_t = free_run(torque, p_torque, self.inputs, self.speed, record[:, 4], FIRST)
        self.demand_l = free_run(lambda_, p_lambda, self.inputs, self.speed, record[:, 5], FIRST)
        self.n = len(record) - 1 - FIRST
        program = self.functions(p_torque, p_lambda)
        self.solver = ca.nlpsol("fuel", "ipopt", program, options | self.given)

    def variable(self, s, lag, channel):
        """Index of a channel `lag` samples before row s + 1; negative: the record."""
        return 3 * (s + 1 - lag) + channel

    def window(self, x, s):
        past = lambda k, c: self.inputs[FIRST + s + 1 - k, c] if s + 1 - k < 0 else x[self.variable(s, k, c)]
        return [tuple(past(k, c) for c in range(3)) for k in (1, 2, 3)]

    def functions(self, p_torque, p_lambda):
        n = self.n
        x, lam, sigma = ca.SX.sym("x", 3 * n), ca.SX.sym("lam", 3 * n), ca.SX.sym("sigma")
        # Blocks of one window, differentiated once.
        w, weights, speed, y = ca.SX.sym("w", 9), ca.SX.sym("l", 2), ca.SX.sym("v"), ca.SX.sym("y", 2)
        rows = [tuple(w[3 * k + c] for c in range(3)) for k in range(3)]
        f = ca.vertcat(torque(p_torque, rows, speed, y[0]), lambda_(p_lambda, rows, speed, y[1]))
        value = ca.Function("value", [w, speed, y], [f])
        jac = ca.jacobian(f, w)
        hess = ca.tril(ca.hessian(ca.dot(weights, f), w)[0])
        at_j, at_h = list(zip(*jac.sparsity().get_triplet())), list(zip(*hess.sparsity().get_triplet()))
        blocks = ca.Function("blocks", [w, weights], [ca.vertcat(*[jac[i, j] for i, j in at_j]),
                                                     ca.vertcat(*[hess[i, j] for i, j in at_h])])
        g, jacobian, hessian = [], {}, {}
        for s in range(n):
            t = FIRST + s + 1
            here = self.window(x, s)
            flat = ca.vertcat(*[v for lag in here for v in lag])
            known = [self.demand_t[t - 1], self.demand_l[t - 1]]
            g.append(value(flat, self.speed[t - 1], known) - ca.DM([self.demand_t[t], self.demand_l[t]]))
            g.append(here[0][1] - here[1][1])
            of_j, of_h = blocks(flat, lam[3 * s:3 * s + 2])
            index = [self.variable(s, 1 + i // 3, i % 3) for i in range(9)]
            for k, (i, j) in enumerate(at_j):
                if index[j] >= 0:
                    jacobian[3 * s + i, index[j]] = of_j[k]
            jacobian[3 * s + 2, index[1]] = ca.SX(1)
            if index[4] >= 0:
                jacobian[3 * s + 2, index[4]] = ca.SX(-1)
            for k, (i, j) in enumerate(at_h):
                if min(index[i], index[j]) >= 0:
                    # Lower block entry; the later lag is the earlier variable. IPOPT is given the upper triangle.
                    key = (min(index[i], index[j]), max(index[i], index[j]))
                    hessian[key] = hessian[key] + of_h[k] if key in hessian else of_h[k]
        slope = np.zeros(3 * n)
        slope[::3] = 1.2e-4 * self.speed[FIRST:-1] / n
        f, g, par = ca.dot(ca.DM(slope), x), ca.vertcat(*g), ca.SX.sym("p", 0)
        self.given = {
            "grad_f": ca.Function("grad_f", [x, par], [f, ca.SX(ca.DM(slope))], ["x", "p"], ["f", "grad_f_x"]),
            "jac_g": ca.Function("jac_g", [x, par], [g, sparse(3 * n, jacobian)], ["x", "p"], ["g", "jac_g_x"]),
            "hess_lag": ca.Function("hess_lag", [x, par, sigma, lam], [sparse(3 * n, hessian)],
                                    ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"]),
        }
        self.compare_with_automatic(x, g, lam)
        return {"x": x, "f": f, "g": g}

    def compare_with_automatic(self, x, g, lam):
        """The hand-assembled derivatives against CasADi's own at a random point."""
        rng = np.random.default_rng(1)
        at, weights = rng.uniform(1, 20, 3 * self.n), rng.uniform(-1, 1, 3 * self.n)
        j = ca.Function("j", [x], [ca.jacobian(g, x)])(at)
        h = ca.Function("h", [x, lam], [ca.triu(ca.hessian(ca.dot(lam, g), x)[0])])(at, weights)
        worst = max(float(ca.norm_inf(ca.vec(self.given["jac_g"](at, [])[1] - j))),
                    float(ca.norm_inf(ca.vec(self.given["hess_lag"](at, [], 1, weights) - h))))
        assert worst < 1e-9, f"hand-assembled derivatives differ by {worst}"

    def solve(self):
        n = self.n
        low, high = np.zeros((n, 3)), np.zeros((n, 3))
        low[:, 2], high[:, 2] = -RATE, RATE
        found = self.solver(x0=self.inputs[FIRST:-1].ravel(), lbx=np.tile([b[0] for b in BOUNDS], n),
                            ubx=np.tile([b[1] for b in BOUNDS], n), lbg=low.ravel(), ubg=high.ravel())
        return np.array(found["x"]).reshape(n, 3), float(found["f"]), self.solver.stats()


def sparse(rows, entries):
    """SX matrix from {(row, column): expression}."""
    keys = sorted(entries, key=lambda k: (k[1], k[0]))
    pattern = ca.Sparsity.triplet(rows, rows, [k[0] for k in keys], [k[1] for k in keys])
    return ca.SX(pattern, ca.vertcat(*[entries[k] for k in keys]))


def worst_violation(inputs, record, parameters, demands):
    """Largest |free run - demand| from the first decision on, bound and rate violations, of full-record inputs."""
    speed, worst = record[:, 3], 0.0
    for model, p, demand in zip((torque, lambda_), parameters, demands):
        worst = max(worst, np.abs(free_run(model, p, inputs, speed, demand, FIRST + 1) - demand)[FIRST:].max())
    decided = inputs[FIRST:-1]
    for c, (low, high) in enumerate(BOUNDS):
        worst = max(worst, (low - decided[:, c]).max(), (decided[:, c] - high).max())
    return max(worst, (np.abs(np.diff(inputs[FIRST - 1:-1, 1])) - RATE).max())


def in_generated_c(record, parameters, demands):
    """The same program, windows mapped, over C that CasADi generates: CPU time of a solution, inputs, statistics, build in s."""
    def outputs(w, speed, y):
        rows = [tuple(w[3 * k + c] for c in range(3)) for k in range(3)]
        return ca.vertcat(torque(parameters[0], rows, speed[0], y[0]), lambda_(parameters[1], rows, speed[0], y[1]))
    windows = Windows(Block(3, outputs), record[:, :3], record[:, 3], demands, FIRST, RATE)
    with tempfile.TemporaryDirectory() as folder:
        solver, build = windows.solver(COMMON | {"ipopt.mu_strategy": "adaptive"}, folder)
        seconds, (x, _, stats) = measure(lambda: windows.solve(solver, BOUNDS), least=2.0)
    return seconds, x, stats, build


def main():
    record = table("estimation_inputs/engine_opt.csv")
    parameters = [table("estimation_inputs/poly_T_sem.csv"), table("estimation_inputs/poly_lambda_sem.csv")]
    verdict = Verdict("Fuel over 2000 samples, torque and lambda exact, |dSA| <= 1 deg (first sample included)",
                      f"window blocks assembled by hand, IPOPT {COMMON}, mu_strategy adaptive / monotone")
    mine = ours("fuel", {
        "u": record[:, :4].ravel(), "first": FIRST, "rate": RATE, "bounds": BOUNDS,
        "torque": {"regressors": TORQUE, "theta": parameters[0], "y": record[:, 4]},
        "lambda": {"regressors": LAMBDA, "theta": parameters[1], "y": record[:, 5]},
    })
    own, times, demands = mine["time"]["cpu_s"], {}, None
    for strategy in ("adaptive", "monotone"):
        options = COMMON | {"ipopt.mu_strategy": strategy}
        peer = Peer(record, *parameters, options)
        seconds, (x, fuel, stats) = measure(peer.solve, least=2.0)
        demands = [peer.demand_t, peer.demand_l]
        whole = record[:, :3].copy()
        whole[FIRST:-1] = x
        violation = worst_violation(whole, record, parameters, demands)
        times[strategy] = seconds
        verdict.row(f"CasADi + IPOPT, {strategy}, prepared graph", seconds, own)
        print(f"   {stats['return_status']}, {stats['iter_count']} iterations, fuel {fuel:.10f} kg/h, "
              f"violation {violation:.1e}")
        if strategy == "adaptive":
            peer_fuel = fuel
    seconds, x, stats, build = in_generated_c(record, parameters, demands)
    verdict.row(f"CasADi + IPOPT, adaptive, windows in C ({' '.join(COMPILER[:2])})", seconds, own)
    print(f"   {stats['return_status']}, {stats['iter_count']} iterations, fuel "
          f"{np.mean(1.2e-4 * x[:, 0] * record[FIRST:-1, 3]):.10f} kg/h; built in {build:.1f} s")
    whole = record[:, :3].copy()
    whole[FIRST:-1] = np.array(mine["inputs"]).reshape(-1, 3)[FIRST:-1]
    fuel = float(np.mean(1.2e-4 * whole[FIRST:-1, 0] * record[FIRST:-1, 3]))
    violation = worst_violation(whole, record, parameters, demands)
    verdict.row("dynocal, building the program included", own)
    print(f"   {mine['status']}, {mine['iterations']} iterations, fuel {fuel:.10f} kg/h, violation {violation:.1e}")
    verdict.check(f"fuel <= {ASKED_FUEL} kg/h", fuel <= ASKED_FUEL, f"{fuel:.10f}")
    verdict.check("no worse than the peer by more than 1e-7 kg/h", fuel <= peer_fuel + 1e-7, f"{fuel - peer_fuel:.1e}")
    verdict.check(f"violation < {ASKED_VIOLATION}", violation < ASKED_VIOLATION, f"{violation:.1e}")
    fastest = min(times.values())
    verdict.check("CPU time at most half of the faster of both on CasADi's virtual machine", own <= 0.5 * fastest,
                  f"{own / fastest:.3g} of it")
    verdict.end()


if __name__ == "__main__":
    main()
