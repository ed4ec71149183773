//! Feedforward maps: from a record of demands to a record of actuators, by channel name.
//!
//! A map reads *references*, the demanded outputs and the given operating channels (torque, lambda; speed), and gives
//! *actuators*, the inputs that may move. Static maps see the present sample only; dynamic maps see the look-ahead that the
//! filter of the demand buys.

use dynocal_numerics::interval::Interval;
use serde::{Deserialize, Serialize};

pub mod anchor;
pub mod filter;
pub mod lagged;
pub mod lead_lag;
mod lookup;
pub mod published;
pub mod rows;
pub mod start;
pub mod static_map;
pub mod structured;
pub mod structures;
mod surface;

pub use filter::FirstOrder;
pub use rows::Rows;

/// A channel that a map reads.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Port {
    /// Name.
    pub name: String,
    /// Unit.
    pub unit: String,
}

/// A channel that a map gives, with the limits that it keeps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActuatorPort {
    /// Name.
    pub name: String,
    /// Unit.
    pub unit: String,
    /// Least value.
    pub lower: f64,
    /// Largest value.
    pub upper: f64,
}

/// What a map reads and gives. A row of references holds the demands, the first one being the one that the others follow
/// (torque), and then the given channels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ports {
    /// Demanded outputs.
    pub demands: Vec<Port>,
    /// Given operating channels.
    pub given: Vec<Port>,
    /// Actuators.
    pub actuators: Vec<ActuatorPort>,
}

impl Ports {
    /// Width of a row of references.
    pub fn n_references(&self) -> usize {
        self.demands.len() + self.given.len()
    }

    /// References in the order of a row.
    pub fn references(&self) -> impl Iterator<Item = &Port> {
        self.demands.iter().chain(&self.given)
    }

    /// Names of the references in the order of a row.
    pub fn reference_names(&self) -> Vec<String> {
        self.references().map(|p| p.name.clone()).collect()
    }

    /// Names of the actuators.
    pub fn actuator_names(&self) -> Vec<String> {
        self.actuators.iter().map(|p| p.name.clone()).collect()
    }

    /// `u` (one value per actuator) inside the limits.
    pub fn clamp(&self, u: &mut [f64]) {
        for (v, port) in u.iter_mut().zip(&self.actuators) {
            *v = v.clamp(port.lower, port.upper);
        }
    }
}

/// What is minimised when the dynamics of a map are chosen: a number for any map, from models of the plant.
pub type Judge<'a> = &'a dyn Fn(&dyn FeedforwardMap) -> f64;

/// What a map is made of.
pub enum MapForm<'a> {
    /// Terms with coefficients.
    Terms(&'a structured::StructuredMap),
    /// Tables.
    Tables(&'a lead_lag::LeadLagMap),
    /// Something that has no form for people.
    Other,
}

/// A measured point at rest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SteadyPoint {
    /// References as measured (demanded outputs, given channels).
    pub reference: Vec<f64>,
    /// Actuators that were applied.
    pub actuators: Vec<f64>,
}

/// A feedforward map.
pub trait FeedforwardMap: Send + Sync {
    /// Name for tables and plots.
    fn name(&self) -> &str;

    /// What it reads and gives.
    fn ports(&self) -> &Ports;

    /// Actuators for a whole record of raw references (N x [`Ports::n_references`]), as the map would have given them online,
    /// sample by sample (causal: its own filter, delay and look-ahead included).
    fn drive(&self, reference: &Rows, sample_time_s: f64) -> Rows;

    /// Steady-state actuators at an operating point (one row of references).
    fn steady(&self, reference: &[f64]) -> Vec<f64>;

    /// Name of its structure in the table ([`structures::MAP_STRUCTURES`]); empty for a map that is not kept.
    fn structure(&self) -> &'static str {
        ""
    }

    /// The map as JSON, without the name of its structure.
    ///
    /// # Errors
    /// A map that is not kept has none.
    fn stored(&self) -> Result<serde_json::Value, serde_json::Error> {
        Err(serde::ser::Error::custom(format!("the {} is no structure of the table", self.name())))
    }

    /// The map as what exports and pages can show of it.
    fn form(&self) -> MapForm<'_> {
        MapForm::Other
    }

    /// The same map moved onto points at rest that were measured; none where the structure cannot be moved, or the points ask
    /// for nothing that holds at points left out.
    fn anchored(&self, _points: &[SteadyPoint]) -> Option<structures::StoredMap> {
        None
    }

    /// The same map with the dynamics that `judge` likes best (less is better); `leader` is the actuator that acts at once. None
    /// where the structure has no dynamics to choose.
    fn tuned(&self, _judge: Judge, _leader: usize) -> Option<structures::StoredMap> {
        None
    }

    /// The same map with a leading actuator that may go beyond its rest for a while, as `judge` likes it best, and the dynamics of all
    /// others chosen anew with it: for plants where nothing has to wait for the leader. It stays `within` a range on its way, as far as it
    /// rests there. None as of [`FeedforwardMap::tuned`], or where no lead pays.
    fn led(&self, _judge: Judge, _leader: usize, _within: Interval) -> Option<structures::StoredMap> {
        None
    }

    /// The same map with its values in steps, as a control unit keeps them. None where no resolution was asked for.
    fn rounded(&self) -> Option<structures::StoredMap> {
        None
    }

    /// The same map with the plainest dynamics, one lag of all actuators but `leader`, as `judge` likes it best: what shows whether
    /// those of [`FeedforwardMap::tuned`] pay. None where the structure has none.
    fn lagged(&self, _judge: Judge, _leader: usize) -> Option<structures::StoredMap> {
        None
    }

    /// Longest time in s that the map waits on purpose before it answers a demand.
    fn latency_s(&self, sample_time_s: f64) -> f64;
}
