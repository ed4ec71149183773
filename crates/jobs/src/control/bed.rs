//! Tests about set points on a plant that answers: what is applied, what is measured, what is not linear.

use std::collections::BTreeMap;

use dynocal_control::error::ControlError;
use dynocal_control::response::odd_multisine;
use dynocal_ident::excitation::bla::{Level, Realisation, bla};
use dynocal_ident::plan::{Plan, PlanChannel};
use dynocal_ident::plant::{Causality, Plant, Variable};
use dynocal_ident::play::{Interruptible, Unwatched, play};
use dynocal_ident::signal;
use dynocal_ident::stored::Quantity;
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::watch::Watch;
use dynocal_plant::plants::{self, PlantSpec};
use serde::Serialize;

use super::records::Record;
use super::result::ControlJobError;
use super::spec::{Job, Point};
use super::test_spec::{Kind, TestSpec};

/// Realisations of a multisine, and periods of each that are kept after the first.
const SINES: (usize, usize) = (3, 3);
/// Longest hold over the shortest.
const HOLDS: f64 = 30.0;
/// Rises of a chirp, and steps, of one input.
const REPEATED: usize = 4;

/// What a multisine shows of a channel that is not linear, in dB over the excited lines; none: not above the noise.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Distortion {
    /// At odd lines that were left out: what is odd in the input.
    pub odd_db: Option<f64>,
    /// At even lines.
    pub even_db: Option<f64>,
}

/// One input as it is moved about its set point, and where the periods of its multisines begin.
struct Moved {
    values: Vec<f64>,
    realisations: Vec<usize>,
    period: usize,
}

/// The test about a set point: its record, and by loop the distortion of the output by its own input where multisines show it.
pub(super) fn tested(
    job: &Job,
    spec: &PlantSpec,
    test: &TestSpec,
    point: &Point,
    number: usize,
    watch: Watch,
) -> Result<(Record, Vec<Option<Distortion>>), ControlJobError> {
    let refused = |text: String| ControlJobError::Point {
        point: point.name.clone(),
        source: ControlError::Model(text),
    };
    let make = plants::find(&spec.name).and_then(|p| p.make);
    let make = make.ok_or_else(|| refused(format!("the plant `{}` does not answer", spec.name)))?;
    let mut plant = make(spec, true).map_err(|e| refused(e.to_string()))?;
    plant.reset(job.seed.wrapping_add(number as u64));
    let moved = moved(job, test, number)
        .map_err(|source| ControlJobError::Point { point: point.name.clone(), source })?;
    let plan = plan(job, plant.as_ref(), test, point, &moved).map_err(refused)?;
    let interrupt = || watch.interrupted();
    let mut watchdog = Interruptible { interrupt: &interrupt, watchdog: &mut Unwatched };
    let played = play(plant.as_mut(), &plan, &mut watchdog).and_then(dynocal_ident::play::Played::whole);
    if watch.interrupted() {
        return Err(ControlJobError::Interrupted);
    }
    let record = played.map_err(|e| refused(e.to_string()))?.record;
    let column = |name: &str| -> Result<(Quantity, Vec<f64>), ControlJobError> {
        let c = record.channel(name).map_err(|e| refused(e.to_string()))?;
        let mean = c.values.iter().sum::<f64>() / c.values.len().max(1) as f64;
        let quantity = Quantity { name: name.into(), unit: c.unit.clone() };
        Ok((quantity, c.values.iter().map(|v| v - mean).collect()))
    };
    let out = Record {
        name: point.name.clone(),
        inputs: job.loops.iter().map(|l| column(&l.input)).collect::<Result<_, _>>()?,
        outputs: job.loops.iter().map(|l| column(&l.output)).collect::<Result<_, _>>()?,
        demands: Vec::new(),
        sample_time_s: test.sample_time_s,
    };
    let shown = moved.iter().enumerate().map(|(k, m)| distortion(m, &out, k)).collect();
    Ok((out, shown))
}

/// Units of the channels of a plant.
pub(super) fn units(spec: &PlantSpec) -> BTreeMap<String, String> {
    let made = plants::find(&spec.name).and_then(|p| p.make).and_then(|make| make(spec, true).ok());
    let of = |v: &Variable| (v.name.clone(), v.unit.clone());
    made.map(|plant| plant.variables().iter().map(of).collect()).unwrap_or_default()
}

