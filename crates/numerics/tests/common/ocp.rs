//! A banded optimal control problem: two coupled masses, implicit Euler, two forces.
//!
//! ```text
//! p1' = v1,  v1' = -p1 - b p1^3 - 0.1 v1 + (p2 - p1) + u1
//! p2' = v2,  v2' = -p2 - b p2^3 - 0.1 v2 - (p2 - p1) + u2
//! minimise h sum (p1 - r1(t))^2 + (p2 - r2(t))^2 + 0.01 (v1^2 + v2^2) + 0.02 (u1^2 + u2^2)
//! ```
//!
//! Variables per node: p1, v1, p2, v2, u1, u2. With b = 0 and zero reference it is linear-quadratic.
#![allow(dead_code, unreachable_pub)]

use dynocal_numerics::nlp::SparseNlp;

pub const STATE_WEIGHT: [f64; 4] = [1.0, 0.01, 1.0, 0.01];
pub const INPUT_WEIGHT: f64 = 0.02;

pub struct Masses {
    pub nodes: usize,
    pub h: f64,
    pub x0: [f64; 4],
    /// Cubic spring.
    pub b: f64,
    pub reference: fn(f64) -> [f64; 2],
    pub input_bound: f64,
    pub p1_max: f64,
}

impl Masses {
    /// The nonlinear bounded case: 6 nodes variables, 4 nodes equations.
    pub fn nonlinear(nodes: usize) -> Self {
        Self {
            nodes,
            h: 20.0 / nodes as f64,
            x0: [0.0; 4],
            b: 1.0,
            reference: |t| [(0.7 * t).sin(), 0.5 * (0.4 * t).cos()],
            input_bound: 1.5,
            p1_max: 0.8,
        }
    }

    pub fn linear_quadratic(nodes: usize) -> Self {
        Self {
            nodes,
            h: 0.05,
            x0: [1.0, 0.0, -0.5, 0.2],
            b: 0.0,
            reference: |_| [0.0, 0.0],
            input_bound: f64::INFINITY,
            p1_max: f64::INFINITY,
        }
    }

    /// The system matrix of the linear part (row-major 4 x 4).
    pub fn linear_part() -> [f64; 16] {
        [0.0, 1.0, 0.0, 0.0, -2.0, -0.1, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, -2.0, -0.1]
    }

    fn targets(&self, k: usize) -> [f64; 4] {
        let r = (self.reference)((k + 1) as f64 * self.h);
        [r[0], 0.0, r[1], 0.0]
    }
}

impl SparseNlp for Masses {
    fn n(&self) -> usize {
        6 * self.nodes
    }
    fn m(&self) -> usize {
        4 * self.nodes
    }
    fn bounds(&self, lower: &mut [f64], upper: &mut [f64]) {
        for k in 0..self.nodes {
            upper[6 * k] = self.p1_max;
            lower[6 * k + 4..6 * k + 6].fill(-self.input_bound);
            upper[6 * k + 4..6 * k + 6].fill(self.input_bound);
        }
    }
    fn start(&self, x: &mut [f64]) {
        x.fill(0.0);
    }
    fn objective(&mut self, x: &[f64]) -> f64 {
        let mut sum = 0.0;
        for k in 0..self.nodes {
            let (z, r) = (&x[6 * k..6 * k + 6], self.targets(k));
            sum += (0..4).map(|i| STATE_WEIGHT[i] * (z[i] - r[i]).powi(2)).sum::<f64>();
            sum += INPUT_WEIGHT * (z[4] * z[4] + z[5] * z[5]);
        }
        self.h * sum
    }
    fn gradient(&mut self, x: &[f64], grad: &mut [f64]) {
        for k in 0..self.nodes {
            let r = self.targets(k);
            for i in 0..4 {
                grad[6 * k + i] = 2.0 * self.h * STATE_WEIGHT[i] * (x[6 * k + i] - r[i]);
            }
            for i in 4..6 {
                grad[6 * k + i] = 2.0 * self.h * INPUT_WEIGHT * x[6 * k + i];
            }
        }
    }
    fn constraints(&mut self, x: &[f64], c: &mut [f64]) {
        let a = Self::linear_part();
        for k in 0..self.nodes {
            let z = &x[6 * k..6 * k + 6];
            let previous = if k == 0 { &self.x0[..] } else { &x[6 * k - 6..6 * k - 2] };
            for i in 0..4 {
                let mut rate: f64 = (0..4).map(|j| a[4 * i + j] * z[j]).sum();
                if i == 1 {
                    rate += z[4] - self.b * z[0].powi(3);
                } else if i == 3 {
                    rate += z[5] - self.b * z[2].powi(3);
                }
                c[4 * k + i] = z[i] - previous[i] - self.h * rate;
            }
        }
    }
    fn jacobian_structure(&self) -> Vec<(usize, usize)> {
        let mut s = Vec::new();
        for k in 0..self.nodes {
            for i in 0..4 {
                s.extend((0..4).map(|j| (4 * k + i, 6 * k + j)));
                if k > 0 {
                    s.push((4 * k + i, 6 * k - 6 + i));
                }
            }
            s.extend([(4 * k + 1, 6 * k + 4), (4 * k + 3, 6 * k + 5)]);
        }
        s
    }
    fn jacobian(&mut self, x: &[f64], values: &mut [f64]) {
        let a = Self::linear_part();
        let mut next = values.iter_mut();
        let mut put = |v: f64| {
            if let Some(slot) = next.next() {
                *slot = v;
            }
        };
        for k in 0..self.nodes {
            let z = &x[6 * k..6 * k + 6];
            for i in 0..4 {
                for j in 0..4 {
                    let cubic =
                        if (i, j) == (1, 0) || (i, j) == (3, 2) { -3.0 * self.b * z[j] * z[j] } else { 0.0 };
                    put(f64::from(u8::from(i == j)) - self.h * (a[4 * i + j] + cubic));
                }
                if k > 0 {
                    put(-1.0);
                }
            }
            put(-self.h);
            put(-self.h);
        }
    }
    fn hessian_structure(&self) -> Vec<(usize, usize)> {
        (0..6 * self.nodes).map(|k| (k, k)).collect()
    }
    fn hessian(&mut self, x: &[f64], sigma: f64, multipliers: &[f64], values: &mut [f64]) {
        for k in 0..self.nodes {
            for i in 0..6 {
                let w = if i < 4 { STATE_WEIGHT[i] } else { INPUT_WEIGHT };
                values[6 * k + i] = 2.0 * sigma * self.h * w;
            }
            for (i, row) in [(0, 1), (2, 3)] {
                values[6 * k + i] += 6.0 * self.h * self.b * x[6 * k + i] * multipliers[4 * k + row];
            }
        }
    }
}
