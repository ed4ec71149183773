//! Amplitude-modulated pseudo-random signal.

use dynocal_numerics::registry::{self, BuildError, Member, MemberDoc, ParamDoc};
use dynocal_numerics::rng::Rng64;
use serde::Deserialize;

use super::Signal;
use super::common::{check_range, displacement, fault, samples};

pub(super) const MEMBER: Member<dyn Signal> = Member {
    doc: MemberDoc {
        name: "aprbs",
        what: "random equidistant levels with a fixed or random hold, never the same level twice in a row",
        params: &[
            ParamDoc { name: "lo", unit: "channel", default: "", what: "lowest level" },
            ParamDoc { name: "hi", unit: "channel", default: "", what: "highest level" },
            ParamDoc { name: "levels", unit: "-", default: "5", what: "number of levels" },
            ParamDoc {
                name: "hold_s",
                unit: "s",
                default: "3",
                what: "time at each level, or the least of it",
            },
            ParamDoc {
                name: "hold_max_s",
                unit: "s",
                default: "hold_s",
                what: "greatest time at a level: each is drawn evenly between the two",
            },
            ParamDoc {
                name: "phase_s",
                unit: "s",
                default: "0",
                what: "how much earlier the channel switches: displaces channels against each other",
            },
        ],
    },
    build: |keys| {
        let signal: Aprbs = registry::keys("aprbs", keys)?;
        check_range("aprbs", signal.lo, signal.hi)?;
        if signal.levels < 2 {
            return Err(fault("aprbs", format!("found levels = {}, expected at least 2", signal.levels)));
        }
        Ok(Box::new(signal))
    },
};

/// Levels `lo + (hi - lo) k / (levels - 1)`; the next one is drawn from the others.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Aprbs {
    lo: f64,
    hi: f64,
    #[serde(default = "five")]
    levels: usize,
    #[serde(default = "three")]
    hold_s: f64,
    hold_max_s: Option<f64>,
    #[serde(default)]
    phase_s: f64,
}

fn five() -> usize {
    5
}

fn three() -> f64 {
    3.0
}

impl Signal for Aprbs {
    fn fill(&self, u: &mut [f64], dt_s: f64, rng: &mut Rng64) -> Result<(), BuildError> {
        let hold = samples("aprbs", "hold_s", self.hold_s, dt_s)?;
        let longest = samples("aprbs", "hold_max_s", self.hold_max_s.unwrap_or(self.hold_s), dt_s)?;
        if longest < hold {
            let message = format!("found hold_max_s = {} s, expected at least hold_s", longest as f64 * dt_s);
            return Err(fault("aprbs", message));
        }
        let phase = displacement("aprbs", self.phase_s, dt_s)? % hold;
        let mut level = rng.below(self.levels);
        let draw = |rng: &mut Rng64| if longest > hold { hold + rng.below(longest - hold + 1) } else { hold };
        let mut left = draw(rng) - phase;
        for x in u.iter_mut() {
            if left == 0 {
                // One of the other levels, all equally likely.
                level = (level + 1 + rng.below(self.levels - 1)) % self.levels;
                left = draw(rng);
            }
            left -= 1;
            // The exact ends, without rounding.
            let f = level as f64 / (self.levels - 1) as f64;
            *x = (1.0 - f) * self.lo + f * self.hi;
        }
        Ok(())
    }
}
