//! Base tables with a lead and a lag: what a calibrator reads, edits and signs.
//!
//! With the leading demand T, the first given channel N and every other reference r about its rest r0, for every actuator
//!
//! ```text
//! v(t)  = B(T, N) + sum_r S_r(T, N) (r - r0)          tables, bilinear
//! tau x' + x = v,      u = x + h (v - x)              (1 + h tau s) / (1 + tau s),  tau = tau(T, N) a table
//! ```
//!
//! At rest u = v, so that dynamics never move what holds at rest. The tables come from the structured inverse of the optimal
//! records at rest; [`LeadLagMap::anchored`] moves them onto points that were measured at rest, and [`LeadLagMap::tuned`] chooses
//! h and tau(T, N) = tau0 (N0/N)^a (T/T0)^b for every actuator that does not lead, by models of the plant; [`LeadLagMap::led`] lets the
//! one that leads go beyond its rest for a while (h > 1), where nothing has to wait for it.

mod onto;
mod rounded;
mod search;

use super::lookup::Corners;
use super::structured::{StructuredMap, StructuredShape};
use super::structures::{
    FitTask, FittedMap, InverseScore, MapError, MapRow, MapStructure, Pairs, StoredMap, r2,
};
use super::{FeedforwardMap, FirstOrder, Judge, MapForm, Ports, Rows, SteadyPoint};
use dynocal_files::spec::Faults;
use dynocal_numerics::interval::Interval;
use dynocal_numerics::registry::{self, MemberDoc, ParamDoc};
use dynocal_numerics::status::Status;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Row of the table.
pub(super) const ROW: MapRow = MapRow {
    doc: MemberDoc {
        name: "lead_lag",
        what: "base tables over the leading demand and the first given channel, each with a lead and a table of lags",
        params: &[
            ParamDoc {
                name: "demand_points",
                unit: "-",
                default: "9",
                what: "breakpoints of the leading demand",
            },
            ParamDoc {
                name: "given_points",
                unit: "-",
                default: "9",
                what: "breakpoints of the given channel",
            },
            ParamDoc {
                name: "resolution",
                unit: "of the actuator",
                default: "none",
                what: "by actuator: its base table holds multiples of this, slopes are steps that make as much over the range of their reference",
            },
            ParamDoc {
                name: "lag_resolution_s",
                unit: "s",
                default: "0",
                what: "lags are multiples of this; 0: any",
            },
        ],
    },
    fits: |ports| !ports.demands.is_empty(),
    build: |keys| Ok(Box::new(registry::keys::<LeadLagShape>("lead_lag", keys)?)),
    read: |map| Ok(Arc::new(serde_json::from_value::<LeadLagMap>(map)?)),
};

/// Most of a lead: a leading actuator that goes further beyond its rest asks for more than a model of the plant was told.
const MOST_LEAD: f64 = 4.0;
/// Steps of its line search.
const LEAD_STEPS: u32 = 6;
/// Lags in s at which the lead of the leading actuator is looked for.
const LED_S: [f64; 3] = [0.05, 0.1, 0.2];
/// Share of the judged number by which a change must pay.
const PAYS: f64 = 1e-3;

/// Shape of the map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LeadLagShape {
    /// Breakpoints of the leading demand.
    pub demand_points: usize,
    /// Breakpoints of the first given channel.
    pub given_points: usize,
    /// By actuator: step of which its tables hold multiples, in its unit.
    pub resolution: BTreeMap<String, f64>,
    /// Step of the lags in s; 0: none.
    pub lag_resolution_s: f64,
}

impl Default for LeadLagShape {
    fn default() -> Self {
        Self { demand_points: 9, given_points: 9, resolution: BTreeMap::new(), lag_resolution_s: 0.0 }
    }
}

/// Dynamics of one actuator.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LagLaw {
    /// Lag in s in the middle of both axes.
    pub tau_s: f64,
    /// Power of (middle / given channel).
    pub by_given: f64,
    /// Power of (leading demand / middle).
    pub by_demand: f64,
    /// Time constant of the lead over that of the lag: 0 a lag, 1 at once, above 1 beyond the rest for a while.
    pub lead: f64,
}

impl LagLaw {
    /// At once.
    const NONE: Self = Self { tau_s: 0.0, by_given: 1.0, by_demand: 0.0, lead: 0.0 };
}

