//! Lines of a map on a plant: the factors go along a path slowly while loops hold the demands, and everything is averaged over windows.
//!
//! What is averaged lags behind what it would be at rest, one way up and the other way down: a path that goes there and back holds both.

use dynocal_ident::data::Dataset;
use dynocal_ident::plan::Plan;
use dynocal_ident::play::{self, Interruptible, PlayError, Reason};
use serde::{Deserialize, Serialize};

use super::{Part, Station, Touched, Watching, feed_forward, means, schedule};

/// A straight part of a path.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Leg {
    /// Factors at its end.
    pub to: Vec<f64>,
    /// What the inputs of the loops are expected to change along it, by loop: fed forward, so that the loops have only the rest to do.
    pub driven: Vec<f64>,
    /// Factors of the gains of the loops at its end, by loop: they go there along it. 1 where there is none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub gains: Vec<f64>,
    /// Time that it takes in s.
    pub seconds: f64,
}

/// Means over a window of a sweep.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SweepRow {
    /// Factors; demands as measured.
    pub factors: Vec<f64>,
    /// Responses.
    pub responses: Vec<f64>,
    /// Demands as asked for, by loop.
    pub asked: Vec<f64>,
    /// Number of the leg in its middle.
    pub leg: usize,
    /// Whether the input of each loop was at an end of its range, by loop.
    pub at_end: Vec<bool>,
    /// Whether each demand was followed: in the mean it is behind by no more than its course changes over the window; one that is held while anything
    /// changes counts as followed. Where it is not, the loop still moves its input, which then says nothing about what holds the demand.
    pub followed: Vec<bool>,
    /// By how much each demand is missed, in units of what still counts as followed; empty in what older versions kept.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub behind: Vec<f64>,
    /// Bed time at its end, from the begin of the day, in s.
    pub at_s: f64,
}

/// A line that was swept, as far as the limits allowed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Swept {
    /// Windows along the way: one behind the other from where it begins to move, and those of a rest up to its end.
    pub rows: Vec<SweepRow>,
    /// Bed time at which it began, and length of a window, in s; none in what older versions kept, whose windows are one behind the other from the begin on.
    #[serde(default)]
    pub clock_s: Option<[f64; 2]>,
    /// The limit that ended it; none where it came to its end.
    pub touched: Option<Touched>,
    /// Bed time in s, the way to its begin counted in.
    pub used_s: f64,
}

impl Station<'_> {
    /// Goes to `from`, rests there, and goes along `legs`. A limit that is touched on the way there or along it ends the line, and it goes back
    /// leg by leg until the limits are kept: whatever comes next would begin beyond one, and end there.
    ///
    /// # Errors
    /// As of [`Station::measure`].
    pub fn sweep(&mut self, from: &[f64], legs: &[Leg]) -> Result<Swept, PlayError> {
        let begun_s = self.used_s;
        let origin = self.at.clone();
        let driven = self.driven.clone();
        // A path that comes back ends with the gains with which it begins.
        let first = legs.last().filter(|l| l.to == from).map_or(&[][..], |l| &l.gains);
        let drive = self.drive(&[Part { to: from.to_vec(), driven }], first, false)?;
        if let Some(stop) = drive.played.stop.as_ref().filter(|s| s.reason != Reason::Still) {
            let share = (drive.played.played as f64 / drive.ramp.max(1) as f64).min(1.0);
            self.at = between(&origin, from, share);
            let touched = Some(self.touched(stop, self.at.clone())?);
            self.back_within([origin])?;
            let used_s = self.used_s - begun_s;
            return Ok(Swept { rows: Vec::new(), clock_s: None, touched, used_s });
        }
        let dt = self.layout.sample_time_s;
        let samples = |s: f64| (s / dt).round().max(1.0) as usize;
        let ways: Vec<(&[f64], usize)> = legs.iter().map(|l| (&l.to[..], samples(l.seconds))).collect();
        let mut plan = self.layout.along("sweep", from, &ways, &self.driven);
        let changes: Vec<(&[f64], usize)> =
            legs.iter().zip(&ways).map(|(l, w)| (&l.driven[..], w.1)).collect();
        feed_forward(&mut plan, &changes);
        let gains: Vec<(&[f64], usize)> = legs.iter().zip(&ways).map(|(l, w)| (&l.gains[..], w.1)).collect();
        schedule(&mut plan, first, &gains);
        let window = samples(self.spec.window_s).max(2);
        // A plan without a hold is never at rest: only limits are watched.
        let mut watch = Watching::new((&self.guards, &self.tolerances), &plan, plan.len(), window, 1);
        let played = {
            let mut both = Interruptible { interrupt: self.interrupt, watchdog: &mut watch };
            play::play(self.plant, &plan, &mut both)?
        };
        let started_s = self.used_s;
        self.used_s += played.used_s;
        self.keep_driven(&plan, &played.record)?;
        let mut rows = Vec::new();
        for k in windows(from, &ways, window).take_while(|k| k + window <= played.record.len()) {
            let part = played.record.part(k, k + window, "window".into());
            let at_s = started_s + (k + window) as f64 * dt;
            let leg = leg_at(&ways, k + window / 2);
            rows.push(self.row(&plan, (&part, k), leg, at_s)?);
        }
        let clock_s = Some([started_s, window as f64 * dt]);
        self.at = reached(from, &ways, played.played);
        let touched = match played.stop.as_ref() {
            Some(stop) => {
                let touched = self.touched(stop, self.at.clone())?;
                self.back_within(begins(from, &ways, played.played).chain([origin]))?;
                Some(touched)
            }
            None => None,
        };
        Ok(Swept { rows, clock_s, touched, used_s: self.used_s - begun_s })
    }

    /// Goes back to the first of `places` where all limits are kept, or to the last.
    fn back_within(&mut self, places: impl IntoIterator<Item = Vec<f64>>) -> Result<(), PlayError> {
        for place in places {
            let driven = self.driven.clone();
            let drive = self.drive(&[Part { to: place, driven }], &[], true)?;
            if drive.played.stop.is_none_or(|s| s.reason == Reason::Still) {
                break;
            }
        }
        Ok(())
    }

    /// The window `part`, which begins at row `from` of the plan.
    fn row(
        &self,
        plan: &Plan,
        (part, from): (&Dataset, usize),
        leg: usize,
        at_s: f64,
    ) -> Result<SweepRow, PlayError> {
        let (factors, responses) = means(self.layout, part)?;
        let (mut at_end, mut followed, mut missed, mut demands) =
            (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        let course = |values: &[f64]| (values[values.len() - 1] - values[0]).abs();
        // It rests where nothing that is commanded changes.
        let commanded = plan.demands.iter().map(|d| &d.values).chain(plan.channels.iter().map(|c| &c.values));
        let rests = commanded.into_iter().all(|v| course(&v[from..from + part.len()]) == 0.0);
        for (k, d) in plan.demands.iter().enumerate() {
            let (asked, found) = (&d.values[from..from + part.len()], part.values(&d.output)?);
            let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
            demands.push(mean(asked));
            let change = course(asked);
            let behind = (mean(found) - mean(asked)).abs() / change.max(self.tolerances[k].1);
            followed.push(change == 0.0 && !rests || behind <= 1.0);
            missed.push(behind);
        }
        for l in &plan.loops {
            let c = plan.channels.iter().find(|c| c.name == l.input);
            let values = part.values(&l.input)?;
            at_end.push(c.is_some_and(|c| values.iter().any(|u| *u <= c.lower || *u >= c.upper)));
        }
        Ok(SweepRow { factors, responses, asked: demands, leg, at_end, followed, behind: missed, at_s })
    }
}

