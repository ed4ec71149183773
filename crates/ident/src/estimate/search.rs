//! Searches that simulation-error estimation can use: Levenberg-Marquardt, or any member of the table of bounded
//! optimisers, so that methods can be compared as in thesis Table 5.1.
//!
//! The optimisers see `cost(theta) / cost(theta_0)` in the variables `z = theta / d`. Those that compare values only get
//! `d = |theta_0|`: equal relative steps, which is what a simplex or a pattern starts with. Those with gradients get
//! `d = 1 / |J_k|`, one over the size of each sensitivity, for which the Hessian has a diagonal of one. Gradients are
//! exact, `2 J' r` from the recursive sensitivities. A trial whose free run diverges has infinite cost and is left.

use std::fmt;

use dynocal_numerics::linalg::dot;
use dynocal_numerics::lm::{LeastSquares, LmOptions, LmOutcome, levenberg_marquardt_interruptible};
use dynocal_numerics::optim::{Bounds, Budget, OPTIMISERS, Objective, optimiser};
use dynocal_numerics::registry::nearest;
use dynocal_numerics::status::{Iterate, Status};
use serde::{Deserialize, Deserializer, de};

/// Name of a search.
///
/// ```
/// use dynocal_ident::estimate::search::SearchMethod;
/// assert_eq!(SearchMethod::named("nelder_mead").unwrap().name(), "nelder_mead");
/// assert!(SearchMethod::named("nelder").unwrap_err().contains("lm, line_search, "));
/// ```
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct SearchMethod {
    name: &'static str,
    /// `None` for Levenberg-Marquardt.
    optimiser: Option<&'static str>,
}

/// Levenberg-Marquardt.
const LM: &str = "lm";
/// The thesis' name for a quasi-Newton method with line search.
const LINE_SEARCH: (&str, &str) = ("line_search", "quasi_newton");

impl SearchMethod {
    /// The search of that name: `lm`, `line_search` (which is `quasi_newton`), or a member of the table of optimisers.
    ///
    /// # Errors
    /// A sentence with the names there are.
    pub fn named(name: &str) -> Result<Self, String> {
        if name == LM {
            return Ok(Self::default());
        }
        if name == LINE_SEARCH.0 {
            return Ok(Self { name: LINE_SEARCH.0, optimiser: Some(LINE_SEARCH.1) });
        }
        if let Some(member) = OPTIMISERS.iter().find(|m| m.doc.name == name) {
            return Ok(Self { name: member.doc.name, optimiser: Some(member.doc.name) });
        }
        let known: Vec<String> = Self::names().into_iter().map(String::from).collect();
        let hint = nearest(name, &known).map(|n| format!(" (did you mean `{n}`?)")).unwrap_or_default();
        Err(format!("unknown search `{name}`{hint}; known: {}", known.join(", ")))
    }

    /// All names.
    pub fn names() -> Vec<&'static str> {
        [LM, LINE_SEARCH.0].into_iter().chain(OPTIMISERS.iter().map(|m| m.doc.name)).collect()
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        self.name
    }

    /// Whether it uses derivatives.
    fn is_smooth(self) -> bool {
        matches!(self.optimiser, Some("quasi_newton" | "lbfgsb"))
    }

    /// Evaluations of the cost that are its usual budget for n parameters: 200 with derivatives of the errors, 200 n with
    /// values alone (as in the thesis' tools), as many with the gradient alone, and ten times that for the slow ones.
    fn usual_evaluations(self, n: usize) -> usize {
        match self.optimiser {
            None => 200,
            Some("pattern_search") => 2000 * n,
            Some(_) if self.is_smooth() => 1000 * n,
            Some(_) => 200 * n,
        }
    }
}

impl Default for SearchMethod {
    fn default() -> Self {
        Self { name: LM, optimiser: None }
    }
}

impl fmt::Debug for SearchMethod {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)
    }
}

impl<'de> Deserialize<'de> for SearchMethod {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Self::named(&String::deserialize(deserializer)?).map_err(de::Error::custom)
    }
}

/// When a search ends.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limits {
    /// Most evaluations of the cost; 0 for what is usual for the method.
    pub(super) evaluations: usize,
    /// Relative decrease at which it has converged.
    pub(super) cost_tolerance: f64,
}

