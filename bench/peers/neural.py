#!/usr/bin/env python3
"""One Levenberg-Marquardt iteration of the network with 231 weights in free run, 1995 scored samples of `engine_ident.csv`.

10 tanh neurons, lags 1 to 5 of four inputs and one of the output, channels scaled to [-1, 1], from the stored start
`nn_T_start500.csv`. The peer is NumPy with the exact sensitivity recursion

    y(t) = w2' tanh(U(t) + w1y y(t-1)) + b2        U: all that does not depend on past outputs, one matrix product
    s(t) = d(t) + a(t) s(t-1)                      d, a: for all samples at once, only the recursion is a loop

and normal equations; shown beside it the same with SciPy's banded solver for the recursion, and JAX's forward mode over
`scan` where JAX is installed (jit, compilation not counted).
"""

from common import Verdict, measure, ours, table  # noqa: I001

import numpy as np
import scipy
import scipy.linalg

HIDDEN, LAGS, START = 10, 5, 5
INPUTS, OUTPUT = [0, 1, 2, 3], 4
FROBENIUS = 1358.0353629370384
ITERATIONS = 30
ASKED_RATIO = 0.25


class Network:
    """Inputs and output scaled to [-1, 1]; theta = W1 (row by row), b1, w2, b2."""

    def __init__(self, u, y):
        def scaled(v):
            low, high = v.min(axis=0), v.max(axis=0)
            return (v - 0.5 * (low + high)) / (0.5 * (high - low))
        self.y, self.n = scaled(y), len(y)
        u = scaled(u)
        self.past = np.column_stack([u[START - k:self.n - k, i] for i in range(u.shape[1]) for k in range(1, LAGS + 1)])
        self.width = self.past.shape[1] + 1
        rows = self.n - START
        self.sensitivities = np.zeros((rows, HIDDEN * (self.width + 2) + 1))

    def parts(self, theta):
        q = self.width
        w1 = theta[:HIDDEN * q].reshape(HIDDEN, q)
        b1, w2, b2 = np.split(theta[HIDDEN * q:], [HIDDEN, 2 * HIDDEN])
        return w1, b1, w2, b2[0]

    def free_run(self, theta):
        w1, b1, w2, b2 = self.parts(theta)
        known = self.past @ w1[:, :-1].T + b1
        feedback, y = np.ascontiguousarray(w1[:, -1]), self.y[START - 1]
        hidden, out = np.empty_like(known), np.empty(len(known))
        for t in range(len(known)):
            h = np.tanh(known[t] + feedback * y, out=hidden[t])
            out[t] = y = w2.dot(h) + b2
        return out, hidden

    def error(self, theta):
        return self.free_run(theta)[0] - self.y[START:]

    def direct(self, theta):
        """Error, df/dtheta of all samples, and df/dy(t-1)."""
        w1, _, w2, _ = self.parts(theta)
        out, hidden = self.free_run(theta)
        delta = w2 * (1.0 - hidden * hidden)
        before = np.r_[self.y[START - 1], out[:-1]]
        z = np.column_stack([self.past, before])
        s, q = self.sensitivities, self.width
        np.multiply(delta[:, :, None], z[:, None, :], out=s[:, :HIDDEN * q].reshape(len(z), HIDDEN, q))
        s[:, HIDDEN * q:HIDDEN * (q + 1)] = delta
        s[:, HIDDEN * (q + 1):-1] = hidden
        s[:, -1] = 1.0
        return out - self.y[START:], s, delta @ w1[:, -1]

    def jacobian(self, theta):
        error, s, a = self.direct(theta)
        step = np.empty(s.shape[1])
        # The first scored sample starts from a measured output: nothing to add there.
        for t in range(1, len(s)):
            np.multiply(s[t - 1], a[t], out=step)
            s[t] += step
        return error, s

    def jacobian_banded(self, theta):
        error, s, a = self.direct(theta)
        bands = np.vstack([np.ones(len(s)), np.r_[-a[1:], 0.0]])
        return error, scipy.linalg.solve_banded((1, 0), bands, s, check_finite=False)


def train(net, theta, iterations, jacobian):
    """Levenberg-Marquardt with Marquardt's factor of ten; returns theta, cost and trials."""
    damping, trials = 1e-3, 0
    theta = theta.copy()
    for _ in range(iterations):
        error, s = jacobian(theta)
        cost, gram, gradient = error @ error, s.T @ s, s.T @ error
        scale = np.diag(gram).copy()
        while True:
            system = gram.copy()
            system[np.diag_indices_from(system)] += damping * scale + 1e-12
            step = scipy.linalg.cho_solve(scipy.linalg.cho_factor(system, overwrite_a=True, check_finite=False), gradient)
            trials += 1
            error = net.error(theta - step)
            if error @ error < cost:
                theta, damping = theta - step, damping / 10
                break
            damping *= 10
            if damping > 1e12:
                return theta, cost, trials
    error = net.error(theta)
    return theta, error @ error, trials


