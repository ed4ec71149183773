//! How errors of 1 / lambda count.

use super::follow::pressure;
use super::record::TransientRecord;
use super::{length, residual, unexplained};
use crate::fuelling::Fuelling;

/// Errors beyond this count less and less while models are chosen.
const ROBUST: f64 = 0.05;
/// The last fits take less and less of errors beyond so many standard deviations of what is left (by its median), as no model of mean
/// values has the first cycles of a large step, and beyond this at least.
const DEVIATIONS: f64 = 5.0;
const LEAST: f64 = 1e-3;

/// c asinh(e / c): large errors by their logarithm.
#[derive(Clone, Copy)]
pub(super) struct Loss {
    beyond: f64,
}

impl Loss {
    /// While models are chosen.
    pub(super) const CHOOSING: Self = Self { beyond: ROBUST };

    /// By what a model leaves of the records.
    pub(super) fn of_left(records: &[TransientRecord<'_>], f: &Fuelling) -> Self {
        let mut sizes: Vec<f64> =
            records.iter().flat_map(|r| residual(r, f).0).map(f64::abs).filter(|e| e.is_finite()).collect();
        sizes.sort_unstable_by(f64::total_cmp);
        // Median of the size of a normal variable over its standard deviation.
        let deviation = sizes.get(sizes.len() / 2).map_or(ROBUST, |e| e / 0.6745);
        Self { beyond: (DEVIATIONS * deviation).clamp(LEAST, ROBUST) }
    }

    /// What an error counts as.
    pub(super) fn of(self, error: f64) -> f64 {
        self.beyond * (error / self.beyond).asinh()
    }

    /// Its derivative.
    pub(super) fn slope(self, error: f64) -> f64 {
        let e = error / self.beyond;
        1.0 / (1.0 + e * e).sqrt()
    }

    /// Root of the mean square of what the errors of 1 / lambda of a model count as, with weights of the samples if there are any.
    pub(super) fn rms(self, records: &[TransientRecord<'_>], f: &Fuelling, weights: &[f64]) -> f64 {
        let pressures: Vec<Vec<f64>> = records.iter().map(|r| pressure(r, f)).collect();
        let mut errors = vec![0.0; length(records)];
        unexplained(records, &pressures, f, self, &mut errors);
        errors.iter_mut().zip(weights).for_each(|(e, w)| *e *= w);
        (errors.iter().map(|e| e * e).sum::<f64>() / errors.len().max(1) as f64).sqrt()
    }
}
