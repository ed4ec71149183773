#!/usr/bin/env bash
# The Python package: builds the wheel, installs it into an empty environment with NumPy only, runs the stories there, then the
# tests with everything that the package can work with, and builds the documentation site.
#
#     bash scripts/check_python.sh
#
# The wheel is built by maturin in the release profile, in the target folder of the workspace. Its environments lie in
# target/python and are kept.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
MATURIN_VERSION=1.16.0
place="$PWD/target/python"
wheels="$place/wheels"
mkdir -p "$place"
rm -rf "$wheels"

# environment NAME PACKAGES..: a virtual environment with them.
environment() {
    local at="$place/$1"
    shift
    [ -x "$at/bin/python" ] || python3 -m venv "$at"
    "$at/bin/python" -m pip install --quiet --disable-pip-version-check "$@"
}

environment build "maturin==$MATURIN_VERSION"
"$place/build/bin/maturin" build --release --locked --quiet --out "$wheels"
wheel="$(ls "$wheels"/dynocal-*.whl)"
echo "wheel: $(basename "$wheel"), $(($(stat -c %s "$wheel") / 1000000)) MB"

# The source distribution has what the wheel was built of.
"$place/build/bin/maturin" sdist --out "$wheels" >/dev/null 2>&1
python3 scripts/sdist.py "$wheels"/dynocal-*.tar.gz "${CARGO_TARGET_DIR:-target}/release/lib_dynocal.d"

# Whoever has nothing but NumPy.
rm -rf "$place/bare"
environment bare "$wheel"
"$place/bare/bin/python" - <<'PYTHON'
import importlib.metadata as metadata
import subprocess, sys
names = sorted(d.name for d in metadata.distributions() if d.name not in ("pip", "setuptools"))
assert names == ["dynocal", "numpy"], names
code = "import time, numpy; a = time.perf_counter(); import dynocal; print(time.perf_counter() - a)"
took = sorted(float(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout) for _ in range(5))
print(f"import beyond NumPy: {1e3 * took[2]:.0f} ms (median of 5)")
PYTHON
work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT
for story in "$PWD"/python/examples/*.py; do
    (cd "$work" && "$place/bare/bin/python" "$story" >"$work/out.txt" 2>&1) || { cat "$work/out.txt"; echo "error: $story"; exit 1; }
    echo "story: $(basename "$story")"
done

# Whoever has everything.
environment full "$wheel" pytest mypy pandas pyarrow polars scikit-learn gymnasium scipy control matplotlib \
    distributed tqdm sphinx myst-parser furo nbclient ipykernel
"$place/full/bin/python" -m pip install --quiet --disable-pip-version-check --force-reinstall --no-deps "$wheel"
# Thousands of small files are written and synced: in memory where there is some.
memory=()
[ -w /dev/shm ] && memory=(--basetemp "$(mktemp -d /dev/shm/dynocal.XXXXXX)/tests")
"$place/full/bin/python" -m pytest python/tests "${memory[@]}"
[ "${#memory[@]}" = 0 ] || rm -rf "$(dirname "${memory[1]}")"

# The site: its tutorials and notebooks are run, its links and the keys of every spec checked.
DYNOCAL_ROOT="$PWD" "$place/full/bin/python" docs/site/build.py "$place/site-html"
