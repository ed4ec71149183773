//! What a check asks of a number.

/// How a measured number is judged.
#[derive(Clone, Copy)]
pub(super) enum Asked {
    AtMost(f64),
    AtLeast(f64),
    Below(f64),
    Above(f64),
    Reported,
}

impl Asked {
    pub(super) fn text(self) -> Option<String> {
        let number = |v: f64| if v != 0.0 && v.abs() < 1e-3 { format!("{v:e}") } else { format!("{v}") };
        match self {
            Asked::AtMost(v) => Some(format!("<= {}", number(v))),
            Asked::AtLeast(v) => Some(format!(">= {}", number(v))),
            Asked::Below(v) => Some(format!("< {}", number(v))),
            Asked::Above(v) => Some(format!("> {}", number(v))),
            Asked::Reported => None,
        }
    }

    /// A number that is missing does not hold.
    pub(super) fn holds(self, measured: Option<f64>) -> Option<bool> {
        let is = |f: &dyn Fn(f64) -> bool| Some(measured.is_some_and(f));
        match self {
            Asked::AtMost(v) => is(&|m| m <= v),
            Asked::AtLeast(v) => is(&|m| m >= v),
            Asked::Below(v) => is(&|m| m < v),
            Asked::Above(v) => is(&|m| m > v),
            Asked::Reported => None,
        }
    }

    /// Of several runs, the number that is hardest to accept; their mean where nothing is asked.
    pub(super) fn worst(self, values: &[Option<f64>]) -> Option<f64> {
        let all = values.iter().copied().collect::<Option<Vec<f64>>>().filter(|v| !v.is_empty())?;
        let pick = match self {
            Asked::AtLeast(_) | Asked::Above(_) => f64::min,
            Asked::AtMost(_) | Asked::Below(_) => f64::max,
            Asked::Reported => return Some(all.iter().sum::<f64>() / all.len() as f64),
        };
        all.into_iter().reduce(pick)
    }
}

#[cfg(test)]
mod tests {
    use super::Asked;

    #[test]
    fn the_worst_seed_decides_and_a_missing_number_never_holds() {
        let values = [Some(1.0), Some(3.0), Some(2.0)];
        assert_eq!(Asked::AtMost(2.5).worst(&values), Some(3.0));
        assert_eq!(Asked::AtMost(2.5).holds(Some(3.0)), Some(false));
        assert_eq!(Asked::AtLeast(0.5).worst(&values), Some(1.0));
        assert_eq!(Asked::AtLeast(1.0).holds(Some(1.0)), Some(true));
        assert_eq!(Asked::Above(1.0).holds(Some(1.0)), Some(false));
        assert_eq!(Asked::AtMost(2.5).worst(&[Some(1.0), None]), None);
        assert_eq!(Asked::AtMost(2.5).holds(None), Some(false));
        assert_eq!(Asked::Below(1.0).holds(Some(f64::NAN)), Some(false));
        assert_eq!(Asked::Reported.worst(&values), Some(2.0));
        assert_eq!(Asked::Reported.holds(None), None);
    }
}
