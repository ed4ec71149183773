//! Frequency responses out of records: spectra averaged over segments, with coherence and standard deviations.
//!
//! ```text
//! S_ab(f) = mean over segments of A conj(B)          Hann window, half overlapping, straight line taken off each segment
//! G = S_yw S_uw^-1       w = u in open loop; in closed loop w is the demand, which no disturbance of the loop reaches
//! v = y - G u,    S_vv = S_yy - G S_uy - (G S_uy)' + G S_uu G'
//! var G_i = S_vv [(S_uw^-1)' S_ww S_uw^-1]_ii / (n - m),        n = segments / (1 + 2 (1/6)^2) independent ones, m inputs
//! coherence = S_yw S_ww^-1 S_wy / S_yy
//! G = (4 G_n - G_n/2) / 3                             segments of n and of half as many samples
//! ```
//!
//! All channels pass through one filter that makes the moving ones nearly white (an autoregressive model of them, order
//! eight): G stays what it is, and a window that sees a steep spectrum no longer sees its neighbours in place of a line. What is
//! left of what a window smears goes with one over the square of its length, and two lengths take it out. For that the deviation is
//! larger by `sqrt(12.5) / 3`: the shorter segments have half the variance of the longer ones, and what they see is an average of it.
//! (R. B. Blackman, J. W. Tukey, Bell System Technical J. 37 (1958) 185-282, for prewhitening.)
//!
//! Nothing is given above [`HIGHEST`] of the sampling frequency: half of it is where a record ends, and before it the filters of
//! sensors and the hold of actuators leave nothing to see. (P. D. Welch, IEEE Trans. Audio Electroacoustics 15 (1967) 70-73, for
//! the overlap; L. Ljung, System Identification, 2nd ed. (1999), section 6.4; P. Van den Hof, Annual Reviews in Control 22
//! (1998) 173-186, for the loop.)

use std::f64::consts::{PI, TAU};

use dynocal_numerics::fft::RealDft;
use dynocal_numerics::rng::Rng64;
use serde::{Deserialize, Serialize};

use crate::error::ControlError;
use crate::margin::{Margins, of_response};
use crate::matrix::{C, Matrix, ZERO};
use crate::system::{System, Time, Transfer};

/// Highest frequency as a share of the sampling frequency.
pub const HIGHEST: f64 = 0.4;
/// Correlation of the powers of segments that overlap by half under a Hann window.
const OVERLAP: f64 = 1.0 / 36.0;
/// Order of the filter that makes the moving channels nearly white, and the share of white noise that is added to them for it.
const WHITENING: (usize, f64) = (8, 1e-3);
/// Deviation of a line over its size, above which it is left out of measured margins: of noise alone one line in three thousand is below it.
const CLEAR: f64 = 0.35;
/// Lines on either side that say whether a clear one is no accident.
const ABOUT: usize = 4;
/// Correlation of the error of a line with that of the next one: of a product of two spectra under a Hann window.
const NEIGHBOURS: f64 = 4.0 / 9.0;
/// Segments that are aimed at where their length is not given.
const SEGMENTS: usize = 24;

/// A record of equal length in all its channels.
#[derive(Clone, Copy, Debug)]
pub struct Test<'a> {
    /// Inputs, each a column.
    pub inputs: &'a [Vec<f64>],
    /// Outputs, each a column.
    pub outputs: &'a [Vec<f64>],
    /// Demands of a closed loop, as many as inputs; none in open loop.
    pub demands: Option<&'a [Vec<f64>]>,
    /// Sample time in s.
    pub sample_time_s: f64,
}

/// A measured frequency response.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Response {
    /// Frequencies in Hz.
    pub frequency_hz: Vec<f64>,
    /// Outputs.
    pub outputs: usize,
    /// Inputs.
    pub inputs: usize,
    /// Real and imaginary part: by frequency, output, input.
    pub gain: Vec<(f64, f64)>,
    /// Standard deviation of each.
    pub std: Vec<f64>,
    /// Coherence between an output and all inputs (demands in closed loop): by frequency, output.
    pub coherence: Vec<f64>,
    /// Segments that were averaged.
    pub segments: usize,
    /// Sample time in s.
    pub sample_time_s: f64,
}

