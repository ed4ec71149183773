//! Populations of thesis chapter 4 against an independent implementation, and their invariances.

use dynocal_calib::chapter4::library::Library;
use dynocal_calib::chapter4::population::{NOISE, Population, VALIDATION, measure};
use dynocal_calib::chapter4::published::R2_TORQUE;
use dynocal_calib::chapter4::source::{DesignCriterion, Source, signals};
use dynocal_calib::chapter4::{Chapter4Error, Output, Setting, Size};

fn measured(source: Source, n: usize) -> Population {
    let size = Size { identification: n, validation: n, seed: 11 };
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
