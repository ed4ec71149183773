//! Does the sample time suit the system: 4 to 6 samples in the rise time (thesis section 2.3).
//!
//! The step responses come from an ARX model with a constant term,
//!
//! ```text
//! y(t) = c + sum_{j=1..n} a_j y(t-j) + sum_i sum_{k=0..n} b_ik u_i(t-k)
//! ```
//!
//! of the order n = 2, 4, 8 or 16 that has the least AIC. The rise time is that from 10 to 90 % of the final value, on
//! the line between samples. Inputs that move the output by little beside the others are left out.

use dynocal_numerics::interval::Interval;
use std::collections::BTreeMap;

use dynocal_numerics::linalg::least_squares;
use serde::Serialize;

use crate::experiment::Experiment;

/// Fewest samples in a rise time.
pub const FEWEST: f64 = 4.0;
/// Most samples in a rise time that are of use.
pub const MOST: f64 = 6.0;

/// Answer of the output to a step of one input.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Rise {
    /// Input.
    pub input: String,
    /// Final value of the output for a step of one unit.
    pub gain: f64,
    /// Time from 10 to 90 % of it in s.
    pub rise_s: f64,
    /// The same in samples.
    pub samples: f64,
}

/// What the rise times say about the sample time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// Fewer than 4 samples in the fastest rise.
    TooSlow,
    /// 4 to 6.
    Fits,
    /// More than 6.
    TooFast,
    /// No step response settles, or no input moves the output.
    Unknown,
}

/// The check for one output.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SampleTimeCheck {
    /// Output.
    pub output: String,
    /// Sample time in s.
    pub sample_time_s: f64,
    /// Rise times, one per input that counts.
    pub rises: Vec<Rise>,
    /// By the fastest of them.
    pub verdict: Verdict,
    /// From the sample time in s that gives 6 samples in the fastest rise to the one that gives 4.
    pub fitting_s: Option<Interval>,
}

impl SampleTimeCheck {
    fn new(output: &str, sample_time_s: f64, rises: Vec<Rise>) -> Self {
        let fastest = rises.iter().map(|r| r.samples).fold(f64::INFINITY, f64::min);
        let verdict = match fastest {
            s if s < FEWEST => Verdict::TooSlow,
            s if s <= MOST => Verdict::Fits,
            s if s.is_finite() => Verdict::TooFast,
            _ => Verdict::Unknown,
        };
        let rise_s = fastest * sample_time_s;
        let fitting_s = rise_s.is_finite().then_some(Interval::new(rise_s / MOST, rise_s / FEWEST));
        Self { output: output.into(), sample_time_s, rises, verdict, fitting_s }
    }

    /// The verdict for people.
    pub fn sentence(&self) -> String {
        let fastest = self.rises.iter().min_by(|a, b| a.samples.total_cmp(&b.samples));
        let (Some(r), Some(Interval { lower: from, upper: to })) = (fastest, self.fitting_s) else {
            return format!(
                "no rise time of `{}` was found: no input moves it enough, or it does not settle",
                self.output
            );
        };
        let found = format!(
            "`{}` rises in {} s after a step of `{}`, that is {:.1} samples of {} s",
            self.output,
            digits(r.rise_s),
            r.input,
            r.samples,
            self.sample_time_s
        );
        match self.verdict {
            Verdict::TooSlow => format!(
                "{found}: too slow, a dynamic model needs {FEWEST} to {MOST} samples there; sample at {} to {} s",
                digits(from),
                digits(to)
            ),
            Verdict::TooFast => format!(
                "{found}: faster than needed, {FEWEST} to {MOST} samples there are enough; `decimate` by {} makes \
                 regressors that differ more from lag to lag",
                ((r.samples / 5.0).round() as usize).max(2)
            ),
            _ => found,
        }
    }
}

/// Three significant digits, without an exponent.
fn digits(v: f64) -> String {
    let decimals = (2 - v.abs().max(1e-12).log10().floor() as i32).clamp(0, 12) as usize;
    format!("{v:.decimals$}")
}

