//! A car driven through a cycle.

use super::car::{Car, CarState};
use super::cycle::DriveCycle;
use super::driver::Driver;
use crate::error::PlantError;
use serde::{Deserialize, Serialize};

/// What a power source answers over one step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Power {
    /// Brake torque \[Nm\].
    pub torque_nm: f64,
    /// Fuel flow \[kg/h\].
    pub fuel_kg_h: f64,
    /// Lambda \[-\]; NaN without fuel.
    pub lambda: f64,
    /// Throttle angle \[deg\].
    pub throttle_deg: f64,
    /// Spark advance \[deg BTDC\].
    pub spark_deg: f64,
    /// Fuel per cylinder and cycle \[mg\].
    pub inj_mg: f64,
}

/// Whatever makes torque in a car: the virtual engine with its controls, or an ideal one.
pub trait PowerSource {
    /// Least and greatest torque at a speed \[Nm\].
    fn limits_nm(&self, speed_rpm: f64) -> (f64, f64);

    /// One step at the demanded torque and the speed of the car.
    ///
    /// # Errors
    /// [`PlantError`] of the engine.
    fn step(&mut self, demand_nm: f64, speed_rpm: f64, dt_s: f64) -> Result<Power, PlantError>;
}

/// Allowed distance from a cycle: a band of speed within a band of time (UN GTR 15, 2.6.8.3: 2 km/h within 1 s).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Tolerance {
    /// Half width \[m/s\].
    pub speed_mps: f64,
    /// Half width \[s\].
    pub time_s: f64,
}

impl Default for Tolerance {
    fn default() -> Self {
        Self { speed_mps: 2.0 / 3.6, time_s: 1.0 }
    }
}

/// How a cycle is driven.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct DriveOptions {
    /// Step \[s\]: torque, speed and car are exchanged once in it.
    pub step_s: f64,
    /// Band that counts as followed.
    pub tolerance: Tolerance,
}

impl Default for DriveOptions {
    fn default() -> Self {
        Self { step_s: 0.02, tolerance: Tolerance::default() }
    }
}

/// What happened, one entry a step.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DriveLog {
    /// Time at the end of the step \[s\].
    pub time_s: Vec<f64>,
    /// Demanded speed \[m/s\].
    pub demand_mps: Vec<f64>,
    /// Speed of the car \[m/s\].
    pub speed_mps: Vec<f64>,
    /// Engine speed \[rpm\].
    pub engine_rpm: Vec<f64>,
    /// Gear, 1 for the first.
    pub gear: Vec<f64>,
    /// Demanded torque \[Nm\].
    pub demand_nm: Vec<f64>,
    /// Brake torque at the wheels \[Nm\].
    pub brake_nm: Vec<f64>,
    /// Answer of the engine.
    pub power: Vec<Power>,
    /// Distance \[m\].
    pub distance_m: f64,
    /// Fuel \[g\].
    pub fuel_g: f64,
    /// Work of the engine on the car \[J\].
    pub engine_work_j: f64,
    /// Steps outside the tolerance.
    pub outside: usize,
}

impl DriveLog {
    /// Fuel over distance \[l/100 km\] for gasoline of 745 g/l; `None` before the car has moved.
    pub fn litres_per_100_km(&self) -> Option<f64> {
        (self.distance_m > 1.0).then(|| self.fuel_g / 745.0 / (self.distance_m * 1e-5))
    }

    /// Root of the mean squared speed error \[m/s\].
    pub fn rms_error_mps(&self) -> f64 {
        let sum: f64 = self.demand_mps.iter().zip(&self.speed_mps).map(|(d, v)| (d - v).powi(2)).sum();
        (sum / self.speed_mps.len().max(1) as f64).sqrt()
    }
}

