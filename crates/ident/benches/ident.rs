//! Simulation, sensitivities and adjoint of eq. (4.17); simulation-error estimation; forward regression; linear models
//! with noise; a network.

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use dynocal_ident::estimate::Estimator;
use dynocal_ident::estimate::ols::Ols;
use dynocal_ident::estimate::pem::Pem;
use dynocal_ident::estimate::sem::Sem;
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::linear::LinearModel;
use dynocal_ident::model::neural::NeuralNarx;
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::model::{Model, Run, literature};
use dynocal_ident::select::frols::{Stop, frols};
use dynocal_ident::select::pool::PoolSpec;
use dynocal_numerics::rng::Rng64;

fn recursion(c: &mut Criterion) {
    let lit = literature::torque_4_17();
    for n in [100, 1000] {
        let mut rng = Rng64::new(1);
        let u: Vec<f64> = (0..n)
            .flat_map(|_| {
                [rng.uniform_in(2000.0, 6000.0), rng.uniform_in(0.4, 0.6), rng.uniform_in(1000.0, 2000.0)]
            })
            .collect();
        let (zeros, p) = (vec![0.0; n], lit.theta.len());
        let run = Run { u: &u, y: &zeros, start: 10 };
        let (mut y, mut s, mut u_bar) = (vec![0.0; n], vec![0.0; n * p], vec![0.0; n * 3]);
        let mut group = c.benchmark_group(format!("torque_4_17_{n}"));
        group.throughput(Throughput::Elements(n as u64));
        group.bench_function("simulate", |b| {
            b.iter(|| lit.model.simulate(black_box(&lit.theta), &run, &mut y))
        });
        group.bench_function("sensitivities", |b| {
            b.iter(|| lit.model.sensitivities(black_box(&lit.theta), &run, &mut y, &mut s))
        });
        let (y_bar, s_bar) = (vec![1.0; n], vec![1.0; n * p]);
        group.bench_function("adjoint", |b| {
            b.iter(|| {
                lit.model.sensitivity_adjoint(black_box(&lit.theta), &run, &y, &s, &y_bar, &s_bar, &mut u_bar)
            })
        });
        group.finish();
    }
}

/// A record like that of chapter 5: n samples, inputs held 10, 10 and 100, output error variance 0.5.
fn chapter_5(n: usize) -> Experiment {
    let lit = literature::torque_5_3();
    let mut rng = Rng64::new(5);
    let mut u = Vec::with_capacity(3 * n);
    let (mut a, mut b, mut s) = (0.0, 0.0, 0.0);
    for t in 0..n {
        if t % 10 == 0 {
            (a, b) = (rng.uniform_in(0.42, 0.5), rng.uniform_in(16.0, 34.0));
        }
        if t % 100 == 0 {
            s = rng.uniform_in(1000.0, 1800.0);
        }
        u.extend([a, b, s]);
    }
    let mut y = vec![0.0; n];
    let zeros = vec![0.0; n];
    lit.model.simulate(&lit.theta, &Run { u: &u, y: &zeros, start: 7 }, &mut y);
    y.iter_mut().for_each(|v| *v += 0.5f64.sqrt() * rng.normal());
    Experiment { name: "chapter 5".into(), u, y, init_samples: 0, weights: Vec::new() }
}

/// Cost per sample of free run and estimation from a thousand to a million samples; the long ones by blocks.
fn long_records(c: &mut Criterion) {
    let (torque, model) = (literature::torque_4_17(), literature::torque_5_3().model);
    let mut group = c.benchmark_group("long_records");
    group.sample_size(10);
    for n in [1000, 10_000, 100_000, 1_000_000] {
        let mut rng = Rng64::new(1);
        let u: Vec<f64> = (0..n)
            .flat_map(|_| {
                [rng.uniform_in(2000.0, 6000.0), rng.uniform_in(0.4, 0.6), rng.uniform_in(1000.0, 2000.0)]
            })
            .collect();
        let (zeros, mut y) = (vec![0.0; n], vec![0.0; n]);
        let run = Run { u: &u, y: &zeros, start: 10 };
        group.throughput(Throughput::Elements(n as u64));
        group.bench_function(format!("simulate_23_terms_{n}"), |b| {
            b.iter(|| torque.model.simulate(black_box(&torque.theta), &run, &mut y))
        });
        // Seven evaluations whatever the noise: the cost of a sample, not of a convergence.
        let sem = Sem { max_evaluations: 7, cost_tolerance: 0.0, ..Sem::default() };
        let data = [chapter_5(n)];
        group.bench_function(format!("sem_{n}"), |b| {
            b.iter(|| sem.estimate(&model, black_box(&data), None, &|| false))
        });
    }
    group.finish();
}

fn estimation(c: &mut Criterion) {
    let model = literature::torque_5_3().model;
    let data = [chapter_5(1000)];
    let mut group = c.benchmark_group("chapter_5");
    group.bench_function("ols", |b| {
        b.iter(|| Ols::default().estimate(&model, black_box(&data), None, &|| false))
    });
    group.bench_function("sem", |b| {
        b.iter(|| Sem::default().estimate(&model, black_box(&data), None, &|| false))
    });
    group.finish();
}

