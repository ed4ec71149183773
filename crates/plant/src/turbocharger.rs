//! Turbocharger: compressor by speed lines with surge and choke, turbine that chokes, one shaft, a wastegate with a spring.
//!
//! Compressor, with psi = 2 dh_is/U^2, phi = m'/(rho D^2 U) and the Mach number M = U/a_0 of the tip:
//!
//! - Speed lines are quarter ellipses from the top (surge) to the foot (choke),
//!   ((phi - phi_s)/(phi_c - phi_s))^2 + ((psi - psi_c)/(psi_s - psi_c))^2 = 1, with psi_s = h_0 + h_1 M,
//!   psi_c = psi_s (k_0 + k_1 M), phi_s = phi_c (s_0 + s_1 M + s_2 M^2) and phi_c that falls as 1/M where the inlet is
//!   choked. Form after Leufven and Eriksson, Control Engineering Practice 21 (2013), with exponent 2.
//! - Work: dh = U^2 (w_0 - w_1 phi/phi_c), linear in flow as Euler's equation has it (Llamas and Eriksson, J. Eng. Gas
//!   Turbines Power 139 (2017)); the efficiency dh_is/dh has its islands from the two together, and falls to nothing
//!   at choke.
//! - Above the top a recirculation valve opens: the wheel keeps its surge flow and takes the power of it, what goes on
//!   falls to nothing over [`BYPASS`] of the head.
//! - Below the foot a slow wheel is an orifice that the engine draws through.
//!
//! Turbine: m' = A p/sqrt(R T) Psi_c sqrt(1 - (p_7/p_6)^k), the flow line of radial turbines that chokes late (k 1.45 on
//! a measured map), power eta_t m' c_p T (1 - (p_7/p_6)^((g-1)/g)), eta_t = eta_max (2 s - s^2) with s the blade speed
//! over jet speed relative to its best value. Shaft J w w' = eta_m P_t - P_c - c_f w^2. The flap of the wastegate is held
//! by a spring: where the exhaust pressure passes its preload it lifts, whatever was asked for. The intercooler takes the
//! share `cooling` of the compressor's heat, less at high flow where its conductance is given.
//!
//! Not covered: flow that turns back in deep surge, heat from turbine to compressor, pressure loss of the intercooler.

use serde::{Deserialize, Serialize};

/// Constants of a turbocharger.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Turbocharger {
    /// Diameter D of the compressor wheel \[m\].
    pub compressor_m: f64,
    /// Flow coefficient phi_c of choke \[-\].
    pub flow_coefficient: f64,
    /// Mach number of the tip above which the inlet is choked \[-\].
    pub choke_mach: f64,
    /// Head coefficient psi_s at the top of a speed line: h_0, h_1 \[-\].
    pub head_coefficient: [f64; 2],
    /// Head at choke over that at the top: k_0, k_1 \[-\].
    pub choke_head: [f64; 2],
    /// Flow at the top of a speed line over that at choke: s_0, s_1, s_2 \[-\]; held below the vertex of the parabola.
    pub surge_share: [f64; 3],
    /// Work coefficient: w_0, w_1 \[-\].
    pub work_coefficient: [f64; 2],
    /// Diameter of the turbine wheel \[m\].
    pub turbine_m: f64,
    /// Exponent k of the turbine's flow line \[-\].
    pub turbine_exponent: f64,
    /// Best turbine efficiency \[-\].
    pub turbine_efficiency: f64,
    /// Blade speed over isentropic jet speed at the best efficiency \[-\].
    pub best_speed_ratio: f64,
    /// Mechanical efficiency of the shaft \[-\].
    pub mechanical_efficiency: f64,
    /// Friction c_f \[W s2/rad2\].
    pub friction_w_s2: f64,
    /// Moment of inertia J of the rotor \[kg m2\].
    pub inertia_kg_m2: f64,
    /// Share of the heat of compression that the intercooler takes at little flow \[-\].
    pub cooling: f64,
    /// Conductance of the intercooler \[W/K\], by which that share falls with flow; 0: it does not.
    #[serde(default)]
    pub cooler_w_k: f64,
    /// Least shaft speed \[rad/s\]: where it stands while the turbine gives nothing.
    pub least_rad_s: f64,
    /// Pressure over the wastegate at which its flap lifts against the spring \[Pa\].
    pub flap_preload_pa: f64,
    /// Pressure above the preload at which it stands wide open \[Pa\].
    pub flap_range_pa: f64,
}

