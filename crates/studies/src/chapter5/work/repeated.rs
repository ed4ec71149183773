//! Both estimators on many records of the known system: which error is the smaller, on average.

use dynocal_ident::estimate::ols::Ols;
use dynocal_ident::estimate::sem::Sem;
use dynocal_ident::estimate::{Estimator, Fit};
use dynocal_ident::model::literature::torque_5_3;
use dynocal_ident::validate::{Kind, Seen, score_noise_free};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::known::{Noise, Record, record};
use super::{Chapter5Error, Fitness};

/// Records that judge, on streams after those that identify.
const UNSEEN: u64 = 10;

/// What an estimator reached on one identification record.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Reached {
    /// One-step error on that record.
    pub one_step: Fitness,
    /// Free-run error on that record, against the noisy output.
    pub free_run: Fitness,
    /// Free-run error on that record, mean square against the output without noise.
    pub to_noise_free: f64,
    /// Mean square of the same over ten unseen records.
    pub unseen_to_noise_free: f64,
    /// Mean square of the one-step error over ten unseen records, against the noisy output.
    pub unseen_one_step: f64,
    /// What the estimator warned of.
    pub warnings: Vec<String>,
}

/// Both estimators on the same record.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Pair {
    /// Least squares (PEM).
    pub ols: Reached,
    /// Simulation error.
    pub sem: Reached,
    /// Free-run MSE on the identification record of the least-squares parameters rounded as printed in (5.6).
    pub ols_rounded: f64,
}

/// Both estimators on `repeats` records with noise where `noise` says, inputs and noise new each time.
///
/// # Errors
/// [`Chapter5Error`].
///
/// ```
/// use dynocal_studies::chapter5::work::known::Noise;
/// use dynocal_studies::chapter5::work::repeated::{mean, repeat};
/// let pairs = repeat(Noise::Output, 3, 1, &|| false)?;
/// let (ols, sem) = (mean(&pairs, |p| p.ols.to_noise_free), mean(&pairs, |p| p.sem.to_noise_free));
/// assert!(sem < ols, "output error is the model of the simulation error");
/// # Ok::<(), dynocal_studies::chapter5::work::Chapter5Error>(())
/// ```
pub fn repeat(
    noise: Noise,
    repeats: u64,
    seed: u64,
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Result<Vec<Pair>, Chapter5Error> {
    let unseen: Vec<Record> =
        (0..UNSEEN).map(|k| record(noise, seed, repeats + k)).collect::<Result<_, _>>()?;
    let one = |k: u64| -> Result<Pair, Chapter5Error> {
        if interrupt() {
            return Err(Chapter5Error::Interrupted);
        }
        let identification = record(noise, seed, k)?;
        let data = std::slice::from_ref(&identification.experiment);
        let model = torque_5_3().model;
        let ols = Ols::default().estimate(&model, data, None, &|| interrupt())?;
        let sem = Sem::default().estimate(&model, data, None, &|| interrupt())?;
        let rounded = Fitness::of(&model, &as_printed(&ols.theta), &data[0], Kind::FreeRun);
        Ok(Pair {
            ols: reached(ols, &identification, &unseen),
            sem: reached(sem, &identification, &unseen),
            ols_rounded: rounded.mse,
        })
    };
    (0..repeats).into_par_iter().map(one).collect::<Vec<_>>().into_iter().collect()
}

/// Decimals of the parameters in (5.6).
const DECIMALS: [i32; 12] = [2, 1, 2, 2, 3, 4, 3, 3, 2, 2, 2, 2];

fn as_printed(theta: &[f64]) -> Vec<f64> {
    theta.iter().zip(DECIMALS).map(|(v, d)| (v * 10f64.powi(d)).round() / 10f64.powi(d)).collect()
}

fn reached(fit: Fit, identification: &Record, unseen: &[Record]) -> Reached {
    let model = torque_5_3().model;
    let theta = &fit.theta;
    let to_noise_free = |r: &Record| {
        let data = std::slice::from_ref(&r.experiment);
        score_noise_free(&model, theta, data, &[&r.noise_free], Kind::FreeRun, Seen::Unseen).mse
    };
    let of = |r: &Record, kind| Fitness::of(&model, theta, &r.experiment, kind);
    let n = unseen.len() as f64;
    Reached {
        one_step: of(identification, Kind::OneStep),
        free_run: of(identification, Kind::FreeRun),
        to_noise_free: to_noise_free(identification),
        unseen_to_noise_free: unseen.iter().map(to_noise_free).sum::<f64>() / n,
        unseen_one_step: unseen.iter().map(|r| of(r, Kind::OneStep).mse).sum::<f64>() / n,
        warnings: fit.warnings,
    }
}

/// Mean of a number over the records.
pub fn mean(pairs: &[Pair], f: impl Fn(&Pair) -> f64) -> f64 {
    pairs.iter().map(f).sum::<f64>() / pairs.len() as f64
}
