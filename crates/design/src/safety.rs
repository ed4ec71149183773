//! Predicted outputs of a design against their limits.

use crate::problem::{DesignProblem, Evaluator};
use dynocal_numerics::interval::Interval;

/// One predicted output over a record.
#[derive(Clone, Debug, PartialEq)]
pub struct Safety {
    /// Name of the output.
    pub name: String,
    /// Predicted output (N).
    pub predicted: Vec<f64>,
    /// Least and largest prediction over the samples that are computed.
    pub range: Interval,
    /// Worst distance to a limit with its margin, negative where it is passed; `None` without limits.
    pub worst: Option<Worst>,
}

/// Where an output comes nearest to a limit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Worst {
    /// Distance kept to the limit beyond the margin, in the unit of the output; negative: violated.
    pub distance: f64,
    /// Sample.
    pub sample: usize,
    /// Predicted output there.
    pub output: f64,
    /// The limit with its margin.
    pub limit: f64,
}

/// Outputs of the record that `evaluator` evaluated last.
pub fn safety(problem: &DesignProblem, evaluator: &Evaluator) -> Vec<Safety> {
    let first = evaluator.first_computed();
    problem
        .terms
        .iter()
        .enumerate()
        .map(|(i, term)| {
            let y = evaluator.output(i);
            let computed = || y.iter().enumerate().skip(first);
            let range = Interval::spanning(computed().map(|(_, v)| *v));
            let worst = term.limits.and_then(|l| {
                let Interval { lower, upper } = l.kept();
                computed()
                    .map(|(sample, output)| {
                        let below = upper - output < output - lower;
                        let (distance, limit) =
                            if below { (upper - output, upper) } else { (output - lower, lower) };
                        Worst { distance, sample, output: *output, limit }
                    })
                    .min_by(|a, b| a.distance.total_cmp(&b.distance))
            });
            Safety { name: term.name.into(), predicted: y.to_vec(), range, worst }
        })
        .collect()
}
