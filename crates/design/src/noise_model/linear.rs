//! Linear models: output error, Box-Jenkins, ARMAX and the general form.

use super::{VIEW, filter_back, filter_from, multiply};
use crate::kernel;
use dynocal_ident::model::form::{Driven, Form, FormRow};
use dynocal_ident::model::linear::{LinearModel, Polynomials, PredictionErrors};
use dynocal_ident::model::poly::{PolyNarx, StructureError};
use dynocal_ident::model::{Model, Run};
use dynocal_numerics::status::Status;

/// A linear model whose sensitivities are those of its prediction errors, or of its free run, in the parameters of A, B
/// and F (see [`crate::noise_model`]).
#[derive(Clone, Debug)]
pub struct LinearInformation {
    model: LinearModel,
    /// The same response as a NARX model, for what reads windows.
    driven: PolyNarx,
    driven_theta: Vec<f64>,
    /// Coefficients of C and D, from 1.
    c: Vec<f64>,
    d: Vec<f64>,
    names: Vec<String>,
    /// Whether the noise model is left out: sensitivities of the free run.
    of_free_run: bool,
}

impl LinearInformation {
    /// For `model` with all its parameters `theta`; the parameters of the design follow.
    ///
    /// ```
    /// use dynocal_design::noise_model::LinearInformation;
    /// use dynocal_ident::model::Model;
    /// use dynocal_ident::model::linear::LinearModel;
    /// // Two inputs with a denominator each: four parameters, six of the common denominator form.
    /// let oe = LinearModel::oe(&["a", "b"], "y", 1, 1, 1);
    /// let (information, theta) = LinearInformation::new(&oe, &[1.0, 0.5, -0.8, -0.6])?;
    /// assert_eq!(theta, [1.0, 0.5, -0.8, -0.6]);
    /// assert_eq!(information.param_name(2), "f1(a)");
    /// # Ok::<(), dynocal_ident::model::poly::StructureError>(())
    /// ```
    ///
    /// # Errors
    /// [`StructureError`] of a model without inputs or with names that cannot stand in regressors.
    pub fn new(model: &LinearModel, theta: &[f64]) -> Result<(Self, Vec<f64>), StructureError> {
        let (driven, driven_theta) = model.deterministic(theta)?;
        let p = model.polynomials(theta);
        let noise = noise_places(model);
        let keep = |k: &usize| !noise.contains(k);
        let all = model.param_names();
        let names = (0..all.len()).filter(keep).map(|k| all[k].clone()).collect();
        let own = (0..theta.len()).filter(keep).map(|k| theta[k]).collect();
        Ok((
            Self { model: model.clone(), driven, driven_theta, c: p.c, d: p.d, names, of_free_run: false },
            own,
        ))
    }

    /// The same parameters with the sensitivities of the free run, for predictions.
    pub fn prediction(&self) -> Self {
        Self { of_free_run: true, ..self.clone() }
    }

    /// All parameters of the model.
    fn complete(&self, theta: &[f64]) -> Vec<f64> {
        let noise = noise_places(&self.model);
        let mut out = theta[..noise.start].to_vec();
        out.extend_from_slice(&self.c[1..]);
        out.extend_from_slice(&self.d[1..]);
        out.extend_from_slice(&theta[noise.start..]);
        out
    }

    fn polynomials(&self, theta: &[f64]) -> Polynomials {
        self.model.polynomials(&self.complete(theta))
    }

    /// Numerator and denominators (common, then of each input) that the sensitivities go through.
    fn filters(&self, p: &Polynomials) -> (Vec<f64>, Vec<f64>, Vec<Vec<f64>>) {
        let (num, den) = match self.of_free_run {
            true => (vec![1.0], p.a.clone()),
            false => (p.d.clone(), p.c.clone()),
        };
        let of_inputs = p.f.iter().map(|f| multiply(&den, f)).collect();
        (num, den, of_inputs)
    }

