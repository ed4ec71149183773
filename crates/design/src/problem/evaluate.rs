//! Value and exact gradient of a design problem.

use super::term::TermWork;
use super::{Convention, DesignProblem};
use crate::channel::Layout;
use crate::criterion::Active;
use crate::error::DesignError;
use dynocal_numerics::interval::Interval;
use dynocal_numerics::status::Status;

/// Multipliers of the range constraints of a problem (augmented Lagrangian): rate limits, then outputs per sample.
#[derive(Clone, Debug)]
pub(crate) struct Multipliers {
    pub(crate) penalty: f64,
    pub(crate) rate: Vec<f64>,
    pub(crate) region: Vec<f64>,
    pub(crate) output: Vec<Vec<f64>>,
}

/// A part of a record.
pub(crate) struct Part {
    /// Free variables that belong to it.
    pub(crate) free: Vec<bool>,
    /// Its samples.
    pub(crate) samples: std::ops::Range<usize>,
}

/// Evaluates a [`DesignProblem`]; all buffers are allocated once.
///
/// The search minimises `f(x) = ln sum_i w_i J_i`, or the plain sum where a criterion may be negative, over the
/// variables x of the [`Layout`].
#[derive(Clone)]
pub struct Evaluator<'a> {
    layout: Layout,
    convention: Convention,
    pad: usize,
    start: usize,
    lag: usize,
    logarithmic: bool,
    /// Share of the range of every limit that the search aims inside, so that what it ends with keeps the limit itself.
    aim: f64,
    /// Padded record, (N + pad) x m.
    u: Vec<f64>,
    u_bar: Vec<f64>,
    terms: Vec<TermWork<'a>>,
    count: usize,
}

impl<'a> Evaluator<'a> {
    /// Checks the problem and allocates.
    ///
    /// # Errors
    /// What [`DesignProblem::check`] finds; [`DesignError::Diverged`] for an objective signal that the model
    /// cannot follow.
    pub fn new(problem: &DesignProblem<'a>) -> Result<Self, DesignError> {
        let layout = problem.check()?;
        let (pad, start) = problem.padding();
        let size = (problem.n_samples + pad) * problem.channels.len();
        let terms =
            problem.terms.iter().map(|t| TermWork::new(problem, *t)).collect::<Result<Vec<_>, _>>()?;
        let logarithmic = problem.terms.iter().filter_map(|t| t.criterion).all(|c| c.is_positive());
        Ok(Self {
            layout,
            convention: problem.convention,
            pad,
            start,
            lag: problem.max_lag(),
            logarithmic,
            aim: 0.0,
            u: vec![0.0; size],
            u_bar: vec![0.0; size],
            terms,
            count: 0,
        })
    }

    /// The map between free variables and samples.
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Evaluations so far.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Samples (N x m) of the last evaluation.
    pub fn inputs(&self) -> &[f64] {
        &self.u[self.pad * self.layout.n_channels()..]
    }

    /// Predicted output (N) of term `i` at the last evaluation.
    pub fn output(&self, i: usize) -> &[f64] {
        &self.terms[i].y[self.pad..]
    }

    /// Lower factor L = R' and column scales of the information of term `i` at the last evaluation.
    pub fn factors(&self, i: usize) -> (&[f64], &[f64]) {
        self.terms[i].factors()
    }

    /// Raw sensitivities of term `i` at the last evaluation, rows that count.
    pub fn sensitivities(&self, i: usize) -> &[f64] {
        self.terms[i].counted()
    }

    /// Weighted criterion of the samples `u` (N x m), factored by QR and with extremes exact. Infinite where the
    /// information is singular or a model diverges.
    pub fn value(&mut self, u: &[f64]) -> f64 {
        self.load(u);
        if !self.simulate() {
            return f64::INFINITY;
        }
        let mut sum = 0.0;
        for t in self.terms.iter_mut().filter(|t| t.term.criterion.is_some()) {
            if !t.factor(true) {
                return f64::INFINITY;
            }
            sum += t.term.weight * t.exact_value();
        }
        sum
    }

