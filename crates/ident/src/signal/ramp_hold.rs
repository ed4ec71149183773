//! Random levels reached with a limited gradient.

use dynocal_numerics::registry::{self, BuildError, Member, MemberDoc, ParamDoc};
use dynocal_numerics::rng::Rng64;
use serde::Deserialize;

use super::Signal;
use super::common::{check_positive, check_range, samples};

pub(super) const MEMBER: Member<dyn Signal> = Member {
    doc: MemberDoc {
        name: "ramp_hold",
        what: "uniform random levels, reached by ramps of one gradient, each held",
        params: &[
            ParamDoc { name: "lo", unit: "channel", default: "", what: "lower end" },
            ParamDoc { name: "hi", unit: "channel", default: "", what: "upper end" },
            ParamDoc { name: "rate_per_s", unit: "channel/s", default: "", what: "gradient of the ramps" },
            ParamDoc { name: "hold_s", unit: "s", default: "", what: "time at each level after its ramp" },
        ],
    },
    build: |keys| {
        let signal: RampHold = registry::keys("ramp_hold", keys)?;
        check_range("ramp_hold", signal.lo, signal.hi)?;
        check_positive("ramp_hold", "rate_per_s", signal.rate_per_s)?;
        Ok(Box::new(signal))
    },
};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RampHold {
    lo: f64,
    hi: f64,
    rate_per_s: f64,
    hold_s: f64,
}

impl Signal for RampHold {
    fn fill(&self, u: &mut [f64], dt_s: f64, rng: &mut Rng64) -> Result<(), BuildError> {
        let hold = samples("ramp_hold", "hold_s", self.hold_s, dt_s)?;
        let step = self.rate_per_s * dt_s;
        let mut value = rng.uniform_in(self.lo, self.hi);
        let (mut target, mut held) = (value, 0);
        for x in u.iter_mut() {
            if value == target {
                if held == hold {
                    target = rng.uniform_in(self.lo, self.hi);
                    held = 0;
                }
                held += 1;
            }
            // The last step of a ramp is the shorter one that meets the level.
            value += (target - value).clamp(-step, step);
            if (target - value).abs() <= 1e-12 * (self.hi - self.lo) {
                value = target;
            }
            *x = value;
        }
        Ok(())
    }
}
