//! A stored model as a model of measured channels: inputs and output in the user's units, derived channels and preparation
//! folded in. What designs a test, optimises or predicts then needs to know nothing of either.
//!
//! ```text
//! z(t) = f(x(t-k), z(t-j); theta)        the structure, x_i = x_i(u) derived, shifted and scaled sample by sample
//! y(t) = g(z(t))                         the user's output
//!
//! dy/dtheta = g'(z) dz/dtheta            dy/du = g'(z) sum_i dz/dx_i dx_i/du
//! ```

use dynocal_numerics::status::Status;

use super::{Path, Pointwise, StoredError, StoredModel};
use crate::model::form::{Driven, Form, FormRow};
use crate::model::poly::StructureError;
use crate::model::{Drawn, Model, Run};
use std::sync::Arc;

/// A stored model over given measured channels.
#[derive(Clone, Debug)]
pub struct MeasuredModel {
    inner: Driven,
    way: Pointwise,
    /// Inner inputs over rows of the measured channels.
    paths: Vec<Path>,
    /// The user's output.
    output: String,
    /// Measured channels, in the order of the inputs of this model.
    channels: Vec<String>,
    /// For each channel, the inner inputs that it moves.
    moves: Vec<Vec<usize>>,
    /// (channel, lag) pairs that the prediction reads, and for each the entries of the inner window that it moves.
    window: Vec<(usize, usize)>,
    entries: Vec<Vec<usize>>,
}

impl StoredModel {
    /// The model over `channels` (measured ones, all that it reads among them), in the user's units.
    ///
    /// # Errors
    /// [`StoredError`]: a channel is missing, nothing drives the model, or its preparation does not act sample by sample.
    pub fn over(&self, channels: &[String]) -> Result<MeasuredModel, StoredError> {
        self.over_with(channels, self.driven()?)
    }

    /// The same with another model of the structure's inputs and output behind it, e.g. one with the sensitivities of the
    /// prediction errors.
    ///
    /// # Errors
    /// [`StoredError`] as of [`StoredModel::over`].
    pub fn over_with(&self, channels: &[String], inner: Driven) -> Result<MeasuredModel, StoredError> {
        let way = self.pointwise()?;
        let paths = way.paths(channels).map_err(|missing| StoredError::Channels {
            output: self.output.name.clone(),
            found: channels.join(", "),
            expected: format!("`{missing}` among them"),
        })?;
        let moves: Vec<Vec<usize>> =
            (0..channels.len()).map(|c| (0..paths.len()).filter(|i| paths[*i].reads(c)).collect()).collect();
        let (mut window, mut entries): (Vec<(usize, usize)>, Vec<Vec<usize>>) = (Vec::new(), Vec::new());
        for (e, &(i, lag)) in inner.model.window().iter().enumerate() {
            for c in (0..channels.len()).filter(|c| moves[*c].contains(&i)) {
                match window.iter().position(|w| *w == (c, lag)) {
                    Some(k) => entries[k].push(e),
                    None => {
                        window.push((c, lag));
                        entries.push(vec![e]);
                    }
                }
            }
        }
        let output = self.user_output().name;
        Ok(MeasuredModel { inner, way, paths, output, channels: channels.to_vec(), moves, window, entries })
    }
}

impl MeasuredModel {
    /// Parameters of the structure behind (p).
    pub fn theta(&self) -> &[f64] {
        &self.inner.theta
    }

    /// The user's output for a value of the structure's.
    pub fn to_user(&self, z: f64) -> f64 {
        self.way.to_user(z)
    }

    /// The structure's output for a value of the user's.
    pub fn from_user(&self, y: f64) -> f64 {
        self.way.from_user(y)
    }

    /// Inputs of the structure over rows of measured channels.
    fn inner_rows(&self, u: &[f64]) -> Vec<f64> {
        u.chunks_exact(self.channels.len().max(1))
            .flat_map(|row| self.paths.iter().map(|path| path.value(row)))
            .collect()
    }

    fn inner_outputs(&self, y: &[f64]) -> Vec<f64> {
        y.iter().map(|v| self.way.from_user(*v)).collect()
    }

    /// First and second derivative of the user's output with respect to the structure's.
    fn slopes(&self, z: f64) -> (f64, f64) {
        self.way.output_slopes(z)
    }
}

