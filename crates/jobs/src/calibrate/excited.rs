//! How far inputs were moved where the plant was driven alike: an optimum stays there, because models know little beyond.
//!
//! The inputs that loops drive follow from the operating point: at each sample of a record of references the samples of the measured
//! records that are nearest to it in demands and given channels, each by its range, give the least and greatest value that was seen.
//! Inputs that no loop drives are moved over their whole range everywhere and need no such bounds.

use super::context::Context;
use super::error::ChainError;
use dynocal_calib::optimise::bound_channels;
use dynocal_ident::data::{Channel, Dataset, Role};
use std::path::PathBuf;

/// Share of the measured samples that count as near, and how far beyond what they saw an input may go, in widths of that.
const NEAR: f64 = 0.02;
const BEYOND: f64 = 0.25;
/// Every so many samples the neighbours are looked for; between them operating points hardly differ.
const STRIDE: usize = 5;

/// Measured samples: operating points, scaled, and what the inputs of loops were there.
#[derive(Default)]
struct Seen {
    points: Vec<Vec<f64>>,
    moved: Vec<Vec<f64>>,
}

impl Seen {
    /// Least and greatest value of each input at the [`NEAR`] share of the samples that lie nearest to `at`, the earlier of equally
    /// near ones.
    fn around(&self, at: &[f64]) -> Vec<(f64, f64)> {
        let distance = |p: &[f64]| p.iter().zip(at).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
        let mut order: Vec<(f64, usize)> =
            self.points.iter().enumerate().map(|(k, p)| (distance(p), k)).collect();
        let near = ((NEAR * order.len() as f64) as usize).clamp(1, order.len().max(1));
        if order.len() > near {
            order.select_nth_unstable_by(near, |a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            order.truncate(near);
        }
        let inputs = self.moved.first().map_or(0, Vec::len);
        let range = |i: usize| {
            let values = order.iter().map(|(_, k)| self.moved[*k][i]);
            values.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)))
        };
        (0..inputs).map(range).collect()
    }
}

/// Adds the channels `<input>_lower` and `<input>_upper` for the inputs of loops to a record of references `demands`.
///
/// # Errors
/// [`ChainError`]: a record lacks a channel.
pub(super) fn bounded(
    ctx: &Context,
    start: &mut Dataset,
    demands: &[Vec<f64>],
    data: &[(Dataset, PathBuf)],
) -> Result<(), ChainError> {
    let problem = &ctx.spec.problem;
    let ranges = problem
        .demands
        .iter()
        .map(|d| d.upper - d.lower)
        .chain(problem.given.iter().map(|g| g.upper - g.lower));
    let scales: Vec<f64> = ranges.collect();
    let names: Vec<&String> = ctx.channels.demands.iter().chain(&ctx.channels.given).collect();
    let inputs: Vec<&String> = ctx.channels.driven.iter().map(|i| &ctx.channels.inputs[*i]).collect();
    let mut seen = Seen::default();
    for (d, _) in data {
        let columns = |names: &[&String]| names.iter().map(|n| d.values(n)).collect::<Result<Vec<_>, _>>();
        let (at, moved) = (columns(&names)?, columns(&inputs)?);
        for t in (0..d.len()).step_by(STRIDE) {
            seen.points.push(at.iter().zip(&scales).map(|(v, s)| v[t] / s).collect());
            seen.moved.push(moved.iter().map(|v| v[t]).collect());
        }
    }
    let given: Vec<Vec<f64>> =
        ctx.channels.given.iter().map(|g| start.values(g).map(<[f64]>::to_vec)).collect::<Result<_, _>>()?;
    let references: Vec<&Vec<f64>> = demands.iter().chain(&given).collect();
    let n = start.len();
    let mut bounds = vec![(vec![0.0; n], vec![0.0; n]); inputs.len()];
    for from in (0..n).step_by(STRIDE) {
        let at: Vec<f64> = references.iter().zip(&scales).map(|(v, s)| v[from] / s).collect();
        let to = (from + STRIDE).min(n);
        for ((lower, upper), (least, most)) in bounds.iter_mut().zip(seen.around(&at)) {
            let beyond = BEYOND * (most - least);
            lower[from..to].fill(least - beyond);
            upper[from..to].fill(most + beyond);
        }
    }
    for (name, (lower, upper)) in inputs.into_iter().zip(bounds) {
        for (bound, values) in bound_channels(name).into_iter().zip([lower, upper]) {
            let unit = problem.unit(name).unwrap_or("-").to_string();
            start.channels.push(Channel { name: bound, unit, role: Role::Auxiliary, values });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use dynocal_numerics::rng::Rng64;

    /// Against all samples sorted by their distance.
    #[test]
    fn the_range_is_that_of_the_nearest_samples() {
        let mut rng = Rng64::stream(5, 0);
        let mut seen = Seen::default();
        for _ in 0..500 {
            let point = vec![rng.uniform(), rng.uniform()];
            seen.moved.push(vec![3.0 * point[0] + 0.1 * rng.uniform(), rng.uniform()]);
            seen.points.push(point);
        }
        for at in [[0.5, 0.5], [0.0, 1.0], [2.0, -1.0]] {
            let far = |k: &usize| {
                let p = &seen.points[*k];
                (p[0] - at[0]).hypot(p[1] - at[1])
            };
            let mut all: Vec<usize> = (0..500).collect();
            all.sort_by(|a, b| far(a).total_cmp(&far(b)));
            let found = seen.around(&at);
            for (i, (least, most)) in found.iter().enumerate() {
                let values = all[..10].iter().map(|k| seen.moved[*k][i]);
                assert_eq!(*least, values.clone().fold(f64::INFINITY, f64::min));
                assert_eq!(*most, values.fold(f64::NEG_INFINITY, f64::max));
            }
        }
    }

    /// Few samples: the nearest of them alone.
    #[test]
    fn one_sample_is_enough() {
        let seen = Seen { points: vec![vec![0.0], vec![1.0]], moved: vec![vec![4.0], vec![6.0]] };
        assert_eq!(seen.around(&[0.9]), [(6.0, 6.0)]);
    }
}
