//! What all signals check in the same way.

use dynocal_numerics::registry::BuildError;

/// A fault in the keys of `member`.
pub(super) fn fault(member: &str, message: String) -> BuildError {
    BuildError::Keys { member: member.into(), message }
}

/// `lo < hi`, both finite.
pub(super) fn check_range(member: &str, lo: f64, hi: f64) -> Result<(), BuildError> {
    if lo < hi && lo.is_finite() && hi.is_finite() {
        return Ok(());
    }
    Err(fault(member, format!("found lo = {lo}, hi = {hi}, expected finite values with lo < hi")))
}

/// A positive finite number.
pub(super) fn check_positive(member: &str, key: &str, value: f64) -> Result<(), BuildError> {
    if value > 0.0 && value.is_finite() {
        return Ok(());
    }
    Err(fault(member, format!("found {key} = {value}, expected a positive number")))
}

/// A duration in whole samples (rounded), at least one.
pub(super) fn samples(member: &str, key: &str, value_s: f64, dt_s: f64) -> Result<usize, BuildError> {
    check_positive(member, key, value_s)?;
    check_positive(member, "sample time", dt_s)?;
    let n = (value_s / dt_s).round();
    if n < 1.0 {
        return Err(fault(
            member,
            format!("found {key} = {value_s} s, expected at least one sample of {dt_s} s"),
        ));
    }
    Ok(n as usize)
}

/// A displacement in time in whole samples (rounded), zero allowed.
pub(super) fn displacement(member: &str, value_s: f64, dt_s: f64) -> Result<usize, BuildError> {
    if !(value_s >= 0.0 && value_s.is_finite()) {
        return Err(fault(member, format!("found phase_s = {value_s}, expected zero or a positive number")));
    }
    check_positive(member, "sample time", dt_s)?;
    Ok((value_s / dt_s).round() as usize)
}
