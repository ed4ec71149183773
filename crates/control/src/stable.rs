//! The gains of a channel's plane that are stable, and those that keep Ms.
//!
//! ```text
//! boundary (kp(w), ki(w)): 1 + G C = 0 at w.  Upwards through it at constant kp, ds/dki = j phi / (kp' + phi ki'), so that
//!     a pair of poles leaves to the right where kp rises along w, and comes back where it falls
//! Ms: |1 + G C| >= 1/Ms at each w leaves out an interval of ki for each kp
//! ```
//!
//! Between the boundaries the number of unstable poles is constant: the pieces that have the fewest of them are known from the signs
//! alone, and one count says whether that is none (decomposition of the parameter plane, J. Ackermann, Robust Control (2002), chapters 2
//! and 3). The work therefore grows with the crossings of the boundary and not with their square: long delays have thousands.

use dynocal_numerics::interval::Interval;
use serde::{Deserialize, Serialize};

use crate::matrix::{C, ONE};
use crate::plane::{Channel, phi};
use crate::poly::degree;
use crate::system::Time;

/// Halvings of an interval that holds a crossing.
const HALVINGS: usize = 80;
/// Crossings that are all found exactly; of more only those about the pieces that matter.
const EXACT: usize = 64;
/// Most pieces with fewest unstable poles of which one is asked for each kp.
const ASKED: usize = 4;

/// The stable set with positive integral gain.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StableSet {
    /// Ranges of kp in which there is a stable ki.
    pub kp: Vec<Interval>,
    /// Largest stable ki.
    pub largest_ki: f64,
    /// kp at it.
    pub kp_at_largest_ki: f64,
    /// Area in the plane.
    pub area: f64,
}

/// Where the line of one kp meets the boundary.
#[derive(Clone, Copy)]
struct Edge {
    ki: f64,
    /// Unstable poles beyond it less those before; none: unknown, a real pole passes.
    change: Option<i32>,
    /// Place on the grid before it, where it can be made exact.
    before: Option<usize>,
}

impl Channel {
    /// Whether `kp + ki phi + kd d` is stable, on the grid alone where it is fine enough for that, else with all refinement.
    pub fn is_stable(&self, kp: f64, ki: f64) -> bool {
        let mut sum = 0.0;
        let mut last: Option<C> = None;
        for (k, p) in self.poles_at.iter().enumerate() {
            let v = p * (ONE + self.open_at(k, kp, ki));
            if let Some(before) = last {
                let angle = (v / before).arg();
                if !(angle.abs() < 1.0) {
                    return self.unstable(kp, ki).is_stable();
                }
                sum += angle;
            } else if !(v.im.abs() < 0.05 * v.re.abs()) {
                return self.unstable(kp, ki).is_stable();
            }
            last = Some(v);
        }
        let count = match self.time {
            Time::Sampled { .. } => -sum / std::f64::consts::PI,
            Time::Continuous => self.states() as f64 / 2.0 - sum / std::f64::consts::PI,
        };
        if (count - count.round()).abs() > 0.2 {
            self.unstable(kp, ki).is_stable()
        } else {
            count.round() == 0.0
        }
    }

    /// Intervals of positive ki that are stable with `kp`.
    pub fn stable_ki(&self, kp: f64) -> Vec<Interval> {
        let mut edges = self.edges(kp);
        let exact = edges.len() <= EXACT;
        if exact {
            edges.iter_mut().for_each(|e| e.ki = self.exactly(e, kp));
            edges.retain(|e| e.ki >= 0.0);
            edges.sort_by(|a, b| a.ki.total_cmp(&b.ki));
        }
        let mut out = Vec::new();
        for group in self.fewest(&edges) {
            let asked = group.iter().take(ASKED).find(|p| {
                let i = self.piece(&edges, **p, kp, !exact);
                i.upper - i.lower > 1e-12 * i.upper
            });
            let Some(first) = asked else { continue };
            let i = self.piece(&edges, *first, kp, !exact);
            if self.is_stable(kp, 0.5 * (i.lower + i.upper)) {
                let all = group.iter().map(|p| self.piece(&edges, *p, kp, !exact));
                out.extend(all.filter(|i| i.upper - i.lower > 1e-12 * i.upper));
            }
        }
        out.sort_by(|a, b| a.lower.total_cmp(&b.lower));
        out
    }

