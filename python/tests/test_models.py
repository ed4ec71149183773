"""Estimators and models against what is known of the systems."""

from __future__ import annotations

import json
import pickle

import numpy as np
import pytest
from conftest import lagged, trained

import dynocal
from dynocal.errors import ArgumentError, DataError, EstimateError, FileError, ModelError, NotFittedError, ResultWarning, SpecError

TRUE = {"y(t-1)": 1.5, "y(t-2)": -0.7, "u(t-1)": 1.0, "u(t-2)": 0.5}


@pytest.mark.parametrize("estimator", ["ols", "sem", {"name": "iv"}])
def test_a_linear_system_is_found(estimator) -> None:
    u, y = lagged(600)
    m = dynocal.Arx(na=2, nb=2, constant=False, estimator=estimator).fit(u, y, ts_s=0.1)
    assert m.parameters_ == pytest.approx(TRUE, abs=1e-6)


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_least_squares_is_that_of_numpy(seed: int) -> None:
    u, y = lagged(500, seed=seed, noise=0.2)
    m = dynocal.Arx(na=2, nb=2).fit(u, y, ts_s=0.1)
    rows = np.column_stack([y[1:-1], y[:-2], u[1:-1], u[:-2], np.ones(len(y) - 2)])
    expected = np.linalg.lstsq(rows, y[2:], rcond=None)[0]
    by_name = m.parameters_
    found = [by_name[n] for n in ("y(t-1)", "y(t-2)", "u(t-1)", "u(t-2)", "1")]
    assert np.allclose(found, expected, rtol=1e-9, atol=1e-12)
    one_step = m.predict(u, y)
    assert np.allclose(one_step[2:], rows @ expected, rtol=1e-9, atol=1e-9)


def test_free_run_against_the_recursion(arx) -> None:
    u, y = lagged(300, seed=9)
    run = arx.simulate(u, y0=y[:2])
    assert np.allclose(run, y, atol=1e-9)
    # From rest, which of a linear system is zero: the recursion over a record before which everything was zero.
    before, rest = np.concatenate([[0.0, 0.0], u]), np.zeros(302)
    for t in range(2, 302):
        rest[t] = 1.5 * rest[t - 1] - 0.7 * rest[t - 2] + before[t - 1] + 0.5 * before[t - 2]
    assert np.allclose(arx.simulate(u), rest[2:], atol=1e-9)
    # Many steps ahead are the free run from the start.
    assert np.allclose(arx.predict(u, y, steps=1000), run, atol=1e-9)


def test_shapes(arx) -> None:
    u, y = lagged(50)
    assert arx.simulate(u).shape == (50,) and arx.simulate(u[:, None]).shape == (50,)
    two = dynocal.Arx(na=1, nb=1).fit(np.column_stack([u, u**2]), np.column_stack([y, -y]), ts_s=0.1)
    assert two.model_.inputs == ["u1", "u2"] and two.model_.outputs == ["y1", "y2"]
    assert two.simulate(np.column_stack([u, u**2])).shape == (50, 2)
    with pytest.raises(ModelError, match=r"single\(output\)"):
        two.model_.parameters


def test_manners_of_an_estimator() -> None:
    m = dynocal.Narx(ylag=2, xlag=3, degree=2, estimator="sem")
    assert m.get_params()["xlag"] == 3 and repr(m) == "Narx(ylag=2, xlag=3, estimator='sem')"
    assert m.set_params(xlag=1) is m and m.get_params()["xlag"] == 1
    with pytest.raises(ArgumentError, match="xleg"):
        m.set_params(xleg=1)
    with pytest.raises(NotFittedError, match="fit"):
        m.simulate([1.0, 2.0])
    u, y = lagged(100)
    assert m.fit(u, y) is m
    assert not hasattr(dynocal.Arx(), "model_")


