//! The equations of the fit, and the weight of the smoothness by generalised cross-validation.

use dynocal_numerics::linalg;

use super::{Options, Problem, Role, offsets};
use crate::error::LabelError;

/// Bounds of the search for the weight of the roughness, as powers of ten, and its steps.
const SMOOTH_FROM: f64 = -8.0;
const SMOOTH_TO: f64 = 4.0;
/// Difference of `n ln V` up to which two weights of the roughness explain the data as well: 95 % of chi-squared with one degree of
/// freedom, as of a ratio of likelihoods.
const AS_GOOD: f64 = 3.841_458_820_694_124;
/// Weight of the base where nothing else holds a cell, as a share of the mean weight of the data.
const TIE: f64 = 1e-12;
/// The same of a cell that no data reach.
const TIE_ALONE: f64 = 1e-10;

/// Cells with factors, what the fixed cells and the base add, and the number of the label.
type RoughRow = (Vec<(usize, f64)>, f64, usize);

/// `G = A'WA`, `c = A'Wb` over the free cells, and the roughness.
pub(super) struct Normal {
    pub(super) n: usize,
    pub(super) g: Vec<f64>,
    c: Vec<f64>,
    square: f64,
    samples: f64,
    /// Rows of the roughness over the free cells, with what the fixed ones and the base add.
    rough: Vec<RoughRow>,
    /// Cells of each label among the free ones, for the scale of its roughness.
    owner: Vec<usize>,
    /// Scale of the roughness of each label.
    scales: Vec<f64>,
    base_weight: Vec<f64>,
    /// Weight that one measurement at a cell has in its own equation: the sum of `w a |row|_1` over the sum of `|a| / |row|_1`.
    pub(super) mean_weight: Vec<f64>,
    gathered: Option<Vec<f64>>,
}

/// A solution without limits.
pub(super) struct Smooth {
    pub(super) delta: Vec<f64>,
    pub(super) smooth: f64,
    /// The least weight of the roughness that explains the data as well: what the intervals stand on.
    pub(super) cautious: f64,
    pub(super) parameters: f64,
    pub(super) variance: f64,
}

impl Normal {
    pub(super) fn new(
        p: &Problem,
        map: &[Option<usize>],
        base: &[f64],
        locked: &[bool],
        options: &Options,
    ) -> Self {
        let n = map.iter().flatten().count();
        let (first, _) = offsets(p.labels);
        let (mut rough, mut owner, mut base_weight) = (Vec::new(), Vec::new(), Vec::new());
        for (number, (l, from)) in p.labels.iter().zip(first).enumerate() {
            for row in l.roughness() {
                // A cell that keeps its base has no change: where the change is smoothed that is known of it, as of one that is
                // locked, and a cell with little data beside it does not run away from it. Of its value nothing is known.
                let follows = |k: usize| matches!(p.roles.get(k), Some(Role::Follows(_)));
                let unknown = |k: usize| map[from + k].is_none() && !locked[from + k] && !follows(from + k);
                if !options.smooth_change && row.iter().any(|(k, _)| unknown(*k)) {
                    continue;
                }
                let told = if options.smooth_change {
                    0.0
                } else {
                    row.iter().map(|(k, d)| d * base[from + k]).sum()
                };
                let terms = p.over_free(map, row.iter().map(|(k, d)| (from + k, *d)));
                if !terms.is_empty() {
                    rough.push((terms, told, number));
                }
            }
            for _ in (0..l.len()).filter(|k| map[from + k].is_some()) {
                owner.push(number);
                base_weight.push(l.base_weight);
            }
        }
        Self {
            n,
            g: Vec::new(),
            c: Vec::new(),
            square: 0.0,
            samples: 0.0,
            rough,
            owner,
            scales: vec![0.0; p.labels.len()],
            base_weight,
            mean_weight: Vec::new(),
            gathered: None,
        }
    }

    /// Whether the label of a free cell is smoothed.
    pub(super) fn is_rough(&self, f: usize) -> bool {
        self.rough.iter().any(|row| row.2 == self.owner[f])
    }

