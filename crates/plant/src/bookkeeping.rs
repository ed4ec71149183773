//! What happens between steps: latched events, injection, sums, torque sensor.

use crate::combustion::{Charge, Wiebe};
use crate::emissions::Hidden;
use crate::end_gas::{EndGas, KnockModel, ZoneStep};
use crate::engine::VirtualEngine;
use crate::gas::GasModel;
use crate::grid::EventKind;
use crate::state::{CycleRecord, EXHAUST, INTAKE, PIPE, Sums};
use std::f64::consts::PI;

/// Unburned gas that is followed from here on; the temperature kept is that of the step before, hence one Newton
/// correction to the present one.
fn unburned(gas: &GasModel, mass_kg: [f64; 3], energy_j: f64, p_pa: f64, t_k: f64) -> EndGas {
    let (u, cv) = gas.energy_and_capacity(mass_kg, t_k);
    let now = t_k + (energy_j - u) / cv;
    EndGas::closed(gas, mass_kg, p_pa * now / t_k, now)
}

/// Mole fraction of NO that the residual gas of a charge brings along.
fn entrained(last: &CycleRecord, [air, fuel, products]: [f64; 3]) -> f64 {
    1e-6 * last.emissions.no_ppm * products / (air + fuel + products)
}

/// Recirculated gas over air \[-\], means of the last 720 deg: the charge of a cylinder has drawn both from one manifold.
fn recirculated_over_air(half_turns: &[Sums; 4]) -> f64 {
    let sum = |of: fn(&Sums) -> f64| half_turns.iter().map(of).sum::<f64>();
    let (egr_kg, air_kg) = (sum(|h| h.egr_kg), sum(|h| h.air_kg));
    if air_kg > 0.0 { egr_kg / air_kg } else { 0.0 }
}

impl VirtualEngine {
    /// Handle every event up to the present cell.
    #[inline]
    pub(crate) fn events(&mut self) {
        while let Some(event) = self.grid.events.get(self.state.next_event).copied() {
            if event.cell > self.state.cell {
                break;
            }
            self.event(event.cylinder, event.kind);
            self.state.next_event += 1;
        }
    }

