//! The calibration problem as data: what may move, what must be met, what is made small, and where that is valid.
//!
//! ```text
//! minimise    sum_j w_j mean_t c_j(t)  +  sum_i v_i mean_t (u_i(t) - u_i(t-1))^2
//! subject to  y_d(t) = demand_d(t)                       outputs that follow a demand
//!             lower_l <= y_l(t) <= upper_l               outputs with limits, at every sample
//!             mean_t y_l(t) <= mean_upper_l              and in the mean
//!             lower_i <= u_i(t) <= upper_i               inputs that may move
//!             |u_i(t) - u_i(t-1)| <= rate_i dt
//! ```
//!
//! u inputs that may move, c any channel: an input, a given operating channel, a derived channel (a monomial such as the
//! fuel flow `1.2e-4 inj speed`, thesis eq. 7.11) or a modelled output. Steady maps, optimisation over a record, receding
//! horizon and inverse maps read the same problem; which models compute the outputs stands elsewhere.
//!
//! ```
//! use dynocal_calib::problem::CalibrationProblem;
//! use dynocal_files::spec::Faults;
//!
//! let text = r#"
//! minimise = [{ channel = "fuel", weight = 1.0 }]
//!
//! [[inputs]]
//! name = "inj"
//! unit = "mg"
//! lower = 0.0
//! upper = 30.0
//! increment_weight = 0.02       # kg/h per mg^2
//!
//! [[inputs]]
//! name = "spark"
//! unit = "deg"
//! lower = 5.0
//! upper = 30.0
//! rate_per_s = 33.3             # deg/s
//!
//! [[given]]
//! name = "speed"
//! unit = "rpm"
//! lower = 1000.0
//! upper = 3000.0
//!
//! [[demands]]
//! output = "torque"
//! unit = "Nm"
//! lower = 10.0
//! upper = 90.0
//!
//! [[limits]]
//! output = "knock"
//! unit = "-"
//! upper = 1.0
//!
//! [[derive]]
//! name = "fuel"
//! unit = "kg/h"
//! factor = 1.2e-4
//! powers = { inj = 1, speed = 1 }
//! "#;
//! let problem: CalibrationProblem = toml::from_str(text)?;
//! let mut faults = Faults::default();
//! problem.check("", &mut faults);
//! assert!(faults.is_empty());
//! assert_eq!(problem.input_names(), ["inj", "spark"]);
//! # Ok::<(), toml::de::Error>(())
//! ```

use dynocal_files::spec::Faults;
use dynocal_ident::data::{DataError, Dataset, Role};
use dynocal_ident::derived::{Derived, DerivedError, Monomial};
use serde::{Deserialize, Serialize};

/// An input that may move.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InputChannel {
    /// Name.
    pub name: String,
    /// Unit.
    pub unit: String,
    /// Least value.
    pub lower: f64,
    /// Greatest value.
    pub upper: f64,
    /// Largest change in units per second; absent for none.
    #[serde(default)]
    pub rate_per_s: Option<f64>,
    /// Weight on squared increments from sample to sample, mean over samples: objective unit per unit^2. Absent: by the
    /// share of the objective that [`smoothing`](crate::optimise::OptimiseOptions::smoothing) gives to increments.
    #[serde(default)]
    pub increment_weight: Option<f64>,
}

/// An operating channel that is imposed, e.g. the speed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GivenChannel {
    /// Name.
    pub name: String,
    /// Unit.
    pub unit: String,
    /// Least value of the calibrated range.
    pub lower: f64,
    /// Greatest value of the calibrated range.
    pub upper: f64,
}

/// An output that follows a demand.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DemandChannel {
    /// Output.
    pub output: String,
    /// Unit.
    pub unit: String,
    /// Least demand.
    pub lower: f64,
    /// Greatest demand.
    pub upper: f64,
}

/// An output with limits. Without any it is free: only what is minimised reads it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LimitChannel {
    /// Output, or a derived channel for [`LimitChannel::mean_upper`] alone.
    pub output: String,
    /// Unit.
    pub unit: String,
    /// Least value at every sample.
    #[serde(default)]
    pub lower: Option<f64>,
    /// Greatest value at every sample.
    #[serde(default)]
    pub upper: Option<f64>,
    /// Greatest mean over the record.
    #[serde(default)]
    pub mean_upper: Option<f64>,
    /// Makes the limits soft: price of a violation, mean over samples of its size, objective unit per unit; absent for
    /// hard limits.
    #[serde(default)]
    pub soft_weight: Option<f64>,
}

