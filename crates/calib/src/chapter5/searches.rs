//! The simulation error made small by the methods of Table 5.1, each from the least-squares estimate.

use dynocal_ident::estimate::Estimator;
use dynocal_ident::estimate::ols::Ols;
use dynocal_ident::estimate::sem::Sem;
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::Model;
use dynocal_ident::validate::{Kind, output};
use dynocal_numerics::optim::{Bounds, Budget, Objective, optimiser};
use dynocal_numerics::status::Status;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{Chapter5Error, Fitness};

/// A method of Table 5.1, or ours.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// Least squares on the one-step error, simulated: no search.
    LeastSquares,
    /// Pattern search (mesh adaptive).
    PatternSearch,
    /// Line searches along quasi-Newton directions with the exact gradient (L-BFGS-B).
    LineSearch,
    /// Nelder-Mead simplex.
    NelderMead,
    /// Levenberg-Marquardt with exact sensitivities: our simulation-error estimator.
    LevenbergMarquardt,
}

impl Method {
    /// Name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::LeastSquares => "least squares, simulated (PEM)",
            Self::PatternSearch => "pattern search",
            Self::LineSearch => "line search",
            Self::NelderMead => "Nelder-Mead",
            Self::LevenbergMarquardt => "Levenberg-Marquardt (SEM)",
        }
    }
}

/// What a method found.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Found {
    /// Method.
    pub method: Method,
    /// Parameters.
    pub theta: Vec<f64>,
    /// Evaluations of the cost (a gradient counts with its value); 1 for least squares.
    pub evaluations: usize,
    /// How it ended.
    pub status: Status,
    /// Cost and evaluations along the way.
    pub history: Vec<(usize, f64)>,
}

/// Runs `method` on the simulation error of `model` over `record` with at most `evaluations` of the cost.
///
/// # Errors
/// [`Chapter5Error::Estimate`]: no least-squares start.
pub fn search(
    method: Method,
    model: &dyn Model,
    record: &Experiment,
    evaluations: usize,
    interrupt: &dyn Fn() -> bool,
) -> Result<Found, Chapter5Error> {
    let data = std::slice::from_ref(record);
    let start = Ols::default().estimate(model, data, None, interrupt)?;
    let by_table = match method {
        Method::LeastSquares => {
            let (theta, status) = (start.theta, start.status);
            return Ok(Found { method, theta, evaluations: 1, status, history: Vec::new() });
        }
        Method::LevenbergMarquardt => {
            let options = Sem { max_evaluations: evaluations, ..Sem::default() };
            let fit = options.estimate(model, data, None, interrupt)?;
            let n = fit.samples as f64;
            let history = fit.history.iter().map(|i| (i.evaluations, i.objective / n)).collect();
            let (theta, status, evaluations) = (fit.theta, fit.status, fit.evaluations);
            return Ok(Found { method, theta, evaluations, status, history });
        }
        Method::PatternSearch => "pattern_search",
        Method::LineSearch => "lbfgsb",
        Method::NelderMead => "nelder_mead",
    };
    let mut cost = Cost::new(model, record, &start.theta, interrupt);
    let free = Bounds {
        lower: vec![f64::NEG_INFINITY; start.theta.len()],
        upper: vec![f64::INFINITY; start.theta.len()],
    };
    let budget = Budget { evaluations, gradient_tolerance: 1e-8, value_tolerance: 1e-15 };
    let ones = vec![1.0; start.theta.len()];
    let found = optimiser(by_table, &toml::Table::new())?.minimise(&mut cost, &free, &ones, &budget);
    let theta = cost.parameters(&found.x);
    let status = if interrupt() { Status::Interrupted } else { found.status };
    let history = found.history.iter().map(|i| (i.evaluations, i.objective)).collect();
    Ok(Found { method, theta, evaluations: cost.evaluations, status, history })
}

