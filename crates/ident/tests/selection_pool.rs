//! Pools from a spec, missing samples, and the table of selection methods.

#[path = "common/cubic.rs"]
mod cubic;

use cubic::{pool, record};
use dynocal_ident::experiment::Experiment;
use dynocal_ident::select::frols::{Stop, frols};
use dynocal_ident::select::pool::{Pool, PoolKeys};
use dynocal_ident::select::{SELECTIONS, Select, SelectError};

#[test]
fn every_member_builds_from_its_documented_defaults_and_selects() {
    let (pool, data) = (pool(1, 2, 2), [record(300, 0.05, 71)]);
    for member in SELECTIONS {
        let text: String = member
            .doc
            .params
            .iter()
            .map(|p| {
                let quoted = p.default.parse::<f64>().is_err() && p.default.parse::<bool>().is_err();
                if quoted {
                    format!("{} = \"{}\"\n", p.name, p.default)
                } else {
                    format!("{} = {}\n", p.name, p.default)
                }
            })
            .collect();
        let documented = (member.build)(&toml::from_str(&text).unwrap()).unwrap();
        let plain = (member.build)(&toml::Table::new()).unwrap();
        let run = |m: &dyn Select| m.select(&pool, &data, &|| false).unwrap();
        assert_eq!(run(&*documented).path, run(&*plain).path, "{}", member.doc.name);
        assert!(run(&*plain).model.regressor_texts().contains(&"y(t-1)".to_string()), "{}", member.doc.name);
        let stopped = plain.select(&pool, &data, &|| true);
        assert!(matches!(stopped, Err(SelectError::Interrupted)), "{}", member.doc.name);
    }
    let error = dynocal_ident::select::selection("stepwize", &toml::Table::new()).err().unwrap().to_string();
    assert!(error.contains("did you mean `stepwise`?"), "{error}");
    let error =
        (SELECTIONS[3].build)(&toml::from_str("f_to_enter = 2.0\nf_to_remove = 3.0").unwrap()).err().unwrap();
    assert!(error.to_string().contains("f_to_remove is 3"), "{error}");
}

#[test]
fn samples_with_missing_values_are_left_out() {
    let mut e = record(400, 0.05, 81);
    let clean = [
        Experiment { u: e.u[..200].to_vec(), y: e.y[..200].to_vec(), ..e.clone() },
        Experiment { u: e.u[201..].to_vec(), y: e.y[201..].to_vec(), ..e.clone() },
    ];
    e.y[200] = f64::NAN;
    e.u[200] = f64::NAN;
    let pool = pool(2, 2, 2);
    // What reads sample 200 drops out: the same samples as of two records that end and begin beside it.
    let (whole, split) = (frols(pool.clone(), &[e], Stop::Terms(5)), frols(pool, &clean, Stop::Terms(5)));
    let (whole, split) = (whole.unwrap(), split.unwrap());
    for (a, b) in whole.path.iter().zip(&split.path) {
        assert_eq!(a.candidate, b.candidate);
        assert!((a.mse - b.mse).abs() <= 1e-12 * b.mse);
    }
}

#[test]
fn pools_from_a_spec() {
    let inputs = ["inj".to_string(), "spark".to_string()];
    let of = |text: &str| toml::from_str::<PoolKeys>(text).unwrap().pool(&inputs, "torque");
    let texts = |p: &Pool| (0..p.candidates().len()).map(|k| p.text(k)).collect::<Vec<_>>();
    let powers = of("ny = 1\nnu = { inj = 2 }\nnk = { inj = 3 }\ndegree = 2\ncross = false").unwrap();
    let expected = ["1", "inj(t-3)", "inj(t-4)", "torque(t-1)", "inj(t-3)^2", "inj(t-4)^2", "torque(t-1)^2"];
    assert_eq!(texts(&powers), expected);
    let more =
        of("ny = 0\nnu = 1\nnk = 0\ndegree = 2\nconstant = false\nregressors = [\"torque(t-1)\"]").unwrap();
    let expected = ["inj(t)", "spark(t)", "inj(t)^2", "inj(t)*spark(t)", "spark(t)^2", "torque(t-1)"];
    assert_eq!(texts(&more), expected);
    let shaped =
        of("ny = 1\nnu = 0\ndegree = 2\nconstant = false\nvariables = [\"sqrt(torque(t-2))\"]").unwrap();
    let expected = [
        "torque(t-1)",
        "sqrt(torque(t-2))",
        "torque(t-1)^2",
        "torque(t-1)*sqrt(torque(t-2))",
        "sqrt(torque(t-2))^2",
    ];
    assert_eq!((texts(&shaped).as_slice(), shaped.max_lag()), (&expected.map(String::from)[..], 2));
    for (text, part) in [
        ("nu = { injj = 2 }", "did you mean `inj`?"),
        ("ny = 40\nnu = 40\ndegree = 8", "expected at most 1000000"),
        ("ny = 9999999999", "longest lag is 9999999999"),
        ("degree = 0", "degree is 0, expected 1 to 12"),
        ("ny = 0\nnu = 0\nconstant = false", "no candidate for `torque`"),
        ("regressors = [\"torq(t-1)\"]", "did you mean `torque`?"),
    ] {
        let error = of(text).unwrap_err().to_string();
        assert!(error.contains(part), "{text}: {error}");
    }
    let short = [Experiment {
        name: "short".into(),
        u: vec![0.0; 24],
        y: vec![0.0; 12],
        init_samples: 0,
        weights: vec![],
    }];
    let error = frols(powers, &short, Stop::Terms(7)).unwrap_err().to_string();
    assert!(error.contains("short: 8 usable samples") || error.contains("no regressor"), "{error}");
}
