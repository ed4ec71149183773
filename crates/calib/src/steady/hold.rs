//! Holding an operating point: loops drive their inputs until the outputs have come to rest, then everything is averaged.

use dynocal_ident::plan::Plan;
use dynocal_ident::plant::{LimitEvent, Plant};
use dynocal_ident::play::{self, Course, Oscillation, PlayError, Reason, Stop, Watchdog};
use dynocal_numerics::linalg::least_squares;
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
    /// with scatter settle too. Scatter of a burn reaches a sensor behind its lag: neighbouring samples are alike, and the mean of a
    /// window tells less than that of as many independent ones. The larger of both standard errors counts.
    fn at_rest(&self, course: &Course) -> bool {
        let n = course.rows();
        if n < 2 * self.window {
            return false;
        }
        self.outputs.iter().zip(&self.places).all(|(o, &place)| {
            let values = |from: usize, to: usize| (from..=to).map(move |t| course.output(t)[place]);
            let window = |end: usize| Window::of(values(end - self.window + 1, end));
            let (before, now) = (window(n - self.window), window(n));
            let both: Vec<f64> = values(n - 2 * self.window + 1, n).collect();
            let alike = alike_variance(&both, self.window).min(innovation_variance(&both, self.window));
            let doubt = 2.0 * (before.variance_of_mean() + now.variance_of_mean()).max(2.0 * alike).sqrt();
            let near = (2.0 * o.resolution).max(3.0 * now.variance_of_mean().max(alike).sqrt());
            (now.mean - before.mean).abs() <= o.resolution.max(doubt) && (now.mean - o.demand).abs() <= near
        })
    }
}

/// Variance of the mean of `window` samples that are alike, from `values` about their line, so that a drift does not count as scatter:
/// s^2/n (1 + rho)/(1 - rho) with the correlation rho of neighbours, at most that of a single sample.
fn alike_variance(values: &[f64], window: usize) -> f64 {
    let n = values.len() as f64;
    if n < 4.0 {
        return 0.0;
    }
    let (middle, mean) = (0.5 * (n - 1.0), values.iter().sum::<f64>() / n);
    let place = |t: usize| t as f64 - middle;
    let (along, spread) = values
        .iter()
        .enumerate()
        .fold((0.0, 0.0), |(a, s), (t, v)| (a + place(t) * (v - mean), s + place(t) * place(t)));
    let rest: Vec<f64> =
        values.iter().enumerate().map(|(t, v)| v - mean - along / spread * place(t)).collect();
    let squares: f64 = rest.iter().map(|r| r * r).sum();
    if squares <= 0.0 {
        return 0.0;
    }
    let rho = (rest.windows(2).map(|w| w[0] * w[1]).sum::<f64>() / squares).clamp(0.0, 0.95);
    let fewer = ((1.0 + rho) / (1.0 - rho)).min(window as f64);
    squares / (n - 2.0) * fewer / window as f64
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

/// The same from an autoregression y_t = a y_(t-1) + b y_(t-2) + c + d t + e_t: s_e^2/(1 - a - b)^2/n. A transient of a quiet plant obeys
/// it without a rest, so that its curve is not taken for scatter; scatter behind a lag does not.
fn innovation_variance(values: &[f64], window: usize) -> f64 {
    const TERMS: usize = 4;
    let rows = values.len().saturating_sub(2);
    if rows < 3 * TERMS {
        return 0.0;
    }
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let (mut a, mut b) = (Vec::with_capacity(rows * TERMS), Vec::with_capacity(rows));
    for (t, w) in values.windows(3).enumerate() {
        a.extend([w[1] - mean, w[0] - mean, 1.0, t as f64 / rows as f64 - 0.5]);
        b.push(w[2] - mean);
    }
    let Ok(fit) = least_squares(&a, rows, TERMS, &b, 0.0) else { return 0.0 };
    let (found, rest) = (fit.x, fit.residual_sum_squares / (rows - TERMS) as f64);
    // A root near one says nothing about a second of record: at most a memory of twenty samples.
    let left = (1.0 - found[0] - found[1]).max(0.05);
    rest / (left * left) / window as f64
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
