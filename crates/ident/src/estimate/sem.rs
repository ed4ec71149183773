//! Simulation-error estimation.
//!
//! ```text
//! theta = argmin sum_t w(t) rho(y(t) - yhat(t; theta)),   yhat the free run, rho the square or Huber's cost
//! ```
//!
//! (thesis section 5.2) by Levenberg-Marquardt with the exact recursive sensitivities dyhat/dtheta, or by another search
//! of [`super::search`]. Each free run starts from the measured outputs before its first scored sample. The start is the
//! least-squares estimate; when its free run is useless, the output terms are shrunk until one is found that is not.

use dynocal_numerics::lm::{LeastSquares, LmOutcome};
use dynocal_numerics::registry::{self, MemberDoc, ParamDoc};
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::status::Status;
use serde::Deserialize;

use super::cost::{Cost, CostKind, HUBER_THRESHOLD, fit_scale, outlier_note};
use super::covariance::CovarianceChoice;
use super::initial::{FreeStates, Initial, started};
use super::search::{Limits, SearchMethod, search};
use super::simulation::free_run_samples;
use super::table::{EstimatorRow, Fits, Gaps};
use super::{EstimateError, Estimator, Fit, narx};
use crate::experiment::Experiment;
use crate::model::Model;
use crate::model::form::Form;

/// Row of the table.
pub(super) const ROW: EstimatorRow = EstimatorRow {
    doc: MemberDoc {
        name: "sem",
        what: "simulation (free-run) error with exact recursive sensitivities, by Levenberg-Marquardt or another search",
        params: &[
            ParamDoc {
                name: "search",
                unit: "-",
                default: "\"lm\"",
                what: "lm, line_search, quasi_newton, lbfgsb, nelder_mead or pattern_search",
            },
            ParamDoc {
                name: "max_evaluations",
                unit: "-",
                default: "0",
                what: "most cost evaluations per start; 0: 200 for lm, 200 per parameter for nelder_mead, more for others",
            },
            ParamDoc {
                name: "cost_tolerance",
                unit: "-",
                default: "1e-12",
                what: "relative decrease that ends the search",
            },
            ParamDoc {
                name: "restarts",
                unit: "-",
                default: "0",
                what: "further starts around the first one",
            },
            ParamDoc {
                name: "spread",
                unit: "-",
                default: "0.1",
                what: "relative spread of the further starts",
            },
            ParamDoc { name: "seed", unit: "-", default: "0", what: "seed of the further starts" },
            ParamDoc {
                name: "initial",
                unit: "-",
                default: "\"measured\"",
                what: "where free runs start: `rest`, `measured` outputs, or outputs `estimated` with the parameters",
            },
            ParamDoc {
                name: "ridge",
                unit: "-",
                default: "0",
                what: "weight on squared parameters, as of ols",
            },
            ParamDoc {
                name: "cost",
                unit: "-",
                default: "\"squared\"",
                what: "cost of an error: squared, or huber, which outliers pull with a constant force only",
            },
            ParamDoc {
                name: "threshold",
                unit: "-",
                default: "1.345",
                what: "where Huber's cost turns linear, in robust standard deviations of the errors",
            },
            ParamDoc {
                name: "covariance",
                unit: "-",
                default: "\"auto\"",
                what: "white, robust (sandwich for coloured errors), or auto: as a test of the errors says",
            },
        ],
    },
    fits: Fits::Narx,
    gaps: Gaps::Bridged { free_run: true },
    build: |keys| Ok(Box::new(registry::keys::<Sem>("sem", keys)?)),
};

pub(super) use super::simulation::{SimulationError, further_start, least_squares_start};

/// Options of simulation-error estimation.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Sem {
    /// Most cost evaluations per start; 0 for what is usual for the search.
    pub max_evaluations: usize,
    /// Relative decrease of the cost at which the search has converged.
    pub cost_tolerance: f64,
    /// Further starts, drawn around the first one.
    pub restarts: usize,
    /// Relative standard deviation of the further starts.
    pub spread: f64,
    /// Seed of the further starts.
    pub seed: u64,
    /// Where the free runs start.
    pub initial: Initial,
    /// Ridge weight as in [`super::ols::Ols`]: parameters count in units of their regressor's rms. A little of it keeps
    /// models with many terms from cancelling large contributions against each other.
    pub ridge: f64,
    /// Search method.
    pub search: SearchMethod,
    /// Cost of an error.
    pub cost: CostKind,
    /// Threshold of Huber's cost in robust standard deviations of the errors.
    pub threshold: f64,
    /// What the covariance assumes of the errors.
    pub covariance: CovarianceChoice,
}

