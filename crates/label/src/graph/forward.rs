//! Values and derivatives forward in time.

use rayon::prelude::*;

use super::{Graph, Op, Record, place};
use crate::rows::Rows;

/// Samples that one processor takes at a time.
const PIECE: usize = 8192;

/// What a run leaves: all that the way back needs.
pub(crate) struct Run {
    /// Values of all nodes, node by node, `n` each.
    pub(crate) values: Vec<Vec<f64>>,
    /// State of each film before each sample; the place that each delay read; empty elsewhere.
    pub(super) film: Vec<Vec<f64>>,
    pub(super) places: Vec<Vec<(usize, f64)>>,
    /// Running integral of each flow.
    pub(super) flown: Vec<Vec<f64>>,
}

/// Share of a state that is left after `dt` with the time constant `tau`, and its derivative with respect to tau.
pub(super) fn left(dt: f64, tau: f64) -> (f64, f64) {
    if !(tau > 0.0) {
        return (0.0, 0.0);
    }
    let a = (-dt / tau).exp();
    (a, a * dt / (tau * tau))
}

impl Graph {
    /// Output of the last node at each sample of `record`, with the cells `theta`.
    pub fn values(&self, theta: &[f64], record: &Record) -> Vec<f64> {
        let mut run = self.run(theta, record);
        run.values.pop().unwrap_or_default()
    }

    /// Outputs of all nodes at each sample of `record`, in their order.
    pub fn all_values(&self, theta: &[f64], record: &Record) -> Vec<Vec<f64>> {
        self.run(theta, record).values
    }

    /// All nodes.
    pub(crate) fn run(&self, theta: &[f64], record: &Record) -> Run {
        self.run_some(theta, record, &vec![true; self.nodes.len()], &|_| None)
    }

    /// The nodes of `need`; others have no values. `sum` has what those inputs of a sum give that have none.
    pub(crate) fn run_some(
        &self,
        theta: &[f64],
        record: &Record,
        need: &[bool],
        sum: &dyn Fn(usize) -> Option<Vec<f64>>,
    ) -> Run {
        let (n, first) = (record.time_s.len(), self.first());
        let m = self.nodes.len();
        let mut run = Run {
            values: Vec::new(),
            film: vec![Vec::new(); m],
            places: vec![Vec::new(); m],
            flown: vec![Vec::new(); m],
        };
        for (k, node) in self.nodes.iter().enumerate() {
            let y = match &node.op {
                _ if !need[k] => Vec::new(),
                Op::Model(model, at) => {
                    let inputs: Vec<&[f64]> = at.iter().map(|i| run.values[*i].as_slice()).collect();
                    model.answer(record.time_s, &inputs)
                }
                Op::Channel(c) => record.channels[*c].to_vec(),
                Op::Add(terms) => match sum(k) {
                    Some(mut y) => {
                        terms
                            .iter()
                            .for_each(|i| y.iter_mut().zip(&run.values[*i]).for_each(|(y, x)| *y += x));
                        y
                    }
                    None => self.instants(k, n, theta, &first, record, &run.values),
                },
                op if op.remembers() => self.remembers(k, record, &mut run),
                _ => self.instants(k, n, theta, &first, record, &run.values),
            };
            run.values.push(y);
        }
        run
    }

    /// A node that knows the samples before.
    fn remembers(&self, k: usize, record: &Record, run: &mut Run) -> Vec<f64> {
        let n = record.time_s.len();
        match &self.nodes[k].op {
            Op::DelayFlow(_, flow, _) => run.flown[k] = integral(record.time_s, &run.values[*flow]),
            Op::Film(..) => run.film[k] = vec![0.0; n],
            _ => {}
        }
        if matches!(self.nodes[k].op, Op::Delay(..) | Op::DelayFlow(..)) {
            run.places[k] = vec![(0, 0.0); n];
        }
        let mut y = vec![0.0; n];
        for t in 0..n {
            y[t] = self.remembered(k, t, record, run, &y);
        }
        y
    }

