//! Lines of the finished maps on the bed: the inputs that loops drive are measured where the maps will be used.
//!
//! Models of six factors miss an input that a loop drives by some percent, and its map has to hold the demand alone. But the map
//! stands on a surface of two axes, and the loops find its values by themselves while the bed goes along it:
//!
//! ```text
//! r = log u - log g(q)      u: input as measured, g(q): what its model expects there ([`super::drive`])
//! u_map = g(q) exp(trim)    trim: r over the axes of the maps without the lag of the way ([`dynocal_calib::steady::trim`])
//! w = (d log u / d log y)^-2   weight of r, y: the demand that u holds; where y hardly answers u the loop swings far and that is no matter
//! ```
//!
//! A window counts where all demands were followed and the loop had room, and where the maps still go through it: what lines find at the ends
//! of the driven inputs is learnt (`reach.rs`) and may move the optimum.
//!
//! Free inputs follow the maps as an ECU will interpolate them; driven ones are fed forward with g, so that the loops have only the rest to
//! do and outputs that are held stay there. A line ends where a limit is touched, and goes through cells that hold an
//! optimum only.

use dynocal_calib::steady::cell::Setting;
use dynocal_calib::steady::day::Drift;
use dynocal_calib::steady::grid::{Cell, CellState, corners, interpolate};
use dynocal_calib::steady::layout::{FactorKind, Layout};
use dynocal_calib::steady::station::{Leg, SweepRow};
use dynocal_calib::steady::trim::{Along, Trim, finer};
use dynocal_ident::model::response::{Ask, Prediction};
use dynocal_numerics::watch::Watch;
use serde::Serialize;

use super::bench::Bench;
use super::drive::Drive;
use super::error::MapError;
use super::spec::{MapSpec, SweepSpec};

/// What the sweeps were.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Sweeps {
    /// Lines that were planned.
    pub planned: usize,
    /// Lines that were gone to their end.
    pub whole: usize,
    /// Windows that were measured.
    pub rows: usize,
    /// Windows in which a driven input stood at an end of its range: what was reached there bounds the cells around.
    pub at_ends: usize,
    /// Bed time in s.
    pub bed_s: f64,
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

/// A line: factors at its nodes along the first axis.
struct Line {
    /// Value of the other axis; none where there is none.
    other: Option<f64>,
    nodes: Vec<Vec<f64>>,
    /// What the maps of the driven inputs say at the nodes, by loop.
    driven: Vec<Vec<f64>>,
}

/// A window of a sweep.
pub(super) struct Window {
    line: usize,
    /// 1: up the first axis; -1: down.
    up: f64,
    pub(super) row: SweepRow,
}

/// Bed time that the sweeps of a spec take, about.
pub(super) fn expected_s(spec: &MapSpec, axes: &[Vec<f64>]) -> f64 {
    let Some(s) = &spec.bed.sweep else { return 0.0 };
    let lines = axes.get(1).map_or(1, |a| (a.len() - 1) * (s.between + 1) + 1);
    let a = &spec.bed.approach;
    // There and back, and to the next line: about half of the range, and half of the longest wait for its rest. Less here is time that the
    // verification lacks, more is points that are not measured.
    lines as f64 * (2.0 * s.pass_s + 0.5 * (a.ramp_s + a.settle_s) + a.average_s)
}

impl Window {
    /// Axes as they were asked for, where a demand that is one of them was not reached with its input at an end.
    pub(super) fn missed(&self, layout: &Layout) -> Option<Vec<f64>> {
        let mut at = self.row.factors[..layout.axes].to_vec();
        let mut missed = false;
        for (k, f) in layout.factors[..layout.axes].iter().enumerate() {
            if let FactorKind::Demand(l) = f.kind {
                missed |= self.row.at_end[l] && !self.row.followed[l];
                at[k] = self.row.asked[l];
            }
        }
        missed.then_some(at)
    }
}