/// Sums of products of spectra at one frequency.
struct Sums {
    ww: Matrix,
    uw: Matrix,
    uu: Matrix,
    yw: Matrix,
    yu: Matrix,
    yy: Vec<f64>,
}

/// Response of a record over segments of `segment` samples (none: as many as give about 24 segments).
///
/// ```
/// use dynocal_control::response::{Test, frequency_response};
/// use dynocal_numerics::rng::Rng64;
/// // y(t) = 0.5 y(t-1) + u(t-1): 2 at rest.
/// let mut rng = Rng64::new(1);
/// let u: Vec<f64> = (0..8000).map(|_| rng.normal()).collect();
/// let mut y = vec![0.0; 8000];
/// (1..8000).for_each(|t| y[t] = 0.5 * y[t - 1] + u[t - 1]);
/// let found = frequency_response(&Test { inputs: &[u], outputs: &[y], demands: None, sample_time_s: 0.1 }, Some(256))?;
/// let (re, im) = found.gain[0];
/// assert!((re.hypot(im) - 2.0).abs() < 0.05 && found.coherence[0] > 0.99);
/// assert!(found.frequency_hz.last().unwrap() <= &4.0);
/// # Ok::<(), dynocal_control::error::ControlError>(())
/// ```
///
/// # Errors
/// [`ControlError`]: channels of different lengths or with values that are no numbers, a record too short for its segments,
/// inputs that do not move on their own at some frequency.
pub fn frequency_response(test: &Test, segment: Option<usize>) -> Result<Response, ControlError> {
    let m = test.inputs.len();
    let rows = check(test)?;
    let n = segment.unwrap_or((2 * rows / (SEGMENTS + 1)).max(16)) & !1;
    let segments = if n >= 16 && n <= rows { (rows - n) / (n / 2) + 1 } else { 0 };
    if segments < m + 2 {
        return Err(ControlError::shape(
            format!("a record of {rows} samples in segments of {n}"),
            format!("{segments} segments"),
            format!("{} at least, of 16 samples at least: a longer record or shorter segments", m + 2),
        ));
    }
    let white = Whitened::new(test);
    let mut out = over_segments(&white.test(test), n)?;
    // Segments of half the length, where they are long enough to say something of their own.
    if n / 2 >= 16 {
        let shorter = over_segments(&white.test(test), (n / 2) & !1)?;
        out.extrapolate(&shorter);
    }
    Ok(out)
}

/// The response over segments of `n` samples.
fn over_segments(test: &Test, n: usize) -> Result<Response, ControlError> {
    let (m, p) = (test.inputs.len(), test.outputs.len());
    let rows = test.inputs[0].len();
    let segments = (rows.max(n) - n) / (n / 2) + 1;
    let spectra = Spectra::new(test, n.min(rows), segments);
    let independent = segments as f64 / (1.0 + 2.0 * OVERLAP);
    let last = (HIGHEST * n as f64).floor() as usize;
    let mut out = Response {
        frequency_hz: Vec::new(),
        outputs: p,
        inputs: m,
        gain: Vec::new(),
        std: Vec::new(),
        coherence: Vec::new(),
        segments,
        sample_time_s: test.sample_time_s,
    };
    // The first line holds what is left of the straight line.
    for k in 2..=last {
        let frequency_hz = k as f64 / (n as f64 * test.sample_time_s);
        let sums = spectra.at(k);
        let silent = || {
            let what = "the inputs of the record (one of them stands still, or two move alike)".into();
            ControlError::Singular { what, frequency_rad_s: TAU * frequency_hz }
        };
        let (a, ww) = (regular(&sums.uw).ok_or_else(silent)?, regular(&sums.ww).ok_or_else(silent)?);
        let g = sums.yw.times(&a);
        let spread = a.adjoint().times(&sums.ww).times(&a);
        let explained = sums.yw.times(&ww).times(&sums.yw.adjoint());
        let (gyu, guu) = (g.times(&sums.yu.adjoint()), g.times(&sums.uu).times(&g.adjoint()));
        out.frequency_hz.push(frequency_hz);
        for o in 0..p {
            let left = (sums.yy[o] - 2.0 * gyu.at(o, o).re + guu.at(o, o).re).max(0.0);
            for i in 0..m {
                let v = g.at(o, i);
                out.gain.push((v.re, v.im));
                out.std.push((left * spread.at(i, i).re.max(0.0) / (independent - m as f64).max(1.0)).sqrt());
            }
            let share = if sums.yy[o] > 0.0 { explained.at(o, o).re / sums.yy[o] } else { 0.0 };
            out.coherence.push(share.clamp(0.0, 1.0));
        }
    }
    Ok(out)
}