    /// Whether some positive ki is stable with `kp`.
    fn has_stable(&self, kp: f64) -> bool {
        let edges = self.edges(kp);
        self.fewest(&edges).iter().any(|group| {
            group.iter().take(ASKED).any(|p| {
                let i = self.piece(&edges, *p, kp, false);
                self.is_stable(kp, 0.5 * (i.lower + i.upper))
            })
        })
    }

    /// Where the boundary meets the line of `kp` at positive ki, rising: between the frequencies of the grid on the line.
    fn edges(&self, kp: f64) -> Vec<Edge> {
        let mut out = Vec::new();
        for k in 1..self.boundary.len() {
            let (before, after) = (self.boundary[k - 1], self.boundary[k]);
            let (a, b) = (before.0 - kp, after.0 - kp);
            if (a > 0.0) != (b > 0.0) && a.is_finite() && b.is_finite() {
                let ki = before.1 + (after.1 - before.1) * a / (a - b);
                out.push(Edge { ki, change: Some(if b > 0.0 { 2 } else { -2 }), before: Some(k - 1) });
            }
        }
        // At half the sampling frequency a real pole passes: 1 + G C = 0 there.
        if let Some(end) = self.time.nyquist_rad_s() {
            let x = self.time.variable(end);
            let (g, phi) = (self.transfer.at(self.time, end), phi(self.time, x));
            let known = self.known_at(x);
            out.push(Edge { ki: (-1.0 / g.re - known.re - kp) / phi.re, change: None, before: None });
        }
        // An edge a little below zero may lie above it when it is found exactly.
        let reach = out.iter().map(|e| e.ki.abs()).filter(|v| v.is_finite()).fold(0.0, f64::max);
        let least = if out.len() <= EXACT { -reach } else { 0.0 };
        out.retain(|e| e.ki >= least && e.ki.is_finite());
        out.sort_by(|a, b| a.ki.total_cmp(&b.ki));
        out
    }

    /// ki of an edge where the boundary is followed between two frequencies of the grid.
    fn exactly(&self, e: &Edge, kp: f64) -> f64 {
        let Some(k) = e.before else { return e.ki };
        let (mut lower, mut upper) = (self.grid[k], self.grid[k + 1]);
        let above = self.boundary[k].0 > kp;
        for _ in 0..HALVINGS {
            let middle = 0.5 * (lower + upper);
            if !(middle > lower && middle < upper) {
                break;
            }
            if (self.boundary_at(middle).0 > kp) == above { lower = middle } else { upper = middle }
        }
        self.boundary_at(0.5 * (lower + upper)).1
    }

    /// Pieces between edges (0: from zero to the first) with the fewest unstable poles, widest first: in one group where each edge
    /// says how many pass, before and behind an edge that does not in groups of their own.
    fn fewest(&self, edges: &[Edge]) -> Vec<Vec<usize>> {
        let (mut groups, mut counts): (Vec<Vec<(i32, usize)>>, i32) = (vec![vec![(0, 0)]], 0);
        for (k, e) in edges.iter().enumerate() {
            match e.change {
                Some(change) => counts += change,
                None => {
                    counts = 0;
                    groups.push(Vec::new());
                }
            }
            if let Some(group) = groups.last_mut() {
                group.push((counts, k + 1));
            }
        }
        let width = |p: usize| {
            let lower = if p == 0 { 0.0 } else { edges[p - 1].ki };
            edges.get(p).map_or(f64::INFINITY, |e| e.ki) - lower
        };
        let best = |group: Vec<(i32, usize)>| -> Vec<usize> {
            let least = group.iter().map(|g| g.0).min().unwrap_or(0);
            let mut out: Vec<usize> = group.into_iter().filter(|g| g.0 == least).map(|g| g.1).collect();
            out.sort_by(|a, b| width(*b).total_cmp(&width(*a)));
            out
        };
        groups.into_iter().map(best).collect()
    }

