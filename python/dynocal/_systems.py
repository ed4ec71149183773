"""Linear models as systems of other packages."""

from __future__ import annotations

import json
import re
from typing import Any

import numpy as np

from ._arguments import FloatArray
from ._data import _package
from ._model import Model
from .errors import ModelError

__all__ = ["to_control", "to_scipy", "transfer_functions"]

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
