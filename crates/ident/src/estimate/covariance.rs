//! Covariance of the parameters from the Jacobian J of the errors e.
//!
//! ```text
//! white     s2 (J'J)^-1,                                      s2 = |e|^2 / (n - p)
//! robust    n/(n-p) (J'J)^-1 M (J'J)^-1
//!           M = J' R J,  R the covariance of the errors' autoregressive description      rows of inputs only
//!           M = sum_k (1 - |k|/(L+1)) sum_t g(t) g(t-k)',  g(t) = J(t)' e(t)             else
//! ```
//!
//! Sensitivities of a free run, and regressors without outputs, depend on inputs only, so that the errors' own
//! autocovariance is all that is needed; regressors with measured outputs depend on the errors, so that products of both are
//! summed (Newey and West). The lags L follow from Andrews' rule for that kernel, `L + 1 = 1.1447 (alpha n)^(1/3)`, with alpha
//! from first-order autoregressions of the components of g.
//!
//! A ridge adds its diagonal to the outer J'J. Neither needs J whole: it comes in blocks, twice for the robust one.
//!
//! Reference: W. K. Newey, K. D. West, Econometrica 55 (1987), 703-708; D. W. K. Andrews, Econometrica 59 (1991),
//! 817-858; L. Ljung, System Identification (1999), section 9.3 and (for coloured errors) 9.4.

use dynocal_numerics::linalg::{
    GramRows, LinalgError, PivotedR, QrRows, dot, invert_upper, pivoted_from_gram,
};
use serde::{Deserialize, Serialize};

use super::cost::Cost;
use super::noise::{self, Autoregression, Residuals};

/// Rows from which blocks are made.
const BLOCK: usize = 64;

/// What the covariance assumes of the errors: the choice of a spec.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CovarianceChoice {
    /// Nothing correlated.
    White,
    /// Correlated over time.
    Robust,
    /// Robust where a test calls the errors coloured, else white.
    #[default]
    Auto,
}

/// Which covariance a fit states.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CovarianceKind {
    /// `s2 (J'J)^-1`, for white errors.
    #[default]
    White,
    /// The sandwich, for coloured errors.
    Robust,
}

/// Takes `(record, errors, rows of the Jacobian)`.
pub(super) type TakeRows<'a> = dyn FnMut(usize, &[f64], &[f64]) + 'a;

/// What the rows of a Jacobian are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Rows {
    /// Regressors: the data's own, whatever the estimate.
    Regressors,
    /// Sensitivities of the errors, which hold at the estimate.
    Sensitivities,
}

/// Errors and their Jacobian at the estimate, in order of time, record by record; rows that are not scored are zero.
pub(super) trait Evidence {
    /// Number of parameters.
    fn params(&self) -> usize;
    /// Whether the rows depend on inputs only, so that errors and rows are independent.
    fn exogenous(&self) -> bool;
    /// What the rows are.
    fn rows(&self) -> Rows;
    /// Roots of the diagonal that a ridge adds to J'J; empty without one.
    fn penalties(&self) -> &[f64] {
        &[]
    }
    /// Calls `take(record, errors, rows of the Jacobian)` for consecutive blocks.
    fn visit(&mut self, take: &mut TakeRows<'_>);
}

/// Evidence that is stored whole.
pub(super) struct Stored<'a> {
    pub(super) errors: &'a [f64],
    pub(super) jacobian: &'a [f64],
    pub(super) params: usize,
    /// Rows of each record.
    pub(super) records: Vec<usize>,
    pub(super) penalties: &'a [f64],
    pub(super) exogenous: bool,
    pub(super) rows: Rows,
}

impl Evidence for Stored<'_> {
    fn params(&self) -> usize {
        self.params
    }

    fn exogenous(&self) -> bool {
        self.exogenous
    }

    fn rows(&self) -> Rows {
        self.rows
    }

    fn penalties(&self) -> &[f64] {
        self.penalties
    }

    fn visit(&mut self, take: &mut TakeRows<'_>) {
        let (p, mut row) = (self.params, 0);
        for (record, rows) in self.records.iter().enumerate() {
            let end = row + rows;
            take(record, &self.errors[row..end], &self.jacobian[row * p..end * p]);
            row = end;
        }
    }
}

/// What is known of an estimate.
pub(super) struct Uncertainty {
    pub(super) covariance: Vec<f64>,
    pub(super) std_errors: Vec<f64>,
    pub(super) kind: CovarianceKind,
    pub(super) residuals: Residuals,
    pub(super) factor: PivotedR,
    /// Sum of the squared errors.
    pub(super) sum_squares: f64,
    pub(super) noise_variance: f64,
}

