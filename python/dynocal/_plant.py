"""The virtual engine and other plants as objects."""

from __future__ import annotations

import html
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from . import _arguments as arguments
from . import _dynocal
from ._arguments import FloatArray
from ._data import Dataset
from .errors import ArgumentError, FileError

__all__ = ["Engine", "LimitEvent", "Variable"]


@dataclass(frozen=True)
class Variable:
    """A variable of a plant: its unit, its range, and its value after a reset."""

    name: str
    unit: str
    low: float
    high: float
    start: float


@dataclass(frozen=True)
class LimitEvent:
    """A limit that was touched."""

    time_s: float
    what: str
    value: float
    limit: float


class Engine:
    """A plant in its state: the virtual engine, a user's FMU, or a system of the literature.

    Parameters
    ----------
    parameters
        Parameter set (``dynocal.members("parameters")``), or a file of one.
    name
        Plant (``dynocal.members("plants")``).
    noise
        Whether its sensors are noisy as the keys say.
    seed
        Seed of the sensors.
    keys
        Further keys of ``[plant]`` of a spec: ``bed``, ``torque_noise_nm``, ``file``, ..

    Examples
    --------
    >>> e = Engine()
    >>> y = e.step(e.start, ts_s=0.03)
    >>> sorted(y) == sorted(e.outputs)
    True
    """

    def __init__(
        self,
        parameters: str | None = None,
        *,
        name: str = "virtual_engine",
        noise: bool = False,
        seed: int = 0,
        keys: Mapping[str, Any] | None = None,
    ) -> None:
        given = arguments.mapping("keys", keys)
        spec = {**given, "name": arguments.text("name", name)}
        if parameters is not None:
            spec["parameters"] = arguments.text("parameters", parameters)
        file = given.get("file")
        if isinstance(file, (str, os.PathLike)) and not Path(file).exists():
            raise FileError(f"file: found nothing at {file}, expected a file")
        self._spec, self._noise = spec, bool(noise)
        self._plant = _dynocal.Plant(spec, self._noise)
        self.reset(seed)

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuilt, (self._spec, self._noise, self.save())

    # ------------------------------------------------------------------ what it is

    def _variables(self, inputs: bool) -> dict[str, Variable]:
        found = [v for v in self._plant.variables() if v[2] == inputs]
        return {n: Variable(n, unit, low, high, start) for n, unit, _, low, high, start in found}

    @property
    def inputs(self) -> dict[str, Variable]:
        """Inputs by name, in the order that arrays have."""
        return self._variables(True)

    @property
    def outputs(self) -> dict[str, Variable]:
        """Outputs by name, in the order that arrays have."""
        return self._variables(False)

    @property
    def start(self) -> dict[str, float]:
        """Inputs after a reset."""
        return {n: v.start for n, v in self.inputs.items()}

    @property
    def time_s(self) -> float:
        """Time in s since the reset."""
        return self._plant.time_s

    def __repr__(self) -> str:
        return f"<Engine {self._plant.describe()} at {self.time_s:g} s>"

    def _repr_html_(self) -> str:
        shown = self.shown
        rows = [
            (v.name, v.unit, kind, f"{v.low:g}", f"{v.high:g}", f"{shown[v.name]:.5g}" if kind == "output" else f"{v.start:.5g} at the start")
            for kind, known in (("input", self.inputs), ("output", self.outputs))
            for v in known.values()
        ]
        head = "".join(f"<th>{c}</th>" for c in ("variable", "unit", "", "least", "greatest", "value"))
        body = "".join("<tr>" + "".join(f"<td>{html.escape(c)}</td>" for c in row) + "</tr>" for row in rows)
        return f"<p>{html.escape(repr(self)[1:-1])}</p><table><tr>{head}</tr>{body}</table>"

    # ------------------------------------------------------------------ runs

    def reset(self, seed: int = 0) -> dict[str, float]:
        """Back to the start; returns what the plant shows."""
        self._plant.reset(arguments.count("seed", seed, 0, 2**63 - 1))
        return self.shown

    @property
    def shown(self) -> dict[str, float]:
        """Outputs as they are now."""
        return dict(zip(self.outputs, self._plant.outputs().tolist(), strict=True))

    def step(self, u: Mapping[str, float] | object, ts_s: float) -> dict[str, float]:
        """Holds inputs for ``ts_s`` seconds; returns what a bed would record, by name."""
        if isinstance(u, Mapping):
            known = self.inputs
            for name in u:
                arguments.one_of("u", name, known)
            missing = [n for n in known if n not in u]
            if missing:
                raise ArgumentError(f"u: found no {', '.join(missing)}, expected a value of each input")
            values = np.array([arguments.number(f"u[{n!r}]", u[n], v.unit) for n, v in known.items()])
        else:
            values = arguments.finite("u", arguments.array("u", u))
            if values.ndim != 1:
                raise ArgumentError(f"u: found shape {values.shape}, expected ({len(self.inputs)},)")
        y = self._plant.step(values, arguments.number("ts_s", ts_s, "seconds", positive=True))
        return dict(zip(self.outputs, y.tolist(), strict=True))

    def run(self, plan: Dataset | object, ts_s: float | None = None, *, progress: Any = None) -> Dataset:
        """Plays a plan from the present state on.

        Parameters
        ----------
        plan
            Dataset with the inputs as channels in the units of the plant (``-`` where nobody says one; those that it does not have stay at their start
            values), or (N, inputs).
        ts_s
            Sample time in s; with an array only.

        Returns
        -------
        Dataset
            Inputs and outputs: row t holds the inputs of the interval that begins there and what is recorded at its end.
        """
        variables = self.inputs
        if isinstance(plan, Dataset):
            if plan.is_steady or plan.ts_s is None:
                raise ArgumentError("plan: found steady points, expected a record in time")
            if ts_s is not None:
                raise ArgumentError("ts_s: found it beside a Dataset, which has its own")
            step = plan.ts_s
            if not any(n in plan for n in variables):
                raise ArgumentError(f"plan: found the channels {', '.join(plan)}, expected at least one of {', '.join(variables)}")
            self._fits(plan, variables)
            rows = np.column_stack([plan[n] if n in plan else np.full(len(plan), v.start) for n, v in variables.items()])
        else:
            rows = arguments.finite("plan", arguments.columns("plan", plan))
            if ts_s is None:
                raise ArgumentError("ts_s: found None, expected the sample time in s of the rows")
            step = arguments.number("ts_s", ts_s, "seconds", positive=True)
            if rows.shape[1] != len(variables):
                raise ArgumentError(f"plan: found {rows.shape[1]} columns, expected {len(variables)}: {', '.join(variables)}")
        y: FloatArray = self._plant.run(np.ascontiguousarray(rows), step, arguments.callback(progress))
        columns = {n: rows[:, k] for k, n in enumerate(variables)}
        columns.update({n: y[:, k] for k, n in enumerate(self.outputs)})
        units = {n: v.unit for n, v in {**variables, **self.outputs}.items()}
        return Dataset(columns, ts_s=step, inputs=list(variables), outputs=list(self.outputs), units=units, name="engine")

    def _fits(self, plan: Dataset, variables: Mapping[str, Variable]) -> None:
        """Refuses inputs that the plant does not have and units that it does not take: they would be played as something else."""
        outputs = self.outputs
        for name in plan.inputs:
            if name not in variables and name not in outputs:
                raise ArgumentError(
                    f"plan: found the input `{name}`, expected inputs out of {', '.join(variables)}: with_roles(inputs=..) says which are meant"
                )
        for name, v in variables.items():
            unit = plan.units.get(name, "-")
            if unit not in ("-", v.unit):
                raise ArgumentError(f"plan: found `{name}` in {unit}, expected {v.unit}")

    # ------------------------------------------------------------------ state

    def save(self) -> FloatArray:
        """The whole state, noise included, as numbers that mean something to this plant only."""
        return self._plant.save()

    def restore(self, state: object) -> None:
        """Goes on from a saved state exactly."""
        values = arguments.array("state", state)
        if values.ndim != 1:
            raise ArgumentError(f"state: found shape {values.shape}, expected what save() gave")
        self._plant.restore(values)

    def events(self) -> list[LimitEvent]:
        """Limits that were touched since the last call."""
        return [LimitEvent(*e) for e in self._plant.events()]


def _rebuilt(spec: dict[str, Any], noise: bool, state: FloatArray) -> Engine:
    """A plant in a state that was saved."""
    new = Engine.__new__(Engine)
    new._spec, new._noise, new._plant = spec, noise, _dynocal.Plant(spec, noise)
    new._plant.restore(state)
    return new
