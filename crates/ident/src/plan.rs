//! A plan: what a test asks of a plant, sample by sample, with its loops, limits and abort rules.
//!
//! A plan is a table of channels over time. Where a loop is closed, the channel is its feedforward:
//!
//! ```text
//! u_i(t) = sat( f_i(t) )                                    open
//! u_i(t) = sat( f_i(t) + g(t) kp e(t) + ki sum g e dt ),  e = d - y   closed: y follows its demand d by u_i; g: the schedule of the gains, 1
//! ```
//!
//! where `sat` keeps the channel's range and its rate. The same plan is played on the virtual engine
//! ([`crate::play::play`]) and, as two files, on a bed ([`crate::play::check_record`] compares what comes back).
//!
//! ```
//! use dynocal_ident::pi::PiGains;
//! use dynocal_ident::plan::{Plan, PlanChannel, PlanDemand, PlanLimit, PlanLoop};
//!
//! let throttle = PlanChannel { rate_per_s: Some(60.0), ..PlanChannel::free("throttle", "deg", vec![12.0; 400]) };
//! let speed = PlanChannel::free("speed", "rpm", vec![2000.0; 400]);
//! let torque = PlanDemand { output: "torque".into(), unit: "Nm".into(), values: vec![50.0; 400] };
//! let gains = PiGains { ki: 0.3, kp: 0.05 };
//! let plan = Plan::open_loop("hold", 0.03, vec![PlanChannel { lower: 0.0, upper: 60.0, ..throttle }, speed])
//!     .with_loops(vec![torque], vec![PlanLoop::closed("torque", "throttle", gains)])
//!     .with_limits(vec![PlanLimit::upper("torque", "Nm", 90.0, 2.0)])
//!     .settled(3.0);
//! assert!(plan.check().is_empty());
//! assert_eq!((plan.len(), plan.settling_samples()), (400, 100));
//! assert_eq!(plan.as_dataset().values("torque_demand").unwrap()[7], 50.0);
//!
//! // Every fault is named, with its key, what was found and what was expected.
//! let wrong = plan.with_loops(vec![], vec![PlanLoop::closed("lambda", "inj", gains)]);
//! let faults: Vec<String> = wrong.check().iter().map(ToString::to_string).collect();
//! assert_eq!(faults.len(), 2);
//! assert!(faults[0].contains("loops[0].input: found `inj`, expected a channel of the plan: throttle, speed"));
//! ```

mod check;

pub use check::PlanFault;

use dynocal_numerics::interval::Interval;
use serde::{Deserialize, Serialize};

use crate::data::{Channel, Dataset, Role};
use crate::pi::PiGains;

/// An input of the plant, one value per sample, with the limits that loops and feedforward obey.
#[derive(Clone, Debug, PartialEq)]
pub struct PlanChannel {
    /// Name of the plant's input.
    pub name: String,
    /// Unit.
    pub unit: String,
    /// Feedforward, one value per sample; applied as it is where no loop is closed over it.
    pub values: Vec<f64>,
    /// Least value that is applied; `-inf` for none.
    pub lower: f64,
    /// Greatest value that is applied; `inf` for none.
    pub upper: f64,
    /// Largest change per second, in either direction.
    pub rate_per_s: Option<f64>,
}

/// What an output is asked to follow; recorded as the auxiliary channel `<output>_demand`.
#[derive(Clone, Debug, PartialEq)]
pub struct PlanDemand {
    /// Name of the plant's output.
    pub output: String,
    /// Unit.
    pub unit: String,
    /// Demand, one value per sample.
    pub values: Vec<f64>,
}

/// A PI loop: the error of an output against its demand drives an input, over its feedforward.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlanLoop {
    /// Output that follows its demand.
    pub output: String,
    /// Channel that makes it.
    pub input: String,
    /// Gains, unit of the input per unit of the output (and per second).
    pub gains: PiGains,
    /// Whether the loop is closed; an open one is carried along and does nothing.
    pub closed: bool,
    /// Factor of both gains at each sample, where what the input does to the output is another along the plan; 1 where there is none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub schedule: Vec<f64>,
}

/// An abort rule: the plan ends before the output passes a limit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlanLimit {
    /// Output that is watched.
    pub output: String,
    /// Unit.
    pub unit: String,
    /// Least value.
    pub lower: Option<f64>,
    /// Greatest value.
    pub upper: Option<f64>,
    /// Distance that is kept from both: by predictions where there is a model, by the measured value where there is none.
    pub margin: f64,
}

/// A plan.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Name, of the record and of the files.
    pub name: String,
    /// Sample time in s.
    pub sample_time_s: f64,
    /// Inputs of the plant that the plan drives; others stay at their start values.
    pub channels: Vec<PlanChannel>,
    /// Demands.
    pub demands: Vec<PlanDemand>,
    /// Loops.
    pub loops: Vec<PlanLoop>,
    /// Abort rules.
    pub limits: Vec<PlanLimit>,
    /// Time in s at the first row before the record begins, loops closed; its first sample is in open loop, because a
    /// loop needs a measured value.
    pub settle_s: f64,
    /// Outputs that are recorded, in this order; empty: all of the plant.
    pub outputs: Vec<String>,
}

impl PlanChannel {
    /// A channel without limits.
    pub fn free(name: &str, unit: &str, values: Vec<f64>) -> Self {
        let (lower, upper) = (f64::NEG_INFINITY, f64::INFINITY);
        Self { name: name.into(), unit: unit.into(), values, lower, upper, rate_per_s: None }
    }

    /// The same within a range.
    pub fn within(self, lower: f64, upper: f64) -> Self {
        Self { lower, upper, ..self }
    }

