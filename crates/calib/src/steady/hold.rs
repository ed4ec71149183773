//! Holding an operating point: loops drive their inputs until the outputs have come to rest, then everything is averaged.

use dynocal_ident::plan::Plan;
use dynocal_ident::plant::{LimitEvent, Plant};
use dynocal_ident::play::{self, Course, Oscillation, PlayError, Reason, Stop, Watchdog};
use serde::{Deserialize, Serialize};

/// When a point counts as settled, and for how long it is averaged.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HoldSpec {
    /// Longest wait in s (the thesis waits 9 s).
    pub settle_s: f64,
    /// Window in s whose mean is compared with that of the window before.
    pub window_s: f64,
    /// Averaging time after settling in s.
    pub average_s: f64,
}

impl Default for HoldSpec {
    fn default() -> Self {
        Self { settle_s: 9.0, window_s: 0.5, average_s: 1.0 }
    }
}

impl HoldSpec {
    /// Samples that a plan of a hold needs.
    pub fn samples(&self, sample_time_s: f64) -> usize {
        ((self.settle_s + self.average_s) / sample_time_s).ceil() as usize
    }
}

/// A held point.
#[derive(Clone, Debug, PartialEq)]
pub struct Held {
    /// Mean inputs while averaging, in the order of the channels of the plan.
    pub inputs: Vec<f64>,
    /// Mean outputs while averaging, in the order of the outputs of the plan.
    pub outputs: Vec<f64>,
    /// Mean errors of the resting outputs, measured less demanded.
    pub errors: Vec<f64>,
    /// Whether the means stopped drifting within the time, and no loop oscillates.
    pub settled: bool,
    /// A loop that swings: its means are no point of rest.
    pub oscillation: Option<Oscillation>,
    /// Bed time in s.
    pub used_s: f64,
}

/// Running mean and scatter of a window.
#[derive(Clone, Copy, Debug, Default)]
struct Window {
    n: f64,
    mean: f64,
    squares: f64,
}

impl Window {
    fn of(values: impl Iterator<Item = f64>) -> Self {
        let mut w = Self::default();
        for v in values {
            w.n += 1.0;
            let d = v - w.mean;
            w.mean += d / w.n;
            w.squares += d * (v - w.mean);
        }
        w
    }

    /// Variance of the mean, as if samples were independent.
    fn variance_of_mean(&self) -> f64 {
        self.squares / (self.n - 1.0).max(1.0) / self.n.max(1.0)
    }
}

/// An output that must come to rest on its demand.
#[derive(Clone, Debug, PartialEq)]
pub struct Resting {
    /// Output.
    pub output: String,
    /// Demand.
    pub demand: f64,
    /// Change that counts as none, in its unit: its resolution.
    pub resolution: f64,
}

/// Ends a plan when no output drifts any more: the means of two windows in a row are equal, and the last is on the demand, as
/// far as resolution and scatter can tell. Then the average is played.
struct Rest<'a> {
    outputs: &'a [Resting],
    places: Vec<usize>,
    window: usize,
    more: usize,
    /// Samples of the average that are left.
    left: Option<usize>,
}

impl Rest<'_> {
    /// Two windows have the same mean when it moved by less than the resolution or twice its standard error, so that sensors
    /// with scatter settle too.
    fn at_rest(&self, course: &Course) -> bool {
        let n = course.rows();
        if n < 2 * self.window {
            return false;
        }
        self.outputs.iter().zip(&self.places).all(|(o, &place)| {
            let window =
                |end: usize| Window::of((end - self.window + 1..=end).map(|t| course.output(t)[place]));
            let (before, now) = (window(n - self.window), window(n));
            let doubt = 2.0 * (before.variance_of_mean() + now.variance_of_mean()).sqrt();
            let near = (2.0 * o.resolution).max(3.0 * now.variance_of_mean().sqrt());
            (now.mean - before.mean).abs() <= o.resolution.max(doubt) && (now.mean - o.demand).abs() <= near
        })
    }
}

impl Watchdog for Rest<'_> {
    fn prepare(&mut self, _plan: &Plan, course: &Course) -> Result<usize, PlayError> {
        let place = |o: &Resting| {
            course.outputs.iter().position(|name| *name == o.output).ok_or_else(|| PlayError::Model {
                output: o.output.clone(),
                reason: format!("there is no such output; outputs are: {}", course.outputs.join(", ")),
            })
        };
        self.places = self.outputs.iter().map(place).collect::<Result<_, _>>()?;
        Ok(0)
    }

    fn after(&mut self, course: &Course, _events: &[LimitEvent]) -> Option<Stop> {
        // Windows do not overlap: the test is made once in each.
        self.left = match self.left {
            Some(left) => Some(left.saturating_sub(1)),
            None if course.rows().is_multiple_of(self.window) && self.at_rest(course) => Some(self.more),
            None => None,
        };
        (self.left == Some(0)).then(|| Stop::new("", Reason::Still))
    }
}

/// Plays `plan` (constant rows, at least [`HoldSpec::samples`] of them) until `outputs` rest, and averages.
///
/// # Errors
/// [`PlayError`] of the player: the plan does not fit the plant, or the plant refused it.
pub fn hold(
    plant: &mut dyn Plant,
    spec: &HoldSpec,
    plan: &Plan,
    outputs: &[Resting],
) -> Result<Held, PlayError> {
    let samples = |s: f64| (s / plan.sample_time_s).round().max(1.0) as usize;
    let n = samples(spec.average_s);
    let mut rest =
        Rest { outputs, places: Vec::new(), window: samples(spec.window_s).max(2), more: n, left: None };
    let played = play::play(plant, plan, &mut rest)?;
    if let Some(stop) = played.stop.as_ref().filter(|s| s.reason != Reason::Still) {
        return Err(PlayError::Ended {
            plan: plan.name.clone(),
            samples: played.played,
            stop: Box::new(stop.clone()),
        });
    }
    let record = &played.record;
    let from = record.len().saturating_sub(n);
    let mean = |name: &str| -> Result<f64, PlayError> {
        let values = &record.values(name)?[from..];
        Ok(values.iter().sum::<f64>() / values.len().max(1) as f64)
    };
    let inputs = plan.channels.iter().map(|c| mean(&c.name)).collect::<Result<_, _>>()?;
    let means = plan.outputs.iter().map(|o| mean(o)).collect::<Result<_, _>>()?;
    let errors = outputs.iter().map(|o| Ok(mean(&o.output)? - o.demand)).collect::<Result<_, PlayError>>()?;
    let mut oscillation = None;
    for l in plan.loops.iter().filter(|l| l.closed) {
        oscillation = oscillation.or(play::oscillation(record, l)?);
    }
    let settled = rest.left.is_some() && oscillation.is_none();
    Ok(Held { inputs, outputs: means, errors, settled, oscillation, used_s: played.used_s })
}
