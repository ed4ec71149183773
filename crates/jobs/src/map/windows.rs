//! What was measured along lines, window by window.

use dynocal_calib::steady::layout::{FactorKind, Layout};
use dynocal_calib::steady::station::{Leg, SweepRow};
use dynocal_calib::steady::trim::Way;

/// A window of a sweep.
pub(super) struct Window {
    pub(super) line: usize,
    pub(super) way: Way,
    pub(super) row: SweepRow,
}

impl Window {
    /// Axes as they were asked for, where a demand that is one of them was not followed, and with its input `at_end` where that is asked.
    fn missed(&self, layout: &Layout, at_end: bool) -> Option<Vec<f64>> {
        let mut at = self.row.factors[..layout.axes].to_vec();
        let mut missed = false;
        for (k, f) in layout.factors[..layout.axes].iter().enumerate() {
            if let FactorKind::Demand(l) = f.kind {
                missed |= !self.row.followed[l] && (self.row.at_end[l] || !at_end);
                at[k] = self.row.asked[l];
            }
        }
        missed.then_some(at)
    }
}

/// Places, as they were asked for, whose demand `windows` show not to be reached: its input stood at an end, or it was not followed on both sides of a
/// turn, so that more of the input came too late or to nothing.
pub(super) fn missed(layout: &Layout, windows: &[Window]) -> Vec<Vec<f64>> {
    let turn = |k: usize, next: usize| {
        let pair = windows.get(k).zip(windows.get(next));
        let turns = |(a, b): &(&Window, &Window)| a.line == b.line && a.way.up * b.way.up < 0.0;
        pair.filter(turns).is_some_and(|(_, b)| b.missed(layout, false).is_some())
    };
    let one = |(k, w): (usize, &Window)| {
        let turned = turn(k, k + 1) || k > 0 && turn(k, k - 1);
        w.missed(layout, !turned)
    };
    windows.iter().enumerate().filter_map(one).collect()
}

/// Ways of legs that begin at `from`: 1 up the first axis, -1 down, 0 where it rests, and when each begins in s.
fn ways(from: f64, legs: &[Leg]) -> Vec<(f64, f64)> {
    let mut ways: Vec<(f64, f64)> = Vec::new();
    let (mut now, mut end_s) = (from, 0.0);
    for leg in legs {
        let gone = leg.to[0] - now;
        let up = if gone == 0.0 { 0.0 } else { gone.signum() };
        if ways.last().is_none_or(|w| w.0 != up) {
            ways.push((up, end_s));
        }
        (now, end_s) = (leg.to[0], end_s + leg.seconds);
    }
    ways
}

/// Adds the windows of a line that was gone along from `from` on, with those of a rest; none in which it turned.
pub(super) fn keep(
    line: usize,
    (from, legs): (&[f64], &[Leg]),
    found: Vec<SweepRow>,
    window_s: f64,
    rows: &mut Vec<Window>,
) {
    // As long as they came out in whole samples.
    let window_s = match &found[..] {
        [a, b, ..] => b.at_s - a.at_s,
        _ => window_s,
    };
    let Some(begun_s) = found.first().map(|r| r.at_s - window_s) else { return };
    let ways = ways(from[0], legs);
    for row in found {
        let (last_s, first_s) = (row.at_s - begun_s, row.at_s - begun_s - window_s);
        // What is rounded to samples is no turn.
        let Some(k) = ways.iter().rposition(|w| w.1 <= first_s + 0.1 * window_s) else { continue };
        if ways.get(k + 1).is_some_and(|next| last_s - 0.1 * window_s > next.1) {
            continue;
        }
        let (up, since) = ways[k];
        let before = k.checked_sub(1).map(|b| ways[b]).filter(|b| b.0 != 0.0);
        let before_s = before.map_or(0.0, |b| since - b.1);
        let since_s = (first_s - since).max(0.0);
        rows.push(Window { line, way: Way { up, since_s, before_s, window_s }, row });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A rest of 4 s, 9 s up, 5 s down, in windows of 2 s: the one with the turn is left out, the others know how long it had gone their way, and
    /// the other one before.
    #[test]
    fn windows_know_since_when_they_go_their_way() {
        let leg = |to: f64, seconds| Leg { to: vec![to], driven: Vec::new(), seconds };
        let legs = [leg(0.0, 4.0), leg(0.5, 4.0), leg(1.0, 5.0), leg(0.0, 5.0)];
        assert_eq!(ways(0.0, &legs), [(0.0, 0.0), (1.0, 4.0), (-1.0, 13.0)]);
        let row = |k: usize| SweepRow {
            factors: Vec::new(),
            responses: Vec::new(),
            asked: Vec::new(),
            leg: 0,
            at_end: Vec::new(),
            followed: Vec::new(),
            at_s: 100.0 + 2.0 * (k + 1) as f64,
        };
        let of = |count: usize| {
            let mut rows = Vec::new();
            keep(3, (&[0.0], &legs), (0..count).map(row).collect(), 2.0, &mut rows);
            assert!(rows.iter().all(|w| w.line == 3 && w.way.window_s == 2.0));
            rows.iter().map(|w| (w.way.up, w.way.since_s, w.way.before_s)).collect::<Vec<_>>()
        };
        let rest = [(0.0, 0.0, 0.0), (0.0, 2.0, 0.0)];
        let up = [&rest[..], &[(1.0, 0.0, 0.0), (1.0, 2.0, 0.0), (1.0, 4.0, 0.0), (1.0, 6.0, 0.0)]].concat();
        assert_eq!(of(9), [&up[..], &[(-1.0, 1.0, 9.0), (-1.0, 3.0, 9.0)]].concat());
        assert_eq!(of(6), up);
        assert!(of(0).is_empty() && of(1) == rest[..1]);
    }
}
