//! A plant whose fuel is given by measured states: whoever drives it moves everything else.

use dynocal_calib::fuelling::{FuelPolicy, Sensed, SpeedDensityState};
use dynocal_ident::plant::{Causality, LimitEvent, Plant, PlantError, PlantState, Variable};

use crate::fuelling::places::{Places, variables};

/// What gives the fuel.
#[derive(Clone, Debug)]
pub(super) enum Fuel {
    /// The identified air and film model.
    Policy(Box<FuelPolicy>),
    /// A speed-density ECU.
    Ecu(Box<SpeedDensityState>),
}

impl Fuel {
    fn step(&mut self, y: &Sensed, lambda: f64) -> f64 {
        match self {
            Self::Policy(p) => p.step(y, lambda),
            Self::Ecu(e) => e.step(y, lambda),
        }
    }
}

/// How fuel is given.
#[derive(Clone, Debug)]
pub(super) struct FuelSetting {
    pub(super) fuel: Fuel,
    /// Interval in which it is given, in s; a step of the plant is a multiple of it.
    pub(super) interval_s: f64,
    /// Demanded lambda by step; that of the first before them, that of the last behind.
    pub(super) lambda: Vec<f64>,
    /// Steps before the first.
    pub(super) lead: usize,
    /// Range of the injection in its unit.
    pub(super) range: (f64, f64),
}

/// A plant behind a controller of its fuel. Its variables are those of the plant; what is asked of the injection is not used.
pub(super) struct FuelDriven {
    plant: Box<dyn Plant>,
    places: Places,
    start: FuelSetting,
    now: FuelSetting,
    inputs: Vec<f64>,
    shown: Vec<f64>,
    /// Mean injection of each step since the reset.
    given: Vec<f64>,
}

impl FuelDriven {
    pub(super) fn new(plant: Box<dyn Plant>, places: Places, setting: FuelSetting) -> Self {
        let (inputs, outputs) = (
            variables(plant.as_ref(), Causality::Input).len(),
            variables(plant.as_ref(), Causality::Output).len(),
        );
        Self {
            plant,
            places,
            start: setting.clone(),
            now: setting,
            inputs: vec![0.0; inputs],
            shown: vec![0.0; outputs],
            given: Vec::new(),
        }
    }

    /// From the next step on lambda is demanded to be this.
    pub(super) fn demand(&mut self, lambda: f64) {
        self.now.lambda.clear();
        self.now.lambda.push(lambda);
    }

    /// Mean injection of each of the last `samples` steps.
    pub(super) fn given(&self, samples: usize) -> &[f64] {
        &self.given[self.given.len().saturating_sub(samples)..]
    }
}

impl Plant for FuelDriven {
    fn variables(&self) -> &[Variable] {
        self.plant.variables()
    }

    fn reset(&mut self, seed: u64) {
        self.plant.reset(seed);
        self.now = self.start.clone();
        self.given.clear();
        // A plant that does not tell is one that a record cannot begin on: playing says so.
        let _ = self.plant.outputs(&mut self.shown);
        let inputs = variables(self.plant.as_ref(), Causality::Input);
        self.inputs.iter_mut().zip(inputs).for_each(|(u, v)| *u = v.start);
    }

    /// Lambda is the mean over the step, everything else what the last interval gave.
    fn step(&mut self, inputs: &[f64], dt_s: f64, outputs: &mut [f64]) -> Result<(), PlantError> {
        let interval_s = self.now.interval_s;
        let count = (dt_s / interval_s).round();
        if inputs.len() != self.inputs.len() || count < 1.0 || (count * interval_s - dt_s).abs() > 1e-9 {
            return Err(PlantError::Call(format!(
                "{} inputs for {dt_s} s: expected {} and a multiple of {interval_s} s",
                inputs.len(),
                self.inputs.len()
            )));
        }
        let p = &self.places;
        let driven = (p.speed.get(inputs), p.throttle.get(inputs));
        let step =
            self.given.len().saturating_sub(self.now.lead).min(self.now.lambda.len().saturating_sub(1));
        let demanded = self.now.lambda.get(step).copied().unwrap_or(1.0);
        let (mut lambda, mut injection) = (0.0, 0.0);
        for _ in 0..count as usize {
            // What was commanded in the interval before, as in the records that identified.
            let sensed = p.sensed(driven, &self.inputs, &self.shown);
            let (low, high) = self.now.range;
            let fuel = self.now.fuel.step(&sensed, demanded).clamp(low, high);
            self.inputs.copy_from_slice(inputs);
            p.injection.set(&mut self.inputs, fuel);
            self.plant.step(&self.inputs, interval_s, &mut self.shown)?;
            injection += fuel / count;
            lambda += self.shown[p.lambda.at] / count;
        }
        outputs.copy_from_slice(&self.shown);
        outputs[p.lambda.at] = lambda;
        self.given.push(injection);
        Ok(())
    }