    /// What is applied where no loop is closed: the values within range and rate (N).
    pub fn applied(&self, sample_time_s: f64) -> Vec<f64> {
        let mut out: Vec<f64> = Vec::with_capacity(self.values.len());
        for v in &self.values {
            let v = self.limited(*v, out.last().copied(), sample_time_s);
            out.push(v);
        }
        out
    }

    /// `value` within the range, and within the rate from the value `before` one sample ago.
    pub(crate) fn limited(&self, value: f64, before: Option<f64>, sample_time_s: f64) -> f64 {
        let value = value.clamp(self.lower, self.upper);
        match (self.rate_per_s, before) {
            (Some(rate), Some(before)) => {
                let step = rate * sample_time_s;
                value.clamp(before - step, before + step)
            }
            _ => value,
        }
    }
}

impl PlanLoop {
    /// A closed loop.
    pub fn closed(output: &str, input: &str, gains: PiGains) -> Self {
        Self { output: output.into(), input: input.into(), gains, closed: true, schedule: Vec::new() }
    }

    /// Gains at a sample.
    pub fn gains_at(&self, sample: usize) -> PiGains {
        let factor = self.schedule.get(sample).copied().unwrap_or(1.0);
        PiGains { ki: factor * self.gains.ki, kp: factor * self.gains.kp }
    }
}

impl PlanLimit {
    /// An upper limit.
    pub fn upper(output: &str, unit: &str, upper: f64, margin: f64) -> Self {
        Self { output: output.into(), unit: unit.into(), lower: None, upper: Some(upper), margin }
    }

    /// Limits on both sides.
    pub fn between(output: &str, unit: &str, lower: f64, upper: f64, margin: f64) -> Self {
        Self { output: output.into(), unit: unit.into(), lower: Some(lower), upper: Some(upper), margin }
    }

    /// Least and greatest value, infinite where there is none.
    pub fn range(&self) -> Interval {
        Interval::new(self.lower.unwrap_or(f64::NEG_INFINITY), self.upper.unwrap_or(f64::INFINITY))
    }

    /// Distance of `value` to the nearer limit; negative: passed.
    pub fn distance(&self, value: f64) -> f64 {
        let Interval { lower, upper } = self.range();
        (upper - value).min(value - lower)
    }
}

/// Name of the recorded channel of a demand.
pub fn demand_name(output: &str) -> String {
    format!("{output}_demand")
}

impl Plan {
    /// A plan without loops, demands and limits.
    pub fn open_loop(name: &str, sample_time_s: f64, channels: Vec<PlanChannel>) -> Self {
        Self {
            name: name.into(),
            sample_time_s,
            channels,
            demands: Vec::new(),
            loops: Vec::new(),
            limits: Vec::new(),
            settle_s: 0.0,
            outputs: Vec::new(),
        }
    }

    /// The same with demands and the loops that hold them.
    pub fn with_loops(self, demands: Vec<PlanDemand>, loops: Vec<PlanLoop>) -> Self {
        Self { demands, loops, ..self }
    }

    /// The same with abort rules.
    pub fn with_limits(self, limits: Vec<PlanLimit>) -> Self {
        Self { limits, ..self }
    }

    /// The same after `settle_s` seconds at its first row.
    pub fn settled(self, settle_s: f64) -> Self {
        Self { settle_s, ..self }
    }

    /// The same, these outputs recorded.
    pub fn recording(self, outputs: &[&str]) -> Self {
        Self { outputs: outputs.iter().map(ToString::to_string).collect(), ..self }
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.channels.first().map_or(0, |c| c.values.len())
    }

    /// Whether there is no sample.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Length in s, without settling.
    pub fn duration_s(&self) -> f64 {
        self.len() as f64 * self.sample_time_s
    }

    /// Samples at the first row before the record begins: the settling time rounded up.
    pub fn settling_samples(&self) -> usize {
        // A whole number of samples must not become one more by rounding.
        let samples = (self.settle_s / self.sample_time_s - 1e-6).ceil().max(0.0) as usize;
        samples.max(usize::from(self.loops.iter().any(|l| l.closed)))
    }

    /// The channel `name`.
    pub fn channel(&self, name: &str) -> Option<&PlanChannel> {
        self.channels.iter().find(|c| c.name == name)
    }

    /// The demand of `output`.
    pub fn demand(&self, output: &str) -> Option<&PlanDemand> {
        self.demands.iter().find(|d| d.output == output)
    }

    /// The closed loop over the channel `input`.
    pub fn closed_loop(&self, input: &str) -> Option<&PlanLoop> {
        self.loops.iter().find(|l| l.closed && l.input == input)
    }

    /// Open or closed loop, in words: `closed loop: torque by throttle, lambda by inj`.
    pub fn mode(&self) -> String {
        let closed = self.loops.iter().filter(|l| l.closed);
        let words: Vec<String> = closed.map(|l| format!("{} by {}", l.output, l.input)).collect();
        if words.is_empty() { "open loop".into() } else { format!("closed loop: {}", words.join(", ")) }
    }

    /// Channels as inputs and demands as auxiliary channels, as a record has them.
    pub fn as_dataset(&self) -> Dataset {
        let channel = |name: String, unit: &str, role: Role, values: &[f64]| Channel {
            name,
            unit: unit.into(),
            role,
            values: values.to_vec(),
        };
        let inputs = self.channels.iter().map(|c| channel(c.name.clone(), &c.unit, Role::Input, &c.values));
        let demands =
            self.demands.iter().map(|d| channel(demand_name(&d.output), &d.unit, Role::Auxiliary, &d.values));
        Dataset {
            name: self.name.clone(),
            sample_time_s: self.sample_time_s,
            channels: inputs.chain(demands).collect(),
            init_samples: 0,
            origin: "plan".into(),
        }
    }
}