/// Covariance of the parameters under `cost`, with the tests of the errors that choose it.
pub(super) fn uncertainty(
    evidence: &mut dyn Evidence,
    samples: usize,
    choice: CovarianceChoice,
    cost: Cost,
) -> Result<Uncertainty, LinalgError> {
    let p = evidence.params();
    let (mut errors, factor) = gather(evidence)?;
    let sum_squares = errors.iter().map(|e| dot(e, e)).sum();
    let free = (samples - factor.rank.min(samples)).max(1) as f64;
    if !cost.is_squared() {
        let mut all: Vec<f64> = errors.iter().flatten().copied().collect();
        cost.pseudo_values(&mut all, p);
        let mut rest = all.as_slice();
        for e in &mut errors {
            let (head, tail) = rest.split_at(e.len());
            e.copy_from_slice(head);
            rest = tail;
        }
    }
    let noise_variance = errors.iter().map(|e| dot(e, e)).sum::<f64>() / free;
    let (residuals, ar) = noise::describe(errors.iter().map(Vec::as_slice));
    let robust = match choice {
        CovarianceChoice::White => false,
        CovarianceChoice::Robust => true,
        CovarianceChoice::Auto => residuals.coloured,
    };
    let (kind, covariance) = if robust {
        let white = White { factor: &factor };
        let meat = if evidence.exogenous() {
            filtered_meat(evidence, &ar, white)
        } else {
            score_meat(evidence, &errors, white)
        };
        let gain = samples as f64 / free;
        let sandwich = covariance_of(&factor, &meat, p)?;
        (CovarianceKind::Robust, sandwich.into_iter().map(|v| gain * v).collect())
    } else {
        let bread = inverse(&factor, p)?;
        (CovarianceKind::White, bread.iter().map(|v| noise_variance * v).collect::<Vec<f64>>())
    };
    let mut std_errors = vec![f64::NAN; p];
    for &k in &factor.order[..factor.rank] {
        // What rounding left below zero is not known, and no certainty.
        std_errors[k] = covariance[k * p + k].sqrt();
    }
    Ok(Uncertainty { covariance, std_errors, kind, residuals, factor, sum_squares, noise_variance })
}

/// Errors of each record and the factor of the Jacobian: from J'J where that keeps enough digits, else by QR.
fn gather(evidence: &mut dyn Evidence) -> Result<(Vec<Vec<f64>>, PivotedR), LinalgError> {
    let p = evidence.params();
    let mut errors: Vec<Vec<f64>> = Vec::new();
    let (mut gram, mut fault) = (GramRows::new(p), None);
    evidence.visit(&mut |record, e, rows| {
        errors.resize_with(errors.len().max(record + 1), Vec::new);
        errors[record].extend_from_slice(e);
        fault = fault.take().or(gram.push(rows).err());
    });
    if let Some(fault) = fault {
        return Err(fault);
    }
    for (k, w) in evidence.penalties().iter().enumerate() {
        gram.gram[k * p + k] += w * w;
    }
    if let Some(factor) = pivoted_from_gram(&gram.gram, p) {
        return Ok((errors, factor));
    }
    let (mut qr, mut fault) = (QrRows::new(p), None);
    evidence.visit(&mut |_, _, rows| fault = fault.take().or(qr.push(rows).err()));
    for (k, w) in evidence.penalties().iter().enumerate() {
        let mut row = vec![0.0; p];
        row[k] = *w;
        fault = fault.take().or(qr.push(&row).err());
    }
    match fault {
        Some(fault) => Err(fault),
        None => Ok((errors, qr.pivoted()?)),
    }
}

/// `(J'J)^-1` (p x p, row-major) from a pivoted factorisation of J in unit column scaling; zero rows and columns for
/// dependent parameters.
pub(super) fn inverse(factor: &PivotedR, p: usize) -> Result<Vec<f64>, LinalgError> {
    let rank = factor.rank;
    let mut unit = vec![0.0; rank * rank];
    (0..rank).for_each(|i| unit[i * rank + i] = 1.0);
    covariance_of(factor, &unit, p)
}

