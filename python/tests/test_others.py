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


def linear(kind: str) -> dynocal.Estimator:
    return {
        "arx": dynocal.Arx(na=2, nb=2, constant=False),
        "armax": dynocal.Armax(na=2, nb=2, nc=1),
        "oe": dynocal.OutputError(nb={"u1": 2, "u2": 1}, nf=2, nk={"u1": 1, "u2": 3}),
        "bj": dynocal.BoxJenkins(nb=1, nf=2, nc=1, nd=1),
    }[kind]


@pytest.mark.parametrize("kind", ["arx", "armax", "oe", "bj"])
def test_linear_models_are_systems_of_others(kind: str) -> None:
    signal, control = pytest.importorskip("scipy.signal"), pytest.importorskip("control")
    draw = np.random.default_rng(6)
    u, y = draw.standard_normal((500, 2)), np.zeros(500)
    for t in range(3, 500):
        y[t] = 1.2 * y[t - 1] - 0.5 * y[t - 2] + u[t - 1, 0] + 0.3 * u[t - 2, 0] - 0.4 * u[t - 3, 1]
    model = linear(kind).fit(u, y + 0.01 * draw.standard_normal(500), ts_s=0.1).model_
    run = model.simulate(u)
    systems = model.to_scipy()
    filtered = sum(signal.lfilter(*model.transfer_functions()[n], u[:, k]) for k, n in enumerate(model.inputs))
    stepped = sum(signal.dlsim(systems[n], u[:, k])[1].ravel() for k, n in enumerate(model.inputs))
    whole = model.to_control()
    answer = sum(control.forced_response(whole[0, k], inputs=u[:, k]).outputs for k in range(2))
    for theirs in (filtered, stepped, answer):
        assert np.allclose(theirs, run, atol=1e-6 * np.abs(run).max())


def test_other_models_are_no_linear_systems() -> None:
    from dynocal.errors import ModelError

    u, y = lagged(200)
    with pytest.raises(ModelError, match=r"u\(t-1\)\^2"):
        dynocal.Polynomial(["y(t-1)", "u(t-1)^2"]).fit(u, y).model_.transfer_functions()


def test_plots_are_axes() -> None:
    pytest.importorskip("matplotlib")
    from conftest import trained

    d = trained()
    ax = d.plot()
    assert len(ax.lines) == 2 and ax.get_xlabel() == "time [s]"
    m = dynocal.Arx(na=2, nb=2).fit(d).model_
    assert m.plot(d, ax=ax) is ax and len(ax.lines) == 4
