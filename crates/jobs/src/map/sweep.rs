//! Lines of the finished maps on the bed: the inputs that loops drive are measured where the maps will be used.
//!
//! Models of six factors miss an input that a loop drives by some percent, and its map has to hold the demand alone. But the map
//! stands on a surface of two axes, and the loops find its values by themselves while the bed goes along it:
//!
//! ```text
//! u_map(y, z) = g(y exp(-e(z)))          u: input, y: the demand that it holds, z: axes, g: what its model expects there ([`super::drive`])
//! e + (log g - log u) / s = e(z) + s_way d(z)      what a window tells, s = d log g / d log y, 0.5 at least; e(z): over the axes of the maps without the lag of the
//!                                        way d ([`dynocal_calib::steady::trim`]), found by Newton's method
//! ```
//!
//! e says how much more the demand is at an input than the model says. It is smooth where the input is not: behind a throttle that is nearly open the
//! demand hardly answers, a share of it is a tenth of the opening or all of it, and what the loop sets there swings far, which is no matter. An input
//! whose demand is no axis gets a correction of its own, over the axes as well.
//!
//! A window counts where all demands were followed and the loop had room, and where the maps still go through it: what lines find at the ends
//! of the driven inputs is learnt (`reach.rs`) and may move the optimum. Nor does one count in which the demand was there in passing only
//! (`windows.rs`), or the way back had needlessly much of the input: a throttle that has stood wide open holds with 46 deg what 31 had held before, both are
//! true, and no smooth map goes through both. What is between them passed for a lag of the way, which goes on beyond where there is one way alone.
//!
//! Of lines that rest at each value of the first axis (`bed.sweep.rest_s`) windows of rests alone count; there is no way back then, and what is needless on one is not sought.
//!
//! How the bed goes along the lines: `lines.rs`.

use dynocal_calib::steady::day::DayPoint;
use dynocal_calib::steady::trim::{Along, Trim, finer};

use super::along;
use super::drive::{Drive, Set};
use super::error::MapError;
use super::lines::Lines;
use super::schedule::slopes;
use super::spec::SweepSpec;
use super::windows::{Window, in_passing};

