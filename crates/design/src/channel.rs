//! Input channels of a design: amplitude, rate, hold, and the map from free variables to samples.

mod layout;
pub mod limits;

pub use layout::Layout;
pub(crate) use layout::SAFE;

use crate::error::DesignError;
use limits::Region;

/// How a channel moves between its free values.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Shape {
    /// Held for `hold` samples, then a step.
    Hold,
    /// A ramp from one free value to the next over `hold` samples.
    Linear,
}

/// One input channel of a design.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Channel {
    /// Name, e.g. `inj`.
    pub name: String,
    /// Least value, in the channel's unit.
    pub lower: f64,
    /// Largest value.
    pub upper: f64,
    /// Largest change from one sample to the next, if limited.
    pub rate_per_sample: Option<f64>,
    /// Samples between free values, at least 1.
    pub hold: usize,
    /// How the channel moves between them.
    pub shape: Shape,
    /// Value before the first sample (the rate limit then covers the first sample too).
    pub before: Option<f64>,
    /// Value of the first free value: the operating point that the record starts from.
    pub start: Option<f64>,
    /// Value of the last sample: the operating point that the record ends at.
    pub end: Option<f64>,
    /// The only values that the channel may take at its free values (any order); empty: all within the bounds.
    pub levels: Vec<f64>,
    /// Regions in the plane of this channel and others, kept at every sample.
    pub regions: Vec<Region>,
    /// Samples of a channel that is not designed (e.g. a given speed profile), N of them.
    pub given: Option<Vec<f64>>,
}

impl Channel {
    /// A channel in a box, free at every sample.
    pub fn free(name: &str, lower: f64, upper: f64) -> Self {
        Self {
            name: name.into(),
            lower,
            upper,
            rate_per_sample: None,
            hold: 1,
            shape: Shape::Hold,
            before: None,
            start: None,
            end: None,
            levels: Vec::new(),
            regions: Vec::new(),
            given: None,
        }
    }

