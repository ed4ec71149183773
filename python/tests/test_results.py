"""What runs found, as objects: loops, labels, maps; systems of other packages that become models; bars."""

from __future__ import annotations

import json

import numpy as np
import pytest
from conftest import lagged

import dynocal
from dynocal import errors


@pytest.fixture(scope="module")
def loops(root, tmp_path_factory):
    return dynocal.control(root / "examples" / "control" / "loops.toml", out=tmp_path_factory.mktemp("control") / "run")


def test_margins_are_those_of_an_independent_computation(loops) -> None:
    """The torque loop of the spec with the lambda loop closed, by frequency responses in NumPy."""
    ts_s = 0.03
    w = np.concatenate([np.geomspace(1e-3, 1.0, 2000), np.linspace(1.0, np.pi / ts_s - 1e-6, 200_000)])
    z = np.exp(1j * w * ts_s)
    torque, lam = loops.loops
    assert (torque.output, lam.output) == ("torque", "lambda") and loops.valid

    def pi(loop: dynocal.Loop) -> np.ndarray:
        return loop.kp + loop.ki * ts_s * z / (z - 1)

    # 2000 rpm of examples/control/loops.toml; a sample of reaction, three more to the sensor.
    g11, g12 = 0.45 / z / (1 - 0.80 / z) / z, 0.25 / z / (1 - 0.50 / z) / z
    g21, g22 = (0.0008 / z**2 / (1 - 0.80 / z)) / z**4, (-0.022 / z**2 / (1 - 0.65 / z)) / z**4
    first = pi(torque) * (g11 - g12 * pi(lam) * g21 / (1 + pi(lam) * g22))
    sensitivity = float(np.max(np.abs(1 / (1 + first))))
    found = next(m for m in torque.margins if m.point == "2000 rpm")
    assert found.sensitivity == pytest.approx(sensitivity, rel=2e-3)
    # The phase crosses -180 degrees where the gain margin is read.
    crossing = np.flatnonzero((first.imag[:-1] < 0) & (first.imag[1:] >= 0) & (first.real[:-1] < 0))
    assert found.gain_up == pytest.approx(float(np.min(1 / np.abs(first[crossing]))), rel=2e-3)


def test_control_says_what_it_is(loops) -> None:
    assert "<table>" in loops._repr_html_() and "kp" in loops._repr_html_()
    assert len(loops.loops[0].margins) == 3 and loops.loops[0].rules
    with pytest.raises(errors.SpecError, match="loops"):
        dynocal.control({"name": "x"})


def test_labels_of_a_known_function(tmp_path) -> None:
    """out = K in1 with K = 2.5, noise of a thousandth: the fit finds it, within its own interval."""
    draw = np.random.default_rng(1)
    x = draw.uniform(1.0, 3.0, 400)
    out = 2.5 * x + 1e-3 * draw.standard_normal(400)
    dynocal.Dataset({"x": x, "out": out}, ts_s=0.1).write(tmp_path / "drive.csv")
    spec = {
        "name": "gain",
        "data": [str(tmp_path / "drive.csv")],
        "target": "out",
        "labels": [{"name": "K", "unit": "-", "base": [1.0]}],
        "nodes": [
            {"name": "x", "op": "channel", "channel": "x"},
            {"name": "k", "op": "label", "label": "K"},
            {"name": "out", "op": "multiply", "in": ["k", "x"]},
        ],
    }
    found = dynocal.label(spec, out=tmp_path / "run")
    k = found.labels["K"]
    assert found.valid and float(k.before) == 1.0
    assert abs(float(k.fitted) - 2.5) < 3 * float(k.half_width) < 1e-3
    assert float(found.map("K").values) == pytest.approx(float(k.fitted), rel=1e-6)


def stored(values: np.ndarray, x: list[float], y: list[float]) -> dict[str, object]:
    axes = [
        {"name": n, "description": "", "unit": u, "input": n, "points": p, "shared": False} for n, u, p in (("speed", "rpm", x), ("load", "%", y))
    ]
    one = {"name": "SPARK", "description": "", "unit": "deg", "axes": axes, "values": list(values.T.ravel()), "limits": None}
    provenance = {k: "" for k in ("run", "spec_digest", "version", "data_digest", "file", "file_digest")} | {"validity": []}
    package = {"name": "p", "description": "", "provenance": provenance, "extrapolation": "clip", "characteristics": [one], "program": None, "left_out": []}
    return {"schema": "dynocal/export", "version": 1, "package": package}


