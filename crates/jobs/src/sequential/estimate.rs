//! What a campaign takes, before it runs.

use dynocal_ident::model::kinds;

use super::result::SequentialError;
use super::spec::Job;
use crate::estimate::Estimate;

/// What will be played and searched. Every evaluation of the search factorises the scaled sensitivities of the models (N x p),
/// and every round is played a second time with random records beside it.
///
/// # Errors
/// [`SequentialError`]: a structure that does not fit the channels.
pub fn estimate(job: &Job) -> Result<Estimate, SequentialError> {
    let n = job.samples as f64;
    let inputs: Vec<String> = job.channels.iter().map(|c| c.name.clone()).collect();
    let dt = job.sample_time_s;
    let all = job.first + job.rounds * job.samples;
    let mut plan = Estimate::new(&job.name)
        .line("run folder", job.out.display().to_string())
        .line("plant", job.plant.name.clone())
        .line("channels", inputs.join(", "))
        .line("first record", format!("{} samples of {dt} s", job.first))
        .line("designed records", format!("at most {} of {} samples", job.rounds, job.samples))
        .line(
            "bed time",
            format!("at most {:.0} s, and as much for the random records beside", all as f64 * dt),
        )
        .memory(8.0 * 6.0 * (2 * all + job.held_out) as f64 * (inputs.len() + job.outputs.len()) as f64);
    let draws = job.robust.as_ref().map_or(1, |r| r.draws) as f64;
    let evaluations = (job.search.starts * job.search.evaluations * job.rounds) as f64 * draws;
    for o in &job.outputs {
        let refused = |source| SequentialError::Structure { output: o.name.clone(), source };
        let form = kinds::kind(&o.kind, &o.keys)?.form(&inputs, &o.name, &[]).map_err(refused)?;
        let p = form.parameters() as f64;
        plan = plan
            .line(format!("model of {}", o.name), format!("{}, {p} parameters", o.kind))
            .memory(8.0 * 3.0 * n * p * draws)
            .work(evaluations * 4.0 * n * p * p);
    }
    Ok(plan)
}