def test_pickle_and_files_keep_the_model(tmp_path, arx) -> None:
    u, _ = lagged(80, seed=2)
    path = tmp_path / "model.json"
    arx.model_.save(path)
    for other in (pickle.loads(pickle.dumps(arx)), pickle.loads(pickle.dumps(arx.model_)), dynocal.Model.load(path)):
        assert np.array_equal(other.simulate(u), arx.simulate(u))
    dynocal.Model.load(path).save(tmp_path / "again.json")
    assert path.read_bytes() == (tmp_path / "again.json").read_bytes()
    assert json.loads(arx.model_.to_json()) == json.loads(path.read_text())
    (tmp_path / "other.json").write_text("{}")
    with pytest.raises(FileError, match="dynocal/model"):
        dynocal.Model.load(tmp_path / "other.json")


def test_scores_against_their_definition() -> None:
    d = trained()
    train, test = d.split(at_s=20.0)
    m = dynocal.Arx(na=2, nb=2).fit(train)
    for record, seen in ((train, "identification"), (test, "unseen")):
        row = m.score(record).of("one_step")
        assert row.data == seen and row.unit == "Nm"
        error = record["y"][2:] - m.predict(record)["y"][2:]
        spread = record["y"][2:] - record["y"][2:].mean()
        assert row.samples == len(error)
        assert row.rmse == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-9)
        assert row.r2_percent == pytest.approx(100 * (1 - (error @ error) / (spread @ spread)), rel=1e-9)
        free = m.score(record).of("free_run")
        run = record["y"][2:] - m.simulate(record)["y"][2:]
        assert free.rmse == pytest.approx(np.sqrt(np.mean(run**2)), rel=1e-9)
    table = m.score(test, k_steps=[5])
    assert [r.kind for r in table] == ["one_step", "k_step(5)", "free_run"]
    assert "RMSE" in repr(table) and "<table>" in table._repr_html_()


def test_what_an_unstable_run_says() -> None:
    u, y = lagged(200)
    m = dynocal.Polynomial(["y(t-1)^2", "u(t-1)"]).fit(u, y, ts_s=0.1)
    big = dynocal.Dataset({"u": 1e3 + np.zeros(60), "y": np.zeros(60)}, ts_s=0.1, outputs="y")
    scores = m.score(big)
    assert scores.of("free_run").rmse is None
    assert any(f.grade == "fault" for f in scores.findings)
    assert any("diverges" in n for n in m.simulate(big).notes)


def test_a_search_that_has_not_ended_says_so() -> None:
    u, y = lagged(200, noise=0.3)
    with pytest.warns(ResultWarning, match="evaluations without converging"):
        m = dynocal.Polynomial(["y(t-1)", "u(t-1)", "u(t-1)^3"], estimator={"name": "sem", "max_evaluations": 1}).fit(u, y)
    assert m.status_ == ["limit"] and m.findings_[0].grade == "fault"


def test_selection_finds_the_terms() -> None:
    draw = np.random.default_rng(11)
    u, y = draw.uniform(-1, 1, 1200), np.zeros(1200)
    for t in range(2, 1200):
        y[t] = 0.5 * y[t - 1] + u[t - 1] - 0.3 * u[t - 1] * y[t - 1] + 0.2 * u[t - 2] ** 2
    m = dynocal.Narx(ylag=2, xlag=2, degree=2, terms=4).fit(u, y, ts_s=0.1)
    found = dict(sorted(m.parameters_.items()))
    assert len(found) == 4 and all(abs(v) > 0.19 for v in found.values())
    assert sorted(abs(v) for v in found.values()) == pytest.approx([0.2, 0.3, 0.5, 1.0], abs=1e-6)


def test_prepared_models_take_raw_records() -> None:
    u, y = lagged(500)
    raw = dynocal.Dataset({"u": 3.0 * u + 10.0, "y": 2.0 * y + 100.0}, ts_s=0.1, outputs="y")
    plain = dynocal.Arx(na=2, nb=2, constant=False, prepare=[{"step": "offset"}]).fit(raw)
    run = plain.simulate(raw)
    assert np.allclose(run["y"][2:], raw["y"][2:], atol=0.5) and plain.score(raw).of("one_step").rmse < 0.1


