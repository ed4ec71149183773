//! Multisine with phases of low crest factor.
//!
//! ```text
//! u(t) ~ sum_{k=1}^{F} cos(2 pi f_k t + phi_k),   phi_k = -pi k (k - 1) / F
//! ```
//!
//! on the frequencies f_k that are multiples of 1 / record length, so that the spectrum is flat in the band and
//! zero elsewhere. (M. R. Schroeder, IEEE Trans. Inf. Theory 16 (1970) 85-89: low crest factor.)

use dynocal_numerics::registry::{self, BuildError, Member, MemberDoc, ParamDoc};
use dynocal_numerics::rng::Rng64;
use serde::Deserialize;

use super::Signal;
use super::common::{check_positive, check_range};
use super::lines::{Lines, scale_into};

pub(super) const MEMBER: Member<dyn Signal> = Member {
    doc: MemberDoc {
        name: "multisine",
        what: "sum of sines with equal amplitudes in a band and a low crest factor, scaled to the limits",
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
            ParamDoc {
                name: "phases",
                unit: "-",
                default: "schroeder",
                what: "schroeder; optimised (less crest factor by repeated clipping); random",
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

/// How the phases are chosen.
#[derive(Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Phases {
    #[default]
    Schroeder,
    Optimised,
    Random,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Multisine {
    lo: f64,
    hi: f64,
    f_min_hz: f64,
    f_max_hz: f64,
    #[serde(default)]
    phases: Phases,
}

impl Signal for Multisine {
    fn fill(&self, u: &mut [f64], dt_s: f64, rng: &mut Rng64) -> Result<(), BuildError> {
        check_positive("multisine", "sample time", dt_s)?;
        if u.is_empty() {
            return Ok(());
        }
        let lines = Lines::in_band("multisine", (self.f_min_hz, self.f_max_hz), u.len(), dt_s)?;
        let phases = match self.phases {
            Phases::Schroeder => lines.schroeder(),
            Phases::Optimised => lines.clipped(lines.schroeder()),
            Phases::Random => lines.random(rng),
        };
        scale_into(u, &lines.sum(&phases), self.lo, self.hi);
        Ok(())
    }
}
