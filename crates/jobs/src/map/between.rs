//! Values of the maps between their cells, where straight lines would miss the inputs that loops drive.
//!
//! Free inputs are straight between the cells by definition, so that their maps do not change. What a loop drives to hold the demand
//! there is bent: the air through a throttle goes with a power of its angle. An interval between two values of an axis is halved, and once
//! more, as long as the largest error of the straight line along it is above the tolerance:
//!
//! ```text
//! max | u(z) - ((1 - s) u(a) + s u(b)) | / | u(z) | <= tolerance        z = a + s (b - a), quarters of the interval, all lines of the other axis
//! ```

use dynocal_calib::steady::cell::{CellOptimum, Setting};
use dynocal_calib::steady::grid::{Cell, CellState, corners, interpolate, place};
use dynocal_calib::steady::layout::Layout;
use dynocal_calib::steady::quantise::quantise;
use dynocal_calib::steady::trim::finer;
use dynocal_numerics::status::Status;

use super::drive::{self, Drive};
use super::error::MapError;
use super::result::MapAxis;
use super::spec::MapSpec;

/// Parts of an interval that are looked at, and numbers of parts that it may get.
const PARTS: usize = 4;
const CHOICES: [usize; 3] = [1, 2, PARTS];

/// The maps with their cells.
pub(super) struct Between<'a> {
    pub(super) spec: &'a MapSpec,
    pub(super) layout: &'a Layout,
    pub(super) setting: &'a Setting<'a>,
    pub(super) drives: &'a [Drive],
    pub(super) axes: &'a [MapAxis],
    pub(super) cells: &'a [Cell],
}

impl Between<'_> {
    /// Axes and cells of the maps with as many values between as the tolerance asks for.
    ///
    /// # Errors
    /// As of [`drive::fill`].
    pub(super) fn maps(&self) -> Result<(Vec<MapAxis>, Vec<Cell>), MapError> {
        let tolerance = self.spec.optimise.between;
        if tolerance <= 0.0 || self.cells.is_empty() {
            return Ok((self.axes.to_vec(), self.cells.to_vec()));
        }
        let coarse: Vec<Vec<f64>> = self.axes.iter().map(|a| a.points.clone()).collect();
        let fine = finer(&coarse, PARTS - 1);
        let known = self.cells_at(&coarse, &fine)?;
        let mut axes = self.axes.to_vec();
        for (k, axis) in axes.iter_mut().enumerate() {
            let points = (0..axis.points.len().saturating_sub(1)).flat_map(|i| {
                let parts = self.parts(&fine, &known, k, i * PARTS, tolerance);
                (0..parts).map(move |p| i * PARTS + p * PARTS / parts)
            });
            let last = fine[k].len() - 1;
            axis.points = points.chain([last]).map(|i| fine[k][i]).collect();
        }
        let points: Vec<Vec<f64>> = axes.iter().map(|a| a.points.clone()).collect();
        Ok((axes, self.cells_at(&coarse, &points)?))
    }

    /// Fewest parts of the interval of axis `k` from `from` on that keep the tolerance; most where none does.
    fn parts(&self, axes: &[Vec<f64>], cells: &[Cell], k: usize, from: usize, tolerance: f64) -> usize {
        let stride: usize = axes[k + 1..].iter().map(Vec::len).product();
        let n = axes[k].len();
        let lines = (0..cells.len()).filter(|c| (c / stride).is_multiple_of(n));
        let error = |start: usize, parts: usize| {
            let at = |i: usize| &cells[start + i * stride];
            let optimal = (from..=from + PARTS).all(|i| at(i).state == CellState::Optimal);
            if !optimal {
                return 0.0;
            }
            let step = PARTS / parts;
            let each = (from..from + PARTS).flat_map(|i| {
                let a = from + (i - from) / step * step;
                let share = (i - a) as f64 / step as f64;
                (0..self.drives.len()).map(move |l| {
                    let u = |i: usize| at(i).optimum.responses[l];
                    let straight = (1.0 - share) * u(a) + share * u(a + step);
                    (straight - u(i)).abs() / u(i).abs().max(f64::MIN_POSITIVE)
                })
            });
            each.fold(0.0, f64::max)
        };
        let starts: Vec<usize> = lines.collect();
        let keeps = |parts: &usize| starts.iter().all(|s| error(*s, *parts) <= tolerance);
        CHOICES.into_iter().find(keeps).unwrap_or(PARTS)
    }

    /// Cells at all nodes of `axes`; those of the maps as they are.
    fn cells_at(&self, coarse: &[Vec<f64>], axes: &[Vec<f64>]) -> Result<Vec<Cell>, MapError> {
        let n: usize = axes.iter().map(Vec::len).product();
        let (mut own, mut cells): (Vec<usize>, Vec<Cell>) = (Vec::new(), Vec::new());
        for k in 0..n {
            let at = place(axes, k);
            let around = corners(coarse, &at);
            if let [(one, _)] = around[..] {
                own.push(k);
                cells.push(self.cells[one].clone());
                continue;
            }
            cells.push(self.between(coarse, at, &around));
        }
        let which: Vec<usize> = (0..n)
            .filter(|k| cells[*k].state == CellState::Optimal && own.binary_search(k).is_err())
            .collect();
        let mut between: Vec<Cell> = which.iter().map(|k| cells[*k].clone()).collect();
        drive::fill(self.drives, self.layout, self.setting, &mut between)?;
        which.into_iter().zip(between).for_each(|(k, c)| cells[k] = c);
        Ok(cells)
    }

    /// A place between cells; where one of them holds no optimum its responses are straight, too.
    fn between(&self, coarse: &[Vec<f64>], at: Vec<f64>, around: &[(usize, f64)]) -> Cell {
        let x = interpolate(coarse, self.cells, &at);
        let mut optimum = self.setting.judge(&x, Status::Stalled, None);
        let odd = around.iter().map(|(k, _)| &self.cells[*k]).find(|c| c.state != CellState::Optimal);
        match odd {
            Some(_) => {
                for (l, r) in optimum.responses.iter_mut().enumerate() {
                    *r = around.iter().map(|(k, w)| w * self.cells[*k].optimum.responses[l]).sum();
                }
            }
            None => optimum = self.in_steps(optimum),
        }
        let state = odd.map_or(CellState::Optimal, |c| c.state);
        Cell { at, state, best: self.setting.cost(&optimum), optimum }
    }

    fn in_steps(&self, optimum: CellOptimum) -> CellOptimum {
        let resolution = &self.spec.optimise.resolution;
        if resolution.is_empty() {
            return optimum;
        }
        let free = &self.layout.factors[self.layout.axes..];
        let steps: Vec<Option<f64>> = free.iter().map(|f| resolution.get(&f.name).copied()).collect();
        quantise(self.setting, &optimum, &steps)
    }
}
