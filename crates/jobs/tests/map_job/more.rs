//! Plans, stops, edits, inverse maps: what a day may be told, and what is made of its maps.

use dynocal_calib::map::FeedforwardMap;
use dynocal_calib::steady::day::Purpose;
use dynocal_calib::steady::envelope::Envelope;
use dynocal_calib::steady::grid::{CellState, interpolate};
use dynocal_calib::steady::station::{ApproachSpec, Leg, Station};
use dynocal_design::points::optimal::{log_determinant, mean_variance};
use dynocal_ident::model::response::{Ask, Prediction, Response};
use dynocal_ident::pi::PiGains;
use dynocal_jobs::map::{Mapped, job, page, work};
use dynocal_jobs::place::Overrides;
use dynocal_numerics::interval::Interval;
use dynocal_numerics::watch::Watch;

use super::engine::{Bench, DAY, Fault, best, fuel, oil_at_rest, run_with, text};

fn day(keys: &str) -> String {
    DAY.replace("[bed]\n", &format!("[bed]\n{keys}\n"))
}

/// Points that were planned, as asked, in the units of the cube.
fn planned(found: &Mapped) -> Vec<Vec<f64>> {
    let of = found.points.iter().filter(|p| p.purpose == Purpose::Plan);
    of.map(|p| found.layout.to_unit(&p.point.asked)).collect()
}

/// Whatever the points are planned by, the maps are near the optimum that is known. Optimal ones tell more of a quadratic than those that
/// fill the space, each by its own measure, and after the first block they lie inside of what was reached.
#[test]
fn plans_of_every_kind_give_maps() {
    let run =
        |plan: &str| run_with(&day(&format!("plan = \"{plan}\"")), 2, Bench::new(0.5, Fault::None)).unwrap();
    let mut told = std::collections::BTreeMap::new();
    let kinds = ["sobol", "latin_hypercube", "maximin", "d_optimal", "v_optimal", "i_optimal"];
    for kind in kinds {
        let found = run(kind);
        assert!(found.valid, "{kind}: {} {:?}", found.verdict, found.warnings);
        for c in found.cells.iter().filter(|c| c.state == CellState::Optimal) {
            let (least, ..) = best(c.at[0], c.at[1], 0.0);
            let got = fuel(c.at[0], c.at[1], c.optimum.x[2], c.optimum.x[3], 0.0);
            assert!(got <= 1.015 * least, "{kind} {:?}: {got} against {least}", c.at);
        }
        if kind.ends_with("_optimal") {
            let plan: Vec<_> = found.points.iter().filter(|p| p.purpose == Purpose::Plan).collect();
            let first = plan[..10].iter().filter(|p| p.point.usable);
            let repeat = found.points.iter().find(|p| p.purpose == Purpose::Repeat).unwrap();
            let reached: Vec<Vec<f64>> = first
                .map(|p| {
                    if p.point.touched.is_empty() {
                        p.point.asked[..2].to_vec()
                    } else {
                        p.point.factors[..2].to_vec()
                    }
                })
                .chain([repeat.point.asked[..2].to_vec()])
                .collect();
            let ranges: Vec<Interval> =
                found.layout.factors[..2].iter().map(|f| Interval::new(f.lower, f.upper)).collect();
            let hull = Envelope::of(&reached, &ranges);
            for p in &plan[10..] {
                assert!(hull.outside(&p.point.asked[..2]) < 0.01, "{kind}: {:?}", p.point.asked);
            }
        }
        told.insert(kind, planned(&found));
    }
    let determinant = |kind: &str| log_determinant(&told[kind]);
    let even: Vec<Vec<f64>> =
        (0..81).map(|k| [1, 3, 9, 27].map(|d| 0.5 * f64::from(k / d % 3)).to_vec()).collect();
    let variance = |kind: &str| mean_variance(&told[kind], &even);
    for filling in ["sobol", "latin_hypercube", "maximin"] {
        assert!(determinant("d_optimal") > determinant(filling), "{filling}");
        assert!(variance("i_optimal") < variance(filling), "{filling}");
    }
}

