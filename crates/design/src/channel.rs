//! Input channels of a design: amplitude, rate, hold, and the map from free variables to samples.

use crate::error::DesignError;

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
#[derive(Clone, Debug, PartialEq)]
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

    fn check(&self, n: usize) -> Result<(), DesignError> {
        let name = &self.name;
        let number = |what: &str, found: f64, expected: &str| {
            Err(DesignError::Number { what: format!("{name}: {what}"), found, expected: expected.into() })
        };
        if let Some(v) = &self.given {
            if v.len() != n {
                return Err(DesignError::Shape {
                    what: format!("{name}: given samples"),
                    found: v.len(),
                    expected: n,
                });
            }
            return match v.iter().find(|v| !v.is_finite()) {
                Some(v) => number("given sample", *v, "a finite number"),
                None => Ok(()),
            };
        }
        for bound in [self.lower, self.upper] {
            if !bound.is_finite() {
                return number("bound", bound, "a finite number");
            }
        }
        if self.lower > self.upper {
            return Err(self.conflict(format!("upper bound {}", self.upper), self.lower - self.upper));
        }
        if self.hold == 0 {
            return number("hold", 0.0, "at least 1 sample");
        }
        match (self.rate_per_sample, self.before) {
            (Some(r), _) if !(r > 0.0 && r.is_finite()) => number("rate limit", r, "a positive number"),
            (_, Some(b)) if !b.is_finite() => number("value before the record", b, "a finite number"),
            (Some(r), Some(b)) if b + r < self.lower => Err(self.reach(b, r, self.lower - b - r)),
            (Some(r), Some(b)) if b - r > self.upper => Err(self.reach(b, r, b - r - self.upper)),
            _ => Ok(()),
        }
    }

    fn conflict(&self, second: String, by: f64) -> DesignError {
        let first = format!("{} lower bound {}", self.name, self.lower);
        DesignError::Conflict { first, second, by, sample: None }
    }

    fn reach(&self, before: f64, rate: f64, by: f64) -> DesignError {
        DesignError::Conflict {
            first: format!("{} bounds {} to {}", self.name, self.lower, self.upper),
            second: format!("rate limit {rate} per sample from {before} before the record"),
            by,
            sample: Some(0),
        }
    }
}

/// A rate limit in the free variables: `|x[j] - x[j-1]| <= limit`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RateLimit {
    /// Index j of the later variable.
    pub(crate) j: usize,
    /// Limit in units of x.
    pub(crate) limit: f64,
}

/// The map between free variables x (each in \[0, 1\] of its channel's range) and input samples.
#[derive(Clone, Debug)]
pub struct Layout {
    channels: Vec<Channel>,
    n: usize,
    /// First variable of each channel, and one more.
    first: Vec<usize>,
    lower: Vec<f64>,
    upper: Vec<f64>,
    rates: Vec<RateLimit>,
}

impl Layout {
    /// Layout of `channels` over `n` samples.
    ///
    /// # Errors
    /// The first limit that makes no sense, or limits that contradict each other, with names and numbers.
    pub fn new(channels: &[Channel], n: usize) -> Result<Self, DesignError> {
        let mut first = vec![0];
        let (mut lower, mut upper, mut rates) = (Vec::new(), Vec::new(), Vec::new());
        for c in channels {
            c.check(n)?;
            let start = lower.len();
            lower.resize(start + c.knots(n), 0.0);
            upper.resize(start + c.knots(n), if c.upper > c.lower { 1.0 } else { 0.0 });
            let range = c.upper - c.lower;
            if let (Some(b), Some(r), true) =
                (c.before, c.rate_per_sample, start < lower.len() && range > 0.0)
            {
                lower[start] = ((b - r - c.lower) / range).clamp(0.0, 1.0);
                upper[start] = ((b + r - c.lower) / range).clamp(0.0, 1.0);
            }
            if let Some(r) = c.knot_rate() {
                rates.extend((start + 1..lower.len()).map(|j| RateLimit { j, limit: r / range }));
            }
            first.push(lower.len());
        }
        if lower.iter().zip(&upper).all(|(l, u)| l == u) {
            return Err(DesignError::NothingFree);
        }
        Ok(Self { channels: channels.to_vec(), n, first, lower, upper, rates })
    }

