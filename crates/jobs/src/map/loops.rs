//! What is minimised over one free input, everything else as it stands in the map: the spark sweep of a bed, on the models.

use dynocal_calib::steady::cell::{Setting, deviations};
use dynocal_calib::steady::grid::{Cell, CellState};
use dynocal_calib::steady::layout::Layout;
use dynocal_numerics::status::Status;
use serde::Serialize;

/// Cells that are shown, and values along the input.
const CELLS: usize = 6;
const VALUES: usize = 25;

/// What is minimised along an input at one cell, as shares of what it is in the map.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct InputLoop {
    /// Input.
    pub input: String,
    /// Unit.
    pub unit: String,
    /// Values of the axes.
    pub at: Vec<f64>,
    /// Value in the map.
    pub set: f64,
    /// Values of the input.
    pub x: Vec<f64>,
    /// Change of what is minimised, as a share.
    pub change: Vec<f64>,
    /// Half width of the 95 % interval of it.
    pub half_width: Vec<f64>,
    /// Whether all limits are kept there with the asked probability.
    pub kept: Vec<bool>,
}

/// Loops of all free inputs at some cells that hold an optimum, spread over the map.
pub(super) fn of(setting: &Setting, layout: &Layout, cells: &[Cell]) -> Vec<InputLoop> {
    let optimal: Vec<&Cell> = cells.iter().filter(|c| c.state == CellState::Optimal).collect();
    let n = optimal.len().min(CELLS);
    let shown: Vec<&Cell> = (0..n).map(|k| optimal[(2 * k + 1) * optimal.len() / (2 * n)]).collect();
    let one = |i: usize, c: &Cell| {
        let (f, base) = (&layout.factors[i], c.optimum.objective);
        let x: Vec<f64> =
            (0..VALUES).map(|k| f.lower + (f.upper - f.lower) * k as f64 / (VALUES - 1) as f64).collect();
        let judged = x.iter().map(|v| {
            let mut at = c.optimum.x.clone();
            at[i] = *v;
            setting.judge(&at, Status::Stalled, None)
        });
        let judged: Vec<_> = judged.collect();
        InputLoop {
            input: f.name.clone(),
            unit: f.unit.clone(),
            at: c.at.clone(),
            set: c.optimum.x[i],
            change: judged.iter().map(|o| o.objective / base - 1.0).collect(),
            half_width: judged
                .iter()
                .map(|o| deviations(0.975) * o.objective_deviation / base.abs())
                .collect(),
            kept: judged.iter().map(|o| o.feasible).collect(),
            x,
        }
    };
    (layout.axes..layout.factors.len()).flat_map(|i| shown.iter().map(move |c| one(i, c))).collect()
}
