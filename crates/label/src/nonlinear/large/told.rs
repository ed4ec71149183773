//! What the data say of each cell, from draws.

use super::super::Target;
use super::system::{Exact, Pairs, System};
use crate::correlation;
use crate::error::LabelError;
use crate::graph::Graph;
use crate::linear::{Fit, Open, Options, Verdict, huber};

/// Two-sided 95 % of Student's distribution, by the number of draws that a standard deviation comes from.
const T95: [f64; 16] = [
    12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160, 2.145, 2.131,
    2.120,
];
/// How exact a draw is.
const DRAWN: Exact = Exact { left: 0.03, most: 100 };

/// Values, intervals, verdicts at `theta`. Draws x of covariance `H^-1` give the spread of each cell, and `x'J'WJx` the parameters that
/// the fit effectively has.
pub(super) fn tell(
    graph: &Graph,
    theta: &[f64],
    targets: &[Target],
    system: &System,
    options: &Options,
) -> Result<Fit, LabelError> {
    let free = &system.free;
    let mut squares = vec![0.0; theta.len()];
    let mut parameters = 0.0;
    let draws = options.draws.min(T95.len());
    let mut pairs = Pairs::default();
    for draw in 0..draws {
        let x = system.solve(&system.noise(draw as u64), free, 0.0, DRAWN, &mut pairs, &|| false)?;
        parameters += system.square(&x) / draws as f64;
        squares.iter_mut().zip(&x).for_each(|(s, x)| *s += x * x / draws as f64);
    }
    if draws == 0 {
        parameters = free.iter().filter(|f| **f).count() as f64;
    }
    let (left, weights, tau) = correlated(targets, system);
    let square: f64 = left.iter().zip(&weights).map(|(r, w)| w * r * r).sum();
    let mut variance = square / (left.len() as f64 - tau * parameters).max(1.0);
    if options.robust {
        let plain = targets.iter().zip(&system.weights).flat_map(|(t, w)| t.weights.iter().zip(w));
        let plain: Vec<f64> = plain.filter(|(_, w)| **w > 0.0).map(|(plain, _)| *plain).collect();
        variance *= huber::variance(&left, &plain, &weights, parameters);
    }
    let half = |k: usize| match (free[k], draws) {
        (false, _) | (_, 0) => f64::INFINITY,
        _ => T95[draws - 1] * (tau * variance * squares[k]).sqrt(),
    };
    let locked: Vec<bool> = graph.labels.iter().flat_map(|l| l.locked.iter().copied()).collect();
    let ties = system.ties();
    let facts: Vec<f64> = system.facts.iter().map(|f| f / tau).collect();
    let verdict = |k: usize| {
        if locked[k] {
            Verdict::Locked
        } else if system.visits[k] <= 0.0 || !free[k] {
            Verdict::Untouched
        } else if facts[k] >= 1.0 && system.diagonal[k] >= ties[k] {
            Verdict::Determined
        } else {
            Verdict::Pulled
        }
    };
    let all = 0..theta.len();
    let before = rms(targets, &residuals(graph, &graph.base(), targets));
    let (values, proven) = whole_steps(graph, theta);
    Ok(Fit {
        values,
        exact: theta.to_vec(),
        half_width: all.clone().map(|k| if locked[k] { 0.0 } else { half(k) }).collect(),
        visits: system.visits.clone(),
        verdicts: all.map(verdict).collect(),
        facts,
        smooth: options.smooth.unwrap_or(super::super::FIRST_SMOOTH),
        sigma: variance.sqrt(),
        correlation_samples: tau,
        effective_parameters: parameters,
        rms: [before, rms(targets, &system.residuals)],
        held: held(graph, theta),
        broken: Vec::new(),
        proven,
        open: Open::default(),
    })
}

/// What is left of the samples that count, their weights, and how many of them are one independent one.
fn correlated(targets: &[Target], system: &System) -> (Vec<f64>, Vec<f64>, f64) {
    let (mut left, mut weights, mut segments) = (Vec::new(), Vec::new(), Vec::new());
    for (t, (r, w)) in targets.iter().zip(system.residuals.iter().zip(&system.weights)) {
        let mut from = left.len();
        for k in 0..t.y.len() {
            if w[k] > 0.0 {
                left.push(r[k]);
                weights.push(w[k]);
            } else if left.len() > from {
                segments.push(from..left.len());
                from = left.len();
            }
        }
        segments.push(from..left.len());
    }
    let tau = correlation::time_samples(&left, &segments);
    (left, weights, tau)
}

fn residuals(graph: &Graph, theta: &[f64], targets: &[Target]) -> Vec<Vec<f64>> {
    let one = |t: &Target| {
        let y = graph.run(theta, &t.record).values.swap_remove(t.node_of(graph));
        t.y.iter().zip(y).map(|(y, f)| y - f).collect()
    };
    targets.iter().map(one).collect()
}

fn rms(targets: &[Target], left: &[Vec<f64>]) -> f64 {
    let (mut sum, mut all) = (0.0, 0.0);
    for (t, left) in targets.iter().zip(left) {
        for k in t.counts() {
            sum += t.weights[k] * left[k] * left[k];
            all += t.weights[k];
        }
    }
    (sum / f64::max(all, 1e-300)).sqrt()
}

/// Each cell on the step that is nearest: the joint search needs the equations as a whole.
fn whole_steps(graph: &Graph, theta: &[f64]) -> (Vec<f64>, Option<bool>) {
    let cells = graph.labels.iter().flat_map(|l| (0..l.len()).map(move |k| (l, k)));
    let near = |(l, k): (&crate::label::Label, usize), v: f64| match l.step {
        Some(step) if !l.locked[k] && v != l.base[k] => {
            let steps = |x: f64| (x - l.origin) / step;
            // A bound may lie between two steps.
            let count = steps(v).round().clamp(steps(l.lower).ceil(), steps(l.upper).floor());
            l.origin + step * count
        }
        _ => v,
    };
    let values = cells.zip(theta).map(|(at, v)| near(at, *v)).collect();
    (values, graph.labels.iter().any(|l| l.step.is_some()).then_some(false))
}

fn held(graph: &Graph, theta: &[f64]) -> Vec<String> {
    let mut at = theta.iter();
    let mut out = Vec::new();
    for l in &graph.labels {
        for (v, locked) in at.by_ref().take(l.len()).zip(&l.locked) {
            for (side, bound) in [("least", l.lower), ("greatest", l.upper)] {
                if !locked && *v == bound {
                    out.push(format!("`{}`: {side} value {bound} {}", l.name, l.unit));
                }
            }
        }
    }
    out
}
