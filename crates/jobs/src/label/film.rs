//! Recipe: share and time constant of the fuel film of port injection, and the way from the cylinder to the lambda sensor.
//!
//! ```text
//! fuel flow   f = injected * cylinders * speed / 120
//! film        c = film(f, X, tau(coolant))
//! lambda      l = air / (AFR * gain * c)
//! sensor      lag( lag( delay(l, cycles * 120 / speed + pipe / air), mixing / air ), sensor )
//! ```
//!
//! Air is that of a meter before the manifold, which does not see the cylinders while the manifold fills: after a tip-in samples count
//! again when air and speed have been slow for a while. By then a warm film has nearly settled, so that steps of the fuel at constant
//! air tell most of it.

use std::path::PathBuf;

use dynocal_files::run_folder::RunPlace;
use dynocal_label::graph::{Graph, Node, Op};
use dynocal_label::label::{Axis, Label};
use dynocal_label::linear::Options;

use super::function::spec::{Condition, Job, Row};
use super::result::LabelJobError;

/// What is asked for: names of channels, and constants of the engine.
#[derive(Clone, Debug)]
pub struct Film {
    /// Logs.
    pub data: Vec<PathBuf>,
    /// Fuel in mg for each cylinder and cycle.
    pub fuel: String,
    /// Air in g/s.
    pub air: String,
    /// Speed in rpm.
    pub speed: String,
    /// Lambda.
    pub lambda: String,
    /// Coolant temperature; none where the engine is warm throughout.
    pub coolant: Option<String>,
    /// Temperatures, in the unit of the coolant channel, at which tau is told.
    pub points: Vec<f64>,
    /// Cylinders.
    pub cylinders: usize,
    /// Stoichiometric air over fuel.
    pub afr: f64,
}

/// Change of air and speed, in shares a second, above which the manifold fills.
const FILLS: f64 = 0.25;
/// Fuel of a cylinder and cycle from which it is injected at all, mg.
const LEAST_FUEL_MG: f64 = 1e-3;
/// Speed from which the engine runs by itself, rpm; time in s after a fuel cut in which the exhaust holds its air. Both as of the fuel table.
const LEAST_SPEED_RPM: f64 = 400.0;
const ECHO_S: f64 = 1.5;
/// Lambda beyond which there is air and no mixture: what the function says during a cut, so that it stays a number.
const AIR_LAMBDA: f64 = 10.0;
/// Air of an engine that stands, g/s, so that delays stay numbers.
const LEAST_AIR_G_S: f64 = 0.01;
/// Time in s after which it has filled.
const FILLED_S: f64 = 0.8;

impl Film {
    /// The fit that it means.
    ///
    /// # Errors
    /// [`LabelJobError::Option`]: constants out of range, temperatures that do not increase.
    pub fn job(&self, out: RunPlace) -> Result<Job, LabelJobError> {
        self.check()?;
        let mut channels = vec![self.fuel.clone(), self.speed.clone(), self.air.clone()];
        channels.extend(self.coolant.clone());
        let slow = |channel: &str| Condition {
            channel: channel.into(),
            least: None,
            greatest: None,
            slower_than: Some(FILLS),
            for_s: Some(FILLED_S),
        };
        let above = |channel: &str, least: f64| Condition {
            channel: channel.into(),
            least: Some(least),
            greatest: None,
            slower_than: None,
            for_s: Some(ECHO_S),
        };
        // A cut of the fuel is no lambda, nor is an engine that stands; the exhaust holds the air of both for a while.
        let running = [above(&self.fuel, LEAST_FUEL_MG), above(&self.speed, LEAST_SPEED_RPM)];
        let graph = self.graph();
        let node = graph.nodes.len() - 1;
        Ok(Job {
            name: "label-film".into(),
            out,
            data: self.data.clone(),
            units: vec![Some("mg".into()), Some("rpm".into()), Some("g/s".into()), None][..channels.len()]
                .to_vec(),
            channels,
            rows: vec![Row { node, name: "sensor".into(), target: self.lambda.clone(), weight: 1.0 }],
            conditions: [slow(&self.air), slow(&self.speed)].into_iter().chain(running).collect(),
            lambda: Some(self.lambda.clone()),
            train: 0.7,
            graph,
            shared: Vec::new(),
            placed: Vec::new(),
            fitted: Vec::new(),
            reduce: 1,
            fit: Options::default(),
        })
    }

