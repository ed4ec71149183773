//! A plant that answers, driven over throttle and speed by whatever gives its fuel.

use dynocal_calib::fuelling::{FuelPolicy, STILL_S, Sensed, SpeedDensityState};
use dynocal_ident::plant::{Causality, Plant};
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::watch::Watch;
use dynocal_plant::plants::{self, PlantSpec};

use super::places::{Place, Places, variables};
use super::records::Record;
use super::result::FuellingJobError;
use super::spec::{Channels, Test};

/// Most change of the speed in rpm/s.
const SPEED_RATE: f64 = 1000.0;
/// Time of a hold after its ramp of the speed, in s: with it a hold ends at rest, and rests are what charge and throttle are begun from.
const REST_S: f64 = STILL_S + 0.1;
/// Steps of the fuel in the middle of a hold, as shares: they tell the film where the air stands still.
const STEP: f64 = 0.08;
/// Time constant of the loop of a first record in s: slower than any transport.
const LOOP_S: f64 = 1.5;
/// Time in s in which an input that is varied goes through its range: cams are not elsewhere at once.
const MOVED_S: f64 = 0.5;
/// Most of the logarithm of what that loop corrects.
const MOST_LOOP: f64 = 1.5;

/// Throttle and speed over time.
pub(super) struct Course {
    pub(super) throttle_deg: Vec<f64>,
    pub(super) speed_rpm: Vec<f64>,
    /// Share by which a driver that is to excite changes its fuel.
    share: Vec<f64>,
    /// Inputs that are varied, in their order, each over time.
    varied: Vec<Vec<f64>>,
}

impl Course {
    /// Points drawn and held, each until it rests.
    pub(super) fn drawn(test: &Test, length_s: f64, rng: &mut Rng64) -> Self {
        let dt_s = test.sample_time_s;
        let samples = (length_s / dt_s).round() as usize;
        let varied = vec![Vec::new(); test.varied.len()];
        let mut out = Self { throttle_deg: Vec::new(), speed_rpm: Vec::new(), share: Vec::new(), varied };
        let (low, high) = (test.throttle_deg.lower.ln(), test.throttle_deg.upper.ln());
        let mut at_rpm = None;
        while out.throttle_deg.len() < samples {
            let throttle = rng.uniform_in(low, high).exp();
            let speed = rng.uniform_in(test.speed_rpm.lower, test.speed_rpm.upper);
            let ramp_s = at_rpm.map_or(0.0, |at: f64| (speed - at).abs() / SPEED_RATE);
            let hold_s = rng.uniform_in(test.hold_s.lower, test.hold_s.upper).max(ramp_s + REST_S);
            let hold = (hold_s / dt_s) as usize;
            let step = if rng.uniform_in(0.0, 1.0) < 0.5 { STEP } else { -STEP };
            let mut now = at_rpm.unwrap_or(speed);
            for t in 0..hold {
                now += (speed - now).clamp(-SPEED_RATE * dt_s, SPEED_RATE * dt_s);
                out.throttle_deg.push(throttle);
                out.speed_rpm.push(now);
                // Back to the middle for the last third: what rests at the end of a hold is charge.
                out.share.push(if (hold / 3..2 * hold / 3).contains(&t) { step } else { 0.0 });
            }
            at_rpm = Some(now);
            for (range, values) in test.varied.values().zip(&mut out.varied) {
                let goal = rng.uniform_in(range.lower, range.upper);
                let most = (range.upper - range.lower) * dt_s / MOVED_S;
                let mut at = values.last().copied().unwrap_or(goal);
                for _ in 0..hold {
                    at += (goal - at).clamp(-most, most);
                    values.push(at);
                }
            }
        }
        out.throttle_deg.truncate(samples);
        out.speed_rpm.truncate(samples);
        out
    }
}

/// What gives the fuel.
pub(super) enum Driver {
    /// Fuel that goes with the pressure, corrected slowly by lambda: what can be driven before anything is known.
    First {
        /// Injection per kPa.
        per_kpa: f64,
        /// Logarithm of the correction.
        k: f64,
    },
    /// The identified policy; with what the sensor shows, or without it.
    Policy { policy: Box<FuelPolicy>, trimmed: bool },
    /// A speed-density ECU.
    Ecu(Box<SpeedDensityState>),
}

impl Driver {
    fn step(&mut self, y: &Sensed, dt_s: f64, share: f64, most: f64) -> f64 {
        match self {
            Self::First { per_kpa, k } => {
                let error = y.lambda.map_or(0.0, f64::ln);
                *k = (*k + dt_s / LOOP_S * error.clamp(-0.3, 0.3)).clamp(-MOST_LOOP, MOST_LOOP);
                (*per_kpa * y.map_kpa * k.exp() * (1.0 + share)).clamp(0.0, most)
            }
            Self::Policy { policy, trimmed } => {
                let shown = Sensed { lambda: y.lambda.filter(|_| *trimmed), ..*y };
                // A demand that moves the fuel as the first driver moves it.
                policy.step(&shown, 1.0 / (1.0 + share))
            }
            Self::Ecu(ecu) => ecu.step(y, 1.0 / (1.0 + share)),
        }
    }
}

