//! What a linear model says about its output: one step, k steps, free run; and how it is written down.
//!
//! ```text
//! one step    y^(t|t-1) = y(t) - e(t)
//! k steps     y^(t|t-k) = y(t) - sum_{j<k} h_j e(t-j),   h the response of C/(A D)
//! free run    A y = sum B_i/F_i u_i
//! ```
//!
//! Everything runs sample by sample, so that a missing output (NaN) is replaced by its own prediction.
//!
//! Reference: L. Ljung, System Identification (1999), section 3.2.

use dynocal_numerics::status::Status;

use super::filter::{filter, multiply};
use super::{LinearModel, Polynomials};
use crate::model::Run;

impl LinearModel {
    /// Prediction k samples ahead from measured outputs; `yhat[..run.start]` is copied from `run.y`. A start of 0 is from
    /// rest, a later one from the measured values before it. Near the start fewer samples are free.
    ///
    /// ```
    /// use dynocal_ident::model::{Run, linear::LinearModel};
    /// // y(t) = 0.5 y(t-1) + u(t-1) + e(t)
    /// let arx = LinearModel::arx(&["u"], "y", 1, 1, 1);
    /// let run = Run { u: &[1.0, 0.0, 0.0, 0.0], y: &[0.0, 2.0, 0.0, 4.0], start: 1 };
    /// let mut yhat = [0.0; 4];
    /// arx.predict(&[-0.5, 1.0], &run, 1, &mut yhat);
    /// assert_eq!(yhat, [0.0, 1.0, 1.0, 0.0]);
    /// arx.predict(&[-0.5, 1.0], &run, 2, &mut yhat);
    /// assert_eq!(yhat, [0.0, 1.0, 0.5, 0.5]);
    /// ```
    pub fn predict(&self, theta: &[f64], run: &Run, k: usize, yhat: &mut [f64]) {
        let p = self.polynomials(theta);
        let n = run.len();
        let start = run.start.min(n);
        let w = self.responses(&p, run);
        // What stands in for the output, the noise v = A y - sum w, and its innovations.
        let mut y = run.y.to_vec();
        let (mut x, mut e) = (vec![0.0; n], vec![0.0; n]);
        for t in start..n {
            let noise = past(&p.c, &e, t) - past(&p.d, &x, t);
            let predicted = w[t] - past(&p.a, &y, t) + noise;
            if y[t].is_nan() {
                y[t] = predicted;
            }
            e[t] = y[t] - predicted;
            x[t] = e[t] + noise;
        }
        let h = self.noise_response(theta, k.clamp(1, n.max(1)));
        yhat[..start].copy_from_slice(&run.y[..start]);
        for t in start..n {
            yhat[t] = y[t] - h.iter().take(t + 1).enumerate().map(|(j, h)| h * e[t - j]).sum::<f64>();
        }
    }

    /// Free run; `y[..run.start]` is copied from `run.y`. A start of 0 is from rest.
    pub fn simulate(&self, theta: &[f64], run: &Run, y: &mut [f64]) -> Status {
        let p = self.polynomials(theta);
        let start = run.start.min(run.len());
        y[..start].copy_from_slice(&run.y[..start]);
        let w = self.responses(&p, run);
        for t in start..run.len() {
            y[t] = w[t] - past(&p.a, y, t);
            if !y[t].is_finite() {
                y[t..].fill(f64::NAN);
                return Status::Diverged;
            }
        }
        Status::Converged
    }

    /// Sum of the responses `B_i/F_i u_i`. Before the start, parts with an F share the measured output (in the form with
    /// A and F together they are at rest).
    fn responses(&self, p: &Polynomials, run: &Run) -> Vec<f64> {
        let (n, m) = (run.len(), self.n_inputs());
        let start = run.start.min(n);
        let sharing = self.orders.iter().filter(|o| o.nf > 0).count().max(1) as f64;
        let (mut total, mut w) = (vec![0.0; n], vec![0.0; n]);
        for (i, o) in self.orders.iter().enumerate() {
            for t in 0..n {
                w[t] = if t < start && o.nf > 0 && self.na == 0 {
                    run.y[t] / sharing
                } else {
                    let driven = p.b[i].iter().enumerate().take(t + 1);
                    driven.map(|(j, b)| b * run.u[(t - j) * m + i]).sum::<f64>() - past(&p.f[i], &w, t)
                };
                total[t] += w[t];
            }
        }
        total
    }

    /// The first `count` coefficients of the noise's response `C/(A D)`.
    pub fn noise_response(&self, theta: &[f64], count: usize) -> Vec<f64> {
        let p = self.polynomials(theta);
        let (mut impulse, mut h) = (vec![0.0; count], vec![0.0; count]);
        impulse.iter_mut().take(1).for_each(|v| *v = 1.0);
        filter(&p.c, &multiply(&p.a, &p.d), &impulse, &mut h);
        h
    }

    /// Static gain from input i to the output: `B_i(1) / (A(1) F_i(1))`.
    pub fn static_gain(&self, theta: &[f64], i: usize) -> f64 {
        let p = self.polynomials(theta);
        let at_one = |c: &[f64]| c.iter().sum::<f64>();
        at_one(&p.b[i]) / (at_one(&p.a) * at_one(&p.f[i]))
    }

    /// The transfer functions in text, one line for each input and one for the noise.
    ///
    /// ```
    /// use dynocal_ident::model::linear::LinearModel;
    /// let oe = LinearModel::oe(&["inj"], "torque", 2, 1, 1);
    /// let lines = oe.transfer_functions(&[1.0, 0.5, -0.8]);
    /// assert_eq!(lines[0], "torque / inj = (1 q^-1 + 0.5 q^-2) / (1 - 0.8 q^-1)");
    /// assert_eq!(lines[1], "torque / e = 1");
    /// ```
    pub fn transfer_functions(&self, theta: &[f64]) -> Vec<String> {
        let p = self.polynomials(theta);
        let mut lines = Vec::with_capacity(self.n_inputs() + 1);
        for (i, input) in self.inputs.iter().enumerate() {
            let ratio = ratio_text(&p.b[i], &multiply(&p.a, &p.f[i]));
            lines.push(format!("{} / {input} = {ratio}", self.output));
        }
        lines.push(format!("{} / e = {}", self.output, ratio_text(&p.c, &multiply(&p.a, &p.d))));
        lines
    }
}

/// `sum_{j>=1} c_j x(t-j)`, nothing before the record.
fn past(c: &[f64], x: &[f64], t: usize) -> f64 {
    c.iter().enumerate().take(t + 1).skip(1).map(|(j, c)| c * x[t - j]).sum()
}

fn ratio_text(num: &[f64], den: &[f64]) -> String {
    let numerator = polynomial_text(num);
    if den.len() <= 1 {
        return if num.len() > 1 { format!("({numerator})") } else { numerator };
    }
    format!("({numerator}) / ({})", polynomial_text(den))
}

/// `1 - 0.8 q^-1` with six significant digits.
fn polynomial_text(c: &[f64]) -> String {
    let mut text = String::new();
    for (j, &v) in c.iter().enumerate().filter(|(_, v)| **v != 0.0) {
        let digits: f64 = format!("{:.5e}", v.abs()).parse().unwrap_or(v.abs());
        let power = if j == 0 { String::new() } else { format!(" q^-{j}") };
        let sign = match (text.is_empty(), v < 0.0) {
            (true, true) => "-",
            (true, false) => "",
            (false, true) => " - ",
            (false, false) => " + ",
        };
        text.push_str(&format!("{sign}{digits}{power}"));
    }
    if text.is_empty() { "0".into() } else { text }
}
