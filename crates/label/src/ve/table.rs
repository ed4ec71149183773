//! The fit of a table: what is known of each cell, and what the others take from their neighbours.
//!
//! A cell is *known* with one independent measurement at itself or more. Cells with less are fitted too, but by no greater and no lesser
//! share of their value than the known cells around them change by; cells without data have the share that the harmonic extension of the
//! others gives them ([`crate::follow`]), and keep their value unless the user asks for it. What is smoothed is the change of a cell as a
//! share of its value: a table is wrong by shares, and a small value is not to be off by as many counts as a large one.

use super::Used;
use crate::error::LabelError;
use crate::follow;
use crate::label::Label;
use crate::linear::{self, Fit, Options, Problem, Role, Verdict};

/// Independent measurements at a cell from which it is known.
pub const KNOWN: f64 = 1.0;

/// The label with what a fuel table needs: changes in shares of its own values, and no value that is none.
///
/// A cell of 0 has the least positive value of the table as its size.
pub fn prepared(label: &Label) -> Label {
    let least = least_positive(label);
    let mut out = label.clone();
    out.sizes = label.base.iter().map(|v| v.max(least)).collect();
    // Fuel must come: one step that the ECU can hold at least.
    out.lower = out.lower.max(label.step.unwrap_or(0.0).min(least));
    out
}

fn least_positive(label: &Label) -> f64 {
    let least = label.base.iter().copied().filter(|v| *v > 0.0).fold(f64::INFINITY, f64::min);
    if least.is_finite() { least } else { 1.0 }
}

/// Fits all cells that samples reach; residuals count in shares of the measured lambda.
///
/// # Errors
/// [`LabelError`].
pub fn fit(label: &Label, used: &Used, options: &Options) -> Result<Fit, LabelError> {
    within(label, used, options, Vec::new(), Vec::new())
}

fn within(
    label: &Label,
    used: &Used,
    options: &Options,
    roles: Vec<Role>,
    bounds: Vec<Option<[f64; 2]>>,
) -> Result<Fit, LabelError> {
    let weights: Vec<f64> = used.y.iter().map(|y| 1.0 / (y * y)).collect();
    let problem = Problem {
        labels: std::slice::from_ref(label),
        rows: &used.rows,
        target: &used.y,
        weights: Some(&weights),
        segments: used.segments(),
        roles,
        bounds,
    };
    linear::fit(&problem, &Options { extrapolate: false, least_visits: 0.0, ..options.clone() })
}

/// The table: all cells that samples reach, those with less than one independent measurement within the change of known ones.
///
/// The first fit, of all cells that samples reach, says how many samples are one independent measurement, how many of these each cell
/// has, and by which share the known cells change. In the second a cell with fewer lies between the least and the greatest share of the
/// known cells that its extension leads to. No value of a known cell is less than the least one of the table as it was, times the share by
/// which known cells changed in the middle: what lies lower is no engine, but an error that the cell took upon itself.
///
/// Where no cell is known the table is the one that it was.
///
/// # Errors
/// [`LabelError`].
pub fn known(label: &Label, used: &Used, options: &Options) -> Result<Fit, LabelError> {
    let first = fit(label, used, options)?;
    let is: Vec<bool> = first.facts.iter().zip(&label.locked).map(|(f, l)| *f >= KNOWN && !*l).collect();
    if !is.iter().any(|k| *k) {
        return Ok(nothing(label, first));
    }
    let least = bounded(label, &first, &is);
    // Shares of known cells as they will be: within their own bound.
    let share = |k: usize| (first.exact[k].max(least.lower) - label.base[k]) / size(label, k);
    let around = follow::extension(label, &is)?;
    let reached = |k: usize| first.visits[k] > 0.0 && !around[k].is_empty() && !label.locked[k];
    let bounds = (0..label.len()).map(|k| {
        (!is[k] && reached(k)).then(|| {
            let all = || around[k].iter().map(|(j, _)| share(*j));
            let at = |s: f64, whole: fn(f64) -> f64| {
                let v = label.base[k] + size(label, k) * s;
                // In whole steps, outwards: there must be one.
                label
                    .step
                    .map_or(v, |step| label.origin + step * whole((v - label.origin) / step))
                    .clamp(label.lower, label.upper)
            };
            [
                at(all().fold(f64::INFINITY, f64::min), f64::floor),
                at(all().fold(f64::NEG_INFINITY, f64::max), f64::ceil),
            ]
        })
    });
    let bounds: Vec<Option<[f64; 2]>> = bounds.collect();
    let fitted: Vec<bool> = (0..label.len()).map(|k| is[k] || reached(k)).collect();
    let roles = roles(label, &fitted)?;
    let mut fit = within(&least, used, options, roles, bounds)?;
    tell(label, &first, &is, &fitted, options.extrapolate, &mut fit);
    fit.facts.clone_from(&first.facts);
    Ok(fit)
}

