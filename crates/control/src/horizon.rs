//! Receding horizon: every sample the next moves of all actuators are optimised within their limits, and the first one is applied.
//!
//! ```text
//! y(t + j) = free run of the channels + d,    d(t) = d(t-1) + (1 - exp(-dt / T)) (measured - model - d(t-1))
//! minimise   sum_{j=1..N} sum_o w_o (r_o(t + j) - y_o(t + j))^2 + sum_{k<M} sum_i p_i (u_i(t + k) - u_i(t + k - 1))^2
//! within     lower <= u <= upper,    u held after the last of M moves
//! ```
//!
//! The program is a strictly convex quadratic one whose matrix never changes: where no limit holds its solution, it is one product with
//! a triangle that is factored once; else the interior point solves it. No controller of an ECU: what could be had of a plant
//! whose model is known, causally or with preview of the demand. (J. M. Maciejowski, Predictive Control with Constraints (2002); d is
//! its constant output disturbance, which leaves no offset.)

use dynocal_numerics::linalg;
use dynocal_numerics::nlp::{self, NlpOptions, SparseNlp};

use crate::error::ControlError;
use crate::system::System;

/// What is optimised.
#[derive(Clone, Debug, PartialEq)]
pub struct HorizonSettings {
    /// Samples that are looked ahead, N.
    pub ahead: usize,
    /// Samples in which the actuators may move, M.
    pub moves: usize,
    /// Weight of each output's squared distance from its demand.
    pub weights: Vec<f64>,
    /// Price of each input's squared move from sample to sample.
    pub prices: Vec<f64>,
    /// Least value of each input, in deviations from rest; may be infinite.
    pub lower: Vec<f64>,
    /// Greatest value.
    pub upper: Vec<f64>,
    /// Time constant T in s by which what the model does not know is followed; 0: at once.
    pub correction_s: f64,
}

/// A channel as a difference equation with its past, latest first.
#[derive(Clone, Debug)]
struct Run {
    b: Vec<f64>,
    a: Vec<f64>,
    y: Vec<f64>,
}

impl Run {
    /// The next output for past inputs, latest first; the past moves on.
    fn step(&mut self, u: &[f64]) -> f64 {
        let forward: f64 = self.b.iter().zip(u).map(|(b, u)| b * u).sum();
        let back: f64 = self.a.iter().zip(&self.y).map(|(a, y)| a * y).sum();
        push(&mut self.y, forward - back);
        forward - back
    }
}

/// A controller with a receding horizon over a stable sampled plant.
///
/// ```
/// use dynocal_control::horizon::{Horizon, HorizonSettings};
/// use dynocal_control::system::{System, Time, Transfer};
/// let plant = System::single(Time::Sampled { sample_time_s: 0.1 }, Transfer::sampled(&[0.0, 0.2], &[1.0, -0.8]))?;
/// let one = |v: f64| vec![v];
/// let settings = HorizonSettings { ahead: 20, moves: 5, weights: one(1.0), prices: one(1e-9), lower: one(-10.0), upper: one(10.0), correction_s: 0.0 };
/// let mut c = Horizon::new(&plant, settings)?;
/// // Moves cost next to nothing: the demand is there a sample later, then it is held.
/// assert!((c.step(&|_, _| 1.0, &[0.0])?[0] - 5.0).abs() < 1e-3);
/// assert!((c.step(&|_, _| 1.0, &[1.0])?[0] - 1.0).abs() < 1e-3);
/// # Ok::<(), dynocal_control::error::ControlError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Horizon {
    settings: HorizonSettings,
    /// Output by input.
    runs: Vec<Run>,
    /// Past of each input, latest first.
    u: Vec<Vec<f64>>,
    outputs: usize,
    /// Outputs at the horizon's samples by moves, (N outputs) x (M inputs); the matrix of the program and its triangle.
    phi: Vec<f64>,
    h: Vec<f64>,
    factor: Vec<f64>,
    /// What the model does not know, its share that is followed in a sample.
    d: Vec<f64>,
    share: f64,
    plan: Vec<f64>,
}

impl Horizon {
    /// At rest.
    ///
    /// # Errors
    /// [`ControlError`]: a plant that is continuous, has delays apart from its numerators or answers within its sample; settings that do not
    /// fit it; prices that are not positive.
    pub fn new(plant: &System, settings: HorizonSettings) -> Result<Self, ControlError> {
        let Some(dt_s) = plant.time.sample_time_s() else {
            return Err(ControlError::Model("a horizon needs a sampled plant".into()));
        };
        check(plant, &settings)?;
        let (inputs, outputs) = (plant.inputs, plant.outputs);
        let longest = plant.channels.iter().map(|g| g.num.len()).max().unwrap_or(1);
        let run = |g: &crate::system::Transfer| Run {
            b: g.num[1..].iter().map(|v| v / g.den[0]).collect(),
            a: g.den[1..].iter().map(|v| v / g.den[0]).collect(),
            y: vec![0.0; g.den.len() - 1],
        };
        let share = if settings.correction_s > 0.0 { -(-dt_s / settings.correction_s).exp_m1() } else { 1.0 };
        let mut own = Self {
            runs: plant.channels.iter().map(run).collect(),
            u: vec![vec![0.0; longest - 1]; inputs],
            outputs,
            phi: Vec::new(),
            h: Vec::new(),
            factor: Vec::new(),
            d: vec![0.0; outputs],
            share,
            plan: vec![0.0; settings.moves * inputs],
            settings,
        };
        own.phi = own.answers();
        own.h = own.matrix();
        own.factor = own.h.clone();
        linalg::cholesky(&mut own.factor, own.plan.len())
            .map_err(|e| ControlError::Model(format!("the program of the horizon: {e}")))?;
        Ok(own)
    }

