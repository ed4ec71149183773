//! Points of lines: what was measured there and back at the same place, averaged, or at rest.
//!
//! The lag of the way is opposite there and back, so that the mean of the two is what is at rest, as far as both were followed:
//!
//! ```text
//! p(z) = ( there(z) + back(z) ) / 2        z: a place along the first axis; back: between the two windows around it
//! ```
//!
//! Where lines rest at each value (`bed.sweep.rest_s`) a rest is a point: the mean of those of its windows that count, but for the first, in which the bed comes to it.
//!
//! Where a driven input was another there than back by more than a tenth, its loop was still moving it, and the mean says nothing. The others stand where
//! the maps lie, and are about as many as the points of the day: the maps of driven inputs are learnt again with them, and what is minimised is by those of the first lines.

use dynocal_calib::steady::day::{DayPoint, Purpose};
use dynocal_calib::steady::layout::Layout;
use dynocal_calib::steady::station::SteadyPoint;

use super::windows::Window;

/// Of the windows that were followed there one in so many is taken: those beside each other say the same.
const ONE_IN: usize = 2;

/// Share of a driven input by which it may be another there than back.
const ALIKE: f64 = 0.1;

/// Points of the lines that `windows` were measured along: of each of their `rests`, or of there and back.
pub(super) fn points(layout: &Layout, windows: &[&Window], rests: bool) -> Vec<DayPoint> {
    let counts = |w: &&&Window| w.row.followed.iter().all(|f| *f) && !w.row.at_end.contains(&true);
    if rests {
        let rested = windows.iter().filter(counts).filter(|w| w.way.up == 0.0 && !w.settles());
        let rested: Vec<&&Window> = rested.collect();
        return rested.chunk_by(|a, b| a.belongs_to(b)).map(mean).collect();
    }
    let there = windows.iter().filter(counts).filter(|w| w.way.up > 0.0).step_by(ONE_IN);
    let back: Vec<&&Window> = windows.iter().filter(counts).filter(|w| w.way.up < 0.0).collect();
    there.filter_map(|w| between(layout, w, &back)).collect()
}

/// The mean of the windows of a rest.
fn mean(rest: &[&&Window]) -> DayPoint {
    let of = |values: &dyn Fn(&Window) -> &[f64]| -> Vec<f64> {
        let one = |k: usize| rest.iter().map(|w| values(w)[k]).sum::<f64>() / rest.len() as f64;
        (0..values(rest[0]).len()).map(one).collect()
    };
    point(of(&|w| &w.row.factors), of(&|w| &w.row.responses), rest[0].row.asked.len(), rest[0].row.at_s)
}

/// A point of a line.
fn point(factors: Vec<f64>, responses: Vec<f64>, demands: usize, at_s: f64) -> DayPoint {
    let point = SteadyPoint {
        asked: factors.clone(),
        responses,
        factors,
        errors: vec![0.0; demands],
        usable: true,
        note: String::new(),
        touched: Vec::new(),
        saturated: Vec::new(),
        at_s,
        used_s: 0.0,
    };
    DayPoint { purpose: Purpose::Optimum, point }
}

/// The mean of a window there and of what was measured on the way back at the same place of the same pass; none where nothing was on both sides of it.
fn between(layout: &Layout, there: &Window, back: &[&&Window]) -> Option<DayPoint> {
    let at = there.row.factors[0];
    let line = || back.iter().filter(|w| w.pass == there.pass);
    let below = line().filter(|w| w.row.factors[0] <= at);
    let below = below.max_by(|a, b| a.row.factors[0].total_cmp(&b.row.factors[0]))?;
    let above = line().filter(|w| w.row.factors[0] >= at);
    let above = above.min_by(|a, b| a.row.factors[0].total_cmp(&b.row.factors[0]))?;
    // What lies between windows that are farther apart was not followed, or did not count.
    if (above.row.at_s - below.row.at_s).abs() > 1.5 * there.way.window_s {
        return None;
    }
    let (low, high) = (below.row.factors[0], above.row.factors[0]);
    let share = if high > low { (at - low) / (high - low) } else { 0.0 };
    let mean = |of: &dyn Fn(&Window) -> &[f64]| -> Vec<f64> {
        let (a, b, c) = (of(below), of(above), of(there));
        (0..c.len()).map(|k| 0.5 * (c[k] + a[k] + share * (b[k] - a[k]))).collect()
    };
    let responses = mean(&|w| &w.row.responses);
    let moves = |k: usize| (there.row.responses[k] - responses[k]).abs() > 0.5 * ALIKE * responses[k].abs();
    // Driven inputs are the first of the responses.
    if (0..layout.loops.len()).any(moves) {
        return None;
    }
    let factors = mean(&|w| &w.row.factors);
    Some(point(factors, responses, layout.problem.demands.len(), there.row.at_s))
}

