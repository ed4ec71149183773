//! The best setting of one operating point, measured on the plant: coordinate by coordinate, each by golden section and a
//! parabola.

use super::hold::{Held, HoldSpec};
use dynocal_ident::play::PlayError;
use serde::{Deserialize, Serialize};

/// How the free inputs are searched.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SearchSpec {
    /// Settling and averaging at each setting.
    pub hold: HoldSpec,
    /// Width of the bracket at which the search along one input ends, as a share of its range.
    pub tolerance: f64,
    /// Times that all free inputs are gone through; one is enough for a single free input.
    pub sweeps: usize,
}

impl Default for SearchSpec {
    fn default() -> Self {
        Self { hold: HoldSpec::default(), tolerance: 0.06, sweeps: 1 }
    }
}

/// A measured setting.
#[derive(Clone, Debug)]
pub struct Setting {
    /// The held point.
    pub held: Held,
    /// What is minimised, penalties included.
    pub cost: f64,
}

/// An input that is searched: its place among the inputs of the plan and its range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FreeInput {
    /// Place.
    pub place: usize,
    /// Range.
    pub range: (f64, f64),
}

/// Searches all free inputs from `start` (all inputs of the plan, its order); `measure` holds a setting and judges it.
///
/// Along one input with everything else held there is one minimum of a smooth cost, so a bracket never loses it; with
/// several inputs the sweeps approach a minimum along the axes.
///
/// # Errors
/// [`PlayError`] of `measure`.
pub fn best_point(
    spec: &SearchSpec,
    free: &[FreeInput],
    start: &[f64],
    measure: &mut dyn FnMut(&[f64]) -> Result<Setting, PlayError>,
) -> Result<Setting, PlayError> {
    let mut best: Option<Setting> = None;
    for _ in 0..spec.sweeps.max(1) {
        for f in free {
            let from = best.as_ref().map_or(start, |b| &b.held.inputs).to_vec();
            let along = along(measure, &from, *f, spec.tolerance * (f.range.1 - f.range.0))?;
            if best.as_ref().is_none_or(|b| along.cost < b.cost) {
                best = Some(along);
            }
        }
    }
    match best {
        Some(best) => Ok(best),
        None => measure(start),
    }
}

/// Golden section along one input, finished by the vertex of the parabola through the best three.
fn along(
    measure: &mut dyn FnMut(&[f64]) -> Result<Setting, PlayError>,
    from: &[f64],
    free: FreeInput,
    tolerance: f64,
) -> Result<Setting, PlayError> {
    let mut seen: Vec<(f64, Setting)> = Vec::new();
    let mut warm = from.to_vec();
    let mut evaluate = |x: f64, seen: &mut Vec<(f64, Setting)>| -> Result<f64, PlayError> {
        warm[free.place] = x;
        let setting = measure(&warm)?;
        warm.clone_from(&setting.held.inputs);
        let cost = setting.cost;
        seen.push((x, setting));
        Ok(cost)
    };
    let golden = 0.5 * (5f64.sqrt() - 1.0);
    let (mut lo, mut hi) = free.range;
    let (mut a, mut b) = (hi - golden * (hi - lo), lo + golden * (hi - lo));
    let (mut fa, mut fb) = (evaluate(a, &mut seen)?, evaluate(b, &mut seen)?);
    while hi - lo > tolerance {
        if fa <= fb {
            (hi, b, fb) = (b, a, fa);
            a = hi - golden * (hi - lo);
            fa = evaluate(a, &mut seen)?;
        } else {
            (lo, a, fa) = (a, b, fb);
            b = lo + golden * (hi - lo);
            fb = evaluate(b, &mut seen)?;
        }
    }
    if let Some(x) = vertex(&seen) {
        evaluate(x.clamp(free.range.0, free.range.1), &mut seen)?;
    }
    // Both ends of the bracket were measured, so that there is a least one.
    let best = seen.into_iter().map(|(_, s)| s).min_by(|x, y| x.cost.total_cmp(&y.cost));
    best.map_or_else(|| measure(from), Ok)
}

/// Abscissa of the vertex of the parabola through the three points of least cost, if it opens upwards.
fn vertex(seen: &[(f64, Setting)]) -> Option<f64> {
    let mut points: Vec<(f64, f64)> = seen.iter().map(|(x, s)| (*x, s.cost)).collect();
    points.sort_by(|a, b| a.1.total_cmp(&b.1));
    let [(x0, y0), (x1, y1), (x2, y2)] = *points.get(..3)? else { return None };
    let (d1, d2) = ((y1 - y0) / (x1 - x0), (y2 - y0) / (x2 - x0));
    let curvature = (d2 - d1) / (x2 - x1);
    (curvature > 0.0 && curvature.is_finite()).then(|| 0.5 * (x0 + x1 - d1 / curvature))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A quadratic bowl with a cross term: sweeps come down to its minimum.
    #[test]
    fn sweeps_find_the_minimum_of_a_bowl() {
        let free = [FreeInput { place: 0, range: (-2.0, 4.0) }, FreeInput { place: 2, range: (0.0, 10.0) }];
        let mut measure = |u: &[f64]| {
            let (a, b) = (u[0] - 1.0, u[2] - 6.0);
            let held = Held {
                inputs: u.to_vec(),
                outputs: vec![],
                errors: vec![],
                settled: true,
                oscillation: None,
                used_s: 1.0,
            };
            Ok(Setting { held, cost: a * a + 0.3 * b * b + 0.2 * a * b })
        };
        let spec = SearchSpec { tolerance: 0.02, sweeps: 6, ..SearchSpec::default() };
        let best = best_point(&spec, &free, &[0.0, 7.0, 3.0], &mut measure).unwrap();
        assert!((best.held.inputs[0] - 1.0).abs() < 0.02 && (best.held.inputs[2] - 6.0).abs() < 0.05);
        assert_eq!(best.held.inputs[1], 7.0, "what is not free stays");
    }
}
