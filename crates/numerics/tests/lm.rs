//! Levenberg-Marquardt on the nonlinear least-squares problems of J. J. More, B. S. Garbow, K. E. Hillstrom,
//! Testing unconstrained optimization software, ACM TOMS 7 (1981), 17-41; minima as printed there.

use dynocal_numerics::lm::{LeastSquares, LmOptions, LmOutcome, levenberg_marquardt};
use dynocal_numerics::status::Status;

/// Residuals and Jacobian (row-major) at x.
type Fill = fn(&[f64], &mut [f64], &mut [f64]);

struct Case {
    name: &'static str,
    start: &'static [f64],
    residuals: usize,
    minimum: f64,
    fill: Fill,
}

struct Problem<'a>(&'a Case, Vec<f64>);

impl LeastSquares for Problem<'_> {
    fn n(&self) -> usize {
        self.0.start.len()
    }
    fn residuals(&self) -> usize {
        self.0.residuals
    }
    fn residual(&mut self, x: &[f64], r: &mut [f64]) -> bool {
        let mut jac = std::mem::take(&mut self.1);
        (self.0.fill)(x, r, &mut jac);
        self.1 = jac;
        r.iter().all(|v| v.is_finite())
    }
    fn residual_jacobian(&mut self, x: &[f64], r: &mut [f64], jac: &mut [f64]) -> bool {
        (self.0.fill)(x, r, jac);
        r.iter().chain(jac.iter()).all(|v| v.is_finite())
    }
}

fn solve(case: &Case, start: &[f64], options: &LmOptions) -> LmOutcome {
    let mut problem = Problem(case, vec![0.0; case.residuals * case.start.len()]);
    levenberg_marquardt(&mut problem, start, options)
}

const BARD: [f64; 15] =
    [0.14, 0.18, 0.22, 0.25, 0.29, 0.32, 0.35, 0.39, 0.37, 0.58, 0.73, 0.96, 1.34, 2.10, 4.39];
const KOWALIK_Y: [f64; 11] =
    [0.1957, 0.1947, 0.1735, 0.1600, 0.0844, 0.0627, 0.0456, 0.0342, 0.0323, 0.0235, 0.0246];
const KOWALIK_U: [f64; 11] = [4.0, 2.0, 1.0, 0.5, 0.25, 0.167, 0.125, 0.1, 0.0833, 0.0714, 0.0625];
const MEYER: [f64; 16] = [
    34780.0, 28610.0, 23650.0, 19630.0, 16370.0, 13720.0, 11540.0, 9744.0, 8261.0, 7030.0, 6005.0, 5147.0,
    4427.0, 3820.0, 3307.0, 2872.0,
];
const OSBORNE: [f64; 33] = [
    0.844, 0.908, 0.932, 0.936, 0.925, 0.908, 0.881, 0.850, 0.818, 0.784, 0.751, 0.718, 0.685, 0.658, 0.628,
    0.603, 0.580, 0.558, 0.538, 0.522, 0.506, 0.490, 0.478, 0.467, 0.457, 0.448, 0.438, 0.431, 0.424, 0.420,
    0.414, 0.411, 0.406,
];

fn bard(x: &[f64], r: &mut [f64], jac: &mut [f64]) {
    for i in 0..15 {
        let (u, v) = ((i + 1) as f64, (15 - i) as f64);
        let w = u.min(v);
        let d = v * x[1] + w * x[2];
        r[i] = BARD[i] - (x[0] + u / d);
        jac[3 * i..3 * i + 3].copy_from_slice(&[-1.0, u * v / (d * d), u * w / (d * d)]);
    }
}

fn kowalik(x: &[f64], r: &mut [f64], jac: &mut [f64]) {
    for i in 0..11 {
        let u = KOWALIK_U[i];
        let (a, b) = (u * u + u * x[1], u * u + u * x[2] + x[3]);
        r[i] = KOWALIK_Y[i] - x[0] * a / b;
        let d = x[0] * a / (b * b);
        jac[4 * i..4 * i + 4].copy_from_slice(&[-a / b, -x[0] * u / b, d * u, d]);
    }
}