/// Mean squared simulation error in parameters relative to their least-squares values: raw parameters differ by 1e4.
struct Cost<'a> {
    model: &'a dyn Model,
    record: &'a Experiment,
    scale: Vec<f64>,
    theta: Vec<f64>,
    y: Vec<f64>,
    s: Vec<f64>,
    evaluations: usize,
    interrupt: &'a dyn Fn() -> bool,
}

impl<'a> Cost<'a> {
    fn new(
        model: &'a dyn Model,
        record: &'a Experiment,
        start: &[f64],
        interrupt: &'a dyn Fn() -> bool,
    ) -> Self {
        let p = start.len();
        Self {
            model,
            record,
            scale: start.iter().map(|v| if *v == 0.0 { 1.0 } else { *v }).collect(),
            theta: vec![0.0; p],
            y: vec![0.0; record.len()],
            s: vec![0.0; record.len() * p],
            evaluations: 0,
            interrupt,
        }
    }

    fn parameters(&self, x: &[f64]) -> Vec<f64> {
        x.iter().zip(&self.scale).map(|(x, s)| x * s).collect()
    }
}

impl Objective for Cost<'_> {
    fn n(&self) -> usize {
        self.scale.len()
    }

    fn value_gradient(&mut self, x: &[f64], grad: &mut [f64]) -> f64 {
        // Past an interruption every trial is a bad one: the search ends where it is.
        if (self.interrupt)() {
            return f64::INFINITY;
        }
        self.evaluations += 1;
        for ((t, x), s) in self.theta.iter_mut().zip(x).zip(&self.scale) {
            *t = x * s;
        }
        let run = self.record.run(self.model);
        let (first, n, p) = (run.start, run.len(), self.scale.len());
        let status = if grad.is_empty() {
            self.model.simulate(&self.theta, &run, &mut self.y)
        } else {
            self.model.sensitivities(&self.theta, &run, &mut self.y, &mut self.s)
        };
        if status != Status::Converged {
            return f64::INFINITY;
        }
        grad.fill(0.0);
        let scored = (n - first) as f64;
        let mut sum = 0.0;
        for t in first..n {
            let e = self.y[t] - run.y[t];
            sum += e * e;
            for (k, g) in grad.iter_mut().enumerate() {
                *g += 2.0 * e * self.s[t * p + k] * self.scale[k] / scored;
            }
        }
        sum / scored
    }
}

/// A method with the scores of what it found.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Compared {
    /// What it found.
    pub found: Found,
    /// One-step error on the identification record.
    pub one_step: Fitness,
    /// Free-run error on the identification record.
    pub free_run: Fitness,
    /// Mean free-run error over unseen records, as Table 5.2.
    pub unseen: Fitness,
    /// Its free run over the identification record.
    #[serde(deserialize_with = "dynocal_ident::nullable::numbers")]
    pub trace: Vec<f64>,
}

/// Every method of `rows` on the same record, scored on the same unseen records (in parallel; order of `rows`).
///
/// # Errors
/// As [`search`]; [`Chapter5Error::Interrupted`].
pub fn compare(
    rows: &[(Method, usize)],
    model: &dyn Model,
    record: &Experiment,
    unseen: &[Experiment],
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Result<Vec<Compared>, Chapter5Error> {
    let one = |&(method, evaluations): &(Method, usize)| -> Result<Compared, Chapter5Error> {
        let found = search(method, model, record, evaluations, &|| interrupt())?;
        if interrupt() {
            return Err(Chapter5Error::Interrupted);
        }
        Ok(Compared {
            one_step: Fitness::of(model, &found.theta, record, Kind::OneStep),
            free_run: Fitness::of(model, &found.theta, record, Kind::FreeRun),
            unseen: Fitness::mean_over(model, &found.theta, unseen, Kind::FreeRun),
            trace: output(model, &found.theta, record, Kind::FreeRun),
            found,
        })
    };
    rows.par_iter().map(one).collect::<Vec<_>>().into_iter().collect()
}
