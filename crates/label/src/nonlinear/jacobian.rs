//! J of a function at a point: by columns where memories fill it, by rows where a sample depends on a few cells only.

use dynocal_numerics::linalg;

use crate::rows::Rows;

/// Derivatives of the samples that count with respect to all cells.
pub(super) enum Jacobian {
    /// One list of samples for each cell.
    Columns(Vec<Vec<f64>>),
    /// One sparse row for each sample.
    Rows(Rows),
}

impl Jacobian {
    /// Hands on what sample `k` has.
    pub(super) fn row(&self, k: usize, take: &mut dyn FnMut(usize, f64)) {
        match self {
            Jacobian::Columns(j) => j.iter().enumerate().for_each(|(c, column)| take(c, column[k])),
            Jacobian::Rows(rows) => {
                let (at, v) = rows.row(k);
                at.iter().zip(v).for_each(|(c, v)| take(*c, *v));
            }
        }
    }

    /// Diagonal of `J'WJ`.
    pub(super) fn squares(&self, w: &[f64], cells: usize) -> Vec<f64> {
        match self {
            Jacobian::Columns(j) => j.iter().map(|j| j.iter().zip(w).map(|(j, w)| w * j * j).sum()).collect(),
            Jacobian::Rows(rows) => {
                let mut out = vec![0.0; cells];
                for (k, w) in w.iter().enumerate() {
                    let (at, v) = rows.row(k);
                    at.iter().zip(v).for_each(|(c, v)| out[*c] += w * v * v);
                }
                out
            }
        }
    }

    /// `J'WJ` (upper triangle) and `J'Wr` over the cells that are not locked; rows and columns of the others are empty.
    pub(super) fn normal(&self, w: &[f64], r: &[f64], locked: &[bool]) -> (Vec<f64>, Vec<f64>) {
        let n = locked.len();
        let (mut h, mut g) = (vec![0.0; n * n], vec![0.0; n]);
        match self {
            Jacobian::Columns(j) => {
                for a in (0..n).filter(|a| !locked[*a]) {
                    let weighted: Vec<f64> = j[a].iter().zip(w).map(|(j, w)| j * w).collect();
                    g[a] = linalg::dot(&weighted, r);
                    for b in (a..n).filter(|b| !locked[*b]) {
                        h[a * n + b] = linalg::dot(&weighted, &j[b]);
                    }
                }
            }
            Jacobian::Rows(rows) => {
                for k in 0..r.len() {
                    let (at, v) = rows.row(k);
                    for (a, va) in at.iter().zip(v).filter(|(a, _)| !locked[**a]) {
                        g[*a] += w[k] * va * r[k];
                        for (b, vb) in at.iter().zip(v).filter(|(b, _)| **b >= *a && !locked[**b]) {
                            h[a * n + b] += w[k] * va * vb;
                        }
                    }
                }
            }
        }
        (h, g)
    }
}
