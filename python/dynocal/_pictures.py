"""Small pictures in SVG for notebooks: no package needed."""

from __future__ import annotations

import numpy as np

from ._arguments import FloatArray

_WIDTH, _HEIGHT, _PIXELS = 160, 24, 80


def trace(values: FloatArray) -> str:
    """A line over the samples: least and greatest of each pixel, so that no peak is lost."""
    known = values[np.isfinite(values)]
    if known.size < 2:
        return ""
    low, high = float(known.min()), float(known.max())
    # Halves, for the difference of two numbers may be none.
    span = high / 2 - low / 2 or 1.0
    points = []
    for k, part in enumerate(np.array_split(known, min(_PIXELS, known.size))):
        x = _WIDTH * (k + 0.5) / min(_PIXELS, known.size)
        for v in (part.min(), part.max()):
            points.append(f"{x:.1f},{_HEIGHT - 2 - (_HEIGHT - 4) * ((v / 2 - low / 2) / span):.1f}")
    line = f'<polyline points="{" ".join(points)}" fill="none" stroke="currentColor" stroke-width="1"/>'
    return f'<svg width="{_WIDTH}" height="{_HEIGHT}" role="img" aria-label="{low:.5g} to {high:.5g}">{line}</svg>'


_CELL = 14


def heat(values: FloatArray, x: FloatArray, y: FloatArray) -> str:
    """A map as cells from light (least) to dark (greatest); hovering shows a cell's numbers."""
    known = values[np.isfinite(values)]
    if not known.size:
        return "no cell has a number"
    low, high = float(known.min()), float(known.max())
    span = high / 2 - low / 2 or 1.0
    cells = []
    for i, xi in enumerate(x):
        for j, yj in enumerate(y):
            v = float(values[i, j])
            place = f'x="{i * _CELL}" y="{(len(y) - 1 - j) * _CELL}" width="{_CELL}" height="{_CELL}"'
            shade = 90.0 - 60.0 * ((v / 2 - low / 2) / span) if np.isfinite(v) else 100.0
            cells.append(f'<rect {place} fill="hsl(215 60% {shade:.0f}%)"><title>{xi:.5g}, {yj:.5g}: {v:.5g}</title></rect>')
    size = f'width="{len(x) * _CELL}" height="{len(y) * _CELL}"'
    return f'<svg {size} role="img" aria-label="{low:.5g} to {high:.5g}">{"".join(cells)}</svg><br/>{low:.5g} (light) to {high:.5g} (dark)'
