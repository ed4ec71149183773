//! Published benchmarks by the specs of `examples/benchmarks`: official split, free run, at or below the published
//! polynomial NARX (M. D. Champneys, G. I. Beintema, R. Toth, M. Schoukens, T. J. Rogers, Baseline results for selected
//! nonlinear system identification benchmarks, arXiv:2405.10779).

use std::path::Path;

use dynocal_ident::validate::Kind;
use dynocal_jobs::identify::{job, spec};

/// Free-run RMSE of each part, in the unit of the record; `None` (printed) where the data are not installed.
fn free_run(name: &str) -> Option<Vec<(String, f64)>> {
    if std::env::var_os("DYNOCAL_REFERENCE_DIR").is_none() {
        println!("SKIPPED: DYNOCAL_REFERENCE_DIR is not set");
        return None;
    }
    let folder = tempfile::tempdir().unwrap();
    let file = format!("{}/../../examples/benchmarks/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    let overrides = spec::Overrides { out: Some(folder.path().join(name)), ..spec::Overrides::default() };
    let job = spec::read(Path::new(&file), &overrides).unwrap();
    let (found, _) = job::run(&job, dynocal_numerics::watch::Watch::silent()).unwrap();
    let scores = found.scores.iter().filter(|s| s.kind == Kind::FreeRun);
    // A run that diverged has no score.
    Some(scores.map(|s| (s.part.clone(), s.rmse.unwrap_or(f64::INFINITY))).collect())
}

fn check(name: &str, published: &[(&str, f64)]) {
    let Some(found) = free_run(name) else { return };
    for (part, limit) in published {
        let (_, rmse) =
            found.iter().find(|(p, _)| p == part).unwrap_or_else(|| panic!("{part} in {found:?}"));
        assert!(rmse <= limit, "{name}, {part}: {rmse}, published {limit}");
    }
}

#[test]
fn silverbox_is_below_the_published_polynomial() {
    check(
        "silverbox",
        &[("multisine", 0.640e-3), ("arrow_full", 2.25e-3), ("arrow_no_extrapolation", 0.571e-3)],
    );
}

#[test]
fn cascaded_tanks_are_below_the_published_polynomial() {
    check("cascaded_tanks", &[("official_test", 0.413)]);
}

#[test]
fn emps_is_below_the_published_polynomial() {
    check("emps", &[("official_test", 5.17e-3)]);
}