/// Minimises the sum of squares of `problem` from `start`.
pub(super) fn search(
    method: SearchMethod,
    problem: &mut dyn LeastSquares,
    start: &[f64],
    limits: Limits,
    interrupt: &dyn Fn() -> bool,
) -> LmOutcome {
    let max_evaluations =
        if limits.evaluations > 0 { limits.evaluations } else { method.usual_evaluations(start.len()) };
    let Some(name) = method.optimiser else {
        let options =
            LmOptions { max_evaluations, cost_tolerance: limits.cost_tolerance, ..LmOptions::default() };
        return levenberg_marquardt_interruptible(problem, start, &options, interrupt);
    };
    let method_of_table = optimiser(name, &toml::Table::new());
    let (Ok(found), Some(mut objective)) =
        (method_of_table, Scaled::new(problem, start, method.is_smooth(), interrupt))
    else {
        return diverged(start);
    };
    let n = start.len();
    let bounds = Bounds { lower: vec![f64::NEG_INFINITY; n], upper: vec![f64::INFINITY; n] };
    let budget = Budget {
        evaluations: max_evaluations,
        gradient_tolerance: 1e-10,
        value_tolerance: limits.cost_tolerance,
    };
    let z0: Vec<f64> = start.iter().zip(&objective.scale).map(|(x, d)| x / d).collect();
    let outcome = found.minimise(&mut objective, &bounds, &z0, &budget);
    let x = outcome.x.iter().zip(&objective.scale).map(|(z, d)| z * d).collect();
    let first = objective.first;
    let status = if objective.interrupted { Status::Interrupted } else { outcome.status };
    LmOutcome {
        x,
        cost: outcome.value * first,
        status,
        evaluations: objective.evaluations,
        jacobians: objective.jacobians,
        history: outcome
            .history
            .into_iter()
            .map(|i| Iterate { objective: i.objective * first, ..i })
            .collect(),
    }
}

fn diverged(start: &[f64]) -> LmOutcome {
    LmOutcome {
        x: start.to_vec(),
        cost: f64::INFINITY,
        status: Status::Diverged,
        evaluations: 1,
        jacobians: 1,
        history: Vec::new(),
    }
}

/// The sum of squares in scaled variables.
struct Scaled<'a> {
    problem: &'a mut dyn LeastSquares,
    interrupt: &'a dyn Fn() -> bool,
    scale: Vec<f64>,
    first: f64,
    x: Vec<f64>,
    r: Vec<f64>,
    evaluations: usize,
    jacobians: usize,
    interrupted: bool,
}

impl<'a> Scaled<'a> {
    /// `None` when the problem is not finite at the start.
    fn new(
        problem: &'a mut dyn LeastSquares,
        start: &[f64],
        smooth: bool,
        interrupt: &'a dyn Fn() -> bool,
    ) -> Option<Self> {
        let (n, m) = (problem.n(), problem.residuals());
        let (mut first, mut size) = (0.0, vec![0.0; n]);
        let finite = problem.jacobian_blocks(start, &mut |r, jac| {
            first += dot(r, r);
            for row in jac.chunks_exact(n.max(1)) {
                size.iter_mut().zip(row).for_each(|(s, v)| *s += v * v);
            }
        });
        if !finite || !first.is_finite() {
            return None;
        }
        // A parameter that starts from zero, or moves nothing, takes the other measure.
        let by_size = |k: usize| if size[k] > 0.0 { (first / size[k]).sqrt() } else { 1.0 };
        let scale =
            (0..n).map(|k| if smooth || start[k] == 0.0 { by_size(k) } else { start[k].abs() }).collect();
        let first = if first > 0.0 { first } else { 1.0 };
        let x = start.to_vec();
        let r = vec![0.0; m];
        Some(Self {
            problem,
            interrupt,
            scale,
            first,
            x,
            r,
            evaluations: 0,
            jacobians: 0,
            interrupted: false,
        })
    }
}

impl Objective for Scaled<'_> {
    fn n(&self) -> usize {
        self.x.len()
    }

    fn value_gradient(&mut self, z: &[f64], grad: &mut [f64]) -> f64 {
        self.interrupted |= (self.interrupt)();
        if self.interrupted {
            // Nothing is computed any more; the optimiser runs out of trials.
            return f64::INFINITY;
        }
        self.evaluations += 1;
        self.x.iter_mut().zip(z).zip(&self.scale).for_each(|((x, z), d)| *x = z * d);
        if grad.is_empty() {
            let finite = self.problem.residual(&self.x, &mut self.r);
            return if finite { dot(&self.r, &self.r) / self.first } else { f64::INFINITY };
        }
        self.jacobians += 1;
        grad.fill(0.0);
        let (n, mut cost) = (self.x.len(), 0.0);
        let finite = self.problem.jacobian_blocks(&self.x, &mut |r, jac| {
            cost += dot(r, r);
            for (row, r) in jac.chunks_exact(n.max(1)).zip(r) {
                grad.iter_mut().zip(row).for_each(|(g, v)| *g += r * v);
            }
        });
        grad.iter_mut().zip(&self.scale).for_each(|(g, d)| *g *= 2.0 * d / self.first);
        if finite { cost / self.first } else { f64::INFINITY }
    }
}
