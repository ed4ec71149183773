#!/usr/bin/env bash
# Everything that must hold before a change goes in: formatting, lints, documentation, tests, and the demo at reduced
# length with its report opened in a browser. Installs what is missing (Debian, as root or with sudo).
#
#     bash scripts/check.sh
#
# DYNOCAL_REFERENCE_DIR names the folder with the larger reference data. Without it the tests that need it say SKIPPED;
# with it nothing may skip but readers of other houses that cannot be had (SKIPPED READER, named in the summary). The release profile
# is used throughout, the demos run what the tests have built, and the wheel has the features of the tests (scripts/one_build.py), so
# that every crate compiles once.
set -uo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
# Nothing is built twice here: what an incremental build would keep only fills the disk.
export CARGO_INCREMENTAL=0
export CARGO_TERM_COLOR="${CARGO_TERM_COLOR:-never}" CARGO_TERM_PROGRESS_WHEN=never DEBIAN_FRONTEND=noninteractive
NEXTEST_VERSION=0.9.143
DENY_VERSION=0.20.2
NEEDED_GB=9
work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT
# Where tools are installed that are gone with this run.
export PATH="$work/tools/bin:$PATH"
# What the step of the tests leaves: programs and examples.
built="${CARGO_TARGET_DIR:-target}/release"
program="$built/dynocal"
failed=()
notes=()

say() { printf '\n== %s\n' "$*"; }

# step NAME COMMAND...: runs it, keeps going when it fails.
step() {
    local name="$1" before=$SECONDS
    shift
    say "$name"
    local code=0
    # In braces the shell itself starts tee, so that it can be waited for.
    { "$@"; } </dev/null > >(tee "$work/step.log") 2>&1 || code=$?
    wait "$!"
    if [ "$code" = 0 ]; then
        notes+=("ok      $((SECONDS - before)) s  $name")
    else
        failed+=("$name")
        # Of a long output often only the end is kept: what a step said last stands in the summary too.
        notes+=("FAILED  $((SECONDS - before)) s  $name"$'\n'"$(tail -n 5 "$work/step.log" | cut -c 1-400 | sed 's/^/        /')")
    fi
}

as_root() {
    if [ "$(id -u)" = 0 ]; then "$@"; else sudo --non-interactive "$@"; fi
}

find_browser() { command -v "${CHROMIUM:-chromium}" || command -v chromium-browser || command -v google-chrome; }

# cargo_tool NAME VERSION: a subcommand of cargo, as a wheel that holds the program (seconds), or where there is none for this machine
# from its sources (minutes).
cargo_tool() {
    cargo "$1" --version >/dev/null 2>&1 && return
    [ -d "$work/tools" ] || python3 -m venv "$work/tools" || return 1
    "$work/tools/bin/pip" install --quiet --disable-pip-version-check --only-binary :all: --no-deps \
        "astral-dev-toolchain-cargo-$1==$2" && cargo "$1" --version >/dev/null && return
    cargo install --quiet --locked "cargo-$1@$2"
}

install_missing() {
    local packages=()
    command -v cc >/dev/null || packages+=(gcc libc6-dev)
    command -v python3 >/dev/null || packages+=(python3)
    find_browser >/dev/null || packages+=(chromium)
    python3 -c 'import ensurepip' >/dev/null 2>&1 || packages+=(python3-venv)
    command -v cppcheck >/dev/null || packages+=(cppcheck)
    if [ "${#packages[@]}" -gt 0 ]; then
        as_root apt-get update -qq && as_root apt-get install -y -qq --no-install-recommends "${packages[@]}" || return 1
    fi
    cargo fmt --version >/dev/null 2>&1 || rustup component add rustfmt || return 1
    cargo clippy --version >/dev/null 2>&1 || rustup component add clippy || return 1
    cargo_tool nextest "$NEXTEST_VERSION" && cargo_tool deny "$DENY_VERSION" || return 1
    cargo --version && cargo nextest --version | head -n 1 && python3 --version && echo "browser: $(find_browser)"
}

documentation() { RUSTDOCFLAGS="-D warnings" cargo doc --quiet --release --workspace --no-deps --locked; }

