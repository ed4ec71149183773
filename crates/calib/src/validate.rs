//! Validation of feedforward maps on the plant: random operating points and steps of the leading demand (thesis sections 6.7,
//! 7.6.4).

mod unreached;

pub use unreached::{MOST_OFFSET, Unreached, unreached};

use crate::limits::{LimitScore, limit_scores};
use crate::map::Rows;
use crate::problem::CalibrationProblem;
use dynocal_ident::data::{DataError, Dataset};
use dynocal_ident::derived::DerivedError;
use dynocal_numerics::interval::Interval;
use dynocal_numerics::rng::Rng64;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Levels of steps. Files hold them as `[from, to]`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(from = "(f64, f64)", into = "(f64, f64)")]
pub struct StepLevels {
    /// Where the first step begins.
    pub from: f64,
    /// Where it goes to.
    pub to: f64,
}

impl From<(f64, f64)> for StepLevels {
    fn from((from, to): (f64, f64)) -> Self {
        Self { from, to }
    }
}

impl From<StepLevels> for (f64, f64) {
    fn from(s: StepLevels) -> Self {
        (s.from, s.to)
    }
}

/// What the maps are asked to do. Ranges that are not given are inner parts of the problem's ranges.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ValidateSpec {
    /// Random operating points.
    pub points: usize,
    /// Time at each operating point in s.
    pub point_s: f64,
    /// Range of the leading demand at the points; its inner three quarters where it is not given.
    pub demand: Option<Interval>,
    /// Range of the given channel at the points; its inner nine tenths where it is not given.
    pub given: Option<Interval>,
    /// Largest change of the given channel between points per second (the dynamometer's gradient); half its range where it is
    /// not given.
    pub given_rate_per_s: Option<f64>,
    /// Levels of the steps; a quarter and three quarters of the leading demand where they are not given.
    pub step: Option<StepLevels>,
    /// Value of the given channel during the steps; its middle where it is not given.
    pub step_given: Option<f64>,
    /// Number of steps.
    pub steps: usize,
    /// Time after each step in s.
    pub step_s: f64,
    /// Settling bands about the final value by demand, in its unit; where a demand is not named, a fortieth of the range
    /// of the leading demand and a tenth of that of a further one.
    pub bands: BTreeMap<String, f64>,
}

impl Default for ValidateSpec {
    fn default() -> Self {
        Self {
            points: 20,
            point_s: 6.0,
            demand: None,
            given: None,
            given_rate_per_s: None,
            step: None,
            step_given: None,
            steps: 6,
            step_s: 6.0,
            bands: BTreeMap::new(),
        }
    }
}

/// Part of a range: `share` is left out at either end.
pub fn inner((lower, upper): (f64, f64), share: f64) -> (f64, f64) {
    let cut = share * (upper - lower);
    (lower + cut, upper - cut)
}

impl ValidateSpec {
    /// Range of the leading demand at the points.
    pub fn demand_range(&self, problem: &CalibrationProblem) -> Interval {
        self.demand.unwrap_or_else(|| inner(lead(problem), 0.125).into())
    }

    /// Range of the first given channel at the points; none where the problem has none.
    pub fn given_range(&self, problem: &CalibrationProblem) -> Option<Interval> {
        let range = problem.given.first().map(|g| (g.lower, g.upper))?;
        Some(self.given.unwrap_or_else(|| inner(range, 0.05).into()))
    }

    /// Settling band of demand number `k`.
    pub fn band(&self, problem: &CalibrationProblem, k: usize) -> f64 {
        let d = &problem.demands[k];
        let share = if k == 0 { 0.025 } else { 0.1 };
        self.bands.get(&d.output).copied().unwrap_or(share * (d.upper - d.lower))
    }
}

fn lead(problem: &CalibrationProblem) -> (f64, f64) {
    problem.demands.first().map_or((0.0, 1.0), |d| (d.lower, d.upper))
}

