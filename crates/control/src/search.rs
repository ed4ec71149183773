//! The search of the plane for the fastest settling that keeps margins, for PI and PID.
//!
//! ```text
//! PI    least worst settling time over all plants, subject to the margins on all plants
//! PID   the same for derivative gains kd = f |C(jw)| / w of that PI, w its crossover, with a filter of kd / (10 |C(jw)|), then with
//!       others of the best kd
//! ```
//!
//! Candidates are a raster of the area in which gains are stable on all plants, and for a fan of kp, from the ends of its range by
//! halves to zero, the ki that keep Ms: what keeps margins can be a thousandth of what is stable (a lightly damped plant under a PI).

use dynocal_numerics::interval::Interval;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::error::ControlError;
use crate::matrix::C;
use crate::plane::Channel;
use crate::system::Time;
use crate::tune::{Asked, FINER, StepRun, Tuned, judged, soon_settled_s};

/// Steps in each direction of the plane.
const RASTER: usize = 28;
/// Halvings of kp in the fan, and the shares of each interval of ki that are tried.
const FAN: i32 = 14;
const SHARES: [f64; 8] = [0.98, 0.8, 0.6, 0.45, 0.3, 0.15, 0.05, 0.01];
/// Share of the largest kp that is searched below zero.
const BELOW: f64 = 0.25;
/// Candidates that are run at a time, and how much longer than the best one's settling time a run is that shows who is slower.
const ROUND: usize = 32;
const LONGER: f64 = 1.3;
/// Rounds of refinement about the best point.
const ROUNDS: usize = 8;
/// Factors f of the derivative that are tried, and the ratio of neighbours, whose roots are tried about the best.
const DERIVATIVES: usize = 8;
const RATIO: f64 = 3.0;
const CLOSER: [f64; 3] = [0.5, 0.25, 0.125];
/// The same of its filter alone.
const CLOSER_FILTER: [f64; 2] = [1.0, 0.5];
/// Factors in a row that keep everything and are no faster, after which the rest is left out, and how many are tried in any case.
const PAST: usize = 2;
const UNTRIED: usize = 4;
/// Most frequencies of a loop whose derivative part is searched where a PI holds the plant too.
const LONGEST: usize = 10_000;
/// Size of the derivative part at high frequencies over that of the PI at its crossover.
const LIFT: f64 = 10.0;

/// What the search of the plane found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Choice {
    /// The gains: the fastest that keep everything, else those nearest to what is asked.
    pub tuned: Tuned,
    /// Whether they keep everything on every plant.
    pub kept: bool,
    /// Range of kp and of ki that was searched.
    pub kp: Interval,
    /// Range of ki.
    pub ki: Interval,
    /// The raster: for each ki (rows) and kp (columns) the worst ratio of asked to had over all plants; none: not stable on
    /// all.
    pub raster: Vec<Option<f64>>,
    /// Values of kp of its columns.
    pub kp_values: Vec<f64>,
    /// Values of ki of its rows.
    pub ki_values: Vec<f64>,
}

/// What the search for a PID found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PidChoice {
    /// The plane of the derivative part that was chosen.
    pub choice: Choice,
    /// Derivative gain in input unit x s per output unit; 0 where no derivative part that was tried settles faster.
    pub kd: f64,
    /// Time constant of its filter in s.
    pub filter_s: f64,
    /// The best PI; none where no PI is stable.
    pub pi: Option<Tuned>,
}

/// How good gains are: whether they keep everything, and then the worst settling time in s, else the worst ratio of asked to had.
#[derive(Clone, Copy, PartialEq)]
struct Score {
    keeps: bool,
    value: f64,
}

impl Score {
    fn beats(&self, other: &Self) -> bool {
        (self.keeps && !other.keeps) || (self.keeps == other.keeps && self.value < other.value)
    }
}

/// Gains with the worst ratio of asked to had, and how far the next look goes.
#[derive(Clone, Copy)]
struct Candidate {
    violation: f64,
    kp: f64,
    ki: f64,
    step: (f64, f64),
}

