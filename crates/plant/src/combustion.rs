//! Wiebe heat release and the burn sub-model.

use crate::geometry::Geometry;
use serde::{Deserialize, Serialize};

/// Wiebe function x_b = 1 - exp(-a ((phi - phi_0)/D)^(m+1)) with D the 10-90 % duration; with a tail, the share s of the
/// fuel burns by a second one of [`TAIL`] times the duration from the same start.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Wiebe {
    /// Start of burn phi_0 \[deg after firing TDC\].
    pub start_deg: f64,
    /// Duration D from 10 to 90 % burned \[deg\].
    pub duration_deg: f64,
    /// Exponent m \[-\].
    pub m: f64,
    /// Efficiency factor a \[-\], fixed by m and the meaning of D.
    pub a: f64,
    /// Share s of the tail \[-\].
    #[serde(default)]
    pub tail: f64,
}

/// Duration of the tail over that of the main burn.
pub const TAIL: f64 = 2.5;

impl Wiebe {
    /// a = (ln(10)^(1/(m+1)) - ln(1/0.9)^(1/(m+1)))^(m+1).
    pub fn new(start_deg: f64, duration_deg: f64, m: f64) -> Self {
        let k = 1.0 / (m + 1.0);
        let a = (10f64.ln().powf(k) - (1.0 / 0.9f64).ln().powf(k)).powf(m + 1.0);
        Self { start_deg, duration_deg, m, a, tail: 0.0 }
    }

    /// The same curve with delay after the spark and duration times `factor`.
    #[must_use]
    pub fn stretched(self, spark_deg: f64, factor: f64) -> Self {
        if factor == 1.0 {
            return self;
        }
        let start_deg = -spark_deg + factor * (self.start_deg + spark_deg);
        Self { start_deg, duration_deg: factor * self.duration_deg, ..self }
    }

    /// The same curve with the share `tail` burning slowly.
    #[must_use]
    pub fn with_tail(self, tail: f64) -> Self {
        Self { tail, ..self }
    }

    /// Angle after the start at which the fraction `x` of the main burn is burned, over the duration.
    fn place(&self, x: f64) -> f64 {
        (-(-x).ln_1p() / self.a).powf(1.0 / (self.m + 1.0))
    }

    /// Burned fraction x_b at `phi_deg`.
    pub fn burned(&self, phi_deg: f64) -> f64 {
        let y = (phi_deg - self.start_deg) / self.duration_deg;
        let part = |y: f64| if y <= 0.0 { 0.0 } else { -(-self.a * y.powf(self.m + 1.0)).exp_m1() };
        if self.tail == 0.0 {
            return part(y);
        }
        (1.0 - self.tail) * part(y) + self.tail * part(y / TAIL)
    }

    /// dx_b/dphi \[1/deg\].
    #[inline]
    pub fn rate_per_deg(&self, phi_deg: f64) -> f64 {
        let y = (phi_deg - self.start_deg) / self.duration_deg;
        if self.tail == 0.0 {
            return self.rate(y);
        }
        (1.0 - self.tail) * self.rate(y) + self.tail / TAIL * self.rate(y / TAIL)
    }

    #[inline]
    fn rate(&self, y: f64) -> f64 {
        if y <= 0.0 {
            return 0.0;
        }
        // m = 2 is the exponent of the maps (thesis 6.4); a general power costs two more calls.
        let y_m = if self.m == 2.0 { y * y } else { y.powf(self.m) };
        let argument = self.a * y_m * y;
        if argument > 45.0 {
            return 0.0;
        }
        self.a * (self.m + 1.0) / self.duration_deg * y_m * (-argument).exp()
    }

    /// Angle \[deg\] at which the fraction `x` (0 < x < 1) is burned.
    pub fn angle_of_fraction_deg(&self, x: f64) -> f64 {
        let y = self.place(x);
        let main = self.start_deg + self.duration_deg * y;
        if self.tail == 0.0 {
            return main;
        }
        // Between the angle of the main burn and that of the tail alone.
        let (mut low, mut high) = (main, self.start_deg + TAIL * self.duration_deg * y);
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            if self.burned(middle) < x { low = middle } else { high = middle }
        }
        0.5 * (low + high)
    }
}

