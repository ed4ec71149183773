//! Speed of the numerical kernels: R factors, a Levenberg-Marquardt run, the interior point on a banded problem.

use criterion::{Criterion, criterion_group, criterion_main};
use dynocal_numerics::linalg::{QrWork, gram_upper};
use dynocal_numerics::lm::{LeastSquares, LmOptions, levenberg_marquardt};
use dynocal_numerics::nlp::{NlpOptions, solve};
use dynocal_numerics::rng::Rng64;
use std::hint::black_box;

#[path = "../tests/common/ocp.rs"]
mod ocp;

fn r_factor(c: &mut Criterion) {
    for (rows, cols) in [(100, 23), (300, 12), (500, 23), (400, 40), (2000, 40)] {
        let mut g = Rng64::new(1);
        let a: Vec<f64> = (0..rows * cols).map(|_| g.normal()).collect();
        let (mut work, mut r) = (QrWork::new(rows, cols), vec![0.0; cols * cols]);
        c.bench_function(&format!("r_factor_{rows}x{cols}"), |b| {
            b.iter(|| work.r_factor(black_box(&a), &mut r).is_ok());
        });
        c.bench_function(&format!("gram_{rows}x{cols}"), |b| {
            b.iter(|| gram_upper(black_box(&a), rows, cols, &mut r).is_ok());
        });
    }
}

/// y = sum_k a_k exp(-b_k t) on 2000 samples: 12 parameters.
struct Decays {
    y: Vec<f64>,
}

fn decay(x: &[f64], t: f64) -> f64 {
    x.chunks_exact(2).map(|p| p[0] * (-p[1] * t).exp()).sum()
}

impl LeastSquares for Decays {
    fn n(&self) -> usize {
        12
    }
    fn residuals(&self) -> usize {
        self.y.len()
    }
    fn residual(&mut self, x: &[f64], r: &mut [f64]) -> bool {
        for (i, (r, y)) in r.iter_mut().zip(&self.y).enumerate() {
            *r = decay(x, 0.01 * i as f64) - y;
        }
        r.iter().all(|v| v.is_finite())
    }
    fn residual_jacobian(&mut self, x: &[f64], r: &mut [f64], jac: &mut [f64]) -> bool {
        for (i, row) in jac.chunks_exact_mut(12).enumerate() {
            let t = 0.01 * i as f64;
            for (p, d) in x.chunks_exact(2).zip(row.chunks_exact_mut(2)) {
                let e = (-p[1] * t).exp();
                (d[0], d[1]) = (e, -p[0] * t * e);
            }
        }
        self.residual(x, r)
    }
}

fn lm(c: &mut Criterion) {
    let truth: Vec<f64> = (0..6).flat_map(|k| [1.0 + f64::from(k), 0.2 * 2f64.powi(k)]).collect();
    let mut g = Rng64::new(2);
    let y = (0..2000).map(|i| decay(&truth, 0.01 * f64::from(i)) + 0.01 * g.normal()).collect();
    let start: Vec<f64> = truth.iter().map(|v| 1.2 * v).collect();
    let mut problem = Decays { y };
    let options = LmOptions { max_evaluations: 10, ..LmOptions::default() };
    c.bench_function("lm_10_evaluations_2000x12", |b| {
        b.iter(|| levenberg_marquardt(&mut problem, black_box(&start), &options).cost);
    });
}

fn nlp(c: &mut Criterion) {
    let mut group = c.benchmark_group("nlp");
    group.sample_size(10);
    group.bench_function("banded_6000x4000", |b| {
        b.iter(|| solve(&mut ocp::Masses::nonlinear(1000), &NlpOptions::default(), &|| false).objective);
    });
    group.finish();
}

criterion_group!(benches, r_factor, lm, nlp);
criterion_main!(benches);
