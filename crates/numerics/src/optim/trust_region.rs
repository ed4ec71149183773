//! Trust region in a box by affine scaling and reflection, with a limited-memory SR1 model.
//!
//! ```text
//! v_k = x_k - u_k where g_k < 0, x_k - l_k else (1 where that bound is infinite);  D = diag(|v|^1/2)
//! minimise  (D g)'p + p'(D B D + diag(|g|)) p / 2   over |p| <= Delta            truncated conjugate gradients
//! s = D p, shortened to the box, reflected at it, or along -D g: the one that lowers the model most
//! ```
//!
//! All iterates are strictly inside of the box. References: T. F. Coleman, Y. Li, An interior trust region approach for
//! nonlinear minimization subject to bounds, SIAM J. Optim. 6 (1996), 418-445; M. A. Branch, T. F. Coleman, Y. Li,
//! SIAM J. Sci. Comput. 21 (1999), 1-23 (reflections); R. H. Byrd, H. F. Khalfan, R. B. Schnabel, SIAM J. Optim. 6
//! (1996), 1025-1039 (SR1 in trust regions).

use super::limited::{Limited, Update};
use super::probe::{BudgetUsed, Probe};
use super::{Bounds, Budget, Objective, Optimiser, Outcome};
use crate::linalg::{axpy, dot};
use crate::status::Status;

/// Trust-region-reflective search. Needs gradients; one evaluation per iteration.
#[derive(Clone, Copy, Debug)]
pub struct TrustRegion {
    /// Number of (step, gradient change) pairs kept (at least 1 is used).
    pub memory: usize,
}

impl Default for TrustRegion {
    fn default() -> Self {
        Self { memory: 25 }
    }
}

/// Most products with the model in one step.
const MOST_PRODUCTS: usize = 60;
/// Radius, relative to the first, below which no step improves any more.
const LEAST_RADIUS: f64 = 1e-13;

impl Optimiser for TrustRegion {
    fn minimise(&self, problem: &mut dyn Objective, bounds: &Bounds, x0: &[f64], budget: &Budget) -> Outcome {
        let mut probe = Probe::new(problem, bounds, x0, budget);
        let x = probe.start();
        let status = Region::new(bounds, x).run(&mut probe, budget, self.memory).unwrap_or(Status::Limit);
        probe.outcome(status)
    }
}

struct Region<'b> {
    bounds: &'b Bounds,
    x: Vec<f64>,
    g: Vec<f64>,
    f: f64,
    model: Limited,
    /// Roots of the scaled distances, and the diagonal that the scaling adds.
    d: Vec<f64>,
    c: Vec<f64>,
    radius: f64,
}

impl<'b> Region<'b> {
    fn new(bounds: &'b Bounds, x: Vec<f64>) -> Self {
        let n = x.len();
        let model = Limited::new(Update::Sr1, 1, 1.0);
        let mut region =
            Self { bounds, x, g: vec![0.0; n], f: 0.0, model, d: vec![1.0; n], c: vec![0.0; n], radius: 1.0 };
        let mut x = std::mem::take(&mut region.x);
        region.move_inside(&mut x, 1e-3);
        region.x = x;
        region
    }

    /// Keeps `x` a share `margin` of the box (or of one) away from its sides.
    fn move_inside(&self, x: &mut [f64], margin: f64) {
        for (k, x) in x.iter_mut().enumerate() {
            let (l, u) = (self.bounds.lower[k], self.bounds.upper[k]);
            let by = margin * (u - l).min(1.0);
            *x = if u - l <= 2.0 * by { 0.5 * (l + u) } else { x.max(l + by).min(u - by) };
        }
    }

