//! An engine driven at measured boundary conditions: what a steady point of a bed is compared with.
//!
//! Given are speed, pressure and temperature before the throttle, intake pressure, lambda, and the air that the compressor
//! draws. Intake pressure is held by a reservoir behind an open throttle; fuel follows the air; the spark stands later than
//! the best one (50 % burned at [`BEST_CA50_DEG`]) by the retard of [`retard`]. With a turbocharger the shaft turns as fast
//! as the compressor needs for this flow and pressure, and the wastegate takes the gas that the turbine does not need:
//!
//! eta_m P_t(w, p_6, T_6, A_g) = P_c(w, m', p_1, p_2) + c_f w^2,   w from m'(w, p_2/p_1) = m',   0 <= A_g <= A_g,max.
//!
//! No state is slow then (shaft and charge pipe are given), so that a point stands still after some ten cycles. The wall of
//! the exhaust manifold, the valves, the burn and the turbine are those of the engine that runs freely.
//!
//! Not covered: the position of the throttle, which follows from the flow, and the pulses of the manifold behind a throttle
//! that is nearly closed, which the reservoir holds down (1.5 % of the air at 2000 rpm and 50 kPa).

pub mod retard;

use crate::combustion::Charge;
use crate::engine::VirtualEngine;
use crate::error::PlantError;
use crate::inputs::{Inputs, WASTEGATE_MM};
use crate::outputs::Outputs;
use crate::params::EngineParams;
use crate::state::{CATALYST, INTAKE, PIPE};
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;
use std::sync::Arc;

/// Angle of 50 % burned at best spark \[deg ATDC\] (7 to 10 deg: Klimstra, SAE 852090; Zhu et al. 2007).
pub const BEST_CA50_DEG: f64 = 8.0;

/// A measured point: what the engine is driven at.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Boundary {
    /// Speed \[rpm\].
    pub speed_rpm: f64,
    /// Pressure before the throttle \[Pa\].
    pub charge_pa: f64,
    /// Temperature before the throttle \[K\].
    pub charge_k: f64,
    /// Intake-manifold pressure \[Pa\].
    pub intake_pa: f64,
    /// Lambda \[-\].
    pub lambda: f64,
    /// Pressure of the air before the compressor and behind the tailpipe \[Pa\].
    pub ambient_pa: f64,
    /// Its temperature \[K\].
    pub ambient_k: f64,
    /// Spark \[deg BTDC\] where it was measured; otherwise best spark less the retard of the table.
    pub spark_deg: Option<f64>,
    /// Intake and exhaust opening points \[deg\] where they were measured; otherwise those of the engine's schedule.
    pub cams_deg: Option<[f64; 2]>,
}

/// What the engine answers.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Answer {
    /// Brake torque \[Nm\].
    pub torque_nm: f64,
    /// Air \[kg/s\].
    pub air_kg_s: f64,
    /// Exhaust-manifold temperature, weighted with the flow \[K\].
    pub exhaust_k: f64,
    /// Exhaust-manifold pressure \[Pa\].
    pub exhaust_pa: f64,
    /// Pressure behind the turbine \[Pa\].
    pub system_pa: f64,
    /// Shaft speed \[rpm\]; 0 without a turbocharger.
    pub turbo_rpm: f64,
    /// Spark \[deg BTDC\] and the retard from best spark in it \[deg\].
    pub spark_deg: f64,
    /// See `spark_deg`.
    pub retard_deg: f64,
    /// Wastegate \[mm\].
    pub wastegate_mm: f64,
    /// Power of the turbine less what the shaft needs, over that need \[-\]: below 0 with the wastegate shut, above with it
    /// open, where the pressure before the throttle is not one that this turbocharger makes.
    pub surplus: f64,
    /// Residual fraction \[-\].
    pub residual: f64,
    /// Friction and pumping \[bar\].
    pub loss_bar: f64,
    /// Inputs held.
    pub inputs: Inputs,
    /// Everything stood still.
    pub settled: bool,
}

/// Most cycles of a point.
const CYCLES: usize = 120;
/// Relative change from cycle to cycle below which a quantity stands still, and cycles for which it must.
const STILL: f64 = 5e-5;
const STILL_CYCLES: usize = 3;