    /// Weighted criterion (p-norms of order `sharpness` for extremes) of the samples `u` (N x m) and its gradient
    /// in the samples (N x m). Infinite where singular or diverged; the gradient is then zero.
    pub fn value_gradient(&mut self, u: &[f64], sharpness: f64, gradient: &mut [f64]) -> f64 {
        self.load(u);
        self.clear();
        let value = self.forward(sharpness);
        gradient.fill(0.0);
        if value.is_finite() {
            self.backward(1.0);
            gradient.copy_from_slice(&self.u_bar[self.pad * self.layout.n_channels()..]);
        }
        value
    }

    /// The search objective at `x` and its gradient (none where `grad` is empty), with the augmented Lagrangian of the
    /// constraints when given.
    pub(crate) fn objective(
        &mut self,
        x: &[f64],
        sharpness: f64,
        multipliers: Option<&Multipliers>,
        grad: &mut [f64],
    ) -> f64 {
        self.load_variables(x);
        self.clear();
        let sum = self.forward(sharpness);
        if !sum.is_finite() || (self.logarithmic && sum <= 0.0) {
            return f64::INFINITY;
        }
        let mut f = if self.logarithmic { sum.ln() } else { sum };
        if let Some(mu) = multipliers {
            f += self.penalise_outputs(mu);
        }
        if grad.is_empty() {
            return multipliers.map_or(f, |mu| f + penalise_rates(&self.layout, self.aim, mu, x, grad));
        }
        self.backward(if self.logarithmic { 1.0 / sum } else { 1.0 });
        self.layout.gather(&self.u_bar[self.pad * self.layout.n_channels()..], grad);
        if let Some(mu) = multipliers {
            f += penalise_rates(&self.layout, self.aim, mu, x, grad);
        }
        f
    }

    /// What [`Evaluator::aim_inside`] was told.
    pub(crate) fn aimed_inside(&self) -> f64 {
        self.aim
    }

    /// Half the sum of squared violations of the aimed limits at `x` (outputs, rates, regions), and its gradient: what a
    /// restoration makes zero. No sensitivities are needed. Infinite where a model diverges.
    pub(crate) fn shortfall(&mut self, x: &[f64], grad: &mut [f64]) -> f64 {
        self.load_variables(x);
        self.clear();
        self.count += 1;
        if !self.terms.iter_mut().all(|t| t.term.limits.is_none() || t.simulate_only(&self.u)) {
            return f64::INFINITY;
        }
        let Some(mu) = self.multipliers(1.0) else { return 0.0 };
        let mut f = self.penalise_outputs(&mu);
        self.u_bar.fill(0.0);
        for t in self.terms.iter_mut().filter(|t| t.term.limits.is_some()) {
            t.output_adjoint(&self.u, &mut self.u_bar);
        }
        self.gather_pad();
        self.layout.gather(&self.u_bar[self.pad * self.layout.n_channels()..], grad);
        f += penalise_rates(&self.layout, self.aim, &mu, x, grad);
        f
    }

    /// Lets the search aim `share` of the range inside every limit.
    pub(crate) fn aim_inside(&mut self, share: f64) {
        self.aim = share.clamp(0.0, 0.1);
    }

    /// Pieces of the criterion of a problem of one model at `x`; `None` where it is singular.
    pub(crate) fn active(&mut self, x: &[f64], band: f64) -> Option<Active> {
        self.load_variables(x);
        self.clear();
        if !self.simulate() || !self.terms[0].factor(true) {
            return None;
        }
        self.terms[0].active(band)
    }

    /// Gradient in x of what has the derivative `gram_bar` (p x p) in A, at the record of [`Evaluator::active`].
    pub(crate) fn piece_gradient(&mut self, gram_bar: &[f64], grad: &mut [f64]) {
        self.terms[0].set_gram_bar(gram_bar);
        let weight = self.terms[0].term.weight;
        self.backward(if weight > 0.0 { 1.0 / weight } else { 1.0 });
        self.layout.gather(&self.u_bar[self.pad * self.layout.n_channels()..], grad);
    }

    /// The criterion that belongs to a search objective.
    pub(crate) fn undo_logarithm(&self, f: f64) -> f64 {
        if self.logarithmic { f.exp() } else { f }
    }

    /// Whether a criterion is approached through p-norms.
    pub(crate) fn has_extreme(&self) -> bool {
        self.terms.iter().filter_map(|t| t.term.criterion).any(|c| c.is_extreme())
    }

    fn load(&mut self, u: &[f64]) {
        let m = self.layout.n_channels();
        self.u[self.pad * m..].copy_from_slice(u);
        self.fill_pad();
    }

