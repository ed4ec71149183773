//! An engine in closed form, and its spec.

use dynocal_ident::plant::{Causality, LimitEvent, Plant, PlantError, PlantState, Variable, show};
use dynocal_jobs::map::{MapError, Mapped, job, work};
use dynocal_jobs::place::Overrides;
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::watch::Watch;

/// How a bed fails.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Fault {
    None,
    /// It refuses to go on after so many seconds.
    Stalls(f64),
    /// Torque swings for ever.
    Swings,
    /// Torque swings from one time to another, in s.
    SwingsIn(f64, f64),
    /// Knock does not depend on anything.
    NoSignal,
    /// The load saturates as a throttle does ([`saturated`]).
    Saturates,
    /// Oil is 40 s behind where it comes to rest, and helps by 0.1 Nm a K ([`oil_at_rest`]).
    Oil,
}

/// Torque = load eff(spark, cam), behind a lag of 0.3 s:
///
/// ```text
/// eff   = 1 - 0.2 (spark - s0)^2 - 0.1 (cam - c0)^2,   s0 = 0.7 + 0.2 n,  c0 = 0.3 + 0.3 n,   n = speed / 1000 - 1
/// knock = 0.2 + 0.006 torque + 0.6 spark
/// heat  = 500 + 3 torque - 100 spark + 150 cam
/// fuel  = load
/// ```
pub(crate) struct Bench {
    variables: Vec<Variable>,
    noise: f64,
    shift: f64,
    fault: Fault,
    rng: Rng64,
    torque: f64,
    oil: f64,
    time_s: f64,
    shown: Vec<f64>,
}

const OUTPUTS: [(&str, &str); 5] =
    [("torque", "Nm"), ("knock", "-"), ("heat", "K"), ("fuel", "kg/h"), ("oil", "K")];

impl Bench {
    pub(crate) fn new(noise: f64, fault: Fault) -> Self {
        let variable = |name: &str, unit: &str, causality, min, max, start| Variable {
            name: name.into(),
            unit: unit.into(),
            causality,
            min,
            max,
            start,
        };
        let mut variables = vec![
            variable("load", "kg/h", Causality::Input, 0.0, 200.0, 50.0),
            variable("spark", "-", Causality::Input, 0.0, 1.0, 0.3),
            variable("cam", "-", Causality::Input, 0.0, 1.0, 0.5),
            variable("speed", "rpm", Causality::Input, 0.0, 1e4, 1500.0),
        ];
        variables.extend(OUTPUTS.map(|(n, u)| variable(n, u, Causality::Output, -1e6, 1e6, 0.0)));
        Self {
            variables,
            noise,
            shift: 0.0,
            fault,
            rng: Rng64::new(0),
            torque: 0.0,
            oil: OIL_K,
            time_s: 0.0,
            shown: vec![0.0; 5],
        }
    }

    /// Another engine: its best spark lies elsewhere.
    pub(crate) fn shifted(self, shift: f64) -> Self {
        Self { shift, ..self }
    }
}

impl Plant for Bench {
    fn variables(&self) -> &[Variable] {
        &self.variables
    }
    fn reset(&mut self, seed: u64) {
        (self.rng, self.torque, self.oil, self.time_s) = (Rng64::new(seed), 0.0, OIL_K, 0.0);
        self.shown.fill(0.0);
    }
    fn step(&mut self, u: &[f64], dt_s: f64, y: &mut [f64]) -> Result<(), PlantError> {
        if let Fault::Stalls(s) = self.fault
            && self.time_s > s
        {
            return Err(PlantError::Call("the engine has stalled".into()));
        }
        let [load, spark, cam, speed] = u else { return Err(PlantError::Call("four inputs".into())) };
        let n = speed / 1000.0 - 1.0;
        let (s0, c0) = (0.7 + 0.2 * n + self.shift, 0.3 + 0.3 * n);
        let eff = 1.0 - 0.2 * (spark - s0).powi(2) - 0.1 * (cam - c0).powi(2);
        let load_of = if self.fault == Fault::Saturates { saturated(*load, *cam) } else { *load };
        if self.fault == Fault::Oil {
            self.oil += (oil_at_rest(self.torque, *speed) - self.oil) * (1.0 - (-dt_s / 40.0f64).exp());
        }
        let drawn = load_of * eff + 0.1 * (self.oil - OIL_K);
        self.torque += (drawn - self.torque) * (1.0 - (-dt_s / 0.3f64).exp());
        self.time_s += dt_s;
        let mut scatter = |size: f64| size * self.noise * self.rng.normal();
        let swings = match self.fault {
            Fault::Swings => true,
            Fault::SwingsIn(from, to) => (from..to).contains(&self.time_s),
            _ => false,
        };
        let swing = if swings { 15.0 * (2.0 * self.time_s).sin() } else { 0.0 };
        y[0] = self.torque + swing + scatter(0.5);
        y[1] = match self.fault {
            Fault::NoSignal => 0.97 + scatter(0.05),
            _ => 0.2 + 0.006 * self.torque + 0.6 * spark + scatter(0.02),
        };
        y[2] = 500.0 + 3.0 * self.torque - 100.0 * spark + 150.0 * cam + scatter(2.0);
        y[3] = load_of + scatter(0.05);
        y[4] = self.oil;
        self.shown.copy_from_slice(y);
        Ok(())
    }
    fn outputs(&self, y: &mut [f64]) -> Result<(), PlantError> {
        show(&self.shown, y)
    }
    fn time_s(&self) -> f64 {
        self.time_s
    }
    fn take_events(&mut self) -> Vec<LimitEvent> {
        Vec::new()
    }
    fn save(&self) -> PlantState {
        PlantState([&[self.torque, self.oil, self.time_s], &self.shown[..]].concat())
    }
    fn restore(&mut self, state: &PlantState) -> Result<(), PlantError> {
        (self.torque, self.oil, self.time_s) = (state.0[0], state.0[1], state.0[2]);
        self.shown.copy_from_slice(&state.0[3..]);
        Ok(())
    }
    fn describe(&self) -> String {
        "bench".into()
    }
}

