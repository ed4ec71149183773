//! Plants, loops and what is asked of them: read as typed, checked as meant.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use dynocal_control::runtime::ActuatorLimits;
use dynocal_control::system::{Time, Transfer};
use dynocal_control::tune::Asked;
use dynocal_files::run_folder::RunPlace;
use dynocal_files::spec::{Faults, LoadError, SpecError};
use serde::{Deserialize, Serialize};

use crate::place::{Overrides, Place};

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
    sample_time_s: Option<f64>,
    draws: Option<usize>,
    reaction_samples: Option<usize>,
    #[serde(default)]
    loops: Vec<TypedLoop>,
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

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TypedLoop {
    output: Option<String>,
    input: Option<String>,
    #[serde(default)]
    extra_delay_s: f64,
    #[serde(default)]
    predictor: bool,
    #[serde(default)]
    filter_s: f64,
    lower: Option<f64>,
    upper: Option<f64>,
    rate_per_s: Option<f64>,
    #[serde(default)]
    start: f64,
    kp: Option<f64>,
    ki: Option<f64>,
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
    /// Transfer functions.
    Given {
        /// Continuous or sampled.
        time: Time,
        /// One for each set point.
        plants: Vec<Given>,
    },
}

/// One loop.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LoopSpec {
    /// What it holds.
    pub output: String,
    /// By what.
    pub input: String,
    /// Delay in s beyond that of the plant (sampled: whole samples).
    pub extra_delay_s: f64,
    /// Whether a Smith predictor stands about that delay.
    pub predictor: bool,
    /// Time constant in s of the filter of its prediction error.
    pub filter_s: f64,
    /// Limits of the actuator in the file of the controller.
    pub limits: ActuatorLimits,
    /// Actuator before the first step.
    pub start: f64,
    /// Gains to be judged as they are, `(kp, ki)`; none: the search finds them.
    pub gains: Option<(f64, f64)>,
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
    /// Loops.
    pub loops: Vec<LoopSpec>,
    /// Margins of each loop.
    pub asked: Asked,
    /// Balanced disk margin of all loops at once, at inputs and at outputs.
    pub disk_margin: f64,
    /// Run folder.
    #[serde(skip)]
    pub out: RunPlace,
}

/// Most loops, set points and draws.
const MOST: (usize, usize, usize) = (4, 400, 1000);

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

