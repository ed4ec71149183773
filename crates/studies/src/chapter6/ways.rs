//! Ways to the same map: as published, and quicker ones. Every row of equal torque has an engine of its own.

use dynocal_calib::steady::best_point;
use dynocal_calib::steady::hold::{Held, HoldSpec};
use dynocal_calib::steady::search::{FreeInput, SearchSpec, Setting};
use dynocal_ident::play::PlayError;
use dynocal_numerics::interval::Interval;
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::watch::Watch;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::bed::{Actuators, At, Bed, SAMPLE_S, SPARKS, START};
use super::smooth::best_spark;

/// How the best spark of a point is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Way {
    /// 36 sparks, 9 s of waiting and 1 s of averaging each (thesis 6.6.1).
    Published,
    /// The same sparks, each until its means rest.
    Settled,
    /// Downhill from the best setting of the neighbour and by parabolas, each setting until its means rest.
    Bracketed,
    /// The same with the points of a row in an arbitrary order, each begun where the one before ended.
    Scattered,
    /// A slow ramp of the spark up and down, mean of both, then the best until its means rest.
    Ramped,
}

/// A point of a map with what the engine says about it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Cell {
    pub(super) at: At,
    pub(super) u: Actuators,
    /// Whether torque and lambda were on their demands.
    pub(super) reached: bool,
    /// Settings that were held.
    pub(super) settings: usize,
    /// Rise of the fuel 3 deg beside the best in percent, where a sweep says it.
    pub(super) rise_percent: Option<f64>,
}

/// A map with its cost.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Made {
    pub(super) way: Way,
    /// Torque slow, speed fast.
    pub(super) cells: Vec<Cell>,
    /// Bed time of all rows in s.
    pub(super) bed_s: f64,
    /// The longest row: the time that copies of the bed need side by side.
    pub(super) longest_row_s: f64,
}

/// The cells of a row with its bed time in s.
type Row = (Vec<Cell>, f64);

/// Errors of torque in Nm and of lambda up to which a point is on its demand.
const REACHED: [f64; 2] = [1.0, 0.01];
/// Half of the range of a ramp in deg about the best spark of the neighbour, and its rate in deg/s.
const HALF_RAMP_DEG: f64 = 9.0;
const RAMP_DEG_S: f64 = 2.5;
/// What a missed demand costs by the settings of a search, in mg for each Nm and for each 0.01 of lambda.
const MISSED_MG: f64 = 10.0;

/// Waiting as published: no earlier end, as no two windows fit.
fn fixed() -> HoldSpec {
    HoldSpec { settle_s: 9.0, window_s: 10.0, average_s: 1.0 }
}

/// Waiting until two windows agree.
fn resting() -> HoldSpec {
    HoldSpec { settle_s: 20.0, window_s: 0.6, average_s: 0.6 }
}

/// The map over the grid by one of the ways.
///
/// # Errors
/// What the bed says; none where the user interrupted.
pub(super) fn make(way: Way, torques: &[f64], speeds: &[f64], watch: Watch) -> Result<Option<Made>, String> {
    let rows: Vec<Result<Option<Row>, String>> =
        torques.par_iter().enumerate().map(|(k, torque)| row(way, k, *torque, speeds, watch)).collect();
    let (mut cells, mut bed_s, mut longest_row_s) = (Vec::new(), 0.0, 0.0f64);
    for row in rows {
        let Some((row, used_s)) = row? else { return Ok(None) };
        cells.extend(row);
        bed_s += used_s;
        longest_row_s = longest_row_s.max(used_s);
    }
    Ok(Some(Made { way, cells, bed_s, longest_row_s }))
}

fn row(way: Way, number: usize, torque_nm: f64, speeds: &[f64], watch: Watch) -> Result<Option<Row>, String> {
    let mut order: Vec<usize> = (0..speeds.len()).collect();
    if way == Way::Scattered {
        let mut rng = Rng64::stream(6, number as u64);
        // Fisher and Yates.
        (1..order.len()).rev().for_each(|k| order.swap(k, rng.below(k + 1)));
    }
    let mut bed = Bed::new()?;
    let mut found: Vec<Option<Cell>> = vec![None; speeds.len()];
    let mut before: Vec<Actuators> = Vec::new();
    for k in order {
        if watch.interrupted() {
            return Ok(None);
        }
        let at = At { torque_nm, speed_rpm: speeds[k] };
        let from = ahead(way, &before);
        let cell = match way {
            Way::Published => swept(&mut bed, at, from, &fixed())?,
            Way::Settled => swept(&mut bed, at, from, &resting())?,
            Way::Bracketed | Way::Scattered => bracketed(&mut bed, at, from)?,
            Way::Ramped => ramped(&mut bed, at, from, before.is_empty())?,
        };
        before.push(cell.u);
        found[k] = Some(cell);
    }
    Ok(Some((found.into_iter().flatten().collect(), bed.used_s)))
}

