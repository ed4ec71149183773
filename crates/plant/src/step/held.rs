//! What follows from inputs, deviations and the last cycle, and holds until they change.

use crate::deviations::Deviations;
use crate::grid::Grid;
use crate::inputs::Inputs;
use crate::params::{Coolant, EngineParams};
use crate::state::Means;

/// Rate at which a volume V and its neighbour level out through an area A, over A/V \[m/s\]: 11.5 g sqrt(R T) (slope of
/// Psi near equal pressures) for hot gas. The explicit midpoint rule is stable up to 2 over the rate.
const OVERLAP_M_S: f64 = 7900.0;

/// Quantities that only change with the inputs.
#[derive(Debug, Clone, Default)]
pub(crate) struct Held {
    /// Crank speed \[rad/s\] and \[deg/s\].
    pub(crate) omega: f64,
    pub(crate) deg_s: f64,
    /// Wanted step \[cells\].
    pub(crate) step_cells: usize,
    pub(crate) throttle_m2: f64,
    /// Half of the inverse step \[1/s\]: no rate may use up a species within a step.
    pub(crate) half_per_step: f64,
    /// Heat of the exhaust manifold: conductance \[W/K\] and temperature at which it ends \[K\].
    pub(crate) exhaust_heat: (f64, f64),
    pub(crate) turbine_m2: f64,
    /// Of that the wastegate.
    pub(crate) wastegate_m2: f64,
    pub(crate) egr_m2: f64,
    /// Whole half cells and the rest of the shift of each cam.
    pub(crate) intake_shift: (usize, f64),
    pub(crate) exhaust_shift: (usize, f64),
    pub(crate) gas_exchange_w: f64,
    pub(crate) closed_w: f64,
    pub(crate) piston_speed: f64,
    /// Share of the torque error that the sensor makes up per cell.
    pub(crate) lag_per_cell: f64,
    pub(crate) cylinder_wall_k: f64,
    pub(crate) friction_factor: f64,
    /// Fuel that all cylinders get over the demand \[-\].
    pub(crate) fuel_share: f64,
}

impl Held {
    pub(crate) fn new(p: &EngineParams, grid: &Grid, u: &Inputs, d: &Deviations, means: &Means) -> Self {
        let deg_s = 6.0 * u.speed_rpm;
        let intake_shift = grid.valve_shift(720.0 - u.intake_mop_deg_btdc);
        let exhaust_shift = grid.valve_shift(u.exhaust_mop_deg_atdc);
        let s = &p.stepping;
        let step_cells = if s.fixed_cells > 0 {
            s.fixed_cells
        } else {
            // Largest step that keeps dt below the stability limit of open valves, and of both valves in overlap.
            let overlap = grid.overlap_m2(intake_shift, exhaust_shift) / p.geometry.clearance_m3();
            let most_s = s.max_step_s.min(2.0 / (OVERLAP_M_S * overlap).max(f64::MIN_POSITIVE));
            let mut cells = 2 * s.cells_per_deg;
            while cells > 1 && cells as f64 * grid.cell_deg / deg_s > most_s {
                cells /= 2;
            }
            cells
        };
        let piston_speed = p.geometry.mean_piston_speed_m_s(u.speed_rpm);
        let wastegate_m = 1e-3 * u.wastegate_mm;
        let wastegate_m2 = 0.25 * std::f64::consts::PI * wastegate_m * wastegate_m;
        let wastegate_m2 = p.exhaust.wastegate_discharge * wastegate_m2;
        let turbine_m2 = p.exhaust.turbine_m2 + wastegate_m2;
        let mut held = Self {
            omega: deg_s.to_radians(),
            deg_s,
            step_cells,
            half_per_step: 0.5 * deg_s / (step_cells as f64 * grid.cell_deg),
            throttle_m2: p.throttle.area_m2(u.throttle_deg),
            turbine_m2,
            wastegate_m2,
            egr_m2: p.egr.map_or(0.0, |e| e.area_m2(u.egr_mm)),
            intake_shift,
            exhaust_shift,
            gas_exchange_w: 6.18 * piston_speed,
            closed_w: 2.28 * piston_speed,
            piston_speed,
            lag_per_cell: -(-grid.cell_deg / deg_s / p.torque_lag_s).exp_m1(),
            friction_factor: d.friction_factor,
            fuel_share: 0.25 * d.fuel_share.iter().sum::<f64>(),
            ..Self::default()
        };
        held.rest(p, d, means);
        held
    }

    /// Walls that are at rest with the last cycle, where they are not given from outside.
    pub(crate) fn rest(&mut self, p: &EngineParams, d: &Deviations, means: &Means) {
        let m = &p.exhaust_manifold;
        self.exhaust_heat = p
            .exhaust_wall
            .map_or((m.ua_w_k, m.wall_k), |w| w.of(p.ambient.temperature_k, d, means.exhaust_kg_s).joined());
        let at_rest = p.heat.coolant.zip(means.cylinder_heat_w);
        let warmed = |(c, w): (Coolant, f64)| (c.temperature_k + w / c.conductance_w_k).clamp(220.0, 800.0);
        self.cylinder_wall_k = d.cylinder_wall_k.unwrap_or(at_rest.map_or(p.heat.wall_k, warmed));
    }
}
