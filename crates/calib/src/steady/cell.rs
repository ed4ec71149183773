//! The best setting of one operating point on response models.
//!
//! ```text
//! minimise    m(x) + caution sd(x),   m = sum_j w_j f_j(x),   sd^2 = sum_j w_j^2 v_j(x)
//! subject to  f_l(x) + z sd_l(x) <= upper_l,   f_l(x) - z sd_l(x) >= lower_l,   z = quantile of the asked probability (times the caution of the limit)
//!             lower_i <= x_i <= upper_i,   axes fixed
//! ```
//!
//! f and v are mean and variance of the models, so that a limit is kept with the probability that is asked for as far as the
//! models know themselves. Gradients and Hessians are exact; the program is solved by the interior point from several starts.
//! As long as no start was feasible, the sum of the violations, each in its own scale, is made small instead: what remains names the
//! limits that conflict, and by how much.

use dynocal_design::points::{MOST_DIMENSIONS, Sobol};
use dynocal_ident::model::response::{Ask, Prediction, Response};
use dynocal_numerics::interval::Interval;
use dynocal_numerics::nlp::{NlpOptions, SparseNlp, solve};
use dynocal_numerics::status::Status;
use serde::{Deserialize, Serialize};
use statrs::distribution::{ContinuousCDF, Normal};

/// A limit of a response, one side.
#[derive(Clone, Debug, PartialEq)]
pub struct Side {
    /// Number of the response.
    pub response: usize,
    /// The limit.
    pub limit: f64,
    /// 1: above is not allowed; -1: below is not.
    pub sign: f64,
    /// Size in which violations are weighed.
    pub scale: f64,
    /// Share of the standard deviations [`Setting::z`] that are kept from it: 1, or 0 where passing it harms nothing.
    pub caution: f64,
}

/// Models and limits that all cells share.
#[derive(Clone)]
pub struct Setting<'a> {
    /// Models of the responses over the factors.
    pub models: Vec<&'a dyn Response>,
    /// Weights of the responses in what is minimised.
    pub weights: Vec<f64>,
    /// Limits.
    pub sides: Vec<Side>,
    /// Standard deviations that are kept from limits.
    pub z: f64,
    /// Standard deviations of the objective that are added to it.
    pub caution: f64,
    /// Ranges of the factors.
    pub ranges: Vec<Interval>,
    /// Number of leading factors that are fixed in a cell.
    pub axes: usize,
}

/// The price of a limit at an optimum.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Price {
    /// Number of the response.
    pub response: usize,
    /// 1: upper limit; -1: lower limit.
    pub sign: f64,
    /// What one unit more of room would save of the objective.
    pub saves: f64,
    /// How far the limit is passed (negative: room), the models' uncertainty counted in; unit of the response.
    pub passed: f64,
}

/// The optimum of a cell.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CellOptimum {
    /// All factors.
    pub x: Vec<f64>,
    /// Expected responses.
    pub responses: Vec<f64>,
    /// Their standard deviations.
    pub deviations: Vec<f64>,
    /// Expected objective.
    pub objective: f64,
    /// Its standard deviation.
    pub objective_deviation: f64,
    /// Whether all limits are kept with the asked probability.
    pub feasible: bool,
    /// How the search ended.
    pub status: Status,
    /// Limits: their prices and room.
    pub prices: Vec<Price>,
}

/// Standard deviations below which a normal variable stays with a `probability` (0 to 1): z with P(Z <= z) = p.
pub fn deviations(probability: f64) -> f64 {
    Normal::standard().inverse_cdf(probability)
}

/// Violation of a limit, in its scale, that counts as none.
pub const KEPT: f64 = 1e-6;
/// Points of a low-discrepancy sequence that starts are chosen from.
const TRIALS: usize = 128;
/// Least violation, in the scales of the limits, above which limits are in conflict.
const NEARLY: f64 = 1e-3;
/// Share by which the violations of two starts may differ that have found the same conflict of limits.
const ALIKE: f64 = 1e-3;
/// Variance below which a standard deviation has no slope, as a share of the scale squared.
const FLOOR: f64 = 1e-12;

