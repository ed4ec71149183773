//! Points at rest on the plant that a map is moved onto (thesis 7.8.2, its steady part): the map drives a grid of them under the
//! loops, and what these had to add is taken into it.

use super::context::{Context, Tone};
use super::error::ChainError;
use super::records::{RecordRef, save_records};
use dynocal_calib::map::filter::filtered;
use dynocal_calib::map::structures::{MapError, StoredMap};
use dynocal_calib::map::{FeedforwardMap, Ports, Rows, SteadyPoint};
use dynocal_calib::problem::CalibrationProblem;
use dynocal_calib::validate::{MOST_OFFSET, inner, reference_row};
use dynocal_ident::data::Dataset;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// What the points told.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AtRest {
    /// Points at rest.
    pub points: Vec<SteadyPoint>,
    /// Points that had not come to rest and were left out.
    pub restless: usize,
    /// Points left out as their demand was not met, or an input that a loop drives stood at its limit: what holds there is not known.
    #[serde(default)]
    pub unreached: usize,
    /// Root mean square over the points of what was applied less what the map gives there, by actuator: as it was.
    pub before: Vec<f64>,
    /// The same of the map that is delivered.
    pub after: Vec<f64>,
    /// The record.
    pub records: Vec<RecordRef>,
    /// Bed time in s.
    pub bed_s: f64,
    /// Why there was none; empty where there was.
    pub refused: String,
}

impl AtRest {
    fn none(refused: String) -> Self {
        let (points, records) = (Vec::new(), Vec::new());
        Self {
            points,
            restless: 0,
            unreached: 0,
            before: Vec::new(),
            after: Vec::new(),
            records,
            bed_s: 0.0,
            refused,
        }
    }
}

/// Share of the range of each axis that is left out at either end.
const EDGE: f64 = 0.05;
/// Change of a demanded output between the halves of the average, in its settling bands, from which on a point is not at rest. A
/// point that still creeps within its band says nearly what holds it; a corner without a point says nothing.
const MOVES: f64 = 1.0;

/// Plays the points with `map` as feedforward; none where the spec wants none.
///
/// # Errors
/// [`ChainError`], but for a record that was stopped or swung: that is told, and there are no points.
pub(super) fn measured(
    ctx: &Context,
    folder: &Path,
    map: &dyn FeedforwardMap,
) -> Result<Option<AtRest>, ChainError> {
    let spec = &ctx.spec.invert.at_rest;
    if !spec.enabled {
        return Ok(None);
    }
    let (reference, switches) = course(ctx);
    let drive = map.drive(&reference, ctx.spec.sample_time_s);
    let demands = ctx.channels.demands.len();
    let inputs = (0..drive.width()).map(|k| drive.column(k)).collect();
    let given = (0..ctx.channels.given.len()).map(|k| reference.column(demands + k)).collect();
    // Loops are asked for what the plant can follow: else they take its lag for a miss, and are long in giving that back.
    let structure = ctx.spec.invert.built().map_err(MapError::from)?;
    let names = ctx.channels.demands.iter().enumerate();
    let wanted = names
        .map(|(k, d)| filtered(&reference.column(k), &structure.filter_s(d, k), ctx.spec.sample_time_s))
        .collect();
    let plan = ctx.plan("at_rest", inputs, given, wanted, Tone::Lead);
    let record = match ctx.measure(folder, &plan, true) {
        Ok(record) => record,
        Err(e @ (ChainError::Stopped { .. } | ChainError::Oscillates { .. })) => {
            return Ok(Some(AtRest::none(e.to_string())));
        }
        Err(e) => return Err(e),
    };
    let (points, restless, unreached) = points_of(ctx, &record, (&reference, &switches))?;
    let before = missed(map, &points);
    Ok(Some(AtRest {
        after: before.clone(),
        before,
        restless,
        unreached,
        bed_s: record.len() as f64 * ctx.spec.sample_time_s + ctx.spec.excite.lead_in_s,
        records: save_records(folder, &[record])?,
        points,
        refused: String::new(),
    }))
}

/// Share of an input's range within which it stands at its limit.
const AT_LIMIT: f64 = 1e-3;

/// Whether an input that a loop drives stands at its limit: the demand is not held there, and nobody knows what would hold it.
fn spent(ports: &Ports, driven: &[usize], point: &SteadyPoint) -> bool {
    driven.iter().any(|k| {
        let (port, u) = (&ports.actuators[*k], point.actuators[*k]);
        let near = AT_LIMIT * (port.upper - port.lower);
        u <= port.lower + near || u >= port.upper - near
    })
}

/// `map` moved onto the points; how far it still is from them is kept beside.
pub(super) fn anchored(map: StoredMap, points: Option<&mut AtRest>) -> StoredMap {
    let Some(told) = points else { return map };
    let map = map.anchored(&told.points).unwrap_or(map);
    told.after = missed(&*map, &told.points);
    map
}

