//! Modules of this crate point down only: the engine knows nothing of its bed.

#[path = "../../../tests/common/layers.rs"]
mod layers;

use std::path::Path;

/// Lowest first.
const ORDER: &[&str] = &[
    "cams",
    "geometry",
    "combustion",
    "deviations",
    "egr",
    "equilibrium",
    "error",
    "exhaust_wall",
    "film",
    "gas",
    "heat",
    "orifice",
    "sensors",
    "dissociation",
    "inputs",
    "nitric_oxide",
    "turbocharger",
    "end_gas",
    "emissions",
    "params",
    "state",
    "flatten",
    "grid",
    "initial",
    "step",
    "outputs",
    "engine",
    "bookkeeping",
    "statics",
    "driven",
    "trace",
    "twin",
    "full_load",
    "vehicle",
    "testbed",
    "bed",
    "plants",
];

#[test]
fn no_module_uses_one_above_it() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let faults = layers::faults(&src, ORDER);
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    // The arrows are really read: these are there.
    let arrows = layers::arrows(&src);
    for (from, to) in [("testbed", "engine"), ("state", "film")] {
        assert!(arrows.contains_key(&(from.into(), to.into())), "{from} uses {to}");
    }
}
