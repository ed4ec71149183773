//! Gradients of every criterion against central differences; conventions, priors, several models.

mod common;

use common::*;
use dynocal_design::criterion::CRITERIA;
use dynocal_design::problem::{Convention, DesignProblem, Evaluator, Term};

/// Directional derivatives along ten random directions, against central differences refined by Richardson.
fn check(problem: &DesignProblem, sharpness: f64, seed: u64, what: &str) {
    let mut e = Evaluator::new(problem).unwrap();
    let n = problem.n_samples * problem.channels.len();
    let u = uniform_record(&problem.channels, problem.n_samples, seed);
    let (mut g, mut none) = (vec![0.0; n], vec![0.0; n]);
    let value = e.value_gradient(&u, sharpness, &mut g);
    assert!(value.is_finite(), "{what}: {value}");
    let mut rng = dynocal_numerics::rng::Rng64::new(seed + 100);
    for _ in 0..10 {
        let d: Vec<f64> = (0..n)
            .map(|k| {
                let c = &problem.channels[k % problem.channels.len()];
                (c.upper - c.lower) * rng.normal()
            })
            .collect();
        let mut difference = |h: f64| {
            let mut at = |h: f64| {
                let x: Vec<f64> = u.iter().zip(&d).map(|(u, d)| u + h * d).collect();
                e.value_gradient(&x, sharpness, &mut none)
            };
            (at(h) - at(-h)) / (2.0 * h)
        };
        let h = 2e-4;
        let fd = (4.0 * difference(h / 2.0) - difference(h)) / 3.0;
        let exact: f64 = g.iter().zip(&d).map(|(a, b)| a * b).sum();
        let size: f64 = g.iter().zip(&d).map(|(a, b)| (a * b).powi(2)).sum::<f64>().sqrt();
        assert!((fd - exact).abs() <= 1e-6 * size.max(exact.abs()), "{what}: {fd} {exact} ({size})");
    }
}

#[test]
fn every_criterion_under_every_convention() {
    let (u0, root) = core();
    for kind in ["torque", "lambda"] {
        let model = chapter_4_model(kind);
        let scale = numbers(&root[format!("c_{kind}")]);
        for member in CRITERIA {
            let c = named(member.doc.name);
            for convention in [Convention::Trim, Convention::Hold, Convention::Zero] {
                let p = problem(term(&model, c.as_ref(), &u0, &scale), 100, convention);
                check(&p, 6.0, 3, &format!("{kind} {} {convention:?}", member.doc.name));
            }
        }
    }
}

#[test]
fn several_models_and_prior_rows() {
    let (u0, _) = core();
    let (torque, lambda) = (chapter_4_model("torque"), chapter_4_model("lambda"));
    let ai = named("ai");
    let prior = dynocal_design::information::sensitivities(
        &torque.model,
        &torque.theta,
        &u0,
        3,
        Convention::Trim,
        10,
        0.0,
    )
    .unwrap();
    let t = Term { weight: 1.0 / 1.8109e6, prior: &prior, ..term(&torque, ai.as_ref(), &u0, &[]) };
    let l = Term { weight: 2.0 / 3945.2, ..term(&lambda, ai.as_ref(), &u0, &[]) };
    let mut p = problem(t, 60, Convention::Trim);
    p.terms.push(l);
    check(&p, 6.0, 5, "composite with prior");
}

/// Information of two records adds up: the prior rows of one and the record of the other give the criterion of
/// both as one (trim, so that neither sees the other's inputs); the triangular factor tells as much as the rows.
#[test]
fn prior_information_adds_up() {
    let (u0, _) = core();
    let model = chapter_4_model("torque");
    let d = named("d");
    let prior = |u: &[f64]| {
        dynocal_design::information::sensitivities(
            &model.model,
            &model.theta,
            u,
            3,
            Convention::Trim,
            10,
            0.0,
        )
        .unwrap()
    };
    let u1 = uniform_record(&chapter_4_box(), 100, 1);
    let with = |prior: &[f64], u: &[f64]| {
        let t = Term { prior, ..term(&model, d.as_ref(), &u0, &[]) };
        let p = problem(t, 100, Convention::Trim);
        let mut e = Evaluator::new(&p).unwrap();
        let value = e.value(u);
        let (l, scale) = e.factors(0);
        let k = scale.len();
        let rows: Vec<f64> = (0..k * k).map(|i| l[(i % k) * k + i / k] * scale[i % k]).collect();
        (value, rows)
    };
    let (a, _) = with(&prior(&u0), &u1);
    let (b, _) = with(&prior(&u1), &u0);
    assert_close(a, b, 1e-12, "order of records");
    let (_, r) = with(&[], &u0);
    let (c, _) = with(&r, &u1);
    assert_close(a, c, 1e-11, "triangular factor as prior");
    // M doubles when a record is repeated: ln det grows by p ln 2.
    let (one, _) = with(&[], &u0);
    let (two, _) = with(&prior(&u0), &u0);
    assert!((one - two - 23.0 * 2f64.ln()).abs() < 1e-9);
}

#[test]
fn i_of_a_signal_on_itself_is_sigma2_p() {
    // J_I of a signal on itself is sigma^2 p exactly, whatever the signal (trace of a projection).
    let model = chapter_4_model("lambda");
    let i = named("i");
    for seed in 0..3 {
        let u = uniform_record(&chapter_4_box(), 100, seed);
        let p = problem(term(&model, i.as_ref(), &u, &[]), 100, Convention::Trim);
        assert_close(Evaluator::new(&p).unwrap().value(&u), 0.04 * 21.0, 1e-10, "J_I of itself");
    }
}
