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
    let (mut points, mut seen) = (Vec::new(), Vec::new());
    for (d, _) in data {
        let columns = |names: &[&String]| names.iter().map(|n| d.values(n)).collect::<Result<Vec<_>, _>>();
        let (at, moved) = (columns(&names)?, columns(&inputs)?);
        for t in (0..d.len()).step_by(STRIDE) {
            points.push(at.iter().zip(&scales).map(|(v, s)| v[t] / s).collect::<Vec<f64>>());
            seen.push(moved.iter().map(|v| v[t]).collect::<Vec<f64>>());
        }
    }
    let given: Vec<Vec<f64>> =
        ctx.channels.given.iter().map(|g| start.values(g).map(<[f64]>::to_vec)).collect::<Result<_, _>>()?;
    let references: Vec<&Vec<f64>> = demands.iter().chain(&given).collect();
    let near = ((NEAR * points.len() as f64) as usize).clamp(1, points.len().max(1));
    let n = start.len();
    let mut bounds = vec![(vec![0.0; n], vec![0.0; n]); inputs.len()];
    let mut order: Vec<(f64, usize)> = Vec::with_capacity(points.len());
    for from in (0..n).step_by(STRIDE) {
        let at: Vec<f64> = references.iter().zip(&scales).map(|(v, s)| v[from] / s).collect();
        order.clear();
        order.extend(
            points
                .iter()
                .enumerate()
                .map(|(k, p)| (p.iter().zip(&at).map(|(a, b)| (a - b).powi(2)).sum(), k)),
        );
        if order.len() > near {
            order.select_nth_unstable_by(near, |a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        }
        for (i, (lower, upper)) in bounds.iter_mut().enumerate() {
            let values = order.iter().take(near).map(|(_, k)| seen[*k][i]);
            let (least, most) =
                values.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
            let beyond = BEYOND * (most - least);
            let to = (from + STRIDE).min(n);
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
