//! Optimality conditions of the criteria that have no gradient at their minima.

mod common;

use common::*;
use dynocal_design::problem::{Convention, Evaluator};
use dynocal_design::search::{DesignOptions, design, random_record};
use dynocal_design::stationarity::stationarity;

/// Designs under G and E are stationary: a convex combination of the gradients of their active pieces vanishes up to
/// what the bounds take; random records are not, and where a single piece is active its slope is the whole residual.
#[test]
fn designs_under_g_and_e_meet_their_optimality_conditions_and_random_records_do_not() {
    let (u0, root) = core();
    let model = chapter_4_model("torque");
    let scale = numbers(&root["c_torque"]);
    for name in ["g", "e"] {
        let c = named(name);
        let p = problem(term(&model, c.as_ref(), &u0, &scale), 100, Convention::Trim);
        let options = DesignOptions { evaluations: 16_000, ..Default::default() };
        let found = design(&p, &options, &|| false, &|_| {}).unwrap();
        let at_end = stationarity(&p, &found.u, 0.01).unwrap();
        let random = stationarity(&p, &random_record(&p, 9).unwrap(), 0.01).unwrap();
        println!("{name}: {} {at_end:?}, random {random:?}", found.value);
        assert!(at_end.active > 1, "{name}: minima lie where pieces meet: {at_end:?}");
        assert!(at_end.residual < 0.02 * at_end.steepest, "{name}: {at_end:?}");
        assert!(at_end.residual < 0.02 * random.residual, "{name}: {at_end:?} {random:?}");
        assert!(random.residual > 0.2 * random.steepest, "{name}: {random:?}");
    }
    let d = named("d");
    let p = problem(term(&model, d.as_ref(), &u0, &scale), 100, Convention::Trim);
    assert!(stationarity(&p, &u0, 0.01).is_none(), "smooth criteria have a gradient instead");
}

/// At a random record one piece is the worst alone, so that the criterion has a gradient: the exact value, by central
/// differences, against the residual of that piece (nothing at a bound).
#[test]
fn the_slope_of_a_single_piece_is_that_of_the_exact_criterion() {
    let (u0, root) = core();
    let model = chapter_4_model("lambda");
    let scale = numbers(&root["c_lambda"]);
    for name in ["g", "e"] {
        let c = named(name);
        let p = problem(term(&model, c.as_ref(), &u0, &scale), 60, Convention::Trim);
        let u = random_record(&p, 4).unwrap();
        let found = stationarity(&p, &u, 1e-9).unwrap();
        assert_eq!(found.active, 1, "{name}");
        let mut e = Evaluator::new(&p).unwrap();
        let mut square = 0.0;
        for k in 0..u.len() {
            let range = p.channels[k % 3].upper - p.channels[k % 3].lower;
            let mut at = |h: f64| {
                let mut x = u.clone();
                x[k] += h * range;
                e.value(&x).ln()
            };
            square += ((at(1e-5) - at(-1e-5)) / 2e-5).powi(2);
        }
        assert_close(found.residual, square.sqrt(), 1e-5, name);
        assert_close(found.steepest, square.sqrt(), 1e-5, name);
    }
}