def test_maps_keep_their_axes_through_files(tmp_path) -> None:
    values = np.arange(12.0).reshape(4, 3) ** 1.5
    (tmp_path / "m.json").write_text(json.dumps(stored(values, [1000.0, 2000.0, 3000.0, 4500.0], [10.0, 50.0, 90.0])))
    spark = dynocal.maps(tmp_path / "m.json")["SPARK"]
    assert np.array_equal(spark.values, values) and spark.values[3, 0] == values[3, 0]
    assert [(n, u) for n, u, _ in spark.axes] == [("speed", "rpm"), ("load", "%")]
    spark.to_dcm(tmp_path / "out" / "spark.dcm")
    text = (tmp_path / "out" / "spark.dcm").read_text()
    # As any reader of DCM sees it: x points of the first axis, a row for each point of the second.
    assert "KENNFELD SPARK 4 3" in " ".join(text.split())
    back = dynocal.maps(tmp_path / "out" / "spark.dcm")["SPARK"]
    assert np.allclose(back.values, values, rtol=1e-6) and "4 " in repr(back)
    assert back._repr_html_().count("<rect") == 12
    with pytest.raises(errors.ArgumentError, match="expected one of SPARK"):
        dynocal.maps(tmp_path / "m.json")["FUEL"]
    with pytest.raises(errors.ArgumentError, match="format"):
        spark.write(tmp_path / "x", "xls")
    plotted = pytest.importorskip("matplotlib.figure").Figure().add_subplot()
    assert spark.plot(plotted) is plotted


def test_systems_come_back_as_models() -> None:
    u, y = lagged(300)
    model = dynocal.Arx(na=2, nb=2, constant=False).fit(u, y, ts_s=0.1).model_
    signal = pytest.importorskip("scipy.signal")
    control = pytest.importorskip("control")
    for system in (model.to_scipy(), model.to_control(), control.tf2ss(model.to_control())):
        back = dynocal.Model.from_system(system, input="u", output="y", units={"y": "Nm"})
        assert back.ts_s == 0.1 and back.units["y"] == "Nm"
        assert np.allclose(back.simulate(u), model.simulate(u), atol=1e-6 * np.abs(y).max())
    # Against SciPy's own simulation: several inputs, a dead time, direct feedthrough.
    two = control.TransferFunction([[[0.5], [1.0, 0.2]]], [[[1.0, -0.5, 0.0, 0.0], [1.0, -0.9]]], 0.2)
    back = dynocal.Model.from_system(two)
    assert back.inputs == ["u1", "u2"]
    first = signal.lfilter([0.0, 0.0, 0.0, 0.5], [1.0, -0.5], u)
    assert np.allclose(back.simulate(np.column_stack([u, u])), first + signal.lfilter([1.0, 0.2], [1.0, -0.9], u), atol=1e-9)


def test_systems_that_are_no_models_are_refused() -> None:
    control = pytest.importorskip("control")
    cases = [
        (control.TransferFunction([1.0], [1.0, 1.0]), {}, "sampled"),
        (([1.0], [0.0, 1.0]), {"ts_s": 0.1}, "no later input"),
        (([1.0], [1.0, 0.5]), {}, "ts_s"),
        (([np.nan], [1.0, 0.5]), {"ts_s": 0.1}, "finite"),
        (([1.0], [1.0, 0.5]), {"ts_s": -0.1}, "positive"),
        (([1.0], [1.0, 0.5]), {"ts_s": 0.1, "input": ["a", "b"]}, "2 names, expected 1"),
        ("system", {"ts_s": 0.1}, "expected a system"),
        (control.TransferFunction([1.0], [1.0, 0.5], 0.1), {"ts_s": 0.2}, "one sample time"),
        (control.TransferFunction([[[1.0]], [[1.0]]], [[[1.0, 0.5]], [[1.0, 0.5]]], 0.1), {}, "one output"),
    ]
    for system, keywords, said in cases:
        with pytest.raises(errors.DynocalError, match=said):
            dynocal.Model.from_system(system, **keywords)


def test_models_leave_as_fmu_and_onnx(arx, tmp_path) -> None:
    import zipfile

    path = arx.model_.to_fmu(tmp_path / "model.fmu")
    assert "modelDescription.xml" in zipfile.ZipFile(path).namelist()
    for file in arx.model_.to_onnx(tmp_path / "onnx"):
        assert file.suffix == ".onnx" and file.stat().st_size > 100
    with pytest.raises(errors.ArgumentError, match="version"):
        arx.model_.to_fmu(tmp_path / "model.fmu", version="1.0")


def test_a_bar_is_shown_where_there_is_one(capfd) -> None:
    tqdm = pytest.importorskip("tqdm")
    assert tqdm.__version__
    u, y = lagged(3000, noise=0.1)
    dynocal.Neural(hidden=3, starts=2, max_evaluations=10).fit(u, y, ts_s=0.1, progress=True)
    assert "gone" in capfd.readouterr().err


def test_maps_are_what_was_read(tmp_path) -> None:
    file = tmp_path / "one.dcm"
    file.write_text('KONSERVIERUNG_FORMAT 2.0\n\nKENNLINIE A 2\n   EINHEIT_X "rpm"\n   EINHEIT_W "Nm"\n   ST/X 1 2\n   WERT 3 4\nEND\n')
    maps = dynocal.maps(file)
    name = next(iter(maps))
    assert name in maps and "none of them" not in maps and maps.get("none of them") is None
    with pytest.raises(ValueError, match="read-only"):
        maps[name].values[...] = 1.0
    (tmp_path / "folder").mkdir()
    with pytest.raises(errors.FileError):
        maps[name].to_dcm(tmp_path / "folder")
    assert not list(tmp_path.glob(".*.tmp"))
