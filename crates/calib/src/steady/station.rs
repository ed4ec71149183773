//! One steady point on a plant: approached along a ramp under its limits, backed off where one is touched, held until nothing
//! drifts any more, averaged.
//!
//! ```text
//! x(t) = x_0 + s(t) (x_1 - x_0)                      ramp, s from 0 to 1; or over a corner ([`Corner`])
//! lower <= mean of y over the window <= upper        watched, else the ramp ends at s = s*
//! s <- s* - backoff                                  and it is tried again from there
//! ```

use dynocal_ident::data::Dataset;
use dynocal_ident::derived::DerivedError;
use dynocal_ident::plan::Plan;
use dynocal_ident::plant::{Plant, PlantError, PlantState};
use dynocal_ident::play::{self, Interruptible, PlayError, Played, Reason, Stop};
use serde::{Deserialize, Deserializer, Serialize};

use super::layout::{Layout, ResponseSource};

mod route;
mod sweep;
mod watching;

pub use route::Corner;
use route::{Route, length};
pub use sweep::{Leg, SweepRow, Swept};
use watching::Watching;

/// How points are approached and held.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ApproachSpec {
    /// Time in which a factor goes through its whole range, in s.
    pub ramp_s: f64,
    /// Longest wait at a point in s.
    pub settle_s: f64,
    /// Window in s whose mean is compared with that of the window before, and over which limits are watched.
    pub window_s: f64,
    /// Averaging time after settling in s.
    pub average_s: f64,
    /// Share of the way that is gone back from where a limit was touched.
    pub backoff: f64,
    /// Most times that is done at one point.
    pub backoffs: usize,
}

impl Default for ApproachSpec {
    fn default() -> Self {
        Self { ramp_s: 12.0, settle_s: 25.0, window_s: 2.0, average_s: 4.0, backoff: 0.15, backoffs: 4 }
    }
}

/// An output that is watched while points are approached.
#[derive(Clone, Debug, PartialEq)]
pub struct Guard {
    /// Output of the plant.
    pub output: String,
    /// Least value.
    pub lower: f64,
    /// Greatest value.
    pub upper: f64,
    /// Change from window to window that counts as none; 0: by the size of the output.
    pub resolution: f64,
}

/// A limit that was touched on the way.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Touched {
    /// Output, or what the plant calls it.
    pub output: String,
    /// What was met.
    #[serde(deserialize_with = "gap")]
    pub value: f64,
    /// The limit.
    #[serde(deserialize_with = "gap")]
    pub limit: f64,
    /// Factors as commanded there.
    pub factors: Vec<f64>,
    /// What happened, in words.
    pub words: String,
}

/// A point that was measured, or that could not be.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SteadyPoint {
    /// Factors that were asked for.
    pub asked: Vec<f64>,
    /// Mean factors while averaging; demands as measured. Not a number where nothing was measured, in files `null`.
    #[serde(deserialize_with = "gaps")]
    pub factors: Vec<f64>,
    /// Mean responses.
    #[serde(deserialize_with = "gaps")]
    pub responses: Vec<f64>,
    /// Mean errors of the demands, measured less demanded.
    #[serde(deserialize_with = "gaps")]
    pub errors: Vec<f64>,
    /// Whether it may be learnt from.
    pub usable: bool,
    /// Why not, or what is to be known about it; empty for a point as asked.
    pub note: String,
    /// Limits that were touched on the way.
    pub touched: Vec<Touched>,
    /// Inputs of loops that stood at an end of their range.
    pub saturated: Vec<String>,
    /// Bed time at its end, from the begin of the day, in s.
    pub at_s: f64,
    /// Bed time that it took in s.
    pub used_s: f64,
}

/// JSON has no number that is none.
fn gap<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(from)?.unwrap_or(f64::NAN))
}

fn gaps<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<f64>, D::Error> {
    let all: Vec<Option<f64>> = Vec::deserialize(from)?;
    Ok(all.into_iter().map(|v| v.unwrap_or(f64::NAN)).collect())
}

