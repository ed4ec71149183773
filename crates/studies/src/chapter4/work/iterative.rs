//! Iterative design (thesis Figure 4.2 and Table 4.8): design, measure, estimate, and again with the new estimate.

use dynocal_design::problem::Term;
use dynocal_design::search::DesignOptions;
use dynocal_ident::model::Model;
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::status::Status;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::models::{estimate, noisy, relative_error, truth};
use super::source::{DesignCriterion, problem};
use super::statistics::Stat;
use super::{Chapter4Error, Output, Setting, Size};

/// Torque noise variance of the example.
const NOISE: f64 = 80.0;
/// Iterations of Table 4.8.
pub const ITERATIONS: usize = 5;
/// Evaluations per design: enough for a local optimum, and hundreds of designs are made.
const EVALUATIONS: usize = 600;

/// The estimate from a UDRN test that the thesis prints and starts from.
pub const FIRST_ESTIMATE: [f64; 23] = [
    74.25, -0.031, 0.068, 7.59e-7, 2.80e-6, -0.00466, 2.05e-6, 1.63e-6, -195.34, -0.019, -1.35e-5, 2.67e-7,
    0.014, -0.015, 9.4e-6, -3.24e-6, 0.0057, 5.53e-6, -1.47e-6, 0.0017, 5.65e-7, -1.30e-6, 0.11,
];

/// What an iteration makes of earlier records.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Use {
    /// The estimate is made from the latest record alone.
    Fresh,
    /// The estimate is made from all records; each design stands alone.
    Pooled,
    /// The same, and each design adds to what the earlier records tell.
    Informed,
}

impl Use {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Pooled, Self::Informed, Self::Fresh];
}

/// Mean relative error of the parameters from iteration to iteration.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Iterations {
    /// What it makes of earlier records.
    pub data: Use,
    /// Initial state, then after each iteration.
    pub error: Vec<Option<Stat>>,
}

/// Repeats the D-optimal iteration of Table 4.8 from its printed first estimate, `size.identification` times.
///
/// # Errors
/// [`Chapter4Error`].
///
/// ```
/// use dynocal_studies::chapter4::work::iterative::{Use, iterate};
/// use dynocal_studies::chapter4::work::{Setting, Size};
/// let size = Size { identification: 3, validation: 0, designed: 0, seed: 1 };
/// let found = iterate(&Setting::new()?, Use::Pooled, size, &|| false)?;
/// let mean = |k: usize| found.error[k].as_ref().map(|s| s.mean).unwrap();
/// assert!((mean(0) - 2.08).abs() < 0.01 && mean(5) < mean(1));
/// # Ok::<(), dynocal_studies::chapter4::work::Chapter4Error>(())
/// ```
pub fn iterate(
    setting: &Setting,
    data: Use,
    size: Size,
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Result<Iterations, Chapter4Error> {
    let runs = (0..size.identification)
        .into_par_iter()
        .map(|k| one(setting, data, size.seed, k as u64, interrupt))
        .collect::<Result<Vec<Vec<f64>>, _>>()?;
    let error = (0..=ITERATIONS)
        .map(|i| {
            let values: Vec<f64> = runs.iter().map(|r| r[i]).collect();
            // The initial state is one number for all runs.
            if i == 0 { constant(&values) } else { Stat::of(&values) }
        })
        .collect();
    Ok(Iterations { data, error })
}

fn constant(values: &[f64]) -> Option<Stat> {
    values.first().map(|&v| Stat { n: values.len(), mean: v, se: 0.0, median: v, low: v, high: v })
}

/// Errors of one run: initial, then after each iteration.
fn one(
    setting: &Setting,
    data: Use,
    seed: u64,
    k: u64,
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Result<Vec<f64>, Chapter4Error> {
    let mut theta = FIRST_ESTIMATE.to_vec();
    let mut errors = vec![relative_error(setting, Output::Torque, &theta)];
    let mut records = Vec::new();
    for i in 0..ITERATIONS as u64 {
        let earlier: Vec<Vec<f64>> = match data {
            Use::Informed => records.iter().map(|r: &Measured| r.u.clone()).collect(),
            _ => Vec::new(),
        };
        // Starts and noise are those of the run and the iteration, whatever is made of the data.
        let number = seed.wrapping_add(1000 * (k + 1)).wrapping_add(i);
        let u = next_record(setting, &theta, &earlier, number, interrupt)?;
        let (y, _) = truth(setting, Output::Torque, &u)?;
        let mut rng = Rng64::stream(seed, 6 << 40 | k << 8 | i);
        let experiment = noisy(&y, &u, NOISE, &mut rng);
        if data == Use::Fresh {
            records.clear();
        }
        records.push(Measured { u, experiment });
        let pooled: Vec<_> = records.iter().map(|r| r.experiment.clone()).collect();
        theta = estimate(setting, Output::Torque, &pooled, false)?;
        errors.push(relative_error(setting, Output::Torque, &theta));
    }
    Ok(errors)
}

struct Measured {
    u: Vec<f64>,
    experiment: dynocal_ident::experiment::Experiment,
}

/// A D-optimal record at `theta`, given what the `earlier` records tell.
fn next_record(
    setting: &Setting,
    theta: &[f64],
    earlier: &[Vec<f64>],
    seed: u64,
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Result<Vec<f64>, Chapter4Error> {
    let d = DesignCriterion::D.build()?;
    let model: &dyn Model = &setting.torque.model;
    let mut prior = Vec::new();
    for u in earlier {
        let convention = dynocal_design::problem::Convention::Trim;
        let s = dynocal_design::information::sensitivities(
            model,
            theta,
            u,
            setting.channels.len(),
            convention,
            super::START,
            0.0,
        )
        .map_err(|_| Chapter4Error::Diverged { model: "estimated torque model" })?;
        prior.extend(s);
    }
    let term = Term { prior: &prior, ..Term::new("torque", model, theta, NOISE, d.as_ref()) };
    let options = DesignOptions { seed, evaluations: EVALUATIONS, ..DesignOptions::default() };
    let found = dynocal_design::search::design(&problem(setting, vec![term]), &options, interrupt, &|_| {})?;
    match found.status {
        Status::Interrupted => Err(Chapter4Error::Interrupted),
        _ => Ok(found.u),
    }
}
