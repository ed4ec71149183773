//! Plants, loops and what is asked of them: read as typed, checked as meant.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use dynocal_control::oxygen::{OxygenObserver, OxygenSettings};
use dynocal_control::system::{Time, Transfer};
use dynocal_control::tune::Asked;
use dynocal_files::run_folder::RunPlace;
use dynocal_files::spec::{Faults, LoadError, SpecError};
use dynocal_plant::plants::PlantSpec;
use serde::{Deserialize, Serialize};

use super::loop_spec::{self, TypedLoop};
use super::test_spec::{self, TypedTest};
use crate::place::{Overrides, Place};

pub use super::loop_spec::LoopSpec;
pub use super::test_spec::{Kind, TestSpec};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Typed {
    name: Option<String>,
    out: Option<PathBuf>,
    seed: Option<u64>,
    models: Option<Vec<PathBuf>>,
    records: Option<Vec<PathBuf>>,
    demands: Option<Vec<String>>,
    segment_s: Option<f64>,
    #[serde(default)]
    schedule: Vec<String>,
    #[serde(default)]
    points: Vec<TypedPoint>,
    #[serde(default)]
    plants: Vec<TypedPlant>,
    plant: Option<PlantSpec>,
    test: Option<TypedTest>,
    decoupler: Option<Decoupler>,
    taps: Option<usize>,
    sample_time_s: Option<f64>,
    draws: Option<usize>,
    reaction_samples: Option<usize>,
    #[serde(default)]
    loops: Vec<TypedLoop>,
    catalyst: Option<OxygenSettings>,
    #[serde(default)]
    asked: Asked,
    disk_margin: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TypedPoint {
    name: Option<String>,
    values: Option<BTreeMap<String, f64>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TypedPlant {
    name: Option<String>,
    /// Rows of outputs, columns of inputs.
    channels: Option<Vec<Vec<TypedChannel>>>,
}

#[derive(Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct TypedChannel {
    num: Vec<f64>,
    den: Vec<f64>,
    #[serde(default)]
    delay_s: f64,
}

/// A set point of stored models.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Point {
    /// Name.
    pub name: String,
    /// Values of the channels that the models read.
    pub values: BTreeMap<String, f64>,
}

/// A plant that is given.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Given {
    /// Name.
    pub name: String,
    /// Channels, row-major, outputs by inputs in the order of the loops.
    pub channels: Vec<Transfer>,
}

/// What stands between controllers and plant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Decoupler {
    /// Gains that leave each output its own demand at rest.
    Static,
    /// Filters that do so in time, as far as their length allows.
    Dynamic,
}

/// Where plants come from.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Plants {
    /// Stored models about set points.
    Models {
        /// Model files.
        files: Vec<PathBuf>,
        /// Set points.
        points: Vec<Point>,
    },
    /// Records of tests, each about a set point of its own: linear models are identified from them.
    Records {
        /// Record files.
        files: Vec<PathBuf>,
        /// Channels of the demands of a test in closed loop, in the order of the loops; empty in open loop.
        demands: Vec<String>,
        /// Length in s of the segments of the spectra; none: a twelfth of the record.
        segment_s: Option<f64>,
    },
    /// A plant that answers: the job makes tests about its set points, and identifies as from records.
    Bed {
        /// Plant.
        plant: PlantSpec,
        /// Test.
        test: TestSpec,
        /// Set points.
        points: Vec<Point>,
    },
    /// Transfer functions.
    Given {
        /// Continuous or sampled.
        time: Time,
        /// One for each set point.
        plants: Vec<Given>,
    },
}

/// A control job as understood.
#[derive(Clone, Debug, Serialize)]
pub struct Job {
    /// Name of the run.
    pub name: String,
    /// Seed of the draws.
    pub seed: u64,
    /// Plants.
    pub plants: Plants,
    /// Draws of the parameters of stored models at each set point.
    pub draws: usize,
    /// Samples from a measurement to the actuator that answers it.
    pub reaction_samples: usize,
    /// Channels over which gains are scheduled; none: one set of gains for all set points.
    pub schedule: Vec<String>,
    /// Decoupler of the first set point's nominal plant; none: each controller moves its own input alone.
    pub decoupler: Option<Decoupler>,
    /// Samples of the filters of a dynamic one.
    pub taps: usize,
    /// Loops.
    pub loops: Vec<LoopSpec>,
    /// Observer of the oxygen in a catalyst that is delivered with the loops.
    pub catalyst: Option<OxygenSettings>,
    /// Margins of each loop.
    pub asked: Asked,
    /// Balanced disk margin of all loops at once, at inputs and at outputs.
    pub disk_margin: f64,
    /// Run folder.
    #[serde(skip)]
    pub out: RunPlace,
}

