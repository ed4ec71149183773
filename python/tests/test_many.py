"""Studies of many tasks: the same bytes alone, by processes that join, and by Dask, whoever dies on the way."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import pytest

import dynocal
from dynocal import errors, executors

TASKS = 200
# About 20 ms of work a task.
SPEC = {
    "name": "many",
    "job": "signal",
    "seeds": {"first": 1, "count": TASKS},
    "spec": {
        "length_s": 60.0,
        "sample_time_s": 0.1,
        "channels": [{"name": "u", "unit": "V", "signal": {"name": "aprbs", "lo": 0.0, "hi": 1.0, "hold_s": 0.5}}],
    },
}


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The study by one process."""
    return dynocal.study(SPEC, out=tmp_path_factory.mktemp("alone") / "run", chunk_tasks=1).folder


@pytest.fixture
def spec(tmp_path: Path) -> Path:
    path = tmp_path / "many.toml"
    path.write_text(dynocal._dynocal.to_toml(SPEC), encoding="utf-8")
    return path


def results(folder: Path) -> dict[str, bytes]:
    """What may not depend on who worked, and how it was cut."""
    chunks = b"".join(p.read_bytes() for p in sorted((folder / "chunks").glob("*.jsonl")))
    return {"chunks": chunks, **{n: (folder / n).read_bytes() for n in ("summary.json", "report.html", "results.parquet")}}


def begun(folder: Path) -> Counter[int]:
    """How often each task was begun."""
    count: Counter[int] = Counter()
    for log in (folder / "workers").glob("*.jsonl"):
        for line in log.read_text(encoding="utf-8").splitlines():
            said = json.loads(line)
            if "from_s" in said:
                count.update(range(said["first"], said["last"] + 1))
    return count


def wait_for(folder: Path, chunks: int, seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while len(list((folder / "chunks").glob("*.jsonl"))) < chunks:
        assert time.monotonic() < end, f"found fewer than {chunks} chunks after {seconds} s"
        time.sleep(0.01)


def stray(folder: Path) -> list[str]:
    left = [p for p in folder.rglob("*") if p.name.endswith(".tmp")] + list((folder / "claims").glob("*"))
    return [str(p) for p in left] + [str(p) for p in (folder / "work").rglob("*")]


def is_whole(folder: Path, alone: Path, twice: int = 2) -> None:
    assert results(folder) == results(alone)
    count = begun(folder)
    assert sorted(count) == list(range(TASKS))
    assert sum(n > 1 for n in count.values()) <= twice, count.most_common(5)
    assert stray(folder) == []


def test_here(alone: Path, tmp_path: Path) -> None:
    is_whole(alone, alone, twice=0)
    found = dynocal.study(SPEC, out=tmp_path / "run", seeds=range(5, 9))
    assert [line["seed"] for line in found.lines()] == [5, 6, 7, 8] and found.valid
    numbers = found.numbers()
    assert list(numbers["seed"]) == [5, 6, 7, 8]
    assert "4 of 4 runs of signal are valid" in found.verdict
    # Chunks that are cut otherwise give the same lines.
    again = dynocal.study(SPEC, out=tmp_path / "other", chunk_tasks=37)
    assert results(again.folder) == results(alone)


def test_processes(alone: Path, tmp_path: Path) -> None:
    heard = []
    found = dynocal.study(
        SPEC, out=tmp_path / "run", chunk_tasks=1, executor=executors.Local(2), progress=lambda text, share: heard.append(share)
    )
    is_whole(found.folder, alone)
    assert len(list((found.folder / "workers").glob("*"))) >= 2 and max(s for s in heard if s is not None) == 1.0


def joined(spec: Path, out: Path, *more: str) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "dynocal", "study", str(spec), "--join", str(out), "--threads", "1", "--quiet", *more]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)