/// The channels of a test behind the filter that whitens the moving ones.
struct Whitened {
    inputs: Vec<Vec<f64>>,
    outputs: Vec<Vec<f64>>,
    demands: Option<Vec<Vec<f64>>>,
}

impl Whitened {
    fn new(test: &Test) -> Self {
        let filter = whitening(test.demands.unwrap_or(test.inputs));
        let all = |columns: &[Vec<f64>]| columns.iter().map(|c| filtered(c, &filter)).collect::<Vec<_>>();
        Self { inputs: all(test.inputs), outputs: all(test.outputs), demands: test.demands.map(all) }
    }

    fn test(&self, of: &Test) -> Test<'_> {
        Test {
            inputs: &self.inputs,
            outputs: &self.outputs,
            demands: self.demands.as_deref(),
            sample_time_s: of.sample_time_s,
        }
    }
}

/// Prediction error filter `1, a_1, ..` of the mean correlation of columns (recursion of Levinson and Durbin).
fn whitening(columns: &[Vec<f64>]) -> Vec<f64> {
    let order = WHITENING.0.min(columns[0].len() / 50);
    let mut r = vec![0.0; order + 1];
    for c in columns {
        let mean = c.iter().sum::<f64>() / c.len() as f64;
        let lag = |k: usize| c.iter().zip(&c[k..]).map(|(a, b)| (a - mean) * (b - mean)).sum::<f64>();
        let power = lag(0);
        if power > 0.0 {
            r.iter_mut().enumerate().for_each(|(k, v)| *v += lag(k) / power);
        }
    }
    r[0] *= 1.0 + WHITENING.1;
    let mut a = vec![1.0];
    let mut left = r[0];
    for k in 1..=order {
        if !(left > 0.0) {
            break;
        }
        let reflection = -(0..k).map(|j| a[j] * r[k - j]).sum::<f64>() / left;
        let before = a.clone();
        a.push(0.0);
        (1..=k).for_each(|j| a[j] += reflection * before.get(k - j).copied().unwrap_or(0.0));
        left *= 1.0 - reflection * reflection;
    }
    a
}

/// What a filter of finite length makes of a column, from its first whole sum on.
fn filtered(column: &[f64], filter: &[f64]) -> Vec<f64> {
    let n = filter.len();
    column.windows(n).map(|w| w.iter().rev().zip(filter).map(|(x, a)| a * x).sum()).collect()
}

fn check(test: &Test) -> Result<usize, ControlError> {
    if !(test.sample_time_s > 0.0 && test.sample_time_s.is_finite()) {
        return Err(ControlError::number(
            "the sample time",
            test.sample_time_s,
            "a positive number of seconds",
        ));
    }
    if test.inputs.is_empty() || test.outputs.is_empty() {
        return Err(ControlError::shape("a record", "no inputs or no outputs", "one of each at least"));
    }
    let rows = test.inputs[0].len();
    let demands = test.demands.unwrap_or_default();
    if test.demands.is_some() && demands.len() != test.inputs.len() {
        return Err(ControlError::shape("demands of a closed loop", demands.len(), test.inputs.len()));
    }
    for c in test.inputs.iter().chain(test.outputs).chain(demands) {
        if c.len() != rows {
            return Err(ControlError::shape("samples of a channel", c.len(), rows));
        }
        if let Some(k) = c.iter().position(|v| !v.is_finite()) {
            return Err(ControlError::number(format!("sample {}", k + 1), c[k], "a finite number"));
        }
    }
    Ok(rows)
}

/// The inverse where rounding has not made it up.
fn regular(a: &Matrix) -> Option<Matrix> {
    let scale: f64 =
        (0..a.rows).map(|i| (0..a.cols).map(|j| a.at(i, j).norm()).fold(0.0, f64::max)).product();
    let (det, inverse) = a.solved();
    if det.norm() > 1e-10 * scale { inverse } else { None }
}

