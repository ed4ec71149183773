//! The one place that names the random generator (ChaCha8: the same stream on every platform).

use rand::{Rng, SeedableRng};
use rand_distr::{Distribution, StandardNormal};

/// Seeded generator. Independent streams of one seed come from [`Rng64::stream`], so that parallel tasks
/// never share a generator and results do not depend on the number of threads.
#[derive(Clone, Debug)]
pub struct Rng64(rand_chacha::ChaCha8Rng);

impl Rng64 {
    /// Generator of `seed`, stream 0.
    pub fn new(seed: u64) -> Self {
        Self::stream(seed, 0)
    }

    /// Generator of `seed`, independent stream number `stream`.
    pub fn stream(seed: u64, stream: u64) -> Self {
        let mut g = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        g.set_stream(stream);
        Self(g)
    }

    /// Uniform number in `[0, 1)`.
    pub fn uniform(&mut self) -> f64 {
        // 53 random bits: every representable multiple of 2^-53 in [0, 1).
        (self.0.next_u64() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
    }

    /// Uniform number in `[lo, hi)`.
    pub fn uniform_in(&mut self, lo: f64, hi: f64) -> f64 {
        lo + (hi - lo) * self.uniform()
    }

    /// Standard normal number.
    pub fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }

    /// Uniform integer in `0..n` (`n` > 0), free of modulo bias.
    pub fn below(&mut self, n: usize) -> usize {
        let n = n as u64;
        let zone = u64::MAX - u64::MAX % n;
        loop {
            let x = self.0.next_u64();
            if x < zone {
                return (x % n) as usize;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn same_seed_same_stream_and_streams_differ() {
        let draw = |seed, stream| -> Vec<f64> {
            let mut g = Rng64::stream(seed, stream);
            (0..8).map(|_| g.uniform()).collect()
        };
        assert_eq!(draw(7, 0), draw(7, 0));
        assert_ne!(draw(7, 0), draw(7, 1));
        assert_ne!(draw(7, 0), draw(8, 0));
    }

    #[test]
    fn moments_of_uniform_and_normal() {
        let mut g = Rng64::new(1);
        let n = 100_000;
        let (mut mu, mut mn, mut vn) = (0.0, 0.0, 0.0);
        for _ in 0..n {
            let (u, z) = (g.uniform(), g.normal());
            mu += u;
            mn += z;
            vn += z * z;
        }
        let n = f64::from(n);
        // Five standard errors of each mean.
        assert!((mu / n - 0.5).abs() < 5.0 * (1.0 / 12.0 / n).sqrt());
        assert!((mn / n).abs() < 5.0 / n.sqrt());
        assert!((vn / n - 1.0).abs() < 5.0 * (2.0 / n).sqrt());
    }
}
