//! What an identification takes, before it runs.

use dynocal_ident::model::kinds;

use super::error::IdentifyError;
use super::load::Part;
use super::spec::{Job, Target};
use crate::estimate::Estimate;

/// Evaluations of the cost that an iterative estimator takes where the spec says nothing.
const EVALUATIONS: f64 = 50.0;

/// What will be estimated from parts that have been read.
///
/// An estimate with p parameters (or p candidates of a pool) factorises an N x p matrix, 2 N p^2 operations, once for each
/// evaluation or step of the selection. Samples are counted before the preparation.
///
/// # Errors
/// [`IdentifyError`]: a structure that does not fit the channels.
pub(super) fn of_parts(job: &Job, parts: &[Part]) -> Result<Estimate, IdentifyError> {
    let mut plan = Estimate::new(&job.name).line("run folder", job.out.display().to_string());
    let mut n = 0.0;
    for (k, part) in parts.iter().enumerate() {
        let samples: usize = part.records.iter().map(|d| d.len()).sum();
        if k == 0 {
            n = samples as f64;
        }
        let channels = part.records.first().map_or(0, |d| d.channels.len());
        plan = plan
            .line(format!("part {}", part.name), format!("{} records, {samples} samples", part.records.len()))
            .memory(8.0 * 3.0 * (samples * channels) as f64);
    }
    if !job.saved.is_empty() {
        // What is only scored needs no matrix of its own.
        return Ok(plan.line("models", format!("{} saved, scored only", job.saved.len())));
    }
    for t in &job.targets {
        let (columns, text) = columns(t)?;
        let evaluations = t
            .estimator_keys
            .get("max_evaluations")
            .and_then(|v| v.as_integer())
            .map_or(EVALUATIONS, |v| v as f64);
        plan = plan
            .line(format!("model of {}", t.target), format!("{text}, estimator {}", t.estimator))
            .memory(8.0 * 2.0 * n * columns)
            .work(evaluations * 2.0 * n * columns * columns);
    }
    Ok(plan)
}

/// Columns of the largest matrix of a target, and what they are.
fn columns(t: &Target) -> Result<(f64, String), IdentifyError> {
    if let Some(select) = &t.select
        && let Some(pool) = &select.pool
    {
        let n = pool.pool(&t.inputs, &t.target)?.candidates().len();
        return Ok((n as f64, format!("terms selected from a pool of {n}")));
    }
    let n = kinds::kind(&t.structure.name, &t.structure.keys)?.form(&t.inputs, &t.target, &[])?.parameters();
    Ok((n as f64, format!("{}, {n} parameters", t.structure.name)))
}