impl Lines<'_> {
    /// Goes along all lines until `bed_s` is used up; nothing where the spec asks for none or the bed cannot.
    ///
    /// # Errors
    /// [`MapError`].
    pub(super) fn run(
        &self,
        bench: &mut dyn Bench,
        drives: &[Drive],
        bed_s: f64,
        watch: Watch,
    ) -> Result<Option<(Sweeps, Vec<Window>)>, MapError> {
        let Some(spec) = self.spec.bed.sweep.as_ref().filter(|_| bench.goes_on()) else { return Ok(None) };
        let lines = self.lines(spec, drives)?;
        watch.note(&format!("{} lines of the maps on the bed", lines.len()));
        let begun_s = bench.used_s();
        let mut sweeps = Sweeps { planned: lines.len(), ..Sweeps::default() };
        let mut rows: Vec<Window> = Vec::new();
        for (k, line) in lines.iter().enumerate() {
            if bench.used_s() >= bed_s {
                sweeps
                    .notes
                    .push(format!("{} lines were left out: the bed time was used up", lines.len() - k));
                break;
            }
            watch.fraction(k as f64 / lines.len() as f64);
            let (from, legs) = self.path(line, bench.stands_at(), spec.pass_s);
            let Some(swept) = bench.sweep(&from, &legs, watch)? else { return Ok(None) };
            match &swept.touched {
                Some(t) => sweeps.notes.push(format!("{} ended early: {}", self.named(line), t.words)),
                None => sweeps.whole += 1,
            }
            let ends: Vec<f64> = [from[0]].into_iter().chain(legs.iter().map(|l| l.to[0])).collect();
            let up = |leg: usize| (ends[leg + 1] - ends[leg]).signum();
            let mut way = 0.0;
            for row in swept.rows {
                // The first window of a way is not yet behind by all of the lag.
                let before = std::mem::replace(&mut way, up(row.leg));
                if before == way {
                    rows.push(Window { line: k, up: way, row });
                }
            }
        }
        sweeps.rows = rows.len();
        sweeps.at_ends = rows.iter().filter(|w| w.row.at_end.contains(&true)).count();
        sweeps.bed_s = bench.used_s() - begun_s;
        Ok(Some((sweeps, rows)))
    }

    /// Trims the maps of the driven inputs by what was measured along the lines.
    ///
    /// # Errors
    /// As of [`Drive::at`].
    pub(super) fn trim(&self, rows: &[Window], drives: &mut [Drive]) -> Result<(), MapError> {
        let Some(spec) = &self.spec.bed.sweep else { return Ok(()) };
        let knots: Vec<Vec<f64>> = self.knots(spec);
        let on_the_maps: Vec<&Window> = rows.iter().filter(|w| self.goes_through(w)).collect();
        drives.iter_mut().enumerate().try_for_each(|(l, d)| self.trim_one(l, d, &on_the_maps, &knots))
    }

    /// Whether the maps go through what was measured in a window.
    fn goes_through(&self, w: &Window) -> bool {
        let n = self.layout.axes;
        let here = interpolate(self.axes, self.cells, &w.row.factors[..n]);
        let apart = self.layout.factors[n..].iter().zip(w.row.factors[n..].iter().zip(&here[n..]));
        apart.into_iter().all(|(f, (a, b))| (a - b).abs() <= ASIDE * (f.upper - f.lower))
    }

    fn knots(&self, spec: &SweepSpec) -> Vec<Vec<f64>> {
        let one = |(k, a): (usize, &Vec<f64>)| {
            finer(std::slice::from_ref(a), if k == 0 { 1 } else { spec.between })
        };
        self.axes.iter().enumerate().flat_map(one).collect()
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
        let line = |other: Option<f64>| {
            let place = |t: &f64| -> Vec<f64> { [*t].into_iter().chain(other).collect() };
            let held = |at: &Vec<f64>| {
                corners(self.axes, at).iter().all(|(k, _)| self.cells[*k].state == CellState::Optimal)
            };
            let all: Vec<Vec<f64>> = self.axes[0].iter().map(place).collect();
            let longest = all.split(|at| !held(at)).max_by_key(|run| run.len()).unwrap_or(&[]);
            let nodes: Vec<Vec<f64>> =
                longest.iter().map(|at| interpolate(self.axes, self.cells, at)).collect();
            let driven = drives
                .iter()
                .map(|d| models_say(self.layout, self.setting, d, &nodes))
                .collect::<Result<_, _>>()?;
            Ok(Line { other, nodes, driven })
        };
        let all: Vec<Line> = others.into_iter().map(line).collect::<Result<_, MapError>>()?;
        Ok(all.into_iter().filter(|l| l.nodes.len() > 1).collect())
    }

    /// There and back, beginning at the nearer end.
    fn path(&self, line: &Line, now: &[f64], pass_s: f64) -> (Vec<f64>, Vec<Leg>) {
        let mut order: Vec<usize> = (0..line.nodes.len()).collect();
        let far = |k: usize| (line.nodes[k][0] - now[0]).abs();
        if far(order.len() - 1) < far(0) {
            order.reverse();
        }
        let begin = line.nodes[order[0]].clone();
        order.extend(order.clone().into_iter().rev().skip(1));
        let axis = &self.axes[0];
        let whole = axis[axis.len() - 1] - axis[0];
        let leg = |w: &[usize]| {
            let (a, b) = (&line.nodes[w[0]], &line.nodes[w[1]]);
            // A model that says nothing there is not fed forward.
            let change = |d: &Vec<f64>| Some(d[w[1]] - d[w[0]]).filter(|v| v.is_finite()).unwrap_or(0.0);
            Leg {
                to: b.clone(),
                seconds: pass_s * (b[0] - a[0]).abs() / whole,
                driven: line.driven.iter().map(change).collect(),
            }
        };
        (begin, order.windows(2).map(leg).collect())
    }

    /// What windows say of how loop `l` was answered; nothing where its demand is no axis, or where its map is not relative.
    fn answers(&self, l: usize, drive: &Drive, used: &[&Window]) -> Vec<Answer> {
        let place = self.layout.factors[..self.layout.axes]
            .iter()
            .position(|f| f.kind == FactorKind::Demand(l))
            .filter(|_| drive.relative);
        let Some(k) = place else { return Vec::new() };
        let one = |w: &&Window| Answer {
            way: (w.line, w.up > 0.0),
            at_s: w.row.at_s,
            asked: w.row.asked[l],
            got: w.row.factors[k],
            input: w.row.responses[l],
        };
        used.iter().map(one).collect()
    }

    /// Learns the trim of the input of loop `l` from windows with room.
    fn trim_one(
        &self,
        l: usize,
        drive: &mut Drive,
        rows: &[&Window],
        knots: &[Vec<f64>],
    ) -> Result<(), MapError> {
        let (n, drift) = (self.layout.axes, self.drift.get(l).filter(|d| d.corrected));
        let room = |w: &Window| !w.row.at_end[l] && w.row.followed.iter().all(|f| *f);
        let used: Vec<&Window> = rows.iter().copied().filter(|w| room(w)).collect();
        let factors: Vec<Vec<f64>> = used.iter().map(|w| w.row.factors.clone()).collect();
        let mut missed = Missed::default();
        let say = models_say(self.layout, self.setting, drive, &factors)?;
        let mut slopes = slopes(self.layout, self.setting, l, drive, &factors)?;
        // Between all windows of a way: those beside one that counts may not count themselves.
        let measured = measured_slopes(&self.answers(l, drive, rows), 1.5 * self.spec.bed.approach.window_s);
        for (slope, m) in
            slopes.iter_mut().zip(rows.iter().zip(&measured).filter(|(w, _)| room(w)).map(|(_, m)| m))
        {
            if *m > STEEPER * *slope {
                *slope = *m;
            }
        }
        for ((w, model), slope) in used.into_iter().zip(say).zip(slopes) {
            let gone = drift.map_or(0.0, |d| d.per_hour / 3600.0 * (w.row.at_s - d.mean_s));
            let r = drive.missed_by(w.row.responses[l] - gone, model);
            if r.is_finite() {
                missed.along.push(w.row.factors[..n].to_vec(), w.up, r, 1.0 / (slope * slope));
                missed.line.push(w.line);
            }
        }
        let Some(trim) = Trim::learn(knots, &missed.along) else { return Ok(()) };
        let error = missed.between(&trim);
        let squares: f64 = missed.along.at.iter().map(|z| trim.at(z).powi(2)).sum();
        drive.take(trim, (squares / missed.along.r.len() as f64).sqrt(), error);
        Ok(())
    }
}

