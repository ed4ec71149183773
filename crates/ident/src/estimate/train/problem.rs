//! The training problem: errors of free runs over whole records or over subrecords, J'J gathered block by block.
//!
//! ```text
//! sum_t w(t) (y(t) - yhat(t; theta))^2 + sum_k v_k theta_k^2
//! ```
//!
//! With a horizon of H samples each record is cut into subrecords that start from measured outputs every H samples
//! (multiple shooting with the shooting states measured): H = 1 is the one-step prediction (series-parallel form), H = 0
//! stands for the whole record (parallel form). A short horizon bounds what the recursion can amplify.

use dynocal_numerics::linalg::least_squares;
use dynocal_numerics::lm::LeastSquares;
use dynocal_numerics::status::Status;

use super::division::Weights;
use crate::estimate::covariance::{Evidence, Rows, TakeRows};
use crate::experiment::Experiment;
use crate::model::{Model, Run};

/// Rows of a block of the Jacobian: small enough for the cache, large enough for the matrix kernel.
const ROWS: usize = 256;

/// Errors of a model on divided records.
pub(super) struct Task<'a> {
    model: &'a dyn Model,
    data: &'a [Experiment],
    weights: &'a [Weights],
    /// Length of the subrecords; 0 for whole records.
    pub(super) horizon: usize,
    /// Weight of each squared parameter; empty without penalty.
    pub(super) penalty: Vec<f64>,
    rows: usize,
    y: Vec<f64>,
    block: Block,
    /// Parameters of the report.
    pub(super) estimate: Vec<f64>,
    /// The last whole free run and its scores: the search asks for them again where it moves.
    last: Option<(Vec<f64>, Scores)>,
}

/// Rows on their way to J'J.
struct Block {
    r: Vec<f64>,
    jac: Vec<f64>,
}

/// Mean squared errors of one free run on the samples of each use; NaN where there is none.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Scores {
    pub(super) fit: f64,
    pub(super) selection: f64,
    pub(super) test: f64,
}

impl Scores {
    const DIVERGED: Self = Self { fit: f64::INFINITY, selection: f64::INFINITY, test: f64::INFINITY };
}

impl<'a> Task<'a> {
    pub(super) fn new(model: &'a dyn Model, data: &'a [Experiment], weights: &'a [Weights]) -> Self {
        let longest = data.iter().map(Experiment::len).max().unwrap_or(0);
        let rows = data.iter().map(Experiment::len).sum();
        let (y, block) = (vec![0.0; longest], Block { r: Vec::new(), jac: Vec::new() });
        Self {
            model,
            data,
            weights,
            horizon: 0,
            penalty: Vec::new(),
            rows,
            y,
            block,
            estimate: Vec::new(),
            last: None,
        }
    }

    /// Sum of squares; infinite when a free run diverges.
    pub(super) fn cost(&mut self, x: &[f64]) -> f64 {
        let mut r = vec![0.0; self.residuals()];
        let cost = if self.residual(x, &mut r) { r.iter().map(|v| v * v).sum() } else { f64::INFINITY };
        if cost.is_finite() { cost } else { f64::INFINITY }
    }

    /// Scores of the free run over whole records, whatever the horizon; infinite when one diverges.
    pub(super) fn scores(&mut self, x: &[f64]) -> Scores {
        match &self.last {
            Some((known, scores)) if known == x => *scores,
            _ => self.run_whole(x, &mut []).unwrap_or(Scores::DIVERGED),
        }
    }

    /// Free runs over whole records: their scores, and their errors into `errors` unless that is empty.
    fn run_whole(&mut self, x: &[f64], errors: &mut [f64]) -> Option<Scores> {
        self.last = None;
        let (mut sums, mut totals, mut row) = ([0.0; 3], [0.0; 3], 0);
        for (e, w) in self.data.iter().zip(self.weights) {
            let y = &mut self.y[..e.len()];
            if self.model.simulate(x, &e.run(self.model), y) != Status::Converged {
                return None;
            }
            for (i, w) in [&w.fit, &w.selection, &w.test].into_iter().enumerate() {
                for ((y, z), w) in y.iter().zip(&e.y).zip(w).filter(|(_, w)| **w > 0.0) {
                    sums[i] += w * (y - z).powi(2);
                    totals[i] += w;
                }
            }
            if !errors.is_empty() {
                fill_errors(y, &e.y, &w.fit, &mut errors[row..row + e.len()]);
            }
            row += e.len();
        }
        let mean = |i: usize| {
            let mse: f64 = sums[i] / totals[i];
            if totals[i] > 0.0 && !mse.is_finite() { f64::INFINITY } else { mse }
        };
        let scores = Scores { fit: mean(0), selection: mean(1), test: mean(2) };
        self.last = Some((x.to_vec(), scores));
        Some(scores)
    }