impl Setting<'_> {
    /// Number of factors.
    pub fn dim(&self) -> usize {
        self.ranges.len()
    }

    /// The optimum at the axes `at`, from `warm` (all factors each) and from `starts` of the best points of a sequence. While no setting
    /// keeps all limits, the sequence ends with the first of its points that leads to the least conflict that is known.
    pub fn optimise(
        &self,
        at: &[f64],
        starts: usize,
        warm: &[Vec<f64>],
        seed: u64,
        interrupt: &dyn Fn() -> bool,
    ) -> CellOptimum {
        let warm = warm.iter().map(|x| ([at, &x[self.axes..]].concat(), true));
        let sequence = self.starts(at, starts, seed).into_iter().map(|x| (x, false));
        let mut best: Option<CellOptimum> = None;
        let keep = |found: CellOptimum, best: &mut Option<CellOptimum>| {
            if best.as_ref().is_none_or(|b| self.better(&found, b)) {
                *best = Some(found);
            }
        };
        let feasible = |best: &Option<CellOptimum>| best.as_ref().is_some_and(|b| b.feasible);
        let within = |x: &[f64]| self.violation(&self.judge(x, Status::Stalled, None)) <= KEPT;
        let mut least = f64::INFINITY;
        for (start, warm) in warm.chain(sequence) {
            // A point of the sequence that passes limits is worth little before it is known whether they can be kept.
            if warm || feasible(&best) || within(&start) {
                keep(self.solve(&start, false, interrupt), &mut best);
                if feasible(&best) {
                    continue;
                }
            }
            let found = self.solve(&start, true, interrupt);
            let (violation, x) = (self.violation(&found), found.x.clone());
            keep(found, &mut best);
            // From where the violations are least the limits may be kept after all.
            if violation <= NEARLY {
                keep(self.solve(&x, false, interrupt), &mut best);
            }
            if !warm && !feasible(&best) && least.is_finite() && (violation - least).abs() <= ALIKE * least {
                break;
            }
            least = least.min(violation);
        }
        best.unwrap_or_else(|| self.judge(at, Status::Infeasible, None))
    }

    /// The local optimum at the axes `at` that is found from the free inputs of `x` (all factors).
    pub fn local(&self, at: &[f64], x: &[f64], interrupt: &dyn Fn() -> bool) -> CellOptimum {
        self.solve(&[at, &x[self.axes..]].concat(), false, interrupt)
    }

    /// Feasible before infeasible, then by objective, else by violation.
    pub fn better(&self, a: &CellOptimum, b: &CellOptimum) -> bool {
        match (a.feasible, b.feasible) {
            (true, true) => self.cost(a) < self.cost(b),
            (false, false) => self.violation(a) < self.violation(b),
            (a, _) => a,
        }
    }

    /// Objective with its caution.
    pub fn cost(&self, o: &CellOptimum) -> f64 {
        o.objective + self.caution * o.objective_deviation
    }

    /// Sum of the violations, each in its scale.
    fn violation(&self, o: &CellOptimum) -> f64 {
        // What is no number is no room.
        let of = |passed: f64| if passed.is_nan() { f64::INFINITY } else { passed.max(0.0) };
        let sum: f64 = self.sides.iter().zip(&o.prices).map(|(s, p)| of(p.passed / s.scale)).sum();
        if sum.is_finite() { sum } else { f64::INFINITY }
    }

    /// The most promising points of a sequence: least violation, then least objective.
    fn starts(&self, at: &[f64], count: usize, seed: u64) -> Vec<Vec<f64>> {
        let free = self.dim() - self.axes;
        let Some(mut sequence) = Sobol::new(free.min(MOST_DIMENSIONS), seed) else {
            return vec![at.to_vec()];
        };
        let mut trials: Vec<(f64, f64, Vec<f64>)> = (0..TRIALS)
            .map(|_| {
                let unit = sequence.next_point();
                let ranges = &self.ranges[self.axes..];
                let x = ranges.iter().enumerate().map(|(k, r)| r.value_at(*unit.get(k).unwrap_or(&0.5)));
                let x: Vec<f64> = at.iter().copied().chain(x).collect();
                let o = self.judge(&x, Status::Stalled, None);
                (self.violation(&o), self.cost(&o), x)
            })
            .collect();
        trials.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
        trials.truncate(count.max(1));
        trials.into_iter().map(|t| t.2).collect()
    }

    /// A point as it is, with multipliers where there are some.
    pub fn judge(&self, x: &[f64], status: Status, saves: Option<&[f64]>) -> CellOptimum {
        let mut at = Prediction::new(self.dim());
        let each = self.models.iter().map(|m| {
            m.predict(x, Ask::Variance, &mut at);
            (at.mean, at.variance.max(0.0).sqrt())
        });
        let (responses, deviations): (Vec<f64>, Vec<f64>) = each.unzip();
        let objective = responses.iter().zip(&self.weights).map(|(r, w)| w * r).sum();
        let variance: f64 = deviations.iter().zip(&self.weights).map(|(d, w)| (w * d).powi(2)).sum();
        let prices = self.sides.iter().enumerate().map(|(k, s)| Price {
            response: s.response,
            sign: s.sign,
            saves: saves.map_or(0.0, |l| l[k]),
            passed: s.sign * (responses[s.response] - s.limit) + s.caution * self.z * deviations[s.response],
        });
        let prices: Vec<Price> = prices.collect();
        let feasible = prices.iter().zip(&self.sides).all(|(p, s)| p.passed <= KEPT * s.scale);
        CellOptimum {
            x: x.to_vec(),
            responses,
            deviations,
            objective,
            objective_deviation: variance.sqrt(),
            feasible,
            status,
            prices,
        }
    }

    fn solve(&self, start: &[f64], elastic: bool, interrupt: &dyn Fn() -> bool) -> CellOptimum {
        let mut program = Program::new(self, start, elastic);
        let size = program.size;
        let found = solve(&mut program, &NlpOptions { tolerance: 1e-9, ..NlpOptions::default() }, interrupt);
        let x = program.factors(&found.x);
        let saves: Vec<f64> = self
            .sides
            .iter()
            .zip(&found.multipliers)
            .map(|(s, l)| if elastic { 0.0 } else { (l * size / s.scale).max(0.0) })
            .collect();
        self.judge(&x, found.status, Some(&saves))
    }
}

