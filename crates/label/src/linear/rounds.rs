//! Solutions one after the other until the correlation of what is left, and the loss, have settled.

use super::normal::{Normal, Smooth};
use super::{Options, Problem, huber};
use crate::correlation;
use crate::error::LabelError;

/// What the equations are of in the end: changes that the samples ask for, the solution, samples of one fact.
pub(super) struct Rounds {
    pub(super) offset: Vec<f64>,
    pub(super) found: Smooth,
    pub(super) tau: f64,
}

/// Rounds of a plain fit, of a robust one, and of these those that choose the smoothness.
const PLAIN: usize = 6;
const ROBUST: usize = 60;
/// Change of what is left, as a share of its square, at which a robust fit stands.
const STANDS: f64 = 1e-16;

/// Changes of the free cells that lead to `place`.
pub(super) fn change(place: &[f64], base: &[f64], map: &[Option<usize>]) -> Vec<f64> {
    (0..map.len()).filter(|c| map[*c].is_some()).map(|c| place[c] - base[c]).collect()
}

/// Solves until correlation and loss have settled, from `start` where there is one.
pub(super) fn rounds(
    p: &Problem,
    options: &Options,
    map: &[Option<usize>],
    normal: &mut Normal,
    (measured, weights): (&[f64], &[f64]),
    start: Option<Vec<f64>>,
) -> Result<Rounds, LabelError> {
    let mut offset = measured.to_vec();
    // From the smooth side: a fit that follows the noise would leave nothing correlated behind, and think that it may.
    let mut found = normal.solve(p, map, &offset, weights, 1.0, Some(options.smooth.unwrap_or(1.0)))?;
    if let (Some(start), true) = (start, options.robust) {
        found.delta = start;
    }
    // The correlation shows in the residuals, and the smoothness depends on it: a few rounds settle both.
    let (mut tau, mut smooth) = (1.0, options.smooth);
    let mut left: Vec<f64> = Vec::new();
    for round in 0..if options.robust { ROBUST } else { PLAIN } {
        let mut residuals = residuals(p, map, measured, &found.delta);
        let mut stands = true;
        if options.robust {
            let cut = huber::pseudo(&residuals, weights);
            for k in 0..cut.len() {
                offset[k] = measured[k] - residuals[k] + cut[k];
            }
            normal.forget();
            let moved: f64 = left.iter().zip(&cut).map(|(a, b)| (a - b).powi(2)).sum();
            stands = !left.is_empty() && moved <= STANDS * cut.iter().map(|r| r * r).sum::<f64>();
            left.clone_from(&cut);
            residuals = cut;
            if round >= PLAIN {
                smooth = Some(found.smooth);
            }
        }
        let next = correlation::time_samples(&residuals, &p.segments);
        if round > 0 && stands && (next - tau).abs() < 1e-3 * tau {
            break;
        }
        tau = next;
        let cautious = found.cautious;
        found = normal.solve(p, map, &offset, weights, tau, smooth)?;
        if options.smooth.is_none() && smooth.is_some() {
            found.cautious = cautious;
        }
    }
    Ok(Rounds { offset, found, tau })
}

/// What the samples ask for beyond `delta`.
pub(super) fn residuals(p: &Problem, map: &[Option<usize>], offset: &[f64], delta: &[f64]) -> Vec<f64> {
    (0..offset.len())
        .map(|k| {
            let (at, w) = p.rows.row(k);
            offset[k] - at.iter().zip(w).filter_map(|(j, w)| map[*j].map(|f| w * delta[f])).sum::<f64>()
        })
        .collect()
}
