//! Right-hand side of the gas state and the explicit midpoint step.

mod boosted;
mod held;

use self::boosted::Boosted;
pub(crate) use self::held::Held;
use crate::gas::{GasModel, VOLUMES};
use crate::grid::{Grid, Node};
use crate::heat::{self, HeatLaw};
use crate::orifice::PsiTable;
use crate::params::EngineParams;
use crate::state::{CATALYST, Cylinder, EXHAUST, Gas, INTAKE, PIPE};

/// Constants of the right-hand side.
#[derive(Debug, Clone)]
pub(crate) struct Model {
    pub(crate) gas: GasModel,
    pub(crate) psi: PsiTable,
    pub(crate) manifold_m3: [f64; VOLUMES],
    /// Of intake manifold and catalyst; those of the exhaust manifold change: [`Held::exhaust_heat`].
    pub(crate) ua_w_k: [f64; 2],
    pub(crate) wall_k: [f64; 2],
    pub(crate) ambient_pa: f64,
    pub(crate) tail_m2: f64,
    pub(crate) woschni: f64,
    pub(crate) heat_law: HeatLaw,
    pub(crate) heat_scale: f64,
    pub(crate) burn_end_deg: f64,
    pub(crate) evaporation_1_s: f64,
    pub(crate) evaporation_j_kg: f64,
    pub(crate) boosted: Boosted,
    /// Charge pipe and shaft are given from outside: neither compressor nor balance of the shaft.
    pub(crate) charge_held: bool,
}

impl Model {
    pub(crate) fn new(p: &EngineParams) -> Self {
        let (i, e, c) = (&p.intake_manifold, &p.exhaust_manifold, &p.catalyst);
        Self {
            gas: p.gas.clone(),
            psi: PsiTable::default(),
            manifold_m3: [1.0, 1.0, 1.0, 1.0, p.charge_pipe_m3, i.volume_m3, e.volume_m3, c.volume_m3],
            ua_w_k: [i.ua_w_k, c.ua_w_k],
            wall_k: [i.wall_k, c.wall_k],
            ambient_pa: p.ambient.pressure_pa,
            tail_m2: p.exhaust.tailpipe_m2,
            woschni: heat::woschni_constant(p.heat.scale, p.geometry.bore_m),
            heat_law: p.heat.law,
            heat_scale: p.heat.scale,
            burn_end_deg: p.burn.end_deg,
            evaporation_1_s: 1.0 / p.injection.evaporation_s,
            // Vapour enters the charge with its enthalpy at 298.15 K (u = 0, so R T), less the latent heat
            // that the charge has to supply.
            evaporation_j_kg: p.injection.charge_share * p.gas.latent_j_kg - p.gas.r_j_kg_k[1] * 298.15,
            boosted: Boosted::new(p),
            charge_held: false,
        }
    }
}

/// Time derivatives and the powers and flows that belong to them.
#[derive(Debug, Clone)]
pub(crate) struct Rates {
    pub(crate) mass: [[f64; VOLUMES]; 3],
    pub(crate) energy: [f64; VOLUMES],
    pub(crate) liquid: [f64; 4],
    /// Pressures \[Pa\].
    pub(crate) p: [f64; VOLUMES],
    /// p dV/dt per cylinder \[W\].
    pub(crate) work: [f64; 4],
    /// Heat to all walls and to those of the cylinders \[W\].
    pub(crate) wall: f64,
    pub(crate) cylinder_wall: f64,
    /// Heat from the exhaust manifold \[W\].
    pub(crate) exhaust_wall: f64,
    /// Heat-transfer coefficients of the cylinders \[W/m2/K\].
    pub(crate) wall_w_m2_k: [f64; 4],
    /// Fuel burned \[kg/s\].
    pub(crate) burned: f64,
    /// Liquid evaporated \[kg/s\].
    pub(crate) evaporated: f64,
    /// Flow through the throttle \[kg/s\].
    pub(crate) throttle: f64,
    /// Flow out of the tailpipe \[kg/s\].
    pub(crate) tail: f64,
    /// Enthalpy into the engine \[W\].
    pub(crate) enthalpy_in: f64,
    /// Flow into the engine (throttle or compressor) and recirculated \[kg/s\].
    pub(crate) inflow: f64,
    pub(crate) egr: f64,
    /// Power of compressor and turbine, energy bound in CO and H2 \[W\].
    pub(crate) compressor: f64,
    pub(crate) turbine: f64,
    pub(crate) bound: f64,
    /// Shaft of the turbocharger \[rad/s2\]; 1 while the compressor surges.
    pub(crate) shaft: f64,
    pub(crate) surge: f64,
}