/// A random order moves no point to another block, and repeats are what they were.
#[test]
fn blocks_are_randomised() {
    let run = |keys: &str| run_with(&day(keys), 3, Bench::new(0.0, Fault::None)).unwrap();
    let (short, random) = (planned(&run("")), planned(&run("order = \"random\"")));
    let sorted = |block: &[Vec<f64>]| {
        let mut all: Vec<String> = block.iter().map(|x| format!("{x:.9?}")).collect();
        all.sort();
        all
    };
    assert!(short.len() == random.len() && short.len() > 10);
    for (a, b) in short.chunks(10).zip(random.chunks(10)) {
        assert_eq!(sorted(a), sorted(b));
        assert!(a.len() < 4 || a != b, "in another order");
    }
}

/// A stop in the unit of what is minimised: what the optimum may still lie below the maps, and the interval of what they promise. A day that
/// asks for little more than nothing stops early and says so; one that asks for what cannot be goes on to its end.
#[test]
fn a_day_stops_when_more_points_are_worth_too_little() {
    let run = |keys: &str| {
        let refine = format!("{DAY}[bed.refine]\ntolerance = 0.0\nbatch = 4\n{keys}\n");
        // Every cell can be reached: what is left to be tried stops no day.
        let text = text(&refine).replace("torque = [30.0, 50.0, 70.0]", "torque = [30.0, 45.0, 60.0]");
        let job = job::parse("map.toml", &text, &Overrides { seed: Some(1), out: None }).unwrap();
        work::run_on(&job, &mut Bench::new(0.5, Fault::None), Watch::silent()).unwrap()
    };
    let (early, late) = (run("gain = 5.0\ninterval = 5.0"), run("gain = 1e-6"));
    let left = early.enough.unwrap_or_else(|| panic!("{:?}", early.rounds));
    assert!(left.gain <= 5.0 && left.interval <= 5.0, "{left:?}");
    assert!(late.enough.is_none() && early.points.len() < late.points.len());
    let check =
        |m: &Mapped, id: &str| serde_json::to_value(m.checks.iter().find(|c| c.id == id).unwrap()).unwrap();
    assert_eq!(check(&early, "gain")["unit"], "kg/h");
    assert!(check(&early, "interval").to_string().contains("no more points were taken for it"));
    assert!(check(&late, "gain").to_string().contains("ended otherwise"));
    // It is the whole of what was left: half as much as asked stops later or never.
    let between = run(&format!("gain = {}", 0.5 * left.gain));
    assert!(between.points.len() >= early.points.len());
}

