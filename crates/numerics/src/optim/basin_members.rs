//! Optimisers of the crate basin behind our contract; with `basin_global` the only module that names it.
//!
//! The derivative-free ones work in variables that are scaled to the box (or to the start where there is none).

use super::probe::{BudgetUsed, Probe};
use super::{Bounds, Budget, Objective, Optimiser, Outcome};
use crate::registry::{self, Member, MemberDoc, ParamDoc};
use crate::status::Status;
use basin::{
    BoxBounds, ConstraintDescription, ConstraintSet, Constraints, CostFunction, Executor, FirstOrderState,
    Gradient, Lbfgsb, Mads, NelderMead, PointState, SimplexProgress, TerminationCode,
};
use serde::Deserialize;
use std::cell::RefCell;

const MEMORY: ParamDoc = ParamDoc {
    name: "memory",
    unit: "-",
    default: "10",
    what: "Number of (step, gradient change) pairs kept",
};

pub(super) const LBFGSB: Member<dyn Optimiser> = Member {
    doc: MemberDoc {
        name: "lbfgsb",
        what: "L-BFGS-B (Byrd, Lu, Nocedal, Zhu 1995); needs gradients",
        params: &[MEMORY],
    },
    build: |keys| Ok(Box::new(registry::keys::<LimitedMemory>("lbfgsb", keys)?)),
};

pub(super) const NELDER_MEAD: Member<dyn Optimiser> = Member {
    doc: MemberDoc {
        name: "nelder_mead",
        what: "Nelder-Mead simplex with projection onto the box; values only, few variables",
        params: &[],
    },
    build: |keys| Ok(Box::new(registry::keys::<Simplex>("nelder_mead", keys)?)),
};

pub(super) const PATTERN_SEARCH: Member<dyn Optimiser> = Member {
    doc: MemberDoc {
        name: "pattern_search",
        what: "Mesh adaptive direct search (Abramson, Audet, Dennis, Le Digabel 2009); values only, rough objectives",
        params: &[],
    },
    build: |keys| Ok(Box::new(registry::keys::<PatternSearch>("pattern_search", keys)?)),
};

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct LimitedMemory {
    memory: usize,
}

impl Default for LimitedMemory {
    fn default() -> Self {
        Self { memory: 10 }
    }
}

#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Simplex {}

#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct PatternSearch {}

/// The problem as basin sees it: `x = shift + scale y`.
pub(super) struct Bridge<'p, 'a> {
    // basin evaluates through shared references; our objectives own buffers.
    probe: &'p RefCell<Probe<'a>>,
    shift: Vec<f64>,
    scale: Vec<f64>,
    pub(super) lower: Vec<f64>,
    pub(super) upper: Vec<f64>,
}

impl<'p, 'a> Bridge<'p, 'a> {
    pub(super) fn new(probe: &'p RefCell<Probe<'a>>, bounds: &Bounds, scaled: bool) -> (Self, Vec<f64>) {
        let x0 = probe.borrow().start();
        let (mut shift, mut scale) = (vec![0.0; x0.len()], vec![1.0; x0.len()]);
        for k in (0..x0.len()).filter(|_| scaled) {
            let width = bounds.upper[k] - bounds.lower[k];
            if width.is_finite() && width > 0.0 {
                (shift[k], scale[k]) = (bounds.lower[k], width);
            } else {
                scale[k] = x0[k].abs().max(1.0);
            }
        }
        let map = |v: &[f64]| (0..v.len()).map(|k| (v[k] - shift[k]) / scale[k]).collect::<Vec<f64>>();
        let (lower, upper, y0) = (map(&bounds.lower), map(&bounds.upper), map(&x0));
        (Self { probe, shift, scale, lower, upper }, y0)
    }

    /// Puts bounds one unit from `y0` where there is none.
    pub(super) fn close_box(&mut self, y0: &[f64]) {
        for k in 0..y0.len() {
            self.lower[k] = if self.lower[k].is_finite() { self.lower[k] } else { y0[k] - 1.0 };
            self.upper[k] = if self.upper[k].is_finite() { self.upper[k] } else { y0[k] + 1.0 };
        }
    }

    fn evaluate(&self, y: &[f64], grad: &mut [f64]) -> Result<f64, BudgetUsed> {
        let x: Vec<f64> = (0..y.len()).map(|k| self.shift[k] + self.scale[k] * y[k]).collect();
        let value = self.probe.borrow_mut().value(&x, grad)?;
        grad.iter_mut().zip(&self.scale).for_each(|(g, s)| *g *= s);
        // A large finite value: line searches interpolate, and infinities would poison them.
        Ok(if value.is_finite() { value } else { 1e100 })
    }
}

impl CostFunction for Bridge<'_, '_> {
    type Param = Vec<f64>;
    type Output = f64;
    type Error = BudgetUsed;
    fn cost(&self, y: &Vec<f64>) -> Result<f64, BudgetUsed> {
        self.evaluate(y, &mut [])
    }
}

