"""A program over a record as CasADi gets it for speed: exact derivatives of one window, mapped over all samples.

Decisions: INJ, SA, throttle of samples `first` to n-2; equalities at samples first+1 to n-1, with past outputs at their
demand; SA may move by at most `rate` from sample to sample, the first against the record. Nothing is coloured or
differentiated as a whole. Both ways to run it: CasADi's virtual machine, and C that it generates, compiled at -O3.
"""

import pathlib
import subprocess
import time

import casadi as ca
import numpy as np

COMPILER = ["gcc", "-O3", "-fPIC", "-shared"]


class Windows:
    """The program of one record; `block` has the equations of one window."""

    def __init__(self, block, inputs, speed, demands, first, rate=None):
        self.first, self.rate, self.block = first, rate, block
        self.inputs, self.speed, self.demands = inputs, speed, demands
        self.n = len(inputs) - 1 - first
        self.x = ca.MX.sym("x", 3 * self.n)
        self.known = self.known_values()
        lags = block.lags
        history = inputs[first + 1 - lags:first].ravel()
        whole = ca.vertcat(ca.DM(history), self.x)
        at = np.array([[3 * (s + lags - k) + c for k in range(1, lags + 1) for c in range(3)] for s in range(self.n)])
        # Index of each entry of each window among the variables; negative: the record.
        self.variable = at - len(history)
        self.w = ca.reshape(whole[at.ravel().tolist()], 3 * lags, self.n)
        slope = 1.2e-4 * speed[first:-1] / self.n
        self.slope = np.zeros(3 * self.n)
        self.slope[::3] = slope
        self.rates = self.rate_rows() if rate is not None else None

    def known_values(self):
        """Columns: speed at the lags, demand one sample before, demand."""
        t = np.arange(self.first + 1, self.first + 1 + self.n)
        rows = [self.speed[t - k] for k in range(1, self.block.lags + 1)]
        rows += [d[t - 1] for d in self.demands] + [d[t] for d in self.demands]
        return ca.DM(np.array(rows))

    def rate_rows(self):
        n = self.n
        rows = [s for s in range(n)] + [s for s in range(1, n)]
        columns = [3 * s + 1 for s in range(n)] + [3 * (s - 1) + 1 for s in range(1, n)]
        signs = [1.0] * n + [-1.0] * (n - 1)
        matrix = ca.DM.triplet(rows, columns, ca.DM(signs), n, 3 * n)
        start = np.zeros(n)
        start[0] = -self.inputs[self.first - 1, 1]
        return matrix, ca.DM(start)

    def program(self):
        """Objective and constraints, and the derivatives as functions for the solver."""
        x, n = self.x, self.n
        equations = ca.vec(self.block.value.map(n)(self.w, self.known))
        g = equations if self.rates is None else ca.vertcat(equations, ca.mtimes(self.rates[0], x) + self.rates[1])
        f, par = ca.dot(ca.DM(self.slope), x), ca.MX.sym("p", 0)
        lam, sigma = ca.MX.sym("lam", g.numel()), ca.MX.sym("sigma")
        given = {
            "grad_f": ca.Function("nlp_grad_f", [x, par], [f, ca.MX(ca.DM(self.slope))], ["x", "p"], ["f", "grad_f_x"]),
            "jac_g": ca.Function("nlp_jac_g", [x, par], [g, self.jacobian(g.numel())], ["x", "p"], ["g", "jac_g_x"]),
            "hess_lag": ca.Function("nlp_hess_l", [x, par, sigma, lam], [self.hessian(lam)],
                                    ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"]),
        }
        return {"x": x, "f": f, "g": g}, given

    def jacobian(self, rows):
        pattern, n = self.block.jacobian_at, self.n
        values = ca.vec(self.block.jacobian.map(n)(self.w, self.known))
        entries = [(2 * s + i, self.variable[s, j], len(pattern) * s + k)
                   for s in range(n) for k, (i, j) in enumerate(pattern) if self.variable[s, j] >= 0]
        if self.rates is not None:
            matrix = self.rates[0]
            r, c = matrix.sparsity().get_triplet()
            entries += [(2 * n + i, j, values.numel() + k) for k, (i, j) in enumerate(zip(r, c))]
            values = ca.vertcat(values, ca.DM(matrix.nonzeros()))
        entries.sort(key=lambda e: (e[1], e[0]))
        sparsity = ca.Sparsity.triplet(rows, 3 * n, [e[0] for e in entries], [int(e[1]) for e in entries])
        return ca.MX(sparsity, values[[e[2] for e in entries]])

    def hessian(self, lam):
        pattern, n = self.block.hessian_at, self.n
        weights = ca.reshape(lam[:2 * n], 2, n)
        values = ca.vec(self.block.hessian.map(n)(self.w, self.known, weights))
        places = {}
        for s in range(n):
            for k, (i, j) in enumerate(pattern):
                a, b = int(self.variable[s, i]), int(self.variable[s, j])
                if min(a, b) >= 0:
                    # The solver is given the upper triangle.
                    places.setdefault((max(a, b), min(a, b)), []).append(len(pattern) * s + k)
        keys = sorted(places)
        rows = [r for r, key in enumerate(keys) for _ in places[key]]
        columns = [c for key in keys for c in places[key]]
        add = ca.DM.triplet(rows, columns, ca.DM.ones(len(rows)), len(keys), values.numel())
        sparsity = ca.Sparsity.triplet(3 * n, 3 * n, [k[1] for k in keys], [k[0] for k in keys])
        return ca.MX(sparsity, ca.mtimes(add, values))

    def check_derivatives(self, given, program):
        """Jacobian and Hessian along a random direction against central differences."""
        rng = np.random.default_rng(1)
        at = np.clip(self.inputs[self.first:-1], 1.0, 29.0).ravel() + rng.uniform(-1, 1, 3 * self.n)
        along = rng.uniform(-1, 1, 3 * self.n)
        lam = rng.uniform(-1, 1, program["g"].numel())
        g = ca.Function("g", [self.x], [program["g"]])
        jacobian = lambda p: given["jac_g"](p, [])[1]
        h = 1e-5
        j = np.array((g(at + h * along) - g(at - h * along)) / (2 * h) - jacobian(at) @ along).ravel()
        upper = given["hess_lag"](at, [], 1.0, lam)
        full = upper + ca.triu(upper, False).T
        slopes = (jacobian(at + h * along).T @ lam - jacobian(at - h * along).T @ lam) / (2 * h)
        size = lambda a: max(1.0, float(ca.norm_inf(a)))
        worst = max(float(np.abs(j).max()) / size(jacobian(at) @ along),
                    float(ca.norm_inf(slopes - full @ along)) / size(slopes))
        assert worst < 1e-6, f"derivatives put together by hand differ from differences by {worst}"

    def solver(self, options, compiled=None):
        """The solver; with `compiled`, a folder, over generated C. Beside it the time to build it in s."""
        before = time.perf_counter()
        program, given = self.program()
        if compiled is None:
            made = ca.nlpsol("fuel", "ipopt", program, options | given)
            self.check_derivatives(given, program)
        else:
            made = ca.nlpsol("fuel", "ipopt", *in_c(program, given, options, compiled))
        return made, time.perf_counter() - before

    def solve(self, solver, bounds):
        n = self.n
        limits = 0 if self.rates is None else n
        side = np.concatenate([np.zeros(2 * n), np.full(limits, self.rate or 0.0)])
        found = solver(x0=self.inputs[self.first:-1].ravel(), lbx=np.tile([b[0] for b in bounds], n),
                       ubx=np.tile([b[1] for b in bounds], n), lbg=-side, ubg=side)
        return np.array(found["x"]).reshape(n, 3), float(found["f"]), solver.stats()


def in_c(program, given, options, folder):
    """Functions of a program and options over them, as C that CasADi generates and the compiler makes a library of."""
    par = ca.MX.sym("p", 0)
    nlp = ca.Function("nlp", [program["x"], par], [program["f"], program["g"]], ["x", "p"], ["f", "g"])
    generator = ca.CodeGenerator("fuel.c")
    for function in (nlp, *given.values()):
        generator.add(function)
    generator.generate(f"{folder}/")
    library = pathlib.Path(folder, "fuel.so")
    subprocess.run([*COMPILER, "-o", str(library), str(library.with_suffix(".c")), "-lm"], check=True)
    load = lambda function: ca.external(function.name(), str(library))
    # Not needed for the solution, and it would have to be differentiated.
    return load(nlp), options | {"no_nlp_grad": True} | {key: load(function) for key, function in given.items()}


class Block:
    """Equations of one window: `w` holds (INJ, SA, throttle) at lags 1, 2, ..; `known` speeds at these lags, outputs, demands.

    `outputs(w, speed, y)` gives torque and lambda; `hessian(w, speed, y, weights)`, where given, their weighted second
    derivative, else it is CasADi's.
    """

    def __init__(self, lags, outputs, hessian=None):
        self.lags = lags
        w, known, weights = ca.SX.sym("w", 3 * lags), ca.SX.sym("k", lags + 4), ca.SX.sym("l", 2)
        speed, y, demand = known[:lags], known[lags:lags + 2], known[lags + 2:]
        f = outputs(w, speed, y)
        self.value = ca.Function("value", [w, known], [f - demand])
        jacobian = ca.jacobian(f, w)
        automatic = ca.tril(ca.hessian(ca.dot(weights, f), w)[0])
        second = automatic if hessian is None else ca.tril(hessian(w, speed, y, weights))
        if hessian is not None:
            self.compare(w, known, weights, second, automatic)
        self.jacobian_at, self.hessian_at = triplet(jacobian), triplet(second)
        # Both lists are in the order of the stored entries.
        self.jacobian = ca.Function("jacobian", [w, known], [ca.vertcat(*jacobian.nonzeros())])
        self.hessian = ca.Function("hessian", [w, known, weights], [ca.vertcat(*second.nonzeros())])

    @staticmethod
    def compare(w, known, weights, own, automatic):
        rng = np.random.default_rng(2)
        both = ca.Function("both", [w, known, weights], [ca.densify(own), ca.densify(automatic)])
        a, b = both(rng.uniform(1, 20, w.numel()), rng.uniform(1, 20, known.numel()), [0.7, -0.4])
        assert float(ca.norm_inf(ca.vec(a - b))) <= 1e-10 * (1 + float(ca.norm_inf(ca.vec(b)))), "Hessian of a window"


def triplet(matrix):
    return list(zip(*matrix.sparsity().get_triplet()))
