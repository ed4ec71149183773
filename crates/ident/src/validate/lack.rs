//! Lack of fit: whether what a model leaves is white, and how much of it changes slowly.
//!
//! ```text
//! d_t = e_(t-1)/2 - e_t + e_(t+1)/2              second differences of the errors of a free run
//! s^2 = (2/3) mean d_t^2                          variance of white noise under an error that changes slowly
//! lack = mean e^2 / s^2 - 1                       the slow part, in variances of the fast one
//! eta = sum (e_t - e_(t-1))^2 / sum (e - mean e)^2,    z = (1 - eta/2) sqrt((n^2 - 1)/(n - 2))
//! ```
//!
//! z is that of von Neumann's ratio of one run, about standard normal where the errors are white; those of several runs are added with
//! the roots of their lengths as weights. Structure that is missing makes it large, and so does noise that a sensor has smoothed or that
//! drifts: errors alone do not tell the two apart. A structure that errs in jumps makes s^2 too large and the lack too small.
//!
//! Sources: T. Gasser, L. Sroka, C. Jennen-Steinmetz, Biometrika 73 (1986), 625-633 (s^2); J. von Neumann, Ann. Math. Statist. 12
//! (1941), 367-395 (eta).

/// What errors say of noise and structure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lack {
    /// Standard deviation of the fast part of the errors, in the unit of the output.
    pub noise_std: f64,
    /// Mean square of the errors over the variance of that part, less one; not below 0.
    pub lack: f64,
    /// Standardised ratio of von Neumann: above 2.33 the errors are not white (99 %, one-sided).
    pub z: f64,
    /// Errors that counted.
    pub samples: usize,
}

/// Shortest run that counts: below, the ratio is far from normal.
const SHORTEST: usize = 10;

/// Lack of fit from the errors of free runs, a slice for each run; runs of fewer than ten errors do not count. None with fewer than 30
/// errors, or where they are not finite or do not change.
///
/// ```
/// use dynocal_ident::validate::lack;
/// // An error that goes slowly up and down has no noise in it.
/// let slow: Vec<f64> = (0..500).map(|t| (0.05 * f64::from(t)).sin()).collect();
/// let found = lack(&[&slow]).unwrap();
/// assert!(found.lack > 1e3 && found.z > 10.0);
/// ```
pub fn lack(runs: &[&[f64]]) -> Option<Lack> {
    let (mut squares, mut second, mut triples, mut n) = (0.0, 0.0, 0usize, 0usize);
    let (mut z, mut weights) = (0.0, 0.0);
    for run in runs.iter().filter(|r| r.len() >= SHORTEST) {
        let count = run.len() as f64;
        let mean = run.iter().sum::<f64>() / count;
        let about_mean: f64 = run.iter().map(|e| (e - mean).powi(2)).sum();
        let steps: f64 = run.windows(2).map(|w| (w[1] - w[0]).powi(2)).sum();
        if !(about_mean > 0.0 && about_mean.is_finite()) {
            return None;
        }
        let alone = (1.0 - 0.5 * steps / about_mean) * ((count * count - 1.0) / (count - 2.0)).sqrt();
        z += count.sqrt() * alone;
        weights += count;
        squares += run.iter().map(|e| e * e).sum::<f64>();
        second += run.windows(3).map(|w| (0.5 * (w[0] + w[2]) - w[1]).powi(2)).sum::<f64>();
        triples += run.len() - 2;
        n += run.len();
    }
    let variance = second / 1.5 / triples.max(1) as f64;
    if n < 30 || !(variance > 0.0) {
        return None;
    }
    let lack = (squares / n as f64 / variance - 1.0).max(0.0);
    Some(Lack { noise_std: variance.sqrt(), lack, z: z / weights.sqrt(), samples: n })
}

#[cfg(test)]
mod tests {
    use super::*;
    use dynocal_numerics::rng::Rng64;

    /// Of 400 draws, and three standard deviations.
    fn level(length: usize, pieces: usize) {
        let mut refused = 0;
        for seed in 0..400 {
            let mut rng = Rng64::new(seed);
            let e: Vec<Vec<f64>> =
                (0..pieces).map(|_| (0..length).map(|_| 1.7 * rng.normal()).collect()).collect();
            let found = lack(&e.iter().map(Vec::as_slice).collect::<Vec<_>>()).unwrap();
            assert!((found.noise_std / 1.7 - 1.0).abs() < 0.15, "{found:?}");
            assert!(found.lack < 0.25, "{found:?}");
            refused += usize::from(found.z > 2.33);
        }
        assert!(refused <= 10, "{length} x {pieces}: {refused}");
    }

    #[test]
    fn white_errors_have_no_lack_and_the_test_keeps_its_level() {
        level(800, 1);
        level(40, 60);
    }

    #[test]
    fn what_is_missing_is_told_from_noise() {
        let mut rng = Rng64::new(7);
        let slow = |t: usize| 2.0 * (0.04 * t as f64).sin();
        let e: Vec<f64> = (0..4000).map(|t| slow(t) + 0.5 * rng.normal()).collect();
        let found = lack(&[&e[..2000], &e[2000..]]).unwrap();
        // Mean square 2 of the sine over a variance of 0.25.
        assert!(
            (found.noise_std / 0.5 - 1.0).abs() < 0.05 && (found.lack / 8.0 - 1.0).abs() < 0.1,
            "{found:?}"
        );
        assert!(found.z > 20.0);
    }

    #[test]
    fn too_few_or_no_numbers_are_none() {
        assert_eq!(lack(&[]), None);
        assert_eq!(lack(&[&[1.0; 10]]), None);
        assert_eq!(lack(&[&[0.0; 100]]), None);
        let mut e = vec![1.0; 100];
        e[50] = f64::NAN;
        assert_eq!(lack(&[&e]), None);
    }
}
