"""Estimated models: run, scored, stored."""

from __future__ import annotations

import html
import json
import os
from collections.abc import Iterable, Mapping, Sized
from pathlib import Path
from typing import Any, overload

import numpy as np
import numpy.typing as npt

from . import _arguments as arguments
from . import _dynocal
from ._arguments import FloatArray
from ._data import Dataset
from ._scores import Score, Scores, findings_of, kind_of
from .errors import ArgumentError, ModelError, warn

__all__ = ["Model"]


class Model:
    """A stored model, or several that answer different outputs: what ``identify`` writes and everything else reads.

    :meth:`simulate` is a free run: measured outputs are only its start. :meth:`predict` looks ``steps`` samples ahead of measured
    outputs. The two are never compared.

    Examples
    --------
    >>> import numpy as np, dynocal
    >>> u = np.sin(np.arange(200.0)) + np.cos(np.arange(200.0) ** 1.3)
    >>> y = np.zeros(200)
    >>> for t in range(1, 200):
    ...     y[t] = 0.8 * y[t - 1] + 0.5 * u[t - 1]
    >>> m = dynocal.Arx(na=1, nb=1, constant=False).fit(u, y, ts_s=0.1)
    >>> {name: round(value, 6) for name, value in m.parameters_.items()}
    {'u(t-1)': 0.5, 'y(t-1)': 0.8}
    >>> bool(np.abs(m.simulate(u) - y).max() < 1e-9)
    True
    """

    _models: tuple[_dynocal.Model, ...]
    _names: list[str]
    _columns: list[list[int] | slice]

    def __init__(self, models: Iterable[_dynocal.Model]) -> None:
        self._models = tuple(models)
        own = [[name for name, _ in m.inputs()] for m in self._models]
        self._names = list(dict.fromkeys(name for names in own for name in names))
        # A call over few samples is short: what it looks up is known before.
        self._columns = [slice(None) if names == self._names else [self._names.index(n) for n in names] for names in own]
        if not self._models:
            raise ArgumentError("models: found none, expected at least one")
        outputs = [m.output()[0] for m in self._models]
        for k, m in enumerate(self._models):
            if outputs[k] in outputs[:k]:
                raise ModelError(f"models: the output `{outputs[k]}` is that of two of them, expected one model for each")
            for name, _ in m.inputs():
                if len(outputs) > 1 and name in outputs:
                    raise ModelError(
                        f"models: the input `{name}` of the model of `{outputs[k]}` is the output of another: models that drive "
                        "each other are run by dynocal.identify with their files"
                    )

    # ------------------------------------------------------------------ files

    @classmethod
    def load(cls, *paths: str | os.PathLike[str]) -> Model:
        """Reads model files (``model.json`` of ``identify``), one for each output."""
        if not paths:
            raise ArgumentError("paths: found none, expected at least one model file")
        return cls(_dynocal.Model.load(arguments.path("path", p)) for p in paths)

    @classmethod
    def from_system(
        cls,
        system: Any,
        *,
        ts_s: float | None = None,
        input: str | Iterable[str] | None = None,
        output: str = "y",
        units: Mapping[str, str] | None = None,
    ) -> Model:
        """A sampled linear system of one output as a model, without a noise model.

        Parameters
        ----------
        system
            ``scipy.signal.dlti``, ``control.TransferFunction`` (or what has ``to_tf``), or a pair of coefficients of z^0, z^-1, ..:
            ``(num, den)``.
        ts_s
            Sample time in s, where the system has none.
        input, output
            Names of its channels.
        units
            Units by name; ``-`` where none is given.
        """
        from ._systems import from_system

        return from_system(system, ts_s=ts_s, input=input, output=output, units=units)

    def to_fmu(self, path: str | os.PathLike[str], *, version: str = "2.0") -> Path:
        """Writes a model of one output as an FMU of FMI 2.0 or 3.0."""
        return self._export(path, {"2.0": "fmu2", "3.0": "fmu3"}[arguments.one_of("version", version, ["2.0", "3.0"])])

    def to_onnx(self, folder: str | os.PathLike[str]) -> list[Path]:
        """Writes a model of one output, e.g. a network, as ONNX: files of one step and of the free run."""
        import tempfile

        one = self._one("to_onnx")
        with tempfile.TemporaryDirectory() as place:
            one.save(str(Path(place) / "model.json"))
            files, _ = _dynocal.export(str(Path(place) / "model.json"), ["onnx"], arguments.path("folder", folder), True, False, None)
        return [Path(f) for f in files]

    def _export(self, path: str | os.PathLike[str], format: str) -> Path:
        import tempfile

        from ._results import to_file

        one = self._one(f"to_{format.rstrip('23')}")
        with tempfile.TemporaryDirectory() as folder:
            source = Path(folder) / "model.json"
            one.save(str(source))
            return to_file(source, path, format)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the file that ``identify`` would; a model of several outputs writes one for each by :meth:`single`."""
        self._one("save").save(arguments.path("path", path))

    def single(self, output: str) -> Model:
        """The model of one output."""
        arguments.one_of("output", output, self.outputs)
        return Model([m for m in self._models if m.output()[0] == output])

    def to_json(self) -> str:
        """The text of the file."""
        return self._one("to_json").to_json()

    def __eq__(self, other: object) -> bool:
        """Whether the other has the same file, records that it comes from among it."""
        if not isinstance(other, Model):
            return NotImplemented
        return [m.to_json() for m in self._models] == [m.to_json() for m in other._models]

    def __hash__(self) -> int:
        return hash(tuple(m.to_json() for m in self._models))

    def __reduce__(self) -> tuple[Any, ...]:
        return _unpickled, ([m.to_json() for m in self._models],)

    # ------------------------------------------------------------------ what it is

    @property
    def inputs(self) -> list[str]:
        """Channels that drive it, in the order of the columns of ``u``."""
        return list(self._names)

    @property
    def outputs(self) -> list[str]:
        """Channels that it computes, in the order of the columns of ``y``."""
        return [m.output()[0] for m in self._models]

    @property
    def units(self) -> dict[str, str]:
        """Unit of each channel."""
        pairs = [pair for m in self._models for pair in [*m.inputs(), m.output()]]
        return dict(pairs)

    @property
    def kind(self) -> str:
        """Kind of the model, as ``dynocal list models`` names it."""
        return ", ".join(dict.fromkeys(m.kind for m in self._models))

    @property
    def estimator(self) -> str:
        """Estimator of its parameters."""
        return ", ".join(dict.fromkeys(m.estimator for m in self._models))

    @property
    def ts_s(self) -> float | None:
        """Sample time in s; ``None`` for a model of present values alone."""
        return None if self.is_steady else self._models[0].sample_time_s

    @property
    def is_steady(self) -> bool:
        """Whether it reads present values alone."""
        return all(m.is_steady for m in self._models)

    @property
    def memory(self) -> int:
        """Past samples that a run reads before the first one that it computes."""
        return max(m.memory for m in self._models)

    @property
    def parameters(self) -> dict[str, float]:
        """Parameters of a model of one output, by the names that the structure gives them."""
        return {name: value for name, value, _ in self._one("parameters").parameters()}

    @property
    def std_errors(self) -> dict[str, float | None]:
        """Standard errors of the parameters; ``None`` where the data do not determine one."""
        return {name: error for name, _, error in self._one("std_errors").parameters()}

    def _dataset(self, what: str, record: object) -> Dataset:
        if not isinstance(record, Dataset):
            raise ArgumentError(f"{what}: found {arguments.kind(record)}, expected a Dataset")
        return record

    def _one(self, what: str) -> _dynocal.Model:
        if len(self._models) != 1:
            raise ModelError(f"{what}: the model has the outputs {', '.join(self.outputs)}, expected one: take single(output)")
        return self._models[0]

    def __repr__(self) -> str:
        time = "present values" if self.is_steady else f"samples of {self._models[0].sample_time_s:g} s"
        count = sum(len(m.parameters()) for m in self._models)
        drives = ", ".join(self.inputs) or "nothing"
        return f"<Model {', '.join(self.outputs)} from {drives}: {self.kind} by {self.estimator}, {count} parameters, {time}>"

    def _repr_html_(self) -> str:
        parts = [f"<p>{html.escape(repr(self)[1:-1])}</p>"]
        for m in self._models:
            rows = "".join(
                f"<tr><td>{html.escape(name)}</td><td>{value:.6g}</td><td>{'-' if error is None else f'{error:.2g}'}</td></tr>"
                for name, value, error in m.parameters()
            )
            head = f"<tr><th>{html.escape(m.output()[0])}</th><th>value</th><th>standard error</th></tr>"
            parts.append(f"<table>{head}{rows}</table>" if rows else "")
        return "".join(parts)

    # ------------------------------------------------------------------ runs

    @overload
    def simulate(self, u: Dataset, *, initial: str | None = None) -> Dataset: ...
    @overload
    def simulate(self, u: npt.ArrayLike, *, y0: npt.ArrayLike | None = None) -> FloatArray: ...
    def simulate(
        self, u: npt.ArrayLike | Dataset, *, y0: npt.ArrayLike | None = None, initial: str | None = None
    ) -> FloatArray | Dataset:
        """Free run.

        Parameters
        ----------
        u
            Dataset, inputs (N,) or (N, m) in the order of :attr:`inputs`, or a frame or mapping that has them as columns by name.
        y0
            Measured outputs of the first samples, (k,) or (k, outputs), k at least :attr:`memory`; without it the run
            starts at rest: zero for a linear model, else the equilibrium that the first inputs hold. With arrays only.
        initial
            ``rest``, ``measured`` or ``estimated``: where a run over a Dataset starts; by default as the model says where
            the output was measured, else at rest.

        Returns
        -------
        numpy.ndarray or Dataset
            (N,) or (N, outputs) for arrays; for a Dataset the outputs as a Dataset.
        """
        if isinstance(u, Dataset):
            if y0 is not None:
                raise ArgumentError("y0: found it beside a Dataset, expected initial= (the Dataset holds the outputs)")
            if initial is not None:
                arguments.one_of("initial", initial, ["rest", "measured", "estimated"])
            return self._over(u, lambda m: m.simulate(u._record, initial))
        if initial is not None:
            raise ArgumentError("initial: found it beside arrays, expected y0= or a Dataset")
        inputs = self._inputs(u)
        starts: list[FloatArray | None] = [None] * len(self._models)
        if y0 is not None:
            start = self._outputs("y0", y0)
            starts = [np.ascontiguousarray(start[:, k]) for k in range(start.shape[1])]
        found = [m.simulate_arrays(inputs[:, c], s) for m, c, s in zip(self._models, self._columns, starts, strict=True)]
        for name, values in zip(self.outputs, found, strict=True):
            if not np.isfinite(values).all():
                at = int(np.argmin(np.isfinite(values)))
                warn(f"the free run of `{name}` left all numbers in sample {at}: it must not be used from there on")
        return self._shaped(found)

    @overload
    def predict(self, u: Dataset, y: None = None, *, steps: int = 1) -> Dataset: ...
    @overload
    def predict(self, u: npt.ArrayLike, y: npt.ArrayLike, *, steps: int = 1) -> FloatArray: ...
    def predict(
        self, u: npt.ArrayLike | Dataset, y: npt.ArrayLike | None = None, *, steps: int = 1
    ) -> FloatArray | Dataset:
        """``steps`` samples ahead of measured outputs.

        Parameters
        ----------
        u
            Dataset with the outputs, or inputs (N,) or (N, m).
        y
            Measured outputs (N,) or (N, outputs); with arrays only.
        steps
            Horizon in samples; 1 is the one-step prediction.

        Returns
        -------
        numpy.ndarray or Dataset
            The first samples are the measured ones.
        """
        ahead = arguments.count("steps", steps, 1)
        # Further ahead than the record is long nothing changes, and memory would be asked for.
        ahead = min(ahead, max(len(y) if isinstance(y, Sized) else len(u) if isinstance(u, Sized) else 1, 1))
        if isinstance(u, Dataset):
            if y is not None:
                raise ArgumentError("y: found it beside a Dataset, expected the outputs inside of it")
            return self._over(u, lambda m: m.predict(u._record, ahead))
        if y is None:
            raise ArgumentError("y: found None, expected measured outputs: without them only simulate(u) can be computed")
        inputs, measured = self._inputs(u), self._outputs("y", y)
        if len(measured) != len(inputs):
            raise ArgumentError(f"y: found {len(measured)} samples, expected {len(inputs)} as of u")
        found = [
            m.predict_arrays(inputs[:, c], np.ascontiguousarray(measured[:, k]), ahead)
            for k, (m, c) in enumerate(zip(self._models, self._columns, strict=True))
        ]
        return self._shaped(found)

    def score(self, *records: Dataset, k_steps: Iterable[int] = ()) -> Scores:
        """One step, k steps ahead and free run on records, each with R2, NRMSE and RMSE in the unit of the output.

        A record that the model was estimated from is said to be seen (``identification``), as one that chose between its candidates
        (``selection``); others are ``unseen``. The model knows its records by pieces of them, wherever they were read: parts, longer
        records around them, other channels beside. Parts below some three per cent, resampled or rescaled samples are not recognised.
        """
        if not records:
            raise ArgumentError("records: found none, expected at least one Dataset")
        for k, d in enumerate(records):
            if not isinstance(d, Dataset):
                raise ArgumentError(f"records[{k}]: found {arguments.kind(d)}, expected a Dataset")
            self._timed(d)
        longest = max(len(d) for d in records)
        steps: list[int] = []
        for i, k in enumerate(arguments.listed("k_steps", k_steps, "a list of numbers of samples")):
            if (ahead := arguments.count(f"k_steps[{i}]", k, 1)) >= longest:
                raise ArgumentError(
                    f"k_steps[{i}]: found {ahead}, expected less than the {longest} samples of the longest record: so far ahead it is a free run"
                )
            if ahead not in steps:
                steps.append(ahead)
        text, said = _dynocal.judge(list(self._models), [d._record for d in records], steps)
        names = ("output", "unit", "data", "samples", "rmse", "error_95", "r2_percent", "nrmse_fit_percent")
        rows = [Score(kind=kind_of(r["kind"]), **{n: r[n] for n in names}) for r in json.loads(text)]
        return Scores(rows, findings_of(said))

    def transfer_functions(self) -> dict[str, tuple[FloatArray, FloatArray]]:
        """Numerator and denominator in powers of z^-1 of a linear model of one output, by input."""
        from ._systems import transfer_functions

        return transfer_functions(self)

    def to_scipy(self) -> Any:
        """A linear model as ``scipy.signal.dlti``; several inputs as a mapping of them."""
        from ._systems import to_scipy

        return to_scipy(self)

    def to_control(self) -> Any:
        """A linear model as ``control.TransferFunction``."""
        from ._systems import to_control

        return to_control(self)

    def outside(self, record: Dataset) -> list[str]:
        """Sentences on the channels of a record that leave what the model was estimated on."""
        record = self._dataset("outside", record)
        return [text for m in self._models for text in m.outside(record._record)]

    def plot(self, record: Dataset, output: str | None = None, ax: Any = None) -> Any:
        """Draws a measured output and its free run into Matplotlib axes and returns them."""
        from ._plots import agreement

        record = self._dataset("plot", record)
        name = arguments.one_of("output", output or self.outputs[0], self.outputs)
        return agreement(record, self.simulate(record), name, ax)

    # ------------------------------------------------------------------ arrays

    def _inputs(self, u: object) -> FloatArray:
        """Inputs as columns, of what has names by these; that they are finite is looked at where they are copied."""
        named = arguments.table_columns(u)
        if named is not None:
            return self._named("u", u, named, self._names)
        found = arguments.columns("u", u)
        if found.shape[1] != len(self._names):
            raise ArgumentError(
                f"u: found {found.shape[1]} channels (shape {found.shape}), expected {len(self._names)}: {', '.join(self._names)}"
            )
        return found

    def _named(self, what: str, table: Any, found: list[str], names: list[str]) -> FloatArray:
        """Columns of a frame by name: their order is nobody's promise."""
        missing = [n for n in names if n not in found]
        if missing:
            raise ArgumentError(
                f"{what}: found the columns {', '.join(found)}, expected {', '.join(names)}: rename them, or give an array with the "
                "channels in this order"
            )
        if len(set(found)) < len(found):
            raise ArgumentError(f"{what}: found the columns {', '.join(found)}, expected names that differ")
        return np.column_stack([arguments.array(f"{what}[{n!r}]", table[n]) for n in names])

    def _outputs(self, name: str, y: object) -> FloatArray:
        named = arguments.table_columns(y)
        if named is not None:
            return self._named(name, y, named, self.outputs)
        found = arguments.columns(name, y)
        if found.shape[1] != len(self._models):
            expected = f"{len(self._models)}: {', '.join(self.outputs)}"
            raise ArgumentError(f"{name}: found {found.shape[1]} channels (shape {found.shape}), expected {expected}")
        return found

    def _shaped(self, found: list[FloatArray]) -> FloatArray:
        return found[0] if len(found) == 1 else np.column_stack(found)

    def _timed(self, record: Dataset) -> None:
        """Refuses points where a model needs samples in time."""
        if record.is_steady and not self.is_steady:
            raise ModelError(f"{record.name}: found steady points, expected a record in time: the model has samples of {self.ts_s:g} s")

    def _over(self, record: Dataset, run: Any) -> Dataset:
        self._timed(record)
        columns: dict[str, FloatArray] = {}
        notes: list[str] = []
        for m in self._models:
            answers = run(m)
            if len(answers) != 1:
                raise ModelError("the preparation that is stored with the model cuts the record: run it over each part")
            _, values, _, remarks = answers[0]
            if len(values) != len(record):
                raise ModelError(
                    f"the preparation that is stored with the model makes {len(values)} samples of {len(record)}: prepare the "
                    "record before"
                )
            columns[m.output()[0]] = values
            notes.extend(remarks)
        diverged = [name for name, values in columns.items() if not np.isfinite(values).all()]
        notes.extend(f"the free run of `{name}` diverges" for name in diverged)
        units = {m.output()[0]: m.output()[1] for m in self._models}
        out = Dataset(
            columns, ts_s=record.ts_s, outputs=list(columns), inputs=[], units=units, name=record.name, missing=True
        ) if not diverged else _diverged(self, record, columns, units)
        out.notes.extend(notes + self.outside(record))
        return out


def _diverged(model: Model, record: Dataset, columns: dict[str, FloatArray], units: dict[str, str]) -> Dataset:
    """Outputs that left all numbers: what is not finite is missing."""
    known = {name: np.where(np.isfinite(v), v, np.nan) for name, v in columns.items()}
    if any(not np.isfinite(v).any() for v in known.values()):
        raise ModelError(f"the free run of {', '.join(model.outputs)} diverges from the first sample on")
    return Dataset(known, ts_s=record.ts_s, outputs=list(known), inputs=[], units=units, name=record.name, missing=True)


def _unpickled(texts: list[str]) -> Model:
    return Model(_dynocal.Model.from_json(t) for t in texts)
