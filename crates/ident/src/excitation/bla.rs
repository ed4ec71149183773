//! Best linear approximation of a system from periodic multisine records, with what is noise and what is nonlinear.
//!
//! ```text
//! G_m(k)  = Y_m(k) / U_m(k)                        spectra averaged over the P periods of realisation m
//! G(k)    = mean of G_m over the M realisations
//! var_n   = sum_m [ sum_p |Y_mp - G_m U_mp|^2 / (P - 1) ] / (P |U_m|^2) / M^2      noise
//! var_t   = sum_m |G_m - G|^2 / (M (M - 1))                                        noise and stochastic nonlinearity
//! ```
//!
//! at the excited lines k. At the lines that the input leaves out, the output (less G U, should the actuator leak) is
//! noise and nonlinear distortion: even lines hold what is even in the input (squares), odd lines what is odd (cubes).
//! (J. Schoukens, R. Pintelon, Y. Rolain, Mastering System Identification in 100 Exercises, 2012, chapters 4 to 6; R.
//! Pintelon, J. Schoukens, System Identification: A Frequency Domain Approach, 2nd ed., 2012, sections 4.3 and 4.4.)

use dynocal_numerics::fft::{Complex, RealDft};
use serde::Serialize;

/// One realisation: input and output over whole periods, in steady state.
#[derive(Clone, Copy, Debug)]
pub struct Realisation<'a> {
    /// Input.
    pub u: &'a [f64],
    /// Output.
    pub y: &'a [f64],
}

/// Best linear approximation at the excited lines.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Bla {
    /// Samples of a period.
    pub period: usize,
    /// Periods per realisation.
    pub periods: usize,
    /// Realisations.
    pub realisations: usize,
    /// Excited lines (multiples of one over the period).
    pub lines: Vec<usize>,
    /// Their frequencies in Hz.
    pub frequency_hz: Vec<f64>,
    /// Real and imaginary part of G.
    pub gain: Vec<(f64, f64)>,
    /// Standard deviation of G by noise; NaN for one period.
    pub noise_std: Vec<f64>,
    /// Standard deviation of G by noise and stochastic nonlinearity; NaN for one realisation.
    pub total_std: Vec<f64>,
    /// Output at the excited lines.
    pub excited: Level,
    /// Output at the odd lines that are not excited, up to the highest that is; none without such lines.
    pub odd: Option<Level>,
    /// The same at even lines.
    pub even: Option<Level>,
}

/// Amplitudes of the output on a set of lines.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Level {
    /// Frequencies in Hz.
    pub frequency_hz: Vec<f64>,
    /// Amplitude per line in the output's unit, root mean square over the realisations.
    pub amplitude: Vec<f64>,
    /// Root mean square of the amplitudes.
    pub rms: f64,
    /// Root mean square of what noise alone gives; NaN for one period.
    pub noise_rms: f64,
}

impl Level {
    /// Level above the noise over that of `other`, in dB.
    pub fn db_of(&self, other: &Self) -> f64 {
        let noise = if self.noise_rms.is_nan() { 0.0 } else { self.noise_rms };
        10.0 * ((self.rms * self.rms - noise * noise).max(0.0) / (other.rms * other.rms)).log10()
    }

    /// Whether it stands out of the noise: twice its power.
    pub fn stands_out(&self) -> bool {
        self.rms * self.rms > 2.0 * self.noise_rms * self.noise_rms
    }
}

/// Records that are not periodic as said.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum BlaError {
    /// No realisation, or one without a whole period.
    #[error("realisation {realisation}: {samples} samples, expected whole periods of {period}")]
    Length {
        /// Index of the realisation.
        realisation: usize,
        /// Samples of its shorter channel.
        samples: usize,
        /// Samples of a period.
        period: usize,
    },
    /// A sample is missing or infinite.
    #[error("realisation {realisation}: sample {sample} is missing or not finite")]
    Missing {
        /// Index of the realisation.
        realisation: usize,
        /// Sample.
        sample: usize,
    },
    /// No line stands out.
    #[error("no line of the input is excited in all {realisations} realisations")]
    NoLine {
        /// Realisations.
        realisations: usize,
    },
}

