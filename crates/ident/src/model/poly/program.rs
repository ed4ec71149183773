//! Regressors compiled to flat index tables, and the kernels that run them.
//!
//! A regressor is I_k(t) O_k(t): a product of lagged inputs times a product of lagged outputs. The terms without
//! outputs do not depend on the recursion and are evaluated for a block of samples at a time (term by term, so
//! that the loop over time vectorises); only the terms with outputs are evaluated sample by sample.

use super::regressor::{Regressor, Source};
use super::shaped::{Place, ShapedTerm};

/// Samples per block.
pub(super) const BLOCK: usize = 64;
/// Room for the channels of one block, transposed.
const CHANNELS: usize = 1024;
/// Most distinct output lags.
pub(super) const MAX_OUTPUT_LAGS: usize = 64;

/// One input read: `u[(t - lag) m + channel]`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tap {
    pub(super) channel: usize,
    pub(super) lag: usize,
    /// Position in the window `u[(t - max_lag) m ..= t m + m - 1]`.
    pub(super) shift: usize,
    /// Position in the list of (input, lag) pairs.
    pub(super) window: usize,
}

/// One output read: `y(t - lag)^power`.
#[derive(Clone, Copy, Debug)]
pub(super) struct OutputFactor {
    pub(super) lag: usize,
    /// Position of the lag in [`Program::output_lags`].
    pub(super) slot: usize,
    pub(super) power: u32,
}

/// One term: ranges in the two factor tables. Input powers are repeated taps.
#[derive(Clone, Copy, Debug)]
pub(super) struct Term {
    taps: (usize, usize),
    outputs: (usize, usize),
}

/// A term `I_k(t) y(t - lag)`.
#[derive(Clone, Copy, Debug)]
pub(super) struct LinearTerm {
    pub(super) k: usize,
    pub(super) lag: usize,
    pub(super) slot: usize,
}

/// Compiled structure.
#[derive(Clone, Debug)]
pub(super) struct Program {
    pub(super) m: usize,
    pub(super) max_lag: usize,
    pub(super) terms: Vec<Term>,
    taps: Vec<Tap>,
    outputs: Vec<OutputFactor>,
    /// Terms without outputs.
    pub(super) exogenous: Vec<usize>,
    /// Terms with outputs.
    pub(super) recursive: Vec<usize>,
    /// Those of them with one output factor of power one: nearly all that occur, and O_k, dO_k/dy are then plain.
    pub(super) linear: Vec<LinearTerm>,
    /// The others.
    pub(super) general: Vec<usize>,
    /// Exogenous terms of one tap: (term, shift).
    pub(super) singles: Vec<(usize, usize)>,
    /// Exogenous terms of two taps: (term, shift, shift).
    pub(super) pairs: Vec<(usize, usize, usize)>,
    /// Exogenous terms of three and more taps.
    pub(super) longer: Vec<usize>,
    /// Terms with functions that do not read the output; not in the lists above, without taps and outputs.
    pub(super) shaped: Vec<ShapedTerm>,
    /// Terms with functions that do, or whose plain factors do.
    pub(super) shaped_recursive: Vec<ShapedTerm>,
    /// Distinct output lags, ascending.
    pub(super) output_lags: Vec<usize>,
    /// Distinct (input, lag) pairs, sorted.
    pub(super) window: Vec<(usize, usize)>,
}

/// Work space of the block kernel, on the stack.
pub(super) struct Scratch {
    channels: [f64; CHANNELS],
    product: [f64; BLOCK],
    pub(super) sum: [f64; BLOCK],
}

impl Scratch {
    pub(super) fn new() -> Self {
        Self { channels: [0.0; CHANNELS], product: [0.0; BLOCK], sum: [0.0; BLOCK] }
    }
}

