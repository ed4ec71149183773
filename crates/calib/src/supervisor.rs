//! Plays a plan on a plant, watches its outputs, and goes back to a safe point before a limit is passed.
//!
//! A step of the plan is taken only if the way back from there is predicted to keep all limits (a backup manoeuvre as
//! in T. Gurriet et al., IEEE Access 8 (2020) 187249-187263): with the free run f of the model on what was applied so
//! far, then the step, then the ramp to the safe point,
//!
//! ```text
//! e(t) = y(t) - f(t)                                    error of the model so far
//! p(t + h) = f(t + h) + d(t),  d = e, smoothed          prediction (constant output disturbance)
//! c(s) = max_{h <= H} |e(s) - d(s - h)|                 what a prediction up to H samples before had missed
//! b(t + h) = max(margin, max_s c(s), r |f(t + h) - f0|) band: never below what was seen in this run
//! r = max_s c(s) / |f(s) - f0|                          errors grow with the distance to the safe point f0
//! lower <= p(t + h) -+ b(t + h) <= upper, h = 0 .. H    or the plan ends here
//! ```
//!
//! The way back was predicted to be safe one step before, so that it is there when it is needed. An output without a
//! model is watched by its measured value and its margin alone. No prediction can promise what a plant does that is
//! unlike anything the model and this run have seen: the margin is for that.

use dynocal_ident::data::{Channel, DataError, Dataset, Role};
use dynocal_ident::model::{Model, Run};
use dynocal_ident::plant::{Causality, LimitEvent, Plant, PlantError, variable_index};
use serde::Serialize;

/// A test to play.
#[derive(Clone, Debug)]
pub struct Plan<'a> {
    /// Sample time in s.
    pub sample_time_s: f64,
    /// Inputs of the plant that the plan drives (m); the others stay at their start values.
    pub inputs: &'a [String],
    /// Samples (N x m).
    pub u: &'a [f64],
    /// Safe operating point (m): the plan starts from it and the way back leads to it.
    pub safe: &'a [f64],
    /// Largest change per sample on the way back (m).
    pub rate_per_sample: &'a [f64],
    /// Samples at the safe point before the plan, and after a way back.
    pub settle: usize,
}

/// The model of a watched output; its inputs are those of the plan, in the same order.
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

/// Why a plan ended early.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Reason {
    /// The next step or the way back from it was predicted to pass a limit.
    Predicted {
        /// Predicted value with its band.
        value: f64,
        /// The limit.
        limit: f64,
        /// Samples ahead.
        ahead: usize,
    },
    /// The measured value came within the margin of a limit, or passed it.
    Measured {
        /// Value.
        value: f64,
        /// The limit.
        limit: f64,
    },
    /// The plant reported a limit of its own.
    Event(LimitEvent),
    /// The plant refused the inputs.
    Refused(String),
}

/// Where a plan ended early, and why.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Stop {
    /// First sample of the plan that was not played.
    pub sample: usize,
    /// Output, or what the plant calls it.
    pub output: String,
    /// Why.
    pub reason: Reason,
}

/// A plan that was played.
#[derive(Clone, Debug)]
pub struct Played {
    /// Inputs of the plan and all outputs of the plant: settling, the plan as far as it went, the way back.
    pub record: Dataset,
    /// Samples before the plan.
    pub before: usize,
    /// Samples of the plan that were played.
    pub played: usize,
    /// Why it ended early; none where the plan was played to its end.
    pub stop: Option<Stop>,
    /// Least distance of each watched output to a limit, measured; negative: passed.
    pub least_distance: Vec<f64>,
}

/// A plan cannot be played.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SupervisorError {
    /// The plant does not know a name, or fails at the safe point.
    #[error(transparent)]
    Plant(#[from] PlantError),
    /// Lengths do not fit.
    #[error("plan: found {found} values for {what}, expected {expected}")]
    Shape {
        /// What.
        what: &'static str,
        /// Found.
        found: usize,
        /// Expected.
        expected: usize,
    },
    /// The safe point is not safe.
    #[error("the safe point is outside of the limits of `{output}`: {value} against {lower} to {upper}")]
    Unsafe {
        /// Output.
        output: String,
        /// Measured there.
        value: f64,
        /// Least value.
        lower: f64,
        /// Largest value.
        upper: f64,
    },
    /// The record.
    #[error(transparent)]
    Data(#[from] DataError),
}

/// Share of the newest error in the smoothed one.
const NEWEST: f64 = 0.5;
/// Distance to the safe point, in margins, from which on errors count as shares of it.
const SHARE_FROM: f64 = 2.0;

/// One watched output with what its model has done so far.
struct Tracker<'a> {
    watched: &'a Watched<'a>,
    /// Column among the plant's outputs.
    column: usize,
    /// Free run, one value per row.
    free: Vec<f64>,
    smooth: Vec<f64>,
    /// Largest error of a prediction so far, and the same as a share of the distance to the safe point.
    seen: f64,
    share: f64,
    /// Free run at the safe point.
    rest: f64,
    least: f64,
}

