//! How a model is judged: table `validate`.

use std::collections::BTreeMap;

use dynocal_files::spec::Faults;
use dynocal_ident::model::initial::Initial;
use dynocal_ident::validate::Kind;
use dynocal_ident::validate::boundary::BoundaryKeys;
use dynocal_numerics::registry;
use serde::Serialize;

use super::member::built;
use super::typed::TypedValidate;

/// What is computed after the fit beside one step and free run.
#[derive(Clone, Debug, Serialize)]
pub struct Validation {
    /// Horizons of predictions, in samples.
    pub k_steps: Vec<usize>,
    /// Half width of the band that errors should stay in, in the unit of the target; by target.
    pub band: BTreeMap<String, f64>,
    /// Blocks of the cross-validation; 0 for none.
    pub folds: usize,
    /// Free runs on random inputs within the limits of the record; 0 for none.
    pub stability_runs: usize,
    /// Lags of the residual correlations.
    pub residual_lags: usize,
    /// How free runs start; absent: as is usual for the kind of model.
    pub initial: Option<Initial>,
    /// Level of confidence of bands and bounds.
    pub confidence: f64,
    /// How the boundary of what was identified is learnt.
    pub boundary: BoundaryKeys,
}

impl Default for Validation {
    fn default() -> Self {
        Self {
            k_steps: Vec::new(),
            band: BTreeMap::new(),
            folds: 0,
            stability_runs: 20,
            residual_lags: 25,
            initial: None,
            confidence: 0.95,
            boundary: BoundaryKeys::default(),
        }
    }
}

impl Validation {
    /// The outputs that are scored: one step, the horizons that are asked for, free run.
    pub fn kinds(&self) -> Vec<Kind> {
        let between = self.k_steps.iter().map(|k| Kind::KStep(*k));
        [Kind::OneStep].into_iter().chain(between).chain([Kind::FreeRun]).collect()
    }
}

/// More than these is a typing error, or work that no machine ends.
const MOST_STEPS: usize = 10_000;
const MOST_FOLDS: usize = 1000;
const MOST_RUNS: usize = 100_000;
const MOST_POINTS: usize = 10_000;

/// The table with its defaults.
pub(super) fn validation(
    typed: Option<&TypedValidate>,
    targets: &[String],
    faults: &mut Faults,
) -> Validation {
    let mut v = Validation::default();
    let Some(t) = typed else { return v };
    if let Some(k) = &t.k_steps {
        if k.contains(&0) {
            faults.push("validate.k_steps", "0", "horizons of 1 sample or more");
        }
        v.k_steps = k.clone();
        v.k_steps.sort_unstable();
        v.k_steps.dedup();
        // One step has its own row.
        v.k_steps.retain(|k| *k > 1);
    }
    for (name, half_width) in t.band.iter().flatten() {
        if !targets.contains(name) {
            faults.unknown("validate.band", name, targets);
        }
        faults.positive(
            &format!("validate.band.{name}"),
            *half_width,
            "half width in the unit of the target",
        );
        v.band.insert(name.clone(), *half_width);
    }
    for (key, found, most) in [
        ("k_steps", v.k_steps.last().copied(), MOST_STEPS),
        ("folds", t.folds, MOST_FOLDS),
        ("stability_runs", t.stability_runs, MOST_RUNS),
        ("residual_lags", t.residual_lags, MOST_STEPS),
    ] {
        if let Some(found) = found.filter(|n| *n > most) {
            faults.push(&format!("validate.{key}"), found, format!("{most} or less"));
        }
    }
    v.folds = t.folds.unwrap_or(v.folds);
    if v.folds == 1 {
        faults.push("validate.folds", "1", "0 for no cross-validation, or 2 and more blocks");
    }
    v.stability_runs = t.stability_runs.unwrap_or(v.stability_runs);
    v.residual_lags = t.residual_lags.unwrap_or(v.residual_lags);
    v.initial = t.initial;
    v.confidence = t.confidence.unwrap_or(v.confidence);
    if !(0.5..1.0).contains(&v.confidence) {
        faults.push("validate.confidence", v.confidence, "a level from 0.5 to below 1, e.g. 0.95");
    }
    if let Some(keys) = &t.boundary
        && let Some(b) = built("validate.boundary", "kind", registry::keys("boundary", keys), faults)
    {
        v.boundary = b;
        if !(v.boundary.quantile > 0.0 && v.boundary.quantile < 1.0) {
            faults.push(
                "validate.boundary.quantile",
                v.boundary.quantile,
                "a share above 0 and below 1, e.g. 0.99",
            );
        }
        if !(2..=MOST_POINTS).contains(&v.boundary.points) {
            let expected = format!("2 to {MOST_POINTS} points");
            faults.push("validate.boundary.points", v.boundary.points, expected);
        }
    }
    v
}