fn meyer(x: &[f64], r: &mut [f64], jac: &mut [f64]) {
    for i in 0..16 {
        let t = 50.0 + 5.0 * i as f64;
        let e = (x[1] / (t + x[2])).exp();
        r[i] = x[0] * e - MEYER[i];
        let d = x[0] * e / (t + x[2]);
        jac[3 * i..3 * i + 3].copy_from_slice(&[e, d, -d * x[1] / (t + x[2])]);
    }
}

fn osborne(x: &[f64], r: &mut [f64], jac: &mut [f64]) {
    for i in 0..33 {
        let t = 10.0 * i as f64;
        let (e4, e5) = ((-t * x[3]).exp(), (-t * x[4]).exp());
        r[i] = OSBORNE[i] - (x[0] + x[1] * e4 + x[2] * e5);
        jac[5 * i..5 * i + 5].copy_from_slice(&[-1.0, -e4, -e5, t * x[1] * e4, t * x[2] * e5]);
    }
}

fn rosenbrock(x: &[f64], r: &mut [f64], jac: &mut [f64]) {
    r.copy_from_slice(&[10.0 * (x[1] - x[0] * x[0]), 1.0 - x[0]]);
    jac.copy_from_slice(&[-20.0 * x[0], 10.0, -1.0, 0.0]);
}

fn powell_singular(x: &[f64], r: &mut [f64], jac: &mut [f64]) {
    let (b, c) = (x[1] - 2.0 * x[2], x[0] - x[3]);
    let (s5, s10) = (5f64.sqrt(), 10f64.sqrt());
    r.copy_from_slice(&[x[0] + 10.0 * x[1], s5 * (x[2] - x[3]), b * b, s10 * c * c]);
    jac.fill(0.0);
    jac[..2].copy_from_slice(&[1.0, 10.0]);
    jac[6..8].copy_from_slice(&[s5, -s5]);
    jac[9..11].copy_from_slice(&[2.0 * b, -4.0 * b]);
    (jac[12], jac[15]) = (2.0 * s10 * c, -2.0 * s10 * c);
}

fn wood(x: &[f64], r: &mut [f64], jac: &mut [f64]) {
    let (s90, s10) = (90f64.sqrt(), 10f64.sqrt());
    r.copy_from_slice(&[
        10.0 * (x[1] - x[0] * x[0]),
        1.0 - x[0],
        s90 * (x[3] - x[2] * x[2]),
        1.0 - x[2],
        s10 * (x[1] + x[3] - 2.0),
        (x[1] - x[3]) / s10,
    ]);
    jac.fill(0.0);
    (jac[0], jac[1], jac[4]) = (-20.0 * x[0], 10.0, -1.0);
    (jac[10], jac[11], jac[14]) = (-2.0 * s90 * x[2], s90, -1.0);
    (jac[17], jac[19]) = (s10, s10);
    (jac[21], jac[23]) = (1.0 / s10, -1.0 / s10);
}

fn freudenstein_roth(x: &[f64], r: &mut [f64], jac: &mut [f64]) {
    let y = x[1];
    r[0] = -13.0 + x[0] + ((5.0 - y) * y - 2.0) * y;
    r[1] = -29.0 + x[0] + ((y + 1.0) * y - 14.0) * y;
    jac.copy_from_slice(&[1.0, 10.0 * y - 3.0 * y * y - 2.0, 1.0, 3.0 * y * y + 2.0 * y - 14.0]);
}

