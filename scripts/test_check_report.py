#!/usr/bin/env python3
"""Show that check_report.py can fail: break a good report in each way that it must notice.

    cargo run --release -p dynocal-deliver --example demo > /tmp/demo.html
    scripts/test_check_report.py /tmp/demo.html
"""

import os
import pathlib
import subprocess
import sys
import tempfile

from check_report import browser

CHECK = pathlib.Path(__file__).with_name("check_report.py")
END = "</body>"
# name, text of the good page, its replacement, what the check must say
BREAKS = [
    ("uncaught error", END, "<script>undefinedFunction()</script>" + END, "console:"),
    ("console message", END, "<script>console.warn('x')</script>" + END, "console:"),
    ("refused load", END, "<img src='https://example.invalid/x.png'>" + END, "loads from outside"),
    ("plot data of another kind", '"kind":"time"', '"kind":"none"', "plots: found"),
    ("no script", "const Charts = ", "const Other = ", "plots: found 0 drawn"),
    ("wide element", END, "<p style='width:1000px'>x</p>" + END, "too much at 390 px"),
    ("very wide element", END, "<p style='width:3000px'>x</p>" + END, "too much at 1400 px"),
]


# A browser that breaks off as often as its file has lines, and then is $REAL.
BROKEN = """#!/bin/sh
left="$(dirname "$0")/left"
if [ -s "$left" ]; then sed -i 1d "$left"; exit 139; fi
exec "$REAL" "$@"
"""


def run(page, *options, **env):
    done = subprocess.run([sys.executable, CHECK, page, *options], capture_output=True, text=True, env={**os.environ, **env})
    return done.returncode, done.stderr


def broken_off(folder, times, real):
    """The environment of a browser that breaks off so many times."""
    fake = pathlib.Path(folder, "browser")
    fake.write_text(BROKEN, encoding="utf-8")
    fake.chmod(0o755)
    pathlib.Path(folder, "left").write_text("x\n" * times, encoding="utf-8")
    return {"CHROMIUM": str(fake), "REAL": real}


def main():
    good = pathlib.Path(sys.argv[1])
    text, wrong = good.read_text(encoding="utf-8"), []

    def expect(name, outcome, code, said=""):
        if outcome[0] != code or said not in outcome[1]:
            wrong.append(f"{name}: found exit code {outcome[0]} and {outcome[1]!r}, expected {code} and {said!r}")

    expect("good page", run(good), 0)
    expect("missing text", run(good, "--text", "no such text"), 1, "text missing: 'no such text'")
    expect("missing id", run(good, "--id", "no-such-id"), 1, "id missing: 'no-such-id'")
    expect("missing file", run(good.with_name("no-such-file.html")), 2, "no such file")
    with tempfile.TemporaryDirectory() as folder:
        for name, old, new, said in BREAKS:
            page = pathlib.Path(folder, "broken.html")
            assert old in text, f"{name}: the good page does not hold {old!r}"
            page.write_text(text.replace(old, new), encoding="utf-8")
            expect(name, run(page), 1, said)
        expect("browser breaks off twice", run(good, **broken_off(folder, 2, browser())), 0)
        expect("browser breaks off always", run(good, **broken_off(folder, 99, browser())), 2, "Chromium ended with 139")
    print("\n".join(wrong) or f"check_report.py noticed all {len(BREAKS) + 4} faults")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