    fn event(&mut self, c: usize, kind: EventKind) {
        let geometry = &self.params.geometry;
        let s = &mut self.state;
        let u = &s.inputs;
        let boosted = &self.model.boosted;
        let d = &self.deviations;
        let m = &mut s.cylinders[c];
        let [air, fuel, products] = [0, 1, 2].map(|i| s.gas.mass_kg[i][c]);
        match kind {
            EventKind::ExchangeBegins => {
                m.variation.cycle(m.work_j, m.last.gross_work_j);
                m.last.gross_work_j = m.work_j;
                m.last.exchange_work_j = m.exchange_work_j;
                m.work_j = 0.0;
                m.blown_down_k = s.t_k[c];
                // Port injection goes on the closed intake valve, so that the fuel waits for the next induction.
                if let Some(port) = &self.params.port {
                    let fuel = 1e-6 * u.injection_mg * d.fuel_share[c];
                    m.film.inject(port, d.film_factor, fuel, s.time_s);
                }
            }
            EventKind::CycleEnds => {
                m.last = CycleRecord {
                    peak_pa: m.running_peak_pa,
                    peak_deg: m.running_peak_deg,
                    residual: m.residual,
                    lambda: m.lambda,
                    trapped_kg: m.trapped_kg,
                    ca_deg: [0.1, 0.5, 0.9].map(|x| m.wiebe.angle_of_fraction_deg(x)),
                    knock: m.end_gas.knock,
                    burned_k: m.end_gas.burned_k,
                    ..m.last
                };
                if let (Some((model, _)), Some(table)) = (&boosted.emissions, &boosted.table) {
                    let afr = self.params.gas.afr_stoich;
                    let air = (1.0 - m.residual) * m.lambda * afr / (1.0 + m.lambda * afr);
                    let recirculated = (recirculated_over_air(&s.half_turns) * air).min(m.residual);
                    let hidden = Hidden {
                        peak_pa: m.running_peak_pa,
                        trapped_kg: m.trapped_kg,
                        wall_k: self.held.cylinder_wall_k,
                        blown_down_k: m.blown_down_k,
                        residual: m.residual - recirculated,
                        recirculated,
                    };
                    let mixture = (m.lambda, afr);
                    m.last.emissions = model.cycle(table, &m.end_gas, mixture, m.stable, &hidden);
                }
                m.end_gas.t_k = 0.0;
                m.running_peak_pa = 0.0;
                s.peak_mean_pa = 0.25 * s.cylinders.iter().map(|m| m.last.peak_pa).sum::<f64>();
            }
            EventKind::Injection => {
                m.to_inject_kg += match &self.params.port {
                    None => 1e-6 * u.injection_mg * d.fuel_share[c],
                    Some(port) => m.film.induct(port, d.film_factor, s.time_s),
                };
            }
            EventKind::ExchangeEnds => {
                m.exchange_work_j = m.work_j;
                m.work_j = 0.0;
            }
            EventKind::Closed => {
                let node = &self.grid.nodes[self.grid.local_nodes(s.cell)[c]];
                let t = s.t_k[c];
                let p = self.model.gas.mass_r_j_k([air, fuel, products]) * t / node.volume_m3;
                m.woschni_ref = geometry.displacement_m3() * t / (p * node.volume_m3);
                m.motored_ref = p / node.motored;
                if boosted.knock.is_some() {
                    m.end_gas = unburned(&self.model.gas, [air, fuel, products], s.gas.energy_j[c], p, t);
                    m.end_gas.entrained = entrained(&m.last, [air, fuel, products]);
                }
            }
            EventKind::Spark => {
                let gas = &self.model.gas;
                let all_fuel = fuel + s.gas.liquid_kg[c];
                let total = air + all_fuel + products;
                m.trapped_kg = total;
                m.residual = products / total;
                m.lambda = gas.lambda(air, all_fuel, 0.0);
                m.stable = self.params.burn.stability(m.lambda, m.residual);
                if let Some(knock) = &boosted.knock {
                    m.end_gas.slower = knock.charge_factor(m.lambda, m.residual, gas.afr_stoich);
                }
                if let (Some(energy), Some(table)) = (&boosted.burned, &boosted.table) {
                    m.held = table.held(m.lambda, energy.dissociation);
                    m.bound_j_kg = energy.bound_j_kg * (1.0 / m.lambda - 1.0).clamp(0.0, 2.0);
                }
                let limited = all_fuel.min(air / gas.afr_stoich).max(0.0);
                let scale = d.scatter.of_charge(m.lambda, m.residual).cycle(d.seed, s.cycle, c);
                let share = self.params.burn.burnable_share(m.lambda)
                    * self.params.burn.dilution_share(m.residual)
                    * scale.heat;
                m.burnable_kg = share.min(1.0) * limited;
                let charge = Charge {
                    speed_rpm: u.speed_rpm,
                    spark_deg: u.spark_deg,
                    wiebe_m: u.wiebe_m,
                    duration_deg: u.burn_duration_deg,
                    trapped_kg: total,
                    residual: m.residual,
                    lambda: m.lambda,
                };
                let wiebe: Wiebe = self.params.burn.wiebe(&charge, geometry);
                m.wiebe = wiebe.stretched(u.spark_deg, d.burn_share[c] * scale.burn);
                if boosted.knock.is_none() && boosted.emissions.is_some() {
                    // Nothing has burned yet and no delay of knock is followed: all gas is unburned and of one temperature.
                    let node = &self.grid.nodes[self.grid.local_nodes(s.cell)[c]];
                    let mass = [air, fuel, products];
                    let p = gas.mass_r_j_k(mass) * s.t_k[c] / node.volume_m3;
                    m.end_gas = unburned(gas, mass, s.gas.energy_j[c], p, s.t_k[c]);
                    m.end_gas.entrained = entrained(&m.last, mass);
                }
            }
        }
    }

    /// Injected mass by exact overlap of the injection with the step.
    #[inline]
    pub(crate) fn inject(&mut self, dt_s: f64) {
        let most = self.params.injection.rate_kg_s * dt_s;
        let s = &mut self.state;
        for c in 0..4 {
            let left = s.cylinders[c].to_inject_kg;
            if left > 0.0 {
                let part = left.min(most);
                s.cylinders[c].to_inject_kg = left - part;
                s.gas.liquid_kg[c] += part;
                s.ledger.injected_kg += part;
            }
        }
    }