def test_join_with_a_worker_killed(alone: Path, spec: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    workers = [joined(spec, out, "--chunk", "1", "--lease", "1") for _ in range(2)]
    wait_for(out, 60)
    workers[0].kill()
    said = [w.communicate(timeout=120)[1].decode() for w in workers]
    assert workers[0].returncode == -signal.SIGKILL and workers[1].returncode == 0, said
    is_whole(out, alone)


def test_join_interrupted_goes_on(alone: Path, spec: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    worker = joined(spec, out, "--chunk", "1")
    wait_for(out, 20)
    worker.send_signal(signal.SIGINT)
    said = worker.communicate(timeout=60)[1].decode()
    assert worker.returncode == 2 and "the same command goes on" in said
    assert stray(out) == [] and not (out / "summary.json").exists()
    worker = joined(spec, out)
    worker.communicate(timeout=120)
    assert worker.returncode == 0
    is_whole(out, alone)


def test_shards_are_the_whole(alone: Path, spec: Path, tmp_path: Path) -> None:
    meeting = tmp_path / "meeting"
    for part in ("1/2", "2/2"):
        out = tmp_path / part.replace("/", "of")
        command = [sys.executable, "-m", "dynocal", "study", str(spec), "--shard", part, "--out", str(out), "--chunk", "1"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120)
        assert done.returncode == 0, done.stderr
        assert f"100 of {TASKS} tasks are done" in done.stderr
        shutil.copytree(out, meeting, dirs_exist_ok=True)
    assert joined(spec, meeting).wait(120) == 0
    assert results(meeting) == results(alone)


# -------------------------------------------------------------------------------- Dask


class Cluster:
    """A scheduler and workers as processes of their own; each is ended by its pid."""

    def __init__(self, folder: Path, workers: int) -> None:
        pytest.importorskip("distributed")
        self.file = folder / "scheduler.json"
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": folder}
        where = ["--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(self.file)]
        self.scheduler = subprocess.Popen([sys.executable, "-m", "distributed.cli.dask_scheduler", *where], **quiet)
        end = time.monotonic() + 60
        while not self.file.exists():
            assert time.monotonic() < end and self.scheduler.poll() is None
            time.sleep(0.05)
        # Without nannies: nobody starts a worker again that was killed.
        how = ["--scheduler-file", str(self.file), "--nthreads", "1", "--no-nanny", "--no-dashboard", "--death-timeout", "5"]
        self.workers = [
            subprocess.Popen([sys.executable, "-m", "distributed.cli.dask_worker", *how, "--local-directory", str(folder)], **quiet)
            for _ in range(workers)
        ]
        self.clients: list[subprocess.Popen[bytes]] = []
        self.address = json.loads(self.file.read_text())["address"]

    def end(self) -> None:
        # Workers before the scheduler: one that has lost it waits for it.
        for p in [*self.clients, *self.workers, self.scheduler]:
            if p.poll() is None:
                p.terminate()
            try:
                p.wait(20)
            except subprocess.TimeoutExpired:
                p.kill()
                p.wait()


@pytest.fixture
def cluster(tmp_path: Path):
    made = Cluster(tmp_path, 2)
    yield made
    made.end()
    assert all(p.poll() is not None for p in [*made.clients, *made.workers, made.scheduler])


CLIENT = """
import json, sys
import dynocal
from dynocal import executors
dynocal.study(json.loads(sys.argv[1]), out=sys.argv[2], chunk_tasks=1, executor=executors.Dask(sys.argv[3]))
"""


def client(out: Path, cluster: Cluster) -> subprocess.Popen[bytes]:
    """One that asks for the study; it ends with the cluster at the latest."""
    command = [sys.executable, "-c", CLIENT, json.dumps(SPEC), str(out), cluster.address]
    cluster.clients.append(subprocess.Popen(command, stderr=subprocess.PIPE))
    return cluster.clients[-1]


def test_dask_with_a_worker_killed(alone: Path, tmp_path: Path, cluster: Cluster) -> None:
    out = tmp_path / "run"
    asked = client(out, cluster)
    wait_for(out, 60)
    cluster.workers[0].kill()
    said = asked.communicate(timeout=120)[1].decode()
    assert asked.returncode == 0, said
    is_whole(out, alone)


def test_dask_with_the_client_killed_and_started_again(alone: Path, tmp_path: Path, cluster: Cluster) -> None:
    out = tmp_path / "run"
    asked = client(out, cluster)
    wait_for(out, 60)
    asked.kill()
    asked.wait(20)
    there = len(list((out / "chunks").glob("*.jsonl")))
    assert there < TASKS
    asked = client(out, cluster)
    said = asked.communicate(timeout=120)[1].decode()
    assert asked.returncode == 0, said
    is_whole(out, alone)


def test_dask_without_a_scheduler_says_so(tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    with pytest.raises(errors.RunError, match="found no scheduler at tcp://127.0.0.1:9 within 1 s"):
        dynocal.study(SPEC, out=tmp_path / "run", executor=executors.Dask("tcp://127.0.0.1:9", timeout_s=1.0))


# ------------------------------------------------------------------------------ refusals


def test_wrong_arguments_are_refused(tmp_path: Path) -> None:
    out = tmp_path / "run"
    cases = [
        (dict(what={**SPEC, "job": "nothing"}), errors.SpecError, "expected one of|one of identify"),
        (dict(what={**SPEC, "seads": [1]}), errors.SpecError, "did you mean `seeds`"),
        (dict(what="nothing"), errors.ArgumentError, "expected a file ending in .toml"),
        (dict(what=SPEC, seeds=[1, 1]), errors.ArgumentError, "each once"),
        (dict(what=SPEC, seeds=[]), errors.ArgumentError, "each once"),
        (dict(what=SPEC, seeds=[1.5]), errors.ArgumentError, r"seeds\[0\]"),
        (dict(what=SPEC, seeds=[1], seed=2), errors.ArgumentError, "one of them"),
        (dict(what=SPEC, chunk_tasks=0), errors.ArgumentError, "chunk_tasks"),
        (dict(what=SPEC, lease_s=-1), errors.ArgumentError, "lease_s"),
        (dict(what=SPEC, executor="dask"), errors.ArgumentError, "dynocal.executors"),
        (dict(what=tmp_path / "none.toml"), errors.FileError, "none.toml"),
        (dict(what=SPEC, progress=3), errors.ArgumentError, "True for a bar"),
    ]
    for arguments, kind, said in cases:
        with pytest.raises(kind, match=said):
            dynocal.study(out=out, **arguments)
    assert not out.exists()


def test_another_study_does_not_get_the_folder(tmp_path: Path) -> None:
    out = tmp_path / "run"
    dynocal.study(SPEC, out=out, seeds=[1])
    with pytest.raises(errors.RunError, match="tasks of another spec"):
        dynocal.study(SPEC, out=out, seeds=[1, 2])


def test_a_task_that_cannot_be_done_warns(tmp_path: Path) -> None:
    points = [{"channels.0.signal.hi": 1.0}, {"channels.0.signal.hi": -1.0}]
    with pytest.warns(errors.ResultWarning, match="1 could not be done"):
        found = dynocal.study({**SPEC, "seeds": [1], "points": points}, out=tmp_path / "run")
    assert not found.valid and [line["status"] for line in found.lines()] == ["done", "failed"]


def test_no_process_is_left() -> None:
    """All children of this process have ended."""
    with pytest.raises(ChildProcessError):
        os.waitpid(-1, os.WNOHANG)