/// Spectra of all segments.
struct Spectra {
    u: Vec<Vec<Vec<C>>>,
    y: Vec<Vec<Vec<C>>>,
    w: Option<Vec<Vec<Vec<C>>>>,
    segments: usize,
}

impl Spectra {
    fn new(test: &Test, n: usize, segments: usize) -> Self {
        let dft = RealDft::new(n);
        let window: Vec<f64> =
            (0..n).map(|t| 0.5 - 0.5 * (TAU * (t as f64 + 0.5) / n as f64).cos()).collect();
        let each = |column: &Vec<f64>| -> Vec<Vec<C>> {
            (0..segments)
                .map(|s| dft.transform(&windowed(&column[s * (n / 2)..s * (n / 2) + n], &window)))
                .collect()
        };
        let all = |columns: &[Vec<f64>]| columns.iter().map(each).collect::<Vec<_>>();
        Self { u: all(test.inputs), y: all(test.outputs), w: test.demands.map(all), segments }
    }

    fn at(&self, k: usize) -> Sums {
        let w = self.w.as_ref().unwrap_or(&self.u);
        let product = |a: &[Vec<Vec<C>>], b: &[Vec<Vec<C>>]| {
            let mut out = Matrix::zeros(a.len(), b.len());
            for i in 0..a.len() {
                for j in 0..b.len() {
                    let sum = (0..self.segments).fold(ZERO, |sum, s| sum + a[i][s][k] * b[j][s][k].conj());
                    *out.at_mut(i, j) = sum / self.segments as f64;
                }
            }
            out
        };
        let power = |c: &Vec<Vec<C>>| c.iter().map(|s| s[k].norm_sqr()).sum::<f64>() / self.segments as f64;
        Sums {
            ww: product(w, w),
            uw: product(&self.u, w),
            uu: product(&self.u, &self.u),
            yw: product(&self.y, w),
            yu: product(&self.y, &self.u),
            yy: self.y.iter().map(power).collect(),
        }
    }
}

/// A segment without its straight line, under the window.
fn windowed(x: &[f64], window: &[f64]) -> Vec<f64> {
    let n = x.len() as f64;
    let middle = 0.5 * (n - 1.0);
    let mean = x.iter().sum::<f64>() / n;
    let slope =
        x.iter().enumerate().map(|(t, v)| (t as f64 - middle) * v).sum::<f64>() * 12.0 / (n * (n * n - 1.0));
    x.iter().zip(window).enumerate().map(|(t, (v, w))| (v - mean - slope * (t as f64 - middle)) * w).collect()
}

/// Margins of a measured channel under a controller, and what their uncertainty makes of them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MeasuredMargins {
    /// Of the response as it was measured.
    pub found: Margins,
    /// Least and greatest gain margin of nine tenths of the draws; none where a draw has none.
    pub gain_up: Option<(f64, f64)>,
    /// The same of the phase margin in deg.
    pub phase_deg: Option<(f64, f64)>,
}

impl Response {
    /// Takes out what goes with one over the square of the length of segments, by those of half the length.
    fn extrapolate(&mut self, shorter: &Self) {
        let channels = self.outputs * self.inputs;
        let (first, last) = (shorter.frequency_hz[0], shorter.frequency_hz[shorter.frequency_hz.len() - 1]);
        for (k, f) in self.frequency_hz.iter().enumerate() {
            if !(*f >= first && *f <= last) {
                continue;
            }
            let i = shorter.frequency_hz.partition_point(|v| v < f).clamp(1, shorter.frequency_hz.len() - 1);
            let (a, b) = (shorter.frequency_hz[i - 1], shorter.frequency_hz[i]);
            let share = (f - a) / (b - a);
            for c in 0..channels {
                let (x, y) = (shorter.gain[(i - 1) * channels + c], shorter.gain[i * channels + c]);
                let own = &mut self.gain[k * channels + c];
                // The chord between two lines lies inside of the curve: sizes and angles are taken between them.
                let (x, y) = (C::new(x.0, x.1), C::new(y.0, y.1));
                let between = between(x, y, share);
                *own = ((4.0 * own.0 - between.re) / 3.0, (4.0 * own.1 - between.im) / 3.0);
                self.std[k * channels + c] *= 12.5f64.sqrt() / 3.0;
            }
        }
    }

