//! The upper bound on what any record tells: equal to known optima, never passed by a record, refused where it has no
//! ground.

mod common;

use common::*;
use dynocal_design::certificate::{Certificate, NoCertificate, certify};
use dynocal_design::channel::Channel;
use dynocal_design::problem::{Convention, DesignProblem, Evaluator, OutputLimits, Term};
use dynocal_design::search::{DesignOptions, design};
use dynocal_ident::model::poly::PolyNarx;

fn one<'a>(channels: Vec<Channel>, n: usize, start: usize, term: Term<'a>) -> DesignProblem<'a> {
    DesignProblem { channels, n_samples: n, convention: Convention::Trim, start, terms: vec![term] }
}

fn bound(problem: &DesignProblem) -> Certificate {
    certify(problem, 0.0).unwrap()
}

/// Example 1 of the thesis: three taps, |u| <= 10. The information is at most 100 per row and tap and uncorrelated, so
/// that the bound is -3 ln(100 N), the same matrix that gives its bound 3 / (100 N) of J_A; binary records come close.
#[test]
fn example_1_has_its_known_bound_and_a_design_reaches_it_nearly() {
    let fir = PolyNarx::parse(&["u"], "y", &["u(t-1)", "u(t-2)", "u(t-3)"]).unwrap();
    let d = named("d");
    let p = one(
        vec![Channel::free("u", -10.0, 10.0)],
        100,
        3,
        Term::new("y", &fir, &[1.0, 0.5, 0.2], 1.0, d.as_ref()),
    );
    let options = DesignOptions { certify: true, evaluations: 3000, ..Default::default() };
    let found = design(&p, &options, &|| false, &|_| {}).unwrap();
    let c = found.certificate.unwrap().unwrap();
    assert_close(c.bound, -3.0 * 9700f64.ln(), 1e-10, "bound");
    assert_eq!((c.feedback, c.windows, c.value), (0.0, 8, found.value));
    assert!(c.efficiency > 0.99 && c.efficiency <= 1.0, "{c:?}");
}

/// Quadratic regression on [-1, 1]: a third of the weight at -1, 0 and 1, `det M = 4/27 N^3` (Smith 1918). The squared
/// sample is bounded through triangles, so that the bound lies a little beyond.
#[test]
fn quadratic_regression_has_its_textbook_optimum() {
    let model = PolyNarx::parse(&["u"], "y", &["1", "u(t)", "u(t)^2"]).unwrap();
    let d = named("d");
    let channels = vec![Channel::free("u", -1.0, 1.0)];
    let p = one(channels, 60, 0, Term::new("y", &model, &[0.0; 3], 1.0, d.as_ref()));
    let exact = -(4.0 / 27.0 * 60f64.powi(3)).ln();
    let c = bound(&p);
    assert!(c.bound <= exact + 1e-9 && c.bound > exact - 0.1, "{c:?} against {exact}");
    // Twenty rows at each point reach it.
    let u: Vec<f64> = (0..60).map(|t| [-1.0, 0.0, 1.0][t % 3]).collect();
    assert_close(Evaluator::new(&p).unwrap().value(&u), exact, 1e-12, "J_D of the optimum");
}

/// A recursion that periodic inputs excite in resonance: records of every kind stay on their side of the bound.
#[test]
fn no_record_passes_the_bound_of_a_recursive_model() {
    let model = PolyNarx::parse(&["u"], "y", &["u(t-1)", "u(t-2)*u(t-1)", "y(t-1)", "y(t-2)"]).unwrap();
    let theta = [0.8, 0.1, 0.5, -0.3];
    let d = named("d");
    let prior = [3.0, 0.0, 0.5, 0.1, 0.0, 2.0, 0.1, 0.4];
    for prior in [&[][..], &prior] {
        let term = Term { prior, ..Term::new("y", &model, &theta, 0.5, d.as_ref()) };
        let p = one(vec![Channel::free("u", -1.0, 2.0)], 60, 2, term);
        let c = bound(&p);
        let mut e = Evaluator::new(&p).unwrap();
        let mut rng = dynocal_numerics::rng::Rng64::new(5);
        let mut best = f64::INFINITY;
        for k in 0..2000 {
            let period = 2 + rng.below(12);
            let binary: Vec<f64> = (0..period).map(|_| [-1.0, 2.0][rng.below(2)]).collect();
            let u: Vec<f64> = (0..60)
                .map(|t| if k % 2 == 0 { binary[t % period] } else { [-1.0, 2.0][rng.below(2)] })
                .collect();
            best = best.min(e.value(&u));
        }
        let found = design(&p, &DesignOptions::default(), &|| false, &|_| {}).unwrap().value;
        assert!(c.bound <= found.min(best), "{c:?} passed by {found} or {best}");
        assert!(c.feedback > 0.0);
    }
}

/// The model of lambda (no recursion) in the box of chapter 4: the design is within 10 % of what no record can beat.
#[test]
fn a_lambda_design_states_a_high_efficiency() {
    let model = chapter_4_model("lambda");
    let d = named("d");
    let p = problem(term(&model, d.as_ref(), &[], &[]), 100, Convention::Trim);
    let options = DesignOptions { certify: true, ..Default::default() };
    let found = design(&p, &options, &|| false, &|_| {}).unwrap();
    let c = found.certificate.unwrap().unwrap();
    println!("{c:?}");
    assert!(c.bound <= found.value && c.efficiency > 0.9 && c.feedback == 0.0, "{c:?}");
}

#[test]
fn problems_without_a_bound_say_why() {
    let (d, ai) = (named("d"), named("ai"));
    let u = || vec![Channel::free("u", -1.0, 1.0)];
    let reason = |texts: &[&str], theta: &[f64]| {
        let m = PolyNarx::parse(&["u"], "y", texts).unwrap();
        let p = one(u(), 50, 3, Term::new("y", &m, theta, 1.0, d.as_ref()));
        certify(&p, 0.0).unwrap_err().to_string()
    };
    assert!(reason(&["u(t)^3", "1"], &[1.0; 2]).contains("u(t)^3"));
    assert!(reason(&["abs(u(t))", "1"], &[1.0; 2]).contains("not a polynomial"));
    assert!(reason(&["u(t)*y(t-1)", "1"], &[0.1; 2]).contains("feeds the output back in a product"));
    assert!(reason(&["u(t)", "y(t-1)"], &[1.0, 1.1]).contains("sum to 1.1"));
    let many: Vec<String> = (0..40).map(|k| format!("u(t-{k})")).collect();
    let many: Vec<&str> = many.iter().map(String::as_str).collect();
    assert!(reason(&many, &[0.1; 40]).contains("40 samples per window"));
    let model = chapter_4_model("torque");
    let (u0, _) = core();
    let p = problem(term(&model, ai.as_ref(), &u0, &[]), 100, Convention::Trim);
    assert!(matches!(certify(&p, 0.0), Err(NoCertificate::Criterion { .. })));
    let limits = OutputLimits { lower: 0.0, upper: 1.0, margin: 0.0 };
    let two = Term { limits: Some(limits), ..term(&model, d.as_ref(), &[], &[]) };
    let mut p = problem(two, 100, Convention::Trim);
    p.terms.push(two);
    assert!(certify(&p, 0.0).unwrap_err().to_string().contains("several models"));
}
