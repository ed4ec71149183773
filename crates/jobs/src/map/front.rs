//! The trade-off of a steady calibration, and maps that are taken from it.

use dynocal_calib::steady::cell::Setting;
use dynocal_calib::steady::front::{Front, Tradeoff};
use dynocal_calib::steady::grid::{self, Cell, CellState};
use dynocal_calib::steady::layout::Layout;
use dynocal_numerics::status::Status;
use dynocal_numerics::watch::Watch;

use super::spec::MapSpec;

/// Models, spec and axes of the maps.
pub(super) struct Maps<'a> {
    pub(super) spec: &'a MapSpec,
    pub(super) layout: &'a Layout,
    pub(super) setting: &'a Setting<'a>,
    pub(super) axes: &'a [Vec<f64>],
}

impl Maps<'_> {
    /// The trade-off that is asked for; cells that are taken from it take the place of those of the least objective.
    pub(super) fn front(&self, cells: &mut [Cell], watch: Watch) -> Option<Front> {
        let spec = self.spec.optimise.front.as_ref()?;
        let against = self.layout.responses.iter().position(|r| r.name == spec.against)?;
        let which = optimal(cells);
        if which.is_empty() {
            return None;
        }
        watch.note(&format!("the trade-off against {}", spec.against));
        let trade = self.tradeoff(against, &which, cells);
        let points = trade.trace(spec.points, watch.interrupt);
        let taken = spec
            .take
            .and_then(|share| trade.at_most(share * points.first()?.other, &points, watch.interrupt));
        if let Some(taken) = &taken {
            // Not smoothed: what a smoother map costs of the weighted sum may be much of the response that is to be low.
            grid::replace(self.setting, self.axes, &which, taken.cells.clone(), cells);
        }
        let unit = self.layout.responses[against].unit.clone();
        Some(Front { against: spec.against.clone(), unit, points, taken })
    }

    /// All cells as one program, at the point of the front that was taken.
    pub(super) fn couple(
        &self,
        front: Option<&Front>,
        cells: &mut [Cell],
        watch: Watch,
    ) -> Option<(Status, usize)> {
        let whole = self.spec.optimise.whole.as_ref()?;
        watch.note("all cells as one program");
        let names = &self.layout.factor_names();
        let taken = front.and_then(|f| Some((f, f.taken.as_ref()?)));
        let Some((front, taken)) = taken else {
            return Some(grid::couple(self.setting, self.axes, whole, names, cells, watch.interrupt));
        };
        let against = self.layout.responses.iter().position(|r| r.name == front.against)?;
        let which = optimal(cells);
        let mut trade = self.tradeoff(against, &which, cells);
        // The scales are those of the map of the least objective.
        trade.cells = front.points.first()?.cells.clone();
        let weighted = trade.weighted(taken.share);
        let before = cells.to_vec();
        let ended = grid::couple(&weighted, self.axes, whole, names, cells, watch.interrupt);
        if cells[..] != before[..] {
            let optima = which.iter().map(|k| trade.in_units(taken.share, &cells[*k].optimum)).collect();
            grid::replace(self.setting, self.axes, &which, optima, cells);
        }
        Some(ended)
    }

    fn tradeoff(&self, against: usize, which: &[usize], cells: &[Cell]) -> Tradeoff<'_, '_> {
        let residence = self.spec.optimise.whole.as_ref().map_or(&[][..], |w| &w.residence);
        Tradeoff {
            setting: self.setting,
            against,
            cells: which.iter().map(|k| cells[*k].optimum.clone()).collect(),
            weights: which.iter().map(|k| residence.get(*k).copied().unwrap_or(1.0)).collect(),
            seed: self.spec.seed,
        }
    }
}

fn optimal(cells: &[Cell]) -> Vec<usize> {
    (0..cells.len()).filter(|k| cells[*k].state == CellState::Optimal).collect()
}
