//! Maps as an ECU holds them: fewer breakpoints, inputs in steps, and what that costs.

use dynocal_calib::steady::breakpoints::{Tables, places};
use dynocal_calib::steady::cell::CellOptimum;
use dynocal_calib::steady::front::Front;
use dynocal_calib::steady::grid::{self, Cell, CellState, corners, interpolate};
use dynocal_calib::steady::quantise::{multiple, quantise};
use dynocal_numerics::status::Status;

use super::front::Maps;
use super::reach::channel;
use super::result::{Delivered, MapAxis, Passed};

impl Maps<'_> {
    /// Takes the breakpoints and steps that the spec asks for; none where it asks for neither.
    pub(super) fn deliver(
        &self,
        front: Option<&Front>,
        axes: &mut [MapAxis],
        cells: &mut Vec<Cell>,
    ) -> Option<Delivered> {
        let spec = &self.spec.optimise;
        if spec.breakpoints.is_empty() && spec.resolution.is_empty() {
            return None;
        }
        let full = cells.clone();
        let count = |a: &MapAxis| spec.breakpoints.get(&a.name).copied().unwrap_or(a.points.len());
        let counts: Vec<usize> = axes.iter().map(count).collect();
        let kept = self.tables(cells).choose(&counts);
        let which = places(self.axes, &kept);
        *cells = which.iter().map(|k| full[*k].clone()).collect();
        for (axis, kept) in axes.iter_mut().zip(&kept) {
            axis.points = kept.iter().map(|i| axis.points[*i]).collect();
        }
        let fewer: Vec<Vec<f64>> = axes.iter().map(|a| a.points.clone()).collect();
        let lost_cells = self.in_steps(&fewer, cells);
        let against_share = front.and_then(|f| self.against_share(f, &full, &fewer, cells));
        Some(Delivered { against_share, ..self.loss(&full, &fewer, cells, lost_cells) })
    }

    /// Inputs of all cells as shares of their ranges; cells that hold no optimum do not count.
    fn tables(&self, cells: &[Cell]) -> Tables {
        let (layout, axes) = (self.layout, self.layout.axes);
        let free = (axes..layout.factors.len()).map(|i| {
            let f = &layout.factors[i];
            cells.iter().map(|c| (c.optimum.x[i] - f.lower) / (f.upper - f.lower)).collect()
        });
        let driven = layout.driven().into_iter().enumerate().map(|(l, k)| {
            let i = &layout.problem.inputs[k];
            cells.iter().map(|c| (c.optimum.responses[l] - i.lower) / (i.upper - i.lower)).collect()
        });
        let residence = self.spec.optimise.whole.as_ref().map_or(&[][..], |w| &w.residence);
        let weight = |(k, c): (usize, &Cell)| match c.state {
            CellState::Optimal => residence.get(k).copied().unwrap_or(1.0),
            _ => 0.0,
        };
        Tables {
            axes: self.axes.to_vec(),
            layers: free.chain(driven).collect(),
            weights: cells.iter().enumerate().map(weight).collect(),
        }
    }

    /// Free inputs in the steps of the ECU; cells that keep no longer all limits are no optimum, their number.
    fn in_steps(&self, axes: &[Vec<f64>], cells: &mut [Cell]) -> usize {
        let spec = &self.spec.optimise;
        let free = &self.layout.factors[self.layout.axes..];
        let steps: Vec<Option<f64>> = free.iter().map(|f| spec.resolution.get(&f.name).copied()).collect();
        let mut lost = 0;
        let optimal = |c: &Cell| c.state == CellState::Optimal;
        let which: Vec<usize> = (0..cells.len()).filter(|k| optimal(&cells[*k])).collect();
        let mut optima: Vec<CellOptimum> = Vec::new();
        for k in &which {
            let o = quantise(self.setting, &cells[*k].optimum, &steps);
            if !o.feasible {
                cells[*k].state = CellState::Infeasible;
                lost += 1;
            }
            optima.push(o);
        }
        grid::replace(self.setting, axes, &which, optima, cells);
        for c in cells.iter_mut().filter(|c| c.state == CellState::Filled) {
            for (i, step) in steps.iter().enumerate() {
                let x = &mut c.optimum.x[self.layout.axes + i];
                *x = step.map_or(*x, |s| multiple((*x / s).round(), s)).clamp(free[i].lower, free[i].upper);
            }
        }
        lost
    }

    /// The other response of a front at the full cells of the delivered maps, over that of the map of the least objective.
    fn against_share(&self, f: &Front, full: &[Cell], axes: &[Vec<f64>], cells: &[Cell]) -> Option<f64> {
        let k = self.layout.responses.iter().position(|r| r.name == f.against)?;
        let residence = self.spec.optimise.whole.as_ref().map_or(&[][..], |w| &w.residence);
        let optimal = full.iter().enumerate().filter(|(_, c)| c.state == CellState::Optimal);
        let (mut now, mut least) = (0.0, 0.0);
        for ((i, c), first) in optimal.zip(&f.points.first()?.cells) {
            let weight = residence.get(i).copied().unwrap_or(1.0);
            let there = self.setting.judge(&interpolate(axes, cells, &c.at), Status::Stalled, None);
            now += weight * there.responses[k];
            least += weight * first.responses[k];
        }
        Some(now / least)
    }

    fn loss(&self, full: &[Cell], axes: &[Vec<f64>], cells: &[Cell], lost_cells: usize) -> Delivered {
        let (mut losses, mut worst): (Vec<f64>, Option<(f64, Passed)>) = (Vec::new(), None);
        for c in full.iter().filter(|c| c.state == CellState::Optimal) {
            let around = corners(axes, &c.at);
            if !around.iter().all(|(k, _)| cells[*k].state == CellState::Optimal) {
                continue;
            }
            let there = self.setting.judge(&interpolate(axes, cells, &c.at), Status::Stalled, None);
            losses.push((there.objective - c.optimum.objective) / c.optimum.objective.abs());
            for (p, s) in there.prices.iter().zip(&self.setting.sides) {
                let share = p.passed / s.scale;
                if share > LEAST && worst.as_ref().is_none_or(|w| share > w.0) {
                    let r = channel(self.layout, p.response);
                    let (response, unit) = (r.name.clone(), r.unit.clone());
                    worst = Some((share, Passed { response, unit, by: p.passed }));
                }
            }
        }
        Delivered {
            full_cells: full.len(),
            mean_loss: losses.iter().sum::<f64>() / losses.len().max(1) as f64,
            largest_loss: losses.iter().copied().fold(0.0, f64::max),
            passed: worst.map(|w| w.1),
            against_share: None,
            lost_cells,
        }
    }
}

/// Share of the scatter of a response by which a limit may be passed unsaid.
const LEAST: f64 = 1e-3;
