//! Every constant of the engine, with unit and source. The values lie in `parameters/*.toml`.
//!
//! Source tags: \[T\] thesis, \[C\] calibrated against the thesis, \[L\] literature, \[H\] textbook value
//! (Heywood class), \[A\] engineering assumption.

mod check;
pub mod perturb;
mod sets;

pub use sets::{LIKE_A_SET, PARAMETER_SETS, ParameterSet};

use crate::cams::CamSchedule;
use crate::combustion::BurnModel;
use crate::dissociation::BurnedEnergy;
use crate::egr::EgrPath;
use crate::emissions::EmissionsModel;
use crate::end_gas::KnockModel;
use crate::exhaust_wall::ExhaustWall;
use crate::film::FilmModel;
use crate::gas::GasModel;
use crate::geometry::Geometry;
use crate::heat::HeatLaw;
use crate::turbocharger::Turbocharger;
use serde::{Deserialize, Serialize};

/// Ambient air.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ambient {
    /// Pressure \[Pa\].
    pub pressure_pa: f64,
    /// Temperature \[K\].
    pub temperature_k: f64,
}

/// Throttle: diameter d = d0 + k theta.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Throttle {
    /// Diameter at angle 0 \[m\] \[C\].
    pub diameter0_m: f64,
    /// Slope \[m/deg\] \[C\].
    pub slope_m_per_deg: f64,
    /// Discharge coefficient \[-\] \[C\].
    pub discharge: f64,
}

impl Throttle {
    /// Effective area \[m2\] at `angle_deg`.
    pub fn area_m2(&self, angle_deg: f64) -> f64 {
        let d = self.diameter0_m + self.slope_m_per_deg * angle_deg;
        self.discharge * 0.25 * std::f64::consts::PI * d * d
    }
}

/// One kind of poppet valve: l = l_max (1 - z^2)^1.5, z = (angle - MOP)/(duration/2).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Valve {
    /// Opening duration \[deg crank\] \[A\].
    pub duration_deg: f64,
    /// Maximum lift \[m\] \[A\]; 0 keeps the valve shut.
    pub lift_m: f64,
    /// Head diameter \[m\] \[A\].
    pub head_m: f64,
    /// Valves per cylinder.
    pub count: f64,
    /// C_f = flow_coefficient tanh(lift_slope l/D) on the head area \[H\].
    pub flow_coefficient: f64,
    /// Slope inside the tanh \[-\] \[H\].
    pub lift_slope: f64,
}

impl Valve {
    /// Effective area of all valves of this kind of one cylinder \[m2\]; `from_mop_deg` is the
    /// crank angle relative to the maximum opening point.
    pub fn area_m2(&self, from_mop_deg: f64) -> f64 {
        let z = from_mop_deg / (0.5 * self.duration_deg);
        if z.abs() >= 1.0 {
            return 0.0;
        }
        let lift = self.lift_m * (1.0 - z * z).powf(1.5);
        let head_area = 0.25 * std::f64::consts::PI * self.head_m * self.head_m;
        self.count * head_area * self.flow_coefficient * (self.lift_slope * lift / self.head_m).tanh()
    }
}

/// A manifold volume with heat exchange UA (T - T_wall).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifold {
    /// Volume \[m3\].
    pub volume_m3: f64,
    /// Heat conductance UA \[W/K\].
    pub ua_w_k: f64,
    /// Wall temperature \[K\].
    pub wall_k: f64,
}

/// Exhaust restrictions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Exhaust {
    /// Turbine effective area \[m2\] \[A\].
    pub turbine_m2: f64,
    /// Discharge coefficient of the wastegate orifice \[-\] \[A\].
    pub wastegate_discharge: f64,
    /// Tailpipe effective area \[m2\] \[A\].
    pub tailpipe_m2: f64,
}

/// Direct injection.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Injection {
    /// Injector rate \[kg/s\] (10 mg/ms) \[A\].
    pub rate_kg_s: f64,
    /// Time constant of evaporation \[s\] \[A\].
    pub evaporation_s: f64,
    /// Share of the latent heat taken from the charge \[-\] \[A\].
    pub charge_share: f64,
}

/// Walls of the cylinders that are at rest with the gas, T_w = T_c + Q/UA, Q the heat of all cylinders, mean of a cycle.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Coolant {
    /// Temperature T_c \[K\].
    pub temperature_k: f64,
    /// Conductance UA between the walls of all cylinders and coolant and oil \[W/K\].
    pub conductance_w_k: f64,
}

/// Heat transfer in the cylinder \[L/C\].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HeatTransfer {
    /// Multiplier of the whole correlation \[-\] \[C\]; 0 makes the cylinder adiabatic.
    pub scale: f64,
    /// Wall temperature \[K\] \[A\].
    pub wall_k: f64,
    /// What cools the walls; absent, they stand at `wall_k`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub coolant: Option<Coolant>,
    /// Correlation.
    #[serde(default)]
    pub law: HeatLaw,
}

/// Chen-Flynn friction FMEP = a + b p_max + c c_m + d c_m^2 \[C\], with boundary lubrication e (1 + 500 rpm/N) where e is given: rings and valve
/// train touch at low speed. Form of that term after Patton, Nitschke and Heywood (SAE 890836) as revised by Sandoval and Heywood (SAE
/// 2003-01-0725), cited from memory.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Friction {
    /// Constant \[Pa\].
    pub constant_pa: f64,
    /// Share of the peak pressure \[-\].
    pub peak_share: f64,
    /// Linear in the mean piston speed \[Pa s/m\].
    pub linear_pa_s_m: f64,
    /// Quadratic \[Pa s2/m2\].
    pub quadratic_pa_s2_m2: f64,
    /// Boundary lubrication e \[Pa\]; 0 leaves it out.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub boundary_pa: f64,
}

