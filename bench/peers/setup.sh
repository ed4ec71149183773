#!/usr/bin/env bash
# Virtual environments of the peers: bench/peers/.venv, and .venv-sippy for SIPPY, which pins an older NumPy
set -euo pipefail
cd "$(dirname "$0")"
python3 -m venv .venv
.venv/bin/pip install --quiet --requirement requirements.txt
.venv/bin/pip freeze
# sysidentpy asks for an older NumPy.
python3 -m venv .venv-selection
.venv-selection/bin/pip install --quiet --requirement requirements-selection.txt
.venv-selection/bin/pip freeze
# The Python package beside SysIdentPy: its wheel comes from this tree.
python3 -m venv .venv-python
.venv-python/bin/pip install --quiet --requirement requirements-python.txt maturin
(cd ../.. && bench/peers/.venv-python/bin/maturin build --release --locked --quiet --out target/peers-wheel)
.venv-python/bin/pip install --quiet --no-deps --force-reinstall ../../target/peers-wheel/dynocal-*.whl
.venv-python/bin/pip freeze
python3 -m venv .venv-sippy
.venv-sippy/bin/pip install --quiet --requirement requirements-sippy.txt
.venv-sippy/bin/pip freeze
# python-control finds its upper bound of several loops in Slycot.
python3 -m venv .venv-control
.venv-control/bin/pip install --quiet --requirement requirements-control.txt
.venv-control/bin/pip freeze
