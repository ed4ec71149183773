//! Triangular sweep with dwell at the ends.

use dynocal_numerics::registry::{self, BuildError, Member, MemberDoc, ParamDoc};
use dynocal_numerics::rng::Rng64;
use serde::Deserialize;

use super::Signal;
use super::common::{check_positive, check_range, fault};

pub(super) const MEMBER: Member<dyn Signal> = Member {
    doc: MemberDoc {
        name: "sweep",
        what: "triangular sweep between two ends with a dwell at each",
        params: &[
            ParamDoc { name: "lo", unit: "channel", default: "", what: "lower end, where it starts" },
            ParamDoc { name: "hi", unit: "channel", default: "", what: "upper end" },
            ParamDoc {
                name: "period_s",
                unit: "s",
                default: "",
                what: "time of up, dwell, down and dwell together",
            },
            ParamDoc { name: "dwell_s", unit: "s", default: "0", what: "time at each end" },
            ParamDoc { name: "phase_s", unit: "s", default: "0", what: "how far into the period it starts" },
        ],
    },
    build: |keys| {
        let signal: Sweep = registry::keys("sweep", keys)?;
        check_range("sweep", signal.lo, signal.hi)?;
        check_positive("sweep", "period_s", signal.period_s)?;
        if !(signal.dwell_s >= 0.0 && 2.0 * signal.dwell_s < signal.period_s) {
            let half = 0.5 * signal.period_s;
            return Err(fault(
                "sweep",
                format!("found dwell_s = {}, expected 0 to below {half} (half the period)", signal.dwell_s),
            ));
        }
        if !signal.phase_s.is_finite() {
            return Err(fault(
                "sweep",
                format!("found phase_s = {}, expected a finite number", signal.phase_s),
            ));
        }
        Ok(Box::new(signal))
    },
};

/// Dwell at lo, ramp up, dwell at hi, ramp down; the slope is `(hi - lo) / (period / 2 - dwell)`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Sweep {
    lo: f64,
    hi: f64,
    period_s: f64,
    #[serde(default)]
    dwell_s: f64,
    #[serde(default)]
    phase_s: f64,
}

impl Signal for Sweep {
    fn fill(&self, u: &mut [f64], dt_s: f64, _rng: &mut Rng64) -> Result<(), BuildError> {
        check_positive("sweep", "sample time", dt_s)?;
        let half = 0.5 * self.period_s;
        let ramp = half - self.dwell_s;
        for (t, x) in u.iter_mut().enumerate() {
            let time = (t as f64 * dt_s + self.phase_s).rem_euclid(self.period_s);
            let (into, down) = if time < half { (time, false) } else { (time - half, true) };
            let risen = ((into - self.dwell_s) / ramp).clamp(0.0, 1.0);
            let f = if down { 1.0 - risen } else { risen };
            *x = (1.0 - f) * self.lo + f * self.hi;
        }
        Ok(())
    }
}
