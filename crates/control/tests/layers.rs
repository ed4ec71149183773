//! Modules of this crate point down only.

#[path = "../../../tests/common/layers.rs"]
mod layers;

use std::path::Path;

/// Lowest first.
const ORDER: &[&str] = &[
    "error",
    "trim",
    "oxygen",
    "poly",
    "matrix",
    "experiment",
    "system",
    "grid",
    "closed",
    "margin",
    "response",
    "mu",
    "disk",
    "perturb",
    "runtime",
    "predictor",
    "horizon",
    "stored",
    "simulate",
    "trial",
    "interaction",
    "smith",
    "plane",
    "stable",
    "tune",
    "search",
    "linear",
    "identify",
];

#[test]
fn no_module_uses_one_above_it() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let faults = layers::faults(&src, ORDER);
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    // The arrows are really read: this one is there.
    let arrows = layers::arrows(&src);
    assert!(arrows.contains_key(&("disk".into(), "mu".into())), "disk uses mu");
}
