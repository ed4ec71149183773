//! What shows an air path: boost against the wastegate from both sides, steps, tip-in.

use dynocal_plant::engine::VirtualEngine;
use dynocal_plant::error::PlantError;
use dynocal_plant::full_load::{LoadLimits, LoadPoint, LoadRequest, hold_load};
use dynocal_plant::inputs::Inputs;
use dynocal_plant::outputs::Outputs;
use dynocal_plant::params::EngineParams;
use serde::{Deserialize, Serialize};

/// Boost at one position of the wastegate, come to from both sides.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SweepPoint {
    /// Speed \[rpm\].
    pub speed_rpm: f64,
    /// Wastegate \[mm\].
    pub wastegate_mm: f64,
    /// Intake pressure \[kPa\] while the wastegate closes, and while it opens.
    pub closing_kpa: f64,
    /// See `closing_kpa`.
    pub opening_kpa: f64,
    /// Shaft speed \[rpm\], opening.
    pub turbo_rpm: f64,
    /// Torque \[Nm\], opening.
    pub torque_nm: f64,
    /// Share of the time in which the compressor surged, opening.
    pub surge: f64,
}

/// Longest wait at a position \[s\], window of the drift test \[s\] and largest drift from window to window \[kPa\].
const WAIT_S: f64 = 20.0;
const WINDOW_S: f64 = 0.5;
const DRIFT_KPA: f64 = 0.02;
/// Spark of the sweeps \[deg BTDC\]: late, as at full load.
const SPARK_DEG: f64 = 5.0;

/// A cycle at the lambda asked for: fuel follows the air, cams their schedule.
fn cycle(e: &mut VirtualEngine, u: &mut Inputs, lambda: f64) -> Result<Outputs, PlantError> {
    e.set_inputs(*u)?;
    e.advance_angle(720.0);
    let y = e.outputs();
    let p = e.params();
    let air_mg = 1e3 * y.air_g_s * 120.0 / u.speed_rpm / 4.0;
    u.injection_mg = (air_mg / (p.gas.afr_stoich * lambda)).clamp(0.0, 120.0);
    if let Some(cams) = &p.cams {
        let (intake, exhaust) = cams.at(u.speed_rpm, y.map_kpa);
        (u.intake_mop_deg_btdc, u.exhaust_mop_deg_atdc) = (intake, exhaust);
    }
    Ok(y)
}

/// Cycles until the intake pressure stands still, or until the wait is over; the mean of the last window beside the last
/// outputs.
fn still(e: &mut VirtualEngine, u: &mut Inputs) -> Result<(f64, Outputs), PlantError> {
    let mut before = f64::NAN;
    for _ in 0..(WAIT_S / WINDOW_S) as usize {
        let (mut sum, mut n, start_s) = (0.0, 0.0, e.state().time_s);
        let y = loop {
            let y = cycle(e, u, 1.0)?;
            (sum, n) = (sum + y.map_kpa, n + 1.0);
            if y.time_s - start_s >= WINDOW_S {
                break y;
            }
        };
        let mean = sum / n;
        if (mean - before).abs() < DRIFT_KPA {
            e.check_state()?;
            return Ok((mean, y));
        }
        before = mean;
    }
    e.check_state()?;
    Ok((before, e.outputs()))
}

/// Open throttle, lambda 1: the wastegate closes position by position and opens again; in the order of `positions_mm`.
///
/// # Errors
/// [`PlantError`] of parameters and inputs; [`PlantError::Diverged`].
pub fn wastegate_sweep(
    params: &EngineParams,
    speed_rpm: f64,
    positions_mm: &[f64],
) -> Result<Vec<SweepPoint>, PlantError> {
    let mut order: Vec<f64> = positions_mm.to_vec();
    order.sort_by(|a, b| b.total_cmp(a));
    let mut e = VirtualEngine::new(params)?;
    let mut u = Inputs { speed_rpm, throttle_deg: 90.0, spark_deg: SPARK_DEG, ..Inputs::default() };
    let mut all = Vec::with_capacity(order.len());
    for wastegate_mm in &order {
        u.wastegate_mm = *wastegate_mm;
        let (closing_kpa, _) = still(&mut e, &mut u)?;
        all.push((*wastegate_mm, closing_kpa));
    }
    let mut out = Vec::with_capacity(all.len());
    for (wastegate_mm, closing_kpa) in all.into_iter().rev() {
        u.wastegate_mm = wastegate_mm;
        let (opening_kpa, y) = still(&mut e, &mut u)?;
        out.push(SweepPoint {
            speed_rpm,
            wastegate_mm,
            closing_kpa,
            opening_kpa,
            turbo_rpm: y.turbo_rpm,
            torque_nm: y.torque_cycle_nm,
            surge: y.surge,
        });
    }
    Ok(out)
}

