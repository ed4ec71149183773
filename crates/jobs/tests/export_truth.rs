//! What `export` writes computes what the map or model computes: the neutral form sample by sample beside the original.

use dynocal_numerics::interval::Interval;
use std::collections::BTreeMap;

use dynocal_calib::map::lead_lag::{ActuatorTables, LagLaw, LeadLagMap, OtherReference};
use dynocal_calib::map::static_map::{StaticMap, StaticPoint};
use dynocal_calib::map::structured::terms::{self, Scale};
use dynocal_calib::map::structured::{StructuredMap, StructuredShape};
use dynocal_calib::map::{ActuatorPort, FeedforwardMap, Port, Ports, Rows};
use dynocal_export::evaluate::Machine;
use dynocal_export::package::Package;
use dynocal_files::json;
use dynocal_ident::data::{Channel, Dataset, Role};
use dynocal_ident::derived::Derived;
use dynocal_ident::model::initial::Initial;
use dynocal_ident::model::kinds::kind;
use dynocal_ident::model::neural::{Activation, Layout, NeuralNarx};
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::model::response::form::{Learner, ResponseForm};
use dynocal_ident::model::response::{self, Ask, Points, Prediction, Response};
use dynocal_ident::stored::{MODEL_SCHEMA, MODEL_VERSION, Quantity, Seen, StoredModel};
use dynocal_jobs::export::{ExportSpec, dynamic_map, lead_lag, model, run, static_map};
use dynocal_numerics::rng::Rng64;

fn ports() -> Ports {
    let port = |name: &str, unit: &str| Port { name: name.into(), unit: unit.into() };
    let actuator = |name: &str, unit: &str, lower, upper| {
        let (name, unit) = (name.into(), unit.into());
        ActuatorPort { name, unit, lower, upper }
    };
    Ports {
        demands: vec![port("torque", "Nm"), port("lambda", "-")],
        given: vec![port("speed", "rpm")],
        actuators: vec![
            actuator("inj", "mg", 3.0, 40.0),
            actuator("spark", "deg", -10.0, 45.0),
            actuator("throttle", "deg", 1.0, 60.0),
        ],
    }
}

/// A structured map with random coefficients in all of its terms.
fn structured(rng: &mut Rng64) -> StructuredMap {
    let region = [(10.0, 90.0), (0.9, 1.1), (1000.0, 3000.0)].map(Interval::from).to_vec();
    let scales: Vec<Scale> = region.iter().map(|s| Scale::of_range(*s)).collect();
    let terms = terms::terms(&ports(), &scales, &StructuredShape::default());
    let row = |middle: f64, rng: &mut Rng64| {
        let mut c: Vec<f64> = terms.iter().map(|_| rng.uniform_in(-1.0, 1.0)).collect();
        c[0] = middle;
        c
    };
    let coefficients = vec![row(15.0, rng), row(20.0, rng), row(25.0, rng)];
    let filter_s = vec![vec![0.12, 0.15], vec![]];
    StructuredMap { ports: ports(), look_ahead: 4, filter_s, scales, terms, coefficients, region }
}

/// References that leave the region now and then.
fn references(n: usize, rng: &mut Rng64) -> Rows {
    let mut rows = Rows::new(3);
    let mut at = [50.0, 1.0, 2000.0];
    for t in 0..n {
        if t % 17 == 0 {
            at = [rng.uniform_in(0.0, 100.0), rng.uniform_in(0.85, 1.15), rng.uniform_in(800.0, 3300.0)];
        }
        rows.push(&at);
    }
    rows
}

/// Outputs of the program, row by row; inputs by their names.
fn programmed(
    package: &Package,
    names: &[&str],
    rows: &dyn Fn(usize) -> Vec<f64>,
    n: usize,
) -> Vec<Vec<f64>> {
    let program = package.program.as_ref().unwrap();
    let places: Vec<usize> =
        program.inputs.iter().map(|i| names.iter().position(|x| *x == i.name).unwrap()).collect();
    let mut machine = Machine::<f64>::new(package).unwrap();
    (0..n).map(|t| machine.step(&places.iter().map(|k| rows(t)[*k]).collect::<Vec<_>>())).collect()
}

