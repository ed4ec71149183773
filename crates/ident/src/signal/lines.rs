//! Sums of sines on the lines of a record, by the inverse Fourier transform.

use std::f64::consts::PI;

use dynocal_numerics::fft::{Complex, RealDft};
use dynocal_numerics::registry::BuildError;
use dynocal_numerics::rng::Rng64;

use super::common::fault;

/// Lines `first..=last` of a record of `n` samples.
#[derive(Clone, Copy)]
pub(super) struct Lines {
    n: usize,
    first: usize,
    last: usize,
}

impl Lines {
    /// The multiples of `1 / (n dt)` in a band.
    pub(super) fn in_band(
        member: &str,
        band_hz: (f64, f64),
        n: usize,
        dt_s: f64,
    ) -> Result<Self, BuildError> {
        let record_s = n as f64 * dt_s;
        // Ends that are multiples up to rounding count as inside the band.
        let first = (band_hz.0 * record_s - 1e-9).ceil().max(1.0) as usize;
        let last = (band_hz.1 * record_s + 1e-9).floor() as usize;
        if last < first || 2 * last >= n {
            let message = format!(
                "found a band of {} to {} Hz, expected at least one multiple of {} Hz, below {} Hz",
                band_hz.0,
                band_hz.1,
                1.0 / record_s,
                0.5 / dt_s
            );
            return Err(fault(member, message));
        }
        Ok(Self { n, first, last })
    }

    fn count(self) -> usize {
        self.last - self.first + 1
    }

    /// Phases after Schroeder: `-pi k (k - 1) / F`.
    pub(super) fn schroeder(self) -> Vec<f64> {
        let f = self.count() as f64;
        (0..self.count()).map(|k| -PI * (k * (k + 1)) as f64 / f).collect()
    }

    /// Independent uniform phases.
    pub(super) fn random(self, rng: &mut Rng64) -> Vec<f64> {
        (0..self.count()).map(|_| rng.uniform_in(-PI, PI)).collect()
    }

    /// Phases of low crest factor: the signal is clipped at a share of its peak and only the phases of what remains are
    /// kept, until that no longer helps. (E. Van der Ouderaa, J. Schoukens, J. Renneboog, IEEE Trans. Instrum. Meas. 37
    /// (1988) 145-147.)
    pub(super) fn clipped(self, start: Vec<f64>) -> Vec<f64> {
        const STEPS: usize = 400;
        let dft = RealDft::new(self.n);
        let (mut phases, mut best) = (start.clone(), (f64::INFINITY, start));
        for step in 0..STEPS {
            let mut u = self.sum_by(&dft, &phases);
            let peak = u.iter().fold(0.0f64, |m, v| m.max(v.abs()));
            if peak < best.0 {
                best = (peak, phases.clone());
            }
            // Mild clipping at last: what is cut off then hardly disturbs the lines.
            let level = peak * (0.80 + 0.19 * step as f64 / STEPS as f64);
            u.iter_mut().for_each(|v| *v = v.clamp(-level, level));
            let spectrum = dft.transform(&u);
            phases.iter_mut().zip(&spectrum[self.first..]).for_each(|(p, s)| *p = s.arg());
        }
        best.1
    }

    /// `u(t) = sum_k cos(2 pi k t / n + phi_k)`.
    pub(super) fn sum(self, phases: &[f64]) -> Vec<f64> {
        self.sum_by(&RealDft::new(self.n), phases)
    }

    fn sum_by(self, dft: &RealDft, phases: &[f64]) -> Vec<f64> {
        let mut spectrum = vec![Complex::new(0.0, 0.0); self.n / 2 + 1];
        for (s, p) in spectrum[self.first..].iter_mut().zip(phases) {
            *s = Complex::from_polar(0.5 * self.n as f64, *p);
        }
        dft.inverse(&spectrum)
    }
}

/// Scales to the limits with one gain for both sides, so that the mean is their middle and no line is added.
pub(super) fn scale_into(u: &mut [f64], sum: &[f64], lo: f64, hi: f64) {
    let peak = sum.iter().fold(0.0f64, |m, v| m.max(v.abs())).max(f64::MIN_POSITIVE);
    let (middle, half) = (0.5 * (lo + hi), 0.5 * (hi - lo));
    for (x, s) in u.iter_mut().zip(sum) {
        *x = (middle + half * s / peak).clamp(lo, hi);
    }
}
