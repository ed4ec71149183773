//! What a steady test moves and what it measures: the calibration problem with its loops closed.
//!
//! ```text
//! factors    x = (given channels, demands with a loop that vary, inputs that no loop drives)
//! responses  r(x) = (inputs that loops drive, outputs with limits, what is minimised)
//! ```
//!
//! The loops hold the demands, so that no model has to meet them: the input that a loop drives is a response like any other,
//! and its range is a limit.

use std::collections::BTreeMap;

use dynocal_ident::data::Dataset;
use dynocal_ident::derived::DerivedError;
use dynocal_ident::plan::{Plan, PlanChannel, PlanDemand, PlanLoop};
use dynocal_ident::plant::{Causality, Variable};
use dynocal_numerics::interval::Interval;
use serde::{Deserialize, Serialize};

use crate::problem::CalibrationProblem;

/// Where the value of a factor goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FactorKind {
    /// Number of a given channel of the problem.
    Given(usize),
    /// Number of a demand.
    Demand(usize),
    /// Number of an input that no loop drives.
    Free(usize),
}

/// What is set.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Factor {
    /// Channel.
    pub name: String,
    /// Unit.
    pub unit: String,
    /// Least value.
    pub lower: f64,
    /// Greatest value.
    pub upper: f64,
    /// Where it goes.
    pub kind: FactorKind,
}

/// Where a response comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ResponseSource {
    /// Number of the input that a loop drives.
    Driven(usize),
    /// An output of the plant.
    Output,
    /// A derived channel of the problem.
    Derived,
}

/// What is measured and modelled.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ResponseChannel {
    /// Channel.
    pub name: String,
    /// Unit.
    pub unit: String,
    /// Where it comes from.
    pub source: ResponseSource,
    /// Least value that is allowed.
    pub lower: Option<f64>,
    /// Greatest value that is allowed.
    pub upper: Option<f64>,
    /// Weight in what is minimised; 0 where it is not.
    pub weight: f64,
    /// Whether it is recorded only, and slower than a point is held: no point waits for it.
    #[serde(default)]
    pub slow: bool,
}

/// Factors and responses of a problem.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Layout {
    /// The problem.
    pub problem: CalibrationProblem,
    /// One closed loop for each demand, in their order.
    pub loops: Vec<PlanLoop>,
    /// What is set, axes first.
    pub factors: Vec<Factor>,
    /// Number of factors that are axes of the maps.
    pub axes: usize,
    /// Values of the given channels and demands that are no factors.
    pub held: BTreeMap<String, f64>,
    /// What is measured.
    pub responses: Vec<ResponseChannel>,
    /// Sample time in s.
    pub sample_time_s: f64,
}

/// A range of an axis.
#[derive(Clone, Debug, PartialEq)]
pub struct AxisRange {
    /// Given channel or demand.
    pub name: String,
    /// Least and greatest value.
    pub range: Interval,
}

impl Layout {
    /// The layout of a checked problem: `axes` are given channels and demands, the others have their value in `held`. Outputs among
    /// `variables` with the name of what is minimised are believed rather than what is derived.
    pub fn new(
        problem: &CalibrationProblem,
        loops: Vec<PlanLoop>,
        axes: &[AxisRange],
        held: BTreeMap<String, f64>,
        sample_time_s: f64,
        variables: &[Variable],
    ) -> Self {
        let inputs = problem.input_names();
        let axis = |a: &AxisRange| {
            let given = problem.given.iter().position(|g| g.name == a.name);
            let demand = problem.demands.iter().position(|d| d.output == a.name);
            let kind = given.map(FactorKind::Given).or(demand.map(FactorKind::Demand))?;
            let unit = problem.unit(&a.name).unwrap_or("-").to_string();
            Some(Factor { name: a.name.clone(), unit, lower: a.range.lower, upper: a.range.upper, kind })
        };
        let mut factors: Vec<Factor> = axes.iter().filter_map(axis).collect();
        let n_axes = factors.len();
        let driven = |k: usize| loops.iter().any(|l| l.input == inputs[k]);
        factors.extend((0..inputs.len()).filter(|k| !driven(*k)).map(|k| {
            let i = &problem.inputs[k];
            let kind = FactorKind::Free(k);
            Factor { name: i.name.clone(), unit: i.unit.clone(), lower: i.lower, upper: i.upper, kind }
        }));
        let responses = responses(problem, &loops, variables);
        Self { problem: problem.clone(), loops, factors, axes: n_axes, held, responses, sample_time_s }
    }

