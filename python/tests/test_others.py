"""Packages that others bring: scikit-learn, Gymnasium."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import lagged

import dynocal


def test_checks_of_scikit_learn() -> None:
    pytest.importorskip("sklearn")
    from sklearn.utils.estimator_checks import check_estimator

    from dynocal.sklearn import OneStepRegressor

    order = "rows are samples in time: their order and their neighbours are the data"
    expected = {
        "check_methods_sample_order_invariance": order,
        "check_methods_subset_invariance": order,
        "check_regressors_no_decision_function": "ten samples of four channels do not determine ten parameters: refused",
        "check_fit2d_1sample": "one sample holds no dynamics: it is refused in a sentence of ours",
    }
    results = check_estimator(OneStepRegressor(), expected_failed_checks=expected, on_fail=None, on_skip=None)
    failed = {r["check_name"]: str(r["exception"]) for r in results if r["status"] == "failed"}
    assert failed == {}
    assert sum(r["status"] == "passed" for r in results) >= 40
    # A check that is expected to fail and does not is no reason to skip it.
    assert {r["check_name"] for r in results if r["status"] == "xfail"} <= set(expected)


def test_pipelines_and_searches() -> None:
    pytest.importorskip("sklearn")
    from sklearn.base import clone
    from sklearn.model_selection import GridSearchCV, TimeSeriesSplit
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    from dynocal.sklearn import OneStepRegressor

    u, y = lagged(900, noise=0.05)
    steps = make_pipeline(StandardScaler(), OneStepRegressor(delay=1))
    grid = {"onestepregressor__ylag": [1, 2], "onestepregressor__xlag": [1, 2]}
    search = GridSearchCV(steps, grid, cv=TimeSeriesSplit(3, test_size=200)).fit(u[:, None], y)
    assert search.best_params_ == {"onestepregressor__ylag": 2, "onestepregressor__xlag": 2}
    assert clone(dynocal.Arx(na=3)).get_params()["na"] == 3


def test_the_environment() -> None:
    gymnasium = pytest.importorskip("gymnasium")
    from gymnasium.utils.env_checker import check_env

    from dynocal.gym import TorqueEnv

    env = TorqueEnv(length=30)
    check_env(env, skip_render_check=True)
    assert isinstance(env, gymnasium.Env)

    def episode(seed: int) -> tuple[list[float], int]:
        env.reset(seed=seed)
        rewards, ends = [], 0
        for t in range(30):
            _, reward, terminated, truncated, info = env.step(np.array([np.sin(0.2 * t)]))
            rewards.append(reward)
            ends += truncated or terminated
        assert "torque" in info and info["demand_nm"] >= 20.0
        return rewards, ends

    first, ends = episode(3)
    assert ends == 1 and len(set(first)) > 10
    assert episode(3)[0] == first and episode(4)[0] != first
