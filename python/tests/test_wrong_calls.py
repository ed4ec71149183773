"""Wrong calls: each ends in an exception of ours that names what was wrong, none in a crash or in a result."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from conftest import lagged, trained

import dynocal
from dynocal.errors import DynocalError

U, Y = lagged(60)
D = trained()
FITTED = dynocal.Arx(na=2, nb=2).fit(D)
MODEL = FITTED.model_
TWO = dynocal.Arx(na=1, nb=1).fit(np.column_stack([U, U**2]), Y, ts_s=0.1)
ENGINE = dynocal.Engine()
POINTS = dynocal.Dataset({"a": U, "z": Y}, outputs="z")
NAN, HOLE, INF = np.full(60, np.nan), np.where(np.arange(60) == 7, np.nan, U), np.where(np.arange(60) == 7, np.inf, U)

Call = Callable[[], Any]

#: What is no record of 60 samples, for arguments that take one.
ARRAYS: dict[str, Any] = {
    "none": None,
    "text": "u",
    "texts": ["a"] * 60,
    "object": object(),
    "mapping": {"a": 1},
    "set": {1.0, 2.0},
    "complex": U + 1j,
    "dates": np.arange(60).astype("datetime64[s]"),
    "objects": np.array([object()] * 60),
    "ragged": [[1.0], [1.0, 2.0]] * 30,
    "empty": [],
    "no channels": np.zeros((60, 0)),
    "scalar": 3.0,
    "three dimensions": np.zeros((60, 1, 1)),
    "nan": NAN,
    "hole": HOLE,
    "inf": INF,
    "bytes": b"abc",
    "structured": np.zeros(60, dtype=[("a", float)]),
}

#: What is no positive number.
NUMBERS: dict[str, Any] = {
    "text": "0.1",
    "zero": 0.0,
    "negative": -0.1,
    "nan": float("nan"),
    "inf": float("inf"),
    "list": [0.1],
    "true": True,
    "complex": 1j,
    "mapping": {},
}

#: What is no whole number of one or more.
COUNTS: dict[str, Any] = {"text": "1", "half": 1.5, "zero": 0, "negative": -1, "none": None, "true": True, "list": [1], "huge": 2**70}

CALLS: dict[str, Call] = {}


def group(name: str, values: dict[str, Any], call: Callable[[Any], Any]) -> None:
    for kind, value in values.items():
        CALLS[f"{name} = {kind}"] = lambda value=value: call(value)


two_dims = {k: v for k, v in ARRAYS.items()}
group("fit u", two_dims, lambda v: dynocal.Arx().fit(v, Y))
group("fit y", {k: v for k, v in two_dims.items()}, lambda v: dynocal.Arx().fit(U, v))
group("simulate u", two_dims, lambda v: MODEL.simulate(v))
group("simulate y0", {k: v for k, v in two_dims.items() if k != "none"}, lambda v: MODEL.simulate(U, y0=v))
group("predict u", two_dims, lambda v: MODEL.predict(v, Y))
group("predict y", two_dims, lambda v: MODEL.predict(U, v))
group("channel", {k: v for k, v in ARRAYS.items()}, lambda v: dynocal.Dataset({"a": v}, ts_s=0.1))
group("plan", {k: v for k, v in two_dims.items()}, lambda v: ENGINE.run(v, 0.03))
group("ts_s of fit", NUMBERS, lambda v: dynocal.Arx().fit(U, Y, ts_s=v))
group("ts_s of Dataset", NUMBERS, lambda v: dynocal.Dataset({"a": U}, ts_s=v))
group("ts_s of signal", NUMBERS, lambda v: dynocal.signal("aprbs", 100, v, lo=0.0, hi=1.0, hold_s=0.5))
group("ts_s of step", NUMBERS, lambda v: ENGINE.step(ENGINE.start, v))
group("at_s", {k: v for k, v in NUMBERS.items()}, lambda v: D.split(at_s=v))
group("steps", COUNTS, lambda v: MODEL.predict(U, Y, steps=v))
group("sample", COUNTS, lambda v: D.split(sample=v if v is not None else -3))
group("n of signal", COUNTS, lambda v: dynocal.signal("aprbs", v, 0.1))
group("k_steps", COUNTS, lambda v: FITTED.score(D, k_steps=[v]))
group("n of design", COUNTS, lambda v: dynocal.design(MODEL, n=v, limits={"u": (-1, 1)}))
group("na", {k: v for k, v in COUNTS.items() if k not in ("none", "zero")}, lambda v: dynocal.Arx(na=v).fit(U, Y))
group("seed", {k: v for k, v in COUNTS.items() if k not in ("none", "zero")}, lambda v: ENGINE.reset(v))
group("degree", {k: v for k, v in COUNTS.items() if k not in ("none", "zero")}, lambda v: dynocal.Narx(degree=v).fit(U, Y))

CALLS.update({
    "lengths of u and y": lambda: dynocal.Arx().fit(U, Y[:-1]),
    "lengths of predict": lambda: MODEL.predict(U, Y[:-1]),
    "channels of u": lambda: MODEL.simulate(np.column_stack([U, U])),
    "channels of two": lambda: TWO.simulate(U),
    "channels of y": lambda: MODEL.predict(U, np.column_stack([Y, Y])),
    "transposed u": lambda: TWO.simulate(np.column_stack([U, U]).T),
    "short y0": lambda: MODEL.simulate(U, y0=Y[:1]),
    "y0 beside a record": lambda: MODEL.simulate(D, y0=Y[:2]),
    "initial beside arrays": lambda: MODEL.simulate(U, initial="rest"),
    "initial unknown": lambda: MODEL.simulate(D, initial="cold"),
    "y beside a record": lambda: dynocal.Arx().fit(D, Y),
    "ts_s beside a record": lambda: dynocal.Arx().fit(D, ts_s=0.1),
    "lengths of channels": lambda: dynocal.Dataset({"a": U, "b": U[:-1]}, ts_s=0.1),
    "no channels": lambda: dynocal.Dataset({}, ts_s=0.1),
    "names of channels": lambda: dynocal.Dataset({1: U}, ts_s=0.1),
    "unknown input": lambda: dynocal.Dataset({"a": U}, ts_s=0.1, inputs=["b"]),
    "unknown output": lambda: dynocal.Dataset({"a": U}, ts_s=0.1, outputs=["b"]),
    "unknown unit": lambda: dynocal.Dataset({"a": U}, ts_s=0.1, units={"b": "V"}),
    "unit that is no text": lambda: dynocal.Dataset({"a": U}, ts_s=0.1, units={"a": 3}),
    "units that are no mapping": lambda: dynocal.Dataset({"a": U}, ts_s=0.1, units=["V"]),
    "names twice": lambda: dynocal.Dataset({"a": U}, ts_s=0.1, inputs=["a", "a"]),
    "unknown time": lambda: dynocal.Dataset({"a": U}, time="t"),
    "time and ts_s": lambda: dynocal.Dataset({"a": U, "t": np.arange(60.0)}, time="t", ts_s=1.0),
    "uneven time": lambda: dynocal.Dataset({"a": U, "t": np.arange(60.0) ** 2}, time="t"),
    "backward time": lambda: dynocal.Dataset({"a": U, "t": -np.arange(60.0)}, time="t"),
    "unknown channel": lambda: D["torque"],
    "channel that is no text": lambda: D[0],
    "input that is the output": lambda: dynocal.Arx().fit(D, inputs=["y"], outputs=["y"]),
    "unknown target": lambda: dynocal.Arx().fit(D, outputs=["torque"]),
    "no target": lambda: dynocal.Arx().fit(dynocal.Dataset({"a": U, "b": Y}, ts_s=0.1)),
    "steady points": lambda: dynocal.Arx().fit(POINTS),
    "other roles": lambda: dynocal.Arx().fit([D, D.with_roles("y", "u")]),
    "other sample time": lambda: MODEL.simulate(dynocal.Dataset({"u": U}, ts_s=0.2, units={"u": "V"})),
    "other unit": lambda: MODEL.simulate(dynocal.Dataset({"u": U}, ts_s=0.1, units={"u": "A"})),
    "other channels": lambda: MODEL.simulate(dynocal.Dataset({"v": U}, ts_s=0.1)),
    "predict without outputs": lambda: MODEL.predict(dynocal.Dataset({"u": U}, ts_s=0.1, units={"u": "V"})),
    "predict without y": lambda: MODEL.predict(U, None),
    "score of nothing": lambda: FITTED.score(),
    "score of arrays": lambda: FITTED.score(U),
    "row that is not there": lambda: FITTED.score(D).of("two_step"),
    "constant input": lambda: dynocal.Arx().fit(np.ones(60), Y),
    "too short": lambda: dynocal.Arx().fit(U[:3], Y[:3]),
    "more parameters than samples": lambda: dynocal.Arx(na=40, nb=40).fit(U, Y),
    "unknown estimator": lambda: dynocal.Arx(estimator="magic").fit(U, Y),
    "estimator that is no text": lambda: dynocal.Arx(estimator=3).fit(U, Y),
    "estimator of another structure": lambda: dynocal.Arx(estimator="train").fit(POINTS),
    "key of the estimator": lambda: dynocal.Arx(estimator={"name": "ols", "rigde": 1.0}).fit(U, Y),
    "key of the structure": lambda: dynocal.Estimator("arx", keys={"nx": 1}).fit(U, Y),
    "unknown structure": lambda: dynocal.Estimator("arks").fit(U, Y),
    "structure that is no text": lambda: dynocal.Estimator(3).fit(U, Y),
    "regressor that is no text": lambda: dynocal.Polynomial([3]).fit(U, Y),
    "regressor of nothing": lambda: dynocal.Polynomial(["v(t-1)"]).fit(U, Y),
    "regressor that does not end": lambda: dynocal.Polynomial(["u(t-1"]).fit(U, Y),
    "step of the preparation": lambda: dynocal.Arx(prepare=[{"step": "polish"}]).fit(U, Y),
    "preparation that is no mapping": lambda: dynocal.Arx(prepare=["offset"]).fit(U, Y),
    "rule of a selection": lambda: dynocal.Narx(terms="best").fit(U, Y),
    "hidden layer": lambda: dynocal.Neural(hidden=-3, starts=1).fit(U, Y),
    "activation": lambda: dynocal.Neural(activation="step", starts=1).fit(U, Y),
    "progress": lambda: dynocal.Arx().fit(U, Y, progress=3),
    "parameter of an estimator": lambda: dynocal.Arx().set_params(order=2),
    "not fitted": lambda: dynocal.Arx().simulate(U),
    "not fitted, scored": lambda: dynocal.Arx().score(D),
    "model of nothing": lambda: dynocal.Model([]),
    "models of one output": lambda: dynocal.Model([*MODEL._models, *MODEL._models]),
    "no model file": lambda: dynocal.Model.load("nowhere.json"),
    "no paths": lambda: dynocal.Model.load(),
    "path that is none": lambda: dynocal.Model.load(3),
    "folder as a file": lambda: dynocal.Model.load("."),
    "saved nowhere": lambda: MODEL.save(__file__ + "/model.json"),
    "written nowhere": lambda: D.write(__file__ + "/record.csv"),
    "ending that is none": lambda: D.write("record.xyz"),
    "file that is not there": lambda: dynocal.read("nowhere.csv"),
    "path of read": lambda: dynocal.read(3),
    "format of read": lambda: dynocal.read("nowhere.csv", format="docx"),
    "keys of read": lambda: dynocal.read("nowhere.csv", keys={"cvs": {}}),
    "contents of nothing": lambda: dynocal.contents("nowhere.mf4"),
    "conversion of nothing": lambda: dynocal.convert("nowhere.csv", "somewhere.mf4"),
    "unknown job": lambda: dynocal.run("identfy", {}),
    "spec of nothing": lambda: dynocal.identify({}),
    "spec that is a number": lambda: dynocal.identify(3),
    "spec with a hole": lambda: dynocal.identify({"data": object()}),
    "spec with numbers as keys": lambda: dynocal.identify({"data": {1: 2}}),
    "spec that is not there": lambda: dynocal.identify("nowhere.toml"),
    "unknown step": lambda: dynocal.calibrate({"name": "x"}, until="lunch"),
    "unknown study": lambda: dynocal.study("alchemy"),
    "run folder": lambda: dynocal.Run("nowhere"),
    "export to nothing": lambda: dynocal.export("nowhere.json", []),
    "export of nothing": lambda: dynocal.export("nowhere.json", "c"),
    "precision": lambda: dynocal.export("nowhere.json", "c", precision="quad"),
    "unknown family": lambda: dynocal.members("animals"),
    "unknown signal": lambda: dynocal.signal("noise", 10, 0.1),
    "key of a signal": lambda: dynocal.signal("aprbs", 100, 0.1, low=0),
    "limits in the wrong order": lambda: dynocal.design(MODEL, n=50, limits={"u": (1, -1)}),
    "limits of one number": lambda: dynocal.design(MODEL, n=50, limits={"u": 1}),
    "limits of another channel": lambda: dynocal.design(MODEL, n=50, limits={"u": (-1, 1), "v": (-1, 1)}),
    "limits that are missing": lambda: dynocal.design(MODEL, n=50, limits={}),
    "criterion": lambda: dynocal.design(MODEL, n=50, limits={"u": (-1, 1)}, criterion="beauty"),
    "design without n": lambda: dynocal.design(MODEL, limits={"u": (-1, 1)}),
    "design of a spec and n": lambda: dynocal.design({"name": "x"}, n=50),
    "parameter set": lambda: dynocal.Engine("v12"),
    "plant": lambda: dynocal.Engine(name="toaster"),
    "key of a plant": lambda: dynocal.Engine(keys={"colour": "red"}),
    "input of a plant": lambda: ENGINE.step({"steam": 1.0}, 0.03),
    "inputs of a plant": lambda: ENGINE.step({}, 0.03),
    "number of inputs": lambda: ENGINE.step([1.0], 0.03),
    "input out of range": lambda: ENGINE.step({**ENGINE.start, "speed": 1e9}, 0.03),
    "state of another": lambda: ENGINE.restore([1.0, 2.0]),
    "plan without inputs": lambda: ENGINE.run(D),
    "plan of points": lambda: ENGINE.run(POINTS),
})


def test_there_are_enough() -> None:
    assert len(CALLS) >= 200, len(CALLS)


@pytest.mark.parametrize("name", CALLS)
def test_refused(name: str, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(DynocalError) as error:
        CALLS[name]()
    text = str(error.value)
    assert len(text) > 15 and text.count("\n") < 30, text
    for word in ("panicked", "unwrap", "PyErr", "Option<", "src/", "called `", "serde", "bug in dynocal"):
        assert word not in text, text
    assert list(tmp_path.iterdir()) == [], "a refused call leaves nothing behind"