/// Cells that a user has edited stand in the maps as they are; what they cost and break is said, and faults are named with their place.
#[test]
fn edits_are_kept_and_judged() {
    let tmp = tempfile::tempdir().unwrap();
    let file = tmp.path().join("edits.csv");
    let write = |rows: &str| dynocal_files::atomic::write(&file, rows.as_bytes()).unwrap();
    let spec = format!("edits = \"{}\"\n{}", file.display(), text(DAY));
    let run = || {
        let job = job::parse("map.toml", &spec, &Overrides { seed: Some(1), out: None }).unwrap();
        work::run_on(&job, &mut Bench::new(0.0, Fault::None), Watch::silent()).map(|m| (m, job))
    };
    // A spark of 1 at 50 Nm knocks: 0.2 + 0.3 + 0.6 = 1.1.
    write("torque [Nm],speed [rpm],spark [-],cam [-]\n50,1500,0.6,\n50,1900,1.0,0.2\n");
    let (found, job) = run().unwrap();
    let cell = |m: &Mapped, at: [f64; 2]| m.cells.iter().find(|c| c.at == at).unwrap().clone();
    let (fine, broken) = (cell(&found, [50.0, 1500.0]), cell(&found, [50.0, 1900.0]));
    assert!(fine.state == CellState::Optimal && fine.optimum.x[2] == 0.6, "{fine:?}");
    assert!(broken.state == CellState::Edited && broken.optimum.x[2..] == [1.0, 0.2], "{broken:?}");
    assert!(!found.valid, "{}", found.verdict);
    let says = |m: &Mapped, what: &str| m.warnings.iter().any(|w| w.contains(what));
    assert!(
        says(&found, "the edit at torque 50.00 Nm, speed 1900 rpm breaks limits: `knock` by 0.1"),
        "{:?}",
        found.warnings
    );
    let e = &found.edits[0];
    assert!(
        e.passed.is_empty() && e.costs > 0.0 && e.values.len() == 1 && e.words().contains("`spark` 0.6"),
        "{e:?}"
    );
    // What it costs is what the engine takes more.
    let closed = |spark: f64| fuel(50.0, 1500.0, spark, fine.optimum.x[3], 0.0);
    assert!((e.costs - closed(0.6) + closed(e.values[0].optimum)).abs() < 0.1, "{e:?}");
    // The load of the edited cell is that of the edited spark, and the map that leaves has both.
    assert!((fine.optimum.responses[0] / closed(0.6) - 1.0).abs() < 0.01);
    let place = found.map.ports.actuators.iter().position(|a| a.name == "spark").unwrap();
    assert!(
        found.map.points.iter().any(|p| p.demand == 50.0 && p.given == 1500.0 && p.actuators[place] == 0.6)
    );
    let html = dynocal_report::render(&page::report(&found, &job)).unwrap();
    assert!(html.contains("held as edited") && html.contains("Limits that it breaks"));
    let refused = |rows: &str| {
        write(rows);
        // A bed that stalls at once: the edits are read before it is run.
        let job = job::parse("map.toml", &spec, &Overrides { seed: Some(1), out: None }).unwrap();
        let found = work::run_on(&job, &mut Bench::new(0.0, Fault::Stalls(0.0)), Watch::silent());
        found.map(|m| m.verdict).unwrap_err().to_string()
    };
    let e = refused("torque,speed,spark\n50,1500,0.6\n51,1500,0.6\n");
    assert!(e.contains("edits.csv, line 3, column `torque`: found 51") && e.contains("30, 50, 70"), "{e}");
    // Another unit of the same kind is converted, and what is none is refused.
    let e = refused("torque [Nm],speed [rpm],spark [-]\n50,1500,1.6\n");
    assert!(e.contains("found 1.6, expected 0 to 1"), "{e}");
    let e = refused("torque [kNm],speed [rpm],spark [-]\n0.05,1500,1.6\n");
    assert!(e.contains("found 1.6, expected 0 to 1"), "{e}");
    let e = refused("torque [Nm],speed [kg],spark [-]\n50,1500,0.6\n");
    assert!(e.contains("column `speed`: found the unit kg, expected rpm"), "{e}");
    let e = refused("torque,speed,spark\n50,1500,1.6\n");
    assert!(e.contains("line 2, column `spark`: found 1.6, expected 0 to 1"), "{e}");
    let e = refused("torque,speed,load\n50,1500,60\n");
    assert!(e.contains("found column `load`") && e.contains("spark, cam"), "{e}");
    let e = refused("torque,speed,spark\n50,1500,0.6\n50,1500,0.7\n");
    assert!(e.contains("line 3") && e.contains("each cell once"), "{e}");
}

/// The inverse of the load's map gives the torque that the load holds, and the page and the folder have it.
#[test]
fn inverse_maps_give_back_the_torque() {
    let found = run_with(DAY, 1, Bench::new(0.0, Fault::None)).unwrap();
    let i = &found.inverses[0];
    assert!(i.input == "load" && i.output == "torque" && i.givens == [1100.0, 1500.0, 1900.0], "{i:?}");
    // As many values of the load as it takes for half a percent of 40 Nm.
    assert!(i.several.is_empty() && i.error <= 0.2 && i.inputs.len() <= 9, "{i:?}");
    let axes: Vec<Vec<f64>> = found.axes.iter().map(|a| a.points.clone()).collect();
    for (u, row) in i.inputs.iter().zip(i.values.chunks(3)) {
        for (n, y) in i.givens.iter().zip(row).filter(|(_, y)| **y > 30.0 && **y < 70.0) {
            let x = interpolate(&axes, &found.cells, &[*y, *n]);
            let load = fuel(*y, *n, x[2], x[3], 0.0);
            assert!((u / load - 1.0).abs() < 0.02, "{u} gives {y} Nm at {n} rpm, which takes {load}");
        }
    }
    assert!(found.loops.len() == 2 * 6, "{}", found.loops.len());
    for l in &found.loops {
        // The map stands at the bottom of its loop, as far as limits let it and smoothing costs.
        let least = l.change.iter().zip(&l.kept).filter(|(_, k)| **k).map(|(c, _)| *c).fold(0.0, f64::min);
        assert!(least > -0.005, "{l:?}");
    }
    assert!(found.verified_cells.len() == 9 && found.verified_cells.contains(&Some(true)));
}

