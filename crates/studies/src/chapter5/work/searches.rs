//! The simulation error made small by the methods of Table 5.1, each from the least-squares estimate.

use dynocal_ident::estimate::Estimator;
use dynocal_ident::estimate::ols::Ols;
use dynocal_ident::estimate::search::SearchMethod;
use dynocal_ident::estimate::sem::Sem;
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::Model;
use dynocal_ident::validate::{Kind, output};
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
    /// Line searches along quasi-Newton directions with the exact gradient.
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
    let search = match method {
        Method::LeastSquares => {
            let start = Ols::default().estimate(model, data, None, interrupt)?;
            let (theta, status) = (start.theta, start.status);
            return Ok(Found { method, theta, evaluations: 1, status, history: Vec::new() });
        }
        Method::PatternSearch => "pattern_search",
        Method::LineSearch => "line_search",
        Method::NelderMead => "nelder_mead",
        Method::LevenbergMarquardt => "lm",
    };
    let search = SearchMethod::named(search).map_err(Chapter5Error::Method)?;
    let options = Sem { search, max_evaluations: evaluations, ..Sem::default() };
    let fit = options.estimate(model, data, None, interrupt)?;
    let n = fit.samples as f64;
    let history = fit.history.iter().map(|i| (i.evaluations, i.objective / n)).collect();
    Ok(Found { method, theta: fit.theta, evaluations: fit.evaluations, status: fit.status, history })
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
