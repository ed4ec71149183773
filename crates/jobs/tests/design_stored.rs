//! Models of shifted, scaled and derived channels in a design: the same numbers as the stored model itself gives.

use dynocal_files::json;
use dynocal_ident::data::{Channel, Dataset, Role};
use dynocal_ident::derived::Derived;
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::Run;
use dynocal_ident::model::form::AnyForm;
use dynocal_ident::model::initial::Initial;
use dynocal_ident::model::linear::LinearModel;
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::model::response::form::{Learner, ResponseForm};
use dynocal_ident::model::response::{self, Points};
use dynocal_ident::prepare::{Planned, prepare};
use dynocal_ident::stored::{MODEL_SCHEMA, MODEL_VERSION, Quantity, Seen, StoredModel};
use dynocal_ident::validate::boundary::{Boundary, BoundaryKeys, Space, coverage, learn};
use dynocal_jobs::design::{self, Overrides, load};
use dynocal_numerics::rng::Rng64;

const N: usize = 80;
const DT_S: f64 = 0.05;

/// Fuel and speed drive torque.
fn record(seed: u64) -> Dataset {
    let mut rng = Rng64::new(seed);
    let mut channel = |name: &str, unit: &str, role, lo, hi| Channel {
        name: name.into(),
        unit: unit.into(),
        role,
        values: (0..N).map(|_| rng.uniform_in(lo, hi)).collect(),
    };
    let channels = vec![
        channel("fuel", "mg", Role::Input, 10.0, 30.0),
        channel("speed", "rpm", Role::Input, 1000.0, 3000.0),
        channel("torque", "Nm", Role::Output, 20.0, 120.0),
    ];
    Dataset { name: "bed".into(), sample_time_s: DT_S, channels, init_samples: 0, origin: "test".into() }
}

fn quantity(name: &str, unit: &str) -> Quantity {
    Quantity { name: name.into(), unit: unit.into() }
}

fn seen(c: &Channel) -> Seen {
    let (minimum, maximum) =
        c.values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(*v), b.max(*v)));
    Seen { name: c.name.clone(), unit: c.unit.clone(), minimum, maximum }
}

/// A stored model whose channels are shifted and scaled.
fn stored(structure: AnyForm, theta: &[f64], inputs: &[(&str, &str)], derived: &[Derived]) -> StoredModel {
    let all = inputs.iter().map(|(n, u)| quantity(n, u)).collect();
    let mut m = StoredModel::new(structure, theta, all, quantity("torque", "Nm"), DT_S).unwrap();
    m.derived = derived.to_vec();
    let names: Vec<&str> = inputs.iter().map(|i| i.0).chain(["torque"]).collect();
    let keys = format!("channels = {names:?}").parse().unwrap();
    let plan = [Planned::new("offset", &keys).unwrap(), Planned::new("scale", &keys).unwrap()];
    let mut d = record(1);
    m.derived.iter().for_each(|x| x.add_to(&mut d, Role::Input).unwrap());
    m.preparation = prepare(&plan, vec![d], &mut |_, _| ()).unwrap().1;
    m.noise_variance = Some(0.01);
    m.seen = record(1).channels.iter().map(seen).collect();
    m
}

fn cases() -> Vec<(&'static str, StoredModel)> {
    let plain = [("fuel", "mg"), ("speed", "rpm")];
    let cycle = Derived {
        name: "cycle".into(),
        unit: "s".into(),
        factor: 120.0,
        powers: [("speed".into(), -1)].into(),
    };
    let terms = ["fuel(t-1)", "fuel(t-2)*cycle(t-1)", "cycle(t-1)", "torque(t-1)"];
    let poly = PolyNarx::parse(&["fuel", "cycle"], "torque", &terms).unwrap();
    let terms = ["fuel(t-1)", "fuel(t-2)*speed(t-1)", "1", "torque(t-1)"];
    let shifted = PolyNarx::parse(&["fuel", "speed"], "torque", &terms).unwrap();
    let oe = LinearModel::oe(&["fuel", "speed"], "torque", 2, 1, 1);
    let bj = LinearModel { nc: 1, nd: 1, ..oe.clone() };
    vec![
        ("derived", stored(poly.into(), &[0.4, 0.1, -0.2, 0.6], &[("fuel", "mg"), ("cycle", "s")], &[cycle])),
        ("shifted", stored(shifted.into(), &[0.4, 0.1, 0.05, 0.6], &plain, &[])),
        ("oe", stored(oe.into(), &[0.4, 0.1, -0.2, 0.3, -0.8, -0.6], &plain, &[])),
        ("bj", stored(bj.into(), &[0.4, 0.1, -0.2, 0.3, 0.5, -0.9, -0.8, -0.6], &plain, &[])),
    ]
}

