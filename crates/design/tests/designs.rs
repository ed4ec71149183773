//! Whole designs: published bars, limits that must hold, conformance of every search.

mod common;

use common::*;
use dynocal_design::channel::{Channel, Shape};
use dynocal_design::error::DesignError;
use dynocal_design::problem::{Convention, DesignProblem, Evaluator, OutputLimits, Term};
use dynocal_design::search::{DesignOptions, DesignOutcome, Failure, SEARCHES, design, random_record};
use dynocal_numerics::status::Status;

fn run(problem: &DesignProblem, options: &DesignOptions) -> DesignOutcome {
    design(problem, options, &|| false, &|_| {}).unwrap()
}

/// Values of ten random starts, the best first.
fn ten(problem: &DesignProblem, evaluations: usize) -> Vec<f64> {
    let one = |seed| {
        let found = run(problem, &DesignOptions { seed, evaluations, ..Default::default() });
        assert!(found.status != Status::Infeasible);
        found.value
    };
    let mut v: Vec<f64> = (0..10).map(one).collect();
    v.sort_by(f64::total_cmp);
    v
}

/// Median and best of ten single starts against those of CasADi with IPOPT.
fn reaches(what: &str, problem: &DesignProblem, evaluations: usize, median: f64, best: f64) {
    let v = ten(problem, evaluations);
    let found = 0.5 * (v[4] + v[5]);
    println!("{what}: median {found}, asked {median}; best {}, asked {best}", v[0]);
    assert!(found <= median, "{what}: median {found}, asked {median}");
    assert!(v[0] <= best, "{what}: best {}, asked {best}", v[0]);
}

/// The default budget, or half of it where that is enough.
#[test]
fn starts_in_a_box_reach_the_interior_point_bars() {
    let (u0, root) = core();
    let model = chapter_4_model("torque");
    let scale = numbers(&root["c_torque"]);
    for (name, evaluations, median, best) in [
        ("d", 2000, -436.2, -436.89),
        ("ai", 4000, 2.138e5, 2.045e5),
        ("a", 2000, 899.0, 849.0),
        ("wa", 2000, 1.954e5, 1.886e5),
        ("i", 2000, 984.0, 963.5),
        ("g", 4000, 13.23, 13.11),
    ] {
        let c = named(name);
        let p = problem(term(&model, c.as_ref(), &u0, &scale), 100, Convention::Trim);
        reaches(name, &p, evaluations, median, best);
    }
}

/// The best of ten is not known for these limits: the median stands for it.
#[test]
fn rate_limited_starts_reach_the_interior_point_bars() {
    let (u0, _) = core();
    let model = chapter_4_model("torque");
    for (name, bar) in [("d", -401.0), ("ai", 8.93e5), ("a", 1204.0)] {
        let c = named(name);
        let mut p = problem(term(&model, c.as_ref(), &u0, &[]), 100, Convention::Trim);
        p.channels.iter_mut().zip([500.0, 0.025, 125.0]).for_each(|(c, r)| c.rate_per_sample = Some(r));
        reaches(&format!("rate {name}"), &p, 4000, bar, bar);
    }
}

/// Output limits take more evaluations per run: twice the default. The best of ten is better than that of CasADi with IPOPT
/// for each criterion; the median is for D, and up to 1 % above for AI (99 287 against 98 500) and A (355.1 against 354).
#[test]
fn output_limited_starts_reach_the_interior_point_bars() {
    let (u0, _) = core();
    let model = chapter_4_model("torque");
    for (name, median, bar) in
        [("d", -450.29, -450.29), ("ai", 1.01 * 9.85e4, 9.85e4), ("a", 1.01 * 354.0, 354.0)]
    {
        let c = named(name);
        let limits = Some(OutputLimits { lower: -10.0, upper: 40.0, margin: 0.0 });
        let mut p = problem(Term { limits, ..term(&model, c.as_ref(), &u0, &[]) }, 100, Convention::Trim);
        p.channels = vec![
            Channel::free("fpw", 1800.0, 6200.0),
            Channel::free("abv", 0.35, 0.65),
            Channel::free("speed", 800.0, 2200.0),
        ];
        reaches(&format!("output {name}"), &p, 8000, median, bar);
    }
}

