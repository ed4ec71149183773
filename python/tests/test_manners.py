"""What a notebook expects: runs that stay themselves, exceptions of ours in words of Python, processes that end with it."""

from __future__ import annotations

import copy
import os
import pickle
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import pytest
from conftest import lagged, trained

import dynocal
from dynocal.errors import ArgumentError, DynocalError, FileError, PlantError, ResultWarning, RunError

needs_sigint = pytest.mark.skipif(os.name != "posix", reason="SIGINT is sent as POSIX has it")


# ---------------------------------------------------------------- runs


def signal_spec(**more: object) -> dict[str, object]:
    channel = {"name": "u", "unit": "V", "signal": {"name": "aprbs", "lo": 0.0, "hi": 1.0, "hold_s": 0.5}}
    return {"length_s": 5.0, "sample_time_s": 0.1, "channels": [channel], **more}


def test_runs_without_a_name_do_not_meet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    one, other = dynocal.signal_plan(signal_spec()), dynocal.signal_plan(signal_spec(length_s=6.0))
    seeded = dynocal.signal_plan(signal_spec(), seed=7)
    assert len({one.folder, other.folder, seeded.folder}) == 3
    assert dynocal.signal_plan(signal_spec()).folder == one.folder
    few, more = (dynocal.study({"job": "signal", "spec": signal_spec()}, seeds=range(n)) for n in (2, 3))
    assert (len(few.lines()), len(more.lines())) == (2, 3)
    # Wherever the notebook goes.
    monkeypatch.chdir("/")
    assert one.folder.is_absolute() and one.summary["verb"] == "signal"


def test_designs_of_a_model_do_not_meet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    m = dynocal.Arx(na=1, nb=1).fit(trained())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResultWarning)
        one, other = (dynocal.design(m, n=60, limits={"u": (-1, 1)}, seed=s) for s in (1, 2))
    first = dynocal.plan(one)
    assert one.folder != other.folder and dynocal.plan(one) == first != dynocal.plan(other)


def test_a_folder_that_was_written_again_is_said(tmp_path: Path) -> None:
    one = dynocal.signal_plan(signal_spec(name="same"), out=tmp_path / "run")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        dynocal.signal_plan(signal_spec(name="same"), out=tmp_path / "run")
        assert one.summary["verb"] == "signal"
    dynocal.signal_plan(signal_spec(name="same", length_s=7.0), out=tmp_path / "run")
    with pytest.warns(ResultWarning, match="a later run has written"):
        assert one.summary["verb"] == "signal"


def test_runs_of_another_job_say_so(tmp_path: Path) -> None:
    run = dynocal.signal_plan(signal_spec(), out=tmp_path / "run")
    with pytest.raises(RunError, match="found a run of signal, expected one of control"):
        _ = dynocal.Control(run.folder).loops
    with pytest.raises(RunError, match="expected one of label"):
        _ = dynocal.Labels(run.folder).labels
    with pytest.raises(RunError, match="expected a run of design"):
        dynocal.plan(run)


# ---------------------------------------------------------------- engine


def test_a_plan_is_played_as_it_is_meant() -> None:
    engine = dynocal.Engine()
    ok = dynocal.Dataset({"throttle": [10.0, 12.0]}, ts_s=0.03, units={"throttle": engine.inputs["throttle"].unit})
    assert len(engine.run(ok)) == 2 and len(engine.run(dynocal.Dataset({"throttle": [10.0, 12.0]}, ts_s=0.03))) == 2
    for unit in ("rad", "Nm"):
        with pytest.raises(ArgumentError, match=f"plan: found `throttle` in {unit}, expected deg"):
            engine.run(dynocal.Dataset({"throttle": [1.0, 1.2]}, ts_s=0.03, units={"throttle": unit}))
    with pytest.raises(ArgumentError, match="plan: found the input `sprak`"):
        engine.run(dynocal.Dataset({"throttle": [10.0, 12.0], "sprak": [20.0, 20.0]}, ts_s=0.03))
    # What the engine gave is a plan too.
    assert len(engine.run(engine.run(ok))) == 2


