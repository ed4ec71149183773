//! Interior point on banded optimal control problems.

mod common;

use common::ocp::{INPUT_WEIGHT, Masses, STATE_WEIGHT};
use dynocal_numerics::linalg::least_squares;
use dynocal_numerics::nlp::{NlpOptions, SparseNlp, solve};
use dynocal_numerics::status::Status;

/// Optimal cost of the linear-quadratic case by dynamic programming (independent of the solver).
fn riccati_cost(p: &Masses) -> f64 {
    let (h, a) = (p.h, Masses::linear_part());
    // x_k+1 = F (x_k + h B u), F = (I - h A)^-1, column by column.
    let implicit: Vec<f64> = (0..16).map(|i| f64::from(u8::from(i % 5 == 0)) - h * a[i]).collect();
    let mut f = [[0.0; 4]; 4];
    for j in 0..4 {
        let mut e = [0.0; 4];
        e[j] = 1.0;
        let column = least_squares(&implicit, 4, 4, &e, 0.0).expect("regular").x;
        (0..4).for_each(|i| f[i][j] = column[i]);
    }
    let g = |i: usize, s: usize| h * f[i][2 * s + 1];
    let mut value = [[0.0; 4]; 4];
    for _ in 0..p.nodes {
        let mut s = value;
        (0..4).for_each(|i| s[i][i] += h * STATE_WEIGHT[i]);
        let form = |l: &dyn Fn(usize) -> f64, r: &dyn Fn(usize) -> f64| -> f64 {
            (0..4).map(|i| (0..4).map(|j| l(i) * s[i][j] * r(j)).sum::<f64>()).sum()
        };
        let k11 = form(&|i| g(i, 0), &|j| g(j, 0)) + h * INPUT_WEIGHT;
        let k22 = form(&|i| g(i, 1), &|j| g(j, 1)) + h * INPUT_WEIGHT;
        let k12 = form(&|i| g(i, 0), &|j| g(j, 1));
        let det = k11 * k22 - k12 * k12;
        let mut next = [[0.0; 4]; 4];
        for c in 0..4 {
            for d in 0..4 {
                let m = |s: usize, e: usize| form(&|i| g(i, s), &|j| f[j][e]);
                let (c1, c2, d1, d2) = (m(0, c), m(1, c), m(0, d), m(1, d));
                let reduction = (c1 * (k22 * d1 - k12 * d2) + c2 * (k11 * d2 - k12 * d1)) / det;
                next[c][d] = form(&|i| f[i][c], &|j| f[j][d]) - reduction;
            }
        }
        value = next;
    }
    (0..4).map(|i| (0..4).map(|j| p.x0[i] * value[i][j] * p.x0[j]).sum::<f64>()).sum()
}

#[test]
fn the_linear_quadratic_problem_agrees_with_dynamic_programming() {
    let mut problem = Masses::linear_quadratic(300);
    let expected = riccati_cost(&problem);
    let found = solve(&mut problem, &NlpOptions::default(), &|| false);
    assert_eq!(found.status, Status::Converged);
    assert!(found.history.len() <= 3, "a quadratic program without bounds takes one step");
    assert!((found.objective - expected).abs() < 1e-9 * expected, "{} {expected}", found.objective);
}

#[test]
fn derivatives_of_the_banded_problem_agree_with_central_differences() {
    let mut p = Masses::nonlinear(5);
    let (n, m) = (p.n(), p.m());
    let x: Vec<f64> = (0..n).map(|k| 0.3 * (1.7 * k as f64).sin()).collect();
    let l: Vec<f64> = (0..m).map(|k| (0.9 * k as f64).cos()).collect();
    let (js, hs) = (p.jacobian_structure(), p.hessian_structure());
    let lagrangian_gradient = |p: &mut Masses, x: &[f64]| -> Vec<f64> {
        let (mut g, mut j) = (vec![0.0; n], vec![0.0; js.len()]);
        p.gradient(x, &mut g);
        g.iter_mut().for_each(|v| *v *= 0.7);
        p.jacobian(x, &mut j);
        js.iter().zip(&j).for_each(|(&(r, c), v)| g[c] += l[r] * v);
        g
    };
    let lagrangian = |p: &mut Masses, x: &[f64]| -> f64 {
        let mut c = vec![0.0; m];
        p.constraints(x, &mut c);
        0.7 * p.objective(x) + c.iter().zip(&l).map(|(c, l)| c * l).sum::<f64>()
    };
    let g = lagrangian_gradient(&mut p, &x);
    let mut h = vec![0.0; hs.len()];
    p.hessian(&x, 0.7, &l, &mut h);
    for k in 0..n {
        let at = |s: f64| -> Vec<f64> {
            x.iter().enumerate().map(|(j, v)| if j == k { v + s } else { *v }).collect()
        };
        let difference = (lagrangian(&mut p, &at(1e-5)) - lagrangian(&mut p, &at(-1e-5))) / 2e-5;
        assert!((difference - g[k]).abs() < 1e-8, "gradient {k}");
        let (gp, gm) = (lagrangian_gradient(&mut p, &at(1e-5)), lagrangian_gradient(&mut p, &at(-1e-5)));
        for j in 0..n {
            let exact: f64 =
                hs.iter().zip(&h).filter(|(s, _)| **s == (j.max(k), j.min(k))).map(|(_, v)| v).sum();
            assert!(((gp[j] - gm[j]) / 2e-5 - exact).abs() < 1e-8, "Hessian {j} {k}");
        }
    }
}

