"""Frames and tables: names, time, units, steady points."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conftest import lagged

import dynocal
from dynocal.errors import ArgumentError, DataError, DynocalError, ModelError


def two(n: int = 300) -> dynocal.Dataset:
    draw = np.random.default_rng(1)
    speed, load = draw.uniform(1, 2, n), draw.uniform(10, 20, n)
    y = np.zeros(n)
    for t in range(1, n):
        y[t] = 0.5 * y[t - 1] + 3.0 * speed[t - 1] + 0.1 * load[t - 1]
    return dynocal.Dataset({"speed": speed, "load": load, "torque": y}, ts_s=0.1, outputs="torque", units={"speed": "1/s"})


def test_columns_are_taken_by_name() -> None:
    pandas = pytest.importorskip("pandas")
    polars = pytest.importorskip("polars")
    d = two()
    m = dynocal.Arx(na=1, nb=1).fit(d).model_
    columns = {n: d[n] for n in ("speed", "load")}
    expected = m.simulate(np.column_stack([d["speed"], d["load"]]))
    turned = {"load": columns["load"], "speed": columns["speed"]}
    for table in (pandas.DataFrame(turned), polars.DataFrame(turned), turned, d.to_pandas(), d.to_polars()):
        assert np.array_equal(m.simulate(table), expected)
        if "torque" in table:
            assert np.array_equal(m.predict(table, d["torque"]), m.predict(np.column_stack(list(columns.values())), d["torque"]))
    with pytest.raises(ArgumentError, match="u: found the columns load, expected speed, load"):
        m.simulate(pandas.DataFrame({"load": d["load"]}))


def test_a_frame_gives_its_names_to_the_model() -> None:
    pandas = pytest.importorskip("pandas")
    d = two()
    frame = d.to_pandas()
    m = dynocal.Arx(na=1, nb=1).fit(frame[["load", "speed"]], frame["torque"]).model_
    assert (m.inputs, m.outputs, m.ts_s) == (["load", "speed"], ["torque"], 0.1)
    assert dynocal.Arx().fit(pandas.DataFrame({"speed": d["speed"]}), pandas.Series(d["torque"], name="torque")).model_.inputs == ["speed"]
    # Without names that are texts it is an array.
    assert dynocal.Arx().fit(pandas.DataFrame(np.column_stack([d["speed"]])), d["torque"]).model_.inputs == ["u"]


def test_time_is_no_input() -> None:
    pandas = pytest.importorskip("pandas")
    pytest.importorskip("polars")
    u, y = lagged(300)
    d = dynocal.Dataset({"u": u, "y": y}, ts_s=0.1, outputs="y")
    for call in (
        lambda: dynocal.Arx().fit(d.to_polars(), outputs="y", ts_s=0.1),
        lambda: dynocal.Dataset(d.to_polars(), ts_s=0.1, outputs="y"),
        lambda: dynocal.Dataset({"time": u, "y": y}, ts_s=0.1, outputs="y"),
        lambda: dynocal.Dataset(pandas.DataFrame({"when": pandas.date_range("2026-01-01", periods=300, freq="100ms"), "y": y}), ts_s=0.1),
    ):
        with pytest.raises(ArgumentError, match="looks like time"):
            call()
    # Who says what it is has it.
    taken = dynocal.Dataset(d.to_polars(), time="time_s", outputs="y")
    assert taken.inputs == ["u"] and taken.ts_s == 0.1
    assert dynocal.Dataset(d.to_polars(), ts_s=0.1, inputs="u", outputs="y").inputs == ["u"]
    assert dynocal.Dataset({"t": u, "y": y}, ts_s=0.1, outputs="y", units={"t": "degC"}).inputs == ["t"]
    assert dynocal.Dataset({"T": u, "y": y}, ts_s=0.1, outputs="y").inputs == ["T"]


def test_the_index_of_a_frame_is_the_time() -> None:
    pandas = pytest.importorskip("pandas")
    u, y = lagged(300)
    d = dynocal.Dataset({"u": u, "y": y}, ts_s=0.1, outputs="y")
    for frame in (
        d.to_pandas(),
        pandas.DataFrame(d.to_dict(), index=pandas.date_range("2026-01-01", periods=300, freq="100ms")),
        pandas.DataFrame(d.to_dict(), index=pandas.to_timedelta(0.1 * np.arange(300), unit="s")),
    ):
        assert dynocal.Arx().fit(frame, outputs="y").model_.ts_s == pytest.approx(0.1, rel=1e-9)
    plain = pandas.DataFrame(d.to_dict())
    assert dynocal.Dataset(plain, outputs="y").is_steady and dynocal.Arx().fit(plain, outputs="y").model_.ts_s == 1.0


def test_a_column_that_counts_rows_is_left_out(tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    u, y = lagged(50)
    pandas.DataFrame({"u": u, "y": y}).to_csv(tmp_path / "plain.csv")
    read = dynocal.read(tmp_path / "plain.csv", ts_s=0.1, outputs="y")
    assert read.inputs == ["u"] and any("counts the rows" in n for n in read.notes)
    assert "1 note" in repr(read) or "notes" in repr(read)
    assert "counts the rows" in read._repr_html_()
    again = dynocal.Dataset(pandas.read_csv(tmp_path / "plain.csv"), ts_s=0.1, outputs="y")
    assert again.inputs == ["u"] and "counts the rows" in again.notes[0]


@pytest.mark.parametrize("ending", ["csv", "csv.gz", "parquet", "mf4"])
def test_points_come_back_without_a_time(ending: str, tmp_path: Path) -> None:
    points = dynocal.Dataset({"a": [1.0, 2.0, 4.0], "y": [0.5, 0.25, 0.75]}, outputs="y", units={"a": "V"})
    points.write(tmp_path / f"p.{ending}")
    back = dynocal.read(tmp_path / f"p.{ending}", steady=True, outputs="y")
    assert back == points
    # A table of points that somebody else has stamped.
    (tmp_path / "stamped.csv").write_text("time [s],a [V],y [-]\n0.1,1,2\n0.7,3,4\n", encoding="utf-8")
    stamped = dynocal.read(tmp_path / "stamped.csv", steady=True, outputs="y")
    assert stamped.inputs == ["a"]
    assert dynocal.read(tmp_path / "stamped.csv", ["time", "a"], steady=True).inputs == ["time", "a"]


@pytest.mark.parametrize("ending", ["csv", "parquet"])
@pytest.mark.parametrize("steady", [False, True])
def test_missing_samples_are_written(ending: str, steady: bool, tmp_path: Path) -> None:
    columns = {"u": [1.0, np.nan, 3.0], "y": [np.nan, 2.0, 3.0]}
    d = dynocal.Dataset(columns, ts_s=None if steady else 0.5, outputs="y", missing=True)
    d.write(tmp_path / f"d.{ending}")
    back = dynocal.read(tmp_path / f"d.{ending}", steady=steady, outputs="y", missing=True)
    for name, values in columns.items():
        assert np.array_equal(back[name], values, equal_nan=True)
    with pytest.raises(DynocalError, match="(?i)nan|missing|empty"):
        dynocal.read(tmp_path / f"d.{ending}", steady=steady, outputs="y")


def test_units_stay_in_the_family(tmp_path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    d = dynocal.Dataset({"u": [1.0, 2.0], "y": [3.0, 4.0]}, ts_s=0.1, outputs="y", units={"u": "V", "y": "Nm"})
    assert dynocal.Dataset(pyarrow.table(d), ts_s=0.1, outputs="y") == d
    assert dynocal.Dataset(d) == d and dynocal.Dataset(d, units={"u": "mV"}).units == {"u": "mV", "y": "Nm"}
    assert dynocal.Dataset(d, outputs=["u", "y"]).inputs == []
    plain = dynocal.Dataset({"u": [1.0, 2.0]}, ts_s=0.1)
    plain.write(tmp_path / "plain.csv")
    assert dynocal.read(tmp_path / "plain.csv", units={"u": "V"}).units == {"u": "V"}


def test_records_are_equal_where_they_mean_the_same() -> None:
    u, y = lagged(30)
    d = dynocal.Dataset({"u": u, "y": y}, ts_s=1.0, outputs="y")
    assert d == dynocal.Dataset({"u": u, "y": y}, ts_s=1.0, outputs="y", name="other")
    for other in (
        dynocal.Dataset({"u": u, "y": y}, outputs="y"),
        dynocal.Dataset({"u": u, "y": y}, ts_s=1.0, outputs="u"),
        dynocal.Dataset({"u": u, "y": y}, ts_s=1.0, outputs="y", init_samples=3),
    ):
        assert d != other
    m = dynocal.Arx().fit(u, y).model_
    with pytest.raises(ModelError, match="steady points"):
        m.simulate(dynocal.Dataset({"u": u}))
    with pytest.raises(ModelError, match="steady points"):
        m.score(dynocal.Dataset({"u": u, "y": y}, outputs="y"))


def test_roles_are_one_each(tmp_path: Path) -> None:
    u, y = lagged(30)
    d = dynocal.Dataset({"u": u, "y": y}, ts_s=1.0, outputs="y")
    d.write(tmp_path / "d.csv")
    for call in (
        lambda: dynocal.Dataset({"u": u, "y": y}, ts_s=1.0, inputs=["u", "y"], outputs="y"),
        lambda: dynocal.read(tmp_path / "d.csv", inputs=["u", "y"], outputs="y"),
    ):
        with pytest.raises(ArgumentError, match="found `y`, which is an output as well"):
            call()
    with pytest.raises(ArgumentError, match="ts_s: found it beside steady=True"):
        dynocal.read(tmp_path / "d.csv", steady=True, ts_s=0.1)


def test_tables_that_cannot_be_read_are_ours() -> None:
    pandas = pytest.importorskip("pandas")
    for table in (
        pandas.DataFrame({"u": [1.0, 2.0], "s": ["a", 1]}),
        pandas.DataFrame([[1.0, 2.0]], columns=["u", "u"]),
        pandas.DataFrame({"u": [1j, 2.0]}),
        pandas.DataFrame({"u": pandas.arrays.SparseArray([0.0, 1.0])}),
        {"u": [10**400]},
        {"\ud800": [1.0]},
    ):
        with pytest.raises((DataError, ArgumentError)):
            dynocal.Dataset(table, ts_s=0.1)