/// References of the record, and the first sample of each point: along the given channel from end to end, along the demand
/// to and fro.
fn course(ctx: &Context) -> (Rows, Vec<usize>) {
    let (spec, problem, dt) = (&ctx.spec.invert.at_rest, &ctx.spec.problem, ctx.spec.sample_time_s);
    let levels = |range: (f64, f64)| -> Vec<f64> {
        let (a, b) = inner(range, EDGE);
        let last = (spec.points - 1).max(1) as f64;
        (0..spec.points).map(|k| a + (b - a) * k as f64 / last).collect()
    };
    let lead = problem.demands.first().map_or((0.0, 1.0), |d| (d.lower, d.upper));
    let given = problem.given.first();
    let places: Vec<Option<f64>> =
        given.map_or_else(|| vec![None], |g| levels((g.lower, g.upper)).into_iter().map(Some).collect());
    let rate = ctx.spec.validate.scenario.given_rate_per_s;
    let rate = rate.or(given.map(|g| 0.5 * (g.upper - g.lower))).unwrap_or(f64::INFINITY);
    let hold = (spec.hold_s / dt).round() as usize;
    let (mut rows, mut switches) = (Rows::new(ctx.channels.ports.n_references()), Vec::new());
    let mut now = places[0];
    for (j, place) in places.iter().enumerate() {
        let mut demands = levels(lead);
        if !j.is_multiple_of(2) {
            demands.reverse();
        }
        for demand in demands {
            switches.push(rows.len());
            for _ in 0..hold {
                now = now.zip(*place).map(|(a, b)| a + (b - a).clamp(-rate * dt, rate * dt));
                rows.push(&reference_row(problem, demand, now));
            }
        }
    }
    (rows, switches)
}

/// Whether the loops did not bring a point to its demand: then what the map gave with them is that of another one.
fn missed_demand(problem: &CalibrationProblem, point: &SteadyPoint, asked: &[f64]) -> bool {
    problem.demands.iter().enumerate().any(|(k, d)| {
        let most = MOST_OFFSET[k.min(1)] * (d.upper - d.lower);
        !((point.reference[k] - asked[k]).abs() <= most)
    })
}

/// Means at the end of each hold, of those that are at rest where they should be; how many are not at rest, and how many are elsewhere.
fn points_of(
    ctx: &Context,
    record: &Dataset,
    (asked, switches): (&Rows, &[usize]),
) -> Result<(Vec<SteadyPoint>, usize, usize), ChainError> {
    let (references, actuators) = (ctx.channels.references(record)?, ctx.channels.actuators(record)?);
    let problem = &ctx.spec.problem;
    let window = (ctx.spec.invert.at_rest.average_s / ctx.spec.sample_time_s).round().max(2.0) as usize;
    let mean = |rows: &Rows, k: usize, from: usize, to: usize| {
        (from..to).map(|t| rows.row(t)[k]).sum::<f64>() / (to - from).max(1) as f64
    };
    let ends = switches.iter().skip(1).copied().chain([references.len()]);
    let (mut points, mut restless, mut unreached) = (Vec::new(), 0, 0);
    for (from, to) in switches.iter().zip(ends) {
        let (start, middle) =
            (to.saturating_sub(window).max(*from), to.saturating_sub(window / 2).max(*from));
        let still = (0..problem.demands.len()).all(|k| {
            let moved = mean(&references, k, middle, to) - mean(&references, k, start, middle);
            moved.abs() <= MOVES * ctx.spec.validate.scenario.band(problem, k)
        });
        if !still {
            restless += 1;
            continue;
        }
        let point = SteadyPoint {
            reference: (0..references.width()).map(|k| mean(&references, k, start, to)).collect(),
            actuators: (0..actuators.width()).map(|k| mean(&actuators, k, start, to)).collect(),
        };
        let spent = spent(&ctx.channels.ports, &ctx.channels.driven, &point);
        if spent || missed_demand(problem, &point, asked.row(to - 1)) {
            unreached += 1;
        } else {
            points.push(point);
        }
    }
    Ok((points, restless, unreached))
}

/// Root mean square over the points of what was applied less what the map gives.
fn missed(map: &dyn FeedforwardMap, points: &[SteadyPoint]) -> Vec<f64> {
    let mut squares = vec![0.0; map.ports().actuators.len()];
    for p in points {
        let given = map.steady(&p.reference);
        squares.iter_mut().zip(p.actuators.iter().zip(given)).for_each(|(s, (u, g))| *s += (u - g).powi(2));
    }
    squares.iter().map(|s| (s / points.len().max(1) as f64).sqrt()).collect()
}

#[cfg(test)]
mod tests {
    use super::super::channels::ports;
    use super::*;

    /// A point counts where the loops hold its demand between their limits: beside it one whose throttle is fully open though the demand is
    /// met, one whose torque is short of what was asked by more than the verdict lets a map be, and one whose lambda is no number.
    #[test]
    fn a_point_that_is_not_held_is_none() {
        let problem = CalibrationProblem::thesis();
        let ports = ports(&problem);
        let throttle = ports.actuators.iter().position(|a| a.name == "throttle").unwrap();
        let middle: Vec<f64> = ports.actuators.iter().map(|a| 0.5 * (a.lower + a.upper)).collect();
        let held = SteadyPoint { reference: vec![50.0, 1.0, 2000.0], actuators: middle };
        let asked = [50.0, 1.0, 2000.0];
        assert!(!spent(&ports, &[throttle], &held) && !missed_demand(&problem, &held, &asked));

        let mut open = held.clone();
        open.actuators[throttle] = ports.actuators[throttle].upper;
        assert!(spent(&ports, &[throttle], &open) && !missed_demand(&problem, &open, &asked));
        // An input that no loop drives may stand at its limit.
        assert!(!spent(&ports, &[], &open));

        let range = problem.demands[0].upper - problem.demands[0].lower;
        let off = |by: f64| SteadyPoint {
            reference: vec![50.0 - by * MOST_OFFSET[0] * range, 1.0, 2000.0],
            ..held.clone()
        };
        assert!(!missed_demand(&problem, &off(0.99), &asked) && missed_demand(&problem, &off(1.01), &asked));
        let mut unknown = held.clone();
        unknown.reference[1] = f64::NAN;
        assert!(missed_demand(&problem, &unknown, &asked));
    }
}
