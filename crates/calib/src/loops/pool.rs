//! Designs for several structures at once, because the right one is not known before the test.
//!
//! The efficiency of a record u for structure i is what it tells of the best that a record of equal length could:
//! `J_i* / J_i(u)` for criteria that are variances, `exp((J_i* - J_i(u)) / p_i)` for D. A design for the pool minimises
//! the weighted mean of the inverse efficiencies (for D: of minus their logarithms), a sum of the criteria of one
//! design problem.
//!
//! ```
//! use dynocal_calib::loops::pool::Pool;
//! use dynocal_design::channel::Channel;
//! use dynocal_design::criterion::criterion;
//! use dynocal_design::problem::{Convention, DesignProblem, Term};
//! use dynocal_design::search::DesignOptions;
//! use dynocal_ident::model::poly::PolyNarx;
//!
//! // A line and a parabola: two levels are best for the one and useless for the other.
//! let line = PolyNarx::parse(&["u"], "y", &["1", "u(t-1)"])?;
//! let parabola = PolyNarx::parse(&["u"], "y", &["1", "u(t-1)", "u(t-1)^2"])?;
//! let d = criterion("d", &Default::default())?;
//! let (two, three) = ([0.0; 2], [0.0; 3]);
//! let problem = DesignProblem {
//!     channels: vec![Channel::free("u", -1.0, 1.0)],
//!     n_samples: 31,
//!     convention: Convention::Trim,
//!     start: 1,
//!     terms: vec![Term::new("line", &line, &two, 1.0, d.as_ref()), Term::new("parabola", &parabola, &three, 1.0, d.as_ref())],
//! };
//! let options = DesignOptions { evaluations: 400, ..DesignOptions::default() };
//! let pool = Pool::new(&problem, &options, &|| false)?;
//! let both = pool.design(&problem, &options, &|| false)?;
//! let [alone, together] = [&pool.alone[0], &both.u].map(|u| pool.efficiencies(&problem, u));
//! assert!(alone?[1] < 0.01 && together?.iter().all(|e| *e > 0.8));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use dynocal_design::problem::{DesignProblem, Evaluator, Term};
use dynocal_design::search::{DesignOptions, DesignOutcome, design};

use super::LoopError;

/// A pool of structures with the best record of each.
#[derive(Clone, Debug)]
pub struct Pool {
    /// Best value of each structure's criterion that its own design found.
    pub best: Vec<f64>,
    /// These designs (N x m each).
    pub alone: Vec<Vec<f64>>,
}

impl Pool {
    /// Designs for each term of `problem` alone.
    ///
    /// # Errors
    /// [`LoopError`] of a wrong problem or a failed design.
    pub fn new(
        problem: &DesignProblem,
        options: &DesignOptions,
        interrupt: &(dyn Fn() -> bool + Sync),
    ) -> Result<Self, LoopError> {
        let mut pool = Self { best: Vec::new(), alone: Vec::new() };
        for term in &problem.terms {
            let found = design(&of(problem, term, 1.0), options, interrupt, &|_| {})?;
            if interrupt() {
                return Err(LoopError::Interrupted);
            }
            pool.best.push(found.value);
            pool.alone.push(found.u);
        }
        Ok(pool)
    }

    /// Efficiency of the record `u` for every structure; 0 where its information is singular.
    ///
    /// # Errors
    /// [`LoopError::Problem`] for a wrong problem.
    pub fn efficiencies(&self, problem: &DesignProblem, u: &[f64]) -> Result<Vec<f64>, LoopError> {
        let one = |(term, best): (&Term, &f64)| -> Result<f64, LoopError> {
            let value = Evaluator::new(&of(problem, term, 1.0))?.value(u);
            Ok(match term.criterion {
                _ if !value.is_finite() => 0.0,
                Some(c) if !c.is_positive() => ((best - value) / term.model.n_params() as f64).exp(),
                _ => best / value,
            })
        };
        problem.terms.iter().zip(&self.best).map(one).collect()
    }

    /// A record for the whole pool; the terms' weights say how much each structure counts.
    ///
    /// # Errors
    /// [`LoopError`] of a wrong problem or a failed design.
    pub fn design(
        &self,
        problem: &DesignProblem,
        options: &DesignOptions,
        interrupt: &(dyn Fn() -> bool + Sync),
    ) -> Result<DesignOutcome, LoopError> {
        let mut together = problem.clone();
        for (term, best) in together.terms.iter_mut().zip(&self.best) {
            let scale = match term.criterion {
                Some(c) if !c.is_positive() => term.model.n_params() as f64,
                _ => *best,
            };
            term.weight /= scale;
        }
        let found = design(&together, options, interrupt, &|_| {})?;
        if interrupt() { Err(LoopError::Interrupted) } else { Ok(found) }
    }
}

/// The problem of one term alone.
fn of<'a>(problem: &DesignProblem<'a>, term: &Term<'a>, weight: f64) -> DesignProblem<'a> {
    DesignProblem { terms: vec![Term { weight, ..*term }], ..problem.clone() }
}
