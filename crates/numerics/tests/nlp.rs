//! Interior point on problems of W. Hock, K. Schittkowski, Test Examples for Nonlinear Programming Codes, Lecture
//! Notes in Economics and Mathematical Systems 187, Springer 1981; optima as printed there.

mod common;

use common::{Jet, Small};
use dynocal_numerics::nlp::{NlpOptions, NlpOutcome, solve};
use dynocal_numerics::status::Status;

fn v(x: &[Jet], k: usize) -> Jet {
    x[k - 1].clone()
}

fn sum_squares(x: &[Jet]) -> Jet {
    x.iter().map(|a| a.powi(2)).reduce(|a, b| a + b).expect("not empty")
}

fn hs6(x: &[Jet]) -> (Jet, Vec<Jet>) {
    ((v(x, 1) - 1.0).powi(2), vec![(v(x, 2) - v(x, 1).powi(2)) * 10.0])
}
fn hs7(x: &[Jet]) -> (Jet, Vec<Jet>) {
    let q = v(x, 1).powi(2) + 1.0;
    (q.ln() - v(x, 2), vec![q.powi(2) + v(x, 2).powi(2) - 4.0])
}
fn hs13(x: &[Jet]) -> (Jet, Vec<Jet>) {
    ((v(x, 1) - 2.0).powi(2) + v(x, 2).powi(2), vec![(-v(x, 1) + 1.0).powi(3) - v(x, 2)])
}
fn hs26(x: &[Jet]) -> (Jet, Vec<Jet>) {
    (
        (v(x, 1) - v(x, 2)).powi(2) + (v(x, 2) - v(x, 3)).powi(4),
        vec![(v(x, 2).powi(2) + 1.0) * v(x, 1) + v(x, 3).powi(4) - 3.0],
    )
}
fn hs28(x: &[Jet]) -> (Jet, Vec<Jet>) {
    (
        (v(x, 1) + v(x, 2)).powi(2) + (v(x, 2) + v(x, 3)).powi(2),
        vec![v(x, 1) + v(x, 2) * 2.0 + v(x, 3) * 3.0 - 1.0],
    )
}
/// HS28 with its constraint twice: the Jacobian has rank one of two.
fn hs28_twice(x: &[Jet]) -> (Jet, Vec<Jet>) {
    let (f, g) = hs28(x);
    (f, vec![g[0].clone(), g[0].clone() * 2.0])
}
fn hs35(x: &[Jet]) -> (Jet, Vec<Jet>) {
    let (a, b, c) = (v(x, 1), v(x, 2), v(x, 3));
    let linear = a.clone() * -8.0 - b.clone() * 6.0 - c.clone() * 4.0 + 9.0;
    let square = a.powi(2) * 2.0 + b.powi(2) * 2.0 + c.powi(2);
    let mixed = a.clone() * b.clone() * 2.0 + a.clone() * c.clone() * 2.0;
    (linear + square + mixed, vec![-a - b - c * 2.0 + 3.0])
}
fn hs39(x: &[Jet]) -> (Jet, Vec<Jet>) {
    (-v(x, 1), vec![v(x, 2) - v(x, 1).powi(3) - v(x, 3).powi(2), v(x, 1).powi(2) - v(x, 2) - v(x, 4).powi(2)])
}
fn hs40(x: &[Jet]) -> (Jet, Vec<Jet>) {
    (
        -(v(x, 1) * v(x, 2) * v(x, 3) * v(x, 4)),
        vec![
            v(x, 1).powi(3) + v(x, 2).powi(2) - 1.0,
            v(x, 1).powi(2) * v(x, 4) - v(x, 3),
            v(x, 4).powi(2) - v(x, 2),
        ],
    )
}
fn hs43(x: &[Jet]) -> (Jet, Vec<Jet>) {
    let s = |k| v(x, k).powi(2);
    let f = s(1) + s(2) + s(3) * 2.0 + s(4) - v(x, 1) * 5.0 - v(x, 2) * 5.0 - v(x, 3) * 21.0 + v(x, 4) * 7.0;
    let g1 = -(s(1) + s(2) + s(3) + s(4)) - v(x, 1) + v(x, 2) - v(x, 3) + v(x, 4) + 8.0;
    let g2 = -(s(1) + s(2) * 2.0 + s(3) + s(4) * 2.0) + v(x, 1) + v(x, 4) + 10.0;
    let g3 = -(s(1) * 2.0 + s(2) + s(3)) - v(x, 1) * 2.0 + v(x, 2) + v(x, 4) + 5.0;
    (f, vec![g1, g2, g3])
}
fn hs48(x: &[Jet]) -> (Jet, Vec<Jet>) {
    (
        (v(x, 1) - 1.0).powi(2) + (v(x, 2) - v(x, 3)).powi(2) + (v(x, 4) - v(x, 5)).powi(2),
        vec![
            v(x, 1) + v(x, 2) + v(x, 3) + v(x, 4) + v(x, 5) - 5.0,
            v(x, 3) - (v(x, 4) + v(x, 5)) * 2.0 + 3.0,
        ],
    )
}
fn hs50(x: &[Jet]) -> (Jet, Vec<Jet>) {
    let d = |i| v(x, i) - v(x, i + 1);
    let c = |i| v(x, i) + v(x, i + 1) * 2.0 + v(x, i + 2) * 3.0 - 6.0;
    (d(1).powi(2) + d(2).powi(2) + d(3).powi(4) + d(4).powi(2), vec![c(1), c(2), c(3)])
}
fn hs65(x: &[Jet]) -> (Jet, Vec<Jet>) {
    let f = (v(x, 1) - v(x, 2)).powi(2)
        + (v(x, 1) + v(x, 2) - 10.0).powi(2) * (1.0 / 9.0)
        + (v(x, 3) - 5.0).powi(2);
    (f, vec![-sum_squares(x) + 48.0])
}
fn hs71(x: &[Jet]) -> (Jet, Vec<Jet>) {
    let product = v(x, 1) * v(x, 2) * v(x, 3) * v(x, 4);
    (v(x, 1) * v(x, 4) * (v(x, 1) + v(x, 2) + v(x, 3)) + v(x, 3), vec![product - 25.0, sum_squares(x) - 40.0])
}
/// HS71 with its equality twice.
fn hs71_twice(x: &[Jet]) -> (Jet, Vec<Jet>) {
    let (f, mut g) = hs71(x);
    g.push(g[1].clone());
    (f, g)
}
/// HS71 with a sphere that does not meet the box.
fn hs71_infeasible(x: &[Jet]) -> (Jet, Vec<Jet>) {
    let (f, g) = hs71(x);
    (f, vec![g[0].clone(), sum_squares(x) - 2.0])
}
fn hs76(x: &[Jet]) -> (Jet, Vec<Jet>) {
    let (a, b, c, d) = (v(x, 1), v(x, 2), v(x, 3), v(x, 4));
    let f = a.powi(2) + b.powi(2) * 0.5 + c.powi(2) + d.powi(2) * 0.5 - a.clone() * c.clone()
        + c.clone() * d.clone()
        - a.clone()
        - b.clone() * 3.0
        + c.clone()
        - d.clone();
    let g1 = -a.clone() - b.clone() * 2.0 - c.clone() - d.clone() + 5.0;
    let g2 = a * -3.0 - b.clone() - c.clone() * 2.0 + d + 4.0;
    (f, vec![g1, g2, b + c * 4.0 - 1.5])
}
fn hs78(x: &[Jet]) -> (Jet, Vec<Jet>) {
    (
        v(x, 1) * v(x, 2) * v(x, 3) * v(x, 4) * v(x, 5),
        vec![
            sum_squares(x) - 10.0,
            v(x, 2) * v(x, 3) - v(x, 4) * v(x, 5) * 5.0,
            v(x, 1).powi(3) + v(x, 2).powi(3) + 1.0,
        ],
    )
}
fn hs100(x: &[Jet]) -> (Jet, Vec<Jet>) {
    let p = |k, e| v(x, k).powi(e);
    let f = (v(x, 1) - 10.0).powi(2)
        + (v(x, 2) - 12.0).powi(2) * 5.0
        + p(3, 4)
        + (v(x, 4) - 11.0).powi(2) * 3.0
        + p(5, 6) * 10.0
        + p(6, 2) * 7.0
        + p(7, 4)
        - v(x, 6) * v(x, 7) * 4.0
        - v(x, 6) * 10.0
        - v(x, 7) * 8.0;
    let g1 = p(1, 2) * -2.0 - p(2, 4) * 3.0 - v(x, 3) - p(4, 2) * 4.0 - v(x, 5) * 5.0 + 127.0;
    let g2 = v(x, 1) * -7.0 - v(x, 2) * 3.0 - p(3, 2) * 10.0 - v(x, 4) + v(x, 5) + 282.0;
    let g3 = v(x, 1) * -23.0 - p(2, 2) - p(6, 2) * 6.0 + v(x, 7) * 8.0 + 196.0;
    let g4 =
        p(1, 2) * -4.0 - p(2, 2) + v(x, 1) * v(x, 2) * 3.0 - p(3, 2) * 2.0 - v(x, 6) * 5.0 + v(x, 7) * 11.0;
    (f, vec![g1, g2, g3, g4])
}
fn hs5(x: &[Jet]) -> (Jet, Vec<Jet>) {
    let f = (v(x, 1) + v(x, 2)).sin() + (v(x, 1) - v(x, 2)).powi(2) - v(x, 1) * 1.5 + v(x, 2) * 2.5 + 1.0;
    (f, vec![])
}
fn circle_without_points(x: &[Jet]) -> (Jet, Vec<Jet>) {
    (v(x, 1), vec![sum_squares(x) + 1.0])
}

