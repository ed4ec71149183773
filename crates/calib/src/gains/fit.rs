//! Impulse responses of all loops from one record, regularised.
//!
//! ```text
//! y_o(t) = c_o + sum_i sum_k b_oik (u_i(t-k) - u_i(0)) + e,   k = 1 .. p       inputs are at rest before the record
//! s_i b_oi ~ N(0, c K),   K_jk = lambda^max(j,k)                               tuned/correlated kernel, s_i movement of u_i
//! lambda, c / sigma^2: the largest marginal likelihood of y_o, sigma^2 profiled
//! ```
//!
//! The loops are open, so that inputs know nothing of noise and scatter: without lags of a noisy output among the regressors
//! nothing bends what is found. The kernel says that an answer is smooth and fades, the likelihood how fast and how much of it
//! there is.
//!
//! T. Chen, H. Ohlsson, L. Ljung, Automatica 48 (2012) 1525-1535, sections 3 and 5.

use dynocal_ident::data::Dataset;
use dynocal_ident::plan::PlanLoop;
use dynocal_ident::play::PlayError;
use dynocal_numerics::linalg::{
    LinalgError, cholesky, dot, gram_upper, log_det_gram, solve_upper, solve_upper_transposed,
};

use super::{TuneError, TuneSpec};

/// Length of a response, in memories of the inputs.
const RESPONSE: f64 = 4.0;
/// Standard errors from which on an effect is none of chance.
const DOUBT: f64 = 3.0;
/// Time constants of the kernel that are compared, as shares of the length of a response.
const FADING: [f64; 8] = [0.02, 0.04, 0.07, 0.12, 0.2, 0.35, 0.6, 1.0];
/// Powers of ten of c / sigma^2 that are compared.
const RATIO: std::ops::RangeInclusive<i32> = -4..=8;

/// `y_o(t) = c_o + sum_i sum_k b_oik u_i(t-k)` for every loop's output and input.
pub(super) struct Linear {
    pub(super) sample_time_s: f64,
    /// b, by output, input and lag (from 1).
    pub(super) b: Vec<Vec<Vec<f64>>>,
    /// Largest standard error of the steady effect of an input on the output of its own loop, as a share of it.
    pub(super) doubt: f64,
}

impl Linear {
    /// The model of all records, each of which begins at rest.
    pub(super) fn fit(records: &[Dataset], loops: &[PlanLoop], spec: &TuneSpec) -> Result<Self, TuneError> {
        let sample_time_s = records.first().map_or(1.0, |r| r.sample_time_s);
        let lags = ((RESPONSE * spec.memory_s / sample_time_s).round() as usize).max(1);
        let mut parts = Vec::with_capacity(records.len());
        for record in records {
            record.check().map_err(PlayError::from)?;
            let values = |l: &PlanLoop| record.values(&l.input).map_err(PlayError::from);
            parts.push(loops.iter().map(values).collect::<Result<Vec<_>, _>>()?);
        }
        let n: usize = records.iter().map(Dataset::len).sum();
        let moves: Vec<f64> = (0..loops.len()).map(|i| deviation(parts.iter().map(|u| u[i]))).collect();
        let about = |l: &PlanLoop, reason: String| TuneError::NoAnswer {
            output: l.output.clone(),
            input: l.input.clone(),
            reason,
        };
        for (l, moves) in loops.iter().zip(&moves) {
            if !(*moves > 0.0) {
                return Err(about(l, "the input does not move in the test".into()));
            }
            if n < 2 * lags {
                return Err(about(l, format!("{n} samples for responses of {lags}: the test is too short")));
            }
        }
        let failed = |l: &PlanLoop, e: LinalgError| about(l, format!("the test cannot be fitted: {e}"));
        let sums = Sums::new(&parts, &moves, lags).map_err(|e| failed(&loops[0], e))?;
        let mut linear = Self { sample_time_s, b: Vec::new(), doubt: 0.0 };
        for (o, l) in loops.iter().enumerate() {
            let y = records.iter().map(|r| r.values(&l.output).map_err(PlayError::from));
            let found = sums.responses(&y.collect::<Result<Vec<_>, _>>()?).map_err(|e| failed(l, e))?;
            let (effect, chance) = (found.rest[o].abs(), DOUBT * found.error[o]);
            if !(effect > chance) {
                return Err(about(
                    l,
                    format!(
                        "the input does nothing that could be told from chance ({effect:.2e} against {chance:.2e}, for movements of {:.2e})",
                        moves[o]
                    ),
                ));
            }
            linear.doubt = linear.doubt.max(found.error[o] / effect);
            let own = |(b, s): (&[f64], &f64)| b.iter().map(|b| b / s).collect();
            linear.b.push(found.responses.chunks(lags).zip(&moves).map(own).collect());
        }
        Ok(linear)
    }

    /// Steady gains, outputs x inputs, row-major.
    pub(super) fn steady(&self) -> Vec<f64> {
        self.b.iter().flatten().map(|b| b.iter().sum()).collect()
    }

