//! The best setting of one operating point, measured on the plant: coordinate by coordinate, each downhill from where it stands
//! and by parabolas.

use super::hold::{Held, HoldSpec};
use dynocal_ident::play::PlayError;
use dynocal_numerics::interval::Interval;
use serde::{Deserialize, Serialize};

/// How the free inputs are searched.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SearchSpec {
    /// Settling and averaging at each setting.
    pub hold: HoldSpec,
    /// Change of an input, as a share of its range, at which the search along it ends; its first step is twice as long.
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
    pub range: Interval,
}

/// Searches all free inputs from `start` (all inputs of the plan, its order); `measure` holds a setting and judges it.
///
/// Along one input with everything else held there is one minimum of a smooth cost, so that the way downhill leads to it; with
/// several inputs the sweeps approach a minimum along the axes. A start that is the best of a neighbouring point saves settings.
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
            let along = along(measure, &from, *f, spec.tolerance * (f.range.width()))?;
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

/// Growth of the steps downhill, and most parabolas.
const GROWTH: f64 = 1.618_033_988_749_895;
const PARABOLAS: usize = 2;

/// Along one input: steps downhill from where it stands until the least of three lies between the others or at the end of the
/// range, then the vertex of the parabola through the best three, until it stays within the tolerance. Near a minimum, where a
/// neighbour has one, that takes four or five settings instead of the nine of a golden section of the whole range.
fn along(
    measure: &mut dyn FnMut(&[f64]) -> Result<Setting, PlayError>,
    from: &[f64],
    free: FreeInput,
    tolerance: f64,
) -> Result<Setting, PlayError> {
    let mut line = Line { measure, place: free.place, warm: from.to_vec(), seen: Vec::new() };
    let Interval { lower: lo, upper: hi } = free.range;
    let start_at = from[free.place].clamp(lo, hi);
    let mut at = start_at;
    line.cost(at)?;
    let first = if at + 2.0 * tolerance <= hi { 2.0 * tolerance } else { -2.0 * tolerance };
    for start in [first, -first] {
        let mut step = start;
        loop {
            let next = (at + step).clamp(lo, hi);
            let before = line.least();
            if next == at || line.cost(next)? >= before {
                break;
            }
            at = next;
            step *= GROWTH;
        }
        // Where the first direction went down, the start closes the bracket.
        if at != start_at {
            break;
        }
    }
    for _ in 0..PARABOLAS {
        let Some(x) = vertex(&line.seen).map(|x| x.clamp(lo, hi)) else { break };
        if line.seen.iter().any(|(seen, _)| (x - seen).abs() < 0.05 * tolerance) {
            break;
        }
        let away = (x - line.place_of_least()).abs();
        line.cost(x)?;
        if away <= tolerance {
            break;
        }
    }
    let best = line.seen.into_iter().map(|(_, s)| s).min_by(|x, y| x.cost.total_cmp(&y.cost));
    best.map_or_else(|| measure(from), Ok)
}

/// Settings along one input, each begun where the one before it came to rest.
struct Line<'a> {
    measure: &'a mut dyn FnMut(&[f64]) -> Result<Setting, PlayError>,
    place: usize,
    warm: Vec<f64>,
    seen: Vec<(f64, Setting)>,
}

impl Line<'_> {
    fn cost(&mut self, x: f64) -> Result<f64, PlayError> {
        self.warm[self.place] = x;
        let setting = (self.measure)(&self.warm)?;
        self.warm.clone_from(&setting.held.inputs);
        let cost = setting.cost;
        self.seen.push((x, setting));
        Ok(cost)
    }

    fn least(&self) -> f64 {
        self.seen.iter().map(|(_, s)| s.cost).fold(f64::INFINITY, f64::min)
    }

    fn place_of_least(&self) -> f64 {
        let least = self.seen.iter().min_by(|a, b| a.1.cost.total_cmp(&b.1.cost));
        least.map_or(f64::NAN, |(x, _)| *x)
    }
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
        let free = [
            FreeInput { place: 0, range: Interval::new(-2.0, 4.0) },
            FreeInput { place: 2, range: Interval::new(0.0, 10.0) },
        ];
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
