//! Every key of every example spec and of every table, with values that nobody should write: refused in words or taken, never
//! a panic, and what is taken states what it will cost.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use dynocal_ident::data::{Channel, Dataset, Role};
use dynocal_ident::estimate;
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::kinds;
use dynocal_ident::prepare::{self, Planned, prepare};
use dynocal_ident::{select, signal};
use dynocal_jobs::{calibrate, design, fuelling, identify, map, optimise, sequential, signal as signals};
use dynocal_numerics::registry::MemberDoc;
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::watch::Watch;
use toml::{Table, Value};

/// What stands in place of a value; none: the key is missing.
fn hostile() -> Vec<Option<Value>> {
    let float = |v: f64| Some(Value::Float(v));
    let int = |v: i64| Some(Value::Integer(v));
    vec![
        None,
        Some(Value::String(String::new())),
        Some(Value::String("../\u{0}\u{202e}".into())),
        Some(Value::Boolean(true)),
        Some(Value::Array(Vec::new())),
        Some(Value::Array(vec![Value::Float(f64::NAN), Value::Float(-1.0)])),
        Some(Value::Table(Table::new())),
        int(0),
        int(-1),
        int(1 << 31),
        int(i64::MAX),
        int(i64::MIN),
        float(0.0),
        float(-1.0),
        float(1e-308),
        float(1e308),
        float(-1e308),
        float(f64::NAN),
        float(f64::INFINITY),
    ]
}

/// Way to a value: keys of tables and places of arrays.
#[derive(Clone, Debug)]
enum Step {
    Key(String),
    Place(usize),
}

fn ways(value: &Value, here: &[Step], out: &mut Vec<Vec<Step>>) {
    let mut inner: Vec<(Step, &Value)> = Vec::new();
    match value {
        Value::Table(t) => inner.extend(t.iter().map(|(k, v)| (Step::Key(k.clone()), v))),
        // Alike elements: the first and the last stand for all.
        Value::Array(a) => inner.extend(
            a.iter()
                .enumerate()
                .filter(|(i, _)| *i == 0 || *i + 1 == a.len())
                .map(|(i, v)| (Step::Place(i), v)),
        ),
        _ => {}
    }
    for (step, v) in inner {
        let way = [here, &[step]].concat();
        out.push(way.clone());
        ways(v, &way, out);
    }
}

/// `root` with another value at the end of `way`.
fn changed(root: &Table, way: &[Step], value: Option<&Value>) -> Table {
    fn set(here: &mut Value, way: &[Step], value: Option<&Value>) {
        let Some((first, rest)) = way.split_first() else { return };
        match (first, here) {
            (Step::Key(k), Value::Table(t)) if rest.is_empty() => match value {
                Some(v) => drop(t.insert(k.clone(), v.clone())),
                None => drop(t.remove(k)),
            },
            (Step::Place(i), Value::Array(a)) if rest.is_empty() => match value {
                Some(v) => a[*i] = v.clone(),
                None => drop(a.remove(*i)),
            },
            (Step::Key(k), Value::Table(t)) => t.get_mut(k).into_iter().for_each(|v| set(v, rest, value)),
            (Step::Place(i), Value::Array(a)) => a.get_mut(*i).into_iter().for_each(|v| set(v, rest, value)),
            _ => {}
        }
    }
    let mut all = Value::Table(root.clone());
    set(&mut all, way, value);
    match all {
        Value::Table(t) => t,
        _ => root.clone(),
    }
}

