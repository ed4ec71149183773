//! Test signals: the contract and its table.
//!
//! ```
//! use dynocal_ident::signal;
//! use dynocal_numerics::rng::Rng64;
//! let keys = toml::from_str("lo = 10\nhi = 90\nhold_s = 3")?;
//! let mut torque_nm = vec![0.0; 2000];
//! signal::signal("aprbs", &keys)?.fill(&mut torque_nm, 0.03, &mut Rng64::new(1))?;
//! assert!(torque_nm.iter().all(|v| [10.0, 30.0, 50.0, 70.0, 90.0].contains(v)));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod analysis;
mod aprbs;
mod band_noise;
mod chirp;
mod common;
mod lines;
mod multisine;
mod prbs;
mod ramp_hold;
mod random_walk;
mod rbs;
mod space_filling;
mod staircase;
mod sweep;
mod udrn;

use dynocal_numerics::registry::{self, BuildError, Member, MemberDoc};
use dynocal_numerics::rng::Rng64;

/// A test signal: fills one channel from its parameters, the sample time and a generator.
///
/// Every member has one defining property that is its test.
pub trait Signal: Send + Sync {
    /// Fills `u` with samples `dt_s` apart.
    ///
    /// # Errors
    /// [`BuildError::Keys`] when the parameters do not fit the length or sample time.
    fn fill(&self, u: &mut [f64], dt_s: f64, rng: &mut Rng64) -> Result<(), BuildError>;
}

/// All test signals.
pub static SIGNALS: &[Member<dyn Signal>] = &[
    aprbs::MEMBER,
    prbs::MEMBER,
    rbs::MEMBER,
    udrn::MEMBER,
    band_noise::MEMBER,
    random_walk::MEMBER,
    ramp_hold::MEMBER,
    space_filling::MEMBER,
    multisine::MEMBER,
    staircase::MEMBER,
    sweep::MEMBER,
    chirp::MEMBER,
];

/// Builds the signal `name` from the keys of a spec.
///
/// # Errors
/// [`BuildError`] with the nearest known name.
pub fn signal(name: &str, keys: &toml::Table) -> Result<Box<dyn Signal>, BuildError> {
    registry::build("signal", SIGNALS, name, keys)
}

/// Documentation of all signals.
pub fn docs() -> Vec<MemberDoc> {
    SIGNALS.iter().map(|m| m.doc).collect()
}
