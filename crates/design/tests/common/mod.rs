//! What the tests of this crate share: the chapter 4 models and the reference folder.
#![allow(dead_code, unreachable_pub)]

use dynocal_design::channel::Channel;
use dynocal_design::criterion::{Criterion, criterion};
use dynocal_design::problem::{Convention, DesignProblem, Term};
use dynocal_ident::model::Model;
use dynocal_ident::model::literature::{LiteratureModel, lambda_4_53, torque_4_17};
use dynocal_numerics::rng::Rng64;
use serde_json::Value;
use std::path::PathBuf;

pub fn reference_dir() -> Option<PathBuf> {
    let dir = std::env::var_os("DYNOCAL_REFERENCE_DIR").map(PathBuf::from);
    if dir.is_none() {
        println!("SKIPPED: DYNOCAL_REFERENCE_DIR is not set");
    }
    dir
}

pub fn json(path: PathBuf) -> Value {
    serde_json::from_str(&std::fs::read_to_string(&path).unwrap()).unwrap()
}

pub fn numbers(v: &Value) -> Vec<f64> {
    v.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect()
}

/// The reduced reference that lies in the repository: signal U0 and its values.
pub fn core() -> (Vec<f64>, Value) {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../tests/reference/design_u0.json");
    let v = json(path);
    let u = v["u"].as_array().unwrap().iter().flat_map(numbers).collect();
    (u, v)
}

pub fn csv(path: PathBuf) -> Vec<f64> {
    let text = std::fs::read_to_string(path).unwrap();
    text.lines().skip(1).flat_map(|l| l.split(',').map(|x| x.trim().parse::<f64>().unwrap())).collect()
}

/// Box (4.16) with the speed range of section 4.6.
pub fn chapter_4_box() -> Vec<Channel> {
    vec![
        Channel::free("fpw", 2000.0, 6000.0),
        Channel::free("abv", 0.4, 0.6),
        Channel::free("speed", 1000.0, 2000.0),
    ]
}

pub fn uniform_record(channels: &[Channel], n: usize, seed: u64) -> Vec<f64> {
    let mut g = Rng64::new(seed);
    (0..n).flat_map(|_| channels.iter().map(|c| g.uniform_in(c.lower, c.upper)).collect::<Vec<_>>()).collect()
}

pub fn chapter_4_model(name: &str) -> LiteratureModel {
    if name == "lambda" { lambda_4_53() } else { torque_4_17() }
}

pub fn named(name: &str) -> Box<dyn Criterion> {
    criterion(name, &Default::default()).unwrap()
}

/// A one-model problem in the box (4.16).
pub fn problem<'a>(term: Term<'a>, n: usize, convention: Convention) -> DesignProblem<'a> {
    DesignProblem { channels: chapter_4_box(), n_samples: n, convention, start: 10, terms: vec![term] }
}

pub fn term<'a>(
    model: &'a LiteratureModel,
    criterion: &'a dyn Criterion,
    u0: &'a [f64],
    scale: &'a [f64],
) -> Term<'a> {
    Term {
        objective_signal: u0,
        reference_scale: scale,
        ..Term::new("y", &model.model as &dyn Model, &model.theta, model.noise_variance, criterion)
    }
}

pub fn assert_close(found: f64, expected: f64, relative: f64, what: &str) {
    assert!(
        (found - expected).abs() <= relative * expected.abs(),
        "{what}: found {found}, expected {expected}"
    );
}
