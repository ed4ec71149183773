//! Sources of torque in a car: an ideal one, and the virtual engine with a static controller.

use super::drive::{Power, PowerSource};
use crate::engine::VirtualEngine;
use crate::error::PlantError;
use crate::inputs::Inputs;
use crate::statics::{SettleOptions, Target, settle, spark_guess_deg, steady};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Torque exactly as demanded within constant limits, without fuel: a test load for car and driver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IdealTorque {
    least_nm: f64,
    most_nm: f64,
}

impl IdealTorque {
    /// A source between two torques \[Nm\].
    pub fn new(least_nm: f64, most_nm: f64) -> Self {
        Self { least_nm, most_nm }
    }
}

impl PowerSource for IdealTorque {
    fn limits_nm(&self, _speed_rpm: f64) -> (f64, f64) {
        (self.least_nm, self.most_nm)
    }

    fn step(&mut self, demand_nm: f64, _speed_rpm: f64, _dt_s: f64) -> Result<Power, PlantError> {
        Ok(Power {
            torque_nm: demand_nm.clamp(self.least_nm, self.most_nm),
            lambda: f64::NAN,
            ..Power::default()
        })
    }
}

/// One speed of a grid of steady points.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct SpeedRow {
    speed_rpm: f64,
    motored_nm: f64,
    torque_nm: Vec<f64>,
    throttle_deg: Vec<f64>,
    spark_deg: Vec<f64>,
}

/// Steady points of an engine over speed and torque: motored torque, then equal steps from no load to full load.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SteadyGrid {
    rows: Vec<SpeedRow>,
}

impl SteadyGrid {
    /// Settles `engine` at `steps` torques for each speed, lambda 1, parallel over speeds; points that the engine cannot
    /// hold are left out.
    ///
    /// # Errors
    /// [`PlantError`] of the engine, and when a speed has fewer than two points.
    pub fn measure(engine: &VirtualEngine, speeds_rpm: &[f64], steps: usize) -> Result<Self, PlantError> {
        let rows: Result<Vec<SpeedRow>, PlantError> =
            speeds_rpm.par_iter().map(|&n| Self::row(engine.clone(), n, steps.max(2))).collect();
        Ok(Self { rows: rows? })
    }

    fn row(mut engine: VirtualEngine, speed_rpm: f64, steps: usize) -> Result<SpeedRow, PlantError> {
        let closed =
            Inputs { speed_rpm, throttle_deg: CLOSED_DEG, injection_mg: 0.0, ..engine.state().inputs };
        let motored_nm = steady(&mut engine, closed, 2.0, 0.5)?.torque_nm;
        let mut full = Inputs { throttle_deg: 90.0, spark_deg: spark_guess_deg(speed_rpm, 130.0), ..closed };
        let mut most_nm = 0.0;
        for _ in 0..3 {
            let y = steady(&mut engine, full, 1.5, 0.5)?;
            let air_mg = 1e3 * y.air_g_s * 120.0 / speed_rpm / 4.0;
            full.injection_mg = (air_mg / engine.params().gas.afr_stoich).clamp(0.0, 120.0);
            most_nm = y.torque_nm;
        }
        let mut row = SpeedRow {
            speed_rpm,
            motored_nm,
            torque_nm: Vec::new(),
            throttle_deg: Vec::new(),
            spark_deg: Vec::new(),
        };
        engine.set_inputs(Inputs { throttle_deg: 16.0, injection_mg: 16.7, spark_deg: 19.0, ..full })?;
        let mut why = None;
        for k in 0..steps {
            let torque_nm = 0.97 * most_nm * k as f64 / (steps - 1) as f64;
            let spark = spark_guess_deg(speed_rpm, torque_nm).clamp(-5.0, 45.0);
            let target = Target { speed_rpm, torque_nm, lambda: 1.0 };
            let options = SettleOptions { torque_nm: 0.2, lambda: 2e-3, limit_s: 12.0, cams: false };
            match settle(&mut engine, target, spark, options) {
                Ok(p) => {
                    row.torque_nm.push(torque_nm);
                    row.throttle_deg.push(p.inputs.throttle_deg);
                    row.spark_deg.push(spark);
                }
                Err(e) => why = Some(e),
            }
        }
        match why {
            Some(e) if row.torque_nm.len() < 2 => Err(e),
            _ => Ok(row),
        }
    }

    /// Motored and full-load torque \[Nm\] at a speed.
    pub fn limits_nm(&self, speed_rpm: f64) -> (f64, f64) {
        let full = |r: &SpeedRow| r.torque_nm[r.torque_nm.len() - 1];
        (self.between(speed_rpm, |r| r.motored_nm), self.between(speed_rpm, full))
    }

    /// Throttle \[deg\] and spark \[deg BTDC\] for a torque at a speed, linear between the points. Below the least torque
    /// that settled the throttle follows the lowest slope down to closed.
    pub fn actuators_deg(&self, speed_rpm: f64, torque_nm: f64) -> (f64, f64) {
        let throttle = |r: &SpeedRow| {
            let (x, y) = (&r.torque_nm, &r.throttle_deg);
            let below = (torque_nm - x[0]).min(0.0) * (y[1] - y[0]) / (x[1] - x[0]);
            (interpolate(x, y, torque_nm) + below).max(CLOSED_DEG)
        };
        let spark = |r: &SpeedRow| interpolate(&r.torque_nm, &r.spark_deg, torque_nm);
        (self.between(speed_rpm, throttle), self.between(speed_rpm, spark))
    }

