//! (7.34): the map made again from data of the closed loop, until feedback has nothing left to do.
//!
//! ```text
//! u = map(demand + what feedback adds),    first map: the inverted steady gains
//! then     u = sum_k c_k phi_k(T, lambda) by least squares over the ends of all holds so far,   phi: 1, T, l, T^2, T l, l^2, T^3
//! ```
//!
//! What was reached stands in for what was demanded: at rest the map gives back the actuators that led there.

use dynocal_control::runtime::{ActuatorLimits, Pid, PidGains};
use dynocal_numerics::linalg::least_squares;
use dynocal_numerics::rng::Rng64;
use serde::{Deserialize, Serialize};

use super::bed::{Driven, SAMPLE_S};
use super::runs::Rig;

/// Samples of a hold, of which the last ones are its end, and holds of a drive.
const HOLD: (usize, usize) = (250, 50);
const HOLDS: usize = 30;
/// Terms of a map.
const TERMS: usize = 7;
/// Movement of the demands about the set point: torque as a share, lambda.
const REACH: [f64; 2] = [0.4, 0.05];

/// A map, and what it leaves.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Round {
    /// Root mean square of what feedback adds to the demands at the ends of holds, Nm and lambda.
    pub(super) added: [f64; 2],
    /// Mean distance from the demands under the map alone at the ends of holds that nothing saw, in percent of the demand.
    pub(super) off_pct: [f64; 2],
}

/// Throttle and fuel by demanded torque and lambda.
enum Map {
    Steady,
    Fitted([Vec<f64>; 2]),
}

fn terms(t: f64, l: f64) -> [f64; TERMS] {
    [1.0, t, l, t * t, t * l, l * l, t * t * t]
}

impl Map {
    fn actuators(&self, rig: &Rig, demand: [f64; 2]) -> [f64; 3] {
        let (u0, y0) = rig.bench.point();
        match self {
            Self::Steady => rig.actuators([demand[0] - y0[0], demand[1] - y0[1]], 0.0),
            Self::Fitted(c) => {
                let phi = terms(demand[0] / y0[0], demand[1]);
                let value = |c: &[f64]| c.iter().zip(&phi).map(|(c, p)| c * p).sum::<f64>();
                [value(&c[0]), value(&c[1]), u0[2]]
            }
        }
    }
}

/// Mean over the end of a hold: torque and lambda demanded and reached, throttle and fuel, what feedback added.
struct End {
    demand: [f64; 2],
    reached: [f64; 2],
    actuators: [f64; 2],
    added: [f64; 2],
}

fn driven(rig: &Rig, map: &Map, closed: bool, seed: u64) -> Result<Vec<End>, String> {
    let y0 = rig.bench.point().1;
    let mut rng = Rng64::stream(seed, 43);
    let mut level = || [0, 1].map(|k| y0[k] * (1.0 + REACH[k] * rng.uniform_in(-1.0, 1.0)));
    let demands: Vec<[f64; 2]> = (0..HOLDS).map(|_| level()).collect();
    let wide = ActuatorLimits { lower: -1e6, upper: 1e6, rate_per_s: None };
    let pid = |g: PidGains| Pid::new(g, wide, SAMPLE_S, 0.0).map_err(|e| e.to_string());
    let mut loops = [pid(rig.gains[0])?, pid(rig.gains[1])?];
    let mut added = Vec::with_capacity(HOLDS * HOLD.0);
    let run = rig.bench.drive(HOLDS * HOLD.0, &mut |t, shown| {
        let demand = demands[t / HOLD.0];
        let more = [0, 1].map(|k| if closed { loops[k].step(0.0, demand[k] - shown[k]) } else { 0.0 });
        added.push(more);
        map.actuators(rig, [demand[0] + more[0], demand[1] + more[1]])
    })?;
    let end = |(k, demand): (usize, &[f64; 2])| {
        let rows = (k + 1) * HOLD.0 - HOLD.1..(k + 1) * HOLD.0;
        let mean = |of: &dyn Fn(usize) -> f64| rows.clone().map(of).sum::<f64>() / HOLD.1 as f64;
        let run: &Driven = &run;
        End {
            demand: *demand,
            reached: [mean(&|t| run.torque_nm[t]), mean(&|t| run.shown[t][1])],
            actuators: [mean(&|t| run.u[t][0]), mean(&|t| run.u[t][1])],
            added: [mean(&|t| added[t][0]), mean(&|t| added[t][1])],
        }
    };
    Ok(demands.iter().enumerate().map(end).collect())
}

/// The map of all ends so far.
fn fitted(rig: &Rig, ends: &[End]) -> Result<Map, String> {
    let y0 = rig.bench.point().1;
    let rows: Vec<f64> = ends.iter().flat_map(|e| terms(e.reached[0] / y0[0], e.reached[1])).collect();
    let one = |k: usize| {
        let u: Vec<f64> = ends.iter().map(|e| e.actuators[k]).collect();
        least_squares(&rows, u.len(), TERMS, &u, 0.0)
            .map(|f| f.x)
            .map_err(|e| format!("the map made again: {e}"))
    };
    Ok(Map::Fitted([one(0)?, one(1)?]))
}

/// The first map, and `rounds` that are made of data of the loops about the one before.
pub(super) fn refined(rig: &Rig, seed: u64, rounds: usize) -> Result<Vec<Round>, String> {
    let (mut map, mut ends, mut out) = (Map::Steady, Vec::new(), Vec::new());
    for r in 0..=rounds {
        let held = driven(rig, &map, true, seed + r as u64)?;
        let alone = driven(rig, &map, false, seed + 1000)?;
        let rms = |k: usize| (held.iter().map(|e| e.added[k].powi(2)).sum::<f64>() / HOLDS as f64).sqrt();
        let off = |k: usize| {
            alone.iter().map(|e| 100.0 * (e.reached[k] / e.demand[k] - 1.0).abs()).sum::<f64>() / HOLDS as f64
        };
        out.push(Round { added: [rms(0), rms(1)], off_pct: [off(0), off(1)] });
        ends.extend(held);
        map = fitted(rig, &ends)?;
    }
    Ok(out)
}
