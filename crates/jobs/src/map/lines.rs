//! Lines of the finished maps on the bed, and how it goes along them.
//!
//! Free inputs follow the maps as an ECU will interpolate them; driven ones are fed forward with what their maps expect, so that the loops have
//! only the rest to do and outputs that are held stay there. A line is gone there and back, or
//! rests at each value of the first axis on the way there (`bed.sweep.rest_s`): then nothing else of it is measured. It ends where a limit is touched, and goes through
//! cells that hold an optimum only.

use dynocal_calib::steady::cell::Setting;
use dynocal_calib::steady::day::Drift;
use dynocal_calib::steady::grid::{Cell, CellState, corners, interpolate};
use dynocal_calib::steady::layout::Layout;
use dynocal_calib::steady::trim::finer;
use dynocal_numerics::watch::Watch;
use serde::Serialize;

use super::bench::Bench;
use super::drive::Drive;
use super::error::MapError;
use super::halfway;
use super::line::{Half, Line, path};
use super::line_time::{again_s, along_s, beside_s, least_s, pace};
use super::schedule::Schedule;
use super::spec::{MapSpec, SweepSpec};
use super::windows::{Window, keep};

/// What the sweeps were.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Sweeps {
    /// Lines that were planned.
    pub planned: usize,
    /// Lines that were gone to their end.
    pub whole: usize,
    /// Parts of lines that were gone along again, as their maps had become others by what lines showed.
    pub again: usize,
    /// Windows that were measured.
    pub rows: usize,
    /// Windows in which a driven input stood at an end of its range: what was reached there bounds the cells around.
    pub at_ends: usize,
    /// Bed time in s.
    pub bed_s: f64,
    /// How many times as fast as asked lines were gone along at most: 1 where there was time enough.
    pub fastest: f64,
    /// Lines that ended early, in words.
    pub notes: Vec<String>,
}

/// Maps that are gone along.
pub(super) struct Lines<'a> {
    pub(super) spec: &'a MapSpec,
    pub(super) layout: &'a Layout,
    pub(super) setting: &'a Setting<'a>,
    pub(super) axes: &'a [Vec<f64>],
    pub(super) cells: &'a [Cell],
    pub(super) drift: &'a [Drift],
}

/// What sweeps were, and what they measured.
pub(super) type Gone = (Sweeps, Vec<Window>);

/// Share of the range of a free input by which the maps may go past a window that still counts: what cams and the like do to a throttle
/// within it is less than its map misses.
const ASIDE: f64 = 0.05;
/// First and last of the nodes whose settings are not `beside` those that had the same leading `axes` before, with one more on either side; none
/// where all are.
fn others(
    nodes: &[Vec<f64>],
    before: &[Vec<f64>],
    axes: usize,
    beside: &dyn Fn(&[f64], &[f64]) -> bool,
) -> Option<(usize, usize)> {
    let other = |k: &usize| {
        let now = &nodes[*k];
        let same = before.iter().find(|x| x[..axes] == now[..axes]);
        same.is_none_or(|x| !beside(x, now))
    };
    let others: Vec<usize> = (0..nodes.len()).filter(other).collect();
    Some((others.first()?.saturating_sub(1), (others.last()? + 1).min(nodes.len() - 1)))
}

/// Whether the free inputs of two settings are so near that what was measured at one counts at the other.
pub(super) fn beside(layout: &Layout, a: &[f64], b: &[f64]) -> bool {
    let mut free = layout.axes..layout.factors.len();
    free.all(|i| {
        let f = &layout.factors[i];
        (a[i] - b[i]).abs() <= ASIDE * (f.upper - f.lower)
    })
}

/// Whether a line between two `ends` of the first axis begins at the second: the smaller of them where a demand is gone along, else the one that
/// is nearer to `now`.
fn begins_last(demanded: bool, [first, last]: [f64; 2], now: f64) -> bool {
    if demanded { last.abs() < first.abs() } else { (last - now).abs() < (first - now).abs() }
}

/// When lines have to end.
struct Until {
    /// Bed time at which none begins any more, in s.
    bed_s: f64,
    /// Of that, for lines which come later.
    others_s: f64,
    /// Whether none may go on beyond `bed_s`, either.
    firm: bool,
}

