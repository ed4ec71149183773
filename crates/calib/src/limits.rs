//! What a record keeps of the limits of a problem.
//!
//! ```text
//! excess = max_t (y(t) - upper),  max_t (lower - y(t)),  mean_t y(t) - mean_upper        negative: what is left
//! ```

use crate::problem::{CalibrationProblem, LimitChannel};
use dynocal_ident::data::Dataset;
use dynocal_ident::derived::DerivedError;
use serde::{Deserialize, Serialize};

/// Excess that sensors and models may account for, as a share of the size of a limit.
const SCATTER: f64 = 0.02;

/// One limit against one record.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LimitScore {
    /// Channel.
    pub output: String,
    /// Its unit.
    pub unit: String,
    /// Which of its limits: `lower`, `upper` or `mean_upper`.
    pub of: String,
    /// The limit.
    pub limit: f64,
    /// Whether it is soft.
    pub soft: bool,
    /// Largest amount beyond it; negative where it is kept.
    pub excess: f64,
    /// Share of the samples beyond it; 0 or 1 for a mean.
    pub share: f64,
    /// The excess that counts as none: [the share that scatter may account for](LimitScore::passed) of the limit, or of the
    /// distance of both limits.
    pub tolerated: f64,
}

impl LimitScore {
    /// Whether the limit is passed by more than scatter may account for, a fiftieth of it; a value that is not a number is.
    pub fn passed(&self) -> bool {
        !(self.excess <= self.tolerated)
    }

    /// In words, without a verb: `the upper limit of boost, 200 kPa, by 6.2 kPa (in 3 % of the samples)`.
    pub fn words(&self) -> String {
        let (name, share) = match self.of.as_str() {
            "mean_upper" => ("limit of the mean", String::new()),
            "lower" => ("lower limit", format!(" (in {:.1} % of the samples)", 100.0 * self.share)),
            _ => ("upper limit", format!(" (in {:.1} % of the samples)", 100.0 * self.share)),
        };
        let unit = if self.unit == "-" { String::new() } else { format!(" {}", self.unit) };
        format!("the {name} of {}, {}{unit}, by {:.3}{unit}{share}", self.output, self.limit, self.excess)
    }
}

/// All limits of `problem` against samples `from..` of a record.
///
/// # Errors
/// [`DerivedError`] when the record lacks a channel.
pub fn limit_scores(
    problem: &CalibrationProblem,
    record: &Dataset,
    from: usize,
) -> Result<Vec<LimitScore>, DerivedError> {
    let mut out = Vec::new();
    for l in &problem.limits {
        let values = problem.values(&l.output, record)?;
        let values = values.get(from..).unwrap_or_default();
        let n = values.len().max(1) as f64;
        let size = match (l.lower, l.upper) {
            (Some(a), Some(b)) => b - a,
            (a, b) => a.or(b).unwrap_or(0.0).abs(),
        };
        let mut push = |of: &str, limit: f64, size: f64, excess: f64, share: f64| {
            out.push(score(l, of, (limit, SCATTER * size), excess, share));
        };
        let sides = [("lower", l.lower, -1.0), ("upper", l.upper, 1.0)];
        for (of, limit, sign) in sides.into_iter().filter_map(|(of, limit, sign)| Some((of, limit?, sign))) {
            let beyond = |v: &f64| sign * (v - limit);
            let excess = values
                .iter()
                .map(beyond)
                .fold(f64::NEG_INFINITY, |a, b| if b > a || b.is_nan() { b } else { a });
            let share = values.iter().filter(|v| !(beyond(v) <= 0.0)).count() as f64 / n;
            push(of, limit, size, excess, share);
        }
        if let Some(limit) = l.mean_upper {
            let excess = values.iter().sum::<f64>() / n - limit;
            push("mean_upper", limit, limit.abs(), excess, f64::from(!(excess <= 0.0)));
        }
    }
    Ok(out)
}

fn score(l: &LimitChannel, of: &str, (limit, tolerated): (f64, f64), excess: f64, share: f64) -> LimitScore {
    LimitScore {
        output: l.output.clone(),
        unit: l.unit.clone(),
        of: of.into(),
        limit,
        soft: l.soft_weight.is_some(),
        excess,
        share,
        tolerated,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dynocal_ident::data::{Channel, Role};

    #[test]
    fn excess_and_share_are_those_of_the_samples() {
        let problem: CalibrationProblem = toml::from_str(
            r#"
            inputs = [{ name = "u", unit = "-", lower = 0.0, upper = 1.0 }]
            limits = [
                { output = "p", unit = "kPa", lower = 50.0, upper = 200.0 },
                { output = "knock", unit = "-", upper = 1.0, soft_weight = 0.1 },
                { output = "no", unit = "g/h", mean_upper = 3.0 },
            ]
            minimise = [{ channel = "u" }]
            "#,
        )
        .unwrap();
        let channel = |name: &str, values: Vec<f64>| Channel {
            name: name.into(),
            unit: "-".into(),
            role: Role::Output,
            values,
        };
        let record = Dataset {
            name: "r".into(),
            sample_time_s: 0.1,
            channels: vec![
                channel("p", vec![999.0, 60.0, 206.0, 100.0, 201.0]),
                channel("knock", vec![9.0, 0.5, 0.6, 0.7, 0.9]),
                channel("no", vec![9.0, 2.0, 4.0, 4.0, 4.0]),
            ],
            init_samples: 0,
            origin: "test".into(),
        };
        let found = limit_scores(&problem, &record, 1).unwrap();
        let seen: Vec<(&str, f64, f64, bool)> =
            found.iter().map(|l| (l.of.as_str(), l.excess, l.share, l.passed())).collect();
        // 2 % of 150 kPa is 3 kPa.
        assert_eq!(seen[0], ("lower", -10.0, 0.0, false));
        assert_eq!(seen[1], ("upper", 6.0, 0.5, true));
        assert!((seen[2].1 + 0.1).abs() < 1e-12 && !seen[2].3 && found[2].soft);
        assert_eq!(seen[3], ("mean_upper", 0.5, 1.0, true));
        assert_eq!(
            found[1].words(),
            "the upper limit of p, 200 kPa, by 6.000 kPa (in 50.0 % of the samples)"
        );
        let mut broken = record;
        broken.channels[1].values[3] = f64::NAN;
        assert!(limit_scores(&problem, &broken, 1).unwrap()[2].passed());
    }
}