impl Lines<'_> {
    /// Trims the maps of the driven inputs by what was measured along the lines, and takes those over the channels of which lines say least against
    /// them: those that the bed went along with, or one of the `others` by loop.
    ///
    /// # Errors
    /// As of [`Drive::at`].
    pub(super) fn trim(
        &self,
        rows: &[Window],
        drives: &mut [Drive],
        others: Vec<Vec<Drive>>,
    ) -> Result<(), MapError> {
        let Some(spec) = &self.spec.bed.sweep else { return Ok(()) };
        let knots: Vec<Vec<f64>> = self.knots(spec);
        for (l, (first, others)) in drives.iter_mut().zip(others).enumerate() {
            let on_the_maps = self.on_the_maps(rows, &[l]);
            self.trim_one(l, first, &on_the_maps, &knots)?;
            for mut other in others {
                self.trim_one(l, &mut other, &on_the_maps, &knots)?;
                other.rather_than(first);
            }
        }
        Ok(())
    }

    /// Windows that the maps go through and in which none of the `loops` holds its demand in passing.
    fn on_the_maps<'w>(&self, rows: &'w [Window], loops: &[usize]) -> Vec<&'w Window> {
        let demands = self.layout.demanded().filter(|(_, l)| loops.contains(l));
        let passing: Vec<Vec<bool>> = demands.map(|d| in_passing(rows, d)).collect();
        let held = |k: usize| passing.iter().all(|p| !p[k]);
        let each = rows.iter().enumerate();
        each.filter(|(k, w)| held(*k) && self.goes_through(w)).map(|(_, w)| w).collect()
    }

    /// Points of the lines along the maps as they are.
    pub(super) fn points(&self, rows: &[Window]) -> Vec<DayPoint> {
        let loops: Vec<usize> = (0..self.layout.loops.len()).collect();
        let rests = self.spec.bed.sweep.as_ref().is_some_and(|s| s.rest_s > 0.0);
        along::points(self.layout, &self.on_the_maps(rows, &loops), rests)
    }

    /// Puts maps of driven inputs that were learnt with `points` of the lines, too, in the place of those that were not, and trims them.
    ///
    /// # Errors
    /// As of [`Drive::at`].
    pub(super) fn learnt_again(
        &self,
        rows: &[Window],
        drives: &mut [Drive],
        mut again: Vec<Vec<Drive>>,
        points: usize,
    ) -> Result<(), MapError> {
        let mut first: Vec<Drive> = again.iter_mut().map(|all| all.remove(0)).collect();
        self.trim(rows, &mut first, again)?;
        first.into_iter().zip(drives).for_each(|(new, before)| new.in_place_of(before, points));
        Ok(())
    }

    fn knots(&self, spec: &SweepSpec) -> Vec<Vec<f64>> {
        let one = |(k, a): (usize, &Vec<f64>)| {
            finer(std::slice::from_ref(a), if k == 0 { 1 } else { spec.between })
        };
        self.axes.iter().enumerate().flat_map(one).collect()
    }

    /// What windows say of how loop `l` was answered; nothing where its demand is no axis, or where its map is not relative.
    fn answers(&self, l: usize, drive: &Drive, used: &[&Window]) -> Vec<Answer> {
        let Some(k) = self.demand(l, drive) else { return Vec::new() };
        let one = |w: &&Window| Answer {
            way: (w.line, w.way.up > 0.0),
            rest: Some((w.pass, w.row.leg)).filter(|_| w.way.up == 0.0),
            rising: w.way.up > 0.0 && w.way.since_s >= w.way.window_s,
            at_s: w.row.at_s,
            asked: w.row.asked[l],
            got: w.row.factors[k],
            input: w.row.responses[l],
        };
        used.iter().map(one).collect()
    }

    /// The factor of the demand that loop `l` holds; none where it is no axis, where it may be zero, or where the map is not relative.
    fn demand(&self, l: usize, drive: &Drive) -> Option<usize> {
        let place = self.layout.demand_factor(l).filter(|_| drive.relative);
        place.filter(|k| self.axes[*k].iter().all(|v| *v > 0.0))
    }

    /// Learns the trim of the input of loop `l` from windows with room.
    fn trim_one(
        &self,
        l: usize,
        drive: &mut Drive,
        rows: &[&Window],
        knots: &[Vec<f64>],
    ) -> Result<(), MapError> {
        let room = |w: &Window| !w.row.at_end[l] && w.row.followed.iter().all(|f| *f);
        // Between all windows of a way: those beside one that counts may not count themselves.
        let answers = self.answers(l, drive, rows);
        let measured = measured_slopes(&answers, 1.5 * self.spec.bed.approach.window_s);
        let steep = |k: usize| measured.get(k).copied().unwrap_or(0.0);
        let all: Vec<Vec<f64>> = rows.iter().map(|w| w.row.factors.clone()).collect();
        let way = slopes(self.layout, self.setting, l, drive, &all)?.iter().sum();
        let needless = needless(&answers, way);
        let counts = |k: usize, w: &Window| room(w) && !needless.get(k).copied().unwrap_or(false);
        let each = rows.iter().enumerate();
        let used: Vec<(&Window, f64)> =
            each.filter(|(k, w)| counts(*k, w)).map(|(k, w)| (*w, steep(k))).collect();
        let factors: Vec<Vec<f64>> = used.iter().map(|(w, _)| w.row.factors.clone()).collect();
        let first = drive.say(self.layout, self.setting, &factors)?;
        let told = Told { l, used: &used, knots };
        // A model that hardly knows its demand cannot be asked at another one.
        match self.demand(l, drive) {
            Some(k) if self.shifted(&told, drive, k)? => {}
            _ => drop(self.round(&told, drive, None)?),
        }
        if drive.trimmed.is_none() {
            return Ok(());
        }
        let last = drive.say(self.layout, self.setting, &factors)?;
        let slopes = slopes(self.layout, self.setting, l, drive, &factors)?;
        let set: Vec<Set> = used
            .iter()
            .enumerate()
            .map(|(i, (w, steep))| Set {
                at: &w.row.factors[..self.layout.axes],
                way: w.way,
                input: w.row.responses[l] - self.gone(l, w),
                said: [first[i], last[i]],
                slope: slopes[i],
                weight: weight(*steep, slopes[i]),
            })
            .collect();
        drive.compare(self.axes, &set);
        Ok(())
    }

    /// Trims the demand `k` at which the model is asked, in some rounds, each of which takes what is left by the slope of the map as it is by then,
    /// as long as less is left. False, and no trim, where the first leaves no less.
    fn shifted(&self, told: &Told, drive: &mut Drive, k: usize) -> Result<bool, MapError> {
        let mut least = self.left(told, drive, Some(k))?;
        for _ in 0..ROUNDS {
            let before = drive.clone();
            if !self.round(told, drive, Some(k))? {
                break;
            }
            let left = self.left(told, drive, Some(k))?;
            if left.is_nan() || left >= least {
                *drive = before;
                break;
            }
            least = left;
        }
        Ok(drive.trimmed.is_some())
    }

    /// One round: the trim from what windows tell by now, and how stiff it is; false where they tell nothing. In the first rounds the map is farther off than later,
    /// and what is chosen for that is too stiff for what is left.
    fn round(&self, told: &Told, drive: &mut Drive, demand: Option<usize>) -> Result<bool, MapError> {
        let (l, used) = (told.l, told.used);
        let mut missed = Missed::default();
        for ((w, _), (e, weight)) in used.iter().zip(self.told(l, drive, used, demand)?) {
            if e.is_finite() {
                missed.along.push(w.row.factors[..self.layout.axes].to_vec(), w.way, e, weight);
                missed.line.push(w.line);
            }
        }
        let Some(trim) = Trim::learn(told.knots, &missed.along) else { return Ok(false) };
        let between = missed.between(&trim);
        drive.take(trim, demand, between);
        Ok(true)
    }

    /// How much of the demand windows miss about the trim that there is: sum of squares by their weights.
    fn left(&self, told: &Told, drive: &Drive, demand: Option<usize>) -> Result<f64, MapError> {
        let n = self.layout.axes;
        let each = self.told(told.l, drive, told.used, demand)?.into_iter().zip(told.used);
        let square = |((e, weight), (w, _)): ((f64, f64), &(&Window, f64))| {
            weight * (e - drive.trim_at(&w.row.factors[..n])).powi(2)
        };
        Ok(each.map(square).filter(|v| v.is_finite()).sum())
    }

    /// What drift has done to the input of loop `l` by a window.
    fn gone(&self, l: usize, w: &Window) -> f64 {
        let drift = self.drift.get(l).filter(|d| d.corrected);
        drift.map_or(0.0, |d| d.per_hour / 3600.0 * (w.row.at_s - d.mean_s))
    }

    /// What windows tell of the trim of the input of loop `l`, that which it has by now included, with their weights. A window is given with
    /// the slope that was measured beside it.
    fn told(
        &self,
        l: usize,
        drive: &Drive,
        windows: &[(&Window, f64)],
        demand: Option<usize>,
    ) -> Result<Vec<(f64, f64)>, MapError> {
        let n = self.layout.axes;
        let factors: Vec<Vec<f64>> = windows.iter().map(|(w, _)| w.row.factors.clone()).collect();
        let say = drive.say(self.layout, self.setting, &factors)?;
        let slopes = slopes(self.layout, self.setting, l, drive, &factors)?;
        let one = |(((w, steep), model), slope): ((&(&Window, f64), f64), f64)| {
            let r = drive.missed_by(w.row.responses[l] - self.gone(l, w), model);
            // More of the input is less of the demand that it stands for.
            let e = if demand.is_some() { drive.trim_at(&w.row.factors[..n]) - r / slope } else { r };
            (e, weight(*steep, slope))
        };
        Ok(windows.iter().zip(say).zip(slopes).map(one).collect())
    }
}

