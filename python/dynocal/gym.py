"""The virtual engine as a Gymnasium environment, for people who learn controllers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from . import _arguments as arguments
from ._data import _package
from ._plant import Engine
from .errors import ArgumentError, PlantError

_package("gymnasium", "dynocal.gym")

import gymnasium  # noqa: E402

__all__ = ["TorqueEnv"]

Reward = Callable[[Mapping[str, float], float], float]


class TorqueEnv(gymnasium.Env):  # type: ignore[misc]
    """Follow a demand of torque by actuators of the virtual engine.

    Parameters
    ----------
    actuators
        Inputs that an action sets; others stay at their start values, unless ``given`` has them.
    demand_nm
        Least and greatest demand. It steps at random between levels that are held for ``hold_s`` seconds.
    ts_s
        Sample time in s.
    length
        Samples of an episode, after which it is truncated.
    given
        Values of further inputs.
    reward
        Of the outputs by name and the demand in Nm; by default minus the squared error of torque relative to the range of the
        demand.
    engine
        Keyword arguments of :class:`dynocal.Engine`.

    Observations are the outputs of the plant, divided by the sizes of their ranges, and the demand from 0 to 1; actions are the
    actuators from -1 to 1 over their ranges. An action that the plant refuses ends the episode. It can be copied, pickled and taken along by a
    fork (``gymnasium.vector.AsyncVectorEnv``).
    """

    metadata: dict[str, Any] = {"render_modes": []}

    def __init__(
        self,
        actuators: Sequence[str] = ("throttle",),
        *,
        demand_nm: tuple[float, float] = (20.0, 80.0),
        ts_s: float = 0.03,
        hold_s: float = 1.5,
        length: int = 500,
        given: Mapping[str, float] | None = None,
        reward: Reward | None = None,
        engine: Mapping[str, Any] | None = None,
    ) -> None:
        self.plant = Engine(**arguments.mapping("engine", engine))
        self.actuators = arguments.names("actuators", actuators)
        if not self.actuators:
            raise ArgumentError("actuators: found none, expected at least one")
        self.given = {n: arguments.number(f"given[{n!r}]", v) for n, v in arguments.mapping("given", given).items()}
        for what, names in (("actuators", self.actuators), ("given", self.given)):
            for name in names:
                arguments.one_of(what, name, self.plant.inputs)
        self.ts_s = arguments.number("ts_s", ts_s, "seconds", positive=True)
        self.length = arguments.count("length", length, 1)
        self.hold = max(1, round(arguments.number("hold_s", hold_s, "seconds", positive=True) / self.ts_s))
        if not isinstance(demand_nm, (tuple, list)) or len(demand_nm) != 2:
            raise ArgumentError(f"demand_nm: found {arguments.kind(demand_nm)}, expected (least, greatest) in Nm")
        low, high = (arguments.number("demand_nm", v, "Nm") for v in demand_nm)
        if not low < high:
            raise ArgumentError(f"demand_nm: found {low:g} to {high:g}, expected the least below the greatest")
        self.demand_range = (low, high)
        if reward is not None and not callable(reward):
            raise ArgumentError(f"reward: found {arguments.kind(reward)}, expected a function of outputs and demand")
        self._t, self._demands = self.length, np.zeros(0)
        self._reward = reward or self._squared
        outputs = self.plant.outputs
        if "torque" not in outputs:
            raise ArgumentError(f"engine: found the outputs {', '.join(outputs)}, expected one called torque")
        size = [max(abs(v.low), abs(v.high)) for v in outputs.values()]
        self._scale = np.array([s if np.isfinite(s) and s > 0.0 else 1.0 for s in size])
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (len(outputs) + 1,), np.float64)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (len(self.actuators),), np.float64)

    def _squared(self, y: Mapping[str, float], demand: float) -> float:
        low, high = self.demand_range
        return -(((y["torque"] - demand) / (high - low)) ** 2)

    def _draw(self) -> None:
        low, high = self.demand_range
        levels = self.np_random.uniform(low, high, self.length // self.hold + 2)
        self._demands = np.repeat(levels, self.hold)

    def _observed(self, y: Mapping[str, float]) -> Any:
        low, high = self.demand_range
        demand = (self._demands[self._t] - low) / (high - low)
        return np.append(np.array(list(y.values())) / self._scale, demand)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """A new episode; the seed draws demands and noise of the sensors."""
        super().reset(seed=seed)
        self._t = 0
        self._draw()
        shown = self.plant.reset(int(self.np_random.integers(2**62)))
        return self._observed(shown), {"demand_nm": float(self._demands[0]), **shown}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Holds the actuators for a sample."""
        if self._t >= self.length:
            raise PlantError("step: found no episode that goes on, expected a call of reset() before")
        asked = arguments.finite("action", arguments.array("action", action))
        if asked.shape != (len(self.actuators),):
            raise ArgumentError(f"action: found shape {asked.shape}, expected ({len(self.actuators)},)")
        share = np.clip(asked, -1.0, 1.0)
        inputs = self.plant.inputs
        u = {**self.plant.start, **self.given}
        for name, s in zip(self.actuators, share, strict=True):
            v = inputs[name]
            u[name] = min(max(v.low + (float(s) + 1.0) / 2.0 * (v.high - v.low), v.low), v.high)
        demand = float(self._demands[self._t])
        try:
            y, refused = self.plant.step(u, self.ts_s), ""
        except PlantError as error:
            y, refused = self.plant.shown, str(error)
        self._t += 1
        info = {"demand_nm": float(self._demands[self._t]), "refused": refused, **y}
        seen, over = self._observed(y), self._t >= self.length
        if refused:
            # Nothing goes on from a state that the plant did not take.
            self._t = self.length
        return seen, float(self._reward(y, demand)), bool(refused), over, info
