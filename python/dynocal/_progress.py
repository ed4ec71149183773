"""Progress as a bar: tqdm where it is installed, else lines on standard error."""

from __future__ import annotations

import sys
import time
from typing import Any

_BETWEEN_S = 2.0


class Bar:
    """Called as ``bar(text, fraction)``."""

    def __init__(self) -> None:
        try:
            from tqdm.auto import tqdm
        except ImportError:
            self._bar: Any = None
        else:
            self._bar = tqdm(total=100, bar_format="{l_bar}{bar}| {elapsed} gone, {remaining} left")
        self._said, self._at = "", -_BETWEEN_S

    def __call__(self, text: str, fraction: float | None) -> None:
        if self._bar is not None:
            if text:
                self._bar.set_description_str(text, refresh=False)
            if fraction is not None:
                # From what is known now: a job may begin a second part at zero.
                self._bar.n = round(100 * fraction)
            self._bar.refresh()
        elif text and (text != self._said and time.monotonic() - self._at >= _BETWEEN_S):
            share = "" if fraction is None else f" ({100 * fraction:.0f} %)"
            print(f"{text}{share}", file=sys.stderr)
            self._said, self._at = text, time.monotonic()

    def __del__(self) -> None:
        if getattr(self, "_bar", None) is not None:
            self._bar.close()