    fn piece(&self, edges: &[Edge], p: usize, kp: f64, exactly: bool) -> Interval {
        let at = |e: &Edge| if exactly { self.exactly(e, kp).max(0.0) } else { e.ki };
        let lower = if p == 0 { 0.0 } else { at(&edges[p - 1]).max(0.0) };
        // Without a last edge ki may grow without limit: what is enough to choose from.
        let upper = edges.get(p).map_or_else(|| (2.0 * lower).max(wide(self).1), at);
        Interval { lower, upper }
    }

    /// Intervals of positive ki with `kp` that are stable and keep `Ms <= most` on the grid.
    pub fn ki_with_sensitivity(&self, kp: f64, most: f64) -> Vec<Interval> {
        let mut left = self.stable_ki(kp);
        for k in 0..self.grid.len() {
            if left.is_empty() {
                break;
            }
            let (g, phi) = (self.response[k], self.phi[k]);
            let (a, b) = (ONE + g * (self.known[k] + kp), g * phi);
            let (square, half) = (b.norm_sqr(), (a * b.conj()).re);
            let root = half * half - square * (a.norm_sqr() - 1.0 / (most * most));
            if root > 0.0 && square > 0.0 {
                let out = ((-half - root.sqrt()) / square, (-half + root.sqrt()) / square);
                left = left.into_iter().flat_map(|i| without(i, out)).collect();
            }
        }
        left
    }

    /// The stable set with positive ki, its extent and its area (`points` values of kp in each range, Gauss-Legendre pieces).
    ///
    /// ```
    /// use dynocal_control::plane::Channel;
    /// use dynocal_control::system::{Time, Transfer};
    /// let lag = Channel::new(Time::Continuous, Transfer::continuous(&[1.0], &[4.0, 1.0], 1.0))?;
    /// let set = lag.stable_set(200);
    /// assert!((set.largest_ki - 3.21360).abs() < 1e-4 && (set.kp[0].upper - 6.93451).abs() < 1e-4);
    /// # Ok::<(), dynocal_control::error::ControlError>(())
    /// ```
    pub fn stable_set(&self, points: usize) -> StableSet {
        let mut set =
            StableSet { kp: self.kp_ranges(), largest_ki: 0.0, kp_at_largest_ki: f64::NAN, area: 0.0 };
        let height = |kp: f64| self.stable_ki(kp).iter().map(|i| i.upper - i.lower).sum::<f64>();
        for range in &set.kp {
            let width = (range.upper - range.lower) / points as f64;
            let mut best = (0.0, f64::NAN);
            for k in 0..points {
                let start = range.lower + width * k as f64;
                // Two points of Gauss: exact for cubic pieces.
                for share in [0.5 - 0.5 / 3f64.sqrt(), 0.5 + 0.5 / 3f64.sqrt()] {
                    let kp = start + share * width;
                    let ki = height(kp);
                    set.area += 0.5 * width * ki;
                    if ki > best.0 {
                        best = (ki, kp);
                    }
                }
            }
            let top = |kp: f64| self.stable_ki(kp).last().map_or(0.0, |i| i.upper);
            let grid = [best.1 - width, best.1, best.1 + width];
            let (kp, ki) = crate::margin::peak(&grid, &grid.map(top), &top);
            if ki > set.largest_ki {
                (set.largest_ki, set.kp_at_largest_ki) = (ki, kp);
            }
        }
        set
    }

