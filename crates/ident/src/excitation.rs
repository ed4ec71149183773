//! Checks of a record before any fit: can a model be identified from it at all?
//!
//! ```
//! use dynocal_ident::data::{Channel, Dataset, Role};
//! use dynocal_ident::excitation::{Settings, excitation};
//! // A system with a lag of half a second, sampled at 0.1 s, that is given two sines and no more.
//! let u: Vec<f64> = (0..600).map(|t| (0.1 * t as f64).sin() + (0.37 * t as f64).sin()).collect();
//! let mut y = vec![0.0; 600];
//! (1..600).for_each(|t| y[t] = 0.8187 * y[t - 1] + 0.1813 * u[t - 1]);
//! let channel = |name: &str, role, values| Channel { name: name.into(), unit: "-".into(), role, values };
//! let channels = vec![channel("u", Role::Input, u), channel("y", Role::Output, y)];
//! let (name, origin) = ("run".into(), "example".into());
//! let record = Dataset { name, sample_time_s: 0.1, channels, init_samples: 0, origin };
//! let report = excitation(&[record], &["u".into()], &["y".into()], &Settings::default())?;
//! assert_eq!(report.persistence[0].found.order, 4);
//! assert!(report.warnings[0].contains("order 4"), "{:?}", report.warnings);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod bla;
pub mod correlation;
pub mod coverage;
pub mod persistence;
pub mod regressors;
pub mod sample_time;

use std::collections::BTreeMap;

use dynocal_numerics::interval::Interval;
use dynocal_numerics::linalg::LinalgError;
use serde::Serialize;

use crate::data::{DataError, Dataset, runs};
use crate::experiment::{Experiment, experiments_marked};
use bla::{Bla, BlaError, Realisation, bla};
use correlation::{InputCorrelation, correlation};
use coverage::{Coverage, PairCoverage, coverage, pair_coverage};
use persistence::{Persistence, persistence};
use regressors::{Rank, rank};
use sample_time::{SampleTimeCheck, Verdict, sample_time};

/// What is asked.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Settings {
    /// Highest order of persistence that is tested.
    pub max_order: usize,
    /// A lag of which the lags before explain all but this share counts as dependent.
    pub tolerance: f64,
    /// Longest lag of the correlation between inputs.
    pub max_lag: usize,
    /// Limits of inputs where they are declared.
    pub ranges: BTreeMap<String, Interval>,
    /// Period of the test signal in samples, where it is a periodic multisine: asks for the best linear approximation.
    pub period: Option<usize>,
    /// Periods at the start of every record that are still a transient.
    pub skip_periods: usize,
}

impl Default for Settings {
    fn default() -> Self {
        let ranges = BTreeMap::new();
        Self { max_order: 30, tolerance: 1e-6, max_lag: 30, ranges, period: None, skip_periods: 1 }
    }
}

/// Order of persistence of one input.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct InputPersistence {
    /// Input.
    pub input: String,
    /// What was found.
    pub found: Persistence,
}

/// Best linear approximation from one input to one output.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PathBla {
    /// Input.
    pub input: String,
    /// Output.
    pub output: String,
    /// The approximation.
    pub bla: Bla,
}

/// Everything that is known about the excitation.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ExcitationReport {
    /// Order of persistence of every input.
    pub persistence: Vec<InputPersistence>,
    /// Rank of the inputs at the same instant, with a constant: inputs that are combinations of others.
    pub inputs: Rank,
    /// Coverage of every input.
    pub coverage: Vec<Coverage>,
    /// Coverage of every pair of inputs.
    pub pairs: Vec<PairCoverage>,
    /// Correlation of every pair of inputs.
    pub correlations: Vec<InputCorrelation>,
    /// Sample time against the rise time of every output.
    pub sample_time: Vec<SampleTimeCheck>,
    /// Best linear approximations from periodic records with one input that moves.
    pub bla: Vec<PathBla>,
    /// What an engineer should know, in sentences.
    pub warnings: Vec<String>,
}

