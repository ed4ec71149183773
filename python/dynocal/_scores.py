"""Scores of models, and what a user should know of a result."""

from __future__ import annotations

import html
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import overload

from .errors import ArgumentError

__all__ = ["Finding", "Score", "Scores"]


@dataclass(frozen=True)
class Finding:
    """What a user should know: ``grade`` is fault, warning or note."""

    grade: str
    about: str
    text: str

    def __str__(self) -> str:
        return f"{self.grade}: {self.about}: {self.text}" if self.about else f"{self.grade}: {self.text}"


@dataclass(frozen=True)
class Score:
    """Fit numbers of one output and one kind of computation over all scored samples.

    ``r2_percent`` is 100 (1 - SSE/SST), ``nrmse_fit_percent`` 100 (1 - sqrt(SSE/SST)), SST about the mean of the scored samples;
    they and ``rmse`` are ``None`` where a free run diverges. ``data`` says whether the parameters have seen the samples.
    """

    output: str
    unit: str
    kind: str
    data: str
    samples: int
    rmse: float | None
    error_95: float | None
    r2_percent: float | None
    nrmse_fit_percent: float | None


class Scores(Sequence[Score]):
    """A table of scores with what is wrong with them."""

    def __init__(self, rows: Iterable[Score], findings: Iterable[Finding]) -> None:
        self._rows, self.findings = tuple(rows), tuple(findings)

    @overload
    def __getitem__(self, index: int) -> Score: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Score]: ...
    def __getitem__(self, index: int | slice) -> Score | Sequence[Score]:
        return self._rows[index]

    def __len__(self) -> int:
        return len(self._rows)

    def of(self, kind: str = "free_run", output: str | None = None) -> Score:
        """The row of a kind (``one_step``, ``k_step(5)``, ``free_run``) and an output."""
        found = [r for r in self._rows if r.kind == kind and output in (None, r.output)]
        if len(found) != 1:
            known = ", ".join(f"{r.kind} of {r.output}" for r in self._rows)
            raise ArgumentError(f"kind: found {kind!r} of {output!r}, which is {len(found)} rows of: {known}")
        return found[0]

    def _cells(self) -> list[list[str]]:
        def number(value: float | None) -> str:
            return "diverged" if value is None else f"{value:.5g}"

        head = ["output", "unit", "computed", "data", "samples", "RMSE", "95 % within", "R2 [%]", "NRMSE fit [%]"]
        rows = [
            [r.output, r.unit, r.kind, r.data, str(r.samples)]
            + [number(v) for v in (r.rmse, r.error_95, r.r2_percent, r.nrmse_fit_percent)]
            for r in self._rows
        ]
        return [head, *rows]

    def __repr__(self) -> str:
        cells = self._cells()
        widths = [max(len(row[k]) for row in cells) for k in range(len(cells[0]))]
        lines = ["  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() for row in cells]
        return "\n".join(lines + [str(f) for f in self.findings])

    def _repr_html_(self) -> str:
        head, *rows = self._cells()
        text = "<tr>" + "".join(f"<th>{html.escape(c)}</th>" for c in head) + "</tr>"
        for row in rows:
            text += "<tr>" + "".join(f"<td>{html.escape(c)}</td>" for c in row) + "</tr>"
        said = "".join(f"<li>{html.escape(str(f))}</li>" for f in self.findings)
        return f"<table>{text}</table><ul>{said}</ul>"


def findings_of(said: Iterable[tuple[str, str, str]]) -> list[Finding]:
    return [Finding(*one) for one in said]


def kind_of(value: object) -> str:
    """The kind of a score as one word."""
    if isinstance(value, Mapping):
        ((name, steps),) = value.items()
        return f"{name}({steps})"
    return str(value)