/// Reads a spec by its verb; whether it was taken.
fn read(verb: &str, path: &Path) -> bool {
    let out = Some(path.with_extension("run"));
    match verb {
        "identify" => {
            let overrides = identify::spec::Overrides { out, ..Default::default() };
            identify::spec::read(path, &overrides).is_ok()
        }
        "signal" => {
            let overrides = dynocal_jobs::place::Overrides { seed: None, out };
            let Ok(job) = signals::spec::read(path, &overrides) else { return false };
            let plan = signals::work::estimate(&job);
            // What is taken and small is run.
            if plan.memory_bytes < 1e6 && plan.operations < 1e8 {
                drop(signals::work::make(&job, Watch::silent()));
            }
            true
        }
        "design" => {
            let overrides = design::Overrides { seed: None, out };
            let Ok(job) = design::read(path, &overrides) else { return false };
            design::estimate::estimate(&job).is_ok_and(|plan| plan.memory_bytes.is_finite())
        }
        "optimise" => {
            let overrides = dynocal_jobs::place::Overrides { seed: None, out };
            let Ok(job) = optimise::spec::read(path, &overrides) else { return false };
            // Models and record are read as far as that goes, and the plan states what it costs.
            !optimise::estimate(&job).is_ok_and(|plan| plan.memory_bytes.is_nan())
        }
        "sequential" => {
            let overrides = dynocal_jobs::place::Overrides { seed: None, out };
            let Ok(job) = sequential::spec::read(path, &overrides) else { return false };
            sequential::estimate::estimate(&job).is_ok_and(|plan| plan.memory_bytes.is_finite())
        }
        "fuelling" => {
            let overrides = dynocal_jobs::place::Overrides { seed: None, out };
            let Ok(job) = fuelling::spec::read(path, &overrides) else { return false };
            fuelling::work::estimate(&job).is_ok_and(|plan| plan.memory_bytes.is_finite())
        }
        "map" => {
            let overrides = dynocal_jobs::place::Overrides { seed: None, out };
            let Ok(job) = map::job::read(path, &overrides) else { return false };
            let plan = map::estimate::estimate(&job);
            assert!(plan.memory_bytes.is_finite() && plan.operations.is_finite(), "{plan:?}");
            true
        }
        _ => {
            let Ok(campaign) = calibrate::job::read(path, None, out.as_deref()) else { return false };
            let plan = calibrate::estimate::estimate(&campaign);
            assert!(plan.memory_bytes.is_finite() && plan.operations.is_finite(), "{plan:?}");
            true
        }
    }
}

fn examples() -> Vec<(&'static str, PathBuf)> {
    let place = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples");
    [
        ("identify", "gas_furnace/identify.toml"),
        ("identify", "bosch_engine/polynomial.toml"),
        ("identify", "benchmarks/cascaded_tanks_neural.toml"),
        ("identify", "benchmarks/emps.toml"),
        ("signal", "design/signals.toml"),
        ("design", "design/spec.toml"),
        ("optimise", "optimise/fuel.toml"),
        ("calibrate", "gtdi/calibrate.toml"),
        ("calibrate", "gtdi/quick.toml"),
        ("calibrate", "gtdi_2l/calibrate.toml"),
        ("map", "gtdi_2l/map.toml"),
        ("fuelling", "pfi_1_6l/fuelling.toml"),
        ("sequential", "sequential/spec.toml"),
        ("identify", "steady/engine_points.toml"),
    ]
    .map(|(verb, file)| (verb, place.join(file)))
    .into()
}

#[test]
fn no_value_of_any_key_of_a_spec_ends_in_a_panic() {
    let tmp = tempfile::tempdir().unwrap();
    let (mut faults, mut tried, mut taken) = (Vec::new(), 0, 0);
    for (verb, file) in examples() {
        let text = std::fs::read_to_string(&file).unwrap();
        let root: Table = text.parse().unwrap();
        if verb == "optimise" {
            // What is taken is read as far as models and record.
            for beside in ["torque.json", "lambda.json", "record.csv.gz"] {
                std::fs::copy(file.with_file_name(beside), tmp.path().join(beside)).unwrap();
            }
        }
        let mut all = Vec::new();
        ways(&Value::Table(root.clone()), &[], &mut all);
        assert!(all.len() > 8, "{}", file.display());
        for way in all {
            for value in hostile() {
                let Ok(text) = toml::to_string(&changed(&root, &way, value.as_ref())) else { continue };
                let path = tmp.path().join("spec.toml");
                dynocal_files::atomic::write(&path, text.as_bytes()).unwrap();
                tried += 1;
                match catch_unwind(AssertUnwindSafe(|| read(verb, &path))) {
                    Ok(fine) => taken += usize::from(fine),
                    Err(_) => faults.push(format!("{verb} {}: {way:?} = {value:?}", file.display())),
                }
            }
        }
    }
    println!("{tried} specs, {taken} taken");
    assert!(faults.is_empty(), "{} of {tried}:\n{}", faults.len(), faults.join("\n"));
    // Some are harmless (another seed); most are not.
    assert!(taken > 0 && taken < tried / 2, "{taken} of {tried}");
}

