//! Validation of feedforward maps on the plant: random operating points and torque steps (thesis sections 6.7, 7.6.4).

use crate::control::LoopGains;
use crate::map::{FeedforwardMap, Reference};
use crate::record::{ActuatorLimits, engine_plan};
use dynocal_ident::data::{Channel, Dataset, Role};
use dynocal_ident::plant::Plant;
use dynocal_ident::play::{PlayError, Unwatched, play};
use dynocal_numerics::rng::Rng64;
use serde::{Deserialize, Serialize};

/// What the maps are asked to do.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ValidateSpec {
    /// Random operating points.
    pub points: usize,
    /// Time at each operating point in s.
    pub point_s: f64,
    /// Torque range of the points in Nm.
    pub torque_nm: (f64, f64),
    /// Speed range of the points in rpm.
    pub speed_rpm: (f64, f64),
    /// Largest speed gradient of the dynamometer between points, rpm/s.
    pub speed_rate_rpm_s: f64,
    /// Torque levels of the steps in Nm.
    pub step_nm: (f64, f64),
    /// Speed of the steps in rpm.
    pub step_speed_rpm: f64,
    /// Number of steps.
    pub steps: usize,
    /// Time after each step in s.
    pub step_s: f64,
    /// Settling band about the final torque, in Nm.
    pub torque_band_nm: f64,
    /// Settling band about the final lambda.
    pub lambda_band: f64,
}

impl Default for ValidateSpec {
    fn default() -> Self {
        Self {
            points: 20,
            point_s: 6.0,
            torque_nm: (20.0, 80.0),
            speed_rpm: (1100.0, 2900.0),
            speed_rate_rpm_s: 1000.0,
            step_nm: (30.0, 70.0),
            step_speed_rpm: 2000.0,
            steps: 6,
            step_s: 6.0,
            torque_band_nm: 2.0,
            lambda_band: 0.02,
        }
    }
}

/// A demand record with the samples at which the demand changes.
#[derive(Clone, Debug)]
pub struct Scenario {
    /// Name for tables.
    pub name: String,
    /// Raw demand per sample.
    pub demand: Vec<Reference>,
    /// First sample of each held operating point.
    pub switches: Vec<usize>,
}

/// Random operating points; speed moves between them with the dynamometer's gradient.
pub fn random_points(spec: &ValidateSpec, sample_time_s: f64, rng: &mut Rng64) -> Scenario {
    let hold = (spec.point_s / sample_time_s).round() as usize;
    let slew = spec.speed_rate_rpm_s * sample_time_s;
    let mut demand: Vec<Reference> = Vec::with_capacity(hold * spec.points);
    let mut speed = f64::NAN;
    for _ in 0..spec.points {
        let torque_nm = rng.uniform_in(spec.torque_nm.0, spec.torque_nm.1);
        let target = rng.uniform_in(spec.speed_rpm.0, spec.speed_rpm.1);
        if speed.is_nan() {
            speed = target;
        }
        for _ in 0..hold {
            speed += (target - speed).clamp(-slew, slew);
            demand.push(Reference { torque_nm, lambda: 1.0, speed_rpm: speed });
        }
    }
    let switches = (0..spec.points).map(|k| k * hold).collect();
    Scenario { name: "random operating points".into(), demand, switches }
}

/// Torque steps between two levels at constant speed.
pub fn torque_steps(spec: &ValidateSpec, sample_time_s: f64) -> Scenario {
    let hold = (spec.step_s / sample_time_s).round() as usize;
    let level = |k: usize| if k.is_multiple_of(2) { spec.step_nm.0 } else { spec.step_nm.1 };
    let demand = (0..=spec.steps)
        .flat_map(|k| {
            let r = Reference { torque_nm: level(k), lambda: 1.0, speed_rpm: spec.step_speed_rpm };
            std::iter::repeat_n(r, hold)
        })
        .collect();
    let switches = (0..=spec.steps).map(|k| k * hold).collect();
    let name = format!("{} to {} Nm steps at {} rpm", spec.step_nm.0, spec.step_nm.1, spec.step_speed_rpm);
    Scenario { name, demand, switches }
}