/// Gains with what they are worth, and how far the next look goes.
#[derive(Clone, Copy)]
struct Found {
    score: Score,
    kp: f64,
    ki: f64,
    step: (f64, f64),
}

struct Search<'a> {
    channels: &'a [Channel],
    asked: &'a Asked,
    run: StepRun,
    kp: Interval,
    ki: Interval,
}

/// Searches the plane for the fastest settling that keeps `asked` on all channels.
///
/// # Errors
/// [`ControlError::Unstable`] where no PI (with the channels' derivative part) makes all plants stable.
pub fn choose(channels: &[Channel], asked: &Asked, r: StepRun) -> Result<Choice, ControlError> {
    let (kp, ki) = bounds(channels)?;
    let search = Search { channels, asked, run: r, kp, ki };
    let inner = |i: &Interval, k: usize| i.lower + (i.upper - i.lower) * (k as f64 + 0.5) / RASTER as f64;
    let kp_values: Vec<f64> = (0..RASTER).map(|k| inner(&kp, k)).collect();
    // Small gains take most of the area of what keeps margins: squares of even steps.
    let ki_values: Vec<f64> =
        (0..RASTER).map(|k| ki.upper * ((k as f64 + 0.5) / RASTER as f64).powi(2)).collect();
    let raster: Vec<Option<f64>> = (0..RASTER * RASTER)
        .into_par_iter()
        .map(|k| search.worst(kp_values[k % RASTER], ki_values[k / RASTER]))
        .collect();
    let width = (kp.upper - kp.lower) / RASTER as f64;
    let on_raster = |k: usize| {
        let (kp, ki) = (kp_values[k % RASTER], ki_values[k / RASTER]);
        Some(Candidate { violation: raster[k]?, kp, ki, step: (width, 0.3 * ki) })
    };
    let mut candidates: Vec<Candidate> = (0..RASTER * RASTER).filter_map(on_raster).collect();
    candidates.extend(search.fan());
    let first = search.best_of(candidates);
    let none = || ControlError::Unstable {
        what: "every PI that was tried on all set points".into(),
        poles: "the raster of the plane".into(),
    };
    let best = search.refined(first.ok_or_else(none)?);
    let tuned = judged("search", &channels[0].gains(best.kp, best.ki), channels, asked, r);
    let kept = asked.kept_by(&tuned);
    Ok(Choice { tuned, kept, kp, ki, raster, kp_values, ki_values })
}

