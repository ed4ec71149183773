//! Scores of a set of models on one part of the data, and the records that are kept.

use std::collections::BTreeMap;
use std::path::Path;

use dynocal_files::csv_io;
use dynocal_files::measurement::parquet_io;
use dynocal_ident::data::{DataError, Dataset};
use dynocal_ident::estimate::missing::bridged;
use dynocal_ident::experiment::Experiment;
use dynocal_ident::prepare::Note;
use dynocal_ident::validate::{self, Kind, Reference, autocorrelation, cross_correlation, departure};

use super::error::IdentifyError;
use super::finding::{Finding, Grade};
use super::load::Part;
use super::prepare::{own_unit, restored};
use super::result::{Histogram, InputCrossCorrelation, RecordFile, ResidualTests, Score};
use super::set::{Member, Set};
use super::spec::Validation;

/// Lower and upper bound of a measurement about the free run of a target, by its place in the set.
pub type Bounds<'a> = dyn Fn(usize, &Experiment) -> Option<(Vec<f64>, Vec<f64>)> + 'a;

/// What scoring one part gives.
#[derive(Debug, Default)]
pub struct Scored {
    /// Scores, target by target.
    pub scores: Vec<Score>,
    /// Residual correlations of each target, as the kinds asked for say.
    pub residuals: Vec<(String, ResidualTests)>,
    /// Free runs that leave everything measured.
    pub findings: Vec<Finding>,
    /// Files written.
    pub records: Vec<RecordFile>,
}

/// What is known of the model of one target before it is scored.
#[derive(Clone, Debug)]
pub struct Judged {
    /// Which of its errors should be white.
    pub minimised: Kind,
    /// Least and greatest value of the output in the estimation, in its own unit.
    pub range: [f64; 2],
    /// What helps against a free run that diverges.
    pub advice: String,
}

/// Errors of one target and kind of output over all records of a part.
#[derive(Default)]
struct Errors {
    z: Vec<f64>,
    computed: Vec<f64>,
    /// Whether a free run leaves everything measured.
    outside: bool,
    /// Inputs of the same samples, one after the other.
    u: Vec<Vec<f64>>,
}

/// Scores `set` on `part`. Records go to `dir`, in files with the ending that is given.
///
/// Without one-step outputs among `kinds` the records are points without time.
///
/// # Errors
/// [`IdentifyError`]: a record too short to score, or files.
pub fn score(
    part: &Part,
    notes: &[Note],
    set: &Set,
    judged: &[Judged],
    (kinds, v): (&[Kind], &Validation),
    bounds: &Bounds,
    (dir, ending): (&Path, Option<&str>),
) -> Result<Scored, IdentifyError> {
    let steady = !kinds.contains(&Kind::OneStep);
    let mut scored = Scored::default();
    let mut errors: BTreeMap<(usize, usize), Errors> = BTreeMap::new();
    for d in &part.records {
        let shaped = set.shaped(d)?;
        long_enough(set, &shaped)?;
        let mut kept: Vec<(String, String, Vec<f64>)> = Vec::new();
        let measured = measured(set, notes, d, &shaped)?;
        let whole: Vec<Experiment> = shaped.iter().map(|e| bridged(e).0).collect();
        for (m, z) in set.members.iter().zip(&measured) {
            let unit = own_unit(notes, d, &m.target)?;
            kept.push((format!("{}_measured", m.target), unit, z.clone()));
        }
        for (j, kind) in kinds.iter().enumerate() {
            for (k, found) in set.outputs(&whole, *kind).into_iter().enumerate() {
                let Some(mut found) = found else { continue };
                restored(notes, d, &set.members[k].target, &mut found)?;
                let target = &set.members[k].target;
                if *kind == Kind::FreeRun
                    && let Some(text) = diverged(&shaped[k], &measured[k], &found, &judged[k], &part.name)
                {
                    scored.findings.push(Finding::new(Grade::Fault, target.as_str(), text));
                    errors.entry((k, j)).or_default().outside = true;
                }
                let first = set.members[k].model.first(&shaped[k]);
                let inputs = (judged[k].minimised == *kind).then_some(shaped[k].u.as_slice());
                errors.entry((k, j)).or_default().add(&measured[k], &found, first, inputs);
                if let Some(label) = label(*kind, steady) {
                    kept.push((format!("{target}_{label}"), own_unit(notes, d, target)?, found));
                }
            }
        }
        for (k, e) in whole.iter().enumerate() {
            let target = &set.members[k].target;
            let Some((mut low, mut high)) = bounds(k, e) else { continue };
            for (label, values) in [("low", &mut low), ("high", &mut high)] {
                restored(notes, d, target, values)?;
                let unit = own_unit(notes, d, target)?;
                kept.push((format!("{target}_{label}"), unit, std::mem::take(values)));
            }
        }
        let Some(ending) = ending else { continue };
        let name = format!("{}-{}.{ending}", file_name(&part.name), file_name(&d.name));
        write_record(&dir.join(&name), set, d, &kept, steady)?;
        scored.records.push(RecordFile {
            part: part.name.clone(),
            record: d.name.clone(),
            data: part.seen,
            file: name,
        });
    }
    for ((k, j), e) in errors {
        let member = &set.members[k];
        let unit = own_unit(notes, &part.records[0], &member.target)?;
        scored.scores.push(e.score(part, &member.target, kinds[j], v, unit));
        if judged[k].minimised == kinds[j] {
            let tests = e.tests(part, &member.inputs, kinds[j], v.residual_lags);
            scored.residuals.push((member.target.clone(), tests));
        }
    }
    Ok(scored)
}