    /// First sample after `t` that ends the subrecord beginning at `t`.
    fn end(&self, t: usize, n: usize) -> usize {
        if self.horizon == 0 { n } else { (t + self.horizon).min(n) }
    }

    /// The part of a record whose computed samples are `from..to`.
    fn part<'e>(&self, e: &'e Experiment, from: usize, to: usize) -> Run<'e> {
        let (m, lag) = (self.model.n_inputs(), self.model.max_lag());
        Run { u: &e.u[(from - lag) * m..to * m], y: &e.y[from - lag..to], start: lag }
    }

    /// One-step predictions with their Jacobian, in blocks of rows.
    fn one_step_blocks(&mut self, x: &[f64], take: &mut dyn FnMut(&[f64], &[f64])) -> bool {
        let (p, lag) = (self.model.n_params(), self.model.max_lag());
        let mut s = vec![0.0; (ROWS + lag) * p];
        for (e, w) in self.data.iter().zip(self.weights) {
            let first = e.first(self.model);
            for from in (first..e.len()).step_by(ROWS) {
                let to = (from + ROWS).min(e.len());
                let run = self.part(e, from, to);
                let y = &mut self.y[..run.len()];
                self.model.predict(x, &run, y);
                let s = &mut s[..run.len() * p];
                self.model.one_step_jacobian(x, &run, s);
                self.block.clear();
                self.block.add(&y[lag..], &e.y[from..to], &w.fit[from..to], &s[lag * p..]);
                if !self.block.is_finite() {
                    return false;
                }
                self.block.hand_over(take);
            }
        }
        true
    }

    /// Free runs over the subrecords with their sensitivities, in blocks of rows.
    fn free_run_blocks(&mut self, x: &[f64], take: &mut dyn FnMut(&[f64], &[f64])) -> bool {
        let lag = self.model.max_lag();
        self.block.clear();
        for (e, w) in self.data.iter().zip(self.weights) {
            let mut from = e.first(self.model);
            while from < e.len() {
                let to = self.end(from, e.len());
                let run = self.part(e, from, to);
                let (y, block) = (&mut self.y[..run.len()], &mut self.block);
                let mut finite = true;
                let status = self.model.sensitivity_blocks(x, &run, ROWS, y, &mut |t, y, s| {
                    let at = from + t - lag;
                    let until = at + y.len();
                    block.add(y, &e.y[at..until], &w.fit[at..until], s);
                    if block.r.len() >= ROWS {
                        finite &= block.is_finite();
                        block.hand_over(take);
                        block.clear();
                    }
                });
                if status != Status::Converged || !finite {
                    return false;
                }
                from = to;
            }
        }
        self.block.hand_over(take);
        self.block.is_finite()
    }

    /// Errors of the subrecords; `false` when one diverges.
    fn run_parts(&mut self, x: &[f64], errors: &mut [f64]) -> bool {
        let (lag, mut row) = (self.model.max_lag(), 0);
        for (e, w) in self.data.iter().zip(self.weights) {
            let errors = &mut errors[row..row + e.len()];
            let mut from = e.first(self.model).min(e.len());
            errors[..from].fill(0.0);
            while from < e.len() {
                let to = if self.horizon == 1 { e.len() } else { self.end(from, e.len()) };
                let run = self.part(e, from, to);
                let y = &mut self.y[..run.len()];
                if self.horizon == 1 {
                    self.model.predict(x, &run, y);
                } else if self.model.simulate(x, &run, y) != Status::Converged {
                    return false;
                }
                fill_errors(&y[lag..], &e.y[from..to], &w.fit[from..to], &mut errors[from..to]);
                from = to;
            }
            row += e.len();
        }
        true
    }

    /// Fits by least squares the parameters at `places`, in which prediction is linear when the others stay as in `x`.
    pub(super) fn fit_linear(&mut self, x: &[f64], places: &[usize], ridge: f64) -> Option<Vec<f64>> {
        let p = self.model.n_params();
        let (mut a, mut b) = (Vec::new(), Vec::new());
        let finite = self.one_step_blocks(x, &mut |r, jac| {
            b.extend(r.iter().map(|v| -v));
            jac.chunks_exact(p).for_each(|row| a.extend(places.iter().map(|k| row[*k])));
        });
        let scale: f64 = a.iter().map(|v| v * v).sum::<f64>() / places.len().max(1) as f64;
        let fit = least_squares(&a, b.len(), places.len(), &b, ridge * scale).ok().filter(|_| finite)?;
        let mut theta = x.to_vec();
        places.iter().zip(&fit.x).for_each(|(k, v)| theta[*k] += v);
        Some(theta)
    }
}