/// What is known of the inputs of loops is fed forward: a slow loop has only the rest to do, and the point comes to rest sooner.
#[test]
fn what_loops_will_set_is_fed_forward() {
    let mut layout = run_with(DAY, 1, Bench::new(0.0, Fault::None)).unwrap().layout;
    layout.loops[0].gains = PiGains { ki: 0.15, kp: 0.05 };
    let approach = ApproachSpec { settle_s: 60.0, window_s: 1.0, average_s: 2.0, ..ApproachSpec::default() };
    let took = |driven: &[f64]| {
        let mut bench = Bench::new(0.0, Fault::None);
        let begin = (vec![30.0, 1500.0, 0.5, 0.5], vec![fuel(30.0, 1500.0, 0.5, 0.5, 0.0)]);
        let mut station = Station::new(&mut bench, &layout, &approach, &|_| 0.0, begin, &|| false);
        let p = station.measure(&[60.0, 1500.0, 0.5, 0.5], None, driven, &[]).unwrap();
        assert!(p.usable && p.errors[0].abs() < 0.5, "{p:?}");
        p.used_s
    };
    let known = fuel(60.0, 1500.0, 0.5, 0.5, 0.0);
    let (without, with, rough) = (took(&[]), took(&[known]), took(&[1.1 * known]));
    assert!(with < 0.6 * without && rough < without, "{with} {rough} {without}");
    assert_eq!(took(&[f64::NAN]), without);
}

/// Gains that come in along the way make a loop that is slow for its place as fast as one that was tuned for it.
#[test]
fn gains_that_are_raised_make_a_slow_loop_as_fast() {
    let mut layout = run_with(DAY, 1, Bench::new(0.0, Fault::None)).unwrap().layout;
    let approach = ApproachSpec { settle_s: 60.0, window_s: 1.0, average_s: 2.0, ..ApproachSpec::default() };
    let mut took = |ki: f64, gains: &[f64]| {
        layout.loops[0].gains = PiGains { ki, kp: ki / 3.0 };
        let mut bench = Bench::new(0.0, Fault::None);
        let begin = (vec![30.0, 1500.0, 0.5, 0.5], vec![fuel(30.0, 1500.0, 0.5, 0.5, 0.0)]);
        let mut station = Station::new(&mut bench, &layout, &approach, &|_| 0.0, begin, &|| false);
        let p = station.measure(&[60.0, 1500.0, 0.5, 0.5], None, &[], gains).unwrap();
        assert!(p.usable && p.errors[0].abs() < 0.5, "{p:?}");
        p.used_s
    };
    let (slow, raised, tuned) = (took(0.15, &[]), took(0.15, &[4.0]), took(0.6, &[]));
    assert!(raised < 0.7 * slow && raised <= 1.25 * tuned, "{slow} {raised} {tuned}");
    assert_eq!((took(0.15, &[f64::NAN]), took(0.15, &[1.0])), (slow, slow));
}

/// A line that meets a limit, on the way to it or along it, leaves the bed where the limit is kept: what comes next is not ended by it.
#[test]
fn a_line_that_meets_a_limit_goes_back_within_it() {
    let job = job::parse("map.toml", &text(DAY), &Overrides::default()).unwrap();
    let layout = run_with(DAY, 1, Bench::new(0.0, Fault::None)).unwrap().layout;
    let approach: ApproachSpec = job.spec.bed.approach.clone();
    let mut bench = Bench::new(0.0, Fault::None);
    let begin = (vec![60.0, 1500.0, 0.5, 0.5], vec![fuel(60.0, 1500.0, 0.5, 0.5, 0.0)]);
    let mut station = Station::new(&mut bench, &layout, &approach, &|_| 0.0, begin, &|| false);
    let leg = |torque: f64, spark: f64, seconds| Leg {
        to: vec![torque, 1500.0, spark, 0.5],
        driven: vec![0.0],
        gains: Vec::new(),
        seconds,
    };
    // The first limit is met on the way to the line: knock is 0.2 + 0.006 torque + 0.6 spark, and heat 500 + 3 torque - 100 spark + 150 cam.
    let on_the_way = station.sweep(&[70.0, 1500.0, 0.9, 0.5], &[leg(30.0, 0.9, 10.0)]).unwrap();
    assert!(on_the_way.rows.is_empty() && on_the_way.touched.unwrap().output == "knock");
    assert_eq!(station.at(), [60.0, 1500.0, 0.5, 0.5]);
    // Along it: after the first leg, in the second.
    let along =
        station.sweep(&[30.0, 1500.0, 0.5, 0.5], &[leg(50.0, 0.5, 5.0), leg(50.0, 1.0, 10.0)]).unwrap();
    assert!(along.rows.iter().any(|r| r.leg == 1) && along.touched.unwrap().output == "knock");
    assert_eq!(station.at(), [50.0, 1500.0, 0.5, 0.5]);
    // And what comes next is not ended.
    let whole = station.sweep(&[30.0, 1500.0, 0.5, 0.5], &[leg(60.0, 0.5, 10.0)]).unwrap();
    assert!(whole.touched.is_none() && whole.rows.len() == 10, "{whole:?}");
}

