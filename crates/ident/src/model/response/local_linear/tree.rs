//! The tree of splits and the features that it makes: validity times local regressors.

use serde::{Deserialize, Serialize};

use super::super::features::Features;

/// A smooth split: `psi(z) = 1 / (1 + exp(-(offset + normal'z)))`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Split {
    /// Constant.
    pub offset: f64,
    /// Direction and slope (d).
    pub normal: Vec<f64>,
}

impl Split {
    /// psi at z.
    pub fn psi(&self, z: &[f64]) -> f64 {
        let a = self.offset + self.normal.iter().zip(z).map(|(v, z)| v * z).sum::<f64>();
        1.0 / (1.0 + (-a).exp())
    }
}

/// A local model: the splits on its path and the side of each (true: psi, false: 1 - psi).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Leaf {
    /// Splits from the root, with the side.
    pub path: Vec<(usize, bool)>,
}

/// All splits and leaves.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Tree {
    /// Number of inputs d.
    pub dim: usize,
    /// Whether local models are of second degree.
    pub quadratic: bool,
    /// Splits.
    pub splits: Vec<Split>,
    /// Local models.
    pub leaves: Vec<Leaf>,
}

impl Tree {
    /// One local model everywhere.
    pub(super) fn root(dim: usize, quadratic: bool) -> Self {
        Self { dim, quadratic, splits: Vec::new(), leaves: vec![Leaf::default()] }
    }

    /// Regressors of a local model.
    pub fn local_terms(&self) -> usize {
        let d = self.dim;
        1 + d + if self.quadratic { d * (d + 1) / 2 } else { 0 }
    }

    /// Local regressors at z.
    pub(super) fn regressors(&self, z: &[f64], x: &mut [f64]) {
        let d = self.dim;
        x[0] = 1.0;
        x[1..=d].copy_from_slice(z);
        if self.quadratic {
            for (x, (i, j)) in x[d + 1..].iter_mut().zip(pairs(d)) {
                *x = z[i] * z[j];
            }
        }
    }

    /// Validity of a leaf at z; with `slopes` (d) also the gradient of its logarithm.
    pub(super) fn validity(&self, leaf: &Leaf, z: &[f64], slopes: Option<&mut [f64]>) -> f64 {
        let mut validity = 1.0;
        let mut slopes = slopes;
        if let Some(s) = slopes.as_deref_mut() {
            s.fill(0.0);
        }
        for (split, side) in &leaf.path {
            let split = &self.splits[*split];
            let psi = split.psi(z);
            let (own, other, sign) = if *side { (psi, 1.0 - psi, 1.0) } else { (1.0 - psi, psi, -1.0) };
            validity *= own;
            if let Some(s) = slopes.as_deref_mut() {
                s.iter_mut().zip(&split.normal).for_each(|(s, v)| *s += sign * other * v);
            }
        }
        validity
    }
}

/// Derivative of local regressor `a` with respect to z_j.
fn slope(d: usize, z: &[f64], a: usize, j: usize) -> f64 {
    if a == 0 {
        return 0.0;
    }
    if a <= d {
        return f64::from(u8::from(a - 1 == j));
    }
    let (p, q) = pairs(d).nth(a - d - 1).unwrap_or((d, d));
    f64::from(u8::from(p == j)) * z[q] + f64::from(u8::from(q == j)) * z[p]
}

fn pairs(d: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..d).flat_map(move |i| (i..d).map(move |j| (i, j)))
}

impl Features for Tree {
    fn count(&self) -> usize {
        self.leaves.len() * self.local_terms()
    }

    fn values(&self, z: &[f64], c: &mut [f64], jacobian: &mut [f64]) {
        let (d, k, p) = (self.dim, self.local_terms(), self.count());
        // Gradients of the logarithm of a validity; more inputs than this allocate.
        let mut few = [0.0; 16];
        let mut many = vec![0.0; if d > 16 { d } else { 0 }];
        let slopes = if d > 16 { &mut many[..] } else { &mut few[..d] };
        for (l, leaf) in self.leaves.iter().enumerate() {
            let x = &mut c[l * k..(l + 1) * k];
            self.regressors(z, x);
            let with = !jacobian.is_empty();
            let validity = self.validity(leaf, z, with.then_some(&mut *slopes));
            if with {
                for (j, s) in slopes.iter().enumerate() {
                    for a in 0..k {
                        jacobian[j * p + l * k + a] = validity * (s * x[a] + slope(d, z, a, j));
                    }
                }
            }
            x.iter_mut().for_each(|x| *x *= validity);
        }
    }

    fn curvature(&self, z: &[f64], w: &[f64], hessian: &mut [f64]) {
        let (d, k) = (self.dim, self.local_terms());
        let (mut s, mut x, mut m) = (vec![0.0; d], vec![0.0; k], vec![0.0; d]);
        self.regressors(z, &mut x);
        for (leaf, w) in self.leaves.iter().zip(w.chunks_exact(k)) {
            let validity = self.validity(leaf, z, Some(&mut s));
            let value: f64 = x.iter().zip(w).map(|(x, w)| x * w).sum();
            (0..d).for_each(|j| m[j] = (0..k).map(|a| w[a] * slope(d, z, a, j)).sum());
            for i in 0..d {
                for j in 0..d {
                    hessian[i * d + j] += validity * (s[i] * s[j] * value + s[i] * m[j] + s[j] * m[i]);
                }
            }
            for (split, _) in &leaf.path {
                let split = &self.splits[*split];
                let psi = split.psi(z);
                // Second derivative of both log psi and log (1 - psi).
                let bend = validity * value * psi * (1.0 - psi);
                for i in 0..d {
                    for j in 0..d {
                        hessian[i * d + j] -= bend * split.normal[i] * split.normal[j];
                    }
                }
            }
            if self.quadratic {
                for (w, (i, j)) in w[d + 1..].iter().zip(pairs(d)) {
                    hessian[i * d + j] += validity * w;
                    hessian[j * d + i] += validity * w;
                }
            }
        }
    }
}
