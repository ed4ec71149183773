//! A linear model of all loops from one record.

use dynocal_ident::data::Dataset;
use dynocal_ident::plan::PlanLoop;
use dynocal_ident::play::PlayError;
use dynocal_numerics::linalg::least_squares;

use super::{TuneError, TuneSpec};

/// Lags of the output.
const OUTPUT_LAGS: usize = 2;

/// Standard errors from which on an effect is none of chance.
const DOUBT: f64 = 3.0;

/// Standard deviation.
fn deviation(x: &[f64]) -> f64 {
    let n = x.len().max(1) as f64;
    let mean = x.iter().sum::<f64>() / n;
    (x.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt()
}

/// `y_o(t) = c_o + sum_j a_oj y_o(t-j) + sum_i sum_k b_oik u_i(t-k)` for every loop's output and input.
pub(super) struct Linear {
    pub(super) sample_time_s: f64,
    /// a, by output and lag.
    pub(super) a: Vec<Vec<f64>>,
    /// b, by output, input and lag (from 1).
    pub(super) b: Vec<Vec<Vec<f64>>>,
}

impl Linear {
    pub(super) fn fit(record: &Dataset, loops: &[PlanLoop], spec: &TuneSpec) -> Result<Self, TuneError> {
        let n = record.len();
        let lags = ((spec.memory_s / record.sample_time_s).round() as usize).max(1);
        let columns = |name: &str| record.values(name).map_err(PlayError::from);
        let u = loops.iter().map(|l| columns(&l.input)).collect::<Result<Vec<_>, _>>()?;
        let y = loops.iter().map(|l| columns(&l.output)).collect::<Result<Vec<_>, _>>()?;
        let width = 1 + OUTPUT_LAGS + lags * loops.len();
        let first = lags.max(OUTPUT_LAGS);
        let mut linear = Self { sample_time_s: record.sample_time_s, a: Vec::new(), b: Vec::new() };
        for (o, l) in loops.iter().enumerate() {
            let refused = |reason: String| TuneError::NoAnswer {
                output: l.output.clone(),
                input: l.input.clone(),
                reason,
            };
            if n < first + 2 * width {
                return Err(refused(format!("{n} samples for {width} parameters: the test is too short")));
            }
            let mut rows = Vec::with_capacity((n - first) * width);
            for t in first..n {
                rows.push(1.0);
                rows.extend((1..=OUTPUT_LAGS).map(|j| y[o][t - j]));
                u.iter().for_each(|u| rows.extend((1..=lags).map(|k| u[t - k])));
            }
            let fit = least_squares(&rows, n - first, width, &y[o][first..], 0.0)
                .map_err(|e| refused(format!("the test cannot be fitted: {e}")))?;
            linear.a.push(fit.x[1..=OUTPUT_LAGS].to_vec());
            let of_input = |i: usize| fit.x[1 + OUTPUT_LAGS + i * lags..][..lags].to_vec();
            linear.b.push((0..loops.len()).map(of_input).collect());
            // What the input does at rest, beside what chance leaves of it: the input is slow, its coefficients count as their sum.
            let error = |row: &[f64]| row.iter().zip(&fit.x).map(|(a, x)| a * x).sum::<f64>();
            let squares: f64 =
                rows.chunks(width).zip(&y[o][first..]).map(|(r, y)| (y - error(r)).powi(2)).sum();
            let chance = DOUBT * squares.sqrt() / (n - first) as f64;
            let moves = deviation(u[o]);
            let effect = of_input(o).iter().sum::<f64>().abs() * moves;
            if !(effect > chance) {
                return Err(refused(format!(
                    "the input does nothing that could be told from chance ({effect:.2e} against {chance:.2e} a sample, for movements of {moves:.2e})"
                )));
            }
        }
        Ok(linear)
    }

    /// Steady gains, outputs x inputs, row-major.
    pub(super) fn steady(&self) -> Vec<f64> {
        let own = |o: usize| 1.0 - self.a[o].iter().sum::<f64>();
        let row = |(o, b): (usize, &Vec<Vec<f64>>)| {
            b.iter().map(|b| b.iter().sum::<f64>() / own(o)).collect::<Vec<f64>>()
        };
        self.b.iter().enumerate().flat_map(row).collect()
    }

    /// Answer of output `o` to a unit step of input `i` (N).
    pub(super) fn step(&self, o: usize, i: usize, n: usize) -> Vec<f64> {
        let mut y: Vec<f64> = Vec::with_capacity(n);
        for t in 0..n {
            let past = |j: usize| if t >= j { y[t - j] } else { 0.0 };
            let own: f64 = self.a[o].iter().enumerate().map(|(j, a)| a * past(j + 1)).sum();
            // The step is there from sample 0 on.
            let input: f64 = self.b[o][i].iter().take(t).sum();
            y.push(own + input);
        }
        y
    }
}
