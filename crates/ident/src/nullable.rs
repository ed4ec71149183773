//! JSON has no NaN: it is written as `null`, and read back here (for `#[serde(deserialize_with = ..)]`).

use serde::{Deserialize, Deserializer};

/// A number, `null` being NaN.
///
/// # Errors
/// Of the deserialiser, where there is neither.
pub fn number<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    Ok(Option::<f64>::deserialize(deserializer)?.unwrap_or(f64::NAN))
}

/// Numbers, `null` being NaN.
///
/// # Errors
/// Of the deserialiser, where there is something else.
pub fn numbers<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<f64>, D::Error> {
    let values = Vec::<Option<f64>>::deserialize(deserializer)?;
    Ok(values.into_iter().map(|v| v.unwrap_or(f64::NAN)).collect())
}
