"""What this package raises: :class:`DynocalError` and its kinds.

Kinds that are one of Python's own as well (``ValueError``, ``OSError``) can be caught by either name.
"""

from __future__ import annotations

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