/// 4000 samples, 250 candidates, 40 terms.
fn selection(c: &mut Criterion) {
    let names: Vec<String> = ["a", "b", "c"].map(String::from).to_vec();
    let lagged: Vec<(usize, usize)> = (0..3).flat_map(|i| (1..=6).map(move |lag| (i, lag))).collect();
    let spec = PoolSpec {
        cubic: vec![(0, 1), (1, 1), (2, 1)],
        output_lags: vec![1, 2],
        output_times: lagged[..18].to_vec(),
        lagged,
    };
    let candidates: Vec<_> = spec.candidates().into_iter().take(250).collect();
    let pool = PolyNarx::new(names, "y".into(), candidates).unwrap();
    let mut rng = Rng64::new(7);
    let n = 4006;
    let u: Vec<f64> = (0..3 * n).map(|_| rng.uniform_in(0.5, 1.5)).collect();
    let mut y = vec![0.0; n];
    for t in 6..n {
        y[t] = 0.7 * y[t - 1]
            + u[3 * (t - 1)] * u[3 * (t - 3) + 1]
            + u[3 * (t - 2) + 2].powi(3)
            + 0.1 * rng.normal();
    }
    let data = [Experiment { name: "pool".into(), u, y, init_samples: 0, weights: Vec::new() }];
    let mut group = c.benchmark_group("frols");
    group.sample_size(10);
    group.bench_function(format!("{}_candidates_40_terms", pool.n_params()), |b| {
        b.iter(|| frols(&pool, black_box(&data), Stop::Terms(40)))
    });
    group.finish();
}

/// Prediction-error estimation of one system per structure, 2000 samples, from the least-squares start.
fn linear(c: &mut Criterion) {
    let cases = [
        ("arx", LinearModel::arx(&["u"], "y", 2, 2, 1), vec![-1.5, 0.7, 1.0, 0.5]),
        ("armax", LinearModel::armax(&["u"], "y", 2, 2, 2, 1), vec![-1.5, 0.7, 1.0, 0.5, -1.0, 0.2]),
        ("oe", LinearModel::oe(&["u"], "y", 2, 2, 1), vec![1.0, 0.5, -1.5, 0.7]),
        ("bj", LinearModel::bj(&["u"], "y", 2, 1, 1, 2, 1), vec![1.0, 0.5, 0.8, -0.9, -1.5, 0.7]),
        ("fir_arma", LinearModel::bj(&["u"], "y", 2, 1, 1, 0, 1), vec![1.0, 0.5, 0.6, -0.8]),
        ("arma", LinearModel::arma("y", 1, 2), vec![0.6, -1.2, 0.5]),
    ];
    let mut group = c.benchmark_group("linear_pem_2000");
    for (name, model, theta) in cases {
        let data = [linear_record(&model, &theta)];
        group.bench_function(name, |b| {
            b.iter(|| Pem::default().estimate(&model, black_box(&data), None, &|| false))
        });
    }
    group.finish();
}

/// The system driven by a random binary input and noise of standard deviation 0.5.
fn linear_record(model: &LinearModel, theta: &[f64]) -> Experiment {
    let p = model.polynomials(theta);
    let (n, mut rng) = (2000, Rng64::new(3));
    let back = |c: &[f64], x: &[f64], t: usize| -> f64 {
        (1..c.len()).filter(|j| *j <= t).map(|j| c[j] * x[t - j]).sum()
    };
    let (mut u, mut y, mut e, mut v, mut w) =
        (vec![0.0; n], vec![0.0; n], vec![0.0; n], vec![0.0; n], vec![0.0; n]);
    for t in 0..n {
        u[t] = if rng.uniform() < 0.5 { -1.0 } else { 1.0 };
        e[t] = 0.5 * rng.normal();
        v[t] = e[t] + back(&p.c, &e, t) - back(&p.d, &v, t);
        if let (Some(b), Some(f)) = (p.b.first(), p.f.first()) {
            w[t] = back(b, &u, t) - back(f, &w, t);
        }
        y[t] = w[t] + v[t] - back(&p.a, &y, t);
    }
    let u = if model.n_inputs() == 0 { Vec::new() } else { u };
    Experiment { name: "linear".into(), u, y, init_samples: 0, weights: Vec::new() }
}

/// 10 neurons, lags 1 to 5 of four inputs and one of the output (231 weights), 2000 samples.
fn network(c: &mut Criterion) {
    let (n, m, mut rng) = (2000, 4, Rng64::new(13));
    let names = ["inj", "spark", "throttle", "speed"];
    let net = NeuralNarx::new(&names, "torque", 10, 5, 1).unwrap();
    let mut u = vec![0.0; n * m];
    for t in 0..n {
        for i in 0..m {
            u[t * m + i] = if t % 50 == 0 { rng.uniform_in(-1.0, 1.0) } else { u[(t - 1) * m + i] };
        }
    }
    let truth = net.random_start(&mut Rng64::new(1));
    let start = net.random_start(&mut Rng64::new(2));
    let mut y = vec![0.0; n];
    net.simulate(&truth, &Run { u: &u, y: &vec![0.0; n], start: 5 }, &mut y);
    let data = [Experiment { name: "network".into(), u, y, init_samples: 0, weights: Vec::new() }];
    let run = data[0].run(&net);
    let (mut y, mut s) = (vec![0.0; n], vec![0.0; n * net.n_params()]);
    let mut group = c.benchmark_group("network_231_weights_2000");
    group.sample_size(10);
    group.bench_function("simulate", |b| b.iter(|| net.simulate(black_box(&start), &run, &mut y)));
    group.bench_function("jacobian", |b| {
        b.iter(|| net.sensitivities(black_box(&start), &run, &mut y, &mut s))
    });
    // Ten trials and the report of the covariance; a tenth of it is about one iteration.
    let sem = Sem { max_evaluations: 11, ..Sem::default() };
    group.bench_function("ten_lm_iterations", |b| {
        b.iter(|| sem.estimate(&net, black_box(&data), Some(&start), &|| false))
    });
    group.finish();
}

criterion_group!(benches, recursion, estimation, long_records, selection, linear, network);
criterion_main!(benches);