    /// Inputs of the next sample for demands `demand(j, output)` j = 1.. samples ahead, and what was measured now (deviations from rest). A
    /// measurement that is no number leaves the correction what it was.
    ///
    /// # Errors
    /// [`ControlError::Model`] where the program could not be solved.
    pub fn step(
        &mut self,
        demand: &dyn Fn(usize, usize) -> f64,
        measured: &[f64],
    ) -> Result<&[f64], ControlError> {
        let inputs = self.u.len();
        for o in 0..self.outputs {
            let model: f64 = (0..inputs).map(|i| self.runs[o * inputs + i].step(&self.u[i])).sum();
            let error = measured[o] - model - self.d[o];
            if error.is_finite() {
                self.d[o] += self.share * error;
            }
        }
        let g = self.slope(demand);
        self.solve(&g)?;
        for (past, u) in self.u.iter_mut().zip(&self.plan) {
            push(past, *u);
        }
        Ok(&self.plan[..inputs])
    }

    /// The moves that were planned in the last sample, rows of inputs.
    pub fn plan(&self) -> &[f64] {
        &self.plan
    }

    /// What each unit of a move does to each output along the horizon.
    fn answers(&self) -> Vec<f64> {
        let (inputs, n, m) = (self.u.len(), self.settings.ahead, self.settings.moves);
        let width = m * inputs;
        let mut phi = vec![0.0; n * self.outputs * width];
        for (c, run) in self.runs.iter().enumerate() {
            let (o, i) = (c / inputs, c % inputs);
            for k in 0..m {
                let (mut own, mut u) = (run.clone(), vec![0.0; self.u[i].len()]);
                for j in 0..n {
                    // The last move is held.
                    push(&mut u, if j == k || (k + 1 == m && j > k) { 1.0 } else { 0.0 });
                    phi[(j * self.outputs + o) * width + k * inputs + i] = own.step(&u);
                }
            }
        }
        phi
    }

    fn matrix(&self) -> Vec<f64> {
        let (inputs, width) = (self.u.len(), self.plan.len());
        let mut h = vec![0.0; width * width];
        for (row, phi) in self.phi.chunks(width).enumerate() {
            let w = self.settings.weights[row % self.outputs];
            for a in (0..width).filter(|a| phi[*a] != 0.0) {
                (0..width).for_each(|b| h[a * width + b] += w * phi[a] * phi[b]);
            }
        }
        for a in 0..width {
            let p = self.settings.prices[a % inputs];
            h[a * width + a] += p;
            if a + inputs < width {
                h[a * width + a] += p;
                h[a * width + a + inputs] -= p;
                h[(a + inputs) * width + a] -= p;
            }
        }
        h
    }

    /// Right side of the program: what is missing without any input, and where the inputs are.
    fn slope(&self, demand: &dyn Fn(usize, usize) -> f64) -> Vec<f64> {
        let (inputs, width) = (self.u.len(), self.plan.len());
        let mut g = vec![0.0; width];
        let mut runs = self.runs.clone();
        let mut u = self.u.clone();
        for j in 0..self.settings.ahead {
            u.iter_mut().for_each(|past| push(past, 0.0));
            for o in 0..self.outputs {
                let free: f64 = (0..inputs).map(|i| runs[o * inputs + i].step(&u[i])).sum();
                let missing = self.settings.weights[o] * (demand(j + 1, o) - free - self.d[o]);
                let row = j * self.outputs + o;
                for (g, phi) in g.iter_mut().zip(&self.phi[row * width..(row + 1) * width]) {
                    *g += missing * phi;
                }
            }
        }
        for i in 0..inputs {
            g[i] += self.settings.prices[i] * self.u[i].first().copied().unwrap_or(0.0);
        }
        g
    }

    fn solve(&mut self, g: &[f64]) -> Result<(), ControlError> {
        let (inputs, width) = (self.u.len(), self.plan.len());
        let refused = |e: String| ControlError::Model(format!("the program of the horizon: {e}"));
        let mut x = g.to_vec();
        linalg::solve_upper_transposed(&self.factor, width, &mut x).map_err(|e| refused(e.to_string()))?;
        linalg::solve_upper(&self.factor, width, &mut x).map_err(|e| refused(e.to_string()))?;
        let (lower, upper) = (&self.settings.lower, &self.settings.upper);
        let within = |(k, v): (usize, &f64)| (lower[k % inputs]..=upper[k % inputs]).contains(v);
        if !x.iter().enumerate().all(within) {
            let mut program = Limited { h: &self.h, g, lower, upper, start: &x };
            let found = nlp::solve(&mut program, &NlpOptions::default(), &|| false);
            if !found.status.is_success() {
                return Err(refused(format!("{:?}", found.status)));
            }
            x = found.x;
        }
        self.plan = x;
        Ok(())
    }
}

