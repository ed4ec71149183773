#!/usr/bin/env python3
"""Open a report.html in headless Chromium and fail when it is not whole.

    scripts/check_report.py RUN/report.html --text "Free-run R2" --id identification
    scripts/check_report.py RUN/report.html --screenshot wide.png --width 1400

Fails (exit code 1, one line per fault on standard error) when
  - the console shows anything (the page itself never writes to it), an uncaught error included,
  - fewer plots were drawn than the page holds (body: data-plots-drawn against data-plots-expected),
  - the page is wider than the window, at 1400 px or at 390 px,
  - an element loads something from outside the file,
  - a text given with --text, or an element id given with --id, is missing.
Exit code 2: the check itself could not run (no such file, no Chromium, Chromium did not end, or broke off each time).
Only the standard library is used. The browser is $CHROMIUM, or the first one found on the path.
"""

import argparse
import html
import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
from html.parser import HTMLParser

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
QUIET = (
    "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync --disable-dev-shm-usage --hide-scrollbars "
    "--enable-logging=stderr --v=0 --virtual-time-budget=20000"
).split()
WIDTHS = (1400, 390)
# A phone is narrower than a browser window may be, so the page is put into a frame of that width.
FRAME = "<!doctype html><style>body{{margin:0}}iframe{{border:0;display:block}}</style>" \
        "<iframe src=\"{url}\" width={width} height={height}></iframe>"


class CannotCheck(Exception):
    """The check itself could not run."""


class Page(HTMLParser):
    """What the drawn page holds: visible text, ids, attributes of <body>, addresses that were loaded."""

    def __init__(self, dom):
        super().__init__(convert_charrefs=True)
        self.ids, self.body, self.loads, self.words, self.hidden = set(), {}, [], [], 0
        self.feed(dom)
        self.text = re.sub(r"\s+", " ", "".join(self.words))

    def handle_starttag(self, tag, attributes):
        attributes = dict(attributes)
        if "id" in attributes:
            self.ids.add(attributes["id"])
        if tag == "body":
            self.body = attributes
        if tag in ("script", "style", "noscript"):
            self.hidden += 1
        address = attributes.get("src") or (attributes.get("href") if tag == "link" else None)
        if address and not address.startswith(("data:", "#")):
            self.loads.append(f"<{tag}> {address}")

    def handle_endtag(self, tag):
        if tag in ("script", "style", "noscript"):
            self.hidden -= 1

    def handle_data(self, data):
        if not self.hidden:
            self.words.append(data)


def browser():
    for name in filter(None, (os.environ.get("CHROMIUM"), *BROWSERS)):
        if path := shutil.which(name):
            return path
    raise CannotCheck("found no Chromium: install one or set CHROMIUM")


def run_browser(url, *options, width=1400, height=1000, tries=3):
    """Runs Chromium on `url`. It is started again when it breaks off: that says nothing about the page."""
    with tempfile.TemporaryDirectory() as profile:
        command = [browser(), *QUIET, f"--user-data-dir={profile}", f"--window-size={width},{height}", *options, url]
        try:
            return subprocess.run(command, capture_output=True, text=True, timeout=180, check=True)
        except subprocess.TimeoutExpired as error:
            raise CannotCheck("Chromium did not end within 180 s") from error
        except subprocess.CalledProcessError as error:
            if tries > 1:
                return run_browser(url, *options, width=width, height=height, tries=tries - 1)
            raise CannotCheck(f"Chromium ended with {error.returncode}: {error.stderr[-500:]}") from error


def framed(url, width, height, action):
    """Runs `action` on a page that shows `url` in a frame of the given width."""
    with tempfile.TemporaryDirectory() as folder:
        outer = pathlib.Path(folder, "frame.html")
        outer.write_text(FRAME.format(url=html.escape(url), width=width, height=height), encoding="utf-8")
        return action(outer.as_uri())


def console_lines(stderr):
    return [line for line in stderr.splitlines() if ":CONSOLE" in line]


def phone_overflow(url, width):
    """Pixels by which the page is too wide at `width`. The frame asks its page, which counts them itself."""
    script = "<script>const look=()=>{{const px=document.querySelector('iframe').contentDocument.body?.dataset.overflowPx;" \
             "if(px===undefined)setTimeout(look,100);else document.body.dataset.inner=px}};" \
             "addEventListener('load',()=>setTimeout(look,3000))</script>"
    with tempfile.TemporaryDirectory() as folder:
        outer = pathlib.Path(folder, "frame.html")
        text = (FRAME + script).format(url=html.escape(url), width=width, height=900)
        outer.write_text(text, encoding="utf-8")
        done = run_browser(outer.as_uri(), "--dump-dom", "--allow-file-access-from-files")
    return Page(done.stdout).body.get("data-inner"), console_lines(done.stderr)


def faults(url, texts, ids):
    done = run_browser(url, "--dump-dom")
    page = Page(done.stdout)
    found = [f"console: {line}" for line in console_lines(done.stderr)]
    expected, drawn = page.body.get("data-plots-expected"), page.body.get("data-plots-drawn")
    if expected is None or expected != drawn:
        found.append(f"plots: found {drawn} drawn, expected {expected}")
    found += [f"loads from outside: {what}" for what in page.loads]
    found += [f"text missing: {text!r}" for text in texts if re.sub(r"\s+", " ", text) not in page.text]
    found += [f"id missing: {name!r}" for name in ids if name not in page.ids]
    overflow = {WIDTHS[0]: page.body.get("data-overflow-px")}
    overflow[WIDTHS[1]], console = phone_overflow(url, WIDTHS[1])
    found += [f"console at {WIDTHS[1]} px: {line}" for line in console]
    found += [f"width: found {px} px too much at {w} px, expected 0" for w, px in overflow.items() if px != "0"]
    return found, drawn


def screenshot(url, target, width, height):
    option = f"--screenshot={os.path.abspath(target)}"
    framed(url, width, height, lambda outer: run_browser(outer, option, width=max(width, 500), height=height))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("report", type=pathlib.Path)
    parser.add_argument("--text", action="append", default=[], help="text that must be on the page (repeatable)")
    parser.add_argument("--id", action="append", default=[], help="element id that must be there (repeatable)")
    parser.add_argument("--screenshot", help="also write a picture of the page to this PNG file")
    parser.add_argument("--width", type=int, default=WIDTHS[0], help="width of the picture in px")
    parser.add_argument("--height", type=int, default=7000, help="height of the picture in px")
    arguments = parser.parse_args()
    try:
        if not arguments.report.is_file():
            raise CannotCheck(f"{arguments.report}: no such file")
        url = arguments.report.resolve().as_uri()
        found, drawn = faults(url, arguments.text, arguments.id)
        if arguments.screenshot:
            screenshot(url, arguments.screenshot, arguments.width, arguments.height)
    except CannotCheck as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    for fault in found:
        print(f"{arguments.report}: {fault}", file=sys.stderr)
    if not found:
        print(f"{arguments.report}: {drawn} plots drawn, nothing missing, console empty")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
