#!/usr/bin/env python3
"""Receding horizon of 20 samples over 2000 samples, one sample applied at a time, each step warm from the plan before.

At every step the mean fuel of the horizon and the missed torque and lambda at a price (l1) are minimised over its inputs;
the first sample is applied. The peer is CasADi with IPOPT, once set up with what changes as parameters: SX graph, inputs,
outputs and what is missed as variables; cold, and warm from the shifted plan with and without its multipliers.
"""

from common import Verdict, measure, ours, table  # noqa: I001

import contextlib
import pathlib
import subprocess
import tempfile
import time

import casadi as ca
import numpy as np
from fuel import BOUNDS, COMMON, FIRST, LAMBDA, TORQUE, free_run, lambda_, torque
from windows import COMPILER

LENGTH, LAGS = 20, 3
# Price of the whole range of a demand (80 Nm, 0.2) missed for the whole horizon, in kg/h.
PRICE, RANGES = 50.0, np.array([80.0, 0.2])
ASKED_RATIO, ASKED_NEAR = 0.5, 0.005
BATCH_FUEL = 2.389014814256187
# The quickest of twelve combinations of barrier 1e-5 to 1e-2, pushes 1e-9 and 1e-4, with and without multipliers.
WARM = {"ipopt.warm_start_init_point": "yes", "ipopt.mu_init": 1e-4}
WARM |= {f"ipopt.warm_start_{k}": 1e-4 for k in ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac", "mult_bound_push")}
STATES = 3 + 2 + 4


class Peer:
    """One program for every step; variables sample by sample: three inputs, two outputs, missed above and below of each."""

    def __init__(self, parameters, options, warm, duals, folder=None):
        self.warm, self.duals = warm, duals
        program = self.program(*parameters)
        options = COMMON | (WARM if warm else {}) | options
        self.cold = ca.nlpsol("step", "ipopt", program, COMMON | ({} if warm else options))
        self.solver = ca.nlpsol("step", "ipopt", program, options)
        if folder is not None:
            self.cold, self.solver = self.in_c(folder, COMMON | ({} if warm else options)), self.in_c(folder, options)
        low, high = np.full((LENGTH, STATES), 0.0), np.full((LENGTH, STATES), np.inf)
        low[:, :3], high[:, :3] = np.array(BOUNDS).T
        low[:, 3:5] = -np.inf
        self.sides = {"lbx": low.ravel(), "ubx": high.ravel(), "lbg": 0.0, "ubg": 0.0}

    def program(self, p_torque, p_lambda):
        x = ca.SX.sym("x", STATES * LENGTH)
        past, y, speed = ca.SX.sym("u", 3 * (LAGS - 1)), ca.SX.sym("y", 2), ca.SX.sym("v", LENGTH)
        demand = ca.SX.sym("d", 2 * LENGTH)
        price = PRICE / LENGTH / RANGES
        at = lambda k, c: x[STATES * k + c] if k >= 0 else past[3 * (k + LAGS - 1) + c]
        g, f = [], 0
        for k in range(LENGTH):
            rows = [tuple(at(k - lag, c) for c in range(3)) for lag in range(LAGS)]
            before = [at(k - 1, 3 + i) if k > 0 else y[i] for i in range(2)]
            g += [torque(p_torque, rows, speed[k], before[0]) - at(k, 3),
                  lambda_(p_lambda, rows, speed[k], before[1]) - at(k, 4)]
            g += [at(k, 3 + i) - demand[2 * k + i] - at(k, 5 + 2 * i) + at(k, 6 + 2 * i) for i in range(2)]
            f += 1.2e-4 * at(k, 0) * speed[k] / LENGTH
            f += sum(price[i] * (at(k, 5 + 2 * i) + at(k, 6 + 2 * i)) for i in range(2))
        return {"x": x, "f": f, "g": ca.vertcat(*g), "p": ca.vertcat(past, y, speed, demand)}

    def in_c(self, folder, options):
        """The solver over the C that CasADi generates for it."""
        library = pathlib.Path(folder, "step.so")
        if not library.exists():
            # The generator writes into the working directory.
            with contextlib.chdir(folder):
                self.solver.generate_dependencies("step.c")
            subprocess.run([*COMPILER, "-o", str(library), str(library.with_suffix(".c")), "-lm"], check=True)
        return ca.nlpsol("step", "ipopt", str(library), options)

    def run(self, record, parameters, demands):
        """Inputs over the record, steps that failed, iterations of all steps."""
        inputs, speed = record[:, :3].copy(), record[:, 3]
        y = [demands[0][FIRST], demands[1][FIRST]]
        start = np.zeros((LENGTH, STATES))
        start[:, :3] = inputs[FIRST:FIRST + LENGTH]
        start[:, 3:5] = np.array(demands)[:, FIRST + 1:FIRST + 1 + LENGTH].T
        found, failed, iterations = None, 0, 0
        last = len(record) - 1 - LENGTH
        for t in range(FIRST, last + 1):
            ahead = slice(t + 1, t + 1 + LENGTH)
            p = np.r_[inputs[t - LAGS + 1:t].ravel(), y, speed[t:t + LENGTH], np.array(demands)[:, ahead].T.ravel()]
            arguments = self.sides | {"x0": start.ravel(), "p": p}
            warm = self.warm and found is not None
            if warm and self.duals:
                arguments |= {"lam_x0": shifted(found["lam_x"], STATES).ravel(), "lam_g0": shifted(found["lam_g"], 4).ravel()}
            solver = self.solver if warm else self.cold
            found = solver(**arguments)
            failed += not solver.stats()["success"]
            iterations += solver.stats()["iter_count"]
            plan = np.array(found["x"]).reshape(LENGTH, STATES)
            inputs[t] = plan[0, :3]
            y = list(plan[0, 3:5])
            start = shifted(plan, STATES)
        inputs[last:-1] = plan[:, :3]
        return inputs, failed, iterations


def shifted(values, width):
    rows = np.array(values).reshape(-1, width)
    return np.vstack([rows[1:], rows[-1:]])


def judge(inputs, record, parameters, demands):
    """Fuel, the same with the price of what torque and lambda miss in free run, the largest miss, violation of the bounds."""
    missed = [np.abs(free_run(model, p, inputs, record[:, 3], demand, FIRST + 1) - demand)[FIRST + 1:]
              for model, p, demand in zip((torque, lambda_), parameters, demands)]
    decided = inputs[FIRST:-1]
    beyond = max(max((low - decided[:, c]).max(), (decided[:, c] - high).max()) for c, (low, high) in enumerate(BOUNDS))
    fuel = float(np.mean(1.2e-4 * decided[:, 0] * record[FIRST:-1, 3]))
    cost = fuel + PRICE * sum(m.mean() / r for m, r in zip(missed, RANGES))
    return fuel, cost, [m.max() for m in missed], float(beyond)


def main():
    record = table("estimation_inputs/engine_opt.csv")
    parameters = [table("estimation_inputs/poly_T_sem.csv"), table("estimation_inputs/poly_lambda_sem.csv")]
    demands = [free_run(model, p, record[:, :3], record[:, 3], record[:, 4 + i], FIRST)
               for i, (model, p) in enumerate(zip((torque, lambda_), parameters))]
    steps = len(record) - LENGTH - FIRST
    verdict = Verdict(f"Receding horizon of {LENGTH} samples over 2000, {steps} steps; times are of one step",
                      f"SX graph once set up, IPOPT {COMMON}; warm {WARM}; C: {' '.join(COMPILER)}")
    way = {"name": "horizon", "length_s": float(LENGTH), "price": PRICE}
    mine = ours("fuel", {
        "u": record[:, :4].ravel(), "bounds": BOUNDS, "way": way,
        "torque": {"regressors": TORQUE, "theta": parameters[0], "y": record[:, 4]},
        "lambda": {"regressors": LAMBDA, "theta": parameters[1], "y": record[:, 5]},
    })
    own = mine["time"]["cpu_s"] / mine["parts"]
    inputs = record[:, :3].copy()
    inputs[FIRST:-1] = np.array(mine["inputs"]).reshape(-1, 3)[FIRST:-1]
    fuel, cost, missed, beyond = judge(inputs, record, parameters, demands)
    verdict.row("dynocal, warm from the plan before, building included", own)
    print(f"   {mine['parts_solved']} of {mine['parts']} steps solved, {mine['iterations']} iterations, fuel {fuel:.6f} kg/h, "
          f"with misses {cost:.6f}, missed at most {missed[0]:.2g} Nm, {missed[1]:.2g}")
    fastest, best = np.inf, np.inf
    for name, options, warm, duals in (("cold, adaptive", {"ipopt.mu_strategy": "adaptive"}, False, False),
                                       ("warm, without multipliers", {"ipopt.warm_start_init_point": "no"}, True, False), ("warm, multipliers too", {}, True, True)):
        for compiled in (False, True):
            with tempfile.TemporaryDirectory() as folder:
                before = time.perf_counter()
                peer = Peer(parameters, options, warm, duals, folder if compiled else None)
                build = time.perf_counter() - before
                before = time.process_time()
                theirs, failed, iterations = peer.run(record, parameters, demands)
                seconds = (time.process_time() - before) / steps
            verdict.row(f"CasADi + IPOPT, {name}{', C at -O3' if compiled else ''}", seconds, own)
            their_fuel, their_cost, their_missed, _ = judge(theirs, record, parameters, demands)
            print(f"   {steps - failed} of {steps} steps solved, {iterations} iterations, fuel {their_fuel:.6f} kg/h, "
                  f"with misses {their_cost:.6f}, missed at most {their_missed[0]:.2g} Nm, {their_missed[1]:.2g}; built in {build:.1f} s")
            best = min(best, their_cost)
            if warm and not compiled:
                fastest = min(fastest, seconds)
    verdict.check("as many steps as the peer, all of them solved", mine["parts_solved"] == mine["parts"] == steps, mine["parts_solved"])
    verdict.check(f"fuel within {ASKED_NEAR:.1%} of the batch", abs(fuel / BATCH_FUEL - 1) <= ASKED_NEAR, f"{fuel / BATCH_FUEL - 1:.2%}")
    verdict.check("bounds kept", beyond <= 1e-9, f"{beyond:.1e}")
    verdict.check("fuel with misses no more than 0.1 % above the best peer", cost <= 1.001 * best, f"{cost / best - 1:.2%}")
    verdict.check(f"at most {ASKED_RATIO} of the faster warm peer on CasADi's virtual machine", own <= ASKED_RATIO * fastest,
                  f"{own / fastest:.3g} of it")
    verdict.end()


if __name__ == "__main__":
    main()
