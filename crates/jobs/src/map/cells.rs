//! What the cells of the maps say: values of the inputs, and what they miss.

use dynocal_calib::problem::InputChannel;
use dynocal_calib::steady::day::DayEnd;
use dynocal_calib::steady::grid::{Cell, CellState};
use dynocal_calib::steady::layout::{FactorKind, Layout};
use dynocal_ident::data::UnitAfter;

use super::reach::channel;
use super::result::Mapped;

/// Values of all inputs that may move at a cell: free ones as optimised, driven ones as the models expect them.
pub(super) fn actuators(layout: &Layout, cell: &Cell) -> Vec<f64> {
    let driven = layout.driven();
    let value = |(k, i): (usize, &InputChannel)| {
        let v = match driven.iter().position(|d| *d == k) {
            Some(loop_number) => cell.optimum.responses[loop_number],
            None => {
                let place = layout.factors.iter().position(|f| f.kind == FactorKind::Free(k));
                place.map_or(f64::NAN, |p| cell.optimum.x[p])
            }
        };
        v.clamp(i.lower, i.upper)
    };
    layout.problem.inputs.iter().enumerate().map(value).collect()
}

/// By how much what is minimised (its `caution` counted in) is above what each optimal cell had by itself, as a share: mean and largest. None where no cell has a size.
pub(super) fn above_alone(cells: &[Cell], caution: f64) -> Option<[f64; 2]> {
    let cost = |c: &Cell| c.optimum.objective + caution * c.optimum.objective_deviation;
    let optimal = cells.iter().filter(|c| c.state == CellState::Optimal);
    let shares: Vec<f64> =
        optimal.map(|c| (cost(c) - c.best) / c.best.abs()).filter(|s| s.is_finite()).collect();
    let largest = shares.iter().copied().reduce(f64::max)?;
    Some([shares.iter().sum::<f64>() / shares.len() as f64, largest])
}

/// Why a cell is not what was asked for; empty where it is.
pub(super) fn missed(layout: &Layout, cell: &Cell) -> String {
    match cell.state {
        CellState::Optimal => String::new(),
        CellState::Filled => "filled from its neighbours: not reached on the bed".into(),
        CellState::Infeasible | CellState::Edited => {
            let each = cell.optimum.prices.iter().filter(|p| p.passed > 0.0).map(|p| {
                let r = channel(layout, p.response);
                let (side, limit) = if p.sign > 0.0 { ("above", r.upper) } else { ("below", r.lower) };
                let unit = UnitAfter(&r.unit);
                format!("`{}` {:.4}{unit} {side} {}{unit}", r.name, p.passed, limit.unwrap_or(f64::NAN))
            });
            let each: Vec<String> = each.collect();
            let each = each.join(", ");
            match cell.state {
                CellState::Edited => {
                    format!("held as edited, which breaks limits: {each}, uncertainty counted in")
                }
                _ => format!("limits conflict: {each} at the least violation, uncertainty counted in"),
            }
        }
    }
}

/// Why a day ended.
pub(super) fn end_in_words(end: &DayEnd) -> String {
    match end {
        DayEnd::Done => "the day went to its end".into(),
        DayEnd::BedTime => "the bed time was used up".into(),
        DayEnd::Unusable(notes) => {
            format!("the day was given up after many points in a row that cannot be used ({notes})")
        }
        DayEnd::Refused(words) => format!("the plant refused to go on: {words}"),
    }
}

/// Unit of what is minimised; empty where that is a weighted sum.
pub(super) fn objective_unit(found: &Mapped) -> String {
    let weighted: Vec<_> = found.layout.responses.iter().filter(|r| r.weight != 0.0).collect();
    match weighted.as_slice() {
        [one] if one.weight == 1.0 => one.unit.clone(),
        _ => String::new(),
    }
}
