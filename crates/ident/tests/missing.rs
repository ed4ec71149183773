//! Missing samples on records whose full content is known.

mod common;

use common::systems::{System, simulate};
use dynocal_ident::estimate::initial::FreeStates;
use dynocal_ident::estimate::missing::Missing;
use dynocal_ident::estimate::pem::Pem;
use dynocal_ident::experiment::Experiment;
use dynocal_ident::linear::fit_linear;
use dynocal_ident::model::linear::LinearModel;
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::model::{Model, Run};
use dynocal_ident::validate::{Kind, Seen};
use dynocal_numerics::rng::Rng64;

fn armax() -> System {
    System {
        model: LinearModel::armax(&["u"], "y", 2, 2, 1, 1),
        theta: vec![-1.5, 0.7, 1.0, 0.5, 0.5],
        noise_std: 0.5,
        feedback: 0.0,
    }
}

/// Removes a share of the outputs at random.
fn without_outputs(e: &Experiment, share: f64, seed: u64) -> Experiment {
    let mut rng = Rng64::stream(77, seed);
    let mut holed = e.clone();
    holed.y.iter_mut().for_each(|y| {
        if rng.uniform() < share {
            *y = f64::NAN;
        }
    });
    holed
}

/// With a tenth of the outputs and one long gap removed the estimate stays within its standard errors of that of the
/// full record, and the removed samples are found within theirs.
#[test]
fn missing_outputs_are_states() {
    let s = armax();
    let e = simulate(&s, 2000, 5);
    let mut holed = without_outputs(&e, 0.1, 0);
    holed.y[900..925].fill(f64::NAN);
    let full = Pem::default().estimate(&s.model, std::slice::from_ref(&e), None, &|| false).unwrap();
    let data = [holed];
    let found = fit_linear(&s.model, &data, &Pem::default(), &|| false).unwrap();
    let fit = &found.fit;
    assert_eq!(fit.samples, 2000 - Missing::of(&data[0]).outputs.len());
    for k in 0..s.theta.len() {
        assert!((fit.theta[k] - full.theta[k]).abs() < fit.std_errors[k], "{}", fit.names[k]);
        assert!(fit.std_errors[k] > full.std_errors[k], "{}: less data, more certain", fit.names[k]);
    }
    assert!((fit.noise_variance / full.noise_variance - 1.0).abs() < 0.1);
    assert_eq!(found.recovered.len(), 2000 - fit.samples);
    let squares: Vec<f64> =
        found.recovered.iter().map(|r| ((r.value - e.y[r.sample]) / r.std_error).powi(2)).collect();
    let (n, mean) = (squares.len() as f64, squares.iter().sum::<f64>() / squares.len() as f64);
    // Neighbours in the long gap are correlated: five standard errors of independent squares.
    assert!(
        (mean - 1.0).abs() < 5.0 * (2.0 / n).sqrt(),
        "mean square {mean} of {n} in units of the standard error"
    );
    // Scores skip what is not there.
    let score = found.score(&data, Kind::OneStep, Seen::Identification);
    assert_eq!(score.samples, fit.samples);
    // A missing output is replaced by its own prediction, which costs something in the samples after it.
    let free_run = found.score(&data, Kind::FreeRun, Seen::Identification);
    assert!(score.mse > 0.2 && score.mse < 0.5 * free_run.mse, "{} and {}", score.mse, free_run.mse);
}

/// The criterion is the likelihood of the observed samples: against the closed form for an autoregression of order one,
/// where the error over a gap of k samples has the variance (1 - a^2k) / (1 - a^2).
#[test]
fn likelihood_of_a_first_order_autoregression() {
    let model = LinearModel::arma("y", 0, 1);
    let mut rng = Rng64::new(3);
    let n = 400;
    let mut y = vec![0.0; n];
    y[0] = rng.normal();
    (1..n).for_each(|t| y[t] = 0.85 * y[t - 1] + rng.normal());
    let e = without_outputs(
        &Experiment { name: "ar".into(), u: vec![], y, init_samples: 0, weights: vec![] },
        0.4,
        1,
    );
    let closed_form = |a: f64| {
        let (mut last, mut value, mut sum, mut log, mut count) = (-1_i32, 0.0, 0.0, 0.0, 0.0);
        for (t, y) in e.y.iter().enumerate().filter(|(_, y)| !y.is_nan()) {
            let k = t as i32 - last;
            let variance = (1.0 - a.powi(2 * k)) / (1.0 - a * a);
            sum += (y - a.powi(k) * value).powi(2) / variance;
            log += variance.ln();
            count += 1.0;
            (last, value) = (t as i32, *y);
        }
        sum * f64::exp(log / count)
    };
    let fit = Pem::default().estimate(&model, std::slice::from_ref(&e), None, &|| false).unwrap();
    let a = -fit.theta[0];
    let found = fit.history.last().unwrap().objective;
    let expected = closed_form(a);
    assert!((found - expected).abs() < 1e-9 * expected, "{found} against {expected}");
    for step in [-1e-4, 1e-4] {
        assert!(closed_form(a + step) > expected, "the minimum of the closed form is elsewhere than {a}");
    }
}