/// One term of the objective: mean over the record of `weight * channel`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectiveTerm {
    /// Input, given, derived channel or modelled output.
    pub channel: String,
    /// Weight in objective unit per unit of the channel.
    #[serde(default = "one")]
    pub weight: f64,
}

fn one() -> f64 {
    1.0
}

/// Name of the channel in which a record keeps what a meter said of a derived channel.
pub fn meter_name(channel: &str) -> String {
    format!("{channel}_measured")
}

/// A derived channel that was metered as well.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Metered {
    /// Channel.
    pub channel: String,
    /// Mean of the meter over the mean of what is derived, less one.
    pub error: f64,
}

/// A calibration problem, see [`crate::problem`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CalibrationProblem {
    /// Inputs that may move.
    pub inputs: Vec<InputChannel>,
    /// Imposed operating channels.
    #[serde(default)]
    pub given: Vec<GivenChannel>,
    /// Outputs that follow a demand.
    #[serde(default)]
    pub demands: Vec<DemandChannel>,
    /// Outputs with limits, and free ones.
    #[serde(default)]
    pub limits: Vec<LimitChannel>,
    /// What is minimised.
    pub minimise: Vec<ObjectiveTerm>,
    /// Derived channels, each after those that it reads.
    #[serde(default)]
    pub derive: Vec<Derived>,
}

impl Default for CalibrationProblem {
    fn default() -> Self {
        Self::thesis()
    }
}

impl CalibrationProblem {
    /// The problem of thesis section 7.5: least fuel (eq. 7.11) with injection, spark and throttle in their bounds
    /// (eq. 7.14), torque and lambda demanded, at imposed speed; spark changes by at most 1 deg in 0.03 s.
    ///
    /// Weights on increments are left to whoever optimises.
    pub fn thesis() -> Self {
        let input = |name: &str, unit: &str, lower, upper, rate_per_s| InputChannel {
            name: name.into(),
            unit: unit.into(),
            lower,
            upper,
            rate_per_s,
            increment_weight: None,
        };
        let demand = |output: &str, unit: &str, lower, upper| DemandChannel {
            output: output.into(),
            unit: unit.into(),
            lower,
            upper,
        };
        let powers = [("inj".to_string(), 1), ("speed".to_string(), 1)].into();
        Self {
            inputs: vec![
                input("inj", "mg", 0.0, 30.0, None),
                input("spark", "deg", 5.0, 30.0, Some(1.0 / 0.03)),
                input("throttle", "deg", 0.0, 90.0, None),
            ],
            given: vec![GivenChannel {
                name: "speed".into(),
                unit: "rpm".into(),
                lower: 1000.0,
                upper: 3000.0,
            }],
            demands: vec![demand("torque", "Nm", 10.0, 90.0), demand("lambda", "-", 0.9, 1.1)],
            limits: Vec::new(),
            minimise: vec![ObjectiveTerm { channel: "fuel".into(), weight: 1.0 }],
            derive: vec![Derived { name: "fuel".into(), unit: "kg/h".into(), factor: 1.2e-4, powers }],
        }
    }

    /// Names of the inputs that may move, in their order.
    pub fn input_names(&self) -> Vec<String> {
        self.inputs.iter().map(|c| c.name.clone()).collect()
    }

    /// Names of the given channels.
    pub fn given_names(&self) -> Vec<String> {
        self.given.iter().map(|c| c.name.clone()).collect()
    }

    /// Names of the demanded outputs.
    pub fn demand_names(&self) -> Vec<String> {
        self.demands.iter().map(|c| c.output.clone()).collect()
    }

    /// Outputs that are not demanded: with limits or free, derived channels left out.
    pub fn other_outputs(&self) -> Vec<String> {
        let derived = |name: &str| self.derive.iter().any(|d| d.name == name);
        self.limits.iter().map(|l| l.output.clone()).filter(|name| !derived(name)).collect()
    }