def test_an_engine_is_copied_in_its_state() -> None:
    engine = dynocal.Engine(keys={"torque_noise_nm": 1.0}, noise=True, seed=3)
    start = engine.start
    for _ in range(5):
        engine.step(start, 0.03)
    others = [copy.deepcopy(engine), pickle.loads(pickle.dumps(engine))]
    expected = [engine.step(start, 0.03) for _ in range(5)]
    for other in others:
        assert [other.step(start, 0.03) for _ in range(5)] == expected and other.time_s == engine.time_s


def make_env() -> object:
    from dynocal.gym import TorqueEnv

    return TorqueEnv(length=20)


def test_environments_side_by_side() -> None:
    gymnasium = pytest.importorskip("gymnasium")
    env = gymnasium.vector.AsyncVectorEnv([make_env] * 2)
    try:
        seen, _ = env.reset(seed=1)
        assert seen.shape[0] == 2
        for _ in range(5):
            seen, reward, *_ = env.step(np.zeros((2, 1)))
        assert np.isfinite(reward).all()
    finally:
        env.close()


def test_environments_refuse_in_our_words() -> None:
    pytest.importorskip("gymnasium")
    from dynocal.gym import TorqueEnv

    env = TorqueEnv(length=2)
    with pytest.raises(PlantError, match=r"expected a call of reset\(\)"):
        env.step(np.zeros(1))
    env.reset(seed=1)
    with pytest.raises(ArgumentError, match=r"action: found shape \(3,\)"):
        env.step(np.zeros(3))
    twin = copy.deepcopy(env)
    one, other = env.step(np.zeros(1)), twin.step(np.zeros(1))
    assert np.array_equal(one[0], other[0]) and one[1] == other[1]
    env.step(np.zeros(1))
    with pytest.raises(PlantError):
        env.step(np.zeros(1))
    for wrong in ({"demand_nm": 3}, {"engine": "thesis"}, {"actuators": []}, {"given": {"sprak": 1.0}}, {"reward": 3}):
        with pytest.raises(ArgumentError):
            TorqueEnv(**wrong)


# ---------------------------------------------------------------- exceptions


def test_whatever_is_raised_is_ours(tmp_path: Path) -> None:
    d = trained()
    m = dynocal.Arx(na=1, nb=1).fit(d).model_
    for call in (
        lambda: dynocal.study(signal_spec(), seeds=3),
        lambda: dynocal.study({"name": "s", "job": "signal", "spec": signal_spec()}, seeds=[1], executor=dynocal.executors.Local),
        lambda: m.score(d, k_steps=5),
        lambda: dynocal.Arx().fit(d, selecting=3),
        lambda: dynocal.Arx().fit(d, selecting=[d["u"]]),
        lambda: dynocal.identify({}, data=None),
        lambda: dynocal.design(m, n=50, limits={"u": (-1, 1)}, criterion=3),
        lambda: dynocal.plan(None),
        lambda: m.outside(d["u"]),
        lambda: m.plot(d["u"]),
        lambda: m.to_fmu(""),
        lambda: m.simulate(d, initial=3),
        lambda: d["\ud800"],
        lambda: dynocal.identify({"name": "\ud800"}),
        lambda: dynocal.read(3, outputs="y"),
        lambda: dynocal.read("d.csv", time=3),
        lambda: dynocal.convert("a.csv", "b.csv", merge="yes"),
        lambda: dynocal.executors.Dask(3),
        lambda: dynocal.Model.from_system(3),
    ):
        with pytest.raises(DynocalError):
            call()


