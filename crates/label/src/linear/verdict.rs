//! What the data say of each cell.

use dynocal_numerics::linalg;
use statrs::distribution::{ContinuousCDF, StudentsT};

use super::normal::{Normal, Smooth};
use super::{Problem, Verdict, offsets};
use crate::correlation;
use crate::error::LabelError;

/// Independent measurements at the cell itself from which it may be called determined.
const DETERMINED: f64 = 1.0;
/// Samples from which is taken how much of the correlation the fit itself takes away.
const OVERLAPS: usize = 1000;

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
        let seen = at.iter().zip(weight).filter(|(j, _)| sums[owner[**j]] > 0.0);
        seen.for_each(|(j, w)| out[*j] += w.abs() / sums[owner[*j]]);
    }
    out
}

/// How residuals hang together in time: samples of one fact, the greatest lag that counts, and the residuals.
pub(super) struct Correlated {
    pub(super) tau: f64,
    pub(super) window: usize,
    pub(super) residuals: Vec<f64>,
}

/// Intervals from `tau' sigma^2 H^-1`, the posterior with the roughness as what is known before (G. Wahba, Bayesian confidence
/// intervals for the cross-validated smoothing spline, J. Roy. Stat. Soc. B 45 (1983), 133-150). The facts of cell i
/// are `G_ii / tau` in measurements at the cell itself; it is determined where these are one or more and outweigh what ties it to its
/// neighbours and its base, `G_ii >= H_ii - G_ii`.
///
/// What is left of a fit is less correlated than the noise was: of the sum over the window M, `e'W e`, a fit to regressors Q (orthonormal)
/// takes `trace Q'W Q` of n away, which is added again, `tau' = tau (1 + trace Q'W Q / n)`. And tau is known as well as a variance with
/// `n / (2 M + 1)` degrees of freedom is, so that the factor of 95 % is that of Student's distribution with as many. Of a label that is not
/// smoothed the interval is that of least squares, and the same is asked of its own influence `(H^-1 a w e)(t)`, which may hang together
/// for longer than residuals do on average (W. K. Newey, K. D. West, A simple, positive semi-definite, heteroskedasticity and
/// autocorrelation consistent covariance matrix, Econometrica 55 (1987), 703-708): the longer time counts, with its own degrees of freedom.
pub(super) fn tell(
    p: &Problem,
    weights: &[f64],
    normal: &Normal,
    h: &[f64],
    found: &Smooth,
    correlated: &Correlated,
    map: &[Option<usize>],
    locked: &[bool],
    visits: &[f64],
) -> Result<Told, LabelError> {
    let n = normal.n;
    let inverse = inverse(h, n)?;
    let tau = correlated.tau;
    let taken = overlap(p, weights, map, &inverse, n, correlated.window);
    let shared = (tau, p.target.len() as f64 / (2 * correlated.window + 1) as f64);
    let own = Influence { p, weights, map, inverse: &inverse, n, residuals: &correlated.residuals };
    let (mut half_width, mut facts) = (vec![f64::INFINITY; map.len()], vec![0.0; map.len()]);
    let mut verdicts = vec![Verdict::Untouched; map.len()];
    for k in 0..map.len() {
        if locked[k] {
            verdicts[k] = Verdict::Locked;
            half_width[k] = 0.0;
        }
        let Some(f) = map[k] else { continue };
        let (longer, freedom) = if normal.is_rough(f) { shared } else { own.longer(f, shared) };
        half_width[k] = t95(freedom) * (longer * (1.0 + taken) * found.variance * inverse[f * n + f]).sqrt();
        // In samples: a measurement at the cell itself has the weight that its own equation has for each visit.
        let own = normal.g[f * n + f];
        let each = if visits[k] > 0.0 { normal.mean_weight[f] } else { 0.0 };
        facts[k] = if each > 0.0 { own / (tau * each) } else { 0.0 };
        verdicts[k] = if visits[k] <= 0.0 {
            Verdict::Untouched
        } else if facts[k] >= DETERMINED && 2.0 * own >= h[f * n + f] && own * inverse[f * n + f] <= ALONE {
            Verdict::Determined
        } else {
            Verdict::Pulled
        };
    }
    Ok(Told { half_width, facts, verdicts, sigma: found.variance.sqrt() })
}

