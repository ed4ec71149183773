//! What an optimisation over a record found.

use super::Found;
use super::dynamic::GridValue;
use super::prices::Price;
use super::program::Sum;
use super::robust::Spread;
use super::setup::Setup;
use super::shortfall::Shortfall;
use crate::problem::ObjectiveTerm;
use dynocal_ident::data::{Channel, Role};
use dynocal_numerics::status::Status;
use serde::{Deserialize, Serialize};

/// One term of the objective at start and optimum.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TermValue {
    /// Channel.
    pub channel: String,
    /// Its unit.
    pub unit: String,
    /// Weight.
    pub weight: f64,
    /// Mean of the channel over the decided samples at the start, without the weight.
    pub start: f64,
    /// The same at the optimum.
    pub optimum: f64,
}

/// How far an output of the free run on the optimal inputs is from what was asked of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Violation {
    /// Output, or input with a rate limit.
    pub channel: String,
    /// Its unit; for rates per sample.
    pub unit: String,
    /// What was asked: `demand`, `lower`, `upper`, `mean_upper`, `rate`.
    pub of: String,
    /// Largest distance from it; 0 when it is kept, infinite when the free run diverged.
    pub largest: f64,
    /// Time in s from the start of the record at which that is; absent for means.
    pub at_s: Option<f64>,
}

/// One part of a record that was optimised in parts.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PartOutcome {
    /// Start in s.
    pub from_s: f64,
    /// End in s: the seam with the next part.
    pub to_s: f64,
    /// How its search ended.
    pub status: Status,
    /// Its iterations.
    pub iterations: usize,
}

/// Result of one optimisation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Optimum {
    /// How the search ended.
    pub status: Status,
    /// Iterations.
    pub iterations: usize,
    /// Sample time in s.
    pub sample_time_s: f64,
    /// First decided sample.
    pub first: usize,
    /// One past the last decided sample.
    pub last: usize,
    /// Optimal inputs, in the order of the problem.
    pub inputs: Vec<Channel>,
    /// Demands that were met: the models' response to the start inputs, in the order of the problem.
    pub demands: Vec<Channel>,
    /// Outputs that are not demanded, at the optimum.
    pub outputs: Vec<Channel>,
    /// All outputs as the free run of the models on the optimal inputs gives them, in the order of the models; NaN where
    /// that diverged.
    pub responses: Vec<Channel>,
    /// Objective by term.
    pub terms: Vec<TermValue>,
    /// Sum of the weighted terms at the start, weights on increments and soft limits left out.
    pub start_objective: f64,
    /// The same at the optimum.
    pub objective: f64,
    /// What the search minimised and prices are derivatives of: the objective over the samples that were added to the end too, with
    /// weights on increments and soft limits; absent where the record was not optimised as a whole.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub minimised: Option<f64>,
    /// Its parts, where the record was not optimised as a whole.
    pub parts: Vec<PartOutcome>,
    /// Where and by how much the problem cannot be met (in the first part that failed, where there are parts); empty when
    /// it was solved.
    pub shortfalls: Vec<Shortfall>,
    /// What demands and limits cost; empty where the record was not optimised as a whole.
    pub prices: Vec<Price>,
    /// How far draws of the demanded outputs' models are from the demand; empty where none were asked for.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub spreads: Vec<Spread>,
    /// What the grid of dynamic programming gave; absent for the other ways.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub grid: Option<GridValue>,
    /// What the free run of the models on the optimal inputs violates, one entry for each thing asked.
    pub violations: Vec<Violation>,
}

impl Optimum {
    pub(super) fn new(setup: &Setup<'_>, found: &Found, samples: usize) -> Self {
        let values = &found.values[..samples * setup.columns.len()];
        let inputs = setup.problem.inputs.len();
        let column = |c: usize, role| Channel {
            name: setup.columns[c].clone(),
            unit: setup.problem.unit(&setup.columns[c]).unwrap_or("-").into(),
            role,
            values: values.iter().skip(c).step_by(setup.columns.len()).copied().collect(),
        };
        let demand = |name: &String| Channel {
            name: name.clone(),
            unit: setup.problem.unit(name).unwrap_or("-").into(),
            role: Role::Output,
            values: setup.given(name).map_or(Vec::new(), |v| v[..samples].to_vec()),
        };
        let terms = terms(setup, &found.values, samples);
        let total = |of: fn(&TermValue) -> f64| terms.iter().map(|t| t.weight * of(t)).sum();
        let (violations, responses) = free_runs(setup, &found.values, samples);
        // A plan that misses less than what is said to be missing at least shows that so much need not be missing.
        let missed = |output: &str| {
            violations.iter().filter(|v| v.channel == output).map(|v| v.largest).fold(0.0, f64::max)
        };
        let proven =
            |s: &&Shortfall| found.status == Status::Infeasible || s.largest.abs() <= missed(&s.output);
        let shortfalls = found.shortfalls.iter().filter(proven).cloned().collect();
        Self {
            status: found.status,
            iterations: found.iterations,
            sample_time_s: setup.sample_time_s,
            first: setup.from,
            last: setup.to - (setup.samples - samples),
            inputs: (0..inputs).map(|c| column(c, Role::Input)).collect(),
            demands: setup.problem.demand_names().iter().map(demand).collect(),
            outputs: (inputs..setup.columns.len()).map(|c| column(c, Role::Output)).collect(),
            start_objective: total(|t| t.start),
            objective: total(|t| t.optimum),
            terms,
            minimised: found.minimised,
            parts: found.parts.clone(),
            shortfalls,
            prices: found.prices.clone(),
            spreads: Vec::new(),
            grid: found.grid.clone(),
            violations,
            responses,
        }
    }