/// Plays `plan` from the present state of `plant`.
///
/// # Errors
/// [`SupervisorError`] before anything is played: names, lengths, a safe point that is not safe. What happens during
/// the plan is no error but a [`Stop`].
pub fn play(plant: &mut dyn Plant, plan: &Plan, watched: &[Watched]) -> Result<Played, SupervisorError> {
    let mut session = Session::new(plant, plan, watched)?;
    let lag = watched.iter().filter_map(|w| w.predictor).map(|p| p.model.max_lag()).max().unwrap_or(0);
    let before = plan.settle.max(lag + 1);
    for _ in 0..before {
        session.step(plan.safe)?;
    }
    session.check_safe_point()?;
    session.trackers.iter_mut().for_each(Tracker::begin);
    let _ = session.plant.take_events();
    let m = plan.inputs.len();
    let (mut played, mut stop) = (0, None);
    for u in plan.u.chunks_exact(m) {
        stop = session.objection(u).or_else(|| session.attempt(u)).map(|(output, reason)| Stop {
            sample: played,
            output,
            reason,
        });
        match &stop {
            None => played += 1,
            // The step was taken before its measured value spoke against the next one.
            Some(Stop { reason: Reason::Measured { .. } | Reason::Event(_), .. }) => {
                played += 1;
                break;
            }
            Some(_) => break,
        }
    }
    if let Some(s) = &mut stop {
        s.sample = played;
        session.go_back()?;
    }
    let least_distance = session.trackers.iter().map(|t| t.least).collect();
    Ok(Played { record: session.record()?, before, played, stop, least_distance })
}

struct Session<'a> {
    plant: &'a mut dyn Plant,
    plan: &'a Plan<'a>,
    /// Inputs of the plant, all of them.
    inputs: Vec<f64>,
    /// Place of each plan input among them.
    places: Vec<usize>,
    outputs: Vec<f64>,
    /// Applied inputs of the plan, and outputs, row by row.
    u: Vec<f64>,
    y: Vec<f64>,
    trackers: Vec<Tracker<'a>>,
}