    fn check(&self) -> Result<(), LabelJobError> {
        let fail = |option, found: String, expected| Err(LabelJobError::Option { option, found, expected });
        if !(1..=24).contains(&self.cylinders) {
            return fail("--cylinders", self.cylinders.to_string(), "a number from 1 to 24");
        }
        if !(4.0..=40.0).contains(&self.afr) {
            return fail("--afr", self.afr.to_string(), "an air-fuel ratio from 4 to 40");
        }
        if self.data.is_empty() {
            return fail("LOG", "none".into(), "one log or more");
        }
        let increasing =
            self.points.windows(2).all(|w| w[1] > w[0]) && self.points.iter().all(|p| p.is_finite());
        match &self.coolant {
            Some(_) if self.points.len() < 2 || !increasing => {
                fail("--at", format!("{:?}", self.points), "two or more temperatures that increase")
            }
            None if !self.points.is_empty() => fail(
                "--at",
                format!("{:?}", self.points),
                "--coolant CHANNEL beside it: the temperatures are of that channel",
            ),
            _ => Ok(()),
        }
    }

    fn labels(&self) -> Vec<Label> {
        let bounded = |mut l: Label, least: f64, greatest: f64| {
            (l.lower, l.upper) = (least, greatest);
            l
        };
        let scalar = |name: &str, unit: &str, start: f64, least: f64, greatest: f64| {
            bounded(Label::scalar(name, unit, start), least, greatest)
        };
        let tau = match &self.coolant {
            None => Label::scalar("FILM_TAU", "s", 0.3),
            Some(c) => {
                let axis = Axis::new(c, "", &self.points);
                Label::new("FILM_TAU", "s", vec![axis], &vec![0.3; self.points.len()])
            }
        };
        vec![
            scalar("FILM_SHARE", "-", 0.2, 0.0, 0.95),
            bounded(tau, 0.02, 20.0),
            scalar("FUEL_GAIN", "-", 1.0, 0.5, 2.0),
            scalar("CYCLES_TO_SENSOR", "-", 1.0, 0.0, 6.0),
            scalar("PIPE", "g", 0.2, 0.0, 10.0),
            scalar("MIXING", "g", 0.5, 0.01, 10.0),
            scalar("SENSOR_LAG", "s", 0.05, 0.002, 2.0),
        ]
    }

    fn graph(&self) -> Graph {
        let mut nodes: Vec<Node> = Vec::new();
        let mut add = |name: &str, op: Op| {
            nodes.push(Node { name: name.into(), op });
            nodes.len() - 1
        };
        let (fuel, speed, air) =
            (add("fuel", Op::Channel(0)), add("speed", Op::Channel(1)), add("air", Op::Channel(2)));
        let at = match self.coolant {
            Some(_) => vec![add("coolant", Op::Channel(3))],
            None => Vec::new(),
        };
        let share = add("share", Op::Label(0, vec![]));
        let tau = add("tau", Op::Label(1, at));
        // mg for each cylinder and cycle of two turns, as g/s.
        let flow = add("g/s", Op::Constant(1e-3 * self.cylinders as f64 / 120.0));
        let injected = add("injected", Op::Multiply(vec![fuel, speed, flow]));
        let burnt = add("burnt", Op::Film(injected, share, tau));
        let (gain, afr) = (add("gain", Op::Label(2, vec![])), add("afr", Op::Constant(self.afr)));
        let needed = add("needed", Op::Multiply(vec![burnt, gain, afr]));
        let (leanest, still) = (
            add("air over its lambda", Op::Constant(1.0 / AIR_LAMBDA)),
            add("still", Op::Constant(LEAST_AIR_G_S)),
        );
        let air = add("moving air", Op::Max(air, still));
        let least = add("least", Op::Multiply(vec![air, leanest]));
        let needed = add("burnt at least", Op::Max(needed, least));
        let lambda = add("lambda", Op::Divide(air, needed));
        let slowest = add("slowest", Op::Constant(LEAST_SPEED_RPM));
        let speed = add("running speed", Op::Max(speed, slowest));
        let (turns, cycles) = (add("120", Op::Constant(120.0)), add("cycles", Op::Label(3, vec![])));
        let cycle_s = add("cycle", Op::Divide(turns, speed));
        let waiting = add("waiting", Op::Multiply(vec![cycles, cycle_s]));
        let pipe = add("pipe", Op::Label(4, vec![]));
        let moving = add("moving", Op::Divide(pipe, air));
        let late = add("late", Op::Add(vec![waiting, moving]));
        let there = add("there", Op::Delay(lambda, late));
        let mixing = add("mixing", Op::Label(5, vec![]));
        let mixing_s = add("mixing_s", Op::Divide(mixing, air));
        let mixed = add("mixed", Op::Lag(there, mixing_s));
        let lag = add("lag", Op::Label(6, vec![]));
        add("sensor", Op::Lag(mixed, lag));
        Graph { nodes, labels: self.labels() }
    }
}
