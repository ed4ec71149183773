"""Checks of arguments. Messages name the argument, what was found, and what it takes."""

from __future__ import annotations

import math
import operator
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from .errors import ArgumentError, DataError, _Passed

FloatArray = npt.NDArray[np.float64]


def kind(value: object) -> str:
    """What a value is, for messages."""
    if value is None:
        return "None"
    shape = getattr(value, "shape", None)
    if isinstance(shape, tuple):
        return f"{type(value).__name__} of shape {shape} and dtype {getattr(value, 'dtype', '?')}"
    text = repr(value)
    return f"{type(value).__name__} {text}" if len(text) <= 40 else f"{type(value).__name__} {text[:37]}..."


def array(name: str, value: object) -> FloatArray:
    """A copy-free view of ``value`` as float64 where it is that already, else a copy of its numbers."""
    if isinstance(value, np.ma.MaskedArray) and value.dtype.kind in "fiub":
        # What is masked is missing, and no number.
        value = np.where(np.ma.getmaskarray(value), np.nan, value.data)
    try:
        found = np.asarray(value)
    except Exception as error:
        raise ArgumentError(f"{name}: found {kind(value)}, expected an array of numbers ({error})") from None
    if found.dtype.kind == "O":
        try:
            found = found.astype(np.float64)
        except (TypeError, ValueError, OverflowError):
            raise ArgumentError(f"{name}: found {kind(value)}, expected an array of numbers") from None
    if found.dtype.kind not in "fiub":
        raise ArgumentError(f"{name}: found dtype {found.dtype}, expected real numbers (float64 or what becomes it)")
    return found.astype(np.float64, copy=False)


def finite(name: str, values: FloatArray, unit: str = "") -> FloatArray:
    """The same array, all of it finite."""
    good = np.isfinite(values)
    if not good.all():
        place = tuple(int(i) for i in np.argwhere(~good)[0])
        at = place[0] if len(place) == 1 else place
        raise DataError(f"{name}: found {values[place]} at sample {at}, expected finite numbers{unit}")
    return values


def columns(name: str, value: object) -> FloatArray:
    """(samples, channels); one dimension is one channel."""
    found = array(name, value)
    if found.ndim == 1:
        found = found[:, np.newaxis]
    if found.ndim != 2:
        raise ArgumentError(f"{name}: found shape {found.shape}, expected (samples,) or (samples, channels)")
    if found.shape[0] == 0:
        raise ArgumentError(f"{name}: found no samples (shape {found.shape}), expected at least one")
    if found.shape[1] == 0:
        raise ArgumentError(f"{name}: found no channels (shape {found.shape}), expected at least one")
    return found


def text(name: str, value: object) -> str:
    """A text."""
    if not isinstance(value, str):
        raise ArgumentError(f"{name}: found {kind(value)}, expected a text")
    try:
        value.encode()
    except UnicodeEncodeError:
        raise ArgumentError(f"{name}: found {value!a}, expected a text that Unicode has") from None
    return value


def listed(name: str, value: object, what: str) -> list[Any]:
    """Something to go through, as a list; a text is none."""
    if isinstance(value, (str, bytes)) or not isinstance(value, Iterable):
        raise ArgumentError(f"{name}: found {kind(value)}, expected {what}")
    return list(value)


def names(name: str, value: str | Iterable[str] | None, default: Sequence[str] = ()) -> list[str]:
    """A list of distinct texts; one text is a list of one."""
    if value is None:
        return list(default)
    if isinstance(value, str):
        value = [value]
    try:
        found = [text(f"{name}[{k}]", v) for k, v in enumerate(value)]
    except TypeError:
        raise ArgumentError(f"{name}: found {kind(value)}, expected a list of names") from None
    for k, one in enumerate(found):
        if one in found[:k]:
            raise ArgumentError(f"{name}: found `{one}` twice, expected each name once")
    return found