/// Variables: free factors as shares of their ranges, a slack for each limit, and in the elastic program its violation.
pub(super) struct Program<'a, 'b> {
    pub(super) setting: &'a Setting<'b>,
    elastic: bool,
    pub(super) start: Vec<f64>,
    /// Scale of the objective.
    pub(super) size: f64,
    x: Vec<f64>,
    /// Point at which the predictions hold, and whether its derivatives are known.
    known: Vec<f64>,
    derived: bool,
    at: Vec<Prediction>,
}

/// Gradient and Hessian of a mean plus some standard deviations, over the free factors in shares of their ranges.
pub(super) struct Local {
    pub(super) gradient: Vec<f64>,
    pub(super) hessian: Vec<f64>,
}

impl<'a, 'b> Program<'a, 'b> {
    pub(super) fn new(setting: &'a Setting<'b>, start: &[f64], elastic: bool) -> Self {
        let here = setting.judge(start, Status::Stalled, None);
        Self {
            setting,
            elastic,
            start: start.to_vec(),
            size: here.objective.abs().max(here.objective_deviation).max(1e-9),
            x: start.to_vec(),
            known: Vec::new(),
            derived: false,
            // The axes of the cell stand still.
            at: vec![Prediction::of_moving(setting.dim(), setting.axes); setting.models.len()],
        }
    }

    pub(super) fn free(&self) -> usize {
        self.setting.dim() - self.setting.axes
    }