/// Searches derivative parts as well; `filter_s` is their filter where it is given.
///
/// # Errors
/// As of [`choose`] for the PI.
pub fn choose_pid(
    channels: &[Channel],
    asked: &Asked,
    filter_s: Option<f64>,
    r: StepRun,
) -> Result<PidChoice, ControlError> {
    let pi = choose(channels, asked, r);
    let alone = pi.is_ok();
    // A plant that keeps a gain at all frequencies bears a derivative of half what the gain margin leaves there.
    let keeps = channels.iter().map(Channel::at_infinity).fold(0.0, f64::max) * 2.0 * asked.gain_margin;
    let continuous = channels.iter().any(|c| c.time == Time::Continuous);
    let finest_s = if continuous { r.step_s / FINER } else { 0.0 };
    let at = |kd: f64, own_s: f64| -> Option<(Choice, f64, f64)> {
        let filter_s = filter_s.unwrap_or(own_s.max(kd * keeps));
        let with: Vec<Channel> =
            channels.iter().map(|c| c.with_derivative(kd, filter_s)).collect::<Result<_, _>>().ok()?;
        // Behind so long a delay a derivative earns little, and a search would take minutes.
        if alone && with.iter().any(|c| c.grid.len() > LONGEST) {
            return None;
        }
        Some((choose(&with, asked, r).ok()?, kd, filter_s))
    };
    let better = |a: &Option<(Choice, f64, f64)>, b: &Option<(Choice, f64, f64)>| match (a, b) {
        (Some(a), Some(b)) => worth(&a.0).beats(&worth(&b.0)),
        (a, b) => a.is_some() && b.is_none(),
    };
    // Gains and filters about the PI's crossover; where no PI is stable, those of a derivative part that crosses over somewhere.
    let (starts, pi) = match pi {
        Ok(c) => {
            let (size, w_rad_s) = crossover(channels, &c.tuned);
            let kd = |k: usize| RATIO.powi(1 - k as i32) * size / w_rad_s;
            ((0..DERIVATIVES).map(|k| (kd(k), kd(k) / (LIFT * size))).collect::<Vec<_>>(), Ok((c, 0.0, 0.0)))
        }
        Err(e) => (by_frequency(&channels[0]), Err(e)),
    };
    let plain = pi.as_ref().ok().map(|c| c.0.tuned.clone());
    let (mut best, refused) = match pi {
        Ok(c) => (Some(c), None),
        Err(e) => (None, Some(e)),
    };
    let mut about = None;
    let mut slower = 0;
    for (k, (kd, own_s)) in starts.into_iter().enumerate() {
        // Runs cannot show a finer filter, and a derivative that is past its best no longer does anything.
        if own_s < finest_s || (k >= UNTRIED && slower >= PAST) {
            continue;
        }
        let found = at(kd, own_s);
        slower += usize::from(found.as_ref().is_some_and(|f| f.0.tuned.violation <= Some(1.0)));
        if better(&found, &best) {
            (best, about, slower) = (found, Some((kd, own_s)), 0);
        }
    }
    for closer in CLOSER {
        let Some((kd, own_s)) = about else { break };
        for factor in [RATIO.powf(closer), RATIO.powf(-closer)] {
            if own_s * factor < finest_s {
                continue;
            }
            let found = at(kd * factor, own_s * factor);
            if better(&found, &best) {
                (best, about) = (found, Some((kd * factor, own_s * factor)));
            }
        }
    }
    // The filter alone: how much of a derivative's size at high frequencies margins bear is not known before.
    for closer in CLOSER_FILTER {
        let Some((kd, own_s)) = about.filter(|_| filter_s.is_none()) else { break };
        for factor in [RATIO.powf(closer), RATIO.powf(-closer)] {
            if own_s * factor < finest_s {
                continue;
            }
            let found = at(kd, own_s * factor);
            if better(&found, &best) {
                (best, about) = (found, Some((kd, own_s * factor)));
            }
        }
    }
    let none =
        || ControlError::Unstable { what: "every PID that was tried".into(), poles: "the plane".into() };
    let (choice, kd, filter_s) = best.ok_or_else(|| refused.unwrap_or_else(none))?;
    Ok(PidChoice { choice, kd, filter_s, pi: plain })
}

/// What a choice is worth among others.
fn worth(c: &Choice) -> Score {
    match (c.tuned.violation, c.tuned.settling_s) {
        (Some(v), _) if v > 1.0 => Score { keeps: false, value: v },
        (Some(_), Some(s)) => Score { keeps: true, value: s },
        _ => Score { keeps: false, value: f64::INFINITY },
    }
}

/// Derivative gains, with their filters in s, that make the loop gain 1 at frequencies along the grid.
fn by_frequency(channel: &Channel) -> Vec<(f64, f64)> {
    let n = channel.grid.len();
    let at = |k: usize| {
        let place = n * (2 * k + 1) / (2 * 2 * DERIVATIVES);
        let (w, size) = (channel.grid[place], channel.response[place].norm());
        (1.0 / (w * size), 1.0 / (LIFT * w))
    };
    (0..2 * DERIVATIVES).map(at).filter(|(kd, _)| kd.is_finite() && *kd > 0.0).collect()
}