def test_the_boundary_lets_through_what_is_not_ours() -> None:
    u, y = lagged(60)
    # A call that does not fit the signature is Python's TypeError.
    with pytest.raises(TypeError, match="unexpected keyword"):
        dynocal.read("d.csv", colour="red")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(ResultWarning):
            dynocal.Model.from_system(([0.0, 1.0], [1.0, -5.0]), ts_s=0.1).simulate(np.ones(1000))

    def reward(text: str, share: float | None) -> None:
        raise KeyError("mine")

    with pytest.raises(KeyError, match="mine"):
        dynocal.Arx(na=2, nb=2).fit(u, y, progress=reward)
    assert pickle.loads(pickle.dumps(dynocal.read)) is dynocal.read


def test_warnings_point_at_the_caller() -> None:
    with pytest.warns(ResultWarning) as found:
        dynocal.Model.from_system(([0.0, 1.0], [1.0, -5.0]), ts_s=0.1).simulate(np.ones(1000))
    assert found[0].filename == __file__


def test_files_that_are_not_there_are_file_errors(tmp_path: Path) -> None:
    for call in (
        lambda: dynocal.maps(tmp_path / "nope.dcm"),
        lambda: dynocal.export(tmp_path / "nope", "c"),
        lambda: dynocal.Engine(name="fmu", keys={"file": str(tmp_path / "nope.fmu")}),
        lambda: dynocal.Model.load(tmp_path / "nope.json"),
        lambda: dynocal.read(tmp_path / "nope.csv"),
        lambda: dynocal.Run(tmp_path / "nope"),
    ):
        with pytest.raises(FileError) as found:
            call()
        assert isinstance(found.value, OSError) and "os error" not in str(found.value)


RUST = ("expected f64", "usize", "invalid type", "unknown field", "unknown variant", "missing field", "os error", "EOF", "--out", "found found", "sequence")


