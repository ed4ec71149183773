#!/usr/bin/env python3
"""What handing tasks out costs: alone, by processes that join, and by Dask.

    python bench/peers/python_many.py [TASKS ..] [--dask] [--one]

A task is a test signal of twenty samples with its run folder, page and summary: as empty as a job can be. The workers' own logs say how long they
worked at tasks; what is left of their time is what planning, claiming, writing and handing out cost. `--one` makes every task a chunk of its own.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import dynocal
from dynocal import executors

WORKERS = 2
SPEC = {
    "name": "empty",
    "job": "signal",
    "spec": {
        "length_s": 2.0,
        "sample_time_s": 0.1,
        "channels": [{"name": "u", "unit": "V", "signal": {"name": "aprbs", "lo": 0.0, "hi": 1.0, "hold_s": 0.5}}],
    },
}


def worked_s(folder: Path) -> float:
    """Time within tasks, over all workers."""
    lines = [line for log in (folder / "workers").glob("*.jsonl") for line in log.read_text().splitlines()]
    return sum(json.loads(line).get("worked_s", 0.0) for line in lines)


def measure(tasks: int, workers: int, executor: object, chunk_tasks: int | None, place: Path) -> dict[str, float]:
    out = place / f"run-{time.monotonic_ns()}"
    start = time.perf_counter()
    dynocal.study(SPEC, seeds=range(tasks), out=out, executor=executor, chunk_tasks=chunk_tasks)
    wall_s = time.perf_counter() - start
    worked = worked_s(out)
    start = time.perf_counter()
    dynocal.study(SPEC, seeds=range(tasks), out=out)
    resume_s = time.perf_counter() - start
    chunks = len(list((out / "chunks").glob("*.jsonl")))
    size = sum(p.stat().st_size for p in out.rglob("*") if p.is_file())
    return {
        "tasks": tasks,
        "chunks": chunks,
        "wall_s": wall_s,
        "task_ms": 1e3 * worked / tasks,
        "beyond_ms": 1e3 * (workers * wall_s - worked) / tasks,
        "resume_s": resume_s,
        "megabytes": size / 1e6,
    }


def cluster(place: Path) -> tuple[str, list[subprocess.Popen[bytes]]]:
    file = place / "scheduler.json"
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": place}
    where = ["--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(file)]
    started = [subprocess.Popen([sys.executable, "-m", "distributed.cli.dask_scheduler", *where], **quiet)]
    while not file.exists():
        time.sleep(0.05)
    how = ["--scheduler-file", str(file), "--nthreads", "1", "--no-nanny", "--no-dashboard", "--death-timeout", "5"]
    started += [subprocess.Popen([sys.executable, "-m", "distributed.cli.dask_worker", *how], **quiet) for _ in range(WORKERS)]
    time.sleep(5.0)
    return json.loads(file.read_text())["address"], started


def main() -> None:
    asked = argparse.ArgumentParser()
    asked.add_argument("tasks", nargs="*", type=int, default=[100, 1000, 10000])
    asked.add_argument("--dask", action="store_true")
    asked.add_argument("--one", action="store_true")
    args = asked.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        started: list[subprocess.Popen[bytes]] = []
        ways: dict[str, tuple[int, object]] = {"alone": (1, None), "processes": (WORKERS, executors.Local(WORKERS))}
        if args.dask:
            address, started = cluster(place)
            ways["Dask"] = (WORKERS, executors.Dask(address))
        try:
            print("| who | tasks | chunks | wall, s | a task, ms | beyond it, ms | go on, s | MB |\n|---|---|---|---|---|---|---|---|")
            for tasks in args.tasks:
                for name, (workers, executor) in ways.items():
                    m = measure(tasks, workers, executor, 1 if args.one else None, place)
                    print(
                        f"| {name} | {tasks} | {m['chunks']} | {m['wall_s']:.2f} | {m['task_ms']:.2f} | {m['beyond_ms']:.2f} "
                        f"| {m['resume_s']:.2f} | {m['megabytes']:.1f} |",
                        flush=True,
                    )
        finally:
            # Workers before the scheduler: one that has lost it waits for it.
            for p in reversed(started):
                p.terminate()
                try:
                    p.wait(20)
                except subprocess.TimeoutExpired:
                    p.kill()
                    p.wait()


if __name__ == "__main__":
    main()