/// [`Bridge`] for methods that use gradients: value and gradient in one evaluation.
struct SmoothBridge<'p, 'a>(Bridge<'p, 'a>);

impl CostFunction for SmoothBridge<'_, '_> {
    type Param = Vec<f64>;
    type Output = f64;
    type Error = BudgetUsed;
    fn cost(&self, y: &Vec<f64>) -> Result<f64, BudgetUsed> {
        let mut unused = vec![0.0; y.len()];
        self.0.evaluate(y, &mut unused)
    }
}

impl Gradient for SmoothBridge<'_, '_> {
    type Gradient = Vec<f64>;
    fn gradient(&self, y: &Vec<f64>) -> Result<Vec<f64>, BudgetUsed> {
        let mut grad = vec![0.0; y.len()];
        self.0.evaluate(y, &mut grad)?;
        // After a non-finite trial the gradient is meaningless but must not spread.
        grad.iter_mut().filter(|g| !g.is_finite()).for_each(|g| *g = 0.0);
        Ok(grad)
    }
}

type BoxSet = ConstraintSet<BoxBounds<Vec<f64>>>;

impl Constraints for Bridge<'_, '_> {
    type Set = BoxSet;
    fn constraints(&self) -> <BoxSet as ConstraintDescription>::Borrowed<'_> {
        ConstraintSet::new().with_bounds(BoxBounds::new(Some(&self.lower), Some(&self.upper)))
    }
}

impl Constraints for SmoothBridge<'_, '_> {
    type Set = BoxSet;
    fn constraints(&self) -> <BoxSet as ConstraintDescription>::Borrowed<'_> {
        self.0.constraints()
    }
}

/// How basin's ending reads in our terms.
pub(super) fn status(ended: Result<TerminationCode, BudgetUsed>, converged: bool) -> Status {
    match ended {
        Err(BudgetUsed) | Ok(TerminationCode::MaxIter | TerminationCode::MaxCostEvals) => Status::Limit,
        Ok(_) if converged => Status::Converged,
        Ok(_) => Status::Stalled,
    }
}

/// Runs an executor and gives (ending, converged).
macro_rules! run {
    ($executor:expr) => {
        match $executor.max_iter(u64::MAX).run() {
            Ok(result) => (Ok(result.report.code()), result.report.termination.is_converged()),
            Err(_) => (Err(BudgetUsed), false),
        }
    };
}
pub(super) use run;

impl Optimiser for LimitedMemory {
    fn minimise(&self, problem: &mut dyn Objective, bounds: &Bounds, x0: &[f64], budget: &Budget) -> Outcome {
        let probe = RefCell::new(Probe::new(problem, bounds, x0, budget));
        let (bridge, y0) = Bridge::new(&probe, bounds, false);
        let mut grad = vec![0.0; y0.len()];
        let first = bridge.evaluate(&y0, &mut grad).map(|_| ());
        let norm = super::probe::projected_gradient_norm(&y0, &grad, bounds);
        let (ended, converged) = if first.is_err() || !norm.is_finite() {
            (Err(BudgetUsed), false)
        } else {
            let solver = Lbfgsb::new()
                .with_m_capacity(self.memory.max(1))
                .with_absolute_projected_gradient_tolerance(budget.gradient_tolerance * norm)
                .with_relative_cost_reduction_tolerance(budget.value_tolerance);
            run!(Executor::new(SmoothBridge(bridge), solver, FirstOrderState::new(y0)))
        };
        probe.into_inner().outcome(status(ended, converged))
    }
}

impl Optimiser for Simplex {
    fn minimise(&self, problem: &mut dyn Objective, bounds: &Bounds, x0: &[f64], budget: &Budget) -> Outcome {
        let probe = RefCell::new(Probe::new(problem, bounds, x0, budget));
        let (bridge, y0) = Bridge::new(&probe, bounds, true);
        let solver = NelderMead::adaptive()
            .projected()
            .with_absolute_simplex_size_tolerance(1e-9)
            .with_relative_simplex_cost_tolerance(budget.value_tolerance);
        let (ended, converged) = run!(Executor::new(bridge, solver, SimplexProgress::new(y0)));
        probe.into_inner().outcome(status(ended, converged))
    }
}

impl Optimiser for PatternSearch {
    fn minimise(&self, problem: &mut dyn Objective, bounds: &Bounds, x0: &[f64], budget: &Budget) -> Outcome {
        let probe = RefCell::new(Probe::new(problem, bounds, x0, budget));
        let (bridge, y0) = Bridge::new(&probe, bounds, true);
        let solver = Mads::new().bounded().with_initial_poll_size(0.125).with_minimum_poll_size(1e-7);
        let (ended, converged) = run!(Executor::new(bridge, solver, PointState::new(y0)));
        probe.into_inner().outcome(status(ended, converged))
    }
}