/// Keys that a member cannot do without.
fn base(member: &str) -> Table {
    let text = match member {
        "polynomial" | "narmax" => "regressors = ['u(t-1)', 'y(t-1)']",
        "sweep" => "lo = 0.0\nhi = 1.0\nperiod_s = 2.0",
        "random_walk" => "lo = 0.0\nhi = 1.0\nstep = 0.1\nhold_s = 0.2",
        "multisine" | "band_noise" => "lo = 0.0\nhi = 1.0\nf_min_hz = 0.2\nf_max_hz = 2.0",
        "chirp" => "lo = 0.0\nhi = 1.0\nf_start_hz = 0.1\nf_end_hz = 1.0",
        "ramp_hold" => "lo = 0.0\nhi = 1.0\nrate_per_s = 1.0\nhold_s = 0.5",
        "udrn" | "prbs" | "rbs" | "aprbs" | "staircase" | "space_filling" => {
            "lo = 0.0\nhi = 1.0\nhold_s = 0.3"
        }
        "filter" => "pass = 'low'\nedge_hz = 1.0",
        "resample" => "sample_time_s = 0.2",
        "delay" => "channels = { u = 1 }",
        _ => "",
    };
    text.parse().unwrap()
}

fn experiment(n: usize) -> Experiment {
    let mut rng = Rng64::new(5);
    let u: Vec<f64> = (0..n).map(|_| rng.uniform_in(-1.0, 1.0)).collect();
    let mut y = vec![0.0; n];
    (1..n).for_each(|t| y[t] = 0.7 * y[t - 1] + u[t - 1]);
    Experiment { name: "bed".into(), u, y, init_samples: 0, weights: vec![] }
}

fn dataset(e: &Experiment) -> Dataset {
    let channel = |name: &str, role, values: &[f64]| Channel {
        name: name.into(),
        unit: "-".into(),
        role,
        values: values.to_vec(),
    };
    let channels = vec![channel("u", Role::Input, &e.u), channel("y", Role::Output, &e.y)];
    Dataset { name: "bed".into(), sample_time_s: 0.1, channels, init_samples: 0, origin: "test".into() }
}

/// Builds a member, and uses it on something small where it was built.
type Use = Box<dyn Fn(&str, &Table) -> bool>;

fn families() -> Vec<(&'static str, Vec<MemberDoc>, Use)> {
    let data = Arc::new(experiment(120));
    let record = dataset(&data);
    let e = data.clone();
    let signals: Use = Box::new(|name, keys| {
        let Ok(built) = signal::signal(name, keys) else { return false };
        built.fill(&mut [0.0; 200], 0.1, &mut Rng64::new(1)).is_ok()
    });
    let models: Use = Box::new(move |name, keys| {
        let Ok(built) = kinds::kind(name, keys) else { return false };
        built.form(&["u".into()], "y", std::slice::from_ref(&*e)).is_ok()
    });
    let estimators: Use = Box::new(|name, keys| estimate::estimator(name, keys).is_ok());
    let selections: Use = Box::new(|name, keys| select::selection(name, keys).is_ok());
    let steps: Use = Box::new(move |name, keys| {
        let Ok(step) = Planned::new(name, keys) else { return false };
        prepare(&[step], vec![record.clone()], &mut |_, _| ()).is_ok()
    });
    let searches: Use = Box::new(|name, keys| dynocal_design::search::search(name, keys).is_ok());
    let optimisers: Use = Box::new(|name, keys| dynocal_numerics::optim::optimiser(name, keys).is_ok());
    let criteria: Use = Box::new(|name, keys| dynocal_design::criterion::criterion(name, keys).is_ok());
    vec![
        ("signal", signal::docs(), signals),
        ("model", kinds::docs(), models),
        ("estimator", estimate::docs(), estimators),
        ("selection", select::docs(), selections),
        ("preparation", prepare::docs(), steps),
        ("search", dynocal_design::search::SEARCHES.iter().map(|m| m.doc).collect(), searches),
        ("optimiser", dynocal_numerics::optim::OPTIMISERS.iter().map(|m| m.doc).collect(), optimisers),
        ("criterion", dynocal_design::criterion::CRITERIA.iter().map(|m| m.doc).collect(), criteria),
    ]
}

