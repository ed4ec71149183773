//! Level F1 in the right-hand side: turbocharger, recirculation, dissociated gas in the cylinders.
//!
//! Every part is optional; an engine without them runs through none of this.

use crate::dissociation::{self, BurnedEnergy, BurnedTable};
use crate::egr::EgrPath;
use crate::emissions::EmissionsModel;
use crate::end_gas::KnockModel;
use crate::gas::VOLUMES;
use crate::inputs::WASTEGATE_MM;
use crate::nitric_oxide::ZeldovichTable;
use crate::params::EngineParams;
use crate::state::{CATALYST, Cylinder, EXHAUST, Gas, INTAKE, PIPE};
use crate::step::{Held, Model, Rates, Stage};
use crate::turbocharger::Turbocharger;

/// Constants and tables of level F1.
#[derive(Debug, Clone)]
pub(crate) struct Boosted {
    pub(crate) turbo: Option<Turbocharger>,
    pub(crate) egr: Option<EgrPath>,
    pub(crate) knock: Option<KnockModel>,
    pub(crate) burned: Option<BurnedEnergy>,
    /// Present with `burned` or `emissions`.
    pub(crate) table: Option<BurnedTable>,
    pub(crate) emissions: Option<(EmissionsModel, ZeldovichTable)>,
    /// Effective area of the wastegate wide open \[m2\].
    gate_m2: f64,
    ambient_k: f64,
    /// Density \[kg/m3\] and enthalpy \[J/kg\] of ambient air.
    rho: f64,
    enthalpy: f64,
}

impl Boosted {
    pub(crate) fn new(p: &EngineParams) -> Self {
        let (t_k, r) = (p.ambient.temperature_k, p.gas.r_j_kg_k[0]);
        Self {
            turbo: p.turbocharger,
            egr: p.egr,
            knock: p.knock,
            burned: p.burned_energy,
            table: (p.burned_energy.is_some() || p.emissions.is_some()).then(BurnedTable::default),
            emissions: p.emissions.map(|e| (e, ZeldovichTable::default())),
            gate_m2: p.exhaust.wastegate_discharge * orifice_m2(WASTEGATE_MM),
            ambient_k: t_k,
            rho: p.ambient.pressure_pa / (r * t_k),
            enthalpy: p.gas.energy_j([1.0, 0.0, 0.0], t_k) + r * t_k,
        }
    }

    /// Whether unburned gas and burned zone are followed.
    pub(crate) fn zones(&self) -> bool {
        self.knock.is_some() || self.emissions.is_some()
    }
}

impl Model {
    /// The compressor fills the charge pipe; the turbine takes its power out of what flows to the catalyst.
    pub(crate) fn turbocharger(
        &self,
        t: &Turbocharger,
        s: &Stage,
        gas: &Gas,
        held: &Held,
        t_k: f64,
        k: &mut Rates,
    ) {
        let b = &self.boosted;
        let w = gas.shaft_rad_s;
        let compressor_w = if self.charge_held { 0.0 } else { self.compressor(t, s, w, k) };
        let gamma = s.gamma[EXHAUST];
        let kappa = (gamma - 1.0) / gamma;
        let cp = gas_constant(s, EXHAUST, t_k) / kappa;
        let ratio = s.p[CATALYST] / s.p[EXHAUST];
        let turbine_m2 = held.turbine_m2 - held.wastegate_m2;
        let lift = t.flap_lift(s.p[EXHAUST] - s.p[CATALYST]);
        let gate_m2 = held.wastegate_m2 + lift * (b.gate_m2 - held.wastegate_m2).max(0.0);
        self.exchange(s, gas, EXHAUST, CATALYST, gate_m2, k);
        let (up, down, over) =
            if ratio <= 1.0 { (EXHAUST, CATALYST, ratio) } else { (CATALYST, EXHAUST, 1.0 / ratio) };
        let choked = turbine_m2 * s.drive[up] * self.psi.psi(0.0, s.gamma[up]);
        let through = choked * t.turbine_share(over);
        self.carry(s, gas, up, down, through, k);
        let through = if ratio <= 1.0 { through } else { 0.0 };
        let power = t.turbine_power_w(w, through, cp, kappa, t_k, ratio);
        k.energy[CATALYST] -= power;
        k.turbine = power;
        if !self.charge_held {
            k.shaft = t.acceleration(w, power, compressor_w);
        }
    }

