//! The diagonal of the matrix of the step, for steps that are damped much.

use super::System;

pub(super) struct Near {
    diagonal: Vec<f64>,
    moves: Vec<bool>,
}

impl Near {
    pub(super) fn new(s: &System, moves: &[bool], mu: f64) -> Self {
        let mean = s.diagonal.iter().sum::<f64>() / s.diagonal.len().max(1) as f64;
        let ties = s.ties();
        // A cell that data do not reach is held by its neighbours.
        let own = |k: usize| ((1.0 + mu) * s.diagonal[k]).max(1e-9 * mean) + ties[k];
        Self { diagonal: (0..moves.len()).map(own).collect(), moves: moves.to_vec() }
    }

    pub(super) fn solve(&self, r: &[f64]) -> Vec<f64> {
        let all = r.iter().zip(&self.diagonal).zip(&self.moves);
        all.map(|((r, d), moves)| if *moves { r / d } else { 0.0 }).collect()
    }
}