def table_columns(value: object) -> list[str] | None:
    """Names of the columns of a frame or table or mapping; ``None`` for what has none that are texts."""
    if type(value) is np.ndarray:
        # The usual case, in calls that are short.
        return None
    if isinstance(value, Mapping):
        found = list(value)
    elif hasattr(value, "__arrow_c_stream__") and (hasattr(value, "columns") or hasattr(value, "column_names")):
        # pyarrow has its columns themselves under `columns`, the others their names.
        found = list(getattr(value, "column_names", None) or value.columns)  # type: ignore[attr-defined]
    else:
        return None
    return found if all(isinstance(n, str) for n in found) else None


def number(name: str, value: object, unit: str = "", *, positive: bool = False) -> float:
    """A finite number, positive where asked."""
    unit = f" of {unit}" if unit else ""
    expected = f"a positive number{unit}" if positive else f"a finite number{unit}"
    if isinstance(value, (bool, np.bool_, str)) or not hasattr(value, "__float__"):
        raise ArgumentError(f"{name}: found {kind(value)}, expected {expected}")
    try:
        found = float(value)
    except (TypeError, ValueError, OverflowError):
        raise ArgumentError(f"{name}: found {kind(value)}, expected {expected}") from None
    if not math.isfinite(found) or (positive and found <= 0.0):
        raise ArgumentError(f"{name}: found {found:g}, expected {expected}")
    return found


def count(name: str, value: object, least: int = 0, most: int = 2**62) -> int:
    """A whole number from ``least`` to ``most``."""
    expected = f"a whole number, {least} or more" if most == 2**62 else f"a whole number from {least} to {most}"
    if isinstance(value, (bool, np.bool_)):
        raise ArgumentError(f"{name}: found {value}, expected {expected}")
    try:
        found = operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        raise ArgumentError(f"{name}: found {kind(value)}, expected {expected}") from None
    if not least <= found <= most:
        raise ArgumentError(f"{name}: found {found}, expected {expected}")
    return found


def flag(name: str, value: object) -> bool:
    """True or false."""
    if not isinstance(value, (bool, np.bool_)):
        raise ArgumentError(f"{name}: found {kind(value)}, expected True or False")
    return bool(value)


def one_of(name: str, value: object, known: Iterable[str]) -> str:
    """One of the known texts."""
    known = list(known)
    if not isinstance(value, str) or value not in known:
        raise ArgumentError(f"{name}: found {kind(value)}, expected one of {', '.join(known)}")
    return value


def mapping(name: str, value: object) -> dict[str, Any]:
    """A mapping with keys that are texts."""
    if value is None:
        return {}
    items = getattr(value, "items", None)
    if not callable(items):
        raise ArgumentError(f"{name}: found {kind(value)}, expected a mapping")
    return {text(f"{name}: key", k): _encoded(f"{name}: {k}", v) for k, v in items()}


def _encoded(name: str, value: object, depth: int = 0) -> Any:
    """The same value; texts deep in it are such that Unicode has."""
    if isinstance(value, str):
        return text(name, value)
    # What is deeper is refused where it is read.
    if isinstance(value, dict) and depth < 32:
        for k, v in value.items():
            _encoded(f"{name}.{k}", v, depth + 1)
    elif isinstance(value, (list, tuple)) and depth < 32 and not (value and isinstance(value[0], (int, float))):
        for k, v in enumerate(value):
            _encoded(f"{name}[{k}]", v, depth + 1)
    return value


def callback(value: object) -> Any:
    """What is told of progress: ``None``, a function of text and share, or ``True`` for a bar."""
    if value is True:
        from ._progress import Bar

        return Bar()
    if value is None or value is False:
        return None
    if callable(value):
        return _Passed(value)
    raise ArgumentError(f"progress: found {kind(value)}, expected None, True for a bar, or a function of (text, fraction)")


def path(name: str, value: object) -> str:
    """A path."""
    import os

    try:
        found: str = os.fsdecode(os.fspath(value))  # type: ignore[call-overload]
    except TypeError:
        raise ArgumentError(f"{name}: found {kind(value)}, expected a path") from None
    if not found or "\0" in found:
        raise ArgumentError(f"{name}: found {found!a}, expected a path")
    return found