impl Program {
    pub(super) fn new(m: usize, regressors: &[Regressor]) -> Self {
        let all = || regressors.iter().flat_map(|r| r.reads());
        let max_lag = all().map(|(_, lag)| lag).max().unwrap_or(0);
        let mut window = Vec::new();
        let mut output_lags = Vec::new();
        for (source, lag) in all() {
            match source {
                Source::Input(i) => window.push((i, lag)),
                Source::Output => output_lags.push(lag),
            }
        }
        window.sort_unstable();
        window.dedup();
        output_lags.sort_unstable();
        output_lags.dedup();

        let (mut taps, mut outputs, mut terms) = (Vec::new(), Vec::new(), Vec::new());
        let (mut exogenous, mut recursive) = (Vec::new(), Vec::new());
        let (mut shaped, mut shaped_recursive) = (Vec::new(), Vec::new());
        let place = |source, lag| match source {
            Source::Input(i) => Place::Input {
                shift: (max_lag - lag) * m + i,
                window: window.partition_point(|w| *w < (i, lag)),
            },
            Source::Output => Place::Output { lag, slot: output_lags.partition_point(|l| *l < lag) },
        };
        for (k, r) in regressors.iter().enumerate() {
            if !r.functions().is_empty() {
                let list = if r.reads_output() { &mut shaped_recursive } else { &mut shaped };
                list.push(ShapedTerm::new(k, r, place));
                terms.push(Term { taps: (taps.len(), taps.len()), outputs: (outputs.len(), outputs.len()) });
                continue;
            }
            let (tap0, output0) = (taps.len(), outputs.len());
            for f in r.factors() {
                match f.source {
                    Source::Input(channel) => {
                        let tap = Tap {
                            channel,
                            lag: f.lag,
                            shift: (max_lag - f.lag) * m + channel,
                            window: window.partition_point(|w| *w < (channel, f.lag)),
                        };
                        taps.extend(std::iter::repeat_n(tap, f.power as usize));
                    }
                    Source::Output => {
                        let slot = output_lags.partition_point(|l| *l < f.lag);
                        outputs.push(OutputFactor { lag: f.lag, slot, power: f.power });
                    }
                }
            }
            terms.push(Term { taps: (tap0, taps.len()), outputs: (output0, outputs.len()) });
            if r.reads_output() { recursive.push(k) } else { exogenous.push(k) }
        }
        let mut program = Self {
            m,
            max_lag,
            terms,
            taps,
            outputs,
            exogenous,
            recursive,
            linear: Vec::new(),
            general: Vec::new(),
            singles: Vec::new(),
            pairs: Vec::new(),
            longer: Vec::new(),
            shaped,
            shaped_recursive,
            output_lags,
            window,
        };
        program.classify();
        program
    }

    /// Sorts the terms into those with a short way and the others.
    fn classify(&mut self) {
        for &k in &self.recursive {
            match self.outputs(k) {
                [f] if f.power == 1 => {
                    let (lag, slot) = (f.lag, f.slot);
                    self.linear.push(LinearTerm { k, lag, slot });
                }
                _ => self.general.push(k),
            }
        }
        for &k in &self.exogenous {
            match self.taps(k) {
                [] => {}
                [a] => self.singles.push((k, a.shift)),
                [a, b] => self.pairs.push((k, a.shift, b.shift)),
                _ => self.longer.push(k),
            }
        }
    }

    #[inline(always)]
    pub(super) fn taps(&self, k: usize) -> &[Tap] {
        let (lo, hi) = self.terms[k].taps;
        &self.taps[lo..hi]
    }

    #[inline(always)]
    pub(super) fn outputs(&self, k: usize) -> &[OutputFactor] {
        let (lo, hi) = self.terms[k].outputs;
        &self.outputs[lo..hi]
    }