/// Where a point begins: at the setting of the point before; along a row in order, on the line through the two points before.
fn ahead(way: Way, before: &[Actuators]) -> Actuators {
    match before {
        [] => START,
        [.., a, b] if matches!(way, Way::Bracketed | Way::Ramped) => Actuators {
            inj_mg: 2.0 * b.inj_mg - a.inj_mg,
            spark_deg: (2.0 * b.spark_deg - a.spark_deg).clamp(SPARKS[0], SPARKS[1]),
            throttle_deg: 2.0 * b.throttle_deg - a.throttle_deg,
        },
        [.., last] => *last,
    }
}

fn on_demand(h: &Held) -> bool {
    h.errors.iter().zip(REACHED).all(|(e, most)| e.abs() <= most)
}

/// All sparks of eq. (6.2), then the best by smoothing over those that were on their demands.
fn swept(bed: &mut Bed, at: At, from: Actuators, spec: &HoldSpec) -> Result<Cell, String> {
    let mut u = from;
    let (mut sparks, mut inj, mut throttle, mut settings) = (Vec::new(), Vec::new(), Vec::new(), 0);
    let count = (SPARKS[1] - SPARKS[0]).round() as usize;
    for k in 0..=count {
        u.spark_deg = SPARKS[0] + k as f64;
        let held = bed.hold(at, u, spec)?;
        u = Actuators::of(&held.inputs);
        settings += 1;
        if on_demand(&held) {
            sparks.push(u.spark_deg);
            inj.push(u.inj_mg);
            throttle.push(u.throttle_deg);
        }
    }
    Ok(match best_spark(&sparks, &inj, &throttle) {
        Some(b) => Cell {
            at,
            u: Actuators { inj_mg: b.inj_mg, spark_deg: b.spark_deg, throttle_deg: b.throttle_deg },
            reached: true,
            settings,
            rise_percent: b.rise_percent,
        },
        None => Cell { at, u, reached: false, settings, rise_percent: None },
    })
}

fn bracketed(bed: &mut Bed, at: At, from: Actuators) -> Result<Cell, String> {
    let spec = SearchSpec { hold: resting(), ..SearchSpec::default() };
    let free = [FreeInput { place: 1, range: Interval::new(SPARKS[0], SPARKS[1]) }];
    let (mut settings, mut broken) = (0, None);
    let mut measure = |u: &[f64]| {
        settings += 1;
        let held = bed.hold(at, Actuators::of(u), &spec.hold).map_err(|e| {
            broken = Some(e.clone());
            PlayError::Plant(dynocal_ident::plant::PlantError::Call(e))
        })?;
        let over: f64 =
            held.errors.iter().zip(REACHED).map(|(e, most)| (e.abs() / most - 1.0).max(0.0)).sum();
        Ok(Setting { cost: held.inputs[0] + MISSED_MG * over, held })
    };
    let best = best_point(&spec, &free, &from.values(), &mut measure);
    let best = best.map_err(|e| broken.unwrap_or_else(|| e.to_string()))?;
    let reached = on_demand(&best.held);
    Ok(Cell { at, u: Actuators::of(&best.held.inputs), reached, settings, rise_percent: None })
}

/// A ramp up and down about the spark of the neighbour, over the whole range where there is none.
fn ramped(bed: &mut Bed, at: At, from: Actuators, first: bool) -> Result<Cell, String> {
    let (low, high) = match first {
        true => (SPARKS[0], SPARKS[1]),
        false => {
            let middle = from.spark_deg.clamp(SPARKS[0] + HALF_RAMP_DEG, SPARKS[1] - HALF_RAMP_DEG);
            (middle - HALF_RAMP_DEG, middle + HALF_RAMP_DEG)
        }
    };
    let held = bed.hold(at, Actuators { spark_deg: low, ..from }, &resting())?;
    let steps = ((high - low) / (RAMP_DEG_S * SAMPLE_S)).round() as usize;
    let up = (0..=steps).map(|k| low + (high - low) * k as f64 / steps as f64);
    let ramp: Vec<f64> = up.clone().chain(up.rev()).collect();
    let record = bed.sweep(at, Actuators::of(&held.inputs), &ramp)?;
    let channel = |name: &str| -> Result<Vec<f64>, String> {
        let values = record.values(name).map_err(|e| e.to_string())?;
        // What is measured lags the spark on either way: their mean does not, to first order.
        Ok((0..=steps).map(|k| 0.5 * (values[k] + values[2 * steps + 1 - k])).collect())
    };
    let sparks: Vec<f64> = ramp[..=steps].to_vec();
    let best = best_spark(&sparks, &channel("inj")?, &channel("throttle")?);
    let Some(best) = best else { return Err(format!("a ramp of {} settings", sparks.len())) };
    let from = Actuators { inj_mg: best.inj_mg, spark_deg: best.spark_deg, throttle_deg: best.throttle_deg };
    let held = bed.hold(at, from, &resting())?;
    Ok(Cell {
        at,
        u: Actuators::of(&held.inputs),
        reached: on_demand(&held),
        settings: 2,
        rise_percent: best.rise_percent,
    })
}
