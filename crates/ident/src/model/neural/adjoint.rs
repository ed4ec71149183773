//! Exact adjoint of the sensitivity recursion with respect to the inputs.
//!
//! In scaled units, with a_l = df/dz_l of the output lag l and the forward recursion
//!
//! ```text
//! y(t)   = f(z(t); theta)
//! s_k(t) = df/dtheta_k + sum_l a_l s_k(t-l)
//! ```
//!
//! the weights sbar(t) of s(t) enter through the derivative D of f in the direction (sbar in theta, lambda in z):
//!
//! ```text
//! lambda_l = sbar(t)' s(t-l)                  weight of a_l, in the place of y(t-l) in z; zero elsewhere
//! zbar     = ybar(t) df/dz + dD/dz            Network::tangent_adjoint
//! sbar(t-l) += a_l sbar(t)          ybar(t-l) += zbar_l
//! ```

use dynocal_numerics::linalg::{axpy, dot};

use super::NeuralNarx;
use super::network::{MAX_WIDTH, Pass, Tangent};
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
    let (mut pass, mut work) = (Pass::new(), Tangent::new());
    let (m, p, q, inputs, lags) =
        (net.n_inputs(), net.n_params(), net.width(), net.window.len(), net.layout.output_lags);
    let start = net.first(run);
    let (with_s, half, ring) = (!s_bar.is_empty(), net.output_scale.half, lags + 1);
    // What later samples put on earlier ones; it reaches back by the output lags only.
    let (mut later_y, mut later_s) = (vec![0.0; ring], vec![0.0; if with_s { ring * p } else { 0 }]);
    let mut s_now = vec![0.0; if with_s { p } else { 0 }];
    let (mut z_dot, mut z_bar) = ([0.0; MAX_WIDTH], [0.0; MAX_WIDTH]);
    for t in (start..run.len()).rev() {
        net.forward(theta, run.u, y, t, &mut pass);
        // Weights in scaled units: y = centre + half * scaled.
        let y_now = half * y_bar[t] + std::mem::take(&mut later_y[t % ring]);
        if with_s {
            net.network.backward(theta, &mut pass);
            let gathered = &mut later_s[(t % ring) * p..(t % ring + 1) * p];
            for ((now, own), later) in s_now.iter_mut().zip(&s_bar[t * p..]).zip(gathered.iter_mut()) {
                *now = half * own + std::mem::take(later);
            }
            z_dot[..q].fill(0.0);
            for lag in 1..=lags.min(t - start) {
                z_dot[inputs + lag - 1] = dot(&s_now, &s[(t - lag) * p..(t - lag + 1) * p]) / half;
                let place = (t - lag) % ring;
                axpy(
                    net.output_gradient(theta, &pass, lag),
                    &s_now,
                    &mut later_s[place * p..(place + 1) * p],
                );
            }
        }
        z_bar[..q].fill(0.0);
        net.network.tangent_adjoint(theta, &pass, &s_now, &z_dot[..q], y_now, &mut work, &mut z_bar[..q]);
        for (bar, &(i, lag)) in z_bar.iter().zip(&net.window) {
            u_bar[(t - lag) * m + i] += bar / net.input_scales[i].half;
        }
        for lag in 1..=lags.min(t - start) {
            later_y[(t - lag) % ring] += z_bar[inputs + lag - 1];
        }
    }
}