/// The plan: the set point with what moves about it.
fn plan(
    job: &Job,
    plant: &dyn Plant,
    test: &TestSpec,
    point: &Point,
    moved: &[Moved],
) -> Result<Plan, String> {
    let of = |causality: Causality| plant.variables().iter().filter(move |v| v.causality == causality);
    let names = |causality: Causality| of(causality).map(|v| v.name.as_str()).collect::<Vec<_>>().join(", ");
    let input = |name: &str| -> Result<&Variable, String> {
        let missing = || format!("the plant has no input `{name}`; it has {}", names(Causality::Input));
        of(Causality::Input).find(|v| v.name == name).ok_or_else(missing)
    };
    let rows = moved.first().map_or(0, |m| m.values.len());
    let mut channels = Vec::new();
    for (l, m) in job.loops.iter().zip(moved) {
        let v = input(&l.input)?;
        if !of(Causality::Output).any(|o| o.name == l.output) {
            return Err(format!(
                "the plant has no output `{}`; it has {}",
                l.output,
                names(Causality::Output)
            ));
        }
        let at = point.values.get(&l.input).copied().unwrap_or(v.start);
        let step = l.step.unwrap_or(0.0);
        if at - step < v.min || at + step > v.max {
            return Err(format!(
                "`{}` moves from {:.4} to {:.4} {}, its range is {} to {}",
                l.input,
                at - step,
                at + step,
                v.unit,
                v.min,
                v.max
            ));
        }
        channels.push(PlanChannel::free(&l.input, &v.unit, m.values.iter().map(|d| at + d).collect()));
    }
    for (name, value) in point.values.iter().filter(|(n, _)| !job.loops.iter().any(|l| l.input == **n)) {
        let v = input(name)?;
        channels.push(PlanChannel::free(name, &v.unit, vec![*value; rows]));
    }
    let outputs: Vec<&str> = job.loops.iter().map(|l| l.output.as_str()).collect();
    let plan = Plan::open_loop(&point.name, test.sample_time_s, channels);
    Ok(plan.settled(test.settle_s).recording(&outputs))
}

/// How each input moves.
fn moved(job: &Job, test: &TestSpec, number: usize) -> Result<Vec<Moved>, ControlError> {
    let n = job.loops.len();
    let rows = (test.length_s / test.sample_time_s).round() as usize;
    let part = rows / n;
    let one = |k: usize| -> Result<Moved, ControlError> {
        let size = job.loops[k].step.unwrap_or(0.0);
        let mut rng = Rng64::stream(job.seed, (number * n + k) as u64);
        let mut out = Moved { values: vec![0.0; rows], realisations: Vec::new(), period: 0 };
        let start = k * part;
        match test.kind {
            Kind::Levels => levels(&mut out.values, size, test, &mut rng),
            Kind::Multisine => {
                out.period = part / (SINES.0 * (SINES.1 + 1));
                for r in 0..SINES.0 {
                    let own = odd_multisine(out.period, test.sample_time_s, test.highest_hz, size, &mut rng)?;
                    let first = start + r * out.period * (SINES.1 + 1);
                    let last = first + out.period * (SINES.1 + 1);
                    (first..last).for_each(|t| out.values[t] = own[(t - first) % out.period]);
                    out.realisations.push(first + out.period);
                }
            }
            Kind::Chirp => chirps(&mut out.values[start..start + part], size, test, &mut rng)?,
            Kind::Steps => {
                let hold = part / (4 * REPEATED);
                let level = |t: usize| [0.0, size, 0.0, -size][(t / hold.max(1)) % 4];
                (0..part).for_each(|t| out.values[start + t] = level(t));
            }
        }
        Ok(out)
    };
    (0..n).map(one).collect()
}

/// Levels at random; the shortest hold is half a period of the highest frequency.
fn levels(values: &mut [f64], size: f64, test: &TestSpec, rng: &mut Rng64) {
    let shortest = (0.5 / (test.highest_hz * test.sample_time_s)).max(1.0);
    let (mut left, mut level) = (0, 0.0);
    for v in values {
        if left == 0 {
            left = rng.uniform_in(shortest.ln(), (HOLDS * shortest).ln()).exp().round().max(1.0) as usize;
            level = size * rng.uniform_in(-1.0, 1.0);
        }
        left -= 1;
        *v = level;
    }
}

/// Rises of the frequency one after the other, each from one period to the highest frequency.
fn chirps(values: &mut [f64], size: f64, test: &TestSpec, rng: &mut Rng64) -> Result<(), ControlError> {
    let rise = values.len() / REPEATED;
    let mut keys = toml::Table::new();
    for (key, value) in [
        ("lo", -size),
        ("hi", size),
        ("f_start_hz", 1.0 / (rise as f64 * test.sample_time_s)),
        ("f_end_hz", test.highest_hz),
    ] {
        keys.insert(key.into(), toml::Value::Float(value));
    }
    let own = signal::signal("chirp", &keys).map_err(|e| ControlError::Model(e.to_string()))?;
    for part in values.chunks_exact_mut(rise) {
        own.fill(part, test.sample_time_s, rng).map_err(|e| ControlError::Model(e.to_string()))?;
    }
    Ok(())
}

/// Odd and even distortion of output `k` by its own input.
fn distortion(m: &Moved, record: &Record, k: usize) -> Option<Distortion> {
    let kept = SINES.1 * m.period;
    let part = |x: &'_ [f64], from: usize| x[from..from + kept].to_vec();
    let all: Vec<(Vec<f64>, Vec<f64>)> = m
        .realisations
        .iter()
        .map(|r| (part(&record.inputs[k].1, *r), part(&record.outputs[k].1, *r)))
        .collect();
    let each: Vec<Realisation> = all.iter().map(|(u, y)| Realisation { u, y }).collect();
    let found = bla(&each, m.period, record.sample_time_s).ok()?;
    let level = |l: &Option<Level>| l.as_ref().filter(|l| l.stands_out()).map(|l| l.db_of(&found.excited));
    Some(Distortion { odd_db: level(&found.odd), even_db: level(&found.even) })
}