/// Size of the PI at the slowest crossover of its loops, and that frequency in rad/s.
fn crossover(channels: &[Channel], pi: &Tuned) -> (f64, f64) {
    let own = pi.margins.iter().flatten().map(|m| m.phase_rad_s.unwrap_or(m.sensitivity_rad_s));
    let least = own.filter(|w| *w > 0.0).fold(f64::INFINITY, f64::min);
    let middle = || channels[0].grid[channels[0].grid.len() / 2];
    let w_rad_s = if least.is_finite() { least } else { middle() };
    (C::new(pi.kp, -pi.ki / w_rad_s).norm().max(f64::MIN_POSITIVE), w_rad_s)
}

impl Search<'_> {
    /// Worst ratio of asked to had over all channels; none where one is not stable.
    fn worst(&self, kp: f64, ki: f64) -> Option<f64> {
        self.channels.iter().try_fold(0.0, |w: f64, c| Some(w.max(self.asked.violation(&c.margins(kp, ki)?))))
    }

    fn score(&self, kp: f64, ki: f64, best: &Score) -> Option<Score> {
        Some(self.settled(self.worst(kp, ki)?, kp, ki, best))
    }

    /// What gains are worth. Against gains that settle in a time, a run a little longer than that is enough to see that others do not.
    fn settled(&self, violation: f64, kp: f64, ki: f64, best: &Score) -> Score {
        if violation > 1.0 {
            return Score { keeps: false, value: violation };
        }
        let r = self.run;
        let never = r.step_s * r.rows as f64 * 2.0;
        let time = |r: StepRun| {
            let own = |c: &Channel| soon_settled_s(c, &c.gains(kp, ki), r).unwrap_or(never);
            self.channels.iter().map(own).fold(0.0, f64::max)
        };
        if best.keeps {
            let rows = (LONGER * best.value / r.step_s) as usize + 20;
            if rows < r.rows && time(StepRun { rows, ..r }) >= best.value {
                return Score { keeps: true, value: never };
            }
        }
        Score { keeps: true, value: time(r) }
    }

    /// Highest frequency in rad/s at which the first channel's loop gain is above a half.
    fn bandwidth_rad_s(&self, c: &Candidate) -> f64 {
        let channel = &self.channels[0];
        let above = |k: &usize| channel.open_at(*k, c.kp, c.ki).norm() > 0.5;
        (0..channel.grid.len()).rev().find(above).map_or(0.0, |k| channel.grid[k])
    }

    /// The best candidate, the widest bandwidth first: it is mostly the fastest. Rounds of a fixed size, so that the answer
    /// does not hang on the number of threads.
    fn best_of(&self, all: Vec<Candidate>) -> Option<Found> {
        // What keeps everything, the widest bandwidth first, then what misses by least.
        let place = |c: &Candidate| match c.violation <= 1.0 {
            true => (false, -self.bandwidth_rad_s(c)),
            false => (true, c.violation),
        };
        let mut placed: Vec<((bool, f64), Candidate)> = all.into_par_iter().map(|c| (place(&c), c)).collect();
        placed.sort_by(|(a, _), (b, _)| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
        let all: Vec<Candidate> = placed.into_iter().map(|(_, c)| c).collect();
        let mut best: Option<Found> = None;
        for round in all.chunks(ROUND) {
            let against = best.map_or(Score { keeps: false, value: f64::INFINITY }, |b| b.score);
            let found: Vec<Found> = round
                .par_iter()
                .map(|c| {
                    let score = self.settled(c.violation, c.kp, c.ki, &against);
                    Found { score, kp: c.kp, ki: c.ki, step: c.step }
                })
                .collect();
            for f in found {
                if best.as_ref().is_none_or(|b| f.score.beats(&b.score)) {
                    best = Some(f);
                }
            }
        }
        best
    }

    /// For each kp of the fan the ki that keep Ms on all channels.
    fn fan(&self) -> Vec<Candidate> {
        let halves = (0..=FAN).map(|k| 0.5f64.powi(k));
        let mut all: Vec<f64> = halves.flat_map(|s| [s * self.kp.upper, s * self.kp.lower]).collect();
        all.push(0.0);
        let smallest = self.kp.upper.abs().max(self.kp.lower.abs()) * 0.5f64.powi(FAN + 1);
        let of = |kp: &f64| -> Vec<Candidate> {
            let mut left = vec![Interval { lower: 0.0, upper: self.ki.upper }];
            for c in self.channels {
                let own = c.ki_with_sensitivity(*kp, self.asked.sensitivity);
                left = left.iter().flat_map(|a| own.iter().filter_map(|b| met(a, b))).collect();
            }
            let inside = left.iter().flat_map(|i| SHARES.map(|s| i.lower + s * (i.upper - i.lower)));
            let found = inside.filter_map(|ki| {
                let step = (0.4 * kp.abs().max(smallest), 0.3 * ki);
                Some(Candidate { violation: self.worst(*kp, ki)?, kp: *kp, ki, step })
            });
            found.collect()
        };
        all.par_iter().map(of).collect::<Vec<_>>().into_iter().flatten().collect()
    }

    /// The best about a point: steps in eight directions, halved where none is better.
    fn refined(&self, mut best: Found) -> Found {
        let (mut dp, mut di) = best.step;
        for _ in 0..ROUNDS {
            let around: Vec<(f64, f64)> = (0..9)
                .filter(|k| *k != 4)
                .map(|k| (f64::from(k / 3 - 1), f64::from(k % 3 - 1)))
                .map(|(a, b)| (best.kp + a * dp, (best.ki + b * di).max(1e-9 * self.ki.upper)))
                .collect();
            let found: Vec<Option<Score>> =
                around.par_iter().map(|(p, i)| self.score(*p, *i, &best.score)).collect();
            let before = best.score;
            for (score, (kp, ki)) in found.into_iter().zip(around) {
                if let Some(score) = score.filter(|s| s.beats(&best.score)) {
                    best = Found { score, kp, ki, step: best.step };
                }
            }
            if best.score == before {
                (dp, di) = (0.5 * dp, 0.5 * di);
            }
        }
        best
    }
}