fn jennrich_sampson(x: &[f64], r: &mut [f64], jac: &mut [f64]) {
    for k in 0..10 {
        let i = (k + 1) as f64;
        let (a, b) = ((i * x[0]).exp(), (i * x[1]).exp());
        r[k] = 2.0 + 2.0 * i - (a + b);
        jac[2 * k..2 * k + 2].copy_from_slice(&[-i * a, -i * b]);
    }
}

fn brown_dennis(x: &[f64], r: &mut [f64], jac: &mut [f64]) {
    for k in 0..20 {
        let t = (k + 1) as f64 / 5.0;
        let (a, b) = (x[0] + t * x[1] - t.exp(), x[2] + x[3] * t.sin() - t.cos());
        r[k] = a * a + b * b;
        jac[4 * k..4 * k + 4].copy_from_slice(&[2.0 * a, 2.0 * a * t, 2.0 * b, 2.0 * b * t.sin()]);
    }
}

fn cases() -> Vec<Case> {
    let case = |name, start: &'static [f64], residuals, minimum, fill| Case {
        name,
        start,
        residuals,
        minimum,
        fill,
    };
    vec![
        case("Rosenbrock", &[-1.2, 1.0], 2, 0.0, rosenbrock as Fill),
        case("Freudenstein-Roth", &[0.5, -2.0], 2, 48.9842, freudenstein_roth),
        case("Powell singular", &[3.0, -1.0, 0.0, 1.0], 4, 0.0, powell_singular),
        case("Wood", &[-3.0, -1.0, -3.0, -1.0], 6, 0.0, wood),
        case("Bard", &[1.0, 1.0, 1.0], 15, 8.21487e-3, bard),
        case("Kowalik-Osborne", &[0.25, 0.39, 0.415, 0.39], 11, 3.07505e-4, kowalik),
        case("Meyer", &[0.02, 4000.0, 250.0], 16, 87.9458, meyer),
        case("Osborne 1", &[0.5, 1.5, -1.0, 0.01, 0.02], 33, 5.46489e-5, osborne),
        case("Jennrich-Sampson", &[0.3, 0.4], 10, 124.362, jennrich_sampson),
        case("Brown-Dennis", &[25.0, 5.0, -5.0, -1.0], 20, 85822.2, brown_dennis),
    ]
}

#[test]
fn published_minima_are_reached() {
    for case in cases() {
        let options = LmOptions { max_evaluations: 1000, ..LmOptions::default() };
        let found = solve(&case, case.start, &options);
        println!(
            "{:18} {:?} {:.8e} ev {} jac {}",
            case.name, found.status, found.cost, found.evaluations, found.jacobians
        );
        assert_eq!(found.status, Status::Converged, "{}", case.name);
        // Six digits are printed in the paper; minima of zero are singular or exact zeros.
        let tolerance = if case.minimum == 0.0 { 1e-18 } else { 1e-5 * case.minimum };
        assert!((found.cost - case.minimum).abs() <= tolerance, "{}: {}", case.name, found.cost);
    }
}

#[test]
fn jacobians_of_the_test_problems_agree_with_central_differences() {
    for case in cases() {
        let (n, m) = (case.start.len(), case.residuals);
        let (mut r, mut jac, mut scratch) = (vec![0.0; m], vec![0.0; m * n], vec![0.0; m * n]);
        let x: Vec<f64> = case.start.iter().map(|v| 0.9 * v + 0.001).collect();
        (case.fill)(&x, &mut r, &mut jac);
        let (mut plus, mut minus) = (vec![0.0; m], vec![0.0; m]);
        for k in 0..n {
            let h = 1e-6 * x[k].abs().max(1e-2);
            let at = |s: f64| -> Vec<f64> {
                x.iter().enumerate().map(|(j, v)| if j == k { v + s * h } else { *v }).collect()
            };
            (case.fill)(&at(1.0), &mut plus, &mut scratch);
            (case.fill)(&at(-1.0), &mut minus, &mut scratch);
            for i in 0..m {
                let difference = (plus[i] - minus[i]) / (2.0 * h);
                let scale = jac[i * n + k].abs().max(1e-6 * r[i].abs() / h * 1e-3).max(1e-3);
                assert!(
                    (jac[i * n + k] - difference).abs() < 1e-5 * scale,
                    "{} row {i} column {k}",
                    case.name
                );
            }
        }
    }
}

