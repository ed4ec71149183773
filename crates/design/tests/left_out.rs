//! Criterion `mse`: against the plain formula, its limit V, and central differences.

mod common;

use common::*;
use dynocal_design::criterion::criterion;
use dynocal_design::problem::{Convention, DesignProblem, Evaluator, Term};
use dynocal_ident::model::poly::PolyNarx;

fn keys(left_out: i64, lack: f64) -> toml::Table {
    toml::Table::from_iter([
        ("left_out".to_string(), toml::Value::Integer(left_out)),
        ("lack".to_string(), toml::Value::Float(lack)),
    ])
}

fn channels() -> Vec<dynocal_design::channel::Channel> {
    vec![dynocal_design::channel::Channel::free("u", -1.0, 1.0)]
}

/// One kept term, one left out: `y = a u + b u^2`, every moment a plain sum.
#[test]
fn one_term_left_out_is_the_plain_formula() {
    let model = PolyNarx::parse(&["u"], "y", &["u(t-1)", "u(t-1)^2"]).unwrap();
    let (u, u0) = (uniform_record(&channels(), 30, 1), uniform_record(&channels(), 50, 2));
    let (sigma2, lack) = (0.7, 2.5);
    let c = criterion("mse", &keys(1, lack)).unwrap();
    let term = Term { objective_signal: &u0, ..Term::new("y", &model, &[0.3, -0.2], sigma2, c.as_ref()) };
    let p = DesignProblem {
        channels: channels(),
        n_samples: 30,
        convention: Convention::Trim,
        start: 1,
        terms: vec![term],
    };
    let moment = |u: &[f64], k: i32| u[..u.len() - 1].iter().map(|v| v.powi(k)).sum::<f64>();
    let alias = moment(&u, 3) / moment(&u, 2);
    let bias = alias * alias * moment(&u0, 2) - 2.0 * alias * moment(&u0, 3) + moment(&u0, 4);
    let n0 = 49.0;
    let expected = sigma2 * moment(&u0, 2) / moment(&u, 2) / n0
        + lack * sigma2 / (moment(&u0, 4) - moment(&u0, 3).powi(2) / moment(&u0, 2)) * bias;
    let found = Evaluator::new(&p).unwrap().value(&u);
    assert_close(found, expected, 1e-12, "mse");
    // The objective signal as the record: the bias is the least possible one.
    let p = DesignProblem { n_samples: 50, ..p };
    let found = Evaluator::new(&p).unwrap().value(&u0);
    assert_close(found, sigma2 / n0 + lack * sigma2, 1e-12, "objective signal as record");
}

#[test]
fn nothing_left_out_is_v_and_gradients_are_exact() {
    let names = ["u"];
    let model = PolyNarx::parse(
        &names,
        "y",
        &["1", "u(t-1)", "u(t-2)", "y(t-1)", "u(t-1)^2", "u(t-1)*u(t-2)", "u(t-1)^3"],
    )
    .unwrap();
    let theta = [0.1, 1.0, 0.4, 0.5, 0.3, -0.2, 0.1];
    let (u, u0) = (uniform_record(&channels(), 40, 3), uniform_record(&channels(), 50, 4));
    let value = |c: &dyn dynocal_design::criterion::Criterion, u: &[f64], g: Option<&mut [f64]>| {
        let term = Term { objective_signal: &u0, ..Term::new("y", &model, &theta, 0.2, c) };
        let p = DesignProblem {
            channels: channels(),
            n_samples: 40,
            convention: Convention::Hold,
            start: 0,
            terms: vec![term],
        };
        let mut e = Evaluator::new(&p).unwrap();
        match g {
            Some(g) => e.value_gradient(u, 1.0, g),
            None => e.value(u),
        }
    };
    let v = named("v");
    let nothing = criterion("mse", &keys(0, 1.0)).unwrap();
    assert_close(value(nothing.as_ref(), &u, None), value(v.as_ref(), &u, None), 1e-12, "no term left out");
    for left_out in [0, 1, 3] {
        let c = criterion("mse", &keys(left_out, 3.0)).unwrap();
        let mut g = vec![0.0; 40];
        let both = value(c.as_ref(), &u, Some(&mut g));
        assert_close(both, value(c.as_ref(), &u, None), 1e-9, "value with and without gradient");
        let scale = g.iter().fold(0.0f64, |m, v| m.max(v.abs()));
        for t in 0..40 {
            let at = |h: f64| {
                let mut u = u.clone();
                u[t] += h;
                value(c.as_ref(), &u, None)
            };
            let numeric = (at(1e-6) - at(-1e-6)) / 2e-6;
            assert!((g[t] - numeric).abs() < 1e-6 * scale, "{left_out} {t}: {} {numeric}", g[t]);
        }
    }
}

#[test]
fn wrong_keys_are_refused() {
    assert!(criterion("mse", &keys(1, -1.0)).is_err());
    assert!(criterion("mse", &keys(-1, 1.0)).is_err());
}