    /// Unit of a channel of the problem.
    pub fn unit(&self, channel: &str) -> Option<&str> {
        let inputs = self.inputs.iter().map(|c| (&c.name, &c.unit));
        let given = self.given.iter().map(|c| (&c.name, &c.unit));
        let demands = self.demands.iter().map(|c| (&c.output, &c.unit));
        let limits = self.limits.iter().map(|c| (&c.output, &c.unit));
        let derived = self.derive.iter().map(|c| (&c.name, &c.unit));
        let mut all = inputs.chain(given).chain(demands).chain(derived).chain(limits);
        all.find(|(name, _)| *name == channel).map(|(_, unit)| unit.as_str())
    }

    /// A channel as a monomial of channels that are not derived: its derivations put into each other.
    pub fn monomial(&self, channel: &str) -> Monomial {
        Monomial::of(channel, &self.derive)
    }

    /// The channels `minimise` names, over a record that has the measured ones: one column each. Of a derived channel what a
    /// meter said where the record has it ([`meter_name`]), else what follows from the channels it is derived from.
    ///
    /// # Errors
    /// [`DerivedError`]: a channel is not there, or a derived value is not finite.
    pub fn objective_channels(&self, record: &Dataset) -> Result<Vec<Vec<f64>>, DerivedError> {
        let one = |term: &ObjectiveTerm| match record.values(&meter_name(&term.channel)) {
            Ok(metered) => Ok(metered.to_vec()),
            Err(_) => self.values(&term.channel, record),
        };
        self.minimise.iter().map(one).collect()
    }

    /// Derived channels that are minimised: what a plant or bed may have a meter for.
    pub fn meterable(&self) -> Vec<&Derived> {
        let minimised = |d: &&Derived| self.minimise.iter().any(|term| term.channel == d.name);
        self.derive.iter().filter(minimised).collect()
    }

    /// What the meters of a record say beside what the derived channels say.
    ///
    /// # Errors
    /// As [`CalibrationProblem::objective_channels`].
    pub fn meters(&self, record: &Dataset) -> Result<Vec<Metered>, DerivedError> {
        let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len().max(1) as f64;
        let mut all = Vec::new();
        for d in self.meterable() {
            if let Ok(metered) = record.values(&meter_name(&d.name)) {
                // Row t holds what was applied from t on, and what was measured at t: of what was applied before.
                let derived = self.values(&d.name, record)?;
                let applied = mean(&derived[..derived.len().saturating_sub(1)]);
                let error = mean(metered.get(1..).unwrap_or_default()) / applied - 1.0;
                all.push(Metered { channel: d.name.clone(), error });
            }
        }
        Ok(all)
    }

    /// A channel over a record: its samples, or what follows from other channels by [`CalibrationProblem::derive`].
    ///
    /// # Errors
    /// As [`CalibrationProblem::objective_channels`].
    pub fn values(&self, channel: &str, record: &Dataset) -> Result<Vec<f64>, DerivedError> {
        if !self.derive.iter().any(|d| d.name == channel) {
            return Ok(record.values(channel)?.to_vec());
        }
        let mut d = record.clone();
        for derived in &self.derive {
            let there = |name: &str| d.channels.iter().any(|c| c.name == name);
            if !there(&derived.name) && derived.powers.keys().all(|name| there(name)) {
                derived.add_to(&mut d, Role::Auxiliary)?;
            }
        }
        Ok(d.values(channel)?.to_vec())
    }