type Spectrum = Vec<Complex<f64>>;

/// Spectra of one realisation, averaged over its periods; scaled so that a line is an amplitude.
struct Spectra {
    u: Spectrum,
    y: Spectrum,
    /// Every period.
    each: Vec<(Spectrum, Spectrum)>,
}

impl Spectra {
    fn new(r: &Realisation, period: usize, dft: &RealDft) -> Self {
        let lines = period / 2 + 1;
        let spectrum = |x: &[f64]| -> Spectrum {
            dft.transform(x).into_iter().map(|v| v * (2.0 / period as f64)).collect()
        };
        let each: Vec<_> =
            r.u.chunks_exact(period)
                .zip(r.y.chunks_exact(period))
                .map(|(u, y)| (spectrum(u), spectrum(y)))
                .collect();
        let mean = |of: &dyn Fn(usize, usize) -> Complex<f64>| -> Vec<Complex<f64>> {
            (0..lines)
                .map(|k| (0..each.len()).map(|p| of(p, k)).sum::<Complex<f64>>() / each.len() as f64)
                .collect()
        };
        let (u, y) = (mean(&|p, k| each[p].0[k]), mean(&|p, k| each[p].1[k]));
        Self { u, y, each }
    }

    /// Variance of the mean of `Y - G U` at line k.
    fn noise(&self, k: usize, g: Complex<f64>) -> f64 {
        let p = self.each.len() as f64;
        let mean = self.y[k] - g * self.u[k];
        let sum: f64 = self.each.iter().map(|(u, y)| (y[k] - g * u[k] - mean).norm_sqr()).sum();
        if p > 1.0 { sum / (p - 1.0) / p } else { f64::NAN }
    }
}

/// Lines whose amplitude is at most this share of the largest count as not excited.
const EXCITED: f64 = 1e-2;

/// Best linear approximation from `realisations` of whole periods of `period` samples, `dt_s` apart.
///
/// # Errors
/// [`BlaError`].
///
/// ```
/// use dynocal_ident::excitation::bla::{Realisation, bla};
/// // Lines 1 and 3 of 32 samples through y(t) = 2 u(t - 1), four periods.
/// let u = |t: usize| (0.196349540849362 * t as f64).sin() + (0.589048622548086 * t as f64).cos();
/// let input: Vec<f64> = (0..128).map(|t| u(t + 32)).collect();
/// let output: Vec<f64> = (0..128).map(|t| 2.0 * u(t + 31)).collect();
/// let g = bla(&[Realisation { u: &input, y: &output }], 32, 0.1).unwrap();
/// assert_eq!(g.lines, [1, 3]);
/// assert!((g.gain[0].0.hypot(g.gain[0].1) - 2.0).abs() < 1e-9);
/// ```
pub fn bla(realisations: &[Realisation], period: usize, dt_s: f64) -> Result<Bla, BlaError> {
    for (m, r) in realisations.iter().enumerate() {
        let samples = r.u.len().min(r.y.len());
        if period < 4 || samples < period || r.u.len() != r.y.len() || !samples.is_multiple_of(period) {
            return Err(BlaError::Length { realisation: m, samples, period });
        }
        if let Some(sample) = (0..samples).find(|t| !r.u[*t].is_finite() || !r.y[*t].is_finite()) {
            return Err(BlaError::Missing { realisation: m, sample });
        }
    }
    let dft = RealDft::new(period);
    let spectra: Vec<Spectra> = realisations.iter().map(|r| Spectra::new(r, period, &dft)).collect();
    let lines = excited_lines(&spectra, period);
    if lines.is_empty() {
        return Err(BlaError::NoLine { realisations: spectra.len() });
    }
    let hz = |lines: &[usize]| lines.iter().map(|k| *k as f64 / (period as f64 * dt_s)).collect::<Vec<_>>();
    let m = spectra.len() as f64;
    let (mut gain, mut noise_std, mut total_std) = (Vec::new(), Vec::new(), Vec::new());
    for &k in &lines {
        let each: Vec<Complex<f64>> = spectra.iter().map(|s| s.y[k] / s.u[k]).collect();
        let g = each.iter().sum::<Complex<f64>>() / m;
        let noise: f64 = spectra.iter().zip(&each).map(|(s, g)| s.noise(k, *g) / s.u[k].norm_sqr()).sum();
        let spread: f64 = each.iter().map(|v| (v - g).norm_sqr()).sum();
        gain.push(g);
        noise_std.push(noise.sqrt() / m);
        total_std.push(if m > 1.0 { (spread / (m * (m - 1.0))).sqrt() } else { f64::NAN });
    }
    let level = |set: Vec<usize>, leak: bool| {
        let g = |k: usize| if leak { between(&lines, &gain, k) } else { Complex::new(0.0, 0.0) };
        level(&spectra, &set, hz(&set), g)
    };
    let last = *lines.last().unwrap_or(&0);
    let left_out = |parity: usize| -> Vec<usize> {
        (1..=last).filter(|k| k % 2 == parity && lines.binary_search(k).is_err()).collect()
    };
    let aside = |set: Vec<usize>| (!set.is_empty()).then(|| level(set, true));
    Ok(Bla {
        period,
        periods: spectra.iter().map(|s| s.each.len()).min().unwrap_or(0),
        realisations: spectra.len(),
        frequency_hz: hz(&lines),
        gain: gain.iter().map(|g| (g.re, g.im)).collect(),
        noise_std,
        total_std,
        excited: level(lines.clone(), false),
        odd: aside(left_out(1)),
        even: aside(left_out(0)),
        lines,
    })
}

