//! Beds that fail and specs that cannot be.

use dynocal_jobs::map::{MapError, job, work};
use dynocal_jobs::place::Overrides;
use dynocal_numerics::watch::Watch;

use super::engine::{Bench, DAY, Fault, run_with, text};

#[test]
fn a_bed_that_stalls_is_said_to_have_stalled() {
    let early = run_with(DAY, 1, Bench::new(0.1, Fault::Stalls(30.0))).unwrap_err().to_string();
    assert!(early.contains("the engine has stalled") && early.contains("points can be used"), "{early}");
    // After enough points there is a map, but not one to be used.
    let late = run_with(DAY, 1, Bench::new(0.1, Fault::Stalls(300.0))).unwrap();
    assert!(!late.valid && late.verdict.contains("must not be used"), "{}", late.verdict);
    assert!(late.warnings.iter().any(|w| w.contains("stalled")), "{:?}", late.warnings);
}

#[test]
fn points_that_never_settle_are_not_learnt_from() {
    let e = run_with(DAY, 1, Bench::new(0.1, Fault::Swings)).unwrap_err().to_string();
    assert!(e.contains("0 of ") && (e.contains("not at rest") || e.contains("oscillates")), "{e}");
}

#[test]
fn a_response_without_signal_is_refused_with_its_numbers() {
    let day = DAY.replace("[bed]\n", "[bed]\nbeyond = { knock = 1.0 }\n");
    let e = run_with(&day, 1, Bench::new(1.0, Fault::NoSignal)).map(|m| m.verdict).unwrap_err();
    assert!(matches!(&e, MapError::NoSignal { response, .. } if response == "knock"), "{e}");
}

/// Heat at most 560 K while 70 Nm alone give 500 + 210 - 100: no setting keeps it, and the day itself is stopped by it.
#[test]
fn an_empty_feasible_region_names_its_limits() {
    let text = text(&DAY.replace("[bed]\n", "[bed]\nbeyond = { heat = 500.0, knock = 1.0 }\n"));
    let text = text.replace("upper = 720.0", "upper = 560.0");
    let job = job::parse("map.toml", &text, &Overrides { seed: Some(1), out: None }).unwrap();
    let found = work::run_on(&job, &mut Bench::new(0.0, Fault::None), Watch::silent()).unwrap();
    assert!(!found.valid);
    let high: Vec<&String> = found.warnings.iter().filter(|w| w.contains("torque 70")).collect();
    assert!(high.iter().any(|w| w.contains("`heat`") && w.contains("above 560")), "{:?}", found.warnings);
    // 700 - 100 + ... with spark as far as knock lets it go: 0.63 at 70 Nm leaves 500 + 210 - 63 = 647, 87 K too much.
    let c = found.cells.iter().find(|c| c.at == [70.0, 1500.0]).unwrap();
    let worst = c.optimum.prices.iter().map(|p| p.passed).fold(f64::NEG_INFINITY, f64::max);
    assert!((40.0..95.0).contains(&worst), "{worst}");
}

/// Heat of 675 K where the day begins, and at most 560: the message says that it began outside of its limits, and of which.
#[test]
fn a_day_that_begins_outside_of_its_limits_is_said_to_do_so() {
    let text = text(DAY).replace("upper = 720.0", "upper = 560.0");
    let job = job::parse("map.toml", &text, &Overrides { seed: Some(1), out: None }).unwrap();
    let e = work::run_on(&job, &mut Bench::new(0.0, Fault::None), Watch::silent()).unwrap_err().to_string();
    assert!(
        e.contains("`heat` beyond its limit of 560")
            && e.contains("where the bed stood is outside of its limits"),
        "{e}"
    );
}

/// A value that is held has to lie in the range of its channel.
#[test]
fn a_held_value_out_of_its_range_is_refused() {
    let text = text(DAY).replace("[axes]\ntorque = [30.0, 50.0, 70.0]\n", "[held]\ntorque = HELD\n[axes]\n");
    for (held, fine) in [("50.0", true), ("-1e308", false), ("nan", false), ("81.0", false)] {
        let read = job::parse("map.toml", &text.replace("HELD", held), &Overrides::default());
        assert_eq!(read.is_ok(), fine, "{held}");
        if let Err(e) = read {
            assert!(e.to_string().contains("`held.torque`") && e.to_string().contains("20 to 80 Nm"), "{e}");
        }
    }
}

/// A rest along a line has windows of which some count also where time is short, and no line rests at its turn as well.
#[test]
fn rests_of_lines_are_long_enough_to_tell_something() {
    let cases = [
        ("rest_s = 4.0", None),
        ("rest_s = 0.0\nturn_s = 4.0", None),
        ("rest_s = 3.9", Some(("`bed.sweep.rest_s`", "4 s and more"))),
        ("rest_s = -1.0", Some(("`bed.sweep.rest_s`", "0 to 600 s"))),
        ("rest_s = nan", Some(("`bed.sweep.rest_s`", "0 to 600 s"))),
        ("rest_s = 8.0\nturn_s = 4.0", Some(("`bed.sweep.turn_s`", "`rest_s`"))),
    ];
    for (keys, fault) in cases {
        let text = text(&format!("{DAY}[bed.sweep]\n{keys}\n"));
        match (job::parse("map.toml", &text, &Overrides::default()), fault) {
            (Ok(_), None) => {}
            (Err(e), Some((key, expected))) => {
                let e = e.to_string();
                assert!(e.contains(key) && e.contains(expected), "{keys}: {e}");
            }
            (read, _) => panic!("{keys}: {:?}", read.map(|j| j.name).map_err(|e| e.to_string())),
        }
    }
}

/// Bed time that lines and verification take alone is a fault of the spec, and is said with what takes it.
#[test]
fn bed_time_that_does_not_reach_for_the_points_is_refused_before_the_bed_runs() {
    let short = DAY.replacen("[bed]\n", "[bed]\nminutes = 2.0\n", 1);
    let text = text(&format!("{short}[bed.sweep]\nrest_s = 30.0\n"));
    let e = job::parse("map.toml", &text, &Overrides::default()).map(|j| j.name).unwrap_err().to_string();
    assert!(e.contains("`bed.minutes`") && e.contains("lines of the maps take"), "{e}");
}