/// Where a station stands: enough to go on from there as if it had never been left.
#[derive(Clone, Debug, PartialEq)]
pub struct Stand {
    /// State of the plant.
    pub plant: PlantState,
    /// Factors that are commanded.
    pub at: Vec<f64>,
    /// Inputs of the loops, in their order.
    pub driven: Vec<f64>,
    /// Bed time so far in s.
    pub used_s: f64,
}

/// A station that goes from point to point.
pub struct Station<'a> {
    plant: &'a mut dyn Plant,
    layout: &'a Layout,
    spec: &'a ApproachSpec,
    guards: Vec<Guard>,
    /// Change of each demand that counts as none, and error above which a held demand is missed.
    tolerances: Vec<(f64, f64)>,
    at: Vec<f64>,
    driven: Vec<f64>,
    /// Bed time so far in s.
    pub used_s: f64,
    interrupt: &'a dyn Fn() -> bool,
}

/// Change of an output that counts as none, as a share of the range of its demand or of the size of its limit.
const RESOLUTION: f64 = 2e-3;
/// Error of a held demand above which it is missed, as a share of its range.
const MISSED: f64 = 0.0125;

/// Share of the ranges up to which nothing counts as moved.
const STOOD: f64 = 0.02;

/// A straight part of a way: where it ends, and where the inputs of the loops are expected there.
struct Part {
    to: Vec<f64>,
    driven: Vec<f64>,
}

/// Where one plan ended.
struct Drive {
    played: Played,
    /// Rows of the ramp.
    ramp: usize,
    settled: bool,
    /// Outputs that did not rest at the end, where it has not settled.
    restless: Vec<String>,
    saturated: Vec<String>,
}

/// Why a point was given up, with the output that was farthest beyond its limit as a share of it; `begun`: the first was met before anything had moved.
fn given_up(touched: &[Touched], begun: bool) -> String {
    let beyond = |t: &&Touched| (t.value - t.limit).abs() / t.limit.abs().max(f64::MIN_POSITIVE);
    let worst = touched.iter().max_by(|a, b| beyond(a).total_cmp(&beyond(b)));
    let worst = worst.map_or(String::new(), |t| format!(", `{}` beyond its limit of {}", t.output, t.limit));
    let stood = if begun {
        ". The first was met before anything had moved: where the bed stood is outside of its limits (a day begins in the middle of its axes, with the inputs of `start`)"
    } else {
        ""
    };
    format!("given up after {} limits on the way{worst}{stood}", touched.len())
}

impl<'a> Station<'a> {
    /// At the factors `at` with the driven inputs `driven` (by loop). `beyond` says how far past a limit the bed may go while a
    /// point is approached, by output.
    pub fn new(
        plant: &'a mut dyn Plant,
        layout: &'a Layout,
        spec: &'a ApproachSpec,
        beyond: &dyn Fn(&str) -> f64,
        (at, driven): (Vec<f64>, Vec<f64>),
        interrupt: &'a dyn Fn() -> bool,
    ) -> Self {
        let watched = layout.responses.iter().filter(|r| r.source == ResponseSource::Output && !r.slow);
        let guards = watched.map(|r| {
            let ends = [r.lower, r.upper].into_iter().flatten();
            let size = ends.map(f64::abs).fold(0.0, f64::max);
            Guard {
                output: r.name.clone(),
                lower: r.lower.map_or(f64::NEG_INFINITY, |l| l - beyond(&r.name)),
                upper: r.upper.map_or(f64::INFINITY, |u| u + beyond(&r.name)),
                resolution: RESOLUTION * size,
            }
        });
        let guards = guards.collect();
        let ranges = layout.problem.demands.iter().map(|d| d.upper - d.lower);
        let tolerances = ranges.map(|r| (RESOLUTION * r, MISSED * r)).collect();
        Self { plant, layout, spec, guards, tolerances, at, driven, used_s: 0.0, interrupt }
    }

    /// Factors that are commanded now.
    pub fn at(&self) -> &[f64] {
        &self.at
    }