/// The checks cannot be made.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ExcitationError {
    /// The records do not fit the task.
    #[error(transparent)]
    Data(#[from] DataError),
    /// The record is not periodic as said.
    #[error("best linear approximation: {0}")]
    Bla(#[from] BlaError),
    /// No output was named.
    #[error("found {inputs} inputs and {outputs} outputs, expected at least one of each")]
    NoChannel {
        /// Inputs.
        inputs: usize,
        /// Outputs.
        outputs: usize,
    },
    /// The linear algebra met values that it cannot handle.
    #[error(transparent)]
    Numeric(#[from] LinalgError),
}

/// Checks the records (all with one sample time) for models from `inputs` to `outputs`. Missing samples are left out.
///
/// # Errors
/// [`ExcitationError`].
pub fn excitation(
    records: &[Dataset],
    inputs: &[String],
    outputs: &[String],
    settings: &Settings,
) -> Result<ExcitationReport, ExcitationError> {
    if inputs.is_empty() || outputs.is_empty() {
        return Err(ExcitationError::NoChannel { inputs: inputs.len(), outputs: outputs.len() });
    }
    let per_output =
        outputs.iter().map(|y| experiments_marked(records, inputs, y)).collect::<Result<Vec<_>, _>>()?;
    let dt_s = records.first().map_or(f64::NAN, |r| r.sample_time_s);
    let columns: Vec<Vec<f64>> =
        (0..inputs.len()).map(|i| joined(&per_output[0], inputs.len(), i, settings.max_lag)).collect();
    let mut persistent = Vec::new();
    for (i, name) in inputs.iter().enumerate() {
        let segments = segments(&per_output[0], inputs.len(), i);
        let segments: Vec<&[f64]> = segments.iter().map(Vec::as_slice).collect();
        let found = persistence(&segments, settings.max_order, settings.tolerance, true)?;
        persistent.push(InputPersistence { input: name.clone(), found });
    }
    let range = |name: &String| settings.ranges.get(name).copied();
    let covered: Vec<Coverage> =
        inputs.iter().zip(&columns).filter_map(|(name, v)| coverage(name, v, range(name))).collect();
    let (mut pairs, mut correlations) = (Vec::new(), Vec::new());
    for b in 1..covered.len() {
        for a in 0..b {
            pairs.push(pair_coverage(&covered[a], &covered[b], &columns[a], &columns[b]));
            correlations.extend(correlation(
                (&inputs[a], &columns[a]),
                (&inputs[b], &columns[b]),
                settings.max_lag,
            ));
        }
    }
    let checked = outputs.iter().zip(&per_output).map(|(y, e)| sample_time(e, inputs, y, dt_s)).collect();
    let mut report = ExcitationReport {
        persistence: persistent,
        inputs: input_rank(inputs, &columns, settings.tolerance)?,
        coverage: covered,
        pairs,
        correlations,
        sample_time: checked,
        bla: approximations(records, inputs, outputs, settings)?,
        warnings: Vec::new(),
    };
    report.warnings = report.judged();
    Ok(report)
}

/// Input `i` of all records, one after the other with `gap` missing samples between, so that no lag joins two records.
fn joined(data: &[Experiment], m: usize, i: usize, gap: usize) -> Vec<f64> {
    let mut out = Vec::new();
    for e in data {
        out.resize(out.len() + if out.is_empty() { 0 } else { gap }, f64::NAN);
        out.extend(e.u.iter().skip(i).step_by(m));
    }
    out
}

/// Stretches of input `i` without missing samples.
fn segments(data: &[Experiment], m: usize, i: usize) -> Vec<Vec<f64>> {
    let mut out = Vec::new();
    for e in data {
        let u: Vec<f64> = e.u.iter().skip(i).step_by(m).copied().collect();
        out.extend(runs(u.len(), |t| !u[t].is_nan()).iter().map(|g| u[g.from..g.to].to_vec()));
    }
    out
}

fn input_rank(inputs: &[String], columns: &[Vec<f64>], tolerance: f64) -> Result<Rank, LinalgError> {
    let names: Vec<String> = std::iter::once("1".to_string()).chain(inputs.iter().cloned()).collect();
    let mut phi = Vec::new();
    for t in (0..columns[0].len()).filter(|t| columns.iter().all(|c| !c[*t].is_nan())) {
        phi.push(1.0);
        phi.extend(columns.iter().map(|c| c[t]));
    }
    rank(&phi, &names, tolerance)
}

/// From the inputs that move, one per record, to every output.
fn approximations(
    records: &[Dataset],
    inputs: &[String],
    outputs: &[String],
    settings: &Settings,
) -> Result<Vec<PathBla>, ExcitationError> {
    let Some(period) = settings.period else { return Ok(Vec::new()) };
    let mut out = Vec::new();
    for input in inputs {
        let others: Vec<&String> = inputs.iter().filter(|i| *i != input).collect();
        let still = |r: &Dataset, name: &str| {
            r.values(name).is_ok_and(|v| v.iter().all(|x| *x == v[0]) && !v.is_empty())
        };
        let meant: Vec<&Dataset> =
            records.iter().filter(|r| !still(r, input) && others.iter().all(|o| still(r, o))).collect();
        for output in outputs.iter().filter(|_| !meant.is_empty()) {
            let cut = |r: &Dataset| -> (usize, usize) {
                let whole = r.len() / period.max(1) * period;
                (settings.skip_periods.saturating_mul(period).min(whole), whole)
            };
            let mut parts = Vec::new();
            for r in &meant {
                let (from, to) = cut(r);
                parts.push(Realisation { u: &r.values(input)?[from..to], y: &r.values(output)?[from..to] });
            }
            let bla = bla(&parts, period, meant[0].sample_time_s)?;
            out.push(PathBla { input: input.clone(), output: output.clone(), bla });
        }
    }
    Ok(out)
}

impl ExcitationReport {
    fn judged(&self) -> Vec<String> {
        let mut out = Vec::new();
        for InputPersistence { input: name, found: p } in
            self.persistence.iter().filter(|p| p.found.order < p.found.tested)
        {
            out.push(format!(
                "`{name}` is persistently exciting of order {} only: no more than {} lags of it can be told apart",
                p.order, p.order
            ));
        }
        for d in &self.inputs.dependencies {
            out.push(format!("inputs depend on each other: {} throughout", d.sentence()));
        }
        for c in self.correlations.iter().filter(|c| c.r.abs() > c.bound.max(0.3)) {
            out.push(format!(
                "`{}` and `{}` move together (correlation {:.2}, independent ones stay within {:.2}): their effects \
                 are hard to tell apart",
                c.a, c.b, c.r, c.bound
            ));
        }
        for c in self.correlations.iter().filter(|c| c.r.abs() <= 0.3 && c.r_max.abs() > c.bound.max(0.5)) {
            out.push(format!(
                "`{}` follows `{}` {} samples later (correlation {:.2})",
                if c.lag > 0 { &c.b } else { &c.a },
                if c.lag > 0 { &c.a } else { &c.b },
                c.lag.abs(),
                c.r_max
            ));
        }
        for c in &self.coverage {
            out.extend(c.judged());
        }
        for p in self.pairs.iter().filter(|p| p.of_reachable < 0.3) {
            out.push(format!(
                "`{}` and `{}` together visit {:.0} % of the cells that they reach one by one: a model of both \
                 extrapolates in the others",
                p.a,
                p.b,
                100.0 * p.of_reachable
            ));
        }
        out.extend(
            self.sample_time.iter().filter(|s| s.verdict != Verdict::Fits).map(SampleTimeCheck::sentence),
        );
        for b in &self.bla {
            out.extend(b.bla.judged(&b.input, &b.output));
        }
        out
    }
}

impl Coverage {
    fn judged(&self) -> Vec<String> {
        let mut out = Vec::new();
        if self.span < 0.8 {
            out.push(format!(
                "`{}` goes from {:.4} to {:.4}, {:.0} % of its range {:.4} to {:.4}",
                self.input,
                self.minimum,
                self.maximum,
                100.0 * self.span,
                self.range.lower,
                self.range.upper
            ));
        }
        if self.outside > 0.0 {
            out.push(format!(
                "`{}` is outside its range {:.4} to {:.4} in {:.1} % of the samples",
                self.input,
                self.range.lower,
                self.range.upper,
                100.0 * self.outside
            ));
        }
        if self.occupied <= 2.0 / coverage::CELLS as f64 && self.maximum > self.minimum {
            out.push(format!(
                "`{}` takes two levels only: what is curved in it cannot be identified",
                self.input
            ));
        }
        out
    }
}

impl Bla {
    /// What the distortion levels say.
    fn judged(&self, input: &str, output: &str) -> Vec<String> {
        let parts = [("even", &self.even, "a square"), ("odd", &self.odd, "a cube, a saturation")];
        let found = parts.iter().filter_map(|(name, level, like)| {
            let level = level.as_ref().filter(|l| l.stands_out())?;
            let db = level.db_of(&self.excited);
            (db > -40.0).then(|| {
                format!(
                    "from `{input}` to `{output}` {name} nonlinear distortion ({like}) is {db:.0} dB of the output: a \
                     linear model leaves it out"
                )
            })
        });
        found.collect()
    }
}
