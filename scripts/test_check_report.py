#!/usr/bin/env python3
"""Show that check_report.py can fail: break a good report in each way that it must notice.

    cargo run --release -p dynocal-deliver --example demo > /tmp/demo.html
    scripts/test_check_report.py /tmp/demo.html
"""

import pathlib
import subprocess
import sys
import tempfile

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


def run(page, *options):
    done = subprocess.run([sys.executable, CHECK, page, *options], capture_output=True, text=True)
    return done.returncode, done.stderr


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
    print("\n".join(wrong) or f"check_report.py noticed all {len(BREAKS) + 3} faults")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