/// Samples at which windows of a path begin. On the way they stand one behind the other from its begin on; those of a rest end with it, for what counts there is its
/// end, and a rest of other than whole windows would lose it.
fn windows(from: &[f64], ways: &[(&[f64], usize)], window: usize) -> impl Iterator<Item = usize> {
    let (mut begins, mut at, mut now) = (Vec::new(), from, 0);
    let mut leg = 0;
    while leg < ways.len() {
        let rests = ways[leg].0 == at;
        let begin = now;
        // To the end of the rest, or of the way.
        while leg < ways.len() && (ways[leg].0 == at) == rests {
            (at, now) = (ways[leg].0, now + ways[leg].1);
            leg += 1;
        }
        let first = if rests { begin + (now - begin) % window } else { begin };
        begins.extend((first..).step_by(window).take_while(|k| k + window <= now));
    }
    begins.into_iter()
}

/// Number of the leg at a sample.
fn leg_at(ways: &[(&[f64], usize)], sample: usize) -> usize {
    let mut end = 0;
    let found = ways.iter().position(|(_, n)| {
        end += n;
        sample < end
    });
    found.unwrap_or(ways.len().saturating_sub(1))
}

fn between(a: &[f64], b: &[f64], share: f64) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a + share * (b - a)).collect()
}

/// Begins of the leg in which a line ended after so many samples, and of those before it.
fn begins<'a>(
    from: &'a [f64],
    ways: &'a [(&'a [f64], usize)],
    samples: usize,
) -> impl Iterator<Item = Vec<f64>> + 'a {
    let leg = leg_at(ways, samples.saturating_sub(1));
    (0..=leg).rev().map(move |k| k.checked_sub(1).map_or(from, |before| ways[before].0).to_vec())
}

/// Factors that are commanded after so many samples.
fn reached(from: &[f64], ways: &[(&[f64], usize)], samples: usize) -> Vec<f64> {
    let (mut left, mut at) = (samples, from);
    for (to, n) in ways {
        if left < *n {
            return between(at, to, left as f64 / *n as f64);
        }
        (left, at) = (left - n, to);
    }
    at.to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// On the way windows follow each other from its begin, there and back as one; those of a rest end with it, and what is shorter than one has none.
    #[test]
    fn windows_of_a_rest_end_with_it() {
        let (a, b, c) = ([0.0], [1.0], [2.0]);
        let of = |ways: &[(&[f64], usize)]| windows(&a, ways, 4).collect::<Vec<_>>();
        assert_eq!(of(&[(&b, 5), (&c, 6), (&a, 8)]), [0, 4, 8, 12]);
        // 10 samples at rest, 3 on the way, 9 at rest, 9 back, 2 at rest.
        assert_eq!(of(&[(&a, 10), (&b, 3), (&b, 9), (&a, 9), (&a, 2)]), [2, 6, 14, 18, 22, 26]);
        assert_eq!(of(&[(&a, 8), (&b, 4), (&b, 4), (&b, 4)]), [0, 4, 8, 12, 16]);
        assert!(of(&[]).is_empty());
    }
}
