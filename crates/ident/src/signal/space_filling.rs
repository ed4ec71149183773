//! Low-discrepancy levels: channels that together fill their box evenly.

use dynocal_numerics::registry::{self, BuildError, Member, MemberDoc, ParamDoc};
use dynocal_numerics::rng::Rng64;
use serde::Deserialize;

use super::Signal;
use super::common::{check_positive, check_range, displacement, fault, samples};

pub(super) const MEMBER: Member<dyn Signal> = Member {
    doc: MemberDoc {
        name: "space_filling",
        what: "levels of an additive recurrence that fills the box of all channels evenly, by steps or ramps",
        params: &[
            ParamDoc { name: "lo", unit: "channel", default: "", what: "lower end" },
            ParamDoc { name: "hi", unit: "channel", default: "", what: "upper end" },
            ParamDoc { name: "hold_s", unit: "s", default: "", what: "time at each level" },
            ParamDoc {
                name: "ramp_s",
                unit: "s",
                default: "0",
                what: "time from level to level, the same for all channels: the gradient is at most (hi - lo) / ramp_s",
            },
            ParamDoc { name: "channel", unit: "-", default: "1", what: "number of this channel, from 1" },
            ParamDoc { name: "channels", unit: "-", default: "1", what: "channels that share the box" },
        ],
    },
    build: |keys| {
        let signal: SpaceFilling = registry::keys("space_filling", keys)?;
        check_range("space_filling", signal.lo, signal.hi)?;
        if signal.channel < 1 || signal.channel > signal.channels || signal.channels > 64 {
            let message = format!(
                "found channel = {} of channels = {}, expected 1 up to the number of channels, at most 64",
                signal.channel, signal.channels
            );
            return Err(fault("space_filling", message));
        }
        Ok(Box::new(signal))
    },
};

/// Point k of d channels: `frac(s_j + k g^-j)`, j = 1..d, with g the positive root of `g^(d+1) = g + 1` (the golden
/// ratio for one channel) and a random shift s_j: the Kronecker sequence of M. Roberts (2018), randomised as by
/// R. Cranley and T. N. L. Patterson, SIAM J. Numer. Anal. 13 (1976) 904-914.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SpaceFilling {
    lo: f64,
    hi: f64,
    hold_s: f64,
    #[serde(default)]
    ramp_s: f64,
    #[serde(default = "one")]
    channel: u32,
    #[serde(default = "one")]
    channels: u32,
}

fn one() -> u32 {
    1
}

/// Positive root of `g^(d+1) = g + 1`, by the contraction `g = (1 + g)^(1 / (d+1))`.
fn root(d: u32) -> f64 {
    (0..100).fold(1.5f64, |g, _| (1.0 + g).powf(1.0 / f64::from(d + 1)))
}

impl Signal for SpaceFilling {
    fn fill(&self, u: &mut [f64], dt_s: f64, rng: &mut Rng64) -> Result<(), BuildError> {
        check_positive("space_filling", "sample time", dt_s)?;
        let hold = samples("space_filling", "hold_s", self.hold_s, dt_s)?;
        let ramp = displacement("space_filling", self.ramp_s, dt_s)?;
        let alpha = root(self.channels).powi(-(self.channel as i32));
        let shift = rng.uniform();
        let level = |k: usize| (shift + k as f64 * alpha).fract();
        for (t, x) in u.iter_mut().enumerate() {
            let (k, place) = (t / (hold + ramp), t % (hold + ramp));
            let f = if place < hold {
                level(k)
            } else {
                let share = (place - hold + 1) as f64 / (ramp + 1) as f64;
                (1.0 - share) * level(k) + share * level(k + 1)
            };
            *x = (1.0 - f) * self.lo + f * self.hi;
        }
        Ok(())
    }
}
