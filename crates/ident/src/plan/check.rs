//! What can be wrong with a plan: all of it at once.

use super::{Plan, demand_name};
use dynocal_numerics::interval::Interval;

/// A fault of a plan: key, what was found, what was expected.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("plan `{plan}`, {key}: found {found}, expected {expected}")]
pub struct PlanFault {
    /// Name of the plan.
    pub plan: String,
    /// Key, e.g. `channels[2].values`.
    pub key: String,
    /// What was found.
    pub found: String,
    /// What was expected.
    pub expected: String,
}

/// Most samples of settling, so that a slip of the unit does not run for days.
const MOST_SETTLING: f64 = 1e7;

/// Collects faults of one plan.
struct Faults<'a> {
    plan: &'a Plan,
    found: Vec<PlanFault>,
}

impl Faults<'_> {
    fn push(&mut self, key: impl Into<String>, found: impl ToString, expected: impl Into<String>) {
        let plan = self.plan.name.clone();
        let fault = PlanFault { plan, key: key.into(), found: found.to_string(), expected: expected.into() };
        self.found.push(fault);
    }

    fn must(&mut self, holds: bool, key: impl Into<String>, found: impl ToString, expected: &str) {
        if !holds {
            self.push(key, found, expected);
        }
    }

    /// Values of a column: as many as there are samples, all finite.
    fn column(&mut self, key: &str, values: &[f64]) {
        let n = self.plan.len();
        if values.len() != n {
            self.push(
                format!("{key}.values"),
                format!("{} values", values.len()),
                format!("{n}, as in the first channel"),
            );
        }
        if let Some(t) = values.iter().position(|v| !v.is_finite()) {
            self.push(format!("{key}.values[{t}]"), values[t], "a finite number");
        }
    }
}

impl Plan {
    /// All faults of the plan by itself; whether a plant has its channels, the player sees.
    pub fn check(&self) -> Vec<PlanFault> {
        let mut f = Faults { plan: self, found: Vec::new() };
        let dt = self.sample_time_s;
        f.must(dt > 0.0 && dt.is_finite(), "sample_time_s", dt, "a positive number, s");
        let settling = self.settle_s / dt;
        f.must(
            self.settle_s >= 0.0 && !(settling > MOST_SETTLING),
            "settle_s",
            self.settle_s,
            "0 or a positive number, s, of at most 1e7 samples",
        );
        f.must(!self.is_empty(), "channels", "no sample", "a channel with one value at least");
        channels(&mut f);
        demands(&mut f);
        loops(&mut f);
        limits(&mut f);
        names(&mut f);
        f.found
    }
}

fn channels(f: &mut Faults) {
    for (k, c) in f.plan.channels.iter().enumerate() {
        let key = format!("channels[{k}]");
        f.column(&key, &c.values);
        if !(c.lower <= c.upper) {
            f.push(format!("{key}.lower"), c.lower, format!("at most upper = {}, {}", c.upper, c.unit));
        }
        if let Some(rate) = c.rate_per_s {
            let fits = rate > 0.0 && rate.is_finite();
            f.must(fits, format!("{key}.rate_per_s"), rate, "a positive number, or none");
        }
    }
}

fn demands(f: &mut Faults) {
    for (k, d) in f.plan.demands.iter().enumerate() {
        f.column(&format!("demands[{k}]"), &d.values);
    }
}

fn loops(f: &mut Faults) {
    let plan = f.plan;
    let list = |names: Vec<&str>| if names.is_empty() { "none".into() } else { names.join(", ") };
    for (k, l) in plan.loops.iter().enumerate() {
        let key = format!("loops[{k}]");
        if plan.channel(&l.input).is_none() {
            let known = list(plan.channels.iter().map(|c| c.name.as_str()).collect());
            let found = format!("`{}`", l.input);
            f.push(format!("{key}.input"), found, format!("a channel of the plan: {known}"));
        }
        if plan.demand(&l.output).is_none() {
            let known = list(plan.demands.iter().map(|d| d.output.as_str()).collect());
            let found = format!("`{}`", l.output);
            f.push(format!("{key}.output"), found, format!("an output with a demand: {known}"));
        }
        for (name, gain) in [("ki", l.gains.ki), ("kp", l.gains.kp)] {
            f.must(gain.is_finite(), format!("{key}.gains.{name}"), gain, "a finite number");
        }
        if !l.schedule.is_empty() {
            f.column(&format!("{key}.schedule"), &l.schedule);
            let wrong = l.schedule.iter().find(|g| **g <= 0.0);
            f.must(wrong.is_none(), format!("{key}.schedule"), wrong.unwrap_or(&1.0), "positive numbers");
        }
        let earlier = plan.loops[..k].iter().any(|other| other.closed && l.closed && other.input == l.input);
        f.must(
            !earlier,
            format!("{key}.input"),
            format!("`{}` again", l.input),
            "one closed loop for an input",
        );
    }
}

fn limits(f: &mut Faults) {
    for (k, l) in f.plan.limits.iter().enumerate() {
        let key = format!("limits[{k}]");
        let sides: Vec<f64> = l.lower.iter().chain(&l.upper).copied().collect();
        let finite = sides.iter().all(|v| v.is_finite()) && !sides.is_empty();
        f.must(finite, format!("{key}.lower, upper"), format!("{sides:?}"), "one finite number at least");
        let Interval { lower, upper } = l.range();
        if !(lower < upper) {
            f.push(format!("{key}.lower"), lower, format!("less than upper = {upper}, {}", l.unit));
        }
        let fits = l.margin >= 0.0 && l.margin.is_finite();
        f.must(fits, format!("{key}.margin"), l.margin, "0 or a positive number");
    }
}

/// Every column of the record has a name of its own.
fn names(f: &mut Faults) {
    let plan = f.plan;
    let mut seen: Vec<String> = vec!["time".into()];
    let columns =
        plan.channels.iter().enumerate().map(|(k, c)| (format!("channels[{k}].name"), c.name.clone()));
    let demanded = plan
        .demands
        .iter()
        .enumerate()
        .map(|(k, d)| (format!("demands[{k}].output"), demand_name(&d.output)));
    let outputs = plan.outputs.iter().enumerate().map(|(k, o)| (format!("outputs[{k}]"), o.clone()));
    for (key, name) in columns.chain(demanded).chain(outputs) {
        f.must(!name.is_empty(), key.clone(), "no name", "a name");
        f.must(!seen.contains(&name), key, format!("`{name}` again"), "a name of its own");
        seen.push(name);
    }
}
