//! Curves that an engineer looks at first: what the model does at rest, after a step, and over frequency, about the middle of
//! what was identified.
//!
//! ```text
//! steady     y(u_i) at rest, all other inputs at their medians, with the band of the parameters' covariance
//!            var y = s' C s,  s = dy/dtheta at rest
//! step       y(t) - y(0) after a step of input i by a tenth of its range
//! frequency  H_i(w) = sum_l g_il e^(-jwl) / (1 - sum_j a_j e^(-jwj)),  g, a the slopes of the model at rest
//! ```
//!
//! Inputs are in prepared units where the spec prepares them; outputs are restored.

use std::f64::consts::TAU;

use dynocal_ident::estimate::bands::Band;
use dynocal_ident::estimate::{Fit, Minimised};
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::{Model, Run};
use dynocal_numerics::status::Status;
use serde::{Deserialize, Serialize};

use super::poles::{Pole, poles};

/// Curves of one input.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct InputCurves {
    /// Input.
    pub input: String,
    /// Its unit, as prepared; none where it is not known.
    #[serde(default)]
    pub unit: String,
    /// Steady output over the input.
    pub steady: Steady,
    /// Time in s after a step, and the change of the output for a step of [`InputCurves::step`].
    pub time_s: Vec<f64>,
    /// Change of the output.
    pub response: Vec<f64>,
    /// Size of the step.
    pub step: f64,
    /// Frequencies in Hz.
    pub frequency_hz: Vec<f64>,
    /// Gain in dB of the output's unit over the input's.
    pub gain_db: Vec<f64>,
    /// Phase in degrees, without jumps.
    pub phase_deg: Vec<f64>,
}

/// Steady output over one input.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Steady {
    /// Values of the input.
    pub input: Vec<f64>,
    /// Output at rest.
    pub output: Vec<f64>,
    /// Standard deviation of it from that of the parameters; empty where it is not known.
    pub deviation: Vec<f64>,
    /// Lower bound of its band.
    pub low: Vec<f64>,
    /// Upper bound.
    pub high: Vec<f64>,
}

/// Points of a steady curve and of a frequency response.
const POINTS: usize = 41;
/// Samples of a run to rest: not settled then, never settled.
const LONGEST: usize = 8192;
/// Inputs that are looked at.
const INPUTS: usize = 8;
/// Most entries of the sensitivities of a run to rest.
const ENTRIES: usize = 4_000_000;

/// The curves of all inputs of a model with parameters `theta`; none where it does not come to rest in the middle of its
/// records, or nothing drives it.
pub fn curves(
    model: &dyn Model,
    theta: &[f64],
    fit: Option<&Fit>,
    inputs: &[String],
    data: &[Experiment],
    sample_time_s: f64,
) -> Vec<InputCurves> {
    let m = model.n_inputs();
    let Some(Middle { sorted, middle, rest }) = at_rest(model, theta, data).filter(|_| m == inputs.len())
    else {
        return Vec::new();
    };
    let one = |i: usize| {
        let (low, high) = (sorted[i][0], sorted[i][sorted[i].len() - 1]);
        let mut out = InputCurves { input: inputs[i].clone(), ..InputCurves::default() };
        if high <= low {
            return out;
        }
        out.steady = steady(model, theta, fit, &middle, i, (low, high), rest);
        out.step = 0.1 * (high - low);
        let response = step(model, theta, &middle, i, out.step, rest);
        out.time_s = (0..response.len()).map(|t| t as f64 * sample_time_s).collect();
        out.response = response;
        frequency(model, theta, &middle, i, rest, sample_time_s, &mut out);
        out
    };
    (0..m.min(INPUTS)).map(one).collect()
}

/// Poles about the middle of the records, slowest first; none where the model does not come to rest there.
pub fn poles_at_rest(model: &dyn Model, theta: &[f64], data: &[Experiment]) -> Vec<Pole> {
    at_rest(model, theta, data).map_or(Vec::new(), |at| poles(model, theta, &at.middle, at.rest))
}

