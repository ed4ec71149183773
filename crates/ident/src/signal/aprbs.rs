//! Amplitude-modulated pseudo-random signal.

use dynocal_numerics::registry::{self, BuildError, Member, MemberDoc, ParamDoc};
use dynocal_numerics::rng::Rng64;
use serde::Deserialize;

use super::Signal;
use super::common::{check_range, displacement, fault, samples};

pub(super) const MEMBER: Member<dyn Signal> = Member {
    doc: MemberDoc {
        name: "aprbs",
        what: "random equidistant levels with a fixed hold, never the same level twice in a row",
        params: &[
            ParamDoc { name: "lo", unit: "channel", default: "", what: "lowest level" },
            ParamDoc { name: "hi", unit: "channel", default: "", what: "highest level" },
            ParamDoc { name: "levels", unit: "-", default: "5", what: "number of levels" },
            ParamDoc { name: "hold_s", unit: "s", default: "3", what: "time at each level" },
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
        let phase = displacement("aprbs", self.phase_s, dt_s)? % hold;
        let mut level = rng.below(self.levels);
        for t in 0..u.len() {
            if t > 0 && (t + phase) % hold == 0 {
                // One of the other levels, all equally likely.
                level = (level + 1 + rng.below(self.levels - 1)) % self.levels;
            }
            // The exact ends, without rounding.
            let f = level as f64 / (self.levels - 1) as f64;
            u[t] = (1.0 - f) * self.lo + f * self.hi;
        }
        Ok(())
    }
}
