#!/usr/bin/env python3
"""Whether the wheel is built from the crates that the workspace's tests have compiled already.

    python3 scripts/one_build.py

Cargo compiles a crate again when its features, or those of anything below it, differ: one feature that only a bench asks for is
enough to build the whole tree twice. Cargo's plan of both builds is compared (`--unit-graph`), nothing is compiled.
"""

import json
import os
import subprocess
import sys

PLAN = ["--release", "--locked", "--unit-graph", "-Z", "unstable-options"]
TESTS = ["test", "--workspace", "--no-run"]
WHEEL = ["build", "--lib", "-p", "dynocal-python"]
# The profile of a unit says nothing of a build that the other could not share.
IGNORED = ("name",)


def plan(arguments):
    """The units that cargo would compile, as {name: {identity}} with the identities of all below in each."""
    environment = dict(os.environ, RUSTC_BOOTSTRAP="1")
    text = subprocess.run(["cargo", *arguments, *PLAN], env=environment, check=True, capture_output=True, text=True).stdout
    units = json.loads(text)["units"]
    known = {}

    def identity(index):
        if index not in known:
            unit = units[index]
            profile = {k: v for k, v in unit["profile"].items() if k not in IGNORED}
            below = sorted(identity(d["index"]) for d in unit["dependencies"])
            known[index] = hash(
                (unit["pkg_id"], json.dumps(unit["target"], sort_keys=True), unit["mode"], str(unit["platform"]),
                 tuple(unit["features"]), json.dumps(profile, sort_keys=True), tuple(below)))
        return known[index]

    found = {}
    for index, unit in enumerate(units):
        name = unit["pkg_id"].split("/")[-1].split("#")[-1]
        found.setdefault((name, unit["target"]["name"], unit["mode"]), []).append((identity(index), frozenset(unit["features"])))
    return found


def main():
    tests, wheel = plan(TESTS), plan(WHEEL)
    again, reasons = [], []
    for key, units in wheel.items():
        if key not in tests:
            again.append(key)  # compiled nowhere else: not twice
            continue
        if key[0].split("@")[0] in ("dynocal-python", "pyo3", "pyo3-ffi", "pyo3-macros", "pyo3-build-config", "numpy"):
            continue
        have = {identity for identity, _ in tests[key]}
        if any(identity not in have for identity, _ in units):
            reasons.append(key)
            for _, features in units:
                if not any(features == other for _, other in tests[key]):
                    print(f"error: {key[0]}: features {sorted(features)} for the wheel, {[sorted(f) for _, f in tests[key]]} for the tests")
    print(f"{sum(map(len, wheel.values()))} units of the wheel, {len(reasons)} of them compiled a second time")
    return 1 if reasons else 0


if __name__ == "__main__":
    sys.exit(main())
