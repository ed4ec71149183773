//! A table from look-ups that an ECU has cut to whole steps: each sample is an interval, not a number.
//!
//! ```text
//! minimise  sum_k (cut_k + step / 2 - a_k'theta)^2     subject to   cut_k - slack <= a_k'theta <= cut_k + step + slack   for each k
//! ```
//!
//! With the rows of [`enter_eight_bits`] the intervals are those of the ECU itself: an open ECU looks a table up in whole numbers,
//!
//! ```text
//! s = floor(256 (x - x_i) / (x_i+1 - x_i)),   w = floor((a b + 128) / 256)  for a in {256 - s_x, s_x}, b in {256 - s_y, s_y}
//! look-up = floor(sum w cell / 256)
//! ```
//!
//! which gives the logged value of every sample of three drives of a real car (Speeduino 2025.01), where weights that are not cut give
//! 90 to 99 % of them.
//!
//! Least squares alone treat what is cut off as noise; where few states were visited often it is none. Where cells were edited while
//! the log ran no table keeps all intervals: [`longest`] finds how far one does.

use crate::error::LabelError;
use crate::label::{Label, Limit};
use crate::linear::{Options, Problem, fit as least_squares};
use crate::qp;
use crate::rows::{Rows, between};

/// Weight of the least-squares solution of a cell that the intervals leave open, as a share of the mean diagonal.
const TIE: f64 = 1e-9;

/// What an ECU has cut.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cut {
    /// Step of the look-up.
    pub step: f64,
    /// What the ECU's own arithmetic may add on either side: fractions of eight bits between breakpoints.
    pub slack: f64,
}

/// Adds `label` at `at` to the last row as an ECU interpolates that holds shares and weights in eight bits.
pub fn enter_eight_bits(label: &Label, rows: &mut Rows, offset: usize, at: &[f64]) {
    let share = |k: usize| {
        let points = &label.axes[k].points;
        let (i, s) = between(points, at[k]);
        // From the place itself: a share that was divided before may lie a rounding below a whole number.
        let inside = s > 0.0 && s < 1.0;
        (
            i,
            if inside {
                (256.0 * (at[k] - points[i]) / (points[i + 1] - points[i])).floor()
            } else {
                256.0 * s
            },
        )
    };
    let weight = |a: f64, b: f64| ((a * b + 128.0) / 256.0).floor() / 256.0;
    match label.axes.len() {
        0 => rows.push(offset, 1.0),
        1 => {
            let (i, s) = share(0);
            rows.push(offset + i, (256.0 - s) / 256.0);
            rows.push(offset + i + 1, s / 256.0);
        }
        _ => {
            let ((i, s), (j, r)) = (share(0), share(1));
            let n = label.axes[0].points.len();
            let corner = offset + j * n + i;
            rows.push(corner, weight(256.0 - s, 256.0 - r));
            rows.push(corner + 1, weight(s, 256.0 - r));
            rows.push(corner + n, weight(256.0 - s, r));
            rows.push(corner + n + 1, weight(s, r));
        }
    }
}

/// The cells of `label` by whose interpolation (`rows`) each look-up lies in the interval that was left of it (`cut`); cells without
/// data keep their base.
///
/// # Errors
/// [`LabelError::Contradiction`] names a sample that cannot be kept with the others; else as [`crate::linear::fit`].
pub fn fit(label: &Label, rows: &Rows, cut: &[f64], by: Cut) -> Result<Vec<f64>, LabelError> {
    let middle: Vec<f64> = cut.iter().map(|c| c + 0.5 * by.step).collect();
    let plain = Label { step: None, ..label.clone() };
    let problem = Problem::new(std::slice::from_ref(&plain), rows, &middle);
    let open = Options { smooth: Some(0.0), least_visits: 0.0, ..Options::default() };
    let start = least_squares(&problem, &open)?;
    let mut number = vec![None; label.len()];
    let seen: Vec<usize> = (0..label.len()).filter(|k| start.visits[*k] > 0.0 && !label.locked[*k]).collect();
    seen.iter().enumerate().for_each(|(f, k)| number[*k] = Some(f));
    let n = seen.len();
    let (mut h, mut limits) = (vec![0.0; n * n], Vec::with_capacity(2 * cut.len()));
    for k in 0..cut.len() {
        let (at, weights) = rows.row(k);
        let terms: Vec<(usize, f64)> =
            at.iter().zip(weights).filter_map(|(j, w)| number[*j].map(|f| (f, *w))).collect();
        for &(i, a) in &terms {
            terms.iter().filter(|(j, _)| *j >= i).for_each(|(j, b)| h[i * n + j] += a * b);
        }
        // As changes from the least-squares solution.
        let now = rows.times(k, &start.exact);
        let what = format!("sample {k}: a look-up that was cut to {}", cut[k]);
        let above = Limit { terms, least: cut[k] - by.slack - now, what };
        let below = Limit {
            terms: above.terms.iter().map(|(f, w)| (*f, -w)).collect(),
            least: now - cut[k] - by.step - by.slack,
            what: above.what.clone(),
        };
        limits.extend([above, below]);
    }
    let mean = (0..n).map(|f| h[f * n + f]).sum::<f64>() / n.max(1) as f64;
    (0..n).for_each(|f| h[f * n + f] += TIE * mean);
    let moved = qp::solve(&h, &vec![0.0; n], &limits)?.x;
    let mut out = start.exact;
    seen.iter().zip(moved).for_each(|(k, d)| out[*k] += d);
    Ok(out)
}

/// How many of the first samples one table explains, and that table.
///
/// # Errors
/// As [`fit`], where not even one sample can be explained.
pub fn longest(label: &Label, rows: &Rows, cut: &[f64], by: Cut) -> Result<(usize, Vec<f64>), LabelError> {
    let of = |n: usize| {
        let mut part = Rows::default();
        for k in 0..n {
            part.start();
            let (at, weights) = rows.row(k);
            at.iter().zip(weights).for_each(|(j, w)| part.push(*j, *w));
        }
        fit(label, &part, &cut[..n], by)
    };
    match of(cut.len()) {
        Err(LabelError::Contradiction { .. }) if cut.len() > 1 => {}
        other => return other.map(|t| (cut.len(), t)),
    }
    // What explains more samples explains fewer: the end is found by halving.
    let (mut good, mut bad) = ((1, of(1)?), cut.len());
    while bad - good.0 > 1 {
        let middle = good.0 + (bad - good.0) / 2;
        match of(middle) {
            Ok(table) => good = (middle, table),
            Err(LabelError::Contradiction { .. } | LabelError::Singular(_)) => bad = middle,
            Err(e) => return Err(e),
        }
    }
    Ok(good)
}
