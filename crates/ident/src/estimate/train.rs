//! Training of networks in free run: Levenberg-Marquardt from several random starts, early stopping.
//!
//! ```text
//! theta = argmin sum_t w(t) (y(t) - yhat(t; theta))^2 + penalty S |theta|^2 / p,   yhat the free run,
//! S = sum_t w(t) (y(t) - mean y)^2
//! ```
//!
//! Every point that a search moves to is also scored on selection records that it does not fit; the search ends when
//! that score has not improved for `patience` moves, and the best point of all starts is the one that scores best
//! there. Starts run in parallel; each has its own random stream, so that the result does not depend on the number of
//! threads.
//!
//! Any other model trains alike: its first start is least squares, the others lie around it.
//!
//! Reference: L. Prechelt, Early stopping - but when?, LNCS 1524 (1998); thesis section 7.2.2.

use std::cell::RefCell;
use std::num::NonZeroUsize;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

use dynocal_numerics::lm::{LeastSquares, LmOptions, LmOutcome, levenberg_marquardt_interruptible};
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::status::Status;
use serde::Deserialize;

use super::sem::{SimulationError, further_start, least_squares_start, spread};
use super::{EstimateError, Estimator, Fit};
use crate::experiment::{Experiment, usable_samples};
use crate::model::Model;

/// Options of training.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Train {
    /// Number of starts.
    pub starts: usize,
    /// Most cost evaluations per start.
    pub max_evaluations: usize,
    /// Share of each record, at its end, that selects instead of being fitted (when no selection records are given).
    pub selection: f64,
    /// Moves without a better selection score after which a search ends.
    pub patience: usize,
    /// Weight on the squared parameters, relative to the spread of the output.
    pub penalty: f64,
    /// Relative spread of the further starts of a model that has no random ones.
    pub spread: f64,
    /// Seed of the starts.
    pub seed: u64,
}

impl Default for Train {
    fn default() -> Self {
        Self {
            starts: 8,
            max_evaluations: 120,
            selection: 0.15,
            patience: 15,
            penalty: 0.0,
            spread: 0.1,
            seed: 0,
        }
    }
}

/// A trained model with the score of every start.
#[derive(Clone, Debug)]
pub struct Training {
    /// The best start's estimate.
    pub fit: Fit,
    /// Mean squared free-run error on the selection records, one per start; of the fitted ones where there are none.
    pub scores: Vec<f64>,
    /// Index of the best start.
    pub best: usize,
}

impl Estimator for Train {
    fn estimate(
        &self,
        model: &dyn Model,
        data: &[Experiment],
        start: Option<&[f64]>,
        interrupt: &dyn Fn() -> bool,
    ) -> Result<Fit, EstimateError> {
        let (fitted, selecting) = split(model, data, self.selection);
        Ok(self.train(model, &fitted, &selecting, start, interrupt)?.fit)
    }
}

impl Train {
    /// Fits `data`, selects on `selection` (other records; when empty, the fitted ones decide). `start` (p) replaces the
    /// first start.
    ///
    /// # Errors
    /// [`EstimateError`]: records that do not fit the model, or a first start that diverges.
    pub fn train(
        &self,
        model: &dyn Model,
        data: &[Experiment],
        selection: &[Experiment],
        start: Option<&[f64]>,
        interrupt: &dyn Fn() -> bool,
    ) -> Result<Training, EstimateError> {
        let samples = usable_samples(model, data)?;
        let starts = self.all_starts(model, data, samples, start)?;
        let (stop, next) = (AtomicBool::new(false), AtomicUsize::new(0));
        let results: Vec<Mutex<Option<Search>>> = starts.iter().map(|_| Mutex::new(None)).collect();
        let workers = std::thread::available_parallelism().map_or(1, NonZeroUsize::get).min(starts.len());
        std::thread::scope(|scope| {
            let work = || loop {
                let i = next.fetch_add(1, Ordering::Relaxed);
                let Some(x0) = starts.get(i) else { break };
                let found = self.search(model, data, selection, samples, x0, &stop);
                if let Ok(mut place) = results[i].lock() {
                    *place = Some(found);
                }
            };
            let threads: Vec<_> = (0..workers).map(|_| scope.spawn(work)).collect();
            // The caller's question may not be shared between threads: it is asked here.
            while threads.iter().any(|t| !t.is_finished()) {
                if interrupt() {
                    stop.store(true, Ordering::Relaxed);
                }
                std::thread::park_timeout(Duration::from_millis(5));
            }
        });
        let results: Vec<Search> =
            results.into_iter().filter_map(|r| r.into_inner().ok().flatten()).collect();
        self.best_of(model, data, samples, results, &starts)
    }

    fn all_starts(
        &self,
        model: &dyn Model,
        data: &[Experiment],
        samples: usize,
        start: Option<&[f64]>,
    ) -> Result<Vec<Vec<f64>>, EstimateError> {
        let first = match start {
            Some(theta) if theta.len() != model.n_params() => {
                return Err(EstimateError::Start { found: theta.len(), expected: model.n_params() });
            }
            Some(theta) => theta.to_vec(),
            None => match model.random_start(&mut Rng64::stream(self.seed, 0)) {
                Some(theta) => theta,
                None => {
                    let mut problem = SimulationError::new(model, data, 0.0, samples);
                    least_squares_start(model, data, samples, 0.0, &mut problem, &mut Vec::new())?
                }
            },
        };
        let further = (1..self.starts.max(1)).map(|i| {
            let mut rng = Rng64::stream(self.seed, i as u64);
            further_start(model, &first, self.spread, &mut rng)
        });
        Ok(std::iter::once(first.clone()).chain(further).collect())
    }

