#!/usr/bin/env bash
# Virtual environment of the peers: bench/peers/.venv
set -euo pipefail
cd "$(dirname "$0")"
python3 -m venv .venv
.venv/bin/pip install --quiet --requirement requirements.txt
.venv/bin/pip freeze