#[test]
fn the_nonlinear_bounded_problem_is_solved_to_a_kkt_point() {
    let mut p = Masses::nonlinear(1000);
    let clock = std::time::Instant::now();
    let found = solve(&mut p, &NlpOptions::default(), &|| false);
    println!(
        "{:?} {} it {:.9} {:?}",
        found.status,
        found.history.len() - 1,
        found.objective,
        clock.elapsed()
    );
    assert_eq!(found.status, Status::Converged);
    assert!(found.violation < 1e-7 && found.history.len() < 60);
    // KKT conditions from the returned multipliers: the gradient of the Lagrangian vanishes off the bounds and
    // pushes against them on the bounds.
    let (n, mut g) = (p.n(), vec![0.0; p.n()]);
    p.gradient(&found.x, &mut g);
    let s = p.jacobian_structure();
    let mut j = vec![0.0; s.len()];
    p.jacobian(&found.x, &mut j);
    s.iter().zip(&j).for_each(|(&(r, c), v)| g[c] += found.multipliers[r] * v);
    let (mut lower, mut upper) = (vec![f64::NEG_INFINITY; n], vec![f64::INFINITY; n]);
    p.bounds(&mut lower, &mut upper);
    let mut active = 0;
    for k in 0..n {
        assert!(found.x[k] >= lower[k] && found.x[k] <= upper[k]);
        if found.x[k] - lower[k] > 1e-3 && upper[k] - found.x[k] > 1e-3 {
            assert!(g[k].abs() < 1e-5, "variable {k}: {}", g[k]);
        } else if g[k].abs() > 1e-5 {
            active += 1;
            let at_lower = found.x[k] - lower[k] < 1e-3;
            assert!(if at_lower { g[k] > 0.0 } else { g[k] < 0.0 }, "variable {k}: {}", g[k]);
        }
    }
    assert!(active > 10, "the bounds are meant to matter");
}

/// The same problem with its variables in another order, by which neighbours in time are no longer neighbours: the
/// factorisation then takes its general way instead of the one along the chain.
struct Scattered {
    of: Masses,
    /// Variable `k` of this problem is variable `at[k]` of the other.
    at: Vec<usize>,
    place: Vec<usize>,
    x: Vec<f64>,
    buffer: Vec<f64>,
}

impl Scattered {
    fn new(of: Masses) -> Self {
        let n = of.n();
        // A stride without a common factor with n.
        let stride = (n * 5 / 13..).find(|&s| gcd(s, n) == 1).expect("n and n + 1 differ");
        let at: Vec<usize> = (0..n).map(|k| k * stride % n).collect();
        let mut place = vec![0; n];
        at.iter().enumerate().for_each(|(k, &j)| place[j] = k);
        Self { x: vec![0.0; n], buffer: vec![0.0; n], at, place, of }
    }

    fn load(&mut self, x: &[f64]) {
        self.at.iter().zip(x).for_each(|(&j, v)| self.x[j] = *v);
    }
}

fn gcd(a: usize, b: usize) -> usize {
    if b == 0 { a } else { gcd(b, a % b) }
}

impl SparseNlp for Scattered {
    fn n(&self) -> usize {
        self.of.n()
    }
    fn m(&self) -> usize {
        self.of.m()
    }
    fn bounds(&self, lower: &mut [f64], upper: &mut [f64]) {
        let (mut l, mut u) = (lower.to_vec(), upper.to_vec());
        self.of.bounds(&mut l, &mut u);
        self.at.iter().enumerate().for_each(|(k, &j)| (lower[k], upper[k]) = (l[j], u[j]));
    }
    fn start(&self, x: &mut [f64]) {
        let mut full = x.to_vec();
        self.of.start(&mut full);
        self.at.iter().zip(x).for_each(|(&j, x)| *x = full[j]);
    }
    fn objective(&mut self, x: &[f64]) -> f64 {
        self.load(x);
        self.of.objective(&self.x)
    }
    fn gradient(&mut self, x: &[f64], grad: &mut [f64]) {
        self.load(x);
        self.of.gradient(&self.x, &mut self.buffer);
        self.at.iter().zip(grad).for_each(|(&j, g)| *g = self.buffer[j]);
    }
    fn constraints(&mut self, x: &[f64], c: &mut [f64]) {
        self.load(x);
        self.of.constraints(&self.x, c);
    }
    fn jacobian_structure(&self) -> Vec<(usize, usize)> {
        self.of.jacobian_structure().into_iter().map(|(r, c)| (r, self.place[c])).collect()
    }
    fn jacobian(&mut self, x: &[f64], values: &mut [f64]) {
        self.load(x);
        self.of.jacobian(&self.x, values);
    }
    fn hessian_structure(&self) -> Vec<(usize, usize)> {
        let lower =
            |(i, j): (usize, usize)| (self.place[i].max(self.place[j]), self.place[i].min(self.place[j]));
        self.of.hessian_structure().into_iter().map(lower).collect()
    }
    fn hessian(&mut self, x: &[f64], sigma: f64, multipliers: &[f64], values: &mut [f64]) {
        self.load(x);
        self.of.hessian(&self.x, sigma, multipliers, values);
    }
}