impl<'a> Session<'a> {
    fn new(
        plant: &'a mut dyn Plant,
        plan: &'a Plan<'a>,
        watched: &'a [Watched<'a>],
    ) -> Result<Self, SupervisorError> {
        let m = plan.inputs.len();
        let shapes = [
            ("the safe point", plan.safe.len(), m),
            ("the rates", plan.rate_per_sample.len(), m),
            ("the samples", plan.u.len() % m.max(1), 0),
        ];
        if let Some((what, found, expected)) = shapes.into_iter().find(|s| s.1 != s.2) {
            return Err(SupervisorError::Shape { what, found, expected });
        }
        let variables = plant.variables();
        let of = |c| variables.iter().filter(move |v| v.causality == c);
        let inputs: Vec<f64> = of(Causality::Input).map(|v| v.start).collect();
        let outputs = vec![0.0; of(Causality::Output).count()];
        let places = plan
            .inputs
            .iter()
            .map(|n| variable_index(plant, Causality::Input, n))
            .collect::<Result<Vec<_>, _>>()?;
        let mut trackers = Vec::new();
        for w in watched {
            if let Some(p) = w.predictor
                && p.model.n_inputs() != m
            {
                let (what, found) = ("the inputs of a model", p.model.n_inputs());
                return Err(SupervisorError::Shape { what, found, expected: m });
            }
            let column = variable_index(plant, Causality::Output, &w.output)?;
            trackers.push(Tracker {
                watched: w,
                column,
                free: Vec::new(),
                smooth: Vec::new(),
                seen: 0.0,
                share: 0.0,
                rest: 0.0,
                least: f64::INFINITY,
            });
        }
        Ok(Self { plant, plan, inputs, places, outputs, u: Vec::new(), y: Vec::new(), trackers })
    }

    /// Applies one row and measures.
    fn step(&mut self, u: &[f64]) -> Result<(), PlantError> {
        for (place, v) in self.places.iter().zip(u) {
            self.inputs[*place] = *v;
        }
        self.plant.step(&self.inputs, self.plan.sample_time_s, &mut self.outputs)?;
        self.u.extend_from_slice(u);
        self.y.extend_from_slice(&self.outputs);
        let horizon = self.horizon(u);
        for t in &mut self.trackers {
            t.measured(&self.u, u.len(), self.outputs[t.column], horizon);
        }
        Ok(())
    }

    /// Samples that a prediction has to look ahead from `u`: the way back and the memory of the models.
    fn horizon(&self, u: &[f64]) -> usize {
        let memory = self.trackers.iter().filter_map(|t| t.watched.predictor).map(|p| 2 * p.model.max_lag());
        self.way_back(u).count() + memory.max().unwrap_or(0) + 1
    }

    /// Inputs on the way from `u` to the safe point.
    fn way_back(&self, u: &[f64]) -> impl Iterator<Item = Vec<f64>> + 'a {
        let plan = self.plan;
        let mut at = u.to_vec();
        std::iter::from_fn(move || {
            if at.iter().zip(plan.safe).all(|(a, s)| a == s) {
                return None;
            }
            for ((a, s), rate) in at.iter_mut().zip(plan.safe).zip(plan.rate_per_sample) {
                // A rate that is no limit leads there at once.
                let rate = if *rate > 0.0 { *rate } else { f64::INFINITY };
                *a += (s - *a).clamp(-rate, rate);
            }
            Some(at.clone())
        })
    }

    /// What speaks against taking the step `u`.
    fn objection(&self, u: &[f64]) -> Option<(String, Reason)> {
        let memory = self.horizon(u) - self.way_back(u).count();
        let still = std::iter::repeat_n(self.plan.safe.to_vec(), memory);
        let ahead: Vec<f64> =
            std::iter::once(u.to_vec()).chain(self.way_back(u)).chain(still).flatten().collect();
        self.trackers.iter().find_map(|t| t.objection(&self.u, &ahead, u.len()))
    }

    /// Takes the step; what speaks against the next one.
    fn attempt(&mut self, u: &[f64]) -> Option<(String, Reason)> {
        if let Err(e) = self.step(u) {
            let name = match &e {
                PlantError::OutOfRange { name, .. } | PlantError::NonFinite { name, .. } => name.clone(),
                PlantError::Call(_) => "plant".into(),
            };
            return Some((name, Reason::Refused(e.to_string())));
        }
        let event = self.plant.take_events().into_iter().next();
        event
            .map(|e| (e.what.clone(), Reason::Event(e)))
            .or_else(|| self.trackers.iter().find_map(|t| t.too_near(self.outputs[t.column])))
    }

    fn check_safe_point(&self) -> Result<(), SupervisorError> {
        for t in &self.trackers {
            let (value, w) = (self.outputs[t.column], t.watched);
            if !(w.lower <= value && value <= w.upper) {
                let output = w.output.clone();
                return Err(SupervisorError::Unsafe { output, value, lower: w.lower, upper: w.upper });
            }
        }
        Ok(())
    }

    /// The way back and a while at the safe point.
    fn go_back(&mut self) -> Result<(), PlantError> {
        let m = self.plan.inputs.len();
        let last = self.u[self.u.len() - m..].to_vec();
        for u in self.way_back(&last) {
            self.step(&u)?;
        }
        for _ in 0..self.plan.settle {
            self.step(self.plan.safe)?;
        }
        Ok(())
    }

    fn record(&self) -> Result<Dataset, SupervisorError> {
        let variables = self.plant.variables();
        let find = |name: &str| variables.iter().find(|v| v.name == name).map_or("-", |v| v.unit.as_str());
        let column = |values: &[f64], i: usize, width: usize| -> Vec<f64> {
            values.iter().skip(i).step_by(width).copied().collect()
        };
        let channel =
            |name: &str, role, values| Channel { name: name.into(), unit: find(name).into(), role, values };
        let m = self.plan.inputs.len();
        let inputs =
            self.plan.inputs.iter().enumerate().map(|(i, n)| channel(n, Role::Input, column(&self.u, i, m)));
        let names = variables.iter().filter(|v| v.causality == Causality::Output).map(|v| v.name.clone());
        let width = self.outputs.len();
        let outputs = names.enumerate().map(|(i, n)| channel(&n, Role::Output, column(&self.y, i, width)));
        let record = Dataset {
            name: "played".into(),
            sample_time_s: self.plan.sample_time_s,
            channels: inputs.chain(outputs).collect(),
            init_samples: 0,
            origin: self.plant.describe(),
        };
        record.check()?;
        Ok(record)
    }
}

