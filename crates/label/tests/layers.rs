//! Modules of this crate point down only.

#[path = "../../../tests/common/layers.rs"]
mod layers;

use std::path::Path;

/// Lowest first.
const ORDER: &[&str] = &[
    "error",
    "rows",
    "label",
    "follow",
    "correlation",
    "qp",
    "quantise",
    "linear",
    "truncated",
    "graph",
    "nonlinear",
    "ve",
];

#[test]
fn no_module_uses_one_above_it() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let faults = layers::faults(&src, ORDER);
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    // The arrows are really read: this one is there.
    assert!(layers::arrows(&src).contains_key(&("linear".into(), "qp".into())), "linear uses qp");
}
