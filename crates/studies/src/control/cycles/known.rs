//! What is known of the mapped engine before a drive: steady maps, and air, manifold and film identified from two records.

use std::sync::{Arc, Mutex};

use dynocal_calib::fuelling::{
    self, Feedback, FuelPolicy, Fuelling, Sensed, SpeedDensity, SpeedDensityState, TransientRecord,
};
use dynocal_numerics::rng::Rng64;
use dynocal_plant::engine::VirtualEngine;
use dynocal_plant::inputs::Inputs;
use dynocal_plant::statics::{SettleOptions, Target, settle};
use dynocal_plant::vehicle::SteadyGrid;

use super::sensor::LambdaSensor;
use super::{MOST_MG, SPEEDS_RPM, STEP_S, TORQUES, running};

/// Length of each record in s, range of the holds in s, rate of the speed in rpm/s.
const RECORD_S: f64 = 240.0;
const HOLDS_S: (f64, f64) = (3.0, 6.0);
const SPEED_RATE: f64 = 1000.0;
/// Most of the grid's torque that is held.
const MOST_PART: f64 = 0.95;
/// Step of the fuel in the middle of a hold as a share, and time constant of the first driver's loop in s.
const STEP: f64 = 0.08;
const LOOP_S: f64 = 1.5;
/// What the line searches of the ECU try: time of the extrapolation and of the closed loop, in s.
pub(super) const AHEADS_S: [f64; 6] = [0.0, 0.02, 0.04, 0.06, 0.09, 0.12];
pub(super) const CLOSED_S: [f64; 5] = [0.3, 0.8, 2.0, 5.0, 12.0];
/// Pressure before the throttle, and most of an extrapolation without and with a compressor, in kPa.
const AMBIENT_KPA: f64 = 101.325;
const MOST_KPA: (f64, f64) = (100.0, 240.0);

/// Everything that controllers know.
pub(super) struct Known {
    pub(super) grid: SteadyGrid,
    pub(super) fuel: FuelMap,
    pub(super) fuelling: Fuelling,
    /// The loop of lambda about it.
    pub(super) feedback: Feedback,
    /// A production ECU: extrapolation tuned on the record, its feedback too.
    pub(super) ecu: SpeedDensity,
}

/// Fuel of the steady points, mg, by speed and share of the grid's torque.
pub(super) struct FuelMap {
    torque_nm: Vec<Vec<f64>>,
    fuel_mg: Vec<Vec<f64>>,
}

impl FuelMap {
    fn measure(engine: &VirtualEngine, grid: &SteadyGrid) -> Result<Self, String> {
        let mut out = Self { torque_nm: Vec::new(), fuel_mg: Vec::new() };
        for speed_rpm in SPEEDS_RPM {
            let most = grid.limits_nm(speed_rpm).1;
            let (mut torques, mut fuels) = (Vec::new(), Vec::new());
            let mut own = engine.clone();
            let start = Inputs { speed_rpm, throttle_deg: 16.0, injection_mg: 16.7, ..own.state().inputs };
            own.set_inputs(start).map_err(|e| e.to_string())?;
            for k in 0..TORQUES {
                let torque_nm = most * k as f64 / (TORQUES - 1) as f64;
                let spark = grid.actuators_deg(speed_rpm, torque_nm).1;
                let options = SettleOptions { torque_nm: 0.2, lambda: 1e-3, limit_s: 12.0, cams: false };
                // Points that the engine does not hold are left out.
                if let Ok(p) = settle(&mut own, Target { speed_rpm, torque_nm, lambda: 1.0 }, spark, options)
                {
                    torques.push(torque_nm);
                    fuels.push(p.inputs.injection_mg);
                }
            }
            if torques.len() < 2 {
                return Err(format!("the engine holds fewer than two torques at {speed_rpm} rpm"));
            }
            out.torque_nm.push(torques);
            out.fuel_mg.push(fuels);
        }
        Ok(out)
    }

    pub(super) fn at(&self, speed_rpm: f64, torque_nm: f64) -> f64 {
        let row = |k: usize| {
            let (x, y) = (&self.torque_nm[k], &self.fuel_mg[k]);
            let i = x.partition_point(|v| *v <= torque_nm).clamp(1, x.len() - 1);
            y[i - 1] + (torque_nm - x[i - 1]) / (x[i] - x[i - 1]) * (y[i] - y[i - 1])
        };
        let i = SPEEDS_RPM.partition_point(|v| *v <= speed_rpm).clamp(1, SPEEDS_RPM.len() - 1);
        let share = ((speed_rpm - SPEEDS_RPM[i - 1]) / (SPEEDS_RPM[i] - SPEEDS_RPM[i - 1])).clamp(0.0, 1.0);
        (row(i - 1) + share * (row(i) - row(i - 1))).clamp(1.0, MOST_MG)
    }
}

