//! Closed loops in time: the referee of every margin, independent of frequencies.
//!
//! Sampled loops are difference equations, exact; their delays are whole samples. Continuous loops are integrated by the
//! classical Runge-Kutta method. Of each past step the inputs at its start, middle and end are kept, so that a delay of whole steps reads
//! them as they were, on the right side of what jumps between steps (a derivative kicks), and any other a parabola within one step.

use crate::closed::Closed;
use crate::error::ControlError;
use crate::poly::degree;
use crate::system::{System, Time, Transfer};

/// A run of a closed loop, rows are samples.
#[derive(Clone, Debug, PartialEq)]
pub struct LoopRun {
    /// Time between rows in s.
    pub step_s: f64,
    /// Outputs of the plant, rows x outputs.
    pub y: Vec<f64>,
    /// Inputs of the plant, rows x inputs.
    pub u: Vec<f64>,
}

/// Runs `u = C (r - y)`, `y = G (u + d)` from rest over `rows` rows; `demand(row)` and `load(row)` fill r and d. For a continuous loop
/// `step_s` is the step of the integration; a sampled one has its own.
///
/// # Errors
/// [`ControlError`]: a plant that answers within its sample or without delay at infinite frequency under a controller that does
/// too, delays that are no whole samples or below two steps, delay within the controller.
pub fn run(
    closed: &Closed,
    step_s: f64,
    rows: usize,
    demand: &dyn Fn(usize, &mut [f64]),
    load: &dyn Fn(usize, &mut [f64]),
) -> Result<LoopRun, ControlError> {
    match closed.plant.time {
        Time::Sampled { sample_time_s } => sampled(closed, sample_time_s, rows, demand, load),
        Time::Continuous => continuous(closed, step_s, rows, demand, load),
    }
}

/// `y(t) = (sum b_k x(t-k-d) - sum a_k y(t-k)) / a_0`
struct Difference {
    b: Vec<f64>,
    a: Vec<f64>,
    /// Samples d before the first coefficient that is not zero.
    late: usize,
    /// The last inputs as a ring, and the place of the next one.
    x: Vec<f64>,
    next: usize,
    /// The last outputs, latest first.
    y: Vec<f64>,
}

impl Difference {
    fn new(g: &Transfer, sample_time_s: f64, what: &str) -> Result<Self, ControlError> {
        let samples = g.delay_s / sample_time_s;
        if (samples - samples.round()).abs() > 1e-6 {
            return Err(ControlError::number(
                format!("the delay of {what} in samples"),
                samples,
                "a whole number (a run has no others)",
            ));
        }
        let zeros = g.num.iter().take_while(|v| **v == 0.0).count();
        let b: Vec<f64> = g.num[zeros..].iter().map(|v| v / g.den[0]).collect();
        let a: Vec<f64> = g.den[1..].iter().map(|v| v / g.den[0]).collect();
        let late = samples.round() as usize + zeros;
        Ok(Self { x: vec![0.0; late + b.len()], y: vec![0.0; a.len()], next: 0, late, a, b })
    }

    /// What it answers within a sample.
    fn at_once(&self) -> f64 {
        if self.late == 0 { self.b.first().copied().unwrap_or(0.0) } else { 0.0 }
    }

    /// What past inputs give.
    fn ahead(&self) -> f64 {
        let n = self.x.len();
        let past = |age: usize| self.x[(self.next + n - age) % n];
        let inputs: f64 = (0..self.b.len())
            .map(|k| (k, k + self.late))
            .filter(|(_, age)| *age > 0)
            .map(|(k, age)| self.b[k] * past(age))
            .sum();
        let outputs: f64 = self.a.iter().zip(&self.y).map(|(a, y)| a * y).sum();
        inputs - outputs
    }

    fn step(&mut self, x: f64) -> f64 {
        let y = self.ahead() + self.at_once() * x;
        if let Some(place) = self.x.get_mut(self.next) {
            *place = x;
            self.next = (self.next + 1) % self.x.len();
        }
        push(&mut self.y, y);
        y
    }
}