    /// The compressor fills the charge pipe; returns its power \[W\].
    #[inline(always)]
    fn compressor(&self, t: &Turbocharger, s: &Stage, w: f64, k: &mut Rates) -> f64 {
        let b = &self.boosted;
        let c = t.compressor(w, s.p[PIPE], self.ambient_pa, b.ambient_k, b.rho);
        let on = c.share * c.power_w;
        let cooled = t.cooled_share(c.flow_kg_s) * on;
        k.mass[0][PIPE] += c.flow_kg_s;
        k.energy[PIPE] += c.flow_kg_s * b.enthalpy + on - cooled;
        // What is recirculated gives its heat to the surroundings.
        k.wall += cooled + (c.power_w - on);
        k.enthalpy_in += c.flow_kg_s * b.enthalpy;
        k.inflow = c.flow_kg_s;
        k.compressor = c.power_w;
        k.surge = f64::from(u8::from(c.surge));
        c.power_w
    }

    /// Other air around the engine, and a charge pipe and a shaft that are given.
    pub(crate) fn surround(&mut self, pressure_pa: f64, temperature_k: f64) {
        let r = self.gas.r_j_kg_k[0];
        self.ambient_pa = pressure_pa;
        self.charge_held = true;
        self.boosted.ambient_k = temperature_k;
        self.boosted.rho = pressure_pa / (r * temperature_k);
        self.boosted.enthalpy = self.gas.energy_j([1.0, 0.0, 0.0], temperature_k) + r * temperature_k;
    }

    /// Exhaust gas to the intake manifold, cooled.
    pub(crate) fn recirculate(
        &self,
        e: &EgrPath,
        s: &Stage,
        gas: &Gas,
        held: &Held,
        t_k: f64,
        k: &mut Rates,
    ) {
        if s.p[EXHAUST] <= s.p[INTAKE] {
            return;
        }
        let before = k.energy[INTAKE];
        k.egr = self.exchange(s, gas, EXHAUST, INTAKE, held.egr_m2, k);
        let gamma = s.gamma[EXHAUST];
        let cp = gas_constant(s, EXHAUST, t_k) * gamma / (gamma - 1.0);
        // No colder than the energy that came along.
        let carried = k.energy[INTAKE] - before;
        let cooled = (e.cooling * k.egr * cp * (t_k - e.coolant_k)).clamp(0.0, carried.max(0.0));
        k.energy[INTAKE] -= cooled;
        k.wall += cooled;
    }

    /// Temperatures of hot cylinders with the energy of dissociation: E = sum m u(T) + m_p d(T).
    pub(crate) fn dissociated(
        &self,
        gas: &Gas,
        cylinders: &[Cylinder; 4],
        guess: &[f64; 4],
        t_k: &mut [f64; VOLUMES],
        mcv: &mut [f64; VOLUMES],
    ) {
        for c in 0..4 {
            let held = &cylinders[c].held;
            if t_k[c] <= dissociation::OFF_K {
                continue;
            }
            let mass = [0, 1, 2].map(|i| gas.mass_kg[i][c]);
            // The frozen temperature lies above: start from the last one where that is hot too.
            let mut t = if guess[c] > 1600.0 { guess[c] } else { t_k[c] };
            for _ in 0..12 {
                let (d, slope) = held.at(t);
                let (u, cv) = self.gas.energy_and_capacity(mass, t);
                let cap = cv + mass[2] * slope;
                let step = (gas.energy_j[c] - u - mass[2] * d) / cap;
                t = (t + step).clamp(150.0, 4000.0);
                mcv[c] = cap;
                if step.abs() < 0.02 {
                    break;
                }
            }
            t_k[c] = t;
        }
    }
}

/// Area \[m2\] of an opening of the diameter `mm`.
fn orifice_m2(mm: f64) -> f64 {
    0.25 * std::f64::consts::PI * 1e-6 * mm * mm
}

/// R \[J/kg/K\] of the gas of a volume, from its pressure drive p/sqrt(R T).
fn gas_constant(s: &Stage, v: usize, t_k: f64) -> f64 {
    let root = s.p[v] / s.drive[v];
    root * root / t_k
}
