//! The plants that a spec can name in `[plant]`: one row each, for the parser of specs and for `dynocal list plants`.

mod fmu;
pub mod literature;

use crate::bed::{BedSettings, EngineBed};
use crate::error::PlantError as EngineError;
use crate::params::{EngineParams, LIKE_A_SET, PARAMETER_SETS};
use crate::testbed::settings::BedOptions;
use dynocal_ident::plant::{Plant, PlantError};
use dynocal_numerics::registry::{MemberDoc, ParamDoc};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// The table `[plant]` of a spec: which plant answers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PlantSpec {
    /// Name in the plant table, or `bed` for a real bed: plans are written, measured files are read.
    pub name: String,
    /// Parameter set.
    pub parameters: String,
    /// Standard deviation of white noise on torque in Nm.
    pub torque_noise_nm: f64,
    /// Standard deviation of white noise on lambda.
    pub lambda_noise: f64,
    /// What the plant's bed is like; keys belong to the plant.
    #[serde(skip_serializing_if = "toml::Table::is_empty")]
    pub bed: toml::Table,
    /// The file of plant `fmu`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub file: Option<PathBuf>,
    /// Parameters and ranges of plant `fmu`.
    #[serde(skip_serializing_if = "toml::Table::is_empty")]
    pub fmu: toml::Table,
}

impl Default for PlantSpec {
    fn default() -> Self {
        Self {
            name: "virtual_engine".into(),
            parameters: "thesis".into(),
            torque_noise_nm: 0.0,
            lambda_noise: 0.0,
            bed: toml::Table::new(),
            file: None,
            fmu: toml::Table::new(),
        }
    }
}

impl PlantSpec {
    /// White noise of the sensors: output and standard deviation in its unit, in words, `torque 0.5 Nm, lambda 0.01`; empty
    /// where there is none.
    pub fn noise_words(&self) -> String {
        let options = BedOptions::from_table(&self.parameters, &self.bed).unwrap_or_default();
        options.noise_words(self.torque_noise_nm, self.lambda_noise)
    }
}

/// A key of `[plant]` that is not what it must be.
#[derive(Clone, Debug, PartialEq)]
pub struct PlantFault {
    /// Key, e.g. `plant.bed.tick_s`.
    pub key: String,
    /// Value found.
    pub found: String,
    /// What was expected; empty where `known` says it.
    pub expected: String,
    /// Names that there are, where a name is unknown.
    pub known: Vec<String>,
}

impl PlantFault {
    pub(crate) fn new(key: impl Into<String>, found: impl ToString, expected: impl ToString) -> Self {
        Self { key: key.into(), found: found.to_string(), expected: expected.to_string(), known: Vec::new() }
    }

    fn unknown(key: &str, found: &str, known: Vec<String>) -> Self {
        Self { key: key.into(), found: found.into(), expected: String::new(), known }
    }
}

/// Makes a plant, with the sensor noise of the spec or free of noise.
pub type Make = fn(&PlantSpec, noise: bool) -> Result<Box<dyn Plant>, PlantError>;

/// One row of the table.
pub struct PlantMember {
    /// Name and keys of `[plant]`.
    pub doc: MemberDoc,
    /// Faults of its keys.
    pub check: fn(&PlantSpec) -> Vec<PlantFault>,
    /// Makes it; none when records are measured outside and read from files.
    pub make: Option<Make>,
    /// The one sample time at which it answers \[s\]; none where any will do.
    pub sample_time_s: Option<f64>,
}

/// All plants.
pub static PLANTS: &[PlantMember] = &[
    PlantMember {
        doc: MemberDoc {
            name: "virtual_engine",
            what: "Embedded gasoline engine: crank-angle resolved, speed imposed by an ideal dynamometer",
            params: &[
                ParamDoc {
                    name: "parameters",
                    unit: "-",
                    default: "thesis",
                    what: "Parameter set, perturbed:SEED, perturbed:SET:SEED, or a file *.toml",
                },
                ParamDoc {
                    name: "bed",
                    unit: "-",
                    default: "by set",
                    what: "Table: dynamometer, loops, actuators, sensors, limits, real engine (docs/testbed.md)",
                },
                ParamDoc {
                    name: "torque_noise_nm",
                    unit: "Nm",
                    default: "0",
                    what: "Standard deviation of white sensor noise on torque",
                },
                ParamDoc {
                    name: "lambda_noise",
                    unit: "-",
                    default: "0",
                    what: "Standard deviation of white sensor noise on lambda",
                },
            ],
        },
        check: check_virtual_engine,
        make: Some(virtual_engine),
        sample_time_s: None,
    },
    PlantMember {
        doc: MemberDoc {
            name: "bed",
            what: "Real bed: plans are written to files, measured records are read from RUN/measured",
            params: &[],
        },
        check: check_bed,
        make: None,
        sample_time_s: None,
    },
    fmu::MEMBER,
    literature::TORQUE_4_17,
    literature::LAMBDA_4_53,
    literature::TORQUE_5_3,
];

