//! What the test bed reads.

use crate::params::EngineParams;
use crate::state::{EXHAUST, EngineState, Sums};
use crate::step::{Held, Model, Rates};
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// Outputs at a sample time. Cycle values are means over the last 720 deg (updated every 180 deg).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Outputs {
    /// Torque sensor: 720 deg mean of the brake torque through a first-order lag \[Nm\].
    pub torque_nm: f64,
    /// Brake torque, mean of the last 720 deg, without the lag \[Nm\].
    pub torque_cycle_nm: f64,
    /// Torque of the gas at the last step \[Nm\].
    pub torque_gas_nm: f64,
    /// Lambda of the exhaust-manifold gas, present value \[-\].
    pub lambda: f64,
    /// Lambda averaged since the interval was cleared \[-\].
    pub lambda_interval: f64,
    /// Lambda averaged over the last 720 deg \[-\].
    pub lambda_cycle: f64,
    /// Intake-manifold pressure, cycle mean \[kPa\].
    pub map_kpa: f64,
    /// Exhaust-manifold pressure, cycle mean \[kPa\].
    pub exhaust_kpa: f64,
    /// Charge-pipe (boost) pressure, cycle mean \[kPa\]; ambient without a turbocharger.
    pub boost_kpa: f64,
    /// Exhaust-manifold temperature, present value \[K\].
    pub exhaust_k: f64,
    /// Exhaust gas temperature: manifold temperature weighted with the tailpipe flow over the cycle \[K\].
    pub egt_k: f64,
    /// Air flow, cycle mean \[g/s\].
    pub air_g_s: f64,
    /// Fuel flow 1.2e-4 INJ N \[kg/h\] (thesis eq. 7.11).
    pub fuel_kg_h: f64,
    /// Indicated mean effective pressure of the last cycles, gross \[bar\].
    pub imep_bar: f64,
    /// Pumping mean effective pressure \[bar\] (positive: loss).
    pub pmep_bar: f64,
    /// Friction mean effective pressure \[bar\].
    pub fmep_bar: f64,
    /// Peak pressure, mean of the four last cycles \[bar\].
    pub pmax_bar: f64,
    /// Angle of 50 % burned, mean of the four last cycles \[deg ATDC\].
    pub ca50_deg: f64,
    /// 10-90 % burn duration, mean \[deg\].
    pub burn_deg: f64,
    /// Residual fraction, mean \[-\].
    pub residual: f64,
    /// Volumetric efficiency against ambient air \[-\].
    pub volumetric_efficiency: f64,
    /// Brake specific fuel consumption \[g/kWh\]; infinite without brake power.
    #[serde(deserialize_with = "infinite_where_null")]
    pub bsfc_g_kwh: f64,
    /// Speed of the turbocharger \[rpm\]; 0 without one.
    pub turbo_rpm: f64,
    /// Share of the last cycle in which the compressor surged \[-\].
    pub surge: f64,
    /// Recirculated gas over recirculated gas and air \[-\].
    pub egr_rate: f64,
    /// Knock integral, the worst of the four last cycles \[-\]; 1 is the onset, 0 where it is not followed.
    pub knock: f64,
    /// Nitric oxide before the catalyst, mean of the last cycles, wet \[ppm\].
    pub no_ppm: f64,
    /// Carbon monoxide \[%\].
    pub co_pct: f64,
    /// Unburned fuel \[ppm C1\].
    pub hc_ppm: f64,
    /// Simulated time \[s\].
    pub time_s: f64,
}

/// JSON has no infinity and writes null for it.
fn infinite_where_null<'de, D: serde::Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    Ok(Option::<f64>::deserialize(from)?.unwrap_or(f64::INFINITY))
}