/// The middle of the records and where a model rests there.
struct Middle {
    /// Values of each input, in order.
    sorted: Vec<Vec<f64>>,
    middle: Vec<f64>,
    rest: f64,
}

fn at_rest(model: &dyn Model, theta: &[f64], data: &[Experiment]) -> Option<Middle> {
    let m = model.n_inputs();
    let sorted: Vec<Vec<f64>> = (0..m).map(|i| column(data, i, m)).collect();
    if m == 0 || sorted.iter().any(Vec::is_empty) {
        return None;
    }
    let middle: Vec<f64> = sorted.iter().map(|v| v[v.len() / 2]).collect();
    let outputs: Vec<f64> = data.iter().flat_map(|e| e.y.iter().copied()).filter(|v| v.is_finite()).collect();
    let start = outputs.iter().sum::<f64>() / outputs.len().max(1) as f64;
    let rest = settle(model, theta, &middle, start)?;
    Some(Middle { sorted, middle, rest })
}

/// Values of input i in all records, in order.
fn column(data: &[Experiment], i: usize, m: usize) -> Vec<f64> {
    let mut v: Vec<f64> =
        data.iter().flat_map(|e| e.u.iter().skip(i).step_by(m).copied()).filter(|v| v.is_finite()).collect();
    v.sort_by(f64::total_cmp);
    v
}

fn constant(row: &[f64], n: usize) -> Vec<f64> {
    row.iter().copied().cycle().take(row.len() * n).collect()
}

/// Output at rest under constant inputs; none where the model does not settle.
fn settle(model: &dyn Model, theta: &[f64], row: &[f64], start: f64) -> Option<f64> {
    let lag = model.max_lag();
    let (mut n, mut y0) = (128 + 4 * lag, start);
    while n <= LONGEST {
        let u = constant(row, n);
        let mut y = vec![0.0; n];
        let before = vec![y0; n];
        if model.simulate(theta, &Run { u: &u, y: &before, start: lag }, &mut y) != Status::Converged {
            return None;
        }
        let last = y[n - 1];
        let moved = y[n - 1 - lag.max(2)..].iter().map(|v| (v - last).abs()).fold(0.0, f64::max);
        if moved <= 1e-9 * last.abs().max(1e-9) {
            return Some(last);
        }
        (y0, n) = (last, 2 * n);
    }
    None
}

fn steady(
    model: &dyn Model,
    theta: &[f64],
    fit: Option<&Fit>,
    middle: &[f64],
    i: usize,
    (low, high): (f64, f64),
    rest: f64,
) -> Steady {
    let mut out = Steady::default();
    for k in 0..POINTS {
        let mut row = middle.to_vec();
        row[i] = low + (high - low) * k as f64 / (POINTS - 1) as f64;
        let Some(y) = settle(model, theta, &row, rest) else { continue };
        out.input.push(row[i]);
        out.output.push(y);
        if let Some(deviation) = fit.and_then(|f| deviation(model, theta, f, &row, y)) {
            out.deviation.push(deviation);
        }
    }
    if out.deviation.len() != out.input.len() {
        out.deviation.clear();
    }
    out
}

impl InputCurves {
    /// Keeps what holds at rest.
    pub fn steady_only(&mut self) {
        let (input, unit) = (std::mem::take(&mut self.input), std::mem::take(&mut self.unit));
        *self = Self { input, unit, steady: std::mem::take(&mut self.steady), ..Self::default() };
    }

    /// The curves in the output's own unit: `own` undoes the preparation of values; bounds at a level of confidence.
    ///
    /// # Errors
    /// Those of `own`.
    pub fn restored<E>(
        mut self,
        confidence: f64,
        own: impl Fn(&mut [f64]) -> Result<(), E>,
    ) -> Result<Self, E> {
        // Differences and deviations know the scale alone.
        let mut unit = [0.0, 1.0];
        own(&mut unit)?;
        let scale = unit[1] - unit[0];
        own(&mut self.steady.output)?;
        self.steady.deviation.iter_mut().for_each(|v| *v *= scale.abs());
        self.response.iter_mut().for_each(|v| *v *= scale);
        self.gain_db.iter_mut().for_each(|v| *v += 20.0 * scale.abs().log10());
        if !self.steady.deviation.is_empty() {
            let band = Band {
                kind: Minimised::FreeRun,
                start: 0,
                y: self.steady.output.clone(),
                std_model: self.steady.deviation.clone(),
                std_measured: Vec::new(),
                noise_variance: 0.0,
            };
            (self.steady.low, self.steady.high) = band.of_model(confidence);
        }
        Ok(self)
    }
}

