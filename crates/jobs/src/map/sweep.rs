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
//! How the bed goes along the lines: `lines.rs`.

use dynocal_calib::steady::cell::Setting;
use dynocal_calib::steady::layout::{FactorKind, Layout};
use dynocal_calib::steady::trim::{Along, Trim, finer};

use super::drive::Drive;
use super::error::MapError;
use super::lines::{Lines, Window, models_say};
use super::spec::SweepSpec;

impl Lines<'_> {
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

    fn knots(&self, spec: &SweepSpec) -> Vec<Vec<f64>> {
        let one = |(k, a): (usize, &Vec<f64>)| {
            finer(std::slice::from_ref(a), if k == 0 { 1 } else { spec.between })
        };
        self.axes.iter().enumerate().flat_map(one).collect()
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
        let (first, last) = (*self.line.iter().min()?, *self.line.iter().max()?);
        let (mut sum, mut n) = (0.0, 0.0);
        for held in first + 1..last {
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
