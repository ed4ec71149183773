//! What becomes of samples that are outliers.

use dynocal_numerics::registry::ParamDoc;
use serde::Deserialize;

use super::common::{change, split, union};
use super::{Became, Effect, Outcome};
use crate::data::{Dataset, Gap, runs};

/// What to do with an outlier.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Action {
    /// On the line between the good neighbours.
    #[default]
    Interpolate,
    /// The last good value.
    Hold,
    /// The expected value: the median of the window, or the model.
    Replace,
    /// Missing from now on.
    Mark,
    /// The record is split there.
    Split,
}

pub(super) const ACTION: ParamDoc = ParamDoc {
    name: "action",
    unit: "-",
    default: "interpolate",
    what: "interpolate (between good neighbours), hold (last good value), replace (expected value), mark (missing), split",
};

pub(super) const LEAST: ParamDoc = ParamDoc {
    name: "least_samples",
    unit: "samples",
    default: "10",
    what: "parts of a split record that have fewer after those that initialise are given up",
};

/// Default of [`LEAST`].
pub(super) fn least() -> usize {
    10
}

/// The outliers of one channel: rows in order, with the value that was expected there.
pub(super) struct Outliers {
    pub(super) channel: usize,
    pub(super) rows: Vec<usize>,
    pub(super) expected: Vec<f64>,
}

/// Acts on the outliers of one record.
pub(super) fn act(
    action: Action,
    mut record: Dataset,
    found: &[Outliers],
    least: usize,
    outcome: &mut Outcome,
) {
    let n = record.len();
    let mut places: Vec<Vec<Gap>> = Vec::with_capacity(found.len());
    for f in found.iter().filter(|f| !f.rows.is_empty()) {
        let gaps = runs(n, |t| f.rows.binary_search(&t).is_ok());
        let values = &mut record.channels[f.channel].values;
        f.rows.iter().for_each(|t| values[*t] = f64::NAN);
        let became = match action {
            Action::Interpolate => {
                gaps.iter().for_each(|g| fill(values, *g, true));
                Became::Interpolated
            }
            Action::Hold => {
                gaps.iter().for_each(|g| fill(values, *g, false));
                Became::Held
            }
            Action::Replace => {
                f.rows.iter().zip(&f.expected).for_each(|(t, v)| values[*t] = *v);
                Became::Replaced
            }
            Action::Mark => Became::Missing,
            Action::Split => Became::CutOut,
        };
        let effect = Effect::Samples { runs: gaps.clone(), became };
        outcome.changes.push(change(&record, Some(f.channel), effect));
        places.push(gaps);
    }
    let out = match action {
        Action::Split => union(n, &places.iter().map(Vec::as_slice).collect::<Vec<_>>()),
        _ => Vec::new(),
    };
    split(record, &out, least, outcome);
}

/// Fills a gap from the known samples around it: on the line between them, or with the one before. At an end of the
/// record the only neighbour is taken.
pub(super) fn fill(values: &mut [f64], gap: Gap, line: bool) {
    let before = (0..gap.from).rev().find(|t| !values[*t].is_nan());
    let after = (gap.to..values.len()).find(|t| !values[*t].is_nan());
    for t in gap.from..gap.to {
        values[t] = match (before, after) {
            (Some(a), Some(b)) if line => {
                values[a] + (values[b] - values[a]) * (t - a) as f64 / (b - a) as f64
            }
            (Some(a), _) => values[a],
            (None, Some(b)) => values[b],
            (None, None) => f64::NAN,
        };
    }
}
