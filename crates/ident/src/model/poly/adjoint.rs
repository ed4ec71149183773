//! Exact adjoint of the sensitivity recursion with respect to the inputs.
//!
//! With phi_k(t) = I_k(t) O_k(t) the forward recursion is
//!
//! ```text
//! y(t)   = sum_k theta_k phi_k(t)
//! a_j(t) = sum_k theta_k I_k(t) dO_k/dy(t-j)
//! s_k(t) = phi_k(t) + sum_j a_j(t) s_k(t-j)
//! ```
//!
//! so that, backwards in time, with ybar(t) and sbar(t) holding the weights and all later contributions,
//!
//! ```text
//! w_k     = theta_k ybar(t) + sbar_k(t)                  weight of phi_k(t)
//! abar_j  = sbar(t)' s(t-j)                              weight of a_j(t)
//! sbar(t-j) += a_j(t) sbar(t)
//! weight of I_k:      w_k O_k  + theta_k sum_j abar_j dO_k/dy(t-j)
//! ybar(t-i) += I_k ( w_k dO_k/dy(t-i) + theta_k sum_j abar_j d2O_k/dy(t-j)dy(t-i) )
//! ```

use super::program::{MAX_OUTPUT_LAGS, Program, Tap, first_derivative, second_derivative};
use super::shaped::Place;
use crate::model::Run;

/// See [`crate::model::Model::sensitivity_adjoint`].
pub(super) fn sensitivity_adjoint(
    program: &Program,
    theta: &[f64],
    run: &Run,
    y: &[f64],
    s: &[f64],
    y_bar: &[f64],
    s_bar: &[f64],
    u_bar: &mut [f64],
) {
    let p = program.terms.len();
    let start = run.start.max(program.max_lag).min(run.len());
    let with_s = !s_bar.is_empty();
    // Weights that later samples put on earlier ones; a ring, since they reach back by the output lag only.
    let ring = program.output_lags.last().map_or(0, |l| l + 1);
    let mut later = Later { ring, p, y: vec![0.0; ring], s: vec![0.0; if with_s { ring * p } else { 0 }] };
    let mut s_now = vec![0.0; if with_s { p } else { 0 }];
    let mut weight = vec![0.0; p];
    for t in (start..run.len()).rev() {
        let y_now = y_bar[t] + later.take(t, &mut s_now);
        if with_s {
            for (x, v) in s_now.iter_mut().zip(&s_bar[t * p..(t + 1) * p]) {
                *x += v;
            }
            for ((w, th), v) in weight.iter_mut().zip(theta).zip(&s_now) {
                *w = th * y_now + v;
            }
        } else {
            for (w, th) in weight.iter_mut().zip(theta) {
                *w = th * y_now;
            }
        }
        let u = program.input_window(run.u, t);
        let u_out = &mut u_bar[(t - program.max_lag) * program.m..(t + 1) * program.m];
        for &(k, a) in &program.singles {
            u_out[a] += weight[k];
        }
        for &(k, a, b) in &program.pairs {
            u_out[a] += weight[k] * u[b];
            u_out[b] += weight[k] * u[a];
        }
        for &k in &program.longer {
            distribute(program.taps(k), u, weight[k], u_out);
        }
        for term in &program.shaped {
            term.gradient(u, y, t, |place, slope| {
                if let Place::Input { shift, .. } = place {
                    u_out[shift] += weight[term.k] * slope;
                }
            });
        }
        if ring > 0 {
            recursive_terms(program, theta, run, y, s, start, t, &s_now, &weight, u_out, &mut later);
        }
    }
}

/// Weights of earlier samples, by sample modulo the ring length.
struct Later {
    ring: usize,
    p: usize,
    y: Vec<f64>,
    s: Vec<f64>,
}

impl Later {
    /// Removes what has gathered for sample t.
    fn take(&mut self, t: usize, s_now: &mut [f64]) -> f64 {
        if self.ring == 0 {
            s_now.fill(0.0);
            return 0.0;
        }
        let place = t % self.ring;
        if !self.s.is_empty() {
            let row = &mut self.s[place * self.p..(place + 1) * self.p];
            s_now.copy_from_slice(row);
            row.fill(0.0);
        }
        std::mem::take(&mut self.y[place])
    }
}