/// Share of the range of a free input by which the maps may go past a window that still counts: what cams and the like do to a throttle
/// within it is less than its map misses.
const ASIDE: f64 = 0.05;
/// By how much a measured slope has to be steeper than that of the map to be taken: scatter alone makes it no more.
const STEEPER: f64 = 2.0;
/// Least share of its course that a demand counts as having gone between two windows, where its slope is measured.
const ANSWERED: f64 = 0.1;
/// Share by which a demand is moved to see what its input does.
const SHARE: f64 = 0.01;
/// Least slope of an input over its demand, both as shares: what flows goes with at most the square of an opening.
const STEEP: f64 = 0.5;

/// What a map misses along the lines, with the numbers of the lines.
#[derive(Default)]
struct Missed {
    along: Along,
    line: Vec<usize>,
}

impl Missed {
    /// All but one line.
    fn without(&self, held: usize) -> Along {
        let (mut rest, a) = (Along::default(), &self.along);
        for i in (0..a.r.len()).filter(|i| self.line[*i] != held) {
            rest.push(a.at[i].clone(), a.up[i], a.r[i], a.weight[i]);
        }
        rest
    }

    /// How far each line is from what the others say of it, where there are others on both sides: rms of the trims along it, counted by
    /// what it does to the demand.
    fn between(&self, trim: &Trim) -> Option<f64> {
        let last = *self.line.iter().max()?;
        let (mut sum, mut n) = (0.0, 0.0);
        for held in 1..last {
            let without = Trim::with_lambda(&trim.axes, &self.without(held), trim.lambda);
            let Some(without) = without else { continue };
            for i in (0..self.line.len()).filter(|i| self.line[*i] == held) {
                let z = &self.along.at[i];
                sum += self.along.weight[i] * (without.at(z) - trim.at(z)).powi(2);
                n += 1.0;
            }
        }
        (n > 0.0).then(|| (sum / n).sqrt())
    }
}