    /// Where it stands.
    pub fn stand(&self) -> Stand {
        let (plant, at, driven) = (self.plant.save(), self.at.clone(), self.driven.clone());
        Stand { plant, at, driven, used_s: self.used_s }
    }

    /// Goes on from where an earlier station of the same plant stood.
    ///
    /// # Errors
    /// [`PlantError::Call`]: the state is not that of this plant.
    pub fn go_on(&mut self, from: &Stand) -> Result<(), PlantError> {
        self.plant.restore(&from.plant)?;
        self.at.clone_from(&from.at);
        self.driven.clone_from(&from.driven);
        self.used_s = from.used_s;
        Ok(())
    }

    /// From now on limits may be passed by a share of their size on the way: what is approached is no exploration any more.
    pub fn widen(&mut self, share: f64) {
        for g in &mut self.guards {
            // An open side stays open.
            g.upper += if g.upper.is_finite() { share * g.upper.abs() } else { 0.0 };
            g.lower -= if g.lower.is_finite() { share * g.lower.abs() } else { 0.0 };
        }
    }

    /// Goes to `target` and measures there, or as near as the limits allow: straight, or over the corner `via`. `driven` says where the inputs of the
    /// loops are expected to stand there (by loop, none where it is empty): it is fed forward along the ramp. `gains` are factors of the gains of the
    /// loops there (by loop, 1 where it is empty), where what the inputs do is another than where the loops were tuned; they come in along the ramp.
    ///
    /// # Errors
    /// [`PlayError`]: the plan does not fit the plant, the plant refused it, or the user interrupted.
    pub fn measure(
        &mut self,
        target: &[f64],
        via: Option<&Corner>,
        driven: &[f64],
        gains: &[f64],
    ) -> Result<SteadyPoint, PlayError> {
        let (origin, begun_s) = (self.at.clone(), self.used_s);
        let stood = self.driven.clone();
        let route = Route::new(&self.layout.factors, (&origin, &stood), via, (target, driven));
        let (mut share, mut from, mut touched) = (1.0, 0.0, Vec::new());
        let mut begun = false;
        for attempt in 0..=self.spec.backoffs {
            let part = |s: f64| Part { to: route.at(s), driven: route.driven(s, &self.driven) };
            let parts: Vec<Part> = route.ends(from, share).into_iter().map(part).collect();
            let gains: Vec<f64> = gains.iter().map(|g| between_gains(1.0, *g, share)).collect();
            let drive = self.drive(&parts, &gains, attempt > 0)?;
            let Some(stop) = drive.played.stop.as_ref().filter(|s| s.reason != Reason::Still) else {
                return self.point(target, &drive, touched, begun_s);
            };
            let done = (drive.played.played as f64 / drive.ramp.max(1) as f64).min(1.0);
            let reached = from + done * (share - from);
            touched.push(self.touched(stop, route.at(reached))?);
            let gone = length(&self.layout.factors, &origin, &route.at(reached));
            begun |= attempt == 0 && gone <= STOOD;
            self.at = route.at(reached);
            (from, share) = (reached, (reached - self.spec.backoff).max(0.0));
        }
        // Back to where it began.
        let part = |s: f64| Part { to: route.at(s), driven: route.driven(s, &stood) };
        let back: Vec<Part> = route.ends(from, 0.0).into_iter().map(part).collect();
        self.drive(&back, &[], true)?;
        let note = given_up(&touched, begun);
        Ok(SteadyPoint {
            asked: target.to_vec(),
            factors: vec![f64::NAN; target.len()],
            responses: vec![f64::NAN; self.layout.responses.len()],
            errors: vec![f64::NAN; self.layout.problem.demands.len()],
            usable: false,
            note,
            touched,
            saturated: Vec::new(),
            at_s: self.used_s,
            used_s: self.used_s - begun_s,
        })
    }

