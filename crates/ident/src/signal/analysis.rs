//! What a test signal is like: crest factor, spectrum, autocorrelation, amplitudes.

use std::f64::consts::TAU;

use serde::Serialize;

use crate::correlation::{Correlation, autocorrelation};

/// Longest segment of the spectrum, in samples: longer records are cut into segments whose spectra are averaged.
pub const SEGMENT: usize = 4096;
/// Cells of the amplitude density.
pub const CELLS: usize = 20;

/// Numbers and curves of one channel.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Analysis {
    /// Samples.
    pub samples: usize,
    /// Mean, in the channel's unit.
    pub mean: f64,
    /// Root of the mean square about the mean.
    pub standard_deviation: f64,
    /// Least value.
    pub minimum: f64,
    /// Greatest value.
    pub maximum: f64,
    /// Peak over rms, both about the mean: 1 for two equally frequent levels, 1.41 for a sine, 1.73 for uniform
    /// amplitudes. None for a constant.
    pub crest_factor: Option<f64>,
    /// Largest change from one sample to the next.
    pub largest_step: f64,
    /// Share of the [`CELLS`] equal cells between least and greatest value that hold at least one sample.
    pub coverage: f64,
    /// Normalised autocorrelation about the mean. None for a constant.
    pub autocorrelation: Option<Correlation>,
    /// One-sided power spectral density.
    pub spectrum: Spectrum,
    /// Density of the amplitudes.
    pub amplitudes: Amplitudes,
}

/// One-sided power spectral density of the signal about its mean.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Spectrum {
    /// Frequencies in Hz, from one over the length of a segment to half the sample rate.
    pub frequency_hz: Vec<f64>,
    /// Density in unit^2 / Hz: with the spacing df, `sum density df` is the mean square of the segments.
    pub density: Vec<f64>,
    /// Segments that were averaged.
    pub segments: usize,
}

/// Histogram over equal cells between the least and the greatest value.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Amplitudes {
    /// Middles of the cells.
    pub middle: Vec<f64>,
    /// Share of the samples per unit of the channel; the sum times the width of a cell is 1.
    pub density: Vec<f64>,
}

/// Analyses the samples `u`, `dt_s` apart; none without a sample or with one that is not finite, or for a sample time
/// that is not positive.
///
/// ```
/// use dynocal_ident::signal::analysis::analyse;
/// // A square wave: two levels, crest factor 1, all power at odd multiples of its frequency.
/// let u: Vec<f64> = (0..64).map(|t| if t / 8 % 2 == 0 { 3.0 } else { 1.0 }).collect();
/// let a = analyse(&u, 0.1, 16).unwrap();
/// assert_eq!((a.mean, a.crest_factor), (2.0, Some(1.0)));
/// let strongest = (0..32).max_by(|i, j| a.spectrum.density[*i].total_cmp(&a.spectrum.density[*j])).unwrap();
/// assert!((a.spectrum.frequency_hz[strongest] - 1.0 / 1.6).abs() < 1e-12);
/// ```
pub fn analyse(u: &[f64], dt_s: f64, max_lag: usize) -> Option<Analysis> {
    let n = u.len();
    let usable = n > 0 && dt_s > 0.0 && dt_s.is_finite() && u.iter().all(|v| v.is_finite());
    if !usable {
        return None;
    }
    let (minimum, maximum) =
        u.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
    let mean = u.iter().sum::<f64>() / n as f64;
    let centred: Vec<f64> = u.iter().map(|v| v - mean).collect();
    let standard_deviation = (centred.iter().map(|v| v * v).sum::<f64>() / n as f64).sqrt();
    let moves = maximum > minimum;
    let peak = centred.iter().fold(0.0f64, |p, v| p.max(v.abs()));
    let amplitudes = amplitudes(u, minimum, maximum);
    let filled = amplitudes.density.iter().filter(|d| **d > 0.0).count();
    Some(Analysis {
        samples: n,
        mean,
        standard_deviation,
        minimum,
        maximum,
        crest_factor: moves.then(|| peak / standard_deviation),
        largest_step: u.windows(2).map(|w| (w[1] - w[0]).abs()).fold(0.0, f64::max),
        coverage: filled as f64 / amplitudes.density.len() as f64,
        autocorrelation: moves.then(|| autocorrelation(u, max_lag)),
        spectrum: spectrum(&centred, dt_s),
        amplitudes,
    })
}

/// Mean of the periodograms `2 dt / L |sum_t u(t) e^(-2 pi i k t / L)|^2` of equal segments that do not overlap (M. S.
/// Bartlett, Biometrika 37 (1950) 1-16); half of that at half the sample rate. What is left of a segment at the
/// end of the record does not count.
fn spectrum(u: &[f64], dt_s: f64) -> Spectrum {
    let l = u.len().min(SEGMENT);
    let segments = u.len() / l;
    let wave: Vec<(f64, f64)> = (0..l).map(|j| (TAU * j as f64 / l as f64).sin_cos()).collect();
    let line = |k: usize| -> f64 {
        let power = |part: &[f64]| {
            let (mut re, mut im) = (0.0, 0.0);
            for (t, v) in part.iter().enumerate() {
                // The product modulo L keeps the argument exact.
                let (sin, cos) = wave[k * t % l];
                re += v * cos;
                im -= v * sin;
            }
            re * re + im * im
        };
        let sum: f64 = u.chunks_exact(l).map(power).sum();
        let sides = if 2 * k == l { 1.0 } else { 2.0 };
        sides * dt_s / l as f64 * sum / segments as f64
    };
    let lines = 1..=l / 2;
    Spectrum {
        frequency_hz: lines.clone().map(|k| k as f64 / (l as f64 * dt_s)).collect(),
        density: lines.map(line).collect(),
        segments,
    }
}