    /// Responses `w_i` (m x N) from sample `start` on; parts with an F share the given output before it.
    fn responses(&self, p: &Polynomials, run: &Run) -> Vec<Vec<f64>> {
        let m = self.model.n_inputs();
        let sharing = self.model.orders.iter().filter(|o| o.nf > 0).count().max(1) as f64;
        let mut all = Vec::with_capacity(m);
        for (i, o) in self.model.orders.iter().enumerate() {
            let shares = o.nf > 0 && self.model.na == 0;
            let mut w: Vec<f64> = run.y.iter().map(|y| if shares { y / sharing } else { 0.0 }).collect();
            for t in run.start..run.len() {
                let driven = p.b[i].iter().enumerate().take(t + 1);
                let driven: f64 = driven.map(|(k, b)| b * run.u[(t - k) * m + i]).sum();
                let back = p.f[i].iter().enumerate().take(t + 1).skip(1);
                w[t] = driven - back.map(|(k, f)| f * w[t - k]).sum::<f64>();
            }
            all.push(w);
        }
        all
    }

    /// Free run from the responses `w`.
    fn output(&self, p: &Polynomials, w: &[Vec<f64>], run: &Run, y: &mut [f64]) -> Status {
        y[..run.start].copy_from_slice(&run.y[..run.start]);
        for t in run.start..run.len() {
            let back: f64 = p.a.iter().enumerate().take(t + 1).skip(1).map(|(k, a)| a * y[t - k]).sum();
            y[t] = w.iter().map(|w| w[t]).sum::<f64>() - back;
            if !y[t].is_finite() {
                y[t..].fill(f64::NAN);
                return Status::Diverged;
            }
        }
        Status::Converged
    }

    /// What the noise tells about the parameters in `samples` samples of any record: rows (n x p) to be added to
    /// [`crate::problem::Term::prior`], sigma^2 the variance of the innovations. The parameters of C and D, which the
    /// noise alone shows, have been eliminated. Empty for models without A, where the noise tells nothing about B and F;
    /// none where A, C or D is not stable.
    ///
    /// With `psi_e` of `a_j: - 1/A e(t-j)`, `c_j: 1/C e(t-j)`, `d_j: - 1/D e(t-j)` and the moments `R = E[psi_e psi_e']`
    /// the rows have the Gram matrix `samples (R_aa - R_an R_nn^-1 R_na)`.
    pub fn noise_rows(&self, theta: &[f64], samples: usize, noise_variance: f64) -> Option<Vec<f64>> {
        let (na, p) = (self.model.na, self.names.len());
        if na == 0 {
            return Some(Vec::new());
        }
        let polynomials = self.polynomials(theta);
        let parts = [(&polynomials.c, 1.0), (&polynomials.d, -1.0), (&polynomials.a, -1.0)];
        // Noise parameters first, so that the last block of the factor is that of A with them eliminated.
        let mut columns = Vec::new();
        for (den, sign) in parts {
            let response = impulse_response(den)?;
            for lag in 1..den.len() {
                let column = (0..MOST_RESPONSE).map(|t| if t < lag { 0.0 } else { sign * response[t - lag] });
                columns.push(column.collect::<Vec<f64>>());
            }
        }
        let q = columns.len();
        let mut gram = vec![0.0; q * q];
        for i in 0..q {
            for j in 0..q {
                gram[i * q + j] = noise_variance * samples as f64 * kernel::dot(&columns[i], &columns[j]);
            }
        }
        let mut factor = vec![0.0; q * q];
        // Equal factors of A, C and D leave a common combination unseen: then the noise is taken to tell nothing.
        if kernel::cholesky(&gram, q, &mut factor) <= 1e-10 {
            return Some(Vec::new());
        }
        let first = q - na;
        let mut rows = vec![0.0; na * p];
        for i in 0..na {
            for k in 0..=i {
                rows[k * p + i] = factor[(first + i) * q + first + k];
            }
        }
        Some(rows)
    }

    /// Every column of the sensitivities as (signal, lag, sign, denominator).
    fn columns(&self) -> Vec<Column> {
        let mut out: Vec<Column> =
            (1..=self.model.na).map(|lag| Column { signal: Signal::Output, lag, sign: -1.0 }).collect();
        for (i, o) in self.model.orders.iter().enumerate() {
            out.extend((0..o.nb).map(|j| Column { signal: Signal::Input(i), lag: o.nk + j, sign: 1.0 }));
        }
        for (i, o) in self.model.orders.iter().enumerate() {
            out.extend((1..=o.nf).map(|lag| Column { signal: Signal::Response(i), lag, sign: -1.0 }));
        }
        out
    }
}

