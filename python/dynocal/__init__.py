"""Dynamic powertrain calibration: test design, identification, optimisation, dynamic maps.

>>> import dynocal
>>> "aprbs" in dynocal.members("signals")
True
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from typing import Any

from . import _arguments, _dynocal, errors
from ._arguments import FloatArray
from ._data import Dataset, contents, convert, read
from ._design import Limits, design, plan
from ._estimators import Estimator
from ._jobs import (
    Control,
    Labels,
    Run,
    calibrate,
    check,
    control,
    export,
    fuelling,
    identify,
    label,
    map,
    optimise,
    run,
    sequential,
    signal_plan,
    simulate,
)
from ._many import Study, study
from ._model import Model
from ._plant import Engine, LimitEvent, Variable
from ._results import Label, Loop, Map, Maps, Margins, maps
from ._scores import Finding, Score, Scores
from ._structures import (
    Armax,
    Arx,
    BoxJenkins,
    GaussianProcess,
    LocalLinear,
    Narx,
    Neural,
    OutputError,
    Polynomial,
)
from .errors import DynocalError

__version__: str = _dynocal.version()

__all__ = [
    "Armax",
    "Arx",
    "BoxJenkins",
    "Control",
    "Dataset",
    "DynocalError",
    "Engine",
    "Estimator",
    "Finding",
    "GaussianProcess",
    "Label",
    "Labels",
    "LimitEvent",
    "Limits",
    "LocalLinear",
    "Loop",
    "Map",
    "Maps",
    "Margins",
    "Model",
    "Narx",
    "Neural",
    "OutputError",
    "Polynomial",
    "Run",
    "Score",
    "Scores",
    "Study",
    "Variable",
    "calibrate",
    "check",
    "contents",
    "control",
    "convert",
    "design",
    "errors",
    "export",
    "fuelling",
    "identify",
    "label",
    "map",
    "maps",
    "members",
    "optimise",
    "plan",
    "read",
    "run",
    "sequential",
    "signal",
    "signal_plan",
    "simulate",
    "study",
]


def members(family: str | None = None) -> dict[str, Any]:
    """What a spec can name, from the tables of the program.

    Without ``family`` the families and what they are; with one its members: what each is, and its keys with unit and default.

    >>> members("estimators")["ols"]["params"][0]["name"]
    'ridge'
    """
    tables: dict[str, Any] = json.loads(_dynocal.members())
    if family is None:
        return {name: table["what"] for name, table in tables.items()}
    _arguments.one_of("family", family, tables)
    return {m["name"]: m for m in tables[family]["members"]}


def signal(name: str, n: int, ts_s: float, *, seed: int = 1, keys: Mapping[str, Any] | None = None, **more: Any) -> FloatArray:
    """Samples (n,) of a test signal (``dynocal.members("signals")``), its keys as keyword arguments.

    >>> signal("aprbs", 200, 0.1, lo=-1.0, hi=1.0, hold_s=0.5).shape
    (200,)
    """
    known = members("signals")
    _arguments.one_of("name", name, known)
    chosen = {**_arguments.mapping("keys", keys), **more}
    return _dynocal.signal(
        name,
        chosen,
        _arguments.count("n", n, 2, 100_000_000),
        _arguments.number("ts_s", ts_s, "seconds", positive=True),
        _arguments.count("seed", seed, 0, 2**63 - 1),
    )


def __getattr__(name: str) -> Any:
    """Modules that are loaded when they are asked for: ``dynocal.executors``, ``dynocal.gym``, ``dynocal.sklearn``."""
    if name in ("executors", "gym", "sklearn"):
        import importlib

        return importlib.import_module(f".{name}", __name__)
    raise AttributeError(f"module `dynocal` has no `{name}`")


errors.guard(globals(), __all__)

if hasattr(os, "register_at_fork"):
    # A child that was forked has none of our threads: it is told so instead of waiting for them.
    os.register_at_fork(after_in_child=_dynocal.after_fork)
