//! The bed of the boosted engine: seven inputs, what its sensors show, what the engine really did.

use dynocal_ident::plant::{Causality, Plant};
use dynocal_plant::bed::{BedSettings, EngineBed};
use dynocal_plant::params::EngineParams;

use super::super::bed::SAMPLE_S;
use super::super::rivals::SpeedNow;

/// Most fuel of an injection in mg.
pub(super) const MOST_MG: f64 = 80.0;
/// Time constant of a cam phaser in s: that of the bed where it follows its own schedule.
const PHASER_S: f64 = 0.3;
/// Places of the outputs: five standard ones, then those that are asked for.
const TORQUE: usize = 0;
const LAMBDA: usize = 1;
const MAP: usize = 2;
const COOLANT: usize = 5;
const BOOST: usize = 6;
const KNOCK: usize = 7;
const ASKED: [&str; 3] = ["coolant", "boost", "knock"];
const INPUTS: [&str; 3] = ["wastegate", "intake_cam", "exhaust_cam"];
const ZERO_C: f64 = 273.15;
/// Molar masses in g/mol: exhaust, CO, HC as CH1.9, NO.
const EXHAUST_G: f64 = 28.8;
const MOLAR_G: [f64; 3] = [28.0, 13.9, 30.0];

/// What the channels show at the begin of a sample.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shown {
    pub(super) torque_nm: f64,
    pub(super) lambda: f64,
    pub(super) map_kpa: f64,
    pub(super) boost_kpa: f64,
    pub(super) coolant_c: f64,
    /// Places of the cams in deg.
    pub(super) cams_deg: [f64; 2],
    /// Of the sample that begins, as the last one goes on.
    pub(super) speed_rpm: f64,
}

/// What a controller gives.
#[derive(Clone, Copy, Debug)]
pub(super) struct Command {
    pub(super) injection_mg: f64,
    pub(super) spark_deg: f64,
    pub(super) throttle_deg: f64,
    pub(super) wastegate_mm: f64,
    /// Openings of intake and exhaust that the phasers go to, in deg.
    pub(super) cams_deg: [f64; 2],
}

/// A controller: it knows the demand and what the sensors show.
pub(super) trait Controller {
    fn step(&mut self, torque_nm: f64, y: &Shown) -> Command;
}

/// Demands over time, and the samples at which they change (one past the last is the end).
#[derive(Clone, Debug, Default)]
pub(super) struct Course {
    pub(super) torque_nm: Vec<f64>,
    pub(super) speed_rpm: Vec<f64>,
    /// Where the phasers are sent in place of where a controller sends them, in deg; nothing where it is empty.
    pub(super) cams_deg: Vec<[f64; 2]>,
    pub(super) switches: Vec<usize>,
}

impl Course {
    pub(super) fn hold(&mut self, torque_nm: f64, speed_rpm: f64, time_s: f64) {
        if !self.torque_nm.is_empty() {
            self.switches.push(self.torque_nm.len());
        }
        let n = (time_s / SAMPLE_S).round() as usize;
        self.torque_nm.extend(std::iter::repeat_n(torque_nm, n));
        let mut at = self.speed_rpm.last().copied().unwrap_or(speed_rpm);
        for _ in 0..n {
            at += (speed_rpm - at).clamp(-1000.0 * SAMPLE_S, 1000.0 * SAMPLE_S);
            self.speed_rpm.push(at);
        }
    }

    pub(super) fn end(mut self) -> Self {
        self.switches.push(self.torque_nm.len());
        self
    }

    pub(super) fn length_s(&self) -> f64 {
        self.torque_nm.len() as f64 * SAMPLE_S
    }
}

/// What was commanded, what the sensors showed, what was true.
#[derive(Clone, Debug, Default)]
pub(super) struct Trace {
    pub(super) injection_mg: Vec<f64>,
    pub(super) throttle_deg: Vec<f64>,
    pub(super) map_kpa: Vec<f64>,
    pub(super) boost_kpa: Vec<f64>,
    pub(super) coolant_c: Vec<f64>,
    pub(super) cams_deg: [Vec<f64>; 2],
    pub(super) lambda: Vec<f64>,
    /// Knock index as the channel shows it.
    pub(super) knock: Vec<f64>,
    /// Torque as its sensor shows it.
    pub(super) torque_nm: Vec<f64>,
    pub(super) true_lambda: Vec<f64>,
    pub(super) true_torque_nm: Vec<f64>,
    pub(super) true_knock: Vec<f64>,
    /// Fuel in g/s.
    pub(super) fuel_g_s: Vec<f64>,
    /// Carbon monoxide, unburned fuel, nitric oxide before the catalyst in g/s.
    pub(super) emitted_g_s: Vec<[f64; 3]>,
}