/// Temperature of the oil at which it does nothing.
const OIL_K: f64 = 380.0;

/// Where the oil comes to rest.
pub(crate) fn oil_at_rest(torque: f64, speed: f64) -> f64 {
    OIL_K + 0.03 * (speed - 1500.0) + 0.05 * (torque - 50.0)
}

/// What a load does on an engine whose load saturates: 60 at most with the cam at 0, 110 at 1.
pub(crate) fn saturated(load: f64, cam: f64) -> f64 {
    let most = 60.0 + 50.0 * cam;
    most * (1.0 - (-load / most).exp())
}

/// The best setting: spark limited by knock, cam by heat. On the boundary of heat spark and cam trade, so that both are found from
/// the conditions of the first order by a fine search of the closed form.
pub(crate) fn best(torque: f64, speed: f64, shift: f64) -> (f64, f64, f64) {
    let n = speed / 1000.0 - 1.0;
    let (s0, c0) = (0.7 + 0.2 * n + shift, 0.3 + 0.3 * n);
    let mut found = (f64::INFINITY, 0.0, 0.0);
    for i in 0..=2000 {
        let spark = f64::from(i) / 2000.0;
        if 0.2 + 0.006 * torque + 0.6 * spark > 1.0 + 1e-12 {
            break;
        }
        let most = ((720.0 - 500.0 - 3.0 * torque + 100.0 * spark) / 150.0).min(1.0);
        if most < 0.0 {
            continue;
        }
        let cam: f64 = c0.clamp(0.0, most);
        let fuel = torque / (1.0 - 0.2 * (spark - s0).powi(2) - 0.1 * (cam - c0).powi(2));
        if fuel < found.0 {
            found = (fuel, spark, cam);
        }
    }
    found
}

pub(crate) fn text(more: &str) -> String {
    format!(
        r#"
sample_time_s = 0.1
[problem]
minimise = [{{ channel = "fuel", weight = 1.0 }}]
[[problem.derive]]
name = "fuel"
unit = "kg/h"
factor = 1.0
powers = {{ load = 1 }}
[[problem.inputs]]
name = "load"
unit = "kg/h"
lower = 5.0
upper = 150.0
[[problem.inputs]]
name = "spark"
unit = "-"
lower = 0.0
upper = 1.0
[[problem.inputs]]
name = "cam"
unit = "-"
lower = 0.0
upper = 1.0
[[problem.given]]
name = "speed"
unit = "rpm"
lower = 1000.0
upper = 2000.0
[[problem.demands]]
output = "torque"
unit = "Nm"
lower = 20.0
upper = 80.0
[[problem.limits]]
output = "knock"
unit = "-"
upper = 1.0
[[problem.limits]]
output = "heat"
unit = "K"
upper = 720.0
[[loops]]
output = "torque"
input = "load"
gains = {{ ki = 1.0, kp = 0.2 }}
[axes]
torque = [30.0, 50.0, 70.0]
speed = [1100.0, 1500.0, 1900.0]
{more}
"#
    )
}

pub(crate) fn run_with(more: &str, seed: u64, mut plant: Bench) -> Result<Mapped, MapError> {
    let job = job::parse("map.toml", &text(more), &Overrides { seed: Some(seed), out: None }).unwrap();
    work::run_on(&job, &mut plant, Watch::silent())
}

pub(crate) const DAY: &str =
    "[bed]\npoints = 54\nblock = 10\n[bed.approach]\nsettle_s = 12.0\nwindow_s = 1.0\naverage_s = 2.0\n";

/// Fuel that the engine takes at a setting in closed form.
pub(crate) fn fuel(torque: f64, speed: f64, spark: f64, cam: f64, shift: f64) -> f64 {
    let n = speed / 1000.0 - 1.0;
    let (s0, c0) = (0.7 + 0.2 * n + shift, 0.3 + 0.3 * n);
    torque / (1.0 - 0.2 * (spark - s0).powi(2) - 0.1 * (cam - c0).powi(2))
}