/// A plant with the places of the channels.
pub(super) struct Rig {
    plant: Box<dyn Plant>,
    start: Vec<f64>,
    places: Places,
    /// Inputs that are varied.
    varied: Vec<Place>,
    outputs: usize,
}

fn refused(text: impl Into<String>) -> FuellingJobError {
    FuellingJobError::Plant(text.into())
}

impl Rig {
    /// Makes the plant and finds its channels.
    pub(super) fn new(spec: &PlantSpec, names: &Channels, test: &Test) -> Result<Self, FuellingJobError> {
        let make = plants::find(&spec.name).and_then(|p| p.make);
        let make = make.ok_or_else(|| refused(format!("the plant `{}` does not answer", spec.name)))?;
        let plant = make(spec, true).map_err(|e| refused(e.to_string()))?;
        let places = Places::of(plant.as_ref(), names).map_err(refused)?;
        let inputs = variables(plant.as_ref(), Causality::Input);
        let mut start: Vec<f64> = inputs.iter().map(|v| v.start).collect();
        for (name, value) in &test.held {
            start[Place::of(&inputs, name, None, "input").map_err(refused)?.at] = *value;
        }
        let varied = test.varied.keys().map(|name| Place::of(&inputs, name, None, "input"));
        let varied = varied.collect::<Result<_, _>>().map_err(refused)?;
        let outputs = variables(plant.as_ref(), Causality::Output).len();
        Ok(Self { plant, start, places, varied, outputs })
    }

    /// A first driver that begins with the fuel of the plant's start.
    pub(super) fn first(&mut self) -> Result<Driver, FuellingJobError> {
        self.plant.reset(0);
        let mut y = vec![0.0; self.outputs];
        self.plant.outputs(&mut y).map_err(|e| refused(e.to_string()))?;
        let map_kpa = self.places.map.get(&y);
        let per_kpa = self.places.injection.get(&self.start) / map_kpa;
        if !(per_kpa.is_finite() && per_kpa > 0.0) {
            let text = format!(
                "starts with an injection of {} at {map_kpa} kPa",
                self.places.injection.get(&self.start)
            );
            return Err(refused(format!("the plant {text}: expected fuel and a pressure to begin with")));
        }
        Ok(Driver::First { per_kpa, k: 0.0 })
    }

    /// Drives a course; the throttle of the first sample has been held for a while.
    pub(super) fn drive(
        &mut self,
        name: &str,
        (course, test, excite): (&Course, &Test, bool),
        driver: &mut Driver,
        (seed, most): (u64, f64),
        watch: &Watch,
    ) -> Result<Record, FuellingJobError> {
        self.plant.reset(seed);
        let (mut u, mut y) = (self.start.clone(), vec![0.0; self.outputs]);
        self.plant.outputs(&mut y).map_err(|e| refused(e.to_string()))?;
        let (dt_s, p) = (test.sample_time_s, &self.places);
        let mut out = Record {
            name: name.into(),
            sample_time_s: dt_s,
            injection_unit: p.injection_unit.clone(),
            boost_kpa: p.boost.map(|_| Vec::new()),
            coolant_c: p.coolant.map(|_| Vec::new()),
            cams_deg: p.cams.map(|_| Default::default()),
            ..Record::default()
        };
        for (t, (throttle, speed)) in course.throttle_deg.iter().zip(&course.speed_rpm).enumerate() {
            if t % 100 == 0 && watch.interrupted() {
                return Err(FuellingJobError::Interrupted);
            }
            let sensed = p.sensed((*speed, *throttle), &u, &y);
            let share = if excite { course.share[t] } else { 0.0 };
            let injection = driver.step(&sensed, dt_s, share, most);
            p.throttle.set(&mut u, *throttle);
            p.speed.set(&mut u, *speed);
            p.injection.set(&mut u, injection);
            for (place, values) in self.varied.iter().zip(&course.varied) {
                place.set(&mut u, values[t]);
            }
            self.plant.step(&u, dt_s, &mut y).map_err(|e| refused(e.to_string()))?;
            out.speed_rpm.push(*speed);
            out.throttle_deg.push(*throttle);
            out.injection.push(injection);
            out.map_kpa.push(p.map.get(&y));
            out.lambda.push(p.lambda.get(&y));
            for (place, values) in [(p.boost, &mut out.boost_kpa), (p.coolant, &mut out.coolant_c)] {
                if let (Some(place), Some(values)) = (place, values) {
                    values.push(place.get(&y));
                }
            }
            for (cams, values) in p.cams.iter().zip(&mut out.cams_deg) {
                cams.iter().zip(values).for_each(|(c, v)| v.push(c.get(&u, &y)));
            }
        }
        Ok(out)
    }
}
