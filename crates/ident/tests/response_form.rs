//! Response models as the house keeps models: free run on unseen data, derivatives, the stored form.

use dynocal_ident::data::{Channel, DataError, Dataset, Role};
use dynocal_ident::estimate::estimator;
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::fitted::Fitted;
use dynocal_ident::model::kinds::kind as structure;
use dynocal_ident::model::poly::StructureError;
use dynocal_ident::model::response::form::ResponseForm;
use dynocal_ident::model::{Model, Run};
use dynocal_ident::stored::{Quantity, StoredError, StoredModel};
use dynocal_ident::validate::{Kind, Seen, score};
use dynocal_numerics::rng::Rng64;

/// `y(t) = 0.7 y(t-1) + tanh(1.5 u(t-1))` with a little noise on the output.
fn record(n: usize, seed: u64) -> Experiment {
    let mut rng = Rng64::new(seed);
    let u: Vec<f64> = (0..n)
        .scan(0.0, |level, t| {
            if t % 8 == 0 {
                *level = rng.uniform_in(-1.5, 1.5);
            }
            Some(*level)
        })
        .collect();
    let mut y = vec![0.0; n];
    (1..n).for_each(|t| y[t] = 0.7 * y[t - 1] + (1.5 * u[t - 1]).tanh());
    let mut noise = Rng64::stream(seed, 1);
    y.iter_mut().for_each(|y| *y += 0.01 * noise.normal());
    Experiment { name: format!("record {seed}"), u, y, init_samples: 0, weights: vec![] }
}

fn model(kind: &str, keys: &str) -> ResponseForm {
    let keys: toml::Table = format!("input_lags = 1\noutput_lags = 1\n{keys}").parse().unwrap();
    let form = structure(kind, &keys).unwrap().form(&["u".into()], "y", &[]).unwrap();
    let learn = estimator("learn", &toml::Table::new()).unwrap();
    let fit = learn.estimate(form.as_ref(), &[record(200, 1), record(200, 2)], None, &|| false).unwrap();
    fit.learnt.unwrap().form.form().is_a::<ResponseForm>().unwrap().clone()
}

#[test]
fn free_runs_of_all_kinds_follow_unseen_records() {
    for (kind, keys) in
        [("gaussian_process", "starts = 2"), ("local_linear", ""), ("rbf", ""), ("stepwise_polynomial", "")]
    {
        let narx = model(kind, keys);
        let run = score(&narx, &[], &[record(400, 9)], Kind::FreeRun, Seen::Unseen);
        // The record itself has noise of 0.01 on an output of about +-3.
        let limit = if kind == "stepwise_polynomial" { 0.98 } else { 0.995 };
        assert!(run.r2 > limit, "{kind}: {}", run.r2);
    }
}

#[test]
fn adjoint_and_window_derivatives_are_those_of_differences() {
    for (kind, keys) in [("gaussian_process", "starts = 1"), ("local_linear", "")] {
        let narx = model(kind, keys);
        let e = record(40, 5);
        let weights: Vec<f64> = (0..40).map(|t| (0.3 * f64::from(t)).sin()).collect();
        let value = |u: &[f64]| -> f64 {
            let mut y = vec![0.0; 40];
            narx.simulate(&[], &Run { u, y: &e.y, start: 1 }, &mut y);
            y[1..].iter().zip(&weights[1..]).map(|(y, w)| y * w).sum()
        };
        let run = Run { u: &e.u, y: &e.y, start: 1 };
        let (mut y, mut u_bar) = (vec![0.0; 40], vec![0.0; 40]);
        narx.simulate(&[], &run, &mut y);
        narx.sensitivity_adjoint(&[], &run, &y, &[], &weights, &[], &mut u_bar);
        for t in [0, 7, 20, 38, 39] {
            let at = |sign: f64| {
                let mut u = e.u.clone();
                u[t] += sign * 1e-6;
                value(&u)
            };
            let difference = (at(1.0) - at(-1.0)) / 2e-6;
            assert!(
                (u_bar[t] - difference).abs() < 1e-5 * (1.0 + difference.abs()),
                "{kind} {t}: {difference}"
            );
        }
        let (mut gradient, mut hessian, mut by_output) = (vec![0.0], vec![0.0], vec![0.0]);
        narx.window_derivatives(&[], &run, 12, &mut gradient, &mut hessian);
        narx.output_derivatives(&[], &run, 12, &mut by_output);
        let one = |du: f64, dy: f64| {
            let (mut u, mut y, mut out) = (e.u.clone(), e.y.clone(), vec![0.0; 40]);
            u[11] += du;
            y[11] += dy;
            narx.predict(&[], &Run { u: &u, y: &y, start: 1 }, &mut out);
            out[12]
        };
        let h = 1e-5;
        assert!((gradient[0] - (one(h, 0.0) - one(-h, 0.0)) / (2.0 * h)).abs() < 1e-6);
        assert!((by_output[0] - (one(0.0, h) - one(0.0, -h)) / (2.0 * h)).abs() < 1e-6);
    }
}

