//! Named pairs of PI loops that hold torque by the throttle and lambda by the injected fuel (thesis section 7.4,
//! eq. 7.5). The step itself is [`dynocal_ident::pi`].

use dynocal_ident::pi::PiGains;
use serde::{Deserialize, Serialize};

/// Gains of both loops: throttle in deg per Nm, fuel in mg per unit of lambda.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LoopGains {
    /// Throttle from torque error.
    pub torque: PiGains,
    /// Fuel from lambda error (negative: too lean asks for more fuel).
    pub lambda: PiGains,
}

impl LoopGains {
    /// The published pair of eq. 7.5. It is stable but lets lambda swing from about 0.4 to 3.
    pub const THESIS: LoopGains =
        LoopGains { torque: PiGains { ki: 0.3, kp: 0.7 }, lambda: PiGains { ki: -20.0, kp: -1.5 } };

    /// Retuned pair: keeps lambda inside about 0.57 to 1.51 on the same references.
    pub const RETUNED: LoopGains =
        LoopGains { torque: PiGains { ki: 0.3, kp: 0.2 }, lambda: PiGains { ki: -40.0, kp: -8.0 } };

    /// The published pair of the static calibration, eq. 6.1.
    pub const STATIC: LoopGains =
        LoopGains { torque: PiGains { ki: 0.15, kp: 0.007 }, lambda: PiGains { ki: -20.0, kp: -1.5 } };

    /// A small pair that only trims a feedforward: it holds a promised torque and lambda without taking over.
    pub const TRIM: LoopGains =
        LoopGains { torque: PiGains { ki: 0.3, kp: 0.05 }, lambda: PiGains { ki: -10.0, kp: -1.5 } };

    /// The pair of that name.
    pub fn named(name: &str) -> Option<LoopGains> {
        match name {
            "thesis" => Some(Self::THESIS),
            "retuned" => Some(Self::RETUNED),
            "static" => Some(Self::STATIC),
            "trim" => Some(Self::TRIM),
            _ => None,
        }
    }

    /// Names that [`LoopGains::named`] knows.
    pub const NAMES: &'static [&'static str] = &["retuned", "thesis", "static", "trim"];
}
