//! The map between free variables and samples, with the limits in the variables.

use super::limits::Regions;
use super::{Channel, Shape};
use crate::error::DesignError;

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
    /// Levels of each channel in x, ascending; empty where all values are allowed.
    levels: Vec<Vec<f64>>,
    /// Regions in x.
    pub(crate) regions: Regions,
}

/// Bounds of the free values of `c` in x that its rate limit can reach from the start and leave for the end, so that
/// a value within them always has a neighbour within reach.
fn tube(c: &Channel, n: usize) -> Result<(Vec<f64>, Vec<f64>), DesignError> {
    let (k, range) = (c.knots(n), c.upper - c.lower);
    if k == 0 || range <= 0.0 {
        return Ok((vec![0.0; k], vec![0.0; k]));
    }
    let scaled = |v: f64| (v - c.lower) / range;
    let span = c.span();
    let (mut lower, mut upper) = (vec![scaled(span.0); k], vec![scaled(span.1); k]);
    if let (Some(b), Some(r)) = (c.before, c.rate_per_sample) {
        lower[0] = scaled(b - r).clamp(lower[0], upper[0]);
        upper[0] = scaled(b + r).clamp(lower[0], upper[0]);
    }
    if let Some(s) = c.start {
        (lower[0], upper[0]) = (scaled(s), scaled(s));
    }
    if let Some(e) = c.end {
        // The last sample of a ramp may lie between two free values: both are then the end.
        let part = c.shape == Shape::Linear && !(n - 1).is_multiple_of(c.hold);
        for j in k.saturating_sub(if part { 2 } else { 1 })..k {
            if j == 0 && c.start.is_some_and(|s| s != e) {
                let first = format!("{} start {} and end {e}", c.name, c.start.unwrap_or(e));
                let second = format!("record of {n} samples with a hold of {}", c.hold);
                let by = (c.start.unwrap_or(e) - e).abs();
                return Err(DesignError::Conflict { first, second, by, sample: None });
            }
            (lower[j], upper[j]) = (scaled(e), scaled(e));
        }
    }
    if let Some(r) = c.knot_rate() {
        let r = r / range * SAFE;
        for j in 1..k {
            narrow(&mut lower, &mut upper, j, j - 1, r);
        }
        for j in (0..k - 1).rev() {
            narrow(&mut lower, &mut upper, j, j + 1, r);
        }
    }
    Ok((lower, upper))
}

/// Keeps at `j` what is within `r` of the interval at `from`; the checks before leave rounding at most to disagree.
fn narrow(lower: &mut [f64], upper: &mut [f64], j: usize, from: usize, r: f64) {
    let (l, u) = (lower[j], upper[j]);
    lower[j] = l.max(lower[from] - r).min(u);
    upper[j] = u.min(upper[from] + r).max(l);
}

fn scaled_levels(c: &Channel) -> Vec<f64> {
    let range = c.upper - c.lower;
    if range <= 0.0 || c.given.is_some() {
        return Vec::new();
    }
    let mut out: Vec<f64> = c.levels.iter().map(|v| (v - c.lower) / range).collect();
    out.sort_by(f64::total_cmp);
    out.dedup();
    out
}

