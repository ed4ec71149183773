//! What was measured along lines, window by window.

use dynocal_calib::steady::layout::Layout;
use dynocal_calib::steady::station::{Leg, SweepRow};
use dynocal_calib::steady::trim::Way;

/// A window of a sweep.
#[derive(Clone)]
pub(super) struct Window {
    pub(super) line: usize,
    /// Which time that the bed went there and back it was, over all lines: parts of lines are gone along again.
    pub(super) pass: usize,
    pub(super) way: Way,
    /// Whether it is the last of a rest: as near to it as the bed came.
    pub(super) last: bool,
    /// Whether it is of a rest half way between values of the first axis: whether the demand is reached there says nothing that the value above does not say.
    pub(super) halfway: bool,
    pub(super) row: SweepRow,
}

impl Window {
    /// Whether it is of the same rest, or way, as `other`.
    pub(super) fn belongs_to(&self, other: &Window) -> bool {
        self.pass == other.pass
            && self.way.up == other.way.up
            && (self.way.up != 0.0 || self.row.leg == other.row.leg)
    }

    /// Whether it is the first of a rest, in which the bed comes to it.
    pub(super) fn settles(&self) -> bool {
        self.way.up == 0.0 && self.way.since_s < 0.9 * self.way.window_s
    }

    /// How much it says of the inputs that hold the demands: all where each was followed; less at the end of a rest where one that is `held` (no axis) was
    /// not, the less the farther it was missed; else nothing. What a lambda that is 0.4 % rich does to a throttle is less than its map misses where nothing else is
    /// known.
    pub(super) fn weight(&self, held: &dyn Fn(usize) -> bool) -> f64 {
        let one = |(k, followed): (usize, &bool)| match self.row.behind.get(k) {
            _ if *followed => 1.0,
            Some(behind) if self.last && held(k) && *behind > 1.0 => behind.powi(-2),
            _ => 0.0,
        };
        self.row.followed.iter().enumerate().map(one).product()
    }

    /// Axes as they were asked for.
    pub(super) fn asked(&self, layout: &Layout) -> Vec<f64> {
        let mut at = self.row.factors[..layout.axes].to_vec();
        for (k, l) in layout.demanded() {
            at[k] = self.row.asked[l];
        }
        at
    }
}

/// Numbers of the `windows` whose demand was not reached: it was not followed, and its input stood at an end, or it fell short at the end of a
/// rest to which more of it was asked, or before and behind an upper turn without one, so that more of the input came too late or to nothing. While the bed comes
/// to rest an input may touch its end and leave it again.
pub(super) fn missed(layout: &Layout, windows: &[Window]) -> Vec<usize> {
    let demands: Vec<(usize, usize)> = layout.demanded().collect();
    let short = |w: &Window| {
        let falls =
            |(k, l): &(usize, usize)| !w.row.followed[*l] && w.row.factors[*k].abs() < w.row.asked[*l].abs();
        demands.iter().any(falls)
    };
    let ends = |w: &Window| demands.iter().any(|(_, l)| !w.row.followed[*l] && w.row.at_end[*l]);
    let at_end = |w: &Window| !w.settles() && ends(w);
    let rested = |k: usize| {
        let w = &windows[k];
        let last = windows.get(k + 1).is_none_or(|next| !next.belongs_to(w));
        w.way.up == 0.0 && w.way.before[1].0 > 0.0 && last && short(w)
    };
    let turns = |first: usize| {
        let Some([a, b]) = windows.get(first..first + 2) else { return false };
        let turned = a.line == b.line && a.way.up > 0.0 && b.way.up < 0.0;
        turned && b.row.at_s - a.row.at_s < 3.0 * a.way.window_s && short(a) && short(b)
    };
    let one = |k: &usize| at_end(&windows[*k]) || rested(*k) || turns(*k) || *k > 0 && turns(k - 1);
    (0..windows.len()).filter(one).collect()
}