/// Lines that stand out in every realisation, without the mean and half the sample rate.
fn excited_lines(spectra: &[Spectra], period: usize) -> Vec<usize> {
    let range = 1..period.div_ceil(2);
    let largest = |s: &Spectra| range.clone().map(|k| s.u[k].norm()).fold(0.0, f64::max);
    // What a constant leaves by rounding does not count either.
    let limits: Vec<f64> =
        spectra.iter().map(|s| (EXCITED * largest(s)).max(1e-12 * s.u[0].norm())).collect();
    let stands_out = |k: &usize| spectra.iter().zip(&limits).all(|(s, limit)| s.u[*k].norm() > *limit);
    if spectra.is_empty() { Vec::new() } else { range.clone().filter(stands_out).collect() }
}

/// G at a line between excited ones, on the line between their values; the nearest outside.
fn between(lines: &[usize], gain: &[Complex<f64>], k: usize) -> Complex<f64> {
    let after = lines.partition_point(|l| *l < k);
    if after == 0 {
        return gain[0];
    }
    if after == lines.len() {
        return gain[after - 1];
    }
    let (a, b) = (lines[after - 1] as f64, lines[after] as f64);
    gain[after - 1] + (gain[after] - gain[after - 1]) * ((k as f64 - a) / (b - a))
}

fn level(
    spectra: &[Spectra],
    lines: &[usize],
    frequency_hz: Vec<f64>,
    leak: impl Fn(usize) -> Complex<f64>,
) -> Level {
    let m = spectra.len() as f64;
    let power = |k: usize| spectra.iter().map(|s| (s.y[k] - leak(k) * s.u[k]).norm_sqr()).sum::<f64>() / m;
    let noise = |k: usize| {
        // At an excited line the input is known: only what it does not explain is noise.
        let g = |s: &Spectra| if s.u[k].norm() > 0.0 { s.y[k] / s.u[k] } else { Complex::new(0.0, 0.0) };
        let of = |s: &Spectra| if leak(k).norm() > 0.0 { s.noise(k, leak(k)) } else { s.noise(k, g(s)) };
        spectra.iter().map(of).sum::<f64>() / m
    };
    let mean = |f: &dyn Fn(usize) -> f64| lines.iter().map(|k| f(*k)).sum::<f64>() / lines.len() as f64;
    Level {
        frequency_hz,
        amplitude: lines.iter().map(|k| power(*k).sqrt()).collect(),
        rms: mean(&power).sqrt(),
        noise_rms: mean(&noise).sqrt(),
    }
}
