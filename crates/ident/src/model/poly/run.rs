//! Free run, prediction, sensitivities and window derivatives of polynomial NARX models.

use dynocal_numerics::status::Status;

use super::PolyNarx;
use super::filter::{Filter, add_past_rows};
use super::program::{MAX_OUTPUT_LAGS, Program, Scratch};
use super::shaped::Place;
use crate::model::{Model, Run, TakeRows};

impl Model for PolyNarx {
    fn n_inputs(&self) -> usize {
        self.inputs.len()
    }

    fn n_params(&self) -> usize {
        self.regressors.len()
    }

    fn max_lag(&self) -> usize {
        self.program.max_lag
    }

    fn output_lag(&self) -> usize {
        self.program.output_lags.last().copied().unwrap_or(0)
    }

    fn param_name(&self, k: usize) -> String {
        self.regressors[k].format(&self.inputs, &self.output)
    }

    fn is_linear_in_params(&self) -> bool {
        true
    }

    fn simulate(&self, theta: &[f64], run: &Run, y: &mut [f64]) -> Status {
        pulp::Arch::new().dispatch(FreeRun { program: &self.program, theta, run, y })
    }

    fn predict(&self, theta: &[f64], run: &Run, yhat: &mut [f64]) {
        let program = &self.program;
        let start = begin(program, run, yhat);
        let filter = Filter::of(program, theta);
        let mut scratch = Scratch::new();
        for (t0, len) in blocks(program, start, run.len()) {
            program.exogenous_block(theta, run.u, t0, len, &mut scratch, None);
            for (t, sum) in (t0..t0 + len).zip(&scratch.sum) {
                yhat[t] = match &filter {
                    Some(filter) => filter.one(*sum, run.y, t),
                    None => program.with_recursive_sum(*sum, theta, run.u, run.y, t),
                };
            }
        }
    }

    fn sensitivities(&self, theta: &[f64], run: &Run, y: &mut [f64], s: &mut [f64]) -> Status {
        pulp::Arch::new().dispatch(Sensitivities { program: &self.program, theta, run, y, s })
    }

    fn sensitivity_blocks(
        &self,
        theta: &[f64],
        run: &Run,
        rows: usize,
        y: &mut [f64],
        take: &mut TakeRows<'_>,
    ) -> Status {
        let program = &self.program;
        let (p, lag, block) = (self.n_params(), self.output_lag(), program.block_len());
        let start = begin(program, run, y);
        let filter = Filter::of(program, theta);
        let mut scratch = Scratch::new();
        let chunk = block * rows.div_ceil(block).max(1);
        // The rows that the recursion reads, then those of the chunk.
        let mut s = vec![0.0; (lag + chunk) * p];
        for from in (start..run.len()).step_by(chunk) {
            let to = (from + chunk).min(run.len());
            for t0 in (from..to).step_by(block) {
                let (len, at) = (block.min(to - t0), (lag + t0 - from) * p);
                let (s, scratch) = (&mut s[..], &mut scratch);
                let rows = Rows { program, filter: &filter, theta, u: run.u, y, t0, len, s, at, scratch };
                let finite = pulp::Arch::new().dispatch(rows);
                if finite < len {
                    y[t0 + finite..].fill(f64::NAN);
                    return Status::Diverged;
                }
            }
            take(from, &y[from..to], &s[lag * p..(lag + to - from) * p]);
            s.copy_within((to - from) * p..(to - from + lag) * p, 0);
        }
        Status::Converged
    }