/// Which `windows` hold the demand of loop `l`, factor `k`, in passing: on one way it falls short of what is asked for, comes nearer, and goes beyond, farther from
/// window to window (or the other way round). There the loop is on its way, and its input is not what the demand takes. Of a rest its own windows tell that.
pub(super) fn in_passing(windows: &[Window], (k, l): (usize, usize)) -> Vec<bool> {
    let missed = |w: &Window| w.row.factors[k] - w.row.asked[l];
    let run = |a: &Window, b: &Window| a.belongs_to(b) && a.row.followed[l] && b.row.followed[l];
    let (mut found, mut begin) = (Vec::new(), 0);
    for all in windows.chunk_by(run) {
        let end = begin + all.len();
        // With those before and behind, where these belong to it and were not followed.
        let around = begin.checked_sub(1).and_then(|first| windows.get(first..=end)).unwrap_or(&[]);
        let passes = all[0].row.followed[l]
            && around
                .iter()
                .all(|w| w.pass == all[0].pass && (all[0].way.up != 0.0 || w.belongs_to(&all[0])))
            && [around.first(), around.last()].into_iter().flatten().all(|w| !w.row.followed[l])
            && around.first().zip(around.last()).is_some_and(|(a, b)| missed(a) * missed(b) < 0.0)
            && (around.is_sorted_by(|a, b| missed(a) < missed(b))
                || around.is_sorted_by(|a, b| missed(a) > missed(b)));
        found.extend(all.iter().map(|_| passes));
        begin = end;
    }
    found
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

/// Adds the windows of a line that was gone along from `from` on, with those of a rest; none in which it turned. The clock: when it began, and length of a window.
pub(super) fn keep(
    line: usize,
    (from, legs): (&[f64], &[Leg]),
    (found, clock_s): (Vec<SweepRow>, Option<[f64; 2]>),
    window_s: f64,
    rows: &mut Vec<Window>,
) {
    let pass = rows.last().map_or(0, |w| w.pass + 1);
    let [begun_s, window_s] = match (clock_s, &found[..]) {
        (Some(clock_s), _) => clock_s,
        (None, [a, b, ..]) => [2.0 * a.at_s - b.at_s, b.at_s - a.at_s],
        (None, [a]) => [a.at_s - window_s, window_s],
        (None, []) => return,
    };
    let (ways, all_s) = (ways(from[0], legs), legs.iter().map(|l| l.seconds).sum::<f64>());
    for row in found {
        let (last_s, first_s) = (row.at_s - begun_s, row.at_s - begun_s - window_s);
        // What is rounded to samples is no turn.
        let Some(k) = ways.iter().rposition(|w| w.1 <= first_s + 0.1 * window_s) else { continue };
        if ways.get(k + 1).is_some_and(|next| last_s - 0.1 * window_s > next.1) {
            continue;
        }
        let (up, since) = ways[k];
        let gone = |back: usize| {
            let k = k.checked_sub(back)?;
            Some((ways[k].0, ways[k + 1].1 - ways[k].1))
        };
        let before = [2, 1].map(|back| gone(back).unwrap_or((0.0, 0.0)));
        let since_s = (first_s - since).max(0.0);
        let end_s = ways.get(k + 1).map_or(all_s, |next| next.1);
        let last = up == 0.0 && last_s + 0.1 * window_s > end_s;
        rows.push(Window {
            line,
            pass,
            way: Way { up, since_s, before, window_s },
            last,
            halfway: false,
            row,
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dynocal_calib::problem::CalibrationProblem;
    use dynocal_calib::steady::layout::{Factor, FactorKind};

    /// A rest of 4 s, 9 s up, 5 s down, in windows of 2 s: the one with the turn is left out, the others know how long it had gone their way, and
    /// the other one before.
    #[test]
    fn windows_know_since_when_they_go_their_way() {
        let leg = |to: f64, seconds| Leg { to: vec![to], driven: Vec::new(), gains: Vec::new(), seconds };
        let legs = [leg(0.0, 4.0), leg(0.5, 4.0), leg(1.0, 5.0), leg(0.0, 5.0)];
        assert_eq!(ways(0.0, &legs), [(0.0, 0.0), (1.0, 4.0), (-1.0, 13.0)]);
        let row = |k: usize| SweepRow {
            factors: Vec::new(),
            responses: Vec::new(),
            asked: Vec::new(),
            leg: 0,
            at_end: Vec::new(),
            followed: Vec::new(),
            behind: Vec::new(),
            at_s: 100.0 + 2.0 * (k + 1) as f64,
        };
        let of = |count: usize| {
            let mut rows = Vec::new();
            keep(3, (&[0.0], &legs), ((0..count).map(row).collect(), None), 2.0, &mut rows);
            assert!(rows.iter().all(|w| w.line == 3 && w.way.window_s == 2.0));
            rows.iter().map(|w| (w.way.up, w.way.since_s, w.way.before)).collect::<Vec<_>>()
        };
        let none = (0.0, 0.0);
        let rest = [0.0, 2.0].map(|t| (0.0, t, [none, none]));
        let up = [0.0, 2.0, 4.0, 6.0].map(|t| (1.0, t, [none, (0.0, 4.0)]));
        let up = [&rest[..], &up[..]].concat();
        let down = [1.0, 3.0].map(|t| (-1.0, t, [(0.0, 4.0), (1.0, 9.0)]));
        assert_eq!(of(9), [&up[..], &down[..]].concat());
        assert_eq!(of(6), up);
        assert!(of(0).is_empty() && of(1) == rest[..1]);
        // Of a rest that is no whole number of windows those that end with it, by the clock of the path.
        let legs = [leg(0.0, 5.0), leg(1.0, 1.0), leg(1.0, 5.0)];
        let ends = [3.0, 5.0, 9.0, 11.0].map(|t| SweepRow { at_s: 100.0 + t, ..row(0) });
        let mut rows = Vec::new();
        keep(3, (&[0.0], &legs), (ends.to_vec(), Some([100.0, 2.0])), 2.0, &mut rows);
        let found: Vec<(f64, bool)> = rows.iter().map(|w| (w.way.since_s, w.last)).collect();
        assert_eq!(found, [(1.0, false), (3.0, true), (1.0, false), (3.0, true)]);
        assert!(rows.iter().all(|w| w.way.up == 0.0));
    }

    /// At the end of a rest a held demand that is missed by twice of what still counts leaves a quarter; in other windows, and where it is a demand along which lines go,
    /// nothing is left, and neither is of what older versions kept.
    #[test]
    fn a_held_demand_that_is_missed_a_little_leaves_something_of_the_end_of_a_rest() {
        let of = |behind: &[f64], last: bool| {
            let w = window(0, 0.0, 100.0, 100.0, false);
            let followed = behind.iter().map(|b| *b <= 1.0).collect();
            let w = Window { last, row: SweepRow { followed, behind: behind.to_vec(), ..w.row }, ..w };
            w.weight(&|k| k > 0)
        };
        assert_eq!([of(&[0.5, 0.9], true), of(&[0.5, 0.9], false)], [1.0; 2]);
        assert_eq!([of(&[0.5, 2.0], true), of(&[0.5, 2.0], false), of(&[2.0, 0.5], true)], [0.25, 0.0, 0.0]);
        assert_eq!(of(&[0.5, 2.0, 4.0], true), 0.25 / 16.0);
        let w = window(0, 0.0, 100.0, 80.0, false);
        let old = Window { last: true, row: SweepRow { behind: Vec::new(), ..w.row }, ..w };
        assert_eq!(old.weight(&|_| true), 0.0);
    }

    fn one_axis() -> Layout {
        let f = Factor {
            name: "y".into(),
            unit: "Nm".into(),
            lower: 0.0,
            upper: 200.0,
            kind: FactorKind::Demand(0),
        };
        Layout {
            problem: CalibrationProblem::thesis(),
            loops: Vec::new(),
            factors: vec![f],
            axes: 1,
            held: std::collections::BTreeMap::new(),
            responses: Vec::new(),
            sample_time_s: 0.1,
        }
    }

    /// A window of a way `up` that was asked for `asked` and gave `got`, 2 s after the one before.
    fn window(k: usize, up: f64, asked: f64, got: f64, at_end: bool) -> Window {
        let before = [(0.0, 0.0), if up == 0.0 { (1.0, 40.0) } else { (0.0, 0.0) }];
        let way = Way { up, since_s: 0.0, before, window_s: 2.0 };
        let row = SweepRow {
            factors: vec![got],
            responses: Vec::new(),
            asked: vec![asked],
            leg: 0,
            at_end: vec![at_end],
            followed: vec![(asked - got).abs() < 5.0],
            behind: vec![(asked - got).abs() / 5.0],
            at_s: 2.0 * k as f64,
        };
        Window { line: 0, pass: 0, way, last: false, halfway: false, row }
    }

    /// A loop that comes back from the end of its input: short, there in passing, beyond, and there again. One that was short and stays there is not
    /// passing, nor is one that was there at the end of its rest.
    #[test]
    fn a_demand_that_is_passed_through_is_not_held() {
        let back = [(160.0, 150.0), (150.0, 146.0), (140.0, 142.0), (130.0, 139.0), (120.0, 121.0)];
        let of = |all: &[(f64, f64)], first_up: f64| {
            let up = |k: usize| if k == 0 { first_up } else { -1.0 };
            let one = |(k, (asked, got)): (usize, &(f64, f64))| window(k, up(k), *asked, *got, false);
            in_passing(&all.iter().enumerate().map(one).collect::<Vec<_>>(), (0, 0))
        };
        assert_eq!(of(&back, -1.0), [false, true, true, false, false]);
        assert_eq!(of(&back, 0.0), [false, true, true, false, false]);
        assert_eq!(of(&back[..3], -1.0), [false; 3]);
        let rested = [(160.0, 158.0), (150.0, 146.0), (140.0, 142.0), (130.0, 139.0)];
        assert_eq!(of(&rested, 0.0), [false; 4]);
        // One that was held well after it had fallen short, and went beyond at last.
        let held = [(160.0, 150.0), (150.0, 149.0), (140.0, 141.0), (130.0, 129.5), (120.0, 128.0)];
        assert_eq!(of(&held, -1.0), [false; 5]);
        // Another pass is another story, and below zero less is beyond.
        let mut apart: Vec<Window> = Vec::new();
        for (k, (asked, got)) in back.iter().enumerate() {
            apart.push(Window { pass: k / 3, ..window(k, -1.0, *asked, *got, false) });
        }
        assert_eq!(in_passing(&apart, (0, 0)), [false; 5]);
        let below: Vec<(f64, f64)> = back.iter().map(|(a, g)| (-a, -g)).collect();
        assert_eq!(of(&below, -1.0), [false, true, true, false, false]);
        assert!(in_passing(&[], (0, 0)).is_empty());
    }

    /// Three rests one after the other: one that stays short was not reached, whatever the input touched while the bed came to the others; none is in passing.
    #[test]
    fn a_rest_is_judged_by_its_own_windows() {
        let rest = |leg: usize, since_s: f64, (asked, got): (f64, f64), at_end: bool| {
            let w = window(leg, 0.0, asked, got, at_end);
            let way = Way { since_s, before: [(0.0, 8.0), (1.0, 2.0)], ..w.way };
            Window { way, row: SweepRow { leg, ..w.row }, ..w }
        };
        let all = [
            rest(0, 0.0, (100.0, 94.0), true),
            rest(0, 2.0, (100.0, 99.0), false),
            rest(2, 0.0, (120.0, 108.0), false),
            rest(2, 2.0, (120.0, 114.0), false),
            rest(4, 0.0, (140.0, 150.0), false),
            rest(4, 2.0, (140.0, 141.0), false),
        ];
        assert_eq!(missed(&one_axis(), &all), [3]);
        assert_eq!(in_passing(&all, (0, 0)), [false; 6]);
        // Without rests of their own: short before, beyond after.
        let one: Vec<Window> =
            all.into_iter().map(|w| Window { row: SweepRow { leg: 0, ..w.row }, ..w }).collect();
        assert!(missed(&one_axis(), &one).is_empty());
    }

    #[test]
    fn a_demand_that_falls_short_at_an_upper_turn_was_not_reached() {
        let layout = one_axis();
        let there = |top: f64| {
            [
                (1.0, 120.0, 119.0),
                (1.0, 140.0, 130.0),
                (0.0, 160.0, 149.0),
                (0.0, 160.0, top),
                (-1.0, 158.0, top),
            ]
        };
        let of = |all: &[(f64, f64, f64)], at_end: usize| -> Vec<usize> {
            let one =
                |(k, (up, asked, got)): (usize, &(f64, f64, f64))| window(k, *up, *asked, *got, k == at_end);
            missed(&layout, &all.iter().enumerate().map(one).collect::<Vec<_>>())
        };
        // On the way a loop may be behind, and at the begin of the rest; at its end it has come no further; with its input at an end it could not.
        assert_eq!(of(&there(149.0), 9), [3]);
        assert_eq!(of(&there(158.0), 9), [0; 0]);
        assert_eq!(of(&there(158.0), 1), [1]);
        // Above what was asked for nothing is missed, nor about a lower turn.
        assert_eq!(of(&[(0.0, 40.0, 49.0), (1.0, 42.0, 49.0)], 9), [0; 0]);
        assert_eq!(of(&[(-1.0, 40.0, 30.0), (1.0, 42.0, 30.0)], 9), [0; 0]);
        // Without a rest it has come no further before and behind.
        assert_eq!(of(&[(1.0, 140.0, 130.0), (1.0, 160.0, 149.0), (-1.0, 158.0, 149.0)], 9), [1, 2]);
        let apart = [window(0, 1.0, 160.0, 149.0, false), window(20, -1.0, 158.0, 149.0, false)];
        assert!(missed(&layout, &apart).is_empty());
        assert_eq!(window(0, 1.0, 160.0, 149.0, false).asked(&layout), [160.0]);
    }
}