#[test]
fn the_dynamic_map_drives_as_the_program() {
    let mut rng = Rng64::new(1);
    let map = structured(&mut rng);
    let made = dynamic_map(&map, 0.03);
    let reference = references(2000, &mut rng);
    let want = map.drive(&reference, 0.03);
    let row = |t: usize| reference.row(t).to_vec();
    let got = programmed(&made.package, &["torque", "lambda", "speed"], &row, reference.len());
    let mut free = 0;
    for (t, got) in got.iter().enumerate() {
        for (c, g) in got.iter().enumerate() {
            let w = want.row(t)[c];
            assert!((g - w).abs() < 1e-11, "sample {t}, actuator {c}: {g} {w}");
            free += usize::from(w > map.ports.actuators[c].lower && w < map.ports.actuators[c].upper);
        }
    }
    // Not all of it may lie at the limits.
    assert!(free > 3000, "{free}");
    assert_eq!(made.package.provenance.validity[2].upper, 3000.0);
}

/// Tables, slopes and lags of any numbers; one actuator leads, one has a lead beside its lag.
fn tables(rng: &mut Rng64) -> LeadLagMap {
    let (demand, given) = (vec![10.0, 35.0, 50.0, 90.0], vec![1000.0, 2100.0, 3000.0]);
    let mut values =
        |lower: f64, upper: f64| -> Vec<f64> { (0..12).map(|_| rng.uniform_in(lower, upper)).collect() };
    let law = |lead| LagLaw { tau_s: 0.1, by_given: 1.0, by_demand: 0.0, lead };
    let mut one = |lag: f64, lead| ActuatorTables {
        base: values(5.0, 35.0),
        slopes: vec![values(-30.0, 30.0)],
        lag_s: values(0.0, lag),
        law: law(lead),
    };
    LeadLagMap {
        ports: ports(),
        region: [(10.0, 90.0), (0.9, 1.1), (1000.0, 3000.0)].map(Interval::from).to_vec(),
        others: vec![OtherReference { place: 1, rest: 0.99 }],
        actuators: vec![one(0.3, 0.0), one(0.5, 0.4), one(0.0, 0.0)],
        demand,
        given,
        loss: vec![0.0; 3],
        steps: None,
    }
}

#[test]
fn tables_with_lead_and_lag_drive_as_the_program() {
    let mut rng = Rng64::new(5);
    let map = tables(&mut rng);
    let made = lead_lag(&map, 0.03);
    made.package.check().unwrap();
    // Base and slope of each, lags of the two that have some.
    assert_eq!(made.package.characteristics.len(), 8);
    let reference = references(2000, &mut rng);
    let want = map.drive(&reference, 0.03);
    let row = |t: usize| reference.row(t).to_vec();
    let got = programmed(&made.package, &["torque", "lambda", "speed"], &row, reference.len());
    for (t, got) in got.iter().enumerate() {
        for (c, g) in got.iter().enumerate() {
            let w = want.row(t)[c];
            assert!((g - w).abs() < 1e-11, "sample {t}, actuator {c}: {g} {w}");
        }
    }
}

fn table() -> StaticMap {
    let (demand, given) = (vec![20.0, 35.0, 80.0], vec![1100.0, 2000.0, 2900.0, 3500.0]);
    let mut rng = Rng64::new(2);
    let mut points = Vec::new();
    for t in &demand {
        for n in &given {
            points.push(StaticPoint {
                demand: *t,
                given: *n,
                actuators: (0..3).map(|_| rng.uniform_in(5.0, 30.0)).collect(),
                errors: vec![0.0; 2],
                objective: 0.0,
                missed: String::new(),
            });
        }
    }
    StaticMap { ports: ports(), demand, given, points, bed_s: 0.0 }
}

/// Whoever opens the exported file is told of what was not reached, and why.
#[test]
fn what_was_not_reached_is_named_in_the_tables() {
    let mut map = table();
    assert!(
        static_map(&map, None).package.characteristics.iter().all(|c| !c.description.contains("not reached"))
    );
    for k in [7, 11] {
        map.points[k].missed = "filled from its neighbours".into();
    }
    let made = static_map(&map, None);
    let (demand, given) = (map.ports.demands[0].clone(), map.ports.given[0].clone());
    let at = |t: f64| format!("{} {t} {} at {} 3500 {}", demand.name, demand.unit, given.name, given.unit);
    let words = format!(
        "2 of 12 values were not reached as asked: {}, {} (filled from its neighbours)",
        at(35.0),
        at(80.0)
    );
    assert!(made.package.characteristics.iter().all(|c| c.description.ends_with(&words)));
    assert!(made.notes.iter().any(|n| n.ends_with(&words)), "{:?}", made.notes);
}