    /// Number of free variables.
    pub fn len(&self) -> usize {
        self.lower.len()
    }

    /// Whether there is none (never for a layout that was built).
    pub fn is_empty(&self) -> bool {
        self.lower.is_empty()
    }

    /// Number of samples N.
    pub fn n_samples(&self) -> usize {
        self.n
    }

    /// Number of channels m.
    pub fn n_channels(&self) -> usize {
        self.channels.len()
    }

    /// Bounds of the free variables.
    pub fn bounds(&self) -> (&[f64], &[f64]) {
        (&self.lower, &self.upper)
    }

    pub(crate) fn rates(&self) -> &[RateLimit] {
        &self.rates
    }

    /// Range of variables of channel `i`.
    pub(crate) fn variables(&self, i: usize) -> std::ops::Range<usize> {
        self.first[i]..self.first[i + 1]
    }

    /// Fills the samples `u` (N x m) from the variables `x`.
    pub fn fill(&self, x: &[f64], u: &mut [f64]) {
        let m = self.channels.len();
        for (i, c) in self.channels.iter().enumerate() {
            let x = &x[self.variables(i)];
            let at = |k: usize| (c.lower + x[k] * (c.upper - c.lower)).clamp(c.lower, c.upper);
            for t in 0..self.n {
                u[t * m + i] = match (&c.given, c.shape) {
                    (Some(v), _) => v[t],
                    (None, Shape::Hold) => at(t / c.hold),
                    (None, Shape::Linear) => {
                        let (k, w) = (t / c.hold, (t % c.hold) as f64 / c.hold as f64);
                        if w > 0.0 { (1.0 - w) * at(k) + w * at(k + 1) } else { at(k) }
                    }
                };
            }
        }
    }

    /// Adjoint of [`Layout::fill`]: fills the gradient with respect to x from that with respect to u (N x m).
    pub fn gather(&self, u_bar: &[f64], x_bar: &mut [f64]) {
        let m = self.channels.len();
        x_bar.fill(0.0);
        for (i, c) in self.channels.iter().enumerate().filter(|(_, c)| c.given.is_none()) {
            let range = c.upper - c.lower;
            let x = &mut x_bar[self.first[i]..self.first[i + 1]];
            for t in 0..self.n {
                let g = range * u_bar[t * m + i];
                let (k, w) = (t / c.hold, (t % c.hold) as f64 / c.hold as f64);
                match c.shape {
                    Shape::Linear if w > 0.0 => {
                        x[k] += (1.0 - w) * g;
                        x[k + 1] += w * g;
                    }
                    _ => x[k] += g,
                }
            }
        }
    }

    /// Variables of given samples `u` (N x m), taken where the free values sit and moved into bounds and rates.
    pub fn read(&self, u: &[f64], x: &mut [f64]) {
        let m = self.channels.len();
        for (i, c) in self.channels.iter().enumerate() {
            let range = c.upper - c.lower;
            for (k, j) in self.variables(i).enumerate() {
                let v = u[(k * c.hold).min(self.n - 1) * m + i];
                x[j] = if range > 0.0 { (v - c.lower) / range } else { 0.0 };
            }
        }
        self.repair(x);
    }

    /// Moves `x` into the bounds and then, from the first sample on, into the rate limits. Exactly feasible
    /// afterwards, because a value within reach of one inside the bounds can always stay inside them.
    pub fn repair(&self, x: &mut [f64]) {
        for (v, (l, u)) in x.iter_mut().zip(self.lower.iter().zip(&self.upper)) {
            *v = v.clamp(*l, *u);
        }
        for r in &self.rates {
            let before = x[r.j - 1];
            // The last bits of u = lower + x range must not exceed the limit, hence the small safety factor.
            let limit = r.limit * (1.0 - 1e-12);
            x[r.j] = x[r.j].clamp(before - limit, before + limit).clamp(self.lower[r.j], self.upper[r.j]);
        }
    }

    /// Largest violation of a rate limit by `x`, in units of the channel's range.
    pub fn rate_violation(&self, x: &[f64]) -> f64 {
        self.rates.iter().map(|r| (x[r.j] - x[r.j - 1]).abs() - r.limit).fold(0.0, f64::max)
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
