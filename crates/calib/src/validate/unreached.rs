//! Demands that a map did not reach: which seconds, by how much, and which actuators stood at their limits.

use super::Scenario;
use crate::problem::CalibrationProblem;
use dynocal_ident::data::{DataError, Dataset, UnitAfter};
use serde::{Deserialize, Serialize};
use std::fmt;

/// Mean error of the last second of a point from which on its demand is not reached, as a share of the range of the leading demand
/// and of further ones, whose range is narrow.
pub const MOST_OFFSET: [f64; 2] = [0.05, 0.15];
/// Distance from a bound within which an actuator stands at it, as a share of its range.
const AT_BOUND: f64 = 0.01;

/// A point of a scenario at whose end a demand is not reached.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Unreached {
    /// Demanded output.
    pub output: String,
    /// Its unit.
    pub unit: String,
    /// Begin and end of the point in s.
    pub from_s: f64,
    /// End in s.
    pub to_s: f64,
    /// Demand.
    pub demand: f64,
    /// Mean of output minus demand over the last second.
    pub error: f64,
    /// Inputs that stand at a bound in the mean of that second, in words: `throttle at its upper limit, 60 deg`.
    pub at_limit: Vec<String>,
}

impl fmt::Display for Unreached {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let unit = UnitAfter(&self.unit);
        let side = if self.error < 0.0 { "below" } else { "above" };
        write!(
            f,
            "{:.1} to {:.1} s: {} {:.3}{unit} {side} the demand of {:.3}{unit}",
            self.from_s,
            self.to_s,
            self.output,
            self.error.abs(),
            self.demand
        )?;
        match self.at_limit.is_empty() {
            true => write!(f, ", no actuator at a limit"),
            false => write!(f, ", {}", self.at_limit.join(", ")),
        }
    }
}

/// The points of a run that are not reached, in order.
///
/// # Errors
/// [`DataError`] when the record lacks a channel.
pub fn unreached(
    problem: &CalibrationProblem,
    scenario: &Scenario,
    record: &Dataset,
) -> Result<Vec<Unreached>, DataError> {
    let (n, dt) = (scenario.reference.len(), record.sample_time_s);
    let second = (1.0 / dt).round() as usize;
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len().max(1) as f64;
    let mut out = Vec::new();
    for (at, &from) in scenario.switches.iter().enumerate() {
        let to = scenario.switches.get(at + 1).copied().unwrap_or(n);
        let last = to.saturating_sub(second).max(from)..to;
        for (k, d) in problem.demands.iter().enumerate() {
            let demand = scenario.reference.row(to - 1)[k];
            let error = mean(&record.values(&d.output)?[last.clone()]) - demand;
            if error.abs() <= MOST_OFFSET[k.min(1)] * (d.upper - d.lower) {
                continue;
            }
            let mut at_limit = Vec::new();
            for u in &problem.inputs {
                let value = mean(&record.values(&u.name)?[last.clone()]);
                let room = AT_BOUND * (u.upper - u.lower);
                for (is, which, bound) in
                    [(value <= u.lower + room, "lower", u.lower), (value >= u.upper - room, "upper", u.upper)]
                {
                    if is {
                        at_limit.push(format!(
                            "{} at its {which} limit, {bound}{}",
                            u.name,
                            UnitAfter(&u.unit)
                        ));
                    }
                }
            }
            let (output, unit) = (d.output.clone(), d.unit.clone());
            out.push(Unreached {
                output,
                unit,
                from_s: from as f64 * dt,
                to_s: to as f64 * dt,
                demand,
                error,
                at_limit,
            });
        }
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::map::Rows;
    use dynocal_ident::data::{Channel, Role};

    /// Two points of 3 s: the first is met, at the second the throttle is open and 20 Nm are missing.
    #[test]
    fn says_which_seconds_by_how_much_and_which_actuator() {
        let problem = CalibrationProblem::thesis();
        let dt = 0.1;
        let mut reference = Rows::new(3);
        (0..30).for_each(|_| reference.push(&[40.0, 1.0, 2000.0]));
        (0..30).for_each(|_| reference.push(&[80.0, 1.0, 2000.0]));
        let scenario = Scenario { name: "two points".into(), reference, switches: vec![0, 30] };
        let throttle = problem.inputs.iter().find(|u| u.name == "throttle").unwrap();
        let open = throttle.upper;
        let steps = |a: f64, b: f64| [vec![a; 30], vec![b; 30]].concat();
        let record = |name: &str| match name {
            "torque" => steps(40.2, 60.0),
            "lambda" => steps(1.0, 1.0),
            "throttle" => steps(0.5 * (throttle.lower + open), open),
            other => {
                let u = problem.inputs.iter().find(|u| u.name == other).unwrap();
                steps(0.5 * (u.lower + u.upper), 0.5 * (u.lower + u.upper))
            }
        };
        let names = problem.inputs.iter().map(|u| (&u.name, &u.unit));
        let names = names.chain(problem.demands.iter().map(|d| (&d.output, &d.unit)));
        let channel = |(name, unit): (&String, &String)| {
            let values = record(name);
            Channel { name: name.clone(), unit: unit.clone(), role: Role::Output, values }
        };
        let data = Dataset {
            name: "run".into(),
            sample_time_s: dt,
            channels: names.map(channel).collect(),
            init_samples: 0,
            origin: String::new(),
        };
        let found = unreached(&problem, &scenario, &data).unwrap();
        assert_eq!(found.len(), 1, "{found:?}");
        assert!((found[0].error + 20.0).abs() < 1e-9 && found[0].output == "torque");
        assert_eq!((found[0].from_s, found[0].to_s), (3.0, 6.0));
        let words = found[0].to_string();
        assert!(words.contains("throttle at its upper limit") && words.contains("3.0 to 6.0 s"), "{words}");
    }
}