/// Standard deviation of the output at rest from the covariance of the parameters.
fn deviation(model: &dyn Model, theta: &[f64], fit: &Fit, row: &[f64], y: f64) -> Option<f64> {
    let (p, lag) = (theta.len(), model.max_lag());
    if fit.covariance.len() != p * p || fit.rank < p {
        return None;
    }
    // Long enough for the sensitivities to settle as the output does.
    let n = (256 + 8 * lag).min(ENTRIES / p.max(1));
    let (u, before) = (constant(row, n), vec![y; n]);
    let (mut out, mut s) = (vec![0.0; n], vec![0.0; n * p]);
    let run = Run { u: &u, y: &before, start: lag };
    if n <= 2 * lag || model.sensitivities(theta, &run, &mut out, &mut s) != Status::Converged {
        return None;
    }
    let last = &s[(n - 1) * p..];
    let variance: f64 =
        (0..p).map(|a| last[a] * (0..p).map(|b| fit.covariance[a * p + b] * last[b]).sum::<f64>()).sum();
    (variance >= 0.0 && variance.is_finite()).then(|| variance.sqrt())
}

/// Change of the output after a step at sample 0, until it has settled.
fn step(model: &dyn Model, theta: &[f64], middle: &[f64], i: usize, size: f64, rest: f64) -> Vec<f64> {
    let (lag, m) = (model.max_lag(), middle.len());
    let mut n = 64 + 2 * lag;
    loop {
        let mut u = constant(middle, lag + n);
        (lag..lag + n).for_each(|t| u[t * m + i] += size);
        let before = vec![rest; lag + n];
        let mut y = vec![0.0; lag + n];
        if model.simulate(theta, &Run { u: &u, y: &before, start: lag }, &mut y) != Status::Converged {
            return Vec::new();
        }
        let change: Vec<f64> = y[lag..].iter().map(|v| v - rest).collect();
        let last = change[n - 1];
        let largest = change.iter().fold(0.0_f64, |a, v| a.max(v.abs()));
        let settled = change[n - n / 4..].iter().all(|v| (v - last).abs() <= 0.01 * largest);
        if settled || 2 * n > LONGEST {
            let end = (0..n).rev().find(|t| (change[*t] - last).abs() > 0.01 * largest).unwrap_or(0);
            return change[..(2 * end + 10).min(n)].to_vec();
        }
        n *= 2;
    }
}

