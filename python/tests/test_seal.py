"""What a model has seen is never reported as unseen: by pieces of the record, wherever they are read."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import lagged

import dynocal

SPEC = """
[data]
file = "{file}"
time = "{time}"
[split]
fractions = [0.5, 0.2, 0.3]
[[channels]]
column = "u"
unit = "V"
role = "input"
[[channels]]
column = "y"
unit = "Nm"
role = "output"
[model]
structure = {{ name = "arx", na = 2, nb = 2 }}
estimator = {{ name = "ols" }}
"""


def record(n: int = 2000, seed: int = 1) -> dynocal.Dataset:
    u, y = lagged(n, seed=seed, noise=0.1)
    return dynocal.Dataset({"u": u, "y": y}, ts_s=0.1, outputs="y", units={"u": "V", "y": "Nm"})


def data(model: dynocal.Model, d: dynocal.Dataset) -> str:
    (found,) = {r.data for r in model.score(d)}
    return found


def fitted(d: dynocal.Dataset) -> dynocal.Model:
    return dynocal.Arx(na=2, nb=2).fit(d).model_


def test_columns_order_and_rounding_do_not_matter() -> None:
    d = record()
    m = fitted(d)
    u, y = d["u"], d["y"]
    units = {"u": "V", "y": "Nm"}
    hole = u.copy()
    hole[700] = np.nan
    same = {
        "itself": d,
        "another order": dynocal.Dataset({"y": y, "u": u}, ts_s=0.1, outputs="y", units=units),
        "a channel beside": dynocal.Dataset({"u": u, "z": u**2, "y": y}, ts_s=0.1, inputs="u", outputs="y", units=units),
        "a missing sample": dynocal.Dataset({"u": hole, "y": y}, ts_s=0.1, outputs="y", units=units, missing=True),
        "another last bit": dynocal.Dataset({"u": u, "y": y}, ts_s=0.1 + 1e-16, outputs="y", units=units),
        "single precision": dynocal.Dataset({"u": u.astype("f4"), "y": y.astype("f4")}, ts_s=0.1, outputs="y", units=units),
    }
    assert {k: data(m, v) for k, v in same.items()} == dict.fromkeys(same, "identification")
    assert data(m, record(seed=2)) == "unseen"


def test_parts_and_what_is_around() -> None:
    d = record(4000)
    first, rest = d.split(fraction=0.5)
    m = fitted(first)
    assert data(m, d) == "identification" and data(m, rest) == "unseen"
    assert data(fitted(d), d.part(1000, 1400)) == "identification"


def test_points_in_any_order() -> None:
    draw = np.random.default_rng(3)
    x = draw.uniform(-2, 2, 60)
    z = np.sin(x) + 0.05 * draw.standard_normal(60)
    points = dynocal.Dataset({"x": x, "z": z}, outputs="z")
    m = dynocal.GaussianProcess(starts=1, kernel="squared_exponential").fit(points).model_
    turned = dynocal.Dataset({"x": x[::-1], "z": z[::-1]}, outputs="z")
    others = dynocal.Dataset({"x": x + 0.01, "z": z}, outputs="z")
    assert data(m, points) == data(m, turned) == "identification" and data(m, others) == "unseen"


@pytest.mark.parametrize("ending", ["csv", "parquet", "mf4"])
def test_a_model_of_a_job_knows_its_file_and_the_other_way(ending: str, tmp_path: Path) -> None:
    d = record()
    d.write(tmp_path / f"d.{ending}")
    spec = tmp_path / "job.toml"
    spec.write_text(SPEC.format(file=f"d.{ending}", time="Time" if ending == "mf4" else "time"), encoding="utf-8")
    run = dynocal.identify(spec, out=tmp_path / "run")
    own = run.models["y"]
    read = dynocal.read(tmp_path / f"d.{ending}", outputs="y")
    parts = [read.part(0, 1000), read.part(1000, 1400), read.part(1400, 2000)]
    assert [data(own, p) for p in parts] == ["identification", "selection", "unseen"]
    assert data(own, read) == "identification"
    # The program judges a model that was fitted in memory: of the first half of the file.
    fitted(d.part(0, 1000)).save(tmp_path / "m.json")
    asked = [sys.executable, "-m", "dynocal", "identify", str(spec), "--model", str(tmp_path / "m.json"), "--out", str(tmp_path / "judged")]
    done = subprocess.run(asked, capture_output=True, text=True)
    assert done.returncode in (0, 1), done.stderr
    seen = {s["part"]: s["data"] for s in dynocal.Run(tmp_path / "judged").summary["scores"]}
    assert seen["record"] == "identification" and seen["test"] == "unseen"


def test_what_chose_is_said_to_have_chosen(tmp_path: Path) -> None:
    first, rest = record().split(fraction=0.5)
    chose, unseen = rest.split(fraction=0.5)
    m = dynocal.Neural(2, starts=1, max_evaluations=5, seed=1).fit(first, selecting=chose).model_
    m.save(tmp_path / "m.json")
    for one in (m, dynocal.Model.load(tmp_path / "m.json")):
        assert [data(one, d) for d in (first, chose, unseen)] == ["identification", "selection", "unseen"]
    # Records of ordinary use do not have to be told apart: nothing is chosen by them.
    with pytest.raises(dynocal.errors.ArgumentError, match="selecting: found records beside the estimator `ols`"):
        dynocal.Arx().fit(first, selecting=chose)
