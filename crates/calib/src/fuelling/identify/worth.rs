//! Whether a richer model is worth its parameters.

use statrs::distribution::{ContinuousCDF, StudentsT};

/// Blocks that records are cut into: enough for a mean and its error, and each much longer than what a sensor remembers.
pub(super) const BLOCKS: usize = 32;
/// Chance to keep what is worth nothing.
const CHANCE: f64 = 0.01;

/// The block of a sample out of `samples`.
pub(super) fn block(t: usize, samples: usize) -> usize {
    (t * BLOCKS / samples.max(1)).min(BLOCKS - 1)
}

/// Whether the richer of two models leaves smaller squares: with d the logarithm of the ratio of their sums in a block,
///
/// ```text
/// mean d / (s / sqrt(B)) > t(B - 1, 99 %)
/// ```
///
/// one-sided and paired (Student, Biometrika 6, 1908), over blocks, as errors within one go together, and of logarithms, as one
/// block with a large error must not outvote all others.
pub(super) fn pays(simple: &[f64], rich: &[f64]) -> bool {
    let n = simple.len();
    let mut sums = [[f64::MIN_POSITIVE; 2]; BLOCKS];
    for (t, (a, b)) in simple.iter().zip(rich).enumerate() {
        let sum = &mut sums[block(t, n)];
        sum[0] += a * a;
        sum[1] += b * b;
    }
    let less = sums.map(|[simple, rich]| (simple / rich).ln());
    let mean = less.iter().sum::<f64>() / BLOCKS as f64;
    let variance = less.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / (BLOCKS - 1) as f64;
    let Ok(student) = StudentsT::new(0.0, 1.0, (BLOCKS - 1) as f64) else {
        return false;
    };
    mean > student.inverse_cdf(1.0 - CHANCE) * (variance / BLOCKS as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use dynocal_numerics::rng::Rng64;

    /// What explains a tenth of the variance is kept, what explains nothing is kept about as often as the chance says.
    #[test]
    fn only_what_explains_something_pays() {
        let of = |seed: u64, share: f64| {
            let mut rng = Rng64::stream(seed, 0);
            let rich: Vec<f64> = (0..3200).map(|_| rng.normal()).collect();
            let simple: Vec<f64> = rich.iter().map(|e| e + share * rng.normal()).collect();
            // Against one that is as bad for another reason.
            let other: Vec<f64> = rich.iter().map(|e| e + share * rng.normal()).collect();
            (pays(&simple, &rich), pays(&simple, &other))
        };
        let found: Vec<(bool, bool)> = (0..200).map(|seed| of(seed, 0.33)).collect();
        let count = |of: fn(&(bool, bool)) -> bool| found.iter().filter(|f| of(f)).count();
        assert!(count(|f| f.0) >= 195, "{}", count(|f| f.0));
        assert!(count(|f| f.1) <= 8, "{}", count(|f| f.1));
        assert!(!pays(&[1.0; 64], &[1.0; 64]));
    }
}