fn spec(unit_of_speed: &str, more: &str) -> String {
    format!(
        r#"
length_s = 4.0
sample_time_s = {DT_S}
channels = [
  {{ name = "speed", unit = "{unit_of_speed}", lower = 1000.0, upper = 3000.0 }},
  {{ name = "fuel", unit = "mg", lower = 10.0, upper = 30.0 }},
]
[[models]]
file = "model.json"
criterion = "d"
{more}
"#
    )
}

fn loaded(model: &StoredModel, spec: &str) -> Result<load::Inputs, String> {
    let place = tempfile::tempdir().unwrap();
    json::write_versioned(&place.path().join("model.json"), MODEL_SCHEMA, MODEL_VERSION, model).unwrap();
    let path = place.path().join("spec.toml");
    dynocal_files::atomic::write(&path, spec.as_bytes()).unwrap();
    let job = design::read(&path, &Overrides::default()).map_err(|e| e.to_string())?;
    load::load(&job).map_err(|e| e.to_string())
}

/// Inputs of the plan, in its order of channels, of a record.
fn inputs(d: &Dataset) -> Vec<f64> {
    d.matrix(&["speed".into(), "fuel".into()]).unwrap()
}

#[test]
fn a_design_predicts_what_the_stored_model_simulates() {
    for (name, stored) in cases() {
        let all = loaded(&stored, &spec("rpm", "")).unwrap();
        let m = &all.models[0];
        assert_eq!((m.name.as_str(), m.unit.as_str()), ("torque", "Nm"), "{name}");
        let d = record(2);
        let (u, y0) = (inputs(&d), d.values("torque").unwrap());
        let own = stored.simulate(&d, Some(Initial::Measured)).unwrap().remove(0).y;
        let mut y = vec![0.0; N];
        let start = m.model.max_lag();
        m.model.simulate(&m.theta, &Run { u: &u, y: y0, start }, &mut y);
        // A model with several denominators shares what was measured among them: after it has faded they agree.
        let from = if name == "oe" || name == "bj" { 60 } else { start };
        for t in from..N {
            assert!((y[t] - own[t]).abs() < 1e-3 * (1.0 + own[t].abs()), "{name} {t}: {} {}", y[t], own[t]);
        }
        // The noise of the prepared output, in Nm.
        let scale = stored.pointwise().unwrap().output.scale;
        assert!(scale > 2.0 && (m.noise_variance / (0.01 * scale * scale) - 1.0).abs() < 1e-12, "{name}");
    }
}

/// A response model has no parameters to tell about.
#[test]
fn a_response_model_is_refused_with_the_reason() {
    let mut rng = Rng64::new(11);
    let x: Vec<f64> = (0..60)
        .flat_map(|_| {
            [rng.uniform_in(10.0, 30.0), rng.uniform_in(1000.0, 3000.0), rng.uniform_in(20.0, 120.0)]
        })
        .collect();
    let y = x.chunks_exact(3).map(|x| 2.0 * x[0] + 0.01 * x[1] + 0.3 * x[2] + 0.2 * rng.normal()).collect();
    let keys = toml::Table::new();
    let learner = Learner { name: "local_linear".into(), keys: keys.clone() };
    let names = ["fuel", "speed"].map(String::from);
    let form = ResponseForm::new(&names, "torque", vec![(0, 1), (1, 1)], 1, learner).unwrap();
    let points = Points { inputs: form.names(), output: "torque".into(), x, y };
    let learnt = response::learner("local_linear", &keys).unwrap().learn(&points, &|| false).unwrap();
    let form = AnyForm::from(form.with(learnt.model).unwrap());
    let model = stored(form, &[], &[("fuel", "mg"), ("speed", "rpm")], &[]);
    let refused = loaded(&model, &spec("rpm", "")).err().unwrap();
    assert!(refused.contains("the model of torque has no parameters (a response model"), "{refused}");
}

