//! Whether problem, models and start belong together.

use super::error::OptimiseError;
use super::model::OutputModel;
use crate::problem::CalibrationProblem;
use dynocal_ident::data::Dataset;

/// Slack of the check that a start is inside of its bounds, relative to their width.
const INSIDE: f64 = 1e-9;

/// Checks which outputs the models compute and what they read; sorts them so that each reads outputs of earlier ones only.
pub(super) fn in_order<'a>(
    problem: &CalibrationProblem,
    models: &[OutputModel<'a>],
) -> Result<Vec<OutputModel<'a>>, OptimiseError> {
    let outputs: Vec<String> = problem.demand_names().into_iter().chain(problem.other_outputs()).collect();
    let names: Vec<String> = models.iter().map(|m| m.output.clone()).collect();
    let known = || outputs.join(", ");
    for (k, name) in names.iter().enumerate() {
        let found = match (outputs.contains(name), names[..k].contains(name)) {
            (false, _) => "of an output that the problem does not name",
            (_, true) => "the second one of that output",
            _ => continue,
        };
        return Err(OptimiseError::Model { output: name.clone(), found, known: known() });
    }
    for (k, output) in outputs.iter().enumerate() {
        if !names.contains(output) {
            let role = if k < problem.demands.len() { "demands" } else { "limits or frees" };
            return Err(OptimiseError::NoModel { output: output.clone(), role, known: names.join(", ") });
        }
    }
    let there: Vec<String> =
        problem.input_names().into_iter().chain(problem.given_names()).chain(names.clone()).collect();
    for m in models {
        if let Some(found) = m.channels().find(|c| !there.iter().any(|n| n == c)) {
            let (output, found) = (m.output.clone(), found.to_string());
            return Err(OptimiseError::Input { output, found, known: there.join(", ") });
        }
    }
    for input in problem.input_names() {
        if !models.iter().any(|m| m.channels().any(|c| c == input)) {
            return Err(OptimiseError::Unread { input });
        }
    }
    let (mut sorted, mut left) = (Vec::new(), models.to_vec());
    while !left.is_empty() {
        let waits = |m: &OutputModel| m.channels().any(|c| left.iter().any(|l| l.output == c));
        let Some(next) = left.iter().position(|m| !waits(m)) else {
            let outputs: Vec<String> = left.iter().map(|m| m.output.clone()).collect();
            return Err(OptimiseError::Ring { outputs: outputs.join(", ") });
        };
        sorted.push(left.remove(next));
    }
    Ok(sorted)
}

/// Whether every input of the start lies inside of its bounds.
pub(super) fn check_start(problem: &CalibrationProblem, start: &Dataset) -> Result<(), OptimiseError> {
    for input in &problem.inputs {
        let channel = start.channel(&input.name)?;
        let slack = INSIDE * (input.upper - input.lower);
        let outside = |v: &f64| !(input.lower - slack..=input.upper + slack).contains(v);
        if let Some(sample) = channel.values.iter().position(outside) {
            return Err(OptimiseError::Start {
                record: start.name.clone(),
                channel: input.name.clone(),
                found: channel.values[sample],
                unit: channel.unit.clone(),
                sample,
                lower: input.lower,
                upper: input.upper,
            });
        }
    }
    Ok(())
}