/// Most set points and draws.
const MOST: (usize, usize) = (400, 1000);

/// Reads and checks the spec at `path`. Files in it are relative to its folder.
///
/// # Errors
/// [`LoadError`] with every fault.
pub fn read(path: &Path, overrides: &Overrides) -> Result<Job, LoadError> {
    dynocal_files::spec::load(path, |t: &Typed, faults| check(t, path, overrides, faults))
}

/// The same for a spec that is there as text; `file` is its name in messages.
///
/// # Errors
/// [`SpecError`] with every fault.
pub fn parse(file: &str, text: &str, overrides: &Overrides) -> Result<Job, SpecError> {
    dynocal_files::spec::parse(file, text, |t: &Typed, faults| check(t, Path::new(file), overrides, faults))
}

/// The observer of a catalyst is delivered with sampled loops, in the file that has no decoupler.
fn catalyst(t: &Typed, continuous: bool, faults: &mut Faults) {
    let Some(c) = t.catalyst else { return };
    if let Err(e) = OxygenObserver::new(c, c.target) {
        faults.push("catalyst", e, "settings of a store");
    }
    if !c.half_g_s.is_finite() {
        faults.push(
            "catalyst.half_g_s",
            c.half_g_s,
            "a finite number, g/s (1e9: all of the store at any flow)",
        );
    }
    if c.memory > 0.0 {
        faults.push("catalyst.memory", c.memory, "0: the delivered observer learns its bias alone");
    }
    if continuous || t.decoupler.is_some() {
        faults.push(
            "catalyst",
            "an observer",
            "sampled loops without a decoupler: it is delivered in controller.json",
        );
    }
}

fn check(t: &Typed, spec: &Path, over: &Overrides, faults: &mut Faults) -> Option<Job> {
    let place = Place::of(spec, t.name.as_deref(), t.out.as_deref(), over.out.as_deref(), faults);
    let loops = loop_spec::loops(&t.loops, faults);
    let plants = plants(t, spec, &loops, faults);
    asked(&t.asked, faults);
    let disk_margin = t.disk_margin.unwrap_or(0.0);
    faults.range("disk_margin", disk_margin, 0.0, 2.0, "-");
    let draws = t.draws.unwrap_or(if t.plants.is_empty() { 20 } else { 0 });
    if draws > MOST.1 {
        faults.push("draws", draws, format!("at most {}", MOST.1));
    }
    if !t.plants.is_empty() && draws > 0 {
        faults.push("draws", draws, "0: only models and records know how uncertain their parameters are");
    }
    let continuous = matches!(&plants, Some(Plants::Given { time: Time::Continuous, .. }));
    let reaction_samples = t.reaction_samples.unwrap_or(usize::from(!continuous));
    if continuous && reaction_samples > 0 {
        faults.push(
            "reaction_samples",
            reaction_samples,
            "0: continuous plants have no samples (use `extra_delay_s` of the loops)",
        );
    }
    if reaction_samples > 1000 {
        faults.push("reaction_samples", reaction_samples, "at most 1000");
    }
    schedule(t, continuous, faults);
    let taps = decoupler(t, continuous, faults);
    for (k, l) in loops.iter().enumerate().filter(|(_, l)| l.predictor && continuous) {
        let found = format!("a predictor of `{}`", l.output);
        faults.push(
            &format!("loops[{}].predictor", k + 1),
            found,
            "sampled plants: a predictor runs in samples",
        );
    }
    catalyst(t, continuous, faults);
    let seed = over.seed.or(t.seed).unwrap_or(0);
    let (asked, plants) = (t.asked, plants?);
    Some(Job {
        name: place.name,
        seed,
        plants,
        catalyst: t.catalyst,
        draws,
        reaction_samples,
        schedule: t.schedule.clone(),
        decoupler: t.decoupler,
        taps,
        loops,
        asked,
        disk_margin,
        out: place.out,
    })
}