impl Default for Sem {
    fn default() -> Self {
        Self {
            max_evaluations: 0,
            cost_tolerance: 1e-12,
            restarts: 0,
            spread: 0.1,
            seed: 0,
            initial: Initial::Measured,
            ridge: 0.0,
            search: SearchMethod::default(),
            cost: CostKind::Squared,
            threshold: HUBER_THRESHOLD,
            covariance: CovarianceChoice::Auto,
        }
    }
}

impl Estimator for Sem {
    fn estimate(
        &self,
        model: &dyn Form,
        data: &[Experiment],
        start: Option<&[f64]>,
        interrupt: &dyn Fn() -> bool,
    ) -> Result<Fit, EstimateError> {
        let model = narx("sem", model)?;
        if self.initial == Initial::Estimated {
            return self.with_states(model, data, start, interrupt);
        }
        let data = &*started("sem", model, data, self.initial)?;
        let mut task = Free::new(self, model, data)?;
        let start = match start {
            Some(theta) => task.given(theta)?,
            None => task.own()?,
        };
        task.fit(self, vec![start], interrupt)
    }

    fn estimate_selecting(
        &self,
        model: &dyn Form,
        data: &[Experiment],
        _selecting: &[Experiment],
        start: Option<&[f64]>,
        interrupt: &dyn Fn() -> bool,
    ) -> Result<Fit, EstimateError> {
        let model = narx("sem", model)?;
        if self.initial == Initial::Estimated {
            // The states need a start of their own: the better of both from measured outputs.
            let measured = Self { initial: Initial::Measured, ..*self };
            let first = measured.estimate_selecting(model, data, &[], start, interrupt)?;
            return self.with_states(model, data, Some(&first.theta), interrupt);
        }
        let data = &*started("sem", model, data, self.initial)?;
        let mut task = Free::new(self, model, data)?;
        let starts = match start {
            Some(theta) => task.both(theta)?,
            None => vec![task.own()?],
        };
        task.fit(self, starts, interrupt)
    }
}

/// The free-run errors of the records with what is known of their starts.
struct Free<'a> {
    model: &'a dyn Model,
    data: &'a [Experiment],
    samples: usize,
    problem: SimulationError<'a>,
    ridge: f64,
    seed: u64,
}

/// A start of a search, and what the user should know if it wins.
struct Begin {
    theta: Vec<f64>,
    warnings: Vec<String>,
}

impl<'a> Free<'a> {
    fn new(sem: &Sem, model: &'a dyn Model, data: &'a [Experiment]) -> Result<Self, EstimateError> {
        let samples = free_run_samples(model, data)?;
        let problem = SimulationError::new(model, data, sem.ridge, samples);
        Ok(Self { model, data, samples, problem, ridge: sem.ridge, seed: sem.seed })
    }

    /// A start of the caller's; its free run must be finite.
    fn given(&mut self, theta: &[f64]) -> Result<Begin, EstimateError> {
        let (found, expected) = (theta.len(), self.model.n_params());
        if found != expected {
            return Err(EstimateError::Start { found, expected });
        }
        if self.problem.cost(theta).is_finite() {
            Ok(Begin { theta: theta.to_vec(), warnings: Vec::new() })
        } else {
            Err(self.problem.unstable(theta))
        }
    }

    /// Least squares, or a drawn start for models that have such.
    fn own(&mut self) -> Result<Begin, EstimateError> {
        if let Some(theta) = self.model.drawn().map(|d| d.random_start(&mut Rng64::stream(self.seed, 0))) {
            return self.given(&theta);
        }
        let (model, data, samples) = (self.model, self.data, self.samples);
        let mut warnings = Vec::new();
        let theta = least_squares_start(model, data, samples, self.ridge, &mut self.problem, &mut warnings)?;
        Ok(Begin { theta, warnings })
    }

