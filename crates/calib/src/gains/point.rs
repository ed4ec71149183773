//! One operating point: its test, its model, the gains that keep the margins there.

use dynocal_ident::data::Dataset;
use dynocal_ident::pi::PiGains;
use dynocal_ident::plan::{Plan, PlanChannel, PlanDemand, PlanLoop};
use dynocal_ident::plant::Plant;
use dynocal_ident::play::{Interruptible, Oscillation, PlayError, oscillation, play};
use dynocal_numerics::linalg::least_squares;
use dynocal_numerics::rng::Rng64;

use crate::supervisor;

use super::fit::Linear;
use super::margin;
use super::{TuneError, TuneSpec};

/// Least size of a value of an input, as a share of its range, and where there is no range: what a share of it is taken of.
const LEAST: (f64, f64) = (0.1, 1e-3);
/// Steps of an approach; distance from the demand at which it ends, as a share of the demand; longest step, as a share of the
/// input.
const STEPS: usize = 12;
const NEAR: f64 = 0.05;
const LONGEST_STEP: f64 = 0.3;
/// Memories of the plant that it is given to come to rest, and to come as near to it as a step of an approach asks; time over
/// which a rest is averaged, in s.
const SETTLE: f64 = 8.0;
const NEARLY: f64 = 4.0;
const REST_S: f64 = 1.0;
/// Share of a rest that is enough far from the demand, and what is far, in distances at which an approach ends.
const GLANCE: f64 = 0.5;
const FAR: f64 = 3.0;
/// Movement of an input that shows what it does, as a share of it.
const TOUCH: f64 = 0.1;
/// Most tests about one point, and the standard error of the steady effects, as a share of them, at which one is enough.
const TESTS: usize = 4;
const KNOWN: f64 = 0.03;
/// How much longer responses are made where those of the memory that the spec states do not settle.
const LONGER: [f64; 2] = [1.5, 2.0];

/// A plant on which gains are tried, and what that took.
pub(super) struct Bench<'a> {
    pub(super) plant: &'a mut dyn Plant,
    pub(super) spec: &'a TuneSpec,
    pub(super) seed: u64,
    pub(super) interrupt: &'a dyn Fn() -> bool,
    pub(super) used_s: f64,
    pub(super) oscillations: Vec<Oscillation>,
}

/// What was found at one operating point.
pub(super) struct Point<'a> {
    pub(super) plan: &'a Plan,
    /// Inputs at which the demands are held.
    pub(super) inputs: Vec<f64>,
    /// Model there.
    pub(super) linear: Linear,
    /// Gains that keep the margins there.
    pub(super) gains: Vec<PiGains>,
}

/// How a trial of gains ends.
pub(super) enum Trial {
    /// Inputs at which the demands are held, by point.
    Quiet(Vec<Vec<f64>>),
    /// The first point at which a loop oscillates.
    Restless(String, Oscillation),
}