    fn gather(&mut self, p: &Problem, map: &[Option<usize>], offset: &[f64], weights: &[f64]) {
        let n = self.n;
        self.g = vec![0.0; n * n];
        self.c = vec![0.0; n];
        (self.square, self.samples) = (0.0, 0.0);
        let (mut full, mut share) = (vec![0.0; n], vec![0.0; n]);
        let mut row: Vec<(usize, f64)> = Vec::new();
        for k in 0..offset.len() {
            let w = weights[k];
            if w == 0.0 {
                continue;
            }
            self.square += w * offset[k] * offset[k];
            self.samples += 1.0;
            let (at, value) = p.rows.row(k);
            row.clear();
            row.extend(at.iter().zip(value).filter_map(|(j, v)| map[*j].map(|f| (f, *v))));
            let all: f64 = row.iter().map(|(_, v)| v.abs()).sum();
            for &(i, v) in &row {
                // What the sample says of this label: others have other units.
                let own = |j: &usize| self.owner[*j] == self.owner[i];
                let size: f64 = match self.scales.len() {
                    1 => all,
                    _ => row.iter().filter(|(j, _)| own(j)).map(|(_, u)| u.abs()).sum(),
                };
                // A sample that is shared out among cells counts with its share, with the weight that it would have at one cell.
                full[i] += w * v.abs() * size;
                share[i] += v.abs() / size;
                self.c[i] += w * v * offset[k];
                for &(j, u) in &row {
                    // The upper triangle is enough.
                    if j >= i {
                        self.g[i * n + j] += w * v * u;
                    }
                }
            }
        }
        self.mean_weight = full.iter().zip(&share).map(|(f, s)| if *s > 0.0 { f / s } else { 0.0 }).collect();
        for (number, scale) in self.scales.iter_mut().enumerate() {
            let data: f64 = (0..n).filter(|k| self.owner[*k] == number).map(|k| self.g[k * n + k]).sum();
            let own = self.rough.iter().filter(|r| r.2 == number);
            let rough: f64 = own.flat_map(|r| &r.0).map(|(_, d)| d * d).sum();
            *scale = if rough > 0.0 { data / rough } else { 0.0 };
        }
    }

    /// What was gathered is of other measurements.
    pub(super) fn forget(&mut self) {
        self.gathered = None;
    }

    /// `H = G + lambda P + V`, upper triangle, with a tie to the base where nothing else holds a cell.
    pub(super) fn hessian(&self, smooth: f64) -> Vec<f64> {
        let n = self.n;
        let mut h = self.untied(smooth);
        let mean = (0..n).map(|k| self.g[k * n + k]).sum::<f64>() / n.max(1) as f64;
        for k in 0..n {
            // A cell without data that others take along is not to be lost in their rounding.
            h[k * n + k] += mean * if self.g[k * n + k] > 0.0 { TIE } else { TIE_ALONE };
        }
        h
    }

    /// The same without the tie.
    pub(super) fn untied(&self, smooth: f64) -> Vec<f64> {
        let n = self.n;
        let mut h = self.g.clone();
        for (terms, _, number) in &self.rough {
            let w = smooth * self.scales[*number];
            for &(i, a) in terms {
                for &(j, b) in terms.iter().filter(|(j, _)| *j >= i) {
                    h[i * n + j] += w * a * b;
                }
            }
        }
        (0..n).for_each(|k| h[k * n + k] += self.base_weight[k]);
        h
    }

    /// Right-hand side with the pull of the roughness of the base.
    pub(super) fn right(&self, smooth: f64) -> Vec<f64> {
        let mut c = self.c.clone();
        for (terms, told, number) in self.rough.iter().filter(|r| r.1 != 0.0) {
            terms.iter().for_each(|(k, d)| c[*k] -= smooth * self.scales[*number] * d * told);
        }
        c
    }