impl Evidence for Task<'_> {
    fn params(&self) -> usize {
        self.model.n_params()
    }

    fn exogenous(&self) -> bool {
        true
    }

    fn rows(&self) -> Rows {
        Rows::Sensitivities
    }

    /// Rows of the free runs over whole records; those without weight are zero.
    fn visit(&mut self, take: &mut TakeRows<'_>) {
        let (p, theta) = (self.model.n_params(), std::mem::take(&mut self.estimate));
        let (mut r, mut jac) = (Vec::new(), Vec::new());
        for (record, (e, w)) in self.data.iter().zip(self.weights).enumerate() {
            let first = e.first(self.model).min(e.len());
            take(record, &vec![0.0; first], &vec![0.0; first * p]);
            let (run, y) = (e.run(self.model), &mut self.y[..e.len()]);
            self.model.sensitivity_blocks(&theta, &run, ROWS, y, &mut |t, y, s| {
                let w = &w.fit[t..t + y.len()];
                r.resize(y.len(), 0.0);
                fill_errors(y, &e.y[t..t + y.len()], w, &mut r);
                jac.clear();
                for (row, w) in s.chunks_exact(p).zip(w) {
                    jac.extend(row.iter().map(|v| w.sqrt() * v));
                }
                take(record, &r, &jac);
            });
        }
        self.estimate = theta;
    }
}

impl LeastSquares for Task<'_> {
    fn n(&self) -> usize {
        self.model.n_params()
    }

    fn residuals(&self) -> usize {
        self.rows + self.penalty.len()
    }

    fn residual(&mut self, x: &[f64], r: &mut [f64]) -> bool {
        let (errors, rest) = r.split_at_mut(self.rows);
        let done =
            if self.horizon == 0 { self.run_whole(x, errors).is_some() } else { self.run_parts(x, errors) };
        for ((r, v), x) in rest.iter_mut().zip(&self.penalty).zip(x) {
            *r = v.sqrt() * x;
        }
        done && r.iter().all(|v| v.is_finite())
    }

    fn residual_jacobian(&mut self, x: &[f64], r: &mut [f64], jac: &mut [f64]) -> bool {
        // Only for callers that want the matrix after all; the search takes blocks, which leave out rows of no weight.
        let p = self.n();
        let fitted = self.weights.iter().flat_map(|w| &w.fit).map(|w| *w > 0.0);
        let rows: Vec<usize> = fitted.enumerate().filter_map(|(row, own)| own.then_some(row)).collect();
        let mut rows = rows.into_iter().chain(self.rows..);
        jac.fill(0.0);
        let finite = self.jacobian_blocks(x, &mut |_, block| {
            for (values, row) in block.chunks_exact(p).zip(&mut rows) {
                jac[row * p..(row + 1) * p].copy_from_slice(values);
            }
        });
        finite && self.residual(x, r)
    }

    fn by_blocks(&self) -> bool {
        true
    }

    fn jacobian_blocks(&mut self, x: &[f64], take: &mut dyn FnMut(&[f64], &[f64])) -> bool {
        let finite =
            if self.horizon == 1 { self.one_step_blocks(x, take) } else { self.free_run_blocks(x, take) };
        if !self.penalty.is_empty() {
            let p = self.penalty.len();
            let (mut r, mut jac) = (vec![0.0; p], vec![0.0; p * p]);
            for (k, v) in self.penalty.iter().enumerate() {
                r[k] = v.sqrt() * x[k];
                jac[k * p + k] = v.sqrt();
            }
            take(&r, &jac);
        }
        finite
    }
}

