//! A bed's record against the plan that it was made of: length, stamps, inputs, delay, range, constancy.

use super::delay::{answer, loop_shift};
use super::faults::RecordFault;
use crate::data::{Channel, Dataset, Role, runs};
use crate::plan::{Plan, demand_name};
use dynocal_numerics::interval::Interval;

/// How much a record may differ from its plan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RecordTolerance {
    /// Of an input without loop: share of its largest planned value or of its planned range, whichever is greater.
    pub input_share: f64,
    /// Of a stamp: share of the sample time.
    pub stamp_share: f64,
    /// Longest time in s from a change of an input to the steepest change of an output. Default 0.6 s: two engine cycles
    /// at 600 rpm and 0.2 s of sensor; analysers with long lines need more.
    pub longest_delay_s: f64,
    /// Distance from the middle half of its values, in widths of it, from which on a value is implausible.
    pub widths: f64,
}

impl Default for RecordTolerance {
    fn default() -> Self {
        Self { input_share: 0.02, stamp_share: 0.05, longest_delay_s: 0.6, widths: 50.0 }
    }
}

/// Name of the channel with the stamps in s, where a record has one.
const STAMPS: &str = "time";

/// What of `record` is not what `plan` asked for; empty: nothing.
///
/// Compared are length, stamps (where the record has a channel `time` in s, else its sample time), units, inputs without
/// loop (equal within a tolerance, one sample early or late), inputs with a loop (within their range), outputs against the
/// limits of the plan, their plausibility and whether they move, and the delay between inputs and outputs: where a loop is
/// closed by the loop's own law, else by the correlation of changes.
pub fn check_record(plan: &Plan, record: &Dataset) -> Vec<RecordFault> {
    check_record_within(plan, record, &RecordTolerance::default())
}

/// The same with other tolerances.
pub fn check_record_within(plan: &Plan, record: &Dataset, tolerance: &RecordTolerance) -> Vec<RecordFault> {
    let mut faults = channels(plan, record);
    if !faults.is_empty() {
        return faults;
    }
    length_and_stamps(plan, record, tolerance, &mut faults);
    inputs(plan, record, tolerance, &mut faults);
    let outputs: Vec<&Channel> = record.channels.iter().filter(|c| is_output(plan, c)).collect();
    for c in outputs {
        let before = faults.len();
        limits(plan, c, &mut faults);
        plausible(plan, c, tolerance, &mut faults);
        standing(plan, c, &mut faults);
        // What a dead or a broken sensor says of time means nothing.
        if faults.len() == before {
            delay(plan, record, c, tolerance, &mut faults);
        }
    }
    faults
}

fn is_output(plan: &Plan, c: &Channel) -> bool {
    if plan.outputs.is_empty() { c.role == Role::Output } else { plan.outputs.contains(&c.name) }
}

/// Channels, units and numbers: without them nothing else can be compared.
fn channels(plan: &Plan, record: &Dataset) -> Vec<RecordFault> {
    let mut faults = Vec::new();
    let known: Vec<String> = record.channels.iter().map(|c| c.name.clone()).collect();
    let inputs = plan.channels.iter().map(|c| (&c.name, Some(&c.unit)));
    let unit = |output: &str| {
        let limit = plan.limits.iter().find(|l| l.output == output).map(|l| &l.unit);
        plan.demand(output).map(|d| &d.unit).or(limit)
    };
    let watched = plan.limits.iter().map(|l| &l.output);
    let demanded = plan.demands.iter().map(|d| &d.output);
    let mut outputs: Vec<&String> = plan.outputs.iter().chain(watched).chain(demanded).collect();
    outputs.sort();
    outputs.dedup();
    for (name, unit) in inputs.chain(outputs.into_iter().map(|o| (o, unit(o)))) {
        let Ok(c) = record.channel(name) else {
            faults.push(RecordFault::Missing { channel: name.clone(), known: known.clone() });
            continue;
        };
        if let Some(expected) = unit.filter(|u| **u != c.unit) {
            let (channel, found) = (name.clone(), c.unit.clone());
            faults.push(RecordFault::Unit { channel, found, expected: expected.clone() });
        }
        if let Some(sample) = c.values.iter().position(|v| !v.is_finite()) {
            let time_s = sample as f64 * plan.sample_time_s;
            faults.push(RecordFault::NotFinite { channel: name.clone(), sample, time_s });
        }
    }
    faults
}

