//! Populations of thesis chapter 4 against an independent implementation, and their invariances.

use dynocal_studies::chapter4::work::constrained::{Limits, constrained};
use dynocal_studies::chapter4::work::convergence::{SEARCHES, converge};
use dynocal_studies::chapter4::work::correlation::correlations;
use dynocal_studies::chapter4::work::distribution::distribution;
use dynocal_studies::chapter4::work::iterative::{Use, iterate};
use dynocal_studies::chapter4::work::library::Library;
use dynocal_studies::chapter4::work::objective_signal::{Origin, compare};
use dynocal_studies::chapter4::work::population::{NOISE, Population, VALIDATION, measure};
use dynocal_studies::chapter4::work::published::R2_TORQUE;
use dynocal_studies::chapter4::work::source::{DesignCriterion, Source, signals};
use dynocal_studies::chapter4::work::{Chapter4Error, Output, Setting, Size};

fn measured(source: Source, n: usize) -> Population {
    let size = Size { identification: n, validation: n, designed: 0, seed: 11 };
    measure(&Library::new(size).unwrap(), source, &|| false).unwrap()
}

/// Mean R2 of models from random signals, all noise levels and kinds of unseen signals.
#[test]
fn random_signals_give_the_reference_populations() {
    for source in [Source::Aprbs, Source::Udrn] {
        let found = measured(source, 100);
        for row in R2_TORQUE.iter().filter(|r| r.source == source) {
            for (kind, (mean, se)) in VALIDATION.into_iter().zip(row.reference) {
                let score = found.score(Output::Torque, row.noise_variance, kind).unwrap();
                let distance = (score.r2 - mean) / score.se.hypot(se);
                assert!(distance.abs() <= 3.0, "{source:?} on {kind:?}: {score:?}, reference {mean} ({se})");
            }
        }
    }
}

/// Criteria against medians of another implementation (400 signals), three standard errors of the mean wide.
#[test]
fn criteria_of_random_signals_agree_with_another_implementation() {
    let found = measured(Source::Udrn, 100);
    for (criterion, median) in
        [(DesignCriterion::D, -402.7), (DesignCriterion::I, 4696.0), (DesignCriterion::Ai, 1.64e6)]
    {
        let s = found.criterion(Output::Torque, criterion).unwrap();
        // The standard error of a median is 1.25 times that of the mean; two medians are compared.
        assert!((s.median - median).abs() <= 3.0 * 1.25 * 1.2 * s.se, "{criterion:?}: {s:?}, {median}");
    }
    let lambda = found.criterion(Output::Lambda, DesignCriterion::D).unwrap();
    assert!((lambda.median + 479.3).abs() <= 3.0 * 1.25 * 1.2 * lambda.se, "{lambda:?}");
}

/// Two levels: singular, so that no criterion has a value, and still a model of least norm.
#[test]
fn a_two_level_signal_is_reported_singular() {
    let found = measured(Source::Prbs, 8);
    assert_eq!(found.rank, [(22, 22), (18, 18)]);
    assert!(found.criteria.iter().all(|c| c.stat.is_none()), "{:?}", found.criteria);
    assert!(found.scores.iter().all(|s| s.r2.is_finite()));
}

/// What the search says it reached is what the criterion of the record is.
#[test]
fn designs_keep_their_objective_and_beat_random_signals() {
    let design = Source::Design(DesignCriterion::D);
    let (found, random) = (measured(design, 3), measured(Source::Udrn, 3));
    let own = found.criterion(Output::Torque, DesignCriterion::D).unwrap();
    let objective = found.objective.unwrap();
    assert!((own.mean - objective.mean).abs() <= 1e-9 * own.mean.abs());
    assert!(own.high < random.criterion(Output::Torque, DesignCriterion::D).unwrap().low - 20.0);
    for (output, noise) in NOISE {
        let e = |p: &Population| p.parameter_error(output, noise).unwrap().n;
        assert_eq!((e(&found), e(&random)), (3, 3));
    }
}