    /// Channel from an input to an output at a place of the frequencies.
    pub fn at(&self, k: usize, output: usize, input: usize) -> C {
        let (re, im) = self.gain[(k * self.outputs + output) * self.inputs + input];
        C::new(re, im)
    }

    /// Its standard deviation.
    pub fn std_at(&self, k: usize, output: usize, input: usize) -> f64 {
        self.std[(k * self.outputs + output) * self.inputs + input]
    }

    /// Coherence of an output at a place of the frequencies.
    pub fn coherence_at(&self, k: usize, output: usize) -> f64 {
        self.coherence[k * self.outputs + output]
    }

    /// The same as it is seen behind a decoupler, `G D`; deviations as if the channels' errors were independent.
    pub fn behind(&self, decoupler: &System) -> Self {
        let mut out = Self { gain: Vec::new(), std: Vec::new(), ..self.clone() };
        for (k, f) in self.frequency_hz.iter().enumerate() {
            let d = decoupler.at(TAU * f);
            for o in 0..self.outputs {
                for j in 0..self.inputs {
                    let parts = || (0..self.inputs).map(|i| (i, d.at(i, j)));
                    let v = parts().fold(ZERO, |sum, (i, d)| sum + self.at(k, o, i) * d);
                    out.gain.push((v.re, v.im));
                    let var: f64 = parts().map(|(i, d)| (self.std_at(k, o, i) * d.norm()).powi(2)).sum();
                    out.std.push(var.sqrt());
                }
            }
        }
        out
    }

    /// Gain and phase margin of the loop of one channel under a controller, without a model: the response between its
    /// frequencies has sizes and angles between theirs, its delay of `delay_s` turned out before. `draws` responses about it,
    /// whose errors are alike at neighbouring frequencies as the window makes them, give the intervals. Lines whose deviation is more than a third of their size are left out, and those that
    /// stand alone among such: margins beyond them are none. That the loop is stable is not asked here: a response says nothing of it.
    pub fn margins(
        &self,
        output: usize,
        input: usize,
        controller: &Transfer,
        delay_s: f64,
        draws: usize,
        seed: u64,
    ) -> MeasuredMargins {
        // A line that is hardly told from nothing says nothing of where a loop crosses.
        let clear = |k: &usize| self.std_at(*k, output, input) < CLEAR * self.at(*k, output, input).norm();
        let n = self.frequency_hz.len();
        let all: Vec<bool> = (0..n).map(|k| clear(&k)).collect();
        // Of noise alone some lines look clear: one counts where a third of those about it are.
        let believed = |k: &usize| {
            let about = &all[k.saturating_sub(ABOUT)..(k + ABOUT + 1).min(n)];
            all[*k] && 3 * about.iter().filter(|c| **c).count() >= about.len()
        };
        let lines: Vec<usize> = (0..n).filter(believed).collect();
        let own: Vec<C> = lines.iter().map(|k| self.at(*k, output, input)).collect();
        let found = self.of(&lines, &own, controller, delay_s);
        let (mut gains, mut phases) = (Vec::new(), Vec::new());
        // Errors of neighbouring lines as a moving average of two that has their correlation.
        let share = (1.0 - (1.0 - 4.0 * NEIGHBOURS * NEIGHBOURS).sqrt()) / (2.0 * NEIGHBOURS);
        for d in 0..draws {
            let mut rng = Rng64::stream(seed, d as u64);
            let mut last = C::new(rng.normal(), rng.normal());
            let drawn: Vec<C> = own
                .iter()
                .zip(&lines)
                .map(|(g, k)| {
                    let std = self.std_at(*k, output, input) / std::f64::consts::SQRT_2;
                    let new = C::new(rng.normal(), rng.normal());
                    let error = (new + last * share) / (1.0 + share * share).sqrt();
                    last = new;
                    g + error * std
                })
                .collect();
            let m = self.of(&lines, &drawn, controller, delay_s);
            gains.push(m.gain_up);
            phases.push(m.phase_deg);
        }
        MeasuredMargins { found, gain_up: most(&gains), phase_deg: most(&phases) }
    }

