//! Exact adjoint of the sensitivity recursion with respect to the inputs.
//!
//! In scaled units, with a_l = df/dz_l of the output lag l and the forward recursion
//!
//! ```text
//! y(t)   = f(z(t); theta)
//! s_k(t) = df/dtheta_k + sum_l a_l s_k(t-l)
//! ```
//!
//! the weights sbar(t) of s(t) enter through the derivative of f in the direction (sbar in theta, lambda in z):
//!
//! ```text
//! lambda_l = sbar(t)' s(t-l)                  weight of a_l, in the place of y(t-l) in z; zero elsewhere
//! adot_j   = W1bar_j z + b1bar_j + W1_j lambda
//! D        = sum_j w2bar_j h_j + w2_j h'_j adot_j,            h' = 1 - h^2
//! zbar     = ybar(t) df/dz + dD/dz
//!          = sum_j [ (ybar w2_j + w2bar_j - 2 w2_j h_j adot_j) h'_j ] W1_j + w2_j h'_j W1bar_j
//! sbar(t-l) += a_l sbar(t)          ybar(t-l) += zbar_l
//! ```

use dynocal_numerics::linalg::{axpy, dot};

use super::run::Layer;
use super::{MAX_HIDDEN, MAX_WIDTH, NeuralNarx};
use crate::model::{Model, Run};

/// See [`crate::model::Model::sensitivity_adjoint`].
pub(super) fn sensitivity_adjoint(
    net: &NeuralNarx,
    theta: &[f64],
    run: &Run,
    y: &[f64],
    s: &[f64],
    y_bar: &[f64],
    s_bar: &[f64],
    u_bar: &mut [f64],
) {
    let (w, mut layer) = (net.weights(theta), Layer::new());
    let (m, p, q, h, inputs) = (net.n_inputs(), net.n_params(), net.width(), net.hidden, net.window.len());
    let start = run.start.max(net.max_lag()).min(run.len());
    let (with_s, half, ring) = (!s_bar.is_empty(), net.output_scale.half, net.output_lags + 1);
    // What later samples put on earlier ones; it reaches back by the output lags only.
    let (mut later_y, mut later_s) = (vec![0.0; ring], vec![0.0; if with_s { ring * p } else { 0 }]);
    let (mut s_now, zeros) = (vec![0.0; p], [0.0; MAX_WIDTH]);
    let (mut adot, mut z_bar) = ([0.0; MAX_HIDDEN], [0.0; MAX_WIDTH]);
    for t in (start..run.len()).rev() {
        net.forward(&w, run.u, y, t, &mut layer);
        // Weights in scaled units: y = centre + half * scaled.
        let y_now = half * y_bar[t] + std::mem::take(&mut later_y[t % ring]);
        adot.fill(0.0);
        if with_s {
            let gathered = &mut later_s[(t % ring) * p..(t % ring + 1) * p];
            for ((now, own), later) in s_now.iter_mut().zip(&s_bar[t * p..]).zip(gathered.iter_mut()) {
                *now = half * own + std::mem::take(later);
            }
            for (j, a) in adot[..h].iter_mut().enumerate() {
                *a = dot(&s_now[j * q..(j + 1) * q], &layer.z[..q]) + s_now[h * q + j];
            }
            for lag in 1..=net.output_lags.min(t - start) {
                let lambda = dot(&s_now, &s[(t - lag) * p..(t - lag + 1) * p]) / half;
                for (j, a) in adot[..h].iter_mut().enumerate() {
                    *a += w.w1[j * q + inputs + lag - 1] * lambda;
                }
                let place = (t - lag) % ring;
                axpy(net.output_gradient(&w, &layer, lag), &s_now, &mut later_s[place * p..(place + 1) * p]);
            }
        }
        z_bar[..q].fill(0.0);
        for j in 0..h {
            let (out, slope) = (layer.h[j], 1.0 - layer.h[j] * layer.h[j]);
            let (w1_bar, w2_bar) = if with_s {
                (&s_now[j * q..(j + 1) * q], s_now[h * (q + 1) + j])
            } else {
                (&zeros[..q], 0.0)
            };
            let direct = (y_now * w.w2[j] + w2_bar - 2.0 * w.w2[j] * out * adot[j]) * slope;
            axpy(direct, &w.w1[j * q..(j + 1) * q], &mut z_bar[..q]);
            axpy(w.w2[j] * slope, w1_bar, &mut z_bar[..q]);
        }
        for (bar, &(i, lag)) in z_bar.iter().zip(&net.window) {
            u_bar[(t - lag) * m + i] += bar / net.input_scales[i].half;
        }
        for lag in 1..=net.output_lags.min(t - start) {
            later_y[(t - lag) % ring] += z_bar[inputs + lag - 1];
        }
    }
}
