//! Ways to go through a record, and what a demand that the record gives makes of a problem.

use crate::common::{channel, problem};
use dynocal_calib::optimise::model::OutputModel;
use dynocal_calib::optimise::{
    Batch, DemandFrom, OptimiseOptions, Optimum, Seam, Segments, Way, optimise_models,
};
use dynocal_calib::problem::CalibrationProblem;
use dynocal_ident::data::{Dataset, Role};
use dynocal_ident::model::poly::PolyNarx;
use dynocal_numerics::status::Status;

fn start(channels: &[(&str, Role, Vec<f64>)]) -> Dataset {
    let of = |(name, role, values): &(&str, Role, Vec<f64>)| channel(name, "-", *role, values.clone());
    let (name, origin) = ("start".into(), "test".into());
    Dataset { name, sample_time_s: 0.1, channels: channels.iter().map(of).collect(), init_samples: 0, origin }
}

fn solve(
    p: &CalibrationProblem,
    models: &[OutputModel],
    start: &Dataset,
    options: &OptimiseOptions,
) -> Optimum {
    optimise_models(p, models, start, options, &|| false).expect("set up")
}

/// y(t) = u(t-1) - 2 u(t-2) + v(t-1): u at the end of a segment is worth something there and costs the next one.
#[test]
fn a_segment_that_cannot_go_on_names_its_seam_and_what_it_misses() {
    let p = problem(
        r#"
        minimise = [{ channel = "u", weight = -1.0 }]
        inputs = [
            { name = "u", unit = "-", lower = 0.0, upper = 5.0 },
            { name = "v", unit = "-", lower = 0.0, upper = 1.0 },
        ]
        demands = [{ output = "y", unit = "-", lower = 0.0, upper = 1.0 }]
        "#,
    );
    let y = PolyNarx::parse(&["u", "v"], "y", &["u(t-1)", "u(t-2)", "v(t-1)"]).expect("structure");
    let models = [OutputModel::plain("y", &y, &[1.0, -2.0, 1.0], &["u", "v"])];
    let n = 60;
    // u = 0.3 and v = 0.4 give y = 0.1.
    let record = start(&[
        ("u", Role::Input, vec![0.3; n]),
        ("v", Role::Input, vec![0.4; n]),
        ("y", Role::Output, vec![0.1; n]),
    ]);
    let of = |way: Way| solve(&p, &models, &record, &OptimiseOptions { way, ..OptimiseOptions::default() });
    let in_segments = |seam: Seam| of(Way::Segments(Segments { length_s: 2.0, seam }));
    let batch = of(Way::default());
    assert_eq!(batch.status, Status::Converged);
    assert!(batch.violation("y") < 1e-6 && batch.shortfalls.is_empty());
    let greedy = in_segments(Seam::LookAhead { ahead_s: 0.0 });
    assert!(!greedy.status.is_success());
    let first = greedy.parts.iter().find(|p| !p.status.is_success()).expect("one that fails");
    assert!((first.from_s - 2.2).abs() < 1e-9, "{first:?}");
    // It takes over u = 5: its first y is at least 0 - 2 * 5 + 0 or, with u = 5 and v = 1 again, -4 where 0.1 is asked.
    let s = greedy.shortfalls.first().expect("what it misses");
    assert!(s.output == "y" && (s.at_s - 2.3).abs() < 1e-9 && s.largest < -3.9, "{s:?}");
    assert!(s.inputs.iter().any(|i| i == "u at 5 -"), "{s:?}");
    // The published way hides that; its seams show it.
    let independent = in_segments(Seam::Independent);
    assert!(independent.violation("y") > 3.9, "{:?}", independent.violations);
    // Pinned segments fit. (A look-ahead is no cure here: what it saves up at its own end is on the way already at the seam.)
    let kept = in_segments(Seam::Pinned);
    assert_eq!(kept.status, Status::Converged, "{:?}", kept.parts);
    assert!(kept.violation("y") < 1e-6, "{:?}", kept.violations);
    assert!(kept.objective >= batch.objective - 1e-7, "{} {}", kept.objective, batch.objective);
}

