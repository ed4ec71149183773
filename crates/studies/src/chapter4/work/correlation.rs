//! Correlation between the signals of a kind, thesis eq. (2.45) and Table 4.10.

use dynocal_numerics::linalg::dot;
use serde::{Deserialize, Serialize};

use super::source::{Record, Source};
use super::{Chapter4Error, SAMPLES, library::Library};

/// Mean absolute correlation of all pairs of signals of a kind, per input channel.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Correlations {
    /// Kind.
    pub source: Source,
    /// Number of signals.
    pub n: usize,
    /// Mean and standard error per channel (u1, u2, u3).
    pub mean_se: Vec<(f64, f64)>,
}

/// Mean absolute correlation of the validation signals of a kind.
///
/// Independent signals of N samples have `E |r| = sqrt(2 / (pi (N - 1)))` about, 0.080 for N = 100: correlation is never
/// zero in a finite record.
///
/// # Errors
/// [`Chapter4Error`] of a design.
///
/// ```
/// use dynocal_studies::chapter4::work::correlation::correlations;
/// use dynocal_studies::chapter4::work::library::Library;
/// use dynocal_studies::chapter4::work::{Size, source::Source};
/// let library = Library::new(Size { identification: 2, validation: 60, designed: 0, seed: 1 })?;
/// let found = correlations(&library, Source::Udrn, &|| false)?;
/// assert!(found.mean_se.iter().all(|(mean, se)| (mean - 0.080).abs() < 4.0 * se + 1e-3));
/// # Ok::<(), dynocal_studies::chapter4::work::Chapter4Error>(())
/// ```
pub fn correlations(
    library: &Library,
    source: Source,
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Result<Correlations, Chapter4Error> {
    let records = library.validation(source, interrupt)?;
    let channels = library.setting.channels.len();
    let mean_se = (0..channels).map(|i| mean_absolute(&records, i, channels)).collect();
    Ok(Correlations { source, n: records.len(), mean_se })
}

/// Mean over all pairs; the error from the means of each signal with the others, every signal being in many pairs.
fn mean_absolute(records: &[Record], channel: usize, channels: usize) -> (f64, f64) {
    let n = records.len();
    let unit: Vec<Vec<f64>> = records.iter().map(|r| normalised(&r.u, channel, channels)).collect();
    let of_one = |i: usize| {
        (0..n).filter(|j| *j != i).map(|j| dot(&unit[i], &unit[j]).abs()).sum::<f64>() / (n - 1) as f64
    };
    let means: Vec<f64> = (0..n).map(of_one).collect();
    let mean = means.iter().sum::<f64>() / n as f64;
    let variance = means.iter().map(|m| (m - mean).powi(2)).sum::<f64>() / (n as f64 - 1.0);
    // The mean of a symmetric function of pairs varies twice as much as that of its one-signal means.
    (mean, 2.0 * (variance / n as f64).sqrt())
}

/// The channel about its mean with unit norm; zeros for a constant.
fn normalised(u: &[f64], channel: usize, channels: usize) -> Vec<f64> {
    let mut v: Vec<f64> = (0..SAMPLES).map(|t| u[t * channels + channel]).collect();
    let mean = v.iter().sum::<f64>() / v.len() as f64;
    v.iter_mut().for_each(|x| *x -= mean);
    let norm = dot(&v, &v).sqrt();
    if norm > 0.0 {
        v.iter_mut().for_each(|x| *x /= norm);
    }
    v
}
