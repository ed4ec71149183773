//! Searches at equal budgets, thesis section 4.7.3 with Figures 4.12 to 4.15.

use std::sync::{Mutex, PoisonError};

use dynocal_design::search::{DesignOptions, design, random_record};
use dynocal_numerics::status::{Iterate, Status};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::source::{DesignCriterion, problem, term};
use super::statistics::median;
use super::{Chapter4Error, Output, Setting};

/// The thesis' six, ours, and its parts.
pub const SEARCHES: [&str; 9] = [
    "trust_region",
    "sqp",
    "interior_point",
    "pattern_search",
    "genetic",
    "annealing",
    "compass",
    "local",
    "kicks",
];

/// Points that a curve keeps at most.
const MOST_POINTS: usize = 300;

/// One search from one start.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Path {
    /// Evaluations and best objective so far.
    pub best: Vec<(usize, f64)>,
    /// Evaluations, objective and what else the search tells: mesh (pattern search, compass), temperature with the mean
    /// of the trials at it (annealing), number of the generation with its mean (genetic). Empty for the others.
    pub told: Vec<(usize, f64, f64)>,
    /// Objective at the start.
    pub start: f64,
    /// Objective at the end.
    pub end: f64,
    /// Evaluations used, with or without gradient.
    pub evaluations: usize,
    /// Whether it ended before the budget by its own rule.
    pub converged: bool,
}

/// A search from several starts.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Convergence {
    /// Search.
    pub search: String,
    /// Criterion.
    pub criterion: DesignCriterion,
    /// Evaluations allowed.
    pub budget: usize,
    /// One path per start.
    pub paths: Vec<Path>,
}

impl Convergence {
    /// Median objective at the end.
    pub fn median_end(&self) -> Option<f64> {
        median(&self.paths.iter().map(|p| p.end).collect::<Vec<f64>>())
    }

    /// Median of the best objective after at most `evaluations`.
    pub fn median_after(&self, evaluations: usize) -> Option<f64> {
        let at = |p: &Path| p.best.iter().take_while(|b| b.0 <= evaluations).last().map_or(p.start, |b| b.1);
        median(&self.paths.iter().map(at).collect::<Vec<f64>>())
    }

    /// Median number of evaluations used.
    pub fn median_evaluations(&self) -> Option<f64> {
        median(&self.paths.iter().map(|p| p.evaluations as f64).collect::<Vec<f64>>())
    }
}

/// Runs one search from `starts` uniform random records, the same for every search.
///
/// # Errors
/// [`Chapter4Error`].
///
/// ```
/// use dynocal_studies::chapter4::work::convergence::converge;
/// use dynocal_studies::chapter4::work::{Setting, source::DesignCriterion};
/// let found = converge(&Setting::new()?, "sqp", DesignCriterion::A, 200, 1, 1, &|| false)?;
/// let path = &found.paths[0];
/// assert!(path.evaluations <= 200 && path.end < 0.2 * path.start);
/// # Ok::<(), dynocal_studies::chapter4::work::Chapter4Error>(())
/// ```
pub fn converge(
    setting: &Setting,
    search: &str,
    criterion: DesignCriterion,
    budget: usize,
    starts: usize,
    seed: u64,
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Result<Convergence, Chapter4Error> {
    let built = criterion.build()?;
    let one = |k: usize| -> Result<Path, Chapter4Error> {
        let problem = problem(setting, vec![term(setting, Output::Torque, built.as_ref(), 1.0, &setting.u0)]);
        let seed = seed.wrapping_add(k as u64);
        let options = DesignOptions {
            search: search.into(),
            evaluations: budget,
            seed,
            start: Some(random_record(&problem, seed)?),
            ..DesignOptions::default()
        };
        let lines: Mutex<Vec<Iterate>> = Mutex::default();
        let listen = |line: &Iterate| lines.lock().unwrap_or_else(PoisonError::into_inner).push(*line);
        let found = design(&problem, &options, interrupt, &listen)?;
        if found.status == Status::Interrupted {
            return Err(Chapter4Error::Interrupted);
        }
        let lines = lines.into_inner().unwrap_or_else(PoisonError::into_inner);
        let tells = matches!(search, "pattern_search" | "genetic" | "annealing");
        let told = lines.iter().filter(|l| tells && l.optimality.is_finite() && l.objective.is_finite());
        let told: Vec<_> = told.map(|l| (l.evaluations, l.objective, l.optimality)).collect();
        let best: Vec<_> = found.history.iter().map(|l| (l.evaluations, l.objective)).collect();
        Ok(Path {
            best: thinned(&best),
            told: thinned(&told),
            start: found.start_value,
            end: found.value,
            evaluations: found.evaluations,
            converged: found.status == Status::Converged,
        })
    };
    let paths = (0..starts).into_par_iter().map(one).collect::<Result<Vec<Path>, _>>()?;
    Ok(Convergence { search: search.into(), criterion, budget, paths })
}

/// Every k-th point, and the last.
fn thinned<T: Copy>(points: &[T]) -> Vec<T> {
    let step = points.len().div_ceil(MOST_POINTS).max(1);
    let mut kept: Vec<T> = points.iter().copied().step_by(step).collect();
    if let (Some(last), true) = (points.last(), points.len() % step != 1 && step > 1) {
        kept.push(*last);
    }
    kept
}