#[test]
fn sensitivities_of_the_free_run_are_those_of_the_stored_model_by_differences() {
    for (name, stored) in cases() {
        let all = loaded(&stored, &spec("rpm", "")).unwrap();
        let m = &all.models[0];
        let model = m.predictor.as_ref().unwrap_or(&m.model);
        let p = model.n_params();
        let d = record(2);
        let u = inputs(&d);
        let middle = stored.pointwise().unwrap().to_user(0.0);
        let (mut y, mut s) = (vec![0.0; N], vec![0.0; N * p]);
        let rest = vec![middle; N];
        model.sensitivities(&m.theta, &Run { u: &u, y: &rest, start: model.max_lag() }, &mut y, &mut s);
        for k in 0..p {
            let own = model.param_name(k);
            let place = stored.parameters.iter().position(|q| q.name == own).unwrap();
            let at = |h: f64| {
                let mut moved = stored.clone();
                moved.parameters[place].value += h;
                moved.simulate(&d, Some(Initial::Measured)).unwrap().remove(0).y
            };
            let (up, down) = (at(1e-5), at(-1e-5));
            // What was before the record has faded by then.
            for t in 70..N {
                let difference = (up[t] - down[t]) / 2e-5;
                let found = s[t * p + k];
                assert!(
                    (difference - found).abs() < 2e-3 * (1.0 + found.abs()),
                    "{name} {own} {t}: {difference} {found}"
                );
            }
        }
    }
}

#[test]
fn what_was_identified_goes_into_the_units_of_the_plan() {
    let (_, mut stored) = cases().remove(1);
    let way = stored.pointwise().unwrap();
    let seen = record(1);
    let prepared = Experiment {
        name: "bed".into(),
        u: way.rows(&seen).unwrap(),
        y: seen.values("torque").unwrap().iter().map(|v| way.from_user(*v)).collect(),
        init_samples: 0,
        weights: Vec::new(),
    };
    let space = Space::of(stored.driven().unwrap().model.as_ref());
    let boundary = learn(space, std::slice::from_ref(&prepared), &BoundaryKeys::default()).unwrap();
    let own = coverage(&boundary, &prepared.u, &prepared.y, 0);
    stored.boundary = Some(boundary);
    let all = loaded(&stored, &spec("rpm", "")).unwrap();
    let found = all.models[0].boundary.as_ref().unwrap();
    assert_eq!(found.dim(), stored.boundary.as_ref().unwrap().dim());
    let ours = coverage(found, &inputs(&seen), seen.values("torque").unwrap(), 0);
    assert!(own.worst > 0.5);
    for (a, b) in own.distances.iter().zip(&ours.distances) {
        assert!((a - b).abs() < 1e-9 * (1.0 + a), "{a} {b}");
    }
}

#[test]
fn units_and_noise_that_do_not_serve_are_refused_in_words() {
    let (_, mut stored) = cases().remove(0);
    let refused = |m: &StoredModel, unit: &str, parts: &[&str]| {
        let message = loaded(m, &spec(unit, "")).err().unwrap();
        parts.iter().for_each(|p| assert!(message.contains(p), "no `{p}` in {message}"));
    };
    refused(&stored, "1/min2", &["unit `1/min2` of the channel `speed`", "expected `rpm`"]);
    stored.noise_variance = None;
    refused(&stored, "rpm", &["no noise level is known", "noise_std (in Nm)"]);
}
