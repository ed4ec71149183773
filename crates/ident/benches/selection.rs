//! Structure selection: ten and ten lags at degree 4 (10 626 candidates) over 25 000 samples, ten terms; and a small pool.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use dynocal_ident::experiment::Experiment;
use dynocal_ident::select::frols::{Stop, frols};
use dynocal_ident::select::pool::{PerInput, Pool, PoolKeys};
use dynocal_numerics::rng::Rng64;

/// A Duffing-like system: linear resonance, cubic stiffness, a product with the input.
fn record(n: usize) -> Experiment {
    let mut rng = Rng64::new(7);
    let u: Vec<f64> = (0..n).map(|_| rng.uniform_in(-1.0, 1.0)).collect();
    let mut y = vec![0.0; n];
    for t in 3..n {
        y[t] = 1.2 * y[t - 1] - 0.5 * y[t - 2] + 0.4 * u[t - 1] - 0.1 * y[t - 1].powi(3)
            + 0.1 * u[t - 2] * y[t - 2]
            + 0.05 * rng.normal();
    }
    Experiment { name: "duffing".into(), u, y, init_samples: 0, weights: Vec::new() }
}

fn pool(lags: usize, degree: u32) -> Pool {
    let keys = PoolKeys { ny: lags, nu: PerInput::All(lags), degree, ..PoolKeys::default() };
    keys.pool(&["u".to_string()], "y").expect("a pool")
}

fn selection(c: &mut Criterion) {
    let mut group = c.benchmark_group("frols");
    let (small, large) = (pool(4, 3), pool(10, 4));
    let data = [record(2_000)];
    group.bench_function("165_candidates_2000_samples", |b| {
        b.iter(|| frols(small.clone(), black_box(&data), Stop::Terms(10)))
    });
    let data = [record(25_000)];
    group.sample_size(10);
    group.bench_function("10626_candidates_25000_samples", |b| {
        b.iter(|| frols(large.clone(), black_box(&data), Stop::Terms(10)))
    });
    group.finish();
}

criterion_group!(benches, selection);
criterion_main!(benches);
