//! A closed range of numbers.

use serde::{Deserialize, Serialize};

/// The closed interval `[lower, upper]` of the real line, in the unit of whatever it bounds.
///
/// An end may be infinite where nothing bounds it. Nothing forces `lower <= upper`: what reads an interval from a user checks
/// it and says where it stands; an interval whose ends are the other way round holds no number. Files hold it as the two
/// numbers `[lower, upper]`.
///
/// ```
/// use dynocal_numerics::interval::Interval;
/// let throttle_deg = Interval::new(2.0, 90.0);
/// assert!(throttle_deg.contains(90.0) && !throttle_deg.contains(90.1));
/// assert_eq!((throttle_deg.width(), throttle_deg.middle(), throttle_deg.clamp(1.0)), (88.0, 46.0, 2.0));
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(from = "(f64, f64)", into = "(f64, f64)")]
pub struct Interval {
    /// Least value.
    pub lower: f64,
    /// Greatest value.
    pub upper: f64,
}

impl Interval {
    /// From the least to the greatest value.
    pub const fn new(lower: f64, upper: f64) -> Self {
        Self { lower, upper }
    }

    /// From the least to the greatest of `values`, NaN left out: the interval of no value has its ends at plus and minus
    /// infinity, the other way round.
    pub fn spanning(values: impl IntoIterator<Item = f64>) -> Self {
        let empty = Self::new(f64::INFINITY, f64::NEG_INFINITY);
        values.into_iter().fold(empty, Self::including)
    }

    /// The least interval that holds this one and `value`; NaN changes nothing.
    pub fn including(self, value: f64) -> Self {
        Self::new(self.lower.min(value), self.upper.max(value))
    }

    /// `upper - lower`.
    pub fn width(self) -> f64 {
        self.upper - self.lower
    }

    /// Half way between the ends.
    pub fn middle(self) -> f64 {
        0.5 * (self.lower + self.upper)
    }

    /// Where `value` stands between the ends: `(value - lower) / (upper - lower)`, 0 at the lower and 1 at the upper one.
    pub fn share(self, value: f64) -> f64 {
        (value - self.lower) / (self.upper - self.lower)
    }

    /// The value that stands at `share` between the ends: `lower + share (upper - lower)`.
    pub fn value_at(self, share: f64) -> f64 {
        self.lower + share * (self.upper - self.lower)
    }

    /// Whether `lower <= value <= upper`; never for NaN.
    pub fn contains(self, value: f64) -> bool {
        self.lower <= value && value <= self.upper
    }

    /// The number of the interval that is nearest to `value`; NaN stays NaN. Of an interval whose ends are the other way
    /// round it is the upper end.
    pub fn clamp(self, value: f64) -> f64 {
        // Not `f64::clamp`, which panics on such ends.
        if value > self.upper {
            self.upper
        } else if value < self.lower {
            self.lower.min(self.upper)
        } else {
            value
        }
    }

    /// Whether both ends are finite numbers.
    pub fn is_finite(self) -> bool {
        self.lower.is_finite() && self.upper.is_finite()
    }
}

impl From<(f64, f64)> for Interval {
    fn from((lower, upper): (f64, f64)) -> Self {
        Self { lower, upper }
    }
}

impl From<Interval> for (f64, f64) {
    fn from(i: Interval) -> Self {
        (i.lower, i.upper)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    struct Spec {
        range: Interval,
    }

    #[test]
    fn files_hold_two_numbers() {
        let spec: Spec = toml::from_str("range = [-1.5, 2.0]").unwrap();
        assert_eq!(spec.range, Interval::new(-1.5, 2.0));
        assert_eq!(toml::to_string(&spec).unwrap().trim(), "range = [-1.5, 2.0]");
        assert!(toml::from_str::<Spec>("range = [1.0]").is_err());
    }

    #[test]
    fn ends_belong_to_it_and_nan_does_not() {
        let i = Interval::new(-1.0, 3.0);
        assert!(
            i.contains(-1.0) && i.contains(3.0) && !i.contains(f64::NAN) && !i.contains(3.0_f64.next_up())
        );
        assert_eq!((i.clamp(-2.0), i.clamp(4.0), i.clamp(0.5)), (-1.0, 3.0, 0.5));
        assert!(i.clamp(f64::NAN).is_nan());
        assert!(i.is_finite() && !Interval::new(0.0, f64::INFINITY).is_finite());
    }

    #[test]
    fn shares_run_from_end_to_end() {
        let i = Interval::new(-1.0, 3.0);
        assert_eq!((i.share(-1.0), i.share(0.0), i.share(3.0), i.share(5.0)), (0.0, 0.25, 1.0, 1.5));
        assert_eq!((i.value_at(0.0), i.value_at(0.25), i.value_at(1.0)), (-1.0, 0.0, 3.0));
    }

    #[test]
    fn values_span_an_interval() {
        assert_eq!(Interval::spanning([2.0, f64::NAN, -3.0, 1.0]), Interval::new(-3.0, 2.0));
        assert!(!Interval::spanning([]).contains(0.0));
    }

    #[test]
    fn ends_the_other_way_round_hold_nothing_and_do_not_panic() {
        let i = Interval::new(1.0, -1.0);
        assert!(!i.contains(0.0));
        assert_eq!((i.clamp(-5.0), i.clamp(0.0), i.clamp(5.0)), (-1.0, -1.0, -1.0));
    }
}
