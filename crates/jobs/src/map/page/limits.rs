//! Limits in the maps of the page.

use dynocal_calib::steady::grid::{Cell, CellState};
use dynocal_report::HeatMap;

use crate::map::result::Mapped;

/// The limit of response `k`: a line where it acts, that is, has a price, from some demand on up to the highest, or from some demand down, at each value of the given
/// channel; points where it acts elsewhere.
pub(super) fn drawn(found: &Mapped, k: usize, map: HeatMap) -> HeatMap {
    let acts = |c: &Cell| {
        let small = 1e-6 * c.optimum.objective.abs();
        c.optimum.prices.iter().any(|p| p.response == k && p.saves > small)
    };
    let optimal: Vec<(f64, f64, bool)> = found
        .cells
        .iter()
        .filter(|c| c.state == CellState::Optimal && c.at.len() > 1)
        .map(|c| (c.at[1], c.at[0], acts(c)))
        .collect();
    where_it_acts(&optimal).map_or(map.clone(), |(words, line, x, y)| {
        if line { map.overlay_line(words, x, y) } else { map.overlay(words, x, y) }
    })
}

/// Words, whether a line, and where; of cells (given, demand, whether the limit acts there). None where it acts nowhere.
fn where_it_acts(cells: &[(f64, f64, bool)]) -> Option<(&'static str, bool, Vec<f64>, Vec<f64>)> {
    let acting = || cells.iter().filter(|c| c.2);
    let mut given: Vec<f64> = acting().map(|c| c.0).collect();
    given.sort_by(f64::total_cmp);
    given.dedup();
    let ends = |g: f64| {
        let column = acting().filter(move |c| c.0 == g).map(|c| c.1);
        column.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, u), d| (l.min(d), u.max(d)))
    };
    let all = |inside: &dyn Fn((f64, f64), f64) -> bool| {
        cells.iter().filter(|c| given.contains(&c.0)).all(|c| c.2 == inside(ends(c.0), c.1))
    };
    if given.is_empty() {
        return None;
    }
    // Broken where it acts nowhere; one place makes no line.
    let line = |end: &dyn Fn((f64, f64)) -> f64| {
        let mut x: Vec<f64> = cells.iter().map(|c| c.0).collect();
        x.sort_by(f64::total_cmp);
        x.dedup();
        let y = x.iter().map(|g| if given.contains(g) { end(ends(*g)) } else { f64::NAN }).collect();
        (given.len() > 1, x, y)
    };
    if all(&|(least, _), demand| demand >= least) {
        let (several, x, y) = line(&|(least, _)| least);
        return Some(("the limit acts from here up", several, x, y));
    }
    if all(&|(_, most), demand| demand <= most) {
        let (several, x, y) = line(&|(_, most)| most);
        return Some(("the limit acts from here down", several, x, y));
    }
    let (x, y) = acting().map(|c| (c.0, c.1)).unzip();
    Some(("the limit acts", false, x, y))
}

#[cfg(test)]
mod tests {
    use super::where_it_acts;

    /// Knock acts at high load, unsteady combustion at light load, something else in between.
    #[test]
    fn a_limit_is_drawn_where_it_acts() {
        let cells = |acts: &dyn Fn(f64, f64) -> bool| -> Vec<(f64, f64, bool)> {
            let each = |k: usize| (1000.0 * (k % 2 + 1) as f64, 40.0 * (k / 2 + 1) as f64);
            (0..6).map(each).map(|(n, y)| (n, y, acts(n, y))).collect()
        };
        let drawn = |acts: &dyn Fn(f64, f64) -> bool| where_it_acts(&cells(acts));
        let up = ("the limit acts from here up", true, vec![1000.0, 2000.0], vec![80.0, 120.0]);
        assert_eq!(drawn(&|n, y| y >= 40.0 + 0.04 * n), Some(up));
        let down = ("the limit acts from here down", true, vec![1000.0, 2000.0], vec![80.0, 40.0]);
        assert_eq!(drawn(&|n, y| y <= 120.0 - 0.04 * n), Some(down));
        let between = ("the limit acts", false, vec![2000.0], vec![80.0]);
        assert_eq!(drawn(&|n, y| n > 1500.0 && y == 80.0), Some(between));
        assert_eq!(drawn(&|_, _| false), None);
        // Nothing goes through a speed at which it does not act, and one place is no line.
        let cells = [1000.0, 2000.0, 3000.0].map(|n| (n, 40.0, n != 2000.0));
        let (_, line, x, y) = where_it_acts(&cells).unwrap();
        assert!(line && x.len() == 3 && y[0] == 40.0 && y[1].is_nan() && y[2] == 40.0, "{x:?} {y:?}");
        assert!(!where_it_acts(&cells[1..]).unwrap().1);
    }
}