fn check(t: &Typed, spec: &Path, over: &Overrides, faults: &mut Faults) -> Option<Job> {
    let place = Place::of(spec, t.name.as_deref(), t.out.as_deref(), over.out.as_deref(), faults);
    let loops = loops(t, faults);
    let plants = plants(t, spec, &loops, faults);
    asked(&t.asked, faults);
    let disk_margin = t.disk_margin.unwrap_or(0.0);
    faults.range("disk_margin", disk_margin, 0.0, 2.0, "-");
    let draws = t.draws.unwrap_or(if t.plants.is_empty() { 20 } else { 0 });
    if draws > MOST.2 {
        faults.push("draws", draws, format!("at most {}", MOST.2));
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
    for (k, l) in loops.iter().enumerate().filter(|(_, l)| l.predictor && continuous) {
        let found = format!("a predictor of `{}`", l.output);
        faults.push(
            &format!("loops[{}].predictor", k + 1),
            found,
            "sampled plants: a predictor runs in samples",
        );
    }
    let seed = over.seed.or(t.seed).unwrap_or(0);
    let (asked, plants) = (t.asked, plants?);
    Some(Job {
        name: place.name,
        seed,
        plants,
        draws,
        reaction_samples,
        schedule: t.schedule.clone(),
        loops,
        asked,
        disk_margin,
        out: place.out,
    })
}

fn plants(t: &Typed, spec: &Path, loops: &[LoopSpec], faults: &mut Faults) -> Option<Plants> {
    let sources = [t.models.is_some(), t.records.is_some(), !t.plants.is_empty()];
    if sources.iter().filter(|s| **s).count() > 1 {
        faults.push(
            "plants",
            "several of `models`, `records` and `plants`",
            "one of them: stored models at set points, records of tests, or transfer functions",
        );
        return None;
    }
    if t.records.is_none() && (t.demands.is_some() || t.segment_s.is_some()) {
        faults.push("records", "`demands` or `segment_s` without them", "records of tests beside");
    }
    match (&t.models, &t.records) {
        (Some(files), _) => models(files, t, spec, faults),
        (None, Some(files)) => records(files, t, spec, loops, faults),
        (None, None) => given(t, loops.len(), faults),
    }
}

fn records(
    files: &[PathBuf],
    t: &Typed,
    spec: &Path,
    loops: &[LoopSpec],
    faults: &mut Faults,
) -> Option<Plants> {
    if files.is_empty() || files.len() > MOST.1 {
        let expected = format!("1 to {} files, each a test about a set point of its own", MOST.1);
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
    if t.loops.iter().any(|l| l.kp.is_some() || l.ki.is_some() || l.predictor) {
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

fn loops(t: &Typed, faults: &mut Faults) -> Vec<LoopSpec> {
    if t.loops.is_empty() || t.loops.len() > MOST.0 {
        let expected = format!("1 to {} tables [[loops]] with `output` and `input`", MOST.0);
        faults.push("loops", format!("{} loops", t.loops.len()), expected);
    }
    let mut out: Vec<LoopSpec> = Vec::new();
    for (k, l) in t.loops.iter().enumerate() {
        let key = |part: &str| format!("loops[{}].{part}", k + 1);
        let output = faults.required(&key("output"), &l.output, "the channel that the loop holds");
        let input = faults.required(&key("input"), &l.input, "the channel by which it holds it");
        if !(l.extra_delay_s >= 0.0 && l.extra_delay_s.is_finite()) {
            faults.push(&key("extra_delay_s"), l.extra_delay_s, "0 or a positive number, s");
        }
        let gains = match (l.kp, l.ki) {
            (None, None) => None,
            (kp, Some(ki)) if ki.is_finite() && ki != 0.0 && kp.unwrap_or(0.0).is_finite() => {
                Some((kp.unwrap_or(0.0), ki))
            }
            (_, found) => {
                let found = found.map_or("nothing".into(), |v| v.to_string());
                faults.push(
                    &key("ki"),
                    found,
                    "a number other than 0 beside `kp` (or neither: the search finds them)",
                );
                None
            }
        };
        let (Some(output), Some(input)) = (output, input) else { continue };
        if out.iter().any(|o| o.output == output || o.input == input) {
            faults.push(
                &key("output"),
                format!("`{output}` by `{input}`"),
                "outputs and inputs that no other loop has",
            );
        }
        let limits = limits(l, k, faults);
        let (extra_delay_s, predictor, filter_s, start) = (l.extra_delay_s, l.predictor, l.filter_s, l.start);
        out.push(LoopSpec { output, input, extra_delay_s, predictor, filter_s, limits, start, gains });
    }
    out
}

/// Limits of an actuator; a predictor needs something to predict.
fn limits(l: &TypedLoop, k: usize, faults: &mut Faults) -> ActuatorLimits {
    let key = |part: &str| format!("loops[{}].{part}", k + 1);
    // What is not limited may take any value that a 32-bit ECU can hold.
    let wide = 1e9;
    let (lower, upper) = (l.lower.unwrap_or(-wide), l.upper.unwrap_or(wide));
    if !(lower < upper && lower.is_finite() && upper.is_finite()) {
        faults.push(&key("upper"), format!("{lower} to {upper}"), "a range: `lower` below `upper`");
    } else if !(l.start >= lower && l.start <= upper) {
        faults.push(&key("start"), l.start, format!("a value between {lower} and {upper}"));
    }
    if let Some(rate) = l.rate_per_s {
        faults.positive(&key("rate_per_s"), rate, "per s");
    }
    if l.predictor && !(l.extra_delay_s > 0.0) {
        faults.push(&key("predictor"), "a predictor without `extra_delay_s`", "a delay that it predicts");
    }
    if !(l.filter_s >= 0.0 && l.filter_s.is_finite()) || (l.filter_s > 0.0 && !l.predictor) {
        faults.push(&key("filter_s"), l.filter_s, "0, or with `predictor` a positive number, s");
    }
    ActuatorLimits { lower, upper, rate_per_s: l.rate_per_s }
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
    if t.points.is_empty() || t.points.len() > MOST.1 {
        faults.push(
            "points",
            format!("{} set points", t.points.len()),
            format!("1 to {} tables [[points]] with `values`", MOST.1),
        );
    }
    Some(Plants::Models { files: files.iter().map(|f| folder.join(f)).collect(), points })
}

fn given(t: &Typed, loops: usize, faults: &mut Faults) -> Option<Plants> {
    if t.plants.is_empty() || t.plants.len() > MOST.1 {
        let expected =
            format!("`models` with [[points]], or 1 to {} tables [[plants]] with `channels`", MOST.1);
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
