"""Records in and out."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from conftest import trained

import dynocal
from dynocal.errors import ArgumentError, DataError, FileError

FORMATS = ["record.csv", "record.csv.gz", "record.parquet", "record.mf4", "record.mat"]


def test_what_goes_in_is_what_is_there() -> None:
    u = np.arange(10.0)
    d = dynocal.Dataset({"u": u, "y": list(range(10)), "k": np.arange(10, dtype=np.int16)}, ts_s=0.5, outputs=["y"], inputs="u")
    assert d.channels == ["u", "y", "k"] and d.inputs == ["u"] and d.outputs == ["y"]
    assert d["k"].dtype == np.float64 and np.array_equal(d["k"], u)
    assert d.to_numpy().shape == (10, 3) and d.to_numpy("u").shape == (10,)
    assert np.array_equal(d.time_s, 0.5 * u)


def test_inputs_are_never_changed() -> None:
    u, y = np.random.default_rng(1).standard_normal((2, 300))
    before = u.copy(), y.copy()
    u.setflags(write=False)
    y.setflags(write=False)
    d = dynocal.Dataset({"u": u, "y": y}, ts_s=0.1, outputs="y")
    m = dynocal.Arx(na=1, nb=1).fit(d)
    m.score(d)
    m.predict(u, y)
    m.simulate(u, y0=y[:1])
    dynocal.Arx().fit(u, y)
    assert np.array_equal(u, before[0]) and np.array_equal(y, before[1])
    # What is given out is a copy: writing into it changes nothing.
    d["u"][:] = 0.0
    assert np.array_equal(d["u"], before[0])


def test_strides_and_orders_do_not_matter() -> None:
    whole = np.random.default_rng(2).standard_normal((200, 6))
    y = np.roll(whole[:, 1], 1)
    fits = [
        dynocal.Arx(na=1, nb=1).fit(u, y, ts_s=0.1).parameters_
        for u in (whole[:, 1:3], np.asfortranarray(whole[:, 1:3]), np.ascontiguousarray(whole[:, 1:3]))
    ]
    assert fits[0] == fits[1] == fits[2]
    flipped = np.ascontiguousarray(whole[::-1, 1])
    assert np.array_equal(dynocal.Dataset({"a": whole[::-1, 1]})["a"], flipped)


def test_splits_lose_nothing() -> None:
    d = trained()
    for left, right in (d.split(at_s=13.0), d.split(fraction=0.325), d.split(sample=130)):
        assert len(left) == 130
        assert np.array_equal(np.concatenate([left["y"], right["y"]]), d["y"])
    # 0.7 / 0.1 is 6.999.. in floating point: the sample at 0.7 s is the first of the second part.
    assert len(d.split(at_s=0.7)[0]) == 7


def test_missing_samples_are_asked_for() -> None:
    values = np.array([0.0, np.nan, 2.0])
    with pytest.raises(DataError, match="sample 1"):
        dynocal.Dataset({"a": values}, ts_s=1.0)
    d = dynocal.Dataset({"a": values}, ts_s=1.0, missing=True)
    assert np.isnan(d["a"][1])


@pytest.mark.parametrize("file", FORMATS)
def test_files_keep_every_sample(tmp_path, file: str) -> None:
    d = trained()
    d.write(tmp_path / file)
    back = dynocal.read(tmp_path / file, outputs="y")
    assert back.channels == d.channels and back.ts_s == pytest.approx(0.1, rel=1e-12)
    for name in d:
        assert np.array_equal(back[name], d[name]), name
    assert back.units == d.units


def test_files_are_read_as_they_are_asked_for(tmp_path) -> None:
    path = tmp_path / "bed.csv"
    path.write_text("time [ms],trq [lb ft],state\n0,100,a\n20,110,b\n40,120,b\n60,130,b\n")
    d = dynocal.read(path)
    assert d.channels == ["trq"] and d.ts_s == pytest.approx(0.02)
    assert any("state" in n for n in d.notes)
    renamed = dynocal.read(path, {"torque": "trq"}, units={"torque": "Nm"}, outputs="torque")
    # 1 lbf ft = 0.3048 m * 0.45359237 kg * 9.80665 m/s2.
    assert renamed["torque"][0] == pytest.approx(100 * 0.3048 * 0.45359237 * 9.80665, rel=1e-12)
    slower = dynocal.read(path, ["trq"], ts_s=0.04)
    assert slower.ts_s == pytest.approx(0.04) and list(slower["trq"]) == [100.0, 120.0]
    with pytest.raises(FileError, match="nowhere.csv"):
        dynocal.read(tmp_path / "nowhere.csv")
    with pytest.raises(FileError, match="did you mean `trq`|trq"):
        dynocal.read(path, ["trw"])


def test_what_is_masked_is_missing() -> None:
    values = np.ma.masked_array([1.0, 2.0, 3.0], mask=[False, True, False])
    with pytest.raises(DataError, match="sample 1"):
        dynocal.Dataset({"a": values}, ts_s=1.0)
    assert np.isnan(dynocal.Dataset({"a": values}, ts_s=1.0, missing=True)["a"][1])
    assert np.isnan(dynocal.Dataset({"a": np.ma.masked_equal([1, 2, 3], 2)}, ts_s=1.0, missing=True)["a"][1])


def test_pickle_keeps_it() -> None:
    d = trained().with_init_samples(5)
    back = pickle.loads(pickle.dumps(d))
    assert back == d and back.units == d.units and back.outputs == d.outputs and back.init_samples == 5


class Table:
    """A table of an Arrow stream and nothing else."""

    def __init__(self, d: dynocal.Dataset) -> None:
        self.d = d

    def __arrow_c_stream__(self, requested_schema: object = None) -> object:
        return self.d.__arrow_c_stream__()


def test_arrow_comes_back_as_it_went() -> None:
    d = trained()
    back = dynocal.Dataset(Table(d), ts_s=0.1, outputs="y")
    assert all(np.array_equal(back[n], d[n]) for n in d)
    with pytest.raises(ArgumentError, match="__arrow_c_stream__"):
        dynocal.Dataset(3.0)


def test_arrow_of_pyarrow() -> None:
    pa = pytest.importorskip("pyarrow")
    table = pa.table({
        "u": pa.chunked_array([[0.0, 1.0], [None, 3.0]]),
        "k": pa.chunked_array([pa.array([1, 2], pa.int16()), pa.array([3, 4], pa.int16())]),
        "on": pa.chunked_array([[True, False], [True, True]]),
        "t": pa.chunked_array([pa.array([0, 20], pa.timestamp("ms")), pa.array([40, 60], pa.timestamp("ms"))]),
        "word": pa.chunked_array([["a", "b"], ["c", "d"]]),
    })
    d = dynocal.Dataset(table, time="t", missing=True)
    assert d.ts_s == pytest.approx(0.02) and d.channels == ["u", "k", "on"]
    assert np.isnan(d["u"][2]) and list(d["k"]) == [1, 2, 3, 4] and list(d["on"]) == [1, 0, 1, 1]
    assert any("word" in n for n in d.notes)
    # A slice begins in the middle of its buffers.
    assert list(dynocal.Dataset(table.slice(1, 2).select(["k", "on"]))["k"]) == [2, 3]
    back = pa.table(d)
    assert back.column("k").to_pylist() == [1, 2, 3, 4]
    assert back.schema.field("k").metadata == {b"unit": b"-"}


def test_pandas_and_polars() -> None:
    d = trained()
    pd, pl = pytest.importorskip("pandas"), pytest.importorskip("polars")
    frames = d.to_pandas(), d.to_polars()
    assert frames[0].index.name == "time_s" and frames[1].columns == ["time_s", "u", "y"]
    assert all(np.array_equal(frame["y"].to_numpy(), d["y"]) for frame in frames)
    fitted = [dynocal.Arx(na=2, nb=2).fit(f[["u", "y"]], outputs="y", ts_s=0.1).parameters_ for f in frames]
    assert fitted[0] == fitted[1] == dynocal.Arx(na=2, nb=2).fit(d).parameters_
    assert isinstance(frames[0], pd.DataFrame) and isinstance(frames[1], pl.DataFrame)


def test_views_for_notebooks() -> None:
    d = dynocal.Dataset({"<u>": np.arange(100.0), "y": np.ones(100)}, ts_s=1.0, outputs="y")
    page = d._repr_html_()
    assert "&lt;u&gt;" in page and "<u>" not in page and page.count("<svg") == 2
