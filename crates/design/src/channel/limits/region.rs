//! Regions in the plane of inputs, and what they are in the free variables.

use crate::channel::{Channel, Layout, Shape};
use crate::error::{DesignError, tidy};

/// A region that the samples of several channels keep to, channels by name.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Region {
    /// `sum coefficient * channel <= bound` at every sample.
    AtMost {
        /// Name for messages.
        name: String,
        /// Channels with their coefficients.
        coefficients: Vec<(String, f64)>,
        /// Largest value of the sum.
        bound: f64,
    },
    /// Convex polygon in the plane of two channels that is not left.
    Inside {
        /// Name for messages.
        name: String,
        /// Channels along the first and the second coordinate.
        channels: [String; 2],
        /// Corners in order (either sense).
        corners: Vec<[f64; 2]>,
    },
    /// Convex polygon in the plane of two channels that is not entered (its edge may be touched).
    Outside {
        /// Name for messages.
        name: String,
        /// Channels along the first and the second coordinate.
        channels: [String; 2],
        /// Corners in order (either sense).
        corners: Vec<[f64; 2]>,
    },
}

impl Region {
    /// A box that is not entered: `a` from `a_range.0` to `a_range.1` while `b` is in `b_range`.
    pub fn forbidden_box(name: &str, a: (&str, [f64; 2]), b: (&str, [f64; 2])) -> Self {
        let ([a0, a1], [b0, b1]) = (a.1, b.1);
        Region::Outside {
            name: name.into(),
            channels: [a.0.into(), b.0.into()],
            corners: vec![[a0, b0], [a1, b0], [a1, b1], [a0, b1]],
        }
    }

    /// Name for messages.
    pub fn name(&self) -> &str {
        match self {
            Region::AtMost { name, .. } | Region::Inside { name, .. } | Region::Outside { name, .. } => name,
        }
    }

    /// Channels that it speaks about.
    pub fn channels(&self) -> Vec<&str> {
        match self {
            Region::AtMost { coefficients, .. } => coefficients.iter().map(|c| c.0.as_str()).collect(),
            Region::Inside { channels, .. } | Region::Outside { channels, .. } => {
                channels.iter().map(String::as_str).collect()
            }
        }
    }

    /// Corners where there are any.
    pub fn corners(&self) -> &[[f64; 2]] {
        match self {
            Region::AtMost { .. } => &[],
            Region::Inside { corners, .. } | Region::Outside { corners, .. } => corners,
        }
    }

    /// How far the values `u` of its [`Region::channels`] are from keeping it, in the unit of the bound, or for a
    /// polygon as a distance in the plane; at most 0 where it is kept.
    ///
    /// ```
    /// use dynocal_design::channel::limits::Region;
    /// let r = Region::forbidden_box("surge", ("speed", [1000.0, 2000.0]), ("throttle", [60.0, 90.0]));
    /// assert!(r.violation(&[1500.0, 70.0]) == 10.0 && r.violation(&[1500.0, 50.0]) == -10.0);
    /// ```
    pub fn violation(&self, u: &[f64]) -> f64 {
        let rows = self.half_planes();
        let passed = |(c, b): &(Vec<f64>, f64)| c.iter().zip(u).map(|(c, u)| c * u).sum::<f64>() - b;
        match self {
            Region::Outside { .. } => rows.iter().map(passed).fold(f64::INFINITY, f64::min),
            _ => rows.iter().map(passed).fold(f64::NEG_INFINITY, f64::max),
        }
    }

    /// Rows `c' u <= b` over its channels: all of them, or, of a polygon to stay out of, one of them must hold.
    fn half_planes(&self) -> Vec<(Vec<f64>, f64)> {
        match self {
            Region::AtMost { coefficients, bound, .. } => {
                vec![(coefficients.iter().map(|c| c.1).collect(), *bound)]
            }
            Region::Inside { corners, .. } => edges(corners),
            Region::Outside { corners, .. } => {
                edges(corners).into_iter().map(|(c, b)| (c.iter().map(|v| -v).collect(), -b)).collect()
            }
        }
    }

