//! Limited-memory quasi-Newton matrices as `B = gamma I + sum_i w_i r_i r_i'`, for methods that need products with B.

use crate::linalg::{axpy, dot};

/// Formula of an update from a step s and the change y of the gradient.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Update {
    /// `r r' / r's`, r = y - B s: takes negative curvature in as well.
    Sr1,
    /// `y y' / s'y - B s s' B / s'Bs` with Powell's damping of y: stays positive definite.
    DampedBfgs,
}

/// The matrix with the pairs that it was made from.
pub(super) struct Limited {
    update: Update,
    memory: usize,
    gamma: f64,
    pairs: Vec<(Vec<f64>, Vec<f64>)>,
    terms: Vec<(f64, Vec<f64>)>,
}

impl Limited {
    /// `gamma I`, to remember at most `memory` pairs.
    pub(super) fn new(update: Update, memory: usize, gamma: f64) -> Self {
        Self { update, memory: memory.max(1), gamma, pairs: Vec::new(), terms: Vec::new() }
    }

    /// `out = B v`.
    pub(super) fn apply(&self, v: &[f64], out: &mut [f64]) {
        out.iter_mut().zip(v).for_each(|(o, v)| *o = self.gamma * v);
        for (w, r) in &self.terms {
            axpy(w * dot(r, v), r, out);
        }
    }

    /// Takes a pair in. The oldest goes where the memory is full; gamma becomes the curvature of the newest.
    pub(super) fn push(&mut self, s: Vec<f64>, y: Vec<f64>) {
        let (ss, sy, yy) = (dot(&s, &s), dot(&s, &y), dot(&y, &y));
        if !(ss > 0.0 && yy.is_finite()) {
            return;
        }
        if sy > 1e-10 * (ss * yy).sqrt() {
            self.gamma = if self.update == Update::Sr1 { sy / ss } else { yy / sy };
        }
        if self.pairs.len() == self.memory {
            self.pairs.remove(0);
        }
        self.pairs.push((s, y));
        self.rebuild();
    }

    /// Back to `gamma I`.
    pub(super) fn forget(&mut self) {
        self.pairs.clear();
        self.terms.clear();
    }

    /// Whether no pair is known.
    pub(super) fn is_empty(&self) -> bool {
        self.pairs.is_empty()
    }

    fn rebuild(&mut self) {
        self.terms.clear();
        let mut bs = vec![0.0; self.pairs[0].0.len()];
        for k in 0..self.pairs.len() {
            let (s, y) = &self.pairs[k];
            self.apply(s, &mut bs);
            match self.update {
                Update::Sr1 => {
                    let r: Vec<f64> = y.iter().zip(&bs).map(|(y, b)| y - b).collect();
                    let rs = dot(&r, s);
                    if rs.abs() > 1e-8 * (dot(&r, &r) * dot(s, s)).sqrt() {
                        self.terms.push((1.0 / rs, r));
                    }
                }
                Update::DampedBfgs => {
                    let (sbs, sy) = (dot(s, &bs), dot(s, y));
                    let theta = if sy >= 0.2 * sbs { 1.0 } else { 0.8 * sbs / (sbs - sy) };
                    let r: Vec<f64> = y.iter().zip(&bs).map(|(y, b)| theta * y + (1.0 - theta) * b).collect();
                    let rs = dot(&r, s);
                    if sbs > 0.0 && rs > 0.0 {
                        self.terms.push((-1.0 / sbs, bs.clone()));
                        self.terms.push((1.0 / rs, r));
                    }
                }
            }
        }
    }
}
