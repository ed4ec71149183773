//! Fuel optimisation of 2000 samples with polynomial torque and lambda models and a spark rate limit: the size and
//! structure that the interior point is made for. Data and the tight solution of an independent solver (tolerance
//! 1e-11) come from the reference set named by DYNOCAL_REFERENCE_DIR.

use dynocal_numerics::nlp::{NlpOptions, SparseNlp, solve};
use dynocal_numerics::status::Status;

const TIGHT_RATE_LIMITED: f64 = 2.390_317_721_415_519;
/// First decision sample.
const FIRST: usize = 3;

struct Fuel {
    /// Record: injection mg, spark deg, throttle deg, speed rpm.
    u: Vec<[f64; 4]>,
    torque: Vec<f64>,
    lambda: Vec<f64>,
    demand_torque: Vec<f64>,
    demand_lambda: Vec<f64>,
}

fn read(path: &str) -> Vec<Vec<f64>> {
    let text = std::fs::read_to_string(path).expect("reference file");
    text.lines()
        .filter(|l| l.starts_with(|c: char| c.is_ascii_digit() || c == '-'))
        .map(|l| l.split(',').map(|v| v.trim().parse().expect("number")).collect())
        .collect()
}

impl Fuel {
    fn load(folder: &str) -> Self {
        let file = |name: &str| read(&format!("{folder}/reference/estimation_inputs/{name}.csv"));
        let record = file("engine_opt");
        let column = |name: &str| file(name).into_iter().map(|r| r[0]).collect::<Vec<f64>>();
        let mut p = Self {
            u: record.iter().map(|r| [r[0], r[1], r[2], r[3]]).collect(),
            torque: column("poly_T_sem"),
            lambda: column("poly_lambda_sem"),
            demand_torque: record.iter().map(|r| r[4]).collect(),
            demand_lambda: record.iter().map(|r| r[5]).collect(),
        };
        // The demand is the models' own free run on the record from the last measured value before the decisions.
        for t in FIRST..p.u.len() {
            let w = [p.u[t - 1], p.u[t - 2], p.u[t - 3]];
            p.demand_torque[t] = p.torque_at(&w, p.demand_torque[t - 1]);
            p.demand_lambda[t] = p.lambda_at(&w, p.demand_lambda[t - 1]);
        }
        p
    }

    /// Torque model, thesis eq. (7.8); `w[k]` holds the inputs at lag k + 1.
    fn torque_at(&self, w: &[[f64; 4]; 3], y: f64) -> f64 {
        let (p, [a, b, c]) = (&self.torque, w);
        p[0] + p[1] * a[0]
            + p[2] * b[0]
            + p[3] * c[0]
            + p[4] * a[1]
            + p[5] * b[1]
            + p[6] * a[2]
            + p[7] * b[2]
            + p[8] * a[3]
            + p[9] * a[0] * a[1]
            + p[10] * a[0] * a[2]
            + p[11] * a[1] * a[1]
            + p[12] * a[1] * a[2]
            + p[13] * b[2].powi(2)
            + p[14] * b[2].powi(3)
            + p[15] * y
    }

    /// Lambda model, thesis eq. (7.8).
    fn lambda_at(&self, w: &[[f64; 4]; 3], y: f64) -> f64 {
        let (p, [a, b, c]) = (&self.lambda, w);
        p[0] + p[1] * a[0] + p[2] * b[0] + p[3] * a[1] + p[4] * c[2] + p[5] * a[3] + p[6] * y
    }

    fn samples(&self) -> usize {
        self.u.len() - 1 - FIRST
    }

    /// Inputs at record index t: decisions, or the record before them.
    fn input(&self, x: &[f64], t: usize) -> [f64; 4] {
        if t < FIRST {
            return self.u[t];
        }
        let v = &x[4 * (t - FIRST)..];
        [v[0], v[1], v[2], self.u[t][3]]
    }

    /// Variable of channel c at lag k + 1 of constraint sample s, if it is a decision.
    fn variable(s: usize, k: usize, c: usize) -> Option<usize> {
        (s >= k).then(|| 4 * (s - k) + c)
    }

    /// ((row, variable), value) of every Jacobian entry.
    fn entries(&self, x: &[f64], mut put: impl FnMut(usize, usize, f64)) {
        let (p, l) = (&self.torque, &self.lambda);
        for s in 0..self.samples() {
            let t = s + FIRST + 1;
            let (a, b) = (self.input(x, t - 1), self.input(x, t - 2));
            let list = [
                (0, 0, 0, p[1] + p[9] * a[1] + p[10] * a[2]),
                (0, 1, 0, p[2]),
                (0, 2, 0, p[3]),
                (0, 0, 1, p[4] + p[9] * a[0] + 2.0 * p[11] * a[1] + p[12] * a[2]),
                (0, 1, 1, p[5]),
                (0, 0, 2, p[6] + p[10] * a[0] + p[12] * a[1]),
                (0, 1, 2, p[7] + 2.0 * p[13] * b[2] + 3.0 * p[14] * b[2] * b[2]),
                (1, 0, 0, l[1]),
                (1, 1, 0, l[2]),
                (1, 0, 1, l[3]),
                (1, 2, 2, l[4]),
                (2, 0, 1, 1.0),
                (2, 1, 1, -1.0),
                (2, 0, 3, -1.0),
            ];
            for (row, lag, channel, value) in list {
                if let Some(v) = Self::variable(s, lag, channel) {
                    put(3 * s + row, v, value);
                }
            }
        }
    }
}