/// The same bytes for any number of threads, and an interrupt is obeyed.
#[test]
fn results_do_not_depend_on_threads() {
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| serde_json::to_string(&measured(Source::Aprbs, 6)).unwrap())
    };
    assert_eq!(run(1), run(3));
    let setting = Setting::new().unwrap();
    let stopped = signals(&setting, Source::Design(DesignCriterion::D), 2, 1, 1, &|| true);
    assert!(matches!(stopped, Err(Chapter4Error::Interrupted)));
}

/// The reference numbers that are stored with the study are those of the reference file.
#[test]
fn stored_references_are_those_of_the_file() {
    let Some(dir) = std::env::var_os("DYNOCAL_REFERENCE_DIR") else {
        println!("SKIPPED: DYNOCAL_REFERENCE_DIR is not set");
        return;
    };
    let path = std::path::Path::new(&dir).join("reference/design_reference.json");
    let file: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    for row in R2_TORQUE {
        let key = format!("{}_{}", row.noise_variance, row.source.name().to_uppercase());
        for (kind, (mean, se)) in ["PRBS", "APRBS", "UDRN"].into_iter().zip(row.reference) {
            let stored = &file["population_R2_percent_mean_se"][&key][kind];
            assert!((stored[0].as_f64().unwrap() - mean).abs() < 1e-3, "{key} {kind}");
            assert!((stored[1].as_f64().unwrap() - se).abs() < 1e-3, "{key} {kind}");
        }
    }
}

/// Standard deviations of estimates over repeated experiments are those of the bound, within what a biased least-squares
/// estimate with a measured regressor allows; designed signals scatter less.
#[test]
fn repeated_estimates_scatter_as_the_bound_says() {
    let library = Library::new(Size { identification: 1, validation: 1, designed: 0, seed: 5 }).unwrap();
    let of = |source| distribution(&library, source, 400, &|| false).unwrap();
    let (random, designed) = (of(Source::Udrn), of(Source::Design(DesignCriterion::D)));
    for d in [&random, &designed] {
        let ratio = d.deviation / d.bound;
        assert!((0.8..1.25).contains(&ratio), "{:?}: {} against {}", d.source, d.deviation, d.bound);
    }
    assert!(designed.deviation < random.deviation);
}

/// Bounds of a population: A falls below random signals in the sum of squares, D in the mean ratio.
#[test]
fn bounds_of_designs_lie_below_those_of_random_signals() {
    let (random, d) = (measured(Source::Udrn, 6), measured(Source::Design(DesignCriterion::D), 6));
    assert_eq!((random.bounds.len(), d.bounds.len()), (23, 23));
    let ratio = d.bounds.iter().zip(&random.bounds).map(|(a, b)| a.mean / b.mean).sum::<f64>() / 23.0;
    assert!(ratio < 0.8, "{ratio}");
    // J_A is the sum of the squared bounds, signal by signal: means obey Jensen's inequality.
    let j_a = random.criterion(Output::Torque, DesignCriterion::A).unwrap().mean;
    let of_means: f64 = random.bounds.iter().map(|b| b.mean * b.mean).sum();
    assert!(of_means <= j_a && of_means > 0.5 * j_a, "{of_means} {j_a}");
}

/// Signs of correlation do not matter, equal signals correlate fully, and random ones as the theory says.
#[test]
fn correlations_are_those_of_independent_signals() {
    let library = Library::new(Size { identification: 1, validation: 100, designed: 0, seed: 2 }).unwrap();
    let theory = (2.0 / (std::f64::consts::PI * 99.0)).sqrt();
    for source in [Source::Prbs, Source::Aprbs, Source::Udrn] {
        for (mean, se) in correlations(&library, source, &|| false).unwrap().mean_se {
            assert!((mean - theory).abs() <= 4.0 * se + 0.002, "{source:?}: {mean} ({se}), theory {theory}");
        }
    }
}

