//! How much a sample tells: what is shown a little too early or too late is off by as much as it moves.

use super::follow::{pressure, richness};
use super::loss::Loss;
use super::record::TransientRecord;
use crate::fuelling::Fuelling;

/// Errors below this tell nothing of a sensor: rests that are shown as if without any error must not make all that moves worth nothing.
const LEAST: f64 = 1e-4;
/// Variances over that of what stands still are searched up to this, for a movement of the usual size.
const MOST: f64 = 1e4;
/// Intervals of the search, and how often each is cut.
const GRID: usize = 24;
const CUTS: usize = 30;

/// Weights of all samples of records,
///
/// ```text
/// w = 1 / sqrt(1 + r (d phi/dt)^2),   e ~ N(0, s^2 (1 + r (d phi/dt)^2)),   phi: 1 / lambda as the model shows it, e: its error as it counts
/// ```
///
/// with r of the greatest likelihood (a variance function, M. Davidian, R. J. Carroll, J. Am. Stat. Assoc. 82, 1987, 1079-1091): no model of
/// mean values has every moment of transport and mixing, and where fuel is far from its air such errors are many times those of the charge.
/// On `pfi_1_6l` they moved the moment of the air by some milliseconds, and 4 ms are 1 % of lambda after steps of a fuel that follows it.
pub(super) fn weights(records: &[TransientRecord<'_>], f: &Fuelling, loss: Loss) -> Vec<f64> {
    let mut squares: Vec<[f64; 2]> = Vec::new();
    let mut moves: Vec<f64> = Vec::new();
    for r in records {
        let shown = richness(r, f, &pressure(r, f));
        let last = shown.len() - 1;
        for (t, (phi, lambda)) in shown.iter().zip(r.lambda).enumerate() {
            let over = shown[(t + 1).min(last)] - shown[t.saturating_sub(1)];
            let moved = (0.5 * over / r.sample_time_s).powi(2);
            let error = loss.of(1.0 / lambda - phi).powi(2);
            if t >= r.counts_from() && error.is_finite() && moved.is_finite() {
                squares.push([error + LEAST * LEAST, moved]);
            }
            moves.push(moved);
        }
    }
    let ratio = likely(&squares);
    moves.iter().map(|m| if m.is_finite() { 1.0 / (1.0 + ratio * m).sqrt() } else { 0.0 }).collect()
}

/// r for squares of errors and of movements.
fn likely(squares: &[[f64; 2]]) -> f64 {
    let n = squares.len().max(1) as f64;
    let usual = squares.iter().map(|s| s[1]).sum::<f64>() / n;
    if !(usual > 0.0) {
        return 0.0;
    }
    // Twice the negative logarithm of the likelihood over n.
    let cost = |ratio: f64| {
        let (mut sum, mut logs) = (0.0, 0.0);
        for [error, moved] in squares {
            let by = 1.0 + ratio * moved;
            sum += error / by;
            logs += by.ln();
        }
        (sum / n).max(f64::MIN_POSITIVE).ln() + logs / n
    };
    let at = |k: f64| (MOST * 10.0_f64.powf(-8.0 * (1.0 - k / GRID as f64))) / usual;
    let best = (0..=GRID).map(|k| k as f64).min_by(|a, b| cost(at(*a)).total_cmp(&cost(at(*b))));
    let Some(best) = best.filter(|k| cost(at(*k)) < cost(0.0)) else { return 0.0 };
    let (mut low, mut high) = ((best - 1.0).max(0.0), (best + 1.0).min(GRID as f64));
    for _ in 0..CUTS {
        let (a, b) = (low + (high - low) / 3.0, high - (high - low) / 3.0);
        if cost(at(a)) < cost(at(b)) { high = b } else { low = a }
    }
    at(0.5 * (low + high))
}

#[cfg(test)]
mod tests {
    use super::*;
    use dynocal_numerics::rng::Rng64;

    /// Errors that go with movement are found as they were made; where none do, all samples count alike.
    #[test]
    fn the_variance_that_goes_with_movement_is_found() {
        let made = |ratio: f64| -> Vec<[f64; 2]> {
            let mut rng = Rng64::stream(3, 0);
            let of = |_| {
                let moved = rng.normal().powi(2);
                [(1e-3 * rng.normal()).powi(2) * (1.0 + ratio * moved), moved]
            };
            (0..20_000).map(of).collect()
        };
        let found = likely(&made(9.0));
        assert!((found / 9.0 - 1.0).abs() < 0.1, "{found}");
        assert!(likely(&made(0.0)) < 0.02, "{}", likely(&made(0.0)));
        assert_eq!(likely(&[[1.0, 0.0]; 8]), 0.0);
    }
}
