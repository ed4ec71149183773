//! Band-limited white noise.

use dynocal_numerics::registry::{self, BuildError, Member, MemberDoc, ParamDoc};
use dynocal_numerics::rng::Rng64;
use serde::Deserialize;

use super::Signal;
use super::common::{check_positive, check_range, fault};
use super::lines::{Lines, scale_into};

pub(super) const MEMBER: Member<dyn Signal> = Member {
    doc: MemberDoc {
        name: "band_noise",
        what: "white noise in a band, nothing outside it, scaled to the limits",
        params: &[
            ParamDoc { name: "lo", unit: "channel", default: "", what: "least value" },
            ParamDoc { name: "hi", unit: "channel", default: "", what: "greatest value" },
            ParamDoc {
                name: "f_max_hz",
                unit: "Hz",
                default: "",
                what: "upper end of the band, below half the sample rate",
            },
            ParamDoc { name: "f_min_hz", unit: "Hz", default: "0", what: "lower end of the band" },
        ],
    },
    build: |keys| {
        let signal: BandNoise = registry::keys("band_noise", keys)?;
        check_range("band_noise", signal.lo, signal.hi)?;
        check_positive("band_noise", "f_max_hz", signal.f_max_hz)?;
        if !(signal.f_min_hz >= 0.0 && signal.f_min_hz < signal.f_max_hz) {
            let message = format!("found f_min_hz = {}, expected 0 up to f_max_hz", signal.f_min_hz);
            return Err(fault("band_noise", message));
        }
        Ok(Box::new(signal))
    },
};

/// Every line of the band with the same amplitude and a random phase: by the central limit theorem the amplitudes tend
/// to a normal distribution as lines become many, and no power at all leaves the band. (J. Schoukens, R. Pintelon, Y.
/// Rolain, Mastering System Identification in 100 Exercises, Wiley 2012: random-phase multisine.)
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct BandNoise {
    lo: f64,
    hi: f64,
    f_max_hz: f64,
    #[serde(default)]
    f_min_hz: f64,
}

impl Signal for BandNoise {
    fn fill(&self, u: &mut [f64], dt_s: f64, rng: &mut Rng64) -> Result<(), BuildError> {
        check_positive("band_noise", "sample time", dt_s)?;
        if u.is_empty() {
            return Ok(());
        }
        let lines = Lines::in_band("band_noise", (self.f_min_hz, self.f_max_hz), u.len(), dt_s)?;
        let sum = lines.sum(&lines.random(rng));
        scale_into(u, &sum, self.lo, self.hi);
        Ok(())
    }
}