/// Held points of speed and torque, drawn over what a drive asks for.
struct Course {
    speed_rpm: Vec<f64>,
    torque_nm: Vec<f64>,
    /// Share by which the fuel is moved: it tells the film where the air stands still.
    share: Vec<f64>,
}

impl Course {
    fn drawn(grid: &SteadyGrid, stream: u64, with_corners: bool) -> Self {
        let mut rng = Rng64::stream(1, stream);
        let rows = (RECORD_S / STEP_S) as usize;
        let mut out = Self { speed_rpm: Vec::new(), torque_nm: Vec::new(), share: Vec::new() };
        let mut now = SPEEDS_RPM[0];
        let (slowest, fastest) = (SPEEDS_RPM[0], SPEEDS_RPM[SPEEDS_RPM.len() - 1]);
        // The corners first, idle among them: what is drawn hardly ever comes there, and a polynomial has no hold without.
        let mut corners = [(slowest, 0.0), (slowest, MOST_PART), (fastest, MOST_PART), (fastest, 0.0)]
            .into_iter()
            .filter(|_| with_corners);
        while out.speed_rpm.len() < rows {
            let drawn = (rng.uniform_in(slowest, fastest), rng.uniform_in(0.0, MOST_PART));
            let (speed, part) = corners.next().unwrap_or(drawn);
            let hold = (rng.uniform_in(HOLDS_S.0, HOLDS_S.1) / STEP_S) as usize;
            let step = if rng.uniform() < 0.5 { STEP } else { -STEP };
            for t in 0..hold {
                now += (speed - now).clamp(-SPEED_RATE * STEP_S, SPEED_RATE * STEP_S);
                out.speed_rpm.push(now);
                // The throttle of a hold is that of its end: a manifold is told by steps.
                out.torque_nm.push(part * grid.limits_nm(speed).1);
                out.share.push(if (hold / 3..2 * hold / 3).contains(&t) { step } else { 0.0 });
            }
        }
        out
    }
}

/// A record of a course.
#[derive(Default)]
struct Record {
    speed_rpm: Vec<f64>,
    throttle_deg: Vec<f64>,
    injection: Vec<f64>,
    map_kpa: Vec<f64>,
    lambda: Vec<f64>,
    /// Pressure before the throttle; empty where there is no compressor.
    boost_kpa: Vec<f64>,
}

impl Record {
    fn view(&self) -> TransientRecord<'_> {
        TransientRecord {
            sample_time_s: STEP_S,
            speed_rpm: &self.speed_rpm,
            throttle_deg: &self.throttle_deg,
            injection: &self.injection,
            map_kpa: &self.map_kpa,
            lambda: &self.lambda,
            upstream_kpa: AMBIENT_KPA,
            boost_kpa: (!self.boost_kpa.is_empty()).then_some(self.boost_kpa.as_slice()),
            coolant_c: None,
            cams_deg: None,
        }
    }

    /// Mean distance of what the sensor shows from 1.
    fn off(&self) -> f64 {
        self.lambda.iter().map(|l| (l - 1.0).abs()).sum::<f64>() / self.lambda.len() as f64
    }
}

/// Pressure before the throttle as a channel shows it, where a compressor makes it.
pub(super) fn boost_kpa(engine: &VirtualEngine) -> Option<f64> {
    engine.params().turbocharger.as_ref().map(|_| engine.outputs().boost_kpa)
}

/// A course under what `fuel` gives for what is sensed and the share by which the fuel is to move.
fn driven(
    engine: &VirtualEngine,
    grid: &SteadyGrid,
    course: &Course,
    fuel: &mut dyn FnMut(&Sensed, f64) -> f64,
) -> Result<Record, String> {
    let mut own = engine.clone();
    let mut sensor = LambdaSensor::at_rest();
    let mut out = Record::default();
    for (t, (speed, torque)) in course.speed_rpm.iter().zip(&course.torque_nm).enumerate() {
        let (throttle_deg, spark_deg) = grid.actuators_deg(*speed, *torque);
        let sensed = Sensed {
            speed_rpm: *speed,
            throttle_deg,
            map_kpa: own.outputs().map_kpa,
            upstream_kpa: boost_kpa(&own),
            coolant_c: 0.0,
            cams_deg: None,
            lambda: sensor.lambda(),
        };
        let injection_mg = fuel(&sensed, course.share[t]).clamp(0.0, MOST_MG);
        let now = Inputs { speed_rpm: *speed, throttle_deg, spark_deg, injection_mg, ..own.state().inputs };
        own.set_inputs(now).map_err(|e| e.to_string())?;
        own.clear_interval();
        own.advance_time(STEP_S);
        own.check_state().map_err(|e| e.to_string())?;
        let y = own.outputs();
        sensor.pass(Some(y.lambda_cycle), y.air_g_s, *speed);
        out.speed_rpm.push(*speed);
        out.throttle_deg.push(throttle_deg);
        out.injection.push(injection_mg);
        out.map_kpa.push(y.map_kpa);
        out.boost_kpa.extend(boost_kpa(&own));
        out.lambda.push(sensor.shown());
    }
    Ok(out)
}

