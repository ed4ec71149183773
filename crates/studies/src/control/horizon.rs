//! What could be had: a receding horizon over the model that the PI loops were tuned on, causal and with preview of the demands.
//!
//! Both demands step at random times. Price of a move and correction of the horizon are those that were best under another scatter.

use dynocal_control::horizon::{Horizon, HorizonSettings};
use dynocal_control::runtime::{ActuatorLimits, Pid, PidGains};
use dynocal_numerics::rng::Rng64;
use serde::{Deserialize, Serialize};

use super::bed::{Bench, Driven, SAMPLE_S};
use super::runs::Rig;

/// Samples ahead and moves.
const AHEAD: (usize, usize) = (75, 20);
/// Prices of a move relative to the weight of a distance, and time constants of the correction in s, that are tried.
const PRICES: [f64; 5] = [0.1, 1.0, 10.0, 100.0, 1000.0];
const CORRECTIONS_S: [f64; 2] = [0.1, 0.5];
/// Samples of a hold, from and to.
const HOLD: (usize, usize) = (100, 300);

/// Mean distances from the demands.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Kept {
    pub(super) name: String,
    /// Nm, and lambda.
    pub(super) off: [f64; 2],
}

/// The loops beside the horizon.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Reference {
    /// PI, horizon, horizon with preview.
    pub(super) kept: Vec<Kept>,
    /// What was chosen: price, and correction in s.
    pub(super) price: f64,
    pub(super) correction_s: f64,
}

/// Demands of torque and lambda about the set point, row by row.
fn demands(rows: usize, size: [f64; 2], seed: u64) -> Vec<[f64; 2]> {
    let mut rng = Rng64::stream(seed, 61);
    let (mut left, mut level) = ([0usize; 2], [0.0; 2]);
    let mut row = || {
        for k in 0..2 {
            if left[k] == 0 {
                left[k] = HOLD.0 + rng.below(HOLD.1 - HOLD.0);
                level[k] = size[k] * rng.uniform_in(-1.0, 1.0);
            }
            left[k] -= 1;
        }
        level
    };
    (0..rows).map(|_| row()).collect()
}

fn off(run: &Driven, demands: &[[f64; 2]], y0: [f64; 2]) -> [f64; 2] {
    let mean = |of: &dyn Fn(usize) -> f64| (0..demands.len()).map(of).sum::<f64>() / demands.len() as f64;
    [
        mean(&|t| (run.torque_nm[t] - y0[0] - demands[t][0]).abs()),
        mean(&|t| (run.shown[t][1] - y0[1] - demands[t][1]).abs()),
    ]
}

/// A run under the horizon.
fn held(
    rig: &Rig,
    demands: &[[f64; 2]],
    size: [f64; 2],
    (price, correction_s, preview): (f64, f64, bool),
) -> Result<[f64; 2], String> {
    let y0 = rig.bench.point().1;
    let settings = HorizonSettings {
        ahead: AHEAD.0,
        moves: AHEAD.1,
        weights: size.map(|s| 1.0 / (s * s)).to_vec(),
        prices: size.map(|s| price / (s * s)).to_vec(),
        // As the loops beside: the actuators have ends of their own.
        lower: vec![f64::NEG_INFINITY; 2],
        upper: vec![f64::INFINITY; 2],
        correction_s,
    };
    let mut c = Horizon::new(rig.plant, settings).map_err(|e| e.to_string())?;
    let mut failed = None;
    let last = demands.len() - 1;
    let run = rig.bench.drive(demands.len(), &mut |t, shown| {
        let ahead = |j: usize, o: usize| demands[if preview { (t + j - 1).min(last) } else { t }][o];
        match c.step(&ahead, &[shown[0] - y0[0], shown[1] - y0[1]]) {
            Ok(d) => rig.actuators([d[0], d[1]], 0.0),
            Err(e) => {
                failed = Some(e.to_string());
                rig.actuators([0.0; 2], 0.0)
            }
        }
    })?;
    failed.map_or_else(|| Ok(off(&run, demands, y0)), Err)
}

fn under_pi(rig: &Rig, demands: &[[f64; 2]]) -> Result<[f64; 2], String> {
    let y0 = rig.bench.point().1;
    let wide = ActuatorLimits { lower: -1e6, upper: 1e6, rate_per_s: None };
    let pid = |g: PidGains| Pid::new(g, wide, SAMPLE_S, 0.0).map_err(|e| e.to_string());
    let mut loops = [pid(rig.gains[0])?, pid(rig.gains[1])?];
    let run = rig.bench.drive(demands.len(), &mut |t, shown| {
        let d = [0, 1].map(|k| loops[k].step(0.0, demands[t][k] - (shown[k] - y0[k])));
        rig.actuators(d, 0.0)
    })?;
    Ok(off(&run, demands, y0))
}

/// Loops and horizon on the same demands for `length_s`; steps up to `size`.
pub(super) fn reference(
    rig: &Rig,
    engine: &str,
    seed: u64,
    size: [f64; 2],
    length_s: f64,
) -> Result<Reference, String> {
    let rows = (length_s / SAMPLE_S) as usize;
    // Another scatter and other demands choose.
    let other = Bench::new(engine, seed + 500, None)?;
    let tuned = Rig { bench: &other, ..*rig };
    let (choosing, judged) = (demands(rows, size, seed + 500), demands(rows, size, seed));
    let mut best: Option<(f64, f64, f64)> = None;
    for price in PRICES {
        for correction_s in CORRECTIONS_S {
            let [torque, lambda] = held(&tuned, &choosing, size, (price, correction_s, false))?;
            let sum = torque / size[0] + lambda / size[1];
            if best.is_none_or(|b| sum < b.0) {
                best = Some((sum, price, correction_s));
            }
        }
    }
    let (_, price, correction_s) = best.ok_or("no price of a move was tried")?;
    let one = |name: &str, off| Kept { name: name.into(), off };
    Ok(Reference {
        kept: vec![
            one("PI, ours", under_pi(rig, &judged)?),
            one("receding horizon", held(rig, &judged, size, (price, correction_s, false))?),
            one("receding horizon with preview", held(rig, &judged, size, (price, correction_s, true))?),
        ],
        price,
        correction_s,
    })
}
