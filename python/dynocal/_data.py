"""Records: channels of equal length over time, or steady points."""

from __future__ import annotations

import html
import os
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from . import _arguments as arguments
from . import _dynocal
from . import _table as tables
from ._arguments import FloatArray
from .errors import ArgumentError, DataError, MissingPackageError

if TYPE_CHECKING:
    import matplotlib.axes
    import pandas
    import polars

__all__ = ["Dataset", "contents", "convert", "read"]


class Dataset:
    """A record: channels of equal length with names, units and roles. Nothing changes it.

    Parameters
    ----------
    data
        Mapping of channel name to samples (N,), or a table with ``__arrow_c_stream__``. It is copied. The index of a pandas frame
        is no channel; where it holds stamps, ``time`` may name it.
    ts_s
        Sample time in s; ``None`` for steady points (rows without time), or where ``time`` gives it.
    inputs, outputs
        Channels that drive and that answer. Without ``inputs`` every channel that is no output is one.
    units
        Unit of a channel; ``-`` where it is not given.
    time
        Channel of uniform stamps in s, instead of ``ts_s``. Where neither is given, an index of a pandas frame that holds stamps is the
        time. Other columns that look like it are refused until it is said what they are.
    name
        Name of the record in messages.
    init_samples
        Leading samples that only initialise and enter no score.
    missing
        Whether NaN marks a missing sample; otherwise it is a fault.

    Examples
    --------
    >>> import numpy as np
    >>> d = Dataset({"u": [0.0, 1.0, 1.0, 0.0], "y": [0.0, 0.0, 0.5, 0.75]}, ts_s=0.1, outputs="y", units={"u": "V"})
    >>> d
    <Dataset data: 4 samples of 0.1 s, inputs u [V], outputs y [-]>
    >>> first, second = d.split(at_s=0.2)
    >>> len(first), second["u"]
    (2, array([1., 0.]))
    """

    _record: _dynocal.Record
    notes: list[str]
    """What was decided or left out on the way in."""

    def __init__(
        self,
        data: object,
        *,
        ts_s: float | None = None,
        inputs: str | Iterable[str] | None = None,
        outputs: str | Iterable[str] | None = None,
        units: Mapping[str, str] | None = None,
        time: str | None = None,
        name: str = "data",
        init_samples: int = 0,
        missing: bool = False,
    ) -> None:
        outs = arguments.names("outputs", outputs)
        if isinstance(data, Dataset):
            ts_s = data.ts_s if ts_s is None and time is None else ts_s
            outs = data.outputs if outputs is None else outs
            inputs = [n for n in data.inputs if n not in outs] if inputs is None else inputs
            units = {**data.units, **arguments.mapping("units", units)}
            init_samples, data = init_samples or data.init_samples, data.to_dict()
        table = tables.table(data, None if time is None else arguments.text("time", time))
        given = arguments.mapping("units", units)
        # Without a list of inputs everything would be one, time too.
        named = [*outs, *(table.columns if inputs is not None else [])]
        time = tables.time_of(table, time, ts_s, named, given)
        found = table.columns
        if not found:
            raise DataError("data: found no column of numbers, expected at least one")
        stamps = found.pop(time, None) if time is not None else None
        if time is not None and stamps is None:
            raise ArgumentError(f"time: found `{time}`, expected one of {', '.join(found)}")
        if ts_s is not None and stamps is not None:
            raise ArgumentError("ts_s: found it beside time, expected one of the two")
        step = tables.interval(time or "", stamps) if stamps is not None else ts_s
        step = 1.0 if step is None else arguments.number("ts_s", step, "seconds", positive=True)
        ins = arguments.names("inputs", inputs, [n for n in found if n not in outs])
        both = [n for n in ins if n in outs]
        if both:
            raise ArgumentError(f"inputs: found `{both[0]}`, which is an output as well")
        given = {**table.units, **given}
        if time is not None:
            given.pop(time, None)
        for what, listed in (("inputs", ins), ("outputs", outs), ("units", list(given))):
            for one in listed:
                if one not in found:
                    raise ArgumentError(f"{what}: found `{one}`, expected one of {', '.join(found)}")
        channels = []
        for channel, values in found.items():
            if values.ndim != 1:
                raise DataError(f"data[{channel!r}]: found shape {values.shape}, expected (samples,)")
            if values.size == 0:
                raise DataError(f"data[{channel!r}]: found no samples, expected at least one")
            if not missing:
                arguments.finite(f"data[{channel!r}]", values)
            role = "output" if channel in outs else "input" if channel in ins else "auxiliary"
            channels.append((channel, arguments.text(f"units[{channel!r}]", given.get(channel, "-")), role, values))
        count = arguments.count("init_samples", init_samples)
        self._record = _dynocal.Record(arguments.text("name", name), step, channels, count, name)
        self._steady = ts_s is None and stamps is None
        self.notes = table.notes

    @classmethod
    def _of(cls, record: _dynocal.Record, steady: bool = False, notes: list[str] | None = None) -> Dataset:
        new = cls.__new__(cls)
        new._record, new._steady, new.notes = record, steady, list(notes or [])
        return new

    # ------------------------------------------------------------------ what it is

    @property
    def name(self) -> str:
        """Name in messages."""
        return self._record.name

    @property
    def ts_s(self) -> float | None:
        """Sample time in s; ``None`` for steady points."""
        return None if self._steady else self._record.sample_time_s

    @property
    def is_steady(self) -> bool:
        """Whether rows are points without time."""
        return self._steady

    @property
    def channels(self) -> list[str]:
        """Names, in order."""
        return [name for name, _, _ in self._record.channels()]

    @property
    def units(self) -> dict[str, str]:
        """Unit of each channel; ``-`` for none."""
        return {name: unit for name, unit, _ in self._record.channels()}

    @property
    def inputs(self) -> list[str]:
        """Channels that drive."""
        return [name for name, _, role in self._record.channels() if role == "input"]

    @property
    def outputs(self) -> list[str]:
        """Channels that answer."""
        return [name for name, _, role in self._record.channels() if role == "output"]

    @property
    def origin(self) -> str:
        """Where it came from."""
        return self._record.origin

    @property
    def init_samples(self) -> int:
        """Leading samples that enter no score."""
        return self._record.init_samples

    @property
    def time_s(self) -> FloatArray:
        """Stamps in s from 0 (N,)."""
        if self._steady:
            raise DataError(f"{self.name}: steady points have no time")
        return self._record.sample_time_s * np.arange(len(self), dtype=np.float64)

    def __len__(self) -> int:
        return len(self._record)

    def __iter__(self) -> Iterator[str]:
        return iter(self.channels)

    def __contains__(self, name: object) -> bool:
        return name in self.channels

    def __getitem__(self, name: str) -> FloatArray:
        return self._record.values(arguments.text("channel", name))

    def __eq__(self, other: object) -> bool:
        """Whether the other has the same samples in the same channels, units, roles and sample time; names do not count."""
        if not isinstance(other, Dataset):
            return NotImplemented
        return self._key() == other._key()

    def __hash__(self) -> int:
        return hash(self._key())

    def _key(self) -> tuple[Any, ...]:
        return self._record.fingerprint(), self._steady, tuple(self._record.channels()), self.init_samples

    def __repr__(self) -> str:
        def listed(names: list[str]) -> str:
            return ", ".join(f"{n} [{self.units[n]}]" for n in names) or "none"

        time = "steady points" if self._steady else f"samples of {self._record.sample_time_s:g} s"
        noted = f"; {len(self.notes)} note{'s' * (len(self.notes) > 1)}" if self.notes else ""
        return f"<Dataset {self.name}: {len(self)} {time}, inputs {listed(self.inputs)}, outputs {listed(self.outputs)}{noted}>"

    def __reduce__(self) -> tuple[Any, ...]:
        columns = {name: self[name] for name in self.channels}
        more = (self._record.sample_time_s, self.inputs, self.outputs, self.units, self.name, self.init_samples)
        return _rebuilt, (columns, *more, self._steady, self.origin, self.notes)

    # ------------------------------------------------------------------ parts

    def split(
        self, at_s: float | None = None, *, fraction: float | None = None, sample: int | None = None
    ) -> tuple[Dataset, Dataset]:
        """The record before and from a point on: a time in s, a share of the samples, or a sample."""
        given = [v for v in (at_s, fraction, sample) if v is not None]
        if len(given) != 1:
            raise ArgumentError(f"split: found {len(given)} of at_s, fraction and sample, expected one")
        n = len(self)
        if at_s is not None:
            at = arguments.number("at_s", at_s, "seconds")
            if self._steady:
                raise ArgumentError("at_s: steady points have no time, expected fraction or sample")
            # The first sample at or after it; stamps are multiples of the sample time up to rounding.
            k = int(np.ceil(at / self._record.sample_time_s - 1e-9))
            if not 0 < k < n:
                end = (n - 1) * self._record.sample_time_s
                raise ArgumentError(f"at_s: found {at:g}, expected a time inside of the record (0 to {end:g} s)")
        elif fraction is not None:
            share = arguments.number("fraction", fraction)
            k = round(share * n)
            if not 0 < k < n:
                raise ArgumentError(f"fraction: found {share:g}, expected a share that leaves samples on both sides")
        else:
            k = arguments.count("sample", sample, 1, n - 1)
        return self.part(0, k), self.part(k, n)

    def part(self, start: int, stop: int) -> Dataset:
        """Samples ``start`` to ``stop`` (exclusive) as a record of their own."""
        n = len(self)
        first, last = arguments.count("start", start, 0, n - 1), arguments.count("stop", stop, 1, n)
        return Dataset._of(self._record.part(first, last, f"{self.name}[{first}:{last}]"), self._steady, self.notes)

    def with_roles(
        self, inputs: str | Iterable[str] | None = None, outputs: str | Iterable[str] | None = None
    ) -> Dataset:
        """The same record with other inputs and outputs; other channels stay beside them, used by nothing."""
        outs = arguments.names("outputs", outputs, self.outputs)
        ins = arguments.names("inputs", inputs, [n for n in self.inputs if n not in outs])
        for one in ins:
            if one in outs:
                raise ArgumentError(f"inputs: found `{one}`, which is an output as well")
        return Dataset._of(self._record.with_roles(ins, outs), self._steady, self.notes)

    def with_init_samples(self, init_samples: int) -> Dataset:
        """The same record with another number of leading samples that enter no score."""
        count = arguments.count("init_samples", init_samples, 0, len(self))
        return Dataset._of(self._record.with_init_samples(count), self._steady, self.notes)

    # ------------------------------------------------------------------ out

    def to_numpy(self, channels: str | Iterable[str] | None = None) -> FloatArray:
        """Channels as columns (samples, channels); one name gives (samples,)."""
        if isinstance(channels, str):
            return self[channels]
        return self._record.matrix(arguments.names("channels", channels, self.channels))

    def to_dict(self) -> dict[str, FloatArray]:
        """Samples (N,) by channel name."""
        return {name: self[name] for name in self.channels}

    def to_pandas(self) -> pandas.DataFrame:
        """A pandas frame, its index the time in s."""
        pandas = _package("pandas", "to_pandas")
        index = None if self._steady else pandas.Index(self.time_s, name="time_s")
        return pandas.DataFrame(self.to_dict(), index=index)

    def to_polars(self) -> polars.DataFrame:
        """A polars frame; its first column is the time in s."""
        polars = _package("polars", "to_polars")
        if not self._steady and "time_s" in self:
            raise DataError("to_polars: found a channel `time_s`, which is how the column of the time is called")
        time = {} if self._steady else {"time_s": self.time_s}
        return polars.DataFrame({**time, **self.to_dict()})

    def __arrow_c_stream__(self, requested_schema: object = None) -> object:
        return _dynocal.record_to_arrow(self._record)

    def write(self, path: str | os.PathLike[str]) -> list[str]:
        """Writes the record in the format that the ending names; returns what could not be kept, in sentences."""
        return _dynocal.write(self._record, arguments.path("path", path), self._steady)

    def plot(self, channels: str | Iterable[str] | None = None, ax: matplotlib.axes.Axes | None = None) -> Any:
        """Draws channels over time into Matplotlib axes and returns them; never shows a window."""
        from ._plots import record

        return record(self, arguments.names("channels", channels, self.channels), ax)

    def _repr_html_(self) -> str:
        from ._pictures import trace

        rows = []
        channels = self._record.channels()
        for name, unit, role in channels[:_SHOWN]:
            values = self[name]
            known = values[np.isfinite(values)]
            least, most = (f"{known.min():.5g}", f"{known.max():.5g}") if known.size else ("-", "-")
            cells = "".join(f"<td>{html.escape(str(c))}</td>" for c in (name, unit, role, least, most))
            rows.append(f"<tr>{cells}<td>{trace(values)}</td></tr>")
        head = "".join(f"<th>{c}</th>" for c in ("channel", "unit", "role", "least", "greatest", ""))
        more = f"<p>and {len(channels) - _SHOWN} more channels</p>" if len(channels) > _SHOWN else ""
        noted = "".join(f"<li>{html.escape(n)}</li>" for n in self.notes)
        text = f"<p>{html.escape(repr(self)[1:-1])}</p><table><tr>{head}</tr>{''.join(rows)}</table>{more}"
        return text + (f"<ul>{noted}</ul>" if noted else "")


