"""The jobs of the program from Python: the same spec gives the same files."""

from __future__ import annotations

import hashlib
import html
import json
import os
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from . import _arguments as arguments
from . import _dynocal
from ._data import Dataset, read
from ._model import Model
from ._results import Label, Loop, Map, Maps, labels, loops, maps, to_file
from .errors import ArgumentError, FileError, RunError, warn

__all__ = [
    "Run",
    "Control",
    "Labels",
    "calibrate",
    "check",
    "control",
    "export",
    "fuelling",
    "identify",
    "label",
    "map",
    "optimise",
    "run",
    "sequential",
    "signal_plan",
    "simulate",
]

PathLike = str | os.PathLike[str]
Spec = PathLike | Mapping[str, Any]
Progress = Callable[[str, "float | None"], object]


class Report:
    """A page of a run: one file that needs no network."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def open(self) -> bool:
        """Opens the page in a browser; returns whether there is one."""
        import webbrowser

        if not self.path.is_file():
            raise FileError(f"{self.path}: there is no such page")
        return webbrowser.open(self.path.resolve().as_uri())

    def __repr__(self) -> str:
        return f"<Report {self.path}>"

    def __fspath__(self) -> str:
        return str(self.path)


class Run:
    """A run folder with what a job has written into it.

    ``valid`` is ``False`` for a result that must not be used as it is; ``warnings`` say why. A job that waits for records of a bed
    is not valid and says in ``waiting`` what it waits for.
    """

    def __init__(
        self, folder: PathLike, *, valid: bool | None = None, warnings: Iterable[str] = (), waiting: str | None = None
    ) -> None:
        # Absolute: a notebook may change its folder.
        self.folder = Path(arguments.path("folder", folder)).absolute()
        self.waiting = waiting
        self._valid, self._warnings = valid, list(warnings)
        self._stamp = self._digest()
        if valid is None and not (self.folder / "summary.json").is_file():
            raise FileError(f"{self.folder}: found no summary.json, expected the folder of a finished run")

    def _digest(self) -> str | None:
        """What the summary was when this was made."""
        path = self.folder / "summary.json"
        return hashlib.blake2b(path.read_bytes()).hexdigest() if path.is_file() else None

    def _unchanged(self) -> None:
        """Says it where a later run has written into the folder: what is there is no longer what this run found."""
        if self._stamp is not None and self._digest() != self._stamp:
            self._stamp = self._digest()
            warn(f"{self.folder}: a later run has written into this folder: what is read from now on is that run's (give each its out=)")

    @property
    def summary(self) -> dict[str, Any]:
        """``summary.json``; its keys are in docs/summary.md."""
        self._unchanged()
        path = self.folder / "summary.json"
        if not path.is_file():
            raise FileError(f"{path}: there is none" + (f": {self.waiting}" if self.waiting else ""))
        try:
            found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        except ValueError as error:
            raise FileError(f"{path}: found no whole summary ({error}), expected that of a finished run") from None
        return found

    def _part(self, key: str, job: str) -> dict[str, Any]:
        """The summary of a run that has such a part."""
        found = self.summary
        if key not in found:
            raise RunError(f"{self.folder}: found a run of {found.get('verb', 'another job')}, expected one of {job}")
        return found

    @property
    def valid(self) -> bool:
        """Whether the result may be used as it is."""
        return bool(self.summary["valid"]) if self._valid is None else self._valid

    @property
    def warnings(self) -> list[str]:
        """What may mislead, most important first."""
        return list(self.summary.get("warnings", [])) if self._valid is None else list(self._warnings)

    @property
    def verdict(self) -> str:
        """What came out, against what, and what to do next."""
        if self.waiting:
            return self.waiting
        said = self.summary.get("verdict", "")
        return "\n".join(said) if isinstance(said, list) else str(said)

    @property
    def report(self) -> Report:
        """The page."""
        return Report(self.folder / "report.html")

    @property
    def files(self) -> list[Path]:
        """All files of the run."""
        return sorted(p for p in self.folder.rglob("*") if p.is_file())

    def _model_files(self) -> list[Path]:
        named = [m.get("file") for m in self.summary.get("models", []) if isinstance(m, dict)]
        return [self.folder / f for f in named if isinstance(f, str) and f.endswith(".json") and (self.folder / f).is_file()]

    @property
    def models(self) -> dict[str, Model]:
        """Models by output, of a run of ``identify``."""
        found = [Model.load(p) for p in self._model_files()]
        return {m.outputs[0]: m for m in found}

    def record(self, file: PathLike) -> Dataset:
        """A record of the run, by its path inside of the folder."""
        return read(self.folder / os.fspath(file))

    @property
    def maps(self) -> Maps:
        """Scalars, curves and maps by name, of a run of ``calibrate``, ``map`` or ``label``."""
        self._unchanged()
        return maps(self.folder)

    def map(self, name: str) -> Map:
        """One of :attr:`maps`."""
        return self.maps[name]

    def to_fmu(self, path: PathLike, *, version: str = "2.0") -> Path:
        """What the run found as one FMU of FMI 2.0 or 3.0, e.g. its map; returns the file."""
        self._unchanged()
        return to_file(self.folder, path, {"2.0": "fmu2", "3.0": "fmu3"}[arguments.one_of("version", version, ["2.0", "3.0"])])

    def __repr__(self) -> str:
        state = "waiting" if self.waiting else "valid" if self.valid else "NOT VALID"
        return f"<{type(self).__name__} {self.folder}: {state}, {len(self.warnings)} warnings>"

    def _repr_html_(self) -> str:
        def paragraphs(text: str) -> str:
            return "".join(f"<p>{html.escape(line)}</p>" for line in text.splitlines() if line)

        warned = "".join(f"<li>{html.escape(w)}</li>" for w in self.warnings)
        return f"<p><b>{html.escape(repr(self)[1:-1])}</b></p>{paragraphs(self.verdict)}<ul>{warned}</ul>"


class Control(Run):
    """A run of ``control``: ``loops`` have gains and margins at each set point, ``report`` the plane of gains with its regions."""

    @property
    def loops(self) -> list[Loop]:
        """Loops in the order of the spec."""
        return loops(self._part("loops", "control"))

    @classmethod
    def _of(cls, run: Run) -> Control:
        return cls(run.folder, valid=run._valid, warnings=run._warnings, waiting=run.waiting)

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><td>{html.escape(m.point)}</td><td>{html.escape(m.output)}</td>"
            + "".join(f"<td>{'-' if v is None else format(v, '.4g')}</td>" for v in (m.gain_up, m.phase_deg, m.delay_s, m.sensitivity))
            + "</tr>"
            for loop in self.loops
            for m in loop.margins
        )
        gains = "".join(f"<li>{html.escape(x.output)} by {html.escape(x.input)}: kp {x.kp:.4g}, ki {x.ki:.4g} 1/s</li>" for x in self.loops)
        head = "<tr><th>set point</th><th>loop</th><th>gain</th><th>phase [deg]</th><th>delay [s]</th><th>sensitivity</th></tr>"
        return f"{super()._repr_html_()}<ul>{gains}</ul><table>{head}{rows}</table>"


class Labels(Run):
    """A run of ``label``: ``labels`` before and after the fit, with the half width of their 95 % intervals."""

    @property
    def labels(self) -> dict[str, Label]:
        """Labels by name."""
        return labels(self._part("fit", "label"))

    @classmethod
    def _of(cls, run: Run) -> Labels:
        return cls(run.folder, valid=run._valid, warnings=run._warnings, waiting=run.waiting)


def own_folder(job: str, *parts: object) -> Path:
    """A folder for what has no name: the same call finds it again, another one gets another."""
    text = "\n".join(p if isinstance(p, str) else json.dumps(p, sort_keys=True, default=str) for p in parts)
    return Path("runs") / f"{job}-{hashlib.blake2b(text.encode(), digest_size=4).hexdigest()}"


def _name(spec: Spec, default: str) -> str:
    if isinstance(spec, Mapping):
        name = spec.get("name", default)
        return name if isinstance(name, str) and name else default
    return Path(arguments.path("spec", spec)).stem


def _spec(spec: object) -> Any:
    """A file or a mapping."""
    if isinstance(spec, Mapping):
        return arguments.mapping("spec", spec)
    if isinstance(spec, (str, os.PathLike)):
        return arguments.path("spec", spec)
    raise ArgumentError(f"spec: found {arguments.kind(spec)}, expected a file of TOML or a mapping with its keys")


def _seed(seed: object) -> int | None:
    return None if seed is None else arguments.count("seed", seed, 0, 2**63 - 1)


def run(
    job: str,
    spec: Spec,
    *,
    out: PathLike | None = None,
    seed: int | None = None,
    data: PathLike | Iterable[PathLike] = (),
    until: str | None = None,
    progress: Progress | bool | None = None,
) -> Run:
    """Runs a job of the program.

    Parameters
    ----------
    job
        ``identify``, ``simulate``, ``optimise``, ``design``, ``sequential``, ``signal``, ``map``, ``control``,
        ``fuelling``, ``label`` or ``calibrate``.
    spec
        File of TOML, or a mapping with its keys; files in a mapping are relative to the working folder.
    out
        Run folder; by default that of the spec, else ``runs/NAME``. A mapping without a name has ``runs/JOB-`` and a digest of its keys and of
        the seed: the same call goes on there, another one has another folder.
    seed
        Seed of every random choice, instead of that of the spec.
    data
        Data files of ``identify`` instead of those of the spec.
    until
        Last step of ``calibrate``.
    progress
        Called as ``progress(text, fraction)``; ``True`` for a bar (tqdm where it is installed, else lines).

    Returns
    -------
    Run
        Byte for byte the files that the program writes for this spec, but for times.
    """
    chosen = _spec(spec)
    files = [data] if isinstance(data, (str, os.PathLike)) else arguments.listed("data", data, "a path or a list of paths")
    if out is None and isinstance(chosen, dict) and not chosen.get("name") and not chosen.get("out"):
        out = own_folder(arguments.text("job", job), _dynocal.to_toml(chosen), str(seed), [str(f) for f in files])
    done = _dynocal.run(
        arguments.text("job", job),
        chosen,
        _name(spec, job),
        _seed(seed),
        None if out is None else arguments.path("out", out),
        [arguments.path(f"data[{k}]", f) for k, f in enumerate(files)],
        None if until is None else arguments.text("until", until),
        arguments.callback(progress),
    )
    found = Run(done.folder, valid=done.valid, warnings=done.warnings, waiting=done.waiting)
    if not found.valid:
        why = done.waiting or (done.warnings[0] if done.warnings else "its page says why")
        warn(f"{done.folder}: the result must not be used as it is: {why}")
    return found


def check(job: str, spec: Spec, *, out: PathLike | None = None, seed: int | None = None) -> dict[str, Any]:
    """What a job would do and take in memory and work, as ``--check`` of the program; runs nothing."""
    place = None if out is None else arguments.path("out", out)
    text = _dynocal.check(arguments.text("job", job), _spec(spec), _name(spec, job), _seed(seed), place, [])
    found: dict[str, Any] = json.loads(text)
    return found


def identify(
    spec: Spec,
    *,
    out: PathLike | None = None,
    seed: int | None = None,
    data: PathLike | Iterable[PathLike] = (),
    progress: Progress | bool | None = None,
) -> Run:
    """From measured files to validated models with their page: :func:`run` of ``identify``."""
    return run("identify", spec, out=out, seed=seed, data=data, progress=progress)


def simulate(spec: Spec, *, out: PathLike | None = None, progress: Progress | bool | None = None) -> Run:
    """Stored models on new inputs with a page: :func:`run` of ``simulate``."""
    return run("simulate", spec, out=out, progress=progress)


def optimise(spec: Spec, *, out: PathLike | None = None, seed: int | None = None, progress: Progress | bool | None = None) -> Run:
    """Optimal inputs of a whole record on stored models: :func:`run` of ``optimise``."""
    return run("optimise", spec, out=out, seed=seed, progress=progress)


def sequential(spec: Spec, *, out: PathLike | None = None, seed: int | None = None, progress: Progress | bool | None = None) -> Run:
    """Rounds of design and measurement with a stop rule: :func:`run` of ``sequential``."""
    return run("sequential", spec, out=out, seed=seed, progress=progress)


def map(spec: Spec, *, out: PathLike | None = None, seed: int | None = None, progress: Progress | bool | None = None) -> Run:
    """Steady calibration from points to maps: :func:`run` of ``map``."""
    return run("map", spec, out=out, seed=seed, progress=progress)


def signal_plan(spec: Spec, *, out: PathLike | None = None, seed: int | None = None, progress: Progress | bool | None = None) -> Run:
    """Test signals of several channels together: :func:`run` of ``signal``."""
    return run("signal", spec, out=out, seed=seed, progress=progress)


def calibrate(
    spec: Spec,
    *,
    out: PathLike | None = None,
    seed: int | None = None,
    until: str | None = None,
    progress: Progress | bool | None = None,
) -> Run:
    """A whole calibration, or up to one of its steps: :func:`run` of ``calibrate``. A second call goes on with what is left."""
    return run("calibrate", spec, out=out, seed=seed, until=until, progress=progress)


def control(spec: Spec, *, out: PathLike | None = None, seed: int | None = None, progress: Progress | bool | None = None) -> Control:
    """PI gains and proven margins of loops around stored models or transfer functions: :func:`run` of ``control``."""
    return Control._of(run("control", spec, out=out, seed=seed, progress=progress))


def fuelling(spec: Spec, *, out: PathLike | None = None, seed: int | None = None, progress: Progress | bool | None = None) -> Run:
    """Air charge, manifold, fuel film and lambda sensor from records, judged on others: :func:`run` of ``fuelling``."""
    return run("fuelling", spec, out=out, seed=seed, progress=progress)


def label(spec: Spec, *, out: PathLike | None = None, progress: Progress | bool | None = None) -> Labels:
    """Labels of an ECU function fitted to measurements: :func:`run` of ``label``."""
    return Labels._of(run("label", spec, out=out, progress=progress))


def export(
    source: PathLike | Run,
    to: str | Iterable[str],
    folder: PathLike = ".",
    *,
    precision: str = "float",
    extrapolation: str = "clip",
    ts_s: float | None = None,
) -> list[Path]:
    """Writes maps, models and controllers in formats of the neighbours (``dynocal.members("exports")``); returns the files.

    ``source`` is a run of ``calibrate``, ``map``, ``identify`` or ``control``, one of their files, or a map file.
    """
    place = source.folder if isinstance(source, Run) else Path(arguments.path("source", source))
    if not place.exists():
        raise FileError(f"{place}: found no such file or folder")
    formats = arguments.names("to", to)
    if not formats:
        raise ArgumentError("to: found nothing, expected formats, e.g. [\"c\", \"dcm\"]")
    known = [m["name"] for m in json.loads(_dynocal.members())["exports"]["members"]]
    for one in formats:
        arguments.one_of("to", one, known)
    files, _ = _dynocal.export(
        arguments.path("source", place),
        formats,
        arguments.path("folder", folder),
        arguments.one_of("precision", precision, ["float", "double"]) == "double",
        arguments.one_of("extrapolation", extrapolation, ["clip", "linear"]) == "linear",
        None if ts_s is None else arguments.number("ts_s", ts_s, "seconds", positive=True),
    )
    return list(files)
