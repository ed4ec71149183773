//! Every constant of the engine, with unit and source.
//!
//! Source tags: \[T\] thesis, \[C\] calibrated against the thesis, \[L\] literature, \[H\] textbook value
//! (Heywood class), \[A\] engineering assumption.

use crate::combustion::BurnModel;
use crate::error::PlantError;
use crate::gas::GasModel;
use crate::geometry::Geometry;
use crate::testbed::film::FilmModel;
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

/// Woschni heat transfer in the cylinder \[L/C\].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HeatTransfer {
    /// Multiplier of the whole correlation \[-\] \[C\]; 0 makes the cylinder adiabatic.
    pub scale: f64,
    /// Wall temperature \[K\] \[A\].
    pub wall_k: f64,
}

/// Chen-Flynn friction FMEP = a + b p_max + c c_m + d c_m^2 \[C\].
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
}

impl Friction {
    /// FMEP \[Pa\].
    pub fn fmep_pa(&self, peak_pa: f64, piston_speed_m_s: f64) -> f64 {
        self.constant_pa
            + self.peak_share * peak_pa
            + piston_speed_m_s * (self.linear_pa_s_m + piston_speed_m_s * self.quadratic_pa_s2_m2)
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
    /// The thesis engine (2.0 l, four cylinders, turbocharger off, *thesis mode* of combustion).
    pub fn thesis() -> Self {
        let valve = |duration_deg, lift_m, head_m| Valve {
            duration_deg,
            lift_m,
            head_m,
            count: 2.0,
            flow_coefficient: 0.60,
            lift_slope: 5.6,
        };
        Self {
            geometry: Geometry::thesis(),
            gas: GasModel::gasoline(),
            ambient: Ambient { pressure_pa: 101_325.0, temperature_k: 298.15 },
            throttle: Throttle { diameter0_m: 0.0027, slope_m_per_deg: 0.000_455, discharge: 0.90 },
            intake_valve: valve(248.0, 0.0086, 0.0325),
            exhaust_valve: valve(240.0, 0.0084, 0.0285),
            charge_pipe_m3: 0.006,
            intake_manifold: Manifold { volume_m3: 0.0045, ua_w_k: 4.0, wall_k: 318.0 },
            exhaust_manifold: Manifold { volume_m3: 0.002, ua_w_k: 10.0, wall_k: 550.0 },
            catalyst: Manifold { volume_m3: 0.005, ua_w_k: 8.0, wall_k: 600.0 },
            exhaust: Exhaust { turbine_m2: 330e-6, wastegate_discharge: 0.65, tailpipe_m2: 900e-6 },
            port: None,
            injection: Injection { rate_kg_s: 0.01, evaporation_s: 0.002, charge_share: 0.8 },
            burn: BurnModel::thesis(),
            heat: HeatTransfer { scale: 0.90, wall_k: 440.0 },
            friction: Friction {
                constant_pa: 8000.0,
                peak_share: 0.004,
                linear_pa_s_m: 5000.0,
                quadratic_pa_s2_m2: 90.0,
            },
            torque_lag_s: 0.15,
            stepping: Stepping { cells_per_deg: 2, fixed_cells: 0, max_step_s: 85e-6 },
        }
    }

    /// Read a parameter set from TOML text.
    ///
    /// # Errors
    /// [`PlantError::Toml`] for text that does not fit, [`PlantError::Parameter`] for values out of range.
    ///
    /// ```
    /// use dynocal_plant::params::EngineParams;
    /// let p = EngineParams::thesis();
    /// let back = EngineParams::from_toml(&p.to_toml()).unwrap();
    /// assert_eq!(p, back);
    /// ```
    pub fn from_toml(text: &str) -> Result<Self, PlantError> {
        let p: Self = toml::from_str(text).map_err(|e| PlantError::Toml(Box::new(e)))?;
        p.check()?;
        Ok(p)
    }

    /// The parameter set as TOML text.
    pub fn to_toml(&self) -> String {
        // Plain numbers in plain tables always serialise; an empty text would fail to parse back.
        toml::to_string_pretty(self).unwrap_or_default()
    }

    /// Displacement of the whole engine \[m3\].
    pub fn displacement_m3(&self) -> f64 {
        4.0 * self.geometry.displacement_m3()
    }

    /// Refuse values that no engine has (they would only show later as a failed step).
    ///
    /// # Errors
    /// [`PlantError::Parameter`] naming the first offending value.
    pub fn check(&self) -> Result<(), PlantError> {
        let g = &self.geometry;
        let positive: [(&'static str, f64); 19] = [
            ("geometry.bore_m", g.bore_m),
            ("geometry.stroke_m", g.stroke_m),
            ("geometry.compression_ratio", g.compression_ratio - 1.0),
            ("geometry.conrod_m", g.conrod_m - 0.5 * g.stroke_m - g.pin_offset_m.abs()),
            ("gas.afr_stoich", self.gas.afr_stoich),
            ("gas.lhv_j_kg", self.gas.lhv_j_kg),
            ("ambient.pressure_pa", self.ambient.pressure_pa),
            ("ambient.temperature_k", self.ambient.temperature_k),
            ("throttle.diameter0_m", self.throttle.diameter0_m),
            ("intake_manifold.volume_m3", self.intake_manifold.volume_m3),
            ("exhaust_manifold.volume_m3", self.exhaust_manifold.volume_m3),
            ("catalyst.volume_m3", self.catalyst.volume_m3),
            ("charge_pipe_m3", self.charge_pipe_m3),
            ("exhaust.tailpipe_m2", self.exhaust.tailpipe_m2),
            ("injection.rate_kg_s", self.injection.rate_kg_s),
            ("injection.evaporation_s", self.injection.evaporation_s),
            ("burn.duration_deg", self.burn.duration_deg),
            ("torque_lag_s", self.torque_lag_s),
            ("stepping.max_step_s", self.stepping.max_step_s),
        ];
        for (name, found) in positive {
            if !(found.is_finite() && found > 0.0) {
                return Err(PlantError::Parameter {
                    name,
                    found,
                    expected: "a finite positive (margin) value",
                });
            }
        }
        for (name, v) in [
            ("intake_valve.duration_deg", &self.intake_valve),
            ("exhaust_valve.duration_deg", &self.exhaust_valve),
        ] {
            if !(v.duration_deg > 0.0 && v.duration_deg <= 720.0 && v.lift_m >= 0.0 && v.head_m > 0.0) {
                return Err(PlantError::Parameter {
                    name,
                    found: v.duration_deg,
                    expected: "0..720 deg, lift >= 0, head > 0",
                });
            }
        }
        if let Some(port) = &self.port
            && !((0.0..=1.0).contains(&port.share) && port.tau_s > 0.0)
        {
            let expected = "a share of 0..1 and a positive time constant";
            return Err(PlantError::Parameter { name: "port.share", found: port.share, expected });
        }
        // Steps are powers of two of a cell, so that a longer step always finds the grid of a shorter one.
        let (cells, fixed) = (self.stepping.cells_per_deg, self.stepping.fixed_cells);
        if !(cells <= 16 && cells.is_power_of_two()) {
            let expected = "1, 2, 4, 8 or 16";
            return Err(PlantError::Parameter {
                name: "stepping.cells_per_deg",
                found: cells as f64,
                expected,
            });
        }
        if fixed > 4 * cells || (fixed > 0 && !fixed.is_power_of_two()) {
            let expected = "0 or a power of two, at most 4 deg";
            return Err(PlantError::Parameter {
                name: "stepping.fixed_cells",
                found: fixed as f64,
                expected,
            });
        }
        Ok(())
    }
}