    fn one_step_jacobian(&self, theta: &[f64], run: &Run, s: &mut [f64]) {
        let program = &self.program;
        let p = self.n_params();
        let start = run.start.max(program.max_lag).min(run.len());
        s[..start * p].fill(0.0);
        let mut scratch = Scratch::new();
        for (t0, len) in blocks(program, start, run.len()) {
            program.exogenous_block(theta, run.u, t0, len, &mut scratch, Some(&mut s[t0 * p..]));
            for t in t0..t0 + len {
                fill_recursive_terms(program, run.u, run.y, t, &mut s[t * p..(t + 1) * p]);
            }
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
        super::adjoint::sensitivity_adjoint(&self.program, theta, run, y, s, y_bar, s_bar, u_bar);
    }

    fn window(&self) -> &[(usize, usize)] {
        &self.program.window
    }

    fn output_derivatives(&self, theta: &[f64], run: &Run, t: usize, grad: &mut [f64]) {
        let mut gradient = [0.0; MAX_OUTPUT_LAGS];
        let a = &mut gradient[..self.program.output_lags.len()];
        self.program.output_gradient(theta, run.u, run.y, t, a);
        grad.fill(0.0);
        for (lag, a) in self.program.output_lags.iter().zip(a.iter()) {
            grad[lag - 1] = *a;
        }
    }

    fn window_derivatives(
        &self,
        theta: &[f64],
        run: &Run,
        t: usize,
        grad: &mut [f64],
        hess: &mut [f64],
    ) -> f64 {
        let program = &self.program;
        let w = program.window.len();
        grad.fill(0.0);
        hess.fill(0.0);
        let u = program.input_window(run.u, t);
        let mut value = 0.0;
        for &k in program.exogenous.iter().chain(&program.recursive) {
            let gain = theta[k] * program.output_product(k, run.y, t);
            let taps = program.taps(k);
            value += gain * program.input_product(k, u);
            for (a, tap_a) in taps.iter().enumerate() {
                let except = |skip: usize| {
                    let kept = taps.iter().enumerate().filter(|(i, _)| *i != a && *i != skip);
                    kept.fold(gain, |x, (_, tap)| x * u[tap.shift])
                };
                grad[tap_a.window] += except(a);
                for (b, tap_b) in taps.iter().enumerate() {
                    if a != b {
                        hess[tap_a.window * w + tap_b.window] += except(b);
                    }
                }
            }
        }
        for term in program.shaped.iter().chain(&program.shaped_recursive) {
            term.gradient(u, run.y, t, |place, slope| {
                if let Place::Input { window, .. } = place {
                    grad[window] += theta[term.k] * slope;
                }
            });
            term.hessian(u, run.y, t, |a, b, second| {
                if let (Place::Input { window: a, .. }, Place::Input { window: b, .. }) = (a, b) {
                    hess[a * w + b] += theta[term.k] * second;
                }
            });
            value += theta[term.k] * term.value(u, run.y, t);
        }
        value
    }

    fn joint_derivatives(
        &self,
        theta: &[f64],
        run: &Run,
        t: usize,
        grad: &mut [f64],
        hess: &mut [f64],
    ) -> f64 {
        super::joint::derivatives(&self.program, theta, run, t, grad, hess)
    }
}

/// [`Model::simulate`], compiled for the widest registers there are: the terms without outputs of a block at a time.
struct FreeRun<'a, 'r> {
    program: &'a Program,
    theta: &'a [f64],
    run: &'a Run<'r>,
    y: &'a mut [f64],
}

impl pulp::WithSimd for FreeRun<'_, '_> {
    type Output = Status;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> Status {
        let Self { program, theta, run, y } = self;
        let start = begin(program, run, y);
        let filter = Filter::of(program, theta);
        let mut scratch = Scratch::new();
        for (t0, len) in blocks(program, start, run.len()) {
            program.exogenous_block(theta, run.u, t0, len, &mut scratch, None);
            let finite = output_block(program, &filter, theta, run.u, y, t0, &scratch.sum[..len]);
            if finite < len {
                y[t0 + finite..].fill(f64::NAN);
                return Status::Diverged;
            }
        }
        Status::Converged
    }
}

/// Output of the samples from `t0` on from the sums of their terms without outputs; returns how many are finite.
#[inline(always)]
fn output_block(
    program: &Program,
    filter: &Option<Filter<'_>>,
    theta: &[f64],
    u: &[f64],
    y: &mut [f64],
    t0: usize,
    sums: &[f64],
) -> usize {
    match filter {
        Some(filter) => filter.output(sums, y, t0),
        None => {
            for (t, sum) in (t0..t0 + sums.len()).zip(sums) {
                y[t] = program.with_recursive_sum(*sum, theta, u, y, t);
            }
        }
    }
    let y = &y[t0..t0 + sums.len()];
    // Without branches first: nearly every block is finite, and 0 v is 0 for finite v only.
    let trace: f64 = y.iter().map(|v| 0.0 * v).sum();
    if trace == 0.0 { y.len() } else { y.iter().position(|v| !v.is_finite()).unwrap_or(y.len()) }
}

/// [`Model::sensitivities`], compiled for the widest registers there are: several columns at a time.
struct Sensitivities<'a, 'r> {
    program: &'a Program,
    theta: &'a [f64],
    run: &'a Run<'r>,
    y: &'a mut [f64],
    s: &'a mut [f64],
}

impl pulp::WithSimd for Sensitivities<'_, '_> {
    type Output = Status;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> Status {
        let Self { program, theta, run, y, s } = self;
        let p = theta.len();
        let start = begin(program, run, y);
        s[..(start * p).min(run.len() * p)].fill(0.0);
        let filter = Filter::of(program, theta);
        let mut scratch = Scratch::new();
        for (t0, len) in blocks(program, start, run.len()) {
            let finite =
                sensitivity_block(program, &filter, theta, run.u, y, t0, len, s, t0 * p, &mut scratch);
            if finite < len {
                let t = t0 + finite;
                y[t..].fill(f64::NAN);
                s[t * p..].fill(f64::NAN);
                return Status::Diverged;
            }
        }
        Status::Converged
    }
}

/// [`sensitivity_block`] by itself.
struct Rows<'a> {
    program: &'a Program,
    filter: &'a Option<Filter<'a>>,
    theta: &'a [f64],
    u: &'a [f64],
    y: &'a mut [f64],
    t0: usize,
    len: usize,
    s: &'a mut [f64],
    at: usize,
    scratch: &'a mut Scratch,
}