/// |r|^2 is flat far out and the exponent overflows: steps from the flat part must be survived.
fn overflowing(x: &[f64], r: &mut [f64], jac: &mut [f64]) {
    // r = exp(x^3) - 2: from x = 0.05 the Gauss-Newton step is about +133.
    let e = x[0].powi(3).exp();
    r[0] = e - 2.0;
    jac[0] = 3.0 * x[0] * x[0] * e;
}

#[test]
fn overflowing_trials_are_survived() {
    let case = Case { name: "overflow", start: &[0.05], residuals: 1, minimum: 0.0, fill: overflowing };
    let found = solve(&case, case.start, &LmOptions { initial_radius: 1e6, ..LmOptions::default() });
    assert_eq!(found.status, Status::Converged);
    assert!((found.x[0] - 2f64.ln().cbrt()).abs() < 1e-9, "{found:?}");
}

#[test]
fn a_start_without_finite_residuals_is_diverged() {
    let case = Case { name: "overflow", start: &[20.0], residuals: 1, minimum: 0.0, fill: overflowing };
    let found = solve(&case, case.start, &LmOptions::default());
    assert_eq!(found.status, Status::Diverged);
    assert_eq!(found.x, vec![20.0]);
    assert!(found.cost.is_infinite() && found.history.is_empty());
}

#[test]
fn the_result_does_not_depend_on_the_units_of_the_variables() {
    // Variables scaled by powers of two: the same path in exact and in floating-point arithmetic.
    fn scaled(x: &[f64], r: &mut [f64], jac: &mut [f64]) {
        let y = [x[0] * 1024.0, x[1], x[2] / 1024.0];
        bard(&y, r, jac);
        for row in jac.chunks_exact_mut(3) {
            row[0] *= 1024.0;
            row[2] /= 1024.0;
        }
    }
    let plain = Case { name: "Bard", start: &[1.0, 1.0, 1.0], residuals: 15, minimum: 0.0, fill: bard };
    let other = Case {
        name: "scaled",
        start: &[1.0 / 1024.0, 1.0, 1024.0],
        residuals: 15,
        minimum: 0.0,
        fill: scaled,
    };
    let (a, b) = (
        solve(&plain, plain.start, &LmOptions::default()),
        solve(&other, other.start, &LmOptions::default()),
    );
    assert_eq!(a.evaluations, b.evaluations);
    assert!((a.cost - b.cost).abs() <= 1e-12 * a.cost);
}

#[test]
fn the_budget_is_respected() {
    for budget in 1..12 {
        let case = &cases()[7];
        let found = solve(case, case.start, &LmOptions { max_evaluations: budget, ..LmOptions::default() });
        assert!(found.evaluations <= budget);
        assert_eq!(found.status, Status::Limit);
    }
}

#[test]
fn a_column_without_influence_and_a_rank_deficient_jacobian_are_survived() {
    // x0 and x1 act only as a sum, x2 not at all.
    fn fill(x: &[f64], r: &mut [f64], jac: &mut [f64]) {
        let s = x[0] + x[1];
        r.copy_from_slice(&[s * s - 4.0, s - 1.0]);
        jac.copy_from_slice(&[2.0 * s, 2.0 * s, 0.0, 1.0, 1.0, 0.0]);
    }
    let case = Case { name: "deficient", start: &[3.0, 1.0, 7.0], residuals: 2, minimum: 0.0, fill };
    let found = solve(&case, case.start, &LmOptions::default());
    assert_eq!(found.status, Status::Converged);
    // Stationary points of (s^2-4)^2 + (s-1)^2 solve 4 s^3 - 14 s - 2 = 0.
    let s = found.x[0] + found.x[1];
    assert!((4.0 * s.powi(3) - 14.0 * s - 2.0).abs() < 1e-6, "s = {s}");
    assert_eq!(found.x[2], 7.0);
}

