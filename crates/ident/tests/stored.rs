//! Stored models: the way of the channels there and back, and what is refused.

use dynocal_ident::data::{Channel, Dataset, Role};
use dynocal_ident::derived::Derived;
use dynocal_ident::model::initial::Initial;
use dynocal_ident::model::kinds::{MODEL_KINDS, forms};
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::prepare::{Planned, prepare};
use dynocal_ident::stored::{Quantity, Seen, StoredModel};
use dynocal_numerics::rng::Rng64;

const N: usize = 60;
const THETA: [f64; 4] = [0.3, -0.2, 0.05, 0.6];

fn channel(name: &str, unit: &str, role: Role, values: Vec<f64>) -> Channel {
    Channel { name: name.into(), unit: unit.into(), role, values }
}

/// Injection and speed drive lambda.
fn record(seed: u64) -> Dataset {
    let mut rng = Rng64::new(seed);
    let mut draw = |lo: f64, hi: f64| -> Vec<f64> { (0..N).map(|_| rng.uniform_in(lo, hi)).collect() };
    let channels = vec![
        channel("inj", "mg", Role::Input, draw(10.0, 30.0)),
        channel("speed", "rpm", Role::Input, draw(1000.0, 3000.0)),
        channel("lambda", "-", Role::Output, draw(0.8, 1.3)),
    ];
    Dataset { name: "bed".into(), sample_time_s: 0.03, channels, init_samples: 0, origin: "test".into() }
}

fn monomial(name: &str, unit: &str, factor: f64, powers: &[(&str, i32)]) -> Derived {
    let powers = powers.iter().map(|(n, p)| (n.to_string(), *p)).collect();
    Derived { name: name.into(), unit: unit.into(), factor, powers }
}

fn quantity(name: &str, unit: &str) -> Quantity {
    Quantity { name: name.into(), unit: unit.into() }
}

/// `phi = 1/lambda` from injection and cycle duration, all shifted, some scaled.
fn model() -> StoredModel {
    let structure = PolyNarx::parse(
        &["inj", "cycle"],
        "phi",
        &["inj(t-1)", "cycle(t)", "inj(t-1)*cycle(t-1)", "phi(t-1)"],
    );
    let inputs = vec![quantity("inj", "mg"), quantity("cycle", "s")];
    let mut m = StoredModel::new(structure.unwrap(), &THETA, inputs, quantity("phi", "-"), 0.03).unwrap();
    m.derived =
        vec![monomial("cycle", "s", 120.0, &[("speed", -1)]), monomial("phi", "-", 1.0, &[("lambda", -1)])];
    let plan = [
        Planned::new("offset", &"channels = ['inj', 'cycle', 'phi']".parse().unwrap()).unwrap(),
        Planned::new("scale", &"channels = ['inj', 'phi']".parse().unwrap()).unwrap(),
        Planned::new("offset", &"at = { inj = 0.25 }".parse().unwrap()).unwrap(),
    ];
    let mut d = record(1);
    m.derived.iter().for_each(|x| x.add_to(&mut d, Role::Input).unwrap());
    m.preparation = prepare(&plan, vec![d], &mut |_, _| ()).unwrap().1;
    let raw = record(1);
    m.seen = raw
        .channels
        .iter()
        .map(|c| {
            let (minimum, maximum) =
                c.values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(*v), b.max(*v)));
            Seen { name: c.name.clone(), unit: c.unit.clone(), minimum, maximum }
        })
        .collect();
    m
}

/// Mean and standard deviation of the estimation record, by the definition.
fn moments(values: &[f64]) -> (f64, f64) {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    (mean, (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / values.len() as f64).sqrt())
}