/// Rise time of a step response (one sample per sample time, the step at sample 0) from 10 to 90 % of its final value,
/// in samples; none where it has not settled (the last fifth within 5 % of its mean).
///
/// ```
/// use dynocal_ident::excitation::sample_time::rise_samples;
/// let lag: Vec<f64> = (0..200).map(|t| 1.0 - (-f64::from(t) / 10.0).exp()).collect();
/// assert!((rise_samples(&lag).unwrap() - 10.0 * 9f64.ln()).abs() < 0.05);
/// ```
pub fn rise_samples(step: &[f64]) -> Option<f64> {
    let last = final_value(step)?;
    let crossing = |level: f64| {
        let k = step.iter().position(|v| v / last >= level)?;
        if k == 0 {
            // At once: the output was at zero one sample before.
            return Some(level / (step[0] / last) - 1.0);
        }
        let (a, b) = (step[k - 1] / last, step[k] / last);
        Some((k - 1) as f64 + (level - a) / (b - a))
    };
    Some(crossing(0.9)? - crossing(0.1)?)
}

/// Mean of the last fifth, if all of it is near.
fn final_value(step: &[f64]) -> Option<f64> {
    let tail = &step[step.len() - (step.len() / 5).min(step.len())..];
    let mean = tail.iter().sum::<f64>() / tail.len() as f64;
    let near = |v: &f64| (v - mean).abs() <= 0.05 * mean.abs();
    (!tail.is_empty() && mean.abs() > 0.0 && mean.is_finite() && tail.iter().all(near)).then_some(mean)
}

/// Checks the sample time for one output. Rows with missing samples are left out.
///
/// Where a record is much faster than the rise, noise hides the slow part of the model (an ARX model weighs high
/// frequencies): input and output are then averaged over as many samples as leave about 8 in the rise, and the model
/// fitted again.
pub fn sample_time(
    data: &[Experiment],
    inputs: &[String],
    output: &str,
    sample_time_s: f64,
) -> SampleTimeCheck {
    let m = inputs.len();
    let mut fits = BTreeMap::new();
    let mut rises = Vec::new();
    for (i, input) in inputs.iter().enumerate() {
        if let Some((gain, samples)) = rise(data, m, i, &mut fits) {
            let rise = Rise { input: input.clone(), gain, rise_s: samples * sample_time_s, samples };
            rises.push((gain.abs() * spread(data, m, i), rise));
        }
    }
    let strongest = rises.iter().map(|r| r.0).fold(0.0, f64::max);
    let counting = rises.into_iter().filter(|r| r.0 >= 0.1 * strongest).map(|r| r.1).collect();
    SampleTimeCheck::new(output, sample_time_s, counting)
}

/// Samples in a rise after which a coarser model is asked for, and how many it should have there.
const COARSER: (f64, f64) = (12.0, 8.0);

/// Gain and rise time in samples for input `i`; `fits` holds the models by the number of samples averaged.
fn rise(
    data: &[Experiment],
    m: usize,
    i: usize,
    fits: &mut BTreeMap<usize, Option<Arx>>,
) -> Option<(f64, f64)> {
    let (mut factor, mut found) = (1, None);
    for _ in 0..6 {
        let model = fits.entry(factor).or_insert_with(|| best(&averaged(data, m, factor), m));
        let Some(step) = model.as_ref().map(|f| f.step_response(i)) else { break };
        let (Some(gain), Some(samples)) = (final_value(&step), rise_samples(&step)) else { break };
        found = Some((gain, samples * factor as f64));
        if samples <= COARSER.0 {
            break;
        }
        factor = ((samples * factor as f64 / COARSER.1) as usize).max(factor + 1);
    }
    found
}