/// minimise 1/2 x'H x - g'x within bounds.
struct Limited<'a> {
    h: &'a [f64],
    g: &'a [f64],
    lower: &'a [f64],
    upper: &'a [f64],
    start: &'a [f64],
}

impl Limited<'_> {
    fn product(&self, x: &[f64], row: usize) -> f64 {
        let n = self.g.len();
        self.h[row * n..(row + 1) * n].iter().zip(x).map(|(h, x)| h * x).sum()
    }
}

impl SparseNlp for Limited<'_> {
    fn n(&self) -> usize {
        self.g.len()
    }

    fn m(&self) -> usize {
        0
    }

    fn bounds(&self, lower: &mut [f64], upper: &mut [f64]) {
        let inputs = self.lower.len();
        for k in 0..self.g.len() {
            (lower[k], upper[k]) = (self.lower[k % inputs], self.upper[k % inputs]);
        }
    }

    fn start(&self, x: &mut [f64]) {
        let inputs = self.lower.len();
        for (k, x) in x.iter_mut().enumerate() {
            *x = self.start[k].clamp(self.lower[k % inputs], self.upper[k % inputs]);
        }
    }

    fn objective(&mut self, x: &[f64]) -> f64 {
        (0..x.len()).map(|r| x[r] * (0.5 * self.product(x, r) - self.g[r])).sum()
    }

    fn gradient(&mut self, x: &[f64], grad: &mut [f64]) {
        for (r, grad) in grad.iter_mut().enumerate() {
            *grad = self.product(x, r) - self.g[r];
        }
    }

    fn constraints(&mut self, _x: &[f64], _c: &mut [f64]) {}

    fn jacobian_structure(&self) -> Vec<(usize, usize)> {
        Vec::new()
    }

    fn jacobian(&mut self, _x: &[f64], _values: &mut [f64]) {}

    fn hessian_structure(&self) -> Vec<(usize, usize)> {
        (0..self.g.len()).flat_map(|r| (0..=r).map(move |c| (r, c))).collect()
    }

    fn hessian(&mut self, _x: &[f64], sigma: f64, _multipliers: &[f64], values: &mut [f64]) {
        let n = self.g.len();
        let lower = (0..n).flat_map(|r| (0..=r).map(move |c| r * n + c));
        values.iter_mut().zip(lower).for_each(|(v, k)| *v = sigma * self.h[k]);
    }
}

fn check(plant: &System, s: &HorizonSettings) -> Result<(), ControlError> {
    for (what, found, expected) in [
        ("weights of a horizon", s.weights.len(), plant.outputs),
        ("prices of a horizon", s.prices.len(), plant.inputs),
        ("lower limits of a horizon", s.lower.len(), plant.inputs),
        ("upper limits of a horizon", s.upper.len(), plant.inputs),
    ] {
        if found != expected {
            return Err(ControlError::shape(what, found, expected));
        }
    }
    if s.moves == 0 || s.moves > s.ahead {
        let expected = "1 to the samples that are looked ahead";
        return Err(ControlError::number("moves of a horizon", s.moves as f64, expected));
    }
    if let Some(p) = s.prices.iter().find(|p| !(**p > 0.0 && p.is_finite())) {
        return Err(ControlError::number("a price of a move", *p, "a positive number"));
    }
    if let Some(w) = s.weights.iter().find(|w| !(**w >= 0.0 && w.is_finite())) {
        return Err(ControlError::number("a weight of an output", *w, "0 or a positive number"));
    }
    if let Some((l, _)) = s.lower.iter().zip(&s.upper).find(|(l, u)| !(l < u)) {
        return Err(ControlError::number("a lower limit of a horizon", *l, "a number below the upper limit"));
    }
    if !(s.correction_s >= 0.0 && s.correction_s.is_finite()) {
        return Err(ControlError::number(
            "correction_s",
            s.correction_s,
            "0 or a positive number of seconds",
        ));
    }
    for g in &plant.channels {
        if g.num[0] != 0.0 || g.delay_s != 0.0 {
            let expected =
                "0: a plant of a horizon answers after its sample, delays are part of its numerators";
            let found = if g.num[0] != 0.0 { g.num[0] } else { g.delay_s };
            return Err(ControlError::number(
                "the answer of a channel within its own sample, or its delay_s",
                found,
                expected,
            ));
        }
    }
    Ok(())
}

fn push(past: &mut [f64], value: f64) {
    let n = past.len();
    if n > 0 {
        past.copy_within(0..n - 1, 1);
        past[0] = value;
    }
}