_SHOWN = 60
"""Channels that a notebook shows of a record."""


def _rebuilt(
    columns: dict[str, FloatArray],
    ts_s: float,
    inputs: list[str],
    outputs: list[str],
    units: dict[str, str],
    name: str,
    init_samples: int,
    steady: bool,
    origin: str,
    notes: list[str],
) -> Dataset:
    def role(channel: str) -> str:
        return "output" if channel in outputs else "input" if channel in inputs else "auxiliary"

    channels = [(channel, units[channel], role(channel), values) for channel, values in columns.items()]
    return Dataset._of(_dynocal.Record(name, ts_s, channels, init_samples, origin), steady, notes)


def _package(name: str, what: str) -> Any:
    import importlib

    try:
        return importlib.import_module(name)
    except ImportError:
        raise MissingPackageError(f"{what} needs the package {name}: pip install {name}") from None


def read(
    path: str | os.PathLike[str],
    channels: Iterable[str] | Mapping[str, str] | None = None,
    *,
    ts_s: float | None = None,
    inputs: str | Iterable[str] | None = None,
    outputs: str | Iterable[str] | None = None,
    units: Mapping[str, str] | None = None,
    time: str | None = None,
    time_unit: str | None = None,
    steady: bool = False,
    missing: bool = False,
    format: str | None = None,
    keys: Mapping[str, Any] | None = None,
    init_samples: int = 0,
) -> Dataset:
    """Reads a measurement file: CSV, Parquet, MDF 3 and 4, MAT 5 and 7.3 (``dynocal.members("formats")``).

    Parameters
    ----------
    path
        File; its first bytes or the ending of its name tell the format.
    channels
        Columns to take, or a mapping of channel name to column; all columns of numbers by default.
    ts_s
        Sample time in s. A file with time stamps is brought to it (the last value is held), one without is taken to have it.
    units
        Units that channels get; one that the file gives otherwise is converted, exactly or not at all.
    time, time_unit
        Column of time stamps and its unit, where they are not called as usual.
    steady
        Whether rows are points without time.
    missing
        Whether empty cells are missing samples (NaN); otherwise they are a fault.
    keys
        Dialect of CSV (``csv``), merging of rasters (``merge``), other names (``alias``), as in ``[data]`` of a spec.

    Returns
    -------
    Dataset
        Its ``notes`` say what was decided or lost on the way in.
    """
    if steady and ts_s is not None:
        raise ArgumentError("ts_s: found it beside steady=True, expected one of the two: points have no sample time")
    ins, outs = arguments.names("inputs", inputs), arguments.names("outputs", outputs)
    for one in ins:
        if one in outs:
            raise ArgumentError(f"inputs: found `{one}`, which is an output as well")
    wanted: list[tuple[str, str]] | None = None
    if isinstance(channels, Mapping):
        wanted = [(arguments.text(f"channels[{k!r}]", v), k) for k, v in channels.items()]
    elif channels is not None:
        wanted = [(n, n) for n in arguments.names("channels", channels)]
    how = {
        "format": None if format is None else arguments.text("format", format),
        "keys": arguments.mapping("keys", keys),
        "channels": [list(pair) for pair in wanted] if wanted is not None else None,
        "units": arguments.mapping("units", units),
        "time": None if time is None else arguments.text("time", time),
        "time_unit": None if time_unit is None else arguments.text("time_unit", time_unit),
        "sample_time_s": None if ts_s is None else arguments.number("ts_s", ts_s, "seconds", positive=True),
        "steady": arguments.flag("steady", steady),
        "missing": arguments.flag("missing", missing),
        "inputs": ins,
        "outputs": outs,
    }
    record, notes = _dynocal.read(arguments.path("path", path), how)
    if init_samples:
        record = record.with_init_samples(arguments.count("init_samples", init_samples, 0, len(record)))
    return Dataset._of(record, steady, notes)


def contents(path: str | os.PathLike[str], format: str | None = None) -> dict[str, Any]:
    """What is in a measurement file: its groups and channels with units, ranges and gaps, as ``dynocal show`` says it."""
    import json

    found: dict[str, Any] = json.loads(_dynocal.contents(arguments.path("path", path), None if format is None else arguments.text("format", format)))
    return found


def convert(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    *,
    channels: str | Iterable[str] | None = None,
    units: Mapping[str, str] | None = None,
    keys: Mapping[str, Any] | None = None,
    merge: bool = False,
    format: str | None = None,
) -> list[str]:
    """Writes a measurement file in the format that the ending of ``target`` names; returns notes, in sentences."""
    how = {
        "format": None if format is None else arguments.text("format", format),
        "read": arguments.mapping("keys", keys),
        "merge": arguments.flag("merge", merge),
        "channels": arguments.names("channels", channels),
        "units": arguments.mapping("units", units),
    }
    return _dynocal.convert(arguments.path("source", source), arguments.path("target", target), how)