/// Values at which the demands other than the leading one, and the given channels other than the first, are held: the
/// middles of their ranges.
pub fn rest_of(problem: &CalibrationProblem) -> (Vec<f64>, Vec<f64>) {
    let middle = |a: f64, b: f64| 0.5 * (a + b);
    (
        problem.demands.iter().skip(1).map(|d| middle(d.lower, d.upper)).collect(),
        problem.given.iter().skip(1).map(|g| middle(g.lower, g.upper)).collect(),
    )
}

/// A row of references: leading demand, other demands, first given channel, other given channels.
pub fn reference_row(problem: &CalibrationProblem, demand: f64, given: Option<f64>) -> Vec<f64> {
    let (demands, others) = rest_of(problem);
    [demand].into_iter().chain(demands).chain(given).chain(others).collect()
}

/// A demand record with the samples at which the demand changes.
#[derive(Clone, Debug)]
pub struct Scenario {
    /// Name for tables.
    pub name: String,
    /// Raw references per sample: demands, then given channels.
    pub reference: Rows,
    /// First sample of each held operating point.
    pub switches: Vec<usize>,
}

/// Random operating points; the given channel moves between them with its gradient.
pub fn random_points(
    spec: &ValidateSpec,
    problem: &CalibrationProblem,
    sample_time_s: f64,
    rng: &mut Rng64,
) -> Scenario {
    let hold = (spec.point_s / sample_time_s).round() as usize;
    let demand = spec.demand_range(problem);
    let given = spec.given_range(problem);
    let rate = spec.given_rate_per_s.or_else(|| problem.given.first().map(|g| 0.5 * (g.upper - g.lower)));
    let slew = rate.unwrap_or(f64::INFINITY) * sample_time_s;
    let mut reference = Rows::new(problem.demands.len() + problem.given.len());
    let mut now: Option<f64> = None;
    for _ in 0..spec.points {
        let level = rng.uniform_in(demand.lower, demand.upper);
        let target = given.map(|g| rng.uniform_in(g.lower, g.upper));
        for _ in 0..hold {
            now = target.map(|target| {
                let from = now.unwrap_or(target);
                from + (target - from).clamp(-slew, slew)
            });
            reference.push(&reference_row(problem, level, now));
        }
    }
    let switches = (0..spec.points).map(|k| k * hold).collect();
    Scenario { name: "random operating points".into(), reference, switches }
}

/// Steps of the leading demand between two levels with everything else held.
pub fn demand_steps(spec: &ValidateSpec, problem: &CalibrationProblem, sample_time_s: f64) -> Scenario {
    let hold = (spec.step_s / sample_time_s).round() as usize;
    let levels = spec.step.unwrap_or_else(|| inner(lead(problem), 0.25).into());
    let given = problem.given.first().map(|g| spec.step_given.unwrap_or(0.5 * (g.lower + g.upper)));
    let mut reference = Rows::new(problem.demands.len() + problem.given.len());
    for k in 0..=spec.steps {
        let level = if k.is_multiple_of(2) { levels.from } else { levels.to };
        let row = reference_row(problem, level, given);
        (0..hold).for_each(|_| reference.push(&row));
    }
    let switches = (0..=spec.steps).map(|k| k * hold).collect();
    let unit = problem.demands.first().map_or("", |d| d.unit.as_str());
    let at = match (given, problem.given.first()) {
        (Some(v), Some(g)) => format!(" at {v} {}", g.unit),
        _ => String::new(),
    };
    Scenario { name: format!("{} to {} {unit} steps{at}", levels.from, levels.to), reference, switches }
}

/// How one map met one demand in one scenario. Times count from the change of the raw demand, look-ahead included.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DemandScore {
    /// Demanded output.
    pub output: String,
    /// Its unit.
    pub unit: String,
    /// Root mean square of output minus raw demand.
    pub rms: f64,
    /// Mean |output - demand|.
    pub mean_error: f64,
    /// Mean over the steps of the integral of |output - demand| from one step to the next, in unit s: offsets count.
    pub integral_s: f64,
    /// Worst |mean of the last second - demand| over the points.
    pub offset: f64,
    /// Worst settling time in s.
    pub settling_s: f64,
    /// Mean settling time in s.
    pub settling_mean_s: f64,
    /// Largest output - demand after the first change.
    pub spike_above: f64,
    /// Largest demand - output after the first change.
    pub spike_below: f64,
}