/// The bed of a parameter set as it comes, with wastegate and cams as inputs.
pub(super) fn bed(parameters: &str) -> Result<EngineBed, String> {
    let params = EngineParams::named(parameters).map_err(|e| e.to_string())?;
    let mut settings = BedSettings::of_set(parameters, &params).map_err(|e| e.to_string())?;
    settings.options.outputs = ASKED.map(String::from).to_vec();
    settings.options.inputs = INPUTS.map(String::from).to_vec();
    settings.options.saturate = true;
    EngineBed::new(&params, settings).map_err(|e| e.to_string())
}

/// Plays a course.
pub(super) fn play(
    bed: &EngineBed,
    seed: u64,
    course: &Course,
    controller: &mut dyn Controller,
) -> Result<Trace, String> {
    let mut bed = bed.clone();
    bed.reset(seed);
    let inputs = bed.variables().iter().take_while(|v| v.causality == Causality::Input).count();
    let mut u: Vec<f64> = bed.variables()[..inputs].iter().map(|v| v.start).collect();
    let mut y = vec![0.0; bed.variables().len() - inputs];
    bed.outputs(&mut y).map_err(|e| e.to_string())?;
    let mut out = Trace::default();
    let follow = -(-SAMPLE_S / PHASER_S).exp_m1();
    // The bed is at the speed of the course from its first sample on.
    let (mut speed_rpm, mut speed_now) =
        (course.speed_rpm.first().copied().unwrap_or(u[3]), SpeedNow::default());
    for (t, (torque, speed)) in course.torque_nm.iter().zip(&course.speed_rpm).enumerate() {
        let shown = Shown {
            torque_nm: y[TORQUE],
            lambda: y[LAMBDA],
            map_kpa: y[MAP],
            boost_kpa: y[BOOST],
            coolant_c: y[COOLANT] - ZERO_C,
            cams_deg: [u[5], u[6]],
            speed_rpm: speed_now.step(speed_rpm),
        };
        let c = controller.step(*torque, &shown);
        let sent_deg = course.cams_deg.get(t).copied().unwrap_or(c.cams_deg);
        let cams = [0, 1].map(|k| u[5 + k] + follow * (sent_deg[k] - u[5 + k]));
        let injection = c.injection_mg.clamp(0.0, MOST_MG);
        u.copy_from_slice(&[
            injection,
            c.spark_deg,
            c.throttle_deg,
            *speed,
            c.wastegate_mm,
            cams[0],
            cams[1],
        ]);
        bed.step(&u, SAMPLE_S, &mut y).map_err(|e| e.to_string())?;
        speed_rpm = *speed;
        out.keep(&u, &y, &bed, shown.coolant_c);
    }
    Ok(out)
}

impl Trace {
    fn keep(&mut self, u: &[f64], y: &[f64], bed: &EngineBed, coolant_c: f64) {
        self.injection_mg.push(u[0]);
        self.throttle_deg.push(u[2]);
        self.map_kpa.push(y[MAP]);
        self.boost_kpa.push(y[BOOST]);
        self.coolant_c.push(coolant_c);
        self.cams_deg.iter_mut().zip(&u[5..]).for_each(|(kept, at)| kept.push(*at));
        self.lambda.push(y[LAMBDA]);
        self.knock.push(y[KNOCK]);
        self.torque_nm.push(y[TORQUE]);
        let truth = bed.engine().outputs();
        self.true_lambda.push(truth.lambda_interval);
        self.true_torque_nm.push(truth.torque_cycle_nm);
        self.true_knock.push(truth.knock);
        let fuel_g_s = truth.fuel_kg_h / 3.6;
        let moles = (truth.air_g_s + fuel_g_s) / EXHAUST_G;
        self.fuel_g_s.push(fuel_g_s);
        let shares = [1e-2 * truth.co_pct, 1e-6 * truth.hc_ppm, 1e-6 * truth.no_ppm];
        self.emitted_g_s.push([0, 1, 2].map(|k| shares[k] * moles * MOLAR_G[k]));
    }
}