/// Over many records with a fifth of the outputs missing the mean error is nought within its standard error, and the
/// stated standard errors are the observed spread.
#[test]
fn estimates_with_missing_outputs_are_unbiased() {
    let s = armax();
    let (runs, p) = (60_u64, s.theta.len());
    let errors: Vec<Vec<f64>> = (0..runs)
        .map(|seed| {
            let data = [without_outputs(&simulate(&s, 400, 100 + seed), 0.2, seed)];
            let fit = Pem::default().estimate(&s.model, &data, None, &|| false).unwrap();
            (0..p).map(|k| (fit.theta[k] - s.theta[k]) / fit.std_errors[k]).collect()
        })
        .collect();
    for k in 0..p {
        let mean = errors.iter().map(|e| e[k]).sum::<f64>() / runs as f64;
        let square = errors.iter().map(|e| e[k] * e[k]).sum::<f64>() / runs as f64;
        // A bias of second order in 1/N is there with full records too.
        assert!(mean.abs() < 5.0 / (runs as f64).sqrt(), "parameter {k}: mean error {mean} standard errors");
        assert!((0.6..1.7).contains(&square), "parameter {k}: mean square {square}");
    }
}

/// Missing inputs of an output-error model are parameters.
#[test]
fn missing_inputs_are_found() {
    let s = System {
        model: LinearModel::oe(&["u"], "y", 1, 1, 1),
        theta: vec![1.0, -0.8],
        noise_std: 0.2,
        feedback: 0.0,
    };
    let e = simulate(&s, 800, 11);
    let mut holed = e.clone();
    for t in (20..780).step_by(41) {
        holed.u[t] = f64::NAN;
    }
    holed.u[799] = f64::NAN; // acts after the record
    let found = fit_linear(&s.model, &[holed], &Pem::default(), &|| false).unwrap();
    for k in 0..2 {
        assert!((found.fit.theta[k] - s.theta[k]).abs() < 4.0 * found.fit.std_errors[k]);
    }
    for r in &found.recovered {
        if r.sample == 799 {
            assert!(r.std_error.is_nan() || r.std_error > 10.0, "an input without effect has no estimate");
            continue;
        }
        assert!(
            (r.value - e.u[r.sample]).abs() < 4.5 * r.std_error,
            "sample {}: {} of {}",
            r.sample,
            r.value,
            e.u[r.sample]
        );
        assert!(r.std_error < 0.3);
    }
}

/// The same for the free run of a polynomial model: missing outputs weigh nothing, missing inputs are parameters.
#[test]
fn a_polynomial_model_with_gaps() {
    let model = PolyNarx::parse(&["u"], "y", &["1", "u(t-1)", "u(t-2)^2", "y(t-1)"]).unwrap();
    let truth = [0.2, 1.0, 0.5, 0.7];
    let mut rng = Rng64::new(4);
    let n = 600;
    let u: Vec<f64> = (0..n).map(|_| rng.uniform_in(0.5, 2.0)).collect();
    let mut y = vec![0.0; n];
    model.simulate(&truth, &Run { u: &u, y: &vec![0.0; n], start: 2 }, &mut y);
    y.iter_mut().for_each(|v| *v += 0.05 * rng.normal());
    let mut e = without_outputs(
        &Experiment { name: "gaps".into(), u: u.clone(), y, init_samples: 0, weights: vec![] },
        0.1,
        2,
    );
    for t in (15..580).step_by(37) {
        e.u[t] = f64::NAN;
    }
    let found = FreeStates::default().estimate(&model, &[e], None, &|| false).unwrap();
    for k in 0..4 {
        let off = (found.fit.theta[k] - truth[k]).abs() / found.fit.std_errors[k];
        assert!(off < 4.0, "{}: off by {off} standard errors", found.fit.names[k]);
    }
    for r in &found.recovered {
        assert!(
            (r.value - u[r.sample]).abs() < 4.5 * r.std_error,
            "sample {}: {} of {}",
            r.sample,
            r.value,
            u[r.sample]
        );
    }
}

#[test]
fn channels_without_samples_and_too_many_gaps_are_named() {
    let s = armax();
    let mut e = simulate(&s, 300, 1);
    let pem = |e: &Experiment| Pem::default().estimate(&s.model, std::slice::from_ref(e), None, &|| false);
    e.y.fill(f64::NAN);
    let text = pem(&e).unwrap_err().to_string();
    assert!(text.contains("every sample of `y` is missing"), "{text}");
    let mut e = simulate(&s, 300, 1);
    e.u.fill(f64::NAN);
    let text = pem(&e).unwrap_err().to_string();
    assert!(text.contains("every sample of `u` is missing"), "{text}");
    let mut e = simulate(&s, 6000, 1);
    e.y.iter_mut().step_by(2).for_each(|y| *y = f64::NAN);
    let text = pem(&e).unwrap_err().to_string();
    assert!(text.contains("3000 missing") && text.contains("2000"), "{text}");
}