impl SparseNlp for Fuel {
    fn n(&self) -> usize {
        4 * self.samples()
    }
    fn m(&self) -> usize {
        3 * self.samples()
    }
    fn bounds(&self, lower: &mut [f64], upper: &mut [f64]) {
        for s in 0..self.samples() {
            lower[4 * s..4 * s + 4].copy_from_slice(&[0.0, 5.0, 0.0, -1.0]);
            upper[4 * s..4 * s + 4].copy_from_slice(&[30.0, 30.0, 90.0, 1.0]);
        }
    }
    fn start(&self, x: &mut [f64]) {
        for s in 0..self.samples() {
            let t = s + FIRST;
            x[4 * s..4 * s + 3].copy_from_slice(&self.u[t][..3]);
            x[4 * s + 3] = self.u[t][1] - self.u[t - 1][1];
        }
    }
    fn objective(&mut self, x: &[f64]) -> f64 {
        let n = self.samples();
        (0..n).map(|s| 1.2e-4 * x[4 * s] * self.u[s + FIRST][3]).sum::<f64>() / n as f64
    }
    fn gradient(&mut self, _: &[f64], grad: &mut [f64]) {
        grad.fill(0.0);
        let n = self.samples();
        (0..n).for_each(|s| grad[4 * s] = 1.2e-4 * self.u[s + FIRST][3] / n as f64);
    }
    fn constraints(&mut self, x: &[f64], c: &mut [f64]) {
        for s in 0..self.samples() {
            let t = s + FIRST + 1;
            let w = [self.input(x, t - 1), self.input(x, t - 2), self.input(x, t - 3)];
            c[3 * s] = self.torque_at(&w, self.demand_torque[t - 1]) - self.demand_torque[t];
            c[3 * s + 1] = self.lambda_at(&w, self.demand_lambda[t - 1]) - self.demand_lambda[t];
            c[3 * s + 2] = w[0][1] - w[1][1] - x[4 * s + 3];
        }
    }
    fn jacobian_structure(&self) -> Vec<(usize, usize)> {
        let (x, mut at) = (vec![0.0; self.n()], Vec::new());
        self.entries(&x, |r, c, _| at.push((r, c)));
        at
    }
    fn jacobian(&mut self, x: &[f64], values: &mut [f64]) {
        let mut k = 0;
        self.entries(x, |_, _, v| {
            values[k] = v;
            k += 1;
        });
    }
    fn hessian_structure(&self) -> Vec<(usize, usize)> {
        let pairs = [(1, 0), (2, 0), (1, 1), (2, 1), (2, 2)];
        (0..self.samples()).flat_map(|s| pairs.map(|(i, j)| (4 * s + i, 4 * s + j))).collect()
    }
    fn hessian(&mut self, x: &[f64], _: f64, l: &[f64], values: &mut [f64]) {
        let p = &self.torque;
        for s in 0..self.samples() {
            let m = l[3 * s];
            // The throttle terms act one sample later.
            let later = if s + 1 < self.samples() { l[3 * s + 3] } else { 0.0 };
            values[5 * s..5 * s + 5].copy_from_slice(&[
                m * p[9],
                m * p[10],
                2.0 * m * p[11],
                m * p[12],
                later * (2.0 * p[13] + 6.0 * p[14] * x[4 * s + 2]),
            ]);
        }
    }
}

#[test]
fn rate_limited_fuel_optimum_of_the_reference_record_is_reached() {
    let Ok(folder) = std::env::var("DYNOCAL_REFERENCE_DIR") else {
        println!("SKIPPED: DYNOCAL_REFERENCE_DIR is not set");
        return;
    };
    let mut problem = Fuel::load(&folder);
    let clock = std::time::Instant::now();
    let found = solve(&mut problem, &NlpOptions::default(), &|| false);
    println!(
        "{:?} {} iterations {} evaluations fuel {:.12} kg/h violation {:.1e} {:?}",
        found.status,
        found.history.len() - 1,
        found.history.last().map_or(0, |h| h.evaluations),
        found.objective,
        found.violation,
        clock.elapsed()
    );
    assert_eq!(found.status, Status::Converged);
    assert!(found.violation < 1e-6);
    // An interior point stops on the inner side of the bounds: above the tight value, by less than 1e-7.
    assert!((found.objective - TIGHT_RATE_LIMITED).abs() < 7e-8, "{}", found.objective);
    assert!(found.history.len() <= 60);
}
