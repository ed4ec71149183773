//! What a kind of signal is worth: criteria, models identified with it, and their scores on unseen signals.

use dynocal_design::information::{Report, report};
use dynocal_design::problem::Evaluator;
use dynocal_ident::estimate::Estimator;
use dynocal_ident::estimate::ols::Ols;
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::Model;
use dynocal_ident::validate::{Kind, Reference, Seen, output, score_values};
use dynocal_numerics::rng::Rng64;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::source::{DesignCriterion, Record, Source, problem, signals, term};
use super::statistics::{Stat, crossed, median};
use super::{Chapter4Error, Output, SAMPLES, START, Setting};

/// Ridge of the minimum-norm estimate, relative to the squared rms of a column: its limit to zero is the solution of
/// least norm with columns of unit rms, and the directions that are seen have squared singular values above 1e-6.
const LEAST_NORM_RIDGE: f64 = 1e-13;

/// How large a population is.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Size {
    /// Identification signals.
    pub identification: usize,
    /// Validation signals of each kind.
    pub validation: usize,
    /// Seed of all random numbers.
    pub seed: u64,
}

/// Statistics of one criterion.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct CriterionStat {
    /// Model.
    pub output: Output,
    /// Criterion.
    pub criterion: DesignCriterion,
    /// None where the information is singular.
    pub stat: Option<Stat>,
}

/// Free-run R2 in percent on unseen signals of one kind.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Score {
    /// Model.
    pub output: Output,
    /// Noise variance of identification and validation.
    pub noise_variance: f64,
    /// Kind of the validation signals.
    pub validation: Source,
    /// Mean over models and validation signals, against noisy outputs.
    pub r2: f64,
    /// Its standard error.
    pub se: f64,
    /// Mean against outputs without noise.
    pub r2_noise_free: f64,
}

/// Mean over the parameters of `|estimate - true| / |true|` (eq. 4.37, read as a mean).
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ParameterError {
    /// Model.
    pub output: Output,
    /// Noise variance.
    pub noise_variance: f64,
    /// Population.
    pub stat: Option<Stat>,
}

/// What a kind of signal is worth.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Population {
    /// Kind.
    pub source: Source,
    /// Size.
    pub size: Size,
    /// Least and largest rank of the information: torque, lambda.
    pub rank: [(usize, usize); 2],
    /// Median objective of the first ten designs, one start each.
    pub median_of_ten: Option<f64>,
    /// Least objective of the first ten.
    pub best_of_ten: Option<f64>,
    /// Objective of all designs.
    pub objective: Option<Stat>,
    /// Criteria of the signals.
    pub criteria: Vec<CriterionStat>,
    /// Scores of the models.
    pub scores: Vec<Score>,
    /// Errors of the parameters.
    pub parameters: Vec<ParameterError>,
}

impl Population {
    /// Score of torque or lambda models.
    pub fn score(&self, output: Output, noise_variance: f64, validation: Source) -> Option<&Score> {
        self.scores
            .iter()
            .find(|s| s.output == output && s.noise_variance == noise_variance && s.validation == validation)
    }

    /// Statistics of a criterion.
    pub fn criterion(&self, output: Output, criterion: DesignCriterion) -> Option<&Stat> {
        let of = self.criteria.iter().find(|c| c.output == output && c.criterion == criterion);
        of.and_then(|c| c.stat.as_ref())
    }

    /// Mean error of the parameters.
    pub fn parameter_error(&self, output: Output, noise_variance: f64) -> Option<&Stat> {
        let of = self.parameters.iter().find(|p| p.output == output && p.noise_variance == noise_variance);
        of.and_then(|p| p.stat.as_ref())
    }
}

/// Kinds of validation signals.
pub const VALIDATION: [Source; 3] = [Source::Prbs, Source::Aprbs, Source::Udrn];

/// Noise variances of the chapter: torque in Nm^2 (Tables 4.11, 4.14, 4.15), then lambda.
pub const NOISE: [(Output, f64); 4] =
    [(Output::Torque, 40.0), (Output::Torque, 80.0), (Output::Torque, 160.0), (Output::Lambda, 0.04)];

