"""The virtual engine as an object."""

from __future__ import annotations

import numpy as np
import pytest

import dynocal
from dynocal.errors import PlantError


def moved(engine: dynocal.Engine, n: int) -> np.ndarray:
    start = np.array(list(engine.start.values()))
    return start * (1.0 + 0.02 * np.sin(0.3 * np.arange(n)[:, None]))


def test_steps_are_the_run() -> None:
    engine = dynocal.Engine(keys={"torque_noise_nm": 1.0}, noise=True, seed=4)
    rows = moved(engine, 40)
    run = engine.run(rows, 0.03)
    assert len(run) == 40 and run.inputs == list(engine.inputs) and run.outputs == list(engine.outputs)
    engine.reset(4)
    one_by_one = [engine.step(row, 0.03) for row in rows]
    for name in engine.outputs:
        assert np.array_equal(run[name], [y[name] for y in one_by_one])
    assert engine.time_s == pytest.approx(1.2)
    assert run.units["torque"] == "Nm"


def test_a_saved_state_goes_on_exactly() -> None:
    engine = dynocal.Engine(keys={"torque_noise_nm": 1.0}, noise=True, seed=2)
    rows = moved(engine, 60)
    engine.run(rows[:30], 0.03)
    state = engine.save()
    rest = engine.run(rows[30:], 0.03)
    engine.restore(state)
    again = engine.run(rows[30:], 0.03)
    assert again == rest


def test_a_plan_may_name_some_inputs() -> None:
    engine = dynocal.Engine()
    (name, variable), *_ = engine.inputs.items()
    plan = dynocal.Dataset({name: np.full(10, variable.start)}, ts_s=0.03)
    run = engine.run(plan)
    assert all(np.allclose(run[n], v.start) for n, v in engine.inputs.items())


def test_ranges_are_kept() -> None:
    engine = dynocal.Engine()
    before = engine.time_s
    with pytest.raises(PlantError, match="outside"):
        engine.step({**engine.start, "speed": 1e6}, 0.03)
    assert engine.time_s == before
    assert isinstance(engine.events(), list)


def test_literature_systems_are_plants_too() -> None:
    plant = dynocal.Engine(name="torque_5_3")
    step = plant.step(plant.start, 0.1)
    assert set(step) == set(plant.outputs)