/// `R^-1 W R^-T` in the parameters' own units (p x p), zero for dependent ones.
///
/// `W = sum v v'` of the rows [`White`] is the sandwich's middle where J'J is the unit matrix: no digits of an
/// ill-conditioned J cancel, as they do in `(J'J)^-1 M (J'J)^-1`, whose diagonal can come out negative.
fn covariance_of(factor: &PivotedR, w: &[f64], p: usize) -> Result<Vec<f64>, LinalgError> {
    let rank = factor.rank;
    let mut r = vec![0.0; rank * rank];
    for i in 0..rank {
        r[i * rank..(i + 1) * rank].copy_from_slice(&factor.r[i * p..i * p + rank]);
    }
    let mut inverse = vec![0.0; rank * rank];
    invert_upper(&r, rank, &mut inverse)?;
    // Rows of R^-1 W, then of R^-1 W R^-T; R^-1 is an upper triangle.
    let mut half = vec![0.0; rank * rank];
    for (row, out) in inverse.chunks_exact(rank.max(1)).zip(half.chunks_exact_mut(rank.max(1))) {
        for (a, w) in row.iter().zip(w.chunks_exact(rank.max(1))).filter(|(a, _)| **a != 0.0) {
            out.iter_mut().zip(w).for_each(|(o, w)| *o += a * w);
        }
    }
    let mut out = vec![0.0; p * p];
    for i in 0..rank {
        for j in i..rank {
            let (a, b) = (factor.order[i], factor.order[j]);
            let sum = dot(&half[i * rank + j..(i + 1) * rank], &inverse[j * rank + j..(j + 1) * rank]);
            let value = sum / (factor.scale[a] * factor.scale[b]);
            (out[a * p + b], out[b * p + a]) = (value, value);
        }
    }
    Ok(out)
}

/// Rows of the Jacobian in coordinates in which `J'J` is the unit matrix: `v = R^-T P' D^-1 row` (rank).
#[derive(Clone, Copy)]
struct White<'a> {
    factor: &'a PivotedR,
}

impl White<'_> {
    fn rank(self) -> usize {
        self.factor.rank
    }

    fn row(self, row: &[f64], v: &mut [f64]) {
        let (p, f) = (row.len(), self.factor);
        for (x, k) in v.iter_mut().zip(&f.order) {
            *x = row[*k] / f.scale[*k];
        }
        // R' v = x, row by row of R: the diagonal of a pivoted factor is not zero within its rank.
        for i in 0..v.len() {
            v[i] /= f.r[i * p + i];
            let (done, rest) = v.split_at_mut(i + 1);
            let ahead = &f.r[i * p + i + 1..i * p + i + 1 + rest.len()];
            rest.iter_mut().zip(ahead).for_each(|(x, r)| *x -= r * done[i]);
        }
    }
}

/// J' R J in white coordinates, R the covariance of the autoregression: rows filtered by `1/A(q)`, each record run out to its end.
fn filtered_meat(evidence: &mut dyn Evidence, ar: &Autoregression, white: White) -> Vec<f64> {
    let p = evidence.params();
    let mut sum = Squares::new(white);
    let mut filter = Filter { a: &ar.a, past: vec![0.0; ar.a.len() * p], next: 0, row: vec![0.0; p] };
    let mut current = 0;
    evidence.visit(&mut |record, _, rows| {
        if record != current {
            filter.run_out(p, &mut sum);
            current = record;
        }
        for row in rows.chunks_exact(p.max(1)) {
            filter.step(row, p, &mut sum);
        }
    });
    filter.run_out(p, &mut sum);
    sum.finish().into_iter().map(|v| ar.variance * v).collect()
}

/// x(t) = J(t) + sum_j a_j x(t-j) over rows, with the last rows in a ring.
struct Filter<'a> {
    a: &'a [f64],
    past: Vec<f64>,
    next: usize,
    row: Vec<f64>,
}

impl Filter<'_> {
    fn step(&mut self, row: &[f64], p: usize, sum: &mut Squares<'_>) {
        self.row.copy_from_slice(row);
        let order = self.a.len();
        for (j, a) in self.a.iter().enumerate() {
            let at = (self.next + order - 1 - j) % order;
            for (x, v) in self.row.iter_mut().zip(&self.past[at * p..(at + 1) * p]) {
                *x += a * v;
            }
        }
        if order > 0 {
            self.past[self.next * p..(self.next + 1) * p].copy_from_slice(&self.row);
            self.next = (self.next + 1) % order;
        }
        sum.add(&self.row);
    }

    /// Lets the filter ring until nothing is left of it, then clears it.
    fn run_out(&mut self, p: usize, sum: &mut Squares<'_>) {
        let zeros = vec![0.0; p];
        let start = self.past.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
        for _ in 0..100_000 {
            if self.past.iter().all(|v| v.abs() <= 1e-6 * start) {
                break;
            }
            self.step(&zeros, p, sum);
        }
        self.past.fill(0.0);
    }
}