    /// A channel whose samples are given.
    pub fn given(name: &str, values: Vec<f64>) -> Self {
        let (lower, upper) =
            values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, u), v| (l.min(*v), u.max(*v)));
        Self { given: Some(values), ..Self::free(name, lower, upper) }
    }

    fn knots(&self, n: usize) -> usize {
        match self.shape {
            _ if self.given.is_some() => 0,
            Shape::Hold => n.div_ceil(self.hold),
            Shape::Linear => (n - 1).div_ceil(self.hold) + 1,
        }
    }

    /// Largest change from one free value to the next, in the channel's unit.
    fn knot_rate(&self) -> Option<f64> {
        let samples = if self.shape == Shape::Linear { self.hold as f64 } else { 1.0 };
        self.rate_per_sample.map(|r| r * samples).filter(|r| *r < self.upper - self.lower)
    }

    /// Bounds within which the free values lie: the box, or the ends of the levels.
    fn span(&self) -> (f64, f64) {
        let ends =
            (self.levels.iter().copied().reduce(f64::min), self.levels.iter().copied().reduce(f64::max));
        match ends {
            (Some(a), Some(b)) if self.given.is_none() => (a.max(self.lower), b.min(self.upper)),
            _ => (self.lower, self.upper),
        }
    }

    fn number(&self, what: &str, found: f64, expected: &str) -> Result<(), DesignError> {
        let what = format!("{}: {what}", self.name);
        Err(DesignError::Number { what, found, expected: expected.into() })
    }

    fn check(&self, n: usize) -> Result<(), DesignError> {
        if let Some(v) = &self.given {
            if v.len() != n {
                let what = format!("{}: given samples", self.name);
                return Err(DesignError::Shape { what, found: v.len(), expected: n });
            }
            return match v.iter().find(|v| !v.is_finite()) {
                Some(v) => self.number("given sample", *v, "a finite number"),
                None => Ok(()),
            };
        }
        for bound in [self.lower, self.upper] {
            if !bound.is_finite() {
                return self.number("bound", bound, "a finite number");
            }
        }
        if self.lower > self.upper {
            let (first, second) =
                (format!("lower bound {}", self.lower), format!("upper bound {}", self.upper));
            return Err(self.conflict(first, second, self.lower - self.upper, None));
        }
        if self.hold == 0 {
            return self.number("hold", 0.0, "at least 1 sample");
        }
        if self.hold > n {
            let (first, second) =
                (format!("hold of {} samples", self.hold), format!("record of {n} samples"));
            return Err(self.conflict(first, second, (self.hold - n) as f64, None));
        }
        match self.rate_per_sample {
            Some(r) if !(r > 0.0 && r.is_finite()) => {
                return self.number("rate limit", r, "a positive number");
            }
            _ => {}
        }
        match self.before {
            Some(b) if !b.is_finite() => return self.number("value before the record", b, "a finite number"),
            _ => {}
        }
        self.check_levels()?;
        self.check_point("start", self.start, 0)?;
        self.check_point("end", self.end, n.saturating_sub(1))?;
        self.check_reach(n)
    }

    fn check_levels(&self) -> Result<(), DesignError> {
        for v in &self.levels {
            if !v.is_finite() {
                return self.number("level", *v, "a finite number");
            }
            if *v < self.lower || *v > self.upper {
                let by = (self.lower - v).max(v - self.upper);
                return Err(self.conflict(format!("level {v}"), self.bounds_text(), by, None));
            }
        }
        Ok(())
    }

    /// Start and end lie within the bounds and, where there are levels, on one of them.
    fn check_point(&self, what: &str, value: Option<f64>, sample: usize) -> Result<(), DesignError> {
        let Some(v) = value else { return Ok(()) };
        if !v.is_finite() {
            return self.number(what, v, "a finite number");
        }
        if v < self.lower || v > self.upper {
            let by = (self.lower - v).max(v - self.upper);
            return Err(self.conflict(format!("{what} {v}"), self.bounds_text(), by, Some(sample)));
        }
        let nearest = self.levels.iter().min_by(|a, b| (*a - v).abs().total_cmp(&(*b - v).abs()));
        match nearest {
            Some(l) if *l != v => {
                let second = format!("the levels, the nearest of which is {l}");
                Err(self.conflict(format!("{what} {v}"), second, (l - v).abs(), Some(sample)))
            }
            _ => Ok(()),
        }
    }

    /// Whether the rate limit leads from the value before to the bounds and the start, and from there to the end.
    fn check_reach(&self, n: usize) -> Result<(), DesignError> {
        let Some(r) = self.rate_per_sample else { return Ok(()) };
        let (lower, upper) = self.span();
        let slack = 1e-9 * (upper - lower).abs();
        if let Some(b) = self.before {
            let (near, far) = self.start.map_or((lower, upper), |s| (s, s));
            let by = (near - b - r).max(b - r - far);
            if by > slack {
                let first = self.start.map_or(self.bounds_text(), |s| format!("start {s}"));
                let second = format!("rate limit {r} per sample from {b} before the record");
                return Err(self.conflict(first, second, by, Some(0)));
            }
        }
        // One change per hold, of one sample (a step) or of the whole hold (a ramp).
        let changes = match self.shape {
            Shape::Hold => (n - 1) / self.hold,
            Shape::Linear => (n - 1) / self.hold * self.hold,
        };
        let from = [(self.start, 0), (self.before, 1)].into_iter().find_map(|(v, more)| v.map(|v| (v, more)));
        if let (Some((s, more)), Some(e)) = (from, self.end) {
            let by = (e - s).abs() - r * (changes + more) as f64;
            if by > slack {
                let first = format!("start {s} and end {e}");
                let second = format!("rate limit {r} per sample in {} changes", changes + more);
                return Err(self.conflict(first, second, by, Some(n - 1)));
            }
        }
        Ok(())
    }

    fn bounds_text(&self) -> String {
        format!("bounds {} to {}", self.lower, self.upper)
    }

    fn conflict(&self, first: String, second: String, by: f64, sample: Option<usize>) -> DesignError {
        DesignError::Conflict { first: format!("{} {first}", self.name), second, by, sample }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dynocal_numerics::rng::Rng64;

    fn channels(n: usize) -> Vec<Channel> {
        vec![
            Channel { hold: 4, rate_per_sample: Some(3.0), ..Channel::free("a", -5.0, 5.0) },
            Channel {
                hold: 5,
                shape: Shape::Linear,
                rate_per_sample: Some(0.5),
                before: Some(9.0),
                ..Channel::free("b", 0.0, 10.0)
            },
            Channel::given("c", (0..n).map(|t| t as f64).collect()),
        ]
    }

    #[test]
    fn gather_is_the_adjoint_of_fill() {
        let n = 23;
        let l = Layout::new(&channels(n), n).unwrap();
        let mut g = Rng64::new(4);
        let x: Vec<f64> = (0..l.len()).map(|_| g.uniform()).collect();
        let h: Vec<f64> = (0..l.len()).map(|_| 0.01 * (g.uniform() - 0.5)).collect();
        let w: Vec<f64> = (0..n * 3).map(|_| g.normal()).collect();
        let (mut u0, mut u1, mut xb) = (vec![0.0; n * 3], vec![0.0; n * 3], vec![0.0; l.len()]);
        l.fill(&x, &mut u0);
        let moved: Vec<f64> = x.iter().zip(&h).map(|(a, b)| (a + b).clamp(0.0, 1.0)).collect();
        l.fill(&moved, &mut u1);
        l.gather(&w, &mut xb);
        let a: f64 = (0..n * 3).map(|k| w[k] * (u1[k] - u0[k])).sum();
        let b: f64 = (0..l.len()).map(|j| xb[j] * (moved[j] - x[j])).sum();
        assert!((a - b).abs() < 1e-12 * (1.0 + a.abs()), "{a} {b}");
    }

    #[test]
    fn repaired_variables_keep_every_limit_in_the_samples() {
        let n = 50;
        let l = Layout::new(&channels(n), n).unwrap();
        for seed in 0..50 {
            let mut g = Rng64::new(seed);
            let mut x: Vec<f64> = (0..l.len()).map(|_| g.uniform_in(-0.5, 1.5)).collect();
            l.repair(&mut x);
            let mut u = vec![0.0; n * 3];
            l.fill(&x, &mut u);
            assert_eq!(l.rate_violation(&x), 0.0);
            let mut before = 9.0;
            for t in 0..n {
                assert!(u[t * 3].abs() <= 5.0 && (0.0..=10.0).contains(&u[t * 3 + 1]));
                assert!((u[t * 3 + 1] - before).abs() <= 0.5 + 1e-12);
                before = u[t * 3 + 1];
                if t > 0 {
                    assert!((u[t * 3] - u[t * 3 - 3]).abs() <= 3.0);
                    assert!(t % 4 == 0 || u[t * 3] == u[t * 3 - 3], "held");
                }
            }
        }
    }

    #[test]
    fn contradicting_limits_are_named_with_the_size_of_the_conflict() {
        let crossed = Layout::new(&[Channel::free("inj", 5.0, 2.0)], 10).unwrap_err();
        assert!(matches!(&crossed, DesignError::Conflict { by, .. } if *by == 3.0), "{crossed}");
        let far =
            Channel { rate_per_sample: Some(1.0), before: Some(-4.0), ..Channel::free("spark", 0.0, 30.0) };
        let far = Layout::new(&[far], 10).unwrap_err();
        assert!(matches!(&far, DesignError::Conflict { by, .. } if *by == 3.0), "{far}");
        assert!(far.to_string().contains("spark") && far.to_string().contains("rate limit 1"), "{far}");
        let given = Layout::new(&[Channel::given("n", vec![1.0; 3])], 3).unwrap_err();
        assert_eq!(given, DesignError::NothingFree);
    }
}
