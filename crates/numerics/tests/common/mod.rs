//! Second-order forward differentiation for the test problems: exact gradients and Hessians of short formulas.

#![allow(dead_code, unreachable_pub)] // shared by several test programs

pub mod formula;
pub mod ocp;

use dynocal_numerics::nlp::SparseNlp;
use std::ops::{Add, Mul, Neg, Sub};

/// Value, gradient and Hessian (row-major) of a quantity.
#[derive(Clone, Debug)]
pub struct Jet {
    pub v: f64,
    pub g: Vec<f64>,
    pub h: Vec<f64>,
}

impl Jet {
    pub fn variable(v: f64, k: usize, n: usize) -> Self {
        let mut g = vec![0.0; n];
        g[k] = 1.0;
        Self { v, g, h: vec![0.0; n * n] }
    }

    /// A function of this quantity with value f, derivatives d and dd.
    pub fn chain(&self, f: f64, d: f64, dd: f64) -> Self {
        let n = self.g.len();
        let h = (0..n * n).map(|k| d * self.h[k] + dd * self.g[k / n] * self.g[k % n]).collect();
        Self { v: f, g: self.g.iter().map(|g| d * g).collect(), h }
    }

    pub fn powi(&self, p: i32) -> Self {
        let q = f64::from(p);
        let dd = if p >= 2 { q * (q - 1.0) * self.v.powi(p - 2) } else { 0.0 };
        self.chain(self.v.powi(p), q * self.v.powi(p - 1), dd)
    }

    pub fn ln(&self) -> Self {
        self.chain(self.v.ln(), 1.0 / self.v, -1.0 / (self.v * self.v))
    }

    pub fn sin(&self) -> Self {
        self.chain(self.v.sin(), self.v.cos(), -self.v.sin())
    }
}

fn zip(a: &[f64], b: &[f64], f: impl Fn(f64, f64) -> f64) -> Vec<f64> {
    a.iter().zip(b).map(|(x, y)| f(*x, *y)).collect()
}

impl Add for Jet {
    type Output = Jet;
    fn add(self, o: Jet) -> Jet {
        Jet { v: self.v + o.v, g: zip(&self.g, &o.g, |a, b| a + b), h: zip(&self.h, &o.h, |a, b| a + b) }
    }
}
impl Neg for Jet {
    type Output = Jet;
    fn neg(self) -> Jet {
        self * -1.0
    }
}
impl Sub for Jet {
    type Output = Jet;
    fn sub(self, o: Jet) -> Jet {
        self + (-o)
    }
}
impl Mul for Jet {
    type Output = Jet;
    fn mul(self, o: Jet) -> Jet {
        let n = self.g.len();
        let h = (0..n * n)
            .map(|k| {
                let (i, j) = (k / n, k % n);
                self.v * o.h[k] + o.v * self.h[k] + self.g[i] * o.g[j] + self.g[j] * o.g[i]
            })
            .collect();
        Jet { v: self.v * o.v, g: (0..n).map(|k| self.v * o.g[k] + o.v * self.g[k]).collect(), h }
    }
}
impl Add<f64> for Jet {
    type Output = Jet;
    fn add(mut self, o: f64) -> Jet {
        self.v += o;
        self
    }
}
impl Sub<f64> for Jet {
    type Output = Jet;
    fn sub(self, o: f64) -> Jet {
        self + (-o)
    }
}
impl Mul<f64> for Jet {
    type Output = Jet;
    fn mul(self, o: f64) -> Jet {
        self.chain(o * self.v, o, 0.0)
    }
}

/// Objective and constraints of a small problem.
pub type Formula = fn(&[Jet]) -> (Jet, Vec<Jet>);

/// A small problem; constraint i is `g_i = 0`, or `g_i >= 0` when listed in `inequalities` (a slack is appended).
pub struct Small {
    pub name: &'static str,
    pub start: Vec<f64>,
    pub lower: f64,
    pub upper: f64,
    /// Bounds of single variables that differ.
    pub special: Vec<(usize, f64, f64)>,
    pub inequalities: Vec<usize>,
    pub formula: Formula,
    pub optimum: f64,
}

