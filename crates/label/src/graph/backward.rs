//! Derivatives backward in time: one pass for all cells.

use super::forward::{Run, left, slopes};
use super::{Graph, Op, Record};

/// Adds `g` to what stands at the place (i, s) between samples.
fn spread(bar: &mut [f64], (i, s): (usize, f64), g: f64) {
    if i + 1 < bar.len() {
        bar[i] += (1.0 - s) * g;
        bar[i + 1] += s * g;
    } else {
        bar[i] += g;
    }
}

/// Slope of `x` over `axis` at a place.
fn slope(x: &[f64], axis: &[f64], (i, s): (usize, f64)) -> f64 {
    let inside = i + 1 < x.len() && axis[i + 1] > axis[i] && (i > 0 || s > 0.0);
    if inside { (x[i + 1] - x[i]) / (axis[i + 1] - axis[i]) } else { 0.0 }
}

impl Graph {
    /// `J'u`: the gradient of `sum_t u_t y_t` with respect to all cells.
    pub fn gradient(&self, theta: &[f64], record: &Record, u: &[f64]) -> Vec<f64> {
        let (run, first) = (self.run(theta, record), self.first());
        if self.model().is_some() {
            return self.gradient_by_cells(theta, record, u, &run);
        }
        let (n, m) = (record.time_s.len(), self.nodes.len());
        let mut bar: Vec<Vec<f64>> = vec![vec![0.0; n]; m];
        bar[m - 1].copy_from_slice(u);
        let mut out = vec![0.0; theta.len()];
        for k in (0..m).rev() {
            self.hand_back(k, theta, &first, record, &run, &mut bar, &mut out);
        }
        out
    }

    /// The same where a model, which has no way back, is a node: forward, one cell after the other.
    fn gradient_by_cells(&self, theta: &[f64], record: &Record, u: &[f64], run: &Run) -> Vec<f64> {
        let mut unit = vec![0.0; theta.len()];
        let mut one = |c: usize| {
            unit[c] = 1.0;
            let d = self.tangents(theta, record, &unit, run).pop().unwrap_or_default();
            unit[c] = 0.0;
            d.iter().zip(u).map(|(d, u)| d * u).sum()
        };
        (0..theta.len()).map(&mut one).collect()
    }

    /// What reaches node `k` goes on to the nodes that enter it, and to cells. Nodes use earlier ones only, so that it is complete.
    pub(super) fn hand_back(
        &self,
        k: usize,
        theta: &[f64],
        first: &[usize],
        record: &Record,
        run: &Run,
        bar: &mut [Vec<f64>],
        out: &mut [f64],
    ) {
        let (before, own) = bar.split_at_mut(k);
        let own = &mut own[0];
        // What a film hands back through its state.
        let mut state = 0.0;
        for t in (0..record.time_s.len()).rev() {
            let g = own[t];
            let x = |i: &usize| run.values[*i][t];
            let dt = if t == 0 { 0.0 } else { record.time_s[t] - record.time_s[t - 1] };
            match &self.nodes[k].op {
                Op::Channel(_) | Op::Constant(_) | Op::Hysteresis(..) | Op::Model(..) => {}
                Op::Add(i) => i.iter().for_each(|i| before[*i][t] += g),
                Op::Multiply(i) => {
                    for a in 0..i.len() {
                        let rest: f64 = (0..i.len()).filter(|b| *b != a).map(|b| x(&i[b])).product();
                        before[i[a]][t] += g * rest;
                    }
                }
                Op::Subtract(a, b) => {
                    before[*a][t] += g;
                    before[*b][t] -= g;
                }
                Op::Divide(a, b) => {
                    before[*a][t] += g / x(b);
                    before[*b][t] -= g * x(a) / (x(b) * x(b));
                }
                Op::Min(a, b) => before[if x(a) <= x(b) { *a } else { *b }][t] += g,
                Op::Max(a, b) => before[if x(a) >= x(b) { *a } else { *b }][t] += g,
                Op::Label(l, at) => {
                    let label = &self.labels[*l];
                    let place: Vec<f64> = at.iter().map(x).collect();
                    let (cells, weights, count) = label.weights(&place);
                    (0..count)
                        .filter(|c| weights[*c] != 0.0)
                        .for_each(|c| out[first[*l] + cells[c]] += g * weights[c]);
                    let slopes = slopes(label, &theta[first[*l]..first[*l] + label.len()], &place);
                    at.iter().zip(slopes).for_each(|(i, s)| before[*i][t] += g * s);
                }
                Op::Inverse(l, a) => {
                    let label = &self.labels[*l];
                    let slope = label.inverse(&theta[first[*l]..first[*l] + label.len()], x(a)).1;
                    if let Some((_, cells, by, count)) = self.read_cells(k, t, theta, first, run) {
                        (0..count).for_each(|c| out[first[*l] + cells[c]] += g * by[c]);
                    }
                    before[*a][t] += g * slope;
                }
                Op::Delay(a, d) => {
                    let at = run.places[k][t];
                    spread(&mut before[*a], at, g);
                    if x(d) > 0.0 {
                        before[*d][t] -= g * slope(&run.values[*a], record.time_s, at);
                    }
                }
                Op::DelayFlow(a, _, volume) => {
                    let at = run.places[k][t];
                    spread(&mut before[*a], at, g);
                    if x(volume) > 0.0 {
                        before[*volume][t] -= g * slope(&run.values[*a], &run.flown[k], at);
                    }
                }
                Op::Lag(a, tau) if t > 0 => {
                    let (share, by_tau) = left(dt, x(tau));
                    before[*a][t - 1] += g * (1.0 - share);
                    before[*tau][t] += g * by_tau * (run.values[k][t - 1] - run.values[*a][t - 1]);
                    own[t - 1] += g * share;
                }
                Op::Lag(a, _) => before[*a][t] += g,
                Op::Integrator(a, lo, hi, _) => {
                    let y = run.values[k][t];
                    if t > 0 && y > *lo && y < *hi {
                        before[*a][t - 1] += g * dt;
                        own[t - 1] += g;
                    }
                }
                Op::Film(f, share, tau) => {
                    let (fuel, s, tau_s, m) = (x(f), x(share), x(tau), run.film[k][t]);
                    before[*share][t] -= g * fuel;
                    before[*f][t] += g * (1.0 - s);
                    before[*tau][t] -= g * m / (tau_s * tau_s);
                    state += g / tau_s;
                    if t == 0 {
                        before[*share][t] += state * fuel * tau_s;
                        before[*f][t] += state * s * tau_s;
                        before[*tau][t] += state * s * fuel;
                        continue;
                    }
                    let (f0, s0, m0) = (run.values[*f][t - 1], run.values[*share][t - 1], run.film[k][t - 1]);
                    let (a, by_tau) = left(dt, tau_s);
                    before[*share][t - 1] += state * f0 * tau_s * (1.0 - a);
                    before[*f][t - 1] += state * s0 * tau_s * (1.0 - a);
                    before[*tau][t] += state * (m0 * by_tau + s0 * f0 * (1.0 - a - tau_s * by_tau));
                    state *= a;
                }
                Op::Switch(c, a, b) => before[if x(c) > 0.0 { *a } else { *b }][t] += g,
            }
        }
    }
}