fn push(past: &mut [f64], value: f64) {
    let n = past.len();
    if n > 0 {
        past.copy_within(0..n - 1, 1);
        past[0] = value;
    }
}

fn sampled(
    closed: &Closed,
    sample_time_s: f64,
    rows: usize,
    demand: &dyn Fn(usize, &mut [f64]),
    load: &dyn Fn(usize, &mut [f64]),
) -> Result<LoopRun, ControlError> {
    let (p, m) = (closed.plant.outputs, closed.plant.inputs);
    let blocks = |s: &System, what: &str| -> Result<Vec<Difference>, ControlError> {
        s.channels.iter().map(|g| Difference::new(g, sample_time_s, what)).collect()
    };
    let (mut plant, mut controller) =
        (blocks(&closed.plant, "the plant")?, blocks(&closed.controller, "the controller")?);
    if let Some(g) = plant.iter().find(|g| g.at_once() != 0.0) {
        return Err(ControlError::number(
            "the answer of the plant within its own sample",
            g.at_once(),
            "0: a run needs a delay of one sample at least",
        ));
    }
    let (mut r, mut d, mut e, mut u) = (vec![0.0; p], vec![0.0; m], vec![0.0; p], vec![0.0; m]);
    let mut out =
        LoopRun { step_s: sample_time_s, y: Vec::with_capacity(rows * p), u: Vec::with_capacity(rows * m) };
    for t in 0..rows {
        demand(t, &mut r);
        load(t, &mut d);
        for i in 0..p {
            let y: f64 = plant[i * m..(i + 1) * m].iter().map(Difference::ahead).sum();
            out.y.push(y);
            e[i] = r[i] - y;
        }
        for j in 0..m {
            u[j] = (0..p).map(|i| controller[j * p + i].step(e[i])).sum();
            out.u.push(u[j]);
        }
        for (k, g) in plant.iter_mut().enumerate() {
            g.step(u[k % m] + d[k % m]);
        }
    }
    Ok(out)
}

/// `x' = A x + B v, y = C x + D v` in controllable form.
struct States {
    /// Of the monic denominator, ascending without the leading one.
    a: Vec<f64>,
    c: Vec<f64>,
    d: f64,
    delay_s: f64,
    at: usize,
}

impl States {
    fn new(g: &Transfer, at: usize) -> Self {
        let n = degree(&g.den);
        let lead = g.den[n];
        let a: Vec<f64> = g.den[..n].iter().map(|v| v / lead).collect();
        let b = |k: usize| g.num.get(k).copied().unwrap_or(0.0) / lead;
        let d = b(n);
        let c = (0..n).map(|k| b(k) - d * a[k]).collect();
        Self { a, c, d, delay_s: g.delay_s, at }
    }

    fn output(&self, x: &[f64], v: f64) -> f64 {
        self.c.iter().zip(&x[self.at..]).map(|(c, x)| c * x).sum::<f64>() + self.d * v
    }

    fn slope(&self, x: &[f64], v: f64, out: &mut [f64]) {
        let n = self.a.len();
        let (x, out) = (&x[self.at..self.at + n], &mut out[self.at..self.at + n]);
        for k in 0..n {
            out[k] =
                if k + 1 < n { x[k + 1] } else { v - self.a.iter().zip(x).map(|(a, x)| a * x).sum::<f64>() };
        }
    }
}

/// The loop of a continuous run at one moment.
struct Moment<'a> {
    plant: &'a [States],
    controller: &'a [States],
    p: usize,
    m: usize,
    /// Inputs (with load) of past steps, steps x 3 x m: at the start of each, in the middle and at its end.
    past: Vec<f64>,
    step_s: f64,
}

/// Side from which a signal is looked at where it jumps between two steps.
#[derive(Clone, Copy, PartialEq)]
enum Side {
    Before,
    After,
}

