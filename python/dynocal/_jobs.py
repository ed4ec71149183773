"""The jobs of the program from Python: the same spec gives the same files."""

from __future__ import annotations

import html
import json
import os
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from . import _arguments as arguments
from . import _dynocal
from ._data import Dataset, read
from ._estimators import Estimator
from ._model import Model
from ._results import Label, Loop, Map, Maps, labels, loops, maps, to_file
from .errors import ArgumentError, FileError, ResultWarning, RunError

__all__ = [
    "Limits",
    "Run",
    "Control",
    "Labels",
    "calibrate",
    "check",
    "control",
    "design",
    "export",
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
        self.folder = Path(folder)
        self.waiting = waiting
        self._valid, self._warnings = valid, list(warnings)
        if valid is None and not (self.folder / "summary.json").is_file():
            raise FileError(f"{self.folder}: found no summary.json, expected the folder of a finished run")

    @property
    def summary(self) -> dict[str, Any]:
        """``summary.json``; its keys are in docs/summary.md."""
        path = self.folder / "summary.json"
        if not path.is_file():
            raise FileError(f"{path}: there is none" + (f": {self.waiting}" if self.waiting else ""))
        found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
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
        return maps(self.folder)

    def map(self, name: str) -> Map:
        """One of :attr:`maps`."""
        return self.maps[name]

    def to_fmu(self, path: PathLike, *, version: str = "2.0") -> Path:
        """What the run found as one FMU of FMI 2.0 or 3.0, e.g. its map; returns the file."""
        return to_file(self.folder, path, {"2.0": "fmu2", "3.0": "fmu3"}[arguments.one_of("version", version, ["2.0", "3.0"])])

    def __repr__(self) -> str:
        state = "waiting" if self.waiting else "valid" if self.valid else "NOT VALID"
        return f"<Run {self.folder}: {state}, {len(self.warnings)} warnings>"

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
        return loops(self.summary)

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
        return labels(self.summary)

    @classmethod
    def _of(cls, run: Run) -> Labels:
        return cls(run.folder, valid=run._valid, warnings=run._warnings, waiting=run.waiting)


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
        ``identify``, ``simulate``, ``optimise``, ``design``, ``sequential``, ``signal``, ``map``, ``control``, ``label`` or ``calibrate``.
    spec
        File of TOML, or a mapping with its keys; files in a mapping are relative to the working folder.
    out
        Run folder; by default that of the spec, else ``runs/NAME``.
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
    files = [data] if isinstance(data, (str, os.PathLike)) else list(data)
    done = _dynocal.run(
        arguments.text("job", job),
        chosen,
        _name(spec, job),
        _seed(seed),
        None if out is None else arguments.path("out", out),
        [arguments.path(f"data[{k}]", f) for k, f in enumerate(files)],
        until,
        arguments.callback(progress),
    )
    found = Run(done.folder, valid=done.valid, warnings=done.warnings, waiting=done.waiting)
    if not found.valid:
        why = done.waiting or (done.warnings[0] if done.warnings else "its page says why")
        warnings.warn(f"{done.folder}: the result must not be used as it is: {why}", ResultWarning, stacklevel=3)
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


def label(spec: Spec, *, out: PathLike | None = None, progress: Progress | bool | None = None) -> Labels:
    """Labels of an ECU function fitted to measurements: :func:`run` of ``label``."""
    return Labels._of(run("label", spec, out=out, progress=progress))


# ---------------------------------------------------------------------- design


@dataclass(frozen=True)
class Limits:
    """Limits of the channels of a test, each in the unit of its channel.

    ``Limits(spark=(0, 40), spark_rate=15, torque=(0, 250))``: a pair of a channel bounds it, ``NAME_rate`` is its greatest change per
    second, ``NAME_hold`` its least time at a value in s. Pairs of outputs bound what the model predicts.
    """

    given: Mapping[str, Any] = field(default_factory=dict)

    def __init__(self, given: Mapping[str, Any] | None = None, /, **more: Any) -> None:
        object.__setattr__(self, "given", {**arguments.mapping("limits", given), **more})

    def _pair(self, name: str) -> tuple[float, float] | None:
        if name not in self.given:
            return None
        value = self.given[name]
        if not isinstance(value, (tuple, list)) or len(value) != 2:
            raise ArgumentError(f"limits: {name}: found {arguments.kind(value)}, expected (least, greatest)")
        low, high = (arguments.number(f"limits: {name}[{k}]", v) for k, v in enumerate(value))
        if not low < high:
            raise ArgumentError(f"limits: {name}: found {low:g} to {high:g}, expected the least below the greatest")
        return low, high

    def _channels(self, model: Model) -> tuple[list[dict[str, Any]], dict[str, Any]]:
        """Tables of the channels, and limits by output."""
        known = [f"{n}{end}" for n in model.inputs for end in ("", "_rate", "_hold")] + model.outputs
        for key in self.given:
            arguments.one_of("limits", key, known)
        channels = []
        for name in model.inputs:
            pair = self._pair(name)
            if pair is None:
                raise ArgumentError(f"limits: found none of the input `{name}`, expected {name}=(least, greatest)")
            table: dict[str, Any] = {"name": name, "unit": model.units[name], "lower": pair[0], "upper": pair[1]}
            for end, key in (("_rate", "rate_per_s"), ("_hold", "hold_s")):
                if f"{name}{end}" in self.given:
                    table[key] = arguments.number(f"limits: {name}{end}", self.given[f"{name}{end}"], positive=True)
            channels.append(table)
        outputs = {}
        for name in model.outputs:
            pair = self._pair(name)
            if pair is not None:
                outputs[name] = {"lower": pair[0], "upper": pair[1]}
        return channels, outputs


def design(
    what: Spec | Model | Estimator,
    *,
    criterion: str = "d",
    n: int | None = None,
    limits: Limits | Mapping[str, Any] | None = None,
    margin: float | None = None,
    search: Mapping[str, Any] | None = None,
    out: PathLike | None = None,
    seed: int | None = None,
    progress: Progress | bool | None = None,
) -> Run:
    """The most informative test signal within limits.

    Parameters
    ----------
    what
        A spec (file or mapping), or a model whose parameters the test is to sharpen.
    criterion
        One of ``dynocal.members("criteria")``, for a model.
    n
        Samples of the test, for a model.
    limits
        Limits of inputs and predicted outputs, for a model.
    margin
        Distance that predicted outputs keep from their limits, in their unit.
    search
        Table ``[search]`` of a spec.

    Returns
    -------
    Run
        ``plan(run)`` is the record of the test.
    """
    if isinstance(what, Estimator):
        what = what._fitted()
    if not isinstance(what, Model):
        if n is not None or limits is not None or margin is not None or search is not None:
            raise ArgumentError("design: found n, limits, margin or search beside a spec, which says them itself")
        return run("design", what, out=out, seed=seed, progress=progress)
    if n is None or limits is None:
        raise ArgumentError("design: found a model without n and limits, expected both")
    import tempfile

    step = what.ts_s
    if step is None:
        raise ArgumentError("what: found a model of present values, expected a dynamic one")
    bounds = limits if isinstance(limits, Limits) else Limits(limits)
    channels, outputs = bounds._channels(what)
    with tempfile.TemporaryDirectory() as folder:
        models = []
        for name in what.outputs:
            path = Path(folder) / f"{name}.json"
            what.single(name).save(path)
            table: dict[str, Any] = {"file": path, "criterion": criterion.lower()}
            if name in outputs:
                table["limits"] = {**outputs[name], "margin": 0.0 if margin is None else arguments.number("margin", margin)}
            models.append(table)
        spec: dict[str, Any] = {
            "name": "design",
            "length_s": arguments.count("n", n, 2) * step,
            "sample_time_s": step,
            "channels": channels,
            "models": models,
        }
        if search is not None:
            spec["search"] = arguments.mapping("search", search)
        return run("design", spec, out=out, seed=seed, progress=progress)


def plan(done: Run) -> Dataset:
    """The record of the test that a run of ``design`` found."""
    path = done.folder / "design.csv"
    if not path.is_file():
        raise RunError(f"{done.folder}: found no design.csv, expected a run of design")
    return read(path)


def export(
    source: PathLike | Run,
    to: str | Iterable[str],
    folder: PathLike = ".",
    *,
    precision: str = "float",
    extrapolation: str = "clip",
    ts_s: float | None = None,
) -> list[Path]:
    """Writes maps and models in formats of the neighbours (``dynocal.members("exports")``); returns the files.

    ``source`` is a run of ``calibrate``, ``map`` or ``identify``, one of their files, or a map file.
    """
    place = source.folder if isinstance(source, Run) else source
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
