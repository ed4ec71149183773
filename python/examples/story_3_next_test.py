"""Which test next: a plan inside limits that sharpens the parameters of a first model."""

import numpy as np

import dynocal


def main() -> None:
    u = dynocal.signal("aprbs", 400, 0.1, seed=2, lo=-1.0, hi=1.0, hold_s=0.5)
    draw = np.random.default_rng(2)
    y = np.zeros(400)
    for t in range(2, 400):
        y[t] = 1.2 * y[t - 1] - 0.5 * y[t - 2] + 2.0 * u[t - 1] + 1.0 * u[t - 1] ** 2
    record = dynocal.Dataset({"spark": u, "torque": y + 0.1 * draw.standard_normal(400)}, ts_s=0.1, outputs="torque",
                             units={"spark": "deg", "torque": "Nm"})
    model = dynocal.Polynomial(["torque(t-1)", "torque(t-2)", "spark(t-1)", "spark(t-1)^2"]).fit(record)
    limits = dynocal.Limits(spark=(-1.0, 1.0), spark_rate=15.0, torque=(-20.0, 20.0))
    done = dynocal.design(model, criterion="d", n=150, limits=limits, seed=1)
    plan = dynocal.plan(done)
    print(done)
    print(plan)
    print("greatest change per second:", float(np.abs(np.diff(plan["spark"])).max() / 0.1))


if __name__ == "__main__":
    main()