    /// An optimal input by name.
    pub fn input(&self, name: &str) -> Option<&[f64]> {
        self.inputs.iter().find(|c| c.name == name).map(|c| c.values.as_slice())
    }

    /// Largest violation of a demand or limit of an output.
    pub fn violation(&self, channel: &str) -> f64 {
        let of = self.violations.iter().filter(|v| v.channel == channel).map(|v| v.largest);
        of.fold(0.0, f64::max)
    }
}

/// Means over the decided samples of the record as it was given, without what was added to its end.
fn terms(setup: &Setup<'_>, found: &[f64], samples: usize) -> Vec<TermValue> {
    let width = setup.columns.len();
    let value = |sum: &Sum, values: &[f64]| {
        let cut = Sum { to: sum.to - (setup.samples - samples), ..sum.clone() };
        let share = (sum.to - sum.from) as f64 / (cut.to - cut.from) as f64;
        share * cut.value_of(values, width)
    };
    let terms = setup.problem.minimise.iter().zip(setup.objective_sums());
    let of = |(term, sum): (&ObjectiveTerm, Sum)| TermValue {
        channel: term.channel.clone(),
        unit: setup.problem.unit(&term.channel).unwrap_or("-").into(),
        weight: term.weight,
        start: value(&sum, &setup.start),
        optimum: value(&sum, found),
    };
    terms.map(of).collect()
}

/// The largest of values with their samples; 0 when none is positive.
fn largest(of: impl Iterator<Item = (usize, f64)>) -> (f64, usize) {
    of.fold((0.0f64, 0), |(m, at), (t, e)| if e > m || e.is_nan() { (e, t) } else { (m, at) })
}

/// The free runs of the models on the inputs found, and by how much they and the inputs violate what was asked.
fn free_runs(setup: &Setup<'_>, found: &[f64], samples: usize) -> (Vec<Violation>, Vec<Channel>) {
    let width = setup.columns.len();
    let mut values = found.to_vec();
    let mut responses = Vec::new();
    let mut out = Vec::new();
    let mut push = |channel: &str, of: &str, (largest, t): (f64, usize)| {
        let largest = if largest.is_nan() { f64::INFINITY } else { largest };
        out.push(Violation {
            channel: channel.into(),
            unit: setup.problem.unit(channel).unwrap_or("-").into(),
            of: of.into(),
            largest,
            at_s: Some(t as f64 * setup.sample_time_s),
        });
    };
    for m in &setup.models {
        let column = setup.columns.iter().position(|n| *n == m.output);
        let asked: Vec<f64> = match column {
            None => setup.given(&m.output).unwrap_or(&[]).to_vec(),
            Some(c) => (0..setup.samples).map(|t| values[t * width + c]).collect(),
        };
        let from: Vec<f64> = asked.iter().map(|y| m.way.to_model(*y)).collect();
        let run = setup.free_run(m, &values, &from, setup.first_equation());
        let run: Vec<f64> = match run {
            Some(y) => y.into_iter().map(|v| m.way.to_user(v)).collect(),
            None => vec![f64::NAN; setup.samples],
        };
        responses.push(Channel {
            name: m.output.clone(),
            unit: setup.problem.unit(&m.output).unwrap_or("-").into(),
            role: Role::Output,
            values: run[..samples].to_vec(),
        });
        let Some(c) = column else {
            let distance = (0..samples).map(|t| (t, (run[t] - asked[t]).abs()));
            push(&m.output, "demand", largest(distance));
            continue;
        };
        (0..setup.samples).for_each(|t| values[t * width + c] = run[t]);
        let limit = setup.problem.limits.iter().find(|l| l.output == m.output);
        let first = setup.first_equation();
        let [lower, upper] = limit.map_or([None, None], |l| setup.limits_of(l));
        if let Some(lower) = lower {
            push(&m.output, "lower", largest((first..samples).map(|t| (t, lower[t] - run[t]))));
        }
        if let Some(upper) = upper {
            push(&m.output, "upper", largest((first..samples).map(|t| (t, run[t] - upper[t]))));
        }
    }
    for (c, input) in setup.problem.inputs.iter().enumerate() {
        let Some(rate) = input.rate_per_s.map(|r| r * setup.sample_time_s) else { continue };
        let steps = (setup.from.max(1)..samples).map(|t| {
            let step = values[t * width + c] - values[(t - 1) * width + c];
            (t, step.abs() - rate)
        });
        push(&input.name, "rate", largest(steps));
    }
    for (name, sum, upper) in setup.mean_limits() {
        let unit = setup.problem.unit(&name).unwrap_or("-").to_string();
        let beyond = sum.value_of(&values, width) - upper;
        let largest = if beyond.is_nan() { f64::INFINITY } else { beyond.max(0.0) };
        out.push(Violation { channel: name, unit, of: "mean_upper".into(), largest, at_s: None });
    }
    (out, responses)
}
