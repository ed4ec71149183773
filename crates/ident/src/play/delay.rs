//! The time between inputs and outputs of a record.

use crate::data::Dataset;
use crate::plan::{Plan, PlanLoop, demand_name};

/// What an output answers, and after how many samples.
#[derive(Clone, Debug, PartialEq)]
pub struct Answer {
    /// Channel or demand of the plan.
    pub driver: String,
    /// Samples from its change to the steepest change of the output; negative: before it.
    pub samples: isize,
}

/// Correlation of changes from which on an answer is believed, in standard deviations of that of unrelated noise.
const BELIEVED: f64 = 8.0;
/// Longest lag that is looked at: this share of the record.
const SHARE: f64 = 0.2;
/// Largest lag in samples.
const LONGEST: usize = 400;

/// Which signal of `plan` the output `y` answers most clearly, and when.
///
/// With the changes `d(t) = x(t) - x(t-1)` of a planned signal and `g(t)` of the output, the lag k of the largest
/// `|sum d(t) g(t + k)|`, both taken as means over three samples, is where the impulse response is largest. Planned
/// signals are what nothing in the plant has influenced, loops or not. None where no signal moves the output clearly.
pub fn answer(plan: &Plan, y: &[f64]) -> Option<Answer> {
    let channels = plan.channels.iter().map(|c| (c.name.clone(), c.applied(plan.sample_time_s)));
    let demands = plan.demands.iter().map(|d| (demand_name(&d.output), d.values.clone()));
    let changes = smoothed(&changes(y));
    let mut best: Option<(f64, Answer)> = None;
    for (driver, values) in channels.chain(demands) {
        let Some((strength, samples)) = steepest(&smoothed(&self::changes(&values)), &changes) else {
            continue;
        };
        if best.as_ref().is_none_or(|(s, _)| *s < strength) {
            best = Some((strength, Answer { driver, samples }));
        }
    }
    best.map(|(_, answer)| answer)
}

/// Strength and lag of the largest correlation.
fn steepest(d: &[f64], g: &[f64]) -> Option<(f64, isize)> {
    let n = d.len().min(g.len());
    let power = |x: &[f64]| x[..n].iter().map(|v| v * v).sum::<f64>();
    let size = (power(d) * power(g)).sqrt();
    if !(size > 0.0) {
        return None;
    }
    let most = ((SHARE * n as f64) as usize).min(LONGEST);
    let at = |k: isize| {
        let (from, to) = ((-k).max(0) as usize, (n as isize - k).clamp(0, n as isize) as usize);
        (from..to).map(|t| d[t] * g[(t as isize + k) as usize]).sum::<f64>().abs() / size
    };
    let most = most as isize;
    let (strength, lag) = (-most..=most).map(|k| (at(k), k)).max_by(|a, b| a.0.total_cmp(&b.0))?;
    // Changes of unrelated signals correlate by 1 / sqrt(n); means over three samples by a factor sqrt(3) more.
    (strength * (n as f64 / 3.0).sqrt() >= BELIEVED).then_some((strength, lag))
}

fn changes(x: &[f64]) -> Vec<f64> {
    x.windows(2).map(|w| w[1] - w[0]).collect()
}

fn smoothed(x: &[f64]) -> Vec<f64> {
    let at = |t: usize| x[t.saturating_sub(1)..(t + 2).min(x.len())].iter().sum::<f64>() / 3.0;
    (0..x.len()).map(at).collect()
}

/// Share of what the input moves that the law of the loop must explain.
const EXPLAINED: f64 = 0.5;
/// Least samples on which the law is compared.
const LEAST: usize = 50;

/// Samples by which the output is late in the record of a closed loop, by its own law
///
/// ```text
/// du(t) = df(t) + kp de(t + s) + ki e(t + s) dt,    e = demand(t) - y(t + s), gains with their schedule
/// ```
///
/// on the samples where the input is off its limits: the shift s at which it fits best. None where it explains less than half
/// of what the input moves at any shift (a loop of another kind, or an input that is not what the loop asked for).
pub fn loop_shift(plan: &Plan, record: &Dataset, closed: &PlanLoop) -> Option<isize> {
    let c = plan.channel(&closed.input)?;
    let demand = &plan.demand(&closed.output)?.values;
    let (u, y) = (record.values(&closed.input).ok()?, record.values(&closed.output).ok()?);
    let n = u.len().min(plan.len());
    let dt = plan.sample_time_s;
    let slack = 1e-6 * (c.upper - c.lower).min(1.0);
    let free = |v: f64| v > c.lower + slack && v < c.upper - slack;
    let slow = |t: usize| c.rate_per_s.is_none_or(|rate| (u[t] - u[t - 1]).abs() < 0.999 * rate * dt);
    let most = ((SHARE * n as f64) as usize).min(LONGEST);
    // The same samples at every shift, so that the sums can be compared.
    let rows: Vec<usize> =
        (most + 1..n.saturating_sub(most)).filter(|t| free(u[*t]) && free(u[t - 1]) && slow(*t)).collect();
    if rows.len() < LEAST {
        return None;
    }
    let moved = |t: usize| u[t] - u[t - 1] - (c.values[t] - c.values[t - 1]);
    let total: f64 = rows.iter().map(|t| moved(*t).powi(2)).sum();
    let left = |s: isize| -> f64 {
        let error = |t: usize| demand[t] - y[(t as isize + s) as usize];
        let law = |t: usize| {
            let (now, before) = (closed.gains_at(t), closed.gains_at(t - 1));
            now.kp * error(t) - before.kp * error(t - 1) + now.ki * error(t) * dt
        };
        rows.iter().map(|t| (moved(*t) - law(*t)).powi(2)).sum()
    };
    let most = most as isize;
    let (rest, shift) = (-most..=most).map(|s| (left(s), s)).min_by(|a, b| a.0.total_cmp(&b.0))?;
    if !(rest <= (1.0 - EXPLAINED) * total) {
        return None;
    }
    // As good without a shift: then there is none.
    Some(if left(0) <= 2.0 * rest + 1e-12 * total { 0 } else { shift })
}
