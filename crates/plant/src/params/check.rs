//! Ranges of the parameters: values that no engine has would only show later as a failed step.

use super::EngineParams;
use crate::error::PlantError;

/// A key, its value, the range it must lie in.
pub(crate) type Range = (&'static str, f64, f64, f64);

/// The first value outside its range (both ends allowed), or not finite.
pub(crate) fn first_outside(rows: &[Range]) -> Result<(), PlantError> {
    match rows.iter().find(|(_, v, low, high)| !(v.is_finite() && v >= low && v <= high)) {
        Some(&(name, found, low, high)) => Err(PlantError::ParameterRange { name, found, low, high }),
        None => Ok(()),
    }
}

impl EngineParams {
    /// Refuses values that no engine has.
    ///
    /// # Errors
    /// [`PlantError::ParameterRange`] or [`PlantError::Parameter`] naming the first offending value and its range.
    pub fn check(&self) -> Result<(), PlantError> {
        self.check_mechanics()?;
        self.check_gas()?;
        self.check_gas_path()?;
        self.check_combustion()?;
        self.check_boosted()?;
        self.check_stepping()
    }

    fn check_mechanics(&self) -> Result<(), PlantError> {
        let (g, f) = (&self.geometry, &self.friction);
        first_outside(&[
            ("geometry.bore_m", g.bore_m, 0.02, 0.5),
            ("geometry.stroke_m", g.stroke_m, 0.02, 0.5),
            ("geometry.pin_offset_m", g.pin_offset_m, -0.01, 0.01),
            ("geometry.conrod_m", g.conrod_m, 0.75 * g.stroke_m + g.pin_offset_m.abs(), 1.5),
            ("geometry.compression_ratio", g.compression_ratio, 3.0, 30.0),
            ("geometry.piston_area_m2", g.piston_area_m2, 0.0, 1.0),
            ("geometry.head_area_ratio", g.head_area_ratio, 0.0, 5.0),
            ("geometry.clearance_height_m", g.clearance_height_m, 0.0, 0.05),
            ("friction.constant_pa", f.constant_pa, 0.0, 5e5),
            ("friction.peak_share", f.peak_share, 0.0, 0.1),
            ("friction.linear_pa_s_m", f.linear_pa_s_m, 0.0, 1e5),
            ("friction.quadratic_pa_s2_m2", f.quadratic_pa_s2_m2, 0.0, 1e4),
            ("friction.boundary_pa", f.boundary_pa, 0.0, 1e5),
            ("torque_lag_s", self.torque_lag_s, 1e-4, 10.0),
        ])
    }

    /// Gas constants, and heat capacities over the temperatures of a cylinder.
    fn check_gas(&self) -> Result<(), PlantError> {
        for r in self.gas.r_j_kg_k {
            first_outside(&[("gas.r_j_kg_k", r, 20.0, 5e3)])?;
        }
        let refused = |found| PlantError::Parameter {
            name: "gas.u_j_kg",
            found,
            expected: "coefficients that give 0 at 298.15 K (within 1e5 J/kg) and a heat capacity of 200 to 20000 J/kg/K from 250 to 3300 K",
        };
        for c in &self.gas.u_j_kg {
            let power = |t: f64, k: usize| t.powi(i32::try_from(k).unwrap_or(0));
            let energy: f64 = c.iter().enumerate().map(|(k, c)| c * power(0.298_15, k)).sum();
            if !(energy.abs() <= 1e5) {
                return Err(refused(energy));
            }
            for step in 0..=61 {
                let t = 0.25 + 0.05 * f64::from(step);
                let slope = |(k, c): (usize, &f64)| k as f64 * c * power(t, k.saturating_sub(1));
                let capacity = c.iter().enumerate().map(slope).sum::<f64>() / 1e3;
                if !(200.0..=2e4).contains(&capacity) {
                    return Err(refused(capacity));
                }
            }
        }
        Ok(())
    }

    fn check_gas_path(&self) -> Result<(), PlantError> {
        let (i, e, c) = (&self.intake_manifold, &self.exhaust_manifold, &self.catalyst);
        let (iv, ev, x, t) = (&self.intake_valve, &self.exhaust_valve, &self.exhaust, &self.throttle);
        first_outside(&[
            ("ambient.pressure_pa", self.ambient.pressure_pa, 3e4, 1.2e5),
            ("ambient.temperature_k", self.ambient.temperature_k, 220.0, 340.0),
            ("gas.afr_stoich", self.gas.afr_stoich, 5.0, 40.0),
            ("gas.lhv_j_kg", self.gas.lhv_j_kg, 1e7, 1.3e8),
            ("gas.latent_j_kg", self.gas.latent_j_kg, 0.0, 2e6),
            ("throttle.diameter0_m", t.diameter0_m, 1e-15, 0.1),
            ("throttle.slope_m_per_deg", t.slope_m_per_deg, 0.0, 0.01),
            ("throttle.discharge", t.discharge, 0.0, 1.0),
            ("intake_valve.duration_deg", iv.duration_deg, 100.0, 720.0),
            ("intake_valve.lift_m", iv.lift_m, 0.0, 0.05),
            ("intake_valve.head_m", iv.head_m, 0.005, 0.2),
            ("intake_valve.count", iv.count, 0.0, 4.0),
            ("intake_valve.flow_coefficient", iv.flow_coefficient, 0.0, 1.0),
            ("intake_valve.lift_slope", iv.lift_slope, 0.0, 20.0),
            ("exhaust_valve.duration_deg", ev.duration_deg, 100.0, 720.0),
            ("exhaust_valve.lift_m", ev.lift_m, 0.0, 0.05),
            ("exhaust_valve.head_m", ev.head_m, 0.005, 0.2),
            ("exhaust_valve.count", ev.count, 0.0, 4.0),
            ("exhaust_valve.flow_coefficient", ev.flow_coefficient, 0.0, 1.0),
            ("exhaust_valve.lift_slope", ev.lift_slope, 0.0, 20.0),
            ("charge_pipe_m3", self.charge_pipe_m3, 1e-4, 0.1),
            ("intake_manifold.volume_m3", i.volume_m3, 1e-4, 0.1),
            ("intake_manifold.ua_w_k", i.ua_w_k, 0.0, 1e3),
            ("intake_manifold.wall_k", i.wall_k, 220.0, 600.0),
            ("exhaust_manifold.volume_m3", e.volume_m3, 1e-4, 0.1),
            ("exhaust_manifold.ua_w_k", e.ua_w_k, 0.0, 1e3),
            ("exhaust_manifold.wall_k", e.wall_k, 220.0, 1300.0),
            ("catalyst.volume_m3", c.volume_m3, 1e-4, 0.1),
            ("catalyst.ua_w_k", c.ua_w_k, 0.0, 1e3),
            ("catalyst.wall_k", c.wall_k, 220.0, 1300.0),
            ("exhaust.turbine_m2", x.turbine_m2, 0.0, 0.05),
            ("exhaust.wastegate_discharge", x.wastegate_discharge, 0.0, 1.0),
            ("exhaust.tailpipe_m2", x.tailpipe_m2, 1e-45, 0.05),
            ("injection.rate_kg_s", self.injection.rate_kg_s, 1e-4, 1.0),
            ("injection.evaporation_s", self.injection.evaporation_s, 1e-4, 1.0),
            ("injection.charge_share", self.injection.charge_share, 0.0, 1.0),
        ])?;
        if let Some(w) = &self.exhaust_wall {
            first_outside(&[
                ("exhaust_wall.port_w_k", w.port_w_k, 0.0, 1e3),
                ("exhaust_wall.port_k", w.port_k, 220.0, 1000.0),
                ("exhaust_wall.manifold_w_k", w.manifold_w_k, 0.0, 1e3),
                ("exhaust_wall.manifold_j_k", w.manifold_j_k, 10.0, 1e5),
                ("exhaust_wall.ambient_w_k", w.ambient_w_k, 0.0, 1e3),
                ("exhaust_wall.reference_kg_s", w.reference_kg_s, 1e-4, 10.0),
                ("exhaust_wall.flow_exponent", w.flow_exponent, 0.0, 1.5),
            ])?;
        }
        match &self.port {
            Some(f) => {
                first_outside(&[("port.share", f.share, 0.0, 1.0), ("port.tau_s", f.tau_s, 1e-4, 100.0)])
            }
            None => Ok(()),
        }
    }

    fn check_combustion(&self) -> Result<(), PlantError> {
        let (b, h) = (&self.burn, &self.heat);
        first_outside(&[
            ("burn.duration_deg", b.duration_deg, 2.0, 150.0),
            ("burn.delay_deg", b.delay_deg, 0.0, 60.0),
            ("burn.speed_exponent", b.speed_exponent, -2.0, 2.0),
            ("burn.residual_exponent", b.residual_exponent, 0.0, 3.0),
            ("burn.mass_exponent", b.mass_exponent, -2.0, 2.0),
            ("burn.lambda_exponent", b.lambda_exponent, 0.0, 3.0),
            ("burn.late_weight", b.late_weight, 0.0, 2.0),
            ("burn.early_weight", b.early_weight, 0.0, 2.0),
            ("burn.efficiency", b.efficiency, 0.0, 1.0),
            ("burn.efficiency_bump", b.efficiency_bump, 0.0, 1.0 - b.efficiency.clamp(0.0, 1.0)),
            ("burn.lean_limit_lambda", b.lean_limit_lambda, 1.0, 10.0),
            ("burn.lean_width_lambda", b.lean_width_lambda, 0.001, 5.0),
            ("burn.end_deg", b.end_deg, 60.0, 180.0),
            ("burn.dilution.limit", b.dilution.map_or(0.5, |d| d.limit), 0.05, 2.0),
            ("burn.dilution.width", b.dilution.map_or(0.5, |d| d.width), 1e-3, 1.0),
            ("burn.state_exponent", b.state_exponent, 0.0, 2.0),
            ("burn.tail_share", b.tail_share, 0.0, 0.9),
            ("heat.scale", h.scale, 0.0, 5.0),
            ("heat.wall_k", h.wall_k, 220.0, 800.0),
            ("heat.coolant.temperature_k", h.coolant.map_or(300.0, |c| c.temperature_k), 220.0, 500.0),
            ("heat.coolant.conductance_w_k", h.coolant.map_or(100.0, |c| c.conductance_w_k), 10.0, 1e5),
        ])
    }

    fn check_boosted(&self) -> Result<(), PlantError> {
        if let Some(t) = &self.turbocharger {
            first_outside(&[
                ("turbocharger.compressor_m", t.compressor_m, 0.01, 0.3),
                ("turbocharger.flow_coefficient", t.flow_coefficient, 0.01, 0.5),
                ("turbocharger.choke_mach", t.choke_mach, 0.5, 3.0),
                ("turbocharger.head_coefficient", t.head_coefficient[0], 0.2, 3.0),
                ("turbocharger.head_coefficient", t.head_coefficient[1], -1.0, 1.0),
                ("turbocharger.choke_head", t.choke_head[0], 0.0, 0.95),
                ("turbocharger.choke_head", t.choke_head[1], 0.0, 1.0),
                ("turbocharger.surge_share", t.surge_share[0], 0.0, 1.0),
                ("turbocharger.surge_share", t.surge_share[1], -2.0, 2.0),
                ("turbocharger.surge_share", t.surge_share[2], 0.0, 2.0),
                ("turbocharger.work_coefficient", t.work_coefficient[0], 0.3, 2.0),
                ("turbocharger.work_coefficient", t.work_coefficient[1], 0.0, t.work_coefficient[0]),
                ("turbocharger.turbine_m", t.turbine_m, 0.01, 0.3),
                ("turbocharger.turbine_exponent", t.turbine_exponent, 0.2, 5.0),
                ("turbocharger.turbine_efficiency", t.turbine_efficiency, 0.1, 1.0),
                ("turbocharger.best_speed_ratio", t.best_speed_ratio, 0.2, 1.5),
                ("turbocharger.mechanical_efficiency", t.mechanical_efficiency, 0.1, 1.0),
                ("turbocharger.friction_w_s2", t.friction_w_s2, 0.0, 1e-3),
                ("turbocharger.inertia_kg_m2", t.inertia_kg_m2, 1e-7, 1e-2),
                ("turbocharger.cooling", t.cooling, 0.0, 1.0),
                ("turbocharger.cooler_w_k", t.cooler_w_k, 0.0, 1e5),
                ("turbocharger.least_rad_s", t.least_rad_s, 10.0, 5000.0),
                ("turbocharger.flap_preload_pa", t.flap_preload_pa, 0.0, 1e7),
                ("turbocharger.flap_range_pa", t.flap_range_pa, 1e4, 1e7),
            ])?;
        }
        if let Some(e) = &self.egr {
            first_outside(&[
                ("egr.discharge", e.discharge, 0.0, 1.0),
                ("egr.cooling", e.cooling, 0.0, 1.0),
                ("egr.coolant_k", e.coolant_k, 220.0, 500.0),
            ])?;
        }
        if let Some(k) = &self.knock {
            first_outside(&[
                ("knock.octane", k.octane, 60.0, 130.0),
                ("knock.delay_factor", k.delay_factor, 0.05, 20.0),
                ("knock.oxygen_exponent", k.oxygen_exponent, 0.0, 5.0),
                ("knock.fuel_exponent", k.fuel_exponent, 0.0, 5.0),
                ("knock.wall_share", k.wall_share, 0.0, 5.0),
            ])?;
        }
        if let Some(b) = &self.burned_energy {
            first_outside(&[
                ("burned_energy.dissociation", b.dissociation, 0.0, 2.0),
                ("burned_energy.bound_j_kg", b.bound_j_kg, 0.0, 2e7),
            ])?;
        }
        if let Some(e) = &self.emissions {
            first_outside(&[
                ("emissions.crevice_share", e.crevice_share, 0.0, 0.2),
                ("emissions.unmixed_share", e.unmixed_share, 0.0, 0.5),
                ("emissions.no_factor", e.no_factor, 0.0, 10.0),
            ])?;
            if let Some(h) = &e.hydrocarbons {
                first_outside(&[
                    ("emissions.hydrocarbons.crevice_m3", h.crevice_m3, 0.0, 1e-4),
                    ("emissions.hydrocarbons.oil_share", h.oil_share, 0.0, 5.0),
                    ("emissions.hydrocarbons.survival", h.survival, 0.0, 1.0),
                    ("emissions.hydrocarbons.retained", h.retained, 0.0, 10.0),
                ])?;
            }
        }
        if let Some(s) = self.cams.as_ref().and_then(|c| c.shift) {
            first_outside(&[
                ("cams.shift.intake_deg", s.intake_deg, -60.0, 60.0),
                ("cams.shift.exhaust_deg", s.exhaust_deg, -60.0, 60.0),
                ("cams.shift.intake_bell_deg", s.intake_bell_deg, -60.0, 60.0),
                ("cams.shift.exhaust_bell_deg", s.exhaust_bell_deg, -60.0, 60.0),
                ("cams.shift.summit_kpa", s.summit_kpa, 0.0, 1000.0),
                ("cams.shift.summit_rpm", s.summit_rpm, 0.0, 20e3),
                ("cams.shift.width_kpa", s.width_kpa, 1.0, 1000.0),
                ("cams.shift.width_rpm", s.width_rpm, 10.0, 20e3),
                ("cams.shift.bell_power", s.bell_power, 1.0, 16.0),
                ("cams.shift.bell_speed", s.bell_speed, 0.0, 4.0),
                ("cams.shift.boost_deg", s.boost_deg, -60.0, 60.0),
                ("cams.shift.boost_exhaust", s.boost_exhaust, -2.0, 2.0),
                ("cams.shift.boost_width_rpm", s.boost_width_rpm.unwrap_or(s.width_rpm), 10.0, 20e3),
                ("cams.shift.boost_kpa", s.boost_kpa, 0.0, 1000.0),
                ("cams.shift.boost_width_kpa", s.boost_width_kpa, 0.5, 1000.0),
                ("cams.shift.boost_rpm", s.boost_rpm, 0.0, 20e3),
            ])?;
        }
        match &self.cams {
            Some(c) if !c.fits() => Err(PlantError::Parameter {
                name: "cams.speed_rpm",
                found: c.speed_rpm.len() as f64,
                expected: "two or more speeds rising within 0 to 20000 rpm, each list as long, positions of 180 to 300 deg, pressures (light, part, full) rising within 0 to 1000 kPa",
            }),
            _ => Ok(()),
        }
    }

    fn check_stepping(&self) -> Result<(), PlantError> {
        let s = &self.stepping;
        first_outside(&[("stepping.max_step_s", s.max_step_s, 1e-7, 1e-2)])?;
        // Steps are powers of two of a cell, so that a longer step always finds the grid of a shorter one.
        let (cells, fixed) = (s.cells_per_deg, s.fixed_cells);
        let refuse = |name, found: usize, expected: &'static str| {
            Err(PlantError::Parameter { name, found: found as f64, expected })
        };
        if !(cells <= 16 && cells.is_power_of_two()) {
            return refuse("stepping.cells_per_deg", cells, "1, 2, 4, 8 or 16");
        }
        if fixed > 4 * cells || (fixed > 0 && !fixed.is_power_of_two()) {
            return refuse("stepping.fixed_cells", fixed, "0 or a power of two, at most 4 deg");
        }
        Ok(())
    }
}