/// Torque and lambda together, weights of Table 4.16, and lambda alone.
#[test]
fn composites_and_lambda_reach_the_interior_point_bars() {
    let (u0, _) = core();
    let (torque, lambda) = (chapter_4_model("torque"), chapter_4_model("lambda"));
    for (name, weights, median, best) in [
        ("d", (477.91, 802.84), -614_448.0, -614_936.0),
        ("ai", (1.0 / 1.8109e6, 2.0 / 3945.2), 0.6768, 0.6636),
    ] {
        let c = named(name);
        let of = |model, weight| Term { weight, ..term(model, c.as_ref(), &u0, &[]) };
        let mut p = problem(of(&torque, weights.0), 100, Convention::Trim);
        p.terms.push(of(&lambda, weights.1));
        reaches(&format!("composite {name}"), &p, 2000, median, best);
    }
    for (name, median) in [("d", -507.8), ("ai", 936.0)] {
        let c = named(name);
        let p = problem(term(&lambda, c.as_ref(), &u0, &[]), 100, Convention::Trim);
        reaches(&format!("lambda {name}"), &p, 1000, median, median);
    }
}

/// A tenth of what 60 CPU seconds allow ends beyond the best values that were known: two chains of 40 to 120 s of an
/// iterated local search in the box, 40 interior point runs under rate limits.
#[test]
fn longer_searches_pass_the_best_known_values() {
    let (u0, _) = core();
    let (torque, lambda) = (chapter_4_model("torque"), chapter_4_model("lambda"));
    for (what, model, name, rates, best) in
        [("lambda", &lambda, "d", false, -508.328), ("torque, rates", &torque, "ai", true, 7.883e5)]
    {
        let c = named(name);
        let mut p = problem(term(model, c.as_ref(), &u0, &[]), 100, Convention::Trim);
        if rates {
            let limits = p.channels.iter_mut().zip([500.0, 0.025, 125.0]);
            limits.for_each(|(c, r)| c.rate_per_sample = Some(r));
        }
        let found = run(&p, &DesignOptions { evaluations: 60_000, ..Default::default() });
        println!("{what} {name}: {}, best known {best}", found.value);
        assert!(found.value < best, "{what} {name}: {}", found.value);
    }
}

/// Streams belong to starts and parts, not to threads: one thread and three give the same bytes.
#[test]
fn designs_and_bounds_do_not_depend_on_the_number_of_threads() {
    let texts = ["1", "a(t)", "a(t-1)*b(t)", "a(t-2)^2", "b(t-1)^2", "y(t-1)"];
    let model = dynocal_ident::model::poly::PolyNarx::parse(&["a", "b"], "y", &texts).unwrap();
    let d = named("d");
    let term = Term::new("y", &model, &[1.0, 0.5, 0.3, 0.2, -0.4, 0.4], 1.0, d.as_ref());
    let p = DesignProblem {
        channels: ["a", "b"].map(|name| Channel::free(name, -1.0, 1.0)).to_vec(),
        n_samples: 60,
        convention: Convention::Trim,
        start: 2,
        terms: vec![term],
    };
    let options = DesignOptions { starts: 4, evaluations: 300, certify: true, ..Default::default() };
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| run(&p, &options))
    };
    let (one, three) = (on(1), on(3));
    assert_eq!((&one.u, one.value, one.evaluations), (&three.u, three.value, three.evaluations));
    assert!(one.certificate.as_ref().is_some_and(|c| c.is_ok()));
    assert_eq!(one.certificate, three.certificate);
}

/// Every search: within the bounds, never worse than a given start, the same twice, reproducible value.
#[test]
fn searches_keep_their_contract() {
    let (u0, _) = core();
    let model = chapter_4_model("torque");
    let ai = named("ai");
    let mut p = problem(term(&model, ai.as_ref(), &u0, &[]), 60, Convention::Trim);
    p.channels[2].rate_per_sample = Some(200.0);
    let start = random_record(&p, 3).unwrap();
    let started = Evaluator::new(&p).unwrap().value(&start);
    for member in SEARCHES {
        let options = DesignOptions {
            search: member.doc.name.into(),
            evaluations: 600,
            starts: 2,
            start: Some(start.clone()),
            ..Default::default()
        };
        let (a, b) = (run(&p, &options), run(&p, &options));
        assert_eq!(a.u, b.u, "{}: not the same twice", member.doc.name);
        assert!(a.value <= started, "{}: {} from {started}", member.doc.name, a.value);
        for (t, row) in a.u.chunks_exact(3).enumerate() {
            for (v, c) in row.iter().zip(&p.channels) {
                assert!((c.lower..=c.upper).contains(v));
            }
            assert!(t == 0 || (row[2] - a.u[t * 3 - 1]).abs() <= 200.0);
        }
        assert_eq!(Evaluator::new(&p).unwrap().value(&a.u), a.value);
        assert!(a.evaluations <= 1300, "{}: {} evaluations", member.doc.name, a.evaluations);
    }
}