/// Drives `engine` at a point; it keeps its state, so that a neighbour starts close.
///
/// # Errors
/// [`PlantError::Input`] for a speed outside the box, [`PlantError::Diverged`].
///
/// ```
/// use dynocal_plant::{driven::{Boundary, drive}, engine::VirtualEngine, params::EngineParams};
/// let mut engine = VirtualEngine::new(&EngineParams::named("gtdi_2l")?)?;
/// let at = Boundary {
///     speed_rpm: 2000.0, charge_pa: 150e3, charge_k: 310.0, intake_pa: 149e3, lambda: 1.0,
///     ambient_pa: 101e3, ambient_k: 298.0, spark_deg: None, cams_deg: None,
/// };
/// let y = drive(&mut engine, &at)?;
/// // Boost costs back pressure.
/// assert!(y.settled && y.exhaust_pa > y.system_pa && y.torque_nm > 150.0);
/// # Ok::<(), dynocal_plant::error::PlantError>(())
/// ```
pub fn drive(engine: &mut VirtualEngine, at: &Boundary) -> Result<Answer, PlantError> {
    engine.surround(at.ambient_pa, at.ambient_k);
    let mut d = Drive::new(engine, at)?;
    let mut still = 0;
    let mut settled = false;
    for _ in 0..CYCLES {
        engine.advance_angle(720.0);
        still = if d.cycle(engine)? { still + 1 } else { 0 };
        if still >= STILL_CYCLES {
            settled = true;
            break;
        }
    }
    engine.check_state()?;
    Ok(d.answer(engine, settled))
}

/// The loops around one point.
struct Drive<'a> {
    at: &'a Boundary,
    params: Arc<EngineParams>,
    u: Inputs,
    reservoir_pa: f64,
    retard_deg: f64,
    surplus: f64,
    turbine_before_j: f64,
    last: [f64; 4],
}

impl<'a> Drive<'a> {
    fn new(engine: &mut VirtualEngine, at: &'a Boundary) -> Result<Self, PlantError> {
        let params = Arc::clone(&engine.params);
        let cams = at.cams_deg.or_else(|| {
            let (intake, exhaust) = params.cams.as_ref()?.at(at.speed_rpm, 1e-3 * at.intake_pa);
            Some([intake, exhaust])
        });
        let before = engine.state().inputs;
        let mut u = Inputs {
            speed_rpm: at.speed_rpm,
            throttle_deg: 90.0,
            egr_mm: 0.0,
            wiebe_m: 2.0,
            burn_duration_deg: None,
            ..before
        };
        if let Some([intake, exhaust]) = cams {
            (u.intake_mop_deg_btdc, u.exhaust_mop_deg_atdc) = (intake, exhaust);
        }
        if let Some(spark) = at.spark_deg {
            u.spark_deg = spark;
        }
        // Fuel of a charge of 80 %, until the air is known.
        let charge_kg = 0.8 * at.intake_pa * params.geometry.displacement_m3() / (287.0 * at.charge_k);
        u.injection_mg = (1e6 * charge_kg / (params.gas.afr_stoich * at.lambda)).clamp(0.0, 120.0);
        engine.set_inputs(u)?;
        fill(engine, INTAKE, at.intake_pa, at.charge_k + 5.0, params.intake_manifold.volume_m3);
        let d = Self {
            at,
            u,
            reservoir_pa: at.intake_pa,
            retard_deg: 0.0,
            surplus: 0.0,
            turbine_before_j: engine.state().ledger.turbine_j,
            last: [0.0; 4],
            params,
        };
        d.reservoir(engine);
        Ok(d)
    }

    fn reservoir(&self, engine: &mut VirtualEngine) {
        fill(engine, PIPE, self.reservoir_pa, self.at.charge_k, self.params.charge_pipe_m3);
    }

    /// After a cycle: reservoir, fuel, spark, wastegate; whether everything stands still.
    fn cycle(&mut self, engine: &mut VirtualEngine) -> Result<bool, PlantError> {
        let y = engine.outputs();
        let cycle_s = 120.0 / self.at.speed_rpm;
        let off = self.at.intake_pa / (1e3 * y.map_kpa).max(1e3);
        self.reservoir_pa = (self.reservoir_pa * off.clamp(0.8, 1.25)).clamp(1e4, 5e5);
        self.reservoir(engine);
        let air_mg = 1e3 * y.air_g_s * cycle_s / 4.0;
        self.u.injection_mg = (air_mg / (self.params.gas.afr_stoich * self.at.lambda)).clamp(0.0, 120.0);
        self.spark(engine, &y);
        let balanced = self.shaft(engine, &y, cycle_s);
        engine.set_inputs(self.u)?;
        let now = [y.torque_cycle_nm + 100.0, y.air_g_s, y.exhaust_kpa, y.egt_k];
        let moved = now.iter().zip(&self.last).any(|(a, b)| (a - b).abs() > STILL * a.abs());
        self.last = now;
        Ok(balanced && !moved && (off - 1.0).abs() < 10.0 * STILL)
    }