#[test]
fn no_value_of_any_key_of_a_table_ends_in_a_panic() {
    let (mut faults, mut tried) = (Vec::new(), 0);
    for (family, docs, used) in families() {
        for doc in docs {
            for p in doc.params {
                for value in hostile() {
                    let mut keys = base(doc.name);
                    match &value {
                        Some(v) => drop(keys.insert(p.name.into(), v.clone())),
                        None => drop(keys.remove(p.name)),
                    }
                    tried += 1;
                    if catch_unwind(AssertUnwindSafe(|| used(doc.name, &keys))).is_err() {
                        faults.push(format!("{family} {}: {} = {value:?}", doc.name, p.name));
                    }
                }
            }
        }
    }
    assert!(tried > 1000, "{tried}");
    assert!(faults.is_empty(), "{} of {tried}:\n{}", faults.len(), faults.join("\n"));
}

/// Every key of the embedded parameter sets and of a bed's file: refused with file, line and key, or an engine that can be built and
/// driven. Values that no engine has are none of the accepted ones.
#[test]
fn no_value_of_any_parameter_of_an_engine_ends_in_a_panic() {
    use dynocal_ident::plant::Plant;
    let tmp = tempfile::tempdir().unwrap();
    let path = tmp.path().join("engine.toml");
    let (mut faults, mut tried, mut taken, mut driven, mut lines) = (Vec::new(), 0, Vec::new(), 0, 0);
    for set in dynocal_plant::params::PARAMETER_SETS {
        let root: Table = set.text.parse().unwrap();
        let mut all = Vec::new();
        ways(&Value::Table(root.clone()), &[], &mut all);
        for way in all {
            for value in hostile() {
                let Ok(text) = toml::to_string(&changed(&root, &way, value.as_ref())) else { continue };
                dynocal_files::atomic::write(&path, text.as_bytes()).unwrap();
                tried += 1;
                let name = path.to_str().unwrap();
                let read = catch_unwind(AssertUnwindSafe(|| dynocal_plant::plants::parameters(name)));
                let params = match read {
                    Ok(Ok(params)) => params,
                    Ok(Err(e)) => {
                        let text = e.to_string();
                        lines += usize::from(text.contains("line "));
                        if !text.contains("engine.toml") || text.len() > 4000 {
                            faults.push(format!("{}: {way:?} = {value:?}: {text:.300}", set.doc.name));
                        }
                        continue;
                    }
                    Err(_) => {
                        faults.push(format!("{}: {way:?} = {value:?} panics", set.doc.name));
                        continue;
                    }
                };
                let huge = matches!(value, Some(Value::Float(v)) if v.abs() > 1e300);
                if huge {
                    faults.push(format!("{}: {way:?} = {value:?} is an engine", set.doc.name));
                }
                taken.push((set.doc.name, way.clone(), params));
            }
        }
    }
    // A sample of what was taken is built and driven.
    for (set, way, params) in taken.iter().step_by(23) {
        let built = catch_unwind(AssertUnwindSafe(|| {
            let settings = dynocal_plant::bed::BedSettings::of_set(set, params).ok()?;
            let mut bed = dynocal_plant::bed::EngineBed::new(params, settings).ok()?;
            let start: Vec<f64> = bed
                .variables()
                .iter()
                .filter(|v| v.causality == dynocal_ident::plant::Causality::Input)
                .map(|v| v.start)
                .collect();
            let mut y = vec![0.0; bed.variables().len() - start.len()];
            (0..3).try_for_each(|_| bed.step(&start, 0.03, &mut y)).ok()
        }));
        driven += usize::from(matches!(built, Ok(Some(()))));
        if built.is_err() {
            faults.push(format!("{set}: {way:?}: building or driving panics"));
        }
    }
    println!("{tried} sets, {} taken, {driven} of a sample driven, {lines} refused with a line", taken.len());
    assert!(faults.is_empty(), "{} of {tried}:\n{}", faults.len(), faults[..faults.len().min(60)].join("\n"));
    assert!(taken.len() < tried / 4 && driven > 0, "{} of {tried}", taken.len());
}