    fn outputs(&self, outputs: &mut [f64]) -> Result<(), PlantError> {
        self.plant.outputs(outputs)
    }

    fn time_s(&self) -> f64 {
        self.plant.time_s()
    }

    fn take_events(&mut self) -> Vec<LimitEvent> {
        self.plant.take_events()
    }

    /// The state of the plant alone: records are played from a reset.
    fn save(&self) -> PlantState {
        self.plant.save()
    }

    fn restore(&mut self, _: &PlantState) -> Result<(), PlantError> {
        Err(PlantError::Call("what gives the fuel does not go back to an earlier state".into()))
    }

    fn describe(&self) -> String {
        format!("{}, fuel by measured states", self.plant.describe())
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::fuelling::spec::Channels;
    use dynocal_calib::fuelling::{Charge, SpeedDensity};

    /// Manifold pressure that follows the throttle, one kPa for a degree; lambda is 20 mg over the injection, plus the time in s.
    struct Toy {
        variables: Vec<Variable>,
        time_s: f64,
    }

    impl Toy {
        fn new() -> Self {
            let variable = |name: &str, unit: &str, causality, start| Variable {
                name: name.into(),
                unit: unit.into(),
                causality,
                min: 0.0,
                max: 1e4,
                start,
            };
            let variables = vec![
                variable("inj", "mg", Causality::Input, 10.0),
                variable("throttle", "deg", Causality::Input, 40.0),
                variable("speed", "rpm", Causality::Input, 2000.0),
                variable("lambda", "-", Causality::Output, 1.0),
                variable("map", "kPa", Causality::Output, 40.0),
            ];
            Self { variables, time_s: 0.0 }
        }
    }

    impl Plant for Toy {
        fn variables(&self) -> &[Variable] {
            &self.variables
        }
        fn reset(&mut self, _: u64) {
            self.time_s = 0.0;
        }
        fn step(&mut self, inputs: &[f64], dt_s: f64, outputs: &mut [f64]) -> Result<(), PlantError> {
            self.time_s += dt_s;
            outputs.copy_from_slice(&[20.0 / inputs[0] + self.time_s, inputs[1]]);
            Ok(())
        }
        fn outputs(&self, outputs: &mut [f64]) -> Result<(), PlantError> {
            outputs.copy_from_slice(&[1.0, 40.0]);
            Ok(())
        }
        fn time_s(&self) -> f64 {
            self.time_s
        }
        fn take_events(&mut self) -> Vec<LimitEvent> {
            Vec::new()
        }
        fn save(&self) -> PlantState {
            PlantState(vec![self.time_s])
        }
        fn restore(&mut self, _: &PlantState) -> Result<(), PlantError> {
            Ok(())
        }
        fn describe(&self) -> String {
            "toy".into()
        }
    }

    /// A charge of a quarter of a mg for a kPa.
    pub(in super::super) fn driven(range: (f64, f64)) -> FuelDriven {
        let points: Vec<[f64; 3]> = (0..60)
            .map(|k| {
                let p = 30.0 + 6.0 * f64::from(k / 6);
                [1000.0 + 400.0 * f64::from(k % 6), p, 0.25 * p]
            })
            .collect();
        let ecu = SpeedDensity {
            sample_time_s: 0.01,
            charge: Charge::fit(&points).unwrap(),
            law: None,
            most_kpa: 100.0,
            ahead_s: 0.0,
            film: None,
            feedback: None,
        };
        let places = Places::of(&Toy::new(), &Channels::default()).unwrap();
        let fuel = Fuel::Ecu(Box::new(SpeedDensityState::new(ecu, 60.0)));
        let setting = FuelSetting { fuel, interval_s: 0.01, lambda: vec![0.8, 1.0], lead: 1, range };
        FuelDriven::new(Box::new(Toy::new()), places, setting)
    }

    #[test]
    fn fuel_is_that_of_the_controller_and_lambda_a_mean() {
        let mut plant = driven((0.0, 60.0));
        let mut y = [0.0; 2];
        plant.reset(1);
        // 40 kPa: 10 mg over 0.8, for one interval; then the 60 kPa that the throttle made: 15 mg over 0.8.
        plant.step(&[3.0, 60.0, 2000.0], 0.03, &mut y).unwrap();
        let (first, then) = (10.0 / 0.8, 15.0 / 0.8);
        assert!((plant.given(1)[0] - (first + 2.0 * then) / 3.0).abs() < 1e-3, "{:?}", plant.given(1));
        let lambda = (20.0 / first + 2.0 * 20.0 / then) / 3.0 + 0.02;
        assert!((y[0] - lambda).abs() < 1e-4, "{y:?} {lambda}");
        assert_eq!(y[1], 60.0);
        // The first demand of lambda lasts until the lead is over, and goes on with the second.
        plant.step(&[3.0, 60.0, 2000.0], 0.01, &mut y).unwrap();
        assert!((plant.given(1)[0] - 15.0 / 0.8).abs() < 1e-3);
        plant.step(&[3.0, 60.0, 2000.0], 0.01, &mut y).unwrap();
        assert!((plant.given(1)[0] - 15.0).abs() < 1e-3);
        plant.step(&[3.0, 60.0, 2000.0], 0.01, &mut y).unwrap();
        assert!((plant.given(1)[0] - 15.0).abs() < 1e-3);
        plant.reset(1);
        plant.step(&[3.0, 60.0, 2000.0], 0.03, &mut y).unwrap();
        // The same again after a reset, whatever is asked of the injection.
        let before = (plant.given(1)[0], y);
        plant.reset(1);
        plant.step(&[30.0, 60.0, 2000.0], 0.03, &mut y).unwrap();
        assert_eq!((plant.given(5)[0], y), before);
        assert_eq!(plant.given(5).len(), 1);
    }

    #[test]
    fn the_range_holds_and_other_intervals_are_refused() {
        let mut plant = driven((0.0, 14.0));
        let mut y = [0.0; 2];
        plant.reset(1);
        plant.step(&[3.0, 80.0, 2000.0], 0.02, &mut y).unwrap();
        assert!((plant.given(1)[0] - (12.5 + 14.0) / 2.0).abs() < 1e-3);
        let text = plant.step(&[3.0, 80.0, 2000.0], 0.025, &mut y).unwrap_err().to_string();
        assert!(text.contains("multiple of 0.01 s"), "{text}");
        assert!(plant.restore(&plant.save()).is_err());
    }

    /// Cams are read where their channels lie, in degrees, and what cannot be one is named.
    #[test]
    fn cams_are_read_where_they_lie() {
        let channels = Channels {
            intake_cam: Some("throttle".into()),
            exhaust_cam: Some("throttle".into()),
            ..Channels::default()
        };
        let places = Places::of(&Toy::new(), &channels).unwrap();
        let sensed = places.sensed((2000.0, 10.0), &[3.0, 55.0, 2000.0], &[1.0, 44.0]);
        assert_eq!((sensed.throttle_deg, sensed.cams_deg), (10.0, Some([55.0, 55.0])));
        let pressure = Channels { exhaust_cam: Some("map".into()), ..channels.clone() };
        let text = Places::of(&Toy::new(), &pressure).unwrap_err();
        assert!(text.contains("`map` of the plant is in kPa"), "{text}");
        let missing = Channels { exhaust_cam: Some("nothing".into()), ..channels };
        let text = Places::of(&Toy::new(), &missing).unwrap_err();
        assert!(text.contains("no output or input `nothing`"), "{text}");
    }
}
