"""Where the tasks of a study run. Their contract is files: every worker writes into the folder of the study, which all must see.

``Local(workers)`` starts processes here. ``Dask(address)`` hands chunks to a Dask cluster, which brings Slurm, PBS and Kubernetes. Without
either, ``dynocal study SPEC --join DIR`` from anywhere that sees the folder, or ``--shard I/N`` from anywhere that does not.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, Protocol

from . import _arguments as arguments
from ._many import Asked, chunk
from .errors import ArgumentError, FileError, MissingPackageError, RunError

__all__ = ["Dask", "Executor", "Local"]

Tell = Callable[[str, "float | None"], object]


class Executor(Protocol):
    """Does the chunks of a study that are left."""

    def run(self, asked: Asked, progress: Tell | None) -> None:
        """Returns when no chunk is left, or raises."""


class Local:
    """Processes on this machine.

    Parameters
    ----------
    workers
        How many.
    threads
        Threads of each, for jobs that use several.
    """

    def __init__(self, workers: int = 2, *, threads: int = 1) -> None:
        self.workers = arguments.count("workers", workers, 1, 1024)
        self.threads = arguments.count("threads", threads, 1, 512)

    def __repr__(self) -> str:
        return f"Local({self.workers}, threads={self.threads})"

    def run(self, asked: Asked, progress: Tell | None) -> None:
        """Starts the processes and waits for them; they end with this call."""
        tasks = asked.tasks()
        _, total, _, left = tasks.plan(progress)
        if not left:
            return
        command = [sys.executable, "-c", "from dynocal import _many; _many.work()"]
        # Through a pipe: a command line holds no hundred thousand seeds.
        told = f"{json.dumps(asdict(asked))}\n".encode()
        environment = {**os.environ, "RAYON_NUM_THREADS": str(self.threads)}
        with tempfile.TemporaryFile("w+", encoding="utf-8") as said:
            started = [
                subprocess.Popen(command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=said)
                for _ in range(min(self.workers, len(left)))
            ]
            try:
                for p in started:
                    _tell(p, told)
                self._wait(started, tasks, total, progress)
            finally:
                _stop(started)
            if all(p.returncode for p in started):
                said.seek(0)
                lines = [line for line in said.read().splitlines() if line.strip()]
                raise RunError("no worker has come to its end: " + (lines[-1] if lines else "they were killed"))

    def _wait(self, started: list[subprocess.Popen[bytes]], tasks: Any, total: int, progress: Tell | None) -> None:
        last = -1
        while any(p.poll() is None for p in started):
            time.sleep(0.05)
            if progress is None:
                continue
            done = tasks.plan(None)[2]
            if done != last:
                last = done
                progress(f"{done} of {total} tasks", done / total)


def _tell(p: subprocess.Popen[bytes], what: bytes) -> None:
    """Writes into the pipe and leaves it open: a worker ends when it closes, with this process."""
    if p.stdin is None:
        return
    try:
        p.stdin.write(what)
        p.stdin.flush()
    except BrokenPipeError:
        # It has ended already; what it said of that is read at the end.
        pass


def _stop(started: list[subprocess.Popen[bytes]]) -> None:
    """Ends processes of ours that are still there."""
    for p in started:
        if p.poll() is None:
            p.terminate()
    for p in started:
        try:
            p.wait(5.0)
        except subprocess.TimeoutExpired:
            p.kill()
            p.wait()
    for p in started:
        if p.stdin is not None:
            with contextlib.suppress(BrokenPipeError):
                p.stdin.close()


class Dask:
    """A Dask cluster.

    Chunks are submitted, not tasks; what comes back is the name of a file, so a lost worker costs the chunk that it was at and no finished
    one. The workers need this version of dynocal and the folder of the study at the same path.

    Parameters
    ----------
    address
        Address of the scheduler, e.g. ``"tcp://host:8786"``, or a ``distributed.Client``.
    retries
        How often a chunk that raised is tried again. One that ends its worker is tried as often as the scheduler allows.
    timeout_s
        How long to wait for the scheduler.
    """

    def __init__(self, address: Any, *, retries: int = 2, timeout_s: float = 10.0) -> None:
        if not isinstance(address, str) and not hasattr(address, "submit"):
            raise ArgumentError(f"address: found {arguments.kind(address)}, expected the address of a scheduler, or a distributed.Client")
        self.address = address
        self.retries = arguments.count("retries", retries, 0, 1000)
        self.timeout_s = arguments.number("timeout_s", timeout_s, "seconds", positive=True)

    def __repr__(self) -> str:
        return f"Dask({self.address!r})"

    def run(self, asked: Asked, progress: Tell | None) -> None:
        """Submits the chunks that are left and waits for their files."""
        try:
            from distributed import Client
        except ImportError:
            raise MissingPackageError("executors.Dask needs `distributed`: pip install dynocal[dask]") from None
        _, total, done, left = asked.tasks().plan(progress)
        if not left:
            return
        if isinstance(self.address, Client):
            self._submit(self.address, asked, left, (done, total), progress)
            return
        where = arguments.text("address", self.address)
        try:
            client = Client(where, timeout=self.timeout_s, set_as_default=False)
        except (OSError, ValueError) as error:
            raise RunError(f"address: found no scheduler at {where} within {self.timeout_s:g} s ({error})") from None
        try:
            self._submit(client, asked, left, (done, total), progress)
        finally:
            client.close()

    def _submit(
        self, client: Any, asked: Asked, left: list[tuple[int, int]], far: tuple[int, int], progress: Tell | None
    ) -> None:
        from distributed import as_completed

        # Keys of this call's own: a chunk whose file has been removed since is no known result.
        call = f"{os.getpid()}-{time.monotonic_ns()}"
        futures = {
            client.submit(chunk, asked, first, last, key=f"dynocal-{call}-{first}-{last}", retries=self.retries, pure=False): (first, last)
            for first, last in left
        }
        done, total = far
        try:
            for future in as_completed(list(futures), loop=client.loop):
                first, last = futures[future]
                if future.status == "error":
                    raise RunError(f"tasks {first} to {last}: {future.exception()}")
                path = Path(future.result())
                if not path.is_file():
                    raise FileError(f"{path}: a worker has written it and it is not here: all workers must see the folder of the study")
                done += last - first + 1
                if progress is not None:
                    progress(f"{done} of {total} tasks", done / total)
                # What has been seen need not be kept by the scheduler.
                future.release()
        except BaseException:
            client.cancel(list(futures))
            raise