def jax_jacobian(net):
    """Forward-mode Jacobian of the error, or None without JAX."""
    try:
        import jax
        import jax.numpy as jnp
    except ImportError:
        return None, None
    jax.config.update("jax_enable_x64", True)
    past, measured = jnp.asarray(net.past), jnp.asarray(net.y)

    def error(theta):
        q = net.width
        w1 = theta[:HIDDEN * q].reshape(HIDDEN, q)
        b1, w2, b2 = theta[HIDDEN * q:HIDDEN * (q + 1)], theta[HIDDEN * (q + 1):-1], theta[-1]

        def step(y, known):
            y = w2 @ jnp.tanh(known + w1[:, -1] * y) + b2
            return y, y
        return jax.lax.scan(step, measured[START - 1], past @ w1[:, :-1].T + b1)[1] - measured[START:]
    compiled = jax.jit(jax.jacfwd(error))
    return (lambda theta: np.asarray(compiled(theta).block_until_ready())), jax.__version__


def main():
    record, theta = table("estimation_inputs/engine_ident.csv"), table("estimation_inputs/nn_T_start500.csv")
    names = open_header("estimation_inputs/engine_ident.csv")
    u = record[:, [names.index(c) for c in ("INJ_mg", "SA_deg", "theta_deg", "N_rpm")]]
    y = record[:, names.index("T_Nm")]
    net = Network(u, y)
    verdict = Verdict("LM iteration of a network with 231 weights in free run, 1995 samples",
                      f"NumPy recursion, J'J and Cholesky, Marquardt damping; {ITERATIONS} iterations from the stored start")
    jacobian_s, (_, exact) = measure(lambda: net.jacobian(theta))
    exact = exact.copy()
    banded_s, (_, banded) = measure(lambda: net.jacobian_banded(theta))
    train_s, (_, cost, trials) = measure(lambda: train(net, theta, ITERATIONS, net.jacobian))
    # As many evaluations for both; what ours needs for the report of the covariance belongs to no iteration.
    mine = ours("neural", {"u": u.ravel(), "y": y, "theta": theta, "evaluations": trials + 1})
    train_banded_s, _ = measure(lambda: train(net, theta, ITERATIONS, net.jacobian_banded))
    own_jacobian, own = mine["jacobian_time"]["cpu_s"], (mine["time"]["cpu_s"] - mine["report_time"]["cpu_s"]) / mine["iterations"]
    verdict.row("Jacobian: dynocal", own_jacobian)
    verdict.row("Jacobian: NumPy, recursion in Python", jacobian_s, own_jacobian)
    verdict.row("Jacobian: SciPy solve_banded for the recursion", banded_s, own_jacobian)
    compute, version = jax_jacobian(net)
    if compute is None:
        print("   JAX is not installed: left out")
    else:
        jax_s, found = measure(lambda: compute(theta))
        verdict.row(f"Jacobian: JAX {version} jacfwd, compiled", jax_s, own_jacobian)
        verdict.check("JAX agrees with the recursion", np.abs(found - exact).max() <= 1e-9 * np.abs(exact).max(),
                      f"{np.abs(found - exact).max() / np.abs(exact).max():.1e}")
    verdict.row(f"LM iteration: dynocal ({mine['evaluations']} evaluations in {mine['iterations']} iterations)", own)
    verdict.row(f"LM iteration: NumPy ({trials} evaluations in {ITERATIONS} iterations)", train_s / ITERATIONS, own)
    verdict.row("LM iteration: NumPy with solve_banded", train_banded_s / ITERATIONS, own)
    rows = net.n - START
    print(f"   mean squared error in scaled units: dynocal {mine['cost'] / rows:.4e}, NumPy {cost / rows:.4e}")
    own_jac = np.array(mine["jacobian"]).reshape(net.n, -1)[START:]
    difference = np.abs(own_jac - exact).max() / np.abs(exact).max()
    verdict.check("both Jacobians are the same", difference <= 1e-10, f"{difference:.1e}")
    norm = np.linalg.norm(own_jac)
    verdict.check(f"its Frobenius norm is {FROBENIUS} to 1e-10", abs(norm / FROBENIUS - 1) <= 1e-10, repr(float(norm)))
    verdict.check("error after as many evaluations no worse than the peer's", mine["cost"] <= cost, f"{mine['cost'] / cost:.3g} of it")
    ratio = own / (train_s / ITERATIONS)
    verdict.check(f"at most {ASKED_RATIO} of NumPy's time per iteration", ratio <= ASKED_RATIO, f"{ratio:.3g}")
    verdict.end()


def open_header(name):
    from common import reference
    return reference(name).read_text(encoding="utf-8").split("\n", 1)[0].split(",")


if __name__ == "__main__":
    main()
