//! First and second derivatives of a prediction with respect to lagged inputs and past outputs together.
//!
//! ```text
//! term k = theta_k I_k O_k,   I_k a product of lagged inputs (taps), O_k = prod_f y(t-l_f)^(q_f)
//! d2/du dy_f = theta_k dI_k/du dO_k/dy_f,   d2/dy_f dy_g = theta_k I_k d2O_k/dy_f dy_g
//! ```

use super::program::{OutputFactor, Program, power};
use super::shaped::Place;
use crate::model::Run;

/// Fills gradient and Hessian over the window (w) and the past outputs (l); gives the prediction.
pub(super) fn derivatives(
    program: &Program,
    theta: &[f64],
    run: &Run,
    t: usize,
    grad: &mut [f64],
    hess: &mut [f64],
) -> f64 {
    let (w, n) = (program.window.len(), grad.len());
    grad.fill(0.0);
    hess.fill(0.0);
    let u = program.input_window(run.u, t);
    let mut value = 0.0;
    for &k in program.exogenous.iter().chain(&program.recursive) {
        let (taps, outputs) = (program.taps(k), program.outputs(k));
        let (input, output) = (program.input_product(k, u), program.output_product(k, run.y, t));
        let of_taps = |a: usize, b: usize| {
            let kept = taps.iter().enumerate().filter(|(i, _)| *i != a && *i != b);
            kept.fold(theta[k], |x, (_, tap)| x * u[tap.shift])
        };
        value += theta[k] * input * output;
        for (a, tap) in taps.iter().enumerate() {
            let slope = of_taps(a, a);
            grad[tap.window] += slope * output;
            for (b, other) in taps.iter().enumerate().filter(|(b, _)| *b != a) {
                hess[tap.window * n + other.window] += of_taps(a, b) * output;
            }
            for f in 0..outputs.len() {
                let cross = slope * output_slope(outputs, run.y, t, f);
                let at = w + outputs[f].lag - 1;
                hess[tap.window * n + at] += cross;
                hess[at * n + tap.window] += cross;
            }
        }
        for f in 0..outputs.len() {
            let at = w + outputs[f].lag - 1;
            grad[at] += theta[k] * input * output_slope(outputs, run.y, t, f);
            for g in 0..outputs.len() {
                let second = output_second(outputs, run.y, t, f, g);
                hess[at * n + w + outputs[g].lag - 1] += theta[k] * input * second;
            }
        }
    }
    for term in program.shaped.iter().chain(&program.shaped_recursive) {
        let at = |place| match place {
            Place::Input { window, .. } => window,
            Place::Output { lag, .. } => w + lag - 1,
        };
        value += theta[term.k] * term.value(u, run.y, t);
        term.gradient(u, run.y, t, |place, slope| grad[at(place)] += theta[term.k] * slope);
        term.hessian(u, run.y, t, |a, b, second| hess[at(a) * n + at(b)] += theta[term.k] * second);
    }
    value
}

/// Product of the factors that are neither `f` nor `g`.
fn except(outputs: &[OutputFactor], y: &[f64], t: usize, f: usize, g: usize) -> f64 {
    let kept = outputs.iter().enumerate().filter(|(i, _)| *i != f && *i != g);
    kept.fold(1.0, |x, (_, o)| x * power(y[t - o.lag], o.power))
}

/// Derivative of factor `f` alone.
fn own_slope(o: &OutputFactor, y: &[f64], t: usize) -> f64 {
    f64::from(o.power) * power(y[t - o.lag], o.power - 1)
}

fn output_slope(outputs: &[OutputFactor], y: &[f64], t: usize, f: usize) -> f64 {
    except(outputs, y, t, f, f) * own_slope(&outputs[f], y, t)
}

fn output_second(outputs: &[OutputFactor], y: &[f64], t: usize, f: usize, g: usize) -> f64 {
    let rest = except(outputs, y, t, f, g);
    let o = &outputs[f];
    match (f == g, o.power) {
        (false, _) => rest * own_slope(o, y, t) * own_slope(&outputs[g], y, t),
        (true, 0 | 1) => 0.0,
        (true, q) => rest * f64::from(q) * f64::from(q - 1) * power(y[t - o.lag], q - 2),
    }
}
