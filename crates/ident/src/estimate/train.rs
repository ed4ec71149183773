//! Training of networks in free run: Levenberg-Marquardt from several starts, early stopping.
//!
//! ```text
//! theta = argmin sum_t w(t) (y(t) - yhat(t; theta))^2 + penalty S |theta|^2 / p,   yhat the free run,
//! S = sum_t w(t) (y(t) - mean y)^2
//! ```
//!
//! The penalty leaves out the parameters of a linear path. Some samples are kept from the fit: those for selection and,
//! where asked, for a test. Every point that a search moves to is scored by its free run on the selection samples; the
//! search ends when that score has not improved for `patience` moves, and the best point of all starts is the one that
//! scores best there. Stages with subrecords of growing length may go before the whole free run: a start that would
//! diverge over the whole record is first brought near the data. Starts run in parallel; each has its own random
//! stream, so that the result does not depend on the number of threads. The Jacobian is never stored whole.
//!
//! Any other model trains alike: its first start is least squares, the others lie around it.
//!
//! Reference: L. Prechelt, Early stopping - but when?, LNCS 1524 (1998); A. H. Ribeiro, L. A. Aguirre, Parallel training
//! considered harmful?, Neurocomputing 316 (2018), for one-step against free run; thesis section 7.2.2.

mod division;
mod ensemble;
mod mean;
mod problem;
mod report;
mod sizes;
mod spec;
mod starts;

use std::cell::RefCell;
use std::num::NonZeroUsize;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

use dynocal_numerics::lm::{LeastSquares, LmOptions, LmOutcome, levenberg_marquardt_interruptible};
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::status::Status;
use serde::Deserialize;

pub use division::Division;
pub use ensemble::{bagged, best, mean_free_run};
pub use sizes::{BuildSize, SizeScore, layer_sizes};
pub(super) use spec::ROW;
use starts::Given;
pub use starts::Start;

use super::initial::{Initial, started};
use super::{EstimateError, Estimator, Fit, narx};
use crate::experiment::Experiment;
use crate::model::Model;
use crate::model::form::Form;
use crate::model::usable_samples;
use division::{Shares, Weights, divide, whole};
use problem::{Scores, Task};

/// Options of training.
#[derive(Clone, Debug, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Train {
    /// Number of starts.
    pub starts: usize,
    /// Number of the best starts whose free runs are averaged; 1: the best one alone.
    pub mean: usize,
    /// What the starts are.
    pub start: Start,
    /// Most cost evaluations per start over the whole records.
    pub max_evaluations: usize,
    /// Lengths in samples of the subrecords of the stages before, e.g. `[1, 20, 200]`; 1 is one-step prediction.
    pub horizons: Vec<usize>,
    /// Most cost evaluations of each of these stages.
    pub stage_evaluations: usize,
    /// How samples are chosen for selection and test (when no selection records are given).
    pub division: Division,
    /// Share of the samples that selects instead of being fitted.
    pub selection: f64,
    /// Share of the samples that only tests.
    pub test: f64,
    /// Samples per block of [`Division::Blocks`].
    pub block: usize,
    /// Moves without a better selection score after which a search ends.
    pub patience: usize,
    /// Weight on the squared parameters, relative to the spread of the output.
    pub penalty: f64,
    /// Relative spread of the further starts of a model that has no random ones.
    pub spread: f64,
    /// Where the free runs start: from measured outputs, or at rest.
    pub initial: Initial,
    /// Seed of the starts and of the division.
    pub seed: u64,
}

impl Default for Train {
    fn default() -> Self {
        Self {
            starts: 12,
            mean: 1,
            start: Start::Random,
            max_evaluations: 120,
            horizons: Vec::new(),
            stage_evaluations: 30,
            division: Division::End,
            selection: 0.15,
            test: 0.0,
            block: 50,
            patience: 15,
            penalty: 0.0,
            spread: 0.1,
            initial: Initial::Measured,
            seed: 0,
        }
    }
}

