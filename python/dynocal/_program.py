"""The program ``dynocal`` of the wheel: the same as the one that cargo builds."""

from __future__ import annotations

import signal
import sys

from . import _dynocal


def main() -> int:
    """Runs the program with the arguments of this process; returns its exit code."""
    # The program has its own answer to Ctrl-C: the first stops at a safe point, the second ends.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    return _dynocal.program(["dynocal", *sys.argv[1:]])


if __name__ == "__main__":
    sys.exit(main())
