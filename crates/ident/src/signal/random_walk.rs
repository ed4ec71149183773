//! Random walk between two limits.

use dynocal_numerics::registry::{self, BuildError, Member, MemberDoc, ParamDoc};
use dynocal_numerics::rng::Rng64;
use serde::Deserialize;

use super::Signal;
use super::common::{check_positive, check_range, fault, samples};

pub(super) const MEMBER: Member<dyn Signal> = Member {
    doc: MemberDoc {
        name: "random_walk",
        what: "steps of fixed size up or down, reflected at the limits",
        params: &[
            ParamDoc { name: "lo", unit: "channel", default: "", what: "lower limit" },
            ParamDoc { name: "hi", unit: "channel", default: "", what: "upper limit" },
            ParamDoc { name: "step", unit: "channel", default: "", what: "size of a step, at most hi - lo" },
            ParamDoc { name: "hold_s", unit: "s", default: "", what: "time between steps" },
        ],
    },
    build: |keys| {
        let signal: RandomWalk = registry::keys("random_walk", keys)?;
        check_range("random_walk", signal.lo, signal.hi)?;
        check_positive("random_walk", "step", signal.step)?;
        if signal.step > signal.hi - signal.lo {
            let range = signal.hi - signal.lo;
            return Err(fault(
                "random_walk",
                format!("found step = {}, expected at most {range}", signal.step),
            ));
        }
        Ok(Box::new(signal))
    },
};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RandomWalk {
    lo: f64,
    hi: f64,
    step: f64,
    hold_s: f64,
}

impl Signal for RandomWalk {
    fn fill(&self, u: &mut [f64], dt_s: f64, rng: &mut Rng64) -> Result<(), BuildError> {
        let hold = samples("random_walk", "hold_s", self.hold_s, dt_s)?;
        let mut value = rng.uniform_in(self.lo, self.hi);
        for t in 0..u.len() {
            if t > 0 && t % hold == 0 {
                value += if rng.below(2) == 0 { self.step } else { -self.step };
                // A mirror at each limit keeps the walk inside without stopping it there.
                if value > self.hi {
                    value = 2.0 * self.hi - value;
                } else if value < self.lo {
                    value = 2.0 * self.lo - value;
                }
                value = value.clamp(self.lo, self.hi);
            }
            u[t] = value;
        }
        Ok(())
    }
}