/// Speed of the term of boundary lubrication \[rpm\], and the least at which it is read: below, no engine runs.
const BOUNDARY_RPM: f64 = 500.0;
const LEAST_RPM: f64 = 100.0;

// The signature is serde's.
#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde calls it with a reference")]
fn is_zero(x: &f64) -> bool {
    *x == 0.0
}

impl Friction {
    /// FMEP \[Pa\] at a mean piston speed \[m/s\] and an engine speed \[rpm\].
    pub fn fmep_pa(&self, peak_pa: f64, piston_speed_m_s: f64, speed_rpm: f64) -> f64 {
        let hydrodynamic = self.constant_pa
            + self.peak_share * peak_pa
            + piston_speed_m_s * (self.linear_pa_s_m + piston_speed_m_s * self.quadratic_pa_s2_m2);
        if self.boundary_pa == 0.0 {
            return hydrodynamic;
        }
        hydrodynamic + self.boundary_pa * (1.0 + BOUNDARY_RPM / speed_rpm.max(LEAST_RPM))
    }
}

/// Crank-angle step.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stepping {
    /// Cells of the crank-angle grid per degree (finest step = 1/cells_per_deg).
    pub cells_per_deg: usize,
    /// Fixed step in cells; 0 chooses 0.5, 1 or 2 deg from speed such that dt <= `max_step_s`.
    pub fixed_cells: usize,
    /// Longest time step \[s\] of the automatic choice (stiffness of open valves).
    pub max_step_s: f64,
}

/// All constants of one engine. Units are SI unless the name says otherwise.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EngineParams {
    /// Crank-slider geometry.
    pub geometry: Geometry,
    /// Gas properties.
    pub gas: GasModel,
    /// Ambient air.
    pub ambient: Ambient,
    /// Throttle.
    pub throttle: Throttle,
    /// Intake valves.
    pub intake_valve: Valve,
    /// Exhaust valves.
    pub exhaust_valve: Valve,
    /// Charge pipe volume \[m3\] \[A\]; held at ambient while the turbocharger is off.
    pub charge_pipe_m3: f64,
    /// Intake manifold \[C by throttle rise time\].
    pub intake_manifold: Manifold,
    /// Exhaust manifold \[A\].
    pub exhaust_manifold: Manifold,
    /// Ports and manifold apart, in place of `ua_w_k` and `wall_k` of the exhaust manifold.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exhaust_wall: Option<ExhaustWall>,
    /// Catalyst \[A\].
    pub catalyst: Manifold,
    /// Exhaust restrictions.
    pub exhaust: Exhaust,
    /// Injection into the cylinder: rate and evaporation (with `port`: of what is inducted).
    pub injection: Injection,
    /// Fuel film of port injection; absent with direct injection.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub port: Option<FilmModel>,
    /// Combustion.
    pub burn: BurnModel,
    /// Turbocharger; absent, the charge pipe stands at ambient state.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub turbocharger: Option<Turbocharger>,
    /// External exhaust-gas recirculation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub egr: Option<EgrPath>,
    /// Knock integral.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub knock: Option<KnockModel>,
    /// Dissociation and rich mixture; absent, burned gas is frozen.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub burned_energy: Option<BurnedEnergy>,
    /// Engine-out emissions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub emissions: Option<EmissionsModel>,
    /// Cam positions of the engine controller.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cams: Option<CamSchedule>,
    /// Heat transfer in the cylinder.
    pub heat: HeatTransfer,
    /// Friction.
    pub friction: Friction,
    /// Lag of the torque sensor tau_T \[s\] \[C from the spark rise time 0.36 s\].
    pub torque_lag_s: f64,
    /// Crank-angle step.
    pub stepping: Stepping,
}

impl EngineParams {
    /// The thesis engine (2.0 l, four cylinders, turbocharger off, *thesis mode* of combustion): `parameters/thesis.toml`.
    ///
    /// # Panics
    /// Never: the embedded text is read by the tests.
    pub fn thesis() -> Self {
        Self::named("thesis").expect("the embedded parameter set is valid")
    }

    /// What an input or output of an engine needs and this one lacks, by the name that tables, beds and pages give it; none where it has it. Its
    /// value would be a zero that nothing computed, or an input that nothing feels.
    ///
    /// ```
    /// use dynocal_plant::params::EngineParams;
    /// assert_eq!(EngineParams::thesis().lacks("knock"), Some("knock model"));
    /// assert_eq!(EngineParams::named("gtdi_2l")?.lacks("knock"), None);
    /// # Ok::<(), dynocal_plant::error::PlantError>(())
    /// ```
    pub fn lacks(&self, name: &str) -> Option<&'static str> {
        match name {
            "knock" if self.knock.is_none() => Some("knock model"),
            "no" | "co" | "hc" if self.emissions.is_none() => Some("model of emissions"),
            "turbo" | "turbo_speed" | "surge" | "wastegate" | "wastegate_bore"
                if self.turbocharger.is_none() =>
            {
                Some("turbocharger")
            }
            "egr" | "egr_rate" if self.egr.is_none() => Some("exhaust-gas recirculation"),
            _ => None,
        }
    }

    /// Displacement of the whole engine \[m3\].
    pub fn displacement_m3(&self) -> f64 {
        4.0 * self.geometry.displacement_m3()
    }
}