fn length_and_stamps(
    plan: &Plan,
    record: &Dataset,
    tolerance: &RecordTolerance,
    faults: &mut Vec<RecordFault>,
) {
    let (dt, found, expected) = (plan.sample_time_s, record.len(), plan.len());
    if found != expected {
        let (found_s, expected_s) = (found as f64 * dt, expected as f64 * dt);
        faults.push(RecordFault::Length { found, found_s, expected, expected_s });
    }
    let slack = tolerance.stamp_share * dt;
    let Ok(stamps) = record.values(STAMPS) else {
        if !((record.sample_time_s - dt).abs() <= 1e-3 * dt) {
            faults.push(RecordFault::Interval { found_s: record.sample_time_s, expected_s: dt });
        }
        return;
    };
    let Some(&first) = stamps.first() else { return };
    if !(first.abs() <= slack) {
        faults.push(RecordFault::Start { found_s: first });
    }
    // The mean interval tells another sample time, a single stamp a gap.
    let mean = (stamps[stamps.len() - 1] - first) / (stamps.len() - 1).max(1) as f64;
    if stamps.len() > 1 && !((mean - dt).abs() <= 1e-3 * dt) {
        faults.push(RecordFault::Interval { found_s: mean, expected_s: dt });
        return;
    }
    let off = |t: usize| (stamps[t] - first - t as f64 * dt).abs();
    if let Some(sample) = (0..stamps.len()).find(|t| !(off(*t) <= slack)) {
        let (found_s, expected_s) = (stamps[sample] - first, sample as f64 * dt);
        faults.push(RecordFault::Stamp { sample, found_s, expected_s });
    }
}

fn inputs(plan: &Plan, record: &Dataset, tolerance: &RecordTolerance, faults: &mut Vec<RecordFault>) {
    let dt = plan.sample_time_s;
    for c in &plan.channels {
        let Ok(found) = record.values(&c.name) else { continue };
        let largest = found.iter().fold(0.0f64, |a, v| a.max(v.abs()));
        if plan.closed_loop(&c.name).is_some() {
            let width = c.upper - c.lower;
            let slack = tolerance.input_share * if width.is_finite() { width } else { largest };
            let beyond = |v: f64| (v - c.upper).max(c.lower - v);
            let worst = (0..found.len()).max_by(|a, b| beyond(found[*a]).total_cmp(&beyond(found[*b])));
            if let Some(t) = worst.filter(|t| beyond(found[*t]) > slack) {
                faults.push(RecordFault::OutsideRange {
                    channel: c.name.clone(),
                    unit: c.unit.clone(),
                    found: found[t],
                    time_s: t as f64 * dt,
                    lower: c.lower,
                    upper: c.upper,
                });
            }
        } else {
            let planned = c.applied(dt);
            compare(&c.name, &c.unit, &planned, found, dt, tolerance, faults);
        }
    }
    for d in &plan.demands {
        let name = demand_name(&d.output);
        if let Ok(found) = record.values(&name) {
            compare(&name, &d.unit, &d.values, found, dt, tolerance, faults);
        }
    }
}

/// Planned and found values of a channel that nothing but the plan drives.
fn compare(
    name: &str,
    unit: &str,
    planned: &[f64],
    found: &[f64],
    dt: f64,
    tolerance: &RecordTolerance,
    faults: &mut Vec<RecordFault>,
) {
    let n = planned.len().min(found.len());
    let (least, greatest) = range(planned);
    let slack = tolerance.input_share * (greatest - least).max(least.abs()).max(greatest.abs());
    // An actuator may be read a sample early or late where the plan steps.
    let off = |t: usize| {
        let (least, greatest) = range(&planned[t.saturating_sub(1)..(t + 2).min(planned.len())]);
        (least - found[t]).max(found[t] - greatest) - slack
    };
    let bad: Vec<usize> = (0..n).filter(|t| !(off(*t) <= 0.0)).collect();
    if let Some(&t) = bad.iter().max_by(|a, b| off(**a).total_cmp(&off(**b))) {
        faults.push(RecordFault::NotAsPlanned {
            channel: name.into(),
            unit: unit.into(),
            samples: bad.len(),
            of: n,
            time_s: t as f64 * dt,
            found: found[t],
            planned: planned[t],
        });
    }
}

fn range(values: &[f64]) -> (f64, f64) {
    values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(*v), b.max(*v)))
}