    fn touched(&self, stop: &Stop, factors: Vec<f64>) -> Result<Touched, PlayError> {
        let (value, limit) = match &stop.reason {
            Reason::Measured { value, limit } => (*value, *limit),
            Reason::Event(e) => (e.value, e.limit),
            _ => {
                let plan = "steady point".to_string();
                return Err(PlayError::Ended { plan, samples: stop.sample, stop: Box::new(stop.clone()) });
            }
        };
        Ok(Touched { output: stop.output.clone(), value, limit, factors, words: stop.to_string() })
    }

    /// Plays ramps along `parts` and a hold at the end, the inputs of the loops fed forward to where they are expected and their gains brought to those
    /// `gains` times as large; on the way back limits are watched only once it is there.
    fn drive(&mut self, parts: &[Part], gains: &[f64], back: bool) -> Result<Drive, PlayError> {
        let dt = self.layout.sample_time_s;
        let samples = |s: f64| (s / dt).round().max(1.0) as usize;
        let mut now = &self.at;
        let mut ways: Vec<(&[f64], usize)> = Vec::with_capacity(parts.len() + 1);
        for p in parts {
            ways.push((&p.to, samples(self.spec.ramp_s * length(&self.layout.factors, now, &p.to))));
            now = &p.to;
        }
        let to = now.clone();
        let ramp: usize = ways.iter().map(|w| w.1).sum();
        ways.push((&to, samples(self.spec.settle_s + self.spec.average_s)));
        let mut plan = self.layout.along("point", &self.at, &ways, &self.driven);
        let befores = std::iter::once(&self.driven).chain(parts.iter().map(|p| &p.driven));
        let changes = parts.iter().zip(befores).map(|(p, before)| -> Vec<f64> {
            p.driven.iter().zip(before).map(|(to, now)| to - now).collect()
        });
        let changes: Vec<Vec<f64>> = changes.collect();
        let spans: Vec<(&[f64], usize)> = changes.iter().zip(&ways).map(|(c, w)| (&c[..], w.1)).collect();
        feed_forward(&mut plan, &spans);
        schedule(&mut plan, &[], &[(gains, ramp.max(1))]);
        let window = samples(self.spec.window_s).max(2);
        let mut watch = Watching::new(
            (&self.guards, &self.tolerances),
            &plan,
            ramp,
            window,
            samples(self.spec.average_s),
        );
        if back {
            watch.watched_from += ramp;
        }
        let played = {
            let mut both = Interruptible { interrupt: self.interrupt, watchdog: &mut watch };
            play::play(self.plant, &plan, &mut both)?
        };
        let (settled, restless) = (watch.left.is_some(), std::mem::take(&mut watch.restless));
        let saturated = plan.loops.iter().zip(&watch.saturated).filter(|(_, s)| **s);
        let saturated = saturated.map(|(l, _)| l.input.clone()).collect();
        self.used_s += played.used_s;
        self.keep_driven(&plan, &played.record)?;
        self.at = to;
        Ok(Drive { played, ramp, settled, restless, saturated })
    }

    /// Where the loops left their inputs.
    fn keep_driven(&mut self, plan: &Plan, record: &Dataset) -> Result<(), PlayError> {
        for (k, l) in plan.loops.iter().enumerate() {
            if let Some(last) = record.values(&l.input)?.last() {
                self.driven[k] = *last;
            }
        }
        Ok(())
    }