impl Bench<'_> {
    /// Goes from the first row of `plan`, number `k`, to where its demands are held, and tests there. The way is found by the
    /// model of a neighbour among the points that are `known`; it begins where one of them holds the same demands.
    pub(super) fn point<'a>(
        &mut self,
        plan: &'a Plan,
        k: usize,
        known: &[Point],
    ) -> Result<Point<'a>, TuneError> {
        let mut inputs = start(plan);
        let alike = known.iter().rev().find(|p| same_demands(p.plan, plan));
        if let (Some(p), true) = (alike, self.spec.rounds > 1) {
            for (v, (c, held)) in inputs.iter_mut().zip(plan.channels.iter().zip(&p.inputs)) {
                if plan.loops.iter().any(|l| l.input == c.name) {
                    *v = *held;
                }
            }
        }
        let mut linear = None;
        for test in 0..self.spec.rounds {
            let mut arrived = false;
            if self.spec.rounds > 1 {
                let way = linear.as_ref().or(alike.or(known.last()).map(|p| &p.linear)).map(Linear::steady);
                let way = match way {
                    Some(gains) => gains,
                    None => self.touched(plan, &inputs)?,
                };
                (inputs, arrived) = self.approach(plan, inputs, way)?;
            }
            linear = Some(self.tested(plan, &inputs, arrived, 1000 * k + 100 * test)?);
            if arrived {
                break;
            }
        }
        // The rounds are checked to be one at least.
        let linear = match linear {
            Some(linear) => linear,
            None => self.tested(plan, &inputs, false, 1000 * k)?,
        };
        let alone = margin::alone(&linear, &plan.loops)?;
        let gains = margin::detuned(&[&linear], &alone, &plan.loops, self.spec, 1.0)?;
        let gains = gains.loops.iter().map(|l| l.gains).collect();
        Ok(Point { plan, inputs, linear, gains })
    }

    /// The model about `inputs`, at which the plant nearly is at rest when it has just `arrived`: from tests until it is known.
    fn tested(
        &mut self,
        plan: &Plan,
        inputs: &[f64],
        arrived: bool,
        stream: usize,
    ) -> Result<Linear, TuneError> {
        let spec = self.spec;
        let mut records = Vec::new();
        loop {
            let part = test(plan, inputs, spec, self.seed, stream + 10 * records.len());
            let rested_s = if arrived && records.is_empty() { NEARLY * spec.memory_s + REST_S } else { 0.0 };
            let settle_s = (part.settle_s - rested_s).max(0.0);
            records.push(self.played(&part.settled(settle_s))?);
            let found = Linear::fit(&records, &plan.loops, spec);
            let enough = |l: &Linear| l.doubt <= KNOWN && margin::alone(l, &plan.loops).is_ok();
            if found.as_ref().is_ok_and(enough) {
                return found;
            }
            if records.len() >= TESTS {
                let settled = |l: &Linear| margin::alone(l, &plan.loops).is_ok();
                // A plant that remembers more than was expected: the same records, longer responses.
                let longer =
                    LONGER.iter().map(|by| TuneSpec { memory_s: by * spec.memory_s, ..spec.clone() });
                let fit = |spec: TuneSpec| Linear::fit(&records, &plan.loops, &spec).ok().filter(settled);
                return match found {
                    Ok(l) if !settled(&l) => Ok(longer.into_iter().find_map(fit).unwrap_or(l)),
                    other => other,
                };
            }
        }
    }

    /// Steady gains about `inputs`, outputs by inputs, row-major, from one movement of the input of each loop.
    fn touched(&mut self, plan: &Plan, inputs: &[f64]) -> Result<Vec<f64>, TuneError> {
        let n = plan.loops.len();
        let before = self.rest(plan, inputs, GLANCE)?;
        let mut gains = vec![0.0; n * n];
        for (i, l) in plan.loops.iter().enumerate() {
            let mut moved = inputs.to_vec();
            for (v, c) in moved.iter_mut().zip(&plan.channels).filter(|(_, c)| c.name == l.input) {
                let by = TOUCH * size(c, *v);
                *v = if *v + by <= c.upper { *v + by } else { (*v - by).max(c.lower) };
            }
            let by: f64 = moved.iter().zip(inputs).map(|(a, b)| a - b).sum();
            if by == 0.0 {
                continue;
            }
            let after = self.rest(plan, &moved, GLANCE)?;
            for o in 0..n {
                gains[o * n + i] = (after[o] - before[o]) / by;
            }
        }
        Ok(gains)
    }

    /// From `inputs` towards the demands with all loops open, and whether they are reached: Newton steps on steady `gains`,
    /// corrected by what each step does (Broyden), none larger than a share of the input. A loop that is closed far from its
    /// demand may have the other sign there: on a lean mixture more throttle is less torque.
    fn approach(
        &mut self,
        plan: &Plan,
        inputs: Vec<f64>,
        mut gains: Vec<f64>,
    ) -> Result<(Vec<f64>, bool), TuneError> {
        let n = plan.loops.len();
        let place = |l: &PlanLoop| plan.channels.iter().position(|c| c.name == l.input);
        let places: Vec<usize> = plan.loops.iter().filter_map(place).collect();
        let demands: Vec<f64> = plan
            .loops
            .iter()
            .filter_map(|l| plan.demand(&l.output).and_then(|d| d.values.first().copied()))
            .collect();
        if places.len() < n || demands.len() < n {
            // The player names what is missing.
            return Ok((inputs, true));
        }
        let mut at = inputs;
        let mut before: Option<(Vec<f64>, Vec<f64>)> = None;
        let mut share = GLANCE;
        for _ in 0..STEPS {
            let y = self.rest(plan, &at, share)?;
            let u: Vec<f64> = places.iter().map(|k| at[*k]).collect();
            if let Some((u0, y0)) = &before {
                broyden(&mut gains, u0, &u, y0, &y);
            }
            let error: Vec<f64> = demands.iter().zip(&y).map(|(d, y)| d - y).collect();
            let within = |most: f64| error.iter().zip(&demands).all(|(e, d)| e.abs() <= most * d.abs());
            if within(NEAR) && share == 1.0 {
                return Ok((at, true));
            }
            share = if within(FAR * NEAR) { 1.0 } else { GLANCE };
            if within(NEAR) {
                // A glance says so: look once more.
                continue;
            }
            let Ok(step) = least_squares(&gains, n, n, &error, 0.0) else { break };
            let channel = |k: usize| &plan.channels[places[k]];
            let length = |k: usize| step.x[k].abs() / (LONGEST_STEP * size(channel(k), u[k]));
            let shorter = (0..n).map(length).fold(1.0, f64::max);
            for k in 0..n {
                at[places[k]] = (u[k] + step.x[k] / shorter).clamp(channel(k).lower, channel(k).upper);
            }
            before = Some((u, y));
        }
        Ok((at, false))
    }

    /// Outputs of the loops at rest under constant inputs, after a `share` of the time that a rest takes.
    fn rest(&mut self, plan: &Plan, inputs: &[f64], share: f64) -> Result<Vec<f64>, TuneError> {
        let n = samples(share * REST_S, plan);
        let outputs: Vec<String> = plan.loops.iter().map(|l| l.output.clone()).collect();
        let name = format!("{}, approach", plan.name);
        let open = Plan::open_loop(&name, plan.sample_time_s, held(plan, inputs, n));
        let settle_s = share * NEARLY * self.spec.memory_s;
        let hold = Plan { outputs, ..open.with_limits(plan.limits.clone()).settled(settle_s) };
        let record = self.played(&hold)?;
        let mean = |l: &PlanLoop| Ok(record.values(&l.output)?.iter().sum::<f64>() / n as f64);
        plan.loops.iter().map(mean).collect::<Result<_, PlayError>>().map_err(TuneError::from)
    }

    /// Plays `loops` at the demands of all `points`: the inputs that hold them, or the first point at which a loop oscillates.
    pub(super) fn tried(&mut self, points: &[Point], loops: &[PlanLoop]) -> Result<Trial, TuneError> {
        let mut inputs = Vec::with_capacity(points.len());
        for p in points {
            let record = self.played(&trial(p.plan, &p.inputs, loops, self.spec))?;
            let seen = loops.iter().map(|l| oscillation(&record, l)).collect::<Result<Vec<_>, _>>();
            if let Some(o) = seen.map_err(PlayError::from)?.into_iter().flatten().next() {
                return Ok(Trial::Restless(p.plan.name.clone(), o));
            }
            inputs.push(means(p.plan, &record, samples(0.25 * self.spec.trial_s, p.plan))?);
        }
        Ok(Trial::Quiet(inputs))
    }

    fn played(&mut self, plan: &Plan) -> Result<Dataset, TuneError> {
        // Abort rules hold while gains are looked for, too.
        let mut supervisor = supervisor::for_plan(plan, &[]);
        let mut watchdog = Interruptible { interrupt: self.interrupt, watchdog: &mut supervisor };
        let played = play(self.plant, plan, &mut watchdog)?.whole()?;
        self.used_s += played.used_s;
        Ok(played.record)
    }
}

