"""What this package raises: :class:`DynocalError` and its kinds.

Kinds that are one of Python's own as well (``ValueError``, ``OSError``) can be caught by either name.
"""

from __future__ import annotations

import functools
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from types import FunctionType
from typing import Any

__all__ = [
    "ArgumentError",
    "DataError",
    "DynocalError",
    "EstimateError",
    "FileError",
    "ForkError",
    "InternalError",
    "MissingPackageError",
    "ModelError",
    "NotFittedError",
    "PlantError",
    "ResultWarning",
    "RunError",
    "SpecError",
]


class DynocalError(Exception):
    """Everything that this package raises."""


class ArgumentError(DynocalError, ValueError):
    """An argument is not what the call takes; the message names it and says what it takes."""


class SpecError(DynocalError, ValueError):
    """A spec has faults: all of them are named, each with its key, what was found and what was expected."""


class DataError(DynocalError, ValueError):
    """A record does not fit: lengths, samples that are no numbers, units, channels, sample times."""


class FileError(DynocalError, OSError):
    """A file cannot be read, written or understood."""


class ModelError(DynocalError, ValueError):
    """A model cannot be used as asked."""


class EstimateError(DynocalError):
    """A model cannot be estimated from these records."""


class RunError(DynocalError):
    """A job could not be done."""


class PlantError(DynocalError):
    """A plant refused a call."""


class NotFittedError(DynocalError, AttributeError):
    """An estimator is used before :meth:`fit`."""


class ForkError(DynocalError, RuntimeError):
    """A forked process has no worker threads: start processes by ``spawn``."""


class MissingPackageError(DynocalError, ImportError):
    """An optional package is asked for that is not installed."""


class ResultWarning(UserWarning):
    """A result must not be used as it is: the message says why. Nothing is raised for it, as the program ends with exit code 1."""


class InternalError(DynocalError):
    """A bug of dynocal."""


_HOME = str(Path(__file__).parent)


def warn(text: str) -> None:
    """A :class:`ResultWarning` at the line that called this package, however deep it is told."""
    depth, frame = 1, sys._getframe()
    while frame.f_back is not None and frame.f_code.co_filename.startswith(_HOME):
        depth, frame = depth + 1, frame.f_back
    warnings.warn(text, ResultWarning, stacklevel=depth)


class _Passed:
    """A function of the user. What it raises is the user's and goes through as it is."""

    def __init__(self, call: Callable[..., Any]) -> None:
        self.call = call

    def __call__(self, *args: Any) -> Any:
        try:
            return self.call(*args)
        except Exception as error:
            error._of_the_user = True  # type: ignore[attr-defined]
            raise


def _ours(error: Exception, what: str) -> DynocalError:
    """What an exception of Python or of another package is, of a call that checks its arguments no further than it uses them."""
    text = f"{what}: {error}" if str(error) else f"{what}: {type(error).__name__}"
    if isinstance(error, OSError):
        return FileError(text)
    if isinstance(error, ImportError):
        return MissingPackageError(text)
    if isinstance(error, MemoryError):
        return DataError(f"{what}: found more than fits into memory ({error})")
    return ArgumentError(f"{what}: the arguments cannot be used: {type(error).__name__}: {error}")


def _guarded(call: Callable[..., Any], what: str) -> Callable[..., Any]:
    @functools.wraps(call)
    def guarded(*args: Any, **more: Any) -> Any:
        try:
            return call(*args, **more)
        except DynocalError:
            raise
        except Exception as error:
            trace = error.__traceback__
            # A call that does not fit the signature is Python's TypeError: it was not even begun. Warnings that somebody has turned into
            # exceptions are what he wants.
            begun = trace is not None and trace.tb_next is not None
            if not begun or isinstance(error, Warning) or getattr(error, "_of_the_user", False):
                raise
            raise _ours(error, what) from error

    return guarded


def guard(names: dict[str, Any], public: list[str]) -> None:
    """The boundary of the package: whatever its public functions, methods and properties raise is a :class:`DynocalError`.

    Special methods but the constructor keep what Python's protocols expect of them.
    """
    for name in public:
        value = names[name]
        if isinstance(value, FunctionType):
            guarded = _guarded(value, name)
            names[name] = guarded
            # Where it is defined too: what pickles a function looks for it there.
            setattr(sys.modules[value.__module__], value.__name__, guarded)
        elif isinstance(value, type) and not issubclass(value, BaseException):
            _guard_class(value)


def _guard_class(cls: type) -> None:
    for name, value in list(vars(cls).items()):
        what = f"{cls.__name__}.{name}"
        if name.startswith("_") and name != "__init__":
            continue
        if isinstance(value, FunctionType):
            if name == "__init__":
                what = cls.__name__
            setattr(cls, name, _guarded(value, what))
        elif isinstance(value, (classmethod, staticmethod)):
            setattr(cls, name, type(value)(_guarded(value.__func__, what)))
        elif isinstance(value, property) and value.fget is not None:
            setattr(cls, name, property(_guarded(value.fget, what), doc=value.__doc__))