impl Moment<'_> {
    /// Input `j` at a time in steps, from past steps; nothing before the first.
    fn input(&self, j: usize, at: f64, side: Side) -> f64 {
        let whole = at.round();
        let (k, s) = match ((at - whole).abs() < 1e-6, side) {
            (true, Side::Before) => (whole - 1.0, 1.0),
            (true, Side::After) => (whole, 0.0),
            (false, _) => (at.floor(), at - at.floor()),
        };
        if k < 0.0 {
            return 0.0;
        }
        let value = |part: usize| self.past[(3 * k as usize + part) * self.m + j];
        let (start, middle, end) = (value(0), value(1), value(2));
        start + s * (4.0 * middle - 3.0 * start - end + s * 2.0 * (start - 2.0 * middle + end))
    }

    /// Outputs and inputs for the states `x` at a time in steps.
    fn signals(&self, x: &[f64], (at, side): (f64, Side), r: &[f64], y: &mut [f64], u: &mut [f64]) {
        for i in 0..self.p {
            y[i] = (0..self.m)
                .map(|j| {
                    let g = &self.plant[i * self.m + j];
                    let v = if g.d != 0.0 { self.input(j, at - g.delay_s / self.step_s, side) } else { 0.0 };
                    g.output(x, v)
                })
                .sum();
        }
        for j in 0..self.m {
            u[j] = (0..self.p).map(|i| self.controller[j * self.p + i].output(x, r[i] - y[i])).sum();
        }
    }

    fn slope(
        &self,
        x: &[f64],
        (at, side): (f64, Side),
        r: &[f64],
        d: &[f64],
        work: &mut Work,
        out: &mut [f64],
    ) {
        self.signals(x, (at, side), r, &mut work.y, &mut work.u);
        for (k, g) in self.plant.iter().enumerate() {
            let j = k % self.m;
            let v = if g.delay_s > 0.0 {
                self.input(j, at - g.delay_s / self.step_s, side)
            } else {
                work.u[j] + d[j]
            };
            g.slope(x, v, out);
        }
        for (k, g) in self.controller.iter().enumerate() {
            let i = k % self.p;
            g.slope(x, r[i] - work.y[i], out);
        }
    }
}

impl Moment<'_> {
    fn keep(&mut self, u: &[f64], d: &[f64]) {
        self.past.extend(u.iter().zip(d).map(|(u, d)| u + d));
    }
}

struct Work {
    y: Vec<f64>,
    u: Vec<f64>,
}

