#!/usr/bin/env bash
# All comparisons, one after the other: DYNOCAL_REFERENCE_DIR=... bench/peers/run.sh
set -uo pipefail
cd "$(dirname "$0")"
[ -x .venv/bin/python ] && [ -x .venv-selection/bin/python ] || bash setup.sh || exit 2
missed=0
for script in sensitivities.py estimation.py linear.py neural.py design.py fuel.py fuel_neural.py horizon.py free_outputs.py long_record.py hock_schittkowski.py response.py map_day.py whole_map.py labels.py; do
    .venv/bin/python "$script" || missed=1
done
.venv-selection/bin/python selection.py || missed=1
[ -x .venv-control/bin/python ] && { .venv-control/bin/python disk_margins.py || missed=1; }
(cd ../.. && cargo run --quiet --release -p dynocal-control --example control_runtime) || missed=1
.venv-python/bin/python python_sysidentpy.py || missed=1
exit "$missed"