/// What the compressor does.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Compressor {
    /// Air into the charge pipe \[kg/s\].
    pub flow_kg_s: f64,
    /// Power taken from the shaft \[W\].
    pub power_w: f64,
    /// Share of that power which goes on with the air \[-\]; the rest leaves with what is recirculated.
    pub share: f64,
    /// More is recirculated than goes on.
    pub surge: bool,
}

/// Specific heat \[J/kg/K\], exponent R/c_p, ratio of specific heats times gas constant of ambient air.
const CP_AIR: f64 = 1006.0;
const KAPPA_AIR: f64 = 0.286_5;
const GAMMA_R_AIR: f64 = 1.4 * 287.06;
/// Head above the top of a speed line, over that top, at which all air is recirculated; and what is added to it \[J/kg\]:
/// 2 kPa, the pulses of an engine with open throttle, which move a slow wheel along its line and not off it.
pub const BYPASS: f64 = 0.04;
const PULSE_J_KG: f64 = 2000.0;
/// Effective inlet area of a wheel at rest over D^2 (inducer of 0.7 D, discharge 0.6).
const INLET: f64 = 0.23;
/// Near the top the ellipse would have an infinite slope, which no explicit step can follow: a line below this square.
const TOP: f64 = 1e-3;
/// The same for the flow of the turbine near equal pressures.
const LEVEL: f64 = 0.02;

/// A speed line: velocities m'/(rho D^2) \[m/s\] and heads \[J/kg\] of its two ends.
#[derive(Debug, Clone, Copy)]
struct SpeedLine {
    surge: f64,
    choke: f64,
    top: f64,
    foot: f64,
    mach: f64,
}

impl Turbocharger {
    fn line(&self, u: f64, ambient_k: f64) -> SpeedLine {
        let mach = u / (GAMMA_R_AIR * ambient_k).sqrt();
        let [s0, s1, s2] = self.surge_share;
        let vertex = if s2 > 0.0 { mach.max(-0.5 * s1 / s2) } else { mach };
        let share = (s0 + vertex * (s1 + vertex * s2)).clamp(0.02, 0.98);
        let choke = self.flow_coefficient * u * (self.choke_mach / mach.max(1e-9)).min(1.0);
        let head = (self.head_coefficient[0] + self.head_coefficient[1] * mach).max(0.1);
        let top = 0.5 * u * u * head;
        let foot = top * (self.choke_head[0] + self.choke_head[1] * mach).clamp(0.0, 0.95);
        SpeedLine { surge: share * choke, choke, top, foot, mach }
    }

    /// Flow \[kg/s\] at which the compressor surges at a shaft speed \[rad/s\], from air of `ambient_k` and density `rho`.
    pub fn surge_flow_kg_s(&self, w_rad_s: f64, ambient_k: f64, rho: f64) -> f64 {
        let line = self.line(0.5 * self.compressor_m * w_rad_s, ambient_k);
        rho * self.compressor_m * self.compressor_m * line.surge
    }

