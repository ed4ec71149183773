"""Jobs: the same files as of the program."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from conftest import trained

import dynocal
from dynocal.errors import ArgumentError, FileError, SpecError

#: Files that hold times of day or durations.
TIMES = {"timing.json", "log.txt"}

CASES = [
    ("identify", "examples/gas_furnace/identify.toml"),
    ("optimise", "examples/optimise/fuel.toml"),
    ("signal", "examples/design/signals.toml"),
    ("identify", "examples/steady/engine_points.toml"),
]


def program(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """The program: the one that cargo built where it is named, else that of the wheel."""
    own = os.environ.get("DYNOCAL_PROGRAM")
    call = [own] if own else [sys.executable, "-m", "dynocal"]
    return subprocess.run([*call, *arguments], cwd=cwd, capture_output=True, text=True)


def contents(folder: Path) -> dict[str, bytes]:
    files = [p for p in folder.rglob("*") if p.is_file() and p.name not in TIMES]
    return {str(p.relative_to(folder)): p.read_bytes() for p in files}


def test_same_bytes_of_a_calibration(tmp_path, root) -> None:
    """Two steps of the reduced calibration: plant, estimates and page."""
    spec = root / "examples/gtdi/quick.toml"
    arguments = ["calibrate", str(spec), "--until", "identify", "--out", str(tmp_path / "program"), "--quiet"]
    done = program(*arguments, cwd=tmp_path)
    assert done.returncode in (0, 1), done.stderr
    found = dynocal.calibrate(spec, out=tmp_path / "python", until="identify")
    assert found.valid == (done.returncode == 0)
    ours, theirs = contents(tmp_path / "python"), contents(tmp_path / "program")
    assert ours.keys() == theirs.keys() and [name for name in ours if ours[name] != theirs[name]] == []


def test_same_bytes_of_a_design(tmp_path, root) -> None:
    """The example with a shorter search."""
    from dynocal import _dynocal

    spec = tomllib.loads((root / "examples/design/spec.toml").read_text())
    spec.update(length_s=10.0, rivals=2, certificate=False, search={"name": "kicks", "starts": 2, "evaluations": 300})
    (tmp_path / "short.toml").write_text(_dynocal.to_toml(spec))
    done = program("design", str(tmp_path / "short.toml"), "--out", str(tmp_path / "program"), "--quiet", cwd=tmp_path)
    assert done.returncode in (0, 1), done.stderr
    found = dynocal.design(tmp_path / "short.toml", out=tmp_path / "python")
    assert found.valid == (done.returncode == 0)
    assert contents(tmp_path / "python") == contents(tmp_path / "program")


def test_same_bytes_of_a_simulation(tmp_path) -> None:
    d = trained()
    dynocal.Arx(na=2, nb=2).fit(d).model_.save(tmp_path / "model.json")
    d.write(tmp_path / "new.csv")
    (tmp_path / "again.toml").write_text('models = ["model.json"]\ndata = ["new.csv"]\n')
    done = program("simulate", "again.toml", "--out", "program", "--quiet", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    found = dynocal.simulate(tmp_path / "again.toml", out=tmp_path / "python")
    ours, theirs = contents(found.folder), contents(tmp_path / "program")
    # The spec as understood names files as seen from where it was started.
    assert {n: b for n, b in ours.items() if n.endswith(".csv")} == {n: b for n, b in theirs.items() if n.endswith(".csv")}
    assert ours.keys() == theirs.keys()


@pytest.mark.parametrize(("job", "spec"), CASES)
def test_same_bytes_as_the_program(tmp_path, root, job: str, spec: str) -> None:
    done = program(job, str(root / spec), "--out", str(tmp_path / "program"), "--quiet", cwd=tmp_path)
    assert done.returncode in (0, 1), done.stderr
    found = dynocal.run(job, root / spec, out=tmp_path / "python")
    assert found.valid == (done.returncode == 0)
    ours, theirs = contents(tmp_path / "python"), contents(tmp_path / "program")
    assert ours.keys() == theirs.keys() and len(ours) > 3
    assert [name for name in ours if ours[name] != theirs[name]] == []


def test_a_mapping_is_a_spec(tmp_path, root, monkeypatch) -> None:
    spec = root / "examples/gas_furnace/identify.toml"
    monkeypatch.chdir(spec.parent)
    by_file = dynocal.identify(spec.name, out=tmp_path / "file")
    table = tomllib.loads(spec.read_text())
    by_mapping = dynocal.identify({**table, "name": table.get("name", "identify")}, out=tmp_path / "mapping")
    ours, theirs = contents(by_mapping.folder), contents(by_file.folder)
    assert ours == theirs
    (model,) = by_mapping.models.values()
    assert model.outputs and by_mapping.verdict and by_mapping.report.path.is_file()
    assert "<p>" in by_mapping._repr_html_()


def test_a_fit_is_the_model_of_the_job(tmp_path) -> None:
    """An estimator in memory gives the parameters, to the last bit, of the job over the same samples in a file."""
    d = trained()
    d.write(tmp_path / "bench.parquet")
    spec = {
        "name": "arx",
        "data": {"file": tmp_path / "bench.parquet", "sample_time_s": 0.1},
        "channels": [{"column": "u", "unit": "V", "role": "input"}, {"column": "y", "unit": "Nm", "role": "output"}],
        "model": {"target": "y", "structure": {"name": "arx", "na": 2, "nb": 2}, "estimator": {"name": "sem"}},
    }
    by_job = dynocal.identify(spec, out=tmp_path / "run").models["y"]
    by_fit = dynocal.Arx(na=2, nb=2, estimator="sem").fit(d).model_
    assert by_fit.parameters == by_job.parameters and by_fit.std_errors == by_job.std_errors
    assert np.array_equal(by_fit.simulate(d)["y"], by_job.simulate(d)["y"])


def test_faults_name_their_keys(tmp_path) -> None:
    path = tmp_path / "spec.toml"
    path.write_text('[data]\nfile = "x.csv"\nsample_tim_s = 0.1\n')
    with pytest.raises(SpecError) as error:
        dynocal.identify(path)
    assert "spec.toml:3" in str(error.value) and "did you mean `sample_time_s`" in str(error.value)
    with pytest.raises(FileError, match="nowhere.toml"):
        dynocal.identify(tmp_path / "nowhere.toml")
    with pytest.raises(ArgumentError, match="expected one of identify"):
        dynocal.run("identfy", {})


def test_plans_are_shown(root, tmp_path) -> None:
    plan = dynocal.check("design", root / "examples/design/spec.toml", out=tmp_path / "x")
    assert plan["memory_bytes"] > 0 and not (tmp_path / "x").exists()


def test_design_for_a_model(tmp_path) -> None:
    train, _ = trained().split(fraction=0.5)
    m = dynocal.Arx(na=2, nb=2, constant=False).fit(train)
    limits = dynocal.Limits(u=(-2.0, 2.0), u_rate=30.0, y=(-40.0, 40.0))
    done = dynocal.design(m, criterion="D", n=80, limits=limits, out=tmp_path / "design", seed=3)
    plan = dynocal.plan(done)
    assert len(plan) == 80 and plan.ts_s == pytest.approx(0.1)
    u = plan["u"]
    assert u.min() >= -2.0 and u.max() <= 2.0 and np.abs(np.diff(u)).max() <= 3.0 + 1e-9
    with pytest.raises(ArgumentError, match="u_rat"):
        dynocal.design(m, n=80, limits=dynocal.Limits(u=(-2, 2), u_rat=1))
    with pytest.raises(ArgumentError, match="least below the greatest"):
        dynocal.design(m, n=80, limits=dynocal.Limits(u=(2, -2)))


def test_exports(tmp_path) -> None:
    m = dynocal.Arx(na=2, nb=2).fit(trained())
    m.model_.save(tmp_path / "model.json")
    files = dynocal.export(tmp_path / "model.json", "c", tmp_path / "c")
    assert files and all(f.is_file() for f in files) and any(f.suffix == ".c" for f in files)
    with pytest.raises(ArgumentError, match="cc"):
        dynocal.export(tmp_path / "model.json", "cc", tmp_path)


def test_the_program_of_the_wheel(tmp_path) -> None:
    script = shutil.which("dynocal", path=str(Path(sys.executable).parent))
    assert script, "the wheel brings the program"
    done = subprocess.run([script, "--version"], capture_output=True, text=True)
    assert (done.returncode, done.stdout.split()) == (0, ["dynocal", dynocal.__version__])
    wrong = subprocess.run([script, "identify", "nowhere.toml"], capture_output=True, text=True, cwd=tmp_path)
    assert wrong.returncode == 2 and "nowhere.toml" in wrong.stderr
