//! Modules of this crate point down only.

#[path = "../../../tests/common/layers.rs"]
mod layers;

use std::path::Path;

/// Lowest first.
const ORDER: &[&str] = &[
    "place",
    "page",
    "kept",
    "estimate",
    "export_spec",
    "show",
    "draft",
    "convert",
    "simulate",
    "control",
    "label",
    "fuelling",
    "optimise",
    "signal",
    "engine",
    "identify",
    "design",
    "sequential",
    "calibrate",
    "map",
    "export",
    "runs",
    "families",
];

#[test]
fn no_module_uses_one_above_it() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let faults = layers::faults(&src, ORDER);
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    // The arrows are really read: these are there.
    let arrows = layers::arrows(&src);
    for (from, to) in [("signal", "place"), ("design", "identify")] {
        assert!(arrows.contains_key(&(from.into(), to.into())), "{from} uses {to}");
    }
}