/// Constants of the burn sub-model and of the combustion efficiency.
///
/// The delay and duration scale with a product of ratios (form after Lindstrom 2005)
/// F = (N/2000)^n_exp S(x_r)^-xr_exp (m_trap/280 mg)^-mass_exp S_lam^-lambda_exp and a late/early
/// burn correction; phi_0 = -SA + delay F, D = duration F.
///
/// With `state_exponent` s above 0 the flame also feels how far the charge is compressed where it burns: the time to 10 %
/// burned goes with (V/V_0)^s in its middle, V_0 at 10 deg before dead centre, and D with (V/V_1)^s at 50 % burned, V_1 at
/// 8 deg after it. Eddy burning gives both times as nu^(1/3) S_L^(-2/3) (Hires, Tabaczynski and Novak, SAE 780232, as
/// quoted by Heywood 1988, 14.3.4; cited from memory, not looked up); on an isentrope with S_L as T^2.18 p^-0.16 (Metghalchi and Keck) that is V^0.6, and
/// over mass -0.23.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BurnModel {
    /// 10-90 % duration at F = 1 \[deg\].
    pub duration_deg: f64,
    /// Delay from spark to the start of the Wiebe function at F = 1 \[deg\].
    pub delay_deg: f64,
    /// Exponent of speed.
    pub speed_exponent: f64,
    /// Exponent of the residual factor S(x) = max(0.22, 1 - 2.06 x^0.77).
    pub residual_exponent: f64,
    /// Exponent of trapped mass over 280 mg.
    pub mass_exponent: f64,
    /// Exponent of the mixture factor S_lam; 0 in thesis mode, 0.6 in physical mode.
    pub lambda_exponent: f64,
    /// Weight of the late-burn correction 1 + late z^2, z = (c50 - 8)/10 limited to 0..2.
    pub late_weight: f64,
    /// Weight of the early-burn correction 1 + early z^2, z limited to -2..0.
    pub early_weight: f64,
    /// Combustion efficiency at lambda 1 \[-\] (also absorbs dissociation).
    pub efficiency: f64,
    /// Gain of efficiency away from lambda 1 \[-\], width 0.08.
    pub efficiency_bump: f64,
    /// Lambda at which half of the fuel stays unburned.
    pub lean_limit_lambda: f64,
    /// Width of the lean limit in lambda.
    pub lean_width_lambda: f64,
    /// Exponent s of the volume where the charge burns \[-\]; 0 leaves it out.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub state_exponent: f64,
    /// End of heat release \[deg ATDC\].
    pub end_deg: f64,
    /// Share of the fuel that burns in a slow tail ([`TAIL`]) \[-\].
    #[serde(default)]
    pub tail_share: f64,
    /// Limit of dilution; absent, burned gas never puts the flame out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dilution: Option<DilutionLimit>,
}

/// Share of cycles that burn against the share of burned gas in the charge: 1/(1 + exp((x - limit)/width)).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DilutionLimit {
    /// Share of burned gas (residual and recirculated) at which half of the fuel stays unburned \[-\].
    pub limit: f64,
    /// Width \[-\].
    pub width: f64,
}

/// Charge of one cylinder when the burn is latched.
#[derive(Debug, Clone, Copy)]
pub struct Charge {
    /// Speed \[rpm\].
    pub speed_rpm: f64,
    /// Spark advance \[deg BTDC\].
    pub spark_deg: f64,
    /// Wiebe exponent.
    pub wiebe_m: f64,
    /// Imposed 10-90 % duration \[deg\] instead of the sub-model.
    pub duration_deg: Option<f64>,
    /// Trapped mass \[kg\].
    pub trapped_kg: f64,
    /// Residual fraction \[-\].
    pub residual: f64,
    /// Lambda of the charge.
    pub lambda: f64,
}

/// Angles \[deg ATDC\] whose volumes the exponent of the state is relative to: development of the flame, main burn.
const DEVELOPS_DEG: f64 = -10.0;
const BURNS_DEG: f64 = 8.0;

// The signature is serde's.
#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde calls it with a reference")]
fn is_zero(x: &f64) -> bool {
    *x == 0.0
}

/// Laminar flame speed over that without burned gas, S(x) = max(0.22, 1 - 2.06 x^0.77).
fn residual_factor(residual: f64) -> f64 {
    (1.0 - 2.06 * residual.max(0.0).powf(0.77)).max(0.22)
}

/// Laminar flame speed over that at lambda 1, a parabola over the equivalence ratio, 0.12 at least.
fn mixture_factor(lambda: f64) -> f64 {
    let parabola = |phi: f64| 30.5 - 54.9 * (phi - 1.21) * (phi - 1.21);
    (parabola(1.0 / lambda) / parabola(1.0)).max(0.12)
}

