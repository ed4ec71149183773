//! Random binary signal.

use dynocal_numerics::registry::{self, BuildError, Member, MemberDoc, ParamDoc};
use dynocal_numerics::rng::Rng64;
use serde::Deserialize;

use super::Signal;
use super::common::{check_range, fault, samples};

pub(super) const MEMBER: Member<dyn Signal> = Member {
    doc: MemberDoc {
        name: "rbs",
        what: "two levels, changed at random at each clock",
        params: &[
            ParamDoc { name: "lo", unit: "channel", default: "", what: "lower level" },
            ParamDoc { name: "hi", unit: "channel", default: "", what: "upper level" },
            ParamDoc { name: "hold_s", unit: "s", default: "", what: "clock: least time at a level" },
            ParamDoc {
                name: "change",
                unit: "-",
                default: "0.5",
                what: "probability of a change at each clock: 0.5 is white, less is slower",
            },
        ],
    },
    build: |keys| {
        let signal: Rbs = registry::keys("rbs", keys)?;
        check_range("rbs", signal.lo, signal.hi)?;
        if !(signal.change > 0.0 && signal.change < 1.0) {
            let message = format!("found change = {}, expected a probability between 0 and 1", signal.change);
            return Err(fault("rbs", message));
        }
        Ok(Box::new(signal))
    },
};

/// With probability p of a change the autocorrelation over k clocks is `(1 - 2 p)^k` (of the levels -1 and 1).
/// (H. J. A. F. Tulleken, Automatica 26 (1990) 37-49: generalised binary noise.)
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Rbs {
    lo: f64,
    hi: f64,
    hold_s: f64,
    #[serde(default = "half")]
    change: f64,
}

fn half() -> f64 {
    0.5
}

impl Signal for Rbs {
    fn fill(&self, u: &mut [f64], dt_s: f64, rng: &mut Rng64) -> Result<(), BuildError> {
        let hold = samples("rbs", "hold_s", self.hold_s, dt_s)?;
        let mut high = rng.below(2) == 1;
        for (t, x) in u.iter_mut().enumerate() {
            if t > 0 && t % hold == 0 && rng.uniform() < self.change {
                high = !high;
            }
            *x = if high { self.hi } else { self.lo };
        }
        Ok(())
    }
}
