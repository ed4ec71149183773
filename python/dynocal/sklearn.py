"""A regressor for scikit-learn: ``Pipeline``, ``GridSearchCV``, ``TimeSeriesSplit``.

Rows are samples in time, in their order. :meth:`OneStepRegressor.predict` needs no measured outputs: scikit-learn gives it inputs
alone, so what it returns is the free run from rest. The one-step prediction stands in :meth:`OneStepRegressor.predict_one_step`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ._data import _package
from ._estimators import Estimator
from ._structures import Narx
from .errors import ArgumentError

_package("sklearn", "dynocal.sklearn")

from sklearn.base import BaseEstimator, RegressorMixin  # noqa: E402
from sklearn.utils.validation import check_is_fitted, validate_data  # noqa: E402

__all__ = ["OneStepRegressor"]


class OneStepRegressor(RegressorMixin, BaseEstimator):  # type: ignore[misc]
    """A dynamic model as a regressor on inputs (samples, channels).

    Parameters
    ----------
    ylag, xlag, degree, delay
        Of :class:`dynocal.Narx`. ``delay=0`` lets an output answer within its sample; with ``ylag=0`` nothing is remembered but inputs.
    estimator
        ``"ols"`` (one-step error) or ``"sem"`` (error of the free run).
    """

    def __init__(self, ylag: int = 1, xlag: int = 2, degree: int = 1, delay: int = 0, estimator: str = "ols") -> None:
        self.ylag = ylag
        self.xlag = xlag
        self.degree = degree
        self.delay = delay
        self.estimator = estimator

    def fit(self, X: Any, y: Any) -> OneStepRegressor:
        """Estimates the model from rows in time."""
        X, y = validate_data(self, X, y, y_numeric=True, dtype=np.float64, ensure_min_samples=2)
        full: Estimator = Narx(self.ylag, self.xlag, self.degree, delay=self.delay, estimator=self.estimator)
        self.estimator_ = full.fit(X, y)
        self.model_ = self.estimator_.model_
        return self

    def predict(self, X: Any) -> Any:
        """The free run from rest (samples,)."""
        check_is_fitted(self)
        X = validate_data(self, X, dtype=np.float64, reset=False)
        return self.model_.simulate(X)

    def predict_one_step(self, X: Any, y: Any) -> Any:
        """One step ahead of measured outputs (samples,)."""
        check_is_fitted(self)
        X = validate_data(self, X, dtype=np.float64, reset=False)
        y = np.asarray(y, dtype=np.float64)
        if y.shape != (len(X),):
            raise ArgumentError(f"y: found shape {y.shape}, expected ({len(X)},)")
        return self.model_.predict(X, y)