fn limits(plan: &Plan, c: &Channel, faults: &mut Vec<RecordFault>) {
    for l in plan.limits.iter().filter(|l| l.output == c.name) {
        let worst =
            (0..c.values.len()).min_by(|a, b| l.distance(c.values[*a]).total_cmp(&l.distance(c.values[*b])));
        if let Some(t) = worst.filter(|t| l.distance(c.values[*t]) < 0.0) {
            let Interval { lower, upper } = l.range();
            let limit = if c.values[t] > upper { upper } else { lower };
            faults.push(RecordFault::Limit {
                output: c.name.clone(),
                unit: c.unit.clone(),
                limit,
                found: c.values[t],
                time_s: t as f64 * plan.sample_time_s,
            });
        }
    }
}

/// Values far outside of the middle half of all, which a few wrong ones do not move.
fn plausible(plan: &Plan, c: &Channel, tolerance: &RecordTolerance, faults: &mut Vec<RecordFault>) {
    let n = c.values.len();
    if n < 4 {
        return;
    }
    let mut sorted = c.values.clone();
    sorted.sort_by(f64::total_cmp);
    let (lower, middle, upper) = (sorted[n / 4], sorted[n / 2], sorted[3 * n / 4]);
    let demanded = plan.demand(&c.name).map_or(0.0, |d| {
        let (least, greatest) = range(&d.values);
        greatest - least
    });
    // A signal that is almost constant may still move by a share of its level.
    let width = (upper - lower).max(demanded).max(0.1 * middle.abs());
    let beyond = |v: f64| (v - upper).max(lower - v) - tolerance.widths * width;
    let bad: Vec<usize> = (0..n).filter(|t| beyond(c.values[*t]) > 0.0).collect();
    if let Some(&t) = bad.iter().max_by(|a, b| beyond(c.values[**a]).total_cmp(&beyond(c.values[**b]))) {
        faults.push(RecordFault::Implausible {
            channel: c.name.clone(),
            unit: c.unit.clone(),
            found: c.values[t],
            time_s: t as f64 * plan.sample_time_s,
            samples: bad.len(),
            lower,
            upper,
        });
    }
}

/// Least samples and least share of the record that an output must stand still for.
const STANDING: (usize, f64) = (20, 0.1);
/// Share of its range by which a planned signal must move meanwhile.
const MOVES: f64 = 0.1;

fn standing(plan: &Plan, c: &Channel, faults: &mut Vec<RecordFault>) {
    let n = c.values.len();
    let still = runs(n, |t| t > 0 && c.values[t] == c.values[t - 1]);
    let Some(longest) = still.into_iter().max_by_key(|g| g.samples()) else { return };
    let enough = longest.samples() >= STANDING.0 && longest.samples() as f64 >= STANDING.1 * n as f64;
    let signals = plan.channels.iter().map(|c| &c.values).chain(plan.demands.iter().map(|d| &d.values));
    let moves = |values: &Vec<f64>| {
        let to = longest.to.min(values.len());
        let (least, greatest) = range(values);
        let (a, b) = range(&values[longest.from.min(to)..to]);
        b - a > MOVES * (greatest - least)
    };
    if enough && signals.into_iter().any(moves) {
        let time = |t: usize| t as f64 * plan.sample_time_s;
        faults.push(RecordFault::Constant {
            channel: c.name.clone(),
            unit: c.unit.clone(),
            value: c.values[longest.from],
            from_s: time(longest.from - 1),
            to_s: time(longest.to - 1),
        });
    }
}

fn delay(
    plan: &Plan,
    record: &Dataset,
    c: &Channel,
    tolerance: &RecordTolerance,
    faults: &mut Vec<RecordFault>,
) {
    let dt = plan.sample_time_s;
    for l in plan.loops.iter().filter(|l| l.closed && l.output == c.name) {
        match loop_shift(plan, record, l) {
            // The loop's own law holds: that is more than any correlation can say.
            Some(0) => return,
            Some(samples) => {
                let delay_s = samples as f64 * dt;
                let (output, input) = (c.name.clone(), l.input.clone());
                faults.push(RecordFault::Shifted { output, input, delay_s });
                return;
            }
            None => {}
        }
    }
    let Some(found) = answer(plan, &c.values) else { return };
    let delay_s = found.samples as f64 * dt;
    // A mean over the sample may move with the input; no output moves before.
    if !(delay_s >= -1.5 * dt && delay_s <= tolerance.longest_delay_s) {
        faults.push(RecordFault::Delay {
            output: c.name.clone(),
            driver: found.driver,
            delay_s,
            shortest_s: 0.0,
            longest_s: tolerance.longest_delay_s,
        });
    }
}