/// Largest difference of boost between closing and opening \[kPa\], and the largest rise of boost from one position to
/// the next wider one \[kPa\] (at most zero where boost is monotone).
pub fn spread(points: &[SweepPoint]) -> (f64, f64) {
    let apart = points.iter().map(|p| (p.closing_kpa - p.opening_kpa).abs()).fold(0.0, f64::max);
    let pairs = points.windows(2).filter(|w| w[0].speed_rpm == w[1].speed_rpm);
    let rise = pairs
        .map(|w| {
            let rise = (w[1].opening_kpa - w[0].opening_kpa).max(w[1].closing_kpa - w[0].closing_kpa);
            if w[1].wastegate_mm > w[0].wastegate_mm { rise } else { -rise }
        })
        .fold(f64::NEG_INFINITY, f64::max);
    (apart, rise)
}

/// A record of cycles after a step.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StepRecord {
    /// Speed \[rpm\].
    pub speed_rpm: f64,
    /// Time since the step \[s\].
    pub time_s: Vec<f64>,
    /// Torque \[Nm\], intake pressure \[kPa\], shaft speed \[rpm\].
    pub torque_nm: Vec<f64>,
    /// See `torque_nm`.
    pub map_kpa: Vec<f64>,
    /// See `torque_nm`.
    pub turbo_rpm: Vec<f64>,
}

impl StepRecord {
    fn take(
        e: &mut VirtualEngine,
        mut u: Inputs,
        time_s: f64,
        spark: impl Fn(&Outputs) -> f64,
    ) -> Result<Self, PlantError> {
        let start_s = e.state().time_s;
        let mut r = Self {
            speed_rpm: u.speed_rpm,
            time_s: vec![],
            torque_nm: vec![],
            map_kpa: vec![],
            turbo_rpm: vec![],
        };
        loop {
            let y = cycle(e, &mut u, 1.0)?;
            u.spark_deg = spark(&y);
            let now_s = y.time_s - start_s;
            r.time_s.push(now_s);
            r.torque_nm.push(y.torque_cycle_nm);
            r.map_kpa.push(y.map_kpa);
            r.turbo_rpm.push(y.turbo_rpm);
            if now_s >= time_s {
                e.check_state()?;
                return Ok(r);
            }
        }
    }

    /// The record as far as a time \[s\], as one that was measured for so long.
    #[must_use]
    pub fn first_s(&self, time_s: f64) -> Self {
        let n = self.time_s.iter().take_while(|t| **t <= time_s).count();
        let of = |y: &[f64]| y[..n].to_vec();
        Self {
            speed_rpm: self.speed_rpm,
            time_s: of(&self.time_s),
            torque_nm: of(&self.torque_nm),
            map_kpa: of(&self.map_kpa),
            turbo_rpm: of(&self.turbo_rpm),
        }
    }

    /// First time \[s\] at which `y` has gone the share from `from` to `to`.
    pub fn reached_s(&self, y: &[f64], from: f64, to: f64, share: f64) -> Option<f64> {
        let goal = from + share * (to - from);
        let there = |v: f64| if to >= from { v >= goal } else { v <= goal };
        y.iter().position(|v| there(*v)).map(|k| self.time_s[k])
    }

    /// Last time \[s\] at which `y` was further than `within` from its mean over the last tenth.
    pub fn settled_s(&self, y: &[f64], within: f64) -> f64 {
        let tail = (y.len() / 10).max(1);
        let end = y[y.len() - tail..].iter().sum::<f64>() / tail as f64;
        y.iter().rposition(|v| (v - end).abs() > within).map_or(0.0, |k| self.time_s[k])
    }
}