fn frequency(
    model: &dyn Model,
    theta: &[f64],
    middle: &[f64],
    i: usize,
    rest: f64,
    sample_time_s: f64,
    out: &mut InputCurves,
) {
    let (lag, window) = (model.max_lag(), model.window());
    let (u, y) = (constant(middle, lag + 1), vec![rest; lag + 1]);
    let run = Run { u: &u, y: &y, start: lag };
    let mut g = vec![0.0; window.len()];
    let mut a = vec![0.0; model.output_lag()];
    model.window_derivatives(theta, &run, lag, &mut g, &mut vec![0.0; window.len() * window.len()]);
    model.output_derivatives(theta, &run, lag, &mut a);
    let nyquist = 0.5 / sample_time_s;
    let mut last = 0.0;
    for k in 0..POINTS {
        // Three decades up to the highest frequency that the sample time can tell.
        let f = nyquist * 1e-3_f64.powf(1.0 - k as f64 / (POINTS - 1) as f64);
        let w = TAU * f * sample_time_s;
        let sum = |terms: &mut dyn Iterator<Item = (usize, f64)>| {
            terms.fold((0.0, 0.0), |(re, im), (l, v)| {
                let angle = w * l as f64;
                (re + v * angle.cos(), im - v * angle.sin())
            })
        };
        let mine = window.iter().zip(&g).filter(|((input, _), _)| *input == i);
        let (nr, ni) = sum(&mut mine.map(|((_, l), v)| (*l, *v)));
        let (dr, di) = sum(&mut (1..).zip(a.iter().copied()));
        let (dr, di) = (1.0 - dr, -di);
        let size = nr.hypot(ni) / dr.hypot(di);
        let mut phase = (ni.atan2(nr) - di.atan2(dr)).to_degrees();
        if k == 0 {
            phase = phase.rem_euclid(360.0);
            phase -= if phase > 180.0 { 360.0 } else { 0.0 };
        } else {
            phase -= 360.0 * ((phase - last) / 360.0).round();
        }
        last = phase;
        if size > 0.0 && size.is_finite() {
            out.frequency_hz.push(f);
            out.gain_db.push(20.0 * size.log10());
            out.phase_deg.push(phase);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dynocal_ident::estimate::Estimator;
    use dynocal_ident::estimate::ols::Ols;
    use dynocal_ident::model::poly::PolyNarx;
    use dynocal_numerics::rng::Rng64;

    /// y(t) = 1 + 0.5 y(t-1) + u(t-1): gain 2, time constant one half a sample, phase and gain of the transfer function.
    #[test]
    fn a_first_order_model_has_its_textbook_curves() {
        let model = PolyNarx::parse(&["u"], "y", &["1", "u(t-1)", "y(t-1)"]).unwrap();
        let theta = [1.0, 1.0, 0.5];
        let mut rng = Rng64::new(1);
        let u: Vec<f64> = (0..500).map(|_| rng.uniform_in(-1.0, 3.0)).collect();
        let mut y = vec![2.0; 500];
        (1..500).for_each(|t| y[t] = 1.0 + 0.5 * y[t - 1] + u[t - 1] + 0.1 * rng.normal());
        let data = [Experiment { name: "a".into(), u, y, init_samples: 0, weights: vec![] }];
        let found = curves(&model, &theta, None, &["u".into()], &data, 0.1);
        let c = &found[0];
        for (u, y) in c.steady.input.iter().zip(&c.steady.output) {
            assert!((y - (2.0 + 2.0 * u)).abs() < 1e-6);
        }
        assert!((c.response[1] - c.step).abs() < 1e-9 && (c.response[2] - 1.5 * c.step).abs() < 1e-9);
        assert!((c.response.last().unwrap() / c.step - 2.0).abs() < 0.03);
        for (f, (gain, phase)) in c.frequency_hz.iter().zip(c.gain_db.iter().zip(&c.phase_deg)) {
            // e^(-jw) / (1 - 0.5 e^(-jw))
            let w = TAU * f * 0.1;
            let (dr, di) = (1.0 - 0.5 * w.cos(), 0.5 * w.sin());
            assert!((gain + 20.0 * dr.hypot(di).log10()).abs() < 1e-9);
            assert!((phase - (-w - di.atan2(dr)).to_degrees()).abs() < 1e-6, "{f}");
        }
        // The band at the middle of the data: that of the mean response of a regression, here by the fit's covariance.
        let fit = Ols::default().estimate(&model, &data, None, &|| false).unwrap();
        let found = curves(&model, &fit.theta, Some(&fit), &["u".into()], &data, 0.1);
        let s = &found[0].steady;
        assert_eq!(s.deviation.len(), s.input.len());
        let (k, u) = (20, s.input[20]);
        let h = 1e-6;
        let rest = |t: &[f64]| (t[0] + t[1] * u) / (1.0 - t[2]);
        let slope = |j: usize| {
            let mut t = fit.theta.clone();
            t[j] += h;
            (rest(&t) - rest(&fit.theta)) / h
        };
        let g: Vec<f64> = (0..3).map(slope).collect();
        let expected: f64 = (0..9).map(|ab| g[ab / 3] * fit.covariance[ab] * g[ab % 3]).sum();
        assert!(
            (s.deviation[k] / expected.sqrt() - 1.0).abs() < 1e-4,
            "{} {}",
            s.deviation[k],
            expected.sqrt()
        );
    }
}