fn recursive_terms(
    program: &Program,
    theta: &[f64],
    run: &Run,
    y: &[f64],
    s: &[f64],
    start: usize,
    t: usize,
    s_now: &[f64],
    weight: &[f64],
    u_out: &mut [f64],
    later: &mut Later,
) {
    let p = weight.len();
    let (mut a, mut a_bar) = ([0.0; MAX_OUTPUT_LAGS], [0.0; MAX_OUTPUT_LAGS]);
    let lags = &program.output_lags;
    let (a, a_bar) = (&mut a[..lags.len()], &mut a_bar[..lags.len()]);
    if !s_now.is_empty() {
        program.output_gradient(theta, run.u, y, t, a);
        for (slot, &lag) in lags.iter().enumerate().filter(|(_, lag)| t >= start + **lag) {
            a_bar[slot] = dot(s_now, &s[(t - lag) * p..(t - lag + 1) * p]);
            let place = (t - lag) % later.ring;
            for (x, v) in later.s[place * p..(place + 1) * p].iter_mut().zip(s_now) {
                *x += a[slot] * v;
            }
        }
    }
    let u = program.input_window(run.u, t);
    for term in &program.linear {
        // O = y(t-lag), dO = 1, no second derivative.
        let k = term.k;
        distribute(program.taps(k), u, weight[k] * y[t - term.lag] + theta[k] * a_bar[term.slot], u_out);
        if t >= start + term.lag {
            later.y[(t - term.lag) % later.ring] += program.input_product(k, u) * weight[k];
        }
    }
    for &k in &program.general {
        let factors = program.outputs(k);
        let mut input_weight = weight[k] * program.output_product(k, y, t);
        for (j, f) in factors.iter().enumerate() {
            input_weight += theta[k] * a_bar[f.slot] * first_derivative(factors, j, y, t);
        }
        distribute(program.taps(k), u, input_weight, u_out);
        let inputs = program.input_product(k, u);
        for (i, f) in factors.iter().enumerate().filter(|(_, f)| t >= start + f.lag) {
            let mut g = weight[k] * first_derivative(factors, i, y, t);
            for (j, other) in factors.iter().enumerate() {
                g += theta[k] * a_bar[other.slot] * second_derivative(factors, i, j, y, t);
            }
            later.y[(t - f.lag) % later.ring] += inputs * g;
        }
    }
    // Here the reads are weighted one by one: r(t-i) += w_k dphi/dr_i + theta_k sum_j abar_j d2phi/dr_i dy(t-j).
    for term in &program.shaped_recursive {
        let k = term.k;
        let mut give = |place: Place, g: f64| match place {
            Place::Input { shift, .. } => u_out[shift] += g,
            Place::Output { lag, .. } if t >= start + lag => later.y[(t - lag) % later.ring] += g,
            Place::Output { .. } => {}
        };
        term.gradient(u, y, t, |place, slope| give(place, weight[k] * slope));
        term.hessian(u, y, t, |place, other, second| {
            if let Place::Output { slot, .. } = other {
                give(place, theta[k] * a_bar[slot] * second);
            }
        });
    }
}

/// Dot product with four independent sums: one chain of additions would wait for each of them.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let (ca, cb) = (a.chunks_exact(4), b.chunks_exact(4));
    let tail: f64 = ca.remainder().iter().zip(cb.remainder()).map(|(x, y)| x * y).sum();
    let sum = ca.zip(cb).fold([0.0; 4], |s, (x, y)| std::array::from_fn(|k| s[k] + x[k] * y[k]));
    (sum[0] + sum[2]) + (sum[1] + sum[3]) + tail
}

/// Adds the gradient of `weight * product of taps` to the inputs.
fn distribute(taps: &[Tap], u: &[f64], weight: f64, u_out: &mut [f64]) {
    match taps {
        [] => {}
        [a] => u_out[a.shift] += weight,
        [a, b] => {
            u_out[a.shift] += weight * u[b.shift];
            u_out[b.shift] += weight * u[a.shift];
        }
        _ => {
            for (i, a) in taps.iter().enumerate() {
                let others = taps.iter().enumerate().filter(|(j, _)| *j != i);
                u_out[a.shift] += others.fold(weight, |x, (_, b)| x * u[b.shift]);
            }
        }
    }
}
