//! Tests for control: information and gradients against differences, expected loss against drawn estimates.

use dynocal_control::experiment::{OutputError, Worth, curvature};
use dynocal_numerics::rng::Rng64;

fn plant() -> OutputError {
    OutputError { a: vec![-1.5, 0.6], b: vec![0.05, 0.04], noise_std: 0.2 }
}

fn input(rows: usize, seed: u64) -> Vec<f64> {
    let mut rng = Rng64::new(seed);
    (0..rows).map(|_| rng.uniform_in(-1.0, 1.0)).collect()
}

#[test]
fn sensitivities_and_gradients_are_exact() {
    let (m, u) = (plant(), input(60, 1));
    let psi = m.sensitivities(&u);
    for k in 0..4 {
        let moved = |d: f64| {
            let mut theta = m.theta();
            theta[k] += d;
            m.with(&theta).output(&u)
        };
        let (up, down) = (moved(1e-6), moved(-1e-6));
        for t in 0..60 {
            let slope = (up[t] - down[t]) / 2e-6;
            assert!((psi[t * 4 + k] - slope).abs() < 1e-6 * (1.0 + slope.abs()), "{t} {k}");
        }
    }
    let h: Vec<f64> = (0..16).map(|k| if k % 5 == 0 { 1.0 + k as f64 } else { 0.3 }).collect();
    for worth in [Worth::Determinant, Worth::Weighted(h)] {
        let (_, gradient) = m.criterion(&u, &worth).unwrap();
        for t in [0, 3, 17, 40, 58] {
            let moved = |d: f64| {
                let mut u = u.clone();
                u[t] += d;
                m.criterion(&u, &worth).unwrap().0
            };
            let slope = (moved(1e-5) - moved(-1e-5)) / 2e-5;
            assert!(
                (gradient[t] - slope).abs() < 1e-5 * (slope.abs() + 1e-3),
                "{worth:?} {t}: {} {slope}",
                gradient[t]
            );
        }
    }
}

/// Deviations of estimates are those of the information, and half the trace is the loss of estimates that are drawn.
#[test]
fn the_expected_loss_is_that_of_estimates() {
    let m = plant();
    let (_, u) = m.designed(300, &Worth::Determinant, 2).unwrap();
    let rows = 8;
    let h: Vec<f64> = (0..16).map(|k| if k % 5 == 0 { 1.0 } else { 0.0 }).collect();
    let promised = m.criterion(&u, &Worth::Weighted(h.clone())).unwrap().0;
    let clean = m.output(&u);
    let mut rng = Rng64::new(9);
    let (mut sum, trials) = (0.0, 40 * rows);
    for _ in 0..trials {
        let y: Vec<f64> = clean.iter().map(|v| v + m.noise_std * rng.normal()).collect();
        let found = m.estimated(&u, &y);
        sum += 0.5 * found.theta().iter().zip(m.theta()).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
    }
    let met = sum / trials as f64;
    assert!((met / promised - 1.0).abs() < 0.25, "met {met}, promised {promised}");
}

/// The search makes its criterion smaller than it began, for any seed, within its limits; silence is refused.
#[test]
fn designs_are_better_than_where_they_began() {
    let m = plant();
    for seed in 0..5 {
        let (value, u) = m.designed(150, &Worth::Determinant, seed).unwrap();
        assert!(u.iter().all(|v| v.abs() <= 1.0));
        let (random, _) = m.criterion(&input(150, seed), &Worth::Determinant).unwrap();
        assert!(value < random, "{value} {random}");
    }
    let text = m.criterion(&[0.0; 50], &Worth::Determinant).unwrap_err().to_string();
    assert!(text.contains("does not tell all parameters"), "{text}");
    // A loss whose second derivatives are known.
    let h = curvature(&|x| 3.0 * x[0] * x[0] + x[0] * x[1] + 2.0 * x[1] * x[1], &[0.3, 0.1], &[1e-3, 1e-3]);
    assert!((h[0] - 6.0).abs() < 1e-6 && (h[1] - 1.0).abs() < 1e-6 && (h[3] - 4.0).abs() < 1e-6);
}
