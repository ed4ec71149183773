//! Which records, or which plant, and what is delivered: read as typed, checked as meant.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use dynocal_files::run_folder::RunPlace;
use dynocal_files::spec::{Faults, LoadError, SpecError};
use dynocal_numerics::interval::Interval;
use dynocal_plant::plants::{self, PlantSpec};
use serde::{Deserialize, Serialize};

use crate::place::{Overrides, Place};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Typed {
    name: Option<String>,
    out: Option<PathBuf>,
    seed: Option<u64>,
    identification: Option<Vec<PathBuf>>,
    unseen: Option<Vec<PathBuf>>,
    plant: Option<PlantSpec>,
    test: Option<TypedTest>,
    channels: Option<Channels>,
    upstream_kpa: Option<f64>,
    most_injection: Option<f64>,
    tables: Option<Tables>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TypedTest {
    throttle_deg: Interval,
    speed_rpm: Interval,
    record_s: Option<f64>,
    unseen_s: Option<f64>,
    sample_time_s: Option<f64>,
    hold_s: Option<Interval>,
    held: Option<BTreeMap<String, f64>>,
    varied: Option<BTreeMap<String, Interval>>,
}

/// Names of the channels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Channels {
    /// Speed.
    pub speed: String,
    /// Throttle as it is commanded.
    pub throttle: String,
    /// Fuel per cycle and cylinder as it is commanded.
    pub injection: String,
    /// Manifold pressure.
    pub map: String,
    /// Lambda as the sensor shows it.
    pub lambda: String,
    /// Pressure before the throttle; none where it stands still.
    pub boost: Option<String>,
    /// Coolant temperature; none where it does not count.
    pub coolant: Option<String>,
    /// Place of the intake cam, as it is measured or commanded; none where cams do not count.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub intake_cam: Option<String>,
    /// The same of the exhaust cam: both or none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub exhaust_cam: Option<String>,
}

impl Channels {
    /// Both cams; none where none is named.
    pub fn cams(&self) -> Option<[&str; 2]> {
        self.intake_cam.as_deref().zip(self.exhaust_cam.as_deref()).map(|(i, e)| [i, e])
    }

    /// One cam without the other is a fault; `at` is the key of the table.
    pub fn check(&self, at: &str, faults: &mut Faults) {
        for (key, missing, there) in [
            ("intake_cam", &self.intake_cam, &self.exhaust_cam),
            ("exhaust_cam", &self.exhaust_cam, &self.intake_cam),
        ] {
            if missing.is_none() && there.is_some() {
                faults.push(
                    &format!("{at}.{key}"),
                    "nothing",
                    "the channel of this cam as well, or none of both",
                );
            }
        }
    }
}

impl Default for Channels {
    fn default() -> Self {
        let name = |text: &str| text.to_string();
        Self {
            speed: name("speed"),
            throttle: name("throttle"),
            injection: name("inj"),
            map: name("map"),
            lambda: name("lambda"),
            boost: None,
            coolant: None,
            intake_cam: None,
            exhaust_cam: None,
        }
    }
}

/// Breakpoints of the tables; empty: ten equal steps over what the records saw.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Tables {
    /// Speed in rpm.
    pub speed_rpm: Vec<f64>,
    /// Manifold pressure in kPa.
    pub map_kpa: Vec<f64>,
    /// Coolant temperature in degC.
    pub coolant_c: Vec<f64>,
}

/// What is driven on a plant.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Test {
    /// Range of the throttle in deg; levels are drawn evenly in its logarithm, as the air goes.
    pub throttle_deg: Interval,
    /// Range of the speed in rpm.
    pub speed_rpm: Interval,
    /// Length of each of the two records of the identification in s.
    pub record_s: f64,
    /// Length of the course that judges in s.
    pub unseen_s: f64,
    /// Interval of control in s.
    pub sample_time_s: f64,
    /// Shortest and longest hold in s; one whose ramp of the speed needs more ends 2.1 s after it.
    pub hold_s: Interval,
    /// Other inputs of the plant, by name; as they start where nothing is said.
    pub held: BTreeMap<String, f64>,
    /// Inputs that get a value of a range with each hold, by name.
    pub varied: BTreeMap<String, Interval>,
}