impl Errors {
    /// Adds one record; `inputs` (row-major) where correlations with them are wanted.
    fn add(&mut self, z: &[f64], found: &[f64], first: usize, inputs: Option<&[f64]>) {
        self.z.extend_from_slice(&z[first..]);
        self.computed.extend_from_slice(&found[first..]);
        if let Some(inputs) = inputs {
            let m = inputs.len().checked_div(z.len()).unwrap_or(0);
            self.u.resize(m, Vec::new());
            for (i, u) in self.u.iter_mut().enumerate() {
                u.extend(inputs[first * m..].iter().skip(i).step_by(m));
            }
        }
    }

    fn score(&self, part: &Part, target: &str, kind: Kind, v: &Validation, unit: String) -> Score {
        // A missing sample is nothing to compare with.
        let known = |(z, _): &(&f64, &f64)| !z.is_nan();
        let (z, computed): (Vec<f64>, Vec<f64>) =
            self.z.iter().zip(&self.computed).filter(known).map(|(z, c)| (*z, *c)).unzip();
        let s = validate::score_values(&z, &computed, kind, part.seen, Reference::Noisy);
        let finite = |x: f64| x.is_finite().then_some(x);
        let band = v.band.get(target).copied();
        let inside = |half: f64| {
            let n = z.iter().zip(&computed).filter(|(z, c)| (*z - *c).abs() <= half).count();
            100.0 * n as f64 / z.len().max(1) as f64
        };
        Score {
            output: target.into(),
            part: part.name.clone(),
            data: part.seen,
            kind,
            reference: Reference::Noisy,
            outside: self.outside,
            records: part.records.len(),
            samples: s.samples,
            rmse: finite(s.rmse),
            mse: finite(s.mse),
            error_95: finite(s.error_95),
            band,
            in_band_percent: band.filter(|_| s.rmse.is_finite()).map(inside),
            r2_percent: finite(100.0 * s.r2),
            nrmse_fit_percent: finite(100.0 * s.nrmse_fit),
            unit,
            histogram: (kind == Kind::FreeRun).then(|| histogram(&z, &computed)).flatten(),
        }
    }

    fn tests(&self, part: &Part, inputs: &[String], kind: Kind, lags: usize) -> ResidualTests {
        // An error that is not known is no error; it leaves the correlations of the others as they are.
        let e: Vec<f64> = self
            .z
            .iter()
            .zip(&self.computed)
            .map(|(z, c)| z - c)
            .map(|v| if v.is_finite() { v } else { 0.0 })
            .collect();
        let cross = inputs.iter().zip(&self.u).map(|(input, u)| InputCrossCorrelation {
            input: input.clone(),
            correlation: cross_correlation(&e, u, lags),
        });
        ResidualTests {
            part: part.name.clone(),
            kind,
            auto: autocorrelation(&e, lags),
            cross: cross.collect(),
        }
    }
}