/// Open throttle: the wastegate jumps between two positions after standing still; 10 s of record.
///
/// # Errors
/// As [`wastegate_sweep`].
pub fn wastegate_step(
    params: &EngineParams,
    speed_rpm: f64,
    from_mm: f64,
    to_mm: f64,
) -> Result<StepRecord, PlantError> {
    let mut e = VirtualEngine::new(params)?;
    let mut u = Inputs {
        speed_rpm,
        throttle_deg: 90.0,
        spark_deg: SPARK_DEG,
        wastegate_mm: from_mm,
        ..Inputs::default()
    };
    still(&mut e, &mut u)?;
    u.wastegate_mm = to_mm;
    StepRecord::take(&mut e, u, 10.0, |_| SPARK_DEG)
}

/// Wastegate shut: the throttle jumps from where it holds one intake pressure \[kPa\] to where it holds another; 10 s of
/// record.
///
/// # Errors
/// As [`wastegate_sweep`].
pub fn throttle_step(
    params: &EngineParams,
    speed_rpm: f64,
    from_kpa: f64,
    to_kpa: f64,
) -> Result<StepRecord, PlantError> {
    let mut e = VirtualEngine::new(params)?;
    let mut u = Inputs { speed_rpm, wastegate_mm: 0.0, ..Inputs::default() };
    let mut held = [0.0; 2];
    // The higher one first: the record begins at the lower one.
    for (place, kpa) in [(1, to_kpa), (0, from_kpa)] {
        for _ in 0..(12.0 * speed_rpm / 120.0) as usize {
            let y = cycle(&mut e, &mut u, 1.0)?;
            u.throttle_deg = (u.throttle_deg + (0.02 * (kpa - y.map_kpa)).clamp(-0.5, 0.5)).clamp(0.0, 90.0);
        }
        held[place] = u.throttle_deg;
    }
    u.throttle_deg = held[1];
    StepRecord::take(&mut e, u, 10.0, |_| Inputs::default().spark_deg)
}

/// The wastegate jumps between two positions behind a throttle that holds an intake pressure \[kPa\] at the first one; 10 s of
/// record.
///
/// # Errors
/// As [`wastegate_sweep`].
pub fn throttled_wastegate_step(
    params: &EngineParams,
    speed_rpm: f64,
    kpa: f64,
    from_mm: f64,
    to_mm: f64,
) -> Result<StepRecord, PlantError> {
    let mut e = VirtualEngine::new(params)?;
    let mut u = Inputs { speed_rpm, wastegate_mm: from_mm, ..Inputs::default() };
    for _ in 0..(15.0 * speed_rpm / 120.0) as usize {
        let y = cycle(&mut e, &mut u, 1.0)?;
        u.throttle_deg = (u.throttle_deg + (0.02 * (kpa - y.map_kpa)).clamp(-0.5, 0.5)).clamp(0.0, 90.0);
    }
    u.wastegate_mm = to_mm;
    StepRecord::take(&mut e, u, 10.0, |_| Inputs::default().spark_deg)
}

/// Throttle to its stop and wastegate shut from a steady point: lambda 1, the spark goes with the air between those of the
/// two steady points.
///
/// # Errors
/// As [`hold_load`].
pub fn tip_in(
    params: &EngineParams,
    speed_rpm: f64,
    from_nm: f64,
    to_nm: f64,
) -> Result<StepRecord, PlantError> {
    let mut e = VirtualEngine::new(params)?;
    let limits = LoadLimits::default();
    let request = LoadRequest { speed_rpm, torque_nm: from_nm, lambda: 1.0, limits };
    let low: LoadPoint = hold_load(&mut e, request)?;
    let high = hold_load(&mut e.clone(), LoadRequest { torque_nm: to_nm, ..request })?;
    let slope = (high.inputs.spark_deg - low.inputs.spark_deg) / (high.outputs.air_g_s - low.outputs.air_g_s);
    let spark = |y: &Outputs| {
        let along = (y.air_g_s - low.outputs.air_g_s).clamp(0.0, high.outputs.air_g_s - low.outputs.air_g_s);
        low.inputs.spark_deg + slope * along
    };
    let u = Inputs { throttle_deg: 90.0, wastegate_mm: 0.0, ..low.inputs };
    StepRecord::take(&mut e, u, 8.0, spark)
}