    fn of(&self, lines: &[usize], own: &[C], controller: &Transfer, delay_s: f64) -> Margins {
        let grid: Vec<f64> = lines.iter().map(|k| TAU * self.frequency_hz[*k]).collect();
        if grid.len() < 2 {
            return of_response(&[], &[], &|_| ZERO, None);
        }
        let time = Time::Sampled { sample_time_s: self.sample_time_s };
        let turned: Vec<C> = grid.iter().zip(own).map(|(w, g)| g * C::from_polar(1.0, w * delay_s)).collect();
        let at = |w: f64| {
            let k = grid.partition_point(|v| *v < w).clamp(1, grid.len() - 1);
            let share = (w - grid[k - 1]) / (grid[k] - grid[k - 1]);
            let g = between(turned[k - 1], turned[k], share);
            g * C::from_polar(1.0, -w * delay_s) * controller.at(time, w)
        };
        let values: Vec<C> = grid.iter().map(|w| at(*w)).collect();
        of_response(&grid, &values, &at, None)
    }

    /// Delay in s by which an output follows an input best, from the phase of the frequencies where the coherence is above
    /// nine tenths: the slope that leaves least.
    pub fn delay_s(&self, output: usize, input: usize) -> Option<f64> {
        let (mut sum, mut weight) = (0.0, 0.0);
        for k in 1..self.frequency_hz.len() {
            if self.coherence_at(k, output).min(self.coherence_at(k - 1, output)) < 0.9 {
                continue;
            }
            let turn = (self.at(k, output, input) * self.at(k - 1, output, input).conj()).arg();
            let step = TAU * (self.frequency_hz[k] - self.frequency_hz[k - 1]);
            let w = self.at(k, output, input).norm();
            sum -= w * turn / step;
            weight += w;
        }
        (weight > 0.0).then(|| sum / weight)
    }
}

/// Size and angle between two values, the logarithm of the size on the line.
fn between(a: C, b: C, share: f64) -> C {
    let ratio = b / a;
    if ratio.norm() > 0.0 && ratio.norm().is_finite() {
        a * (ratio.ln() * share).exp()
    } else {
        a + (b - a) * share
    }
}

/// The interval of nine tenths.
fn most(values: &[Option<f64>]) -> Option<(f64, f64)> {
    let mut all: Vec<f64> = values.iter().copied().collect::<Option<Vec<f64>>>()?;
    if all.is_empty() {
        return None;
    }
    all.sort_by(f64::total_cmp);
    let at = |share: f64| all[((all.len() - 1) as f64 * share).round() as usize];
    Some((at(0.05), at(0.95)))
}

/// A periodic input with random phases: equal amplitudes on odd lines of `period` samples up to `highest_hz`, of which every
/// third is left out for what is nonlinear to show itself; scaled to a largest value of `size`.
///
/// # Errors
/// [`ControlError::Number`]: a frequency past [`HIGHEST`] of the sampling frequency, or below the first lines.
pub fn odd_multisine(
    period: usize,
    sample_time_s: f64,
    highest_hz: f64,
    size: f64,
    rng: &mut Rng64,
) -> Result<Vec<f64>, ControlError> {
    let sampling_hz = 1.0 / sample_time_s;
    let lines = (highest_hz * period as f64 * sample_time_s).floor();
    if !(highest_hz <= HIGHEST * sampling_hz * (1.0 + 1e-12) && lines >= 5.0) {
        return Err(ControlError::number(
            format!("the highest frequency of a multisine of {period} samples at {sampling_hz} Hz"),
            highest_hz,
            "at most 0.4 of the sampling frequency, and five lines at least",
        ));
    }
    let mut out = vec![0.0; period];
    for k in (1..=lines as usize).step_by(2).filter(|k| k / 2 % 3 != 2) {
        let phase = rng.uniform_in(-PI, PI);
        for (t, v) in out.iter_mut().enumerate() {
            *v += (TAU * (k * t % period) as f64 / period as f64 + phase).cos();
        }
    }
    let largest = out.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    out.iter_mut().for_each(|v| *v *= size / largest);
    Ok(out)
}