/// Cells of a histogram; odd, so that zero is the middle of one.
const CELLS: usize = 25;

/// Errors (measured minus computed) in cells out to the 99th percentile of their size.
fn histogram(z: &[f64], computed: &[f64]) -> Option<Histogram> {
    let errors: Vec<f64> = z.iter().zip(computed).map(|(z, c)| z - c).filter(|e| e.is_finite()).collect();
    let mut sizes: Vec<f64> = errors.iter().map(|e| e.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    let reach = *sizes.get((sizes.len() * 99) / 100)?;
    if reach <= 0.0 {
        return None;
    }
    let width = 2.0 * reach / CELLS as f64;
    let mut counts = vec![0; CELLS];
    for e in &errors {
        counts[(((e + reach) / width).floor().max(0.0) as usize).min(CELLS - 1)] += 1;
    }
    let centres = (0..CELLS).map(|k| -reach + (k as f64 + 0.5) * width).collect();
    Some(Histogram { centres, counts })
}

/// Measured outputs of all targets in their own units.
fn measured(
    set: &Set,
    notes: &[Note],
    d: &Dataset,
    shaped: &[Experiment],
) -> Result<Vec<Vec<f64>>, IdentifyError> {
    let one = |(m, e): (&Member, &Experiment)| {
        let mut z = e.y.clone();
        restored(notes, d, &m.target, &mut z)?;
        Ok(z)
    };
    set.members.iter().zip(shaped).map(one).collect()
}

fn label(kind: Kind, steady: bool) -> Option<&'static str> {
    match kind {
        _ if steady => Some("predicted"),
        Kind::OneStep => Some("one_step"),
        Kind::FreeRun => Some("free_run"),
        Kind::KStep(_) => None,
    }
}

/// What is wrong with a free run that is not finite or far from everything that was measured.
fn diverged(e: &Experiment, measured: &[f64], found: &[f64], judged: &Judged, part: &str) -> Option<String> {
    let range = measured.iter().chain(&judged.range).copied();
    let far = departure(found, range, |t| !e.y[t].is_nan())?;
    let (how, t) = (far.words(), far.sample);
    Some(format!("the free run {how} on {part} record `{}`, from sample {t} on: {}", e.name, judged.advice))
}

fn long_enough(set: &Set, shaped: &[Experiment]) -> Result<(), DataError> {
    for (m, e) in set.members.iter().zip(shaped) {
        let first = m.model.first(e);
        if e.len() <= first {
            let why = format!("{first} samples initialise, one must be left to score");
            return Err(DataError::TooShort {
                record: e.name.clone(),
                found: e.len(),
                expected: first + 1,
                why,
            });
        }
    }
    Ok(())
}

fn file_name(name: &str) -> String {
    name.chars().map(|c| if c.is_ascii_alphanumeric() || c == '.' || c == '-' { c } else { '_' }).collect()
}

fn write_record(
    path: &Path,
    set: &Set,
    d: &Dataset,
    computed: &[(String, String, Vec<f64>)],
    steady: bool,
) -> Result<(), IdentifyError> {
    let time: Vec<f64> = (0..d.len()).map(|t| t as f64 * d.sample_time_s).collect();
    let mut columns: Vec<(String, &str, &[f64])> = vec![("time".into(), "s", &time)];
    if steady {
        columns.clear();
    }
    for (name, unit, values) in computed {
        columns.push((name.clone(), unit, values));
    }
    let mut inputs: Vec<&String> = Vec::new();
    for name in set.members.iter().flat_map(|m| &m.inputs) {
        let is_target = set.members.iter().any(|m| m.target == *name);
        if !is_target && !inputs.contains(&name) {
            inputs.push(name);
        }
    }
    for name in inputs {
        let c = d.channel(name)?;
        columns.push((c.name.clone(), &c.unit, &c.values));
    }
    let columns: Vec<(&str, &str, &[f64])> = columns.iter().map(|(n, u, v)| (n.as_str(), *u, *v)).collect();
    let parquet = path.extension().is_some_and(|e| e == "parquet");
    let write = if parquet { parquet_io::write_columns } else { csv_io::write_columns };
    Ok(write(path, &columns)?)
}