/// The model written out by hand on `d`, from the lambda measured at sample 0.
fn by_hand(d: &Dataset) -> Vec<f64> {
    let seen = record(1);
    let of = |d: &Dataset, name: &str| d.values(name).unwrap().to_vec();
    let cycle = |d: &Dataset| of(d, "speed").iter().map(|s| 120.0 / s).collect::<Vec<f64>>();
    let phi = |d: &Dataset| of(d, "lambda").iter().map(|l| 1.0 / l).collect::<Vec<f64>>();
    let (inj_0, inj_s) = moments(&of(&seen, "inj"));
    let (cycle_0, _) = moments(&cycle(&seen));
    let (phi_0, phi_s) = moments(&phi(&seen));
    let u1: Vec<f64> = of(d, "inj").iter().map(|v| (v - inj_0) / inj_s - 0.25).collect();
    let u2: Vec<f64> = cycle(d).iter().map(|v| v - cycle_0).collect();
    let mut y = vec![(phi(d)[0] - phi_0) / phi_s];
    for t in 1..N {
        y.push(
            THETA[0] * u1[t - 1] + THETA[1] * u2[t] + THETA[2] * u1[t - 1] * u2[t - 1] + THETA[3] * y[t - 1],
        );
    }
    y.iter().map(|y| 1.0 / (phi_0 + phi_s * y)).collect()
}

#[test]
fn records_pass_derivation_and_preparation_and_the_output_comes_back() {
    let model = model();
    let text = serde_json::to_string(&model).unwrap();
    let again: StoredModel = serde_json::from_str(&text).unwrap();
    assert_eq!(again, model);
    let other = record(2);
    let found = again.simulate(&other, Some(Initial::Measured)).unwrap();
    assert_eq!(found.len(), 1);
    for (y, expected) in found[0].y.iter().zip(by_hand(&other)) {
        assert!((y - expected).abs() < 1e-12, "{y} and {expected}");
    }
    let measured = found[0].measured.as_ref().unwrap();
    let truth = other.values("lambda").unwrap();
    assert!(measured.iter().zip(truth).all(|(a, b)| (a - b).abs() < 1e-12));
    // What the user gives and gets.
    let names =
        |all: Vec<Quantity>| all.into_iter().map(|q| format!("{} {}", q.name, q.unit)).collect::<Vec<_>>();
    assert_eq!(names(model.measured()), ["inj mg", "speed rpm", "lambda -"]);
    assert_eq!(names(model.measured_inputs()), ["inj mg", "speed rpm"]);
    assert_eq!(model.user_output(), quantity("lambda", "-"));
}

#[test]
fn sample_by_sample_is_the_same_way() {
    let model = model();
    let way = model.pointwise().unwrap();
    let other = record(3);
    let rows = way.rows(&other).unwrap();
    let (prepared, _) = model.prepared(&other).unwrap();
    let expected = prepared[0].matrix(&["inj".to_string(), "cycle".to_string()]).unwrap();
    assert!(rows.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-12));
    let channels = ["speed".to_string(), "inj".into()];
    let paths = way.paths(&channels).unwrap();
    let at = [other.values("speed").unwrap()[7], other.values("inj").unwrap()[7]];
    for (path, expected) in paths.iter().zip(&rows[14..16]) {
        assert!((path.value(&at) - expected).abs() < 1e-12);
    }
    for (i, c) in [(0, 1), (1, 0), (0, 0)] {
        let h = 1e-4 * at[c];
        let moved = |step: f64| {
            let mut row = at;
            row[c] += step;
            paths[i].value(&row)
        };
        let difference = (moved(h) - moved(-h)) / (2.0 * h);
        let found = paths[i].slope(&at, c);
        assert!(
            (found - difference).abs() <= 1e-6 * (1e-3 + difference.abs()),
            "{}: {found} and {difference}",
            channels[c]
        );
    }
    assert_eq!(way.paths(&channels[..1]).unwrap_err(), "inj");
    let lambda = way.to_user(way.from_user(1.07));
    assert!((lambda - 1.07).abs() < 1e-14);
    assert_eq!(way.changed(), ["inj", "cycle", "the output"]);
}