/// Equations alone fix the point (1, 3/2): nothing is left to choose, only the multipliers have to be found.
fn fixed_by_equations(x: &[Jet]) -> (Jet, Vec<Jet>) {
    (v(x, 1) + v(x, 2), vec![v(x, 1) - 1.0, v(x, 2) - v(x, 1) * 0.5 - 1.0])
}

const INF: f64 = f64::INFINITY;

fn problems() -> Vec<Small> {
    vec![
        Small::new("HS5", &[0.0, 0.0], -(3f64.sqrt() / 2.0 + std::f64::consts::PI / 3.0), hs5)
            .special(0, -1.5, 4.0)
            .special(1, -3.0, 3.0),
        Small::new("as many equations as variables", &[2.0, 2.0], 2.5, fixed_by_equations).bounds(0.0, 5.0),
        Small::new("HS6", &[-1.2, 1.0], 0.0, hs6),
        Small::new("HS7", &[2.0, 2.0], -3f64.sqrt(), hs7),
        Small::new("HS26", &[-2.6, 2.0, 2.0], 0.0, hs26),
        Small::new("HS28", &[-4.0, 1.0, 1.0], 0.0, hs28),
        Small::new("HS28 twice", &[-4.0, 1.0, 1.0], 0.0, hs28_twice),
        Small::new("HS35", &[0.5; 3], 1.0 / 9.0, hs35).bounds(0.0, INF).inequalities(&[0]),
        Small::new("HS39", &[2.0; 4], -1.0, hs39),
        Small::new("HS40", &[0.8; 4], -0.25, hs40),
        Small::new("HS43", &[0.0; 4], -44.0, hs43).inequalities(&[0, 1, 2]),
        Small::new("HS48", &[3.0, 5.0, -3.0, 2.0, -2.0], 0.0, hs48),
        Small::new("HS50", &[35.0, -31.0, 11.0, 5.0, -5.0], 0.0, hs50),
        Small::new("HS65", &[-5.0, 5.0, 0.0], 0.953_528_856_7, hs65)
            .bounds(-4.5, 4.5)
            .special(2, -5.0, 5.0)
            .inequalities(&[0]),
        Small::new("HS71", &[1.0, 5.0, 5.0, 1.0], 17.014_017_3, hs71).bounds(1.0, 5.0).inequalities(&[0]),
        Small::new("HS71 twice", &[1.0, 5.0, 5.0, 1.0], 17.014_017_3, hs71_twice)
            .bounds(1.0, 5.0)
            .inequalities(&[0]),
        Small::new("HS76", &[0.5; 4], -4.681_818_181, hs76).bounds(0.0, INF).inequalities(&[0, 1, 2]),
        Small::new("HS78", &[-2.0, 1.5, 2.0, -1.0, -1.0], -2.919_700_41, hs78),
        Small::new("HS100", &[1.0, 2.0, 0.0, 4.0, 0.0, 1.0, 1.0], 680.630_057_3, hs100)
            .inequalities(&[0, 1, 2, 3]),
    ]
}

