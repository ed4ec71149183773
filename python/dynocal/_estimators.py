"""Estimators: a structure with the way its parameters are found.

Keyword arguments are stored as they are given, ``fit`` returns the estimator, what is learnt ends in an underscore.
"""

from __future__ import annotations

import html
import inspect
from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeVar, overload

import numpy as np
import numpy.typing as npt

from . import _arguments as arguments
from . import _dynocal
from ._arguments import FloatArray
from ._data import Dataset
from ._model import Model
from ._scores import Finding, Scores, findings_of
from .errors import ArgumentError, DataError, NotFittedError, warn

__all__ = ["Estimator"]

Progress = Callable[[str, "float | None"], object]
Self = TypeVar("Self", bound="Estimator")


class Estimator:
    """Any structure of ``dynocal list models`` with any estimator of ``dynocal list estimators``.

    Parameters
    ----------
    structure
        Name of the structure.
    estimator
        Name of the estimator, or a mapping of ``name`` and its keys; by default least squares of one step (``ols``), and for response
        models their own learning (``learn``).
    keys
        Keys of the structure.
    select
        Selection of terms: a mapping of ``name`` and keys, as ``[model.select]`` of a spec.
    prepare
        Steps of the preparation, as ``[[prepare]]`` of a spec; they are stored with the model.
    seed
        Seed of estimators that draw.

    Examples
    --------
    >>> Estimator("arx", "ols", keys={"na": 2, "nb": 2})
    Estimator(structure='arx', estimator='ols', keys={'na': 2, 'nb': 2})
    """

    model_: Model
    """The model, after :meth:`fit`."""
    findings_: list[Finding]
    """What the estimate says of itself, most important first."""
    status_: list[str | None]
    """How the search of each output ended: ``converged``, ``stalled``, ``limit``, ..."""
    n_evaluations_: list[int]
    """Evaluations of the cost of each output."""

    def __init__(
        self,
        structure: str = "arx",
        estimator: str | Mapping[str, Any] | None = None,
        *,
        keys: Mapping[str, Any] | None = None,
        select: Mapping[str, Any] | None = None,
        prepare: Iterable[Mapping[str, Any]] | None = None,
        seed: int | None = None,
    ) -> None:
        self.structure = structure
        self.estimator: str | Mapping[str, Any] | None = estimator
        self.keys = keys
        self.select = select
        self.prepare = prepare
        self.seed = seed

    # ------------------------------------------------------------------ parameters

    @classmethod
    def _names(cls) -> list[str]:
        return [p for p in inspect.signature(cls.__init__).parameters if p != "self"]

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Parameters of the constructor, as they were given."""
        return {name: getattr(self, name) for name in self._names()}

    def set_params(self: Self, **params: Any) -> Self:
        """Sets parameters of the constructor."""
        known = self._names()
        for name, value in params.items():
            arguments.one_of(f"{type(self).__name__}: the parameter", name, known)
            setattr(self, name, value)
        return self

    def __repr__(self) -> str:
        defaults = {n: p.default for n, p in inspect.signature(type(self).__init__).parameters.items()}
        shown = []
        for name, value in self.get_params().items():
            same = value is defaults[name]
            if not same:
                try:
                    same = type(value) is type(defaults[name]) and bool(value == defaults[name])
                except (TypeError, ValueError):
                    same = False
            if not same or type(self) is Estimator and name == "structure":
                shown.append(f"{name}={value!r}")
        return f"{type(self).__name__}({', '.join(shown)})"

    def _repr_html_(self) -> str:
        model = getattr(self, "model_", None)
        if model is None:
            return f"<p>{html.escape(repr(self))}, not fitted</p>"
        said = "".join(f"<li>{html.escape(str(f))}</li>" for f in self.findings_)
        return f"<p>{html.escape(repr(self))}</p>{model._repr_html_()}" + (f"<ul>{said}</ul>" if said else "")

    def _structure(self) -> tuple[str, dict[str, Any]]:
        """Name and keys of the structure."""
        return arguments.text("structure", self.structure), arguments.mapping("keys", self.keys)

    def _tables(self) -> dict[str, Any]:
        """The tables of a spec that this is."""
        name, keys = self._structure()
        for key, value in keys.items():
            if value is None:
                raise ArgumentError(f"{key}: found None, expected a value: leave it out for the default")
        estimator = self._estimator(name)
        model: dict[str, Any] = {"estimator": estimator, "select": self.select}
        if name != "pool":
            model["structure"] = {"name": name, **keys}
        if name in _RESPONSES and estimator == {"name": "learn"}:
            del model["estimator"]
        tables: dict[str, Any] = {"model": model}
        if self.prepare is not None:
            tables["prepare"] = [arguments.mapping(f"prepare[{k}]", s) for k, s in enumerate(self.prepare)]
        return tables

    def _estimator(self, structure: str) -> dict[str, Any]:
        """Name and keys of the estimator."""
        chosen = self.estimator
        if chosen is None:
            chosen = "learn" if structure in _RESPONSES else "ols"
        return {"name": chosen} if isinstance(chosen, str) else arguments.mapping("estimator", chosen)

    # ------------------------------------------------------------------ fit

    def fit(
        self: Self,
        u: object,
        y: object = None,
        *,
        inputs: str | Iterable[str] | None = None,
        outputs: str | Iterable[str] | None = None,
        ts_s: float | None = None,
        selecting: Dataset | Iterable[Dataset] | None = None,
        progress: Progress | bool | None = None,
    ) -> Self:
        """Estimates a model for each output.

        Parameters
        ----------
        u
            A Dataset, a list of them (experiments), a table with ``__arrow_c_stream__``, or inputs (N,) or (N, m), a frame of inputs
            too.
        y
            Outputs (N,) or (N, p), a series or frame too; beside inputs only.
        inputs, outputs
            Channels, where the roles of the Dataset are not meant; names of the columns of arrays (those of frames and
            series, else u, u1, .. and y, y1, ..).
        ts_s
            Sample time in s of arrays and tables; 1 where neither it nor the index of a frame is given.
        selecting
            Records that choose between candidates: where ``train`` stops.
        progress
            Called as ``progress(text, fraction)``.

        Returns
        -------
        The estimator. ``model_`` is the model, ``findings_`` what the estimate says of itself; a fault among them is a
        ``ResultWarning`` too.

        Raises
        ------
        ArgumentError, DataError, SpecError, EstimateError
        """
        records = _records(u, y, inputs, outputs, ts_s)
        if selecting is not None:
            chosen = [selecting] if isinstance(selecting, Dataset) else arguments.listed("selecting", selecting, "a Dataset or a list of them")
            for k, d in enumerate(chosen):
                if not isinstance(d, Dataset):
                    raise ArgumentError(f"selecting[{k}]: found {arguments.kind(d)}, expected a Dataset")
            selecting = chosen
        others = _records(selecting, None, inputs, outputs, None) if selecting else []
        first = records[0]
        outs = first.outputs
        if not outs:
            raise ArgumentError(f"outputs: found none, expected at least one of {', '.join(first.channels)}")
        tables = self._tables()
        tables["model"].update(targets=outs, inputs=first.inputs)
        if first.is_steady and not self._takes_points():
            raise DataError(f"{first.name}: found steady points, expected a record in time (ts_s=) for a dynamic model")
        chooses = tables["model"].get("estimator", {}).get("name")
        if others and chooses != "train":
            raise ArgumentError(
                f"selecting: found records beside the estimator `{chooses or 'learn'}`, expected none: it does not choose between candidates "
                "by records of their own (`train` does)"
            )
        seed = None if self.seed is None else arguments.count("seed", self.seed, 0, 2**63 - 1)
        name = type(self).__name__
        learnt = _dynocal.learn(
            name,
            tables,
            [d._record for d in records],
            [d._record for d in others],
            first.is_steady,
            seed,
            arguments.callback(progress),
        )
        self.model_ = Model(one[0] for one in learnt)
        self.status_ = [one[1] for one in learnt]
        self.n_evaluations_ = [one[2] for one in learnt]
        self.findings_ = findings_of(said for one in learnt for said in one[5])
        for fault in (f for f in self.findings_ if f.grade == "fault"):
            warn(f"{fault.about}: {fault.text}")
        return self

    def _takes_points(self) -> bool:
        """Whether the structure reads present values alone."""
        name, keys = self._structure()
        if name == "polynomial":
            return not any("(t-" in text.replace(" ", "") for text in keys.get("regressors", ()) if isinstance(text, str))
        return name in _RESPONSES and not (keys.get("input_lags") or keys.get("output_lags"))

    def _fitted(self) -> Model:
        model = getattr(self, "model_", None)
        if model is None:
            raise NotFittedError(f"this {type(self).__name__} is not fitted: call fit(...) first")
        return model  # type: ignore[no-any-return]

    @property
    def parameters_(self) -> dict[str, float]:
        """Parameters of a model of one output."""
        return self._fitted().parameters

    @overload
    def simulate(self, u: Dataset, *, initial: str | None = None) -> Dataset: ...
    @overload
    def simulate(self, u: npt.ArrayLike, *, y0: npt.ArrayLike | None = None) -> FloatArray: ...
    def simulate(
        self, u: npt.ArrayLike | Dataset, *, y0: npt.ArrayLike | None = None, initial: str | None = None
    ) -> FloatArray | Dataset:
        """Free run: :meth:`Model.simulate`."""
        model = self._fitted()
        if isinstance(u, Dataset):
            if y0 is not None:
                raise ArgumentError("y0: found it beside a Dataset, expected initial= (the Dataset holds the outputs)")
            return model.simulate(u, initial=initial)
        if initial is not None:
            raise ArgumentError("initial: found it beside arrays, expected y0= or a Dataset")
        return model.simulate(u, y0=y0)

    @overload
    def predict(self, u: Dataset, y: None = None, *, steps: int = 1) -> Dataset: ...
    @overload
    def predict(self, u: npt.ArrayLike, y: npt.ArrayLike, *, steps: int = 1) -> FloatArray: ...
    def predict(
        self, u: npt.ArrayLike | Dataset, y: npt.ArrayLike | None = None, *, steps: int = 1
    ) -> FloatArray | Dataset:
        """Some samples ahead of measured outputs: :meth:`Model.predict`."""
        model = self._fitted()
        if isinstance(u, Dataset):
            if y is not None:
                raise ArgumentError("y: found it beside a Dataset, expected the outputs inside of it")
            return model.predict(u, steps=steps)
        if y is None:
            raise ArgumentError("y: found None, expected measured outputs: without them only simulate(u) can be computed")
        return model.predict(u, y, steps=steps)

    def score(self, *records: Dataset, k_steps: Iterable[int] = ()) -> Scores:
        """Scores on records: :meth:`Model.score`."""
        return self._fitted().score(*records, k_steps=k_steps)


def _records(
    u: object,
    y: object,
    inputs: str | Iterable[str] | None,
    outputs: str | Iterable[str] | None,
    ts_s: float | None,
) -> list[Dataset]:
    """What is fitted, as records with roles."""
    ins = None if inputs is None else arguments.names("inputs", inputs)
    outs = None if outputs is None else arguments.names("outputs", outputs)
    if isinstance(u, Dataset):
        u = [u]
    if isinstance(u, (list, tuple)) and u and all(isinstance(d, Dataset) for d in u):
        if y is not None:
            raise ArgumentError("y: found it beside a Dataset, expected the outputs inside of it")
        if ts_s is not None:
            raise ArgumentError("ts_s: found it beside a Dataset, which has its own")
        records = [d if ins is None and outs is None else d.with_roles(ins, outs) for d in u]
        names = records[0].inputs, records[0].outputs
        for d in records[1:]:
            if (d.inputs, d.outputs) != names:
                raise DataError(f"{d.name}: found inputs {d.inputs} and outputs {d.outputs}, expected {names[0]} and {names[1]}")
        return records
    if y is None and (hasattr(u, "__arrow_c_stream__") or isinstance(u, Mapping)):
        return [_of_table(u, ts_s, ins, outs)]
    if y is None:
        raise ArgumentError(f"y: found None beside {arguments.kind(u)}, expected outputs (N,) or (N, p), or a Dataset as u")
    # A frame knows the names of its channels, and its index may be the time.
    if ts_s is None and arguments.table_columns(u) is not None and hasattr(u, "index"):
        ts_s = Dataset(u, inputs=arguments.table_columns(u), missing=True).ts_s
    ins = arguments.table_columns(u) if ins is None else ins
    outs = _names_of(y) if outs is None else outs
    a, b = arguments.columns("u", _plain(u)), arguments.columns("y", _plain(y))
    if len(a) != len(b):
        raise ArgumentError(f"y: found {len(b)} samples, expected {len(a)} as of u")
    arguments.finite("u", a)
    arguments.finite("y", b)

    def called(what: str, given: list[str] | None, columns: int) -> list[str]:
        own = [what] if columns == 1 else [f"{what}{k + 1}" for k in range(columns)]
        if given is not None and len(given) != columns:
            raise ArgumentError(f"{what}: found {columns} channels and {len(given)} names, expected as many")
        return given or own

    ins, outs = called("u", ins, a.shape[1]), called("y", outs, b.shape[1])
    for name in ins:
        if name in outs:
            raise ArgumentError(f"inputs: found `{name}`, which is an output as well")
    columns = {**{n: a[:, k] for k, n in enumerate(ins)}, **{n: b[:, k] for k, n in enumerate(outs)}}
    step = 1.0 if ts_s is None else arguments.number("ts_s", ts_s, "seconds", positive=True)
    return [Dataset(columns, ts_s=step, inputs=ins, outputs=outs, name="arrays")]


def _of_table(table: object, ts_s: float | None, ins: list[str] | None, outs: list[str] | None) -> Dataset:
    """A table as a record in time: the index of a frame may say its stamps, else samples are ``ts_s`` apart, 1 s where nobody says."""
    if ts_s is None:
        found = Dataset(table, inputs=ins, outputs=outs)
        if not found.is_steady:
            return found
        ts_s = 1.0
    return Dataset(table, ts_s=ts_s, inputs=ins, outputs=outs)


def _names_of(y: object) -> list[str] | None:
    """Names of outputs that come as a frame, or as a series with a name."""
    found = arguments.table_columns(y)
    name = getattr(y, "name", None)
    return [name] if found is None and isinstance(name, str) and name else found


def _plain(value: object) -> object:
    """A mapping as columns; what knows how to be an array does that itself."""
    if isinstance(value, Mapping):
        return np.column_stack([arguments.array(f"[{k!r}]", v) for k, v in value.items()]) if value else np.zeros((1, 0))
    return value


_RESPONSES = ("gaussian_process", "local_linear", "rbf", "stepwise_polynomial", "mean_of", "best_of")