    fn at(&self, smooth: f64, tau: f64) -> Result<(Smooth, f64), LabelError> {
        let n = self.n;
        let singular = |e: linalg::LinalgError| LabelError::Singular(e.to_string());
        let mut r = self.hessian(smooth);
        linalg::cholesky(&mut r, n).map_err(singular)?;
        let mut x = self.right(smooth);
        linalg::solve_upper_transposed(&r, n, &mut x).map_err(singular)?;
        linalg::solve_upper(&r, n, &mut x).map_err(singular)?;
        let mut inverse = vec![0.0; n * n];
        let mut work = vec![0.0; n * n];
        linalg::cholesky_inverse(&r, n, &mut work, &mut inverse).map_err(singular)?;
        // Both triangles count in tr(H^-1 G).
        let mut parameters = 0.0;
        let (mut xc, mut xgx) = (0.0, 0.0);
        for i in 0..n {
            let (inv, g) = (&inverse[i * n + i..(i + 1) * n], &self.g[i * n + i..(i + 1) * n]);
            parameters += 2.0 * linalg::dot(inv, g) - inv[0] * g[0];
            xc += x[i] * self.c[i];
            xgx += x[i] * (2.0 * linalg::dot(g, &x[i..]) - g[0] * x[i]);
        }
        let square = (self.square - 2.0 * xc + xgx).max(0.0);
        let left = 1.0 - (tau * parameters / self.samples).min(1.0);
        // Where the data say no more than the parameters, nothing is left to judge by.
        let score = if left > 1e-3 { square / self.samples / (left * left) } else { f64::INFINITY };
        // Parameters take as much of correlated noise as tau independent samples have.
        let variance = square / (self.samples - tau * parameters).max(1.0);
        Ok((Smooth { delta: x, smooth, cautious: smooth, parameters, variance }, score))
    }

    /// Solves with the given weight of the roughness, or with the one of least
    /// `V = (RSS / n) / (1 - tau p / n)^2`, p the effective parameters: generalised cross-validation with the samples counted as what
    /// they are worth (N. S. Altman, Kernel smoothing of data with correlated errors, JASA 85 (1990), 749-759).
    pub(super) fn solve(
        &mut self,
        p: &Problem,
        map: &[Option<usize>],
        offset: &[f64],
        weights: &[f64],
        tau: f64,
        smooth: Option<f64>,
    ) -> Result<Smooth, LabelError> {
        // Only weights change what is gathered.
        if self.gathered.as_deref() != Some(weights) {
            self.gather(p, map, offset, weights);
            self.gathered = Some(weights.to_vec());
        }
        if self.samples < 1.0 || self.n == 0 {
            return Err(super::nothing_told(p, self.samples as usize));
        }
        if let Some(smooth) = smooth {
            return Ok(self.at(smooth, tau)?.0);
        }
        if self.scales.iter().all(|s| *s == 0.0) {
            return Ok(self.at(0.0, tau)?.0);
        }
        // Two decades a step first, then the place between by halving.
        let mut tried: Vec<(f64, f64)> = Vec::new();
        let mut power = SMOOTH_FROM;
        while power <= SMOOTH_TO {
            tried.push((power, self.at(10f64.powf(power), tau)?.1));
            power += 2.0;
        }
        let least = |tried: &[(f64, f64)]| {
            tried.iter().copied().min_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0.0, f64::INFINITY))
        };
        for step in [1.0, 0.5] {
            let middle = least(&tried).0;
            for power in [middle - step, middle + step] {
                if (SMOOTH_FROM..=SMOOTH_TO).contains(&power) {
                    tried.push((power, self.at(10f64.powf(power), tau)?.1));
                }
            }
        }
        // The values are those that predict best. The score is flat where the data do not say how smooth the label is, and what they
        // allow is no knowledge: the intervals stand on the least smooth of the weights that explain as well.
        let (best, score) = least(&tried);
        let facts = self.samples / tau;
        let as_good = tried.iter().filter(|t| !(facts * (t.1 / score).ln() > AS_GOOD));
        let power = as_good.map(|t| t.0).fold(f64::INFINITY, f64::min);
        let cautious = 10f64.powf(if power.is_finite() { power } else { 0.0 });
        // Without any finite score nothing was learnt of the smoothness.
        let smooth = if score.is_finite() { 10f64.powf(best) } else { 1.0 };
        let mut found = self.at(smooth, tau)?.0;
        found.cautious = cautious.min(smooth);
        Ok(found)
    }
}