    /// Best spark of the charge that the first cylinder has trapped, less the retard.
    fn spark(&mut self, engine: &VirtualEngine, y: &Outputs) {
        let v_d = self.params.displacement_m3();
        let bmep_bar = 4e-5 * PI * y.torque_cycle_nm / v_d;
        let goal = retard::deg(self.at.speed_rpm, bmep_bar);
        let Some(record) = engine.cycle_log().into_iter().next().filter(|r| r.trapped_kg > 0.0) else {
            return;
        };
        let charge = Charge {
            speed_rpm: self.at.speed_rpm,
            spark_deg: 0.0,
            wiebe_m: 2.0,
            duration_deg: None,
            trapped_kg: record.trapped_kg,
            residual: record.residual,
            lambda: record.lambda,
        };
        let best = best_spark_deg(&self.params, charge);
        if self.at.spark_deg.is_some() {
            self.retard_deg = best - self.u.spark_deg;
        } else {
            self.retard_deg += 0.5 * (goal - self.retard_deg);
            self.u.spark_deg = (best - self.retard_deg).clamp(-10.0, 55.0);
        }
    }

    /// Shaft speed from the compressor, wastegate from the balance of power; whether it is balanced or at an end.
    fn shaft(&mut self, engine: &mut VirtualEngine, y: &Outputs, cycle_s: f64) -> bool {
        let Some(turbo) = self.params.turbocharger else { return true };
        let at = self.at;
        let rho = at.ambient_pa / (self.params.gas.r_j_kg_k[0] * at.ambient_k);
        let run = |w: f64| turbo.compressor(w, at.charge_pa, at.ambient_pa, at.ambient_k, rho);
        let (mut low, mut high) = (turbo.least_rad_s, 30e3);
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            if run(middle).flow_kg_s < 1e-3 * y.air_g_s { low = middle } else { high = middle }
        }
        let w = 0.5 * (low + high);
        engine.state.gas.shaft_rad_s = w;
        let turbine_j = engine.state().ledger.turbine_j;
        let turbine_w = (turbine_j - self.turbine_before_j) / cycle_s;
        self.turbine_before_j = turbine_j;
        let need_w = (run(w).power_w + turbo.friction_w_s2 * w * w) / turbo.mechanical_efficiency;
        let ratio = (turbine_w / need_w.max(1.0)).clamp(0.02, 50.0);
        self.surplus = ratio - 1.0;
        // At equal flow the power goes with the third power of the area: pressure drop and enthalpy with its square.
        let gate = self.params.exhaust.wastegate_discharge;
        let area = |mm: f64| gate * 0.25 * PI * 1e-6 * mm * mm;
        let turbine_m2 = self.params.exhaust.turbine_m2;
        let wanted = (turbine_m2 + area(self.u.wastegate_mm)) * ratio.powf(0.3).clamp(0.7, 1.4) - turbine_m2;
        let mm = (wanted.max(0.0) / (gate * 0.25 * PI * 1e-6).max(1e-12)).sqrt().min(WASTEGATE_MM);
        let before = std::mem::replace(&mut self.u.wastegate_mm, mm);
        self.surplus.abs() < 20.0 * STILL || (before == mm && (mm == 0.0 || mm == WASTEGATE_MM))
    }

    fn answer(&self, engine: &VirtualEngine, settled: bool) -> Answer {
        let y = engine.outputs();
        Answer {
            torque_nm: y.torque_cycle_nm,
            air_kg_s: 1e-3 * y.air_g_s,
            exhaust_k: y.egt_k,
            exhaust_pa: 1e3 * y.exhaust_kpa,
            system_pa: engine.gas_state(CATALYST).p_pa,
            turbo_rpm: y.turbo_rpm,
            spark_deg: self.u.spark_deg,
            retard_deg: self.retard_deg,
            wastegate_mm: self.u.wastegate_mm,
            surplus: self.surplus,
            residual: y.residual,
            loss_bar: y.fmep_bar + y.pmep_bar,
            inputs: self.u,
            settled,
        }
    }
}

/// Air at a pressure and a temperature in a volume.
fn fill(engine: &mut VirtualEngine, volume: usize, p_pa: f64, t_k: f64, volume_m3: f64) {
    let mass = p_pa * volume_m3 / (engine.params().gas.r_j_kg_k[0] * t_k);
    engine.set_volume(volume, [mass, 0.0, 0.0], t_k);
}

/// Spark \[deg BTDC\] at which 50 % of a charge is burned at [`BEST_CA50_DEG`].
fn best_spark_deg(params: &EngineParams, charge: Charge) -> f64 {
    let (mut late, mut early) = (-10.0, 55.0);
    for _ in 0..40 {
        let spark_deg = 0.5 * (late + early);
        let wiebe = params.burn.wiebe(&Charge { spark_deg, ..charge }, &params.geometry);
        if wiebe.angle_of_fraction_deg(0.5) > BEST_CA50_DEG { late = spark_deg } else { early = spark_deg }
    }
    0.5 * (late + early)
}
