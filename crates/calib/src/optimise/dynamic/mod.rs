//! Dynamic programming over a grid of what the models remember: no derivative, no start, the whole of the grid at once.
//!
//! ```text
//! V_t(s) = min_u  stage_t(s, u) + V_(t+1)(next_t(s, u)),   V_to = 0,   u within its bounds and rate
//! ```
//!
//! s are the values of the samples so far that a later equation, rate limit or weight on increments reads; V is linear between
//! the points of the grid. One or two such values can be gone through; the work grows with a power of their number. What is
//! asked of outputs is soft, as in a horizon ([`super::horizon`]). A second grid with half the cells says what the first one is
//! worth: the error of V falls with the square of a cell, so what is left is about a third of their difference, and the whole
//! of it is given as the error.
//!
//! Reference: R. Bellman, Dynamic Programming (1957); D. P. Bertsekas, Dynamic Programming and Optimal Control, volume 1
//! (2017), section 6.6.

mod grid;
mod stage;

use super::error::OptimiseError;
use super::horizon::PRICE;
use super::setup::Setup;
use super::{EndCondition, Found, OptimiseOptions};
use dynocal_numerics::status::Status;
use grid::{Axis, Grid};
use serde::{Deserialize, Serialize};
use stage::Stages;

/// Cells of each axis by default, for one value and for two.
const CELLS: [usize; 2] = [200, 40];
/// Most values that are kept of all stages.
const MOST_VALUES: usize = 20_000_000;
/// Share by which the range of an output is wider than what steps between the bounds of the inputs give, and by which it
/// grows where the best way leaves it; and how often.
const WIDER: f64 = 0.25;
const WIDENINGS: usize = 4;

/// Dynamic programming.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Dynamic {
    /// Cells of the grid along each value that the models remember; absent for 200 of one value, 40 of each of two.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cells: Option<usize>,
    /// Price of an output's whole range missed for the whole record, in objective units; absent for twenty times the objective
    /// of the start.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub price: Option<f64>,
}

/// What a grid gave.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct GridValue {
    /// What the models remember, as `torque(t)`.
    pub remembered: Vec<String>,
    /// Least and greatest value of each on the grid.
    pub ranges: Vec<[f64; 2]>,
    /// Cells along each.
    pub cells: usize,
    /// Least objective by the grid, prices of what is missed and weights on increments included.
    pub objective: f64,
    /// How far it is from that of a grid with half the cells.
    pub error: f64,
}

/// What a search over a grid asks of problem and options before it begins.
pub(super) fn check(
    setup: &Setup<'_>,
    options: &OptimiseOptions,
    spec: &Dynamic,
) -> Result<(), OptimiseError> {
    let refuse = |found: &str, expected: &str| {
        Err(OptimiseError::Grid { found: found.into(), expected: expected.into() })
    };
    if options.end == EndCondition::Start {
        return refuse("inputs that are imposed at the end", "`end = \"free\"`");
    }
    if options.robust.is_some() {
        return refuse("draws of the models, each of which remembers values of its own", "no `robust`");
    }
    let whole = spec.soft(setup);
    let stages = Stages::new(&whole)?;
    let kept =
        (spec.cells(&stages) + 1).saturating_pow(stages.memory.len() as u32).saturating_mul(stages.count());
    if kept > MOST_VALUES {
        let found = format!("{kept} values over {} samples", stages.count());
        return refuse(&found, &format!("at most {MOST_VALUES}: fewer cells or a shorter record"));
    }
    Ok(())
}

impl Dynamic {
    /// The setup with all that is asked of outputs soft.
    fn soft<'a>(&self, setup: &Setup<'a>) -> Setup<'a> {
        setup.elastic(self.price.unwrap_or(PRICE * setup.start_objective().abs().max(1e-9)), 1.0)
    }

    fn cells(&self, stages: &Stages<'_>) -> usize {
        self.cells.unwrap_or(CELLS[stages.memory.len() - 1])
    }
}

/// Goes through all stages backwards, then along the best way.
pub(super) fn solve(
    setup: &Setup<'_>,
    options: &OptimiseOptions,
    spec: &Dynamic,
    interrupt: &dyn Fn() -> bool,
) -> Result<Found, OptimiseError> {
    check(setup, options, spec)?;
    let whole = spec.soft(setup);
    let stages = Stages::new(&whole)?;
    let cells = spec.cells(&stages);
    let mut found = Found::start(&whole);
    let mut axes = stages.axes(&whole, cells, WIDER);
    for _ in 0..=WIDENINGS {
        let fine = Grid::new(axes.clone()).fill(&stages, interrupt);
        let (values, left) = stages.follow(&whole, &fine);
        (found.values, found.iterations) = (values, found.iterations + stages.count());
        found.status = if interrupt() { Status::Interrupted } else { Status::Converged };
        if left.is_empty() || found.status == Status::Interrupted {
            let coarse = Grid::new(axes.iter().map(Axis::coarser).collect()).fill(&stages, interrupt);
            found.grid = Some(stages.judged(&whole, &fine, &coarse, cells));
            break;
        }
        // A way that leaves the grid was judged by what lies outside of it.
        found.status = Status::Stalled;
        left.into_iter().for_each(|k| axes[k].widen(WIDER));
    }
    whole.narrowed(setup, &mut found);
    Ok(found)
}