/// Samples after which an impulse response of a stable polynomial is cut.
const MOST_RESPONSE: usize = 4096;

/// Response of `1 / den` to a unit impulse; none where it does not fade.
fn impulse_response(den: &[f64]) -> Option<Vec<f64>> {
    let (mut x, mut work) = (vec![0.0; MOST_RESPONSE], Vec::new());
    x[0] = 1.0;
    filter_from(&[1.0], den, 0, &mut x, &mut work);
    let fades = |v: &f64| v.is_finite() && v.abs() < 1e-3;
    x[MOST_RESPONSE / 2..].iter().all(fades).then_some(x)
}

/// Places of the parameters of C and D among all of `model`.
fn noise_places(model: &LinearModel) -> std::ops::Range<usize> {
    let first = model.na + model.orders.iter().map(|o| o.nb).sum::<usize>();
    first..first + model.nc + model.nd
}

#[derive(Clone, Copy)]
enum Signal {
    Output,
    Input(usize),
    Response(usize),
}

#[derive(Clone, Copy)]
struct Column {
    signal: Signal,
    lag: usize,
    sign: f64,
}

impl Column {
    fn denominator<'a>(&self, common: &'a [f64], of_inputs: &'a [Vec<f64>]) -> &'a [f64] {
        match self.signal {
            Signal::Output => common,
            Signal::Input(i) | Signal::Response(i) => &of_inputs[i],
        }
    }
}

impl Form for LinearInformation {
    fn row(&self) -> &'static FormRow {
        self.model.row()
    }

    fn inputs(&self) -> &[String] {
        self.model.inputs()
    }

    fn output(&self) -> &str {
        self.model.output()
    }

    fn parameter_names(&self) -> Vec<String> {
        self.names.clone()
    }

    fn memory(&self) -> usize {
        self.model.memory()
    }

    fn dynamics(&self) -> Option<&dyn Model> {
        Some(self)
    }

    fn driven(&self, theta: &[f64]) -> Result<Option<Driven>, StructureError> {
        Form::driven(&self.model, &self.complete(theta))
    }

    fn text(&self) -> Result<serde_json::Value, serde_json::Error> {
        Err(<serde_json::Error as serde::ser::Error>::custom(VIEW))
    }
}

impl Model for LinearInformation {
    fn n_inputs(&self) -> usize {
        self.model.n_inputs()
    }

    fn n_params(&self) -> usize {
        self.names.len()
    }

    fn max_lag(&self) -> usize {
        self.model.max_lag().max(self.driven.max_lag())
    }

    fn output_lag(&self) -> usize {
        self.driven.output_lag()
    }

    fn param_name(&self, k: usize) -> String {
        self.names[k].clone()
    }

    fn is_linear_in_params(&self) -> bool {
        false
    }

    fn simulate(&self, theta: &[f64], run: &Run, y: &mut [f64]) -> Status {
        let polynomials = self.polynomials(theta);
        let w = self.responses(&polynomials, run);
        self.output(&polynomials, &w, run, y)
    }

    fn predict(&self, theta: &[f64], run: &Run, yhat: &mut [f64]) {
        self.model.predict(&self.complete(theta), run, 1, yhat);
    }