    /// Answer of output `o` to a unit step of input `i` that is there from sample 0 on, until it is at rest.
    pub(super) fn step(&self, o: usize, i: usize) -> Vec<f64> {
        let mut y = 0.0;
        let sum = |b: &f64| {
            y += b;
            y
        };
        std::iter::once(0.0).chain(self.b[o][i].iter().map(sum)).collect()
    }
}

/// Standard deviation about the mean of each part.
fn deviation<'a>(parts: impl Iterator<Item = &'a [f64]>) -> f64 {
    let (mut squares, mut n) = (0.0, 0);
    for x in parts {
        let mean = x.iter().sum::<f64>() / x.len().max(1) as f64;
        squares += x.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
        n += x.len();
    }
    (squares / n.max(1) as f64).sqrt()
}

/// The regressors of all records, summed over the lags: with `b_k = sum_(m >= k) w_m` the kernel is `w_m ~ N(0, c v_m)`, independent,
/// `v_m = lambda^m - lambda^(m+1)`, the last `lambda^p`.
struct Sums {
    /// Column (i, m): the movement of input i from lag 1 to m, less its mean over the record; a row a sample.
    rows: Vec<f64>,
    gram: Vec<f64>,
    width: usize,
    lags: usize,
}

/// What one output does.
struct Answer {
    /// By input and lag, for an input in units of its movement.
    responses: Vec<f64>,
    /// Sum over the lags and its standard error, by input.
    rest: Vec<f64>,
    error: Vec<f64>,
}

impl Sums {
    fn new(records: &[Vec<&[f64]>], moves: &[f64], lags: usize) -> Result<Self, LinalgError> {
        let width = lags * moves.len();
        let mut rows = Vec::new();
        for u in records {
            let n = u.first().map_or(0, |u| u.len());
            let from = rows.len();
            rows.resize(from + n * width, 0.0);
            let own = &mut rows[from..];
            for (t, row) in own.chunks_mut(width).enumerate() {
                for (i, (u, s)) in u.iter().zip(moves).enumerate() {
                    let mut sum = 0.0;
                    for m in 1..=lags {
                        sum += if t >= m { (u[t - m] - u[0]) / s } else { 0.0 };
                        row[i * lags + m - 1] = sum;
                    }
                }
            }
            let mut means = vec![0.0; width];
            own.chunks(width).for_each(|r| means.iter_mut().zip(r).for_each(|(m, v)| *m += v / n as f64));
            own.chunks_mut(width).for_each(|r| r.iter_mut().zip(&means).for_each(|(v, m)| *v -= m));
        }
        let mut gram = vec![0.0; width * width];
        gram_upper(&rows, rows.len() / width, width, &mut gram)?;
        Ok(Self { rows, gram, width, lags })
    }

    /// The responses of `y`, by record, with the kernel of the largest marginal likelihood.
    fn responses(&self, y: &[&[f64]]) -> Result<Answer, LinalgError> {
        let mut centred = Vec::new();
        for y in y {
            let mean = y.iter().sum::<f64>() / y.len().max(1) as f64;
            centred.extend(y.iter().map(|v| v - mean));
        }
        let mut own = vec![0.0; self.width];
        for (row, y) in self.rows.chunks(self.width).zip(&centred) {
            own.iter_mut().zip(row).for_each(|(h, v)| *h += v * y);
        }
        let (squares, free) = (dot(&centred, &centred), (centred.len() - y.len()) as f64);
        let mut best: Option<(f64, Vec<f64>, f64, f64)> = None;
        for share in FADING {
            let scales = self.scales(share);
            for power in RATIO {
                let ratio = 10f64.powi(power);
                let Ok((r, z)) = self.factor(&scales, ratio, &own) else { continue };
                let variance = (squares - ratio * dot(&z, &z)).max(f64::EPSILON * squares) / free;
                let value = free * variance.ln() + log_det_gram(&r, self.width);
                if best.as_ref().is_none_or(|b| value < b.0) {
                    best = Some((value, scales.clone(), ratio, variance));
                }
            }
        }
        let Some((_, scales, ratio, variance)) = best else {
            return Err(LinalgError::Pivot { what: "kernel", index: 0, value: squares });
        };
        self.answer(&scales, ratio, variance, &own)
    }

    /// Square roots of v, by column.
    fn scales(&self, share: f64) -> Vec<f64> {
        let lags = self.lags;
        let lambda = (-1.0 / (share * lags as f64)).exp();
        let v = |m: usize| lambda.powi(m as i32) * if m < lags { 1.0 - lambda } else { 1.0 };
        (0..self.width).map(|k| v(k % lags + 1).sqrt()).collect()
    }

