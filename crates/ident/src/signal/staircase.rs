//! Staircase up and down.

use dynocal_numerics::registry::{self, BuildError, Member, MemberDoc, ParamDoc};
use dynocal_numerics::rng::Rng64;
use serde::Deserialize;

use super::Signal;
use super::common::{check_range, fault, samples};

pub(super) const MEMBER: Member<dyn Signal> = Member {
    doc: MemberDoc {
        name: "staircase",
        what: "equal steps from lo to hi and back, repeated",
        params: &[
            ParamDoc { name: "lo", unit: "channel", default: "", what: "first and lowest level" },
            ParamDoc { name: "hi", unit: "channel", default: "", what: "highest level" },
            ParamDoc { name: "levels", unit: "-", default: "5", what: "number of levels" },
            ParamDoc { name: "hold_s", unit: "s", default: "", what: "time at each level" },
        ],
    },
    build: |keys| {
        let signal: Staircase = registry::keys("staircase", keys)?;
        check_range("staircase", signal.lo, signal.hi)?;
        if signal.levels < 2 {
            return Err(fault("staircase", format!("found levels = {}, expected at least 2", signal.levels)));
        }
        Ok(Box::new(signal))
    },
};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Staircase {
    lo: f64,
    hi: f64,
    #[serde(default = "five")]
    levels: usize,
    hold_s: f64,
}

fn five() -> usize {
    5
}

impl Signal for Staircase {
    fn fill(&self, u: &mut [f64], dt_s: f64, _rng: &mut Rng64) -> Result<(), BuildError> {
        let hold = samples("staircase", "hold_s", self.hold_s, dt_s)?;
        let top = self.levels - 1;
        for (t, x) in u.iter_mut().enumerate() {
            let place = t / hold % (2 * top);
            let f = place.min(2 * top - place) as f64 / top as f64;
            *x = (1.0 - f) * self.lo + f * self.hi;
        }
        Ok(())
    }
}