def test_messages_have_no_words_of_rust(tmp_path: Path) -> None:
    u, y = lagged(60)
    text = dynocal.Arx(na=1, nb=1).fit(u, y).model_.to_json()
    (tmp_path / "torn.json").write_text(text[: len(text) // 2], encoding="utf-8")
    (tmp_path / "word.json").write_text(text.replace('"sample_time_s": 1.0', '"sample_time_s": "x"'), encoding="utf-8")
    (tmp_path / "no.fmu").write_text("no archive", encoding="utf-8")
    (tmp_path / "file").write_text("", encoding="utf-8")
    for call in (
        lambda: dynocal.signal("aprbs", 100, 0.1, lo=np.array([0.0]), hi=1.0, hold_s=0.5),
        lambda: dynocal.signal("aprbs", 100, 0.1, lo="x", hi=1.0, hold_s=0.5),
        lambda: dynocal.signal("aprbs", 100, 0.1),
        lambda: dynocal.signal("aprbs", 100, 0.1, lo=0.0, hi=1.0, hold_s=0.5, foo=1),
        lambda: dynocal.Model.load(tmp_path / "torn.json"),
        lambda: dynocal.Model.load(tmp_path / "word.json"),
        lambda: dynocal.read("d.csv", keys={"csv": {"delimiter": 3}}),
        lambda: dynocal.GaussianProcess(kernel="zz").fit(dynocal.Dataset({"a": u, "y": y}, outputs="y")),
        lambda: dynocal.Narx(terms="zz").fit(u, y),
        lambda: dynocal.Engine(name="fmu", keys={"file": str(tmp_path / "no.fmu")}),
        lambda: dynocal.Engine(keys={"torque_noise_nm": "much"}),
        lambda: dynocal.study({"name": "s", "job": "signal", "spec": signal_spec()}, seeds=[1], out=tmp_path / "file"),
        lambda: dynocal.signal_plan(signal_spec(), out=tmp_path / "file"),
    ):
        with pytest.raises(DynocalError) as found:
            call()
        assert not any(word in str(found.value) for word in RUST), str(found.value)


def test_a_mapping_is_not_cited_as_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for call in (lambda: dynocal.identify({"name": "mine"}), lambda: dynocal.study({"name": "mine", "jobb": "signal"})):
        with pytest.raises(DynocalError) as found:
            call()
        assert "the spec `mine`" in str(found.value) and "mine.toml" not in str(found.value)


# ---------------------------------------------------------------- models and estimators


def test_estimators_take_points_where_their_structure_does() -> None:
    draw = np.random.default_rng(2)
    a, b = draw.uniform(-1, 1, (2, 120))
    points = dynocal.Dataset({"a": a, "b": b, "z": 1.0 + 2.0 * a - b + 0.5 * a * b}, outputs="z")
    for estimator in (
        dynocal.Estimator("stepwise_polynomial", "learn"),
        dynocal.Estimator("stepwise_polynomial"),
        dynocal.Estimator("gaussian_process", keys={"starts": 1, "kernel": "squared_exponential"}),
        dynocal.Polynomial(["1", "a(t)", "b(t)", "a(t)*b(t)"]),
    ):
        m = estimator.fit(points)
        assert m.model_.is_steady and m.score(points).of("free_run").rmse < 0.05
    with pytest.raises(DynocalError, match="steady points"):
        dynocal.Polynomial(["a(t-1)"]).fit(points)


def test_arguments_that_would_not_count_are_refused() -> None:
    u, y = lagged(100)
    with pytest.raises(ArgumentError, match="starts: found 3 beside estimator="):
        dynocal.Neural(2, starts=3, estimator={"name": "train", "max_evaluations": 5}).fit(u, y)
    with pytest.raises(ArgumentError, match="na: found None"):
        dynocal.Arx(na=None).fit(u, y)  # type: ignore[arg-type]


def test_models_are_equal_where_their_files_are() -> None:
    u, y = lagged(100)
    one, other = (dynocal.Arx(na=n, nb=1).fit(u, y).model_ for n in (1, 2))
    assert pickle.loads(pickle.dumps(one)) == one != other and hash(pickle.loads(pickle.dumps(one))) == hash(one)


def test_limits_of_an_input_that_is_called_like_a_rate(tmp_path: Path) -> None:
    draw = np.random.default_rng(4)
    u, y = draw.standard_normal((300, 2)), np.zeros(300)
    for t in range(1, 300):
        y[t] = 0.5 * y[t - 1] + u[t - 1, 0] - u[t - 1, 1]
    m = dynocal.Arx(na=1, nb=1).fit(u, y, inputs=["u", "u_rate"], ts_s=0.1)
    limits = {"u": {"lower": -1, "upper": 1, "rate_per_s": 4.0}, "u_rate": (-1, 1)}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResultWarning)
        found = dynocal.plan(dynocal.design(m, n=50, limits=limits, out=tmp_path / "d", seed=1))
    assert np.abs(np.diff(found["u"])).max() <= 0.4 + 1e-9 and np.ptp(found["u_rate"]) > 0.0


def test_systems_of_others_with_and_without_a_sample_time() -> None:
    control = pytest.importorskip("control")
    m = dynocal.Model.from_system(control.tf([1.0], [1.0, -0.5], True), ts_s=0.1)
    assert m.ts_s == 0.1 and np.allclose(m.simulate(np.ones(4)), [0.0, 1.0, 1.5, 1.75])
    pair = ([0.0, 1.0], [1.0, -0.5])
    for wrong in ({"input": "y"}, {"input": ""}, {"output": ""}, {"units": {"z": "V"}}):
        with pytest.raises(ArgumentError):
            dynocal.Model.from_system(pair, ts_s=0.1, **wrong)
    with pytest.raises(ArgumentError, match="sample time"):
        dynocal.Model.from_system(control.tf([1.0], [1.0, 1.0]), ts_s=0.1)


def test_notes_stay_with_a_record(tmp_path: Path) -> None:
    (tmp_path / "d.csv").write_text("time [s],u [V],y [V],word\n0,1,2,a\n0.1,2,3,b\n0.2,3,4,c\n0.3,3,4,c\n", encoding="utf-8")
    d = dynocal.read(tmp_path / "d.csv", outputs="y")
    assert d.notes
    for other in (pickle.loads(pickle.dumps(d)), *d.split(sample=2), d.with_roles("u", "y")):
        assert other.notes == d.notes


def test_pictures_of_extremes_are_pictures() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        d = dynocal.Dataset({"u": [1e308, -1e308, 0.0]}, ts_s=0.1)
        assert "nan" not in d._repr_html_()
        many = dynocal.Dataset({f"c{k}": np.arange(50.0) for k in range(500)}, ts_s=0.1)
        assert len(many._repr_html_()) < 300_000 and "and 440 more channels" in many._repr_html_()
        assert "Engine" in dynocal.Engine()._repr_html_() and "not fitted" in dynocal.Arx()._repr_html_()


def test_failed_writes_leave_nothing(tmp_path: Path) -> None:
    m = dynocal.Arx(na=1, nb=1).fit(trained()).model_
    (tmp_path / "folder").mkdir()
    with pytest.raises(FileError):
        m.to_fmu(tmp_path / "folder")
    assert [p.name for p in tmp_path.iterdir()] == ["folder"]


# ---------------------------------------------------------------- processes


FIRST_ARRAY = """
import sys
import dynocal
print("ready", flush=True)
try:
    dynocal.signal("aprbs", 100_000_000, 0.1, lo=0.0, hi=1.0, hold_s=1.0)
except KeyboardInterrupt:
    sys.exit(7)
sys.exit(3)
"""


@needs_sigint
def test_ctrl_c_in_the_first_array_is_a_keyboard_interrupt() -> None:
    child = subprocess.Popen([sys.executable, "-c", FIRST_ARRAY], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert child.stdout is not None and child.stdout.readline() == "ready\n"
        time.sleep(0.3)
        sent = time.monotonic()
        child.send_signal(signal.SIGINT)
        _, said = child.communicate(timeout=30)
        print(f"signal: {1e3 * (time.monotonic() - sent):.0f} ms")
        assert child.returncode == 7, said
    finally:
        child.kill()
        child.wait()


@needs_sigint
def test_an_interrupted_write_leaves_nothing(tmp_path: Path) -> None:
    code = (
        "import sys, numpy as np, dynocal\n"
        "d = dynocal.Dataset({f'c{k}': np.random.default_rng(k).standard_normal(400_000) for k in range(8)}, ts_s=0.1)\n"
        "print('ready', flush=True)\n"
        "try:\n    d.write('big.csv')\nexcept KeyboardInterrupt:\n    sys.exit(7)\n"
    )
    child = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, cwd=tmp_path, text=True)
    try:
        assert child.stdout is not None and child.stdout.readline() == "ready\n"
        limit = time.monotonic() + 20
        while not any(tmp_path.iterdir()) and time.monotonic() < limit:
            time.sleep(0.005)
        child.send_signal(signal.SIGINT)
        assert child.wait(timeout=30) == 7
    finally:
        child.kill()
        child.wait()
    assert list(tmp_path.iterdir()) == []


KERNEL = """
import dynocal
from dynocal import executors
spec = {spec!r}
dynocal.study({{"name": "s", "job": "signal", "spec": spec}}, seeds=range(100000), executor=executors.Local(2), out="study")
"""


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="processes are looked up in /proc")
def test_workers_end_with_the_kernel(tmp_path: Path) -> None:
    child = subprocess.Popen([sys.executable, "-c", KERNEL.format(spec=signal_spec())], cwd=tmp_path)
    try:
        limit = time.monotonic() + 60
        while len(workers := children(child.pid)) < 2 and time.monotonic() < limit:
            assert child.poll() is None
            time.sleep(0.05)
        time.sleep(1.0)
        assert len(workers) == 2
    finally:
        child.kill()
        child.wait()
    limit = time.monotonic() + 10
    while any(alive(p) for p in workers) and time.monotonic() < limit:
        time.sleep(0.05)
    assert not [p for p in workers if alive(p)]


def children(pid: int) -> list[int]:
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            after = path.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(after[1]) == pid:
            found.append(int(path.parent.name))
    return found


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