/// Weight of a window beside which the input goes `steep` over the demand where its map has a `slope`.
fn weight(steep: f64, slope: f64) -> f64 {
    if steep > STEEPER * slope.abs() { (slope / steep).powi(2) } else { 1.0 }
}

/// What windows tell of the input of a loop.
struct Told<'a> {
    /// The loop.
    l: usize,
    /// Windows, with the slopes that were measured beside them.
    used: &'a [(&'a Window, f64)],
    knots: &'a [Vec<f64>],
}

/// Most rounds in which a trim of the demand is found: those of Newton's method for a curve that is smooth.
const ROUNDS: usize = 4;
/// By how much a measured slope has to be steeper than that of the map to be taken: scatter alone makes it no more.
const STEEPER: f64 = 2.0;
/// Least share of its course that a demand counts as having gone between two windows, where its slope is measured.
const ANSWERED: f64 = 0.1;

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
            rest.push(a.at[i].clone(), a.way[i], a.r[i], a.weight[i]);
        }
        rest
    }

    /// How far each line is from what the others say of it, where there are others on both sides: rms of the trims along it, counted by
    /// what it does to the demand.
    fn between(&self, trim: &Trim) -> Option<f64> {
        let (first, last) = (*self.line.iter().min()?, *self.line.iter().max()?);
        let (mut sum, mut n) = (0.0, 0.0);
        for held in first + 1..last {
            let without = Trim::with(&trim.axes, &self.without(held), trim.choice);
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

/// A window as a loop saw it.
struct Answer {
    /// Number of the line, and whether it was gone up.
    way: (usize, bool),
    /// Which pass and leg it rested on; none where it was under way.
    rest: Option<(usize, usize)>,
    /// Whether it had been gone up for a window by then.
    rising: bool,
    /// Bed time in s.
    at_s: f64,
    /// Demand as asked for, as it was, and the input that held it.
    asked: f64,
    got: f64,
    input: f64,
}

/// Steepest slope of the input over the demand, both as shares, from each window to those beside it on its way that are no more than `apart_s`
/// apart, or from rest to rest; 0 where none is. Where the demand hardly answers any more the loop comes back through inputs that no map at rest goes through,
/// and what they miss is no matter.
fn measured_slopes(answers: &[Answer], apart_s: f64) -> Vec<f64> {
    let share = |a: f64, b: f64| (a / b).ln().abs();
    let mut slopes = vec![0.0; answers.len()];
    for (i, w) in answers.windows(2).enumerate() {
        let (a, b) = (&w[0], &w[1]);
        let (asked, got) = (share(b.asked, a.asked), share(b.got, a.got));
        // Not a number where there is no logarithm.
        let same_rest = a.rest.is_some() && a.rest == b.rest;
        let stands = asked.is_nan() || got.is_nan() || asked == 0.0 || same_rest;
        if a.way != b.way || b.at_s - a.at_s > apart_s || stands {
            continue;
        }
        let found = share(b.input, a.input) / got.max(ANSWERED * asked);
        if found.is_finite() {
            slopes[i..=i + 1].iter_mut().for_each(|s: &mut f64| *s = s.max(found));
        }
    }
    let rests: Vec<&[Answer]> = answers.chunk_by(|a, b| a.rest == b.rest).collect();
    let mut begin = 0;
    for w in rests.windows(2) {
        let (a, b) = (&w[0], &w[1]);
        let end = begin + a.len() + b.len();
        if a[0].rest.zip(b[0].rest).is_some_and(|(a, b)| a.0 == b.0) {
            let of = |value: &dyn Fn(&Answer) -> f64| {
                // The input still moves in the first of several.
                let mean = |all: &[Answer]| {
                    let rested = &all[usize::from(all.len() > 1)..];
                    rested.iter().map(value).sum::<f64>() / rested.len() as f64
                };
                share(mean(b), mean(a))
            };
            let asked = of(&|a| a.asked);
            let found = of(&|a| a.input) / of(&|a| a.got).max(ANSWERED * asked);
            if found.is_finite() && asked > 0.0 {
                slopes[begin..end].iter_mut().for_each(|s: &mut f64| *s = s.max(found));
            }
        }
        begin += a.len();
    }
    slopes
}

/// Logarithm of how many times an input may be beyond what reached as much of the demand on the way up: the settings of the two windows may differ as far as maps
/// go through both.
const BEYOND: f64 = 0.1;

/// Which windows of the ways back, and of rests, have needlessly much of the input: at least as much of the demand was reached with less of it on the way up of the same
/// line. Where it has been gone up for a while the demand is behind the input, so that less had been enough at rest, too: the loop is on its way back from where
/// nothing answers. `way`: whether the input goes up with the demand (> 0) or down.
fn needless(answers: &[Answer], way: f64) -> Vec<bool> {
    let up = || answers.iter().filter(|a| a.rising);
    let one = |back: &Answer| {
        let less = |a: &Answer| way.signum() * (back.input / a.input).ln() > BEYOND;
        !back.way.1 && up().any(|a| a.way.0 == back.way.0 && a.got >= back.got && less(a))
    };
    answers.iter().map(one).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A throttle that has stood wide open: on the way back 46 deg hold what 31 held before, which is needless, and what nothing was shown to hold with less is not.
    #[test]
    fn a_way_back_with_needlessly_much_of_the_input_does_not_count() {
        let at = |line: usize, up: bool, got: f64, input: f64| Answer {
            way: (line, up),
            rest: None,
            rising: up,
            at_s: 0.0,
            asked: got,
            got,
            input,
        };
        let up = [(115.0, 24.0), (126.0, 28.0), (131.0, 30.6), (137.0, 32.8)];
        let back = [(141.0, 49.8), (134.0, 46.0), (125.0, 28.5), (116.0, 23.0)];
        let all = |way: f64| -> Vec<Answer> {
            let input = |u: f64| if way > 0.0 { u } else { 1000.0 / u };
            let there = up.iter().map(|(y, u)| at(0, true, *y, input(*u)));
            there.chain(back.iter().map(|(y, u)| at(0, false, *y, input(*u)))).collect()
        };
        let expected = [false, false, false, false, false, true, false, false];
        assert_eq!(needless(&all(1.0), 1.0), expected);
        // An input that goes down with the demand.
        assert_eq!(needless(&all(-1.0), -4.0), expected);
        // Nor by what was reached when it had just begun to go up.
        let mut begun = all(1.0);
        begun[..4].iter_mut().for_each(|a| a.rising = false);
        assert_eq!(needless(&begun, 1.0), [false; 8]);
        // Of another line nothing is known.
        let mut apart = all(1.0);
        apart[4..].iter_mut().for_each(|a| a.way.0 = 1);
        assert_eq!(needless(&apart, 1.0), [false; 8]);
    }

    /// From rest to rest: what the input does there, windows of a rest have in common, and of another pass nothing is known.
    #[test]
    fn slopes_go_from_rest_to_rest() {
        let at = |rest: Option<(usize, usize)>, got: f64, input: f64| Answer {
            way: (0, false),
            rest,
            rising: false,
            at_s: rest.map_or(0.0, |(pass, leg)| (100 * pass + 10 * leg) as f64),
            asked: got,
            got,
            input,
        };
        let rests = [(Some((0, 0)), 100.0, 20.0), (Some((0, 2)), 110.0, 22.0), (Some((0, 4)), 121.0, 44.0)];
        let pairs = rests.iter().flat_map(|(r, y, u)| [at(*r, *y, *u), at(*r, *y, *u)]);
        let mut all: Vec<Answer> = pairs.collect();
        all.push(at(Some((1, 0)), 130.0, 60.0));
        let slopes = measured_slopes(&all, 0.0);
        let steep = 2.0_f64.ln() / 1.1_f64.ln();
        for (found, right) in slopes.iter().zip([1.0, 1.0, steep, steep, steep, steep, 0.0]) {
            assert!((found - right).abs() < 1e-9, "{slopes:?}");
        }
    }

    /// y = 1 - exp(-u): gone up as at rest, and come back from the end through u of 6 to 3.5, where y stays what it was.
    #[test]
    fn a_loop_that_comes_back_from_where_nothing_answers_counts_little() {
        let at = |k: usize, up: bool, asked: f64, input: f64| Answer {
            way: (0, up),
            rest: None,
            rising: up,
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