# Tests print the reason when they skip; nextest shows what passing tests print only when asked, so the whole goes
# to a file, of which the summary is shown, or all of it after a failure.
tests() {
    local log="$work/tests.log" skipped readers
    cargo nextest run --release --workspace --locked --no-fail-fast --success-output final \
        >"$log" 2>&1 || { cat "$log"; return 1; }
    grep -E '^ +(Summary|SLOW)' "$log"
    readers="$(grep 'SKIPPED READER' "$log" | sort | uniq -c)"
    [ -z "$readers" ] || notes+=("note    READERS MISSING, their tests skipped:"$'\n'"$readers")
    skipped="$(grep -v 'SKIPPED READER' "$log" | grep -c 'SKIPPED')"
    [ "$skipped" = 0 ] && return 0
    grep -v 'SKIPPED READER' "$log" | grep 'SKIPPED' | sort | uniq -c
    if [ -n "${DYNOCAL_REFERENCE_DIR:-}" ]; then
        echo "error: $skipped tests skipped although DYNOCAL_REFERENCE_DIR is set"
        return 1
    fi
    notes+=("note    $skipped tests skipped: DYNOCAL_REFERENCE_DIR is not set")
}

doc_tests() { cargo test --quiet --release --doc --workspace --locked; }

# Seven steps on the virtual engine in a shorter campaign. It may end as not converged (1), it must not fail (2).
demo() {
    local code=0
    "$program" calibrate examples/gtdi/quick.toml --out "$work/quick" --quiet || code=$?
    [ "$code" -le 1 ] || { echo "error: exit code $code"; return 1; }
    python3 - "$work/quick/summary.json" <<'PYTHON'
import json, sys
summary = json.load(open(sys.argv[1], encoding="utf-8"))
print("status:", summary["status"], "| valid:", summary["valid"], "| warnings:", len(summary["warnings"]))
for warning in summary["warnings"]:
    print("  ", warning)
PYTHON
}

demo_report() {
    python3 scripts/check_report.py "$work/quick/report.html" \
        --text Excitation --text Models --text "Test signal design" --text "Optimisation over a record" --text "Dynamic map" \
        --text "Comparison of the maps" --text "Free-run R2" --text "Nm" --text "kg/h"
}

measured_file() {
    "$program" identify examples/gas_furnace/identify.toml --out "$work/furnace" --quiet &&
        python3 scripts/check_report.py "$work/furnace/report.html" --text co2
}

report_check_itself() {
    "$built/examples/demo" >"$work/demo.html" &&
        python3 scripts/test_check_report.py "$work/demo.html"
}

# Advisories need more than the package registry, the rest does not. The crates of other systems than this one are
# fetched first: a build leaves them out, and their licences count too.
licences() { cargo fetch --quiet --locked && cargo deny --offline --log-level error check licenses bans sources; }

# A full disk fails what comes with other words: said first.
free_gb="$(df --output=avail -BG . | tail -n 1 | tr -dc 0-9)"
if [ "$free_gb" -lt "$NEEDED_GB" ]; then
    say "only $free_gb GB are free on this disk; what is built from nothing takes $NEEDED_GB"
    notes+=("note    only $free_gb GB were free on the disk at the start, $NEEDED_GB are needed from nothing")
fi

step "tools" install_missing
[ "${#failed[@]}" = 0 ] || { echo "error: the tools could not be installed"; exit 1; }
[ -n "${DYNOCAL_REFERENCE_DIR:-}" ] && echo "reference data: $DYNOCAL_REFERENCE_DIR" || echo "reference data: not given"
step "formatting" cargo fmt --all --check -- --color never
step "clippy, warnings are errors" cargo clippy --quiet --release --workspace --all-targets --locked --keep-going -- -D warnings
step "documentation, warnings are errors" documentation
step "readers of other houses for the formats" bash scripts/readers.sh
step "tests" tests
step "documentation examples" doc_tests
step "demo: calibrate, reduced length" demo
step "demo: its report in a browser" demo_report
step "demo: identify a measured file, its report in a browser" measured_file
step "the report check notices broken reports" report_check_itself
step "the wheel and the tests share one build" python3 scripts/one_build.py
step "the Python package" bash scripts/check_python.sh
step "licences, bans, sources" licences

say "summary"
printf '%s\n' "${notes[@]}"
if [ "${#failed[@]}" -gt 0 ]; then
    printf 'FAILED: %s\n' "${failed[@]}"
    exit 1
fi
echo "all checks passed in $SECONDS s"