    /// Inputs that sample `t` can read.
    #[inline(always)]
    pub(super) fn input_window<'a>(&self, u: &'a [f64], t: usize) -> &'a [f64] {
        &u[(t - self.max_lag) * self.m..(t + 1) * self.m]
    }

    /// I_k(t) from the window of sample t.
    #[inline(always)]
    pub(super) fn input_product(&self, k: usize, window: &[f64]) -> f64 {
        self.taps(k).iter().fold(1.0, |x, tap| x * window[tap.shift])
    }

    /// O_k(t).
    #[inline(always)]
    pub(super) fn output_product(&self, k: usize, y: &[f64], t: usize) -> f64 {
        self.outputs(k).iter().fold(1.0, |x, f| x * power(y[t - f.lag], f.power))
    }

    /// `exogenous` plus the sum of theta_k I_k(t) O_k(t) over the recursive terms.
    #[inline(always)]
    pub(super) fn with_recursive_sum(
        &self,
        exogenous: f64,
        theta: &[f64],
        u: &[f64],
        y: &[f64],
        t: usize,
    ) -> f64 {
        if !self.is_recursive() {
            return exogenous;
        }
        let window = self.input_window(u, t);
        let mut sum = exogenous;
        for term in &self.linear {
            sum += theta[term.k] * self.input_product(term.k, window) * y[t - term.lag];
        }
        for &k in &self.general {
            sum += theta[k] * self.input_product(k, window) * self.output_product(k, y, t);
        }
        for term in &self.shaped_recursive {
            sum += theta[term.k] * term.value(window, y, t);
        }
        sum
    }

    /// Whether any term reads the output.
    pub(super) fn is_recursive(&self) -> bool {
        !self.recursive.is_empty() || !self.shaped_recursive.is_empty()
    }

    /// Fills `a` (one value per entry of [`Program::output_lags`]) with df/dy(t - lag).
    #[inline(always)]
    pub(super) fn output_gradient(&self, theta: &[f64], u: &[f64], y: &[f64], t: usize, a: &mut [f64]) {
        a.fill(0.0);
        let window = self.input_window(u, t);
        for term in &self.linear {
            a[term.slot] += theta[term.k] * self.input_product(term.k, window);
        }
        for &k in &self.general {
            let gain = theta[k] * self.input_product(k, window);
            let factors = self.outputs(k);
            for (i, f) in factors.iter().enumerate() {
                a[f.slot] += gain * first_derivative(factors, i, y, t);
            }
        }
        for term in &self.shaped_recursive {
            term.gradient(window, y, t, |place, slope| {
                if let Place::Output { slot, .. } = place {
                    a[slot] += theta[term.k] * slope;
                }
            });
        }
    }

    /// Largest block that the work space holds; 0 when the window is too wide to be transposed.
    fn block(&self) -> usize {
        match CHANNELS.checked_div(self.m) {
            None => BLOCK,
            Some(room) => room.saturating_sub(self.max_lag).min(BLOCK),
        }
    }

    /// Samples that one call of [`Program::exogenous_block`] may cover.
    pub(super) fn block_len(&self) -> usize {
        match self.block() {
            short if short < 16 => BLOCK,
            fits => fits,
        }
    }

    /// For the samples `t0..t0 + len`: `scratch.sum` = sum of theta_k I_k(t) over the exogenous terms, and, when
    /// `s` (rows from `t0` on) is given, its entries `s[(t - t0) p + k]` = I_k(t).
    #[inline(always)]
    pub(super) fn exogenous_block(
        &self,
        theta: &[f64],
        u: &[f64],
        t0: usize,
        len: usize,
        scratch: &mut Scratch,
        mut s: Option<&mut [f64]>,
    ) {
        let p = self.terms.len();
        let transposed = self.block() >= 16;
        let Scratch { channels, product, sum } = scratch;
        let rows = len + self.max_lag;
        if transposed {
            transpose(&u[(t0 - self.max_lag) * self.m..(t0 + len) * self.m], self.m, rows, channels);
        }
        let (product, sum) = (&mut product[..len], &mut sum[..len]);
        sum.fill(0.0);
        for &k in &self.exogenous {
            let (taps, gain) = (self.taps(k), theta[k]);
            if transposed {
                let row = |tap: &Tap| &channels[tap.channel * rows + self.max_lag - tap.lag..][..len];
                if s.is_none() {
                    add_rows(taps, row, gain, sum);
                    continue;
                }
                multiply_rows(taps, row, product);
            } else {
                multiply_strided(taps, u, self.m, t0, product);
            }
            for (x, v) in sum.iter_mut().zip(product.iter()) {
                *x += gain * v;
            }
            if let Some(s) = s.as_deref_mut() {
                for (x, v) in s[k..].iter_mut().step_by(p).zip(product.iter()) {
                    *x = *v;
                }
            }
        }
        for term in &self.shaped {
            for (i, x) in sum.iter_mut().enumerate() {
                let v = term.value(self.input_window(u, t0 + i), &[], t0 + i);
                *x += theta[term.k] * v;
                if let Some(s) = s.as_deref_mut() {
                    s[i * p + term.k] = v;
                }
            }
        }
    }
}