impl Form for MeasuredModel {
    fn row(&self) -> &'static FormRow {
        self.inner.model.row()
    }

    fn inputs(&self) -> &[String] {
        &self.channels
    }

    fn output(&self) -> &str {
        &self.output
    }

    fn parameter_names(&self) -> Vec<String> {
        (0..self.n_params()).map(|k| self.param_name(k)).collect()
    }

    fn memory(&self) -> usize {
        self.max_lag()
    }

    fn dynamics(&self) -> Option<&dyn Model> {
        Some(self)
    }

    fn driven(&self, theta: &[f64]) -> Result<Option<Driven>, StructureError> {
        Ok(Some(Driven { model: Arc::new(self.clone()), theta: theta.to_vec() }))
    }

    fn text(&self) -> Result<serde_json::Value, serde_json::Error> {
        Err(serde::ser::Error::custom("a view of a stored model is kept as the stored model"))
    }
}

impl Model for MeasuredModel {
    fn n_inputs(&self) -> usize {
        self.channels.len()
    }

    fn n_params(&self) -> usize {
        self.inner.model.n_params()
    }

    fn max_lag(&self) -> usize {
        self.inner.model.max_lag()
    }

    fn output_lag(&self) -> usize {
        self.inner.model.output_lag()
    }

    fn param_name(&self, k: usize) -> String {
        self.inner.model.param_name(k)
    }

    fn is_linear_in_params(&self) -> bool {
        // The user's output may be a curve of the structure's.
        self.inner.model.is_linear_in_params() && self.way.output_is_affine()
    }

    fn drawn(&self) -> Option<&dyn Drawn> {
        self.inner.model.drawn()
    }

    fn simulate(&self, theta: &[f64], run: &Run, y: &mut [f64]) -> Status {
        let (x, z0) = (self.inner_rows(run.u), self.inner_outputs(run.y));
        let status = self.inner.model.simulate(theta, &Run { u: &x, y: &z0, start: run.start }, y);
        y.iter_mut().for_each(|v| *v = self.way.to_user(*v));
        status
    }

    fn predict(&self, theta: &[f64], run: &Run, yhat: &mut [f64]) {
        let (x, z) = (self.inner_rows(run.u), self.inner_outputs(run.y));
        self.inner.model.predict(theta, &Run { u: &x, y: &z, start: run.start }, yhat);
        yhat.iter_mut().for_each(|v| *v = self.way.to_user(*v));
    }

    fn sensitivities(&self, theta: &[f64], run: &Run, y: &mut [f64], s: &mut [f64]) -> Status {
        let (x, z0) = (self.inner_rows(run.u), self.inner_outputs(run.y));
        let status = self.inner.model.sensitivities(theta, &Run { u: &x, y: &z0, start: run.start }, y, s);
        let p = self.n_params().max(1);
        for (v, row) in y.iter_mut().zip(s.chunks_exact_mut(p)) {
            let slope = self.slopes(*v).0;
            row.iter_mut().for_each(|d| *d *= slope);
            *v = self.way.to_user(*v);
        }
        status
    }

    fn one_step_jacobian(&self, theta: &[f64], run: &Run, s: &mut [f64]) {
        let (x, z) = (self.inner_rows(run.u), self.inner_outputs(run.y));
        let inner = Run { u: &x, y: &z, start: run.start };
        self.inner.model.one_step_jacobian(theta, &inner, s);
        let mut predicted = vec![0.0; z.len()];
        self.inner.model.predict(theta, &inner, &mut predicted);
        let p = self.n_params().max(1);
        for (v, row) in predicted.iter().zip(s.chunks_exact_mut(p)) {
            let slope = self.slopes(*v).0;
            row.iter_mut().for_each(|d| *d *= slope);
        }
    }

    fn sensitivity_adjoint(
        &self,
        theta: &[f64],
        run: &Run,
        y: &[f64],
        s: &[f64],
        y_bar: &[f64],
        s_bar: &[f64],
        u_bar: &mut [f64],
    ) {
        let (x, z0) = (self.inner_rows(run.u), self.inner_outputs(run.y));
        let inner = Run { u: &x, y: &z0, start: run.start };
        let z = self.inner_outputs(y);
        let p = self.n_params().max(1);
        // y = g(z), s = g'(z) s_z: weights on (y, s) are weights on (z, s_z).
        let mut z_bar = y_bar.to_vec();
        let (mut sz, mut sz_bar) = (Vec::new(), Vec::new());
        if s_bar.is_empty() {
            z_bar.iter_mut().zip(&z).for_each(|(b, z)| *b *= self.slopes(*z).0);
        } else {
            sz = s.to_vec();
            sz_bar = s_bar.to_vec();
            for t in 0..z.len() {
                let (first, second) = self.slopes(z[t]);
                z_bar[t] *= first;
                for k in t * p..(t + 1) * p {
                    sz[k] = if first == 0.0 { 0.0 } else { s[k] / first };
                    z_bar[t] += s_bar[k] * second * sz[k];
                    sz_bar[k] *= first;
                }
            }
        }
        let mut x_bar = vec![0.0; x.len()];
        self.inner.model.sensitivity_adjoint(theta, &inner, &z, &sz, &z_bar, &sz_bar, &mut x_bar);
        let (m, width) = (self.paths.len(), self.channels.len());
        for (t, row) in run.u.chunks_exact(width.max(1)).enumerate() {
            for (c, inputs) in self.moves.iter().enumerate() {
                for &i in inputs {
                    let bar = x_bar[t * m + i];
                    if bar != 0.0 {
                        u_bar[t * width + c] += bar * self.paths[i].slope(row, c);
                    }
                }
            }
        }
    }