/// Without measured outputs the model runs from rest, and says so where another start is asked for.
#[test]
fn records_without_the_output_start_from_rest() {
    let model = model();
    let mut blind = record(4);
    blind.channels.pop();
    let fault = model.simulate(&blind, Some(Initial::Measured)).unwrap_err().to_string();
    assert!(fault.contains("no channel `lambda`") && fault.contains("rest"), "{fault}");
    let found = model.simulate(&blind, None).unwrap();
    assert!(found[0].measured.is_none() && found[0].y.iter().all(|v| v.is_finite()));
    // The same run with measured outputs in the record, also from rest.
    let seeing = model.simulate(&record(4), Some(Initial::Rest)).unwrap();
    assert_eq!(found[0].y, seeing[0].y);
}

#[test]
fn what_does_not_belong_together_is_refused_by_name() {
    let mut d = record(5);
    d.channels[1].unit = "1/s".into();
    let fault = model().simulate(&d, None).unwrap_err().to_string();
    assert_eq!(fault, "bed: `speed` is in `1/s`, the model of `phi` takes it in `rpm`");
    d.channels[1].unit = "rpm".into();
    d.sample_time_s = 0.05;
    let fault = model().simulate(&d, None).unwrap_err().to_string();
    assert!(fault.contains("0.05 s") && fault.contains("0.03 s"), "{fault}");

    let mut swapped = model();
    swapped.parameters.swap(0, 3);
    let fault = swapped.check().unwrap_err().to_string();
    assert!(fault.contains("parameter 1 is called `phi(t-1)`") && fault.contains("`inj(t-1)`"), "{fault}");
    let mut short = model();
    short.parameters.pop();
    assert!(short.fitted().unwrap_err().to_string().contains("has 3 parameters, its structure 4"));
    let mut renamed = model();
    renamed.inputs[0].name = "fuel".into();
    assert!(renamed.check().unwrap_err().to_string().contains("fuel, cycle -> phi"));
    let mut filtered = model();
    filtered.preparation[0].step = "filter".into();
    assert!(filtered.pointwise().unwrap_err().to_string().contains("`filter` does not act sample by sample"));
}

#[test]
fn leaving_the_range_of_the_estimation_is_said() {
    let model = model();
    assert!(model.outside(&record(1)).is_empty());
    let mut d = record(1);
    d.channels[0].values[..6].fill(45.0);
    let found = model.outside(&d);
    assert_eq!(found.len(), 1);
    assert!((found[0].share - 0.1).abs() < 1e-12 && found[0].found[1] == 45.0);
    assert!(found[0].sentence().starts_with("`inj` leaves what the model was identified on in 10.0 %"));
}

/// Every form is found again by its name in a file.
#[test]
fn every_kind_survives_a_file() {
    let inputs: Vec<String> = ["a", "b", "c", "d"].map(String::from).to_vec();
    for kind in MODEL_KINDS {
        let keys: toml::Table = match kind.doc.name {
            "polynomial" => "regressors = ['1', 'a(t-1)*y(t-1)']",
            "narmax" => "regressors = ['a(t-1)', 'e(t-1)']",
            "mean_of" | "best_of" => "models = [{ kind = 'gaussian_process' }, { kind = 'rbf', most = 5 }]",
            _ => "",
        }
        .parse()
        .unwrap();
        let form = (kind.build)(&keys).unwrap().form(&inputs, "y", &[]).unwrap();
        assert_eq!(form.row().name, kind.form.name, "{}", kind.doc.name);
        assert_eq!(form.dynamics().is_some(), kind.form.narx, "{}", kind.doc.name);
        let stored = dynocal_ident::model::form::AnyForm(form);
        let text = serde_json::to_string(&stored).unwrap();
        assert!(text.starts_with(&format!("{{\"kind\":\"{}\"", kind.form.name)), "{text}");
        assert_eq!(serde_json::from_str::<dynocal_ident::model::form::AnyForm>(&text).unwrap(), stored);
    }
    assert_eq!(
        forms().map(|f| f.name).collect::<Vec<_>>(),
        ["polynomial", "neural", "narmax", "linear", "response", "mean_of_networks"]
    );
    let fault =
        serde_json::from_str::<dynocal_ident::model::form::AnyForm>("{\"kind\": \"spline\"}").unwrap_err();
    assert!(
        fault
            .to_string()
            .contains("found `spline`, expected one of polynomial, neural, narmax, linear, response")
    );
}
