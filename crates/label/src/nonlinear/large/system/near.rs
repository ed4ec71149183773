//! A matrix near that of the step, label by label.

use dynocal_numerics::linalg;

use super::System;
use crate::error::LabelError;

/// A matrix near that of the step, label by label: the shape of the label's own equations, and its roughness.
pub(super) struct Near {
    /// First cell, size, and upper triangular factor; none for a diagonal.
    blocks: Vec<(usize, usize, Option<Vec<f64>>)>,
    diagonal: Vec<f64>,
    moves: Vec<bool>,
}

impl Near {
    pub(super) fn new(s: &System, moves: &[bool], mu: f64) -> Result<Self, LabelError> {
        let mean = s.diagonal.iter().sum::<f64>() / s.diagonal.len().max(1) as f64;
        let own = |k: usize| {
            let size = s.base_weight[k] + (1.0 + mu) * s.diagonal[k];
            // A cell that data do not reach is held by its neighbours.
            if size > 1e-9 * mean { size } else { 1e-9 * mean }
        };
        let ties = s.ties();
        let diagonal: Vec<f64> = (0..moves.len()).map(|k| own(k) + ties[k] - s.base_weight[k]).collect();
        let mut blocks = Vec::new();
        let mut rows = s.rough.iter().peekable();
        for (span, shape) in s.spans.iter().zip(&s.shapes) {
            let n = span.len();
            let mut h = shape.clone();
            let moving = &moves[span.clone()];
            for (k, v) in h.iter_mut().enumerate().filter(|(k, _)| !moving[k / n] || !moving[k % n]) {
                *v = f64::from(u8::from(k / n == k % n));
            }
            while let Some((row, w)) = rows.next_if(|(row, _)| span.contains(&row[0].0)) {
                if h.is_empty() {
                    continue;
                }
                for (i, a) in row.iter().filter(|(i, _)| moves[*i]) {
                    for (j, b) in row.iter().filter(|(j, _)| moves[*j] && j >= i) {
                        h[(i - span.start) * n + j - span.start] += w * a * b;
                    }
                }
            }
            if h.is_empty() {
                blocks.push((span.start, n, None));
                continue;
            }
            for k in (0..n).filter(|k| moving[*k]) {
                let cell = span.start + k;
                let more = s.base_weight[cell] + mu * s.diagonal[cell];
                // What no data reach is held by its neighbours, and by a little of the mean.
                h[k * n + k] += more + 1e-9 * mean;
            }
            linalg::cholesky(&mut h, n).map_err(|e| LabelError::Singular(e.to_string()))?;
            blocks.push((span.start, n, Some(h)));
        }
        Ok(Self { blocks, diagonal, moves: moves.to_vec() })
    }

    pub(super) fn solve(&self, r: &[f64]) -> Result<Vec<f64>, LabelError> {
        let mut x = r.to_vec();
        for (from, n, factor) in &self.blocks {
            let own = &mut x[*from..from + n];
            match factor {
                None => own.iter_mut().zip(&self.diagonal[*from..]).for_each(|(x, d)| *x /= d),
                Some(u) => {
                    let singular = |e: linalg::LinalgError| LabelError::Singular(e.to_string());
                    linalg::solve_upper_transposed(u, *n, own).map_err(singular)?;
                    linalg::solve_upper(u, *n, own).map_err(singular)?;
                }
            }
        }
        x.iter_mut().zip(&self.moves).for_each(|(x, m)| *x = if *m { *x } else { 0.0 });
        Ok(x)
    }
}