    /// A node that knows only its sample, at all samples.
    fn instants(
        &self,
        k: usize,
        n: usize,
        theta: &[f64],
        first: &[usize],
        record: &Record,
        values: &[Vec<f64>],
    ) -> Vec<f64> {
        let mut y = vec![0.0; n];
        y.par_chunks_mut(PIECE).enumerate().for_each(|(piece, y)| {
            for (i, y) in y.iter_mut().enumerate() {
                *y = self.instant(k, piece * PIECE + i, theta, first, record, values);
            }
        });
        y
    }

    /// A node that knows only its sample.
    fn instant(
        &self,
        k: usize,
        t: usize,
        theta: &[f64],
        first: &[usize],
        record: &Record,
        values: &[Vec<f64>],
    ) -> f64 {
        let v = |i: &usize| values[*i][t];
        match &self.nodes[k].op {
            Op::Channel(c) => record.channels[*c][t],
            Op::Constant(c) => *c,
            Op::Add(i) => i.iter().map(v).sum(),
            Op::Multiply(i) => i.iter().map(v).product(),
            Op::Subtract(a, b) => v(a) - v(b),
            Op::Divide(a, b) => v(a) / v(b),
            Op::Min(a, b) => v(a).min(v(b)),
            Op::Max(a, b) => v(a).max(v(b)),
            Op::Label(l, at) => {
                let label = &self.labels[*l];
                label.value(&theta[first[*l]..first[*l] + label.len()], &spot(at, v))
            }
            Op::Inverse(l, x) => {
                let label = &self.labels[*l];
                label.inverse(&theta[first[*l]..first[*l] + label.len()], v(x)).0
            }
            Op::Switch(c, a, b) => v(if v(c) > 0.0 { a } else { b }),
            Op::Delay(..)
            | Op::DelayFlow(..)
            | Op::Lag(..)
            | Op::Integrator(..)
            | Op::Hysteresis(..)
            | Op::Film(..)
            | Op::Model(..) => f64::NAN,
        }
    }

    /// A node that knows the samples before, of which `y` are its own values.
    fn remembered(&self, k: usize, t: usize, record: &Record, run: &mut Run, y: &[f64]) -> f64 {
        let v = |i: &usize| run.values[*i][t];
        let dt = if t == 0 { 0.0 } else { record.time_s[t] - record.time_s[t - 1] };
        match &self.nodes[k].op {
            Op::Delay(x, d) => {
                let at = place(record.time_s, record.time_s[t] - v(d).max(0.0), t);
                let out = on_the_way(&run.values[*x], at);
                run.places[k][t] = at;
                out
            }
            Op::DelayFlow(x, _, volume) => {
                let flown = &run.flown[k];
                let at = place(flown, flown[t] - v(volume).max(0.0), t);
                let out = on_the_way(&run.values[*x], at);
                run.places[k][t] = at;
                out
            }
            // The input of the last sample acts until this one.
            Op::Lag(x, tau) if t > 0 => {
                let a = left(dt, v(tau)).0;
                a * y[t - 1] + (1.0 - a) * run.values[*x][t - 1]
            }
            Op::Lag(x, _) => v(x),
            Op::Integrator(x, lo, hi, start) => {
                let sum = if t == 0 { *start } else { y[t - 1] + dt * run.values[*x][t - 1] };
                sum.max(*lo).min(*hi)
            }
            Op::Hysteresis(x, low, high) => {
                let before = if t == 0 { 0.0 } else { y[t - 1] };
                if v(x) > *high {
                    1.0
                } else if v(x) < *low {
                    0.0
                } else {
                    before
                }
            }
            Op::Film(f, share, tau) => {
                let (fuel, s, tau_s) = (v(f), v(share), v(tau));
                let m = if t == 0 {
                    s * fuel * tau_s
                } else {
                    let (f0, s0, a) = (run.values[*f][t - 1], run.values[*share][t - 1], left(dt, tau_s).0);
                    run.film[k][t - 1] * a + s0 * f0 * tau_s * (1.0 - a)
                };
                run.film[k][t] = m;
                (1.0 - s) * fuel + m / tau_s
            }
            _ => f64::NAN,
        }
    }

    /// Output and its derivative in the direction `v` of the cells: `y, J v`.
    pub fn forward(&self, theta: &[f64], record: &Record, v: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let run = self.run(theta, record);
        let d = self.tangents(theta, record, v, &run);
        (
            run.values.into_iter().next_back().unwrap_or_default(),
            d.into_iter().next_back().unwrap_or_default(),
        )
    }

