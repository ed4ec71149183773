//! What a kind of signal is worth: criteria, models identified with it, and their scores on unseen signals.

use dynocal_design::problem::Evaluator;
use serde::{Deserialize, Serialize};

use super::library::Library;
use super::models::{Told, identify, relative_error, told, unseen, validate};
use super::source::{DesignCriterion, Record, Source, problem, term};
use super::statistics::{Stat, median};
use super::{Chapter4Error, Output, Setting, Size};

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
    /// Lower bounds of the standard deviations of the torque parameters (p), at noise variance 80; empty where a signal
    /// is singular.
    pub bounds: Vec<Stat>,
    /// Estimates of the torque parameters (p), one per signal, at noise variance 80.
    pub estimates: Vec<Stat>,
    /// The first signal (N x 3).
    pub example: Vec<f64>,
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

/// Kinds of random validation signals.
pub const VALIDATION: [Source; 3] = [Source::Prbs, Source::Aprbs, Source::Udrn];

/// Kinds of designed validation signals of torque models (U_G, U_I and U_AI of Tables 4.11, 4.14 and 4.15).
pub const DESIGNED: [Source; 3] = [
    Source::Design(DesignCriterion::G),
    Source::Design(DesignCriterion::I),
    Source::Design(DesignCriterion::Ai),
];

/// Noise variances of the chapter: torque in Nm^2 (Tables 4.11, 4.14, 4.15), then lambda.
pub const NOISE: [(Output, f64); 4] =
    [(Output::Torque, 40.0), (Output::Torque, 80.0), (Output::Torque, 160.0), (Output::Lambda, 0.04)];

/// Makes the signals of a kind, identifies a model from each and validates them all.
///
/// # Errors
/// [`Chapter4Error`].
///
/// ```
/// use dynocal_studies::chapter4::work::library::Library;
/// use dynocal_studies::chapter4::work::population::measure;
/// use dynocal_studies::chapter4::work::{Size, source::Source};
/// let library = Library::new(Size { identification: 2, validation: 2, designed: 0, seed: 1 })?;
/// let found = measure(&library, Source::Prbs, &|| false)?;
/// // On two levels u1, u1^2 and the constant are one: a PRBS cannot tell the torque parameters.
/// assert_eq!(found.rank[0], (22, 22));
/// # Ok::<(), dynocal_studies::chapter4::work::Chapter4Error>(())
/// ```
pub fn measure(
    library: &Library,
    source: Source,
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Result<Population, Chapter4Error> {
    let (setting, size) = (&library.setting, library.size);
    let records = library.identification(source, interrupt)?;
    let objectives: Option<Vec<f64>> = records.iter().map(|r| r.objective).collect();
    let ten = objectives.as_ref().map(|o| o[..o.len().min(10)].to_vec());
    let mut found = Population {
        source,
        size,
        rank: [(0, 0); 2],
        median_of_ten: ten.as_deref().and_then(median),
        best_of_ten: ten.and_then(|o| o.into_iter().reduce(f64::min)),
        objective: objectives.and_then(|o| Stat::of(&o)),
        criteria: Vec::new(),
        scores: Vec::new(),
        parameters: Vec::new(),
        bounds: Vec::new(),
        estimates: Vec::new(),
        example: records.first().map_or_else(Vec::new, |r| r.u.clone()),
    };
    for (k, output) in [Output::Torque, Output::Lambda].into_iter().enumerate() {
        let told = told(setting, output, &records)?;
        let ranks = || told.iter().map(|t| t.rank);
        found.rank[k] = (ranks().min().unwrap_or(0), ranks().max().unwrap_or(0));
        found.criteria.extend(criterion_statistics(setting, output, &records)?);
        if output == Output::Torque {
            found.bounds = bound_statistics(&told);
        }
        for level in (0..NOISE.len()).filter(|i| NOISE[*i].0 == output) {
            add_models(library, &mut found, (&records, &told), level, interrupt)?;
        }
    }
    Ok(found)
}

/// Identifies and validates models at one noise variance.
fn add_models(
    library: &Library,
    found: &mut Population,
    (records, told): (&[Record], &[Told]),
    level: usize,
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Result<(), Chapter4Error> {
    let (setting, seed, (output, noise)) = (&library.setting, library.size.seed, NOISE[level]);
    let models = identify(setting, output, noise, records, told, (seed, stream(3, found.source, level)))?;
    let errors: Vec<f64> = models.iter().map(|m| relative_error(setting, output, m)).collect();
    found.parameters.push(ParameterError { output, noise_variance: noise, stat: Stat::of(&errors) });
    if (output, noise) == (Output::Torque, 80.0) {
        found.estimates = columns(&models);
    }
    let wanted = output == Output::Torque && library.size.designed > 0;
    let designed: &[Source] = if wanted { &DESIGNED } else { &[] };
    for &kind in VALIDATION.iter().chain(designed) {
        let records = library.validation(kind, interrupt)?;
        let unseen = unseen(setting, output, noise, &records, (seed, stream(4, kind, level)))?;
        let scored = validate(setting, output, &models, &unseen);
        found.scores.push(Score {
            output,
            noise_variance: noise,
            validation: kind,
            r2: scored.r2.0,
            se: scored.r2.1,
            r2_noise_free: scored.r2_noise_free,
        });
        if interrupt() {
            return Err(Chapter4Error::Interrupted);
        }
    }
    Ok(())
}

/// Streams of noise: one per set, kind of signal and noise variance.
fn stream(set: u64, source: Source, level: usize) -> u64 {
    set << 40 | source.number() << 32 | (level as u64) << 28
}

fn criterion_statistics(
    setting: &Setting,
    output: Output,
    records: &[Record],
) -> Result<Vec<CriterionStat>, Chapter4Error> {
    let one = |criterion: DesignCriterion| -> Result<CriterionStat, Chapter4Error> {
        let built = criterion.build()?;
        let terms = vec![term(setting, output, built.as_ref(), 1.0, &setting.u0)];
        let mut evaluator = Evaluator::new(&problem(setting, terms))?;
        let values: Vec<f64> = records.iter().map(|r| evaluator.value(&r.u)).collect();
        Ok(CriterionStat { output, criterion, stat: Stat::of(&values) })
    };
    DesignCriterion::ALL.into_iter().map(one).collect()
}

fn bound_statistics(told: &[Told]) -> Vec<Stat> {
    let regular: Option<Vec<Vec<f64>>> = told.iter().map(|t| t.bounds.clone()).collect();
    regular.map_or_else(Vec::new, |b| columns(&b))
}

/// Statistics of every column of equally long rows.
fn columns(rows: &[Vec<f64>]) -> Vec<Stat> {
    let p = rows.first().map_or(0, Vec::len);
    (0..p).filter_map(|k| Stat::of(&rows.iter().map(|r| r[k]).collect::<Vec<f64>>())).collect()
}