/// How one map did in one scenario. Times count from the change of the raw demand, look-ahead included.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MapScore {
    /// Map.
    pub map: String,
    /// Scenario.
    pub scenario: String,
    /// Root mean square of torque minus raw demand, in Nm.
    pub torque_rms_nm: f64,
    /// Root mean square of lambda minus demand.
    pub lambda_rms: f64,
    /// Worst |mean of the last second - demand| of torque over the points, in Nm.
    pub torque_offset_nm: f64,
    /// Worst |mean of the last second - demand| of lambda.
    pub lambda_offset: f64,
    /// Worst torque settling time in s.
    pub torque_settling_s: f64,
    /// Mean torque settling time in s.
    pub torque_settling_mean_s: f64,
    /// Worst lambda settling time in s.
    pub lambda_settling_s: f64,
    /// Largest |lambda - 1| after the first change.
    pub lambda_spike: f64,
    /// Largest lambda - 1.
    pub lambda_spike_lean: f64,
    /// Largest 1 - lambda.
    pub lambda_spike_rich: f64,
    /// Economy of eq. 6.4 over the whole record, Nm per mg.
    pub economy_nm_mg: f64,
    /// Mean |lambda - 1| of the same record: economy is comparable only at equal lambda error.
    pub lambda_error_mean: f64,
    /// Economy over the samples at which every compared map is within 0.01 of lambda 1; none when there is no such
    /// sample.
    pub economy_equal_lambda_nm_mg: Option<f64>,
}

/// Runs `map` through `scenario` open loop and records it; the raw demand is recorded beside.
///
/// # Errors
/// [`PlayError`] of the player.
pub fn run_map(
    plant: &mut dyn Plant,
    sample_time_s: f64,
    map: &dyn FeedforwardMap,
    scenario: &Scenario,
    limits: ActuatorLimits,
) -> Result<Dataset, PlayError> {
    let drive = map.drive(&scenario.demand, sample_time_s);
    let feedforward: Vec<[f64; 4]> =
        drive.iter().zip(&scenario.demand).map(|(u, r)| [u[0], u[1], u[2], r.speed_rpm]).collect();
    let name = format!("{}, {}", map.name(), scenario.name);
    let plan = engine_plan(&name, sample_time_s, &feedforward, &[], LoopGains::TRIM, limits, 4.0);
    let mut record = play(plant, &plan, &mut Unwatched)?.whole()?.record;
    let demand = scenario.demand.iter().map(|r| r.torque_nm).collect();
    record.channels.push(Channel {
        name: "torque_demand".into(),
        unit: "Nm".into(),
        role: Role::Auxiliary,
        values: demand,
    });
    Ok(record)
}

/// Torque, lambda and fuel of one run.
struct Measured<'a> {
    torque: &'a [f64],
    lambda: &'a [f64],
    inj: &'a [f64],
}

fn measured(record: &Dataset) -> Result<Measured<'_>, dynocal_ident::data::DataError> {
    Ok(Measured {
        torque: record.values("torque")?,
        lambda: record.values("lambda")?,
        inj: record.values("inj")?,
    })
}

/// Scores all maps on one scenario; `records[k]` is the run of map k.
///
/// # Errors
/// [`dynocal_ident::data::DataError`] when a record lacks a channel.
pub fn score(
    spec: &ValidateSpec,
    scenario: &Scenario,
    names: &[&str],
    records: &[&Dataset],
) -> Result<Vec<MapScore>, dynocal_ident::data::DataError> {
    let runs = records.iter().map(|r| measured(r)).collect::<Result<Vec<_>, _>>()?;
    let n = scenario.demand.len();
    let near = |t: usize| runs.iter().all(|m| (m.lambda[t] - 1.0).abs() <= 0.01);
    let comparable: Vec<usize> = (0..n).filter(|&t| near(t)).collect();
    let dt = records.first().map_or(0.03, |r| r.sample_time_s);
    Ok(runs.iter().zip(names).map(|(m, name)| score_one(spec, scenario, name, m, &comparable, dt)).collect())
}