    /// Derivatives of all nodes in the direction `v` of the cells.
    pub(crate) fn tangents(&self, theta: &[f64], record: &Record, v: &[f64], run: &Run) -> Vec<Vec<f64>> {
        let first = self.first();
        let n = record.time_s.len();
        let mut d: Vec<Vec<f64>> = Vec::new();
        let mut reached: Vec<bool> = Vec::new();
        for k in 0..self.nodes.len() {
            let mut dy = vec![0.0; n];
            // A direction in one label leaves all nodes alone that do not come from it.
            let op = &self.nodes[k].op;
            let own = match op {
                Op::Label(l, _) | Op::Inverse(l, _) => {
                    v[first[*l]..first[*l] + self.labels[*l].len()].iter().any(|v| *v != 0.0)
                }
                _ => false,
            };
            reached.push(own || op.inputs().iter().any(|i| reached[*i]));
            if !reached[k] {
                d.push(dy);
                continue;
            }
            if let Op::Model(model, at) = op {
                let x: Vec<&[f64]> = at.iter().map(|i| run.values[*i].as_slice()).collect();
                let dx: Vec<&[f64]> = at.iter().map(|i| d[*i].as_slice()).collect();
                let dy = model.tangent(record.time_s, &x, &dx);
                d.push(dy);
                continue;
            }
            // State of a film has a derivative of its own.
            let mut dm = 0.0;
            for t in 0..n {
                dy[t] = self.tangent(k, t, v, theta, &first, record, run, &d, &dy, &mut dm);
            }
            d.push(dy);
        }
        d
    }

    /// Whether node `output` has no memory of labels: a sample of it depends on what labels give at the same sample.
    pub(crate) fn forgets(&self, output: usize) -> bool {
        let mut on_the_way = vec![false; output + 1];
        on_the_way[output] = true;
        for k in (0..=output).rev().filter(|k| self.depends(*k)) {
            if on_the_way[k] {
                if self.nodes[k].op.remembers() {
                    return false;
                }
                self.nodes[k].op.inputs().into_iter().for_each(|i| on_the_way[i] = true);
            }
        }
        true
    }

    /// Rows of the derivative of node `output` with respect to the cells at the samples `used`; only where it [`Graph::forgets`].
    pub(crate) fn reads(
        &self,
        theta: &[f64],
        record: &Record,
        run: &Run,
        output: usize,
        used: &[usize],
        rows: &mut Rows,
    ) {
        let first = self.first();
        let read: Vec<(usize, Vec<f64>)> = (0..=output)
            .filter(|k| matches!(self.nodes[*k].op, Op::Label(..) | Op::Inverse(..)))
            .map(|k| (k, self.slope_of(theta, record, run, output, k)))
            .collect();
        let mut row: Vec<(usize, f64)> = Vec::new();
        for &t in used {
            row.clear();
            for (k, slope) in read.iter().filter(|(_, s)| s[t] != 0.0) {
                let Some((l, cells, weights, n)) = self.read_cells(*k, t, theta, &first, run) else {
                    continue;
                };
                for c in 0..n {
                    let (cell, v) = (first[l] + cells[c], slope[t] * weights[c]);
                    match row.iter_mut().find(|r| r.0 == cell) {
                        Some(r) => r.1 += v,
                        None => row.push((cell, v)),
                    }
                }
            }
            rows.start();
            row.iter().for_each(|(c, v)| rows.push(*c, *v));
        }
    }

    /// The label of node `k`, its cells that count at sample `t`, and the derivatives of the node with respect to them; none for others.
    pub(super) fn read_cells(
        &self,
        k: usize,
        t: usize,
        theta: &[f64],
        first: &[usize],
        run: &Run,
    ) -> Option<(usize, [usize; 4], [f64; 4], usize)> {
        match &self.nodes[k].op {
            Op::Label(l, at) => {
                let (cells, weights, n) = self.labels[*l].weights(&spot(at, |i| run.values[*i][t]));
                Some((*l, cells, weights, n))
            }
            Op::Inverse(l, x) => {
                let label = &self.labels[*l];
                let (at, slope) =
                    label.inverse(&theta[first[*l]..first[*l] + label.len()], run.values[*x][t]);
                let (cells, weights, n) = label.weights(&[at]);
                Some((*l, cells, weights.map(|w| -slope * w), n))
            }
            _ => None,
        }
    }

