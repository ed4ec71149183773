//! Modules of this crate point down only.

#[path = "../../../tests/common/layers.rs"]
mod layers;

use std::path::Path;

/// Lowest first.
const ORDER: &[&str] = &[
    "asked",
    "error",
    "chapter4",
    "report",
    "many",
    "benchmarks",
    "chain",
    "chapter5",
    "chapter6",
    "chapter7",
    "control",
    "design",
    "dynamic",
    "engine",
    "labels",
    "limits",
    "loops",
    "map",
    "promise",
    "records",
];

#[test]
fn no_module_uses_one_above_it() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let faults = layers::faults(&src, ORDER);
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    // The arrows are really read: these are there.
    let arrows = layers::arrows(&src);
    assert!(arrows.contains_key(&("chain".into(), "asked".into())), "chain uses asked");
}
