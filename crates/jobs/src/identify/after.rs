//! How far a model can be trusted beyond its scores: spread over records, cross-validation, stability, boundary.

use dynocal_ident::estimate;
use dynocal_ident::estimate::missing::bridged;
use dynocal_ident::experiment::Experiment;
use dynocal_ident::validate::boundary::{BoundaryModel, Space, coverage, learn};
use dynocal_ident::validate::cross::{Blocks, CrossValidation, cross_validate};
use dynocal_ident::validate::spread::ScorePool;
use dynocal_ident::validate::stability::{Stability, Trials, free_run_stability};
use dynocal_ident::validate::{Kind, Reference, score_values};
use serde::{Deserialize, Serialize};

use super::error::IdentifyError;
use super::fit::Estimated;
use super::load::Part;
use super::set::shape;
use super::spec::{Job, Target};
use dynocal_numerics::watch::Watch;

/// What is known of one model beyond its scores.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct After {
    /// Free-run errors over the records of each part that has several.
    pub pools: Vec<PoolRow>,
    /// Cross-validation by blocks, where asked for.
    pub folds: Option<CrossValidation>,
    /// Free runs on the unseen records and on random inputs within the limits of the estimation records.
    pub stability: Option<Stability>,
    /// How far each part is from what was identified.
    pub coverage: Vec<CoverageRow>,
    /// What could not be computed, and why.
    pub remarks: Vec<String>,
}

/// Scores over the records of one part.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct PoolRow {
    /// Part of the data.
    pub part: String,
    /// Scores of the free run, in prepared units.
    pub scores: ScorePool,
}

/// How far the records of a part are from those of the estimation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CoverageRow {
    /// Part of the data.
    pub part: String,
    /// Share of the samples outside the boundary, in percent.
    pub outside_percent: f64,
    /// Largest distance; 1 is the boundary.
    pub worst: f64,
    /// Record of it.
    pub record: String,
    /// Sample of it.
    pub sample: usize,
}

/// Everything after the fit of one target, and the boundary to be stored with the model.
///
/// # Errors
/// [`IdentifyError`]: interrupted, or an estimate of the cross-validation that is not possible at all.
pub fn after(
    job: &Job,
    t: &Target,
    e: &Estimated,
    parts: &[Part],
    watch: Watch,
) -> Result<(After, Option<BoundaryModel>), IdentifyError> {
    let mut out = After::default();
    let mut shaped: Vec<(&Part, Vec<Experiment>)> = Vec::new();
    for part in parts {
        let of = |d| shape(d, &t.inputs, &t.target);
        shaped.push((part, part.records.iter().map(of).collect::<Result<_, _>>()?));
    }
    out.pools = shaped.iter().filter(|(_, e)| e.len() > 1).map(|(p, r)| pool(p, r, e, job)).collect();
    // From here on nothing is compared: bridged samples only drive the models.
    for record in shaped.iter_mut().flat_map(|s| &mut s.1) {
        *record = bridged(record).0;
    }
    let data = &shaped[0].1;
    let Some((model, theta)) = e.model.simulated() else { return Ok((out, None)) };
    if job.validate.stability_runs > 0 {
        let trials = Trials { runs: job.validate.stability_runs, seed: job.seed, ..Trials::default() };
        let unseen: Vec<Experiment> = shaped[1..].iter().flat_map(|s| s.1.clone()).collect();
        out.stability = Some(free_run_stability(model, theta, data, &unseen, &trials)?);
    }
    if job.validate.folds > 1 && job.saved.is_empty() && !job.is_steady() {
        cross(job, t, e, data, &mut out, watch)?;
    }
    let boundary = match learn(Space::of(model), data, &job.validate.boundary) {
        Ok(b) => Some(b),
        Err(error) => {
            out.remarks.push(format!("no boundary of what was identified: {error}"));
            None
        }
    };
    if let Some(b) = &boundary {
        out.coverage =
            shaped[1..].iter().filter_map(|(part, records)| covered(part, records, e, b)).collect();
    }
    Ok((out, boundary))
}

fn pool(part: &Part, records: &[Experiment], e: &Estimated, job: &Job) -> PoolRow {
    let one = |r: &Experiment| {
        let first = e.model.first(r).min(r.len());
        let found = e.model.output(&bridged(r).0, Kind::FreeRun)?;
        let s = score_values(&r.y[first..], &found[first..], Kind::FreeRun, part.seen, Reference::Noisy);
        Some((r.name.clone(), s))
    };
    let scores = ScorePool::of(records.iter().filter_map(one).collect(), job.validate.confidence);
    PoolRow { part: part.name.clone(), scores }
}

fn cross(
    job: &Job,
    t: &Target,
    e: &Estimated,
    data: &[Experiment],
    out: &mut After,
    watch: Watch,
) -> Result<(), IdentifyError> {
    watch.note(&format!("{}: cross-validation in {} folds", t.target, job.validate.folds));
    let blocks = Blocks { folds: job.validate.folds, gap: 0, confidence: job.validate.confidence };
    let estimator = estimate::estimator(&t.estimator, &t.estimator_keys)?;
    let found = cross_validate(e.model.form(), data, estimator.as_ref(), &blocks, watch.interrupt)?;
    out.remarks.extend(found.failed.iter().map(|f| format!("cross-validation: {f}")));
    out.folds = Some(found);
    Ok(())
}

fn covered(part: &Part, records: &[Experiment], e: &Estimated, b: &BoundaryModel) -> Option<CoverageRow> {
    let mut row: Option<CoverageRow> = None;
    let (mut outside, mut samples) = (0.0, 0);
    for r in records {
        let start = e.model.first(r).min(r.len());
        let y = e.model.output(r, Kind::FreeRun)?;
        let found = coverage(b, &r.u, &y, start);
        outside += found.share_outside * (r.len() - start) as f64;
        samples += r.len() - start;
        // A run that diverges is infinitely far from everything.
        let worst = if found.worst.is_nan() { f64::INFINITY } else { found.worst };
        if row.as_ref().is_none_or(|row| worst > row.worst) {
            row = Some(CoverageRow {
                part: part.name.clone(),
                outside_percent: 0.0,
                worst,
                record: r.name.clone(),
                sample: found.sample,
            });
        }
    }
    let mut row = row?;
    row.outside_percent = 100.0 * outside / samples.max(1) as f64;
    row.worst = row.worst.min(f64::MAX);
    Some(row)
}