#[test]
fn the_static_map_looks_up_as_the_program() {
    let map = table();
    let made = static_map(&map, Some(0.03));
    let reference = references(2000, &mut Rng64::new(3));
    let want = map.drive(&reference, 0.03);
    let row = |t: usize| reference.row(t).to_vec();
    let got = programmed(&made.package, &["torque", "lambda", "speed"], &row, reference.len());
    for (t, got) in got.iter().enumerate() {
        assert!((0..3).all(|c| (got[c] - want.row(t)[c]).abs() < 1e-12), "sample {t}");
    }
    // Without a sample time the tables leave without a program.
    assert!(static_map(&map, None).package.program.is_none());
}

fn quantity(name: &str, unit: &str) -> Quantity {
    Quantity { name: name.into(), unit: unit.into() }
}

fn seen(name: &str, unit: &str, minimum: f64, maximum: f64) -> Seen {
    Seen { name: name.into(), unit: unit.into(), minimum, maximum }
}

/// Program and free run of the stored model from one start: what the program holds before its first sample stands in the
/// record as measured.
fn free_runs_agree(stored: &StoredModel, tolerance: f64) {
    let made = model(stored).unwrap();
    assert!(made.notes.is_empty(), "{:?}", made.notes);
    let program = made.package.program.as_ref().unwrap();
    let (memory, n) = (40, 600);
    let mut rng = Rng64::new(5);
    let mut at: Vec<f64> = program.inputs.iter().map(|i| i.start).collect();
    let mut columns = vec![Vec::new(); at.len()];
    for t in 0..n {
        if t >= memory && t % 13 == 0 {
            for (x, i) in at.iter_mut().zip(&program.inputs) {
                let Interval { lower, upper } = i.range.unwrap();
                *x = rng.uniform_in(lower, upper);
            }
        }
        columns.iter_mut().zip(&at).for_each(|(c, x)| c.push(*x));
    }
    let names: Vec<&str> = program.inputs.iter().map(|i| i.name.as_str()).collect();
    let row = |t: usize| columns.iter().map(|c| c[t]).collect();
    let got: Vec<f64> = programmed(&made.package, &names, &row, n).into_iter().map(|y| y[0]).collect();
    // At rest at its nominal point until the inputs move.
    assert!(
        got[..memory].iter().all(|y| (y - got[0]).abs() < 1e-9 * (1.0 + y.abs())),
        "{:?}",
        &got[..memory]
    );
    let channel = |name: &str, unit: &str, role, values: &[f64]| Channel {
        name: name.into(),
        unit: unit.into(),
        role,
        values: values.to_vec(),
    };
    let mut channels: Vec<Channel> = program
        .inputs
        .iter()
        .zip(&columns)
        .map(|(i, c)| channel(&i.description, &i.unit, Role::Input, c))
        .collect();
    let user = stored.user_output();
    channels.push(channel(&user.name, &user.unit, Role::Output, &vec![got[0]; n]));
    let record = Dataset {
        name: "drive".into(),
        sample_time_s: stored.sample_time_s,
        channels,
        init_samples: 0,
        origin: "computed".into(),
    };
    let want = &stored.simulate(&record, Some(Initial::Measured)).unwrap()[0].y;
    let moved = want.iter().fold(0.0_f64, |m, y| m.max((y - want[0]).abs()));
    assert!(moved > 1e-3, "the output does not move");
    for (t, (g, w)) in got.iter().zip(want).enumerate() {
        assert!((g - w).abs() <= tolerance * (1.0 + w.abs()), "sample {t}: {g} {w}");
    }
}

fn engine(structure: &[&str], theta: &[f64]) -> StoredModel {
    let m = PolyNarx::parse(&["inj", "spark"], "torque", structure).unwrap();
    let inputs = vec![quantity("inj", "mg"), quantity("spark", "deg")];
    let mut stored = StoredModel::new(m, theta, inputs, quantity("torque", "Nm"), 0.03).unwrap();
    stored.seen = vec![
        seen("inj", "mg", 10.0, 30.0),
        seen("spark", "deg", 5.0, 25.0),
        seen("torque", "Nm", 10.0, 90.0),
    ];
    stored
}