    /// Sums, balance sheet and sensors after a step of `cells` cells; rates are those of the midpoint.
    pub(crate) fn account(&mut self, cells: usize, dt: f64, middle: &[usize; 4]) {
        if self.model.boosted.zones() {
            self.follow_zones(dt, middle);
        }
        let s = &mut self.state;
        let k = &self.k;
        let mut power = 0.0;
        for c in 0..4 {
            power += k.work[c];
            let m = &mut s.cylinders[c];
            m.work_j += dt * k.work[c];
            if k.p[c] > m.running_peak_pa {
                m.running_peak_pa = k.p[c];
                m.running_peak_deg = self.grid.nodes[middle[c]].phi_deg;
            }
        }
        let work = dt * power;
        let part = work / cells as f64;
        for old in &mut s.work_ring_j[s.cell..s.cell + cells] {
            s.work_sum_j += part - *old;
            *old = part;
        }
        let g = &self.params.geometry;
        let friction = &self.params.friction;
        let warm = friction.fmep_pa(s.peak_mean_pa, self.held.piston_speed, s.inputs.speed_rpm);
        let fmep = self.held.friction_factor * warm;
        let friction_nm = fmep * 4.0 * g.displacement_m3() / (4.0 * PI);
        let mean_nm = s.work_sum_j / (4.0 * PI) - friction_nm;
        for _ in 0..cells {
            s.torque_sensor_nm += self.held.lag_per_cell * (mean_nm - s.torque_sensor_nm);
        }
        let [air, fuel, products] = [0, 1, 2].map(|i| s.gas.mass_kg[i][EXHAUST]);
        let sums = Sums {
            time_s: dt,
            lambda_s: dt * self.model.gas.lambda(air, fuel, products),
            map_pa_s: dt * k.p[INTAKE],
            exhaust_pa_s: dt * k.p[EXHAUST],
            air_kg: dt * k.throttle,
            pipe_pa_s: dt * k.p[PIPE],
            egr_kg: dt * k.egr,
            surge_s: dt * k.surge,
            exhaust_kg: dt * k.tail,
            exhaust_kg_k: dt * k.tail * s.t_k[EXHAUST],
            work_j: work,
            cylinder_heat_j: dt * k.cylinder_wall,
            friction_nm_s: dt * friction_nm,
            torque_nm_s: dt * s.torque_sensor_nm,
        };
        s.interval.add(&sums);
        s.running.add(&sums);
        let l = &mut s.ledger;
        l.work_j += work;
        l.wall_heat_j += dt * k.wall;
        l.cylinder_heat_j += dt * k.cylinder_wall;
        l.exhaust_heat_j += dt * k.exhaust_wall;
        l.burned_kg += dt * k.burned;
        l.evaporation_j += dt * k.evaporated * self.model.evaporation_j_kg;
        l.enthalpy_in_j += dt * k.enthalpy_in;
        l.mass_in_kg += dt * (k.inflow - k.tail);
        l.bound_j += dt * k.bound;
        l.compressor_j += dt * k.compressor;
        l.turbine_j += dt * k.turbine;
        s.time_s += dt;
        s.cell += cells;
        self.turn_over();
    }

    /// Unburned gas, knock integral and burned zone of closed cylinders, with the state in the middle of the step.
    fn follow_zones(&mut self, dt_s: f64, middle: &[usize; 4]) {
        let boosted = &self.model.boosted;
        let octane = self.deviations.octane;
        let knock = boosted.knock.map(|k| KnockModel { octane: octane.unwrap_or(k.octane), ..k });
        let wall_k = self.held.cylinder_wall_k;
        for c in 0..4 {
            let mass_kg = [0, 1, 2].map(|i| self.state.gas.mass_kg[i][c]);
            let m = &mut self.state.cylinders[c];
            let node = &self.grid.nodes[middle[c]];
            let phi = node.phi_deg;
            // From intake closing or the latch of the burn (a temperature is there) to the opening of the exhaust.
            if m.end_gas.t_k == 0.0 || phi > 150.0 {
                continue;
            }
            let (p_pa, t_k) = (self.k.p[c], self.state.t_k[c]);
            let burned = m.wiebe.burned(phi);
            let wall_1_s = self.k.wall_w_m2_k[c] * node.wall_m2 / self.model.gas.mass_r_j_k(mass_kg);
            let step = ZoneStep { dt_s, p_pa, t_k, burned, lambda: m.lambda, wall_1_s, wall_k };
            m.end_gas.advance(knock.as_ref(), &step);
            if let Some((model, table)) = &boosted.emissions {
                m.end_gas.react(table, &ZoneStep { dt_s: model.no_factor * dt_s, ..step });
            }
        }
    }

    /// Half-turn means and wrap of the cycle.
    #[inline]
    fn turn_over(&mut self) {
        let s = &mut self.state;
        let cells = self.grid.cells;
        if s.cell >= (s.slot + 1) * (cells / 4) {
            s.half_turns[s.slot] = s.running;
            s.slot = (s.slot + 1) & 3;
            s.running = Sums::default();
            if self.params.exhaust_wall.is_some() || self.params.heat.coolant.is_some() {
                let means = s.means();
                self.held.rest(&self.params, &self.deviations, &means);
            }
        }
        if s.cell >= cells {
            s.cell -= cells;
            s.cycle += 1;
            s.next_event = 0;
            // The running difference would drift by rounding: start each cycle from the exact sum.
            s.work_sum_j = s.work_ring_j.iter().sum();
        }
    }
}