    /// One start.
    fn search(
        &self,
        model: &dyn Model,
        data: &[Experiment],
        selection: &[Experiment],
        samples: usize,
        x0: &[f64],
        stop: &AtomicBool,
    ) -> Search {
        let mut inner = SimulationError::new(model, data, 0.0, samples);
        self.penalise(model, data, &mut inner);
        let selection = (!selection.is_empty()).then(|| SimulationError::new(model, selection, 0.0, 0));
        let watch = RefCell::new(Watch { theta: x0.to_vec(), score: f64::INFINITY, moves: 0, best_move: 0 });
        let mut problem = Watched { inner, selection, watch: &watch };
        let options = LmOptions {
            max_evaluations: self.max_evaluations,
            cost_tolerance: 1e-12,
            ..LmOptions::default()
        };
        let exhausted = || {
            let w = watch.borrow();
            w.moves - w.best_move > self.patience
        };
        let stopped = || stop.load(Ordering::Relaxed);
        let mut outcome =
            levenberg_marquardt_interruptible(&mut problem, x0, &options, &|| stopped() || exhausted());
        if outcome.status == Status::Interrupted && !stopped() {
            // Early stopping is the stated end, not a disturbance.
            outcome.status = Status::Converged;
        }
        drop(problem);
        let watch = watch.into_inner();
        outcome.x = watch.theta;
        Search { outcome, score: watch.score }
    }

    fn penalise(&self, model: &dyn Model, data: &[Experiment], problem: &mut SimulationError) {
        if self.penalty > 0.0 {
            let p = model.n_params();
            problem.ridge = vec![(self.penalty * spread(model, data) / p as f64).sqrt(); p];
        }
    }

    fn best_of(
        &self,
        model: &dyn Model,
        data: &[Experiment],
        samples: usize,
        results: Vec<Search>,
        starts: &[Vec<f64>],
    ) -> Result<Training, EstimateError> {
        let mut problem = SimulationError::new(model, data, 0.0, samples);
        self.penalise(model, data, &mut problem);
        let scores: Vec<f64> = results.iter().map(|r| r.score).collect();
        let evaluations = results.iter().map(|r| r.outcome.evaluations).sum();
        let best = (0..scores.len()).min_by(|a, b| scores[*a].total_cmp(&scores[*b]));
        let Some(best) = best.filter(|b| scores[*b].is_finite()) else {
            return Err(problem.unstable(&starts[0]));
        };
        let Some(found) = results.into_iter().nth(best) else { return Err(problem.unstable(&starts[0])) };
        let mut fit = problem.report(found.outcome, samples, Vec::new())?;
        fit.estimator = "train".into();
        fit.evaluations = evaluations;
        Ok(Training { fit, scores, best })
    }
}

/// What one start found: `x` of the outcome is the point with the best selection score.
struct Search {
    outcome: LmOutcome,
    score: f64,
}

/// The best point so far on the selection records.
struct Watch {
    theta: Vec<f64>,
    score: f64,
    moves: usize,
    best_move: usize,
}

/// The fit's residuals, watched: every point the search moves to is scored on the selection records.
struct Watched<'a> {
    inner: SimulationError<'a>,
    selection: Option<SimulationError<'a>>,
    watch: &'a RefCell<Watch>,
}

impl LeastSquares for Watched<'_> {
    fn n(&self) -> usize {
        self.inner.n()
    }

    fn residuals(&self) -> usize {
        self.inner.residuals()
    }

    fn residual(&mut self, x: &[f64], r: &mut [f64]) -> bool {
        self.inner.residual(x, r)
    }

    fn residual_jacobian(&mut self, x: &[f64], r: &mut [f64], jac: &mut [f64]) -> bool {
        if !self.inner.residual_jacobian(x, r, jac) {
            return false;
        }
        let score = match &mut self.selection {
            Some(s) => s.mean_square(x),
            None => self.inner.mean_square(x),
        };
        let mut w = self.watch.borrow_mut();
        w.moves += 1;
        if score < w.score {
            w.score = score;
            w.best_move = w.moves;
            w.theta.copy_from_slice(x);
        }
        true
    }
}

/// Cuts the last `share` off each record. The tail begins with the samples that initialise it, so that none is scored in
/// both parts; a record too short for that is fitted whole.
fn split(model: &dyn Model, data: &[Experiment], share: f64) -> (Vec<Experiment>, Vec<Experiment>) {
    let (m, lag) = (model.n_inputs(), model.max_lag());
    let (mut fitted, mut selecting) = (Vec::new(), Vec::new());
    for e in data {
        let tail = (share.clamp(0.0, 0.9) * e.len() as f64).round() as usize;
        let cut = e.len() - tail;
        let part = |from: usize, to: usize, init: usize| Experiment {
            name: e.name.clone(),
            u: e.u[from * m..to * m].to_vec(),
            y: e.y[from..to].to_vec(),
            init_samples: init,
            weights: if e.weights.is_empty() { Vec::new() } else { e.weights[from..to].to_vec() },
        };
        if tail <= lag || cut <= e.first(model) + model.n_params() {
            fitted.push(e.clone());
            continue;
        }
        fitted.push(part(0, cut, e.init_samples));
        selecting.push(part(cut, e.len(), lag));
    }
    (fitted, selecting)
}