/// Where records come from.
#[derive(Clone, Debug, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Source {
    /// Files: those that identify, and those that only judge.
    Files {
        /// Identification.
        identification: Vec<PathBuf>,
        /// Judging.
        unseen: Vec<PathBuf>,
    },
    /// A plant that answers.
    Plant {
        /// Which.
        plant: PlantSpec,
        /// What is driven on it.
        test: Box<Test>,
    },
}

/// The job as understood.
#[derive(Clone, Debug, Serialize)]
pub struct Job {
    /// Name of the run.
    pub name: String,
    /// Seed of everything random.
    pub seed: u64,
    /// Records.
    pub source: Source,
    /// Names of channels.
    pub channels: Channels,
    /// Pressure before the throttle in kPa, where no channel says it.
    pub upstream_kpa: f64,
    /// Most of an injection, in its unit.
    pub most_injection: f64,
    /// Breakpoints.
    pub tables: Tables,
    /// Run folder.
    #[serde(skip)]
    pub out: RunPlace,
}

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
    let folder = spec.parent().unwrap_or(Path::new(""));
    let place = Place::of(spec, t.name.as_deref(), t.out.as_deref(), over.out.as_deref(), faults);
    let source = source(t, folder, faults);
    t.channels.iter().for_each(|c| c.check("channels", faults));
    let upstream_kpa = t.upstream_kpa.unwrap_or(101.325);
    faults.range("upstream_kpa", upstream_kpa, 50.0, 400.0, "kPa");
    let most_injection = t.most_injection.unwrap_or(60.0);
    faults.positive("most_injection", most_injection, "the unit of the injection");
    let tables = t.tables.clone().unwrap_or_default();
    let axes =
        [("speed_rpm", &tables.speed_rpm), ("map_kpa", &tables.map_kpa), ("coolant_c", &tables.coolant_c)];
    for (key, axis) in axes {
        if axis.len() == 1 || axis.windows(2).any(|w| w[0] >= w[1]) || axis.iter().any(|v| !v.is_finite()) {
            let expected = "two or more numbers that increase, or none";
            faults.push(&format!("tables.{key}"), format!("{axis:?}"), expected);
        }
    }
    Some(Job {
        name: place.name,
        out: place.out,
        seed: over.seed.or(t.seed).unwrap_or(1),
        source: source?,
        channels: t.channels.clone().unwrap_or_default(),
        upstream_kpa,
        most_injection,
        tables,
    })
}

fn source(t: &Typed, folder: &Path, faults: &mut Faults) -> Option<Source> {
    let files = |given: &Option<Vec<PathBuf>>| -> Vec<PathBuf> {
        given.iter().flatten().map(|f| folder.join(f)).collect()
    };
    let (identification, unseen) = (files(&t.identification), files(&t.unseen));
    match (&t.plant, &t.test) {
        (None, None) => {
            if identification.is_empty() {
                faults.push(
                    "identification",
                    "nothing",
                    "a list of records that identify, or `[plant]` and `[test]`",
                );
            }
            if unseen.is_empty() {
                faults.push("unseen", "nothing", "a list of records that only judge what was identified");
            }
            Some(Source::Files { identification, unseen })
        }
        (plant, Some(test)) => {
            if !identification.is_empty() || !unseen.is_empty() {
                faults.push(
                    "identification",
                    "files beside `[test]`",
                    "either files or a plant that is driven",
                );
            }
            let plant = plant.clone().unwrap_or_default();
            let test = Box::new(checked(test, &plant, faults));
            Some(Source::Plant { plant, test })
        }
        (Some(_), None) => {
            faults.push(
                "test",
                "nothing",
                "`[test]` with throttle_deg and speed_rpm: where the plant may be driven",
            );
            None
        }
    }
}

