//! Models from noisy records, and their scores on unseen noisy records.

use dynocal_design::information::{Report, report};
use dynocal_ident::estimate::Estimator;
use dynocal_ident::estimate::ols::Ols;
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::{Model, Run};
use dynocal_ident::validate::{Kind, Reference, Seen, output, score_values};
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::status::Status;
use rayon::prelude::*;

use super::source::Record;
use super::statistics::crossed;
use super::{Chapter4Error, Output, SAMPLES, START, Setting};

/// Ridge of the minimum-norm estimate, relative to the squared rms of a column: its limit to zero is the solution of
/// least norm with columns of unit rms, and the directions that are seen have squared singular values above 1e-6.
const LEAST_NORM_RIDGE: f64 = 1e-13;

/// Output of the known model, rows before the start zero, and its sensitivities from the start on.
pub(super) fn truth(
    setting: &Setting,
    output: Output,
    u: &[f64],
) -> Result<(Vec<f64>, Vec<f64>), Chapter4Error> {
    let m = setting.model(output);
    let p = m.model.n_params();
    let zeros = vec![0.0; SAMPLES];
    let run = Run { u, y: &zeros, start: START };
    let (mut y, mut s) = (vec![0.0; SAMPLES], vec![0.0; SAMPLES * p]);
    match m.model.sensitivities(&m.theta, &run, &mut y, &mut s) {
        Status::Converged => Ok((y, s.split_off(START * p))),
        _ => Err(Chapter4Error::Diverged { model: m.source }),
    }
}

/// What a signal tells about the parameters of an output.
pub(super) struct Told {
    pub(super) rank: usize,
    /// Lower bounds of the standard deviations of the parameters; none where the information is singular.
    pub(super) bounds: Option<Vec<f64>>,
}

/// What each record tells.
pub(super) fn told(
    setting: &Setting,
    output: Output,
    records: &[Record],
) -> Result<Vec<Told>, Chapter4Error> {
    let m = setting.model(output);
    let one = |r: &Record| -> Result<Told, Chapter4Error> {
        let (_, s) = truth(setting, output, &r.u)?;
        Ok(match report(&m.model, &s, m.noise_variance, &[]) {
            Report::Regular(r) => Told { rank: m.model.n_params(), bounds: Some(r.crlb_std) },
            Report::Singular(s) => Told { rank: s.rank, bounds: None },
        })
    };
    records.par_iter().map(one).collect()
}

/// A noisy record: outputs of the known model and white noise of the variance at every sample.
pub(super) fn noisy(y: &[f64], u: &[f64], noise: f64, rng: &mut Rng64) -> Experiment {
    let deviation = noise.sqrt();
    Experiment {
        name: String::new(),
        u: u.to_vec(),
        y: y.iter().map(|v| v + deviation * rng.normal()).collect(),
        init_samples: START,
        weights: Vec::new(),
    }
}

/// Least squares with the measured z(t-10) as a regressor; of least norm where the data are singular.
pub(super) fn estimate(
    setting: &Setting,
    output: Output,
    data: &[Experiment],
    singular: bool,
) -> Result<Vec<f64>, Chapter4Error> {
    let ridge = if singular { LEAST_NORM_RIDGE } else { 0.0 };
    let model = &setting.model(output).model;
    Ok(Ols { ridge, ..Ols::default() }.estimate(model, data, None, &|| false)?.theta)
}

/// One model from each record; noise from streams that count on from `stream`.
pub(super) fn identify(
    setting: &Setting,
    output: Output,
    noise: f64,
    records: &[Record],
    told: &[Told],
    (seed, stream): (u64, u64),
) -> Result<Vec<Vec<f64>>, Chapter4Error> {
    let one = |(k, r): (usize, &Record)| -> Result<Vec<f64>, Chapter4Error> {
        let (y, _) = truth(setting, output, &r.u)?;
        let data = [noisy(&y, &r.u, noise, &mut Rng64::stream(seed, stream + k as u64))];
        estimate(setting, output, &data, told[k].bounds.is_none())
    };
    records.par_iter().enumerate().map(one).collect()
}

/// Mean over the parameters of `|estimate - true| / |true|` (eq. 4.37 read as a mean).
pub(super) fn relative_error(setting: &Setting, output: Output, found: &[f64]) -> f64 {
    let theta = &setting.model(output).theta;
    found.iter().zip(theta).map(|(f, t)| ((f - t) / t).abs()).sum::<f64>() / theta.len() as f64
}

/// A validation record with its output before the noise.
pub(super) struct Unseen {
    pub(super) experiment: Experiment,
    pub(super) noise_free: Vec<f64>,
}

/// Validation records: the same for every kind of identification signal, so that kinds are compared in pairs.
pub(super) fn unseen(
    setting: &Setting,
    output: Output,
    noise: f64,
    records: &[Record],
    (seed, stream): (u64, u64),
) -> Result<Vec<Unseen>, Chapter4Error> {
    let one = |(k, r): (usize, &Record)| -> Result<Unseen, Chapter4Error> {
        let (y, _) = truth(setting, output, &r.u)?;
        let mut rng = Rng64::stream(seed, stream + k as u64);
        Ok(Unseen { experiment: noisy(&y, &r.u, noise, &mut rng), noise_free: y })
    };
    records.iter().enumerate().map(one).collect()
}

/// Free-run scores of all models on all validation records.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scored {
    /// Mean R2 in percent against noisy outputs, and its standard error.
    pub(super) r2: (f64, f64),
    /// Mean R2 in percent against outputs without noise.
    pub(super) r2_noise_free: f64,
    /// Root mean square error against outputs without noise, mean over the pairs and standard error.
    pub(super) rmse: (f64, f64),
}

/// Scores `models` on `unseen`, over t = 11..100.
pub(super) fn validate(setting: &Setting, of: Output, models: &[Vec<f64>], unseen: &[Unseen]) -> Scored {
    let model = &setting.model(of).model;
    let score = |z: &[f64], y: &[f64], reference| {
        score_values(&z[START..], &y[START..], Kind::FreeRun, Seen::Unseen, reference)
    };
    let pairs: Vec<[f64; 3]> = models
        .par_iter()
        .flat_map_iter(|theta| {
            unseen.iter().map(|v| {
                let y = output(model, theta, &v.experiment, Kind::FreeRun);
                let free = score(&v.noise_free, &y, Reference::NoiseFree);
                [100.0 * score(&v.experiment.y, &y, Reference::Noisy).r2, 100.0 * free.r2, free.rmse]
            })
        })
        .collect();
    let of = |k: usize| crossed(&pairs.iter().map(|p| p[k]).collect::<Vec<f64>>(), unseen.len());
    Scored { r2: of(0), r2_noise_free: of(1).0, rmse: of(2) }
}
