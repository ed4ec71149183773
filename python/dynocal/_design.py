"""The next test: limits, the job `design` for a model in memory, and the record that it finds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from . import _arguments as arguments
from ._data import Dataset, read
from ._estimators import Estimator
from ._jobs import PathLike, Progress, Run, Spec, own_folder, run
from ._model import Model
from .errors import ArgumentError, RunError

__all__ = ["Limits", "design", "plan"]


@dataclass(frozen=True)
class Limits:
    """Limits of the channels of a test, each in the unit of its channel.

    ``Limits(spark=(0, 40), spark_rate=15, torque=(0, 250))``: a pair of a channel bounds it, ``NAME_rate`` is its greatest change per
    second, ``NAME_hold`` its least time at a value in s. Pairs of outputs bound what the model predicts. Where an input is called like that
    itself, a mapping says all of a channel: ``Limits(spark={"lower": 0, "upper": 40, "rate_per_s": 15, "hold_s": 1})``.
    """

    given: Mapping[str, Any] = field(default_factory=dict)

    def __init__(self, given: Mapping[str, Any] | None = None, /, **more: Any) -> None:
        object.__setattr__(self, "given", {**arguments.mapping("limits", given), **more})

    def _pair(self, name: str) -> tuple[float, float] | None:
        if name not in self.given:
            return None
        value = self.given[name]
        if isinstance(value, Mapping):
            keys = arguments.mapping(f"limits: {name}", value)
            for key in keys:
                arguments.one_of(f"limits: {name}: key", key, ["lower", "upper", "rate_per_s", "hold_s"])
            value = (keys.get("lower"), keys.get("upper"))
        if not isinstance(value, (tuple, list)) or len(value) != 2:
            raise ArgumentError(f"limits: {name}: found {arguments.kind(value)}, expected (least, greatest)")
        low, high = (arguments.number(f"limits: {name}[{k}]", v) for k, v in enumerate(value))
        if not low < high:
            raise ArgumentError(f"limits: {name}: found {low:g} to {high:g}, expected the least below the greatest")
        return low, high

    def _more(self, name: str, end: str, key: str, inputs: list[str]) -> float | None:
        """The rate or hold time of an input, unless that name is one of an input too."""
        own = self.given[name]
        if isinstance(own, Mapping):
            value = own.get(key)
        else:
            value = None if f"{name}{end}" in inputs else self.given.get(f"{name}{end}")
        return None if value is None else arguments.number(f"limits: {name}{end}", value, positive=True)

    def _channels(self, model: Model) -> tuple[list[dict[str, Any]], dict[str, Any]]:
        """Tables of the channels, and limits by output."""
        known = [f"{n}{end}" for n in model.inputs for end in ("", "_rate", "_hold")] + model.outputs
        for key in self.given:
            arguments.one_of("limits", key, known)
        channels = []
        for name in model.inputs:
            pair = self._pair(name)
            if pair is None:
                raise ArgumentError(f"limits: found none of the input `{name}`, expected {name}=(least, greatest)")
            table: dict[str, Any] = {"name": name, "unit": model.units[name], "lower": pair[0], "upper": pair[1]}
            for end, key in (("_rate", "rate_per_s"), ("_hold", "hold_s")):
                if (value := self._more(name, end, key, model.inputs)) is not None:
                    table[key] = value
            channels.append(table)
        outputs = {}
        for name in model.outputs:
            pair = self._pair(name)
            if pair is not None:
                outputs[name] = {"lower": pair[0], "upper": pair[1]}
        return channels, outputs


def design(
    what: Spec | Model | Estimator,
    *,
    criterion: str = "d",
    n: int | None = None,
    limits: Limits | Mapping[str, Any] | None = None,
    margin: float | None = None,
    search: Mapping[str, Any] | None = None,
    out: PathLike | None = None,
    seed: int | None = None,
    progress: Progress | bool | None = None,
) -> Run:
    """The most informative test signal within limits.

    Parameters
    ----------
    what
        A spec (file or mapping), or a model whose parameters the test is to sharpen.
    criterion
        One of ``dynocal.members("criteria")``, for a model.
    n
        Samples of the test, for a model.
    limits
        Limits of inputs and predicted outputs, for a model.
    margin
        Distance that predicted outputs keep from their limits, in their unit.
    search
        Table ``[search]`` of a spec.

    Returns
    -------
    Run
        ``plan(run)`` is the record of the test.
    """
    if isinstance(what, Estimator):
        what = what._fitted()
    if not isinstance(what, Model):
        if n is not None or limits is not None or margin is not None or search is not None:
            raise ArgumentError("design: found n, limits, margin or search beside a spec, which says them itself")
        return run("design", what, out=out, seed=seed, progress=progress)
    if n is None or limits is None:
        raise ArgumentError("design: found a model without n and limits, expected both")
    import tempfile

    step = what.ts_s
    if step is None:
        raise ArgumentError("what: found a model of present values, expected a dynamic one")
    bounds = limits if isinstance(limits, Limits) else Limits(limits)
    channels, outputs = bounds._channels(what)
    with tempfile.TemporaryDirectory() as folder:
        models = []
        for name in what.outputs:
            path = Path(folder) / f"{name}.json"
            what.single(name).save(path)
            table: dict[str, Any] = {"file": path, "criterion": arguments.text("criterion", criterion).lower()}
            if name in outputs:
                table["limits"] = {**outputs[name], "margin": 0.0 if margin is None else arguments.number("margin", margin)}
            models.append(table)
        spec: dict[str, Any] = {
            "name": "design",
            "length_s": arguments.count("n", n, 2) * step,
            "sample_time_s": step,
            "channels": channels,
            "models": models,
        }
        if search is not None:
            spec["search"] = arguments.mapping("search", search)
        if out is None:
            # The models' files are of this call alone: what is in them counts.
            told = [{k: v for k, v in m.items() if k != "file"} for m in models]
            out = own_folder("design", {**spec, "models": told}, *(m.to_json() for m in what._models), str(seed))
        return run("design", spec, out=out, seed=seed, progress=progress)


def plan(done: Run) -> Dataset:
    """The record of the test that a run of ``design`` found."""
    if not isinstance(done, Run):
        raise ArgumentError(f"done: found {arguments.kind(done)}, expected a run of design")
    done._unchanged()
    path = done.folder / "design.csv"
    if not path.is_file():
        raise RunError(f"{done.folder}: found no design.csv, expected a run of design")
    return read(path)
