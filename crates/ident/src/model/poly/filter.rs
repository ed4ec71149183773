//! The recursion of a structure whose output terms are plain y(t - lag): one filter 1/A(q) with constant coefficients, which
//! the output and all its sensitivities share.
//!
//! ```text
//! y(t) = x(t) + sum_j a_j y(t-j)          s_k(t) = phi_k(t) + sum_j a_j s_k(t-j)
//! ```
//!
//! Where the lags are 1 to L, with L at most four, the past stays in registers.

use super::program::{MAX_OUTPUT_LAGS, Program};

/// Coefficients of the filter by output lag.
pub(super) struct Filter<'a> {
    lags: &'a [usize],
    a: [f64; MAX_OUTPUT_LAGS],
    /// Whether the lags are 1, 2, ..
    contiguous: bool,
}

impl<'a> Filter<'a> {
    /// `None` when inputs or outputs move a coefficient, or nothing recurs.
    pub(super) fn of(program: &'a Program, theta: &[f64]) -> Option<Self> {
        let plain = program.general.is_empty()
            && program.shaped_recursive.is_empty()
            && program.linear.iter().all(|term| program.taps(term.k).is_empty());
        if !plain || program.linear.is_empty() {
            return None;
        }
        let (mut a, lags) = ([0.0; MAX_OUTPUT_LAGS], program.output_lags.as_slice());
        program.linear.iter().for_each(|term| a[term.slot] += theta[term.k]);
        Some(Self { lags, a, contiguous: lags.iter().enumerate().all(|(j, lag)| *lag == j + 1) })
    }

    /// Filters `x` to `y[t0..]`; what stands before is the past.
    #[inline(always)]
    pub(super) fn output(&self, x: &[f64], y: &mut [f64], t0: usize) {
        match (self.contiguous, self.lags.len()) {
            (true, 1) => self.short::<1>(x, y, t0),
            (true, 2) => self.short::<2>(x, y, t0),
            (true, 3) => self.short::<3>(x, y, t0),
            (true, 4) => self.short::<4>(x, y, t0),
            _ => {
                for (t, x) in (t0..t0 + x.len()).zip(x) {
                    y[t] = self.one(*x, y, t);
                }
            }
        }
    }

    /// `x + sum_j a_j y(t-j)`, the newest output last: only that product and sum wait for the sample before.
    #[inline(always)]
    pub(super) fn one(&self, x: f64, y: &[f64], t: usize) -> f64 {
        self.lags.iter().zip(&self.a).rev().fold(x, |sum, (lag, a)| sum + a * y[t - lag])
    }

    #[inline(always)]
    fn short<const L: usize>(&self, x: &[f64], y: &mut [f64], t0: usize) {
        let mut past = [0.0; L];
        (0..L).for_each(|j| past[j] = y[t0 - 1 - j]);
        for (y, x) in y[t0..].iter_mut().zip(x) {
            let now = (0..L).rev().fold(*x, |sum, j| sum + self.a[j] * past[j]);
            // Not `copy_within`, which would keep the past in memory.
            (1..L).rev().for_each(|j| past[j] = past[j - 1]);
            past[0] = now;
            *y = now;
        }
    }

    /// Filters the `rows` rows of p columns from `s[at..]` on in place; the rows before are the past.
    #[inline(always)]
    pub(super) fn rows(&self, s: &mut [f64], at: usize, rows: usize, p: usize) {
        match (self.contiguous, self.lags.len()) {
            (true, 1) => short_rows::<1>(&self.a, s, at, rows, p),
            (true, 2) => short_rows::<2>(&self.a, s, at, rows, p),
            (true, 3) => short_rows::<3>(&self.a, s, at, rows, p),
            (true, 4) => short_rows::<4>(&self.a, s, at, rows, p),
            _ => (0..rows).for_each(|i| add_past_rows(s, at + i * p, p, self.lags, &self.a)),
        }
    }
}

/// Eight columns at a time, then four, then one.
#[inline(always)]
fn short_rows<const L: usize>(a: &[f64], s: &mut [f64], at: usize, rows: usize, p: usize) {
    let mut k = 0;
    while k + 8 <= p {
        short_columns::<L, 8>(a, s, at + k, rows, p);
        k += 8;
    }
    while k + 4 <= p {
        short_columns::<L, 4>(a, s, at + k, rows, p);
        k += 4;
    }
    while k < p {
        short_columns::<L, 1>(a, s, at + k, rows, p);
        k += 1;
    }
}

#[inline(always)]
fn short_columns<const L: usize, const W: usize>(a: &[f64], s: &mut [f64], at: usize, rows: usize, p: usize) {
    let mut past = [[0.0; W]; L];
    for (j, past) in past.iter_mut().enumerate() {
        past.copy_from_slice(&s[at - (j + 1) * p..][..W]);
    }
    for row in s[at..].chunks_mut(p).take(rows) {
        let Some(now) = row.first_chunk_mut::<W>() else { return };
        let mut sum = *now;
        for j in (0..L).rev() {
            for i in 0..W {
                sum[i] += a[j] * past[j][i];
            }
        }
        (1..L).rev().for_each(|j| past[j] = past[j - 1]);
        past[0] = sum;
        *now = sum;
    }
}

/// `s(t) += sum_j a_j s(t - lag_j)` for the row of p at `row`: eight columns at a time, then four, then one.
#[inline(always)]
pub(super) fn add_past_rows(s: &mut [f64], row: usize, p: usize, lags: &[usize], a: &[f64]) {
    let mut k = 0;
    while k + 8 <= p {
        add_past::<8>(s, row + k, p, lags, a);
        k += 8;
    }
    while k + 4 <= p {
        add_past::<4>(s, row + k, p, lags, a);
        k += 4;
    }
    while k < p {
        add_past::<1>(s, row + k, p, lags, a);
        k += 1;
    }
}

/// [`add_past_rows`] for the W columns at `at`, held in registers meanwhile.
#[inline(always)]
fn add_past<const W: usize>(s: &mut [f64], at: usize, p: usize, lags: &[usize], a: &[f64]) {
    let (past, now) = s.split_at_mut(at);
    let Some(now) = now.first_chunk_mut::<W>() else { return };
    let mut sum = *now;
    for (lag, a) in lags.iter().zip(a).rev() {
        let Some(earlier) = past[at - lag * p..].first_chunk::<W>() else { return };
        for i in 0..W {
            sum[i] += a * earlier[i];
        }
    }
    *now = sum;
}