#[cfg(test)]
mod tests {
    use super::*;
    use dynocal_calib::problem::CalibrationProblem;
    use dynocal_calib::steady::station::SweepRow;
    use dynocal_calib::steady::trim::Way;
    use dynocal_ident::pi::PiGains;
    use dynocal_ident::plan::PlanLoop;

    /// `u = 0.2 y + 0.55` going up and `- 0.55` going down, in windows at other places: the mean is `u = 0.2 y`. Windows that were not followed or at an end
    /// tell nothing, nor does a line that was gone one way, nor those up to 55 where the two differ by more than a tenth.
    #[test]
    fn the_lag_of_the_way_is_not_in_the_points_of_a_line() {
        let layout = Layout {
            problem: CalibrationProblem::thesis(),
            loops: vec![PlanLoop {
                output: "torque".into(),
                input: "throttle".into(),
                gains: PiGains { ki: 1.0, kp: 1.0 },
                closed: true,
                schedule: Vec::new(),
            }],
            factors: Vec::new(),
            axes: 1,
            held: std::collections::BTreeMap::new(),
            responses: Vec::new(),
            sample_time_s: 0.1,
        };
        let window = |line: usize, up: f64, y: f64, fine: [bool; 2]| Window {
            line,
            pass: line,
            way: Way { up, window_s: 6.0, ..Way::default() },
            last: false,
            halfway: false,
            row: SweepRow {
                factors: vec![y, 1500.0],
                responses: vec![0.2 * y + 0.55 * up],
                asked: vec![y],
                leg: 0,
                at_end: vec![!fine[0]],
                followed: vec![fine[1]],
                behind: Vec::new(),
                at_s: y,
            },
        };
        let fine = [true, true];
        let mut all: Vec<Window> = (0..10).map(|k| window(0, 1.0, 40.0 + 6.0 * f64::from(k), fine)).collect();
        all.extend((0..10).map(|k| window(0, -1.0, 97.0 - 6.0 * f64::from(k), fine)));
        all.extend([window(0, 1.0, 100.0, [true, false]), window(0, 1.0, 106.0, [false, true])]);
        all.extend((0..4).map(|k| window(1, 1.0, 40.0 + 6.0 * f64::from(k), fine)));
        // What lies on both sides of 88 on this way back was not followed: what is between them is a chord.
        all.push(window(2, 1.0, 88.0, fine));
        all.extend(
            [103.0, 97.0, 91.0, 85.0, 79.0, 73.0]
                .map(|y| window(2, -1.0, y, [true, !(80.0..95.0).contains(&y)])),
        );
        // A rest is a point by itself: those of its windows that count, but for the first.
        let rest = |pass: usize, since_s: f64, y: f64, fine: [bool; 2]| {
            let way = Way { since_s, window_s: 2.0, ..Way::default() };
            Window { way, ..window(pass, 0.0, y, fine) }
        };
        let rests = [
            rest(7, 0.0, 90.0, fine),
            rest(7, 2.0, 50.0, fine),
            rest(7, 4.0, 52.0, fine),
            rest(8, 2.0, 60.0, fine),
            rest(8, 4.0, 62.0, [false, true]),
        ];
        let rests: Vec<&Window> = rests.iter().collect();
        let found = points(&layout, &rests, true);
        let at: Vec<[f64; 2]> = found.iter().map(|p| [p.point.factors[0], p.point.responses[0]]).collect();
        assert_eq!(at, [[51.0, 10.2], [60.0, 12.0]]);
        assert!(points(&layout, &rests, false).is_empty());
        let found = points(&layout, &all.iter().collect::<Vec<_>>(), false);
        let at: Vec<f64> = found.iter().map(|p| p.point.factors[0].round()).collect();
        assert_eq!(at, [64.0, 76.0, 88.0]);
        for p in &found {
            assert!(
                (p.point.responses[0] - 0.2 * p.point.factors[0]).abs() < 1e-9 && p.point.usable,
                "{p:?}"
            );
        }
    }
}
