//! A bed, controllers on it, and what the engine really did.

use dynocal_calib::fuelling::{Coat, CoolantLaw, Film};
use dynocal_ident::plant::{Causality, Plant, PlantError};
use dynocal_numerics::rng::Rng64;
use dynocal_plant::bed::{BedSettings, EngineBed};
use dynocal_plant::error::PlantError as EngineError;
use dynocal_plant::film::FilmModel;
use dynocal_plant::params::EngineParams;
use dynocal_plant::testbed::settings::BedOptions;

/// Interval of control in s.
pub(super) const SAMPLE_S: f64 = 0.01;
/// Place of the coolant behind the five outputs of every bed.
const COOLANT: usize = 5;
/// Share by which fuel is moved in the records that ours drives, that of the job `fuelling`.
pub(super) const MOVED: f64 = 0.08;
/// Most fuel of an injection in mg.
pub(super) const MOST_MG: f64 = 60.0;

/// What the bed's channels show at the beginning of a sample.
#[derive(Clone, Copy, Debug)]
pub(super) struct Measured {
    pub(super) map_kpa: f64,
    pub(super) speed_rpm: f64,
    /// As the sensor shows it.
    pub(super) lambda: f64,
    pub(super) coolant_c: f64,
}

/// What a controller gives.
#[derive(Clone, Copy, Debug)]
pub(super) struct Command {
    pub(super) injection_mg: f64,
    pub(super) spark_deg: f64,
    pub(super) throttle_deg: f64,
}

/// A controller: it knows the demand and what the sensors show.
pub(super) trait Controller {
    fn step(&mut self, torque_nm: f64, y: &Measured) -> Command;
}

/// Least and most.
#[derive(Clone, Copy, Debug)]
pub(super) struct Between(pub(super) f64, pub(super) f64);

impl Between {
    fn drawn(self, rng: &mut Rng64) -> f64 {
        rng.uniform_in(self.0, self.1)
    }
}

/// What random points are drawn from.
#[derive(Clone, Copy, Debug)]
pub(super) struct Range {
    pub(super) torque_nm: Between,
    pub(super) speed_rpm: Between,
}

/// Demands over time, and the samples at which they change (one past the last is the end).
#[derive(Clone, Debug)]
pub(super) struct Course {
    pub(super) torque_nm: Vec<f64>,
    pub(super) speed_rpm: Vec<f64>,
    pub(super) switches: Vec<usize>,
}

impl Course {
    /// Low, high, low, .. torque at a speed, 10 s and then 6 s each: the steps of the table of rivals.
    pub(super) fn steps(count: usize, [low_nm, high_nm]: [f64; 2], speed_rpm: f64) -> Self {
        let (first, hold) = (samples(10.0), samples(6.0));
        let mut torque_nm = vec![low_nm; first];
        let mut switches = Vec::new();
        for k in 0..count {
            switches.push(torque_nm.len());
            torque_nm.extend(vec![if k % 2 == 0 { high_nm } else { low_nm }; hold]);
        }
        switches.push(torque_nm.len());
        Self { speed_rpm: vec![speed_rpm; torque_nm.len()], torque_nm, switches }
    }

    /// Points drawn from ranges and held; the speed goes to the next one at 1000 rpm/s. The first one is no step.
    pub(super) fn random(count: usize, hold_s: f64, range: &Range, rng: &mut Rng64) -> Self {
        let mut out = Self { torque_nm: Vec::new(), speed_rpm: Vec::new(), switches: Vec::new() };
        for k in 0..=count {
            let (torque, speed) = (range.torque_nm.drawn(rng), range.speed_rpm.drawn(rng));
            if k > 0 {
                out.switches.push(out.torque_nm.len());
            }
            let mut at = out.speed_rpm.last().copied().unwrap_or(speed);
            for _ in 0..samples(hold_s) {
                at += (speed - at).clamp(-1000.0 * SAMPLE_S, 1000.0 * SAMPLE_S);
                out.torque_nm.push(torque);
                out.speed_rpm.push(at);
            }
        }
        out.switches.push(out.torque_nm.len());
        out
    }

    /// Shares by which fuel is moved in the middle third of each hold, up or down as drawn: where the air stands still they tell the film,
    /// which goes with the air elsewhere.
    pub(super) fn moved_fuel(&self, rng: &mut Rng64) -> Vec<f64> {
        let mut out = vec![0.0; self.torque_nm.len()];
        for w in self.switches.windows(2) {
            let third = (w[1] - w[0]) / 3;
            let share = if rng.uniform_in(0.0, 1.0) < 0.5 { MOVED } else { -MOVED };
            out[w[0] + third..w[0] + 2 * third].fill(share);
        }
        out
    }