#[test]
fn polynomial_models_run_free_as_the_program() {
    let terms =
        ["1", "inj(t-2)", "inj(t-1)^2*spark(t)", "torque(t-1)", "torque(t-2)", "inj(t-3)*torque(t-1)"];
    free_runs_agree(&engine(&terms, &[2.0, 0.6, 0.004, 0.9, -0.3, 0.002]), 1e-11);
}

#[test]
fn neural_models_run_free_as_the_program() {
    for (activation, direct) in [(Activation::Tanh, false), (Activation::Softplus, true)] {
        let layout = Layout {
            hidden: vec![5, 3],
            activation,
            direct,
            input_lags: vec![[0, 2], [1, 1]],
            output_lags: 2,
        };
        let net = NeuralNarx::with_layout(&["inj", "spark"], "torque", layout).unwrap();
        let net = net.with_ranges(&[[10.0, 30.0], [5.0, 25.0]], [10.0, 90.0]).unwrap();
        let mut rng = Rng64::new(4);
        let mut theta = net.random_start(&mut rng);
        // Small weights: the free run settles. The direct path comes last.
        theta.iter_mut().for_each(|w| *w *= 0.4);
        if direct {
            let from = theta.len() - 6;
            theta[from..].copy_from_slice(&[0.1, -0.05, 0.2, 0.15, 0.3, -0.1]);
        }
        let inputs = vec![quantity("inj", "mg"), quantity("spark", "deg")];
        let mut stored = StoredModel::new(net, &theta, inputs, quantity("torque", "Nm"), 0.03).unwrap();
        stored.seen = engine(&["inj(t-1)"], &[1.0]).seen;
        // The network's own tanh and that of the C library agree to rounding.
        free_runs_agree(&stored, 1e-11);
    }
}

/// Every kind of response model over lagged inputs and output, and the transforms that are exported.
#[test]
fn response_models_run_free_as_the_program() {
    let window = vec![(0, 1), (1, 0)];
    let names = ["inj", "spark"].map(String::from);
    let mut rng = Rng64::new(9);
    let x: Vec<f64> = (0..100)
        .flat_map(|_| [rng.uniform_in(10.0, 30.0), rng.uniform_in(5.0, 25.0), rng.uniform_in(10.0, 90.0)])
        .collect();
    let torque = |x: &[f64]| 12.0 + 1.1 * x[0] - 0.02 * (x[1] - 18.0).powi(2) + 0.3 * x[2];
    let y: Vec<f64> = x.chunks_exact(3).map(|x| torque(x) + 0.3 * rng.normal()).collect();
    for (kind, keys) in [
        ("stepwise_polynomial", ""),
        ("stepwise_polynomial", "transform = \"log\""),
        ("stepwise_polynomial", "transform = \"logit\"\nlow = 0.0\nhigh = 120.0"),
        ("gaussian_process", "kernel = \"squared_exponential\"\nstarts = 1"),
        ("gaussian_process", "kernel = \"matern32\"\nmean = \"quadratic\"\nstarts = 1"),
        ("gaussian_process", "kernel = \"matern52\"\nmean = \"zero\"\nstarts = 1"),
        ("gaussian_process", "exact_points = 50\ninducing_points = 20\nstarts = 1"),
        ("gaussian_process", "warp = \"sqrt\"\nstarts = 1"),
        ("gaussian_process", "warp = \"asinh\"\ntransform = \"log\"\nstarts = 1"),
        ("local_linear", ""),
        ("local_linear", "quadratic = true\nmost = 3"),
        ("rbf", ""),
        ("mean_of", "models = [{ kind = \"rbf\" }, { kind = \"local_linear\" }]"),
    ] {
        let keys: toml::Table = keys.parse().unwrap();
        let learner = Learner { name: kind.into(), keys: keys.clone() };
        let form = ResponseForm::new(&names, "torque", window.clone(), 1, learner).unwrap();
        let points = Points { inputs: form.names(), output: "torque".into(), x: x.clone(), y: y.clone() };
        let learnt = response::learner(kind, &keys).unwrap().learn(&points, &|| false).unwrap();
        let form = form.with(learnt.model.clone()).unwrap();
        for (row, p) in points.x.chunks_exact(3).zip(0..20) {
            let mut at = Prediction::new(3);
            learnt.model.predict(row, Ask::Mean, &mut at);
            let value: f64 = learnt.model.formulas().iter().map(|f| f.share * f.value(row)).sum();
            assert!(
                (value - at.mean).abs() < 1e-8 * (1.0 + at.mean.abs()),
                "{kind} {p}: {value} {}",
                at.mean
            );
        }
        let inputs = vec![quantity("inj", "mg"), quantity("spark", "deg")];
        let mut stored = StoredModel::new(form, &[], inputs, quantity("torque", "Nm"), 0.03).unwrap();
        stored.seen = engine(&["inj(t-1)"], &[1.0]).seen;
        // The kernel sums subtract large weights from each other.
        println!("{kind} {keys}");
        free_runs_agree(&stored, 1e-7);
    }
}

