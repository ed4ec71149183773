//! When a held point counts as settled: also with scatter, and not while it drifts.

use dynocal_calib::steady::hold::{HoldSpec, Resting, hold};
use dynocal_ident::plan::{Plan, PlanChannel};
use dynocal_ident::plant::{Causality, LimitEvent, Plant, PlantError, PlantState, Variable};
use dynocal_numerics::rng::Rng64;

const DT_S: f64 = 0.03;

/// `y' = (u - y)/tau` from 0, with sensor noise that is white or, with `memory_s`, alike from sample to sample.
struct Lag {
    variables: [Variable; 2],
    tau_s: f64,
    noise: f64,
    memory_s: f64,
    carried: f64,
    rng: Rng64,
    shown: f64,
    state: [f64; 2],
}

impl Lag {
    fn new(tau_s: f64, noise: f64, memory_s: f64) -> Self {
        let of = |name: &str, unit: &str, causality| Variable {
            name: name.into(),
            unit: unit.into(),
            causality,
            min: -1e3,
            max: 1e3,
            start: 0.0,
        };
        let variables = [of("u", "deg", Causality::Input), of("torque", "Nm", Causality::Output)];
        Self {
            variables,
            tau_s,
            noise,
            memory_s,
            carried: 0.0,
            rng: Rng64::new(0),
            shown: 0.0,
            state: [0.0; 2],
        }
    }
}

impl Plant for Lag {
    fn variables(&self) -> &[Variable] {
        &self.variables
    }
    fn reset(&mut self, seed: u64) {
        (self.rng, self.state, self.carried) = (Rng64::new(seed), [0.0; 2], 0.0);
    }
    fn step(&mut self, inputs: &[f64], dt_s: f64, outputs: &mut [f64]) -> Result<(), PlantError> {
        let [y, time_s] = self.state;
        let y = inputs[0] + (y - inputs[0]) * (-dt_s / self.tau_s).exp();
        self.state = [y, time_s + dt_s];
        let keep = if self.memory_s > 0.0 { (-dt_s / self.memory_s).exp() } else { 0.0 };
        self.carried = keep * self.carried + self.noise * (1.0 - keep * keep).sqrt() * self.rng.normal();
        self.shown = y + self.carried;
        outputs[0] = self.shown;
        Ok(())
    }
    fn outputs(&self, outputs: &mut [f64]) -> Result<(), PlantError> {
        outputs[0] = self.shown;
        Ok(())
    }
    fn time_s(&self) -> f64 {
        self.state[1]
    }
    fn take_events(&mut self) -> Vec<LimitEvent> {
        Vec::new()
    }
    fn save(&self) -> PlantState {
        PlantState(self.state.to_vec())
    }
    fn restore(&mut self, state: &PlantState) -> Result<(), PlantError> {
        self.state.copy_from_slice(&state.0);
        Ok(())
    }
    fn describe(&self) -> String {
        "lag".into()
    }
}

/// Holds 50 Nm; resolution as of the thesis' range of torque.
fn held(tau_s: f64, noise: f64, memory_s: f64, seed: u64) -> dynocal_calib::steady::hold::Held {
    let spec = HoldSpec::default();
    let values = vec![50.0; spec.samples(DT_S)];
    let channel = PlanChannel::free("u", "deg", values);
    let plan = Plan::open_loop("hold", DT_S, vec![channel]).recording(&["torque"]);
    let rest = [Resting { output: "torque".into(), demand: 50.0, resolution: 0.02 }];
    let mut plant = Lag::new(tau_s, noise, memory_s);
    plant.reset(seed);
    hold(&mut plant, &spec, &plan, &rest).unwrap()
}

/// A fixed band of 0.02 Nm is never met by a sensor with scatter; the means of two windows are, when nothing drifts.
#[test]
fn a_sensor_with_scatter_settles_and_its_mean_is_right() {
    let quiet = held(0.3, 0.0, 0.0, 0);
    assert!(quiet.settled && quiet.used_s < 5.0, "{quiet:?}");
    for noise in [0.1, 0.5, 2.0] {
        let all: Vec<_> = (0..60).map(|seed| held(0.3, noise, 0.0, seed)).collect();
        let settled = all.iter().filter(|h| h.settled).count();
        // Means that are equal differ by more than two standard errors once in twenty windows, and there are many windows.
        assert!(settled >= 59, "{settled} of 60 at {noise} Nm");
        // The mean of a second: five of its standard errors, and what is left of the transient.
        let bound = 5.0 * noise * (DT_S / HoldSpec::default().average_s).sqrt() + 0.1 * noise + 0.05;
        assert!(all.iter().all(|h| h.errors[0].abs() < bound), "{noise} Nm");
        // Not three times the bed time of a sensor without scatter.
        let used = all.iter().map(|h| h.used_s).sum::<f64>() / 60.0;
        assert!(used < 1.5 * quiet.used_s, "{used} s against {} s at {noise} Nm", quiet.used_s);
    }
}

/// What still drifts at the end of the time has not settled.
#[test]
fn a_slow_drift_is_no_rest() {
    for seed in 0..5 {
        assert!(!held(30.0, 0.0, 0.0, seed).settled);
    }
}

/// Scatter of a burn comes behind the lag of a torque sensor: neighbouring samples are alike, and a window's mean tells less than that
/// of as many independent ones. Points settle all the same, and what still drifts under such scatter has not settled.
#[test]
fn scatter_behind_a_lag_settles_and_a_drift_under_it_does_not() {
    let all: Vec<_> = (0..60).map(|seed| held(0.3, 0.3, 0.15, seed)).collect();
    let settled = all.iter().filter(|h| h.settled).count();
    assert!(settled >= 50, "{settled} of 60");
    // A mean of a second of such scatter: 2 memory / 1 s of its variance, five standard errors.
    let bound = 5.0 * 0.3 * (2.0f64 * 0.15).sqrt() + 0.05;
    assert!(all.iter().filter(|h| h.settled).all(|h| h.errors[0].abs() < bound));
    for seed in 0..20 {
        let slow = held(5.0, 0.3, 0.15, seed);
        assert!(!slow.settled, "{slow:?}");
    }
}