    /// Numbers of the inputs that loops drive.
    pub fn driven(&self) -> Vec<usize> {
        let inputs = self.problem.input_names();
        self.loops.iter().filter_map(|l| inputs.iter().position(|i| *i == l.input)).collect()
    }

    /// Middle of all factors.
    pub fn centre(&self) -> Vec<f64> {
        self.factors.iter().map(|f| 0.5 * (f.lower + f.upper)).collect()
    }

    /// A point of the unit cube in the units of the factors.
    pub fn from_unit(&self, unit: &[f64]) -> Vec<f64> {
        self.factors.iter().zip(unit).map(|(f, u)| f.lower + u * (f.upper - f.lower)).collect()
    }

    /// Factors as shares of their ranges.
    pub fn to_unit(&self, x: &[f64]) -> Vec<f64> {
        self.factors.iter().zip(x).map(|(f, x)| (x - f.lower) / (f.upper - f.lower)).collect()
    }

    /// Names of the factors.
    pub fn factor_names(&self) -> Vec<String> {
        self.factors.iter().map(|f| f.name.clone()).collect()
    }

    /// Value of a given channel or demand at `x`, held ones from where they are held.
    fn value(&self, name: &str, kind: FactorKind, x: &[f64]) -> f64 {
        let place = self.factors.iter().position(|f| f.kind == kind);
        place.map(|k| x[k]).or_else(|| self.held.get(name).copied()).unwrap_or(f64::NAN)
    }

    /// Axes that are demands: number of the factor, and of the demand with its loop.
    pub fn demanded(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        self.factors[..self.axes].iter().enumerate().filter_map(|(k, f)| match f.kind {
            FactorKind::Demand(l) => Some((k, l)),
            _ => None,
        })
    }

    /// The first of them: the demand along which lines go and what is slow acts.
    pub fn leading_demand(&self) -> Option<(usize, usize)> {
        self.demanded().next()
    }

    /// The factor that is the demand of loop `l`; none where that is held.
    pub fn demand_factor(&self, l: usize) -> Option<usize> {
        self.demanded().find(|(_, of)| *of == l).map(|(k, _)| k)
    }

    /// Demand number `k` at factors `x`.
    pub fn demand(&self, k: usize, x: &[f64]) -> f64 {
        self.value(&self.problem.demands[k].output, FactorKind::Demand(k), x)
    }

    /// Given channel number `k` at factors `x`.
    pub fn given(&self, k: usize, x: &[f64]) -> f64 {
        self.value(&self.problem.given[k].name, FactorKind::Given(k), x)
    }

    /// A plan that goes from the factors `from` to `to` in `ramp` samples and stays there for `hold` more, the inputs that loops
    /// drive fed forward with `driven` (by number of the loop).
    pub fn plan(
        &self,
        name: &str,
        from: &[f64],
        to: &[f64],
        driven: &[f64],
        ramp: usize,
        hold: usize,
    ) -> Plan {
        self.along(name, from, &[(to, ramp), (to, hold)], driven)
    }

    /// A plan that goes from the factors `from` along straight ways: each to its factors in so many samples.
    pub fn along(&self, name: &str, from: &[f64], ways: &[(&[f64], usize)], driven: &[f64]) -> Plan {
        let n: usize = ways.iter().map(|w| w.1).sum();
        let course = |value: &dyn Fn(&[f64]) -> f64| -> Vec<f64> {
            let (mut values, mut a) = (Vec::with_capacity(n), value(from));
            for (to, samples) in ways {
                let b = value(to);
                values.extend((1..=*samples).map(|t| a + (b - a) * t as f64 / *samples as f64));
                a = b;
            }
            values
        };
        let loops_of = self.driven();
        let moved = self.problem.inputs.iter().enumerate().map(|(k, i)| {
            let values = match loops_of.iter().position(|d| *d == k) {
                Some(l) => vec![driven[l]; n],
                None => course(&|x| self.free(k, x)),
            };
            PlanChannel::free(&i.name, &i.unit, values).within(i.lower, i.upper)
        });
        let imposed = self
            .problem
            .given
            .iter()
            .enumerate()
            .map(|(k, g)| PlanChannel::free(&g.name, &g.unit, course(&|x| self.given(k, x))));
        let demands = self.problem.demands.iter().enumerate().map(|(k, d)| PlanDemand {
            output: d.output.clone(),
            unit: d.unit.clone(),
            values: course(&|x| self.demand(k, x)),
        });
        let mut plan = Plan::open_loop(name, self.sample_time_s, moved.chain(imposed).collect())
            .with_loops(demands.collect(), self.loops.clone());
        plan.outputs = self.recorded();
        plan
    }