fn run(problem: &mut Small) -> NlpOutcome {
    let found = solve(problem, &NlpOptions::default(), &|| false);
    println!(
        "{:12} {:?} f {:.10} violation {:.1e} iterations {} evaluations {}",
        problem.name,
        found.status,
        found.objective,
        found.violation,
        found.history.len() - 1,
        found.history.last().map_or(0, |h| h.evaluations)
    );
    found
}

#[test]
fn published_optima_are_reached() {
    for mut problem in problems() {
        let found = run(&mut problem);
        assert_eq!(found.status, Status::Converged, "{}", problem.name);
        assert!(found.violation < 1e-6, "{}: violation {}", problem.name, found.violation);
        let error = (found.objective - problem.optimum).abs();
        assert!(error <= 1e-6 * problem.optimum.abs().max(1.0), "{}: {}", problem.name, found.objective);
        assert!(found.history.len() < 60, "{}: {} iterations", problem.name, found.history.len());
    }
}

#[test]
fn the_degenerate_problem_13_is_approached() {
    // No multipliers exist at the optimum (1, 0), f = 1: any status but a wrong point is honest.
    let mut problem = Small::new("HS13", &[-2.0, -2.0], 1.0, hs13).bounds(0.0, INF).inequalities(&[0]);
    let found = run(&mut problem);
    assert!(found.violation < 1e-6);
    assert!((found.objective - 1.0).abs() < 0.02, "{}", found.objective);
}