impl pulp::WithSimd for Rows<'_> {
    type Output = usize;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> usize {
        let Self { program, filter, theta, u, y, t0, len, s, at, scratch } = self;
        sensitivity_block(program, filter, theta, u, y, t0, len, s, at, scratch)
    }
}

/// Output and rows of the samples `t0..t0 + len`; row `t0` stands at `s[at..]`, those of the past before it. Returns how
/// many samples are finite.
#[inline(always)]
fn sensitivity_block(
    program: &Program,
    filter: &Option<Filter<'_>>,
    theta: &[f64],
    u: &[f64],
    y: &mut [f64],
    t0: usize,
    len: usize,
    s: &mut [f64],
    at: usize,
    scratch: &mut Scratch,
) -> usize {
    let p = theta.len();
    program.exogenous_block(theta, u, t0, len, scratch, Some(&mut s[at..]));
    let finite = output_block(program, filter, theta, u, y, t0, &scratch.sum[..len]);
    if let Some(filter) = filter {
        for term in &program.linear {
            let past = &y[t0 - term.lag..];
            for (x, v) in s[at + term.k..].iter_mut().step_by(p).zip(past).take(finite) {
                *x = *v;
            }
        }
        filter.rows(s, at, finite, p);
    } else if program.is_recursive() {
        let mut gradient = [0.0; MAX_OUTPUT_LAGS];
        let a = &mut gradient[..program.output_lags.len()];
        for i in 0..finite {
            let (t, row) = (t0 + i, at + i * p);
            fill_recursive_terms(program, u, y, t, &mut s[row..row + p]);
            program.output_gradient(theta, u, y, t, a);
            add_past_rows(s, row, p, &program.output_lags, a);
        }
    }
    finite
}

/// Copies the initial values and returns the first sample that is computed.
fn begin(program: &Program, run: &Run, y: &mut [f64]) -> usize {
    let start = run.start.max(program.max_lag).min(run.len());
    y[..start].copy_from_slice(&run.y[..start]);
    start
}

/// (first sample, length) of the blocks of `start..n`.
fn blocks(program: &Program, start: usize, n: usize) -> impl Iterator<Item = (usize, usize)> {
    let block = program.block_len();
    (start..n).step_by(block).map(move |t0| (t0, block.min(n - t0)))
}

/// I_k(t) O_k(t) of the recursive terms into their places of one row.
#[inline(always)]
fn fill_recursive_terms(program: &Program, u: &[f64], y: &[f64], t: usize, row: &mut [f64]) {
    if !program.is_recursive() {
        return;
    }
    let window = program.input_window(u, t);
    for term in &program.linear {
        row[term.k] = program.input_product(term.k, window) * y[t - term.lag];
    }
    for &k in &program.general {
        row[k] = program.input_product(k, window) * program.output_product(k, y, t);
    }
    for term in &program.shaped_recursive {
        row[term.k] = term.value(window, y, t);
    }
}
