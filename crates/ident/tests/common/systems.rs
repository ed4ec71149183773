//! Simulated linear systems whose truth is known, written out by the difference equation of each part: independent of
//! the filters that are tested.

use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::linear::{InputOrders, LinearModel, Polynomials};
use dynocal_numerics::rng::Rng64;

/// Truth and orders of a simulated system.
#[derive(Clone, Debug)]
pub(crate) struct System {
    pub(crate) model: LinearModel,
    pub(crate) theta: Vec<f64>,
    pub(crate) noise_std: f64,
    /// Gain from the output to every input; 0 for an open loop.
    pub(crate) feedback: f64,
}

/// Record of a system. Inputs are binary references minus `feedback` times the output.
pub(crate) fn simulate(s: &System, n: usize, seed: u64) -> Experiment {
    simulate_with_reference(s, n, seed).0
}

/// The same with the reference that drives the loop (N x m).
pub(crate) fn simulate_with_reference(s: &System, n: usize, seed: u64) -> (Experiment, Vec<f64>) {
    let m = s.model.n_inputs();
    let p = s.model.polynomials(&s.theta);
    let mut rng = Rng64::new(seed);
    let mut r = vec![1.0; m];
    let mut reference = vec![0.0; n * m];
    let (mut u, mut y) = (vec![0.0; n * m], vec![0.0; n]);
    let (mut e, mut v, mut w) = (vec![0.0; n], vec![0.0; n], vec![vec![0.0; n]; m]);
    let back = |c: &[f64], x: &[f64], t: usize| -> f64 {
        (1..c.len()).filter(|j| *j <= t).map(|j| c[j] * x[t - j]).sum()
    };
    for t in 0..n {
        for i in 0..m {
            if rng.uniform() < 0.3 {
                r[i] = -r[i];
            }
            reference[t * m + i] = r[i];
            u[t * m + i] = r[i];
        }
        e[t] = s.noise_std * rng.normal();
        v[t] = e[t] + back(&p.c, &e, t) - back(&p.d, &v, t);
        let mut driven = v[t];
        for i in 0..m {
            let b: f64 = (0..p.b[i].len()).filter(|j| *j <= t).map(|j| p.b[i][j] * u[(t - j) * m + i]).sum();
            w[i][t] = b - back(&p.f[i], &w[i], t);
            driven += w[i][t];
        }
        y[t] = driven - back(&p.a, &y, t);
        // A loop is closed around delayed inputs only.
        (0..m).for_each(|i| u[t * m + i] -= s.feedback * y[t]);
    }
    (Experiment { name: "simulated".into(), u, y, init_samples: 0, weights: Vec::new() }, reference)
}

/// A monic polynomial of order `n` with random roots of radius up to `radius`.
pub(crate) fn random_polynomial(n: usize, radius: f64, rng: &mut Rng64) -> Vec<f64> {
    let mut p = vec![1.0];
    while p.len() <= n {
        // The square root makes radii near the circle more frequent than near zero.
        let r = radius * rng.uniform().sqrt();
        let factor = if n + 1 - p.len() >= 2 && rng.uniform() < 0.6 {
            vec![1.0, -2.0 * r * (std::f64::consts::PI * rng.uniform_in(0.02, 0.9)).cos(), r * r]
        } else {
            vec![1.0, if rng.uniform() < 0.85 { -r } else { r }]
        };
        let mut product = vec![0.0; p.len() + factor.len() - 1];
        for (i, a) in p.iter().enumerate() {
            factor.iter().enumerate().for_each(|(j, b)| product[i + j] += a * b);
        }
        p = product;
    }
    p
}

/// Random parameters of the orders of `model`: stable A, D, F and C, B of about one.
pub(crate) fn random_theta(model: &LinearModel, rng: &mut Rng64) -> Vec<f64> {
    let p = Polynomials {
        a: random_polynomial(model.na, 0.97, rng),
        b: model
            .orders
            .iter()
            .map(|o| (0..o.nk + o.nb).map(|j| if j < o.nk { 0.0 } else { rng.normal() }).collect())
            .collect(),
        c: random_polynomial(model.nc, 0.95, rng),
        d: random_polynomial(model.nd, 0.97, rng),
        f: model.orders.iter().map(|o| random_polynomial(o.nf, 0.98, rng)).collect(),
    };
    model.parameters(&p)
}

/// A random system of a kind `case % 7`: ARX, ARMAX, OE, BJ, FIR with ARMA noise, ARMA, ARARMAX; one or two inputs with
/// orders and delays of their own, noise from a tenth to three times the response, every third loop closed.
pub(crate) fn random_system(case: u64) -> (System, Experiment) {
    let mut rng = Rng64::stream(4711, case);
    let kind = case % 7;
    let closed = case.is_multiple_of(3) && kind != 5;
    let m = if kind == 5 { 0 } else { 1 + rng.below(2) };
    let order = |rng: &mut Rng64, most: usize| 1 + rng.below(most);
    let orders = (0..m)
        .map(|_| InputOrders {
            nb: order(&mut rng, 3),
            nf: if kind == 2 || kind == 3 { order(&mut rng, 3) } else { 0 },
            nk: rng.below(5).max(usize::from(closed)),
        })
        .collect();
    let model = LinearModel {
        inputs: (0..m).map(|i| format!("u{i}")).collect(),
        output: "y".into(),
        na: if matches!(kind, 0 | 1 | 6) { order(&mut rng, 3) } else { 0 },
        orders,
        nc: if matches!(kind, 1 | 3..=6) { order(&mut rng, 2) } else { 0 },
        nd: if matches!(kind, 3..=6) { order(&mut rng, 2) } else { 0 },
    };
    let n = [300, 600, 1200][rng.below(3)];
    let level = 10f64.powf(rng.uniform_in(-1.0, 0.5));
    loop {
        let theta = random_theta(&model, &mut rng);
        let seed = rng.below(1 << 30) as u64;
        let mut s = System { model: model.clone(), theta, noise_std: 1.0, feedback: 0.0 };
        // Noise in units of the response to the inputs.
        let rms = |e: &Experiment| (e.y.iter().map(|v| v * v).sum::<f64>() / e.len() as f64).sqrt();
        if m > 0 {
            let quiet = rms(&simulate(&System { noise_std: 0.0, ..s.clone() }, n, seed));
            let loud = rms(&simulate(&System { theta: silent(&s), ..s.clone() }, n, seed));
            s.noise_std = level * quiet / loud;
            if closed {
                s.feedback = 0.3 / quiet;
            }
        }
        let e = simulate(&s, n, seed);
        let open = rms(&simulate(&System { feedback: 0.0, ..s.clone() }, n, seed));
        // A loop that amplifies is no bed that anyone would run.
        if e.y.iter().all(|v| v.is_finite()) && rms(&e) < 3.0 * open && s.noise_std.is_finite() {
            return (s, e);
        }
    }
}

/// The parameters with B = 0.
fn silent(s: &System) -> Vec<f64> {
    let mut p = s.model.polynomials(&s.theta);
    p.b.iter_mut().for_each(|b| b.fill(0.0));
    s.model.parameters(&p)
}
