//! Tests for control: the input whose model gives the controller with the least expected loss.
//!
//! ```text
//! yhat = B/A u,  psi = dyhat/dtheta,   M = sum psi psi' / s^2        what a test of N samples says of theta = (a, b)
//! loss L(theta^): what the controller built on theta^ costs on the plant theta;  theta^ ~ N(theta, M^-1)
//! E L - L(theta) = 1/2 tr(H M^-1) + ..,    H = d2L/dtheta^2 at theta^ = theta            (`Weighted`)
//! D: -log det M;     I: tr(R M^-1), R = mean of psi psi' over the inputs of its use      (also `Weighted`)
//! ```
//!
//! All are functions of M; psi is linear in u, so that the gradient is exact: the filters of psi run backwards over
//! `q(t) = -2/s^2 W psi(t)`, W = M^-1 for D and `1/2 M^-1 H M^-1` for a weight. (H. Hjalmarsson, European J. Control 15 (2009)
//! 275-310; M. Gevers, European J. Control 11 (2005) 335-352.)

use dynocal_numerics::rng::Rng64;

use crate::error::ControlError;
use crate::matrix::{C, Matrix};

/// A sampled plant `y(t) = -a_1 y(t-1) - .. + b_1 u(t-1) + ..`, noise of deviation `noise_std` on its output.
#[derive(Clone, Debug, PartialEq)]
pub struct OutputError {
    /// a_1, a_2, ..
    pub a: Vec<f64>,
    /// b_1, b_2, ..
    pub b: Vec<f64>,
    /// Standard deviation of the measurement.
    pub noise_std: f64,
}

/// What a test is to make small.
#[derive(Clone, Debug, PartialEq)]
pub enum Worth {
    /// -log det M.
    Determinant,
    /// 1/2 tr(H M^-1), H row-major: second derivatives of a loss, or a matrix of mean squares.
    Weighted(Vec<f64>),
}

impl OutputError {
    /// Number of parameters.
    pub fn parameters(&self) -> usize {
        self.a.len() + self.b.len()
    }

    /// The parameters: a, then b.
    pub fn theta(&self) -> Vec<f64> {
        self.a.iter().chain(&self.b).copied().collect()
    }

    /// The same with other parameters.
    pub fn with(&self, theta: &[f64]) -> Self {
        let (a, b) = theta.split_at(self.a.len());
        Self { a: a.to_vec(), b: b.to_vec(), noise_std: self.noise_std }
    }

    /// `x / A`
    fn over(&self, x: &[f64]) -> Vec<f64> {
        let mut y = x.to_vec();
        for t in 0..y.len() {
            for (k, a) in self.a.iter().enumerate().take(t) {
                y[t] -= a * y[t - 1 - k];
            }
        }
        y
    }

    /// Output without noise, from rest.
    pub fn output(&self, u: &[f64]) -> Vec<f64> {
        let driven: Vec<f64> = (0..u.len())
            .map(|t| self.b.iter().enumerate().take(t).map(|(k, b)| b * u[t - 1 - k]).sum())
            .collect();
        self.over(&driven)
    }

    /// Derivatives of the output to the parameters, rows x parameters.
    pub fn sensitivities(&self, u: &[f64]) -> Vec<f64> {
        let (na, p) = (self.a.len(), self.parameters());
        let (by_a, by_b) = (self.over(&self.output(u)), self.over(u));
        let mut psi = vec![0.0; u.len() * p];
        for t in 0..u.len() {
            for k in 0..p {
                let (lag, column) = if k < na { (k + 1, &by_a) } else { (k - na + 1, &by_b) };
                if t >= lag {
                    psi[t * p + k] = if k < na { -column[t - lag] } else { column[t - lag] };
                }
            }
        }
        psi
    }

    /// Information matrix of an input, row-major.
    pub fn information(&self, u: &[f64]) -> Vec<f64> {
        let p = self.parameters();
        let mut m = vec![0.0; p * p];
        for row in self.sensitivities(u).chunks(p) {
            for i in 0..p {
                for j in 0..p {
                    m[i * p + j] += row[i] * row[j] / self.noise_std.powi(2);
                }
            }
        }
        m
    }

    /// Value of a criterion and its gradient to every sample of the input.
    ///
    /// # Errors
    /// [`ControlError::Singular`]: an input that does not tell the parameters.
    pub fn criterion(&self, u: &[f64], worth: &Worth) -> Result<(f64, Vec<f64>), ControlError> {
        let p = self.parameters();
        let m = real(&self.information(u), p);
        let silent = || ControlError::Singular {
            what: "the information of the test (its input does not tell all parameters)".into(),
            frequency_rad_s: 0.0,
        };
        let (det, inverse) = m.solved();
        let inverse = inverse.filter(|_| det.re > 0.0).ok_or_else(silent)?;
        let (value, weight) = match worth {
            Worth::Determinant => (-det.re.ln(), inverse),
            Worth::Weighted(h) => {
                let w = inverse.times(&real(h, p)).times(&inverse);
                let trace: f64 =
                    (0..p).map(|i| (0..p).map(|j| h[i * p + j] * inverse.at(j, i).re).sum::<f64>()).sum();
                (0.5 * trace, Matrix { data: w.data.iter().map(|v| v * 0.5).collect(), ..w })
            }
        };
        if !value.is_finite() {
            return Err(silent());
        }
        Ok((value, self.backwards(u, &weight)))
    }

