//! Whether fitted labels are taken, on samples that they were not fitted to.

use std::ops::Range;

use dynocal_label::correlation::{mean_and_error, t_one_sided};
use dynocal_label::graph::Graph;
use dynocal_label::linear::{Fit, huber};
use dynocal_label::nonlinear::{Target, times_a_memory};
use dynocal_label::ve::judge::Decision;

use super::work::rms;

/// Independent measurements of which the variance of their gain can be told at all.
pub(super) const LEAST: f64 = 3.0;
/// One-sided 95 % of the normal distribution.
const COUNTS: f64 = 1.645;
/// Distance from a bound, as a share of it, at which a label lies on it.
const ON_BOUND: f64 = 1e-6;

/// Least standard error of a gain that counts, as a share of it.
const SURE: f64 = 1e-6;

/// The function before and after.
pub(super) struct Sides<'a> {
    pub(super) before: &'a Graph,
    pub(super) after: &'a Graph,
    pub(super) values: &'a [f64],
    /// Knee of the loss, where it is Huber's.
    pub(super) knee: Option<f64>,
}

/// The knee of Huber's loss by what the fitted samples are left by.
pub(super) fn knee(graph: &Graph, values: &[f64], fitted: &[Target]) -> f64 {
    let (mut left, mut weights) = (Vec::new(), Vec::new());
    for t in fitted {
        let y = graph.all_values(values, &t.record).swap_remove(t.node.unwrap_or(graph.nodes.len() - 1));
        left.extend(t.y.iter().zip(y).map(|(y, f)| y - f));
        weights.extend_from_slice(t.weights);
    }
    huber::knee(&left, &weights)
}

/// What unseen samples say.
#[derive(Clone, Debug)]
pub(super) struct Judged {
    pub(super) decision: Decision,
    /// Whether the fit improves the samples that it was fitted to by no more than it would fit noise.
    pub(super) noise: bool,
    pub(super) improvement: f64,
    pub(super) needed: f64,
    pub(super) facts: f64,
}

/// Judges by the gain of the weighted squares (with a knee of Huber's loss), sample by sample, correlated samples counted as what they are worth; what fits no more than
/// noise is no statement either way (twice the gain of the log likelihood against the 95 % point of chi-squared with the effective
/// parameters, as of the fuel table).
pub(super) fn of(s: &Sides, fitted: &[Target], judging: &[Target], fit: &Fit) -> Judged {
    let (gain, segments) = gains(s, judging);
    let (mean, error, facts) = mean_and_error(&gain, &segments, 1.0);
    let needed = t_one_sided(facts - 1.0);
    // A gain that is the same at every sample has no error to speak of.
    let improvement = if mean == 0.0 { 0.0 } else { mean / error.max(SURE * mean.abs()) };
    let samples: usize = fitted.iter().map(|t| t.weights.iter().filter(|w| **w > 0.0).count()).sum();
    let (before, after) =
        (rms(s.before, &s.before.base(), fitted, s.knee), rms(s.after, s.values, fitted, s.knee));
    let evidence = 2.0 * samples as f64 / fit.correlation_samples * (before / after.max(1e-300)).ln();
    let p = fit.effective_parameters;
    let noise = !(evidence > p + COUNTS * (2.0 * p).sqrt());
    let decision = match improvement {
        _ if facts < LEAST => Decision::Keep,
        // What fits noise is no statement either way.
        _ if noise => Decision::Keep,
        i if i < -needed => Decision::Refuse,
        i if i > needed => Decision::Change,
        _ => Decision::Keep,
    };
    Judged { decision, noise, improvement, needed, facts }
}

/// Gain of each unseen sample, over all rows of the criterion, and the ranges of samples that follow each other.
fn gains(s: &Sides, judging: &[Target]) -> (Vec<f64>, Vec<Range<usize>>) {
    let (mut gain, mut segments): (Vec<f64>, Vec<Range<usize>>) = (Vec::new(), Vec::new());
    let base = s.before.base();
    let mut at = 0;
    while at < judging.len() {
        // Rows of one record stand beside each other.
        let own =
            judging[at..].iter().take_while(|t| std::ptr::eq(t.record.time_s, judging[at].record.time_s));
        let own: Vec<&Target> = own.collect();
        at += own.len();
        let n = own[0].y.len();
        let (mut sum, mut counts) = (vec![0.0; n], vec![false; n]);
        for t in own {
            let node = |g: &Graph| t.node.unwrap_or(g.nodes.len() - 1);
            let a = s.before.all_values(&base, &t.record).swap_remove(node(s.before));
            let b = s.after.all_values(s.values, &t.record).swap_remove(node(s.after));
            for k in (0..n).filter(|k| t.weights[*k] > 0.0) {
                let loss = |v: f64| huber::loss(t.y[k] - v, t.weights[k], s.knee);
                sum[k] += loss(a[k]) - loss(b[k]);
                counts[k] = true;
            }
        }
        let mut from = gain.len();
        for k in 0..n {
            if counts[k] {
                gain.push(sum[k]);
            } else if gain.len() > from {
                segments.push(from..gain.len());
                from = gain.len();
            }
        }
        if gain.len() > from {
            segments.push(from..gain.len());
        }
    }
    (gain, segments)
}

/// Labels that time a memory (delays, time constants, shares of a film) and lie on their greatest value, in words: what was found is the
/// bound. On the least one there is none of it, or as good as none, which is an answer, and is warned of as every limit is.
pub(super) fn on_bound(graph: &Graph, values: &[f64]) -> Vec<String> {
    let times = times_a_memory(graph);
    let (mut out, mut at): (Vec<String>, usize) = (Vec::new(), 0);
    for l in &graph.labels {
        let bound = l.upper;
        let on = |k: usize| {
            let v = values[at + k];
            !l.locked[k] && times[at + k] && (v - bound).abs() <= ON_BOUND * bound.abs().max(1e-9)
        };
        if bound.is_finite() && (0..l.len()).any(on) {
            out.push(format!("`{}` on its greatest value, {bound} {}", l.name, l.unit));
        }
        at += l.len();
    }
    out
}
