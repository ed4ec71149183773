//! Identification of records that are in memory, for faces that bring no files: the same estimate, the same scores and
//! the same model as of [`super::job`], without a run folder.
//!
//! ```
//! use dynocal_ident::data::{Channel, Dataset, Role};
//! use dynocal_jobs::identify::memory;
//! use dynocal_numerics::watch::Watch;
//!
//! let u: Vec<f64> = (0..300).map(|t| f64::from((t * t + t / 7) % 11) - 5.0).collect();
//! let mut y = vec![0.0; 300];
//! (1..300).for_each(|t| y[t] = 0.8 * y[t - 1] + 0.5 * u[t - 1]);
//! let channel = |name: &str, role, values| Channel { name: name.into(), unit: "V".into(), role, values };
//! let record = Dataset {
//!     name: "lag".into(),
//!     sample_time_s: 0.1,
//!     channels: vec![channel("u", Role::Input, u), channel("y", Role::Output, y)],
//!     init_samples: 0,
//!     origin: "computed".into(),
//! };
//! let tables = toml::from_str("model = { structure = { name = \"arx\", na = 1, nb = 1 }, estimator = { name = \"ols\" } }")?;
//! let job = memory::job("example", &tables, &record, false, None)?;
//! let learnt = memory::learn(&job, vec![record.clone()], Vec::new(), Watch::silent())?;
//! let value = |name: &str| learnt[0].model.parameters.iter().find(|p| p.name == name).map(|p| p.value);
//! assert!((value("y(t-1)").unwrap() - 0.8).abs() < 1e-9 && (value("u(t-1)").unwrap() - 0.5).abs() < 1e-9);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use std::path::Path;

use dynocal_files::dataset::STAMPS;
use dynocal_files::run_folder::digest;
use dynocal_files::spec::{Fault, SpecError};
use dynocal_ident::data::{DataError, Dataset};
use dynocal_ident::estimate::missing::bridged;
use dynocal_ident::experiment::Experiment;
use dynocal_ident::stored::StoredModel;
use dynocal_ident::validate::boundary::{BoundaryModel, Space, learn as learn_boundary};
use dynocal_ident::validate::{Kind, Seen};
use dynocal_numerics::status::Status;
use dynocal_numerics::watch::Watch;
use rayon::prelude::*;

use super::error::IdentifyError;
use super::estimate::of_parts;
use super::finding::{Finding, Grade, sorted};
use super::fit::{Estimated, saved};
use super::job::{From, estimate_target, fit_records, judged, measured, member, sampled_alike, stored_model};
use super::judge::{losses, of_fit};
use super::load::{Part, completed, seen_by};
use super::prepare::prepare_parts;
use super::remembered::{Remembered, pieces};
use super::result::Score;
use super::score::{Judged, score};
use super::set::{Set, shape};
use super::spec::{Job, Overrides, parse};

/// An estimated model with what its estimate says of itself.
#[derive(Clone, Debug)]
pub struct Learnt {
    /// The model.
    pub model: StoredModel,
    /// How the search ended.
    pub status: Option<Status>,
    /// Evaluations of its cost.
    pub evaluations: usize,
    /// Samples that it fitted.
    pub samples: usize,
    /// Rank of the information; none for an estimate without a covariance of its parameters.
    pub rank: Option<usize>,
    /// What a user should know, most important first.
    pub findings: Vec<Finding>,
}

/// What models do on records.
#[derive(Clone, Debug)]
pub struct Verdict {
    /// Fit numbers.
    pub scores: Vec<Score>,
    /// Free runs that leave everything measured, and what was lost in the preparation.
    pub findings: Vec<Finding>,
}