impl Tracker<'_> {
    /// The plan begins: how the free run went to its own operating point before is no error of the plan.
    fn begin(&mut self) {
        (self.seen, self.share) = (0.0, 0.0);
        self.rest = self.free.last().copied().unwrap_or(0.0);
        self.smooth = self.smooth.last().copied().into_iter().collect();
    }

    /// Free run over the rows of `u` after those that are there, from the values before them.
    fn predicted(&self, p: Predictor, u: &[f64], m: usize) -> Vec<f64> {
        let (lag, have, n) = (p.model.max_lag(), self.free.len(), u.len() / m);
        let from = have - lag;
        let mut initial = self.free[from..].to_vec();
        initial.resize(n - from, 0.0);
        let mut y = vec![0.0; n - from];
        p.model.simulate(p.theta, &Run { u: &u[from * m..], y: &initial, start: lag }, &mut y);
        y.split_off(lag)
    }

    /// A new measured value `y` after the last row of `u` (rows x m).
    fn measured(&mut self, u: &[f64], m: usize, y: f64, horizon: usize) {
        let w = self.watched;
        self.least = self.least.min((w.upper - y).min(y - w.lower));
        let Some(p) = w.predictor else { return };
        // Before the longest lag has passed the free run is what was measured.
        let free = match self.free.len() > p.model.max_lag() {
            true => self.predicted(p, u, m)[0],
            false => y,
        };
        let error = y - free;
        let first = self.smooth.len().saturating_sub(horizon);
        let missed = self.smooth[first..].iter().map(|d| (error - d).abs()).fold(0.0, f64::max);
        self.seen = self.seen.max(missed);
        // Near the safe point the share would be noise over nothing.
        let excursion = (free - self.rest).abs();
        if excursion > SHARE_FROM * w.margin {
            self.share = self.share.max(missed / excursion);
        }
        let smooth = self.smooth.last().map_or(error, |d| d + NEWEST * (error - d));
        self.free.push(free);
        self.smooth.push(smooth);
    }

    /// Half width of the band about a prediction whose free run is `free`.
    fn band(&self, free: f64) -> f64 {
        self.watched.margin.max(self.seen).max(self.share * (free - self.rest).abs())
    }

    /// The first predicted value over the rows `ahead` that passes a limit.
    fn objection(&self, u: &[f64], ahead: &[f64], m: usize) -> Option<(String, Reason)> {
        let w = self.watched;
        let p = w.predictor?;
        let rows: Vec<f64> = u[self.start(m, p)..].iter().chain(ahead).copied().collect();
        let lag = p.model.max_lag();
        let d = self.smooth.last().copied().unwrap_or(0.0);
        let n = rows.len() / m;
        let mut initial = self.free[self.free.len() - lag..].to_vec();
        initial.resize(n, 0.0);
        let mut y = vec![0.0; n];
        p.model.simulate(p.theta, &Run { u: &rows, y: &initial, start: lag }, &mut y);
        y[lag..].iter().enumerate().find_map(|(ahead, f)| {
            let (value, band) = (f + d, self.band(*f));
            let passes =
                |value: f64, limit: f64| Some((w.output.clone(), Reason::Predicted { value, limit, ahead }));
            // A prediction that is not finite is within no limit.
            if !(f64::NEG_INFINITY..=w.upper).contains(&(value + band)) {
                passes(value + band, w.upper)
            } else if !(w.lower..=f64::INFINITY).contains(&(value - band)) {
                passes(value - band, w.lower)
            } else {
                None
            }
        })
    }

    fn start(&self, m: usize, p: Predictor) -> usize {
        (self.free.len() - p.model.max_lag()) * m
    }

    /// A measured value that is too near a limit: within the margin where no model looks ahead, beyond the limit
    /// otherwise.
    fn too_near(&self, y: f64) -> Option<(String, Reason)> {
        let w = self.watched;
        let margin = if w.predictor.is_some() { 0.0 } else { w.margin };
        let limit = if y > w.upper - margin {
            w.upper
        } else if !(w.lower + margin..=f64::INFINITY).contains(&y) {
            w.lower
        } else {
            return None;
        };
        Some((w.output.clone(), Reason::Measured { value: y, limit }))
    }
}