    pub(super) fn factors(&self, v: &[f64]) -> Vec<f64> {
        let axes = self.setting.axes;
        let ranges = &self.setting.ranges[axes..];
        let free = ranges.iter().zip(v).map(|(r, u)| r.clamp(r.value_at(*u)));
        self.start[..axes].iter().copied().chain(free).collect()
    }

    /// Predictions at `v`. A step that is tried needs their values alone; where the search goes on from, all derivatives are asked for
    /// at once.
    pub(super) fn refresh(&mut self, v: &[f64], derivatives: bool) {
        let nf = self.free();
        let known = self.known == v[..nf];
        if known && (self.derived || !derivatives) {
            return;
        }
        if !known {
            self.x = self.factors(v);
            self.known = v[..nf].to_vec();
        }
        let ask = if derivatives { Ask::Hessian } else { Ask::Variance };
        for (m, at) in self.setting.models.iter().zip(&mut self.at) {
            m.predict(&self.x, ask, at);
        }
        self.derived = derivatives;
    }

    /// `mean` weights and squared `variance` weights of responses, and how many standard deviations are added.
    fn value(&self, parts: &[(usize, f64)], deviations: f64, scale: f64) -> f64 {
        let (mut value, mut variance) = (0.0, FLOOR * scale * scale);
        for (k, w) in parts {
            value += w * self.at[*k].mean;
            variance += w * w * self.at[*k].variance.max(0.0);
        }
        value + if deviations == 0.0 { 0.0 } else { deviations * variance.sqrt() }
    }

    /// Derivatives of [`Program::value`].
    fn local(&self, parts: &[(usize, f64)], deviations: f64, scale: f64) -> Local {
        let (axes, nf, d) = (self.setting.axes, self.free(), self.setting.dim());
        let span = |i: usize| self.setting.ranges[axes + i].width();
        let mut variance = FLOOR * scale * scale;
        let (mut g, mut vg) = (vec![0.0; nf], vec![0.0; nf]);
        let (mut h, mut vh) = (vec![0.0; nf * nf], vec![0.0; nf * nf]);
        for (k, w) in parts {
            let at = &self.at[*k];
            variance += w * w * at.variance.max(0.0);
            for i in 0..nf {
                g[i] += w * at.gradient[axes + i] * span(i);
                vg[i] += w * w * at.variance_gradient[axes + i] * span(i);
                for j in 0..nf {
                    let (place, s) = ((axes + i) * d + axes + j, span(i) * span(j));
                    h[i * nf + j] += w * at.hessian[place] * s;
                    vh[i * nf + j] += w * w * at.variance_hessian[place] * s;
                }
            }
        }
        if deviations != 0.0 {
            let sd = variance.sqrt();
            for i in 0..nf {
                g[i] += deviations * vg[i] / (2.0 * sd);
                for j in 0..nf {
                    let curved = vh[i * nf + j] / (2.0 * sd) - vg[i] * vg[j] / (4.0 * sd.powi(3));
                    h[i * nf + j] += deviations * curved;
                }
            }
        }
        Local { gradient: g, hessian: h }
    }

    fn objective_parts(&self) -> Vec<(usize, f64)> {
        let weights = self.setting.weights.iter().copied().enumerate();
        weights.filter(|(_, w)| *w != 0.0).collect()
    }

    pub(super) fn objective_value(&self) -> f64 {
        self.value(&self.objective_parts(), self.setting.caution, self.size)
    }

    pub(super) fn side_value(&self, s: &Side) -> f64 {
        let value = self.value(&[(s.response, s.sign)], s.caution * self.setting.z, s.scale);
        (value - s.sign * s.limit) / s.scale
    }

    pub(super) fn objective_local(&self) -> Local {
        self.local(&self.objective_parts(), self.setting.caution, self.size)
    }

    /// sign f + z sd - sign limit, in the scale of the limit.
    pub(super) fn side_local(&self, s: &Side) -> Local {
        let mut l = self.local(&[(s.response, s.sign)], s.caution * self.setting.z, s.scale);
        l.gradient.iter_mut().for_each(|g| *g /= s.scale);
        l.hessian.iter_mut().for_each(|h| *h /= s.scale);
        l
    }
}

