//! A resonance with cubic stiffness and a product with the input, and pools that hold its terms.
#![allow(dead_code)]

use dynocal_ident::experiment::Experiment;
use dynocal_ident::select::pool::{PerInput, Pool, PoolKeys};
use dynocal_numerics::rng::Rng64;

pub(crate) fn keys(ny: usize, nu: usize, degree: u32) -> PoolKeys {
    PoolKeys { ny, nu: PerInput::All(nu), degree, ..PoolKeys::default() }
}

pub(crate) fn pool(ny: usize, nu: usize, degree: u32) -> Pool {
    keys(ny, nu, degree).pool(&["u".to_string()], "y").unwrap()
}

pub(crate) const TRUE_TERMS: [&str; 5] = ["u(t-1)", "u(t-2)*y(t-2)", "y(t-1)", "y(t-1)^3", "y(t-2)"];

/// y(t) = 1.2 y(t-1) - 0.5 y(t-2) + 0.4 u(t-1) - 0.1 y(t-1)^3 + 0.1 u(t-2) y(t-2) + e(t).
pub(crate) fn record(n: usize, noise: f64, seed: u64) -> Experiment {
    let mut rng = Rng64::new(seed);
    let u: Vec<f64> = (0..n).map(|_| rng.uniform_in(-1.0, 1.0)).collect();
    let mut y = vec![0.0; n];
    for t in 2..n {
        y[t] = 1.2 * y[t - 1] - 0.5 * y[t - 2] + 0.4 * u[t - 1] - 0.1 * y[t - 1].powi(3)
            + 0.1 * u[t - 2] * y[t - 2]
            + noise * rng.normal();
    }
    Experiment { name: format!("r{seed}"), u, y, init_samples: 0, weights: Vec::new() }
}