    fn load_variables(&mut self, x: &[f64]) {
        self.layout.fill(x, &mut self.u[self.pad * self.layout.n_channels()..]);
        self.fill_pad();
    }

    fn fill_pad(&mut self) {
        let m = self.layout.n_channels();
        if self.convention == Convention::Hold {
            let (pad, rest) = self.u.split_at_mut(self.pad * m);
            pad.chunks_exact_mut(m).for_each(|row| row.copy_from_slice(&rest[..m]));
        }
    }

    fn clear(&mut self) {
        self.terms.iter_mut().for_each(|t| t.y_bar.fill(0.0));
    }

    fn simulate(&mut self) -> bool {
        self.count += 1;
        self.terms.iter_mut().all(|t| t.simulate(&self.u) == Status::Converged)
    }

    fn forward(&mut self, sharpness: f64) -> f64 {
        if !self.simulate() {
            return f64::INFINITY;
        }
        let mut sum = 0.0;
        for t in self.terms.iter_mut().filter(|t| t.term.criterion.is_some()) {
            if !t.factor(false) {
                return f64::INFINITY;
            }
            sum += t.term.weight * t.value_gradient(sharpness);
        }
        if sum.is_nan() { f64::INFINITY } else { sum }
    }

    fn backward(&mut self, outer: f64) {
        self.u_bar.fill(0.0);
        for t in &mut self.terms {
            t.adjoint(&self.u, outer * t.term.weight, &mut self.u_bar);
        }
        self.gather_pad();
    }

    /// What stands before the record: copies of the first sample, or constants.
    fn gather_pad(&mut self) {
        let m = self.layout.n_channels();
        if self.convention == Convention::Hold {
            let (pad, rest) = self.u_bar.split_at_mut(self.pad * m);
            for row in pad.chunks_exact(m) {
                crate::kernel::axpy(1.0, row, &mut rest[..m]);
            }
        }
    }

