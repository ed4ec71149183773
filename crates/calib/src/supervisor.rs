//! Watches a plan while it is played, and goes back to a safe point before a limit is passed.
//!
//! A sample of the plan is applied only if the way back from there is predicted to keep all limits (a backup manoeuvre as
//! in T. Gurriet et al., IEEE Access 8 (2020) 187249-187263): with the free run f of the model on what was applied so
//! far, then the sample, then the ramp to the safe point,
//!
//! ```text
//! e(t) = y(t) - f(t)                                    error of the model so far
//! p(t + h) = f(t + h) + d(t),  d = e, smoothed          prediction (constant output disturbance)
//! c(s) = max_{h <= H} |e(s) - d(s - h)|                 what a prediction up to H samples before had missed
//! b(t + h) = max(margin, max_s c(s), r |f(t + h) - f0|) band: never below what was seen in this run
//! r = max_s c(s) / |f(s) - f0|                          errors grow with the distance to the safe point f0
//! lower <= p(t + h) -+ b(t + h) <= upper, h = 1 .. H    or the plan ends here
//! ```
//!
//! The safe point is what was applied at the end of settling; the way back leads there at the rates of the channels, loops
//! open. What a closed loop is about to apply is known when it is about to be applied, so that plans with loops are
//! watched in the same way. The way back was predicted to be safe one step before, so that it is there when it is needed. An
//! output without a model is watched by its measured value and its margin alone. No prediction can promise what a plant does that
//! is unlike anything the model and this run have seen: the margin is for that.

use dynocal_ident::model::{Model, Run};
use dynocal_ident::plan::Plan;
use dynocal_ident::plant::LimitEvent;
use dynocal_ident::play::{Course, PlayError, Reason, Stop, Watchdog};
use dynocal_numerics::interval::Interval;

/// The model of a watched output; its inputs are the channels of the plan, in the same order.
#[derive(Clone, Copy)]
pub struct Predictor<'a> {
    /// Model.
    pub model: &'a dyn Model,
    /// Parameters.
    pub theta: &'a [f64],
}

/// An output that is watched.
#[derive(Clone)]
pub struct Watched<'a> {
    /// Name of the plant's output.
    pub output: String,
    /// Least value.
    pub lower: f64,
    /// Largest value.
    pub upper: f64,
    /// Distance that predictions keep from both (see [`dynocal_design::schedule`]).
    pub margin: f64,
    /// Its model, if there is one.
    pub predictor: Option<Predictor<'a>>,
}

/// Share of the newest error in the smoothed one.
const NEWEST: f64 = 0.5;
/// Distance to the safe point, in margins, from which on errors count as shares of it.
const SHARE_FROM: f64 = 2.0;
/// Most samples of a way back: a rate that would take longer leads there at once.
const LONGEST: usize = 100_000;

/// The watchdog of limits, with predictions where there are models.
pub struct Supervisor<'a> {
    trackers: Vec<Tracker<'a>>,
    /// Largest change per sample on the way back (m).
    rate_per_sample: Vec<f64>,
    /// Samples at the safe point after the way back.
    settle: usize,
}

/// The supervisor of the limits of `plan`: each output with its model where `models` has one (by output), by its measured
/// value and margin where it has none.
pub fn for_plan<'a>(plan: &Plan, models: &[(&str, Predictor<'a>)]) -> Supervisor<'a> {
    let watched = plan.limits.iter().map(|l| {
        let Interval { lower, upper } = l.range();
        let predictor = models.iter().find(|(output, _)| *output == l.output).map(|(_, p)| *p);
        Watched { output: l.output.clone(), lower, upper, margin: l.margin, predictor }
    });
    Supervisor::new(watched.collect())
}

impl<'a> Supervisor<'a> {
    /// Watches these outputs.
    pub fn new(watched: Vec<Watched<'a>>) -> Self {
        let tracker = |watched| Tracker {
            watched,
            column: 0,
            free: Vec::new(),
            smooth: Vec::new(),
            seen: 0.0,
            share: 0.0,
            rest: 0.0,
        };
        let trackers = watched.into_iter().map(tracker).collect();
        Self { trackers, rate_per_sample: Vec::new(), settle: 0 }
    }