/// u^4 - 2 u^2 + 0.2 u has its minima near -1 (the lower one) and 1: a start at 1 stays there, several starts do not.
#[test]
fn several_starts_find_the_lower_of_two_minima() {
    let p = problem(
        r#"
        minimise = [{ channel = "u4" }, { channel = "u2", weight = -2.0 }, { channel = "u", weight = 0.2 }]
        inputs = [{ name = "u", unit = "-", lower = -2.0, upper = 2.0 }]
        limits = [{ output = "y", unit = "-" }]
        derive = [
            { name = "u2", unit = "-", powers = { u = 2 } },
            { name = "u4", unit = "-", powers = { u = 4 } },
        ]
        "#,
    );
    let y = PolyNarx::parse(&["u"], "y", &["u(t-1)"]).expect("structure");
    let models = [OutputModel::plain("y", &y, &[1.0], &["u"])];
    let record = start(&[("u", Role::Input, vec![1.0; 20]), ("y", Role::Output, vec![1.0; 20])]);
    let of = |starts: usize| {
        let way = Way::Batch(Batch { starts });
        solve(&p, &models, &record, &OptimiseOptions { way, ..OptimiseOptions::default() })
    };
    // Roots of 4 u^3 - 4 u + 0.2 by Newton.
    let root = |mut u: f64| {
        (0..50).for_each(|_| u -= (4.0 * u.powi(3) - 4.0 * u + 0.2) / (12.0 * u * u - 4.0));
        u
    };
    let value = |u: f64| u.powi(4) - 2.0 * u * u + 0.2 * u;
    assert!((of(1).objective - value(root(1.0))).abs() < 1e-6);
    let best = of(4);
    assert!((best.objective - value(root(-1.0))).abs() < 1e-6, "{}", best.objective);
    assert_eq!(best.parts.len(), 4);
}

/// Prices against solving again: one sample of a demand, a demand as a whole, a rate, a bound.
#[test]
fn prices_agree_with_problems_that_are_solved_again() {
    let at = |rate: f64, upper: f64, demand: &dyn Fn(usize) -> f64| {
        let text = format!(
            r#"
            minimise = [{{ channel = "a2", weight = 0.2 }}, {{ channel = "b", weight = 0.7 }}]
            inputs = [
                {{ name = "a", unit = "-", lower = 0.0, upper = {upper} }},
                {{ name = "b", unit = "-", lower = 0.0, upper = 9.0, rate_per_s = {rate} }},
            ]
            demands = [{{ output = "y", unit = "-", lower = 0.0, upper = 10.0 }}]
            derive = [{{ name = "a2", unit = "-", powers = {{ a = 2 }} }}]
            "#
        );
        let p = problem(&text);
        let y =
            PolyNarx::parse(&["a", "b"], "y", &["a(t-1)", "b(t-1)", "b(t-2)^2", "a(t-1)*b(t-1)", "y(t-1)"])
                .expect("structure");
        let models = [OutputModel::plain("y", &y, &[1.0, 0.6, 0.05, 0.04, 0.4], &["a", "b"])];
        let n = 50;
        let record = start(&[
            ("a", Role::Input, vec![1.0; n]),
            ("b", Role::Input, vec![1.0; n]),
            ("y", Role::Output, (0..n).map(demand).collect()),
        ]);
        let options =
            OptimiseOptions { demand: DemandFrom::Record, tolerance: 1e-11, ..OptimiseOptions::default() };
        let found = solve(&p, &models, &record, &options);
        assert_eq!(found.status, Status::Converged);
        found
    };
    let demand = |t: usize| 3.0 - 1.2 * (0.4 * t as f64).cos();
    let (rate, upper) = (1.5, 1.5);
    let found = at(rate, upper, &demand);
    let price = |of: &str, channel: &str| {
        found.prices.iter().find(|p| p.of == of && p.channel == channel).expect("price").clone()
    };
    let h = 1e-5;
    let slope = |up: Optimum, down: Optimum| (up.objective - down.objective) / (2.0 * h);
    let agree = |what: &str, price: f64, slope: f64| {
        println!("{what}: price {price:.8}, solved again {slope:.8}");
        assert!((price - slope).abs() < 1e-4 * slope.abs().max(1e-3), "{what}: {price} {slope}");
        assert!(slope.abs() > 1e-4, "{what} costs nothing: the case shows nothing");
    };
    agree(
        "rate of b",
        price("rate", "b").price,
        slope(at(rate + h, upper, &demand), at(rate - h, upper, &demand)),
    );
    agree(
        "upper of a",
        price("upper", "a").price,
        slope(at(rate, upper + h, &demand), at(rate, upper - h, &demand)),
    );
    for sample in [7, 20, 41] {
        let moved = |by: f64| move |t: usize| demand(t) + if t == sample { by } else { 0.0 };
        let again = slope(at(rate, upper, &moved(h)), at(rate, upper, &moved(-h)));
        agree(&format!("demand of sample {sample}"), price("demand", "y").by_sample[sample], again);
    }
}