    /// Ranges of kp with some stable positive ki: ends are where the boundary meets ki = 0, or turns round.
    pub fn kp_ranges(&self) -> Vec<Interval> {
        let mut ends = self.ends();
        ends.retain(|v| v.is_finite());
        ends.sort_by(f64::total_cmp);
        let first = ends.first().copied().unwrap_or(0.0);
        let last = ends.last().copied().unwrap_or(0.0);
        let reach = (last - first).max(last.abs());
        ends.insert(0, first - 0.5 * reach);
        // Without delay there may be no upper end: gains of twenty times the plant's are enough to choose from.
        ends.push((last + 0.5 * reach).max(wide(self).0));
        let mut out: Vec<Interval> = Vec::new();
        // Ends grow with the frequency without limit where the plant falls faster than one over it: what is narrow is told by the ends of
        // each piece alone.
        for e in ends.windows(2).filter(|e| e[1] - e[0] > 1e-9 * e[0].abs().max(e[1].abs())) {
            if self.has_stable(0.5 * (e[0] + e[1])) {
                match out.last_mut() {
                    Some(before) if before.upper == e[0] => before.upper = e[1],
                    _ => out.push(Interval { lower: e[0], upper: e[1] }),
                }
            }
        }
        out
    }

    /// kp at which the stable ki can begin or end.
    fn ends(&self) -> Vec<f64> {
        let own = &self.boundary;
        let mut ends = Vec::new();
        for k in 1..own.len() {
            if (own[k - 1].1 > 0.0) != (own[k].1 > 0.0) {
                let (mut lower, mut upper) = (self.grid[k - 1], self.grid[k]);
                let at_lower = own[k - 1].1 > 0.0;
                for _ in 0..HALVINGS {
                    let middle = 0.5 * (lower + upper);
                    if !(middle > lower && middle < upper) {
                        break;
                    }
                    if (self.boundary_at(middle).1 > 0.0) == at_lower {
                        lower = middle
                    } else {
                        upper = middle
                    }
                }
                ends.push(self.boundary_at(0.5 * (lower + upper)).0);
            }
            if k + 1 < own.len() && (own[k].0 - own[k - 1].0) * (own[k + 1].0 - own[k].0) < 0.0 {
                ends.push(own[k].0);
            }
        }
        if let Some(end) = self.time.nyquist_rad_s() {
            let known = self.known_at(self.time.variable(end));
            ends.push(-1.0 / self.transfer.at(self.time, end).re - known.re);
        }
        // A plant that answers at once keeps a gain at all high frequencies.
        if self.time == Time::Continuous && degree(&self.transfer.num) == degree(&self.transfer.den) {
            ends.extend(own.last().map(|b| b.0));
        }
        ends.push(-1.0 / self.transfer.steady_gain(self.time));
        ends
    }
}

/// Gains kp and ki to choose from where the plane has no end: twenty times those at which the channel, where it has fallen to half of its
/// gain at rest, has gain 1; an integrator in the middle of its grid.
fn wide(channel: &Channel) -> (f64, f64) {
    let steady = channel.transfer.steady_gain(channel.time).abs();
    let fallen =
        if steady.is_finite() { channel.response.iter().position(|g| g.norm() < 0.5 * steady) } else { None };
    let k = fallen.unwrap_or(channel.grid.len() / 2);
    let gain = channel.response[k].norm().max(f64::MIN_POSITIVE);
    let kp = 20.0 / gain;
    (if kp.is_finite() { kp } else { 0.0 }, if kp.is_finite() { kp * channel.grid[k] } else { 1.0 })
}

fn without(i: Interval, out: (f64, f64)) -> Vec<Interval> {
    let below = Interval { lower: i.lower, upper: i.upper.min(out.0) };
    let above = Interval { lower: i.lower.max(out.1), upper: i.upper };
    [below, above].into_iter().filter(|i| i.upper > i.lower).collect()
}