/// A chain-like record: held and ramped channels, a given one, two models, limits on both outputs.
#[test]
fn a_record_with_holds_ramps_and_output_limits_keeps_them_all() {
    let (u0, _) = core();
    let (torque, lambda) = (chapter_4_model("torque"), chapter_4_model("lambda"));
    let d = named("d");
    let n = 300;
    let limits = OutputLimits { lower: -10.0, upper: 40.0, margin: 1.0 };
    let mut p =
        problem(Term { limits: Some(limits), ..term(&torque, d.as_ref(), &u0, &[]) }, n, Convention::Hold);
    let near_one = OutputLimits { lower: -0.5, upper: 2.5, margin: 0.1 };
    p.terms.push(Term { limits: Some(near_one), ..term(&lambda, d.as_ref(), &u0, &[]) });
    p.channels[0].hold = 10;
    p.channels[1] = Channel {
        hold: 5,
        shape: Shape::Linear,
        rate_per_sample: Some(0.02),
        before: Some(0.5),
        ..p.channels[1].clone()
    };
    let speed: Vec<f64> = (0..n).map(|t| 1500.0 + 400.0 * (t as f64 / 20.0).sin()).collect();
    p.channels[2] = Channel::given("speed", speed.clone());
    let found = run(&p, &DesignOptions { evaluations: 600, ..Default::default() });
    assert!(found.status != Status::Infeasible, "{:?}", found.status);
    assert!(found.value < found.start_value);
    for s in &found.safety {
        let worst = s.worst.unwrap();
        assert!(worst.distance >= -1e-6 * 50.0, "{}: {worst:?}", s.name);
        assert_eq!(s.predicted[worst.sample], worst.output);
    }
    for t in 0..n {
        assert_eq!(found.u[t * 3 + 2], speed[t]);
        assert!(t % 10 == 0 || found.u[t * 3] == found.u[t * 3 - 3]);
        let before = if t == 0 { 0.5 } else { found.u[t * 3 - 2] };
        assert!((found.u[t * 3 + 1] - before).abs() <= 0.02 + 1e-12);
    }
}

/// Limits that no input can meet end as infeasible with the output, the sample and the distance.
#[test]
fn unreachable_output_limits_are_reported_not_hidden() {
    let (u0, _) = core();
    let model = chapter_4_model("torque");
    let d = named("d");
    let limits = OutputLimits { lower: 900.0, upper: 1000.0, margin: 0.0 };
    let p =
        problem(Term { limits: Some(limits), ..term(&model, d.as_ref(), &u0, &[]) }, 60, Convention::Trim);
    let found = run(&p, &DesignOptions { evaluations: 400, ..Default::default() });
    assert_eq!(found.status, Status::Infeasible);
    let worst = found.safety[0].worst.unwrap();
    assert!(worst.distance < 0.0 && worst.limit == 900.0, "{worst:?}");
}

#[test]
fn wrong_problems_are_refused_in_words() {
    let (u0, _) = core();
    let model = chapter_4_model("torque");
    let (d, ai) = (named("d"), named("ai"));
    let refuse = |p: &DesignProblem| match design(p, &DesignOptions::default(), &|| false, &|_| {}) {
        Err(Failure::Problem(e)) => e,
        other => panic!("not refused: {other:?}"),
    };
    let good = || problem(term(&model, d.as_ref(), &u0, &[]), 100, Convention::Trim);
    let mut p = good();
    p.terms = vec![term(&model, ai.as_ref(), &[], &[])];
    assert!(matches!(refuse(&p), DesignError::NoObjectiveSignal { .. }));
    let mut p = good();
    p.terms[0].limits = Some(OutputLimits { lower: 0.0, upper: 10.0, margin: 6.0 });
    assert!(refuse(&p).to_string().contains("conflict by 2"), "{}", refuse(&p));
    let mut p = good();
    p.n_samples = 10;
    assert!(matches!(refuse(&p), DesignError::Shape { .. }));
    // Twenty samples cannot tell twenty-three parameters: named, not a number.
    let mut p = good();
    p.n_samples = 30;
    let text = refuse(&p).to_string();
    assert!(text.contains("rank 20 of 23"), "{text}");
    let unknown = DesignOptions { search: "kick".into(), ..Default::default() };
    let Err(Failure::Search(e)) = design(&good(), &unknown, &|| false, &|_| {}) else { panic!("must fail") };
    assert!(e.to_string().contains("did you mean `kicks`"), "{e}");
}