    fn between(&self, speed_rpm: f64, value: impl Fn(&SpeedRow) -> f64) -> f64 {
        if self.rows.len() == 1 {
            return value(&self.rows[0]);
        }
        let i = self.rows.partition_point(|r| r.speed_rpm <= speed_rpm).clamp(1, self.rows.len() - 1);
        let (a, b) = (&self.rows[i - 1], &self.rows[i]);
        let share = ((speed_rpm - a.speed_rpm) / (b.speed_rpm - a.speed_rpm)).clamp(0.0, 1.0);
        value(a) + share * (value(b) - value(a))
    }
}

/// Throttle angle without load \[deg\].
const CLOSED_DEG: f64 = 1.0;

/// Piecewise linear through (x, y), constant outside.
fn interpolate(x: &[f64], y: &[f64], at: f64) -> f64 {
    let i = x.partition_point(|&v| v <= at).clamp(1, x.len() - 1);
    let share = ((at - x[i - 1]) / (x[i] - x[i - 1])).clamp(0.0, 1.0);
    y[i - 1] + share * (y[i] - y[i - 1])
}

/// Demanded torque to engine inputs.
pub trait MapController: Send {
    /// Inputs for a demand, given the engine as its sensors show it.
    fn inputs(&mut self, demand_nm: f64, speed_rpm: f64, engine: &VirtualEngine, dt_s: f64) -> Inputs;

    /// Least and greatest torque at a speed \[Nm\].
    fn limits_nm(&self, speed_rpm: f64) -> (f64, f64);
}

/// The static controller: throttle and spark from the grid, fuel for lambda 1 from the air of the last cycle, an
/// integral trim of the throttle, and fuel cut-off on overrun.
#[derive(Clone, Debug)]
pub struct GridController {
    grid: SteadyGrid,
    /// Trim of the demanded torque \[Nm\].
    trim_nm: f64,
    /// Overrun: no fuel.
    cut: bool,
}

impl MapController for GridController {
    fn inputs(&mut self, demand_nm: f64, speed_rpm: f64, engine: &VirtualEngine, dt_s: f64) -> Inputs {
        const INTEGRAL_PER_S: f64 = 0.8;
        const CUT_BELOW_NM: f64 = -5.0;
        const FUEL_AGAIN_RPM: f64 = 1200.0;
        let y = engine.outputs();
        self.cut =
            demand_nm < CUT_BELOW_NM && (speed_rpm > FUEL_AGAIN_RPM + if self.cut { 0.0 } else { 200.0 });
        let now = Inputs { speed_rpm, ..engine.state().inputs };
        if self.cut {
            self.trim_nm = 0.0;
            return Inputs { throttle_deg: CLOSED_DEG, injection_mg: 0.0, ..now };
        }
        let (_, most) = self.grid.limits_nm(speed_rpm);
        let demand = demand_nm.clamp(0.0, most);
        self.trim_nm =
            (self.trim_nm + dt_s * INTEGRAL_PER_S * (demand - y.torque_cycle_nm)).clamp(-20.0, 20.0);
        let (throttle_deg, spark_deg) =
            self.grid.actuators_deg(speed_rpm, (demand + self.trim_nm).clamp(-20.0, most.max(0.0)));
        let air_mg = 1e3 * y.air_g_s * 120.0 / speed_rpm / 4.0;
        let injection_mg = (air_mg / engine.params().gas.afr_stoich).clamp(0.0, 120.0);
        Inputs { throttle_deg, spark_deg, injection_mg, ..now }
    }

    fn limits_nm(&self, speed_rpm: f64) -> (f64, f64) {
        self.grid.limits_nm(speed_rpm)
    }
}

/// The virtual engine and its controller as a source of torque.
pub struct EngineInCar {
    engine: VirtualEngine,
    controller: Box<dyn MapController>,
}

impl EngineInCar {
    /// The engine with any controller.
    pub fn new(engine: VirtualEngine, controller: Box<dyn MapController>) -> Self {
        Self { engine, controller }
    }

    /// The engine with the static controller over a measured grid.
    pub fn with_grid(engine: VirtualEngine, grid: SteadyGrid) -> Self {
        Self::new(engine, Box::new(GridController { grid, trim_nm: 0.0, cut: false }))
    }

    /// The engine.
    pub fn engine(&self) -> &VirtualEngine {
        &self.engine
    }
}

impl PowerSource for EngineInCar {
    fn limits_nm(&self, speed_rpm: f64) -> (f64, f64) {
        self.controller.limits_nm(speed_rpm)
    }

    fn step(&mut self, demand_nm: f64, speed_rpm: f64, dt_s: f64) -> Result<Power, PlantError> {
        let inputs = self.controller.inputs(demand_nm, speed_rpm, &self.engine, dt_s);
        self.engine.set_inputs(inputs)?;
        self.engine.clear_interval();
        self.engine.advance_time(dt_s);
        let y = self.engine.outputs();
        if !y.torque_cycle_nm.is_finite() {
            self.engine.check_state()?;
        }
        Ok(Power {
            torque_nm: y.torque_cycle_nm,
            fuel_kg_h: y.fuel_kg_h,
            lambda: if inputs.injection_mg > 0.0 { y.lambda_cycle } else { f64::NAN },
            throttle_deg: inputs.throttle_deg,
            spark_deg: inputs.spark_deg,
            inj_mg: inputs.injection_mg,
        })
    }
}