    /// Derivative of node `output` with respect to what node `from` gives at the same sample.
    fn slope_of(&self, theta: &[f64], record: &Record, run: &Run, output: usize, from: usize) -> Vec<f64> {
        let (first, n) = (self.first(), record.time_s.len());
        let still = vec![0.0; theta.len()];
        let mut d: Vec<Vec<f64>> = vec![Vec::new(); from];
        let mut reached = vec![false; from];
        d.push(vec![1.0; n]);
        reached.push(true);
        let zeros = vec![0.0; n];
        for k in from + 1..=output {
            let inputs = self.nodes[k].op.inputs();
            reached.push(inputs.iter().any(|i| reached[*i]));
            if !reached[k] {
                d.push(Vec::new());
                continue;
            }
            // Nodes beside the way do not change.
            inputs.iter().filter(|i| !reached[**i]).for_each(|i| d[*i].clone_from(&zeros));
            let mut dm = 0.0;
            let dy = (0..n).map(|t| self.tangent(k, t, &still, theta, &first, record, run, &d, &[], &mut dm));
            let dy = dy.collect();
            d.push(dy);
        }
        if reached[output] { std::mem::take(&mut d[output]) } else { zeros }
    }

    pub(super) fn tangent(
        &self,
        k: usize,
        t: usize,
        v: &[f64],
        theta: &[f64],
        first: &[usize],
        record: &Record,
        run: &Run,
        d: &[Vec<f64>],
        dy: &[f64],
        dm: &mut f64,
    ) -> f64 {
        let x = |i: &usize| run.values[*i][t];
        let dx = |i: &usize| d[*i][t];
        let dt = if t == 0 { 0.0 } else { record.time_s[t] - record.time_s[t - 1] };
        match &self.nodes[k].op {
            Op::Channel(_) | Op::Constant(_) | Op::Hysteresis(..) => 0.0,
            // Taken over the whole record by the caller.
            Op::Model(..) => f64::NAN,
            Op::Add(i) => i.iter().map(dx).sum(),
            Op::Multiply(i) => (0..i.len())
                .map(|a| dx(&i[a]) * (0..i.len()).filter(|b| *b != a).map(|b| x(&i[b])).product::<f64>())
                .sum(),
            Op::Subtract(a, b) => dx(a) - dx(b),
            Op::Divide(a, b) => (dx(a) - x(a) / x(b) * dx(b)) / x(b),
            Op::Min(a, b) => {
                if x(a) <= x(b) {
                    dx(a)
                } else {
                    dx(b)
                }
            }
            Op::Max(a, b) => {
                if x(a) >= x(b) {
                    dx(a)
                } else {
                    dx(b)
                }
            }
            Op::Label(l, at) => {
                let label = &self.labels[*l];
                let cells = first[*l]..first[*l] + label.len();
                let place = spot(at, x);
                let slopes = slopes(label, &theta[cells.clone()], &place);
                let own = label.value(&v[cells], &place);
                own + at.iter().zip(slopes).map(|(i, s)| s * dx(i)).sum::<f64>()
            }
            // curve(y) = x: what the curve gains at y is taken from x.
            Op::Inverse(l, a) => {
                let label = &self.labels[*l];
                let cells = first[*l]..first[*l] + label.len();
                let (at, slope) = label.inverse(&theta[cells.clone()], x(a));
                slope * (dx(a) - label.value(&v[cells], &[at]))
            }
            Op::Delay(a, delay) => {
                let (i, s) = run.places[k][t];
                let (value, slope) = between(&run.values[*a], &d[*a], i, s, record.time_s);
                value - if x(delay) > 0.0 { slope * dx(delay) } else { 0.0 }
            }
            Op::DelayFlow(a, _, volume) => {
                let (i, s) = run.places[k][t];
                let (value, slope) = between(&run.values[*a], &d[*a], i, s, &run.flown[k]);
                value - if x(volume) > 0.0 { slope * dx(volume) } else { 0.0 }
            }
            Op::Lag(a, tau) if t > 0 => {
                let (share, by_tau) = left(dt, x(tau));
                let (y0, x0) = (run.values[k][t - 1], run.values[*a][t - 1]);
                share * dy[t - 1] + (1.0 - share) * d[*a][t - 1] + by_tau * (y0 - x0) * dx(tau)
            }
            Op::Lag(a, _) => dx(a),
            Op::Integrator(a, lo, hi, _) => {
                let y = run.values[k][t];
                if t == 0 || y <= *lo || y >= *hi { 0.0 } else { dy[t - 1] + dt * d[*a][t - 1] }
            }
            Op::Film(f, share, tau) => {
                let (fuel, s, tau_s) = (x(f), x(share), x(tau));
                *dm = if t == 0 {
                    dx(share) * fuel * tau_s + s * dx(f) * tau_s + s * fuel * dx(tau)
                } else {
                    let (f0, s0) = (run.values[*f][t - 1], run.values[*share][t - 1]);
                    let (a, by_tau) = left(dt, tau_s);
                    let moved = d[*share][t - 1] * f0 + s0 * d[*f][t - 1];
                    let m0 = run.film[k][t - 1];
                    *dm * a
                        + moved * tau_s * (1.0 - a)
                        + (m0 * by_tau + s0 * f0 * (1.0 - a - tau_s * by_tau)) * dx(tau)
                };
                let m = run.film[k][t];
                -dx(share) * fuel + (1.0 - s) * dx(f) + *dm / tau_s - m / (tau_s * tau_s) * dx(tau)
            }
            Op::Switch(c, a, b) => {
                if x(c) > 0.0 {
                    dx(a)
                } else {
                    dx(b)
                }
            }
        }
    }
}

