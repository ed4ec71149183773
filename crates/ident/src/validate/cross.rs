//! Cross-validation by contiguous blocks.
//!
//! Random samples of a dynamic record are no test: each has its neighbours in the fit. Here every record is cut into
//! blocks; in each fold one block of every record is held out, and a gap around it of at least the longest lag, so that
//! no regressor of the fit reads what is scored.

use serde::{Deserialize, Serialize};

use super::spread::{ScorePool, Spread};
use super::{Kind, Seen, score_form};
use crate::data::DataError;
use crate::estimate::{EstimateError, Estimator};
use crate::experiment::Experiment;
use crate::model::form::Form;

/// How blocks are cut.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Blocks {
    /// Number of folds.
    pub folds: usize,
    /// Samples left out on both sides of a held-out block; at least the longest lag is taken.
    pub gap: usize,
    /// Confidence of the intervals of the mean scores.
    pub confidence: f64,
}

impl Default for Blocks {
    fn default() -> Self {
        Self { folds: 5, gap: 0, confidence: 0.95 }
    }
}

/// Result of a cross-validation. The folds share data: intervals are narrower than those of independent records.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct CrossValidation {
    /// Number of folds.
    pub folds: usize,
    /// Samples of the gap.
    pub gap: usize,
    /// One-step scores, one per fold that could be fitted.
    pub one_step: ScorePool,
    /// Free-run scores.
    pub free_run: ScorePool,
    /// Each parameter over the folds.
    pub parameters: Vec<Spread>,
    /// Folds without an estimate, and why.
    pub failed: Vec<String>,
}

/// Parts of the records of one fold: what is fitted, what is scored.
pub type Fold = (Vec<Experiment>, Vec<Experiment>);

/// The folds of `data` for a model with longest lag `lag`.
///
/// # Errors
/// [`DataError::TooShort`] when a block holds less than one sample; [`DataError::Length`] for inputs of another length.
pub fn folds(data: &[Experiment], lag: usize, blocks: &Blocks) -> Result<Vec<Fold>, DataError> {
    let count = blocks.folds.max(2);
    let gap = blocks.gap.max(lag);
    for e in data {
        let usable = e.len().saturating_sub(e.init_samples.max(lag));
        if usable < count {
            let why = format!("{count} folds");
            return Err(DataError::TooShort { record: e.name.clone(), found: usable, expected: count, why });
        }
        if !e.u.len().is_multiple_of(e.len()) || !(e.weights.is_empty() || e.weights.len() == e.len()) {
            let (record, found, expected) = (e.name.clone(), e.u.len().max(e.weights.len()), e.len());
            return Err(DataError::Length { record, channel: "inputs or weights".into(), found, expected });
        }
    }
    let fold = |k: usize| -> Fold {
        let (mut fitted, mut scored) = (Vec::new(), Vec::new());
        for e in data {
            let first = e.init_samples.max(lag);
            let border = |k: usize| first + (e.len() - first) * k / count;
            let (from, to) = (border(k), border(k + 1));
            // The block starts from measured outputs before it, which lie in the gap.
            scored.push(e.part(from - lag, to, lag));
            for (a, b, init) in [(0, from.saturating_sub(gap), e.init_samples), (to + gap, e.len(), 0)] {
                if b > a + lag.max(init) {
                    fitted.push(e.part(a, b, init));
                }
            }
        }
        (fitted, scored)
    };
    Ok((0..count).map(fold).collect())
}

/// Fits `model` in each fold by `estimator` and scores it on the block that was held out.
///
/// # Errors
/// [`EstimateError`] when the records are too short for the folds. A fold whose fit fails is reported, not an error.
pub fn cross_validate(
    model: &dyn Form,
    data: &[Experiment],
    estimator: &dyn Estimator,
    blocks: &Blocks,
    interrupt: &dyn Fn() -> bool,
) -> Result<CrossValidation, EstimateError> {
    let lag = model.memory();
    let (mut one_step, mut free_run, mut failed, mut thetas) = (vec![], vec![], vec![], vec![]);
    let folds = folds(data, lag, blocks)?;
    for (k, (fitted, scored)) in folds.iter().enumerate() {
        if interrupt() {
            failed.push(format!("fold {}: interrupted", k + 1));
            continue;
        }
        match estimator.estimate(model, fitted, None, interrupt) {
            Ok(fit) => {
                let fitted = fit.learnt.as_ref().map_or(model, |l| l.form.form());
                for (kind, into) in [(Kind::OneStep, &mut one_step), (Kind::FreeRun, &mut free_run)] {
                    into.extend(
                        score_form(fitted, &fit.theta, scored, kind, Seen::Unseen)?
                            .map(|s| (format!("fold {}", k + 1), s)),
                    );
                }
                // Members of a mean have no order that folds share.
                if fit.learnt.is_none() {
                    thetas.push(fit.theta);
                }
            }
            Err(e) => failed.push(format!("fold {}: {e}", k + 1)),
        }
    }
    let parameter = |j: usize| {
        let values: Vec<f64> = thetas.iter().map(|t| t[j]).collect();
        Spread::of(&values, blocks.confidence)
    };
    Ok(CrossValidation {
        folds: folds.len(),
        gap: blocks.gap.max(lag),
        one_step: ScorePool::of(one_step, blocks.confidence),
        free_run: ScorePool::of(free_run, blocks.confidence),
        parameters: if thetas.is_empty() { vec![] } else { (0..model.parameters()).map(parameter).collect() },
        failed,
    })
}