    /// Gradient of sum_t q(t)' psi(t) with q = -2/s^2 W psi.
    fn backwards(&self, u: &[f64], weight: &Matrix) -> Vec<f64> {
        let (n, na, p) = (u.len(), self.a.len(), self.parameters());
        let psi = self.sensitivities(u);
        let scale = -2.0 / self.noise_std.powi(2);
        // What each sample of y/A and of u/A is worth.
        let (mut to_a, mut to_b) = (vec![0.0; n], vec![0.0; n]);
        for t in 0..n {
            for k in 0..p {
                let q: f64 = scale * (0..p).map(|j| weight.at(k, j).re * psi[t * p + j]).sum::<f64>();
                let lag = if k < na { k + 1 } else { k - na + 1 };
                if t >= lag {
                    let target = if k < na { &mut to_a } else { &mut to_b };
                    target[t - lag] += if k < na { -q } else { q };
                }
            }
        }
        // y = B/A u is worth what y/A gives; both go back through their filters.
        let through = |x: &[f64]| -> Vec<f64> {
            let turned: Vec<f64> = x.iter().rev().copied().collect();
            self.over(&turned).into_iter().rev().collect()
        };
        let driven = through(&through(&to_a));
        let mut out = through(&to_b);
        for t in 0..n {
            for (k, b) in self.b.iter().enumerate() {
                if t + 1 + k < n {
                    out[t] += b * driven[t + 1 + k];
                }
            }
        }
        out
    }

    /// An input of `rows` samples within -1 to 1 that makes a criterion small: from a random two-level input by steps of
    /// sign and projected gradient, each kept where it makes the criterion smaller. A local search: another seed may do better.
    ///
    /// # Errors
    /// As of [`OutputError::criterion`].
    pub fn designed(&self, rows: usize, worth: &Worth, seed: u64) -> Result<(f64, Vec<f64>), ControlError> {
        let mut rng = Rng64::stream(seed, 3);
        let mut level = 1.0;
        let mut u: Vec<f64> = (0..rows)
            .map(|_| {
                level = if rng.uniform() < 0.2 { -level } else { level };
                level
            })
            .collect();
        let (mut value, mut gradient) = self.criterion(&u, worth)?;
        let mut step = 0.5;
        for _ in 0..400 {
            let largest = gradient.iter().fold(0.0f64, |m, g| m.max(g.abs()));
            if !(largest > 0.0) || step < 1e-4 {
                break;
            }
            let tried: Vec<f64> =
                u.iter().zip(&gradient).map(|(v, g)| (v - step * g / largest).clamp(-1.0, 1.0)).collect();
            match self.criterion(&tried, worth) {
                Ok((better, next)) if better < value => {
                    (value, gradient, u) = (better, next, tried);
                    step = (1.5 * step).min(4.0);
                }
                _ => step *= 0.5,
            }
        }
        Ok((value, u))
    }

    /// Least squares of the output error to a record, from these parameters, by Gauss-Newton with halved steps.
    pub fn estimated(&self, u: &[f64], y: &[f64]) -> Self {
        let p = self.parameters();
        let mut model = self.clone();
        let cost = |m: &Self| m.output(u).iter().zip(y).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
        let mut now = cost(&model);
        for _ in 0..40 {
            let psi = model.sensitivities(u);
            let left: Vec<f64> = y.iter().zip(model.output(u)).map(|(a, b)| a - b).collect();
            let mut m = Matrix::zeros(p, p);
            let mut r = vec![C::new(0.0, 0.0); p];
            for (row, e) in psi.chunks(p).zip(&left) {
                for i in 0..p {
                    r[i] += row[i] * e;
                    for j in 0..p {
                        *m.at_mut(i, j) += row[i] * row[j];
                    }
                }
            }
            let Some(inverse) = m.inverse() else { break };
            let step = inverse.apply(&r);
            let mut share = 1.0;
            let better = loop {
                let theta: Vec<f64> =
                    model.theta().iter().zip(&step).map(|(t, s)| t + share * s.re).collect();
                let tried = model.with(&theta);
                let own = cost(&tried);
                if own < now {
                    break Some((tried, own));
                }
                share *= 0.5;
                if share < 1e-6 {
                    break None;
                }
            };
            match better {
                Some((tried, own)) => {
                    let done = now - own < 1e-12 * now;
                    (model, now) = (tried, own);
                    if done {
                        break;
                    }
                }
                None => break,
            }
        }
        model
    }
}

/// Second derivatives of a loss at a point by central differences, row-major; `scale` is the step of each parameter.
pub fn curvature(loss: &dyn Fn(&[f64]) -> f64, at: &[f64], scale: &[f64]) -> Vec<f64> {
    let p = at.len();
    let value = |i: usize, di: f64, j: usize, dj: f64| {
        let mut x = at.to_vec();
        x[i] += di * scale[i];
        x[j] += dj * scale[j];
        loss(&x)
    };
    let mut h = vec![0.0; p * p];
    for i in 0..p {
        for j in 0..=i {
            let d = value(i, 1.0, j, 1.0) - value(i, 1.0, j, -1.0) - value(i, -1.0, j, 1.0)
                + value(i, -1.0, j, -1.0);
            h[i * p + j] = d / (4.0 * scale[i] * scale[j]);
            h[j * p + i] = h[i * p + j];
        }
    }
    h
}

fn real(m: &[f64], n: usize) -> Matrix {
    Matrix { rows: n, cols: n, data: m.iter().map(|v| C::new(*v, 0.0)).collect() }
}