/// Makes the signals of a kind, identifies a model from each and validates them all.
///
/// # Errors
/// [`Chapter4Error`].
///
/// ```
/// use dynocal_calib::chapter4::population::{Size, measure};
/// use dynocal_calib::chapter4::{Output, Setting, source::Source};
/// let size = Size { identification: 4, validation: 4, seed: 1 };
/// let found = measure(&Setting::new()?, Source::Prbs, size, &|| false)?;
/// // On two levels u1, u1^2 and the constant are one: a PRBS cannot tell the torque parameters.
/// assert_eq!(found.rank[0], (22, 22));
/// # Ok::<(), dynocal_calib::chapter4::Chapter4Error>(())
/// ```
pub fn measure(
    setting: &Setting,
    source: Source,
    size: Size,
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Result<Population, Chapter4Error> {
    let records = signals(setting, source, size.identification, 1, size.seed, interrupt)?;
    let objectives: Option<Vec<f64>> = records.iter().map(|r| r.objective).collect();
    let ten = objectives.as_ref().map(|o| o[..o.len().min(10)].to_vec());
    let mut rank = [(0, 0); 2];
    let (mut criteria, mut scores, mut parameters) = (Vec::new(), Vec::new(), Vec::new());
    for (k, output) in [Output::Torque, Output::Lambda].into_iter().enumerate() {
        let ranks = ranks(setting, output, &records)?;
        rank[k] = (ranks.iter().copied().min().unwrap_or(0), ranks.iter().copied().max().unwrap_or(0));
        criteria.extend(criterion_statistics(setting, output, &records)?);
        for (i, &(_, noise)) in NOISE.iter().enumerate().filter(|(_, n)| n.0 == output) {
            let models = identify(setting, output, noise, &records, &ranks, stream(3, source, i), size.seed)?;
            parameters.push(parameter_error(setting, output, noise, &models));
            for kind in VALIDATION {
                let unseen = unseen(setting, output, noise, kind, i, size)?;
                scores.push(validate(setting, output, noise, kind, &models, &unseen));
            }
        }
        if interrupt() {
            return Err(Chapter4Error::Interrupted);
        }
    }
    Ok(Population {
        source,
        size,
        rank,
        median_of_ten: ten.as_deref().and_then(median),
        best_of_ten: ten.and_then(|o| o.into_iter().reduce(f64::min)),
        objective: objectives.and_then(|o| Stat::of(&o)),
        criteria,
        scores,
        parameters,
    })
}

/// Streams of noise: one per set, kind of signal and noise variance.
fn stream(set: u64, source: Source, level: usize) -> u64 {
    let kind = match source {
        Source::Prbs => 0,
        Source::Aprbs => 1,
        Source::Udrn => 2,
        Source::Design(c) => 3 + c as u64,
        Source::Composite(c) => 16 + c as u64,
    };
    set << 40 | kind << 32 | (level as u64) << 28
}

/// Output of the known model; rows before the start are zero.
fn truth(setting: &Setting, output: Output, u: &[f64]) -> Result<(Vec<f64>, Vec<f64>), Chapter4Error> {
    let m = setting.model(output);
    let p = m.model.n_params();
    let zeros = vec![0.0; SAMPLES];
    let run = dynocal_ident::model::Run { u, y: &zeros, start: START };
    let (mut y, mut s) = (vec![0.0; SAMPLES], vec![0.0; SAMPLES * p]);
    match m.model.sensitivities(&m.theta, &run, &mut y, &mut s) {
        dynocal_numerics::status::Status::Converged => Ok((y, s.split_off(START * p))),
        _ => Err(Chapter4Error::Diverged { model: m.source }),
    }
}

fn ranks(setting: &Setting, output: Output, records: &[Record]) -> Result<Vec<usize>, Chapter4Error> {
    let m = setting.model(output);
    let one = |r: &Record| -> Result<usize, Chapter4Error> {
        let (_, s) = truth(setting, output, &r.u)?;
        Ok(match report(&m.model, &s, m.noise_variance, &[]) {
            Report::Regular(_) => m.model.n_params(),
            Report::Singular(s) => s.rank,
        })
    };
    records.par_iter().map(one).collect()
}

fn criterion_statistics(
    setting: &Setting,
    output: Output,
    records: &[Record],
) -> Result<Vec<CriterionStat>, Chapter4Error> {
    let one = |criterion: DesignCriterion| -> Result<CriterionStat, Chapter4Error> {
        let built = criterion.build()?;
        let terms = vec![term(setting, output, built.as_ref(), 1.0)];
        let mut evaluator = Evaluator::new(&problem(setting, terms))?;
        let values: Vec<f64> = records.iter().map(|r| evaluator.value(&r.u)).collect();
        Ok(CriterionStat { output, criterion, stat: Stat::of(&values) })
    };
    DesignCriterion::ALL.into_iter().map(one).collect()
}

/// A noisy record: outputs of the known model and white noise of the variance at every sample.
fn noisy(y: &[f64], u: &[f64], noise: f64, rng: &mut Rng64) -> Experiment {
    let deviation = noise.sqrt();
    Experiment {
        name: String::new(),
        u: u.to_vec(),
        y: y.iter().map(|v| v + deviation * rng.normal()).collect(),
        init_samples: START,
        weights: Vec::new(),
    }
}

/// Least squares with the measured z(t-10) as a regressor; of least norm where the record is singular.
fn identify(
    setting: &Setting,
    output: Output,
    noise: f64,
    records: &[Record],
    ranks: &[usize],
    stream: u64,
    seed: u64,
) -> Result<Vec<Vec<f64>>, Chapter4Error> {
    let model = &setting.model(output).model;
    let one = |(k, r): (usize, &Record)| -> Result<Vec<f64>, Chapter4Error> {
        let (y, _) = truth(setting, output, &r.u)?;
        let data = [noisy(&y, &r.u, noise, &mut Rng64::stream(seed, stream + k as u64))];
        let ridge = if ranks[k] < model.n_params() { LEAST_NORM_RIDGE } else { 0.0 };
        Ok(Ols { ridge, ..Ols::default() }.estimate(model, &data, None, &|| false)?.theta)
    };
    records.par_iter().enumerate().map(one).collect()
}

fn parameter_error(setting: &Setting, output: Output, noise: f64, models: &[Vec<f64>]) -> ParameterError {
    let theta = &setting.model(output).theta;
    let one = |found: &Vec<f64>| {
        found.iter().zip(theta).map(|(f, t)| ((f - t) / t).abs()).sum::<f64>() / theta.len() as f64
    };
    let values: Vec<f64> = models.iter().map(one).collect();
    ParameterError { output, noise_variance: noise, stat: Stat::of(&values) }
}

/// A validation record with its output before the noise.
struct Unseen {
    experiment: Experiment,
    noise_free: Vec<f64>,
}

/// Validation records: the same for every kind of identification signal, so that kinds are compared in pairs.
fn unseen(
    setting: &Setting,
    output: Output,
    noise: f64,
    kind: Source,
    level: usize,
    size: Size,
) -> Result<Vec<Unseen>, Chapter4Error> {
    let records = signals(setting, kind, size.validation, 2, size.seed, &|| false)?;
    let one = |(k, r): (usize, Record)| -> Result<Unseen, Chapter4Error> {
        let (y, _) = truth(setting, output, &r.u)?;
        let mut rng = Rng64::stream(size.seed, stream(4, kind, level) + k as u64);
        Ok(Unseen { experiment: noisy(&y, &r.u, noise, &mut rng), noise_free: y })
    };
    records.into_iter().enumerate().map(one).collect()
}

fn validate(
    setting: &Setting,
    of: Output,
    noise: f64,
    kind: Source,
    models: &[Vec<f64>],
    unseen: &[Unseen],
) -> Score {
    let model = &setting.model(of).model;
    let r2 = |z: &[f64], y: &[f64], reference| {
        100.0 * score_values(&z[START..], &y[START..], Kind::FreeRun, Seen::Unseen, reference).r2
    };
    let pairs: Vec<(f64, f64)> = models
        .par_iter()
        .flat_map_iter(|theta| {
            unseen.iter().map(|v| {
                let y = output(model, theta, &v.experiment, Kind::FreeRun);
                (r2(&v.experiment.y, &y, Reference::Noisy), r2(&v.noise_free, &y, Reference::NoiseFree))
            })
        })
        .collect();
    let (noisy, free): (Vec<f64>, Vec<f64>) = pairs.into_iter().unzip();
    let (mean, se) = crossed(&noisy, unseen.len());
    let (r2_noise_free, _) = crossed(&free, unseen.len());
    Score { output: of, noise_variance: noise, validation: kind, r2: mean, se, r2_noise_free }
}