impl Rates {
    pub(crate) const ZERO: Self = Self {
        mass: [[0.0; VOLUMES]; 3],
        energy: [0.0; VOLUMES],
        liquid: [0.0; 4],
        p: [0.0; VOLUMES],
        work: [0.0; 4],
        wall: 0.0,
        cylinder_wall: 0.0,
        exhaust_wall: 0.0,
        wall_w_m2_k: [0.0; 4],
        burned: 0.0,
        evaporated: 0.0,
        throttle: 0.0,
        tail: 0.0,
        enthalpy_in: 0.0,
        inflow: 0.0,
        egr: 0.0,
        compressor: 0.0,
        turbine: 0.0,
        bound: 0.0,
        shaft: 0.0,
        surge: 0.0,
    };
}

/// Properties of all volumes at one stage.
pub(crate) struct Stage {
    pub(crate) p: [f64; VOLUMES],
    pub(crate) gamma: [f64; VOLUMES],
    inv_m: [f64; VOLUMES],
    h: [f64; VOLUMES],
    /// p/sqrt(R T).
    pub(crate) drive: [f64; VOLUMES],
}

impl Model {
    /// Derivatives of `gas` with the cylinders at `nodes`; `t_k` is guess and result.
    #[inline(always)]
    pub(crate) fn rates(
        &self,
        gas: &Gas,
        nodes: &[usize; 4],
        grid: &Grid,
        held: &Held,
        cylinders: &[Cylinder; 4],
        t_k: &mut [f64; VOLUMES],
        k: &mut Rates,
    ) {
        let mut volume = self.manifold_m3;
        let mut at: [&Node; 4] = [&grid.nodes[0]; 4];
        for c in 0..4 {
            at[c] = &grid.nodes[nodes[c]];
            volume[c] = at[c].volume_m3;
        }
        let s = self.properties(gas, &volume, cylinders, t_k);
        *k = Rates::ZERO;
        self.manifold_flows(&s, gas, held, t_k, k);
        let wall = self.wall_coefficients(&s, &at, held, cylinders, t_k);
        let period = 2 * grid.cells;
        for c in 0..4 {
            // A cam between two nodes of the grid: areas in between (the tables are padded).
            let area = |table: &[f64], (whole, rest): (usize, f64)| {
                let i = nodes[c] + whole;
                let i = if i >= period { i - period } else { i };
                if rest == 0.0 { table[i] } else { table[i] + rest * (table[i + 1] - table[i]) }
            };
            let intake = area(&grid.intake_m2, held.intake_shift);
            if intake > 0.0 {
                self.exchange(&s, gas, INTAKE, c, intake, k);
            }
            let exhaust = area(&grid.exhaust_m2, held.exhaust_shift);
            if exhaust > 0.0 {
                self.exchange(&s, gas, c, EXHAUST, exhaust, k);
            }
            self.cylinder_rates(&s, gas, c, at[c], held, &cylinders[c], t_k[c], wall[c], k);
        }
        k.p = s.p;
        k.wall_w_m2_k = wall;
    }

    #[inline(always)]
    fn properties(
        &self,
        gas: &Gas,
        volume: &[f64; VOLUMES],
        cylinders: &[Cylinder; 4],
        t_k: &mut [f64; VOLUMES],
    ) -> Stage {
        let mut mcv = [0.0; VOLUMES];
        let guess = [t_k[0], t_k[1], t_k[2], t_k[3]];
        self.gas.temperatures(&gas.mass_kg, &gas.energy_j, t_k, &mut mcv);
        if self.boosted.burned.is_some() {
            self.dissociated(gas, cylinders, &guess, t_k, &mut mcv);
        }
        let [ra, rf, rp] = self.gas.r_j_kg_k;
        let mut extra = [0.0; VOLUMES];
        for c in 0..4 {
            extra[c] = cylinders[c].held.extra_r_j_kg_k;
        }
        let [ma, mf, mp] = &gas.mass_kg;
        let mut s = Stage {
            p: [0.0; VOLUMES],
            gamma: [0.0; VOLUMES],
            inv_m: [0.0; VOLUMES],
            h: [0.0; VOLUMES],
            drive: [0.0; VOLUMES],
        };
        for v in 0..VOLUMES {
            let mr = ma[v] * ra + mf[v] * rf + mp[v] * (rp + extra[v]);
            let pv = mr * t_k[v];
            let m = ma[v] + mf[v] + mp[v];
            s.inv_m[v] = 1.0 / m;
            s.p[v] = pv / volume[v];
            s.gamma[v] = 1.0 + mr / mcv[v];
            s.h[v] = (gas.energy_j[v] + pv) * s.inv_m[v];
            s.drive[v] = s.p[v] / (pv * s.inv_m[v]).sqrt();
        }
        s
    }