/// 80 variables, 200 residuals r = A x + sin(A x) / 2 - b with b of a known x, three columns of A dependent on others.
struct Large {
    a: Vec<f64>,
    b: Vec<f64>,
    by_blocks: bool,
}

const LARGE: (usize, usize) = (200, 80);

impl Large {
    fn new(by_blocks: bool) -> Self {
        let (m, n) = LARGE;
        let mut rng = dynocal_numerics::rng::Rng64::new(4);
        let mut a: Vec<f64> = (0..m * n).map(|_| rng.normal()).collect();
        for row in a.chunks_exact_mut(n) {
            (row[10], row[20], row[30]) = (row[1] - row[2], row[3] + row[4], 2.0 * row[5]);
        }
        let x: Vec<f64> = (0..n).map(|_| 0.3 * rng.normal()).collect();
        let mut problem = Self { a, b: vec![0.0; m], by_blocks };
        let mut r = vec![0.0; m];
        problem.residual(&x, &mut r);
        problem.b = r;
        problem
    }
}

impl LeastSquares for Large {
    fn n(&self) -> usize {
        LARGE.1
    }
    fn residuals(&self) -> usize {
        LARGE.0
    }
    fn residual(&mut self, x: &[f64], r: &mut [f64]) -> bool {
        for ((r, row), b) in r.iter_mut().zip(self.a.chunks_exact(LARGE.1)).zip(&self.b) {
            let v: f64 = row.iter().zip(x).map(|(a, x)| a * x).sum();
            *r = v + 0.5 * v.sin() - b;
        }
        true
    }
    fn residual_jacobian(&mut self, x: &[f64], r: &mut [f64], jac: &mut [f64]) -> bool {
        for (row, out) in self.a.chunks_exact(LARGE.1).zip(jac.chunks_exact_mut(LARGE.1)) {
            let v: f64 = row.iter().zip(x).map(|(a, x)| a * x).sum();
            out.iter_mut().zip(row).for_each(|(o, a)| *o = a * (1.0 + 0.5 * v.cos()));
        }
        self.residual(x, r)
    }
    fn by_blocks(&self) -> bool {
        self.by_blocks
    }
    fn jacobian_blocks(&mut self, x: &[f64], take: &mut dyn FnMut(&[f64], &[f64])) -> bool {
        let (m, n) = LARGE;
        let (mut r, mut jac) = (vec![0.0; m], vec![0.0; m * n]);
        let finite = self.residual_jacobian(x, &mut r, &mut jac);
        for (r, jac) in r.chunks(37).zip(jac.chunks(37 * n)) {
            take(r, jac);
        }
        finite
    }
}

/// The minimum is zero by construction, whole or in blocks, with or without a least damping, rank deficient as it is.
#[test]
fn many_variables_in_blocks_reach_the_same_minimum() {
    for (by_blocks, least_damping) in [(false, 0.0), (false, 1e-12), (true, 0.0), (true, 1e-12)] {
        let mut problem = Large::new(by_blocks);
        let start = vec![0.0; LARGE.1];
        let options = LmOptions { least_damping, ..LmOptions::default() };
        let found = levenberg_marquardt(&mut problem, &start, &options);
        let scale: f64 = problem.b.iter().map(|b| b * b).sum();
        let what = format!("blocks {by_blocks}, damping {least_damping}: {:?}", found.status);
        // At a sum of squares of rounding the last step may also find nothing left to gain.
        let ended = found.status.is_success() || found.status == Status::Stalled;
        assert!(ended && found.cost < 1e-20 * scale, "{what}, {} of {scale}", found.cost);
    }
}