fn amplitudes(u: &[f64], minimum: f64, maximum: f64) -> Amplitudes {
    // A constant has one cell of unit width, so that the density stays a number.
    let (cells, range) = if maximum > minimum { (CELLS, maximum - minimum) } else { (1, 1.0) };
    let width = range / cells as f64;
    let mut count = vec![0usize; cells];
    for v in u {
        count[(((v - minimum) / width) as usize).min(cells - 1)] += 1;
    }
    Amplitudes {
        middle: (0..cells).map(|k| minimum + (k as f64 + 0.5) * width).collect(),
        density: count.iter().map(|c| *c as f64 / (u.len() as f64 * width)).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::signal;
    use dynocal_numerics::rng::Rng64;

    fn made(name: &str, keys: &str, n: usize, dt_s: f64) -> Vec<f64> {
        let mut u = vec![0.0; n];
        let keys = toml::from_str(keys).unwrap();
        signal(name, &keys).unwrap().fill(&mut u, dt_s, &mut Rng64::new(3)).unwrap();
        u
    }

    /// Parseval: the spectrum holds the mean square about the mean, for even and odd lengths.
    #[test]
    fn the_spectrum_holds_the_power() {
        for n in [1000, 1001] {
            let a = analyse(&made("udrn", "lo = -1\nhi = 3\nhold_s = 0.1", n, 0.1), 0.1, 10).unwrap();
            let power = a.spectrum.density.iter().sum::<f64>() / (n as f64 * 0.1);
            assert!((power / a.standard_deviation.powi(2) - 1.0).abs() < 1e-10, "{n}: {power}");
            assert_eq!(a.spectrum.density.len(), n / 2);
        }
    }

    /// Uniform amplitudes: crest factor sqrt(3), variance range^2 / 12, flat density, all cells visited.
    #[test]
    fn uniform_noise_has_its_known_numbers() {
        let a = analyse(&made("udrn", "lo = 0\nhi = 12\nhold_s = 0.1", 100_000, 0.1), 0.1, 50).unwrap();
        assert!((a.crest_factor.unwrap() - 3f64.sqrt()).abs() < 0.02);
        assert!((a.standard_deviation - 12f64.sqrt()).abs() < 0.02);
        assert!(a.amplitudes.density.iter().all(|d| (d * 12.0 - 1.0).abs() < 0.1));
        assert_eq!((a.coverage, a.spectrum.segments), (1.0, 100_000 / SEGMENT));
        // White: density 2 dt variance at all frequencies, in the mean over them.
        let mean = a.spectrum.density.iter().sum::<f64>() / a.spectrum.density.len() as f64;
        assert!((mean / (2.0 * 0.1 * 12.0) - 1.0).abs() < 0.02, "{mean}");
        assert!(a.autocorrelation.unwrap().share_outside < 0.2);
    }

    /// Equal lines in the band, nothing outside.
    #[test]
    fn a_multisine_has_its_band_and_no_other_power() {
        let u = made("multisine", "lo = -1\nhi = 1\nf_min_hz = 0.5\nf_max_hz = 2", 1000, 0.1);
        let s = analyse(&u, 0.1, 10).unwrap().spectrum;
        let inside = |f: f64| (0.495..=2.005).contains(&f);
        let level = s.density[49];
        for (f, d) in s.frequency_hz.iter().zip(&s.density) {
            let expected = if inside(*f) { level } else { 0.0 };
            assert!((d - expected).abs() < 1e-9 * level, "{f} Hz: {d}, expected {expected}");
        }
    }

    /// A bit held for h samples: the autocorrelation falls linearly to zero at lag h (thesis eq. 4.14).
    #[test]
    fn a_held_binary_signal_has_a_triangular_autocorrelation() {
        let a = analyse(&made("prbs", "lo = 0\nhi = 1\norder = 13\nhold_s = 0.5", 5 * 8191, 0.1), 0.1, 8)
            .unwrap();
        let r = a.autocorrelation.unwrap().values;
        for (lag, value) in r.iter().enumerate() {
            let expected = (1.0 - lag as f64 / 5.0).max(0.0);
            assert!((value - expected).abs() < 2e-3, "lag {lag}: {value}, expected {expected}");
        }
        assert!((a.crest_factor.unwrap() - 1.0).abs() < 1e-3);
        assert_eq!((a.coverage, a.largest_step), (2.0 / CELLS as f64, 1.0));
    }

    #[test]
    fn a_constant_and_faulty_samples_are_told_apart() {
        let a = analyse(&[4.0; 7], 0.1, 3).unwrap();
        assert_eq!((a.crest_factor, a.coverage, a.largest_step), (None, 1.0, 0.0));
        assert!(a.spectrum.density.iter().all(|d| *d == 0.0));
        assert_eq!(analyse(&[], 0.1, 3), None);
        assert_eq!(analyse(&[1.0, f64::NAN], 0.1, 3), None);
        assert_eq!(analyse(&[1.0, 2.0], 0.0, 3), None);
    }
}