    /// Flow between two volumes with the composition and enthalpy of the upstream one; returns the
    /// signed mass flow from `a` to `b` \[kg/s\].
    #[inline(always)]
    pub(crate) fn exchange(
        &self,
        s: &Stage,
        gas: &Gas,
        a: usize,
        b: usize,
        area_m2: f64,
        k: &mut Rates,
    ) -> f64 {
        let forward = s.p[a] >= s.p[b];
        let (u, d) = if forward { (a & 7, b & 7) } else { (b & 7, a & 7) };
        let flow = area_m2 * s.drive[u] * self.psi.psi(s.p[d] / s.p[u], s.gamma[u]);
        self.carry(s, gas, u, d, flow, k);
        if forward { flow } else { -flow }
    }

    /// `flow` from `u` to `d` with composition and enthalpy of `u`.
    #[inline(always)]
    pub(crate) fn carry(&self, s: &Stage, gas: &Gas, u: usize, d: usize, flow: f64, k: &mut Rates) {
        let share = flow * s.inv_m[u];
        for i in 0..3 {
            let part = share * gas.mass_kg[i][u];
            k.mass[i][u] -= part;
            k.mass[i][d] += part;
        }
        let power = flow * s.h[u];
        k.energy[u] -= power;
        k.energy[d] += power;
    }

    #[inline(always)]
    fn manifold_flows(&self, s: &Stage, gas: &Gas, held: &Held, t_k: &[f64; VOLUMES], k: &mut Rates) {
        k.throttle = self.exchange(s, gas, PIPE, INTAKE, held.throttle_m2, k);
        let turbo = &self.boosted.turbo;
        if turbo.is_none() || self.charge_held {
            // The charge pipe is a reservoir (at ambient state, where nobody has set it) without a compressor.
            k.enthalpy_in = -k.energy[PIPE];
            for i in 0..3 {
                k.mass[i][PIPE] = 0.0;
            }
            k.energy[PIPE] = 0.0;
            k.inflow = k.throttle;
        }
        match turbo {
            Some(turbo) => self.turbocharger(turbo, s, gas, held, t_k[EXHAUST], k),
            None => {
                self.exchange(s, gas, EXHAUST, CATALYST, held.turbine_m2, k);
            }
        }
        if let Some(path) = &self.boosted.egr
            && held.egr_m2 > 0.0
        {
            self.recirculate(path, s, gas, held, t_k[EXHAUST], k);
        }
        // Reverse flow returns exhaust gas, never ambient air: pulsation would dilute the lambda signal.
        let (p, pa) = (s.p[CATALYST], self.ambient_pa);
        let (gamma, drive) = (s.gamma[CATALYST], s.drive[CATALYST]);
        k.tail = self.tail_m2
            * if p >= pa {
                drive * self.psi.psi(pa / p, gamma)
            } else {
                -drive * (pa / p) * self.psi.psi(p / pa, gamma)
            };
        for i in 0..3 {
            k.mass[i][CATALYST] -= k.tail * s.inv_m[CATALYST] * gas.mass_kg[i][CATALYST];
        }
        let out = k.tail * s.h[CATALYST];
        k.energy[CATALYST] -= out;
        k.enthalpy_in -= out;
        let ([ui, uc], [ti, tc]) = (self.ua_w_k, self.wall_k);
        for (v, ua, wall_k) in
            [(INTAKE, ui, ti), (EXHAUST, held.exhaust_heat.0, held.exhaust_heat.1), (CATALYST, uc, tc)]
        {
            let q = ua * (t_k[v] - wall_k);
            k.energy[v] -= q;
            k.wall += q;
            k.exhaust_wall = if v == EXHAUST { q } else { k.exhaust_wall };
        }
    }

