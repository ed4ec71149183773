#!/usr/bin/env python3
"""The rival without a model: SciPy plays the plant, sees fuel and misses, and moves knots of the inputs.

The plant is a free run of the polynomials of thesis (7.8) over the first 300 samples of the reference record, so that both sides
mean the same by fuel. The rival may run it as often as it likes within the budget; it corrects the record's inputs between knots
and may miss the demand by 0.5 Nm and 0.005 (root mean square), where ours must meet it exactly. Ours optimises on the models. Neither
has a limit of rate: the record itself would break it.
"""

from common import Verdict, ours, table  # noqa: I001

import time

import numpy as np
from fuel import BOUNDS, FIRST, LAMBDA, TORQUE, free_run, lambda_, torque
from scipy.optimize import minimize

N, KNOT, RUNS = 300, 20, 6000
# What the rival may miss, and the sizes of its moves in mg, deg and deg.
MISS = np.array([0.5, 0.005])
SIZES = np.array([1.0, 2.0, 1.0])


class Plant:
    """Runs, counted; the best inputs that missed no more than allowed are kept."""

    def __init__(self, record, parameters):
        self.record, self.parameters = record, parameters
        of = lambda model, p, c: free_run(model, p, record[:, :3], record[:, 3], record[:, c], FIRST)
        self.demands = [of(torque, parameters[0], 4), of(lambda_, parameters[1], 5)]
        self.knots = np.arange(FIRST, N + KNOT, KNOT)
        self.runs, self.best, self.inputs = 0, np.inf, record[:, :3]
        self.scale = self.fuel(record[:, :3])

    def fuel(self, inputs):
        return float(np.mean(1.2e-4 * inputs[FIRST:-1, 0] * self.record[FIRST:-1, 3]))

    def corrected(self, z):
        moves = z.reshape(-1, 3) * SIZES
        inputs = self.record[:, :3].copy()
        for c, (low, high) in enumerate(BOUNDS):
            inputs[FIRST:-1, c] += np.interp(np.arange(FIRST, N - 1), self.knots, moves[:, c])
            inputs[:, c] = inputs[:, c].clip(low, high)
        return inputs

    def violation(self, inputs):
        """Largest miss of a demand or a bound."""
        worst = 0.0
        for model, p, demand in zip((torque, lambda_), self.parameters, self.demands):
            y = free_run(model, p, inputs, self.record[:, 3], demand, FIRST + 1)
            worst = max(worst, np.abs(y - demand)[FIRST:].max())
        for c, (low, high) in enumerate(BOUNDS):
            worst = max(worst, (low - inputs[FIRST:-1, c]).max(), (inputs[FIRST:-1, c] - high).max())
        return float(worst)

    def __call__(self, z):
        """Fuel relative to the start, and what was missed beyond what is allowed, squared."""
        inputs = self.corrected(z)
        misses = []
        for model, p, demand in zip((torque, lambda_), self.parameters, self.demands):
            y = free_run(model, p, inputs, self.record[:, 3], demand, FIRST + 1)
            misses.append(np.sqrt(np.mean((y - demand)[FIRST:] ** 2)))
        beyond = np.maximum(np.array(misses) / MISS - 1.0, 0.0)
        fuel = self.fuel(inputs)
        self.runs += 1
        if beyond.max() == 0.0 and fuel < self.best:
            self.best, self.inputs = fuel, inputs
        return fuel / self.scale + 0.1 * float(beyond @ beyond)


def main():
    record = table("estimation_inputs/engine_opt.csv")[:N]
    parameters = [table("estimation_inputs/poly_T_sem.csv"), table("estimation_inputs/poly_lambda_sem.csv")]
    plants = {}
    verdict = Verdict("Fuel over 300 samples: models against a search on the plant",
                      f"SciPy, knots every {KNOT} samples, {RUNS} runs of the plant")
    mine = ours("fuel", {
        "u": record[:, :4].ravel(), "first": FIRST, "rate": None, "bounds": BOUNDS,
        "torque": {"regressors": TORQUE, "theta": parameters[0], "y": record[:, 4]},
        "lambda": {"regressors": LAMBDA, "theta": parameters[1], "y": record[:, 5]},
    })
    for method, options in (("Powell", {"maxfev": RUNS}), ("COBYLA", {"maxiter": RUNS, "rhobeg": 0.3}),
                            ("Nelder-Mead", {"maxfev": RUNS, "adaptive": True})):
        plant = plants[method] = Plant(record, parameters)
        before = time.process_time()
        minimize(plant, np.zeros(3 * len(plant.knots)), method=method, options=options)
        verdict.row(f"{method}, {plant.runs} runs of the plant", time.process_time() - before, mine["time"]["cpu_s"])
        print(f"   fuel {plant.best:.6f} kg/h of {plant.scale:.6f} at the start")
    whole = record[:, :3].copy()
    whole[FIRST:-1] = np.array(mine["inputs"]).reshape(-1, 3)[FIRST:-1]
    plant = next(iter(plants.values()))
    fuel, violation = plant.fuel(whole), plant.violation(whole)
    verdict.row("dynocal on the models, building the program included", mine["time"]["cpu_s"])
    print(f"   fuel {fuel:.6f} kg/h, violation {violation:.1e}")
    best = min(p.best for p in plants.values())
    verdict.check("less fuel than the rival, although it may miss the demand", np.isfinite(best) and fuel < best, f"{fuel:.6f}, {best:.6f}")
    verdict.check("violation < 1e-6", violation < 1e-6, f"{violation:.1e}")
    verdict.end()


if __name__ == "__main__":
    main()
