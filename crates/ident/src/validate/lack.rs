//! Lack of fit: how much of what a model leaves is noise, told by how fast it changes.
//!
//! ```text
//! d_t = e_(t-1)/2 - e_t + e_(t+1)/2              second differences of the errors of a free run
//! s^2 = (2/3) mean d_t^2                          variance of white noise under an error that changes slowly
//! lack = mean e^2 / s^2 - 1                       what the structure leaves, in variances of the noise
//! eta = mean (e_t - e_(t-1))^2 / mean (e - mean e)^2,    z = (1 - eta/2) sqrt((n^2 - 1)/(n - 2))
//! ```
//!
//! z is that of von Neumann's ratio, about standard normal where the errors are white; structure that is missing makes it large. Noise
//! that a sensor has smoothed changes slowly, too, and counts as lack: then the lack is an upper bound.
//!
//! Sources: T. Gasser, L. Sroka, C. Jennen-Steinmetz, Biometrika 73 (1986), 625-633 (s^2); J. von Neumann, Ann. Math. Statist. 12
//! (1941), 367-395 (eta).

/// What errors say of noise and structure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lack {
    /// Standard deviation of the white part of the errors, in the unit of the output.
    pub noise_std: f64,
    /// Mean square of the errors over the variance of that part, less one; not below 0.
    pub lack: f64,
    /// Standardised ratio of von Neumann: above 2.33 the errors are not white (99 %, one-sided).
    pub z: f64,
    /// Errors that counted.
    pub samples: usize,
}

/// Lack of fit from the errors of free runs, a slice for each run. None with fewer than 30 errors, or where they are not finite or do
/// not change.
///
/// ```
/// use dynocal_ident::validate::lack;
/// // An error that goes slowly up and down has no noise in it.
/// let slow: Vec<f64> = (0..500).map(|t| (0.05 * f64::from(t)).sin()).collect();
/// let found = lack(&[&slow]).unwrap();
/// assert!(found.lack > 1e3 && found.z > 10.0);
/// ```
pub fn lack(runs: &[&[f64]]) -> Option<Lack> {
    let n: usize = runs.iter().map(|r| r.len()).sum();
    let mean = runs.iter().flat_map(|r| r.iter()).sum::<f64>() / n.max(1) as f64;
    let square =
        |f: &dyn Fn(f64) -> f64| runs.iter().flat_map(|r| r.iter()).map(|e| f(*e).powi(2)).sum::<f64>();
    let (about_zero, about_mean) = (square(&|e| e) / n.max(1) as f64, square(&|e| e - mean));
    let triples = runs.iter().flat_map(|r| r.windows(3));
    let (sum, count) =
        triples.fold((0.0, 0usize), |(s, k), w| (s + (0.5 * (w[0] + w[2]) - w[1]).powi(2), k + 1));
    let variance = sum / 1.5 / count.max(1) as f64;
    let steps: f64 = runs.iter().flat_map(|r| r.windows(2)).map(|w| (w[1] - w[0]).powi(2)).sum();
    if n < 30 || count < 10 || !(variance > 0.0 && about_zero.is_finite() && about_mean > 0.0) {
        return None;
    }
    let eta = steps / about_mean;
    let n2 = n as f64;
    Some(Lack {
        noise_std: variance.sqrt(),
        lack: (about_zero / variance - 1.0).max(0.0),
        z: (1.0 - 0.5 * eta) * ((n2 * n2 - 1.0) / (n2 - 2.0)).sqrt(),
        samples: n,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use dynocal_numerics::rng::Rng64;

    #[test]
    fn white_errors_have_no_lack_and_the_test_keeps_its_level() {
        let mut refused = 0;
        for seed in 0..400 {
            let mut rng = Rng64::new(seed);
            let e: Vec<f64> = (0..800).map(|_| 1.7 * rng.normal()).collect();
            let found = lack(&[&e]).unwrap();
            assert!((found.noise_std / 1.7 - 1.0).abs() < 0.15, "{found:?}");
            assert!(found.lack < 0.25, "{found:?}");
            refused += usize::from(found.z > 2.33);
        }
        // One per cent of 400, and three standard deviations.
        assert!(refused <= 10, "{refused}");
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