/// The job that the tables `model`, `prepare`, `derive` and `validate` of a spec describe for records like `record`, whose
/// channels and sample time stand for `data` and `channels`; `steady`: its rows are points without time. `name` is what
/// messages call it.
///
/// # Errors
/// [`SpecError`] with every fault; a table that only files can have is one.
pub fn job(
    name: &str,
    tables: &toml::Table,
    record: &Dataset,
    steady: bool,
    seed: Option<u64>,
) -> Result<Job, SpecError> {
    const TAKEN: [&str; 4] = ["model", "prepare", "derive", "validate"];
    let fault = |key: &str, found: String, expected: &str| Fault {
        line: None,
        key: key.into(),
        found,
        expected: expected.into(),
        nearest: None,
    };
    let foreign = tables.keys().filter(|k| !TAKEN.contains(&k.as_str()));
    let expected = "model, prepare, derive or validate: records in memory say the rest";
    let faults: Vec<Fault> = foreign.map(|k| fault(k, "this table".into(), expected)).collect();
    if !faults.is_empty() {
        return Err(SpecError { file: name.into(), faults });
    }
    let text = |v: &str| toml::Value::String(v.into());
    let mut data = toml::Table::from_iter([("file".to_string(), text("records in memory"))]);
    if steady {
        data.insert("steady".into(), toml::Value::Boolean(true));
    } else if record.sample_time_s.is_nan() {
        data.insert("time".into(), text(STAMPS));
    } else {
        data.insert("sample_time_s".into(), toml::Value::Float(record.sample_time_s));
    }
    let channel = |c: &dynocal_ident::data::Channel| {
        let role = format!("{:?}", c.role).to_lowercase();
        let keys = [("column", c.name.as_str()), ("unit", &c.unit), ("role", &role)];
        toml::Value::Table(keys.map(|(k, v)| (k.to_string(), text(v))).into_iter().collect())
    };
    let own = record.channels.iter().filter(|c| c.name != STAMPS || !record.sample_time_s.is_nan());
    let mut whole = tables.clone();
    whole.insert("data".into(), toml::Value::Table(data));
    whole.insert("channels".into(), toml::Value::Array(own.map(channel).collect()));
    let spec = toml::to_string(&whole).map_err(|e| SpecError {
        file: name.into(),
        faults: vec![fault("", e.to_string(), "tables that TOML can write")],
    })?;
    let overrides = Overrides { seed, ..Overrides::default() };
    let mut job = parse(name, &spec, &overrides).map_err(|mut e| {
        // Lines of a text that nobody has written say nothing.
        e.faults.iter_mut().for_each(|f| f.line = None);
        e
    })?;
    job.sources.clear();
    Ok(job)
}

/// Estimates the targets of a job from `records`; `selecting` are records that choose between candidates, where the
/// estimator has some. Nothing is scored: [`judge`] does that, on whatever records.
///
/// # Errors
/// [`IdentifyError`].
pub fn learn(
    job: &Job,
    records: Vec<Dataset>,
    selecting: Vec<Dataset>,
    watch: Watch,
) -> Result<Vec<Learnt>, IdentifyError> {
    if records.is_empty() {
        return Err(none("the estimation").into());
    }
    let mut origins: Vec<String> =
        records.iter().map(|d| d.origin.clone()).filter(|o| !o.is_empty()).collect();
    origins.dedup();
    let mut parts = vec![part("estimation", Seen::Identification, records)];
    if !selecting.is_empty() {
        parts.push(part("selection", Seen::Selection, selecting));
    }
    let mut parts = completed(job, parts)?;
    of_parts(job, &parts)?.allowed().map_err(|e| IdentifyError::Large(e.to_string()))?;
    let measured = measured(&parts[0].records);
    let remembered = job.targets.iter().map(|t| pieces(job, t, &parts)).collect::<Result<Vec<_>, _>>()?;
    let targets: Vec<(&super::spec::Target, Remembered)> = job.targets.iter().zip(remembered).collect();
    let preparation = prepare_parts(job, &mut parts, None)?;
    let notes = preparation.first().map_or(&[][..], |p| &p.notes);
    let one = |(t, pieces): (&super::spec::Target, Remembered)| {
        let e = estimate_target(t, &parts, watch)?.starting(job.validate.initial);
        let (boundary, remark) = boundary(job, t, &e, &parts[0])?;
        let from = From { origin: origins.join(", "), files: Vec::new(), pieces };
        let model = stored_model(job, t, &e, (&parts[0].records[0], notes, &measured), boundary, from)?;
        let mut findings = losses(&preparation);
        findings.extend(e.fit.iter().flat_map(|f| of_fit(t, f)));
        findings.extend(remark.map(|text| Finding::new(Grade::Note, t.target.as_str(), text)));
        let fit = e.fit.as_ref();
        Ok(Learnt {
            model,
            status: fit.map(|f| f.status),
            evaluations: fit.map_or(0, |f| f.evaluations),
            samples: fit.map_or(0, |f| f.samples),
            rank: fit.filter(|f| f.covariance.len() == f.theta.len().pow(2)).map(|f| f.rank),
            findings: sorted(findings),
        })
    };
    // Targets share nothing but the data.
    targets.into_par_iter().map(one).collect()
}

