//! Numbers as text and as compact JSON.

use serde::ser::{Serialize, SerializeSeq, Serializer};

/// Significant digits of plotted data: finer than a pixel on any screen.
pub(crate) const PLOT_DIGITS: usize = 6;

/// Larger values are gaps like non-finite ones: a run that went away, whose range would overflow in the page.
const PLOT_LARGEST: f64 = 1e150;

/// `value` with `decimals` decimals and its unit, where it has one (`-` is none), as in a sentence.
///
/// ```
/// use dynocal_report::with_unit;
/// assert_eq!(with_unit(3.2, 2, "kg/h"), "3.20 kg/h");
/// assert_eq!(with_unit(0.063, 3, "-"), "0.063");
/// ```
pub fn with_unit(value: f64, decimals: usize, unit: &str) -> String {
    let unit = if matches!(unit, "-" | "") { String::new() } else { format!(" {unit}") };
    format!("{value:.decimals$}{unit}")
}

/// `text` as a sentence begins: its first letter large.
///
/// ```
/// assert_eq!(dynocal_report::capital("random points"), "Random points");
/// ```
pub fn capital(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

/// `value` with `digits` significant digits: fixed notation from 1e-4 to 1e7, otherwise exponential; trailing zeros
/// are kept, because they say how exact the number is.
///
/// ```
/// use dynocal_report::significant;
/// assert_eq!(significant(0.50121098, 4), "0.5012");
/// assert_eq!(significant(-1234.56, 3), "-1235");
/// assert_eq!(significant(3.2e-9, 3), "3.20e-9");
/// ```
pub fn significant(value: f64, digits: usize) -> String {
    let digits = digits.clamp(1, 17);
    if value == 0.0 {
        return "0".to_owned();
    }
    if !value.is_finite() {
        return if value.is_nan() {
            "NaN"
        } else if value > 0.0 {
            "+inf"
        } else {
            "-inf"
        }
        .to_owned();
    }
    // The exponent is read from the rounded number: 9.9996 with 4 digits is 10.00, not 10.000.
    let exponential = format!("{value:.*e}", digits - 1);
    let exponent: i32 = exponential.split_once('e').and_then(|(_, e)| e.parse().ok()).unwrap_or(0);
    if (-4..7).contains(&exponent) {
        let decimals = (digits as i32 - 1 - exponent).max(0) as usize;
        format!("{value:.decimals$}")
    } else {
        exponential
    }
}

/// As [`significant`], without zeros at the end: for a number that stands alone, where `0.030000` only distracts.
pub(crate) fn trimmed(value: f64, digits: usize) -> String {
    let text = significant(value, digits);
    let (mantissa, exponent) = text.split_at(text.find('e').unwrap_or(text.len()));
    if !mantissa.contains('.') {
        return text;
    }
    format!("{}{exponent}", mantissa.trim_end_matches('0').trim_end_matches('.'))
}

/// `value` rounded to `digits` significant digits.
pub(crate) fn rounded(value: f64, digits: usize) -> f64 {
    if !value.is_finite() {
        return value;
    }
    format!("{value:.*e}", digits - 1).parse().unwrap_or(value)
}

/// A slice that serialises as rounded numbers: integers without a decimal point, non-finite values as null.
pub(crate) struct Compact<'a> {
    pub(crate) values: &'a [f64],
    pub(crate) digits: usize,
}

impl<'a> Compact<'a> {
    pub(crate) fn plot(values: &'a [f64]) -> Self {
        Compact { values, digits: PLOT_DIGITS }
    }
}

/// One number as in [`Compact`].
pub(crate) struct CompactNumber(pub(crate) f64, pub(crate) usize);

impl Serialize for CompactNumber {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let value = rounded(self.0, self.1);
        if !value.is_finite() || value.abs() > PLOT_LARGEST {
            serializer.serialize_none()
        } else if value.fract() == 0.0 && value.abs() < 1e15 {
            serializer.serialize_i64(value as i64)
        } else {
            serializer.serialize_f64(value)
        }
    }
}

impl Serialize for Compact<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut sequence = serializer.serialize_seq(Some(self.values.len()))?;
        for &value in self.values {
            sequence.serialize_element(&CompactNumber(value, self.digits))?;
        }
        sequence.end()
    }
}

/// Serde for `Vec<f64>` with non-finite values as null, since JSON has no NaN.
pub(crate) mod nullable {
    use serde::{Deserialize, Deserializer, Serializer};

    pub(crate) fn serialize<S: Serializer>(values: &[f64], serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(values.iter().map(|v| v.is_finite().then_some(*v)))
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<f64>, D::Error> {
        let values = Vec::<Option<f64>>::deserialize(deserializer)?;
        Ok(values.into_iter().map(|v| v.unwrap_or(f64::NAN)).collect())
    }
}