fn quantity(name: &str) -> Quantity {
    Quantity { name: name.into(), unit: "-".into() }
}

fn table(e: &Experiment, sample_time_s: f64) -> Dataset {
    let channel = |name: &str, role, values: &[f64]| Channel {
        name: name.into(),
        unit: "-".into(),
        role,
        values: values.to_vec(),
    };
    Dataset {
        name: "points".into(),
        sample_time_s,
        channels: vec![channel("u", Role::Input, &e.u), channel("y", Role::Output, &e.y)],
        init_samples: 0,
        origin: "test".into(),
    }
}

/// The one stored form: what is read back gives the same bytes of output, lagged or steady.
#[test]
fn a_stored_response_model_runs_again() {
    let lagged = model("gaussian_process", "starts = 1");
    let e = record(60, 3);
    let stored = StoredModel::new(lagged, &[], vec![quantity("u")], quantity("y"), 0.1).unwrap();
    let again: StoredModel = serde_json::from_str(&serde_json::to_string(&stored).unwrap()).unwrap();
    assert_eq!(again, stored);
    let run = |m: &StoredModel| m.simulate(&table(&e, 0.1), None).unwrap()[0].y.clone();
    assert_eq!(run(&again), run(&stored));
    assert!(!again.is_steady());
    let fault = again.simulate(&table(&e, 0.2), None).unwrap_err();
    assert!(matches!(fault, StoredError::Data(DataError::SampleTime { .. })), "{fault}");
}

/// Present values alone: rows in any order, and a sample time of its own, change nothing.
#[test]
fn a_steady_model_knows_no_time() {
    let form = structure("rbf", &toml::Table::new()).unwrap().form(&["u".into()], "y", &[]).unwrap();
    let mut rng = Rng64::new(5);
    let u: Vec<f64> = (0..80).map(|_| rng.uniform_in(-1.0, 1.0)).collect();
    let y = u.iter().map(|u| (3.0 * u).sin()).collect();
    let e = Experiment { name: "points".into(), u, y, init_samples: 0, weights: vec![] };
    let learn = estimator("learn", &toml::Table::new()).unwrap();
    let fit = learn.estimate(form.as_ref(), std::slice::from_ref(&e), None, &|| false).unwrap();
    let learnt = fit.learnt.unwrap().form.form().is_a::<ResponseForm>().unwrap().clone();
    assert!(learnt.is_steady() && learnt.names() == ["u"]);
    let stored = StoredModel::new(learnt, &[], vec![quantity("u")], quantity("y"), 1.0).unwrap();
    let y = stored.simulate(&table(&e, 0.5), None).unwrap()[0].y.clone();
    assert!(y.iter().zip(&e.y).all(|(a, b)| (a - b).abs() < 0.02));
    let reversed = Experiment {
        u: e.u.iter().rev().copied().collect(),
        y: e.y.iter().rev().copied().collect(),
        ..e.clone()
    };
    let mut back = stored.simulate(&table(&reversed, 7.0), None).unwrap()[0].y.clone();
    back.reverse();
    assert_eq!(back, y);
    // Without the output there is nothing to start from, and nothing that would need it.
    let mut inputs = table(&e, 1.0);
    inputs.channels.truncate(1);
    assert_eq!(stored.simulate(&inputs, None).unwrap()[0].y, y);
}

#[test]
fn what_has_not_been_learnt_is_not_run() {
    let form = structure("rbf", &toml::Table::new()).unwrap().form(&["u".into()], "y", &[]).unwrap();
    let bare = form.is_a::<ResponseForm>().unwrap().clone();
    let fault = Fitted::new(bare, vec![]).unwrap_err();
    assert_eq!(fault, StructureError::NotLearnt { output: "y".into(), kind: "rbf".into() });
}

#[test]
fn samples_without_weight_or_value_are_no_points() {
    let keys: toml::Table = "input_lags = 2".parse().unwrap();
    let form = structure("rbf", &keys).unwrap().form(&["u".into()], "y", &[]).unwrap();
    let form = form.is_a::<ResponseForm>().unwrap();
    let mut e = record(20, 1);
    e.weights = vec![1.0; 20];
    e.weights[7] = 0.0;
    e.y[9] = f64::NAN;
    let points = form.points(&[e.clone()]).unwrap();
    // The first two samples only fill the lags.
    assert_eq!((points.len(), points.inputs.clone()), (16, vec!["u(t-1)".to_string(), "u(t-2)".to_string()]));
    assert_eq!(points.row(0), [e.u[1], e.u[0]]);
    let short = Experiment { u: vec![1.0; 7], ..e };
    assert!(form.points(&[short]).is_err());
}