    fn run(&mut self, probe: &mut Probe, budget: &Budget, memory: usize) -> Result<Status, BudgetUsed> {
        let n = self.x.len();
        // The start itself counts too: it may sit on the sides of the box.
        let start = probe.start();
        if start != self.x && !probe.value(&start, &mut vec![0.0; n])?.is_finite() {
            return Ok(Status::Diverged);
        }
        self.f = probe.value(&self.x, &mut self.g)?;
        if !self.f.is_finite() {
            return Ok(Status::Diverged);
        }
        let first = self.scale();
        // Curvature is unknown: the first step goes down the gradient, no variable by more than a tenth.
        let steepest = self.g.iter().fold(0.0f64, |a, g| a.max(g.abs())).max(f64::MIN_POSITIVE);
        self.model = Limited::new(Update::Sr1, memory, 10.0 * steepest);
        self.radius = self.x.iter().zip(&self.d).map(|(x, d)| (x / d).powi(2)).sum::<f64>().sqrt().max(1.0);
        let least = LEAST_RADIUS * self.radius;
        let (mut trial_g, mut idle) = (vec![0.0; n], 0);
        loop {
            let optimality = self.scale();
            if optimality <= budget.gradient_tolerance * first || optimality == 0.0 {
                return Ok(Status::Converged);
            }
            if self.radius < least {
                return Ok(Status::Stalled);
            }
            let (step, predicted) = self.step(optimality);
            let mut trial: Vec<f64> = self.x.iter().zip(&step).map(|(x, s)| x + s).collect();
            self.move_inside(&mut trial, 1e-14);
            let length = step.iter().zip(&self.d).map(|(s, d)| (s / d).powi(2)).sum::<f64>().sqrt();
            let f = probe.value(&trial, &mut trial_g)?;
            let ratio = if f.is_finite() && predicted < 0.0 { (f - self.f) / predicted } else { -1.0 };
            if f.is_finite() {
                let s: Vec<f64> = trial.iter().zip(&self.x).map(|(a, b)| a - b).collect();
                let y: Vec<f64> = trial_g.iter().zip(&self.g).map(|(a, b)| a - b).collect();
                self.model.push(s, y);
            }
            if ratio < 0.25 {
                self.radius = 0.25 * length.min(self.radius);
            } else if ratio > 0.75 && length > 0.8 * self.radius {
                self.radius *= 2.0;
            }
            if ratio > 1e-4 {
                let gained = self.f - f;
                idle =
                    if gained <= budget.value_tolerance * self.f.abs().max(f.abs()) { idle + 1 } else { 0 };
                self.x.copy_from_slice(&trial);
                self.g.copy_from_slice(&trial_g);
                self.f = f;
                if idle >= 3 {
                    return Ok(Status::Converged);
                }
            }
        }
    }

    /// Affine scaling at `x`; the largest entry of `|v g|`.
    fn scale(&mut self) -> f64 {
        let mut worst = 0.0f64;
        for k in 0..self.x.len() {
            let g = self.g[k];
            let (l, u) = (self.bounds.lower[k], self.bounds.upper[k]);
            let distance = if g < 0.0 { u - self.x[k] } else { self.x[k] - l };
            let finite = distance.is_finite();
            let v = if finite { distance.max(0.0) } else { 1.0 };
            self.d[k] = v.sqrt().max(1e-150);
            self.c[k] = if finite { g.abs() } else { 0.0 };
            worst = worst.max(v * g.abs());
        }
        worst
    }

    /// Scaled Hessian times `p`.
    fn product(&self, p: &[f64], scratch: &mut [f64], out: &mut [f64]) {
        scratch.iter_mut().zip(p.iter().zip(&self.d)).for_each(|(s, (p, d))| *s = p * d);
        self.model.apply(scratch, out);
        for k in 0..p.len() {
            out[k] = out[k] * self.d[k] + self.c[k] * p[k];
        }
    }

    /// A step `s` that stays inside of the box, and the change of the model (without the scaling's own term).
    fn step(&self, optimality: f64) -> (Vec<f64>, f64) {
        let n = self.x.len();
        let theta = (1.0 - optimality).max(0.995);
        let gh: Vec<f64> = self.g.iter().zip(&self.d).map(|(g, d)| g * d).collect();
        let (p, mut scratch, mut work) = (self.conjugate_gradients(&gh), vec![0.0; n], vec![0.0; n]);
        let value = |p: &[f64], scratch: &mut [f64], work: &mut [f64]| {
            self.product(p, scratch, work);
            dot(&gh, p) + 0.5 * dot(p, work)
        };
        let (reach, hit) = self.reach(&self.x, &p);
        let mut best = if reach > 1.0 { p.clone() } else { p.iter().map(|v| theta * reach * v).collect() };
        let mut lowest = value(&best, &mut scratch, &mut work);
        if reach <= 1.0 {
            for candidate in [self.reflected(&gh, &p, reach, hit, theta), self.cauchy(&gh, theta)] {
                let found = value(&candidate, &mut scratch, &mut work);
                if found < lowest {
                    (best, lowest) = (candidate, found);
                }
            }
        }
        let s: Vec<f64> = best.iter().zip(&self.d).map(|(p, d)| p * d).collect();
        self.model.apply(&s, &mut work);
        let predicted = dot(&self.g, &s) + 0.5 * dot(&s, &work);
        (s, if predicted < 0.0 { predicted } else { lowest })
    }

