"""From arrays, with the manners of scikit-learn: fit, simulate, predict, pickle."""

import pickle

import numpy as np

import dynocal


def main() -> None:
    u = dynocal.signal("aprbs", 1000, 0.01, seed=1, lo=-1.0, hi=1.0, hold_s=0.05)
    noise = 0.02 * np.random.default_rng(1).standard_normal(1000)
    y = np.zeros(1000)
    for t in range(2, 1000):
        y[t] = 1.6 * y[t - 1] - 0.7 * y[t - 2] + 0.1 * u[t - 1] + 0.05 * u[t - 1] * u[t - 2]
    z = y + noise
    fitted = dynocal.Narx(ylag=2, xlag=2, degree=2, estimator="sem").fit(u[:600], z[:600], ts_s=0.01)
    free = fitted.simulate(u[600:], y0=z[600:602])
    ahead = fitted.predict(u[600:], z[600:], steps=1)
    print("parameters:", {name: round(value, 3) for name, value in fitted.parameters_.items()})
    print("free run, RMSE to the noise-free output:", float(np.sqrt(np.mean((free - y[600:]) ** 2))))
    print("one step, RMSE to the measured output:", float(np.sqrt(np.mean((ahead - z[600:]) ** 2))))
    again = pickle.loads(pickle.dumps(fitted))
    print("the same after pickling:", bool(np.array_equal(again.simulate(u), fitted.simulate(u))))


if __name__ == "__main__":
    main()
