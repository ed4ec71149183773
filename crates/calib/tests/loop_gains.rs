//! Loops in a limit cycle are recognised, and gains from a short identification on the plant are quiet there.

use dynocal_calib::gains::{TuneSpec, Tuned, from_tests, test_plan, tune};
use dynocal_ident::data::Dataset;
use dynocal_ident::pi::PiGains;
use dynocal_ident::plan::{Plan, PlanChannel, PlanDemand, PlanLoop};
use dynocal_ident::plant::Plant;
use dynocal_ident::play::{Unwatched, oscillation, play};
use dynocal_plant::bed::{BedSettings, EngineBed};
use dynocal_plant::params::EngineParams;
use dynocal_plant::sensors::NoiseLevels;

fn bed(set: &str) -> EngineBed {
    let params = EngineParams::named(set).unwrap();
    EngineBed::new(&params, BedSettings::of_set(set, &params).unwrap()).unwrap()
}

fn noisy(set: &str, noise: NoiseLevels) -> EngineBed {
    let params = EngineParams::named(set).unwrap();
    EngineBed::new(&params, BedSettings { noise, ..BedSettings::of_set(set, &params).unwrap() }).unwrap()
}

/// Gains of torque by throttle and of lambda by injection that suit the engine of the thesis.
const OTHER_ENGINE: [PiGains; 2] = [PiGains { ki: 0.3, kp: 0.2 }, PiGains { ki: -40.0, kp: -8.0 }];

/// Torque and lambda held at one point from a rough start, as a static map does.
fn hold(torque_nm: f64, speed_rpm: f64, gains: [PiGains; 2]) -> Plan {
    let n = 600;
    let channel = |name: &str, unit: &str, value: f64| PlanChannel::free(name, unit, vec![value; n]);
    let channels = vec![
        channel("inj", "mg", 4.0 + 0.18 * torque_nm).within(1.0, 30.0),
        channel("spark", "deg", 20.0),
        channel("throttle", "deg", 5.0 + 0.15 * torque_nm).within(0.0, 60.0),
        channel("speed", "rpm", speed_rpm),
    ];
    let demand = |output: &str, unit: &str, value: f64| PlanDemand {
        output: output.into(),
        unit: unit.into(),
        values: vec![value; n],
    };
    Plan::open_loop(&format!("{torque_nm} Nm, {speed_rpm} rpm"), 0.03, channels)
        .with_loops(
            vec![demand("torque", "Nm", torque_nm), demand("lambda", "-", 1.0)],
            vec![
                PlanLoop::closed("torque", "throttle", gains[0]),
                PlanLoop::closed("lambda", "inj", gains[1]),
            ],
        )
        .settled(3.0)
        .recording(&["torque", "lambda"])
}

/// Mean and standard deviation of the last half.
fn half(record: &Dataset, channel: &str) -> (f64, f64) {
    let v = record.values(channel).unwrap();
    let v = &v[v.len() / 2..];
    let mean = v.iter().sum::<f64>() / v.len() as f64;
    (mean, (v.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / v.len() as f64).sqrt())
}

/// The points of the bed: low torque at low speed is where the throttle acts most.
const POINTS: [(f64, f64); 3] = [(20.0, 1100.0), (50.0, 2000.0), (80.0, 2900.0)];

/// The real bed of the 1.6 l engine: gains that suit another engine swing torque by tens of Nm at 20 Nm and 1100 rpm, which is
/// recognised; gains identified there are quiet there.
#[test]
fn gains_of_another_engine_are_recognised_and_own_ones_are_quiet() {
    for (torque, speed) in POINTS {
        let plan = hold(torque, speed, OTHER_ENGINE);
        let record = play(&mut bed("pfi_1_6l"), &plan, &mut Unwatched).unwrap().record;
        let (_, sd) = half(&record, "torque");
        let seen: Vec<_> = plan.loops.iter().filter_map(|l| oscillation(&record, l).unwrap()).collect();
        println!("{}: gains of the thesis, torque sd {sd:.2} Nm, {seen:?}", plan.name);
        if (torque, speed) == POINTS[0] {
            assert!(sd > 5.0, "{sd}");
            assert!(seen.iter().any(|o| o.output == "torque" && o.amplitude > 5.0), "{seen:?}");
        }
        let spec = TuneSpec::default();
        let tuned = tune(&mut bed("pfi_1_6l"), std::slice::from_ref(&plan), &spec, 1, &|| false).unwrap();
        kept(&tuned, &spec);
        quiet(&Plan { loops: tuned.loops, ..plan }, torque);
    }
}

/// One set of gains for the whole range, found at its ends and quiet there and between.
#[test]
fn one_set_of_gains_serves_all_points() {
    let spec = TuneSpec::default();
    let ends: Vec<Plan> = [POINTS[0], POINTS[2]].map(|(t, s)| hold(t, s, OTHER_ENGINE)).into();
    let tuned = tune(&mut bed("pfi_1_6l"), &ends, &spec, 1, &|| false).unwrap();
    println!("{tuned:?}");
    kept(&tuned, &spec);
    assert_eq!(tuned.points.len(), 2);
    for (torque, speed) in POINTS {
        quiet(&Plan { loops: tuned.loops.clone(), ..hold(torque, speed, OTHER_ENGINE) }, torque);
    }
    // Equal seeds, equal gains.
    assert_eq!(tuned, tune(&mut bed("pfi_1_6l"), &ends, &spec, 1, &|| false).unwrap());
}