/// The map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LeadLagMap {
    /// What it reads and gives.
    pub ports: Ports,
    /// Breakpoints of the leading demand.
    pub demand: Vec<f64>,
    /// Breakpoints of the first given channel; one value where there is none.
    pub given: Vec<f64>,
    /// Range of each reference in the data; references outside are clamped to it.
    pub region: Vec<Interval>,
    /// Rest of each reference that is no axis, and its place among the references.
    pub others: Vec<OtherReference>,
    /// Actuators in the order of the ports.
    pub actuators: Vec<ActuatorTables>,
    /// Largest difference of the tables between their breakpoints from what they were made of, as a share of the range of each
    /// actuator's table.
    pub loss: Vec<f64>,
    /// Steps that its values are multiples of; none: any value.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub steps: Option<Steps>,
}

/// Resolution of the tables, and what rounding to it changed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Steps {
    /// Step of the tables of each actuator, in its unit; 0: none.
    pub actuators: Vec<f64>,
    /// Step of the lags in s; 0: none.
    pub lag_s: f64,
    /// Largest change of what the tables of each actuator say, as a share of the range of its base table; nothing before they are rounded.
    pub rounding: Vec<f64>,
}

/// A reference that acts by slopes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OtherReference {
    /// Place among the references.
    pub place: usize,
    /// Value at which the base tables hold.
    pub rest: f64,
}

/// Tables of one actuator, leading demand slow, given channel fast.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActuatorTables {
    /// Values at rest.
    pub base: Vec<f64>,
    /// Slopes over each other reference.
    pub slopes: Vec<Vec<f64>>,
    /// Time constants of the lag in s.
    pub lag_s: Vec<f64>,
    /// What they were made of.
    pub law: LagLaw,
}

impl MapStructure for LeadLagShape {
    fn check(&self, ports: &Ports, key: &str, faults: &mut Faults) {
        rounded::check(self, ports, key, faults);
        for (name, n) in [("demand_points", self.demand_points), ("given_points", self.given_points)] {
            if !(2..=65).contains(&n) {
                faults.push(&format!("{key}.{name}"), n, "from 2 to 65");
            }
        }
    }

    fn filter_s(&self, demand: &str, k: usize) -> Vec<f64> {
        StructuredShape::default().filter_of(demand, k).to_vec()
    }

    fn fit(&self, task: &FitTask) -> Result<FittedMap, MapError> {
        let inverse = StructuredMap::fit(&StructuredShape::default(), task.ports, task.pairs)?;
        let map = LeadLagMap::from_inverse(self, &inverse, task.pairs);
        let scores = map.scores(task.pairs);
        Ok(FittedMap { map: Some(StoredMap::new(map)), scores })
    }
}

/// `n` values over a range.
fn spread(range: Interval, n: usize) -> Vec<f64> {
    (0..n).map(|k| range.lower + range.width() * k as f64 / (n - 1) as f64).collect()
}

impl LeadLagMap {
    /// Tables of an inverse at rest, without dynamics.
    fn from_inverse(shape: &LeadLagShape, inverse: &StructuredMap, pairs: &[Pairs]) -> Self {
        let (ports, region) = (inverse.ports.clone(), inverse.region.clone());
        let first_given = (!ports.given.is_empty()).then_some(ports.demands.len());
        let demand = spread(region[0], shape.demand_points);
        let given = first_given.map_or_else(|| vec![0.0], |g| spread(region[g], shape.given_points));
        let others: Vec<OtherReference> = (1..ports.n_references())
            .filter(|r| Some(*r) != first_given)
            .map(|place| OtherReference { place, rest: mean_of(pairs, place) })
            .collect();
        let mut row = vec![0.0; ports.n_references()];
        others.iter().for_each(|o| row[o.place] = o.rest);
        let at = |t: f64, n: f64, row: &mut Vec<f64>| {
            row[0] = t;
            if let Some(g) = first_given {
                row[g] = n;
            }
            inverse.steady(row)
        };
        let cells = demand.len() * given.len();
        let mut actuators: Vec<ActuatorTables> = ports
            .actuators
            .iter()
            .map(|_| ActuatorTables {
                base: Vec::with_capacity(cells),
                slopes: vec![Vec::with_capacity(cells); others.len()],
                lag_s: vec![0.0; cells],
                law: LagLaw::NONE,
            })
            .collect();
        for &t in &demand {
            for &n in &given {
                let base = at(t, n, &mut row);
                actuators.iter_mut().zip(&base).for_each(|(a, v)| a.base.push(*v));
                for (k, o) in others.iter().enumerate() {
                    // A tenth of what was seen on either side: the slope about its rest.
                    let half = 0.1 * region[o.place].width();
                    let mut side = |sign: f64| {
                        row[o.place] = o.rest + sign * half;
                        at(t, n, &mut row)
                    };
                    let (up, down) = (side(1.0), side(-1.0));
                    row[o.place] = o.rest;
                    for (c, a) in actuators.iter_mut().enumerate() {
                        let slope = (up[c] - down[c]) / (2.0 * half);
                        a.slopes[k].push(if slope.is_finite() { slope } else { 0.0 });
                    }
                }
            }
        }
        let steps = rounded::steps(shape, &ports);
        let mut map = Self { ports, demand, given, region, others, actuators, loss: Vec::new(), steps };
        map.loss = map.loss_against(|t, n| at(t, n, &mut row));
        map
    }