/// The row of `name`.
pub fn find(name: &str) -> Option<&'static PlantMember> {
    PLANTS.iter().find(|p| p.doc.name == name)
}

/// Faults of the table `[plant]` of a spec.
pub fn check(spec: &PlantSpec) -> Vec<PlantFault> {
    match find(&spec.name) {
        Some(member) => (member.check)(spec),
        None => {
            let known = PLANTS.iter().map(|p| p.doc.name.to_string()).collect();
            vec![PlantFault::unknown("plant.name", &spec.name, known)]
        }
    }
}

/// What belongs to a simulation means nothing on a real bed.
fn check_bed(spec: &PlantSpec) -> Vec<PlantFault> {
    let given = [
        ("plant.torque_noise_nm", spec.torque_noise_nm != 0.0, spec.torque_noise_nm.to_string()),
        ("plant.lambda_noise", spec.lambda_noise != 0.0, spec.lambda_noise.to_string()),
        ("plant.bed", !spec.bed.is_empty(), "a table".to_string()),
    ];
    let expected = "no such key where name = \"bed\": it belongs to the virtual engine";
    let given = given.into_iter().filter(|(_, is_given, _)| *is_given);
    given.map(|(key, _, found)| PlantFault::new(key, found, expected)).collect()
}

fn check_virtual_engine(spec: &PlantSpec) -> Vec<PlantFault> {
    let mut faults = Vec::new();
    match parameters(&spec.parameters) {
        Ok(_) => {}
        Err(EngineError::ParameterSet { .. }) => {
            let names = PARAMETER_SETS.iter().map(|s| s.doc.name);
            let known = names.chain(LIKE_A_SET).map(str::to_owned).collect();
            faults.push(PlantFault::unknown("plant.parameters", &spec.parameters, known));
        }
        Err(e) => faults.push(PlantFault::new("plant.parameters", &spec.parameters, e)),
    }
    if spec.file.is_some() || !spec.fmu.is_empty() {
        faults.push(PlantFault::new("plant", "the keys file or fmu", "these with name = \"fmu\" only"));
    }
    if let Err(e) = BedOptions::from_table(&spec.parameters, &spec.bed) {
        faults.push(match e {
            EngineError::Bed { key, found, expected } => {
                PlantFault::new(format!("plant.{key}"), found, expected)
            }
            e => PlantFault::new("plant.bed", "a bed", e),
        });
    }
    for (key, value, most, unit) in
        [("torque_noise_nm", spec.torque_noise_nm, 20.0, " Nm"), ("lambda_noise", spec.lambda_noise, 0.2, "")]
    {
        if !(0.0..=most).contains(&value) {
            faults.push(PlantFault::new(format!("plant.{key}"), value, format!("0 to {most}{unit}")));
        }
    }
    faults
}

/// Parameters by the name of an embedded set, `perturbed:SEED`, `perturbed:SET:SEED`, or from a file `*.toml`.
pub fn parameters(name: &str) -> Result<EngineParams, EngineError> {
    if !name.ends_with(".toml") {
        return EngineParams::named(name);
    }
    let text = std::fs::read_to_string(name).map_err(|e| EngineError::Bed {
        key: "parameters".into(),
        found: name.into(),
        expected: format!("a file that can be read ({e})"),
    })?;
    EngineParams::from_toml(&text)
        .map_err(|e| EngineError::ParameterFile { file: name.into(), source: Box::new(e) })
}

fn virtual_engine(spec: &PlantSpec, noise: bool) -> Result<Box<dyn Plant>, PlantError> {
    let refused = |e: EngineError| PlantError::Call(e.to_string());
    virtual_engine_with(spec, &parameters(&spec.parameters).map_err(refused)?, noise)
}

/// The virtual engine of a spec with numbers of its own instead of those of its parameter set.
///
/// # Errors
/// [`PlantError::Call`] where engine or bed do not take them.
pub fn virtual_engine_with(
    spec: &PlantSpec,
    params: &EngineParams,
    noise: bool,
) -> Result<Box<dyn Plant>, PlantError> {
    let refused = |e: EngineError| PlantError::Call(e.to_string());
    let options = BedOptions::from_table(&spec.parameters, &spec.bed).map_err(refused)?;
    let set = BedSettings::of_set(&spec.parameters, params).map_err(refused)?;
    let mut settings = BedSettings { options, ..set };
    if noise {
        settings.noise.torque_nm = spec.torque_noise_nm;
        settings.noise.lambda = spec.lambda_noise;
    } else {
        settings.options.sensors.values_mut().for_each(|s| s.noise = 0.0);
    }
    let bed = EngineBed::new(params, settings).map_err(refused)?;
    Ok(Box::new(bed))
}