fn met(a: &Interval, b: &Interval) -> Option<Interval> {
    let both = Interval { lower: a.lower.max(b.lower), upper: a.upper.min(b.upper) };
    (both.upper > both.lower).then_some(both)
}

/// Range of kp and ki in which gains can be stable on all channels.
fn bounds(channels: &[Channel]) -> Result<(Interval, Interval), ControlError> {
    let mut kp = Interval { lower: f64::NEG_INFINITY, upper: f64::INFINITY };
    let mut ki = f64::INFINITY;
    for c in channels {
        let ranges = c.kp_ranges();
        let none = || ControlError::Unstable {
            what: "the channel under every PI that was tried".into(),
            poles: "no stable range of kp was found".into(),
        };
        let (first, last) = (ranges.first().ok_or_else(none)?, ranges.last().ok_or_else(none)?);
        kp = Interval { lower: kp.lower.max(first.lower), upper: kp.upper.min(last.upper) };
        let own = (0..24).map(|k| first.lower + (last.upper - first.lower) * (f64::from(k) + 0.5) / 24.0);
        let top = own.filter_map(|p| c.stable_ki(p).last().map(|i| i.upper)).fold(0.0, f64::max);
        ki = ki.min(1.1 * top);
    }
    // Below zero the proportional part takes from the integral one, which an inverse response may ask for: a part of the range.
    kp.lower = kp.lower.max(if kp.upper > 0.0 { -BELOW * kp.upper } else { f64::NEG_INFINITY });
    if !(kp.upper > kp.lower && ki > 0.0) {
        return Err(ControlError::Unstable {
            what: "every PI on all set points together".into(),
            poles: "their stable sets do not meet".into(),
        });
    }
    Ok((kp, Interval { lower: 0.0, upper: ki }))
}