/// Where a label is read; it has two axes at most.
fn spot(at: &[usize], value: impl Fn(&usize) -> f64) -> [f64; 2] {
    let of = |k: usize| at.get(k).map_or(0.0, &value);
    [of(0), of(1)]
}

/// Value at a place between samples.
fn on_the_way(x: &[f64], (i, s): (usize, f64)) -> f64 {
    x[i] + s * (x.get(i + 1).unwrap_or(&x[i]) - x[i])
}

/// Derivative of what stands between samples `i` and `i + 1`, and the slope there over `axis`.
fn between(x: &[f64], dx: &[f64], i: usize, s: f64, axis: &[f64]) -> (f64, f64) {
    let Some((next, dnext)) = x.get(i + 1).zip(dx.get(i + 1)) else { return (dx[i], 0.0) };
    let h = axis[i + 1] - axis[i];
    // Before the record nothing moves.
    let slope = if h > 0.0 && (i > 0 || s > 0.0) { (next - x[i]) / h } else { 0.0 };
    (dx[i] + s * (dnext - dx[i]), slope)
}

/// Derivatives of a label with respect to where it is read.
pub(super) fn slopes(label: &crate::label::Label, values: &[f64], at: &[f64]) -> [f64; 2] {
    let mut out = [0.0; 2];
    for (k, axis) in label.axes.iter().enumerate() {
        let p = &axis.points;
        // At the edges the label is flat.
        if !(at[k] >= p[0] && at[k] < p[p.len() - 1]) {
            continue;
        }
        let (i, _) = crate::rows::between(p, at[k]);
        let mut place = [at.first().copied().unwrap_or(0.0), at.get(1).copied().unwrap_or(0.0)];
        place[k] = p[i];
        let low = label.value(values, &place);
        place[k] = p[i + 1];
        out[k] = (label.value(values, &place) - low) / (p[i + 1] - p[i]);
    }
    out
}

/// Running integral by trapezoids; it never falls.
fn integral(time_s: &[f64], flow: &[f64]) -> Vec<f64> {
    let mut sum = 0.0;
    (0..time_s.len())
        .map(|t| {
            if t > 0 {
                sum += (0.5 * (flow[t] + flow[t - 1]) * (time_s[t] - time_s[t - 1])).max(0.0);
            }
            sum
        })
        .collect()
}