/// Conformance: what every plant of the table must do, whatever it is.
#[cfg(test)]
mod tests {
    use super::*;
    use dynocal_ident::plant::Causality;

    const DT_S: f64 = 0.03;

    /// Every plant that can be made here, with sensor noise, and the virtual engine on beds with everything on.
    fn each(check: impl Fn(&str, Box<dyn Plant>, f64)) {
        let spec = PlantSpec { torque_noise_nm: 1.0, lambda_noise: 0.01, ..PlantSpec::default() };
        // An FMU has no default file: its own crate tests what it must do.
        let ready = PLANTS.iter().filter(|m| m.doc.name != "fmu");
        let made: Vec<_> = ready.filter_map(|m| m.make.map(|make| (m, make))).collect();
        assert!(!made.is_empty());
        for (m, make) in made {
            let plant = make(&spec, true).expect("plant with default keys");
            check(m.doc.name, plant, m.sample_time_s.unwrap_or(DT_S));
        }
        let beds = [
            ("real bed", "thesis", "real = true\n[loops]\ntorque = true\nlambda = true"),
            ("load mode", "thesis", "dynamometer.mode = \"load\"\n[[limits]]\nwhat = \"pmax\"\nmax = 60.0"),
            ("port injection", "pfi_1_6l", ""),
            ("another engine", "perturbed:3", "dynamometer.mode = \"inertial_speed\""),
        ];
        for (name, parameters, bed) in beds {
            let bed: toml::Table = toml::from_str(bed).expect("TOML");
            let spec = PlantSpec { parameters: parameters.into(), bed, ..spec.clone() };
            check(name, virtual_engine(&spec, true).expect("a bed"), DT_S);
        }
    }

    #[test]
    fn faulty_beds_are_named_with_their_key() {
        let fault = |parameters: &str, bed: &str| {
            let bed = toml::from_str(bed).expect("TOML");
            let spec = PlantSpec { parameters: parameters.into(), bed, ..PlantSpec::default() };
            assert!(!check(&spec).is_empty(), "{parameters} {spec:?}");
            virtual_engine(&spec, false).err().map(|e| e.to_string()).unwrap_or_default()
        };
        assert!(fault("v8", "").contains("v8"));
        assert!(fault("nowhere.toml", "").contains("nowhere.toml"));
        assert!(fault("thesis", "tick_s = 3.0").contains("bed.tick_s"));
        assert!(fault("thesis", "tock_s = 3.0").contains("tock_s"));
        assert!(fault("thesis", "outputs = [\"horsepower\"]").contains("horsepower"));
        assert!(fault("thesis", "sensors.torque.lag_s = -1.0").contains("sensors.torque.lag_s"));
        assert!(fault("thesis", "real = 3").contains("bed.real"));
    }

    fn starts(plant: &dyn Plant) -> (Vec<f64>, usize) {
        let of = |c| plant.variables().iter().filter(move |v| v.causality == c);
        (of(Causality::Input).map(|v| v.start).collect(), of(Causality::Output).count())
    }

    /// Outputs over `n` steps of inputs that move a little about the start.
    fn run(plant: &mut dyn Plant, n: usize, dt_s: f64) -> Vec<f64> {
        let (u, outputs) = starts(plant);
        let mut y = vec![0.0; outputs];
        (0..n)
            .flat_map(|t| {
                let u: Vec<f64> = u.iter().map(|v| v * (1.0 + 0.02 * (0.3 * t as f64).sin())).collect();
                plant.step(&u, dt_s, &mut y).expect("inputs near the start");
                y.clone()
            })
            .collect()
    }

    #[test]
    fn inputs_come_first_and_start_in_their_range() {
        each(|name, plant, _| {
            let v = plant.variables();
            let inputs = v.iter().take_while(|v| v.causality == Causality::Input).count();
            assert!(inputs > 0 && v[inputs..].iter().all(|v| v.causality == Causality::Output), "{name}");
            assert!(v.iter().all(|v| v.min <= v.start && v.start <= v.max && !v.unit.is_empty()), "{name}");
        });
    }

    #[test]
    fn reset_gives_an_identical_rerun_and_another_seed_other_noise() {
        each(|name, mut plant, dt_s| {
            plant.reset(5);
            let first = run(plant.as_mut(), 20, dt_s);
            plant.reset(5);
            assert_eq!(first, run(plant.as_mut(), 20, dt_s), "{name}");
            assert!((plant.time_s() - 20.0 * dt_s).abs() < 1e-9, "{name}");
            plant.reset(6);
            assert_ne!(first, run(plant.as_mut(), 20, dt_s), "{name}");
        });
    }

