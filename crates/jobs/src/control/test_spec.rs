//! Tests that the job makes itself, on a plant that answers: read as typed, checked as meant.

use dynocal_control::response::HIGHEST;
use dynocal_files::spec::Faults;
use dynocal_plant::plants::{self, PlantSpec};
use serde::{Deserialize, Serialize};

/// Longest test in samples, settling and all set points not counted.
const LONGEST: f64 = 2e6;
/// Least samples of a test.
const SHORTEST: f64 = 400.0;

/// The table `[test]`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TypedTest {
    kind: Option<Kind>,
    length_s: Option<f64>,
    settle_s: Option<f64>,
    sample_time_s: Option<f64>,
    highest_hz: Option<f64>,
}

/// How inputs are moved about a set point.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// All inputs at once, levels drawn at random for holds drawn at random.
    Levels,
    /// One input after the other: periods of odd multisines, several realisations; shows what is not linear.
    Multisine,
    /// One input after the other: sines whose frequency rises.
    Chirp,
    /// One input after the other: up, down and back.
    Steps,
}

/// A test about every set point.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TestSpec {
    /// How.
    pub kind: Kind,
    /// Length in s.
    pub length_s: f64,
    /// Time at the set point before it in s.
    pub settle_s: f64,
    /// Sample time in s.
    pub sample_time_s: f64,
    /// Highest frequency in Hz that is excited on purpose.
    pub highest_hz: f64,
}

/// Test and plant as meant; none where a fault is pushed.
pub(super) fn check(t: Option<&TypedTest>, plant: &PlantSpec, faults: &mut Faults) -> TestSpec {
    for f in plants::check(plant) {
        faults.push(&f.key, &f.found, if f.expected.is_empty() { f.known.join(", ") } else { f.expected });
    }
    let member = plants::find(&plant.name);
    if member.is_some_and(|m| m.make.is_none()) {
        faults.push("plant.name", &plant.name, "a plant that answers; of a real bed give `records`");
    }
    let own = |of: &dyn Fn(&TypedTest) -> Option<f64>| t.and_then(of);
    let sample_time_s = own(&|t| t.sample_time_s).or(member.and_then(|m| m.sample_time_s)).unwrap_or(0.02);
    let out = TestSpec {
        kind: t.and_then(|t| t.kind).unwrap_or(Kind::Levels),
        length_s: own(&|t| t.length_s).unwrap_or(240.0),
        settle_s: own(&|t| t.settle_s).unwrap_or(20.0),
        sample_time_s,
        highest_hz: own(&|t| t.highest_hz).unwrap_or(0.1 / sample_time_s),
    };
    faults.positive("test.sample_time_s", sample_time_s, "s");
    if let Some(only_s) = member.and_then(|m| m.sample_time_s).filter(|s| *s != sample_time_s) {
        faults.push("test.sample_time_s", sample_time_s, format!("{only_s} s, the only one of this plant"));
    }
    faults.range("test.settle_s", out.settle_s, 0.0, 1e4, "s");
    let samples = out.length_s / sample_time_s;
    if !(SHORTEST..=LONGEST).contains(&samples) {
        let found = format!("{} s, {samples} samples", out.length_s);
        faults.push("test.length_s", found, format!("{SHORTEST} to {LONGEST} samples"));
    }
    let most_hz = HIGHEST / sample_time_s;
    if !(out.highest_hz > 0.0 && out.highest_hz <= most_hz) {
        faults.push(
            "test.highest_hz",
            out.highest_hz,
            format!("above 0, at most {most_hz} Hz: {HIGHEST} of the sampling frequency"),
        );
    }
    out
}
