#!/usr/bin/env python3
"""What handing tasks out costs in processor time, which does not depend on what else the machine does.

    python bench/peers/many_cpu.py PROGRAM [TASKS/CHUNK ..]        e.g. target/release/dynocal 10000/1 10000/1250 100000/1250

A study of empty tasks (a test signal of twenty samples with its run folder, page and summary) is run by `dynocal study SPEC --join DIR`, in memory where there
is a file system in it. `whole` is the processor time of the run, `end` that of writing the results again from the chunks, `go on` that of a run that finds
everything there. What a chunk costs is the difference between two runs of as many tasks in more and in fewer chunks.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

SPEC = """name = "empty"
job = "signal"
seeds = {{ first = 0, count = {tasks} }}
chunk_tasks = {chunk}
[spec]
length_s = 2.0
sample_time_s = 0.1
[[spec.channels]]
name = "u"
unit = "V"
signal = {{ name = "aprbs", lo = 0.0, hi = 1.0, hold_s = 0.5 }}
"""


def cpu_s(command: list[str], place: Path) -> tuple[float, float]:
    """Processor time, user and system, and wall time of a child process."""
    start = time.perf_counter()
    child = subprocess.Popen(command, cwd=place, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, used = os.wait4(child.pid, 0)
    if status != 0:
        raise SystemExit(f"{' '.join(command)}: ended with {os.waitstatus_to_exitcode(status)}")
    return used.ru_utime + used.ru_stime, time.perf_counter() - start


def measure(program: str, tasks: int, chunk: int, place: Path) -> None:
    (place / "many.toml").write_text(SPEC.format(tasks=tasks, chunk=chunk), encoding="utf-8")
    out = place / f"run-{tasks}-{chunk}"
    command = [program, "study", "many.toml", "--join", out.name, "--threads", "1"]
    whole, wall = cpu_s(command, place)
    (out / "summary.json").unlink()
    end, _ = cpu_s(command, place)
    again, _ = cpu_s(command, place)
    size = sum(p.stat().st_size for p in out.rglob("*") if p.is_file()) / 1e6
    each = 1e3 / tasks
    print(
        f"| {tasks} | {-(-tasks // chunk)} | {whole:.1f} | {whole * each:.3f} | {(end - again) * each:.3f} | {again:.2f} | {wall:.0f} | {size:.0f} |", flush=True
    )


def main() -> None:
    program = str(Path(sys.argv[1]).resolve())
    asked = sys.argv[2:] or ["10000/1", "10000/1250", "100000/1250"]
    memory = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    print("| tasks | chunks | CPU whole, s | whole, ms a task | end, ms a task | go on, CPU s | wall, s | MB |\n|---|---|---|---|---|---|---|---|", flush=True)
    with tempfile.TemporaryDirectory(dir=memory) as folder:
        for one in asked:
            tasks, _, chunk = one.partition("/")
            measure(program, int(tasks), int(chunk or 1250), Path(folder))


if __name__ == "__main__":
    main()
