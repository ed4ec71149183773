//! The known system (5.3) with the parameters (5.4) and records of it within (5.5).

use std::path::Path;

use dynocal_files::csv_io;
use dynocal_files::table::Table;
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::literature::{LiteratureModel, torque_5_3};
use dynocal_ident::model::{Model, Run};
use dynocal_numerics::rng::Rng64;
use serde::{Deserialize, Serialize};

use super::{Chapter5Error, udrn};

/// Samples of every record.
pub const SAMPLES: usize = 1000;
/// Range and hold time in samples of each input: bleed valve (fraction), spark (deg), speed (rpm), eq. (5.5).
pub const INPUTS: [(f64, f64, usize); 3] = [(0.42, 0.50, 10), (16.0, 34.0, 10), (1000.0, 1800.0, 100)];

/// The identification record of the reference data, as the tests have it.
const STORED: &str = include_str!("../../../../../tests/reference/ch5_ident.csv");

/// Where the noise of variance 0.5 enters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Noise {
    /// `z = y + e`, y the free run: eq. (5.3) as printed.
    Output,
    /// `z(t) = f(z, u) + e(t)`: the noise goes through the system.
    Equation,
}

/// A record with its output before the noise.
#[derive(Clone, Debug)]
pub struct Record {
    /// Inputs and noisy output.
    pub experiment: Experiment,
    /// Free run of the true system, N.
    pub noise_free: Vec<f64>,
}

/// A record of fresh uniform random inputs and noise; equal for equal (`seed`, `stream`). It begins in equilibrium.
///
/// # Errors
/// [`Chapter5Error::Build`], never for the ranges of this file.
///
/// ```
/// use dynocal_studies::chapter5::work::known::{Noise, record};
/// let r = record(Noise::Output, 1, 0)?;
/// let n = r.noise_free.len() as f64;
/// let variance = r.experiment.y.iter().zip(&r.noise_free).map(|(z, y)| (z - y).powi(2)).sum::<f64>() / n;
/// // 1000 squares of normal numbers: 0.5 with a standard error of 0.022.
/// assert!((variance - 0.5).abs() < 0.1);
/// # Ok::<(), dynocal_studies::chapter5::work::Chapter5Error>(())
/// ```
pub fn record(noise: Noise, seed: u64, stream: u64) -> Result<Record, Chapter5Error> {
    let system = torque_5_3();
    let mut rng = Rng64::stream(seed, stream);
    let mut columns = Vec::new();
    for (lo, hi, hold) in INPUTS {
        let dt_s = system.sample_time_s;
        columns.push(udrn((lo, hi), hold as f64 * dt_s, SAMPLES, dt_s, &mut rng)?);
    }
    let u: Vec<f64> = (0..SAMPLES).flat_map(|t| columns.iter().map(move |c| c[t])).collect();
    let deviation = system.noise_variance.sqrt();
    let e: Vec<f64> = (0..SAMPLES).map(|_| deviation * rng.normal()).collect();
    let noise_free = free_run(&system, &u);
    let y = match noise {
        Noise::Output => noise_free.iter().zip(&e).map(|(y, e)| y + e).collect(),
        Noise::Equation => through_equation(&system, &u, &noise_free, &e),
    };
    let experiment = experiment(format!("seed {seed}, record {stream}"), u, y);
    Ok(Record { experiment, noise_free })
}

/// The stored record on which the reference numbers were computed.
///
/// # Errors
/// [`Chapter5Error::Files`] when the stored text is damaged.
pub fn stored() -> Result<Record, Chapter5Error> {
    of_table(&csv_io::parse("ch5_ident.csv", STORED.as_bytes())?)
}

/// A record of the reference data: columns `u1_fraction`, `u2_deg`, `u3_rpm`, `y_noise_free`, `z`.
///
/// # Errors
/// [`Chapter5Error::Files`] with what is wrong in the file.
pub fn read(path: &Path) -> Result<Record, Chapter5Error> {
    of_table(&csv_io::read(path)?)
}

fn of_table(table: &Table) -> Result<Record, Chapter5Error> {
    let n = table.rows();
    let column = |name: &str| table.numbers(name, 0, n);
    let inputs = [column("u1_fraction")?, column("u2_deg")?, column("u3_rpm")?];
    let u = (0..n).flat_map(|t| inputs.iter().map(move |c| c[t])).collect();
    let experiment = experiment(table.file.clone(), u, column("z")?.to_vec());
    Ok(Record { experiment, noise_free: column("y_noise_free")?.to_vec() })
}

fn experiment(name: String, u: Vec<f64>, y: Vec<f64>) -> Experiment {
    Experiment { name, u, y, init_samples: 0, weights: Vec::new() }
}

/// Free run of the true system from the equilibrium of its first inputs.
fn free_run(system: &LiteratureModel, u: &[f64]) -> Vec<f64> {
    let start = system.model.max_lag();
    let held: Vec<f64> = (0..=start).flat_map(|_| u[..INPUTS.len()].iter().copied()).collect();
    // One step is affine in an output that is held too: f(y) = f(0) + (f(1) - f(0)) y, at rest f(y) = y.
    let mut next = vec![0.0; start + 1];
    let mut step = |y: f64| {
        let run = Run { u: &held, y: &vec![y; start + 1], start };
        system.model.predict(&system.theta, &run, &mut next);
        next[start]
    };
    let (at_zero, at_one) = (step(0.0), step(1.0));
    let rest = vec![at_zero / (1.0 - (at_one - at_zero)); SAMPLES];
    let mut y = vec![0.0; SAMPLES];
    system.model.simulate(&system.theta, &Run { u, y: &rest, start }, &mut y);
    y
}

/// `z(t) = f(z, u) + e(t)` from the equilibrium.
fn through_equation(system: &LiteratureModel, u: &[f64], noise_free: &[f64], e: &[f64]) -> Vec<f64> {
    let (start, m) = (system.model.max_lag(), INPUTS.len());
    let mut z = noise_free.to_vec();
    let mut next = vec![0.0; start + 1];
    for t in start..z.len() {
        let window = Run { u: &u[(t - start) * m..(t + 1) * m], y: &z[t - start..=t], start };
        system.model.predict(&system.theta, &window, &mut next);
        z[t] = next[start] + e[t];
    }
    z
}