/// Of so many lines one is gone along first, the second of each three: what it shows of what is minimised may move the maps before the bed goes along the others.
const FIRST: usize = 3;

impl Lines<'_> {
    /// Goes along some of the lines, one in [`FIRST`], in their share of the time until `bed_s` less what is kept to go along parts again; these lines with what was
    /// measured, nothing where the spec asks for none or the bed cannot.
    ///
    /// # Errors
    /// [`MapError`].
    pub(super) fn begin(
        &self,
        bench: &mut dyn Bench,
        drives: &[Drive],
        bed_s: f64,
        watch: Watch,
    ) -> Result<Option<(Gone, Vec<Line>)>, MapError> {
        let Some(spec) = self.spec.bed.sweep.as_ref().filter(|_| bench.goes_on()) else { return Ok(None) };
        let all = self.lines(spec, drives)?;
        let planned = all.len();
        let each = all.into_iter().enumerate();
        let (first, others): (Vec<_>, Vec<_>) = each.partition(|(k, _)| k % FIRST == FIRST / 2);
        let lines: Vec<Line> = first.into_iter().map(|(_, l)| l).collect();
        if !lines.is_empty() {
            watch.note(&format!("{} of {planned} lines of the maps on the bed", lines.len()));
        }
        let others_s = others.iter().map(|(_, l)| self.line_s(spec, l)).sum();
        let bed_s = bed_s - again_s(self.spec, self.axes);
        let mut swept = (Sweeps { planned, ..Sweeps::default() }, Vec::new());
        let went = self.go(bench, &lines, Until { bed_s, others_s, firm: false }, &mut swept, watch)?;
        Ok(went.then_some((swept, lines)))
    }

    /// Goes along the lines that are not among those `before`, and along the parts of these whose maps are others by now, until `bed_s` is used up, less what is kept to go
    /// along parts again, of which these take half at most. In the end those `before` are all, as they are now.
    ///
    /// # Errors
    /// [`MapError`].
    pub(super) fn go_on(
        &self,
        bench: &mut dyn Bench,
        (drives, before): (&[Drive], &mut Vec<Line>),
        bed_s: f64,
        swept: &mut Gone,
        watch: Watch,
    ) -> Result<(), MapError> {
        let Some(spec) = &self.spec.bed.sweep else { return Ok(()) };
        let all = self.lines(spec, drives)?;
        let gone = |l: &Line| before.iter().any(|b| b.number == l.number);
        let (old, mut lines): (Vec<Line>, Vec<Line>) = all.iter().cloned().partition(gone);
        let parts: Vec<Line> = old.into_iter().filter_map(|l| self.changed(l, before)).collect();
        watch.note(&format!("{} lines of the maps on the bed, {} parts again", lines.len(), parts.len()));
        let (kept_s, parts_s) =
            (again_s(self.spec, self.axes), parts.iter().map(|l| self.line_s(spec, l)).sum::<f64>());
        lines.extend(parts);
        lines.sort_by_key(|l| l.number);
        let bed_s = bed_s - kept_s + parts_s.min(0.5 * kept_s);
        self.go(bench, &lines, Until { bed_s, others_s: 0.0, firm: false }, swept, watch)?;
        swept.0.planned = all.len();
        *before = all;
        Ok(())
    }

    /// Goes along the parts of the lines whose maps are others than those of the lines `before`, until `bed_s` is used up. Windows are added to
    /// those there are; the number of those before.
    ///
    /// # Errors
    /// [`MapError`].
    pub(super) fn again(
        &self,
        bench: &mut dyn Bench,
        (drives, before): (&[Drive], &[Line]),
        bed_s: f64,
        swept: &mut Gone,
        watch: Watch,
    ) -> Result<usize, MapError> {
        let windows = swept.1.len();
        let Some(spec) = &self.spec.bed.sweep else { return Ok(windows) };
        let lines = self.lines(spec, drives)?;
        let parts: Vec<Line> = lines.into_iter().filter_map(|l| self.changed(l, before)).collect();
        if !parts.is_empty() {
            watch.note(&format!("{} parts of lines again: their maps are others now", parts.len()));
            self.go(bench, &parts, Until { bed_s, others_s: 0.0, firm: true }, swept, watch)?;
        }
        Ok(windows)
    }

    /// The part of a line whose free inputs are others than along that of the same number `before`, by more than a window may lie beside the maps,
    /// with a node on either side; none where nothing is.
    fn changed(&self, line: Line, before: &[Line]) -> Option<Line> {
        let old = before.iter().find(|l| l.number == line.number).map_or(&[][..], |l| &l.nodes);
        let beside = |a: &[f64], b: &[f64]| beside(self.layout, a, b);
        let (from, to) = others(&line.nodes, old, self.layout.axes, &beside)?;
        let part = |all: &[Vec<f64>]| all.iter().map(|d| d[from..=to].to_vec()).collect();
        let (driven, gains) = (part(&line.driven), part(&line.gains));
        let halves = line.halves.into_iter().filter(|(k, _)| (from..to).contains(k));
        let halves = halves.map(|(k, half)| (k - from, half)).collect();
        Some(Line { part: true, nodes: line.nodes[from..=to].to_vec(), driven, gains, halves, ..line })
    }

    /// Goes along lines as fast as there is time for them, beginning at the end of the other axis that is nearer to where the bed stands:
    /// oil and walls are a minute and more behind. False where the bed cannot.
    fn go(
        &self,
        bench: &mut dyn Bench,
        lines: &[Line],
        Until { bed_s, others_s, firm }: Until,
        (sweeps, rows): &mut Gone,
        watch: Watch,
    ) -> Result<bool, MapError> {
        let Some(spec) = &self.spec.bed.sweep else { return Ok(false) };
        let (begun_s, window_s) = (bench.used_s(), self.spec.bed.approach.window_s);
        let axis = &self.axes[0];
        let whole = axis[axis.len() - 1] - axis[0];
        let expanded: Vec<Line> = lines.iter().map(Line::expanded).collect();
        let mut lines: Vec<&Line> = expanded.iter().collect();
        if self.nearer_last(&lines, bench.stands_at()) {
            lines.reverse();
        }
        for (k, line) in lines.iter().enumerate() {
            let least_s =
                if firm { least_s(self.spec, spec, (line.nodes.len(), self.length(line))) } else { 0.0 };
            if bench.used_s() + least_s >= bed_s {
                sweeps.notes.push(format!(
                    "{} of {} lines or parts of lines were left out: the bed time was used up",
                    lines.len() - k,
                    lines.len()
                ));
                break;
            }
            watch.fraction(k as f64 / lines.len() as f64);
            let along = |l: &&Line| along_s(spec, (l.nodes.len(), self.length(l)));
            let rest = (lines.len() - k, lines[k..].iter().map(along).sum());
            let pace = pace(self.spec, spec, bed_s - others_s - bench.used_s(), rest);
            sweeps.fastest = sweeps.fastest.max(1.0 / pace);
            sweeps.again += usize::from(line.part);
            let first = self.begins_last(line, bench.stands_at());
            // A limit on the way to one end, or soon behind it, says nothing of the rest: once more from the other end.
            for last in [first, !first] {
                let (from, mut legs) = path((spec, pace), (whole, self.spec.bed.approach.ramp_s), line, last);
                // As the bed goes: what is rounded apart from it adds up over a line.
                let dt = self.layout.sample_time_s;
                legs.iter_mut().for_each(|l| l.seconds = (l.seconds / dt).round().max(1.0) * dt);
                let Some(swept) = bench.sweep(&from, &legs, watch)? else { return Ok(false) };
                let rests = spec.rest_s > 0.0;
                let there = legs.len() + 1 - line.nodes.len();
                let last_leg = swept.rows.last().map(|r| r.leg);
                // In the first half of the way there.
                let soon = last_leg.is_none_or(|leg| 4 * leg < if rests { 2 * there } else { legs.len() });
                let before = rows.len();
                keep(line.number, (&from, &legs), (swept.rows, swept.clock_s), window_s, rows);
                if rests {
                    let gone = rows.split_off(before).into_iter().filter(|w| w.way.up == 0.0);
                    let halfway = |w: &Window| halfway::beside(axis, &legs[w.row.leg]);
                    rows.extend(gone.map(|w| Window { halfway: halfway(&w), ..w }));
                }
                // Nothing is measured on the way back from rests.
                let all = rests && last_leg.is_some_and(|leg| leg >= there);
                let Some(touched) = swept.touched.as_ref().filter(|_| !all) else {
                    sweeps.whole += usize::from(!line.part);
                    break;
                };
                if !soon || last != first || bench.used_s() >= bed_s {
                    sweeps.notes.push(format!("{} ended early: {}", self.named(line), touched.words));
                    break;
                }
            }
        }
        sweeps.rows = rows.len();
        sweeps.at_ends = rows.iter().filter(|w| w.row.at_end.contains(&true)).count();
        sweeps.bed_s += bench.used_s() - begun_s;
        Ok(true)
    }

    /// Whether the maps go through what was measured in a window.
    pub(super) fn goes_through(&self, w: &Window) -> bool {
        let here = interpolate(self.axes, self.cells, &w.row.factors[..self.layout.axes]);
        beside(self.layout, &w.row.factors, &here)
    }

    /// Whether the maps, where a demand of the window was asked for, go through it.
    pub(super) fn asks_for(&self, w: &Window) -> bool {
        beside(self.layout, &w.row.factors, &interpolate(self.axes, self.cells, &w.asked(self.layout)))
    }

    /// Bed time of a line with the way to it, as the spec asks.
    fn line_s(&self, spec: &SweepSpec, line: &Line) -> f64 {
        let values = line.nodes.len() + line.halves.len();
        along_s(spec, (values, self.length(line))) + beside_s(self.spec, spec)
    }

    /// Length of a line over that of the first axis.
    fn length(&self, line: &Line) -> f64 {
        let ends = |first: f64, last: f64| (last - first).abs();
        let (axis, nodes) = (&self.axes[0], &line.nodes);
        ends(nodes[0][0], nodes[nodes.len() - 1][0]) / ends(axis[0], axis[axis.len() - 1])
    }

    fn named(&self, line: &Line) -> String {
        let f = self.layout.factors.get(1);
        match line.other.zip(f) {
            Some((v, f)) => format!("the line at {} {v:.0} {}", f.name, f.unit),
            None => "the line".into(),
        }
    }

    /// Lines along the first axis, each as long as all cells around it hold an optimum.
    fn lines(&self, spec: &SweepSpec, drives: &[Drive]) -> Result<Vec<Line>, MapError> {
        let others: Vec<Option<f64>> = match self.axes.get(1) {
            Some(a) => finer(std::slice::from_ref(a), spec.between)[0].iter().map(|v| Some(*v)).collect(),
            None => vec![None],
        };
        let schedule = Schedule::of(self.layout, self.setting, drives, self.cells)?;
        let line = |(number, other): (usize, Option<f64>)| {
            let place = |t: &f64| -> Vec<f64> { [*t].into_iter().chain(other).collect() };
            let held = |at: &Vec<f64>| {
                corners(self.axes, at).iter().all(|(k, _)| self.cells[*k].state == CellState::Optimal)
            };
            let all: Vec<Vec<f64>> = self.axes[0].iter().map(place).collect();
            let longest = all.split(|at| !held(at)).max_by_key(|run| run.len()).unwrap_or(&[]);
            let nodes: Vec<Vec<f64>> =
                longest.iter().map(|at| interpolate(self.axes, self.cells, at)).collect();
            let driven =
                drives.iter().map(|d| d.say(self.layout, self.setting, &nodes)).collect::<Result<_, _>>()?;
            let gains = schedule.at(self.layout, self.setting, drives, &nodes)?;
            let line = Line { part: false, number, other, nodes, driven, gains, halves: Vec::new() };
            if spec.rest_s > 0.0 { self.with_halves(line, drives, &schedule) } else { Ok(line) }
        };
        let all: Vec<Line> = others.into_iter().enumerate().map(line).collect::<Result<_, MapError>>()?;
        Ok(all.into_iter().filter(|l| l.nodes.len() > 1).collect())
    }

    /// The line with where it rests half way.
    fn with_halves(&self, line: Line, drives: &[Drive], schedule: &Schedule) -> Result<Line, MapError> {
        let steep = halfway::held(self.layout, drives).map(|(l, ends)| {
            let nodes: Vec<(f64, f64)> =
                line.nodes.iter().zip(&line.driven[l]).map(|(x, u)| (x[0], *u)).collect();
            halfway::steep(&nodes, ends)
        });
        let mut which = steep.unwrap_or_default();
        which.extend(halfway::jumps(self.layout, &line.nodes));
        which.sort_unstable();
        which.dedup();
        let middle = |k: &usize| -> Vec<f64> {
            line.nodes[*k].iter().zip(&line.nodes[k + 1]).map(|(a, b)| 0.5 * (a + b)).collect()
        };
        let at: Vec<Vec<f64>> = which.iter().map(middle).collect();
        let driven: Vec<Vec<f64>> =
            drives.iter().map(|d| d.say(self.layout, self.setting, &at)).collect::<Result<_, _>>()?;
        let gains = schedule.at(self.layout, self.setting, drives, &at)?;
        let of = |all: &[Vec<f64>], i: usize| all.iter().map(|v| v[i]).collect::<Vec<f64>>();
        let each = which.into_iter().zip(at).enumerate();
        let halves = each.map(|(i, (k, at))| (k, Half { at, driven: of(&driven, i), gains: of(&gains, i) }));
        Ok(Line { halves: halves.collect(), ..line })
    }

    /// Whether the last of the lines is nearer to where the bed stands, along the other axis, than the first.
    fn nearer_last(&self, lines: &[&Line], now: &[f64]) -> bool {
        let far = |l: Option<&&Line>| l.and_then(|l| l.other).zip(now.get(1)).map(|(v, now)| (v - now).abs());
        far(lines.last()).zip(far(lines.first())).is_some_and(|(last, first)| last < first)
    }

    /// Whether a line begins at its last node: where less is demanded, for at the other end an input may stand at the end of its range, and its loop
    /// then comes back from there all along the way; where nothing is demanded along it, nearer to where the bed stands.
    fn begins_last(&self, line: &Line, now: &[f64]) -> bool {
        let demanded = self.layout.leading_demand().is_some_and(|(k, _)| k == 0);
        begins_last(demanded, [line.nodes[0][0], line.nodes[line.nodes.len() - 1][0]], now[0])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_along_a_demand_begins_where_less_is_asked_for() {
        // Wherever the bed stands; of demands below zero the smaller size.
        assert!(!begins_last(true, [40.0, 160.0], 150.0) && begins_last(true, [-80.0, -10.0], -70.0));
        assert!(begins_last(false, [40.0, 160.0], 150.0) && !begins_last(false, [40.0, 160.0], 60.0));
    }

    /// What has become another setting is gone along again, from one node before it to one after it, and so is a node that is new.
    #[test]
    fn only_what_is_another_setting_is_gone_along_again() {
        let nodes = |x: [f64; 6]| -> Vec<Vec<f64>> { (0..6).map(|k| vec![k as f64, x[k]]).collect() };
        let beside = |a: &[f64], b: &[f64]| (a[1] - b[1]).abs() <= 0.05;
        let before = nodes([0.0; 6]);
        let of = |x: [f64; 6]| others(&nodes(x), &before, 1, &beside);
        assert_eq!(of([0.04; 6]), None);
        assert_eq!(of([0.0, 0.0, 0.0, 0.1, 0.0, 0.0]), Some((2, 4)));
        assert_eq!(of([0.1, 0.0, 0.0, 0.0, 0.0, 0.0]), Some((0, 1)));
        assert_eq!(of([0.0, 0.0, 0.1, 0.0, 0.0, 0.1]), Some((1, 5)));
        // Cells at the end had no optimum before, or the line was not there.
        assert_eq!(others(&nodes([0.0; 6]), &before[..4], 1, &beside), Some((3, 5)));
        assert_eq!(others(&nodes([0.0; 6]), &[], 1, &beside), Some((0, 5)));
    }
}