    /// Indices of its channels among `channels`.
    fn check(&self, channels: &[Channel]) -> Result<Vec<usize>, DesignError> {
        let fault = |found: String, expected: String| {
            Err(DesignError::Region { name: self.name().into(), found, expected })
        };
        let mut out = Vec::new();
        for name in self.channels() {
            match channels.iter().position(|c| c.name == name) {
                Some(i) if !out.contains(&i) => out.push(i),
                Some(_) => return fault(format!("`{name}` twice"), "each channel once".into()),
                None => {
                    let known: Vec<&str> = channels.iter().map(|c| c.name.as_str()).collect();
                    return fault(format!("a channel `{name}`"), format!("one of {}", known.join(", ")));
                }
            }
        }
        if let Region::AtMost { coefficients, bound, .. } = self {
            let finite = bound.is_finite() && coefficients.iter().all(|c| c.1.is_finite());
            if !finite || coefficients.iter().all(|c| c.1 == 0.0) {
                return fault("coefficients that are zero or not finite".into(), "finite numbers".into());
            }
            return Ok(out);
        }
        let corners = self.corners();
        if corners.len() < 3 || corners.iter().flatten().any(|v| !v.is_finite()) {
            return fault(format!("{} corners", corners.len()), "3 finite ones at least".into());
        }
        let turns: Vec<f64> = (0..corners.len()).map(|k| turn(corners, k)).collect();
        let largest = turns.iter().fold(0.0f64, |m, t| m.max(t.abs()));
        let left = turns.iter().any(|t| *t > 1e-12 * largest);
        let right = turns.iter().any(|t| *t < -1e-12 * largest);
        if left == right {
            let found = if left { "corners that turn both ways" } else { "corners on a line" };
            return fault(
                found.into(),
                "a convex polygon, its corners in order (split one that is not)".into(),
            );
        }
        Ok(out)
    }
}

/// Twice the signed area of the corners before, at and after `k`.
fn turn(corners: &[[f64; 2]], k: usize) -> f64 {
    let n = corners.len();
    let (a, b, c) = (corners[(k + n - 1) % n], corners[k], corners[(k + 1) % n]);
    (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0])
}

/// Edges as rows `c' u <= b` of the inside, |c| = 1.
fn edges(corners: &[[f64; 2]]) -> Vec<(Vec<f64>, f64)> {
    let n = corners.len();
    let area: f64 = (0..n).map(|k| turn(corners, k)).sum();
    let sense = area.signum();
    let edge = |k: usize| {
        let (a, b) = (corners[k], corners[(k + 1) % n]);
        let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
        let norm = dx.hypot(dy);
        (norm > 0.0).then(|| {
            let c = vec![sense * dy / norm, -sense * dx / norm];
            let bound = c[0] * a[0] + c[1] * a[1];
            (c, bound)
        })
    };
    (0..n).filter_map(edge).collect()
}

/// One row `a' x <= bound`, with |a| of order one.
#[derive(Clone, Debug)]
struct Row {
    from: usize,
    to: usize,
    bound: f64,
}

/// Rows at one sample of which one must hold.
#[derive(Clone, Copy, Debug)]
struct Group {
    from: usize,
    to: usize,
    sample: usize,
    region: usize,
}

/// All regions of a record in the free variables.
#[derive(Clone, Debug, Default)]
pub(crate) struct Regions {
    names: Vec<String>,
    terms: Vec<(usize, f64)>,
    rows: Vec<Row>,
    groups: Vec<Group>,
    pub(super) anchor: Vec<f64>,
}

impl Regions {
    /// The regions of the channels of `layout`.
    ///
    /// # Errors
    /// [`DesignError::Region`] for a region that makes no sense; [`DesignError::Conflict`] where nothing within the
    /// bounds, rates, start and end keeps one at some sample.
    pub(crate) fn new(layout: &Layout) -> Result<Self, DesignError> {
        let channels = layout.channels();
        let mut out = Self::default();
        for region in channels.iter().flat_map(|c| &c.regions) {
            let index = region.check(channels)?;
            out.names.push(region.name().into());
            let half_planes = region.half_planes();
            let mut before = None;
            for t in 0..layout.n_samples() {
                let places: Vec<Place> = index.iter().map(|i| place(layout, *i, t)).collect();
                // Where nothing has moved since the sample before, its rows stand for this one too.
                if before.as_ref() != Some(&places) {
                    out.add(layout, region, &half_planes, &index, &places, t)?;
                }
                before = Some(places);
            }
        }
        Ok(out)
    }

