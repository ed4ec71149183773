//! What the data say of each cell.

use dynocal_numerics::linalg;

use super::normal::{Normal, Smooth};
use super::{Problem, Verdict, offsets};
use crate::error::LabelError;

/// Independent measurements that must tell of a cell, whatever its neighbours are, to call it determined.
const DETERMINED: f64 = 3.0;
/// What is added to the data so that cells which they do not tell apart have an inverse, as a share of the mean weight.
const RIDGE: f64 = 1e-9;
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
/// intervals for the cross-validated smoothing spline, J. Roy. Stat. Soc. B 45 (1983), 133-150). The facts of cell i are
/// `1 / (tau (G^-1)_ii)`: how many independent measurements tell of it where nothing is known of its neighbours, and nothing is smooth.
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
    let mean = (0..n).map(|k| normal.g[k * n + k]).sum::<f64>() / n as f64;
    let mut alone = normal.g.clone();
    (0..n).for_each(|k| alone[k * n + k] += RIDGE * mean);
    let alone = diagonal_of_inverse(&alone, n)?;
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
        facts[k] = if own > 0.0 && each > 0.0 { 1.0 / (tau * alone[f] * each) } else { 0.0 };
        verdicts[k] = if visits[k] <= 0.0 {
            Verdict::Untouched
        } else if facts[k] >= DETERMINED {
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
