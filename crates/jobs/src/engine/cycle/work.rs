//! The drive: steady points for the controller, then the car along the cycle.

use std::path::Path;

use dynocal_files::csv_io;
use dynocal_numerics::watch::Watch;
use dynocal_plant::engine::VirtualEngine;
use dynocal_plant::error::PlantError;
use dynocal_plant::vehicle::{
    Car, DriveCycle, DriveLog, DriveOptions, EngineInCar, Power, PowerSource, SteadyGrid, drive,
};
use dynocal_report::significant;

use super::{Driven, Fact, Spec};
use crate::engine::{Engine, EngineJobError};

/// Speeds of the steady points of the controller \[rpm\], and points a speed.
const GRID_RPM: [f64; 7] = [800.0, 1200.0, 1700.0, 2300.0, 3000.0, 3800.0, 4600.0];
const GRID_TORQUES: usize = 6;
/// A row of the CSV and a point of the plots every so many steps of 20 ms.
const THIN: usize = 10;

/// Drives the cycle; an interrupted drive gives the part that was driven.
///
/// # Errors
/// [`EngineJobError`].
pub fn run(engine: &Engine, spec: &Spec, watch: Watch) -> Result<Driven, EngineJobError> {
    let mut car = Car { grade: spec.grade, ..Car::thesis() };
    car.road_load.units = spec.units;
    let engine = VirtualEngine::new(&engine.params)?;
    watch.note("steady points for the controller");
    let grid = SteadyGrid::measure(&engine, &GRID_RPM, GRID_TORQUES)?;
    watch.note("driving");
    let mut source = EngineInCar::with_grid(engine, grid);
    let mut counted = Counted { source: &mut source, watch, done_s: 0.0, whole_s: spec.cycle.duration_s() };
    let log = drive(&car, &spec.cycle, &mut counted, DriveOptions::default(), &|| watch.interrupted())?;
    Ok(Driven { facts: facts(&log, &spec.cycle), log, interrupted: watch.interrupted() })
}

/// Says how far the drive is.
struct Counted<'a> {
    source: &'a mut EngineInCar,
    watch: Watch<'a>,
    done_s: f64,
    whole_s: f64,
}

impl PowerSource for Counted<'_> {
    fn limits_nm(&self, speed_rpm: f64) -> (f64, f64) {
        self.source.limits_nm(speed_rpm)
    }

    fn step(&mut self, demand_nm: f64, speed_rpm: f64, dt_s: f64) -> Result<Power, PlantError> {
        self.done_s += dt_s;
        self.watch.fraction(self.done_s / self.whole_s);
        self.source.step(demand_nm, speed_rpm, dt_s)
    }
}

fn facts(log: &DriveLog, cycle: &DriveCycle) -> Vec<Fact> {
    let seconds = log.time_s.last().copied().unwrap_or(0.0);
    let km = log.distance_m / 1e3;
    let share = |n: usize| 100.0 * n as f64 / log.time_s.len().max(1) as f64;
    let step_s = seconds / log.time_s.len().max(1) as f64;
    let burning: Vec<f64> = log.power.iter().map(|p| p.lambda).filter(|l| l.is_finite()).collect();
    let off = burning.iter().filter(|l| (**l - 1.0).abs() > 0.05).count();
    let most = log.power.iter().map(|p| p.torque_nm).fold(f64::NEG_INFINITY, f64::max);
    let rows: Vec<(&'static str, f64, usize, &'static str)> = vec![
        ("time driven", seconds, 5, "s"),
        ("of the cycle's", cycle.duration_s(), 5, "s"),
        ("distance", km, 5, "km"),
        ("fuel", log.fuel_g, 5, "g"),
        ("fuel, 0.745 kg/l", log.litres_per_100_km().unwrap_or(f64::NAN), 4, "l/100 km"),
        ("CO2, 3.09 g/g fuel", 3.09 * log.fuel_g / km, 4, "g/km"),
        ("engine work", log.engine_work_j / 3.6e6, 4, "kWh"),
        ("greatest torque", most, 4, "Nm"),
        ("speed error, RMS", 3.6 * log.rms_error_mps(), 3, "km/h"),
        ("outside 2 km/h within 1 s", log.outside as f64 * step_s, 3, "s"),
        ("lambda off by more than 0.05", share(off), 3, "% of time"),
        ("fuel cut off", share(log.power.iter().filter(|p| p.inj_mg == 0.0).count()), 3, "% of time"),
    ];
    rows.into_iter()
        .map(|(name, v, digits, unit)| Fact { name, text: significant(v, digits), unit })
        .collect()
}

/// Every `THIN`-th step.
pub(super) fn thin(values: impl Iterator<Item = f64>) -> Vec<f64> {
    values.step_by(THIN).collect()
}

/// Writes speeds, torque, fuel and engine inputs every 0.2 s to a CSV file.
///
/// # Errors
/// [`EngineJobError::Files`].
pub fn csv(path: &Path, log: &DriveLog) -> Result<(), EngineJobError> {
    let power = |f: fn(&Power) -> f64| thin(log.power.iter().map(f));
    let copy = |v: &[f64]| thin(v.iter().copied());
    let columns: [(&str, &str, Vec<f64>); 13] = [
        ("time", "s", copy(&log.time_s)),
        ("speed_demand", "m/s", copy(&log.demand_mps)),
        ("speed", "m/s", copy(&log.speed_mps)),
        ("engine_speed", "rpm", copy(&log.engine_rpm)),
        ("gear", "-", copy(&log.gear)),
        ("torque_demand", "Nm", copy(&log.demand_nm)),
        ("brake", "Nm", copy(&log.brake_nm)),
        ("torque", "Nm", power(|p| p.torque_nm)),
        ("fuel", "kg/h", power(|p| p.fuel_kg_h)),
        // Lambda without fuel is written as 0: files hold finite numbers.
        ("lambda", "-", power(|p| if p.lambda.is_finite() { p.lambda } else { 0.0 })),
        ("throttle", "deg", power(|p| p.throttle_deg)),
        ("spark", "deg", power(|p| p.spark_deg)),
        ("inj", "mg", power(|p| p.inj_mg)),
    ];
    let columns: Vec<(&str, &str, &[f64])> = columns.iter().map(|(n, u, v)| (*n, *u, v.as_slice())).collect();
    csv_io::write_columns(path, &columns)?;
    Ok(())
}