    fn free(&self, input: usize, x: &[f64]) -> f64 {
        let place = self.factors.iter().position(|f| f.kind == FactorKind::Free(input));
        place.map_or(f64::NAN, |k| x[k])
    }

    /// One more response without a limit or weight, where it is not there yet: an output among the `variables` of a plant, else a
    /// derived channel. False where it is neither.
    pub fn add_response(&mut self, name: &str, variables: &[Variable]) -> bool {
        if self.responses.iter().any(|r| r.name == name) {
            return true;
        }
        let mut outputs = variables.iter().filter(|v| v.causality == Causality::Output);
        let derived = self.problem.derive.iter().any(|d| d.name == name);
        let (unit, source) = match outputs.find(|v| v.name == name) {
            Some(v) => (v.unit.clone(), ResponseSource::Output),
            None if derived => (self.problem.unit(name).unwrap_or("-").to_string(), ResponseSource::Derived),
            None => return false,
        };
        let name = name.to_string();
        let (lower, upper) = (None, None);
        self.responses.push(ResponseChannel { name, unit, source, lower, upper, weight: 0.0, slow: false });
        true
    }

    /// Outputs of the plant that are recorded.
    pub fn recorded(&self) -> Vec<String> {
        let mut names = self.problem.demand_names();
        for r in self.responses.iter().filter(|r| r.source == ResponseSource::Output) {
            if !names.contains(&r.name) {
                names.push(r.name.clone());
            }
        }
        names
    }

    /// Means over a record: factors as they were (demands as measured), and responses.
    ///
    /// # Errors
    /// [`DerivedError`]: a channel that the record does not have, a derived value that is not finite.
    pub fn means(&self, record: &Dataset) -> Result<(Vec<f64>, Vec<f64>), DerivedError> {
        let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len().max(1) as f64;
        let factors = self.factors.iter().map(|f| Ok(mean(record.values(&f.name)?)));
        let responses = self.responses.iter().map(|r| {
            let values = match r.source {
                ResponseSource::Derived => self.problem.values(&r.name, record)?,
                _ => record.values(&r.name)?.to_vec(),
            };
            Ok(mean(&values))
        });
        Ok((factors.collect::<Result<_, DerivedError>>()?, responses.collect::<Result<_, DerivedError>>()?))
    }
}

/// Driven inputs with their ranges, limited outputs, and what is minimised where it is none of them.
fn responses(
    problem: &CalibrationProblem,
    loops: &[PlanLoop],
    variables: &[Variable],
) -> Vec<ResponseChannel> {
    // A sum of nothing would be -0.
    let weight =
        |name: &str| problem.minimise.iter().filter(|m| m.channel == name).fold(0.0, |sum, m| sum + m.weight);
    let mut all: Vec<ResponseChannel> = Vec::new();
    for l in loops {
        let Some(k) = problem.inputs.iter().position(|i| i.name == l.input) else { continue };
        let i = &problem.inputs[k];
        all.push(ResponseChannel {
            name: i.name.clone(),
            unit: i.unit.clone(),
            source: ResponseSource::Driven(k),
            lower: Some(i.lower),
            upper: Some(i.upper),
            weight: weight(&i.name),
            slow: false,
        });
    }
    let metered = |name: &str, unit: &str| {
        let mut outputs = variables.iter().filter(|v| v.causality == Causality::Output);
        outputs.any(|v| v.name == name && v.unit == unit)
    };
    for l in &problem.limits {
        let derived = problem.derive.iter().any(|d| d.name == l.output) && !metered(&l.output, &l.unit);
        // At rest a limit of the mean is a limit.
        let upper = match (l.upper, l.mean_upper) {
            (Some(a), Some(b)) => Some(a.min(b)),
            (a, b) => a.or(b),
        };
        all.push(ResponseChannel {
            name: l.output.clone(),
            unit: l.unit.clone(),
            source: if derived { ResponseSource::Derived } else { ResponseSource::Output },
            lower: l.lower,
            upper,
            weight: weight(&l.output),
            slow: false,
        });
    }
    for m in &problem.minimise {
        let there = all.iter().any(|r| r.name == m.channel);
        let unit = problem.unit(&m.channel).unwrap_or("-").to_string();
        let output = metered(&m.channel, &unit);
        // Free inputs and given channels are factors: they are minimised through a derived channel.
        if !there {
            let source = if output { ResponseSource::Output } else { ResponseSource::Derived };
            let (name, weight) = (m.channel.clone(), weight(&m.channel));
            all.push(ResponseChannel { name, unit, source, lower: None, upper: None, weight, slow: false });
        }
    }
    all
}
