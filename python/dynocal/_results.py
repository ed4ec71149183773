"""What runs found, as objects: tuned loops, fitted labels, maps."""

from __future__ import annotations

import html
import json
import os
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from . import _arguments as arguments
from . import _dynocal
from ._arguments import FloatArray
from ._pictures import heat
from .errors import ArgumentError, FileError

__all__ = ["Label", "Loop", "Map", "Maps", "Margins", "maps"]


@dataclass(frozen=True)
class Margins:
    """Margins of one loop at one set point, the other loops closed.

    ``gain_up`` is a factor, ``delay_s`` the dead time that may come on top; ``None`` where the loop has no such bound. ``sensitivity`` is
    the largest magnitude of 1/(1 + L).
    """

    point: str
    output: str
    gain_up: float | None
    phase_deg: float | None
    delay_s: float | None
    sensitivity: float


@dataclass(frozen=True)
class Loop:
    """A PI loop that was tuned: ``u = kp e + ki integral(e)``, ``ki`` in 1/s, both with the sign of the channel.

    ``lags`` has, for each set point, the lag with dead time of the channel; ``rules`` compares the search with published rules.
    """

    output: str
    input: str
    kp: float
    ki: float
    rule: str
    margins: list[Margins]
    lags: list[Mapping[str, float] | None] = field(repr=False, default_factory=list)
    rules: list[Mapping[str, Any]] = field(repr=False, default_factory=list)


def loops(summary: Mapping[str, Any]) -> list[Loop]:
    """The loops in the summary of ``control``."""
    found = []
    for k, one in enumerate(summary["loops"]):
        margins = []
        for at in summary["together"]:
            # A loop that is not stable has no margins.
            if k < len(at["loops"]):
                m = at["loops"][k]
                values = (m["gain_up"], m["phase_deg"], m["delay_s"], m["sensitivity"])
                margins.append(Margins(at["point"], one["output"], *values))
        known = (one["output"], one["input"], one["kp"], one["ki"], one["rule"])
        found.append(Loop(*known, margins, one["lags"], one["rules"]))
    return found


@dataclass(frozen=True)
class Label:
    """A label of an ECU function, before and after the fit.

    ``half_width`` is that of the 95 % interval, NaN where no data tell of a cell. Arrays have the shape of the table, one axis a
    dimension; a scalar has none.
    """

    name: str
    unit: str
    axes: list[tuple[str, str, FloatArray]]
    before: FloatArray
    fitted: FloatArray
    half_width: FloatArray


def labels(summary: Mapping[str, Any]) -> dict[str, Label]:
    """The labels in the summary of ``label``."""
    values, widths = summary["fit"]["values"], summary["half_width"]
    found, at = {}, 0
    for one in summary["labels"]:
        axes = [(a["name"], a["unit"], np.array(a["points"], dtype=float)) for a in one["axes"]]
        n = len(one["base"])
        parts = (one["base"], values[at : at + n], [np.nan if w is None else w for w in widths[at : at + n]])
        before, fitted, half_width = (_shaped(np.array(p, dtype=float), axes) for p in parts)
        found[one["name"]] = Label(one["name"], one["unit"], axes, before, fitted, half_width)
        at += n
    return found


def _shaped(values: FloatArray, axes: list[tuple[str, str, FloatArray]]) -> FloatArray:
    """The first axis is fastest in files and the first dimension here."""
    shape = tuple(len(points) for _, _, points in axes)
    if int(np.prod(shape)) != values.size or not axes:
        return values[0] if values.size == 1 and not axes else values
    return values.reshape(shape[::-1]).T