    /// Compressor between ambient air (`ambient_pa`, `ambient_k`, density `rho` \[kg/m3\]) and `p_pa` at shaft speed
    /// `w_rad_s`.
    #[inline]
    pub fn compressor(
        &self,
        w_rad_s: f64,
        p_pa: f64,
        ambient_pa: f64,
        ambient_k: f64,
        rho: f64,
    ) -> Compressor {
        let u = 0.5 * self.compressor_m * w_rad_s;
        let line = self.line(u, ambient_k);
        let head = CP_AIR * ambient_k * ((p_pa / ambient_pa).powf(KAPPA_AIR) - 1.0);
        let (wheel, out) = if head >= line.top {
            let open = (head - line.top) / (BYPASS * line.top + PULSE_J_KG);
            (line.surge, line.surge * (1.0 - open).max(0.0))
        } else if head > line.foot {
            let y = (head - line.foot) / (line.top - line.foot);
            let square = 1.0 - y * y;
            let root = if square < TOP { square / TOP.sqrt() } else { square.sqrt() };
            let v = line.surge + (line.choke - line.surge) * root;
            (v, v)
        } else {
            let still = (1.0 - line.mach * line.mach).max(0.0);
            let v = (line.choke * line.choke + 2.0 * INLET * INLET * still * (line.foot - head)).sqrt();
            (v, v)
        };
        let flow = rho * self.compressor_m * self.compressor_m * wheel;
        let [w0, w1] = self.work_coefficient;
        let work = u * u * (w0 - w1 * wheel / line.choke.max(1e-9)).max(0.0);
        let share = out / wheel.max(1e-12);
        Compressor { flow_kg_s: share * flow, power_w: flow * work, share, surge: share < 0.5 }
    }

    /// Flow of the turbine over that of the same area choked \[-\], at a pressure ratio `p7_p6` below one.
    #[inline]
    pub fn turbine_share(&self, p7_p6: f64) -> f64 {
        let square = -(self.turbine_exponent * p7_p6.ln()).exp_m1();
        if square < LEVEL { square / LEVEL.sqrt() } else { square.sqrt() }
    }

    /// Share \[-\] to which the pressure `over_pa` across it has lifted the flap of the wastegate.
    #[inline]
    pub fn flap_lift(&self, over_pa: f64) -> f64 {
        ((over_pa - self.flap_preload_pa) / self.flap_range_pa).clamp(0.0, 1.0)
    }

    /// Share of the heat of compression that the intercooler takes at a flow \[kg/s\], e (1 - exp(-UA/(m' c_p))): a heat
    /// exchanger whose other side does not warm (effectiveness and number of transfer units), with the share e of the air that
    /// meets it.
    #[inline]
    pub fn cooled_share(&self, flow_kg_s: f64) -> f64 {
        if self.cooler_w_k <= 0.0 || flow_kg_s <= 0.0 {
            return self.cooling;
        }
        self.cooling * -(-self.cooler_w_k / (flow_kg_s * CP_AIR)).exp_m1()
    }

    /// Power of the turbine \[W\] for `flow_kg_s` of gas of c_p \[J/kg/K\] and R/c_p `kappa`, expanded from `t_k` over the
    /// pressure ratio `p7_p6`.
    pub fn turbine_power_w(
        &self,
        w_rad_s: f64,
        flow_kg_s: f64,
        cp: f64,
        kappa: f64,
        t_k: f64,
        p7_p6: f64,
    ) -> f64 {
        if flow_kg_s <= 0.0 || p7_p6 >= 1.0 {
            return 0.0;
        }
        let drop = cp * t_k * -(kappa * p7_p6.ln()).exp_m1();
        let ratio = 0.5 * self.turbine_m * w_rad_s / ((2.0 * drop).sqrt() * self.best_speed_ratio);
        let efficiency = self.turbine_efficiency * (ratio * (2.0 - ratio)).max(0.1);
        efficiency * flow_kg_s * drop
    }

    /// dw/dt \[rad/s2\].
    pub fn acceleration(&self, w_rad_s: f64, turbine_w: f64, compressor_w: f64) -> f64 {
        let power =
            self.mechanical_efficiency * turbine_w - compressor_w - self.friction_w_s2 * w_rad_s * w_rad_s;
        if w_rad_s <= self.least_rad_s && power < 0.0 {
            return 0.0;
        }
        power / (self.inertia_kg_m2 * w_rad_s.max(self.least_rad_s))
    }
}