/// What the map of a driven input says at factors, all responses being as they are expected there.
///
/// # Errors
/// As of [`Drive::at`].
pub(super) fn models_say(
    layout: &Layout,
    setting: &Setting,
    drive: &Drive,
    factors: &[Vec<f64>],
) -> Result<Vec<f64>, MapError> {
    let expected: Vec<Vec<f64>> = factors.iter().map(|x| expected(setting, x)).collect();
    let asked: Vec<(&[f64], &[f64])> = factors.iter().zip(&expected).map(|(x, e)| (&x[..], &e[..])).collect();
    Ok(drive.at(layout, &asked)?.into_iter().map(|v| v.value).collect())
}

/// What a share of its demand is in shares of the input of loop `l`, d log u / d log y, as the map says: an error of the input counts by what it
/// does to what the input has to hold. A throttle that is nearly open may be anywhere. 1 where the demand is no factor, or where the map is
/// not relative.
///
/// # Errors
/// As of [`Drive::at`].
pub(super) fn slopes(
    layout: &Layout,
    setting: &Setting,
    l: usize,
    drive: &Drive,
    factors: &[Vec<f64>],
) -> Result<Vec<f64>, MapError> {
    let place = layout.factors.iter().position(|f| f.kind == FactorKind::Demand(l));
    let Some(k) = place.filter(|_| drive.relative) else { return Ok(vec![1.0; factors.len()]) };
    let say = |share: f64| {
        let mut moved = factors.to_vec();
        moved.iter_mut().for_each(|x| x[k] *= 1.0 + share);
        models_say(layout, setting, drive, &moved)
    };
    let span = (1.0 + SHARE).ln() - (1.0 - SHARE).ln();
    let one = |(more, less): (&f64, &f64)| {
        let slope = (more.ln() - less.ln()).abs() / span;
        if slope.is_finite() { slope.max(STEEP) } else { 1.0 }
    };
    Ok(say(SHARE)?.iter().zip(&say(-SHARE)?).map(one).collect())
}

