//! Test signals: the contract and its table.

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
pub static SIGNALS: &[Member<dyn Signal>] = &[];

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