/// A power of the output has no counterpart among the shapes of the neutral form.
#[test]
fn a_response_to_a_power_is_refused_with_what_leaves() {
    let mut rng = Rng64::new(10);
    let x: Vec<f64> = (0..40).map(|_| rng.uniform_in(10.0, 30.0)).collect();
    let y = x.iter().map(|x| (1.0 + 0.1 * x + 0.01 * rng.normal()).powi(2)).collect();
    let keys: toml::Table = "transform = \"box_cox\"\ndegree = 2".parse().unwrap();
    let learner = Learner { name: "stepwise_polynomial".into(), keys: keys.clone() };
    let form = ResponseForm::new(&["inj".into()], "torque", vec![(0, 0)], 0, learner).unwrap();
    let points = Points { inputs: form.names(), output: "torque".into(), x, y };
    let learnt = response::learner("stepwise_polynomial", &keys).unwrap().learn(&points, &|| false).unwrap();
    let form = form.with(learnt.model).unwrap();
    let inputs = vec![quantity("inj", "mg")];
    let stored = StoredModel::new(form, &[], inputs, quantity("torque", "Nm"), 0.03).unwrap();
    let words = model(&stored).unwrap_err().to_string();
    assert!(
        words.contains("it was learnt for the power") && words.contains("`transform = \"log\"`"),
        "{words}"
    );
}

#[test]
fn linear_models_run_free_as_the_program() {
    let keys = "nb = 2\nnf = 2\nnk = 1".parse().unwrap();
    let form = kind("oe", &keys).unwrap().form(&["inj".into(), "spark".into()], "torque", &[]).unwrap();
    let theta: Vec<f64> = form
        .parameter_names()
        .iter()
        .map(|n| match n.as_str() {
            n if n.starts_with("f1") => -1.2,
            n if n.starts_with("f2") => 0.4,
            _ => 0.7,
        })
        .collect();
    let inputs = vec![quantity("inj", "mg"), quantity("spark", "deg")];
    let form = dynocal_ident::model::form::AnyForm(form);
    let mut stored = StoredModel::new(form, &theta, inputs, quantity("torque", "Nm"), 0.03).unwrap();
    stored.seen = engine(&["inj(t-1)"], &[1.0]).seen;
    free_runs_agree(&stored, 1e-9);
}

/// Derived inputs and an inverted output: the model reads injection by speed and computes the fuel-air ratio, the program
/// reads what was measured and gives lambda.
#[test]
fn derived_channels_are_part_of_the_program() {
    let derived = |name: &str, factor, powers: &[(&str, i32)]| Derived {
        name: name.into(),
        unit: "-".into(),
        factor,
        powers: powers.iter().map(|(n, p)| ((*n).to_string(), *p)).collect::<BTreeMap<_, _>>(),
    };
    let m =
        PolyNarx::parse(&["rate", "cycle"], "phi", &["1", "rate(t-1)", "cycle(t-2)", "phi(t-1)"]).unwrap();
    let inputs = vec![quantity("rate", "-"), quantity("cycle", "-")];
    let mut stored =
        StoredModel::new(m, &[0.2, 0.002, 1.5, 0.6], inputs, quantity("phi", "-"), 0.03).unwrap();
    stored.derived = vec![
        derived("rate", 0.001, &[("inj", 1), ("speed", 1)]),
        derived("cycle", 120.0, &[("speed", -1)]),
        derived("phi", 1.0, &[("lambda", -1)]),
    ];
    stored.seen =
        vec![seen("inj", "-", 10.0, 30.0), seen("speed", "-", 1000.0, 3000.0), seen("lambda", "-", 0.8, 1.3)];
    stored.check().unwrap();
    free_runs_agree(&stored, 1e-10);
    let names: Vec<String> =
        model(&stored).unwrap().package.program.unwrap().inputs.into_iter().map(|i| i.name).collect();
    assert_eq!(names, ["inj", "speed"]);
}