fn continuous(
    closed: &Closed,
    step_s: f64,
    rows: usize,
    demand: &dyn Fn(usize, &mut [f64]),
    load: &dyn Fn(usize, &mut [f64]),
) -> Result<LoopRun, ControlError> {
    let (p, m) = (closed.plant.outputs, closed.plant.inputs);
    let mut n = 0;
    let mut blocks = |s: &System| -> Vec<States> {
        s.channels
            .iter()
            .map(|g| {
                let block = States::new(g, n);
                n += block.a.len();
                block
            })
            .collect()
    };
    let (plant, controller) = (blocks(&closed.plant), blocks(&closed.controller));
    if let Some(g) = plant.iter().find(|g| g.d != 0.0 && g.delay_s == 0.0) {
        return Err(ControlError::number(
            "the gain of the plant at infinite frequency",
            g.d,
            "0, or some delay: a run needs one of them",
        ));
    }
    if let Some(g) = plant.iter().find(|g| g.delay_s > 0.0 && g.delay_s < 2.0 * step_s) {
        return Err(ControlError::number(
            "the step of the run",
            step_s,
            "at most half of the shortest delay",
        )
        .with(g.delay_s));
    }
    if closed.controller.delay_s() > 0.0 {
        return Err(ControlError::number(
            "the delay of the controller",
            closed.controller.delay_s(),
            "0: give it to the plant",
        ));
    }
    let delayed = plant.iter().any(|g| g.delay_s > 0.0);
    let mut moment = Moment { plant: &plant, controller: &controller, p, m, past: Vec::new(), step_s };
    let mut x = vec![0.0; n];
    let (mut k, mut between) = (vec![vec![0.0; n]; 4], vec![0.0; n]);
    let (mut r, mut d, mut work) = (vec![0.0; p], vec![0.0; m], Work { y: vec![0.0; p], u: vec![0.0; m] });
    let mut out = LoopRun { step_s, y: Vec::with_capacity(rows * p), u: Vec::with_capacity(rows * m) };
    for t in 0..rows {
        demand(t, &mut r);
        load(t, &mut d);
        let now = t as f64;
        moment.signals(&x, (now, Side::After), &r, &mut work.y, &mut work.u);
        out.y.extend_from_slice(&work.y);
        out.u.extend_from_slice(&work.u);
        if delayed {
            moment.keep(&work.u, &d);
        }
        for (stage, (share, before)) in [(0.0, 0), (0.5, 0), (0.5, 1), (1.0, 2)].into_iter().enumerate() {
            for i in 0..n {
                between[i] = x[i] + if stage == 0 { 0.0 } else { share * step_s * k[before][i] };
            }
            let side = if stage == 3 { Side::Before } else { Side::After };
            let mut slope = std::mem::take(&mut k[stage]);
            moment.slope(&between, (now + share, side), &r, &d, &mut work, &mut slope);
            k[stage] = slope;
        }
        if delayed {
            // The middle of the step to third order, from the same slopes.
            for i in 0..n {
                between[i] = x[i] + step_s / 24.0 * (5.0 * k[0][i] + 4.0 * (k[1][i] + k[2][i]) - k[3][i]);
            }
            moment.signals(&between, (now + 0.5, Side::After), &r, &mut work.y, &mut work.u);
            moment.keep(&work.u, &d);
        }
        for i in 0..n {
            x[i] += step_s / 6.0 * (k[0][i] + 2.0 * k[1][i] + 2.0 * k[2][i] + k[3][i]);
        }
        if delayed {
            moment.signals(&x, (now + 1.0, Side::Before), &r, &mut work.y, &mut work.u);
            moment.keep(&work.u, &d);
        }
    }
    Ok(out)
}

impl ControlError {
    fn with(self, delay_s: f64) -> Self {
        match self {
            Self::Number { what, found, expected } => {
                Self::Number { what: format!("{what} (shortest delay {delay_s} s)"), found, expected }
            }
            other => other,
        }
    }
}

/// Growth of what a pulse leaves: size of the outputs in the last fifth of a run over that in the fifth before the middle, as a
/// natural logarithm. Below 0 the loop forgets.
///
/// # Errors
/// As of [`run`].
pub fn growth(closed: &Closed, step_s: f64, rows: usize) -> Result<f64, ControlError> {
    let found =
        run(closed, step_s, rows, &|t, r| r.fill(if t < 8 { 1.0 } else { 0.0 }), &|_, d| d.fill(0.0))?;
    let p = closed.plant.outputs;
    // Past the range of numbers there is no doubt.
    if found.y.iter().any(|v| !v.is_finite()) {
        return Ok(f64::INFINITY);
    }
    let size = |from: usize, to: usize| found.y[from * p..to * p].iter().map(|v| v * v).sum::<f64>().sqrt();
    let (first, early, late) =
        (size(0, rows / 5), size(3 * rows / 10, rows / 2), size(rows - rows / 5, rows));
    // What has faded to rounding neither fades nor grows any more: then the whole run is looked at.
    let faded = early.max(late) < 1e-11 * first;
    Ok((late.max(f64::MIN_POSITIVE) / if faded { first } else { early.max(f64::MIN_POSITIVE) }).ln())
}

/// Time in s after which column `k` of `rows x n` values stays within `share` of the step around `level`; none where it does not.
pub fn settling_s(values: &[f64], n: usize, k: usize, step_s: f64, level: f64, share: f64) -> Option<f64> {
    let rows = values.len() / n;
    let out =
        (0..rows).rev().find(|t| !((values[t * n + k] - level).abs() <= share * level.abs().max(1e-300)));
    match out {
        Some(t) if t + 1 == rows => None,
        Some(t) => Some((t + 1) as f64 * step_s),
        None => Some(0.0),
    }
}