/// Whether two plans begin with the same demands.
fn same_demands(a: &Plan, b: &Plan) -> bool {
    let first = |d: &PlanDemand| (d.output.clone(), d.values.first().copied());
    a.demands.iter().map(first).eq(b.demands.iter().map(first))
}

/// Where a plan begins.
pub(super) fn start(plan: &Plan) -> Vec<f64> {
    plan.channels.iter().map(|c| c.values.first().copied().unwrap_or(0.0)).collect()
}

/// The inputs of the loops moved up and down at random times, loops open.
pub(super) fn test(plan: &Plan, inputs: &[f64], spec: &TuneSpec, seed: u64, stream: usize) -> Plan {
    let (n, hold) = (samples(spec.test_s, plan), samples(spec.hold_s, plan));
    let mut channels = held(plan, inputs, n);
    for (k, l) in plan.loops.iter().enumerate() {
        let mut rng = Rng64::stream(seed, (stream + k) as u64);
        for c in channels.iter_mut().filter(|c| c.name == l.input) {
            let (middle, size) = (c.values[0], spec.share * size(c, c.values[0]));
            let mut t = 0;
            while t < n {
                let end = (t + hold * (1 + rng.below(6))).min(n);
                let level = if rng.below(2) == 0 { middle - size } else { middle + size };
                c.values[t..end].fill(level.clamp(c.lower, c.upper));
                t = end;
            }
        }
    }
    let outputs = plan.loops.iter().map(|l| l.output.clone()).collect();
    // What the plant needs to come to rest is at least what the test asks it to remember several times over.
    let open = Plan::open_loop(&format!("{}, test", plan.name), plan.sample_time_s, channels);
    Plan { outputs, ..open.with_limits(plan.limits.clone()).settled(SETTLE * spec.memory_s) }
}