/// Drives `cycle` from its first speed on. `interrupt` is asked each second and ends the drive with what there is.
///
/// # Errors
/// [`PlantError`] for a car or a step that cannot be, and errors of the engine.
///
/// ```
/// use dynocal_plant::vehicle::*;
/// let cycle = DriveCycle::new(vec![0.0, 5.0, 15.0, 30.0], vec![0.0, 0.0, 10.0, 10.0]).unwrap();
/// let mut engine = IdealTorque::new(-20.0, 150.0);
/// let log = drive(&Car::thesis(), &cycle, &mut engine, DriveOptions::default(), &|| false)?;
/// assert_eq!(log.outside, 0);
/// assert!((log.speed_mps.last().unwrap() - 10.0).abs() < 0.1);
/// # Ok::<(), dynocal_plant::error::PlantError>(())
/// ```
pub fn drive(
    car: &Car,
    cycle: &DriveCycle,
    source: &mut dyn PowerSource,
    options: DriveOptions,
    interrupt: &dyn Fn() -> bool,
) -> Result<DriveLog, PlantError> {
    car.check()?;
    let dt = options.step_s;
    if !(dt > 0.0 && dt <= 0.2) {
        let expected = "0 to 0.2 s";
        return Err(PlantError::Parameter { name: "step_s", found: dt, expected });
    }
    let start = cycle.speed_mps(0.0);
    let mut state = CarState { speed_mps: start, gear: car.gear_for(start, 0), distance_m: 0.0 };
    let steps = (cycle.duration_s() / dt).round() as usize;
    let mut log = DriveLog::default();
    let mut driver = Driver::new(0.0, 0.0);
    for k in 0..steps {
        if k % (1.0 / dt).ceil() as usize == 0 && interrupt() {
            break;
        }
        let now = k as f64 * dt;
        let rpm = car.engine_rpm(&state);
        (driver.least_torque_nm, driver.most_torque_nm) = source.limits_nm(rpm);
        let seen = now + driver.preview_s;
        let ahead = (cycle.speed_mps(seen + 0.5) - cycle.speed_mps(seen - 0.5)).clamp(-8.0, 8.0);
        let command = driver.command(car, &state, cycle.speed_mps(now), ahead, dt);
        let power = source.step(command.torque_nm, rpm, dt)?;
        // A slipping clutch carries no drag of the engine to the wheels, and none at all at rest on the brake.
        let carried = if car.slips(&state) {
            power.torque_nm.max(0.0).min(command.torque_nm.max(0.0))
        } else {
            power.torque_nm
        };
        let before = state.speed_mps;
        let ratio = car.ratio(state.gear);
        car.step(&mut state, carried, command.brake_nm, dt);
        log.engine_work_j += carried * ratio * 0.5 * (before + state.speed_mps) / car.tyre_radius_m * dt;
        log.record(&state, now + dt, cycle, rpm, command.torque_nm, command.brake_nm, power, options, dt);
    }
    log.distance_m = state.distance_m;
    Ok(log)
}

impl DriveLog {
    fn record(
        &mut self,
        state: &CarState,
        time_s: f64,
        cycle: &DriveCycle,
        rpm: f64,
        demand_nm: f64,
        brake_nm: f64,
        power: Power,
        options: DriveOptions,
        dt: f64,
    ) {
        self.time_s.push(time_s);
        self.demand_mps.push(cycle.speed_mps(time_s));
        self.speed_mps.push(state.speed_mps);
        self.engine_rpm.push(rpm);
        self.gear.push(state.gear as f64 + 1.0);
        self.demand_nm.push(demand_nm);
        self.brake_nm.push(brake_nm);
        self.fuel_g += power.fuel_kg_h / 3.6 * dt;
        self.power.push(power);
        let band = options.tolerance;
        // Extremes of the cycle within the band of time, looked at every tenth of a second.
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        let looks = (2.0 * band.time_s / 0.1).round().max(1.0) as usize;
        for i in 0..=looks {
            let v = cycle.speed_mps(time_s - band.time_s + 2.0 * band.time_s * i as f64 / looks as f64);
            low = low.min(v);
            high = high.max(v);
        }
        let v = state.speed_mps;
        self.outside += usize::from(v < low - band.speed_mps || v > high + band.speed_mps);
    }
}
