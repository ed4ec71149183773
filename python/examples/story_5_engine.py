"""The virtual engine as an object: a plan is played, a state saved, and the future told twice."""

import numpy as np

import dynocal


def main() -> None:
    engine = dynocal.Engine("thesis", keys={"torque_noise_nm": 0.5}, noise=True, seed=1)
    throttle = engine.inputs["throttle"]
    u = dynocal.signal("aprbs", 300, 0.03, seed=3, lo=throttle.start, hi=throttle.start + 5.0, hold_s=0.3)
    record = engine.run(dynocal.Dataset({"throttle": u}, ts_s=0.03))
    print(record)
    state = engine.save()
    once = engine.run(dynocal.Dataset({"throttle": u[:50]}, ts_s=0.03))
    engine.restore(state)
    twice = engine.run(dynocal.Dataset({"throttle": u[:50]}, ts_s=0.03))
    print("the same future from a saved state, noise included:", once == twice)
    train, test = record.with_roles("throttle", "torque").split(fraction=0.7)
    fitted = dynocal.Arx(na=2, nb=4).fit(train)
    print(fitted.score(test))
    print("touched limits:", len(engine.events()), "| torque from", round(float(np.min(record["torque"])), 1), "Nm up")


if __name__ == "__main__":
    main()