    /// Checks the problem as a whole; `key` is that of the problem in its file, empty where it is the file.
    pub fn check(&self, key: &str, faults: &mut Faults) {
        let at = |rest: String| if key.is_empty() { rest } else { format!("{key}.{rest}") };
        let mut known: Vec<String> = Vec::new();
        if self.inputs.is_empty() {
            faults.push(&at("inputs".into()), "none", "at least one input that may move");
        }
        for (k, c) in self.inputs.iter().enumerate() {
            let of = |field: &str| at(format!("inputs[{k}].{field}"));
            name(&of("name"), &c.name, &mut known, faults);
            range(&of("lower"), c.lower, c.upper, &c.unit, faults);
            if let Some(rate) = c.rate_per_s {
                faults.positive(&of("rate_per_s"), rate, &format!("{}/s", c.unit));
            }
            if let Some(weight) = c.increment_weight {
                not_negative(&of("increment_weight"), weight, faults);
            }
        }
        for (k, c) in self.given.iter().enumerate() {
            name(&at(format!("given[{k}].name")), &c.name, &mut known, faults);
            range(&at(format!("given[{k}].lower")), c.lower, c.upper, &c.unit, faults);
        }
        for (k, c) in self.demands.iter().enumerate() {
            name(&at(format!("demands[{k}].output")), &c.output, &mut known, faults);
            range(&at(format!("demands[{k}].lower")), c.lower, c.upper, &c.unit, faults);
        }
        let derived: Vec<&str> = self.derive.iter().map(|d| d.name.as_str()).collect();
        for (k, c) in self.limits.iter().enumerate() {
            let of = |field: &str| at(format!("limits[{k}].{field}"));
            let is_derived = derived.contains(&c.output.as_str());
            if !is_derived {
                name(&of("output"), &c.output, &mut known, faults);
            }
            check_limit(c, is_derived, &of, faults);
        }
        for (k, d) in self.derive.iter().enumerate() {
            match d.check(&known) {
                Ok(()) => known.push(d.name.clone()),
                Err(e) => faults.push(&at(format!("derive[{k}]")), e, "a monomial of channels before it"),
            }
        }
        if self.minimise.is_empty() {
            faults.push(&at("minimise".into()), "nothing", "at least one channel to minimise");
        }
        for (k, term) in self.minimise.iter().enumerate() {
            if !known.contains(&term.channel) {
                faults.unknown(&at(format!("minimise[{k}].channel")), &term.channel, &known);
            }
            if !(term.weight.is_finite() && term.weight != 0.0) {
                let expected = "a finite weight other than 0";
                faults.push(&at(format!("minimise[{k}].weight")), term.weight, expected);
            }
        }
    }

    /// What a record must have to start from: inputs, given channels and demanded outputs.
    ///
    /// # Errors
    /// [`DataError::NoChannel`], [`DataError::Length`], [`DataError::NonFinite`].
    pub fn check_record(&self, record: &Dataset) -> Result<(), DataError> {
        for name in self.input_names().iter().chain(&self.given_names()) {
            record.channel(name)?;
        }
        record.check()
    }
}

fn name(key: &str, found: &str, known: &mut Vec<String>, faults: &mut Faults) {
    if found.trim().is_empty() || known.iter().any(|n| n == found) {
        faults.push(key, format!("`{found}`"), "a name of its own");
    }
    known.push(found.into());
}

fn range(key: &str, lower: f64, upper: f64, unit: &str, faults: &mut Faults) {
    // Its width counts, too.
    if !(lower < upper && lower.is_finite() && upper.is_finite() && (upper - lower).is_finite()) {
        faults.push(key, format!("{lower} to {upper} {unit}"), "finite limits, the lower below the upper");
    }
}

fn not_negative(key: &str, value: f64, faults: &mut Faults) {
    if !(value >= 0.0 && value.is_finite()) {
        faults.push(key, value, "a finite number, not negative");
    }
}

fn check_limit(c: &LimitChannel, derived: bool, key: &dyn Fn(&str) -> String, faults: &mut Faults) {
    let finite = [("lower", c.lower), ("upper", c.upper), ("mean_upper", c.mean_upper)];
    for (field, value) in finite {
        if let Some(v) = value.filter(|v| !v.is_finite()) {
            faults.push(&key(field), v, format!("a finite limit, {}, or no key", c.unit));
        }
    }
    if let (Some(lower), Some(upper)) = (c.lower, c.upper)
        && lower.is_finite()
        && upper.is_finite()
        && lower >= upper
    {
        faults.push(&key("lower"), lower, format!("less than the upper limit, {upper} {}", c.unit));
    }
    if let Some(weight) = c.soft_weight {
        faults.positive(&key("soft_weight"), weight, "objective unit per unit");
    }
    if derived && (c.lower.is_some() || c.upper.is_some()) {
        let expected = "`mean_upper` alone: limits at every sample are for inputs and modelled outputs";
        faults.push(&key("output"), format!("the derived channel `{}`", c.output), expected);
    }
}

#[cfg(test)]
mod tests;
