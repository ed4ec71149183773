//! The engine state as a list of numbers and back (for saved plant states).

use crate::state::{EngineState, Sums};

/// Visits every number of a state in a fixed order; counters travel as exact f64.
fn visit(s: &mut EngineState, f: &mut impl FnMut(&mut f64)) {
    s.gas.mass_kg.iter_mut().flatten().for_each(&mut *f);
    s.gas.energy_j.iter_mut().for_each(&mut *f);
    s.gas.liquid_kg.iter_mut().for_each(&mut *f);
    f(&mut s.gas.shaft_rad_s);
    s.t_k.iter_mut().for_each(&mut *f);
    s.t_before_k.iter_mut().for_each(&mut *f);
    for c in &mut s.cylinders {
        let (w, l) = (&mut c.wiebe, &mut c.last);
        [&mut w.start_deg, &mut w.duration_deg, &mut w.m, &mut w.a, &mut w.tail]
            .into_iter()
            .for_each(&mut *f);
        [&mut c.to_inject_kg, &mut c.burnable_kg, &mut c.woschni_ref, &mut c.motored_ref]
            .into_iter()
            .for_each(&mut *f);
        [&mut c.residual, &mut c.lambda, &mut c.trapped_kg, &mut c.running_peak_pa]
            .into_iter()
            .for_each(&mut *f);
        [&mut c.running_peak_deg, &mut c.blown_down_k, &mut c.work_j, &mut c.exchange_work_j]
            .into_iter()
            .for_each(&mut *f);
        [&mut l.peak_pa, &mut l.peak_deg, &mut l.gross_work_j, &mut l.exchange_work_j]
            .into_iter()
            .for_each(&mut *f);
        [&mut l.residual, &mut l.lambda, &mut l.trapped_kg].into_iter().for_each(&mut *f);
        l.ca_deg.iter_mut().for_each(&mut *f);
        let (h, z, e) = (&mut c.held, &mut c.end_gas, &mut l.emissions);
        [&mut c.stable, &mut c.bound_j_kg, &mut h.a, &mut h.b_k, &mut h.off_j_kg, &mut h.surplus_j_kg_k]
            .into_iter()
            .for_each(&mut *f);
        f(&mut h.extra_r_j_kg_k);
        [
            &mut z.t_k,
            &mut z.p_pa,
            &mut z.knock,
            &mut z.x_no,
            &mut z.burned,
            &mut z.burned_k,
            &mut z.entrained,
            &mut z.slower,
        ]
        .into_iter()
        .for_each(&mut *f);
        z.kappa.iter_mut().for_each(&mut *f);
        [&mut l.knock, &mut l.burned_k, &mut e.no_ppm, &mut e.co_pct, &mut e.hc_ppm]
            .into_iter()
            .for_each(&mut *f);
        let v = &mut c.variation;
        [&mut v.mean_j, &mut v.square_j2, &mut v.cycles].into_iter().for_each(&mut *f);
        let film = &mut c.film;
        [&mut film.film_kg, &mut film.airborne_kg, &mut film.time_s].into_iter().for_each(&mut *f);
    }
    let u = &mut s.inputs;
    [&mut u.speed_rpm, &mut u.throttle_deg, &mut u.spark_deg, &mut u.injection_mg]
        .into_iter()
        .for_each(&mut *f);
    [&mut u.intake_mop_deg_btdc, &mut u.exhaust_mop_deg_atdc, &mut u.wastegate_mm, &mut u.wiebe_m]
        .into_iter()
        .for_each(&mut *f);
    f(&mut u.egr_mm);
    // A missing duration travels as -1: durations are positive.
    let mut duration = u.burn_duration_deg.unwrap_or(-1.0);
    f(&mut duration);
    u.burn_duration_deg = (duration > 0.0).then_some(duration);
    s.work_ring_j.iter_mut().for_each(&mut *f);
    [&mut s.time_s, &mut s.remainder_deg, &mut s.work_sum_j, &mut s.torque_sensor_nm, &mut s.peak_mean_pa]
        .into_iter()
        .for_each(&mut *f);
    for sums in s.half_turns.iter_mut().chain([&mut s.interval, &mut s.running]) {
        visit_sums(sums, f);
    }
    let l = &mut s.ledger;
    [&mut l.work_j, &mut l.wall_heat_j, &mut l.burned_kg, &mut l.evaporation_j].into_iter().for_each(&mut *f);
    [&mut l.enthalpy_in_j, &mut l.mass_in_kg, &mut l.injected_kg, &mut l.cylinder_heat_j]
        .into_iter()
        .for_each(&mut *f);
    [&mut l.bound_j, &mut l.compressor_j, &mut l.turbine_j, &mut l.exhaust_heat_j]
        .into_iter()
        .for_each(&mut *f);
    for counter in [&mut s.cell, &mut s.next_event, &mut s.slot] {
        let mut x = *counter as f64;
        f(&mut x);
        *counter = x as usize;
    }
    let mut cycle = s.cycle as f64;
    f(&mut cycle);
    s.cycle = cycle as u64;
}

fn visit_sums(s: &mut Sums, f: &mut impl FnMut(&mut f64)) {
    [&mut s.time_s, &mut s.lambda_s, &mut s.map_pa_s, &mut s.exhaust_pa_s, &mut s.air_kg]
        .into_iter()
        .for_each(&mut *f);
    [&mut s.pipe_pa_s, &mut s.egr_kg, &mut s.surge_s, &mut s.cylinder_heat_j].into_iter().for_each(&mut *f);
    [&mut s.exhaust_kg, &mut s.exhaust_kg_k, &mut s.work_j, &mut s.friction_nm_s, &mut s.torque_nm_s]
        .into_iter()
        .for_each(&mut *f);
}

impl EngineState {
    /// Append every number of the state to `out`.
    pub fn to_numbers(&self, out: &mut Vec<f64>) {
        visit(&mut self.clone(), &mut |x| out.push(*x));
    }

    /// Take every number from `numbers` (made by [`Self::to_numbers`] of an engine with the same grid);
    /// false when the count does not fit or an index is out of range.
    pub fn load_numbers(&mut self, numbers: &[f64]) -> bool {
        let mut count = 0;
        visit(self, &mut |_| count += 1);
        if numbers.len() != count {
            return false;
        }
        let mut source = numbers.iter();
        visit(self, &mut |x| {
            if let Some(v) = source.next() {
                *x = *v;
            }
        });
        self.slot < self.half_turns.len()
    }
}