def test_points_without_time() -> None:
    draw = np.random.default_rng(5)
    x = draw.uniform(-2, 2, (60, 2))
    z = np.sin(x[:, 0]) + 0.5 * x[:, 1]
    points = dynocal.Dataset({"a": x[:, 0], "b": x[:, 1], "z": z}, outputs="z")
    m = dynocal.GaussianProcess(starts=1, kernel="squared_exponential").fit(points)
    assert m.model_.is_steady and m.model_.ts_s is None
    new = draw.uniform(-1.5, 1.5, (40, 2))
    assert np.abs(m.simulate(new) - (np.sin(new[:, 0]) + 0.5 * new[:, 1])).max() < 0.05
    with pytest.raises(DataError, match="steady points"):
        dynocal.Arx().fit(points)


def test_networks_learn() -> None:
    draw = np.random.default_rng(8)
    u, y = draw.uniform(-1, 1, 400), np.zeros(400)
    for t in range(1, 400):
        y[t] = 0.6 * y[t - 1] + np.tanh(2 * u[t - 1])
    m = dynocal.Neural(hidden=4, input_lags=1, output_lags=1, starts=3, max_evaluations=60, seed=1).fit(u, y, ts_s=0.1)
    again = dynocal.Neural(hidden=4, input_lags=1, output_lags=1, starts=3, max_evaluations=60, seed=1).fit(u, y, ts_s=0.1)
    assert m.model_.to_json() == again.model_.to_json()
    assert np.corrcoef(m.simulate(u)[5:], y[5:])[0, 1] > 0.99


def test_refusals_are_ours() -> None:
    u, y = lagged(60)
    with pytest.raises(SpecError, match="model.estimator.name.*`olz`|olz"):
        dynocal.Arx(estimator="olz").fit(u, y)
    with pytest.raises(SpecError, match="nn"):
        dynocal.Estimator("arx", keys={"nn": 2}).fit(u, y)
    with pytest.raises((DataError, EstimateError), match="constant"):
        dynocal.Arx().fit(np.ones(60), y)
    with pytest.raises((DataError, EstimateError)):
        dynocal.Arx(na=30, nb=30).fit(u, y)


def test_far_ahead_costs_no_memory() -> None:
    u, y = lagged(300, noise=0.1)
    d = dynocal.Dataset({"u": u, "y": y}, ts_s=0.1, outputs="y")
    m = dynocal.Arx(na=2, nb=2).fit(d).model_
    assert np.array_equal(m.predict(u, y, steps=10**12), m.predict(u, y, steps=300))
    with pytest.raises(ArgumentError, match=r"k_steps\[0\]: found 300, expected less than the 300 samples"):
        m.score(d, k_steps=[300])
    assert [r.kind for r in m.score(d, k_steps=[5, 5])] == [r.kind for r in m.score(d, k_steps=[5])]


def test_a_free_run_without_end_is_said() -> None:
    m = dynocal.Model.from_system(([0.0, 1.0], [1.0, -5.0]), ts_s=0.1)
    with pytest.warns(ResultWarning, match="left all numbers in sample"):
        m.simulate(np.ones(1000))


def test_what_chose_a_model_is_not_unseen(tmp_path) -> None:
    u, y = lagged(400, noise=0.1)
    first, rest = dynocal.Dataset({"u": u, "y": y}, ts_s=0.1, outputs="y").split(fraction=0.5)
    chose, unseen = rest.split(fraction=0.5)
    m = dynocal.Neural(2, starts=1, max_evaluations=5, seed=1).fit(first, selecting=chose).model_
    m.save(tmp_path / "m.json")
    for one in (m, dynocal.Model.load(tmp_path / "m.json")):
        assert {r.data for r in one.score(chose)} == {"selection"}
        assert {r.data for r in one.score(unseen)} == {"unseen"}
