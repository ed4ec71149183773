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
//! A window counts where all demands were followed (at the end of a rest less, where a held one is missed a little: `Window::weight`) and the loop had room, and where the maps still go through it: what lines find at the ends
//! of the driven inputs is learnt (`reach.rs`) and may move the optimum. Nor does one count in which the demand was there in passing only
//! (`windows.rs`), or the way back had needlessly much of the input: a throttle that has stood wide open holds with 46 deg what 31 had held before, both are
//! true, and no smooth map goes through both. What is between them passed for a lag of the way, which goes on beyond where there is one way alone.
//!
//! Of lines that rest at each value of the first axis (`bed.sweep.rest_s`) windows of rests alone count; there is no way back then, and what is needless on one is not sought.
//!
//! How the bed goes along the lines: `lines.rs`; what the first of them do to the optimum: `walk.rs`.

use dynocal_calib::steady::day::DayPoint;
use dynocal_calib::steady::trim::{Along, Trim, finer};
use dynocal_numerics::watch::Watch;

use super::along;
use super::answers::{Answer, measured_slopes, needless};
use super::drive::{self, Drive, Set};
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

    /// Learns maps of driven inputs again with points of the lines, and trims them. They take the place of those that were learnt without where less is left, if that
    /// pays between lines, too: learnt with and trimmed by every second line alone they have to miss less of the others than those of the points, trimmed by the
    /// same lines. A model that goes through all that lines showed may go anywhere between them (12 % of torque on a day of `gtdi_2l`).
    ///
    /// # Errors
    /// [`MapError`].
    pub(super) fn learn_again(
        &self,
        rows: &[Window],
        drives: &mut [Drive],
        learnt: Vec<Vec<Drive>>,
        points: &[DayPoint],
        watch: Watch,
    ) -> Result<(), MapError> {
        let (known, held): (Vec<Window>, Vec<Window>) = rows.iter().cloned().partition(|w| w.line % 2 == 0);
        let learn = |rows: &[Window]| -> Result<(Vec<Vec<Drive>>, usize), MapError> {
            let more = self.points(rows);
            Ok((drive::learn(self.layout, &[points, &more].concat(), self.spec, watch)?, more.len()))
        };
        let trimmed = |mut all: Vec<Vec<Drive>>, rows: &[Window]| -> Result<Vec<Drive>, MapError> {
            let mut first: Vec<Drive> = all.iter_mut().map(|all| all.remove(0)).collect();
            self.trim(rows, &mut first, all)?;
            Ok(first)
        };
        let (half, of_known) = learn(&known)?;
        let others = self.points(&held).len();
        if of_known == 0 || others == 0 {
            return Ok(());
        }
        let missed = |all, rows| self.missed_by(&held, &trimmed(all, rows)?);
        let (without, with) = (missed(learnt, &known)?, missed(half, &known)?);
        if !with.iter().zip(&without).any(|(with, without)| with < without) {
            return Ok(());
        }
        let (again, more) = learn(rows)?;
        for (l, new) in trimmed(again, rows)?.into_iter().enumerate() {
            if with[l] < without[l] {
                new.in_place_of(&mut drives[l], more);
            }
        }
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
        let used = self.used(l, drive, rows)?;
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
                weight: self.weight(w) * weight(*steep, slopes[i]),
            })
            .collect();
        drive.compare(self.axes, &set);
        Ok(())
    }

    /// Windows of `rows` that tell something of loop `l`, with the slopes that were measured beside them.
    fn used<'w>(
        &self,
        l: usize,
        drive: &Drive,
        rows: &[&'w Window],
    ) -> Result<Vec<(&'w Window, f64)>, MapError> {
        let room = |w: &Window| !w.row.at_end[l] && self.weight(w) > 0.0;
        // Between all windows of a way: those beside one that counts may not count themselves.
        let answers = self.answers(l, drive, rows);
        let measured = measured_slopes(&answers, 1.5 * self.spec.bed.approach.window_s);
        let steep = |k: usize| measured.get(k).copied().unwrap_or(0.0);
        let all: Vec<Vec<f64>> = rows.iter().map(|w| w.row.factors.clone()).collect();
        let way = slopes(self.layout, self.setting, l, drive, &all)?.iter().sum();
        let needless = needless(&answers, way);
        let counts = |k: usize, w: &Window| room(w) && !needless.get(k).copied().unwrap_or(false);
        let each = rows.iter().enumerate();
        Ok(each.filter(|(k, w)| counts(*k, w)).map(|(k, w)| (*w, steep(k))).collect())
    }

    /// How much of the demands trimmed maps of driven inputs miss in windows of lines that had no part in them, by loop: sums of squares. Not a number where that is
    /// not known.
    pub(super) fn missed_by(&self, rows: &[Window], drives: &[Drive]) -> Result<Vec<f64>, MapError> {
        let one = |(l, drive): (usize, &Drive)| {
            let Some(trimmed) = &drive.trimmed else { return Ok(f64::NAN) };
            let used = self.used(l, drive, &self.on_the_maps(rows, &[l]))?;
            let told = Told { l, used: &used, knots: &[] };
            if used.is_empty() { Ok(f64::NAN) } else { self.left(&told, drive, trimmed.demand) }
        };
        drives.iter().enumerate().map(one).collect()
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

    /// How much a window counts by how well the demands were followed.
    fn weight(&self, w: &Window) -> f64 {
        w.weight(&|l| self.layout.demand_factor(l).is_none())
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
            (e, self.weight(w) * weight(*steep, slope))
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
