//! Which test gives the safest controller for its minutes: a design for the controller's loss beside D, I and a two-level signal.
//!
//! A linear plant is tested with N samples, a model is estimated, a PI is built that is best for the model, and it runs on the
//! plant. What it costs there beyond the best PI is its loss, whose mean over 40 estimates is compared for equal N.

use dynocal_control::experiment::{OutputError, Worth, curvature};
use dynocal_numerics::rng::Rng64;
use serde::{Deserialize, Serialize};

/// Samples of a test, and estimates from each.
const ROWS: usize = 200;
const ESTIMATES: usize = 40;
/// Samples of the run that costs, and the price of a movement of the input.
const RUN: usize = 80;
const PRICE: f64 = 0.5;

/// Mean loss of each test at one seed.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct WorthCase {
    pub(super) seed: u64,
    /// Best cost, and mean loss beyond it: two-level signal, D, I, for the controller.
    pub(super) best: f64,
    pub(super) losses: [f64; 4],
    /// Estimates whose PI lost stability on the plant.
    pub(super) unstable: [usize; 4],
}

/// Names in the order of the losses.
pub(super) const TESTS: [&str; 4] = ["two-level signal", "D", "I", "for the controller"];

/// The plant: two lags and two samples of dead time more than its model's numerator, known to the design.
fn plant() -> OutputError {
    OutputError { a: vec![-1.6, 0.63], b: vec![0.012, 0.010], noise_std: 0.1 }
}

/// Cost of a PI on a plant: squared error and movement after a step of the demand; infinite where it runs away.
fn cost(m: &OutputError, [kp, ki]: [f64; 2]) -> f64 {
    let (mut u, mut y) = ([0.0; RUN], [0.0; RUN]);
    let (mut integral, mut sum) = (0.0, 0.0);
    for t in 0..RUN {
        for (k, a) in m.a.iter().enumerate().take(t) {
            y[t] -= a * y[t - 1 - k];
        }
        for (k, b) in m.b.iter().enumerate().take(t) {
            y[t] += b * u[t - 1 - k];
        }
        let e = 1.0 - y[t];
        integral += ki * e;
        u[t] = kp * e + integral;
        let moved = if t > 0 { u[t] - u[t - 1] } else { 0.0 };
        sum += e * e + PRICE * 0.01 * moved * moved;
        if !(sum < 1e6) {
            return f64::INFINITY;
        }
    }
    sum
}

/// The PI that costs least on a model, by Newton steps of exact parabolas in the logarithms of its gains.
fn built(m: &OutputError, start: [f64; 2]) -> [f64; 2] {
    let of = |x: &[f64]| cost(m, [x[0].exp(), x[1].exp()]);
    let mut x = [start[0].ln(), start[1].ln()];
    let step = 1e-3;
    for _ in 0..60 {
        let now = of(&x);
        let slope = |k: usize| {
            let (mut up, mut down) = (x, x);
            up[k] += step;
            down[k] -= step;
            (of(&up) - of(&down)) / (2.0 * step)
        };
        let g = [slope(0), slope(1)];
        let h = curvature(&of, &x, &[step, step]);
        let det = h[0] * h[3] - h[1] * h[2];
        let newton = [-(h[3] * g[0] - h[1] * g[1]) / det, -(h[0] * g[1] - h[2] * g[0]) / det];
        let downhill = det > 0.0 && h[0] > 0.0 && newton.iter().all(|v| v.is_finite());
        let size = g[0].hypot(g[1]).max(1e-300);
        let way = if downhill { newton } else { [-0.1 * g[0] / size, -0.1 * g[1] / size] };
        let mut share = (0.5 / way[0].hypot(way[1]).max(1e-300)).min(1.0);
        let moved = loop {
            let tried = [x[0] + share * way[0], x[1] + share * way[1]];
            if of(&tried) < now {
                break Some(tried);
            }
            share *= 0.5;
            if share < 1e-9 {
                break None;
            }
        };
        match moved {
            Some(next) => x = next,
            None => break,
        }
    }
    [x[0].exp(), x[1].exp()]
}

/// Weight of I: mean of psi psi' over a step of the demand as the loop of its use makes it.
fn use_weight(m: &OutputError, gains: [f64; 2]) -> Vec<f64> {
    let (mut u, mut y, mut integral) = (vec![0.0; RUN], vec![0.0; RUN], 0.0);
    for t in 0..RUN {
        y[t] = m.output(&u[..=t])[t];
        integral += gains[1] * (1.0 - y[t]);
        u[t] = gains[0] * (1.0 - y[t]) + integral;
    }
    let p = m.parameters();
    let psi = m.sensitivities(&u);
    let mut r = vec![0.0; p * p];
    for row in psi.chunks(p) {
        (0..p * p).for_each(|k| r[k] += row[k / p] * row[k % p] / RUN as f64);
    }
    r
}

/// Losses of all tests at a seed.
pub(super) fn contest(seed: u64) -> Result<WorthCase, String> {
    let truth = plant();
    let theta = truth.theta();
    let best_gains = built(&truth, [2.0, 0.5]);
    let best = cost(&truth, best_gains);
    let loss = |x: &[f64]| cost(&truth, built(&truth.with(x), best_gains));
    let scale: Vec<f64> = theta.iter().map(|t| 2e-2 * t.abs()).collect();
    let scale: Vec<f64> = scale.iter().enumerate().map(|(k, s)| if k < 2 { 0.05 * s } else { *s }).collect();
    let h = curvature(&loss, &theta, &scale);
    let mut rng = Rng64::stream(seed, 0);
    let mut level = 1.0;
    let plain: Vec<f64> = (0..ROWS)
        .map(|_| {
            level = if rng.uniform() < 0.1 { -level } else { level };
            level
        })
        .collect();
    let designed =
        |w: &Worth| truth.designed(ROWS, w, seed).map(|d| d.1).map_err(|e| format!("seed {seed}: {e}"));
    let tests = [
        plain,
        designed(&Worth::Determinant)?,
        designed(&Worth::Weighted(use_weight(&truth, best_gains)))?,
        designed(&Worth::Weighted(h))?,
    ];
    let mut out = WorthCase { seed, best, losses: [0.0; 4], unstable: [0; 4] };
    for (k, u) in tests.iter().enumerate() {
        // The same noise for all tests.
        let mut rng = Rng64::stream(seed, 1);
        let clean = truth.output(u);
        for _ in 0..ESTIMATES {
            let y: Vec<f64> = clean.iter().map(|v| v + truth.noise_std * rng.normal()).collect();
            let own = cost(&truth, built(&truth.estimated(u, &y), best_gains));
            match own.is_finite() {
                true => out.losses[k] += (own - best) / ESTIMATES as f64,
                false => out.unstable[k] += 1,
            }
        }
    }
    Ok(out)
}
