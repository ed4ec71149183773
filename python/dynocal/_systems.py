"""Linear models as systems of other packages."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from . import _arguments as arguments
from . import _dynocal
from ._arguments import FloatArray
from ._data import _package
from ._model import Model
from .errors import ArgumentError, ModelError

__all__ = ["from_system", "to_control", "to_scipy", "transfer_functions"]

TransferFunctions = dict[str, tuple[FloatArray, FloatArray]]


def transfer_functions(model: Model) -> TransferFunctions:
    """Numerator and denominator of a linear model of one output, by input.

    Both are coefficients of z^0, z^-1, z^-2, .. and equally long; the denominator begins with 1:

    ``y(t) = (num[0] + num[1] z^-1 + ..) / (den[0] + den[1] z^-1 + ..) u(t)``

    A constant and a noise model are no part of it.

    Raises
    ------
    ModelError
        The model has several outputs, a preparation, or terms that are not linear.
    """
    one = model._one("transfer_functions")
    stored = json.loads(one.to_json())
    if stored["preparation"] or stored["derived"]:
        raise ModelError("transfer_functions: the model prepares its channels, expected one without preparation")
    if one.is_steady and one.kind != "polynomial":
        raise ModelError(f"transfer_functions: found a model of kind `{one.kind}`, expected a linear one")
    if one.kind == "linear":
        found = _of_orders(stored["structure"], model.parameters)
    elif one.kind == "polynomial":
        found = _of_regressors(model)
    else:
        raise ModelError(f"transfer_functions: found a model of kind `{one.kind}`, expected a linear one")
    longest = max(len(part) for pair in found.values() for part in pair)
    return {name: (_padded(num, longest), _padded(den, longest)) for name, (num, den) in found.items()}


def _padded(part: FloatArray, n: int) -> FloatArray:
    return np.concatenate([part, np.zeros(n - len(part))])


def _of_orders(structure: dict[str, Any], theta: dict[str, float]) -> TransferFunctions:
    """A y = sum B/F u + ..: B begins at the delay."""
    common = np.array([1.0, *(theta[f"a{k + 1}"] for k in range(structure["na"]))])
    found = {}
    for name, orders in zip(structure["inputs"], structure["orders"], strict=True):
        num = np.array([0.0] * orders["nk"] + [theta[f"b{k}({name})"] for k in range(orders["nb"])])
        own = np.array([1.0, *(theta[f"f{k + 1}({name})"] for k in range(orders["nf"]))])
        found[name] = (num, np.convolve(common, own))
    return found


def _of_regressors(model: Model) -> TransferFunctions:
    """Regressors like ``u(t-2)``: each is a coefficient."""
    lagged = re.compile(r"^(.*)\(t(?:-(\d+))?\)$")
    coefficients: dict[str, dict[int, float]] = {name: {} for name in [*model.inputs, *model.outputs]}
    for term, value in model.parameters.items():
        if term == "1":
            continue
        found = lagged.match(term)
        if found is None or found[1] not in coefficients:
            raise ModelError(f"transfer_functions: found the term `{term}`, expected a linear model")
        coefficients[found[1]][int(found[2] or 0)] = value
    own = coefficients.pop(model.outputs[0])
    den = np.zeros(max(own, default=0) + 1)
    den[0] = 1.0
    for lag, value in own.items():
        den[lag] = -value
    out = {}
    for name, lags in coefficients.items():
        num = np.zeros(max(lags, default=0) + 1)
        for lag, value in lags.items():
            num[lag] = value
        out[name] = (num, den)
    return out


def to_scipy(model: Model) -> Any:
    """A linear model of one input as ``scipy.signal.dlti``; several inputs as a mapping of them."""
    signal = _package("scipy.signal", "to_scipy")
    # Of equal length, both are polynomials in z, whose leading zeros say nothing.
    pairs = transfer_functions(model).items()
    systems = {name: signal.dlti(np.trim_zeros(num, "f"), den, dt=model.ts_s) for name, (num, den) in pairs}
    return next(iter(systems.values())) if len(systems) == 1 else systems


def to_control(model: Model) -> Any:
    """A linear model as ``control.TransferFunction`` with one output and as many inputs as it has."""
    control = _package("control", "to_control")
    pairs = transfer_functions(model)
    nums, dens = [[num for num, _ in pairs.values()]], [[den for _, den in pairs.values()]]
    return control.TransferFunction(nums, dens, model.ts_s, inputs=list(pairs), outputs=model.outputs)


def from_system(system: Any, *, ts_s: float | None, input: str | Iterable[str] | None, output: str, units: Mapping[str, str] | None) -> Model:
    """See :meth:`Model.from_system`."""
    pairs, step = _pairs(system)
    if ts_s is not None:
        ts_s = arguments.number("ts_s", ts_s, "seconds", positive=True)
        if step is not None and not np.isclose(step, ts_s, rtol=1e-9):
            raise ArgumentError(f"ts_s: found {ts_s:g} s and a system of {step:g} s, expected one sample time")
        step = ts_s
    if step is None:
        raise ArgumentError("ts_s: found no sample time, expected that of the system in seconds")
    default = ["u"] if len(pairs) == 1 else [f"u{k + 1}" for k in range(len(pairs))]
    names = arguments.names("input", input, default)
    if len(names) != len(pairs):
        raise ArgumentError(f"input: found {len(names)} names, expected {len(pairs)}: one for each input of the system")
    output = arguments.text("output", output)
    if not output or not all(names):
        raise ArgumentError("input: found an empty name, expected a name of each channel")
    if output in names:
        raise ArgumentError(f"output: found `{output}`, which is an input as well")
    known = arguments.mapping("units", units)
    for name in known:
        arguments.one_of("units", name, [*names, output])
    # All numerators come before all denominators.
    orders, zeros, poles = [], [], []
    for name, (num, den) in zip(names, pairs, strict=True):
        num, den = _monic(name, num, den)
        delay = int(np.flatnonzero(num)[0]) if num.any() else 0
        num = num[delay:]
        orders.append({"nb": len(num), "nf": len(den) - 1, "nk": delay})
        zeros += [(f"b{k}({name})", v) for k, v in enumerate(num)]
        poles += [(f"f{k + 1}({name})", v) for k, v in enumerate(den[1:])]
    stored = {
        "schema": "dynocal/model",
        "schema_version": 3,
        "structure": {"kind": "linear", "inputs": names, "output": output, "na": 0, "orders": orders, "nc": 0, "nd": 0},
        "inputs": [{"name": n, "unit": known.get(n, "-")} for n in names],
        "output": {"name": output, "unit": known.get(output, "-")},
        "sample_time_s": step,
        "parameters": [{"name": n, "value": float(v), "std_error": None} for n, v in zeros + poles],
        "correlation": None,
        "estimator": "given",
        "noise_variance": None,
        "boundary": None,
        "derived": [],
        "preparation": [],
        "initial": None,
        "seen": [],
        "origin": "a given system",
        "files": [],
    }
    return Model([_dynocal.Model.from_json(json.dumps(stored))])


def _monic(name: str, num: object, den: object) -> tuple[FloatArray, FloatArray]:
    """Coefficients of z^0, z^-1, .., without zeros at the end, the denominator beginning with 1."""
    found = []
    for what, part in (("numerator", num), ("denominator", den)):
        values = arguments.array(f"system: {what} of `{name}`", part)
        if values.ndim != 1 or values.size == 0:
            raise ArgumentError(f"system: {what} of `{name}`: found shape {values.shape}, expected (coefficients,)")
        found.append(arguments.finite(f"system: {what} of `{name}`", values))
    num, den = found
    if den[0] == 0.0:
        raise ArgumentError(f"system: denominator of `{name}`: found 0 at z^0, expected a system that needs no later input")
    trimmed = [np.trim_zeros(part / den[0], "b") for part in found]
    return trimmed[0] if trimmed[0].size else np.zeros(1), trimmed[1]


def _pairs(system: Any) -> tuple[list[tuple[Any, Any]], float | None]:
    """Numerators and denominators in z^-1 by input, and the sample time."""
    if isinstance(system, tuple) and len(system) == 2:
        return [system], None
    num, den, step = (getattr(system, name, None) for name in ("num", "den", "dt"))
    if num is None or den is None:
        transfer = getattr(system, "to_tf", None)
        if not callable(transfer):
            found = arguments.kind(system)
            raise ArgumentError(f"system: found {found}, expected a system of SciPy or control, or (num, den) in powers of z^-1")
        return _pairs(transfer())
    if step is True:
        # Sampled, and nobody has said how often.
        step = None
    elif not isinstance(step, (int, float)) or isinstance(step, bool) or step <= 0:
        raise ArgumentError(f"system: found the sample time {step}, expected a sampled system: sample a continuous one first")
    if isinstance(num, np.ndarray) and num.dtype != object:
        return [_powers(num, den)], None if step is None else float(step)
    if len(num) != 1:
        raise ArgumentError(f"system: found {len(num)} outputs, expected one: a model has one output")
    return [_powers(n, d) for n, d in zip(num[0], den[0], strict=True)], None if step is None else float(step)


def _powers(num: Any, den: Any) -> tuple[FloatArray, FloatArray]:
    """From polynomials in z, highest power first."""
    num, den = np.trim_zeros(np.atleast_1d(num), "f"), np.trim_zeros(np.atleast_1d(den), "f")
    if len(num) > len(den):
        raise ArgumentError("system: found a numerator of higher degree than the denominator, expected a system that needs no later input")
    return np.concatenate([np.zeros(len(den) - len(num)), num]), den