    /// R of `I + ratio D S D` and `R'^-1 D h`, with the Gram matrix S and D of the scales.
    fn factor(&self, scales: &[f64], ratio: f64, own: &[f64]) -> Result<(Vec<f64>, Vec<f64>), LinalgError> {
        let width = self.width;
        let mut r = self.gram.clone();
        for (k, row) in r.chunks_mut(width).enumerate() {
            row[k..].iter_mut().zip(&scales[k..]).for_each(|(v, s)| *v *= ratio * scales[k] * s);
            row[k] += 1.0;
        }
        cholesky(&mut r, width)?;
        let mut z: Vec<f64> = own.iter().zip(scales).map(|(h, s)| h * s).collect();
        solve_upper_transposed(&r, width, &mut z)?;
        Ok((r, z))
    }

    fn answer(&self, scales: &[f64], ratio: f64, variance: f64, own: &[f64]) -> Result<Answer, LinalgError> {
        let (width, lags) = (self.width, self.lags);
        let (r, mut w) = self.factor(scales, ratio, own)?;
        solve_upper(&r, width, &mut w)?;
        let mut responses = vec![0.0; width];
        for (b, w) in responses.chunks_mut(lags).zip(w.chunks(lags).zip(scales.chunks(lags))) {
            let mut sum = 0.0;
            for m in (0..lags).rev() {
                sum += ratio * w.0[m] * w.1[m];
                b[m] = sum;
            }
        }
        let rest = responses.chunks(lags).map(|b| b.iter().sum()).collect();
        let error = (0..width / lags).map(|i| {
            let mut d = vec![0.0; width];
            (0..lags).for_each(|m| d[i * lags + m] = (m + 1) as f64 * scales[i * lags + m]);
            solve_upper_transposed(&r, width, &mut d)?;
            Ok((variance * ratio * dot(&d, &d)).sqrt())
        });
        let error = error.collect::<Result<_, LinalgError>>()?;
        Ok(Answer { responses, rest, error })
    }
}

#[cfg(test)]
mod tests {
    use dynocal_ident::data::{Channel, Role};
    use dynocal_numerics::rng::Rng64;

    use super::*;

    /// y(t) = 3 + a (y(t-1) - 3) + gain u(t-3) + 0.5 v(t-1), with noise of standard deviation `noise` on y alone.
    fn record(a: f64, gain: f64, noise: f64, seed: u64) -> Dataset {
        let mut rng = Rng64::stream(seed, 0);
        let n = 660;
        let mut levels = |mean: f64| {
            let mut v = vec![0.0; n];
            v.chunks_mut(9).for_each(|c| c.fill(mean + if rng.below(2) == 0 { -0.2 } else { 0.2 }));
            v
        };
        let (u, v) = (levels(10.0), levels(-4.0));
        let mut x = vec![0.0; n];
        for t in 0..n {
            let before = |s: &[f64], k: usize| s[t.saturating_sub(k)] - s[0];
            x[t] = a * if t > 0 { x[t - 1] } else { 0.0 } + gain * before(&u, 3) + 0.5 * before(&v, 1);
        }
        let y: Vec<f64> = x.iter().map(|x| 3.0 + x + noise * rng.normal()).collect();
        let channel = |name: &str, values: Vec<f64>| Channel {
            name: name.into(),
            unit: "-".into(),
            role: Role::Auxiliary,
            values,
        };
        Dataset {
            name: "test".into(),
            sample_time_s: 0.03,
            channels: vec![channel("u", u), channel("v", v), channel("y", y.clone()), channel("z", y)],
            init_samples: 0,
            origin: String::new(),
        }
    }

    fn loops() -> [PlanLoop; 2] {
        let none = dynocal_ident::pi::PiGains { ki: 0.0, kp: 0.0 };
        [PlanLoop::closed("y", "u", none), PlanLoop::closed("z", "v", none)]
    }

    /// The response of a known system: exact to a percent without noise, within a tenth with noise as large as the movement.
    #[test]
    fn responses_of_a_known_system_are_found_in_noise() {
        for (a, gain) in [(0.5, 1.0), (0.9, -0.4), (0.0, 2.0)] {
            for (noise, within) in [(0.0, 0.01), (0.1, 0.1), (0.3, 0.25)] {
                for seed in 1..=5 {
                    let linear =
                        Linear::fit(&[record(a, gain, noise, seed)], &loops(), &TuneSpec::default()).unwrap();
                    let exact: f64 = gain / (1.0 - a);
                    let step = linear.step(0, 0);
                    let truth = |t: usize| exact * (1.0 - a.powi(t as i32 - 2));
                    let worst = (3..step.len()).map(|t| (step[t] - truth(t)).abs()).fold(0.0, f64::max);
                    assert!(worst < within * exact.abs(), "{a} {gain} {noise} {seed}: {worst}");
                }
            }
        }
    }

    /// An input without effect is told from one by its chance: at three standard errors one in 370 records.
    #[test]
    fn an_input_without_effect_is_refused() {
        let refused = (1..=40).filter(|seed| {
            let r = record(0.8, 0.0, 0.1, *seed);
            Linear::fit(std::slice::from_ref(&r), &loops(), &TuneSpec::default()).is_err()
        });
        let refused = refused.count();
        assert!(refused >= 38, "{refused}");
    }
}