class Map:
    """A scalar, curve or map with axes and units.

    ``values[i, j]`` belongs to ``axes[0].points[i]`` and ``axes[1].points[j]``: the first axis is the first dimension. What is written
    is what was read: values and breakpoints cannot be changed.
    """

    def __init__(self, stored: Mapping[str, Any], document: Mapping[str, Any]) -> None:
        self._stored, self._document = stored, document
        self.name: str = stored["name"]
        self.unit: str = stored["unit"]
        self.description: str = stored["description"]
        self.axes: list[tuple[str, str, FloatArray]] = [
            (a["input"] or a["name"], a["unit"], np.array(a["points"], dtype=float)) for a in stored["axes"]
        ]
        self.values: FloatArray = np.asarray(_shaped(np.array(stored["values"], dtype=float), self.axes))
        for array in (self.values, *(points for _, _, points in self.axes)):
            array.setflags(write=False)

    def __repr__(self) -> str:
        over = " x ".join(f"{len(points)} {name} [{unit}]" for name, unit, points in self.axes)
        return f"<Map {self.name} [{self.unit}]" + (f" over {over}>" if over else f" = {float(self.values):.6g}>")

    def _repr_html_(self) -> str:
        head = f"<b>{html.escape(self.name)}</b> [{html.escape(self.unit)}]"
        if not self.axes:
            return f"<p>{head} = {float(self.values):.6g}</p>"
        over = " and ".join(f"{html.escape(n)} [{html.escape(u)}]" for n, u, _ in self.axes)
        picture = heat(self.values, *(p for _, _, p in self.axes)) if len(self.axes) == 2 else ""
        return f"<p>{head} over {over}</p>{picture}"

    def write(self, path: str | os.PathLike[str], format: str) -> Path:
        """Writes this characteristic alone in a format of ``dynocal.members("exports")`` that makes one file; returns the file."""
        package = {**self._document["package"], "name": "map", "characteristics": [self._stored], "program": None}
        with tempfile.TemporaryDirectory() as folder:
            source = Path(folder) / "map.json"
            source.write_text(json.dumps({**self._document, "package": package}), encoding="utf-8")
            return to_file(source, path, format)

    def to_dcm(self, path: str | os.PathLike[str]) -> Path:
        """Writes this characteristic as DCM."""
        return self.write(path, "dcm")

    def plot(self, ax: Any = None) -> Any:
        """A curve, or a map as colours, on axes of Matplotlib, which are returned."""
        from ._plots import _axes

        ax = _axes(ax)
        label = f"{self.name} [{self.unit}]"
        if len(self.axes) == 1:
            ax.plot(self.axes[0][2], self.values, marker=".")
            ax.set_ylabel(label)
        elif len(self.axes) == 2:
            x, y = self.axes[0][2], self.axes[1][2]
            mesh = ax.pcolormesh(x, y, self.values.T, shading="nearest")
            ax.figure.colorbar(mesh, ax=ax, label=label)
            ax.set_ylabel(f"{self.axes[1][0]} [{self.axes[1][1]}]")
        else:
            raise ArgumentError(f"plot: found {self!r}, expected a curve or a map")
        ax.set_xlabel(f"{self.axes[0][0]} [{self.axes[0][1]}]")
        return ax


def to_file(source: str | os.PathLike[str], path: str | os.PathLike[str], format: str) -> Path:
    """Exports a source that makes one file in this format, under the name that is asked for."""
    target = Path(arguments.path("path", path))
    known = json.loads(_dynocal.members())["exports"]["members"]
    arguments.one_of("format", format, [m["name"] for m in known])
    with tempfile.TemporaryDirectory() as folder:
        files, _ = _dynocal.export(os.fspath(source), [format], folder, True, False, None)
        if len(files) != 1:
            names = ", ".join(Path(f).name for f in files)
            raise ArgumentError(f"format: `{format}` makes {len(files)} files here ({names}), expected one: use dynocal.export")
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            # Beside its place first, so that nobody sees half of it.
            beside = target.with_name(f".{target.name}.{os.getpid()}.tmp")
            try:
                beside.write_bytes(Path(files[0]).read_bytes())
                beside.replace(target)
            finally:
                beside.unlink(missing_ok=True)
        except OSError as error:
            raise FileError(f"{target}: cannot be written: {error.strerror}") from None
    return target


class Maps(Mapping[str, Map]):
    """The characteristics of a source by name."""

    def __init__(self, found: Mapping[str, Map]) -> None:
        self._found = dict(found)

    def __getitem__(self, name: str) -> Map:
        if name not in self._found:
            none = "none here (a dynamic map is a program: to_fmu, or dynocal.export)"
            raise ArgumentError(f"map: found `{name}`, expected one of {', '.join(self._found) or none}")
        return self._found[name]

    def __contains__(self, name: object) -> bool:
        return name in self._found

    def get(self, name: str, default: Any = None) -> Any:
        """The characteristic of that name, or ``default``."""
        return self._found.get(name, default)

    def __iter__(self) -> Iterator[str]:
        return iter(self._found)

    def __len__(self) -> int:
        return len(self._found)

    def __repr__(self) -> str:
        return "\n".join(repr(m) for m in self._found.values())

    def _repr_html_(self) -> str:
        return "".join(m._repr_html_() for m in self._found.values())


def maps(source: str | os.PathLike[str]) -> Maps:
    """Scalars, curves and maps of a run of ``calibrate``, ``map`` or ``label``, or of a file (``.dcm``, ``.cdfx``, ``.json``, ``.csv``)."""
    where = Path(arguments.path("source", source))
    if not where.exists():
        raise FileError(f"{where}: found no such file or folder")
    if where.is_dir() and (written := sorted(where.glob("*.dcm"))):
        # A run of `label` has written its own.
        where = written[0]
    found: dict[str, Map] = {}
    with tempfile.TemporaryDirectory() as folder:
        files, _ = _dynocal.export(str(where), ["json"], folder, True, False, None)
        for file in files:
            document = json.loads(Path(file).read_text(encoding="utf-8"))
            for one in document["package"]["characteristics"]:
                found.setdefault(one["name"], Map(one, document))
    return Maps(found)