    /// Largest difference of every base table from `whole` half-way between its breakpoints, as a share of its range.
    fn loss_against(&self, mut whole: impl FnMut(f64, f64) -> Vec<f64>) -> Vec<f64> {
        let between = |axis: &[f64]| -> Vec<f64> {
            let middles: Vec<f64> = axis.windows(2).map(|w| 0.5 * (w[0] + w[1])).collect();
            if middles.is_empty() { axis.to_vec() } else { middles }
        };
        let mut worst = vec![0.0f64; self.actuators.len()];
        for t in between(&self.demand) {
            for n in between(&self.given) {
                let (corners, exact) = (Corners::around(&self.demand, &self.given, t, n), whole(t, n));
                for (w, (a, e)) in worst.iter_mut().zip(self.actuators.iter().zip(exact)) {
                    *w = w.max((corners.of(|k| a.base[k]) - e).abs());
                }
            }
        }
        let range = |a: &ActuatorTables| Interval::spanning(a.base.iter().copied()).width();
        worst.iter().zip(&self.actuators).map(|(w, a)| w / range(a).max(f64::MIN_POSITIVE)).collect()
    }

    /// Corners about the axes' place of one row of references.
    fn corners(&self, reference: &[f64]) -> Corners {
        let given = if self.ports.given.is_empty() { 0.0 } else { reference[self.ports.demands.len()] };
        Corners::around(&self.demand, &self.given, reference[0], given)
    }

    /// Values of the tables at a row of references, before the dynamics.
    fn at_rest(&self, reference: &[f64], corners: &Corners, v: &mut [f64]) {
        for (v, a) in v.iter_mut().zip(&self.actuators) {
            *v = corners.of(|k| a.base[k]);
            for (slope, o) in a.slopes.iter().zip(&self.others) {
                *v += corners.of(|k| slope[k]) * (self.region[o.place].clamp(reference[o.place]) - o.rest);
            }
        }
    }

    /// How well the tables alone give each actuator of the records.
    fn scores(&self, data: &[Pairs]) -> Vec<InverseScore> {
        let width = self.actuators.len();
        let mut v = vec![0.0; width];
        let mut columns = vec![(Vec::new(), Vec::new()); width];
        for pairs in data {
            for (reference, applied) in pairs.response.iter().zip(pairs.actuators.iter()) {
                self.at_rest(reference, &self.corners(reference), &mut v);
                for (c, (y, z)) in columns.iter_mut().enumerate() {
                    y.push(v[c]);
                    z.push(applied[c]);
                }
            }
        }
        let score = |(port, (y, z)): (&super::ActuatorPort, (Vec<f64>, Vec<f64>))| InverseScore {
            map: "tables at rest".into(),
            actuator: port.name.clone(),
            estimator: "least squares".into(),
            r2: r2(&y, &z),
            status: Status::Converged,
        };
        self.ports.actuators.iter().zip(columns).map(score).collect()
    }
}

/// Mean of a reference over all records.
fn mean_of(pairs: &[Pairs], place: usize) -> f64 {
    let n: usize = pairs.iter().map(|p| p.response.len()).sum();
    let sum: f64 = pairs.iter().flat_map(|p| p.response.iter()).map(|r| r[place]).sum();
    sum / n.max(1) as f64
}

