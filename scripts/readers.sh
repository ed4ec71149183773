#!/usr/bin/env bash
# The readers that nobody here wrote, for the tests of the formats: Python packages in target/readers (a virtual
# environment of their own) and ASAM's schema of CDF 2.0, which is fetched and never committed. Tests find the
# interpreter at target/readers/bin/python or at DYNOCAL_READERS_PYTHON; what is missing is skipped with a line SKIPPED.
#
#     bash scripts/readers.sh
set -uo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
target="${CARGO_TARGET_DIR:-target}/readers"
stamp="$target/installed"
# pya2ldb and pya2l both install a module named pya2l: only the first is wanted here.
packages=(dcmReader==0.5.1 lxml==6.1.3 pya2ldb==1.0.355 asammdf==8.8.28 scipy==1.17.1 h5py==3.16.0 fmpy==0.3.32
    onnx==1.23.2 onnxruntime==1.31.1)
wanted="${packages[*]}"
if [ -f "$stamp" ] && [ "$(cat "$stamp")" = "$wanted" ]; then
    echo "readers: $target (already there)"
    exit 0
fi
python3 -m venv "$target" || { echo "SKIPPED: no virtual environment for the readers"; exit 0; }
missing=()
# One at a time: a package that is not to be had must not take the others with it.
for package in "${packages[@]}"; do
    "$target/bin/python" -m pip install --quiet --disable-pip-version-check "$package" || missing+=("$package")
done
if [ ! -f "$target/cdf/cdf_v2.0.0.sl.xsd" ]; then
    mkdir -p "$target/cdf"
    "$target/bin/python" -m pip install --quiet --disable-pip-version-check poetry-core setuptools
    "$target/bin/python" -m pip download --quiet --disable-pip-version-check --no-deps --no-binary asamint --no-build-isolation \
        --dest "$target/cdf" asamint==0.2.2 &&
        tar -xzf "$target"/cdf/asamint-*.tar.gz -C "$target/cdf" --strip-components=4 --wildcards '*/asamint/data/dtds/*' ||
        missing+=("ASAM's schema of CDF 2.0")
fi
if [ "${#missing[@]}" -gt 0 ]; then
    printf 'SKIPPED: not installed: %s\n' "${missing[@]}"
else
    printf '%s' "$wanted" >"$stamp"
fi
echo "readers: $target"