/// The bed time is not passed: the last point begins only where there is room for it.
#[test]
fn a_day_ends_within_its_bed_time() {
    for minutes in [11.0, 12.0] {
        let found = run_with(&day(&format!("minutes = {minutes}")), 4, Bench::new(0.5, Fault::None)).unwrap();
        assert!(found.bed.all_s() <= 60.0 * minutes, "{} of {minutes} min", found.bed.all_s() / 60.0);
    }
}

/// Oil is behind in points and along lines, and helps by 0.1 Nm a K: maps are for an engine whose oil has come to rest, which is known in closed
/// form, when it is named as slow, and miss three times as much when it is not. What is no output is refused; what stands still is said to.
#[test]
fn what_a_slow_channel_does_is_taken_out() {
    let day = |more: &str| day(more) + "[bed.sweep]\npass_s = 15.0\n[optimise]\nbetween = 0.002\n";
    let miss = |more: &str| {
        let found = run_with(&day(more), 4, Bench::new(0.2, Fault::Oil)).unwrap();
        let axes: Vec<Vec<f64>> = found.axes.iter().map(|a| a.points.clone()).collect();
        let load = found.map.ports.actuators.iter().position(|a| a.name == "load").unwrap();
        let (mut squares, mut promised): (f64, f64) = (0.0, 0.0);
        for i in 0..=12 {
            let at = [30.0 + 25.0 * f64::from(i % 4) / 3.0, 1100.0 + 800.0 * f64::from(i) / 12.0];
            let x = interpolate(&axes, &found.cells, &at);
            let rest = fuel(at[0] - 0.1 * (oil_at_rest(at[0], at[1]) - 380.0), at[1], x[2], x[3], 0.0);
            squares += (found.map.steady(&at)[load] / rest - 1.0).powi(2);
            let model = found.models.iter().find(|m| m.response == "fuel").unwrap();
            let mut expected = Prediction::new(4);
            model.predict(&x, Ask::Mean, &mut expected);
            promised += (expected.mean / rest - 1.0).powi(2);
        }
        ((squares / 13.0).sqrt(), (promised / 13.0).sqrt(), found)
    };
    let (with, fuel_with, found) = miss("slow = \"oil\"");
    let rest = found.rest.as_ref().unwrap();
    assert!((rest.effect.unwrap() - 0.1).abs() < 0.02, "{rest:?}");
    assert!((40.0 / 1.3..1.3 * 40.0).contains(&rest.tau_s.unwrap()), "{rest:?}");
    assert!(rest.words().contains("Nm less of `torque`"), "{}", rest.words());
    // No point waits for it, and no verdict speaks of it.
    assert!(found.layout.responses.iter().any(|r| r.slow && r.name == "oil"));
    assert!(!found.warnings.iter().any(|w| w.contains("oil")), "{:?}", found.warnings);
    let (without, fuel_without, other) = miss("");
    assert!(other.rest.is_none());
    assert!(with < 0.01 && with < without / 3.0, "{with} {without}");
    assert!(fuel_with < 0.01 && fuel_with < fuel_without / 2.0, "{fuel_with} {fuel_without}");
    let refused = |name: &str, fault: Fault| {
        run_with(&day(&format!("slow = \"{name}\"")), 1, Bench::new(0.2, fault)).unwrap_err().to_string()
    };
    for (name, says) in [("load", "bed.slow: the plant has no output `load`"), ("water", "no output `water`")]
    {
        let e = refused(name, Fault::Oil);
        assert!(e.contains(says) && e.contains("oil [K]"), "{e}");
    }
    // What stands still is said to.
    let still = run_with(&day("slow = \"oil\""), 1, Bench::new(0.2, Fault::None)).unwrap().rest.unwrap();
    assert!(
        still.effect.is_none() && still.words().contains("`oil` moved by 0 K in the points"),
        "{still:?}"
    );
}