/// Scores `models`, which run as one set, on `records`: one step, `k_steps` ahead and free run, in the units of the records. Where
/// one of them was seen by a model ([`StoredModel::has_seen`]), they are said to be seen.
///
/// # Errors
/// [`IdentifyError`].
pub fn judge(
    models: Vec<StoredModel>,
    records: Vec<Dataset>,
    k_steps: Vec<usize>,
) -> Result<Verdict, IdentifyError> {
    if records.is_empty() {
        return Err(none("the score").into());
    }
    let mut job = Job::of_models(models, &Overrides::default())?;
    job.validate.k_steps = k_steps;
    let seen = seen_by(&job.saved, &records);
    let mut parts = completed(&job, vec![part("record", seen, records)])?;
    fit_records(&job, &parts)?;
    let range = measured(&parts[0].records);
    let preparation = prepare_parts(&job, &mut parts, None)?;
    sampled_alike(&job, &parts)?;
    let estimated: Vec<Estimated> = job.saved.iter().map(saved).collect::<Result<_, _>>()?;
    let set = Set::new(job.targets.iter().zip(&estimated).map(member).collect());
    if let Some((target, input)) = set.without_step() {
        return Err(IdentifyError::Together { target: target.into(), input: input.into() });
    }
    if let Some((target, input)) = set.loop_at_once() {
        return Err(IdentifyError::Loop { target: target.into(), input: input.into() });
    }
    let judged: Vec<Judged> = job.targets.iter().zip(&estimated).map(|(t, e)| judged(t, e, &range)).collect();
    let kinds = if job.is_steady() { vec![Kind::FreeRun] } else { job.validate.kinds() };
    let notes = preparation.first().map_or(&[][..], |p| &p.notes);
    let nowhere = (Path::new(""), None);
    let found = score(&parts[0], notes, &set, &judged, (&kinds, &job.validate), &|_, _| None, nowhere)?;
    let mut findings = found.findings;
    findings.extend(losses(&preparation));
    Ok(Verdict { scores: found.scores, findings: sorted(findings) })
}

/// Digest of what a record holds: sample time, names, units and samples. Its name and origin do not count.
pub fn fingerprint(d: &Dataset) -> String {
    let mut bytes = d.sample_time_s.to_bits().to_le_bytes().to_vec();
    for c in &d.channels {
        bytes.extend(c.name.as_bytes());
        bytes.extend(c.unit.as_bytes());
        bytes.extend(c.values.iter().flat_map(|v| v.to_bits().to_le_bytes()));
    }
    digest(&bytes)
}

fn part(name: &str, seen: Seen, records: Vec<Dataset>) -> Part {
    Part { name: name.into(), seen, records, notes: Vec::new() }
}

fn none(what: &str) -> DataError {
    let why = format!("records for {what}");
    DataError::TooShort { record: "records in memory".into(), found: 0, expected: 1, why }
}

/// What of the space of lagged inputs and outputs was identified, or why that is not known.
fn boundary(
    job: &Job,
    t: &super::spec::Target,
    e: &Estimated,
    estimation: &Part,
) -> Result<(Option<BoundaryModel>, Option<String>), DataError> {
    let Some((model, _)) = e.model.simulated() else { return Ok((None, None)) };
    let of = |d: &Dataset| Ok(bridged(&shape(d, &t.inputs, &t.target)?).0);
    let data: Vec<Experiment> = estimation.records.iter().map(of).collect::<Result<_, DataError>>()?;
    Ok(match learn_boundary(Space::of(model), &data, &job.validate.boundary) {
        Ok(found) => (Some(found), None),
        Err(error) => (None, Some(format!("no boundary of what was identified: {error}"))),
    })
}
