"""The estimators of the usual structures, with their orders as arguments."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from . import _arguments as arguments
from ._estimators import Estimator
from .errors import ArgumentError

__all__ = [
    "Armax",
    "Arx",
    "BoxJenkins",
    "GaussianProcess",
    "LocalLinear",
    "Narx",
    "Neural",
    "OutputError",
    "Polynomial",
]


class Arx(Estimator):
    """Linear ARX: y(t) = sum a_i y(t-i) + sum b_j u(t-nk-j) + c.

    ``estimator="ols"`` minimises the one-step error, ``"sem"`` the error of the free run.
    """

    def __init__(
        self,
        na: int = 1,
        nb: int = 2,
        *,
        nk: int = 1,
        constant: bool = True,
        estimator: str | Mapping[str, Any] = "ols",
        prepare: Iterable[Mapping[str, Any]] | None = None,
    ) -> None:
        self.na, self.nb, self.nk, self.constant = na, nb, nk, constant
        self.estimator, self.prepare = estimator, prepare
        self.select = self.seed = None

    def _structure(self) -> tuple[str, dict[str, Any]]:
        return "arx", {"na": self.na, "nb": self.nb, "nk": self.nk, "constant": self.constant}


class Narx(Estimator):
    """Polynomial NARX: products of lagged inputs and outputs up to a degree, all of them or those that a selection takes.

    Parameters
    ----------
    ylag, xlag
        Lags of the output and of each input.
    delay
        First lag of each input.
    degree
        Highest degree of a product.
    terms
        ``None``: outputs enter linearly, all products of inputs are kept (``poly_arx``). A number: products of inputs and outputs,
        of which so many are selected by error reduction (``frols``); ``"bic"``, ``"press"``, ..: as many as that rule keeps.
    estimator
        ``"ols"`` minimises the one-step error, ``"sem"`` the error of the free run.
    """

    def __init__(
        self,
        ylag: int = 1,
        xlag: int = 2,
        degree: int = 2,
        *,
        delay: int = 1,
        terms: int | str | None = None,
        estimator: str | Mapping[str, Any] = "ols",
        prepare: Iterable[Mapping[str, Any]] | None = None,
    ) -> None:
        self.ylag, self.xlag, self.degree, self.delay, self.terms = ylag, xlag, degree, delay, terms
        self.estimator, self.prepare = estimator, prepare
        self.seed = None

    @property
    def select(self) -> Mapping[str, Any] | None:  # type: ignore[override]
        """Selection of terms, as a spec has it."""
        if self.terms is None:
            return None
        pool = {"ny": self.ylag, "nu": self.xlag, "nk": self.delay, "degree": self.degree, "cross": True, "constant": True}
        if isinstance(self.terms, str):
            return {"name": "frols", "stop": self.terms, "pool": pool}
        return {"name": "frols", "stop": "terms", "max_terms": arguments.count("terms", self.terms, 1), "pool": pool}

    def _structure(self) -> tuple[str, dict[str, Any]]:
        if self.terms is not None:
            return "pool", {}
        return "poly_arx", {"na": self.ylag, "nb": self.xlag, "nk": self.delay, "degree": self.degree}


class Polynomial(Estimator):
    """Polynomial NARX with the regressors that are listed, e.g. ``["y(t-1)", "u(t-1)*u(t-2)", "tanh(2*y(t-1))"]``."""

    def __init__(
        self,
        regressors: Iterable[str] = ("y(t-1)", "u(t-1)"),
        *,
        estimator: str | Mapping[str, Any] = "ols",
        prepare: Iterable[Mapping[str, Any]] | None = None,
    ) -> None:
        self.regressors, self.estimator, self.prepare = regressors, estimator, prepare
        self.select = self.seed = None

    def _structure(self) -> tuple[str, dict[str, Any]]:
        return "polynomial", {"regressors": arguments.names("regressors", self.regressors)}


class Neural(Estimator):
    """Neural NARX trained on the error of the free run from several starts (``train``)."""

    def __init__(
        self,
        hidden: int | Iterable[int] = 10,
        *,
        input_lags: int = 5,
        output_lags: int = 1,
        activation: str = "tanh",
        direct: bool = False,
        starts: int = 12,
        max_evaluations: int = 120,
        estimator: str | Mapping[str, Any] | None = None,
        prepare: Iterable[Mapping[str, Any]] | None = None,
        seed: int | None = None,
    ) -> None:
        self.hidden, self.input_lags, self.output_lags = hidden, input_lags, output_lags
        self.activation, self.direct, self.starts, self.max_evaluations = activation, direct, starts, max_evaluations
        self.estimator, self.prepare, self.seed = estimator, prepare, seed
        self.select = None

    def _structure(self) -> tuple[str, dict[str, Any]]:
        keys = {"hidden": self.hidden, "input_lags": self.input_lags, "output_lags": self.output_lags}
        return "neural", {**keys, "activation": self.activation, "direct": self.direct}

    def _tables(self) -> dict[str, Any]:
        if self.estimator is not None:
            for name, default in (("starts", 12), ("max_evaluations", 120)):
                if getattr(self, name) != default:
                    raise ArgumentError(f"{name}: found {getattr(self, name)} beside estimator=, which says it itself: expected one of them")
            return super()._tables()
        own = {"name": "train", "starts": self.starts, "max_evaluations": self.max_evaluations}
        full = Estimator("neural", own, keys=self._structure()[1], prepare=self.prepare)
        return full._tables()


class _Linear(Estimator):
    """Linear structures with a noise model, by prediction error."""

    _name = ""
    _orders: tuple[str, ...] = ()

    def _structure(self) -> tuple[str, dict[str, Any]]:
        return self._name, {n: getattr(self, n) for n in self._orders}


class Armax(_Linear):
    """A y = B u + C e, by prediction error."""

    _name, _orders = "armax", ("na", "nb", "nc", "nk")

    def __init__(
        self,
        na: int = 2,
        nb: int | Mapping[str, int] = 2,
        nc: int = 1,
        *,
        nk: int | Mapping[str, int] = 1,
        estimator: str | Mapping[str, Any] = "pem",
        prepare: Iterable[Mapping[str, Any]] | None = None,
    ) -> None:
        self.na, self.nb, self.nc, self.nk = na, nb, nc, nk
        self.estimator, self.prepare = estimator, prepare
        self.select = self.seed = None


class OutputError(_Linear):
    """y = B/F u + e, by prediction error."""

    _name, _orders = "oe", ("nb", "nf", "nk")

    def __init__(
        self,
        nb: int | Mapping[str, int] = 2,
        nf: int | Mapping[str, int] = 2,
        *,
        nk: int | Mapping[str, int] = 1,
        estimator: str | Mapping[str, Any] = "pem",
        prepare: Iterable[Mapping[str, Any]] | None = None,
    ) -> None:
        self.nb, self.nf, self.nk = nb, nf, nk
        self.estimator, self.prepare = estimator, prepare
        self.select = self.seed = None


class BoxJenkins(_Linear):
    """y = B/F u + C/D e, by prediction error."""

    _name, _orders = "bj", ("nb", "nc", "nd", "nf", "nk")

    def __init__(
        self,
        nb: int | Mapping[str, int] = 2,
        nc: int = 1,
        nd: int = 1,
        nf: int | Mapping[str, int] = 2,
        *,
        nk: int | Mapping[str, int] = 1,
        estimator: str | Mapping[str, Any] = "pem",
        prepare: Iterable[Mapping[str, Any]] | None = None,
    ) -> None:
        self.nb, self.nc, self.nd, self.nf, self.nk = nb, nc, nd, nf, nk
        self.estimator, self.prepare = estimator, prepare
        self.select = self.seed = None


class GaussianProcess(Estimator):
    """Gaussian process with a length for each input and estimated noise."""

    def __init__(
        self,
        *,
        kernel: str = "auto",
        mean: str = "linear",
        noise: str = "constant",
        transform: str = "none",
        starts: int = 4,
        input_lags: int = 0,
        output_lags: int = 0,
        prepare: Iterable[Mapping[str, Any]] | None = None,
        seed: int | None = None,
    ) -> None:
        self.kernel, self.mean, self.noise, self.transform, self.starts = kernel, mean, noise, transform, starts
        self.input_lags, self.output_lags, self.prepare, self.seed = input_lags, output_lags, prepare, seed
        self.select, self.estimator = None, "learn"

    def _structure(self) -> tuple[str, dict[str, Any]]:
        names = ("kernel", "mean", "noise", "transform", "starts", "input_lags", "output_lags")
        return "gaussian_process", {n: getattr(self, n) for n in names}


class LocalLinear(Estimator):
    """Local linear models under smooth splits, as many as the left-out error asks for."""

    def __init__(
        self,
        *,
        quadratic: bool = False,
        most: int = 40,
        input_lags: int = 0,
        output_lags: int = 0,
        prepare: Iterable[Mapping[str, Any]] | None = None,
    ) -> None:
        self.quadratic, self.most = quadratic, most
        self.input_lags, self.output_lags, self.prepare = input_lags, output_lags, prepare
        self.select, self.estimator, self.seed = None, "learn", None

    def _structure(self) -> tuple[str, dict[str, Any]]:
        names = ("quadratic", "most", "input_lags", "output_lags")
        return "local_linear", {n: getattr(self, n) for n in names}