/// A trained model with what every start found.
#[derive(Clone, Debug)]
pub struct Training {
    /// The best start's estimate.
    pub fit: Fit,
    /// Best parameters of every start.
    pub thetas: Vec<Vec<f64>>,
    /// Mean squared free-run error on the selection samples, one per start; on the fitted ones where there are none.
    pub scores: Vec<f64>,
    /// The same on the test samples; NaN where there are none.
    pub test_scores: Vec<f64>,
    /// Index of the best start.
    pub best: usize,
}

/// Where a start of the caller's stands among the others.
type Place<'a> = fn(Option<&'a [f64]>) -> Given<'a>;

impl Estimator for Train {
    fn estimate(
        &self,
        model: &dyn Form,
        data: &[Experiment],
        start: Option<&[f64]>,
        interrupt: &dyn Fn() -> bool,
    ) -> Result<Fit, EstimateError> {
        self.fitted(model, data, &[], (start, Given::First), interrupt)
    }

    /// Early stopping watches `selecting` instead of samples divided off the records.
    fn estimate_selecting(
        &self,
        model: &dyn Form,
        data: &[Experiment],
        selecting: &[Experiment],
        start: Option<&[f64]>,
        interrupt: &dyn Fn() -> bool,
    ) -> Result<Fit, EstimateError> {
        self.fitted(model, data, selecting, (start, Given::Beside), interrupt)
    }
}