    fn window(&self) -> &[(usize, usize)] {
        &self.window
    }

    fn window_derivatives(
        &self,
        theta: &[f64],
        run: &Run,
        t: usize,
        grad: &mut [f64],
        hess: &mut [f64],
    ) -> f64 {
        let (width, lag) = (self.channels.len(), self.max_lag());
        let from = t - lag;
        // Only the window is carried over: one sample costs the same in a long record.
        let rows = &run.u[from * width..(t + 1) * width];
        let (x, z) = (self.inner_rows(rows), self.inner_outputs(&run.y[from..=t]));
        let inner_window = self.inner.model.window();
        let (w, v) = (self.window.len(), inner_window.len());
        let (mut gz, mut hz) = (vec![0.0; v], vec![0.0; v * v]);
        let local = Run { u: &x, y: &z, start: lag };
        let value = self.inner.model.window_derivatives(theta, &local, lag, &mut gz, &mut hz);
        let (first, second) = self.slopes(value);
        // Slope of every inner entry with respect to each outer entry that moves it.
        let slope = |k: usize, e: usize| {
            let ((c, lag_k), (i, _)) = (self.window[k], inner_window[e]);
            let at = lag - lag_k;
            self.paths[i].slope(&rows[at * width..(at + 1) * width], c)
        };
        let slopes: Vec<Vec<f64>> =
            (0..w).map(|k| self.entries[k].iter().map(|&e| slope(k, e)).collect()).collect();
        let mut inner_grad = vec![0.0; w];
        for k in 0..w {
            inner_grad[k] = self.entries[k].iter().zip(&slopes[k]).map(|(&e, s)| gz[e] * s).sum();
            grad[k] = first * inner_grad[k];
        }
        for a in 0..w {
            for b in 0..w {
                let mut sum = 0.0;
                for (&e, sa) in self.entries[a].iter().zip(&slopes[a]) {
                    for (&f, sb) in self.entries[b].iter().zip(&slopes[b]) {
                        sum += hz[e * v + f] * sa * sb;
                    }
                }
                let ((ca, lag_a), (cb, lag_b)) = (self.window[a], self.window[b]);
                if lag_a == lag_b {
                    // The curvature of a derived channel itself.
                    let at = lag - lag_a;
                    let row = &rows[at * width..(at + 1) * width];
                    for &e in self.entries[a].iter().filter(|e| self.entries[b].contains(e)) {
                        let i = inner_window[e].0;
                        sum += gz[e] * self.paths[i].bend(row, ca, cb);
                    }
                }
                hess[a * w + b] = first * sum + second * inner_grad[a] * inner_grad[b];
            }
        }
        self.way.to_user(value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::derived::Derived;
    use crate::model::poly::PolyNarx;
    use crate::stored::Quantity;

    /// `phi = 1/lambda` driven by fuel and by `120/speed`, read as lambda over fuel and speed.
    fn model() -> MeasuredModel {
        let texts = ["1", "inj(t-1)", "inj(t-2)*cycle(t-1)", "cycle(t-1)^2", "phi(t-1)", "phi(t-1)*inj(t-1)"];
        let structure = PolyNarx::parse(&["inj", "cycle"], "phi", &texts).unwrap();
        let q = |name: &str, unit: &str| Quantity { name: name.into(), unit: unit.into() };
        let theta = [0.3, 0.02, 0.1, 3.0, 0.4, -0.002];
        let inputs = vec![q("inj", "mg"), q("cycle", "s")];
        let mut stored = StoredModel::new(structure, &theta, inputs, q("phi", "-"), 0.03).unwrap();
        let derived = |name: &str, of: &str, factor: f64| Derived {
            name: name.into(),
            unit: "-".into(),
            factor,
            powers: [(of.to_string(), -1)].into(),
        };
        stored.derived = vec![derived("cycle", "speed", 120.0), derived("phi", "lambda", 1.0)];
        stored.over(&["speed".into(), "inj".into()]).unwrap()
    }

    fn inputs(n: usize) -> Vec<f64> {
        (0..n)
            .flat_map(|t| [1800.0 + 500.0 * (0.3 * t as f64).sin(), 10.0 + 3.0 * (0.9 * t as f64).cos()])
            .collect()
    }

    /// Weighted sum of outputs and sensitivities over a run.
    fn weighted(m: &MeasuredModel, u: &[f64], wy: &[f64], ws: &[f64]) -> f64 {
        let n = u.len() / 2;
        let y0 = vec![1.1; n];
        let (mut y, mut s) = (vec![0.0; n], vec![0.0; n * m.n_params()]);
        m.sensitivities(m.theta(), &Run { u, y: &y0, start: 2 }, &mut y, &mut s);
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
        dot(&y[2..], &wy[2..]) + dot(&s[2 * m.n_params()..], &ws[2 * m.n_params()..])
    }

    #[test]
    fn sensitivities_and_their_adjoint_agree_with_differences() {
        let m = model();
        let (n, p) = (12, m.n_params());
        let u = inputs(n);
        let y0 = vec![1.1; n];
        let (mut y, mut s) = (vec![0.0; n], vec![0.0; n * p]);
        m.sensitivities(m.theta(), &Run { u: &u, y: &y0, start: 2 }, &mut y, &mut s);
        for k in 0..p {
            let at = |d: f64| {
                let mut theta = m.theta().to_vec();
                theta[k] += d;
                let mut y = vec![0.0; n];
                m.simulate(&theta, &Run { u: &u, y: &y0, start: 2 }, &mut y);
                y
            };
            let h = 1e-6 * m.theta()[k].abs();
            let (up, down) = (at(h), at(-h));
            for t in 2..n {
                let difference = (up[t] - down[t]) / (2.0 * h);
                assert!((difference - s[t * p + k]).abs() < 1e-6 * (1.0 + difference.abs()), "{t} {k}");
            }
        }
        let wy: Vec<f64> = (0..n).map(|t| (t as f64).sin()).collect();
        let ws: Vec<f64> = (0..n * p).map(|t| (1.3 * t as f64).cos()).collect();
        let mut u_bar = vec![0.0; u.len()];
        m.sensitivity_adjoint(m.theta(), &Run { u: &u, y: &y0, start: 2 }, &y, &s, &wy, &ws, &mut u_bar);
        for (k, bar) in u_bar.iter().enumerate() {
            let at = |d: f64| {
                let mut v = u.clone();
                v[k] += d;
                weighted(&m, &v, &wy, &ws)
            };
            let h = 1e-6 * u[k];
            let difference = (at(h) - at(-h)) / (2.0 * h);
            assert!((difference - bar).abs() < 2e-6 * (1e-3 + difference.abs()), "{k}: {difference} {bar}");
        }
    }

    #[test]
    fn window_derivatives_agree_with_differences() {
        let m = model();
        let (n, w) = (8, m.window().len());
        let u = inputs(n);
        let y: Vec<f64> = (0..n).map(|t| 1.0 + 0.1 * (t as f64).sin()).collect();
        let t = 6;
        let at = |u: &[f64]| {
            let (mut g, mut h) = (vec![0.0; w], vec![0.0; w * w]);
            let value = m.window_derivatives(m.theta(), &Run { u, y: &y, start: 2 }, t, &mut g, &mut h);
            (value, g, h)
        };
        let (_, g, h) = at(&u);
        for (a, &(c, lag)) in m.window().iter().enumerate() {
            let place = (t - lag) * 2 + c;
            let step = 1e-5 * u[place];
            let (mut up, mut down) = (u.clone(), u.clone());
            up[place] += step;
            down[place] -= step;
            let ((fu, gu, _), (fd, gd, _)) = (at(&up), at(&down));
            let slope = (fu - fd) / (2.0 * step);
            assert!((slope - g[a]).abs() < 1e-7 * (1e-4 + slope.abs()), "{a}: {slope} {}", g[a]);
            for b in 0..w {
                let second = (gu[b] - gd[b]) / (2.0 * step);
                assert!(
                    (second - h[a * w + b]).abs() < 1e-6 * (1e-5 + second.abs()),
                    "{a} {b}: {second} {}",
                    h[a * w + b]
                );
            }
        }
    }
}