fn score_one(
    spec: &ValidateSpec,
    scenario: &Scenario,
    name: &str,
    m: &Measured,
    comparable: &[usize],
    dt: f64,
) -> MapScore {
    let n = scenario.demand.len();
    let second = (1.0 / dt).round() as usize;
    let mean = |y: &[f64]| y.iter().sum::<f64>() / y.len().max(1) as f64;
    let rms = |e: &dyn Fn(usize) -> f64| ((0..n).map(|t| e(t).powi(2)).sum::<f64>() / n as f64).sqrt();
    let mut torque_offset_nm = 0.0f64;
    let mut lambda_offset = 0.0f64;
    let (mut settle_t, mut settle_l) = (Vec::new(), Vec::new());
    for (k, &from) in scenario.switches.iter().enumerate() {
        let to = scenario.switches.get(k + 1).copied().unwrap_or(n);
        let last = to.saturating_sub(second).max(from)..to;
        let (torque_end, lambda_end) = (mean(&m.torque[last.clone()]), mean(&m.lambda[last]));
        torque_offset_nm = torque_offset_nm.max((torque_end - scenario.demand[to - 1].torque_nm).abs());
        lambda_offset = lambda_offset.max((lambda_end - 1.0).abs());
        if k > 0 {
            settle_t.push(settling_s(&m.torque[from..to], torque_end, spec.torque_band_nm, dt));
            settle_l.push(settling_s(&m.lambda[from..to], lambda_end, spec.lambda_band, dt));
        }
    }
    let moved = scenario.switches.get(1).copied().unwrap_or(0);
    let lean = m.lambda[moved..].iter().fold(0.0f64, |a, l| a.max(l - 1.0));
    let rich = m.lambda[moved..].iter().fold(0.0f64, |a, l| a.max(1.0 - l));
    let worst = |v: &[f64]| v.iter().copied().fold(0.0, f64::max);
    let sum = |y: &[f64], at: &[usize]| at.iter().map(|&t| y[t]).sum::<f64>();
    MapScore {
        map: name.into(),
        scenario: scenario.name.clone(),
        torque_rms_nm: rms(&|t| m.torque[t] - scenario.demand[t].torque_nm),
        lambda_rms: rms(&|t| m.lambda[t] - 1.0),
        torque_offset_nm,
        lambda_offset,
        torque_settling_s: worst(&settle_t),
        torque_settling_mean_s: mean(&settle_t),
        lambda_settling_s: worst(&settle_l),
        lambda_spike: lean.max(rich),
        lambda_spike_lean: lean,
        lambda_spike_rich: rich,
        economy_nm_mg: m.torque.iter().sum::<f64>() / m.inj.iter().sum::<f64>(),
        lambda_error_mean: m.lambda.iter().map(|l| (l - 1.0).abs()).sum::<f64>() / n as f64,
        economy_equal_lambda_nm_mg: Some(sum(m.torque, comparable) / sum(m.inj, comparable))
            .filter(|v| v.is_finite()),
    }
}

/// Time from the start of `y` after which it never leaves `band` about `end`.
fn settling_s(y: &[f64], end: f64, band: f64, dt: f64) -> f64 {
    let last_outside = y.iter().rposition(|v| (v - end).abs() > band);
    last_outside.map_or(0.0, |t| (t + 1) as f64 * dt)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settling_of_a_first_order_response_is_analytic() {
        let (tau, dt) = (0.5, 0.001);
        let y: Vec<f64> = (0..6000).map(|k| 40.0 * (1.0 - (-(f64::from(k)) * dt / tau).exp())).collect();
        // 40 exp(-t/tau) = 2
        let exact = tau * 20f64.ln();
        assert!((settling_s(&y, 40.0, 2.0, dt) - exact).abs() <= 2.0 * dt);
    }

    #[test]
    fn random_points_stay_in_range_and_respect_the_speed_gradient() {
        let spec = ValidateSpec::default();
        let s = random_points(&spec, 0.03, &mut Rng64::new(3));
        assert_eq!(s.switches.len(), spec.points);
        assert!(s.demand.iter().all(|r| (20.0..=80.0).contains(&r.torque_nm)));
        let steepest =
            s.demand.windows(2).map(|w| (w[1].speed_rpm - w[0].speed_rpm).abs()).fold(0.0, f64::max);
        assert!(steepest <= spec.speed_rate_rpm_s * 0.03 + 1e-9);
    }
}