/// Newey-West sum over lags of the products of scores: squares of sums over L + 1 neighbours, over L + 1.
fn score_meat(evidence: &mut dyn Evidence, errors: &[Vec<f64>], white: White) -> Vec<f64> {
    let p = evidence.params();
    let width = lags(evidence, errors) + 1;
    let mut sum = Squares::new(white);
    let mut window = Window { ring: vec![0.0; width * p], next: 0, total: vec![0.0; p] };
    let (mut current, mut t) = (0, 0);
    evidence.visit(&mut |record, _, rows| {
        if record != current {
            window.run_out(width, p, &mut sum);
            (current, t) = (record, 0);
        }
        for row in rows.chunks_exact(p.max(1)) {
            window.step(row, errors[record][t], width, p, &mut sum);
            t += 1;
        }
    });
    window.run_out(width, p, &mut sum);
    sum.finish().into_iter().map(|v| v / width as f64).collect()
}

/// Sum of the last `width` scores.
struct Window {
    ring: Vec<f64>,
    next: usize,
    total: Vec<f64>,
}

impl Window {
    fn step(&mut self, row: &[f64], e: f64, width: usize, p: usize, sum: &mut Squares<'_>) {
        let old = &mut self.ring[self.next * p..(self.next + 1) * p];
        for ((total, old), v) in self.total.iter_mut().zip(old).zip(row) {
            *total += v * e - *old;
            *old = v * e;
        }
        self.next = (self.next + 1) % width;
        sum.add(&self.total);
    }

    fn run_out(&mut self, width: usize, p: usize, sum: &mut Squares<'_>) {
        let zeros = vec![0.0; p];
        for _ in 1..width {
            self.step(&zeros, 0.0, width, p, sum);
        }
        self.ring.fill(0.0);
        self.total.fill(0.0);
        self.next = 0;
    }
}

/// Andrews' number of lags for the triangular kernel.
fn lags(evidence: &mut dyn Evidence, errors: &[Vec<f64>]) -> usize {
    let p = evidence.params();
    let (mut square, mut cross, mut past) = (vec![0.0; p], vec![0.0; p], vec![0.0; p]);
    let (mut current, mut t, mut n) = (0, 0, 0usize);
    evidence.visit(&mut |record, _, rows| {
        if record != current {
            (current, t) = (record, 0);
            past.fill(0.0);
        }
        for row in rows.chunks_exact(p.max(1)) {
            let e = errors[record][t];
            for k in 0..p {
                let g = row[k] * e;
                square[k] += g * g;
                cross[k] += g * past[k];
                past[k] = g;
            }
            n += usize::from(e != 0.0);
            t += 1;
        }
    });
    let (mut above, mut below) = (0.0, 0.0);
    for (s, c) in square.iter().zip(&cross).filter(|(s, _)| **s > 0.0) {
        let rho = (c / s).clamp(-0.97, 0.97);
        // Each component relative to its own variance, so that units do not weigh.
        let variance = (1.0 - rho * rho).powi(2);
        above += 4.0 * rho * rho * variance / ((1.0 - rho).powi(6) * (1.0 + rho).powi(2));
        below += variance / (1.0 - rho).powi(4);
    }
    let alpha = if below > 0.0 { above / below } else { 0.0 };
    ((1.1447 * (alpha * n as f64).cbrt()) as usize).min(n / 4)
}

/// Sum of squares of rows in white coordinates, gathered in blocks.
struct Squares<'a> {
    white: White<'a>,
    block: Vec<f64>,
    gram: GramRows,
}

impl<'a> Squares<'a> {
    fn new(white: White<'a>) -> Self {
        let rank = white.rank();
        Self { white, block: Vec::with_capacity(BLOCK * rank), gram: GramRows::new(rank) }
    }

    fn add(&mut self, row: &[f64]) {
        let (rank, from) = (self.white.rank(), self.block.len());
        self.block.resize(from + rank, 0.0);
        self.white.row(row, &mut self.block[from..]);
        if self.block.len() >= BLOCK * rank {
            self.flush();
        }
    }

    fn flush(&mut self) {
        self.gram.push(&self.block).expect("whole rows");
        self.block.clear();
    }

    /// Both triangles of the sum.
    fn finish(mut self) -> Vec<f64> {
        self.flush();
        let (rank, mut full) = (self.white.rank(), self.gram.gram);
        for i in 0..rank {
            for j in 0..i {
                full[i * rank + j] = full[j * rank + i];
            }
        }
        full
    }
}
