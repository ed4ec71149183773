#!/usr/bin/env bash
# Virtual environment of the peers: bench/peers/.venv
set -euo pipefail
cd "$(dirname "$0")"
python3 -m venv .venv
.venv/bin/pip install --quiet --requirement requirements.txt
.venv/bin/pip freeze
# sysidentpy asks for an older NumPy.
python3 -m venv .venv-selection
.venv-selection/bin/pip install --quiet --requirement requirements-selection.txt
.venv-selection/bin/pip freeze
