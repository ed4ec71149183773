//! Discrete Fourier transform of real samples: `X(k) = sum_t x(t) e^(-2 pi i k t / n)`, k = 0 .. n/2.
//!
//! Any length; plans are kept by the object, so that many records of one length cost one plan.

use std::sync::Arc;

use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};

pub use realfft::num_complex::Complex;

/// Transform of one length.
///
/// ```
/// use dynocal_numerics::fft::RealDft;
/// let spectrum = RealDft::new(8).transform(&[1.0, 0.0, -1.0, 0.0, 1.0, 0.0, -1.0, 0.0]);
/// assert!((spectrum[2].re - 4.0).abs() < 1e-15 && spectrum[1].norm() < 1e-15);
/// ```
#[derive(Clone)]
pub struct RealDft {
    n: usize,
    plan: Arc<dyn RealToComplex<f64>>,
    back: Arc<dyn ComplexToReal<f64>>,
}

impl RealDft {
    /// Plans the transform of `n` samples.
    pub fn new(n: usize) -> Self {
        let mut planner = RealFftPlanner::new();
        Self { n, plan: planner.plan_fft_forward(n.max(1)), back: planner.plan_fft_inverse(n.max(1)) }
    }

    /// Spectrum of the first n samples, n/2 + 1 lines; missing ones at the end count as zero.
    pub fn transform(&self, x: &[f64]) -> Vec<Complex<f64>> {
        let mut work = x[..self.n.min(x.len())].to_vec();
        work.resize(self.n.max(1), 0.0);
        let mut out = self.plan.make_output_vec();
        match self.plan.process(&mut work, &mut out) {
            Ok(()) => out,
            Err(e) => unreachable!("both buffers have the planned length: {e}"),
        }
    }

    /// The n samples of a spectrum: undoes [`RealDft::transform`]. Missing lines count as zero, and so do the imaginary
    /// parts of the ends, which real samples do not have.
    pub fn inverse(&self, spectrum: &[Complex<f64>]) -> Vec<f64> {
        let mut work = self.back.make_input_vec();
        let lines = work.len();
        let scale = 1.0 / self.n.max(1) as f64;
        work.iter_mut().zip(spectrum).for_each(|(w, s)| *w = s * scale);
        work[0].im = 0.0;
        if self.n.is_multiple_of(2) {
            work[lines - 1].im = 0.0;
        }
        let mut out = self.back.make_output_vec();
        match self.back.process(&mut work, &mut out) {
            Ok(()) => out,
            Err(e) => unreachable!("both buffers have the planned length and real ends: {e}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::RealDft;
    use std::f64::consts::TAU;

    /// Against the sum that defines it, for even, odd and prime lengths.
    #[test]
    fn equals_its_definition() {
        for n in [1, 2, 12, 45, 97] {
            let x: Vec<f64> = (0..n).map(|t| ((t * t) as f64 * 0.37).sin() + 0.2).collect();
            let dft = RealDft::new(n);
            let back = dft.inverse(&dft.transform(&x));
            assert!(x.iter().zip(&back).all(|(a, b)| (a - b).abs() < 1e-14 * n as f64), "n = {n}");
            for (k, found) in dft.transform(&x).iter().enumerate() {
                let angle = |t: usize| TAU * (k * t % n) as f64 / n as f64;
                let re: f64 = x.iter().enumerate().map(|(t, v)| v * angle(t).cos()).sum();
                let im: f64 = x.iter().enumerate().map(|(t, v)| -v * angle(t).sin()).sum();
                assert!(
                    (found.re - re).abs() + (found.im - im).abs() < 1e-12 * n as f64,
                    "n = {n}, line {k}"
                );
            }
        }
    }
}
