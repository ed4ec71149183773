//! Torque without a torque sensor: (7.24) from closed-loop data, and an observer that has pressure and air beside.
//!
//! ```text
//! (7.24)    y(t) = c + i(t-1..t-3) + s(t-1) + a(t-1..t-2) + y(t-1)     i fuel, s spark, a throttle, each with its coefficient
//! observer  the same with pressure and air flow of the last two samples
//! ```
//!
//! Estimated by least squares of one step, as the thesis does; run freely: the past y are its own.

use dynocal_control::matrix::{C, Matrix};

use super::bed::Driven;

/// Which channels it reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// Fuel, spark, throttle: (7.24).
    Published,
    /// Manifold pressure and air flow beside.
    Observer,
}

/// An estimator with its past.
#[derive(Clone, Debug)]
pub(super) struct Estimator {
    kind: Kind,
    theta: Vec<f64>,
    /// Last estimate.
    pub(super) torque_nm: f64,
}

/// Regressors of a sample, out of the rows before it (latest last) and the last output.
fn row(kind: Kind, u: &[[f64; 3]], shown: &[[f64; 4]], last: f64) -> Vec<f64> {
    let n = u.len();
    let (now, one, two) = (&u[n - 1], &u[n - 2], &u[n - 3]);
    // The torque of a sample answers the inputs that were held up to it.
    let mut x = vec![1.0, now[1], one[1], two[1], now[2], now[0], one[0], last];
    if kind == Kind::Observer {
        let m = shown.len();
        let (s, before) = (&shown[m - 1], &shown[m - 2]);
        x.extend([s[2], before[2], s[3], before[3]]);
    }
    x
}

impl Estimator {
    /// From a record of the closed loop: its torque sensor is the last that is needed.
    pub(super) fn fitted(kind: Kind, record: &Driven) -> Result<Self, String> {
        let rows: Vec<Vec<f64>> = (3..record.u.len())
            .map(|t| row(kind, &record.u[t - 2..=t], &record.shown[t - 2..=t], record.shown[t - 1][0]))
            .collect();
        let p = rows[0].len();
        let scale: Vec<f64> =
            (0..p).map(|k| rows.iter().map(|r| r[k].abs()).fold(0.0, f64::max).max(1e-12)).collect();
        let mut m = Matrix::zeros(p, p);
        let mut r = vec![C::new(0.0, 0.0); p];
        for (x, y) in rows.iter().zip(record.shown[3..].iter().map(|s| s[0])) {
            for i in 0..p {
                r[i] += x[i] / scale[i] * y;
                for j in 0..p {
                    *m.at_mut(i, j) += x[i] / scale[i] * x[j] / scale[j];
                }
            }
        }
        let inverse =
            m.inverse().ok_or("the closed-loop record does not tell the torque estimator's terms")?;
        let theta = inverse.apply(&r).iter().zip(&scale).map(|(t, s)| t.re / s).collect();
        Ok(Self { kind, theta, torque_nm: 0.0 })
    }

    /// The next estimate, out of the last three rows of inputs and sensors (without torque and lambda).
    pub(super) fn step(&mut self, u: &[[f64; 3]], shown: &[[f64; 4]]) -> f64 {
        let x = row(self.kind, u, shown, self.torque_nm);
        self.torque_nm = x.iter().zip(&self.theta).map(|(x, t)| x * t).sum();
        self.torque_nm
    }

    /// Free run over a record: coefficient of determination in percent, and mean squared error in Nm2, against its sensor.
    pub(super) fn fit(&self, record: &Driven) -> (f64, f64) {
        let mut own = self.clone();
        own.torque_nm = record.shown[2][0];
        let (mut errors, mut values) = (Vec::new(), Vec::new());
        for t in 3..record.u.len() {
            let y = own.step(&record.u[t - 2..=t], &record.shown[t - 2..=t]);
            errors.push((y - record.shown[t][0]).powi(2));
            values.push(record.shown[t][0]);
        }
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let spread = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
        let sum: f64 = errors.iter().sum();
        (100.0 * (1.0 - sum / spread), sum / n)
    }
}
