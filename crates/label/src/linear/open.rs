//! Directions in which labels are open: changes that neither data nor smoothness tell anything of.
//!
//! In the sum of two curves a constant may go from one to the other, in the product of two a factor. The equations H are then singular:
//! `H v = 0`. The directions v come from the triangle of Cholesky with pivots of H, scaled to a unit diagonal; one counts where the data
//! themselves have nothing along it, `v'G v` next to `sum_k G_kk v_k^2`, so that cells which only smoothness holds are not taken for open.

use dynocal_numerics::linalg;

use super::normal::Normal;

/// Share of its own diagonal that is left of a pivot where the others say all of it.
const NOTHING: f64 = 1e-10;
/// Part of a direction, of its largest, from which a cell belongs to it.
const BELONGS: f64 = 1e-3;
/// Cells up to which the search is worth its cost.
const MOST: usize = 1000;

/// Open directions over the cells.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Open {
    /// Each over the cells, scaled by the roots of the diagonal of their equations.
    vectors: Vec<Vec<f64>>,
}

impl Open {
    /// Whether nothing is open.
    pub fn is_empty(&self) -> bool {
        self.vectors.is_empty()
    }

    /// Number of open directions.
    pub fn len(&self) -> usize {
        self.vectors.len()
    }

    /// Cells of direction `k`.
    pub fn cells(&self, k: usize) -> Vec<usize> {
        let v = &self.vectors[k];
        let most = v.iter().fold(0.0, |m: f64, x| m.max(x.abs()));
        (0..v.len()).filter(|c| v[*c].abs() > BELONGS * most).collect()
    }
}

/// Open directions of the equations with the weight `smooth` of the roughness; `map` has the number of each free cell.
pub(super) fn find(normal: &Normal, smooth: f64, map: &[Option<usize>]) -> Open {
    let n = normal.n;
    if n == 0 || n > MOST {
        return Open::default();
    }
    let h = normal.untied(smooth);
    let root: Vec<f64> = (0..n).map(|k| h[k * n + k].max(0.0).sqrt()).collect();
    let told: Vec<bool> = (0..n).map(|k| normal.g[k * n + k] > 0.0).collect();
    let free: Vec<Vec<f64>> =
        null(scaled(&h, &root), n).into_iter().filter(|x| nothing(normal, x, &root, &told)).collect();
    let mut vectors: Vec<Vec<f64>> = Vec::new();
    for x in free {
        let mut v: Vec<f64> = map.iter().map(|f| f.map_or(0.0, |f| x[f])).collect();
        for u in &vectors {
            let part = linalg::dot(u, &v);
            linalg::axpy(-part, u, &mut v);
        }
        let size = linalg::norm2(&v);
        if size > NOTHING {
            v.iter_mut().for_each(|x| *x /= size);
            vectors.push(v);
        }
    }
    Open { vectors }
}

impl Open {
    /// Directions across several labels of which the data alone tell nothing, `g` their equations (upper triangle) and `owner` the label of
    /// each cell: what smoothness says of them moves with the labels, as the factor between two curves that are multiplied.
    pub(crate) fn across(g: &[f64], owner: &[usize]) -> Self {
        let n = owner.len();
        if n > MOST {
            return Self::default();
        }
        let root: Vec<f64> = (0..n).map(|k| g[k * n + k].max(0.0).sqrt()).collect();
        let vectors = null(scaled(g, &root), n).into_iter().filter(|x| {
            let most = x.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
            let mut labels = (0..n).filter(|k| x[*k].abs() > BELONGS * most).map(|k| owner[k]);
            labels.next().is_some_and(|first| labels.any(|l| l != first))
        });
        Self { vectors: vectors.collect() }
    }
}

/// A symmetric matrix over its diagonal, both triangles; `root` has the roots of that.
fn scaled(h: &[f64], root: &[f64]) -> Vec<f64> {
    let n = root.len();
    let mut a = vec![0.0; n * n];
    for i in 0..n {
        for j in i..n {
            if root[i] > 0.0 && root[j] > 0.0 {
                let v = h[i * n + j] / (root[i] * root[j]);
                (a[i * n + j], a[j * n + i]) = (v, v);
            }
        }
    }
    a
}

/// Whether the data say nothing along the scaled direction `x`, of cells that they do reach.
fn nothing(normal: &Normal, x: &[f64], root: &[f64], told: &[bool]) -> bool {
    let n = normal.n;
    let v: Vec<f64> = x.iter().zip(root).map(|(x, r)| if *r > 0.0 { x / r } else { 0.0 }).collect();
    let (mut along, mut own) = (0.0, 0.0);
    for i in 0..n {
        own += normal.g[i * n + i] * v[i] * v[i];
        for j in i..n {
            along += if i == j { 1.0 } else { 2.0 } * normal.g[i * n + j] * v[i] * v[j];
        }
    }
    // At least two cells that data reach: one of them says of the other what it would have to be.
    let reached = (0..n).filter(|k| told[*k] && x[*k].abs() > BELONGS).count();
    reached > 1 && along.abs() <= 10.0 * NOTHING * own
}

/// Null vectors of a symmetric positive matrix with a unit diagonal (or zeros), by elimination with pivots.
fn null(mut a: Vec<f64>, n: usize) -> Vec<Vec<f64>> {
    let mut order: Vec<usize> = (0..n).filter(|k| a[k * n + k] > 0.0).collect();
    let m = order.len();
    // Rows of R in the order of the pivots.
    let mut r: Vec<Vec<f64>> = Vec::new();
    for step in 0..m {
        let at =
            (step..m).max_by(|p, q| a[order[*p] * n + order[*p]].total_cmp(&a[order[*q] * n + order[*q]]));
        order.swap(step, at.unwrap_or(step));
        let p = order[step];
        let pivot = a[p * n + p];
        if !(pivot > NOTHING) {
            break;
        }
        let row: Vec<f64> = (0..n).map(|j| a[p * n + j] / pivot.sqrt()).collect();
        for &i in &order[step + 1..] {
            for &j in &order[step + 1..] {
                a[i * n + j] -= row[i] * row[j];
            }
        }
        r.push(row);
    }
    // What is left is said by the pivots: R11 x = -r of the column.
    let rank = r.len();
    let vector = |column: usize| {
        let mut x = vec![0.0; n];
        x[column] = 1.0;
        for k in (0..rank).rev() {
            let sum: f64 = (k + 1..rank).map(|j| r[k][order[j]] * x[order[j]]).sum();
            x[order[k]] = -(r[k][column] + sum) / r[k][order[k]];
        }
        let size = linalg::norm2(&x);
        x.iter_mut().for_each(|v| *v /= size);
        x
    };
    order[rank..m].iter().map(|c| vector(*c)).collect()
}