    fn add(
        &mut self,
        layout: &Layout,
        region: &Region,
        half_planes: &[(Vec<f64>, f64)],
        index: &[usize],
        places: &[Place],
        sample: usize,
    ) -> Result<(), DesignError> {
        let any = matches!(region, Region::Outside { .. });
        let from = self.rows.len();
        let mut least = if any { f64::INFINITY } else { f64::NEG_INFINITY };
        let mut free = false;
        for (c, bound) in half_planes {
            let start = self.terms.len();
            let (mut rest, mut norm) = (*bound, 0.0);
            for ((c, i), place) in c.iter().zip(index).zip(places) {
                let channel = &layout.channels()[*i];
                let range = channel.upper - channel.lower;
                rest -= c * place.constant;
                norm = f64::hypot(norm, if place.weights.is_empty() { 0.0 } else { c * range });
                self.terms.extend(place.weights.iter().map(|(j, w)| (*j, c * range * w)));
            }
            let size = if norm > 0.0 { norm } else { 1.0 };
            self.terms[start..].iter_mut().for_each(|t| t.1 /= size);
            self.rows.push(Row { from: start, to: self.terms.len(), bound: rest / size });
            free |= norm > 0.0;
            let reach = size * self.least(self.rows.len() - 1, layout);
            least = if any { least.min(reach) } else { least.max(reach) };
        }
        // Rounding of the coordinates must not refuse a start on the edge.
        let slack = 1e-9 * region.channels().len() as f64;
        let scale = half_planes.iter().map(|(_, b)| b.abs()).fold(1.0, f64::max);
        if least > slack * scale {
            return Err(unreachable_region(layout, region, index, least, sample));
        }
        if !free {
            self.rows.truncate(from);
            return Ok(());
        }
        let to = self.rows.len();
        let region = self.names.len() - 1;
        match any {
            true => self.groups.push(Group { from, to, sample, region }),
            false => self.groups.extend((from..to).map(|k| Group { from: k, to: k + 1, sample, region })),
        }
        Ok(())
    }

    /// Least value of `a' x - bound` of row `k` within the bounds.
    fn least(&self, k: usize, layout: &Layout) -> f64 {
        let (lower, upper) = layout.bounds();
        let row = &self.rows[k];
        let sum: f64 =
            self.terms[row.from..row.to].iter().map(|(j, a)| (a * lower[*j]).min(a * upper[*j])).sum();
        sum - row.bound
    }

    fn passed(&self, k: usize, x: &[f64]) -> f64 {
        let row = &self.rows[k];
        self.terms[row.from..row.to].iter().map(|(j, a)| a * x[*j]).sum::<f64>() - row.bound
    }

    /// Number of conditions.
    pub(crate) fn len(&self) -> usize {
        self.groups.len()
    }

    /// Free variables that condition `g` reads.
    pub(crate) fn variables(&self, g: usize) -> impl Iterator<Item = usize> + '_ {
        let group = self.groups[g];
        self.rows[group.from..group.to].iter().flat_map(|r| self.terms[r.from..r.to].iter().map(|(j, _)| *j))
    }

    /// Condition `g` at `x`: how far it is passed (in ranges of the channels; kept at 0 and below) by the row that is
    /// nearest to being kept, and the terms of that row.
    pub(crate) fn condition(&self, g: usize, x: &[f64]) -> (f64, &[(usize, f64)]) {
        let group = self.groups[g];
        let mut best = (f64::INFINITY, group.from);
        for k in group.from..group.to {
            let passed = self.passed(k, x);
            if passed < best.0 {
                best = (passed, k);
            }
        }
        let row = &self.rows[best.1];
        (best.0, &self.terms[row.from..row.to])
    }

    /// Sample and name of the region of condition `g`.
    pub(super) fn describe(&self, g: usize) -> (usize, &str) {
        (self.groups[g].sample, &self.names[self.groups[g].region])
    }
}

/// One channel at one sample: a constant and weights of free variables, in the channel's unit and in its range.
#[derive(Clone, Debug, PartialEq)]
struct Place {
    constant: f64,
    weights: Vec<(usize, f64)>,
}

fn place(layout: &Layout, i: usize, t: usize) -> Place {
    let c = &layout.channels()[i];
    if let Some(v) = &c.given {
        return Place { constant: v[t], weights: Vec::new() };
    }
    let first = layout.variables(i).start;
    let (k, w) = (t / c.hold, (t % c.hold) as f64 / c.hold as f64);
    let weights = match c.shape {
        _ if c.upper <= c.lower => Vec::new(),
        Shape::Linear if w > 0.0 => vec![(first + k, 1.0 - w), (first + k + 1, w)],
        _ => vec![(first + k, 1.0)],
    };
    Place { constant: c.lower, weights }
}

fn unreachable_region(
    layout: &Layout,
    region: &Region,
    index: &[usize],
    by: f64,
    sample: usize,
) -> DesignError {
    let reach: Vec<String> = index.iter().map(|i| reach(layout, *i, sample)).collect();
    DesignError::Conflict {
        first: format!("region `{}`", region.name()),
        second: format!("all that the channels can reach there ({})", reach.join(", ")),
        by,
        sample: Some(sample),
    }
}

/// Values that channel `i` can have at sample `t`.
fn reach(layout: &Layout, i: usize, t: usize) -> String {
    let (c, place) = (&layout.channels()[i], place(layout, i, t));
    let (lower, upper) = layout.bounds();
    let end = |bounds: &[f64]| {
        let share: f64 = place.weights.iter().map(|(j, w)| w * bounds[*j]).sum();
        place.constant + share * (c.upper - c.lower)
    };
    format!("{} {} to {}", c.name, tidy(end(lower)), tidy(end(upper)))
}