/// Factor by which the variance of a cell grows because others are not known either, beyond which only sums with them are known: what makes
/// the cell a number then is what ties it to its neighbours, however weak.
const ALONE: f64 = 1e4;

/// What each sample says of a free cell.
struct Influence<'a> {
    p: &'a Problem<'a>,
    weights: &'a [f64],
    map: &'a [Option<usize>],
    inverse: &'a [f64],
    n: usize,
    residuals: &'a [f64],
}

impl Influence<'_> {
    /// Correlation time of what samples say of cell `f`, with its degrees of freedom, where it is longer than the shared one.
    fn longer(&self, f: usize, shared: (f64, f64)) -> (f64, f64) {
        if self.p.segments.is_empty() {
            return shared;
        }
        let inverse = &self.inverse[f * self.n..(f + 1) * self.n];
        let at = |k: usize| {
            let (at, w) = self.p.rows.row(k);
            let own: f64 = at.iter().zip(w).filter_map(|(j, w)| self.map[*j].map(|g| w * inverse[g])).sum();
            own * self.weights[k] * self.residuals[k]
        };
        let series: Vec<f64> = (0..self.residuals.len()).map(at).collect();
        let (tau, window) = correlation::time_and_window(&series, &self.p.segments);
        let freedom = correlation::freedom(&series, &self.p.segments, 2 * window + 1);
        (tau.max(shared.0), freedom.min(shared.1))
    }
}

/// Two-sided 95 % of Student's distribution.
fn t95(freedom: f64) -> f64 {
    StudentsT::new(0.0, 1.0, freedom.max(1.0)).map_or(f64::INFINITY, |t| t.inverse_cdf(0.975))
}

/// `trace Q'W Q / n` of the regressors, W a window of samples that follow each other within `window`, from some of the samples.
fn overlap(
    p: &Problem,
    weights: &[f64],
    map: &[Option<usize>],
    inverse: &[f64],
    n: usize,
    window: usize,
) -> f64 {
    if window == 0 {
        return 0.0;
    }
    let samples = p.target.len();
    let every = samples.div_ceil(OVERLAPS);
    let row = |k: usize| {
        let (at, w) = p.rows.row(k);
        let root = weights[k].sqrt();
        at.iter().zip(w).filter_map(move |(j, w)| map[*j].map(|f| (f, root * w)))
    };
    let (mut sum, mut count) = (0.0, 0usize);
    for segment in &p.segments {
        for t in segment.clone().filter(|t| t % every == 0) {
            let mut near = vec![0.0; n];
            for s in t.saturating_sub(window).max(segment.start)..(t + window + 1).min(segment.end) {
                row(s).for_each(|(f, w)| near[f] += w);
            }
            sum += row(t).map(|(f, w)| w * linalg::dot(&inverse[f * n..(f + 1) * n], &near)).sum::<f64>();
            count += 1;
        }
    }
    sum / count.max(1) as f64
}

fn inverse(h: &[f64], n: usize) -> Result<Vec<f64>, LabelError> {
    let singular = |e: linalg::LinalgError| LabelError::Singular(e.to_string());
    let mut r = h.to_vec();
    linalg::cholesky(&mut r, n).map_err(singular)?;
    let (mut work, mut inverse) = (vec![0.0; n * n], vec![0.0; n * n]);
    linalg::cholesky_inverse(&r, n, &mut work, &mut inverse).map_err(singular)?;
    // The other triangle.
    (0..n).for_each(|i| (0..i).for_each(|j| inverse[i * n + j] = inverse[j * n + i]));
    Ok(inverse)
}