/// A model that never settles leaves with a word, and one that nothing drives does not leave.
#[test]
fn what_does_not_settle_is_told() {
    let made = model(&engine(&["1", "inj(t-1)", "torque(t-1)"], &[1.0, 0.5, 1.01])).unwrap();
    assert!(made.notes.iter().any(|n| n.contains("does not settle")), "{:?}", made.notes);
    let keys = "nc = 1\nnd = 1".parse().unwrap();
    let form = kind("arma", &keys).unwrap().form(&[], "torque", &[]).unwrap();
    let theta = vec![0.1; form.parameter_names().len()];
    let form = dynocal_ident::model::form::AnyForm(form);
    let series = StoredModel::new(form, &theta, Vec::new(), quantity("torque", "Nm"), 0.03).unwrap();
    assert!(model(&series).unwrap_err().to_string().contains("no inputs"));
}

/// Files in a run folder leave in every format that can hold them, with where they came from.
#[test]
fn a_run_leaves_in_every_format() {
    let tmp = tempfile::tempdir().unwrap();
    let (steps, out) = (tmp.path().join("run/steps/05-invert"), tmp.path().join("out"));
    let root = tmp.path().join("run");
    json::write(
        &root.join("run.json"),
        &serde_json::json!({ "tool": "dynocal", "version": "0", "kind": "calibrate" }),
    )
    .unwrap();
    json::write(&root.join("spec.json"), &serde_json::json!({ "sample_time_s": 0.03 })).unwrap();
    json::write(&steps.join("step.json"), &serde_json::json!({ "inputs_digest": "0123abcd" })).unwrap();
    json::write_versioned(
        &steps.join("dynamic_map.json"),
        "dynocal/dynamic-map",
        2,
        &structured(&mut Rng64::new(1)),
    )
    .unwrap();
    json::write_versioned(&steps.join("static_map.json"), "dynocal/static-map", 2, &table()).unwrap();
    json::write_versioned(
        &steps.join("torque_model.json"),
        MODEL_SCHEMA,
        MODEL_VERSION,
        &engine(&["inj(t-1)"], &[1.0]),
    )
    .unwrap();
    let all = |names: &[&str]| ExportSpec {
        to: names.iter().map(|n| (*n).to_string()).collect(),
        ..Default::default()
    };
    let done = run(&root, &out, &all(&["c", "dcm", "json", "python"])).unwrap();
    let names: Vec<String> =
        done.files.iter().map(|p| p.file_name().unwrap().to_string_lossy().into_owned()).collect();
    for file in ["dynamic_map.c", "static_map.c", "static_map.dcm", "dynamic_map.json", "static_map.py"] {
        assert!(names.iter().any(|n| n == file), "{file} in {names:?}");
    }
    // The dynamic map has no tables: the user is told what DCM leaves out.
    assert!(done.notes.iter().any(|n| n.contains("dcm") && n.contains("dynamic_map")), "{:?}", done.notes);
    for file in ["dynamic_map.c", "static_map.dcm", "static_map.py"] {
        let text = std::fs::read_to_string(out.join(file)).unwrap();
        for part in ["Data digest: 0123abcd", "Spec digest: ", "Run: ", "Learnt with speed from "] {
            assert!(text.contains(part), "{file} has no `{part}`");
        }
    }
    // One model by name; a format that can hold nothing of it is an error, and nothing is written.
    let file = steps.join("torque_model.json");
    run(&file, &out, &all(&["c"])).unwrap();
    assert!(out.join("torque_model.c").is_file());
    let before = std::fs::read_dir(&out).unwrap().count();
    let refused = run(&file, &out, &all(&["json", "cdfx"])).unwrap_err().to_string();
    assert!(refused.contains("cdfx") && refused.contains("torque_model"), "{refused}");
    assert_eq!(std::fs::read_dir(&out).unwrap().count(), before);
    // What left comes in again.
    let again = run(&out.join("static_map.dcm"), &out, &all(&["csv"])).unwrap();
    assert!(!again.files.is_empty());
    let nothing = run(tmp.path(), &out, &all(&["c"])).unwrap_err().to_string();
    assert!(nothing.contains("expected a finished run"), "{nothing}");
}
