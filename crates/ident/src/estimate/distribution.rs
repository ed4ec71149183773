//! Parameters as what an estimate says of them: a normal distribution to draw from.

use dynocal_numerics::linalg::{LinalgError, cholesky};
use dynocal_numerics::rng::Rng64;

/// Part of the unit matrix that is added to the correlation matrix before it is factored.
const RIDGE: f64 = 1e-10;

/// `N(theta, C)`. Parameters with a zero row in C (the data do not determine them) keep their value.
///
/// ```
/// use dynocal_ident::estimate::ParameterDistribution;
/// use dynocal_numerics::rng::Rng64;
///
/// let distribution = ParameterDistribution::new(&[1.0, 2.0], &[0.04, 0.0, 0.0, 0.0])?;
/// let draw = distribution.draw(&mut Rng64::new(1));
/// assert!((draw[0] - 1.0).abs() < 1.0 && draw[0] != 1.0);
/// assert_eq!(draw[1], 2.0);
/// # Ok::<(), dynocal_numerics::linalg::LinalgError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct ParameterDistribution {
    theta: Vec<f64>,
    scale: Vec<f64>,
    /// R of the correlation matrix R'R.
    factor: Vec<f64>,
}

impl ParameterDistribution {
    /// From an estimate (p) and its covariance (p x p row-major).
    ///
    /// # Errors
    /// [`LinalgError`]: the covariance has another size, or is not positive.
    pub fn new(theta: &[f64], covariance: &[f64]) -> Result<Self, LinalgError> {
        let p = theta.len();
        if covariance.len() != p * p {
            let (found, expected) = (covariance.len(), p * p);
            return Err(LinalgError::Shape { what: "covariance", found, expected });
        }
        let deviation = |k: usize| covariance[k * p + k].sqrt();
        let scale: Vec<f64> = (0..p).map(|k| if deviation(k) > 0.0 { deviation(k) } else { 0.0 }).collect();
        // Unit diagonal first: raw covariances of engine models span twenty decades.
        let mut factor = vec![0.0; p * p];
        for (i, f) in factor.iter_mut().enumerate() {
            let size = scale[i / p] * scale[i % p];
            *f = match i / p == i % p {
                true => 1.0 + RIDGE,
                false if size > 0.0 => covariance[i] / size,
                false => 0.0,
            };
        }
        cholesky(&mut factor, p)?;
        Ok(Self { theta: theta.to_vec(), scale, factor })
    }

    /// One draw.
    pub fn draw(&self, rng: &mut Rng64) -> Vec<f64> {
        let p = self.theta.len();
        let z: Vec<f64> = (0..p).map(|_| rng.normal()).collect();
        let moved = |i: usize| (0..=i).map(|j| self.factor[j * p + i] * z[j]).sum::<f64>();
        (0..p).map(|i| self.theta[i] + self.scale[i] * moved(i)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Mean and covariance of many draws are what was asked for, within their sampling error.
    #[test]
    fn draws_have_the_mean_and_covariance() {
        let (theta, covariance) = ([1.0, -2.0e6], [0.25, -3.0e4, -3.0e4, 1.0e10]);
        let distribution = ParameterDistribution::new(&theta, &covariance).expect("positive");
        let mut rng = Rng64::new(5);
        let n = 20_000;
        let draws: Vec<Vec<f64>> = (0..n).map(|_| distribution.draw(&mut rng)).collect();
        for i in 0..2 {
            let mean = draws.iter().map(|d| d[i]).sum::<f64>() / n as f64;
            let error = covariance[i * 2 + i].sqrt() / (n as f64).sqrt();
            assert!((mean - theta[i]).abs() < 4.0 * error, "{mean} {}", theta[i]);
            for j in 0..2 {
                let of = draws.iter().map(|d| (d[i] - theta[i]) * (d[j] - theta[j])).sum::<f64>() / n as f64;
                let size = (covariance[i * 3] * covariance[j * 3]).sqrt();
                assert!((of - covariance[i * 2 + j]).abs() < 0.04 * size, "{i}{j} {of}");
            }
        }
    }
}