fn plants(t: &Typed, spec: &Path, loops: &[LoopSpec], faults: &mut Faults) -> Option<Plants> {
    let sources = [t.models.is_some(), t.records.is_some(), !t.plants.is_empty(), t.plant.is_some()];
    if sources.iter().filter(|s| **s).count() > 1 {
        faults.push(
            "plants",
            "several of `models`, `records`, `plants` and `[plant]`",
            "one of them: stored models at set points, records of tests, transfer functions, or a plant to be tested",
        );
        return None;
    }
    if t.records.is_none() && (t.demands.is_some() || t.segment_s.is_some()) {
        faults.push("records", "`demands` or `segment_s` without them", "records of tests beside");
    }
    if t.plant.is_none() && (t.test.is_some() || loops.iter().any(|l| l.step.is_some())) {
        faults.push("plant", "`[test]` or a `step` of a loop without it", "a table [plant] that is tested");
    }
    match (&t.models, &t.records, &t.plant) {
        (Some(files), ..) => models(files, t, spec, faults),
        (None, Some(files), _) => records(files, t, spec, loops, faults),
        (None, None, Some(plant)) => Some(tested(plant, t, loops, faults)),
        (None, None, None) => given(t, loops.len(), faults),
    }
}

/// Tests about set points; without any at the plant's start.
fn tested(plant: &PlantSpec, t: &Typed, loops: &[LoopSpec], faults: &mut Faults) -> Plants {
    if t.sample_time_s.is_some() {
        faults.push("sample_time_s", "a sample time beside `[plant]`", "`sample_time_s` of [test]");
    }
    for (k, l) in loops.iter().enumerate().filter(|(_, l)| l.step.is_none()) {
        let found = format!("nothing for `{}`", l.input);
        faults.push(
            &format!("loops[{}].step", k + 1),
            found,
            "how far the input is moved either way in the test",
        );
    }
    let test = test_spec::check(t.test.as_ref(), plant, faults);
    loop_spec::within_test(loops, test.length_s, test.sample_time_s, faults);
    let mut points = points(t, faults);
    if points.is_empty() {
        points.push(Point { name: "start".into(), values: BTreeMap::new() });
    }
    Plants::Bed { plant: plant.clone(), test, points }
}

/// Whether loops can be decoupled; the samples of the filters.
fn decoupler(t: &Typed, continuous: bool, faults: &mut Faults) -> usize {
    let taps = t.taps.unwrap_or(40);
    if t.taps.is_some() && t.decoupler != Some(Decoupler::Dynamic) {
        faults.push("taps", taps, "with `decoupler = \"dynamic\"` only");
    }
    if !(1..=200).contains(&taps) {
        faults.push("taps", taps, "1 to 200 samples");
    }
    let Some(kind) = t.decoupler else { return taps };
    if t.loops.len() < 2 || t.loops.iter().any(loop_spec::predicts) {
        faults.push(
            "decoupler",
            "one loop, or a loop with a predictor",
            "two loops at least, none of which predicts",
        );
    }
    if continuous && kind == Decoupler::Dynamic {
        faults.push(
            "decoupler",
            "dynamic, for continuous plants",
            "`static`, or sampled plants: filters run in samples",
        );
    }
    taps
}

fn records(
    files: &[PathBuf],
    t: &Typed,
    spec: &Path,
    loops: &[LoopSpec],
    faults: &mut Faults,
) -> Option<Plants> {
    if files.is_empty() || files.len() > MOST.0 {
        let expected = format!("1 to {} files, each a test about a set point of its own", MOST.0);
        faults.push("records", format!("{} files", files.len()), expected);
    }
    if t.sample_time_s.is_some() || !t.points.is_empty() {
        faults.push(
            "records",
            "`sample_time_s` or set points beside them",
            "neither: each record has its own",
        );
    }
    let demands = t.demands.clone().unwrap_or_default();
    if t.demands.is_some() && demands.len() != loops.len() {
        faults.push(
            "demands",
            format!("{demands:?}"),
            format!("{} channels, one for each loop", loops.len()),
        );
    }
    if let Some(s) = t.segment_s {
        faults.positive("segment_s", s, "s");
    }
    let folder = spec.parent().unwrap_or(Path::new(""));
    let files = files.iter().map(|f| folder.join(f)).collect();
    Some(Plants::Records { files, demands, segment_s: t.segment_s })
}

fn schedule(t: &Typed, continuous: bool, faults: &mut Faults) {
    if t.schedule.is_empty() {
        return;
    }
    if t.schedule.len() > 2 || t.models.is_none() || continuous {
        faults.push(
            "schedule",
            format!("{:?}", t.schedule),
            "one or two channels of the set points of stored models (`models` with [[points]])",
        );
    }
    for (k, p) in t.points.iter().enumerate() {
        for c in t.schedule.iter().filter(|c| p.values.as_ref().is_some_and(|v| !v.contains_key(*c))) {
            faults.push(
                "schedule",
                format!("`{c}`, which points[{}] does not have", k + 1),
                "channels of all points",
            );
        }
    }
    if t.loops.iter().any(|l| loop_spec::gains_given(l) || loop_spec::predicts(l)) {
        faults.push(
            "schedule",
            "a loop with given gains or a predictor",
            "loops whose gains are searched, without one",
        );
    }
}