/// `sum += gain * product of the taps`, the product not kept.
#[inline(always)]
fn add_rows<'a>(taps: &[Tap], row: impl Fn(&Tap) -> &'a [f64], gain: f64, sum: &mut [f64]) {
    match taps {
        [] => sum.iter_mut().for_each(|x| *x += gain),
        [a] => sum.iter_mut().zip(row(a)).for_each(|(x, a)| *x += gain * a),
        [a, b] => sum.iter_mut().zip(row(a)).zip(row(b)).for_each(|((x, a), b)| *x += gain * (a * b)),
        [a, b, rest @ ..] => {
            // Factors from left to right as in `multiply_rows`, so that both give the same bits.
            let (a, b) = (row(a), row(b));
            for (i, x) in sum.iter_mut().enumerate() {
                *x += gain * rest.iter().fold(a[i] * b[i], |v, tap| v * row(tap)[i]);
            }
        }
    }
}

/// Row-major samples x m to m contiguous channels.
#[inline(always)]
fn transpose(u: &[f64], m: usize, rows: usize, channels: &mut [f64]) {
    for i in 0..m {
        for (x, v) in channels[i * rows..(i + 1) * rows].iter_mut().zip(u[i..].iter().step_by(m)) {
            *x = *v;
        }
    }
}

#[inline(always)]
fn multiply_rows<'a>(taps: &[Tap], row: impl Fn(&Tap) -> &'a [f64], product: &mut [f64]) {
    match taps {
        [] => product.fill(1.0),
        [a] => product.copy_from_slice(row(a)),
        [a, b] => {
            for ((x, a), b) in product.iter_mut().zip(row(a)).zip(row(b)) {
                *x = a * b;
            }
        }
        [a, rest @ ..] => {
            product.copy_from_slice(row(a));
            for tap in rest {
                for (x, v) in product.iter_mut().zip(row(tap)) {
                    *x *= v;
                }
            }
        }
    }
}

#[inline(always)]
fn multiply_strided(taps: &[Tap], u: &[f64], m: usize, t0: usize, product: &mut [f64]) {
    product.fill(1.0);
    for tap in taps {
        let channel = u[(t0 - tap.lag) * m + tap.channel..].iter().step_by(m);
        for (x, v) in product.iter_mut().zip(channel) {
            *x *= v;
        }
    }
}

/// x^n for small n.
pub(super) fn power(x: f64, n: u32) -> f64 {
    match n {
        0 => 1.0,
        1 => x,
        2 => x * x,
        _ => x.powi(n as i32),
    }
}

/// dO/dy(t - lag_i) of a product of output factors.
pub(super) fn first_derivative(factors: &[OutputFactor], i: usize, y: &[f64], t: usize) -> f64 {
    factors.iter().enumerate().fold(1.0, |x, (j, f)| {
        let v = y[t - f.lag];
        x * if i == j { f64::from(f.power) * power(v, f.power - 1) } else { power(v, f.power) }
    })
}

/// d2O/dy(t - lag_i)dy(t - lag_j).
pub(super) fn second_derivative(factors: &[OutputFactor], i: usize, j: usize, y: &[f64], t: usize) -> f64 {
    factors.iter().enumerate().fold(1.0, |x, (l, f)| {
        let v = y[t - f.lag];
        let n = f64::from(f.power);
        x * match (l == i, l == j) {
            (true, true) if f.power < 2 => 0.0,
            (true, true) => n * (n - 1.0) * power(v, f.power - 2),
            (false, false) => power(v, f.power),
            _ => n * power(v, f.power - 1),
        }
    })
}
