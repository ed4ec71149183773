//! Response models of one step as dynamic models: free run on unseen data and derivatives.

use dynocal_ident::estimate::estimator;
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::fitted::Fitted;
use dynocal_ident::model::kinds::kind as structure;
use dynocal_ident::model::response::form::ResponseForm;
use dynocal_ident::model::{Model, Run};
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
