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
python3 -m venv .venv-sippy
.venv-sippy/bin/pip install --quiet --requirement requirements-sippy.txt
.venv-sippy/bin/pip freeze
# python-control finds its upper bound of several loops in Slycot.
python3 -m venv .venv-control
.venv-control/bin/pip install --quiet --requirement requirements-control.txt
.venv-control/bin/pip freeze