    /// Terms with limits: (term, lower, range) that the search aims at, margin taken off.
    fn limits(&self) -> impl Iterator<Item = (usize, f64, f64)> + '_ {
        self.terms.iter().enumerate().filter_map(|(i, t)| {
            let aimed = |kept: Interval| {
                let inside = self.aim * kept.width();
                (i, kept.lower + inside, kept.width() - 2.0 * inside)
            };
            t.term.limits.map(|l| aimed(l.kept()))
        })
    }

    /// Multipliers at zero for the constraints of this problem; `None` when there is none.
    pub(crate) fn multipliers(&self, penalty: f64) -> Option<Multipliers> {
        let rows = self.u.len() / self.layout.n_channels();
        let output: Vec<Vec<f64>> = self.limits().map(|_| vec![0.0; rows]).collect();
        let rate = vec![0.0; self.layout.rates().len()];
        let region = vec![0.0; self.layout.regions.len()];
        let any = !rate.is_empty() || !region.is_empty() || !output.is_empty();
        any.then_some(Multipliers { penalty, rate, region, output })
    }

    /// The part of a record around `length` free values of each channel from sample `from` on: as far as an output reaches
    /// on both sides.
    pub(crate) fn around(&self, from: usize, length: usize) -> Part {
        let layout = &self.layout;
        let reach = self.lag.max(1);
        let mut to = from;
        for (i, c) in layout.channels().iter().enumerate().filter(|(i, _)| !layout.variables(*i).is_empty()) {
            to = to.max((layout.knot(i, from) + length) * c.hold);
        }
        let samples = from.saturating_sub(reach)..(to + reach).min(layout.n_samples());
        let mut free = vec![false; layout.len()];
        for i in 0..layout.n_channels() {
            for j in layout.variables(i) {
                free[j] =
                    layout.first_sample(i, j) < samples.end && layout.last_sample(i, j) >= samples.start;
            }
        }
        Part { free, samples }
    }

    /// Whether any output has limits.
    pub(crate) fn limits_outputs(&self) -> bool {
        self.terms.iter().any(|t| t.term.limits.is_some())
    }

    /// Sets the multipliers of a part to zero.
    pub(crate) fn forget(&self, mu: &mut Multipliers, part: &Part) {
        for lambda in &mut mu.output {
            lambda[part.samples.start + self.pad..part.samples.end + self.pad].fill(0.0);
        }
        for (_, lambda) in self.layout.rates().iter().zip(&mut mu.rate).filter(|(r, _)| part.free[r.j]) {
            *lambda = 0.0;
        }
        for (g, lambda) in mu.region.iter_mut().enumerate() {
            if self.layout.regions.variables(g).any(|j| part.free[j]) {
                *lambda = 0.0;
            }
        }
    }

    fn penalise_outputs(&mut self, mu: &Multipliers) -> f64 {
        let mut f = 0.0;
        let limits: Vec<_> = self.limits().collect();
        for ((i, lower, range), lambda) in limits.into_iter().zip(&mu.output) {
            let t = &mut self.terms[i];
            for k in self.start..t.y.len() {
                let (value, slope) = penalty((t.y[k] - lower) / range, 0.0, 1.0, lambda[k], mu.penalty);
                f += value;
                t.y_bar[k] = slope / range;
            }
        }
        f
    }

    /// Moves the multipliers to the slopes of the penalties at the last evaluation (made at `x`).
    pub(crate) fn update(&self, x: &[f64], mu: &mut Multipliers) {
        for ((i, lower, range), lambda) in self.limits().zip(&mut mu.output) {
            let t = &self.terms[i];
            for k in self.start..t.y.len() {
                lambda[k] = penalty((t.y[k] - lower) / range, 0.0, 1.0, lambda[k], mu.penalty).1;
            }
        }
        for (r, lambda) in self.layout.rates().iter().zip(&mut mu.rate) {
            let limit = aimed_rate(r.limit, self.aim);
            *lambda = penalty(x[r.j] - x[r.j - 1], -limit, limit, *lambda, mu.penalty).1;
        }
        for (g, lambda) in mu.region.iter_mut().enumerate() {
            let passed = self.layout.regions.condition(g, x).0 + self.aim;
            *lambda = penalty(passed, f64::NEG_INFINITY, 0.0, *lambda, mu.penalty).1;
        }
    }

    /// Violation of the output limits (margin included) at the last evaluation, as a share of the range: the largest one
    /// and the sum over all samples. Both are zero exactly where every limit is kept, without any tolerance.
    pub(crate) fn output_violation(&self) -> (f64, f64) {
        let (mut largest, mut sum) = (0.0f64, 0.0);
        for t in &self.terms {
            let Some(Interval { lower, upper }) = t.term.limits.map(|l| l.kept()) else { continue };
            for y in &t.y[self.start..] {
                let over = (y - upper).max(lower - y).max(0.0) / (upper - lower);
                largest = largest.max(over);
                sum += over;
            }
        }
        (largest, sum)
    }

    /// First sample of the record whose output is computed.
    pub(crate) fn first_computed(&self) -> usize {
        self.start - self.pad
    }
}

/// Rate limit that the search aims at.
fn aimed_rate(limit: f64, aim: f64) -> f64 {
    (limit - aim).max(0.5 * limit)
}

fn penalise_rates(layout: &Layout, aim: f64, mu: &Multipliers, x: &[f64], grad: &mut [f64]) -> f64 {
    let mut f = 0.0;
    for (r, lambda) in layout.rates().iter().zip(&mu.rate) {
        let limit = aimed_rate(r.limit, aim);
        let (value, slope) = penalty(x[r.j] - x[r.j - 1], -limit, limit, *lambda, mu.penalty);
        f += value;
        if !grad.is_empty() {
            grad[r.j] += slope;
            grad[r.j - 1] -= slope;
        }
    }
    for (g, lambda) in mu.region.iter().enumerate() {
        let (passed, terms) = layout.regions.condition(g, x);
        let (value, slope) = penalty(passed + aim, f64::NEG_INFINITY, 0.0, *lambda, mu.penalty);
        f += value;
        if !grad.is_empty() {
            terms.iter().for_each(|(j, a)| grad[*j] += slope * a);
        }
    }
    f
}

/// Augmented-Lagrangian term of `lower <= c <= upper` and its slope: with z = c + lambda / rho and v the distance
/// of z to the range, `rho v^2 / 2 - lambda^2 / (2 rho)`; the slope rho v is the next multiplier.
fn penalty(c: f64, lower: f64, upper: f64, lambda: f64, rho: f64) -> (f64, f64) {
    let z = c + lambda / rho;
    let v = z - z.clamp(lower, upper);
    (0.5 * rho * v * v - 0.5 * lambda * lambda / rho, rho * v)
}
