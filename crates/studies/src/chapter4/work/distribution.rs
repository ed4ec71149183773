//! Figure 4.16: the distribution of an estimate over repeated experiments, against the Cramer-Rao bound.

use dynocal_numerics::rng::Rng64;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::library::Library;
use super::models::{estimate, noisy, told, truth};
use super::source::Source;
use super::statistics::Stat;
use super::{Chapter4Error, Output};

/// Torque noise variance of section 4.7.
const NOISE: f64 = 80.0;

/// Estimates of theta_1 of the torque model from repeated experiments with one signal.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Distribution {
    /// Kind of the signal.
    pub source: Source,
    /// Estimates.
    pub estimates: Vec<f64>,
    /// Their statistics.
    pub stat: Option<Stat>,
    /// Standard deviation over the experiments.
    pub deviation: f64,
    /// Lower bound of the standard deviation of an unbiased estimate.
    pub bound: f64,
}

/// Repeats the experiment with the first signal of a kind `n` times, new noise each time.
///
/// Least squares with the measured z(t-10) as a regressor is neither unbiased nor does it use the model of the noise,
/// so that the deviation may lie on either side of the bound.
///
/// # Errors
/// [`Chapter4Error`].
pub fn distribution(
    library: &Library,
    source: Source,
    n: usize,
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Result<Distribution, Chapter4Error> {
    let (setting, seed) = (&library.setting, library.size.seed);
    let records = library.identification(source, interrupt)?;
    let record = &records[..1];
    let told = told(setting, Output::Torque, record)?;
    let (y, _) = truth(setting, Output::Torque, &record[0].u)?;
    let one = |k: usize| -> Result<f64, Chapter4Error> {
        let mut rng = Rng64::stream(seed, 7 << 40 | source.number() << 32 | k as u64);
        let data = [noisy(&y, &record[0].u, NOISE, &mut rng)];
        Ok(estimate(setting, Output::Torque, &data, told[0].bounds.is_none())?[0])
    };
    let estimates = (0..n).into_par_iter().map(one).collect::<Result<Vec<f64>, _>>()?;
    let stat = Stat::of(&estimates);
    Ok(Distribution {
        source,
        deviation: stat.map_or(f64::NAN, |s| s.se * (s.n as f64).sqrt()),
        stat,
        bound: told[0].bounds.as_ref().map_or(f64::NAN, |b| b[0]),
        estimates,
    })
}