impl Small {
    pub fn new(name: &'static str, start: &[f64], optimum: f64, formula: Formula) -> Self {
        Self {
            name,
            start: start.to_vec(),
            lower: f64::NEG_INFINITY,
            upper: f64::INFINITY,
            special: Vec::new(),
            inequalities: Vec::new(),
            formula,
            optimum,
        }
    }
    pub fn inequalities(mut self, list: &[usize]) -> Self {
        self.inequalities = list.to_vec();
        self
    }
    pub fn bounds(mut self, lower: f64, upper: f64) -> Self {
        (self.lower, self.upper) = (lower, upper);
        self
    }
    pub fn special(mut self, k: usize, lower: f64, upper: f64) -> Self {
        self.special.push((k, lower, upper));
        self
    }
    fn at(&self, x: &[f64]) -> (Jet, Vec<Jet>) {
        let n = self.start.len();
        let jets: Vec<Jet> = (0..n).map(|k| Jet::variable(x[k], k, n)).collect();
        (self.formula)(&jets)
    }
    fn slack_of(&self, i: usize) -> Option<usize> {
        self.inequalities.iter().position(|&k| k == i).map(|s| self.start.len() + s)
    }
}

impl SparseNlp for Small {
    fn n(&self) -> usize {
        self.start.len() + self.inequalities.len()
    }
    fn m(&self) -> usize {
        self.at(&self.start).1.len()
    }
    fn bounds(&self, lower: &mut [f64], upper: &mut [f64]) {
        let n = self.start.len();
        lower[..n].fill(self.lower);
        upper[..n].fill(self.upper);
        lower[n..].fill(0.0);
        for &(k, l, u) in &self.special {
            (lower[k], upper[k]) = (l, u);
        }
    }
    fn start(&self, x: &mut [f64]) {
        let n = self.start.len();
        x[..n].copy_from_slice(&self.start);
        let (_, g) = self.at(&self.start);
        for (s, &i) in self.inequalities.iter().enumerate() {
            x[n + s] = g[i].v;
        }
    }
    fn objective(&mut self, x: &[f64]) -> f64 {
        self.at(x).0.v
    }
    fn gradient(&mut self, x: &[f64], grad: &mut [f64]) {
        grad.fill(0.0);
        grad[..self.start.len()].copy_from_slice(&self.at(x).0.g);
    }
    fn constraints(&mut self, x: &[f64], c: &mut [f64]) {
        for (i, g) in self.at(x).1.iter().enumerate() {
            c[i] = g.v - self.slack_of(i).map_or(0.0, |s| x[s]);
        }
    }
    fn jacobian_structure(&self) -> Vec<(usize, usize)> {
        let n = self.start.len();
        (0..self.m())
            .flat_map(|i| (0..n).map(move |j| (i, j)).chain(self.slack_of(i).map(|s| (i, s))))
            .collect()
    }
    fn jacobian(&mut self, x: &[f64], values: &mut [f64]) {
        let all: Vec<f64> = self
            .at(x)
            .1
            .iter()
            .enumerate()
            .flat_map(|(i, g)| g.g.iter().copied().chain(self.slack_of(i).map(|_| -1.0)).collect::<Vec<_>>())
            .collect();
        values.copy_from_slice(&all);
    }
    fn hessian_structure(&self) -> Vec<(usize, usize)> {
        (0..self.start.len()).flat_map(|i| (0..=i).map(move |j| (i, j))).collect()
    }
    fn hessian(&mut self, x: &[f64], sigma: f64, multipliers: &[f64], values: &mut [f64]) {
        let n = self.start.len();
        let (f, g) = self.at(x);
        for (v, (i, j)) in values.iter_mut().zip(self.hessian_structure()) {
            let k = i * n + j;
            *v = sigma * f.h[k] + multipliers.iter().zip(&g).map(|(l, g)| l * g.h[k]).sum::<f64>();
        }
    }
}
