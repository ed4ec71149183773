//! Information and its gradient for every kind of model: neural, linear with denominators, polynomials with functions;
//! several experiments; several outputs.

mod common;

use std::sync::Arc;

use common::*;
use dynocal_design::channel::Channel;
use dynocal_design::information::{Report, report, sensitivities};
use dynocal_design::problem::{Convention, DesignProblem, Evaluator, Term};
use dynocal_design::search::{DesignOptions, design};
use dynocal_ident::model::kinds::kind;
use dynocal_ident::model::linear::LinearModel;
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::model::{Model, Run};
use dynocal_numerics::rng::Rng64;

/// A model with parameters at which it is stable on inputs in [-1, 1].
struct Case {
    name: &'static str,
    model: Arc<dyn Model>,
    theta: Vec<f64>,
}

fn cases() -> Vec<Case> {
    let inputs: Vec<String> = ["a", "b"].map(String::from).to_vec();
    let keys: toml::Table = "hidden = 3\ninput_lags = 2\noutput_lags = 1".parse().unwrap();
    let neural = kind("neural", &keys).unwrap().form(&inputs, "y", &[]).unwrap();
    let mut rng = Rng64::new(3);
    let drawn: Vec<f64> = (0..neural.parameters()).map(|_| rng.uniform_in(-0.6, 0.6)).collect();
    let neural = neural.driven(&drawn).unwrap().unwrap().model;
    let oe = LinearModel::oe(&["a", "b"], "y", 2, 2, 1);
    let (linear, theta) = oe.deterministic(&[0.8, 0.3, -0.5, 0.2, -0.6, 0.1, -0.4, 0.2]).unwrap();
    let texts = [
        "1",
        "sqrt(a(t-1) + 2)*b(t)",
        "abs(b(t-1) + 5)",
        "tanh(2*a(t) - 2*a(t-1))",
        "a(t-2)*y(t-1)",
        "y(t-2)",
    ];
    let functions = PolyNarx::parse(&["a", "b"], "y", &texts).unwrap();
    vec![
        Case { name: "neural", model: neural, theta: drawn },
        Case { name: "output error", model: Arc::new(linear), theta },
        Case { name: "functions", model: Arc::new(functions), theta: vec![0.5, 0.4, 0.1, 0.6, 0.2, 0.3] },
    ]
}

fn channels() -> Vec<Channel> {
    ["a", "b"].map(|name| Channel::free(name, -1.0, 1.0)).to_vec()
}

fn problem_of<'a>(terms: Vec<Term<'a>>) -> DesignProblem<'a> {
    DesignProblem { channels: channels(), n_samples: 90, convention: Convention::Hold, start: 0, terms }
}

/// S'S / sigma^2 from central differences of the free run, no sensitivity of ours involved.
fn information_by_differences(case: &Case, u: &[f64], variance: f64) -> Vec<f64> {
    let p = case.theta.len();
    let lag = case.model.max_lag();
    // Inputs stood at their first values.
    let padded: Vec<f64> = u[..2].iter().copied().cycle().take(2 * lag).chain(u.iter().copied()).collect();
    let n = padded.len() / 2;
    let free_run = |theta: &[f64]| {
        let mut y = vec![0.0; n];
        case.model.simulate(theta, &Run { u: &padded, y: &vec![0.0; n], start: lag }, &mut y);
        y.split_off(lag)
    };
    let columns: Vec<Vec<f64>> = (0..p)
        .map(|k| {
            let at = |h: f64| {
                let mut theta = case.theta.clone();
                theta[k] += h;
                free_run(&theta)
            };
            at(1e-5).iter().zip(at(-1e-5)).map(|(a, b)| (a - b) / 2e-5).collect()
        })
        .collect();
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>() / variance;
    (0..p * p).map(|i| dot(&columns[i / p], &columns[i % p])).collect()
}

