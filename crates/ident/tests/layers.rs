//! Modules of this crate point down only.

#[path = "../../../tests/common/layers.rs"]
mod layers;

use std::fs;
use std::path::Path;

/// Lowest first.
const ORDER: &[&str] = &[
    "nullable",
    "correlation",
    "signal",
    "data",
    "derived",
    "prepare",
    "experiment",
    "plant",
    "pi",
    "plan",
    "play",
    "model",
    "estimate",
    "excitation",
    "validate",
    "select",
    "linear",
    "stored",
];

#[test]
fn no_module_uses_one_above_it() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let faults = layers::faults(&src, ORDER);
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    // The arrows are really read: these are there.
    let arrows = layers::arrows(&src);
    for (from, to) in [("estimate", "model"), ("stored", "prepare"), ("prepare", "data")] {
        assert!(arrows.contains_key(&(from.into(), to.into())), "{from} uses {to}");
    }
}

/// A crate with every kind of arrow: those up are found, comments and tests are not.
// A tree for this test alone: nobody reads it but the test.
#[allow(clippy::disallowed_methods)]
#[test]
fn back_arrows_are_found() {
    let folder = tempfile::tempdir().unwrap();
    let src = folder.path();
    fs::create_dir(src.join("low")).unwrap();
    fs::write(src.join("lib.rs"), "mod low;\nmod high;\nmod stray;\nuse crate::high::a;\n").unwrap();
    fs::write(src.join("low.rs"), "//! See crate::high.\nmod deep;\n").unwrap();
    fs::write(
        src.join("low/deep.rs"),
        "use super::x;\nuse crate::{low::y, high::{z, w}};\n\n#[cfg(test)]\nmod tests {\n    use crate::stray::t;\n}\n",
    )
    .unwrap();
    fs::write(src.join("high.rs"), "use crate::low::x; // and not crate::stray\npub(crate) fn g() {}\n")
        .unwrap();
    fs::write(src.join("stray.rs"), "fn f() { super::high::g() }\n").unwrap();
    let faults = layers::faults(src, &["low", "high"]);
    let expected = [
        "the module `stray` has no place in the order: name it where it belongs",
        "low/deep.rs:2: `low` uses `high`, which stands above it",
    ];
    assert_eq!(faults, expected);
    let arrows = layers::arrows(src);
    assert_eq!(arrows.len(), 3, "{arrows:?}");
    assert!(
        layers::faults(src, &["high", "low", "stray"])
            == ["high.rs:1: `high` uses `low`, which stands above it"]
    );
}
