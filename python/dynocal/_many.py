"""Studies: one of the program, or a job over seeds and points, alone or on many workers."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import _arguments as arguments
from . import _dynocal
from ._data import Dataset, read
from ._jobs import PathLike, Progress, Run, own_folder
from .errors import ArgumentError, warn

if TYPE_CHECKING:
    from .executors import Executor

__all__ = ["Study", "study"]


@dataclass(frozen=True)
class Asked:
    """All that another process needs to do a part of a study: plain values, which any serialiser carries."""

    spec: str
    text: str | None
    seeds: list[int] | None
    out: str
    chunk_tasks: int | None
    lease_s: float
    quick: bool
    reference: str | None
    data: str | None

    def tasks(self) -> _dynocal.Tasks:
        """The tasks, in this process."""
        return _dynocal.Tasks(
            self.spec, self.text, self.seeds, self.out, self.chunk_tasks, self.lease_s, self.quick, self.reference, self.data
        )


class Study(Run):
    """A finished study: a run folder with the results of all tasks.

    ``summary`` has mean and spread of every number, :meth:`lines` the tasks one by one with all that they said, :meth:`numbers` the
    numbers as a table.
    """

    def lines(self) -> list[dict[str, Any]]:
        """What every task said, in their order; none for a study that ran without parts."""
        found: dict[int, dict[str, Any]] = {}
        for path in sorted((self.folder / "chunks").glob("*.jsonl")):
            for text in path.read_text(encoding="utf-8").splitlines():
                line = json.loads(text)
                found.setdefault(line["task"], line)
        return [found[k] for k in sorted(found)]

    def checks(self) -> list[dict[str, Any]]:
        """The checks of a study of the program: ``id``, ``asked``, ``measured``, ``unit``, ``holds``."""
        return list(self.summary.get("checks", []))

    def numbers(self) -> Dataset:
        """The numbers of all tasks, a row each: task, seed, results. A number that a task lacks is missing (NaN)."""
        return read(self.folder / "results.parquet", steady=True, missing=True)

    def to_pandas(self) -> Any:
        """``results.parquet`` as a pandas frame."""
        from ._data import _package

        self._unchanged()
        return _package("pandas", "to_pandas").read_parquet(self.folder / "results.parquet")

    def to_polars(self) -> Any:
        """``results.parquet`` as a polars frame."""
        from ._data import _package

        return _package("polars", "to_polars").read_parquet(self.folder / "results.parquet")


def _asked(
    what: PathLike | Mapping[str, Any],
    seeds: Iterable[int] | None,
    out: PathLike | None,
    chunk_tasks: int | None,
    lease_s: float,
    quick: bool,
    reference: PathLike | None,
    data: PathLike | None,
) -> Asked:
    text = None
    if isinstance(what, Mapping):
        keys = arguments.mapping("what", what)
        name = keys.get("name", "study")
        # Files in a mapping are relative to the working folder of this process, wherever the tasks run.
        spec = str(Path.cwd() / f"{arguments.text('what: name', name)}.toml")
        text = _dynocal.to_toml(keys)
    else:
        spec = arguments.path("what", what)
        name = Path(spec).stem
        if spec.endswith(".toml"):
            spec = str(Path(spec).absolute())
        else:
            known = json.loads(_dynocal.members())["studies"]["members"]
            names = [m["name"] for m in known]
            if spec not in names:
                raise ArgumentError(f"what: found `{spec}`, expected a file ending in .toml, or one of {', '.join(names)}")
            name = f"study-{spec}-quick" if quick else f"study-{spec}"
    given = None if seeds is None else arguments.listed("seeds", seeds, "a list of seeds")
    listed = None if given is None else [arguments.count(f"seeds[{k}]", s, 0, 2**63 - 1) for k, s in enumerate(given)]
    if listed is not None and (not listed or len(set(listed)) < len(listed)):
        raise ArgumentError(f"seeds: found {len(listed)} with repetitions or none, expected seeds, each once")
    if out is not None:
        place = Path(arguments.path("out", out))
    elif isinstance(what, Mapping) and not what.get("name"):
        place = own_folder("study", text or "", listed)
    else:
        place = Path("runs") / name
    return Asked(
        spec,
        text,
        listed,
        str(place.absolute()),
        None if chunk_tasks is None else arguments.count("chunk_tasks", chunk_tasks, 1),
        arguments.number("lease_s", lease_s, "seconds", positive=True),
        bool(quick),
        None if reference is None else str(Path(arguments.path("reference", reference)).absolute()),
        None if data is None else str(Path(arguments.path("data", data)).absolute()),
    )


def study(
    what: PathLike | Mapping[str, Any],
    *,
    seeds: Iterable[int] | None = None,
    seed: int | None = None,
    executor: Executor | None = None,
    out: PathLike | None = None,
    chunk_tasks: int | None = None,
    lease_s: float = 10.0,
    quick: bool = False,
    reference: PathLike | None = None,
    data: PathLike | None = None,
    progress: Progress | bool | None = None,
) -> Study:
    """Runs a study of the program, or a job over seeds and points.

    Parameters
    ----------
    what
        A name of ``dynocal.members("studies")``, or a spec with ``job``, ``spec``, and ``seeds``, ``values`` or ``points``: a file of TOML or
        a mapping with its keys, whose files are relative to the working folder.
    seeds
        Seeds of every point, instead of those of the spec.
    seed
        One seed.
    executor
        Where the tasks run: ``dynocal.executors.Local(workers)``, ``dynocal.executors.Dask(address)``. Without one they run here. Results do
        not depend on it.
    out
        Folder of the study; all workers must see it. By default ``runs/NAME``.
    chunk_tasks
        Tasks whose results are one file; by default enough for two seconds of work.
    lease_s
        Seconds after which the chunk of a worker that was not heard of is taken by another.
    quick
        Reduced length of a study of the program.
    reference, data
        Reference values and folder of measured data of a study of the program.
    progress
        Called as ``progress(text, fraction)``; ``True`` for a bar.

    Returns
    -------
    Study
        The same call goes on with what an earlier one has left: finished chunks are taken over.
    """
    if seed is not None:
        if seeds is not None:
            raise ArgumentError("seed: found seeds too, expected one of them")
        seeds = [seed]
    tell = arguments.callback(progress)
    asked = _asked(what, seeds, out, chunk_tasks, lease_s, quick, reference, data)
    named = asked.text is None and not asked.spec.endswith(".toml")
    if isinstance(executor, type):
        raise ArgumentError(f"executor: found the class {executor.__name__}, expected one with its arguments: {executor.__name__}(..)")
    if named and executor is None:
        first = asked.seeds[0] if asked.seeds else 1
        if asked.seeds and len(asked.seeds) > 1:
            raise ArgumentError("seeds: found several for a study of the program, expected one: it takes its own from there")
        done = _dynocal.study(asked.spec, first, asked.quick, asked.out, asked.reference, asked.data, tell)
        return Study(done.folder)
    tasks = asked.tasks()
    if executor is not None:
        run = getattr(executor, "run", None)
        if not callable(run):
            raise ArgumentError(f"executor: found {arguments.kind(executor)}, expected one of dynocal.executors")
        run(asked, tell)
    folder, ended = tasks.part(None, tell)
    found = Study(folder)
    if ended is not None and not ended[0]:
        warn(f"{folder}: not every result may be used as it is: {' '.join(ended[1])}")
    return found


def _with_parent() -> None:
    """Ends this process with the one that started it, however that ends: its end of the pipe closes then.

    What the worker was at is taken by others when its claim is no longer touched.
    """

    def wait() -> None:
        # Not by sys.stdin: an interpreter that ends wants its lock, which a thread that reads would hold.
        while os.read(0, 4096):
            pass
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


def work() -> None:
    """A worker of :class:`dynocal.executors.Local`: is told by a line what to join, and does so until nothing is left."""
    from .errors import DynocalError

    text = b""
    while not text.endswith(b"\n") and (more := os.read(0, 1 << 16)):
        text += more
    _with_parent()
    try:
        Asked(**json.loads(text)).tasks().part(None, None)
    except DynocalError as error:
        raise SystemExit(str(error)) from None


def chunk(asked: Asked, first: int, last: int) -> str:
    """Does one chunk, on any machine that sees the folder; returns its file."""
    return os.fspath(asked.tasks().chunk(first, last))