/// The ARX model with the least AIC.
fn best(data: &[Experiment], m: usize) -> Option<Arx> {
    let models = [2, 4, 8, 16].iter().filter_map(|n| Arx::fit(data, m, *n));
    models.min_by(|a, b| a.aic.total_cmp(&b.aic))
}

/// Means of every `factor` samples.
fn averaged(data: &[Experiment], m: usize, factor: usize) -> Vec<Experiment> {
    let one = |e: &Experiment| {
        let blocks = e.len() / factor;
        let mean = |v: &[f64], width: usize, block: usize, i: usize| {
            (0..factor).map(|k| v[(block * factor + k) * width + i]).sum::<f64>() / factor as f64
        };
        Experiment {
            name: e.name.clone(),
            u: (0..blocks)
                .flat_map(|b| (0..m).map(move |i| (b, i)))
                .map(|(b, i)| mean(&e.u, m, b, i))
                .collect(),
            y: (0..blocks).map(|b| mean(&e.y, 1, b, 0)).collect(),
            init_samples: 0,
            weights: Vec::new(),
        }
    };
    data.iter().map(one).collect()
}

/// Standard deviation of input `i` over all records.
fn spread(data: &[Experiment], m: usize, i: usize) -> f64 {
    let known = || data.iter().flat_map(|e| e.u.iter().skip(i).step_by(m)).filter(|v| !v.is_nan());
    let n = known().count() as f64;
    let mean = known().sum::<f64>() / n;
    (known().map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt()
}

struct Arx {
    order: usize,
    a: Vec<f64>,
    /// m x (order + 1).
    b: Vec<f64>,
    aic: f64,
}

/// Most rows that are used; more say nothing new about a rise time.
const ROWS: usize = 20_000;
/// Longest step response in samples.
const LONGEST: usize = 1 << 14;

impl Arx {
    fn fit(data: &[Experiment], m: usize, order: usize) -> Option<Self> {
        let p = 1 + order + m * (order + 1);
        // The same rows for every order, or their criteria could not be compared.
        const FIRST: usize = 16;
        let (mut phi, mut y) = (Vec::new(), Vec::new());
        'records: for e in data {
            for t in FIRST..e.len() {
                if y.len() == ROWS {
                    break 'records;
                }
                let at = phi.len();
                phi.push(1.0);
                phi.extend((1..=order).map(|j| e.y[t - j]));
                phi.extend((0..m).flat_map(|i| (0..=order).map(move |k| e.u[(t - k) * m + i])));
                if e.y[t].is_nan() || phi[at..].iter().any(|v| v.is_nan()) {
                    phi.truncate(at);
                } else {
                    y.push(e.y[t]);
                }
            }
        }
        if y.len() < 3 * p {
            return None;
        }
        let fit = least_squares(&phi, y.len(), p, &y, 0.0).ok()?;
        let n = y.len() as f64;
        Some(Self {
            order,
            a: fit.x[1..=order].to_vec(),
            b: fit.x[1 + order..].to_vec(),
            aic: n * (fit.residual_sum_squares / n).max(f64::MIN_POSITIVE).ln()
                + 2.0 * fit.factor.rank as f64,
        })
    }

    /// Answer to a unit step of input `i`, as long as it takes to settle.
    fn step_response(&self, i: usize) -> Vec<f64> {
        let b = &self.b[i * (self.order + 1)..(i + 1) * (self.order + 1)];
        let mut y: Vec<f64> = Vec::new();
        let mut length = 32;
        while length <= LONGEST {
            for t in y.len()..length {
                let past: f64 = (1..=self.order.min(t)).map(|j| self.a[j - 1] * y[t - j]).sum();
                y.push(past + b.iter().take(t + 1).sum::<f64>());
            }
            // Twice the time it took, so that a slow end is not taken for the final value.
            let settled =
                length >= 64 && final_value(&y).is_some() && final_value(&y[..length / 2]).is_some();
            if settled || y.last().is_some_and(|v| v.abs() > 1e9) {
                break;
            }
            length *= 2;
        }
        y
    }
}
