//! Discrete Fourier transform of real samples: `X(k) = sum_t x(t) e^(-2 pi i k t / n)`, k = 0 .. n/2.
//!
//! Any length; plans are kept by the object, so that many records of one length cost one plan.

use std::sync::Arc;

use realfft::{RealFftPlanner, RealToComplex};

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
}

impl RealDft {
    /// Plans the transform of `n` samples.
    pub fn new(n: usize) -> Self {
        Self { n, plan: RealFftPlanner::new().plan_fft_forward(n.max(1)) }
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
            for (k, found) in RealDft::new(n).transform(&x).iter().enumerate() {
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