    fn point(
        &self,
        target: &[f64],
        drive: &Drive,
        touched: Vec<Touched>,
        begun_s: f64,
    ) -> Result<SteadyPoint, PlayError> {
        let dt = self.layout.sample_time_s;
        let n = (self.spec.average_s / dt).round().max(1.0) as usize;
        let record = &drive.played.record;
        let end = record.len();
        let averaged = record.part(end.saturating_sub(n), end, "average".into());
        let (factors, responses) = means(self.layout, &averaged)?;
        let mut errors = Vec::new();
        for (k, d) in self.layout.problem.demands.iter().enumerate() {
            let values = averaged.values(&d.output)?;
            let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
            errors.push(mean - self.layout.demand(k, &self.at));
        }
        let held = record.part(drive.ramp.min(end), end, "hold".into());
        let mut oscillation = None;
        for l in &self.layout.loops {
            oscillation = oscillation.or(play::oscillation(&held, l)?);
        }
        let mut notes = Vec::new();
        if let Some(o) = &oscillation {
            notes.push(o.to_string());
        } else if !drive.settled {
            let restless = drive.restless.join("`, `");
            notes.push(format!("`{restless}` not at rest after {} s", self.spec.settle_s));
        }
        // A demand that is a factor counts as it was measured; one that is held must be met.
        let missed = self.layout.problem.demands.iter().enumerate().filter(|(k, d)| {
            self.layout.held.contains_key(&d.output) && errors[*k].abs() > self.tolerances[*k].1
        });
        let missed: Vec<String> =
            missed.map(|(k, d)| format!("`{}` is missed by {:.4} {}", d.output, errors[k], d.unit)).collect();
        let finite = factors.iter().chain(&responses).all(|v| v.is_finite());
        let usable = finite && oscillation.is_none() && drive.settled && missed.is_empty();
        notes.extend(missed);
        if !touched.is_empty() {
            notes.push(format!("backed off {} times", touched.len()));
        }
        Ok(SteadyPoint {
            asked: target.to_vec(),
            factors,
            responses,
            errors,
            usable,
            note: notes.join("; "),
            touched,
            saturated: drive.saturated.clone(),
            at_s: self.used_s,
            used_s: self.used_s - begun_s,
        })
    }
}

/// Adds to the inputs of the loops what they are expected to change (by loop) over each of some spans of samples; after the last they stay.
fn feed_forward(plan: &mut Plan, changes: &[(&[f64], usize)]) {
    for (l, which) in plan.loops.clone().iter().enumerate() {
        let Some(c) = plan.channels.iter_mut().find(|c| c.name == which.input) else { continue };
        let (lower, upper) = (c.lower, c.upper);
        let (mut gone, mut rest) = (0.0, c.values.iter_mut());
        for (change, n) in changes {
            let more = change.get(l).copied().unwrap_or(0.0);
            for (k, value) in rest.by_ref().take(*n).enumerate() {
                *value = (*value + gone + more * (k + 1) as f64 / *n as f64).clamp(lower, upper);
            }
            gone += more;
        }
        rest.for_each(|value| *value = (*value + gone).clamp(lower, upper));
    }
}

/// Factor of a gain a share of the way from one to another. What the input does, its inverse, is nearer to straight: gains that came in by even steps
/// would be too large under way.
fn between_gains(from: f64, to: f64, share: f64) -> f64 {
    1.0 / (1.0 / from + share * (1.0 / to - 1.0 / from))
}

/// Brings the gains of the loops from those `from` times as large (by loop; 1 where there is none) to others over each of some spans of samples;
/// after the last they stay.
fn schedule(plan: &mut Plan, from: &[f64], factors: &[(&[f64], usize)]) {
    let samples = plan.len();
    let of = |all: &[f64], l: usize| all.get(l).copied().filter(|g| g.is_finite() && *g > 0.0).unwrap_or(1.0);
    for (l, which) in plan.loops.iter_mut().enumerate() {
        let mut now = of(from, l);
        if now == 1.0 && factors.iter().all(|(to, _)| of(to, l) == 1.0) {
            continue;
        }
        let mut course = Vec::with_capacity(samples);
        for (to, n) in factors {
            let to = of(to, l);
            course.extend((1..=*n).map(|k| between_gains(now, to, k as f64 / *n as f64)));
            now = to;
        }
        course.resize(samples, now);
        which.schedule = course;
    }
}

/// Means over a record.
fn means(layout: &Layout, record: &Dataset) -> Result<(Vec<f64>, Vec<f64>), PlayError> {
    layout.means(record).map_err(|e| match e {
        DerivedError::Data(e) => PlayError::Data(e),
        e => PlayError::Model { output: "a derived channel".into(), reason: e.to_string() },
    })
}