    /// Heat-transfer coefficients of the cylinders \[W/m2/K\].
    #[inline(always)]
    fn wall_coefficients(
        &self,
        s: &Stage,
        at: &[&Node; 4],
        held: &Held,
        cylinders: &[Cylinder; 4],
        t_k: &[f64; VOLUMES],
    ) -> [f64; 4] {
        if self.woschni <= 0.0 {
            return [0.0; 4];
        }
        let (p, t) = ([s.p[0], s.p[1], s.p[2], s.p[3]], [t_k[0], t_k[1], t_k[2], t_k[3]]);
        match self.heat_law {
            HeatLaw::Woschni => {
                let mut w = [held.closed_w; 4];
                for c in 0..4 {
                    let (phi, memory) = (at[c].phi_deg, &cylinders[c]);
                    // Gas exchange from 110 to 616 deg of the cycle (phi = -104 deg).
                    if !(-104.0..110.0).contains(&phi) {
                        w[c] = held.gas_exchange_w;
                    } else if phi >= memory.wiebe.start_deg {
                        let rise = (p[c] - memory.motored_ref * at[c].motored).max(0.0);
                        w[c] = held.closed_w + 3.24e-3 * memory.woschni_ref * rise;
                    }
                }
                heat::woschni(self.woschni, p, t, w)
            }
            HeatLaw::Hohenberg => {
                let volume = [0, 1, 2, 3].map(|c| at[c].volume_m3);
                heat::hohenberg(self.heat_scale, volume, p, t, held.piston_speed)
            }
        }
    }

    /// Piston work, wall heat, combustion and evaporation of cylinder `c`.
    #[inline(always)]
    fn cylinder_rates(
        &self,
        s: &Stage,
        gas: &Gas,
        c: usize,
        at: &Node,
        held: &Held,
        memory: &Cylinder,
        t_k: f64,
        wall_w_m2_k: f64,
        k: &mut Rates,
    ) {
        let p = s.p[c];
        let phi = at.phi_deg;
        let work = p * at.dvolume * held.omega;
        let burning = phi > memory.wiebe.start_deg && phi < self.burn_end_deg;
        let wall = wall_w_m2_k * at.wall_m2 * (t_k - held.cylinder_wall_k);
        let mut energy = -work - wall;
        if burning && memory.burnable_kg > 0.0 {
            let wanted = memory.burnable_kg * memory.wiebe.rate_per_deg(phi) * held.deg_s;
            // What has left through an early exhaust valve does not burn any more.
            let there = gas.mass_kg[1][c].min(gas.mass_kg[0][c] / self.gas.afr_stoich).max(0.0);
            let b = wanted.min(there * held.half_per_step);
            k.mass[0][c] -= self.gas.afr_stoich * b;
            k.mass[1][c] -= b;
            k.mass[2][c] += (self.gas.afr_stoich + 1.0) * b;
            energy += (self.gas.lhv_j_kg - memory.bound_j_kg) * b;
            k.burned += b;
            k.bound += memory.bound_j_kg * b;
        }
        if gas.liquid_kg[c] > 0.0 {
            let e = gas.liquid_kg[c] * self.evaporation_1_s;
            k.liquid[c] = -e;
            k.mass[1][c] += e;
            energy -= self.evaporation_j_kg * e;
            k.evaporated += e;
        }
        k.energy[c] += energy;
        k.work[c] = work;
        k.wall += wall;
        k.cylinder_wall += wall;
    }
}

/// `out = start + dt * k` for all gas quantities.
#[inline(always)]
pub(crate) fn advance(start: &Gas, k: &Rates, dt_s: f64, out: &mut Gas) {
    for i in 0..3 {
        for v in 0..VOLUMES {
            out.mass_kg[i][v] = start.mass_kg[i][v] + dt_s * k.mass[i][v];
        }
    }
    for v in 0..VOLUMES {
        out.energy_j[v] = start.energy_j[v] + dt_s * k.energy[v];
    }
    for c in 0..4 {
        out.liquid_kg[c] = start.liquid_kg[c] + dt_s * k.liquid[c];
    }
    out.shaft_rad_s = start.shaft_rad_s + dt_s * k.shaft;
}

/// `gas += dt * k`.
#[inline(always)]
pub(crate) fn add(gas: &mut Gas, k: &Rates, dt_s: f64) {
    for i in 0..3 {
        for v in 0..VOLUMES {
            gas.mass_kg[i][v] += dt_s * k.mass[i][v];
        }
    }
    for v in 0..VOLUMES {
        gas.energy_j[v] += dt_s * k.energy[v];
    }
    for c in 0..4 {
        gas.liquid_kg[c] += dt_s * k.liquid[c];
    }
    gas.shaft_rad_s += dt_s * k.shaft;
}