/// Where no cell is known nothing changes.
fn nothing(label: &Label, mut first: Fit) -> Fit {
    first.values.clone_from(&label.base);
    first.exact.clone_from(&label.base);
    for k in (0..label.len()).filter(|k| !label.locked[*k]) {
        first.verdicts[k] = Verdict::Untouched;
        first.half_width[k] = f64::INFINITY;
    }
    (first.rms[1], first.proven) = (first.rms[0], None);
    first.held.clear();
    first
}

/// Whether any cell has one independent measurement.
pub fn knows(found: &Fit) -> bool {
    found.facts.iter().any(|f| *f >= KNOWN)
}

fn size(label: &Label, k: usize) -> f64 {
    label.sizes.get(k).copied().unwrap_or(1.0)
}

/// Cells without data follow: what is smoothed does not end at them.
fn roles(label: &Label, fitted: &[bool]) -> Result<Vec<Role>, LabelError> {
    let means = follow::extension(label, fitted)?;
    let role = |(k, mean): (usize, Vec<(usize, f64)>)| match (fitted[k], mean.is_empty()) {
        (true, _) => Role::Fitted,
        (false, true) => Role::Held,
        // Shares of change, as changes.
        (false, false) => {
            Role::Follows(mean.into_iter().map(|(j, w)| (j, w * size(label, k) / size(label, j))).collect())
        }
    };
    Ok(means.into_iter().enumerate().map(role).collect())
}

fn bounded(label: &Label, first: &Fit, known: &[bool]) -> Label {
    let mut shares: Vec<f64> = (0..label.len())
        .filter(|k| known[*k] && label.base[*k] > 0.0)
        .map(|k| first.exact[k] / label.base[k])
        .collect();
    shares.sort_by(f64::total_cmp);
    let middle = shares.get(shares.len() / 2).copied().unwrap_or(1.0);
    let mut out = label.clone();
    // In whole steps, downwards.
    let least = least_positive(label) * middle.clamp(0.0, 1.0);
    let whole = label.step.map_or(least, |s| label.origin + s * ((least - label.origin) / s).floor());
    out.lower = label.lower.max(whole).min(label.upper);
    out
}

/// What is said of cells that are not known: their interval is that of a fit of their own, as far as that lies away.
fn tell(label: &Label, first: &Fit, known: &[bool], fitted: &[bool], extrapolate: bool, fit: &mut Fit) {
    for k in (0..label.len()).filter(|k| !known[*k] && !label.locked[*k]) {
        if fitted[k] {
            fit.verdicts[k] = Verdict::Pulled;
            fit.half_width[k] = first.half_width[k] + (fit.exact[k] - first.exact[k]).abs();
            continue;
        }
        fit.verdicts[k] = Verdict::Untouched;
        fit.half_width[k] = f64::INFINITY;
        if !extrapolate {
            fit.values[k] = label.base[k];
            fit.exact[k] = label.base[k];
        }
    }
}

/// Cells beside each other that differ by more than any two of the table as it was: numbers of the two cells, and how many times the first
/// has the second's value. Only of a table that had a shape.
pub fn steep(label: &Label, values: &[f64]) -> Vec<(usize, usize, f64)> {
    let mut out = Vec::new();
    for k in 0..label.axes.len() {
        let pairs: Vec<(usize, usize)> = label
            .lines(k)
            .iter()
            .flat_map(|l| l.windows(2).map(|w| (w[0], w[1])).collect::<Vec<_>>())
            .collect();
        let step = |v: &[f64], (a, b): (usize, usize)| match v[a] > 0.0 && v[b] > 0.0 {
            true => (v[a] / v[b]).ln().abs(),
            false => f64::INFINITY,
        };
        let before = pairs.iter().map(|p| step(&label.base, *p)).filter(|s| s.is_finite());
        let most = before.fold(0.0, f64::max);
        if most == 0.0 {
            continue;
        }
        for &(a, b) in pairs.iter().filter(|p| step(values, **p) > most && step(&label.base, **p) <= most) {
            if !(values[a] > 0.0 && values[b] > 0.0) {
                continue;
            }
            let (high, low) = if values[a] >= values[b] { (a, b) } else { (b, a) };
            out.push((high, low, values[high] / values[low]));
        }
    }
    out.sort_by(|a, b| b.2.total_cmp(&a.2));
    out
}