impl Train {
    /// Fits `data`. Where `selection` holds other records, these select and `data` are fitted whole; else `data` are
    /// divided. `start` (p) replaces the first start.
    ///
    /// # Errors
    /// [`EstimateError`]: records that do not fit the model, or no start whose free run stays finite.
    ///
    /// ```
    /// use dynocal_ident::estimate::train::{Division, Train};
    /// use dynocal_ident::experiment::Experiment;
    /// use dynocal_ident::model::neural::NeuralNarx;
    ///
    /// // y(t) = tanh(u(t-1)) + y(t-1)/2 on a slow sine
    /// let u: Vec<f64> = (0..400).map(|t| 2.0 * (0.1 * t as f64).sin() + (0.37 * t as f64).cos()).collect();
    /// let mut y = vec![0.0; 400];
    /// for t in 1..400 {
    ///     y[t] = u[t - 1].tanh() + 0.5 * y[t - 1];
    /// }
    /// let data = [Experiment { name: "sine".into(), u, y, init_samples: 0, weights: vec![] }];
    /// let net = NeuralNarx::new(&["u"], "y", 3, 1, 1)?.scaled_to(&data)?;
    /// let options = Train { starts: 2, division: Division::Blocks, test: 0.15, ..Train::default() };
    /// let found = options.train(&net, &data, &[], None, &|| false)?;
    /// assert!(found.scores[found.best] < 1e-4 && found.test_scores[found.best] < 1e-4);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn train(
        &self,
        model: &dyn Model,
        data: &[Experiment],
        selection: &[Experiment],
        start: Option<&[f64]>,
        interrupt: &dyn Fn() -> bool,
    ) -> Result<Training, EstimateError> {
        self.search_starts(model, data, selection, Given::First(start), interrupt)
    }

    /// The best start, or the mean of several.
    fn fitted<'a>(
        &self,
        form: &dyn Form,
        data: &[Experiment],
        selection: &[Experiment],
        (start, place): (Option<&'a [f64]>, Place<'a>),
        interrupt: &dyn Fn() -> bool,
    ) -> Result<Fit, EstimateError> {
        let model = narx("train", form)?;
        let network = mean::network(self, form)?;
        // An earlier mean starts the search with its best member, which stands first.
        let start = start.map(|s| if self.mean > 1 { &s[..s.len().min(model.n_params())] } else { s });
        let found = self.search_starts(model, data, selection, place(start), interrupt)?;
        match network {
            None => Ok(found.fit),
            Some(network) => mean::averaged(self, network, data, selection, found),
        }
    }

    fn search_starts(
        &self,
        model: &dyn Model,
        data: &[Experiment],
        selection: &[Experiment],
        given: Given,
        interrupt: &dyn Fn() -> bool,
    ) -> Result<Training, EstimateError> {
        let data = &*started("train", model, data, self.initial)?;
        let selection = &*started("train", model, selection, self.initial)?;
        let samples = usable_samples(model, data)?;
        let weights = if selection.is_empty() { self.divided(model, data) } else { whole(model, data) };
        let selecting = whole(model, selection);
        let job = Job { train: self, model, data, weights: &weights, selection, selecting: &selecting };
        let mut task = Task::new(model, data, &weights);
        let starts = starts::all(self, model, data, samples, &mut task, given)?;
        let results = self.run_all(&job, &starts, interrupt);
        report::training(&job, results, &starts)
    }

    /// Weights of the samples of each use; a record too short to be divided is fitted whole.
    fn divided(&self, model: &dyn Model, data: &[Experiment]) -> Vec<Weights> {
        let (selection, test) = (self.selection, self.test);
        let shares = Shares { division: self.division, selection, test, block: self.block, seed: self.seed };
        let weights = divide(model, data, &shares);
        let fitted: usize = weights.iter().map(|w| w.fit.iter().filter(|v| **v > 0.0).count()).sum();
        if fitted > model.n_params() { weights } else { whole(model, data) }
    }

    /// Every start on its own thread, as many at a time as there are processors.
    fn run_all(&self, job: &Job, starts: &[Vec<f64>], interrupt: &dyn Fn() -> bool) -> Vec<Search> {
        let (stop, next) = (AtomicBool::new(false), AtomicUsize::new(0));
        let results: Vec<Mutex<Option<Search>>> = starts.iter().map(|_| Mutex::new(None)).collect();
        let workers = std::thread::available_parallelism().map_or(1, NonZeroUsize::get).min(starts.len());
        std::thread::scope(|scope| {
            let work = || loop {
                let i = next.fetch_add(1, Ordering::Relaxed);
                let Some(x0) = starts.get(i) else { break };
                let found = job.search(x0, &stop);
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
        results.into_iter().filter_map(|r| r.into_inner().ok().flatten()).collect()
    }
}

/// What all starts share.
struct Job<'a> {
    train: &'a Train,
    model: &'a dyn Model,
    data: &'a [Experiment],
    weights: &'a [Weights],
    selection: &'a [Experiment],
    selecting: &'a [Weights],
}

/// What one start found: `x` of the outcome is the point with the best selection score.
struct Search {
    outcome: LmOutcome,
    score: f64,
    test: f64,
}

impl Job<'_> {
    fn task(&self) -> Task<'_> {
        let mut task = Task::new(self.model, self.data, self.weights);
        if self.train.penalty > 0.0 {
            let p = self.model.n_params();
            task.penalty = vec![self.train.penalty * self.spread() / p as f64; p];
            // Only the places matter: any stream does.
            let path = self.model.drawn().and_then(|d| d.linear_path(&mut Rng64::new(0)));
            path.iter().flat_map(|path| &path.places).for_each(|k| task.penalty[*k] = 0.0);
        }
        task
    }

    /// Weighted sum of squares of the fitted outputs about their mean.
    fn spread(&self) -> f64 {
        let fitted = || {
            let records = self.data.iter().zip(self.weights);
            records
                .flat_map(|(e, w)| e.y.iter().copied().zip(w.fit.iter().copied()))
                .filter(|(_, w)| *w > 0.0)
        };
        let total: f64 = fitted().map(|(_, w)| w).sum();
        let mean = fitted().map(|(y, w)| w * y).sum::<f64>() / total;
        fitted().map(|(y, w)| w * (y - mean).powi(2)).sum()
    }

    /// One start through all stages.
    fn search(&self, x0: &[f64], stop: &AtomicBool) -> Search {
        let watch = RefCell::new(Watch::new(x0));
        let selection =
            (!self.selection.is_empty()).then(|| Task::new(self.model, self.selection, self.selecting));
        let mut problem = Watched { inner: self.task(), selection, watch: &watch };
        let options =
            LmOptions { least_damping: LEAST_DAMPING, initial_radius: FIRST_RADIUS, ..LmOptions::default() };
        let stopped = || stop.load(Ordering::Relaxed);
        let one_step = (self.train.start == Start::OneStep).then_some(1);
        let mut x = x0.to_vec();
        for horizon in one_step.into_iter().chain(self.train.horizons.iter().copied()).filter(|h| *h > 0) {
            problem.inner.horizon = horizon;
            let options =
                LmOptions { max_evaluations: self.train.stage_evaluations, cost_tolerance: 1e-6, ..options };
            let found = levenberg_marquardt_interruptible(&mut problem, &x, &options, &stopped);
            if found.cost.is_finite() {
                x = found.x;
            }
        }
        problem.inner.horizon = 0;
        if !problem.inner.cost(&x).is_finite() {
            // A good subrecord fit may still diverge over the whole record; the best point so far does not.
            x.clone_from(&watch.borrow().theta);
        }
        watch.borrow_mut().begin();
        let options = LmOptions { max_evaluations: self.train.max_evaluations, ..options };
        let exhausted = || watch.borrow().is_exhausted(self.train.patience);
        let mut outcome =
            levenberg_marquardt_interruptible(&mut problem, &x, &options, &|| stopped() || exhausted());
        if outcome.status == Status::Interrupted && !stopped() {
            // Early stopping is the stated end, not a disturbance.
            outcome.status = Status::Converged;
        }
        drop(problem);
        let watch = watch.into_inner();
        outcome.x = watch.theta;
        Search { outcome, score: watch.score, test: watch.test }
    }
}