    pub(super) fn length_s(&self) -> f64 {
        self.torque_nm.len() as f64 * SAMPLE_S
    }
}

fn samples(time_s: f64) -> usize {
    (time_s / SAMPLE_S).round() as usize
}

/// What was commanded, what the sensors showed, what was true.
#[derive(Clone, Debug, Default)]
pub(super) struct Trace {
    pub(super) injection_mg: Vec<f64>,
    pub(super) throttle_deg: Vec<f64>,
    pub(super) map_kpa: Vec<f64>,
    pub(super) coolant_c: Vec<f64>,
    /// As the sensor shows it.
    pub(super) lambda: Vec<f64>,
    /// Of the gas in the exhaust manifold, present value.
    pub(super) true_lambda: Vec<f64>,
    /// Of the last 720 deg, without the sensor's lag.
    pub(super) true_torque_nm: Vec<f64>,
}

/// Degrees Celsius of a temperature in K.
const ZERO_C: f64 = 273.15;

/// The bed of a parameter set as it comes, with the coolant as one more output; walls, coolant and oil at `start_c` at the start,
/// if that is given; with `real` a real one whatever the set has by itself.
pub(super) fn bed(parameters: &str, start_c: Option<f64>, real: bool) -> Result<EngineBed, EngineError> {
    let params = EngineParams::named(parameters)?;
    let mut settings = BedSettings::of_set(parameters, &params)?;
    if real {
        settings.options = BedOptions::real_of_set(parameters);
    }
    settings.options.outputs.push("coolant".into());
    if let (Some(start_c), Some(thermal)) = (start_c, &mut settings.options.engine.warm_up) {
        thermal.start_k = start_c + ZERO_C;
    }
    EngineBed::new(&params, settings)
}

/// Film of the engine itself and what the coolant does to it; none where it has none.
pub(super) fn exact_film(parameters: &str) -> Result<Option<Coat>, EngineError> {
    let params = EngineParams::named(parameters)?;
    let settings = BedSettings::of_set(parameters, &params)?;
    let thermal = settings.options.engine.warm_up.unwrap_or_default();
    let factor = |coolant_c: f64| thermal.film_factor(coolant_c + ZERO_C);
    let law = CoolantLaw {
        at_c: 90.0,
        range_c: [20.0, 90.0],
        share_per_k: 0.0,
        tau_per_k: (factor(90.0) / factor(20.0)).ln() / 70.0,
        charge_per_k: 0.0,
        charge_ends_per_k: [0.0; 2],
    };
    let film = |f: FilmModel| Film { share: f.share, tau_s: f.tau_s * factor(90.0) };
    Ok(params.port.map(|f| Coat { film: film(f), law: Some(law), ends: None }))
}

/// Plays a course.
pub(super) fn play(
    bed: &EngineBed,
    seed: u64,
    course: &Course,
    controller: &mut dyn Controller,
) -> Result<Trace, PlantError> {
    let mut bed = bed.clone();
    bed.reset(seed);
    let inputs = bed.variables().iter().take_while(|v| v.causality == Causality::Input).count();
    // In the order of the bed: injection, spark, throttle, speed, others as they start.
    let mut u: Vec<f64> = bed.variables()[..inputs].iter().map(|v| v.start).collect();
    let mut y = vec![0.0; bed.variables().len() - inputs];
    bed.outputs(&mut y)?;
    let mut out = Trace::default();
    // The bed is at the speed of the course from its first sample on.
    let mut speed_rpm = course.speed_rpm.first().copied().unwrap_or(u[3]);
    for (torque, speed) in course.torque_nm.iter().zip(&course.speed_rpm) {
        let shown = Measured { map_kpa: y[2], speed_rpm, lambda: y[1], coolant_c: y[COOLANT] - ZERO_C };
        let c = controller.step(*torque, &shown);
        u[0] = c.injection_mg.clamp(0.0, MOST_MG);
        u[1] = c.spark_deg;
        u[2] = c.throttle_deg;
        u[3] = *speed;
        bed.step(&u, SAMPLE_S, &mut y)?;
        speed_rpm = *speed;
        let truth = bed.engine().outputs();
        out.injection_mg.push(u[0]);
        out.throttle_deg.push(u[2]);
        out.map_kpa.push(y[2]);
        out.coolant_c.push(shown.coolant_c);
        out.lambda.push(y[1]);
        out.true_lambda.push(truth.lambda_interval);
        out.true_torque_nm.push(truth.torque_cycle_nm);
    }
    Ok(out)
}
