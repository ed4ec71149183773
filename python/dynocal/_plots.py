"""Plots by Matplotlib, which is only asked for here. Nothing is shown: axes are returned."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ._data import _package

if TYPE_CHECKING:
    from ._data import Dataset


def _axes(ax: Any) -> Any:
    if ax is not None:
        return ax
    _package("matplotlib", "plot")
    from matplotlib.figure import Figure

    return Figure(layout="constrained").add_subplot()


def record(data: Dataset, channels: list[str], ax: Any = None) -> Any:
    """Channels over time, or over their place for steady points."""
    ax = _axes(ax)
    x = np.arange(len(data)) if data.is_steady else data.time_s
    for name in channels:
        ax.plot(x, data[name], label=f"{name} [{data.units[name]}]", linewidth=1.0)
    ax.set_xlabel("point" if data.is_steady else "time [s]")
    ax.legend()
    return ax


def agreement(measured: Dataset, computed: Dataset, name: str, ax: Any = None) -> Any:
    """A measured output and the same as a model computes it."""
    ax = _axes(ax)
    x = np.arange(len(measured)) if measured.is_steady else measured.time_s
    ax.plot(x, measured[name], label="measured", linewidth=1.0)
    ax.plot(x, computed[name], label="free run", linewidth=1.0)
    ax.set_xlabel("point" if measured.is_steady else "time [s]")
    ax.set_ylabel(f"{name} [{measured.units[name]}]")
    ax.legend()
    return ax