    /// Inputs on the way from `u` to the safe point, row by row.
    fn ramp(&self, u: &[f64], safe: &[f64]) -> Vec<f64> {
        let mut at = u.to_vec();
        let mut rows = Vec::new();
        for k in 0.. {
            if at == safe {
                break;
            }
            for ((a, s), rate) in at.iter_mut().zip(safe).zip(&self.rate_per_sample) {
                *a = if k < LONGEST { *a + (s - *a).clamp(-rate, *rate) } else { *s };
            }
            rows.extend_from_slice(&at);
        }
        rows
    }

    /// Samples that models remember, so that a prediction has to look as far beyond the way back.
    fn memory(&self) -> usize {
        let lags = self.trackers.iter().filter_map(|t| t.watched.predictor).map(|p| 2 * p.model.max_lag());
        lags.max().unwrap_or(0) + 1
    }
}

impl Watchdog for Supervisor<'_> {
    fn prepare(&mut self, plan: &Plan, course: &Course) -> Result<usize, PlayError> {
        let m = plan.channels.len();
        let per_sample = |rate: Option<f64>| rate.map_or(f64::INFINITY, |r| r * plan.sample_time_s);
        self.rate_per_sample = plan.channels.iter().map(|c| per_sample(c.rate_per_s)).collect();
        self.settle = plan.settling_samples();
        let mut least = 1;
        for t in &mut self.trackers {
            let output = &t.watched.output;
            let refused = |reason| PlayError::Model { output: output.clone(), reason };
            t.column = course.outputs.iter().position(|o| o == output).ok_or_else(|| {
                refused(format!("the plant has no such output; outputs are: {}", course.outputs.join(", ")))
            })?;
            if let Some(p) = t.watched.predictor {
                let found = p.model.n_inputs();
                if found != m {
                    return Err(refused(format!(
                        "found {found} inputs, expected the {m} channels of the plan"
                    )));
                }
                least = least.max(p.model.max_lag() + 2);
            }
        }
        Ok(least)
    }

    fn begin(&mut self, course: &Course) -> Result<(), PlayError> {
        let now = course.output(course.rows());
        for t in &self.trackers {
            let (value, w) = (now[t.column], &t.watched);
            if !(w.lower <= value && value <= w.upper) {
                let output = w.output.clone();
                return Err(PlayError::Unsafe { output, value, lower: w.lower, upper: w.upper });
            }
        }
        self.trackers.iter_mut().for_each(|t| t.begin(course));
        Ok(())
    }

    fn before(&mut self, course: &Course, next_u: &[f64]) -> Option<Stop> {
        let way = self.ramp(next_u, course.safe());
        let memory = self.memory();
        let horizon = way.len() / next_u.len() + memory;
        let mut ahead = next_u.to_vec();
        ahead.extend(way);
        (0..memory).for_each(|_| ahead.extend_from_slice(course.safe()));
        let looks: Vec<Option<Look>> =
            self.trackers.iter().map(|t| t.look(course, &ahead, horizon)).collect();
        for (t, look) in self.trackers.iter().zip(&looks) {
            if let Some(reason) = look.as_ref().and_then(|l| t.objection(l)) {
                return Some(Stop::new(&t.watched.output, reason));
            }
        }
        for (t, look) in self.trackers.iter_mut().zip(looks) {
            look.into_iter().for_each(|l| t.take(&l));
        }
        None
    }

    fn after(&mut self, course: &Course, events: &[LimitEvent]) -> Option<Stop> {
        if let Some(e) = events.first() {
            return Some(Stop::new(&e.what, Reason::Event(e.clone())));
        }
        let now = course.output(course.rows());
        self.trackers.iter().find_map(|t| t.too_near(now[t.column]))
    }

    fn way_back(&mut self, course: &Course) -> Vec<f64> {
        let safe = course.safe();
        let last = course.rows().checked_sub(1).map_or(safe, |i| course.input(i));
        let mut rows = self.ramp(last, safe);
        (0..self.settle).for_each(|_| rows.extend_from_slice(safe));
        rows
    }
}

/// One watched output with what its model has done so far.
struct Tracker<'a> {
    watched: Watched<'a>,
    /// Column among the plant's outputs.
    column: usize,
    /// Free run, one value per row from row 1 on: row 0 answers to nothing that was applied.
    free: Vec<f64>,
    smooth: Vec<f64>,
    /// Largest error of a prediction so far, and the same as a share of the distance to the safe point.
    seen: f64,
    share: f64,
    /// Free run at the safe point.
    rest: f64,
}

