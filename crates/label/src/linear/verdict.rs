//! What the data say of each cell.

use dynocal_numerics::linalg;

use super::normal::{Normal, Smooth};
use super::{Problem, Verdict, offsets};
use crate::error::LabelError;

/// Independent measurements at the cell itself from which it may be called determined.
const DETERMINED: f64 = 1.0;
/// Two-sided 95 % of the normal distribution.
const Z95: f64 = 1.959_963_984_540_054;

pub(super) struct Told {
    pub(super) half_width: Vec<f64>,
    pub(super) facts: Vec<f64>,
    pub(super) verdicts: Vec<Verdict>,
    pub(super) sigma: f64,
}

/// Samples at each cell: a sample between cells is shared out by its interpolation weights.
pub(super) fn visits(p: &Problem, cells: usize) -> Vec<f64> {
    let (first, _) = offsets(p.labels);
    let mut owner = vec![0; cells];
    for (number, (l, from)) in p.labels.iter().zip(first).enumerate() {
        owner[from..from + l.len()].fill(number);
    }
    let mut out = vec![0.0; cells];
    let mut sums = vec![0.0; p.labels.len()];
    for k in (0..p.rows.len()).filter(|k| p.weights.is_none_or(|w| w[*k] > 0.0)) {
        let (at, weight) = p.rows.row(k);
        at.iter().for_each(|j| sums[owner[*j]] = 0.0);
        at.iter().zip(weight).for_each(|(j, w)| sums[owner[*j]] += w.abs());
        at.iter().zip(weight).for_each(|(j, w)| out[*j] += w.abs() / sums[owner[*j]]);
    }
    out
}

/// Intervals from `tau sigma^2 H^-1`, the posterior with the roughness as what is known before (G. Wahba, Bayesian confidence
/// intervals for the cross-validated smoothing spline, J. Roy. Stat. Soc. B 45 (1983), 133-150). The facts of cell i
/// are `G_ii / tau` in measurements at the cell itself; it is determined where these are one or more and outweigh what ties it to its
/// neighbours and its base, `G_ii >= H_ii - G_ii`.
pub(super) fn tell(
    normal: &Normal,
    h: &[f64],
    found: &Smooth,
    tau: f64,
    map: &[Option<usize>],
    locked: &[bool],
    visits: &[f64],
) -> Result<Told, LabelError> {
    let n = normal.n;
    let inverse = diagonal_of_inverse(h, n)?;
    let (mut half_width, mut facts) = (vec![f64::INFINITY; map.len()], vec![0.0; map.len()]);
    let mut verdicts = vec![Verdict::Untouched; map.len()];
    for k in 0..map.len() {
        if locked[k] {
            verdicts[k] = Verdict::Locked;
            half_width[k] = 0.0;
        }
        let Some(f) = map[k] else { continue };
        half_width[k] = Z95 * (tau * found.variance * inverse[f]).sqrt();
        // In samples: a measurement at the cell itself has the weight that its own equation has for each visit.
        let own = normal.g[f * n + f];
        let each = if visits[k] > 0.0 { normal.mean_weight[f] } else { 0.0 };
        facts[k] = if each > 0.0 { own / (tau * each) } else { 0.0 };
        verdicts[k] = if visits[k] <= 0.0 {
            Verdict::Untouched
        } else if facts[k] >= DETERMINED && 2.0 * own >= h[f * n + f] {
            Verdict::Determined
        } else {
            Verdict::Pulled
        };
    }
    Ok(Told { half_width, facts, verdicts, sigma: found.variance.sqrt() })
}

fn diagonal_of_inverse(h: &[f64], n: usize) -> Result<Vec<f64>, LabelError> {
    let singular = |e: linalg::LinalgError| LabelError::Singular(e.to_string());
    let mut r = h.to_vec();
    linalg::cholesky(&mut r, n).map_err(singular)?;
    let (mut work, mut inverse) = (vec![0.0; n * n], vec![0.0; n * n]);
    linalg::cholesky_inverse(&r, n, &mut work, &mut inverse).map_err(singular)?;
    Ok((0..n).map(|k| inverse[k * n + k]).collect())
}