#[test]
fn information_and_design_gradients_of_every_kind_of_model() {
    for case in cases() {
        let u = uniform_record(&channels(), 90, 8);
        let a = named("a");
        let p = problem_of(vec![Term::new("y", case.model.as_ref(), &case.theta, 0.3, a.as_ref())]);
        let mut e = Evaluator::new(&p).unwrap();
        let value = e.value(&u);
        assert!(value.is_finite(), "{}", case.name);
        let (l, d) = e.factors(0);
        let k = d.len();
        let expected = information_by_differences(&case, &u, 0.3);
        for i in 0..k {
            for j in 0..k {
                let m: f64 = (0..k).map(|r| l[i * k + r] * l[j * k + r]).sum::<f64>() * d[i] * d[j] / 0.3;
                let size = (expected[i * k + i] * expected[j * k + j]).sqrt();
                assert!((m - expected[i * k + j]).abs() < 1e-7 * size, "{} M[{i}, {j}]", case.name);
            }
        }
        let mut g = vec![0.0; u.len()];
        e.value_gradient(&u, 8.0, &mut g);
        for t in [0, 1, 37, 80, 120, 171] {
            let mut at = |h: f64| {
                let mut x = u.clone();
                x[t] += h;
                e.value(&x)
            };
            let fd = (8.0 * (at(1e-4) - at(-1e-4)) - (at(2e-4) - at(-2e-4))) / 12e-4;
            let size = g.iter().map(|v| v * v).sum::<f64>().sqrt();
            assert!((fd - g[t]).abs() < 1e-6 * size, "{} dJ/du[{t}]: {fd} {}", case.name, g[t]);
        }
    }
}

/// Information of the second experiment counts beside that of the first, for a network as for any other model: the
/// criterion of both together is that of the stacked rows.
#[test]
fn a_second_experiment_designed_after_the_first_adds_to_it() {
    let case = &cases()[0];
    let d = named("d");
    let lag = case.model.max_lag();
    let rows = |u: &[f64]| {
        sensitivities(case.model.as_ref(), &case.theta, u, 2, Convention::Hold, lag, 0.0).unwrap()
    };
    let first = rows(&uniform_record(&channels(), 90, 1));
    let term = Term { prior: &first, ..Term::new("y", case.model.as_ref(), &case.theta, 0.3, d.as_ref()) };
    let p = problem_of(vec![term]);
    let options = DesignOptions { evaluations: 300, ..Default::default() };
    let found = design(&p, &options, &|| false, &|_| {}).unwrap();
    let stacked = [first.clone(), rows(&found.u)].concat();
    let Report::Regular(r) = report(case.model.as_ref(), &stacked, 0.3, &[]) else { panic!("regular") };
    let expected: f64 = -r.scaled_eigenvalues.iter().map(|l| l.ln()).sum::<f64>();
    assert!((found.value - expected).abs() < 1e-7 * expected.abs(), "{} {expected}", found.value);
    assert!(found.value < found.start_value);
}

/// Two outputs of one record, each with its noise: the composite is the weighted sum of both alone.
#[test]
fn several_outputs_sum_with_their_weights_and_noise() {
    let all = cases();
    let d = named("d");
    let term = |c: &'static str, variance, weight| {
        let case = all.iter().find(|x| x.name == c).unwrap();
        Term { weight, ..Term::new(c, case.model.as_ref(), &case.theta, variance, d.as_ref()) }
    };
    let u = uniform_record(&channels(), 90, 5);
    let value = |terms| Evaluator::new(&problem_of(terms)).unwrap().value(&u);
    let (a, b) = (value(vec![term("neural", 0.1, 1.0)]), value(vec![term("functions", 2.0, 1.0)]));
    let both = value(vec![term("neural", 0.1, 0.5), term("functions", 2.0, 3.0)]);
    assert_close(both, 0.5 * a + 3.0 * b, 1e-12, "composite");
    // Noise enters as p ln sigma^2.
    let p = all[2].theta.len() as f64;
    assert_close(value(vec![term("functions", 4.0, 1.0)]), b + p * 2f64.ln(), 1e-12, "noise");
}

/// A constant input cannot tell a constant from its gain: the report says so in the names of the regressors.
#[test]
fn what_a_record_cannot_see_is_named_by_its_regressors() {
    let model = PolyNarx::parse(&["a", "b"], "y", &["1", "a(t)", "b(t)"]).unwrap();
    let mut u = uniform_record(&channels(), 40, 2);
    u.iter_mut().step_by(2).for_each(|v| *v = 0.7);
    let s = sensitivities(&model, &[1.0; 3], &u, 2, Convention::Trim, 0, 0.0).unwrap();
    let Report::Singular(found) = report(&model, &s, 1.0, &[]) else { panic!("must be singular") };
    assert_eq!((found.rank, found.unseen.len()), (2, 1));
    let names: Vec<&str> = found.unseen[0].iter().map(|p| p.parameter.as_str()).collect();
    assert!(names.contains(&"1") && names.contains(&"a(t)") && !names.contains(&"b(t)"), "{found}");
}