/// Damping of the training steps: weights need not be determined one by one, only the output counts.
const LEAST_DAMPING: f64 = 1e-12;

/// First step at most this part of the start's length: longer ones drive neurons of a raw start into saturation, from
/// where they return slowly.
const FIRST_RADIUS: f64 = 0.1;

/// The best point so far on the selection samples.
struct Watch {
    theta: Vec<f64>,
    score: f64,
    test: f64,
    moves: usize,
    best_move: usize,
}

impl Watch {
    fn new(x0: &[f64]) -> Self {
        Self { theta: x0.to_vec(), score: f64::INFINITY, test: f64::NAN, moves: 0, best_move: 0 }
    }

    /// The last stage begins: patience counts from here.
    fn begin(&mut self) {
        (self.moves, self.best_move) = (0, 0);
    }

    fn see(&mut self, x: &[f64], score: f64, test: f64) {
        self.moves += 1;
        if score < self.score {
            (self.score, self.test, self.best_move) = (score, test, self.moves);
            self.theta.copy_from_slice(x);
        }
    }

    fn is_exhausted(&self, patience: usize) -> bool {
        self.moves - self.best_move > patience
    }
}

/// The fit's errors, watched: every point the search moves to is scored on the selection samples.
struct Watched<'a> {
    inner: Task<'a>,
    selection: Option<Task<'a>>,
    watch: &'a RefCell<Watch>,
}

impl Watched<'_> {
    fn watch(&mut self, x: &[f64]) {
        let Scores { fit, selection, test } = self.inner.scores(x);
        let score = match &mut self.selection {
            Some(records) => records.scores(x).fit,
            None if selection.is_nan() => fit,
            None => selection,
        };
        self.watch.borrow_mut().see(x, score, test);
    }
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
        self.watch(x);
        self.inner.residual_jacobian(x, r, jac)
    }

    fn by_blocks(&self) -> bool {
        true
    }

    fn jacobian_blocks(&mut self, x: &[f64], take: &mut dyn FnMut(&[f64], &[f64])) -> bool {
        self.watch(x);
        self.inner.jacobian_blocks(x, take)
    }
}