#[test]
fn an_interrupt_ends_the_search_with_the_best_so_far() {
    let (u0, _) = core();
    let model = chapter_4_model("torque");
    let d = named("d");
    let p = problem(term(&model, d.as_ref(), &u0, &[]), 100, Convention::Trim);
    let asked = std::sync::atomic::AtomicUsize::new(0);
    let stop = || asked.fetch_add(1, std::sync::atomic::Ordering::Relaxed) > 50;
    let found = design(&p, &DesignOptions::default(), &stop, &|_| {}).unwrap();
    assert_eq!(found.status, Status::Interrupted);
    assert!(found.value < found.start_value && found.evaluations < 200);
}

/// The thesis' gradient methods against the median of CasADi with IPOPT from random starts: another method on the same
/// problem ends in local optima of the same quality (2 % in D-efficiency is 0.46, three starts only).
#[test]
fn gradient_searches_end_where_another_interior_point_does() {
    let (u0, _) = core();
    let model = chapter_4_model("torque");
    let d = named("d");
    let p = problem(term(&model, d.as_ref(), &u0, &[]), 100, Convention::Trim);
    for search in ["trust_region", "sqp", "interior_point"] {
        let mut v: Vec<f64> = (1..=3)
            .map(|seed| {
                let search = search.into();
                run(&p, &DesignOptions { search, evaluations: 400, seed, ..Default::default() }).value
            })
            .collect();
        v.sort_by(f64::total_cmp);
        println!("{search}: median {}", v[1]);
        assert!(v[1] <= -436.2 + 0.46, "{search}: median {}", v[1]);
    }
}

/// Searches without derivatives improve a random record and state every evaluation that they use; the two stochastic
/// ones depend on the seed, the pattern search does not.
#[test]
fn value_searches_improve_and_stay_within_equal_budgets() {
    let (u0, _) = core();
    let model = chapter_4_model("torque");
    let a = named("a");
    let p = problem(term(&model, a.as_ref(), &u0, &[]), 100, Convention::Trim);
    let start = random_record(&p, 5).unwrap();
    for (search, stochastic) in [("pattern_search", false), ("genetic", true), ("annealing", true)] {
        let with = |seed| {
            let start = Some(start.clone());
            run(
                &p,
                &DesignOptions {
                    search: search.into(),
                    evaluations: 10_000,
                    seed,
                    start,
                    ..Default::default()
                },
            )
        };
        let (one, two) = (with(1), with(2));
        println!("{search}: {} from {}", one.value, one.start_value);
        assert!(one.value < 0.5 * one.start_value, "{search}: {} from {}", one.value, one.start_value);
        assert!(one.evaluations <= 10_001, "{search}: {}", one.evaluations);
        assert_eq!(one.u != two.u, stochastic, "{search}");
        assert!(one.history.windows(2).all(|w| w[1].objective < w[0].objective), "{search}: history");
    }
}

/// Output limits: every search ends within them from a start that breaks them, or says that it did not.
#[test]
fn searches_of_the_thesis_meet_output_limits_or_say_so() {
    let (u0, _) = core();
    let model = chapter_4_model("torque");
    let d = named("d");
    let limits = OutputLimits { lower: -5.0, upper: 25.0, margin: 0.0 };
    let p =
        problem(Term { limits: Some(limits), ..term(&model, d.as_ref(), &u0, &[]) }, 100, Convention::Trim);
    for search in ["trust_region", "sqp", "interior_point", "pattern_search", "genetic", "annealing"] {
        let found =
            run(&p, &DesignOptions { search: search.into(), evaluations: 3000, ..Default::default() });
        let worst = found.safety[0].worst.unwrap();
        println!("{search}: {:?} {} worst {}", found.status, found.value, worst.distance);
        assert_eq!(found.status == Status::Infeasible, worst.distance < -1e-6 * 30.0, "{search}: {worst:?}");
        if matches!(search, "trust_region" | "sqp" | "interior_point") {
            assert!(found.status != Status::Infeasible && found.value < -400.0, "{search}: {}", found.value);
        }
    }
}

#[test]
fn dense_searches_refuse_long_records() {
    let (u0, _) = core();
    let model = chapter_4_model("torque");
    let d = named("d");
    let p = problem(term(&model, d.as_ref(), &u0, &[]), 2000, Convention::Trim);
    let options = DesignOptions { search: "interior_point".into(), ..Default::default() };
    let Err(Failure::Problem(e)) = design(&p, &options, &|| false, &|_| {}) else { panic!("must fail") };
    assert!(e.to_string().contains("found 6000, expected at most 1000"), "{e}");
}
