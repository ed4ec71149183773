"""What tests share."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

import dynocal

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session")
def root() -> Path:
    return ROOT


@pytest.fixture
def reference() -> Path:
    """The folder of the larger reference data; a test that needs it skips where it is not given."""
    folder = os.environ.get("DYNOCAL_REFERENCE_DIR")
    if not folder:
        pytest.skip("DYNOCAL_REFERENCE_DIR is not set")
    return Path(folder)


def lagged(n: int, seed: int = 1, noise: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Record of y(t) = 1.5 y(t-1) - 0.7 y(t-2) + u(t-1) + 0.5 u(t-2), with white noise on what is measured."""
    draw = np.random.default_rng(seed)
    u = draw.standard_normal(n)
    y = np.zeros(n)
    for t in range(2, n):
        y[t] = 1.5 * y[t - 1] - 0.7 * y[t - 2] + u[t - 1] + 0.5 * u[t - 2]
    return u, y + noise * draw.standard_normal(n)


@pytest.fixture
def arx() -> dynocal.Arx:
    """A fitted model of two lags."""
    u, y = lagged(400)
    return dynocal.Arx(na=2, nb=2, constant=False).fit(u, y, ts_s=0.1)


def trained() -> dynocal.Dataset:
    u, y = lagged(400, noise=0.1)
    return dynocal.Dataset({"u": u, "y": y}, ts_s=0.1, outputs="y", units={"u": "V", "y": "Nm"}, name="bench")
