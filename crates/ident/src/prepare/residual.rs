//! Outliers by what a model leaves unexplained.
//!
//! ```text
//! sigma = 1.4826 median |e - median e|,   y(t) is an outlier when |e(t) - median e| > n_sigma sigma
//! ```
//!
//! over the residuals of all records together. Not in the table of steps, because it needs a model: fit, find, and fit
//! again. Residuals of a free run point at the bad sample alone; one-step residuals also blame the samples after it,
//! as many as the model has output lags.

use dynocal_numerics::registry::{self, BuildError, MemberDoc, ParamDoc};
use serde::Deserialize;

use super::action::{ACTION, Action, LEAST, Outliers, act, least};
use super::common::{chosen, fault, median, positive};
use super::note::Size;
use super::{Note, Outcome, PrepareError};
use crate::data::Dataset;

const NAME: &str = "residual_outliers";

/// Name and keys in a spec.
pub const DOC: MemberDoc = MemberDoc {
    name: NAME,
    what: "outliers of an output against a model that was fitted before",
    params: &[
        ParamDoc {
            name: "n_sigma",
            unit: "-",
            default: "5",
            what: "distance from the median residual in robust standard deviations",
        },
        ACTION,
        LEAST,
    ],
};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Keys {
    #[serde(default = "five")]
    n_sigma: f64,
    #[serde(default)]
    action: Action,
    #[serde(default = "least")]
    least_samples: usize,
}

fn five() -> f64 {
    5.0
}

/// Outliers of `output` by the residuals `e = y - yhat` of a model, one slice per record and as long as it; NaN
/// where the model gives none (initialisation, missing samples).
///
/// # Errors
/// A key that does not fit.
pub fn residual_outliers(keys: &toml::Table) -> Result<ResidualOutliers, BuildError> {
    let step: Keys = registry::keys(NAME, keys)?;
    positive(NAME, "n_sigma", step.n_sigma)?;
    Ok(ResidualOutliers { keys: keys.clone(), step })
}

/// The step with its keys.
pub struct ResidualOutliers {
    keys: toml::Table,
    step: Keys,
}

impl ResidualOutliers {
    /// Acts on the outliers of `output`.
    ///
    /// # Errors
    /// [`PrepareError`]: no such channel, or residuals that do not fit the records.
    pub fn apply(
        &self,
        records: Vec<Dataset>,
        output: &str,
        residuals: &[Vec<f64>],
    ) -> Result<(Vec<Dataset>, Note), PrepareError> {
        for (k, record) in records.iter().enumerate() {
            let found = residuals.get(k).map_or(0, Vec::len);
            if found != record.len() {
                let message = format!("found {found} residuals, expected {}", record.len());
                return Err(fault(NAME, record, message));
            }
        }
        let mut known: Vec<f64> = residuals.iter().flatten().copied().filter(|e| e.is_finite()).collect();
        let centre = median(&mut known);
        let mut distance: Vec<f64> = known.iter().map(|e| (e - centre).abs()).collect();
        let limit = self.step.n_sigma * 1.4826 * median(&mut distance);
        let before = Size::of(&records);
        let mut outcome = Outcome::default();
        for (record, e) in records.into_iter().zip(residuals) {
            let channel = chosen(&record, Some(&[output.to_string()]), &[])?[0];
            let rows: Vec<usize> =
                (0..e.len()).filter(|t| e[*t].is_finite() && (e[*t] - centre).abs() > limit).collect();
            let y = &record.channels[channel].values;
            let expected = rows.iter().map(|t| y[*t] - e[*t]).collect();
            let found = [Outliers { channel, rows, expected }];
            act(self.step.action, record, &found, self.step.least_samples, &mut outcome);
        }
        outcome.remarks.push(format!(
            "residuals further than {limit:.6} from {centre:.6} count as outliers ({} robust standard deviations)",
            self.step.n_sigma
        ));
        let note = Note {
            step: NAME.into(),
            keys: self.keys.clone(),
            before,
            after: Size::of(&outcome.records),
            changes: outcome.changes,
            remarks: outcome.remarks,
        };
        Ok((outcome.records, note))
    }
}
