"""Tables of other packages on the way into a record: columns, units, and which of them is the time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from . import _arguments as arguments
from . import _dynocal
from ._arguments import FloatArray
from .errors import ArgumentError, DataError, DynocalError

__all__ = ["Table", "interval", "table", "time_of"]


@dataclass
class Table:
    """What a table holds: columns of numbers, units that its fields say, columns that are stamps, notes on what is left out."""

    columns: dict[str, FloatArray]
    units: dict[str, str] = field(default_factory=dict)
    stamps: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    index: str | None = None
    """Name of the column that is the index of a frame and says the time."""


def table(data: object, time: str | None) -> Table:
    """Columns by name of anything that has them."""
    if isinstance(data, Mapping):
        names = [arguments.text("data: a name", k) for k in data]
        return Table({k: arguments.array(f"data[{k!r}]", data[k]) for k in names})
    if not hasattr(data, "__arrow_c_stream__"):
        raise ArgumentError(
            f"data: found {arguments.kind(data)}, expected a mapping of name to samples, or a table with __arrow_c_stream__ "
            "(pandas, polars, pyarrow, DuckDB)"
        )
    try:
        found, others = _dynocal.record_from_arrow(data)
    except DynocalError:
        raise
    except Exception as error:
        # The package that the table is of: columns of mixed or complex values, doubled names.
        raise DataError(f"data: the table of {type(data).__module__.split('.')[0]} cannot be read: {error}") from None
    index = None
    if hasattr(data, "index") and hasattr(data, "columns"):
        # A pandas frame sends its index along: that is no channel, but it may be the time.
        own = [str(c) for c in data.columns]
        beside = [(name, stamps) for name, _, stamps, _ in found if name not in own]
        index = next((name for name, stamps in beside if stamps or _dynocal.is_time(name, None)), None)
        found = [one for one in found if one[0] in own or one[0] in (time, index)]
    taken = [one[0] for one in found]
    for k, name in enumerate(taken):
        if name in taken[:k]:
            raise DataError(f"data: found the column `{name}` twice, expected names that differ")
    notes = [f"column `{name}` is left out: it holds no numbers ({kind})" for name, kind in others]
    counting = [name for name, _, _, values in found if name.startswith("Unnamed: ") and _counts(values)]
    notes += [f"column `{name}` is left out: it counts the rows" for name in counting]
    kept = [one for one in found if one[0] not in counting]
    units = {name: unit for name, unit, _, _ in kept if unit is not None}
    return Table({one[0]: one[3] for one in kept}, units, [one[0] for one in kept if one[2]], notes, index)


def _counts(values: FloatArray) -> bool:
    return values.size > 1 and values[0] in (0.0, 1.0) and bool((np.diff(values) == 1.0).all())


def time_of(found: Table, time: str | None, ts_s: float | None, named: list[str], units: Mapping[str, str]) -> str | None:
    """The column of stamps: what ``time`` names, or the index of a frame; a column that looks like time is not guessed upon."""
    if time is None and ts_s is None and found.index is not None:
        found.notes.append(f"the index `{found.index}` is the time")
        return found.index
    if time != found.index and found.index is not None:
        found.columns.pop(found.index)
    for name in found.columns:
        unit = units.get(name, found.units.get(name, "-"))
        # A capital T is as often a temperature or a torque.
        timed = name in found.stamps or name != "T" and _dynocal.is_time(name, None if unit == "-" else unit)
        if timed and name != time and name not in named:
            raise ArgumentError(
                f"data: found the column `{name}`, which looks like time, expected to be told: time={name!r} (instead of ts_s=), or "
                "inputs= with the channels that drive"
            )
    return time


def interval(name: str, stamps: FloatArray) -> float:
    """The interval of uniform stamps in s."""
    arguments.finite(f"data[{name!r}]", stamps, " of seconds")
    if stamps.ndim != 1 or stamps.size < 2:
        raise DataError(f"data[{name!r}]: found shape {stamps.shape}, expected at least two stamps in s")
    step = (stamps[-1] - stamps[0]) / (stamps.size - 1)
    steps = np.diff(stamps)
    if step <= 0.0 or np.abs(steps - step).max() > 1e-3 * step:
        least, most = steps.min(), steps.max()
        raise DataError(
            f"data[{name!r}]: found stamps {least:g} to {most:g} s apart, expected uniform ones: read a file with ts_s=, or "
            "resample before"
        )
    # What has been rounded when the stamps were written is not part of the interval.
    return float(f"{step:.9g}")
