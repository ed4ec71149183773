//! Criterion values, bounds, eigenvalues and sensitivities against 50-digit references.

mod common;

use common::*;
use dynocal_design::information::{Report, report, simulate};
use dynocal_design::problem::{Convention, Evaluator};
use serde_json::Value;

fn convention(case: &str) -> Convention {
    match case.rsplit('_').next() {
        Some("hold") => Convention::Hold,
        Some("zero") => Convention::Zero,
        _ => Convention::Trim,
    }
}

/// Every number of one entry of the reference.
fn check_case(root: &Value, signal: &str, case: &str, u: &[f64], u0: &[f64]) {
    let v = &root["values"][signal][case];
    let kind = case.split('_').next().unwrap();
    let model = chapter_4_model(kind);
    let scale = numbers(&root[format!("c_{kind}")]);
    assert_eq!(model.noise_variance, root["sigma2"][kind].as_f64().unwrap());
    let conv = convention(case);
    let (y, s) = simulate(&model.model, &model.theta, u, 3, conv, 10, 0.0).unwrap();
    let at = format!("{signal} {case}");
    if v.get("singular").is_some() {
        let Report::Singular(found) = report(&model.model, &s, model.noise_variance, &scale) else {
            panic!("{at}: not reported as singular")
        };
        assert_eq!(found.rank, v["rank"].as_u64().unwrap() as usize, "{at}: {found}");
        assert_eq!(found.unseen.len(), found.p - found.rank);
        return;
    }
    for (key, name) in [
        ("JD", "d"),
        ("JA", "a"),
        ("JWA", "wa"),
        ("JI", "i"),
        ("JG", "g"),
        ("JAI", "ai"),
        ("JE", "e"),
        ("JV", "v"),
    ] {
        let c = named(name);
        let p = problem(term(&model, c.as_ref(), u0, &scale), 100, conv);
        let found = Evaluator::new(&p).unwrap().value(u);
        let expected = match key {
            "JE" => 1.0 / v["JE_scaled_lambda_min"].as_f64().unwrap(),
            "JV" => v["JI"].as_f64().unwrap() / (y.len() as f64),
            k => v[k].as_f64().unwrap(),
        };
        assert_close(found, expected, 1e-9, &format!("{at} {key}"));
    }
    let Report::Regular(found) = report(&model.model, &s, model.noise_variance, &scale) else {
        panic!("{at}: reported as singular")
    };
    for (key, list) in [("crlb_std", &found.crlb_std), ("fim_scaled_eigenvalues", &found.scaled_eigenvalues)]
    {
        for (k, e) in numbers(&v[key]).iter().enumerate() {
            assert_close(list[k], *e, 1e-9, &format!("{at} {key} {k}"));
        }
    }
    let first = if conv == Convention::Trim { 10 } else { 0 };
    for (t, row) in v["sens_raw"].as_object().unwrap() {
        let t = t.parse::<usize>().unwrap() - 1 - first;
        for (k, e) in numbers(row).iter().enumerate() {
            let p = scale.len();
            assert!((s[t * p + k] - e).abs() <= 1e-12 * (scale[k] + e.abs()), "{at} s[{t}, {k}]");
        }
    }
    let sum: f64 = y.iter().sum();
    assert!((sum - v["y_sum"].as_f64().unwrap()).abs() < 1e-9, "{at}: sum of outputs {sum}");
}

#[test]
fn core_reference_of_u0() {
    let (u0, root) = core();
    for case in ["torque_trim", "lambda_trim"] {
        check_case(&root, "U0_aprbs", case, &u0, &u0);
    }
}

#[test]
fn every_reference_case() {
    let Some(dir) = reference_dir() else { return };
    let dir = dir.join("reference");
    let root = json(dir.join("design_reference.json"));
    let u0 = csv(dir.join("design_inputs/U0_aprbs.csv"));
    let mut cases = 0;
    for (signal, list) in root["values"].as_object().unwrap() {
        let u = csv(dir.join(format!("design_inputs/{signal}.csv")));
        for case in list.as_object().unwrap().keys() {
            check_case(&root, signal, case, &u, &u0);
            cases += 1;
        }
    }
    assert_eq!(cases, 20);
}

/// Two levels cannot tell u1^2 from u1 and the constant: the report must say so in these words.
#[test]
fn a_two_level_signal_is_singular_and_the_report_names_the_square() {
    let model = chapter_4_model("torque");
    let mut g = dynocal_numerics::rng::Rng64::new(11);
    let u: Vec<f64> =
        (0..300).map(|k| [[2000.0, 6000.0], [0.4, 0.6], [1000.0, 2000.0]][k % 3][g.below(2)]).collect();
    let (_, s) = simulate(&model.model, &model.theta, &u, 3, Convention::Trim, 10, 0.0).unwrap();
    let Report::Singular(found) = report(&model.model, &s, 80.0, &[]) else { panic!("must be singular") };
    assert!(found.rank < found.p);
    let text = found.to_string();
    assert!(text.contains("^2"), "{text}");
    let c = named("ai");
    let (u0, _) = core();
    let p = problem(term(&model, c.as_ref(), &u0, &[]), 100, Convention::Trim);
    assert!(Evaluator::new(&p).unwrap().value(&u).is_infinite(), "singular is no number");
}