impl SparseNlp for Program<'_, '_> {
    fn n(&self) -> usize {
        let sides = self.setting.sides.len();
        self.free() + if self.elastic { 2 * sides } else { sides }
    }

    fn m(&self) -> usize {
        self.setting.sides.len()
    }

    fn bounds(&self, lower: &mut [f64], upper: &mut [f64]) {
        let nf = self.free();
        lower.fill(0.0);
        upper[..nf].fill(1.0);
    }

    fn start(&self, v: &mut [f64]) {
        let (axes, nf) = (self.setting.axes, self.free());
        for i in 0..nf {
            let range = self.setting.ranges[axes + i];
            v[i] = range.share(self.start[axes + i]).clamp(0.0, 1.0);
        }
        let here = self.setting.judge(&self.start, Status::Stalled, None);
        let sides = self.setting.sides.len();
        for (k, (p, s)) in here.prices.iter().zip(&self.setting.sides).enumerate() {
            let passed = p.passed / s.scale;
            v[nf + k] = (-passed).max(1e-3);
            if self.elastic {
                v[nf + sides + k] = passed.max(1e-3);
            }
        }
    }

    fn objective(&mut self, v: &[f64]) -> f64 {
        if self.elastic {
            return v[self.free() + self.m()..].iter().sum();
        }
        self.refresh(v, false);
        self.objective_value() / self.size
    }

    fn gradient(&mut self, v: &[f64], grad: &mut [f64]) {
        grad.fill(0.0);
        if self.elastic {
            let from = self.free() + self.m();
            grad[from..].fill(1.0);
            return;
        }
        self.refresh(v, true);
        let l = self.objective_local();
        grad.iter_mut().zip(&l.gradient).for_each(|(g, l)| *g = l / self.size);
    }

    fn constraints(&mut self, v: &[f64], c: &mut [f64]) {
        self.refresh(v, false);
        let (nf, m) = (self.free(), self.m());
        for (k, s) in self.setting.sides.iter().enumerate() {
            let violation = if self.elastic { v[nf + m + k] } else { 0.0 };
            c[k] = self.side_value(s) + v[nf + k] - violation;
        }
    }

    fn jacobian_structure(&self) -> Vec<(usize, usize)> {
        let (nf, m) = (self.free(), self.m());
        let mut all = Vec::new();
        for k in 0..m {
            all.extend((0..nf).map(|i| (k, i)));
            all.push((k, nf + k));
            if self.elastic {
                all.push((k, nf + m + k));
            }
        }
        all
    }

    fn jacobian(&mut self, v: &[f64], values: &mut [f64]) {
        self.refresh(v, true);
        let mut at = 0;
        for s in &self.setting.sides {
            for g in self.side_local(s).gradient {
                values[at] = g;
                at += 1;
            }
            values[at] = 1.0;
            at += 1;
            if self.elastic {
                values[at] = -1.0;
                at += 1;
            }
        }
    }

    fn hessian_structure(&self) -> Vec<(usize, usize)> {
        let nf = self.free();
        (0..nf).flat_map(|i| (0..=i).map(move |j| (i, j))).collect()
    }

    fn hessian(&mut self, v: &[f64], sigma: f64, multipliers: &[f64], values: &mut [f64]) {
        self.refresh(v, true);
        let nf = self.free();
        let mut sum = vec![0.0; nf * nf];
        if !self.elastic && sigma != 0.0 {
            let l = self.objective_local();
            sum.iter_mut().zip(&l.hessian).for_each(|(s, h)| *s += sigma * h / self.size);
        }
        for (s, w) in self.setting.sides.iter().zip(multipliers).filter(|(_, w)| **w != 0.0) {
            let l = self.side_local(s);
            sum.iter_mut().zip(&l.hessian).for_each(|(t, h)| *t += w * h);
        }
        let mut at = 0;
        for i in 0..nf {
            for j in 0..=i {
                values[at] = sum[i * nf + j];
                at += 1;
            }
        }
    }
}
