//! Multisine with Schroeder phases.
//!
//! ```text
//! u(t) ~ sum_{k=1}^{F} cos(2 pi f_k t + phi_k),   phi_k = -pi k (k - 1) / F
//! ```
//!
//! on the frequencies f_k that are multiples of 1 / record length, so that the spectrum is flat in the band and
//! zero elsewhere. (M. R. Schroeder, IEEE Trans. Inf. Theory 16 (1970) 85-89: low crest factor.)

use std::f64::consts::PI;

use dynocal_numerics::registry::{self, BuildError, Member, MemberDoc, ParamDoc};
use dynocal_numerics::rng::Rng64;
use serde::Deserialize;

use super::Signal;
use super::common::{check_positive, check_range, fault};

pub(super) const MEMBER: Member<dyn Signal> = Member {
    doc: MemberDoc {
        name: "multisine",
        what: "sum of sines with equal amplitudes in a band, Schroeder phases, scaled to the limits",
        params: &[
            ParamDoc { name: "lo", unit: "channel", default: "", what: "least value" },
            ParamDoc { name: "hi", unit: "channel", default: "", what: "greatest value" },
            ParamDoc { name: "f_min_hz", unit: "Hz", default: "", what: "lower end of the band" },
            ParamDoc {
                name: "f_max_hz",
                unit: "Hz",
                default: "",
                what: "upper end of the band, below half the sample rate",
            },
        ],
    },
    build: |keys| {
        let signal: Multisine = registry::keys("multisine", keys)?;
        check_range("multisine", signal.lo, signal.hi)?;
        check_positive("multisine", "f_min_hz", signal.f_min_hz)?;
        check_range("multisine band", signal.f_min_hz, signal.f_max_hz)?;
        Ok(Box::new(signal))
    },
};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Multisine {
    lo: f64,
    hi: f64,
    f_min_hz: f64,
    f_max_hz: f64,
}

impl Signal for Multisine {
    fn fill(&self, u: &mut [f64], dt_s: f64, _rng: &mut Rng64) -> Result<(), BuildError> {
        check_positive("multisine", "sample time", dt_s)?;
        let n = u.len();
        if n == 0 {
            return Ok(());
        }
        let record_s = n as f64 * dt_s;
        // Ends that are multiples up to rounding count as inside the band.
        let first = (self.f_min_hz * record_s - 1e-9).ceil().max(1.0) as usize;
        let last = (self.f_max_hz * record_s + 1e-9).floor() as usize;
        if last < first || 2 * last >= n {
            return Err(fault(
                "multisine",
                format!(
                    "found a band of {} to {} Hz, expected at least one multiple of {} Hz, below {} Hz",
                    self.f_min_hz,
                    self.f_max_hz,
                    1.0 / record_s,
                    0.5 / dt_s
                ),
            ));
        }
        let lines = last - first + 1;
        for (t, x) in u.iter_mut().enumerate() {
            let line = |k: usize| {
                let phase = -PI * (k * (k + 1)) as f64 / lines as f64;
                // The product is reduced modulo n first: the argument stays small and exact.
                (2.0 * PI * (((first + k) * t) % n) as f64 / n as f64 + phase).cos()
            };
            *x = (0..lines).map(line).sum();
        }
        // One gain for both sides, so that the mean is the middle of the limits and no line is added.
        let peak = u.iter().fold(0.0f64, |m, v| m.max(v.abs()));
        let (middle, half) = (0.5 * (self.lo + self.hi), 0.5 * (self.hi - self.lo));
        for x in u.iter_mut() {
            *x = (middle + half * *x / peak).clamp(self.lo, self.hi);
        }
        Ok(())
    }
}
