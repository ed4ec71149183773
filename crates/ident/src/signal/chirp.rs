//! Linear chirp.

use std::f64::consts::TAU;

use dynocal_numerics::registry::{self, BuildError, Member, MemberDoc, ParamDoc};
use dynocal_numerics::rng::Rng64;
use serde::Deserialize;

use super::Signal;
use super::common::{check_positive, check_range, fault};

pub(super) const MEMBER: Member<dyn Signal> = Member {
    doc: MemberDoc {
        name: "chirp",
        what: "sine whose frequency moves linearly from f_start to f_end over the record",
        params: &[
            ParamDoc { name: "lo", unit: "channel", default: "", what: "least value" },
            ParamDoc { name: "hi", unit: "channel", default: "", what: "greatest value" },
            ParamDoc { name: "f_start_hz", unit: "Hz", default: "", what: "frequency at the start" },
            ParamDoc {
                name: "f_end_hz",
                unit: "Hz",
                default: "",
                what: "frequency at the end, below half the sample rate",
            },
        ],
    },
    build: |keys| {
        let signal: Chirp = registry::keys("chirp", keys)?;
        check_range("chirp", signal.lo, signal.hi)?;
        check_positive("chirp", "f_start_hz", signal.f_start_hz)?;
        check_positive("chirp", "f_end_hz", signal.f_end_hz)?;
        Ok(Box::new(signal))
    },
};

/// Phase `2 pi (f0 t + (f1 - f0) t^2 / (2 T))`, starting at the middle going up.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Chirp {
    lo: f64,
    hi: f64,
    f_start_hz: f64,
    f_end_hz: f64,
}

impl Signal for Chirp {
    fn fill(&self, u: &mut [f64], dt_s: f64, _rng: &mut Rng64) -> Result<(), BuildError> {
        check_positive("chirp", "sample time", dt_s)?;
        let highest = self.f_start_hz.max(self.f_end_hz);
        if highest >= 0.5 / dt_s {
            let limit = 0.5 / dt_s;
            return Err(fault(
                "chirp",
                format!("found {highest} Hz, expected below {limit} Hz (half the sample rate)"),
            ));
        }
        let record_s = u.len() as f64 * dt_s;
        for (i, x) in u.iter_mut().enumerate() {
            let t = i as f64 * dt_s;
            let cycles = self.f_start_hz * t + 0.5 * (self.f_end_hz - self.f_start_hz) * t * t / record_s;
            let f = 0.5 + 0.5 * (TAU * cycles.fract()).sin();
            *x = ((1.0 - f) * self.lo + f * self.hi).clamp(self.lo, self.hi);
        }
        Ok(())
    }
}