/// A window as a loop saw it.
struct Answer {
    /// Number of the line, and whether it was gone up.
    way: (usize, bool),
    /// Bed time in s.
    at_s: f64,
    /// Demand as asked for, as it was, and the input that held it.
    asked: f64,
    got: f64,
    input: f64,
}

/// Steepest slope of the input over the demand, both as shares, from each window to those beside it on its way that are no more than `apart_s`
/// apart; 0 where none is. Where the demand hardly answers any more the loop comes back through inputs that no map at rest goes through,
/// and what they miss is no matter.
fn measured_slopes(answers: &[Answer], apart_s: f64) -> Vec<f64> {
    let share = |a: f64, b: f64| (a / b).ln().abs();
    let mut slopes = vec![0.0; answers.len()];
    for (i, w) in answers.windows(2).enumerate() {
        let (a, b) = (&w[0], &w[1]);
        let (asked, got) = (share(b.asked, a.asked), share(b.got, a.got));
        // Not a number where there is no logarithm.
        let stands = asked.is_nan() || got.is_nan() || asked == 0.0;
        if a.way != b.way || b.at_s - a.at_s > apart_s || stands {
            continue;
        }
        let found = share(b.input, a.input) / got.max(ANSWERED * asked);
        if found.is_finite() {
            slopes[i..=i + 1].iter_mut().for_each(|s: &mut f64| *s = s.max(found));
        }
    }
    slopes
}

/// What the models expect of all responses.
pub(super) fn expected(setting: &Setting, factors: &[f64]) -> Vec<f64> {
    let mut at = Prediction::new(factors.len());
    let one = |m: &&dyn dynocal_ident::model::response::Response| {
        m.predict(factors, Ask::Mean, &mut at);
        at.mean
    };
    setting.models.iter().map(one).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// y = 1 - exp(-u): gone up as at rest, and come back from the end through u of 6 to 3.5, where y stays what it was.
    #[test]
    fn a_loop_that_comes_back_from_where_nothing_answers_counts_little() {
        let at = |k: usize, up: bool, asked: f64, input: f64| Answer {
            way: (0, up),
            at_s: 2.0 * k as f64,
            asked,
            got: 1.0 - (-input).exp(),
            input,
        };
        let going: Vec<Answer> =
            (0..6).map(|k| at(k, true, 0.4 + 0.1 * k as f64, 0.5 + 0.35 * k as f64)).collect();
        let coming = (6..9).map(|k| at(k, false, 0.98 - 0.05 * (k - 6) as f64, 6.0 - 1.2 * (k - 6) as f64));
        // The last one is of another time: nothing is measured from it to the one before.
        let answers: Vec<Answer> = going.into_iter().chain(coming).chain([at(20, false, 0.5, 0.7)]).collect();
        let slopes = measured_slopes(&answers, 3.0);
        // d log u / d log y of the law is (exp(u) - 1) / u: 1.3 where u is 0.5, 4 where it is 2.25.
        assert!((1.2..1.7).contains(&slopes[0]) && (2.5..4.0).contains(&slopes[5]), "{slopes:?}");
        assert!(slopes[6..9].iter().all(|s| *s > 10.0), "{slopes:?}");
        assert_eq!(slopes[9], 0.0);
        // A demand that stands still says nothing, and what has no logarithm neither.
        let pair = |asked: f64, got: f64| {
            let first = Answer { asked, got, ..at(0, true, 0.5, 0.5) };
            measured_slopes(&[first, at(1, true, 0.5, 0.9)], 3.0)
        };
        for (asked, got) in [(0.5, 0.4), (-0.5, 0.4), (0.4, -0.4)] {
            assert_eq!(pair(asked, got), [0.0, 0.0]);
        }
        assert!(pair(0.4, 0.4)[0] > 1.0);
    }
}
