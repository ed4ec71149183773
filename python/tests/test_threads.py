"""Threads, processes, Ctrl-C."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from conftest import lagged, trained

import dynocal

needs_fork = pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")
needs_sigint = pytest.mark.skipif(os.name != "posix", reason="SIGINT is sent as POSIX has it")


def test_threads_agree() -> None:
    d = trained()
    alone = dynocal.Arx(na=2, nb=2, estimator="sem").fit(d).model_.to_json()
    found: list[str | None] = [None] * 8

    def work(k: int) -> None:
        found[k] = dynocal.Arx(na=2, nb=2, estimator="sem").fit(d).model_.to_json()

    threads = [threading.Thread(target=work, args=(k,)) for k in range(8)]
    for t in threads:
        t.start()
    for t in threads:
        t.join()
    assert found == [alone] * 8


def test_the_lock_is_given_away() -> None:
    """While a fit rests, this thread goes on: counting would stand still otherwise."""
    from dynocal import _dynocal

    done = threading.Event()

    def rest() -> None:
        _dynocal.rest(0.5, True, None)
        done.set()

    threading.Thread(target=rest).start()
    counted = 0
    while not done.is_set():
        counted += 1
    assert counted > 1000


def test_progress_is_told() -> None:
    u, y = lagged(300)
    told: list[tuple[str, float | None]] = []
    dynocal.Arx(na=2, nb=2).fit(u, y, progress=lambda text, share: told.append((text, share)))
    assert any("estimating" in text for text, _ in told)

    def stop(text: str, share: float | None) -> None:
        raise ValueError("enough")

    with pytest.raises(ValueError, match="enough"):
        dynocal.Arx(na=2, nb=2).fit(u, y, progress=stop)


INTERRUPTED = """
import sys, time, numpy as np
import dynocal
from dynocal import _dynocal

def fit():
    rng = np.random.default_rng(1)
    u, y = rng.standard_normal((2, 4000))
    dynocal.Neural(hidden=30, starts=64, max_evaluations=100000).fit(u, y, ts_s=0.1)

def design():
    rng = np.random.default_rng(1)
    u, e = rng.standard_normal((2, 500))
    y = np.convolve(u, 0.8 ** np.arange(30))[:500] + 0.1 * e
    m = dynocal.Arx(na=2, nb=2, constant=False).fit(u, np.roll(y, 1), ts_s=0.1)
    dynocal.design(m, n=3000, limits={{"u": (-1, 1)}}, search={{"name": "kicks", "evaluations": 100000}}, out="design")

calls = {{
    "fit": fit,
    "design": design,
    "heeds": lambda: _dynocal.rest(60, True, None),
    "deaf": lambda: _dynocal.rest(60, False, None),
    "run": lambda: dynocal.Engine().run(np.tile(list(dynocal.Engine().start.values()), (1000000, 1)), 0.03),
    "input": lambda: input(),
    "calibrate": lambda: dynocal.calibrate({spec!r}, out="calibrate"),
}}
print("ready", flush=True)
try:
    calls[{call!r}]()
except KeyboardInterrupt:
    print("interrupted", time.monotonic(), flush=True)
    sys.exit(7)
sys.exit(3)
"""


@needs_sigint
@pytest.mark.parametrize("call", ["fit", "design", "heeds", "deaf", "run", "input", "calibrate"])
def test_ctrl_c_comes_through(tmp_path, root, call: str) -> None:
    text = INTERRUPTED.format(call=call, spec=str(root / "examples/gtdi/quick.toml"))
    child = subprocess.Popen(
        [sys.executable, "-c", text], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path
    )
    try:
        assert child.stdout is not None and child.stdout.readline() == "ready\n"
        time.sleep(2.0)
        assert child.poll() is None, "the call was over before it could be interrupted"
        sent = time.monotonic()
        child.send_signal(signal.SIGINT)
        said = child.stdout.readline().split()
        assert said and said[0] == "interrupted"
        # CLOCK_MONOTONIC is one clock for all processes of a machine.
        print(f"{call}: {1e3 * (float(said[1]) - sent):.0f} ms")
        assert float(said[1]) - sent < 0.5
        assert child.wait(timeout=20) == 7
    finally:
        child.kill()
        child.wait()


@needs_sigint
def test_finished_steps_are_kept(tmp_path, root) -> None:
    """A calibration that is stopped after its first step goes on from there."""
    call = f"import dynocal; dynocal.calibrate({str(root / 'examples/gtdi/quick.toml')!r}, out='run')"
    child = subprocess.Popen([sys.executable, "-c", call], cwd=tmp_path, stderr=subprocess.DEVNULL)
    first = tmp_path / "run" / "steps" / "01-excite" / "step.json"
    try:
        limit = time.monotonic() + 120
        while not first.is_file() and time.monotonic() < limit:
            assert child.poll() is None
            time.sleep(0.02)
        child.send_signal(signal.SIGINT)
        child.wait(timeout=30)
    finally:
        child.kill()
        child.wait()
    before = first.read_bytes(), first.stat().st_mtime_ns
    dynocal.calibrate(root / "examples/gtdi/quick.toml", out=tmp_path / "run", until="excite")
    assert (first.read_bytes(), first.stat().st_mtime_ns) == before


FORKED = """
import os, numpy as np, dynocal
rng = np.random.default_rng(1)
u, y = rng.standard_normal((2, 200))
dynocal.Arx().fit(u, y)
pid = os.fork()
if pid == 0:
    try:
        dynocal.Arx().fit(u, y)
    except dynocal.errors.ForkError as e:
        os._exit(5 if "spawn" in str(e) else 6)
    os._exit(0)
print(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]))
"""


@needs_fork
def test_a_fork_is_refused_in_a_sentence() -> None:
    done = subprocess.run([sys.executable, "-c", FORKED], capture_output=True, text=True, timeout=60)
    assert done.stdout.strip() == "5", done.stderr


def _fit(seed: int) -> list[float]:
    u, y = lagged(200, seed=seed)
    return list(dynocal.Arx(na=2, nb=2).fit(u, y).parameters_.values())


def test_spawned_processes_work() -> None:
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        assert pool.map(_fit, [1, 2, 3]) == [_fit(s) for s in (1, 2, 3)]
    assert np.isfinite(_fit(1)).all()