/// By how much the flame of a charge is slower than at lambda 1 with a tenth of burned gas \[-\], by the laminar flame speeds
/// of the burn sub-model ([`BurnModel`]); 1 there, above 1 where the charge is diluted more.
pub fn flame_slowness(lambda: f64, residual: f64) -> f64 {
    residual_factor(0.1) / (residual_factor(residual) * mixture_factor(lambda))
}

impl BurnModel {
    /// Thesis mode: the burn does not depend on lambda and there is no hard misfire limit.
    pub fn thesis() -> Self {
        Self {
            duration_deg: 19.85,
            delay_deg: 3.95,
            speed_exponent: 0.26,
            residual_exponent: 0.30,
            mass_exponent: 0.22,
            lambda_exponent: 0.0,
            late_weight: 0.20,
            early_weight: 0.04,
            efficiency: 0.895,
            efficiency_bump: 0.03,
            lean_limit_lambda: 4.0,
            lean_width_lambda: 0.40,
            state_exponent: 0.0,
            end_deg: 170.0,
            tail_share: 0.0,
            dilution: None,
        }
    }

    /// Share of cycles that burn: lean limit and, where there is one, limit of dilution.
    pub fn stability(&self, lambda: f64, residual: f64) -> f64 {
        let lean = 1.0 / (1.0 + ((lambda - self.lean_limit_lambda) / self.lean_width_lambda).exp());
        lean * self.dilution_share(residual)
    }

    /// The limit of dilution alone.
    pub fn dilution_share(&self, residual: f64) -> f64 {
        self.dilution.map_or(1.0, |d| 1.0 / (1.0 + ((residual - d.limit) / d.width).exp()))
    }

    /// Share of min(fuel, air/AFR) that burns.
    pub fn burnable_share(&self, lambda: f64) -> f64 {
        let d = (lambda - 1.0) / 0.08;
        let top = self.efficiency + self.efficiency_bump * (1.0 - (-d * d).exp());
        top / (1.0 + ((lambda - self.lean_limit_lambda) / self.lean_width_lambda).exp())
    }

    /// Wiebe function of the cycle in a cylinder of these dimensions.
    pub fn wiebe(&self, c: &Charge, geometry: &Geometry) -> Wiebe {
        let s_xr = residual_factor(c.residual);
        let mut f = (c.speed_rpm / 2000.0).powf(self.speed_exponent)
            * s_xr.powf(-self.residual_exponent)
            * (c.trapped_kg.max(1e-6) / 280e-6).powf(-self.mass_exponent);
        if self.lambda_exponent != 0.0 {
            let s_lambda = mixture_factor(c.lambda);
            f *= s_lambda.powf(-self.lambda_exponent);
        }
        // 1.0434 = (ln 2/a)^(1/3) places CA50 for m = 2; the correction is defined with it.
        let c50 = -c.spark_deg + f * (self.delay_deg + 1.0434 * self.duration_deg);
        let z = ((c50 - 8.0) / 10.0).clamp(-2.0, 2.0);
        f *= 1.0 + if z > 0.0 { self.late_weight } else { self.early_weight } * z * z;
        let duration = c.duration_deg.unwrap_or(self.duration_deg * f);
        let wiebe =
            Wiebe::new(-c.spark_deg + self.delay_deg * f, duration, c.wiebe_m).with_tail(self.tail_share);
        if self.state_exponent == 0.0 {
            return wiebe;
        }
        self.compressed(wiebe, c, geometry)
    }

    /// The burn `w` of a charge whose compression was not looked at, with it.
    fn compressed(&self, w: Wiebe, c: &Charge, geometry: &Geometry) -> Wiebe {
        let volume = |deg: f64| geometry.volume_m3(deg.to_radians());
        let longer = |deg: f64, reference: f64| (volume(deg) / volume(reference)).powf(self.state_exponent);
        let [tenth, half] = [0.1, 0.5].map(|x| w.place(x));
        let first_deg = w.start_deg + tenth * w.duration_deg + c.spark_deg;
        let first_deg = first_deg * longer(0.5 * first_deg - c.spark_deg, DEVELOPS_DEG);
        let ca10_deg = first_deg - c.spark_deg;
        let ca50_deg = ca10_deg + (half - tenth) * w.duration_deg;
        let duration_deg = match c.duration_deg {
            Some(imposed) => imposed,
            None => w.duration_deg * longer(ca50_deg, BURNS_DEG),
        };
        Wiebe { start_deg: ca10_deg - tenth * duration_deg, duration_deg, ..w }
    }
}
