#!/usr/bin/env python3
"""Checks that a source distribution holds every file of the project that the build of the module has read.

    python scripts/sdist.py dynocal-0.1.0.tar.gz target/release/lib_dynocal.d

The second file is what cargo says of the build: all its inputs, those that `include_str!` takes from other folders among them. A source distribution that
holds them all, its manifests and its lock file builds with cargo alone where this tree does.
"""

from __future__ import annotations

import posixpath
import re
import sys
import tarfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def inputs(dep_info: Path) -> set[str]:
    """Paths below the root that the build has read."""
    # `target: input input ..`; a blank in a path is escaped.
    words = re.split(r"(?<!\\)\s+", dep_info.read_text(encoding="utf-8").split(":", 1)[1])
    found = set()
    for word in words:
        path = posixpath.normpath(word.replace("\\ ", " "))
        if word and path.startswith(f"{ROOT}/") and not path.startswith(f"{ROOT}/target/"):
            found.add(path[len(f"{ROOT}/") :])
    return found


def main() -> None:
    archive, dep_info = Path(sys.argv[1]), Path(sys.argv[2])
    with tarfile.open(archive) as tar:
        held = {name.split("/", 1)[1] for name in tar.getnames() if "/" in name}
    needed = inputs(dep_info)
    if len(needed) < 100:
        raise SystemExit(f"error: {dep_info}: found {len(needed)} inputs of the build below {ROOT}, expected those of all crates")
    manifests = {f"{'/'.join(n.split('/')[:2])}/Cargo.toml" for n in needed if n.startswith("crates/")}
    missing = sorted((needed | manifests | {"Cargo.toml", "Cargo.lock", "pyproject.toml"}) - held)
    if missing:
        raise SystemExit("error: the source distribution lacks what the build reads: " + ", ".join(missing))
    print(f"{archive.name}: all {len(needed)} files that the build reads, {archive.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