    /// Steihaug's truncated conjugate gradients for the scaled problem.
    fn conjugate_gradients(&self, gh: &[f64]) -> Vec<f64> {
        let n = gh.len();
        let (mut p, mut r) = (vec![0.0; n], gh.iter().map(|v| -v).collect::<Vec<f64>>());
        let (mut q, mut hq, mut scratch) = (r.clone(), vec![0.0; n], vec![0.0; n]);
        let mut rr = dot(&r, &r);
        let enough = rr * (0.01f64).min(rr.sqrt());
        for _ in 0..MOST_PRODUCTS.min(2 * n) {
            self.product(&q, &mut scratch, &mut hq);
            let curvature = dot(&q, &hq);
            let alpha = rr / curvature;
            let far = || to_sphere(&p, &q, self.radius);
            if curvature <= 0.0 || alpha >= far() {
                let t = far();
                axpy(t, &q, &mut p);
                return p;
            }
            axpy(alpha, &q, &mut p);
            axpy(-alpha, &hq, &mut r);
            let next = dot(&r, &r);
            if next <= enough {
                break;
            }
            let beta = next / rr;
            q.iter_mut().zip(&r).for_each(|(q, r)| *q = r + beta * *q);
            rr = next;
        }
        p
    }

    /// Largest t with `from + t D p` in the box, and the variables that meet it there.
    fn reach(&self, from: &[f64], p: &[f64]) -> (f64, Vec<usize>) {
        let mut hits = Vec::new();
        let mut t = f64::INFINITY;
        for k in 0..p.len() {
            let s = p[k] * self.d[k];
            let room = if s > 0.0 { self.bounds.upper[k] - from[k] } else { self.bounds.lower[k] - from[k] };
            let reach = if s == 0.0 { f64::INFINITY } else { (room / s).max(0.0) };
            if reach < t {
                t = reach;
                hits.clear();
            }
            if reach == t && t.is_finite() {
                hits.push(k);
            }
        }
        (t, hits)
    }

    /// To the box along `p`, then back from it as far as the model, the box and the radius allow.
    fn reflected(&self, gh: &[f64], p: &[f64], reach: f64, hit: Vec<usize>, theta: f64) -> Vec<f64> {
        let n = p.len();
        let base: Vec<f64> = p.iter().map(|v| reach * v).collect();
        let mut away = p.to_vec();
        hit.into_iter().for_each(|k| away[k] = -away[k]);
        let on: Vec<f64> = (0..n).map(|k| self.x[k] + base[k] * self.d[k]).collect();
        let far = to_sphere(&base, &away, self.radius).min(theta * self.reach(&on, &away).0);
        let (mut scratch, mut work) = (vec![0.0; n], vec![0.0; n]);
        self.product(&away, &mut scratch, &mut work);
        let t = lowest(0.5 * dot(&away, &work), dot(gh, &away) + dot(&base, &work), far);
        (0..n).map(|k| theta * base[k] + t * away[k]).collect()
    }

    /// Along the scaled steepest descent.
    fn cauchy(&self, gh: &[f64], theta: f64) -> Vec<f64> {
        let n = gh.len();
        let down: Vec<f64> = gh.iter().map(|v| -v).collect();
        let far = (self.radius / dot(gh, gh).sqrt()).min(theta * self.reach(&self.x, &down).0);
        let (mut scratch, mut work) = (vec![0.0; n], vec![0.0; n]);
        self.product(&down, &mut scratch, &mut work);
        let t = lowest(0.5 * dot(&down, &work), -dot(gh, gh), far);
        down.iter().map(|v| t * v).collect()
    }
}

/// t > 0 with `|p + t q| = radius`; zero where p is outside already.
fn to_sphere(p: &[f64], q: &[f64], radius: f64) -> f64 {
    let (a, b, c) = (dot(q, q), dot(p, q), dot(p, p) - radius * radius);
    if a == 0.0 || c >= 0.0 { 0.0 } else { (-b + (b * b - a * c).sqrt()) / a }
}

/// Minimiser of `a t^2 + b t` over 0 <= t <= far.
fn lowest(a: f64, b: f64, far: f64) -> f64 {
    if a > 0.0 {
        (-0.5 * b / a).clamp(0.0, far)
    } else if a * far + b < 0.0 {
        far
    } else {
        0.0
    }
}
