"""Estimated models: run, scored, stored."""

from __future__ import annotations

import html
import json
import os
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, overload

import numpy as np
import numpy.typing as npt

from . import _arguments as arguments
from . import _dynocal
from ._arguments import FloatArray
from ._data import Dataset
from .errors import ArgumentError, ModelError, ResultWarning

__all__ = ["Finding", "Model", "Score", "Scores"]


@dataclass(frozen=True)
class Finding:
    """What a user should know: ``grade`` is fault, warning or note."""

    grade: str
    about: str
    text: str

    def __str__(self) -> str:
        return f"{self.grade}: {self.about}: {self.text}" if self.about else f"{self.grade}: {self.text}"


@dataclass(frozen=True)
class Score:
    """Fit numbers of one output and one kind of computation over all scored samples.

    ``r2_percent`` is 100 (1 - SSE/SST), ``nrmse_fit_percent`` 100 (1 - sqrt(SSE/SST)), SST about the mean of the scored samples;
    they and ``rmse`` are ``None`` where a free run diverges. ``data`` says whether the parameters have seen the samples.
    """

    output: str
    unit: str
    kind: str
    data: str
    samples: int
    rmse: float | None
    error_95: float | None
    r2_percent: float | None
    nrmse_fit_percent: float | None


class Scores(Sequence[Score]):
    """A table of scores with what is wrong with them."""

    def __init__(self, rows: Iterable[Score], findings: Iterable[Finding]) -> None:
        self._rows, self.findings = tuple(rows), tuple(findings)

    @overload
    def __getitem__(self, index: int) -> Score: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Score]: ...
    def __getitem__(self, index: int | slice) -> Score | Sequence[Score]:
        return self._rows[index]

    def __len__(self) -> int:
        return len(self._rows)

    def of(self, kind: str = "free_run", output: str | None = None) -> Score:
        """The row of a kind (``one_step``, ``k_step(5)``, ``free_run``) and an output."""
        found = [r for r in self._rows if r.kind == kind and output in (None, r.output)]
        if len(found) != 1:
            known = ", ".join(f"{r.kind} of {r.output}" for r in self._rows)
            raise ArgumentError(f"kind: found {kind!r} of {output!r}, which is {len(found)} rows of: {known}")
        return found[0]

    def _cells(self) -> list[list[str]]:
        def number(value: float | None) -> str:
            return "diverged" if value is None else f"{value:.5g}"

        head = ["output", "unit", "computed", "data", "samples", "RMSE", "95 % within", "R2 [%]", "NRMSE fit [%]"]
        rows = [
            [r.output, r.unit, r.kind, r.data, str(r.samples)]
            + [number(v) for v in (r.rmse, r.error_95, r.r2_percent, r.nrmse_fit_percent)]
            for r in self._rows
        ]
        return [head, *rows]

    def __repr__(self) -> str:
        cells = self._cells()
        widths = [max(len(row[k]) for row in cells) for k in range(len(cells[0]))]
        lines = ["  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() for row in cells]
        return "\n".join(lines + [str(f) for f in self.findings])

    def _repr_html_(self) -> str:
        head, *rows = self._cells()
        text = "<tr>" + "".join(f"<th>{html.escape(c)}</th>" for c in head) + "</tr>"
        for row in rows:
            text += "<tr>" + "".join(f"<td>{html.escape(c)}</td>" for c in row) + "</tr>"
        said = "".join(f"<li>{html.escape(str(f))}</li>" for f in self.findings)
        return f"<table>{text}</table><ul>{said}</ul>"


def _findings(said: Iterable[tuple[str, str, str]]) -> list[Finding]:
    return [Finding(*one) for one in said]


def _kind(value: object) -> str:
    """The kind of a score as one word."""
    if isinstance(value, Mapping):
        ((name, steps),) = value.items()
        return f"{name}({steps})"
    return str(value)


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
            Dataset, or inputs (N,) or (N, m) in the order of :attr:`inputs`.
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
                text = f"the free run of `{name}` left all numbers in sample {at}: it must not be used from there on"
                warnings.warn(text, ResultWarning, stacklevel=2)
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
        ahead = min(ahead, max(len(u) if isinstance(u, Dataset) else np.size(u), 1))
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

        A record that the model was estimated from, or that chose between its candidates, is said to be seen (``identification``);
        others are ``unseen``.
        """
        if not records:
            raise ArgumentError("records: found none, expected at least one Dataset")
        for k, d in enumerate(records):
            if not isinstance(d, Dataset):
                raise ArgumentError(f"records[{k}]: found {arguments.kind(d)}, expected a Dataset")
        longest = max(len(d) for d in records)
        steps: list[int] = []
        for i, k in enumerate(k_steps):
            if (ahead := arguments.count(f"k_steps[{i}]", k, 1)) >= longest:
                raise ArgumentError(
                    f"k_steps[{i}]: found {ahead}, expected less than the {longest} samples of the longest record: so far ahead it is a free run"
                )
            if ahead not in steps:
                steps.append(ahead)
        text, said = _dynocal.judge(list(self._models), [d._record for d in records], steps)
        names = ("output", "unit", "data", "samples", "rmse", "error_95", "r2_percent", "nrmse_fit_percent")
        rows = [Score(kind=_kind(r["kind"]), **{n: r[n] for n in names}) for r in json.loads(text)]
        return Scores(rows, _findings(said))

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
        return [text for m in self._models for text in m.outside(record._record)]

    def plot(self, record: Dataset, output: str | None = None, ax: Any = None) -> Any:
        """Draws a measured output and its free run into Matplotlib axes and returns them."""
        from ._plots import agreement

        name = arguments.one_of("output", output or self.outputs[0], self.outputs)
        return agreement(record, self.simulate(record), name, ax)

    # ------------------------------------------------------------------ arrays

    def _inputs(self, u: object) -> FloatArray:
        """Inputs as columns; that they are finite is looked at where they are copied."""
        found = arguments.columns("u", u)
        if found.shape[1] != len(self._names):
            raise ArgumentError(
                f"u: found {found.shape[1]} channels (shape {found.shape}), expected {len(self._names)}: {', '.join(self._names)}"
            )
        return found

    def _outputs(self, name: str, y: object) -> FloatArray:
        found = arguments.columns(name, y)
        if found.shape[1] != len(self._models):
            expected = f"{len(self._models)}: {', '.join(self.outputs)}"
            raise ArgumentError(f"{name}: found {found.shape[1]} channels (shape {found.shape}), expected {expected}")
        return found

    def _shaped(self, found: list[FloatArray]) -> FloatArray:
        return found[0] if len(found) == 1 else np.column_stack(found)

    def _over(self, record: Dataset, run: Any) -> Dataset:
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