fn checked(t: &TypedTest, plant: &PlantSpec, faults: &mut Faults) -> Test {
    for f in plants::check(plant) {
        faults.push(&f.key, &f.found, if f.expected.is_empty() { f.known.join(", ") } else { f.expected });
    }
    let member = plants::find(&plant.name);
    if member.is_some_and(|m| m.make.is_none()) {
        faults.push(
            "plant.name",
            &plant.name,
            "a plant that answers; of a real bed give `identification` and `unseen`",
        );
    }
    let out = Test {
        throttle_deg: t.throttle_deg,
        speed_rpm: t.speed_rpm,
        record_s: t.record_s.unwrap_or(180.0),
        unseen_s: t.unseen_s.unwrap_or(90.0),
        sample_time_s: t.sample_time_s.or(member.and_then(|m| m.sample_time_s)).unwrap_or(0.01),
        hold_s: t.hold_s.unwrap_or(Interval { lower: 3.0, upper: 6.0 }),
        held: t.held.clone().unwrap_or_default(),
        varied: t.varied.clone().unwrap_or_default(),
    };
    for (name, r) in &out.varied {
        let key = format!("test.varied.{name}");
        if !(r.lower.is_finite() && r.upper.is_finite() && r.lower < r.upper) {
            faults.push(&key, format!("{} to {}", r.lower, r.upper), "two numbers that increase");
        }
        if out.held.contains_key(name) {
            faults.push(&key, "an input that is held as well", "an input in one of `held` and `varied`");
        }
    }
    let ranges = [
        ("test.throttle_deg", out.throttle_deg, 0.1, 90.0, "deg"),
        ("test.speed_rpm", out.speed_rpm, 300.0, 20_000.0, "rpm"),
        ("test.hold_s", out.hold_s, 2.5, 60.0, "s"),
    ];
    for (key, r, least, most, unit) in ranges {
        if !(least <= r.lower && r.lower < r.upper && r.upper <= most) {
            let found = format!("{} to {}", r.lower, r.upper);
            faults.push(key, found, format!("two numbers that increase, within {least} and {most} {unit}"));
        }
    }
    faults.range("test.sample_time_s", out.sample_time_s, 1e-3, 0.05, "s");
    faults.range("test.record_s", out.record_s, 60.0, 7200.0, "s");
    faults.range("test.unseen_s", out.unseen_s, 30.0, 7200.0, "s");
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    const SPEC: &str = "[plant]\nparameters = \"gtdi_2l\"\n[plant.bed]\ninputs = [\"intake_cam\", \"exhaust_cam\"]\n[test]\nthrottle_deg = [5.0, 20.0]\nspeed_rpm = [1500.0, 3000.0]\n";

    fn faults(more: &str) -> String {
        parse("f.toml", &format!("{SPEC}{more}"), &Overrides::default()).unwrap_err().to_string()
    }

    #[test]
    fn cams_and_varied_inputs_are_read_and_faults_named() {
        let more = "varied = { intake_cam = [215.0, 255.0] }\n[channels]\nintake_cam = \"intake_cam\"\nexhaust_cam = \"exhaust_cam\"\n";
        let job = parse("f.toml", &format!("{SPEC}{more}"), &Overrides::default()).unwrap();
        assert_eq!(job.channels.cams(), Some(["intake_cam", "exhaust_cam"]));
        let Source::Plant { test, .. } = &job.source else { panic!("{:?}", job.source) };
        assert_eq!(test.varied["intake_cam"], Interval { lower: 215.0, upper: 255.0 });
        let text = faults("[channels]\nintake_cam = \"intake_cam\"\n");
        assert!(text.contains("channels.exhaust_cam") && text.contains("none of both"), "{text}");
        let text = faults("varied = { intake_cam = [255.0, 215.0] }\n");
        assert!(text.contains("test.varied.intake_cam"), "{text}");
        let text = faults("varied = { intake_cam = [215.0, 255.0] }\nheld = { intake_cam = 230.0 }\n");
        assert!(text.contains("held as well"), "{text}");
    }
}