#[test]
fn the_order_of_the_variables_does_not_matter() {
    let mut scattered = Scattered::new(Masses::nonlinear(300));
    let found = solve(&mut scattered, &NlpOptions::default(), &|| false);
    let straight = solve(&mut Masses::nonlinear(300), &NlpOptions::default(), &|| false);
    assert_eq!((found.status, straight.status), (Status::Converged, Status::Converged));
    assert!((found.objective - straight.objective).abs() < 1e-8 * straight.objective.abs());
    for (&j, v) in scattered.at.iter().zip(&found.x) {
        assert!((straight.x[j] - v).abs() < 1e-4, "variable {j}: {v} {}", straight.x[j]);
    }
}

/// The same problem with each variable in a unit of its own, which its size names.
struct InUnits {
    of: Masses,
    unit: Vec<f64>,
    x: Vec<f64>,
}

impl InUnits {
    fn new(of: Masses) -> Self {
        let unit = (0..of.n()).map(|k| [1024.0, 1.0, 0.0078125][k % 3]).collect();
        Self { x: vec![0.0; of.n()], unit, of }
    }

    fn load(&mut self, x: &[f64]) {
        self.x.iter_mut().zip(x.iter().zip(&self.unit)).for_each(|(own, (x, u))| *own = x / u);
    }
}

impl SparseNlp for InUnits {
    fn n(&self) -> usize {
        self.of.n()
    }
    fn m(&self) -> usize {
        self.of.m()
    }
    fn bounds(&self, lower: &mut [f64], upper: &mut [f64]) {
        self.of.bounds(lower, upper);
        for bound in [lower, upper] {
            bound.iter_mut().zip(&self.unit).for_each(|(b, u)| *b *= u);
        }
    }
    fn start(&self, x: &mut [f64]) {
        self.of.start(x);
        x.iter_mut().zip(&self.unit).for_each(|(x, u)| *x *= u);
    }
    fn sizes(&self, size: &mut [f64]) {
        size.copy_from_slice(&self.unit);
    }
    fn objective(&mut self, x: &[f64]) -> f64 {
        self.load(x);
        self.of.objective(&self.x)
    }
    fn gradient(&mut self, x: &[f64], grad: &mut [f64]) {
        self.load(x);
        self.of.gradient(&self.x, grad);
        grad.iter_mut().zip(&self.unit).for_each(|(g, u)| *g /= u);
    }
    fn constraints(&mut self, x: &[f64], c: &mut [f64]) {
        self.load(x);
        self.of.constraints(&self.x, c);
    }
    fn jacobian_structure(&self) -> Vec<(usize, usize)> {
        self.of.jacobian_structure()
    }
    fn jacobian(&mut self, x: &[f64], values: &mut [f64]) {
        self.load(x);
        self.of.jacobian(&self.x, values);
        let at = self.of.jacobian_structure();
        values.iter_mut().zip(&at).for_each(|(v, (_, c))| *v /= self.unit[*c]);
    }
    fn hessian_structure(&self) -> Vec<(usize, usize)> {
        self.of.hessian_structure()
    }
    fn hessian(&mut self, x: &[f64], sigma: f64, multipliers: &[f64], values: &mut [f64]) {
        self.load(x);
        self.of.hessian(&self.x, sigma, multipliers, values);
        let at = self.of.hessian_structure();
        values.iter_mut().zip(&at).for_each(|(v, (r, c))| *v /= self.unit[*r] * self.unit[*c]);
    }
}

#[test]
fn units_do_not_matter_where_sizes_name_them() {
    let mut other = InUnits::new(Masses::nonlinear(300));
    let found = solve(&mut other, &NlpOptions::default(), &|| false);
    let own = solve(&mut Masses::nonlinear(300), &NlpOptions::default(), &|| false);
    assert_eq!((found.status, found.history.len()), (Status::Converged, own.history.len()));
    for ((found, unit), own) in found.x.iter().zip(&other.unit).zip(&own.x) {
        assert!((found / unit - own).abs() <= 1e-12 * own.abs().max(1e-3), "{found} in {unit}, {own}");
    }
}