/// Everything of an engine, measured once in a run of the study: it depends on the name alone.
pub(super) fn known(mapped: &str, stop: &(dyn Fn() -> bool + Sync)) -> Result<Arc<Known>, String> {
    static KEPT: Mutex<Vec<(String, Arc<Known>)>> = Mutex::new(Vec::new());
    let mut kept = KEPT.lock().map_err(|_| "a drive ended within its preparation")?;
    if let Some((_, found)) = kept.iter().find(|k| k.0 == mapped) {
        return Ok(found.clone());
    }
    let found = Arc::new(measured(mapped, stop)?);
    kept.push((mapped.into(), found.clone()));
    Ok(found)
}

fn measured(mapped: &str, stop: &(dyn Fn() -> bool + Sync)) -> Result<Known, String> {
    let engine = running(mapped)?;
    let grid = SteadyGrid::measure(&engine, &SPEEDS_RPM, TORQUES).map_err(|e| e.to_string())?;
    let fuel = FuelMap::measure(&engine, &grid)?;
    let courses = [Course::drawn(&grid, 51, true), Course::drawn(&grid, 52, false)];
    let drive = |c: &Course, f: &mut dyn FnMut(&Sensed, f64) -> f64| driven(&engine, &grid, c, f);
    // Fuel that goes with the pressure, corrected slowly: what can be driven before anything is known.
    let inputs = engine.state().inputs;
    let per_kpa = inputs.injection_mg / engine.outputs().map_kpa.max(1.0);
    let mut k = 0.0;
    let first = drive(&courses[0], &mut |y, share| {
        k += STEP_S / LOOP_S * y.lambda.map_or(0.0, f64::ln).clamp(-0.3, 0.3);
        per_kpa * y.map_kpa * f64::exp(k) * (1.0 + share)
    })?;
    let identified = |records: &[TransientRecord<'_>]| {
        fuelling::identify(records, stop).map_err(|e| format!("identification of `{mapped}`: {e}"))
    };
    let rough = identified(&[first.view()])?;
    let mut policy = FuelPolicy::new(rough, MOST_MG);
    let second =
        drive(&courses[1], &mut |y, share| policy.step(&Sensed { lambda: None, ..*y }, 1.0 / (1.0 + share)))?;
    let records = [first.view(), second.view()];
    let fuelling = identified(&records)?;
    let (charge, law) = fuelling::steady_charge(&records).map_err(|e| e.to_string())?;
    let plain = SpeedDensity {
        sample_time_s: STEP_S,
        charge,
        law,
        most_kpa: if boost_kpa(&engine).is_some() { MOST_KPA.1 } else { MOST_KPA.0 },
        ahead_s: 0.0,
        film: Some(fuelling.coat()),
        feedback: None,
    };
    // Loops and the rival are tuned on the second course, without the steps of the fuel.
    let off = |fuel: &mut dyn FnMut(&Sensed) -> f64| drive(&courses[1], &mut |y, _| fuel(y)).map(|r| r.off());
    let ecu_off = |ecu: &SpeedDensity| {
        let mut own = SpeedDensityState::new(ecu.clone(), MOST_MG);
        off(&mut |y| own.step(y, 1.0))
    };
    let loops = CLOSED_S.map(|closed_s| Feedback { timing: fuelling.timing, closed_s });
    let ahead = best(AHEADS_S.map(|ahead_s| SpeedDensity { ahead_s, ..plain.clone() }).to_vec(), ecu_off)?;
    let looped = loops.map(|f| SpeedDensity { feedback: Some(f), ..ahead.clone() });
    let ecu = best(looped.to_vec(), ecu_off)?;
    let feedback = best(loops.to_vec(), |f| {
        let mut own = FuelPolicy::new(fuelling.clone(), MOST_MG).with_feedback(*f);
        off(&mut |y| own.step(y, 1.0))
    })?;
    Ok(Known { grid, fuel, fuelling, feedback, ecu })
}

/// That of the tried which leaves least.
fn best<T>(tried: Vec<T>, left: impl Fn(&T) -> Result<f64, String>) -> Result<T, String> {
    let mut found: Option<(f64, T)> = None;
    for one in tried {
        let off = left(&one)?;
        if found.as_ref().is_none_or(|f| off < f.0) {
            found = Some((off, one));
        }
    }
    found.map(|f| f.1).ok_or_else(|| "nothing was tried".into())
}