#[test]
fn infeasible_twins_are_called_infeasible() {
    let twins = vec![
        Small::new("circle", &[1.0, 2.0], 0.0, circle_without_points),
        Small::new("HS71 apart", &[1.0, 5.0, 5.0, 1.0], 0.0, hs71_infeasible)
            .bounds(1.0, 5.0)
            .inequalities(&[0]),
        Small::new("HS35 apart", &[11.0, 0.5, 0.5], 0.0, hs35)
            .bounds(0.0, INF)
            .special(0, 10.0, INF)
            .inequalities(&[0]),
        Small::new("all fixed", &[1.0, 1.0], 0.0, hs6).special(0, 1.0, 1.0).special(1, 3.0, 3.0),
    ];
    for mut problem in twins {
        let found = run(&mut problem);
        assert_eq!(found.status, Status::Infeasible, "{}", problem.name);
        assert!(found.violation > 1e-3);
    }
    let mut empty = Small::new("empty box", &[0.5; 3], 0.0, hs35).bounds(1.0, 0.0);
    assert_eq!(solve(&mut empty, &NlpOptions::default(), &|| false).status, Status::Infeasible);
}

#[test]
fn fixed_variables_are_held_and_bounds_kept() {
    // HS71 with x4 fixed at its optimal value has the same optimum.
    let mut problem = Small::new("HS71 fixed", &[1.0, 5.0, 5.0, 1.0], 17.014_017_3, hs71)
        .bounds(1.0, 5.0)
        .special(3, 1.379_408_293_6, 1.379_408_293_6)
        .inequalities(&[0]);
    let found = run(&mut problem);
    assert_eq!(found.status, Status::Converged);
    assert_eq!(found.x[3], 1.379_408_293_6);
    assert!((found.objective - 17.014_017_3).abs() < 1e-5);
    assert!(found.x[..4].iter().all(|x| (1.0..=5.0).contains(x)) && found.x[4] >= 0.0);
}

#[test]
fn multipliers_satisfy_the_stationarity_of_a_problem_by_hand() {
    // min (x1 + x2)^2 + (x2 + x3)^2 on a plane: minimum 0 with multiplier 0; HS39: f = -x1, multipliers (-1, -1).
    let mut problem = Small::new("HS39", &[2.0; 4], -1.0, hs39);
    let found = run(&mut problem);
    // Stationarity in x1: -1 + l1 (-3 x1^2) + l2 (2 x1) = 0, in x2: l1 - l2 = 0, at x1 = 1: l1 = l2 = -1.
    assert!((found.multipliers[0] + 1.0).abs() < 1e-6 && (found.multipliers[1] + 1.0).abs() < 1e-6);
}

#[test]
fn an_interrupt_and_the_iteration_limit_end_the_run() {
    let mut problem = problems().pop().expect("there are problems");
    assert_eq!(solve(&mut problem, &NlpOptions::default(), &|| true).status, Status::Interrupted);
    let few = NlpOptions { max_iterations: 2, ..NlpOptions::default() };
    assert_eq!(solve(&mut problem, &few, &|| false).status, Status::Limit);
}