fn asked(a: &Asked, faults: &mut Faults) {
    faults.range("asked.gain_margin", a.gain_margin, 1.0, 100.0, "-");
    faults.range("asked.phase_margin_deg", a.phase_margin_deg, 0.0, 90.0, "deg");
    faults.range("asked.sensitivity", a.sensitivity, 1.01, 100.0, "-");
    faults.range("asked.delay_margin_s", a.delay_margin_s, 0.0, 1e6, "s");
    if let Some(s) = a.settling_s {
        faults.positive("asked.settling_s", s, "s");
    }
}

fn models(files: &[PathBuf], t: &Typed, spec: &Path, faults: &mut Faults) -> Option<Plants> {
    let folder = spec.parent().unwrap_or(Path::new(""));
    if files.is_empty() {
        faults.push(
            "models",
            "an empty list",
            "model files (model.json of `dynocal identify`), one for each output of a loop",
        );
    }
    if t.sample_time_s.is_some() {
        faults.push("sample_time_s", "a sample time beside `models`", "none: the models have their own");
    }
    let points = points(t, faults);
    if t.points.is_empty() || t.points.len() > MOST.0 {
        faults.push(
            "points",
            format!("{} set points", t.points.len()),
            format!("1 to {} tables [[points]] with `values`", MOST.0),
        );
    }
    Some(Plants::Models { files: files.iter().map(|f| folder.join(f)).collect(), points })
}

fn points(t: &Typed, faults: &mut Faults) -> Vec<Point> {
    let mut points = Vec::new();
    for (k, p) in t.points.iter().enumerate() {
        let expected = "a table of the channels that the models read, in their units";
        let Some(values) = faults.required(&format!("points[{}].values", k + 1), &p.values, expected) else {
            continue;
        };
        for (name, v) in values.iter().filter(|(_, v)| !v.is_finite()) {
            faults.push(&format!("points[{}].values.{name}", k + 1), v, "a finite number");
        }
        points.push(Point { name: p.name.clone().unwrap_or_else(|| format!("point {}", k + 1)), values });
    }
    points
}

fn given(t: &Typed, loops: usize, faults: &mut Faults) -> Option<Plants> {
    if t.plants.is_empty() || t.plants.len() > MOST.0 {
        let expected =
            format!("`models` with [[points]], or 1 to {} tables [[plants]] with `channels`", MOST.0);
        faults.push("plants", format!("{} plants", t.plants.len()), expected);
        return None;
    }
    if !t.points.is_empty() {
        faults.push("points", "set points beside `plants`", "none: each plant is one");
    }
    let time = match t.sample_time_s {
        None => Time::Continuous,
        Some(sample_time_s) => {
            faults.positive("sample_time_s", sample_time_s, "s");
            Time::Sampled { sample_time_s }
        }
    };
    let mut plants = Vec::new();
    for (k, p) in t.plants.iter().enumerate() {
        let key = format!("plants[{}].channels", k + 1);
        let Some(rows) = faults.required(&key, &p.channels, "rows of outputs with columns of inputs") else {
            continue;
        };
        if rows.len() != loops || rows.iter().any(|r| r.len() != loops) {
            let found = format!("rows of {:?}", rows.iter().map(Vec::len).collect::<Vec<_>>());
            faults.push(
                &key,
                found,
                format!("{loops} rows of {loops}: outputs and inputs in the order of the loops"),
            );
            continue;
        }
        let own = |c: &TypedChannel| match time {
            Time::Continuous => Transfer::continuous(&c.num, &c.den, c.delay_s),
            Time::Sampled { .. } => Transfer { delay_s: c.delay_s, ..Transfer::sampled(&c.num, &c.den) },
        };
        let channels: Vec<Transfer> = rows.iter().flatten().map(own).collect();
        if let Err(e) = dynocal_control::system::System::new(time, loops, loops, channels.clone()) {
            faults.push(&key, e, "transfer functions `{ num, den, delay_s }`");
        }
        plants.push(Given { name: p.name.clone().unwrap_or_else(|| format!("plant {}", k + 1)), channels });
    }
    Some(Plants::Given { time, plants })
}
