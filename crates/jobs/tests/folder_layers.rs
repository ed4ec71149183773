//! The files of the jobs `identify`, `calibrate`, `map` and `design` point down only: there is an order to read them in.

#[path = "../../../tests/common/layers.rs"]
mod layers;

use std::path::Path;

/// Lowest first.
const IDENTIFY: &[&str] = &[
    "error",
    "finding",
    "spec",
    "before",
    "odd",
    "gaps",
    "fit",
    "load",
    "remembered",
    "set",
    "bounds",
    "poles",
    "curves",
    "after",
    "points",
    "result",
    "estimate",
    "prepare",
    "score",
    "baseline",
    "judge",
    "verdict",
    "job",
    "page",
    "memory",
];

#[test]
fn no_file_of_identify_uses_one_above_it() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/identify");
    let faults = layers::faults_below(&src, "crate::identify::", IDENTIFY);
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    assert!(layers::arrows_below(&src, "crate::identify::").contains_key(&("job".into(), "fit".into())));
    assert!(layers::arrows(&src).len() <= layers::arrows_below(&src, "crate::identify::").len());
    assert!(layers::faults(&src, IDENTIFY).is_empty());
}

/// Lowest first.
const CALIBRATE: &[&str] = &[
    "signals",
    "levels",
    "spec",
    "channels",
    "check",
    "error",
    "context",
    "records",
    "chain",
    "loops",
    "model_spec",
    "start_maps",
    "fuel_driven",
    "fuel_on_model",
    "fuel_plant",
    "fuelled",
    "given",
    "excited",
    "optimise_start",
    "excite_step",
    "models",
    "poor",
    "optimise_plan",
    "optimise_miss",
    "optimise_trials",
    "design_spec",
    "refine",
    "lag",
    "at_rest",
    "invert_step",
    "optimise_step",
    "design_step",
    "static_search",
    "validate_step",
    "run",
    "store",
    "verdict",
    "summary",
    "page",
    "job",
    "estimate",
];

#[test]
fn no_file_of_calibrate_uses_one_above_it() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/calibrate");
    let faults = layers::faults_below(&src, "crate::calibrate::", CALIBRATE);
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    let arrows = layers::arrows_below(&src, "crate::calibrate::");
    assert!(arrows.contains_key(&("optimise_step".into(), "optimise_plan".into())));
}

/// Lowest first.
const MAP: &[&str] = &[
    "error",
    "spec",
    "line_time",
    "budget",
    "check",
    "job",
    "bench",
    "record",
    "on_bed",
    "journal",
    "choose",
    "learn",
    "shown",
    "drive",
    "schedule",
    "windows",
    "along",
    "slow",
    "rest",
    "line",
    "halfway",
    "lines",
    "answers",
    "sweep",
    "reach",
    "estimate",
    "setting",
    "refine",
    "inverse",
    "loops",
    "result",
    "channels",
    "edits",
    "between",
    "cells",
    "front",
    "deliver",
    "optimum",
    "walk",
    "verify",
    "verdict",
    "work",
    "page",
    "store",
];

#[test]
fn no_file_of_map_uses_one_above_it() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/map");
    let faults = layers::faults_below(&src, "crate::map::", MAP);
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    let arrows = layers::arrows_below(&src, "crate::map::");
    assert!(arrows.contains_key(&("verdict".into(), "result".into())));
}

/// Lowest first. What `typed` reads and `mod.rs` checks is below all that works with it.
const DESIGN: &[&str] = &[
    "error",
    "typed",
    "channels",
    "loaded",
    "literature",
    "models",
    "stored",
    "load",
    "estimate",
    "margins",
    "result",
    "plan",
    "judge",
    "rivals",
    "rounds",
    "run",
    "page",
];

#[test]
fn no_file_of_design_uses_one_above_it() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/design");
    let faults = layers::faults_below(&src, "crate::design::", DESIGN);
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    let arrows = layers::arrows_below(&src, "crate::design::");
    assert!(arrows.contains_key(&("run".into(), "load".into())));
}
