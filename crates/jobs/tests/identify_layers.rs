//! The files of the job `identify` point down only: there is an order to read them in.

#[path = "../../../tests/common/layers.rs"]
mod layers;

use std::path::Path;

/// Lowest first.
const ORDER: &[&str] = &[
    "error", "finding", "spec", "before", "gaps", "fit", "load", "set", "bounds", "poles", "curves", "after",
    "points", "result", "estimate", "prepare", "score", "baseline", "judge", "verdict", "job", "page",
];

#[test]
fn no_file_uses_one_above_it() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/identify");
    let faults = layers::faults_below(&src, "crate::identify::", ORDER);
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    assert!(layers::arrows_below(&src, "crate::identify::").contains_key(&("job".into(), "fit".into())));
    assert!(layers::arrows(&src).len() <= layers::arrows_below(&src, "crate::identify::").len());
    assert!(layers::faults(&src, ORDER).is_empty());
}