/// A look ahead from the row that is about to be applied: its free run, and what follows from the value measured with it.
struct Look {
    /// Free run of this row and of those after it.
    free: Vec<f64>,
    smooth: f64,
    seen: f64,
    share: f64,
}

impl Tracker<'_> {
    /// The rows of settling; how the free run went to its own operating point there is no error of the plan.
    fn begin(&mut self, course: &Course) {
        (self.free, self.smooth) = (Vec::new(), Vec::new());
        let Some(p) = self.watched.predictor else { return };
        let lag = p.model.max_lag();
        for i in 1..course.rows() {
            let y = course.output(i)[self.column];
            // Before the longest lag has passed the free run is what was measured.
            let free = if self.free.len() > lag { self.run(course, p, course.input(i))[0] } else { y };
            let error = y - free;
            let smooth = self.smooth.last().map_or(error, |d| d + NEWEST * (error - d));
            self.free.push(free);
            self.smooth.push(smooth);
        }
        (self.seen, self.share) = (0.0, 0.0);
        self.rest = self.free.last().copied().unwrap_or(0.0);
        self.smooth = self.smooth.last().copied().into_iter().collect();
    }

    /// Free run over the rows `ahead` (rows x m) that follow those that are there.
    fn run(&self, course: &Course, p: Predictor, ahead: &[f64]) -> Vec<f64> {
        let (lag, have, m) = (p.model.max_lag(), self.free.len(), course.inputs.len());
        // The free run begins with row 1.
        let known = &course.u[(1 + have - lag) * m..(1 + have) * m];
        let rows: Vec<f64> = known.iter().chain(ahead).copied().collect();
        let n = rows.len() / m;
        let mut initial = self.free[have - lag..].to_vec();
        initial.resize(n, 0.0);
        let mut y = vec![0.0; n];
        p.model.simulate(p.theta, &Run { u: &rows, y: &initial, start: lag }, &mut y);
        y.split_off(lag)
    }

    fn look(&self, course: &Course, ahead: &[f64], horizon: usize) -> Option<Look> {
        let p = self.watched.predictor?;
        let free = self.run(course, p, ahead);
        let error = course.output(course.rows())[self.column] - free[0];
        let first = self.smooth.len().saturating_sub(horizon);
        let missed = self.smooth[first..].iter().map(|d| (error - d).abs()).fold(0.0, f64::max);
        // Near the safe point the share would be noise over nothing.
        let excursion = (free[0] - self.rest).abs();
        let share = match excursion > SHARE_FROM * self.watched.margin {
            true => self.share.max(missed / excursion),
            false => self.share,
        };
        let smooth = self.smooth.last().map_or(error, |d| d + NEWEST * (error - d));
        Some(Look { free, smooth, seen: self.seen.max(missed), share })
    }

    fn take(&mut self, look: &Look) {
        self.free.push(look.free[0]);
        self.smooth.push(look.smooth);
        (self.seen, self.share) = (look.seen, look.share);
    }

    /// The first predicted value that passes a limit.
    fn objection(&self, look: &Look) -> Option<Reason> {
        let w = &self.watched;
        look.free.iter().enumerate().skip(1).find_map(|(ahead, f)| {
            // Half width of the band about a prediction.
            let band = w.margin.max(look.seen).max(look.share * (f - self.rest).abs());
            let value = f + look.smooth;
            // A prediction that is not finite is within no limit.
            if !(f64::NEG_INFINITY..=w.upper).contains(&(value + band)) {
                Some(Reason::Predicted { value: value + band, limit: w.upper, ahead })
            } else if !(w.lower..=f64::INFINITY).contains(&(value - band)) {
                Some(Reason::Predicted { value: value - band, limit: w.lower, ahead })
            } else {
                None
            }
        })
    }

    /// A measured value that is too near a limit: within the margin where no model looks ahead, beyond the limit
    /// otherwise.
    fn too_near(&self, y: f64) -> Option<Stop> {
        let w = &self.watched;
        let margin = if w.predictor.is_some() { 0.0 } else { w.margin };
        let limit = if y > w.upper - margin {
            w.upper
        } else if !(w.lower + margin..=f64::INFINITY).contains(&y) {
            w.lower
        } else {
            return None;
        };
        Some(Stop::new(&w.output, Reason::Measured { value: y, limit }))
    }
}