impl Block {
    fn clear(&mut self) {
        self.r.clear();
        self.jac.clear();
    }

    /// Adds rows, each times the root of its weight; rows of no weight are left out.
    fn add(&mut self, y: &[f64], measured: &[f64], weights: &[f64], s: &[f64]) {
        let p = s.len() / y.len().max(1);
        for (t, w) in weights.iter().enumerate().filter(|(_, w)| **w > 0.0) {
            let (root, row) = (w.sqrt(), &s[t * p..(t + 1) * p]);
            self.r.push(root * (y[t] - measured[t]));
            if root == 1.0 {
                self.jac.extend_from_slice(row);
            } else {
                self.jac.extend(row.iter().map(|v| root * v));
            }
        }
    }

    fn is_finite(&self) -> bool {
        self.r.iter().all(|v| v.is_finite())
    }

    fn hand_over(&self, take: &mut dyn FnMut(&[f64], &[f64])) {
        if !self.r.is_empty() {
            take(&self.r, &self.jac);
        }
    }
}

fn fill_errors(y: &[f64], measured: &[f64], weights: &[f64], errors: &mut [f64]) {
    for (((r, y), z), w) in errors.iter_mut().zip(y).zip(measured).zip(weights) {
        // A missing value has no weight.
        *r = if *w > 0.0 { w.sqrt() * (y - z) } else { 0.0 };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::train::division::{Division, Shares, divide};
    use crate::model::neural::NeuralNarx;
    use dynocal_numerics::rng::Rng64;

    /// Over whole records, one step, and subrecords that do not divide the record; with weights, rows that are not
    /// fitted, a missing value (whole records), several blocks and a penalty.
    #[test]
    fn blocks_are_the_derivatives_of_the_errors() {
        let mut rng = Rng64::new(3);
        let mut record = |n: usize| Experiment {
            name: "record".into(),
            u: (0..n).map(|_| rng.uniform_in(-1.0, 1.0)).collect(),
            y: (0..n).map(|_| rng.uniform_in(-1.0, 1.0)).collect(),
            init_samples: 4,
            weights: (0..n).map(|_| rng.uniform_in(0.5, 2.0)).collect(),
        };
        let complete = [record(300), record(41)];
        let mut gapped = complete.clone();
        gapped[0].y[200] = f64::NAN;
        let net = NeuralNarx::new(&["u"], "y", 2, 2, 2).unwrap();
        let shares = Shares { division: Division::Random, selection: 0.2, test: 0.1, block: 1, seed: 1 };
        let x = net.random_start(&mut Rng64::new(7));
        let p = x.len();
        // Only the whole free run does not read what was measured later on.
        for (horizon, data) in [(0, &gapped), (1, &complete), (7, &complete)] {
            let weights = divide(&net, data, &shares);
            let mut task = Task::new(&net, data, &weights);
            task.horizon = horizon;
            task.penalty = vec![0.3; p];
            let m = task.residuals();
            let (mut r, mut jac, mut up, mut down) =
                (vec![0.0; m], vec![0.0; m * p], vec![0.0; m], vec![0.0; m]);
            assert!(task.residual_jacobian(&x, &mut r, &mut jac));
            let mut by_blocks = 0.0;
            task.jacobian_blocks(&x, &mut |r, _| by_blocks += r.iter().map(|v| v * v).sum::<f64>());
            assert!((by_blocks / task.cost(&x) - 1.0).abs() < 1e-13);
            for k in 0..p {
                let moved =
                    |h: f64| x.iter().enumerate().map(|(i, v)| if i == k { v + h } else { *v }).collect();
                let (plus, minus): (Vec<f64>, Vec<f64>) = (moved(1e-6), moved(-1e-6));
                assert!(task.residual(&plus, &mut up) && task.residual(&minus, &mut down));
                for i in 0..m {
                    let difference = (up[i] - down[i]) / 2e-6;
                    assert!(
                        (jac[i * p + k] - difference).abs() < 1e-7,
                        "horizon {horizon} row {i} parameter {k}"
                    );
                }
            }
        }
    }
}