    /// What a plant shows is what its last step gave, the start values after a reset, and comes back with a saved state.
    #[test]
    fn the_present_outputs_are_those_of_the_last_step() {
        each(|name, mut plant, dt_s| {
            let (_, outputs) = starts(plant.as_ref());
            let shown = |plant: &dyn Plant| {
                let mut y = vec![f64::NAN; outputs];
                plant.outputs(&mut y).expect("own outputs");
                y
            };
            let first =
                plant.variables().iter().filter(|v| v.causality == Causality::Output).map(|v| v.start);
            let first: Vec<f64> = first.collect();
            plant.reset(5);
            assert_eq!(shown(plant.as_ref()), first, "{name}: start");
            let last = run(plant.as_mut(), 7, dt_s).split_off(6 * outputs);
            assert_eq!(shown(plant.as_ref()), last, "{name}: after a step");
            let state = plant.save();
            run(plant.as_mut(), 5, dt_s);
            assert_ne!(shown(plant.as_ref()), last, "{name}: further on");
            plant.restore(&state).expect("own state");
            assert_eq!(shown(plant.as_ref()), last, "{name}: restored");
            plant.reset(6);
            assert_eq!(shown(plant.as_ref()), first, "{name}: reset");
            assert!(plant.outputs(&mut vec![0.0; outputs + 1]).is_err(), "{name}");
        });
    }

    #[test]
    fn a_restored_state_continues_exactly() {
        each(|name, mut plant, dt_s| {
            run(plant.as_mut(), 7, dt_s);
            let state = plant.save();
            let expected = run(plant.as_mut(), 15, dt_s);
            plant.restore(&state).expect("own state");
            assert_eq!(expected, run(plant.as_mut(), 15, dt_s), "{name}");
            let short = dynocal_ident::plant::PlantState(vec![0.0]);
            assert!(plant.restore(&short).is_err(), "{name}: a foreign state is refused");
        });
    }

    #[test]
    fn inputs_outside_their_range_are_refused_and_change_nothing() {
        each(|name, mut plant, dt_s| {
            let (start, outputs) = starts(plant.as_ref());
            let mut y = vec![0.0; outputs];
            for i in 0..start.len() {
                let variable = plant.variables()[i].clone();
                for bad in [variable.max + 1.0 + variable.max.abs(), f64::NAN] {
                    let before = plant.save();
                    let mut u = start.clone();
                    u[i] = bad;
                    let error = plant.step(&u, dt_s, &mut y).expect_err("refused").to_string();
                    assert!(error.contains(&variable.name), "{name}: {error}");
                    assert_eq!(before, plant.save(), "{name}");
                }
            }
        });
    }

    #[test]
    fn a_published_model_answers_with_its_equation() {
        use dynocal_ident::model::{Model, Run, literature::lambda_4_53};
        let spec = PlantSpec { name: "lambda_4_53".into(), ..PlantSpec::default() };
        assert!(check(&spec).is_empty());
        let other = PlantSpec { torque_noise_nm: 1.0, ..spec.clone() };
        assert_eq!(check(&other).len(), 1);
        let make = find("lambda_4_53").and_then(|m| m.make).expect("a row with a plant");
        let mut plant = make(&spec, false).expect("at rest");
        let (start, _) = starts(plant.as_ref());
        let rest = plant.variables()[3].start;
        // The free run of the same inputs from rest, in one piece.
        let (lit, n, m) = (lambda_4_53(), 60, 3);
        let lag = lit.model.max_lag();
        let mut u: Vec<f64> = start.iter().copied().cycle().take(m * lag).collect();
        let mut found = Vec::new();
        for t in 0..n {
            let row =
                [start[0] + 300.0 * (0.7 * f64::from(t)).sin(), start[1], start[2] + 5.0 * f64::from(t)];
            let mut y = [0.0];
            plant.step(&row, 0.1, &mut y).expect("inside the box");
            found.push(y[0]);
            u.extend(row);
        }
        let measured = vec![rest; lag + n as usize];
        let mut y = vec![0.0; measured.len()];
        lit.model.simulate(&lit.theta, &Run { u: &u, y: &measured, start: lag }, &mut y);
        for (a, b) in found.iter().zip(&y[lag..]) {
            assert!((a - b).abs() < 1e-12 * b.abs().max(1.0), "{a} {b}");
        }
        assert!(plant.step(&start, 0.03, &mut [0.0]).is_err(), "the equation has one sample time");
    }
}
