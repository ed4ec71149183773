#!/usr/bin/env python3
"""The table of Hock-Schittkowski problems solved again by IPOPT through CasADi: are the printed optima right?

Reads the same table as our test. A problem is confirmed when IPOPT ends at the printed optimum; where it ends elsewhere both
values are shown, and a lower feasible one refutes the print.
"""

import math
import re
import tomllib
from pathlib import Path

import casadi as ca

TABLE = Path(__file__).parents[2] / "crates/numerics/tests/data/hock_schittkowski.toml"
OPTIONS = {"ipopt.tol": 1e-9, "ipopt.print_level": 0, "print_time": False, "ipopt.sb": "yes", "ipopt.max_iter": 3000}


def formula(text, x):
    """A formula of the table as an expression in x."""
    names = {f"x{k + 1}": x[k] for k in range(x.numel())}
    names |= {"pi": math.pi, "sin": ca.sin, "cos": ca.cos, "exp": ca.exp, "ln": ca.log, "sqrt": ca.sqrt}
    return eval(re.sub(r"\^", "**", text), {"__builtins__": {}}, names)  # the table is ours


def bounds(value, none, n):
    return [none] * n if value is None else value if isinstance(value, list) else [value] * n


def solve(problem):
    n = len(problem["x0"])
    x = ca.SX.sym("x", n)
    g = [formula(t, x) for t in problem.get("g", [])]
    h = [formula(t, x) for t in problem.get("h", [])]
    nlp = {"x": x, "f": formula(problem["f"], x), "g": ca.vertcat(*g, *h)}
    solver = ca.nlpsol("hs", "ipopt", nlp, OPTIONS)
    found = solver(x0=problem["x0"], lbx=bounds(problem.get("lower"), -math.inf, n),
                   ubx=bounds(problem.get("upper"), math.inf, n), lbg=[0.0] * len(g + h),
                   ubg=[math.inf] * len(g) + [0.0] * len(h))
    return float(found["f"]), solver.stats()


def main():
    problems = tomllib.loads(TABLE.read_text())
    confirmed, others = 0, []
    for name, problem in problems.items():
        f, stats = solve(problem)
        printed = problem["optimum"]
        near = lambda value: abs(f - value) <= 1e-6 * max(abs(value), 1.0)
        same = near(printed) or "local" in problem and near(problem["local"])
        confirmed += same
        if not same:
            others.append(name)
        print(f"{name:8} {stats['return_status']:32} {stats['iter_count']:5} iterations, f {f:.10g}, "
              f"printed {printed:.10g}{'' if same else '   <-- differs'}")
    print(f"{confirmed} of {len(problems)} minima confirmed; others: {', '.join(others) or 'none'}")
    raise SystemExit(1 if others else 0)


if __name__ == "__main__":
    main()