/// Size of a value of a channel.
fn size(c: &PlanChannel, value: f64) -> f64 {
    let range = c.upper - c.lower;
    let least = if range.is_finite() && range > 0.0 { LEAST.0 * range } else { LEAST.1 };
    value.abs().max(least)
}

/// The least change of the gains (row by output) that explains what the last step did; inputs count by their size.
fn broyden(gains: &mut [f64], u0: &[f64], u: &[f64], y0: &[f64], y: &[f64]) {
    let n = u.len();
    let step: Vec<f64> = u.iter().zip(u0).map(|(a, b)| a - b).collect();
    let weighted: Vec<f64> = step.iter().zip(u0).map(|(d, u)| d / u.abs().max(1e-3).powi(2)).collect();
    let length: f64 = step.iter().zip(&weighted).map(|(a, b)| a * b).sum();
    if !(length > 0.0) {
        return;
    }
    for o in 0..n {
        let promised: f64 = (0..n).map(|i| gains[o * n + i] * step[i]).sum();
        let missed = (y[o] - y0[o] - promised) / length;
        (0..n).for_each(|i| gains[o * n + i] += missed * weighted[i]);
    }
}

/// Channels held at `inputs`.
fn held(plan: &Plan, inputs: &[f64], n: usize) -> Vec<PlanChannel> {
    let channels = plan.channels.iter().zip(inputs);
    channels.map(|(c, v)| PlanChannel { values: vec![v.clamp(c.lower, c.upper); n], ..c.clone() }).collect()
}

fn samples(time_s: f64, plan: &Plan) -> usize {
    (time_s / plan.sample_time_s).round().max(1.0) as usize
}

/// The loops closed at the demands of the first row.
fn trial(plan: &Plan, inputs: &[f64], loops: &[PlanLoop], spec: &TuneSpec) -> Plan {
    let n = samples(spec.trial_s, plan);
    let hold = |d: &PlanDemand| PlanDemand { values: vec![d.values[0]; n], ..d.clone() };
    let demands = plan.demands.iter().filter(|d| !d.values.is_empty()).map(hold).collect();
    let outputs = loops.iter().map(|l| l.output.clone()).collect();
    let name = format!("{}, trial", plan.name);
    let open = Plan::open_loop(&name, plan.sample_time_s, held(plan, inputs, n));
    let closed = open.with_loops(demands, loops.to_vec()).with_limits(plan.limits.clone());
    // The loops are there for the last bit of the way.
    Plan { outputs, ..closed.settled(NEARLY * spec.memory_s) }
}

/// Inputs over the last samples of a trial.
fn means(plan: &Plan, record: &Dataset, last: usize) -> Result<Vec<f64>, PlayError> {
    let mean = |c: &PlanChannel| {
        let values = record.values(&c.name)?;
        let tail = &values[values.len().saturating_sub(last)..];
        Ok(tail.iter().sum::<f64>() / tail.len().max(1) as f64)
    };
    plan.channels.iter().map(mean).collect()
}