impl FeedforwardMap for LeadLagMap {
    fn name(&self) -> &str {
        "map with lead and lag"
    }

    fn ports(&self) -> &Ports {
        &self.ports
    }

    fn drive(&self, reference: &Rows, sample_time_s: f64) -> Rows {
        let width = self.actuators.len();
        let mut out = Rows::from_values(width, vec![0.0; reference.len() * width]);
        let (mut v, mut lags) = (vec![0.0; width], Vec::new());
        for t in 0..reference.len() {
            let row = reference.row(t);
            let corners = self.corners(row);
            self.at_rest(row, &corners, &mut v);
            if t == 0 {
                lags.extend(v.iter().map(|v| FirstOrder::new(*v)));
            }
            let u = out.row_mut(t);
            for (c, (lag, a)) in lags.iter_mut().zip(&self.actuators).enumerate() {
                let x = lag.step(v[c], sample_time_s, corners.of(|k| a.lag_s[k]));
                u[c] = x + a.law.lead * (v[c] - x);
            }
            self.ports.clamp(u);
        }
        out
    }

    fn steady(&self, reference: &[f64]) -> Vec<f64> {
        let mut v = vec![0.0; self.actuators.len()];
        self.at_rest(reference, &self.corners(reference), &mut v);
        self.ports.clamp(&mut v);
        v
    }

    fn structure(&self) -> &'static str {
        ROW.doc.name
    }

    fn stored(&self) -> Result<serde_json::Value, serde_json::Error> {
        serde_json::to_value(self)
    }

    fn form(&self) -> MapForm<'_> {
        MapForm::Tables(self)
    }

    fn anchored(&self, points: &[SteadyPoint]) -> Option<StoredMap> {
        self.onto(points).map(StoredMap::new)
    }

    /// First one lag for all that follow ([`LeadLagMap::lagged`]); then for each of them lag,
    /// powers and lead by steps that are halved, each step for at least a thousandth of what is judged.
    fn tuned(&self, judge: Judge, leader: usize) -> Option<StoredMap> {
        let followers = self.followers(leader);
        let mut best = self.one_lag(judge, &followers)?;
        let all: Vec<(usize, f64)> = followers.into_iter().map(|c| (c, 1.0)).collect();
        best = Self::searched(best, judge, &all);
        Some(StoredMap::new(best.1))
    }

    /// From leads of the leading actuator at some lags the best; then lags, powers and leads of all actuators by steps that are halved.
    fn led(&self, judge: Judge, leader: usize, within: Interval) -> Option<StoredMap> {
        let plain = judge(self);
        let mut bounded = self.clone();
        let rests = Interval::spanning(self.actuators.get(leader)?.base.iter().copied());
        let port = &mut bounded.ports.actuators[leader];
        port.lower = port.lower.max(within.lower.min(rests.lower));
        port.upper = port.upper.min(within.upper.max(rests.upper));
        let mut best = (plain, bounded.clone());
        for tau_s in LED_S {
            for step in 1..=LEAD_STEPS {
                let lead = 1.0 + (MOST_LEAD - 1.0) * f64::from(step) / f64::from(LEAD_STEPS);
                let map = bounded.with(&[(leader, LagLaw { tau_s, lead, ..LagLaw::NONE })]);
                let value = judge(&map);
                if value < (1.0 - PAYS) * best.0 {
                    best = (value, map);
                }
            }
        }
        if !(best.0 < plain) {
            return None;
        }
        let most = |c| if c == leader { MOST_LEAD } else { 1.0 };
        let all: Vec<(usize, f64)> = (0..self.actuators.len()).map(|c| (c, most(c))).collect();
        Some(StoredMap::new(Self::searched(best, judge, &all).1))
    }

    fn rounded(&self) -> Option<StoredMap> {
        self.in_steps().map(StoredMap::new)
    }

    fn lagged(&self, judge: Judge, leader: usize) -> Option<StoredMap> {
        Some(StoredMap::new(self.one_lag(judge, &self.followers(leader))?.1))
    }

    fn latency_s(&self, _sample_time_s: f64) -> f64 {
        0.0
    }
}

#[cfg(test)]
mod tests;