/// The last bits of u = lower + x range must not exceed the limit, hence the small safety factor on rates.
pub(crate) const SAFE: f64 = 1.0 - 1e-12;

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
            let tube = tube(c, n)?;
            let start = lower.len();
            lower.extend(tube.0);
            upper.extend(tube.1);
            if let Some(r) = c.knot_rate() {
                let limit = r / (c.upper - c.lower);
                rates.extend((start + 1..lower.len()).map(|j| RateLimit { j, limit }));
            }
            first.push(lower.len());
        }
        if lower.iter().zip(&upper).all(|(l, u)| l == u) {
            return Err(DesignError::NothingFree);
        }
        let levels = channels.iter().map(scaled_levels).collect();
        let regions = Regions::default();
        let mut out = Self { channels: channels.to_vec(), n, first, lower, upper, rates, levels, regions };
        out.regions = Regions::new(&out)?;
        out.find_anchor()?;
        if out.has_levels() {
            let mut x = out.anchor().to_vec();
            out.check_levels_reach(&mut x)?;
        }
        Ok(out)
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
        (0..self.channels.len()).for_each(|i| self.fill_part(x, i, 0..self.n, u));
    }

    /// Fills the samples `part` of channel `i` in `u` (N x m) from the variables `x`.
    pub(crate) fn fill_part(&self, x: &[f64], i: usize, part: std::ops::Range<usize>, u: &mut [f64]) {
        let (m, c) = (self.channels.len(), &self.channels[i]);
        let x = &x[self.variables(i)];
        let at = |k: usize| {
            let v = (c.lower + x[k] * (c.upper - c.lower)).clamp(c.lower, c.upper);
            // A value on a level is that level to the last bit.
            c.levels.iter().copied().find(|l| (l - v).abs() <= 1e-12 * (c.upper - c.lower)).unwrap_or(v)
        };
        for t in part {
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

    /// Number of the free value of channel `i` that sample `t` follows, counted within the channel.
    pub(crate) fn knot(&self, i: usize, t: usize) -> usize {
        t / self.channels[i].hold
    }

    /// First sample that the variable `j` of channel `i` moves.
    pub(crate) fn first_sample(&self, i: usize, j: usize) -> usize {
        let (k, hold) = (j - self.first[i], self.channels[i].hold);
        match self.channels[i].shape {
            Shape::Hold => k * hold,
            Shape::Linear => (k * hold + 1).saturating_sub(hold),
        }
    }

    /// Last sample that the variable `j` of channel `i` moves; may lie behind the record.
    pub(crate) fn last_sample(&self, i: usize, j: usize) -> usize {
        (j - self.first[i] + 1) * self.channels[i].hold - 1
    }

    /// Rate limit of channel `i` between neighbouring free values, in x.
    pub(crate) fn rate(&self, i: usize) -> Option<f64> {
        let c = &self.channels[i];
        c.knot_rate().map(|r| r / (c.upper - c.lower))
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

    /// Moves `x` into the bounds and then, from the first sample on, into the rate limits: exactly feasible afterwards,
    /// because every value within the bounds has one within reach that stays inside them. Then, where there are
    /// regions, into them (see [`super::limits`]).
    pub fn repair(&self, x: &mut [f64]) {
        self.repair_rates(x);
        self.repair_regions(x);
    }

    pub(crate) fn repair_rates(&self, x: &mut [f64]) {
        for (v, (l, u)) in x.iter_mut().zip(self.lower.iter().zip(&self.upper)) {
            *v = v.clamp(*l, *u);
        }
        for r in &self.rates {
            let before = x[r.j - 1];
            let limit = r.limit * SAFE;
            x[r.j] = x[r.j].clamp(before - limit, before + limit).clamp(self.lower[r.j], self.upper[r.j]);
        }
    }

    /// Channels as given.
    pub fn channels(&self) -> &[Channel] {
        &self.channels
    }

    /// Levels of channel `i` in x, ascending; empty where all values are allowed.
    pub(crate) fn levels(&self, i: usize) -> &[f64] {
        &self.levels[i]
    }

    /// The same layout with the `variables` fixed at `x`.
    pub(crate) fn fixed_at(&self, variables: impl Iterator<Item = usize>, x: &[f64]) -> Layout {
        let mut out = self.clone();
        for j in variables {
            (out.lower[j], out.upper[j]) = (x[j], x[j]);
        }
        out
    }

    /// Whether any channel may take certain levels only.
    pub fn has_levels(&self) -> bool {
        self.levels.iter().any(|l| !l.is_empty())
    }

    /// Largest violation of a rate limit or a region by `x`, in ranges of the channels.
    pub(crate) fn coupling_violation(&self, x: &[f64]) -> f64 {
        self.rate_violation(x).max(self.region_violation(x))
    }

    /// Largest violation of a rate limit by `x`, in units of the channel's range.
    pub fn rate_violation(&self, x: &[f64]) -> f64 {
        self.rates.iter().map(|r| (x[r.j] - x[r.j - 1]).abs() - r.limit).fold(0.0, f64::max)
    }
}