impl Outputs {
    pub(crate) fn new(p: &EngineParams, model: &Model, held: &Held, s: &EngineState, k: &Rates) -> Self {
        let mut cycle = Sums::default();
        s.half_turns.iter().for_each(|h| cycle.add(h));
        let mean = |x: f64, over: f64| if over > 0.0 { x / over } else { 0.0 };
        let [air, fuel, products] = [0, 1, 2].map(|i| s.gas.mass_kg[i][EXHAUST]);
        let lambda = model.gas.lambda(air, fuel, products);
        let or_now = |sums: &Sums| if sums.time_s > 0.0 { sums.lambda_s / sums.time_s } else { lambda };
        let per_cylinder = |f: &dyn Fn(&crate::state::CycleRecord) -> f64| {
            0.25 * s.cylinders.iter().map(|c| f(&c.last)).sum::<f64>()
        };
        let v_d = p.geometry.displacement_m3();
        let fmep_pa =
            held.friction_factor * p.friction.fmep_pa(s.peak_mean_pa, held.piston_speed, s.inputs.speed_rpm);
        let torque_cycle_nm = s.work_sum_j / (4.0 * PI) - fmep_pa * 4.0 * v_d / (4.0 * PI);
        let fuel_kg_h = 1.2e-4 * held.fuel_share * s.inputs.injection_mg * s.inputs.speed_rpm;
        let power_kw = 1e-3 * torque_cycle_nm * held.omega;
        let air_kg_s = mean(cycle.air_kg, cycle.time_s);
        let rho = p.ambient.pressure_pa / (p.gas.r_j_kg_k[0] * p.ambient.temperature_k);
        Self {
            torque_nm: s.torque_sensor_nm,
            torque_cycle_nm,
            torque_gas_nm: k.work.iter().sum::<f64>() / held.omega,
            lambda,
            lambda_interval: or_now(&s.interval),
            lambda_cycle: or_now(&cycle),
            map_kpa: 1e-3 * mean(cycle.map_pa_s, cycle.time_s),
            exhaust_kpa: 1e-3 * mean(cycle.exhaust_pa_s, cycle.time_s),
            boost_kpa: match p.turbocharger {
                Some(_) => 1e-3 * mean(cycle.pipe_pa_s, cycle.time_s),
                None => 1e-3 * p.ambient.pressure_pa,
            },
            exhaust_k: s.t_k[EXHAUST],
            egt_k: if cycle.exhaust_kg > 0.0 {
                cycle.exhaust_kg_k / cycle.exhaust_kg
            } else {
                s.t_k[EXHAUST]
            },
            air_g_s: 1e3 * air_kg_s,
            fuel_kg_h,
            imep_bar: 1e-5 * per_cylinder(&|c| c.gross_work_j) / v_d,
            pmep_bar: -1e-5 * per_cylinder(&|c| c.exchange_work_j) / v_d,
            fmep_bar: 1e-5 * fmep_pa,
            pmax_bar: 1e-5 * per_cylinder(&|c| c.peak_pa),
            ca50_deg: per_cylinder(&|c| c.ca_deg[1]),
            burn_deg: per_cylinder(&|c| c.ca_deg[2] - c.ca_deg[0]),
            residual: per_cylinder(&|c| c.residual),
            volumetric_efficiency: air_kg_s / (rho * 4.0 * v_d * held.deg_s / 720.0),
            bsfc_g_kwh: if power_kw > 0.0 { 1e3 * fuel_kg_h / power_kw } else { f64::INFINITY },
            turbo_rpm: s.gas.shaft_rad_s * 30.0 / PI,
            surge: mean(cycle.surge_s, cycle.time_s),
            egr_rate: mean(cycle.egr_kg, cycle.egr_kg + cycle.air_kg),
            knock: s.cylinders.iter().map(|c| c.last.knock).fold(0.0, f64::max),
            no_ppm: per_cylinder(&|c| c.emissions.no_ppm),
            co_pct: per_cylinder(&|c| c.emissions.co_pct),
            hc_ppm: per_cylinder(&|c| c.emissions.hc_ppm),
            time_s: s.time_s,
        }
    }
}