/// y(t) = 0.9 y(t-1) - 0.05 y(t-1)^2 + u(t-1), sum of u^2 - y over the record, 0 <= u <= 0.8: dynamic programming over a
/// grid of y with u by golden section. The error of its value is that of the grid: a quarter from one grid to the next.
#[test]
fn a_case_of_one_state_agrees_with_dynamic_programming_within_its_grid() {
    let (n, bound) = (40, 0.8);
    let step = |y: f64, u: f64| 0.9 * y - 0.05 * y * y + u;
    let p = problem(&format!(
        r#"
        minimise = [{{ channel = "u2" }}, {{ channel = "y", weight = -1.0 }}]
        inputs = [{{ name = "u", unit = "-", lower = 0.0, upper = {bound} }}]
        limits = [{{ output = "y", unit = "-" }}]
        derive = [{{ name = "u2", unit = "-", powers = {{ u = 2 }} }}]
        "#
    ));
    let y = PolyNarx::parse(&["u"], "y", &["y(t-1)", "y(t-1)^2", "u(t-1)"]).expect("structure");
    let models = [OutputModel::plain("y", &y, &[0.9, -0.05, 1.0], &["u"])];
    let (y0, u0) = (0.5, 0.3);
    let record = start(&[("u", Role::Input, vec![u0; n]), ("y", Role::Output, vec![y0; n])]);
    let found = solve(&p, &models, &record, &OptimiseOptions::default());
    assert_eq!(found.status, Status::Converged);
    let stages = n - 2;
    let by_grid = |cells: usize| {
        let (low, high) = (0.0, 6.0);
        let at = |k: usize| low + (high - low) * k as f64 / cells as f64;
        let mut value = vec![0.0; cells + 1];
        let on = |value: &[f64], y: f64| {
            let place = ((y - low) / (high - low) * cells as f64).clamp(0.0, cells as f64 - 1e-9);
            let (k, part) = (place as usize, place.fract());
            value[k] * (1.0 - part) + value[k + 1] * part
        };
        let best = |value: &[f64], y: f64| {
            let cost = |u: f64| u * u - step(y, u) + on(value, step(y, u));
            let (mut a, mut b) = (0.0, bound);
            let ratio = 0.5 * (5.0f64.sqrt() - 1.0);
            for _ in 0..60 {
                let (c, d) = (b - ratio * (b - a), a + ratio * (b - a));
                if cost(c) < cost(d) { b = d } else { a = c }
            }
            cost(0.5 * (a + b)).min(cost(0.0)).min(cost(bound))
        };
        for _ in 0..stages {
            value = (0..=cells).map(|k| best(&value, at(k))).collect();
        }
        on(&value, step(y0, u0)) / stages as f64
    };
    let (coarse, fine) = (by_grid(300), by_grid(600));
    let grid = (coarse - fine).abs();
    println!("programme {:.9}, grids {coarse:.9} {fine:.9}", found.objective);
    assert!(grid > 1e-9, "the grids do not differ: the case shows nothing");
    assert!((found.objective - fine).abs() <= grid, "{} {fine} {grid}", found.objective);
    // It is bent and bounded: both ends of u are used.
    let u = found.input("u").expect("u");
    assert!(u[1..n - 1].iter().any(|u| *u > bound - 1e-4) && u[n - 2] < bound - 0.05, "{u:?}");
}

/// y(t) = 0.5 y(t-1) + u(t-3): pulses of u that take y to four times its range, the first as early as inputs may move. A demand
/// that is led back stays what the models answer where no input acts yet, so that it can be met there, and far from the pulses.
#[test]
fn a_demand_that_is_led_back_can_be_met_from_the_first_sample_on() {
    let p = problem(
        r#"
        minimise = [{ channel = "u", weight = 1.0 }]
        inputs = [{ name = "u", unit = "-", lower = -5.0, upper = 5.0 }]
        demands = [{ output = "y", unit = "-", lower = 0.0, upper = 1.0 }]
        "#,
    );
    let y = PolyNarx::parse(&["u"], "y", &["y(t-1)", "u(t-3)"]).expect("structure");
    let models = [OutputModel::plain("y", &y, &[0.5, 1.0], &["u"])];
    let u: Vec<f64> =
        (0..200).map(|t| if (3..15).contains(&t) || (100..140).contains(&t) { 2.0 } else { 0.3 }).collect();
    let record = start(&[("u", Role::Input, u), ("y", Role::Output, vec![0.6; 200])]);
    let of = |demand| solve(&p, &models, &record, &OptimiseOptions { demand, ..OptimiseOptions::default() });
    let (plain, within) = (of(DemandFrom::Response), of(DemandFrom::Within));
    for o in [&plain, &within] {
        assert_eq!(o.status, Status::Converged);
        assert!(o.violation("y") < 1e-6, "{:?}", o.violations);
    }
    let (a, b) = (&plain.demands[0].values, &within.demands[0].values);
    let largest = |v: &[f64]| v.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    // Half a range above the range is 1.5; 15 samples from an edge a lag of 3 leaves exp(-5) of 2.5.
    assert!(largest(a) > 3.9 && largest(&b[118..125]) < 1.55, "{} {}", largest(a), largest(&b[118..125]));
    assert_eq!(a[..6], b[..6]);
    // 40 samples from the pulses exp(-40 / 3) of 1.25 is left, from each.
    for t in (58..63).chain(190..200) {
        assert!((a[t] - b[t]).abs() < 1e-5, "{t}: {} {}", a[t], b[t]);
    }
}
