//! Uniformly distributed random numbers with hold.

use dynocal_numerics::registry::{self, BuildError, Member, MemberDoc, ParamDoc};
use dynocal_numerics::rng::Rng64;
use serde::Deserialize;

use super::Signal;
use super::common::{check_range, displacement, samples};

pub(super) const MEMBER: Member<dyn Signal> = Member {
    doc: MemberDoc {
        name: "udrn",
        what: "independent uniform random values, each held",
        params: &[
            ParamDoc { name: "lo", unit: "channel", default: "", what: "lower end" },
            ParamDoc { name: "hi", unit: "channel", default: "", what: "upper end" },
            ParamDoc { name: "hold_s", unit: "s", default: "", what: "time at each value" },
            ParamDoc {
                name: "phase_s",
                unit: "s",
                default: "0",
                what: "how much earlier the channel switches",
            },
        ],
    },
    build: |keys| {
        let signal: Udrn = registry::keys("udrn", keys)?;
        check_range("udrn", signal.lo, signal.hi)?;
        Ok(Box::new(signal))
    },
};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Udrn {
    lo: f64,
    hi: f64,
    hold_s: f64,
    #[serde(default)]
    phase_s: f64,
}

impl Signal for Udrn {
    fn fill(&self, u: &mut [f64], dt_s: f64, rng: &mut Rng64) -> Result<(), BuildError> {
        let hold = samples("udrn", "hold_s", self.hold_s, dt_s)?;
        let phase = displacement("udrn", self.phase_s, dt_s)? % hold;
        let mut value = rng.uniform_in(self.lo, self.hi);
        for t in 0..u.len() {
            if t > 0 && (t + phase) % hold == 0 {
                value = rng.uniform_in(self.lo, self.hi);
            }
            u[t] = value;
        }
        Ok(())
    }
}
