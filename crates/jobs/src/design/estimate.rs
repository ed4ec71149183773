//! What a design takes, before it runs.

use super::Job;
use super::error::DesignJobError;
use super::load::{Inputs, load};
use crate::estimate::Estimate;

/// Reads what the spec names and says what the search will do.
///
/// An evaluation factorises the scaled sensitivities (N x p, 2 N p^2 operations) and goes back through them for the
/// gradient, which costs about as much again.
///
/// # Errors
/// [`DesignJobError`]: models or records that cannot be read.
pub fn estimate(job: &Job) -> Result<Estimate, DesignJobError> {
    let inputs: Inputs = load(job)?;
    let n = job.samples as f64;
    let search = &job.search;
    let evaluations = (search.starts * search.evaluations) as f64;
    let length = format!("{} samples of {} s", job.samples, job.sample_time_s);
    let how = format!("{} starts of {}, {} evaluations each", search.starts, search.name, search.evaluations);
    let mut plan = Estimate::new(&job.name)
        .line("record", length)
        .line("channels", inputs.channels.iter().map(|c| c.name.as_str()).collect::<Vec<_>>().join(", "))
        .line("search", how)
        .line("run folder", job.out.display().to_string());
    let threads = search.starts.min(rayon::current_num_threads()) as f64;
    for m in &inputs.models {
        let p = m.theta.len() as f64;
        let criterion =
            m.criterion.as_ref().map_or("limits only".into(), |c| format!("criterion {}", c.name));
        plan = plan
            .line(format!("model {}", m.name), format!("{} parameters, {criterion}", m.theta.len()))
            .memory(8.0 * 3.0 * n * p * threads)
            .work(evaluations * 4.0 * n * p * p);
    }
    Ok(plan)
}