impl DemandScore {
    /// Largest |output - demand| after the first change.
    pub fn spike(&self) -> f64 {
        self.spike_above.max(self.spike_below)
    }
}

/// How one map did in one scenario.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MapScore {
    /// Map.
    pub map: String,
    /// Scenario.
    pub scenario: String,
    /// By demand, leading demand first.
    pub demands: Vec<DemandScore>,
    /// Mean of what is minimised over the record.
    pub objective: f64,
    /// Economy of eq. 6.4: sum of the leading output over the sum of the input that the objective is proportional to (Nm per mg
    /// for torque and injected fuel); comparable only at equal errors of the other demands. None where the objective is
    /// not proportional to one input.
    pub economy: Option<f64>,
    /// The same over the samples at which every compared map is within a twentieth of the range of the other demands; none when
    /// there is no such sample.
    pub economy_equal: Option<f64>,
    /// Limits of the problem against the whole record.
    pub limits: Vec<LimitScore>,
    /// Points at whose end a demand is not reached.
    #[serde(default)]
    pub unreached: Vec<Unreached>,
}

impl MapScore {
    /// The score of a demand.
    pub fn demand(&self, output: &str) -> Option<&DemandScore> {
        self.demands.iter().find(|d| d.output == output)
    }
}

/// Measured demands and objective of one run.
struct Measured<'a> {
    outputs: Vec<&'a [f64]>,
    /// What is minimised, weighted, by sample.
    objective: Vec<f64>,
    /// The input that the objective is proportional to.
    spent: Option<&'a [f64]>,
    limits: Vec<LimitScore>,
    unreached: Vec<Unreached>,
}

fn measured<'a>(
    problem: &CalibrationProblem,
    scenario: &Scenario,
    record: &'a Dataset,
) -> Result<Measured<'a>, DerivedError> {
    let outputs =
        problem.demands.iter().map(|d| record.values(&d.output)).collect::<Result<_, DataError>>()?;
    let spent = spent_input(problem).map(|name| record.values(&name)).transpose()?;
    let limits = limit_scores(problem, record, 0)?;
    let unreached = unreached(problem, scenario, record)?;
    Ok(Measured { outputs, objective: objective(problem, record)?, spent, limits, unreached })
}

/// The input that a single objective term is proportional to, apart from given channels: injected fuel for a fuel flow.
pub fn spent_input(problem: &CalibrationProblem) -> Option<String> {
    let [term] = problem.minimise.as_slice() else { return None };
    let inputs = problem.input_names();
    let powers = problem.monomial(&term.channel).powers;
    let mut moved = powers.into_iter().filter(|(name, _)| inputs.contains(name));
    match (moved.next(), moved.next()) {
        (Some((name, 1)), None) => Some(name),
        _ => None,
    }
}

/// What is minimised, weighted, sample by sample of a record.
///
/// # Errors
/// [`DerivedError`] when the record lacks a channel.
pub fn objective(problem: &CalibrationProblem, record: &Dataset) -> Result<Vec<f64>, DerivedError> {
    let mut sum = vec![0.0; record.len()];
    for (term, values) in problem.minimise.iter().zip(problem.objective_channels(record)?) {
        sum.iter_mut().zip(values).for_each(|(s, v)| *s += term.weight * v);
    }
    Ok(sum)
}

