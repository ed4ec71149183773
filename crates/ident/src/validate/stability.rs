//! Stability of the free run: on records, and on random inputs within the limits of what was identified.
//!
//! A model may predict one step well and still run away where the record was quiet. Here it runs on inputs that jump at
//! random between random levels within the range of every channel, from measured initial outputs of random places.

use dynocal_numerics::rng::Rng64;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::data::DataError;
use crate::experiment::Experiment;
use crate::model::usable_samples;
use crate::model::{Model, Run};

/// What is tried.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Trials {
    /// Random runs.
    pub runs: usize,
    /// Samples of each.
    pub samples: usize,
    /// Longest hold of a level, in samples; holds are drawn evenly on a logarithmic scale from 1.
    pub longest_hold: usize,
    /// A run counts as diverged when it leaves the range of the measured output by more than this many ranges.
    pub beyond: f64,
    /// Seed.
    pub seed: u64,
}

impl Default for Trials {
    fn default() -> Self {
        Self { runs: 200, samples: 1000, longest_hold: 200, beyond: 10.0, seed: 0 }
    }
}

/// How the free runs went.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Stability {
    /// Names of the records whose free run diverged.
    pub diverged_records: Vec<String>,
    /// Largest excursion over the records, in ranges of the measured output beyond that range; 0 within it.
    pub records_excursion: f64,
    /// Random runs.
    pub runs: usize,
    /// Share of them that diverged.
    pub share_diverged: f64,
    /// Largest excursion of those that did not.
    pub largest_excursion: f64,
}

/// Range of a channel over all records.
fn range(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let finite = values.filter(|v| v.is_finite());
    finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), v| (lo.min(v), hi.max(v)))
}

/// Free runs of the model over the records and over random inputs. `identified` are the records whose ranges are the limits
/// and whose outputs are the starts; `held_out` the records that are run as they are.
///
/// # Errors
/// [`DataError`] when a record is too short for the model or has other inputs.
pub fn free_run_stability(
    model: &dyn Model,
    theta: &[f64],
    identified: &[Experiment],
    held_out: &[Experiment],
    trials: &Trials,
) -> Result<Stability, DataError> {
    if identified.is_empty() {
        let (record, why) = ("identification".into(), "no record gives the limits".into());
        return Err(DataError::TooShort { record, found: 0, expected: 1, why });
    }
    for part in [identified, held_out] {
        match usable_samples(model, part) {
            // Fewer samples than parameters are no fault here.
            Err(DataError::TooShort { .. }) if part.iter().all(|e| e.len() > e.first(model)) => {}
            other => drop(other?),
        }
    }
    let m = model.n_inputs();
    let limits: Vec<(f64, f64)> = (0..m)
        .map(|i| range(identified.iter().flat_map(|e| e.u.iter().skip(i).step_by(m).copied())))
        .collect();
    let output = range(identified.iter().flat_map(|e| e.y.iter().copied()));
    let judge = |run: &Run| -> Option<f64> {
        let mut y = vec![0.0; run.len()];
        model.simulate(theta, run, &mut y);
        let excursion = excursion(&y[run.start.min(y.len())..], output);
        (excursion <= trials.beyond).then_some(excursion)
    };
    let records: Vec<Option<f64>> = held_out.par_iter().map(|e| judge(&e.run(model))).collect();
    let random: Vec<Option<f64>> = (0..trials.runs)
        .into_par_iter()
        .map(|k| {
            let mut rng = Rng64::stream(trials.seed, k as u64);
            let (u, y, start) = random_run(model, identified, &limits, trials, &mut rng);
            judge(&Run { u: &u, y: &y, start })
        })
        .collect();
    let largest = |runs: &[Option<f64>]| runs.iter().flatten().copied().fold(0.0, f64::max);
    let diverged = random.iter().filter(|r| r.is_none()).count();
    let names = held_out.iter().zip(&records).filter(|(_, r)| r.is_none());
    Ok(Stability {
        diverged_records: names.map(|(e, _)| e.name.clone()).collect(),
        records_excursion: largest(&records),
        runs: trials.runs,
        share_diverged: diverged as f64 / trials.runs.max(1) as f64,
        largest_excursion: largest(&random),
    })
}

/// How far a run leaves a range, in units of that range; NaN when it is not finite.
fn excursion(y: &[f64], (lo, hi): (f64, f64)) -> f64 {
    let width = if hi > lo { hi - lo } else { hi.abs().max(1.0) };
    y.iter().fold(0.0, |worst: f64, v| {
        let out = (v - hi).max(lo - v).max(0.0) / width;
        if v.is_finite() && !worst.is_nan() { worst.max(out) } else { f64::NAN }
    })
}

/// Inputs that jump at random within the limits; initial outputs and their inputs from a random place of a record.
fn random_run(
    model: &dyn Model,
    identified: &[Experiment],
    limits: &[(f64, f64)],
    trials: &Trials,
    rng: &mut Rng64,
) -> (Vec<f64>, Vec<f64>, usize) {
    let (m, lag) = (limits.len(), model.max_lag());
    let n = lag + trials.samples.max(1);
    let (mut u, mut y) = (vec![0.0; n * m], vec![0.0; n]);
    let longest = (trials.longest_hold.max(1) as f64).ln();
    for (i, &(lo, hi)) in limits.iter().enumerate() {
        let mut t = 0;
        while t < n {
            let hold = (rng.uniform_in(0.0, longest).exp().round() as usize).max(1);
            let level = if hi > lo { rng.uniform_in(lo, hi) } else { lo };
            let to = (t + hold).min(n);
            (t..to).for_each(|t| u[t * m + i] = level);
            t = to;
        }
    }
    let e = &identified[rng.below(identified.len())];
    let from = rng.below(e.len() - lag);
    y[..lag].copy_from_slice(&e.y[from..from + lag]);
    u[..lag * m].copy_from_slice(&e.u[from * m..(from + lag) * m]);
    (u, y, lag)
}