    /// Those of both that can be run. Their searches compete, for the better start need not lead to the better end.
    fn both(&mut self, given: &[f64]) -> Result<Vec<Begin>, EstimateError> {
        match (self.given(given), self.own()) {
            (Ok(a), Ok(b)) => Ok(vec![a, b]),
            (Ok(one), Err(_)) | (Err(_), Ok(one)) => Ok(vec![one]),
            (Err(fault), Err(_)) => Err(fault),
        }
    }

    /// The best end of the searches from all starts.
    fn fit(
        mut self,
        sem: &Sem,
        starts: Vec<Begin>,
        interrupt: &dyn Fn() -> bool,
    ) -> Result<Fit, EstimateError> {
        let rows = self.problem.rows;
        let mut best: Option<(LmOutcome, Cost, Vec<String>)> = None;
        for start in starts {
            if best.as_ref().is_some_and(|b| b.0.status == Status::Interrupted) {
                break;
            }
            let (mut other, cost) = self.searched(sem, &start.theta, interrupt);
            if let Some((found, scale, _)) = &mut best {
                let evaluations = found.evaluations + other.evaluations;
                let mut value = |x: &[f64]| scale.total(&mut self.problem, rows, x);
                if value(&other.x) >= value(&found.x) {
                    found.evaluations = evaluations;
                    continue;
                }
                other.evaluations = evaluations;
            }
            best = Some((other, cost, start.warnings));
        }
        let Some((found, cost, mut warnings)) = best else {
            return Err(EstimateError::Start { found: 0, expected: self.model.n_params() });
        };
        warnings.extend(outlier_note(cost, &self.problem.errors(&found.x)));
        self.problem.report_as(found, self.samples, warnings, sem.covariance, cost)
    }

    fn searched(&mut self, sem: &Sem, start: &[f64], interrupt: &dyn Fn() -> bool) -> (LmOutcome, Cost) {
        let model = self.model;
        if sem.cost == CostKind::Squared {
            return (sem.search(&mut self.problem, model, start, interrupt), Cost::SQUARED);
        }
        let rows = self.problem.rows;
        // Further starts serve the first scale only: the later ones set out from a minimum.
        let mut first = true;
        fit_scale(&mut self.problem, rows, sem.threshold, start, |costed, x| {
            let restarts = if std::mem::take(&mut first) { sem.restarts } else { 0 };
            Sem { restarts, ..*sem }.search(costed, model, x, interrupt)
        })
    }
}

impl Sem {
    /// With the outputs before the first scored sample of each record as further parameters.
    fn with_states(
        &self,
        model: &dyn Model,
        data: &[Experiment],
        start: Option<&[f64]>,
        interrupt: &dyn Fn() -> bool,
    ) -> Result<Fit, EstimateError> {
        let plain = Sem { initial: Initial::Measured, ..Sem::default() };
        let asked =
            (self.search, self.restarts, self.cost) == (plain.search, 0, plain.cost) && self.ridge == 0.0;
        if !asked {
            let found = "search, restarts, ridge or cost beside it".into();
            return Err(EstimateError::Initial { estimator: "sem", rule: self.initial, found });
        }
        let most = if self.max_evaluations == 0 { 200 } else { self.max_evaluations };
        let states = FreeStates { max_evaluations: most, cost_tolerance: self.cost_tolerance, outputs: true };
        Ok(states.estimate(model, data, start, interrupt)?.fit)
    }

    /// The best of all starts.
    fn search(
        &self,
        problem: &mut dyn LeastSquares,
        model: &dyn Model,
        start: &[f64],
        interrupt: &dyn Fn() -> bool,
    ) -> LmOutcome {
        let limits = Limits { evaluations: self.max_evaluations, cost_tolerance: self.cost_tolerance };
        let mut best = search(self.search, problem, start, limits, interrupt);
        for i in 0..self.restarts {
            if best.status == Status::Interrupted {
                break;
            }
            let mut rng = Rng64::stream(self.seed, 1 + i as u64);
            let x0 = further_start(model, start, self.spread, &mut rng);
            let other = search(self.search, problem, &x0, limits, interrupt);
            let evaluations = best.evaluations + other.evaluations;
            // A diverged start has infinite cost and never wins.
            if other.cost < best.cost {
                best = other;
            }
            best.evaluations = evaluations;
        }
        best
    }
}