/// The same from records of tests that were driven elsewhere, about the inputs where the demands are held.
#[test]
fn records_of_tests_give_gains_too() {
    let spec = TuneSpec::default();
    let plans: Vec<Plan> = POINTS.map(|(t, s)| at_rest(hold(t, s, OTHER_ENGINE))).into();
    let records: Vec<Dataset> = plans
        .iter()
        .enumerate()
        .map(|(k, p)| {
            let test = test_plan(p, &spec, 1, k);
            assert!(test.loops.is_empty() && test.len() == 1000, "{}", test.len());
            play(&mut bed("pfi_1_6l"), &test, &mut Unwatched).unwrap().record
        })
        .collect();
    let tuned = from_tests(&plans, &records, &spec).unwrap();
    kept(&tuned, &spec);
    for (torque, speed) in POINTS {
        quiet(&Plan { loops: tuned.loops.clone(), ..hold(torque, speed, OTHER_ENGINE) }, torque);
    }
}

/// The plan with the inputs that hold its demands, found with gains that are quiet there.
fn at_rest(plan: Plan) -> Plan {
    let tuned = tune(&mut bed("pfi_1_6l"), std::slice::from_ref(&plan), &TuneSpec::default(), 1, &|| false);
    let inputs = &tuned.unwrap().points[0].inputs;
    let channels = plan.channels.iter().zip(inputs);
    let channels =
        channels.map(|(c, v)| PlanChannel { values: vec![*v; c.values.len()], ..c.clone() }).collect();
    Plan { channels, ..plan }
}

/// Noise of the sensors leaves the gains what they are (least squares of a noisy record had them ten times too small), and the
/// point where the demands are held, too.
#[test]
fn noise_of_the_sensors_does_not_bend_the_gains() {
    let spec = TuneSpec::default();
    for (set, torque, speed) in
        [("pfi_1_6l", 50.0, 2000.0), ("pfi_1_6l", 20.0, 1100.0), ("thesis", 60.0, 1600.0)]
    {
        let plan = hold(torque, speed, OTHER_ENGINE);
        let found = |torque_nm: f64, lambda: f64, seed: u64| {
            let mut bed = noisy(set, NoiseLevels { torque_nm, lambda });
            bed.reset(seed);
            tune(&mut bed, std::slice::from_ref(&plan), &spec, 1, &|| false).unwrap()
        };
        let quiet = found(0.0, 0.0, 1);
        println!("{set} {torque} {speed}: {:?} {:.0} s", quiet.loops, quiet.used_s);
        for seed in 1..=3 {
            let tuned = found(1.0, 0.01, seed);
            kept(&tuned, &spec);
            for (a, b) in tuned.loops.iter().zip(&quiet.loops) {
                let (ki, kp) = (a.gains.ki / b.gains.ki, a.gains.kp / b.gains.kp);
                println!("  {} ki {ki:.2} kp {kp:.2}, {:.0} s", a.output, tuned.used_s);
                assert!(
                    (0.5..2.0).contains(&ki) && (0.5..2.0).contains(&kp),
                    "{set} {}: {ki} {kp}",
                    a.output
                );
            }
        }
    }
}

/// An input that does nothing is said, with both names.
#[test]
fn a_loop_without_an_answer_is_refused() {
    let mut plan = hold(50.0, 2000.0, OTHER_ENGINE);
    plan.loops = vec![PlanLoop::closed("lambda", "spark", OTHER_ENGINE[1])];
    plan.demands.retain(|d| d.output == "lambda");
    let fault =
        tune(&mut bed("pfi_1_6l"), &[plan], &TuneSpec::default(), 1, &|| false).unwrap_err().to_string();
    assert!(fault.contains("`lambda` by `spark`"), "{fault}");
}

fn kept(tuned: &Tuned, spec: &TuneSpec) {
    for p in &tuned.points {
        assert!(p.log_modulus_db <= 2.0 * spec.log_modulus_db, "{p:?}");
        assert!(p.loops.iter().all(|m| m.sensitivity <= spec.sensitivity), "{p:?}");
    }
}

/// Held within half a Nm and 0.01 of lambda, and no loop oscillates.
fn quiet(plan: &Plan, torque_nm: f64) {
    let record = play(&mut bed("pfi_1_6l"), plan, &mut Unwatched).unwrap().record;
    let ((mean, sd), (lambda, lambda_sd)) = (half(&record, "torque"), half(&record, "lambda"));
    println!("{}: own gains, {mean:.3} sd {sd:.3} Nm, lambda {lambda:.4} sd {lambda_sd:.4}", plan.name);
    assert!((mean - torque_nm).abs() < 0.5 && sd < 1.0, "{mean} {sd}");
    assert!((lambda - 1.0).abs() < 0.01 && lambda_sd < 0.02, "{lambda} {lambda_sd}");
    for l in &plan.loops {
        assert_eq!(oscillation(&record, l).unwrap(), None);
    }
}