/// Scores all maps on one scenario; `records[k]` is the run of map k.
///
/// # Errors
/// [`DerivedError`] when a record lacks a channel.
pub fn score(
    spec: &ValidateSpec,
    problem: &CalibrationProblem,
    scenario: &Scenario,
    names: &[&str],
    records: &[&Dataset],
) -> Result<Vec<MapScore>, DerivedError> {
    let runs = records.iter().map(|r| measured(problem, scenario, r)).collect::<Result<Vec<_>, _>>()?;
    let n = scenario.reference.len();
    let near = |t: usize| {
        runs.iter().all(|m| {
            problem.demands.iter().enumerate().skip(1).all(|(k, d)| {
                (m.outputs[k][t] - scenario.reference.row(t)[k]).abs() <= 0.05 * (d.upper - d.lower)
            })
        })
    };
    let comparable: Vec<usize> = (0..n).filter(|&t| near(t)).collect();
    let dt = records.first().map_or(f64::NAN, |r| r.sample_time_s);
    let one = |(m, name): (&Measured, &&str)| MapScore {
        map: (*name).into(),
        scenario: scenario.name.clone(),
        demands: (0..problem.demands.len())
            .map(|k| demand_score(spec, problem, scenario, m, k, dt))
            .collect(),
        objective: m.objective.iter().sum::<f64>() / n.max(1) as f64,
        economy: economy(m, 0..n),
        economy_equal: economy(m, comparable.iter().copied()),
        limits: m.limits.clone(),
        unreached: m.unreached.clone(),
    };
    Ok(runs.iter().zip(names).map(one).collect())
}

fn economy(m: &Measured, samples: impl Iterator<Item = usize> + Clone) -> Option<f64> {
    let (lead, spent) = (m.outputs.first()?, m.spent?);
    let ratio = samples.clone().map(|t| lead[t]).sum::<f64>() / samples.map(|t| spent[t]).sum::<f64>();
    Some(ratio).filter(|v| v.is_finite())
}

fn demand_score(
    spec: &ValidateSpec,
    problem: &CalibrationProblem,
    scenario: &Scenario,
    m: &Measured,
    k: usize,
    dt: f64,
) -> DemandScore {
    let n = scenario.reference.len();
    let y = m.outputs[k];
    let error = |t: usize| y[t] - scenario.reference.row(t)[k];
    let second = (1.0 / dt).round() as usize;
    let mean = |y: &[f64]| y.iter().sum::<f64>() / y.len().max(1) as f64;
    let (mut offset, mut settling, mut integrals) = (0.0f64, Vec::new(), Vec::new());
    for (at, &from) in scenario.switches.iter().enumerate() {
        let to = scenario.switches.get(at + 1).copied().unwrap_or(n);
        let end = mean(&y[to.saturating_sub(second).max(from)..to]);
        offset = offset.max((end - scenario.reference.row(to - 1)[k]).abs());
        if at > 0 {
            settling.push(settling_s(&y[from..to], end, spec.band(problem, k), dt));
            integrals.push((from..to).map(|t| error(t).abs() * dt).sum::<f64>());
        }
    }
    let moved = scenario.switches.get(1).copied().unwrap_or(0);
    DemandScore {
        output: problem.demands[k].output.clone(),
        unit: problem.demands[k].unit.clone(),
        rms: ((0..n).map(|t| error(t).powi(2)).sum::<f64>() / n.max(1) as f64).sqrt(),
        mean_error: (0..n).map(|t| error(t).abs()).sum::<f64>() / n.max(1) as f64,
        integral_s: mean(&integrals),
        offset,
        settling_s: settling.iter().copied().fold(0.0, f64::max),
        settling_mean_s: mean(&settling),
        spike_above: (moved..n).fold(0.0, |a, t| error(t).max(a)),
        spike_below: (moved..n).fold(0.0, |a, t| (-error(t)).max(a)),
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
        let s = random_points(&spec, &CalibrationProblem::thesis(), 0.03, &mut Rng64::new(3));
        assert_eq!(s.switches.len(), spec.points);
        assert!(s.reference.iter().all(|r| (20.0..=80.0).contains(&r[0]) && r[1] == 1.0));
        let speed = s.reference.column(2);
        let steepest = speed.windows(2).map(|w| (w[1] - w[0]).abs()).fold(0.0, f64::max);
        assert!(steepest <= 1000.0 * 0.03 + 1e-9);
    }
}