    fn sensitivities(&self, theta: &[f64], run: &Run, y: &mut [f64], s: &mut [f64]) -> Status {
        let polynomials = self.polynomials(theta);
        let (m, n, p, start) = (self.n_inputs(), run.len(), self.n_params(), run.start);
        let w = self.responses(&polynomials, run);
        if self.output(&polynomials, &w, run, y) != Status::Converged {
            return Status::Diverged;
        }
        let (num, common, of_inputs) = self.filters(&polynomials);
        s.fill(0.0);
        // Columns of one record; they are short beside what is done with the matrix afterwards.
        let (mut x, mut work) = (vec![0.0; n], Vec::new());
        for (k, c) in self.columns().iter().enumerate() {
            x[..start].fill(0.0);
            for t in start..n {
                x[t] = match (c.signal, t.checked_sub(c.lag)) {
                    (_, None) => 0.0,
                    (Signal::Output, Some(at)) => c.sign * y[at],
                    (Signal::Input(i), Some(at)) => c.sign * run.u[at * m + i],
                    (Signal::Response(i), Some(at)) => c.sign * w[i][at],
                };
            }
            filter_from(&num, c.denominator(&common, &of_inputs), start, &mut x, &mut work);
            s.iter_mut().skip(k).step_by(p).zip(&x).for_each(|(s, x)| *s = *x);
        }
        let finite = s.iter().all(|v| v.is_finite());
        if finite { Status::Converged } else { Status::Diverged }
    }

    fn one_step_jacobian(&self, theta: &[f64], run: &Run, s: &mut [f64]) {
        let (all, p) = (self.complete(theta), self.n_params());
        let (n, q) = (run.len(), all.len());
        let (mut eps, mut jac) = (vec![0.0; n], vec![0.0; n * q]);
        PredictionErrors::from_measured(&self.model, run.u, run.y, run.start)
            .jacobian(&all, &mut eps, &mut jac);
        let noise = noise_places(&self.model);
        for (row, own) in jac.chunks_exact(q).zip(s.chunks_exact_mut(p)) {
            let kept = row.iter().enumerate().filter(|(k, _)| !noise.contains(k));
            own.iter_mut().zip(kept).for_each(|(o, (_, v))| *o = -v);
        }
    }

    fn sensitivity_adjoint(
        &self,
        theta: &[f64],
        run: &Run,
        _y: &[f64],
        _s: &[f64],
        y_bar: &[f64],
        s_bar: &[f64],
        u_bar: &mut [f64],
    ) {
        let polynomials = self.polynomials(theta);
        let (m, n, p, start) = (self.n_inputs(), run.len(), self.n_params(), run.start);
        let (num, common, of_inputs) = self.filters(&polynomials);
        let mut of_y = y_bar.to_vec();
        of_y[..start].fill(0.0);
        let mut of_w = vec![vec![0.0; n]; m];
        let (mut x, mut work) = (vec![0.0; n], Vec::new());
        for (k, c) in self.columns().iter().enumerate().filter(|_| !s_bar.is_empty()) {
            x.iter_mut().zip(s_bar.iter().skip(k).step_by(p)).for_each(|(x, s)| *x = *s);
            x[..start].fill(0.0);
            filter_back(&num, c.denominator(&common, &of_inputs), start, &mut x, &mut work);
            for t in start.max(c.lag)..n {
                let (v, at) = (c.sign * x[t], t - c.lag);
                match c.signal {
                    Signal::Output => of_y[at] += v,
                    Signal::Input(i) => u_bar[at * m + i] += v,
                    Signal::Response(i) => of_w[i][at] += v,
                }
            }
        }
        for t in (start..n).rev() {
            let v = of_y[t];
            of_w.iter_mut().for_each(|w| w[t] += v);
            let back = polynomials.a.iter().enumerate().take(t + 1).skip(1);
            back.for_each(|(k, a)| of_y[t - k] -= a * v);
        }
        for (i, w) in of_w.iter_mut().enumerate() {
            for t in (start..n).rev() {
                let v = w[t];
                let driven = polynomials.b[i].iter().enumerate().take(t + 1);
                driven.for_each(|(k, b)| u_bar[(t - k) * m + i] += b * v);
                let back = polynomials.f[i].iter().enumerate().take(t + 1).skip(1);
                back.for_each(|(k, f)| w[t - k] -= f * v);
            }
        }
    }

    fn window(&self) -> &[(usize, usize)] {
        self.driven.window()
    }

    fn window_derivatives(
        &self,
        _theta: &[f64],
        run: &Run,
        t: usize,
        grad: &mut [f64],
        hess: &mut [f64],
    ) -> f64 {
        self.driven.window_derivatives(&self.driven_theta, run, t, grad, hess)
    }
}
