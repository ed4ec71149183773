//! What cells without knowledge of their own take from those that have some: the change of their neighbours.
//!
//! The share `r` by which a cell changes is the harmonic extension of the shares of the known cells over the grid: it minimises
//!
//! ```text
//! sum over edges of c (r_i - r_j)^2,     c = 1 / (h lines)
//! ```
//!
//! h the distance of two breakpoints as a share of the range of their axis. Each extended share is a mean of known ones with weights that
//! are not negative and have the sum 1, so that no cell changes by more, or by less, than the known ones do (the maximum principle of
//! discrete harmonic functions; P. G. Doyle, J. L. Snell, Random walks and electric networks, 1984, section 1.2).

use dynocal_numerics::linalg;

use crate::error::LabelError;
use crate::label::Label;

/// Weight below which a known cell is left out of a mean.
const COUNTS: f64 = 1e-6;

/// For each cell that is not `known`, the known cells and their weights (sum 1); none for a known cell, and where no known one can be
/// reached. Locked cells neither tell nor follow.
///
/// # Errors
/// [`LabelError::Singular`]; it cannot be on a grid.
pub fn extension(label: &Label, known: &[bool]) -> Result<Vec<Vec<(usize, f64)>>, LabelError> {
    let edges = edges(label);
    let reached = reached(label.len(), &edges, known);
    let open: Vec<usize> = (0..label.len()).filter(|k| reached[*k] && !known[*k]).collect();
    let n = open.len();
    let mut out = vec![Vec::new(); label.len()];
    if n == 0 {
        return Ok(out);
    }
    let mut place = vec![usize::MAX; label.len()];
    open.iter().enumerate().for_each(|(i, k)| place[*k] = i);
    let mut a = vec![0.0; n * n];
    let mut sides: Vec<(usize, Vec<f64>)> = Vec::new();
    for &(i, j, c) in &edges {
        for (own, other) in [(i, j), (j, i)] {
            let Some(row) = place.get(own).copied().filter(|p| *p < n) else { continue };
            if !known[other] && place[other] >= n {
                continue;
            }
            a[row * n + row] += c;
            if known[other] {
                let side = match sides.iter().position(|s| s.0 == other) {
                    Some(k) => &mut sides[k].1,
                    None => {
                        sides.push((other, vec![0.0; n]));
                        let last = sides.len() - 1;
                        &mut sides[last].1
                    }
                };
                side[row] += c;
            } else if place[other] > row {
                a[row * n + place[other]] -= c;
            }
        }
    }
    let singular = |e: linalg::LinalgError| LabelError::Singular(e.to_string());
    linalg::cholesky(&mut a, n).map_err(singular)?;
    for (cell, mut x) in sides {
        linalg::solve_upper_transposed(&a, n, &mut x).map_err(singular)?;
        linalg::solve_upper(&a, n, &mut x).map_err(singular)?;
        for (k, w) in open.iter().zip(x).filter(|(_, w)| *w > COUNTS) {
            out[*k].push((cell, w));
        }
    }
    for mean in &mut out {
        let sum: f64 = mean.iter().map(|m| m.1).sum();
        mean.iter_mut().for_each(|m| m.1 /= sum);
    }
    Ok(out)
}

/// Neighbours on the grid with their conductance.
fn edges(label: &Label) -> Vec<(usize, usize, f64)> {
    let mut out = Vec::new();
    for (k, axis) in label.axes.iter().enumerate() {
        let p = &axis.points;
        let range = p[p.len() - 1] - p[0];
        let lines = label.lines(k);
        for line in &lines {
            for i in 1..p.len() {
                let h = (p[i] - p[i - 1]) / range;
                out.push((line[i - 1], line[i], 1.0 / (h * lines.len() as f64)));
            }
        }
    }
    let free = |c: usize| !label.locked[c];
    out.into_iter().filter(|(i, j, _)| free(*i) && free(*j)).collect()
}

/// Cells that a known one can be reached from.
fn reached(cells: usize, edges: &[(usize, usize, f64)], known: &[bool]) -> Vec<bool> {
    let mut next = vec![Vec::new(); cells];
    for (i, j, _) in edges {
        next[*i].push(*j);
        next[*j].push(*i);
    }
    let mut out = known.to_vec();
    let mut stack: Vec<usize> = (0..cells).filter(|k| known[*k]).collect();
    while let Some(k) = stack.pop() {
        for &j in &next[k] {
            if !std::mem::replace(&mut out[j], true) {
                stack.push(j);
            }
        }
    }
    out
}