/// Within limits: they are kept, AI designs lead in every column, two levels stay singular, and the shares of the box and
/// the criterion are those of an independent implementation (0.43, 0.58, 0.70 of the box).
#[test]
fn output_limits_are_kept_and_designs_use_them() {
    let size = Size { identification: 12, validation: 12, designed: 6, seed: 3 };
    let found = constrained(&Setting::new().unwrap(), Limits::Output, size, &|| false).unwrap();
    assert!(found.rows.iter().all(|r| r.violation <= 5e-5), "{:?}", found.rows);
    let (ai, others) = found.rows.split_last().unwrap();
    assert!(others[0].criterion.is_none(), "a PRBS is singular");
    for (row, share) in others.iter().zip([0.43, 0.58, 0.70]) {
        let s = row.share.unwrap();
        assert!((s.mean - share).abs() < 0.05, "{:?}: {}, reference {share}", row.kind, s.mean);
    }
    assert!(ai.criterion.unwrap().median < 0.1 * others[1].criterion.unwrap().median);
}

#[test]
fn rate_limits_are_kept_by_walks_and_designs() {
    let size = Size { identification: 10, validation: 10, designed: 5, seed: 3 };
    for levels in [9, 5] {
        let limits = Limits::Rate { levels };
        let found = constrained(&Setting::new().unwrap(), limits, size, &|| false).unwrap();
        let [walk, ai] = &found.rows[..] else { panic!("two rows") };
        assert!(walk.violation <= 1e-9 && ai.violation <= 1e-9, "{} {}", walk.violation, ai.violation);
        let (w, a) = (walk.criterion.unwrap().median, ai.criterion.unwrap().median);
        assert!(a < 0.5 * w, "{levels}: {a} against {w}");
    }
}

/// The same start for every search, histories that fall, and an end that is the criterion of the record.
#[test]
fn searches_start_equal_and_never_rise() {
    let setting = Setting::new().unwrap();
    let mut starts = Vec::new();
    for search in SEARCHES {
        let found = converge(&setting, search, DesignCriterion::A, 400, 2, 4, &|| false).unwrap();
        for path in &found.paths {
            assert!(path.best.windows(2).all(|w| w[1].1 < w[0].1), "{search}");
            assert!(path.evaluations <= 401 && path.end <= path.start, "{search}: {path:?}");
            let last = path.best.last().unwrap().1;
            assert!((last / path.end - 1.0).abs() < 1e-6, "{search}: {last} {}", path.end);
        }
        starts.push(found.paths.iter().map(|p| p.start).collect::<Vec<f64>>());
    }
    assert!(starts.windows(2).all(|w| w[0] == w[1]), "{starts:?}");
}

/// Data of all iterations, used, lead on; the latest record alone does not.
#[test]
fn pooled_iterations_approach_the_truth() {
    let size = Size { identification: 12, validation: 0, designed: 0, seed: 2 };
    let of = |data| iterate(&Setting::new().unwrap(), data, size, &|| false).unwrap().error;
    let (pooled, fresh) = (of(Use::Pooled), of(Use::Fresh));
    let mean = |e: &[Option<dynocal_studies::chapter4::work::statistics::Stat>], k: usize| e[k].unwrap().mean;
    assert_eq!(mean(&pooled, 1), mean(&fresh, 1), "the first iteration is the same");
    assert!(mean(&pooled, 5) < 0.5 * mean(&pooled, 0));
    assert!(mean(&pooled, 5) < mean(&fresh, 5));
}

/// A design for the control loop predicts the loop better than random signals of the same length do, and any design for
/// broadband signals beats them on those.
#[test]
fn objective_signals_decide_what_a_model_is_good_at() {
    let library = Library::new(Size { identification: 10, validation: 30, designed: 0, seed: 4 }).unwrap();
    let found = compare(&library, &|| false).unwrap();
    for c in &found {
        println!("{}: loop {:?}, APRBS {:?}, UDRN {:?}", c.origin.name(), c.on_loop, c.on_aprbs, c.on_udrn);
    }
    let of = |origin| found.iter().find(|c| c.origin == origin).unwrap();
    let random = of(Origin::Known(Source::Udrn));
    assert!(of(Origin::ForLongLoop).on_loop.rmse < random.on_loop.rmse);
    assert!(of(Origin::ForUdrn).on_udrn.rmse < random.on_udrn.rmse);
    assert!(of(Origin::Known(Source::Design(DesignCriterion::I))).on_aprbs.rmse < random.on_aprbs.rmse);
}
