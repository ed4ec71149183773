//! What the records say before any fit: can a model be identified from them at all?

use dynocal_ident::data::{DataError, Dataset};
use dynocal_ident::excitation::bla::Level;
use dynocal_ident::excitation::{ExcitationReport, PathBla, Settings, excitation};
use serde::{Deserialize, Serialize};

use super::spec::Job;

/// The checks of the inputs and the sample time.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Before {
    /// What an engineer should know, in sentences.
    pub warnings: Vec<String>,
    /// One row for each input.
    pub inputs: Vec<InputRow>,
    /// One row for each pair of inputs.
    pub pairs: Vec<PairRow>,
    /// One row for each way from an input to an output.
    pub rises: Vec<RiseRow>,
    /// Sample time of the records in s.
    pub sample_time_s: f64,
    /// Best linear approximations, where the inputs are periodic multisines.
    pub approximations: Vec<Approximation>,
}

/// What one input does in the records.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct InputRow {
    /// Name.
    pub input: String,
    /// Unit.
    pub unit: String,
    /// Least value.
    pub minimum: f64,
    /// Greatest value.
    pub maximum: f64,
    /// Share of the cells of its range that are visited, in percent.
    pub occupied_percent: f64,
    /// Order of persistent excitation.
    pub order: usize,
    /// Highest order that was tested.
    pub tested: usize,
}

/// How two inputs go together.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PairRow {
    /// First input.
    pub a: String,
    /// Second input.
    pub b: String,
    /// Correlation at the same sample.
    pub correlation: Option<f64>,
    /// Largest correlation within the lags.
    pub largest: Option<f64>,
    /// Lag of it in samples; positive: b follows a.
    pub lag: Option<isize>,
    /// What independent inputs stay within.
    pub bound: Option<f64>,
    /// Share of the cells reachable one by one that are visited together, in percent.
    pub occupied_percent: f64,
    /// Samples in each cell, a along the rows.
    pub counts: Vec<usize>,
}

/// Rise of an output after a step of an input.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RiseRow {
    /// Input.
    pub input: String,
    /// Output.
    pub output: String,
    /// Rise time in s.
    pub rise_s: f64,
    /// The same in samples.
    pub samples: f64,
    /// What it means, in a sentence.
    pub verdict: String,
}

/// Amplitude at a line of a spectrum. Files hold it as `[frequency_hz, level_db]`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(from = "(f64, f64)", into = "(f64, f64)")]
pub struct LineLevel {
    /// Frequency in Hz.
    pub frequency_hz: f64,
    /// Amplitude in dB.
    pub level_db: f64,
}

impl From<(f64, f64)> for LineLevel {
    fn from((frequency_hz, level_db): (f64, f64)) -> Self {
        Self { frequency_hz, level_db }
    }
}

impl From<LineLevel> for (f64, f64) {
    fn from(l: LineLevel) -> Self {
        (l.frequency_hz, l.level_db)
    }
}

/// Best linear approximation with what is not linear; levels in dB.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Approximation {
    /// Input.
    pub input: String,
    /// Output.
    pub output: String,
    /// Frequencies in Hz.
    pub frequency_hz: Vec<f64>,
    /// Gain.
    pub gain_db: Vec<f64>,
    /// Standard deviation of the gain from noise alone.
    pub noise_db: Vec<f64>,
    /// Standard deviation of the gain from noise and nonlinear distortion.
    pub total_db: Vec<f64>,
    /// Even distortion (a square) at lines that are not excited, in the output.
    pub even: Vec<LineLevel>,
    /// Odd distortion (a cube).
    pub odd: Vec<LineLevel>,
    /// Output at the excited lines.
    pub excited: Vec<LineLevel>,
}

/// Checks the estimation records for all targets together.
///
/// # Errors
/// [`DataError`]: a channel is not there.
pub fn before(job: &Job, records: &[Dataset]) -> Result<Option<Before>, DataError> {
    let targets: Vec<String> = job.targets.iter().map(|t| t.target.clone()).collect();
    let mut inputs: Vec<String> = Vec::new();
    for name in job.targets.iter().flat_map(|t| &t.inputs) {
        if !inputs.contains(name) && !targets.contains(name) {
            inputs.push(name.clone());
        }
    }
    if inputs.is_empty() || records.is_empty() {
        return Ok(None);
    }
    let settings = Settings { period: job.multisine_period, ..Settings::default() };
    // What stands in the way of a check need not stand in the way of a fit, which says itself what it misses.
    match excitation(records, &inputs, &targets, &settings) {
        Ok(report) => Ok(Some(flat(&report, &records[0])?)),
        Err(e) => Ok(Some(Before { warnings: vec![format!("not checked: {e}")], ..Before::default() })),
    }
}

fn flat(r: &ExcitationReport, d: &Dataset) -> Result<Before, DataError> {
    let mut inputs = Vec::new();
    for c in &r.coverage {
        let order = r.persistence.iter().find(|p| p.input == c.input);
        inputs.push(InputRow {
            input: c.input.clone(),
            unit: d.channel(&c.input)?.unit.clone(),
            minimum: c.minimum,
            maximum: c.maximum,
            occupied_percent: 100.0 * c.occupied,
            order: order.map_or(0, |p| p.found.order),
            tested: order.map_or(0, |p| p.found.tested),
        });
    }
    let pairs = r.pairs.iter().map(|p| {
        let c = r.correlations.iter().find(|c| c.a == p.a && c.b == p.b);
        PairRow {
            a: p.a.clone(),
            b: p.b.clone(),
            correlation: c.map(|c| c.r),
            largest: c.map(|c| c.r_max),
            lag: c.map(|c| c.lag),
            bound: c.map(|c| c.bound),
            occupied_percent: 100.0 * p.of_reachable,
            counts: p.counts.clone(),
        }
    });
    let rises = r.sample_time.iter().flat_map(|s| {
        s.rises.iter().map(|rise| RiseRow {
            input: rise.input.clone(),
            output: s.output.clone(),
            rise_s: rise.rise_s,
            samples: rise.samples,
            verdict: s.sentence(),
        })
    });
    Ok(Before {
        warnings: r.warnings.clone(),
        inputs,
        pairs: pairs.collect(),
        rises: rises.filter(|r| r.rise_s.is_finite()).collect(),
        sample_time_s: d.sample_time_s,
        approximations: r.bla.iter().map(approximation).collect(),
    })
}

/// Nothing is this low in a measurement; it keeps a level of exactly zero in the plot.
const FLOOR_DB: f64 = -300.0;

fn db(v: f64) -> f64 {
    (20.0 * v.log10()).max(FLOOR_DB)
}

fn level(l: &Level) -> Vec<LineLevel> {
    let lines = l.frequency_hz.iter().zip(&l.amplitude);
    lines.map(|(f, a)| LineLevel { frequency_hz: *f, level_db: db(*a) }).collect()
}

fn approximation(path: &PathBla) -> Approximation {
    let b = &path.bla;
    let levels = |v: &[f64]| v.iter().map(|x| db(*x)).collect();
    Approximation {
        input: path.input.clone(),
        output: path.output.clone(),
        frequency_hz: b.frequency_hz.clone(),
        gain_db: b.gain.iter().map(|(re, im)| db(re.hypot(*im))).collect(),
        noise_db: levels(&b.noise_std),
        total_db: levels(&b.total_std),
        even: b.even.as_ref().map(level).unwrap_or_default(),
        odd: b.odd.as_ref().map(level).unwrap_or_default(),
        excited: level(&b.excited),
    }
}
