//! The bed with its engine: balances, limits, sampling, save and restore, what a real engine adds.

use dynocal_ident::plant::{Causality, Plant, PlantError, variable_index};
use dynocal_numerics::rng::Rng64;
use dynocal_plant::bed::{BedSettings, EngineBed};
use dynocal_plant::engine::VirtualEngine;
use dynocal_plant::params::EngineParams;
use dynocal_plant::testbed::catalyst::CatalystSettings;
use dynocal_plant::testbed::dynamometer::{DynoMode, DynoSettings};
use dynocal_plant::testbed::guard::{Action, LimitSettings};
use dynocal_plant::testbed::idle::IdleSettings;
use dynocal_plant::testbed::sensor::SensorSettings;
use dynocal_plant::testbed::settings::{BedOptions, LoopSettings, RealEngine};
use dynocal_plant::testbed::thermal::ThermalSettings;
use rayon::prelude::*;

const START: [f64; 4] = [16.754, 18.95, 15.85, 2000.0];

fn bed(options: BedOptions) -> EngineBed {
    EngineBed::new(&EngineParams::thesis(), BedSettings { options, ..BedSettings::default() }).unwrap()
}

fn outputs(b: &EngineBed) -> Vec<f64> {
    vec![0.0; b.variables().iter().filter(|v| v.causality == Causality::Output).count()]
}

fn output(b: &EngineBed, name: &str) -> usize {
    variable_index(b, Causality::Output, name).unwrap()
}

fn start(b: &EngineBed) -> Vec<f64> {
    b.variables().iter().filter(|v| v.causality == Causality::Input).map(|v| v.start).collect()
}

fn dyno(mode: DynoMode) -> BedOptions {
    BedOptions { dynamometer: DynoSettings { mode, ..DynoSettings::default() }, ..BedOptions::default() }
}

/// Inputs over the whole range of part load, held for random times.
fn random(rng: &mut Rng64, u: &mut [f64]) {
    if rng.uniform() < 0.06 {
        u[0] = rng.uniform_in(2.0, 40.0);
        u[1] = rng.uniform_in(5.0, 45.0);
        u[2] = rng.uniform_in(3.0, 60.0);
    }
}

#[test]
fn an_ideal_bed_is_the_engine_itself() {
    let mut b = bed(BedOptions::default());
    let mut e = VirtualEngine::new(&EngineParams::thesis()).unwrap();
    let s = BedSettings::default();
    e.set_inputs(s.start).unwrap();
    e.advance_time(s.settle_s);
    let mut rng = Rng64::new(4);
    let mut u = START.to_vec();
    let mut y = [0.0; 5];
    for _ in 0..100 {
        random(&mut rng, &mut u);
        b.step(&u, 0.03, &mut y).unwrap();
        let mut v = e.state().inputs;
        (v.injection_mg, v.spark_deg, v.throttle_deg) = (u[0], u[1], u[2]);
        e.set_inputs(v).unwrap();
        e.clear_interval();
        e.advance_time(0.03);
        let z = e.outputs();
        assert_eq!(y, [z.torque_nm, z.lambda_interval, z.map_kpa, z.egt_k, z.fuel_kg_h]);
    }
}

#[test]
fn load_mode_balances_power_to_rounding_and_carries_its_load() {
    let mut b = bed(dyno(DynoMode::Load));
    let d = DynoSettings::default();
    let mut y = outputs(&b);
    let mut u = start(&b);
    let begin = b.bed_state().dyno;
    for k in 0..200 {
        u[3] = if k < 60 { 60.0 } else { 75.0 };
        b.step(&u, 0.02, &mut y).unwrap();
        let s = b.bed_state().dyno;
        let kinetic = 0.5 * d.inertia_kg_m2() * (s.omega * s.omega - begin.omega * begin.omega);
        let balance = s.engine_j - s.load_j + s.held_j - kinetic;
        assert!(balance.abs() < 1e-10 * s.load_j.max(1.0), "{balance}");
    }
    // The engine's own account of its work agrees with that of the shaft: gas work less friction over the same angle.
    assert!(b.bed_state().dyno.held_j == 0.0);
    // A higher load than torque brakes the rotor, a lower one accelerates it.
    let fall = b.bed_state().dyno.speed_rpm();
    u[3] = 20.0;
    (0..25).for_each(|_| b.step(&u, 0.02, &mut y).unwrap());
    assert!(b.bed_state().dyno.speed_rpm() > fall + 100.0);
    // Mean acceleration over whole cycles is (T - T_load)/J.
    let before = b.bed_state().dyno;
    let t0 = b.time_s();
    (0..20).for_each(|_| b.step(&u, 0.02, &mut y).unwrap());
    let after = b.bed_state().dyno;
    let mean_nm =
        (after.engine_j - before.engine_j) / (0.5 * (after.omega + before.omega) * (b.time_s() - t0));
    let expected = (mean_nm - 20.0) / d.inertia_kg_m2();
    let found = (after.omega - before.omega) / (b.time_s() - t0);
    assert!((found / expected - 1.0).abs() < 0.02, "{found} {expected}");
}

#[test]
fn inertial_speed_mode_holds_the_speed_and_shows_the_torque_as_load() {
    let mut b = bed(dyno(DynoMode::InertialSpeed));
    let mut y = outputs(&b);
    let mut u = start(&b);
    let mut worst: f64 = 0.0;
    for k in 0..150 {
        u[2] = if k < 50 { START[2] } else { 25.0 };
        u[0] = if k < 50 { START[0] } else { 25.0 };
        b.step(&u, 0.02, &mut y).unwrap();
        worst = worst.max((b.bed_state().dyno.speed_rpm() - 2000.0).abs());
    }
    assert!(worst > 1.0 && worst < 100.0, "a rotor with inertia moves, and is held: {worst}");
    // Over ten cycles the work of the load is the torque times the angle.
    let before = b.bed_state().dyno.load_j;
    (0..30).for_each(|_| b.step(&u, 0.02, &mut y).unwrap());
    let mean_nm = (b.bed_state().dyno.load_j - before) / (0.6 * u[3] * std::f64::consts::PI / 30.0);
    assert!((mean_nm - y[0]).abs() < 0.01 * y[0], "load {mean_nm}, torque {}", y[0]);
    u[3] = 3000.0;
    (0..100).for_each(|_| b.step(&u, 0.02, &mut y).unwrap());
    assert!((b.bed_state().dyno.speed_rpm() - 3000.0).abs() < 20.0);
}

#[test]
fn sampling_by_angle_and_by_time_see_the_same_engine() {
    // At 2000 rpm 0.03 s are 360 deg, exactly half a cycle.
    let (mut by_time, mut by_angle) = (bed(BedOptions::default()), bed(BedOptions::default()));
    let (mut y, mut z) = ([0.0; 5], [0.0; 5]);
    for _ in 0..20 {
        by_time.step(&START, 0.03, &mut y).unwrap();
        by_angle.step_angle(&START, 360.0, &mut z).unwrap();
        assert!((y[0] - z[0]).abs() < 1e-9 && (by_time.time_s() - by_angle.time_s()).abs() < 1e-12);
    }
    // One degree at a time: 720 samples are one cycle, and the crank has gone once round it.
    let angle = by_angle.engine().local_angle_deg(0);
    for k in 1..=720 {
        by_angle.step_angle(&START, 1.0, &mut z).unwrap();
        let turned = (by_angle.engine().local_angle_deg(0) - angle).rem_euclid(720.0);
        assert!((turned - f64::from(k % 720)).abs() <= 1.0 + 1e-6, "{k}: {turned}");
    }
    by_time.step(&START, 0.03, &mut y).unwrap();
    by_time.step(&START, 0.03, &mut y).unwrap();
    assert!((y[0] - z[0]).abs() < 1e-6);
    // Under load the speed changes within a sample, the angle does not.
    let mut b = bed(dyno(DynoMode::Load));
    let mut u = start(&b);
    u[3] = 20.0;
    let mut w = outputs(&b);
    let cycles = |b: &EngineBed| b.engine().state().cycle as f64 + b.engine().local_angle_deg(0) / 720.0;
    let before = cycles(&b);
    (0..10).for_each(|_| b.step_angle(&u, 720.0, &mut w).unwrap());
    assert!((cycles(&b) - before - 10.0).abs() < 1.5 / 720.0);
    assert!(b.bed_state().dyno.speed_rpm() > 2100.0);
    assert!(matches!(b.step_angle(&u, 0.0, &mut w), Err(PlantError::Call(_))));
}

#[test]
fn loops_reach_their_demands() {
    let loops = LoopSettings { torque: true, lambda: true, ..LoopSettings::default() };
    let mut b = bed(BedOptions { loops, ..BedOptions::default() });
    let names: Vec<&str> = b.variables()[..4].iter().map(|v| v.name.as_str()).collect();
    assert_eq!(names, ["lambda_demand", "spark", "torque_demand", "speed"]);
    let mut y = outputs(&b);
    for (torque, lambda) in [(50.0, 1.0), (80.0, 0.95)] {
        (0..300).for_each(|_| b.step(&[lambda, 20.0, torque, 2000.0], 0.03, &mut y).unwrap());
        assert!((y[0] - torque).abs() < 0.3 && (y[1] - lambda).abs() < 0.005, "{y:?}");
    }
}

/// Everything that moves on a bed, on.
fn full() -> BedOptions {
    let o = BedOptions::real();
    let mut sensors = o.sensors.clone();
    sensors.insert(
        "torque".into(),
        SensorSettings {
            delay_s: 0.02,
            noise: 0.5,
            drift: 0.4,
            drift_s: 20.0,
            quantum: 0.05,
            ..Default::default()
        },
    );
    let limits = vec![LimitSettings {
        what: "pmax".into(),
        max: Some(30.0),
        action: Action::RetardSpark,
        ..LimitSettings::default()
    }];
    let names = ["engine_speed", "pmax", "coolant", "lambda_post", "catalyst", "throttle_angle"];
    BedOptions {
        sensors,
        limits,
        outputs: names.map(str::to_owned).to_vec(),
        dynamometer: DynoSettings { mode: DynoMode::Load, ..DynoSettings::default() },
        engine: RealEngine { idle: Some(IdleSettings::default()), ..o.engine },
        ..o
    }
}

fn drive(b: &mut EngineBed, seed: u64, n: usize) -> Vec<Vec<f64>> {
    let mut rng = Rng64::new(seed);
    let mut u = start(b);
    let mut y = outputs(b);
    (0..n)
        .map(|_| {
            random(&mut rng, &mut u);
            b.step(&u, 0.03, &mut y).unwrap();
            y.clone()
        })
        .collect()
}

#[test]
fn a_full_bed_continues_identically_from_a_saved_state() {
    let mut a = bed(full());
    a.reset(u64::MAX - 3);
    drive(&mut a, 1, 60);
    let saved = a.save();
    let expected = drive(&mut a, 2, 60);
    let mut b = bed(full());
    b.restore(&saved).unwrap();
    assert_eq!(b.save(), saved);
    assert_eq!(drive(&mut b, 2, 60), expected);
    assert_eq!(a.save(), b.save());
    // Through JSON, as a run folder would keep it.
    let text = serde_json::to_string(&saved).unwrap();
    b.restore(&serde_json::from_str(&text).unwrap()).unwrap();
    assert_eq!(drive(&mut b, 2, 60), expected);
    let mut short = saved;
    short.0.pop();
    assert!(matches!(b.restore(&short), Err(PlantError::Call(_))));
    // Another seed: other cycles and other noise; the same seed: the same.
    let run = |b: &mut EngineBed, seed| {
        b.reset(seed);
        drive(b, 5, 20)
    };
    let first = run(&mut a, 9);
    assert_ne!(run(&mut b, 10), first);
    assert_eq!(run(&mut b, 9), first);
}

#[test]
fn parallel_beds_give_identical_results() {
    let one = bed(full());
    let task = |seed: u64| {
        let mut b = one.clone();
        b.reset(seed);
        drive(&mut b, seed, 15)
    };
    let seeds: Vec<u64> = (0..6).collect();
    let alone: Vec<_> = seeds.iter().map(|&s| task(s)).collect();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap();
    let together: Vec<_> = pool.install(|| seeds.par_iter().map(|&s| task(s)).collect());
    assert_eq!(alone, together);
}

#[test]
fn no_limit_is_exceeded_for_longer_than_stated() {
    let limit = |what: &str, max: Option<f64>, min: Option<f64>, action| LimitSettings {
        what: what.into(),
        max,
        min,
        action,
        within_s: 0.5,
        ..LimitSettings::default()
    };
    let limits = vec![
        limit("pmax", Some(40.0), None, Action::RetardSpark),
        limit("egt", Some(1000.0), None, Action::CloseThrottle),
        limit("lambda", Some(1.25), None, Action::Enrich),
        limit("lambda", None, Some(0.75), Action::Lean),
        limit("map", Some(80.0), None, Action::CloseThrottle),
    ];
    let mut free = bed(BedOptions::default());
    let mut guarded = bed(BedOptions { limits: limits.clone(), ..BedOptions::default() });
    let read = |b: &EngineBed| {
        let y = b.engine().outputs();
        let pmax = b.engine().cycle_log().iter().map(|c| 1e-5 * c.peak_pa).fold(0.0, f64::max);
        [pmax, y.egt_k, y.lambda_interval, y.lambda_interval, y.map_kpa]
    };
    let (mut rng, mut u) = (Rng64::new(11), START.to_vec());
    let mut y = outputs(&free);
    let h = 0.002;
    let (mut longest, mut free_longest, mut now, mut free_now) =
        ([0.0f64; 5], [0.0f64; 5], [0.0; 5], [0.0; 5]);
    let (mut fuelled, mut events) = (0.0, Vec::new());
    for k in 0..30_000 {
        if k % 10 == 0 {
            random(&mut rng, &mut u);
        }
        free.step(&u, h, &mut y).unwrap();
        guarded.step(&u, h, &mut y).unwrap();
        events.extend(guarded.take_events());
        fuelled = if guarded.engine().state().inputs.injection_mg > 0.0 { fuelled + h } else { 0.0 };
        let both =
            [(&free, &mut free_now, &mut free_longest, 9.0), (&guarded, &mut now, &mut longest, fuelled)];
        for (b, n, most, fuelled) in both {
            for (i, (limit, value)) in limits.iter().zip(read(b)).enumerate() {
                // Lambda means something from one second after fuel has returned.
                let counts = limit.what != "lambda" || fuelled >= 1.0;
                n[i] = if counts && limit.violated(value).is_some() { n[i] + h } else { 0.0 };
                most[i] = most[i].max(n[i]);
            }
        }
    }
    for (i, limit) in limits.iter().enumerate() {
        assert!(longest[i] <= limit.within_s + 1e-9, "{}: {} s", limit.what, longest[i]);
        assert!(
            free_longest[i] > limit.within_s,
            "{} is a limit that matters: {}",
            limit.what,
            free_longest[i]
        );
        assert!(events.iter().any(|e| e.what.starts_with(&limit.what)), "{} is reported", limit.what);
    }
    assert!(events.iter().all(|e| e.value.is_finite() && e.limit.is_finite()));
}

#[test]
fn inputs_outside_are_refused_or_saturate_as_chosen() {
    let outside = [150.0, 60.0, 15.0, 2000.0];
    let mut strict = bed(BedOptions::default());
    let mut y = outputs(&strict);
    assert!(matches!(strict.step(&outside, 0.03, &mut y), Err(PlantError::OutOfRange { .. })));
    let mut soft = bed(BedOptions { saturate: true, ..BedOptions::default() });
    let mut edge = bed(BedOptions::default());
    let mut z = y.clone();
    for _ in 0..3 {
        soft.step(&outside, 0.03, &mut y).unwrap();
        edge.step(&[120.0, 55.0, 15.0, 2000.0], 0.03, &mut z).unwrap();
        assert_eq!(y, z);
    }
    let events = soft.take_events();
    let what: Vec<&str> = events.iter().map(|e| e.what.as_str()).collect();
    assert_eq!(what, ["inj saturated", "spark saturated"], "once each");
    assert!(matches!(
        soft.step(&[f64::NAN, 19.0, 15.0, 2000.0], 0.03, &mut y),
        Err(PlantError::NonFinite { .. })
    ));
}

#[test]
fn unequal_cylinders_differ_and_the_engine_as_a_whole_does_not() {
    let engine =
        RealEngine { cylinder_seed: 3, fuel_imbalance: 0.04, burn_imbalance: 0.05, ..RealEngine::default() };
    let (mut equal, mut unequal) =
        (bed(BedOptions::default()), bed(BedOptions { engine, ..BedOptions::default() }));
    let mut y = outputs(&equal);
    let mut z = y.clone();
    for _ in 0..60 {
        equal.step(&START, 0.06, &mut y).unwrap();
        unequal.step(&START, 0.06, &mut z).unwrap();
    }
    let lambda = |b: &EngineBed| b.engine().cycle_log().map(|c| c.lambda);
    let spread =
        |x: [f64; 4]| x.iter().fold(0.0f64, |m, v| m.max(*v)) - x.iter().fold(9.0f64, |m, v| m.min(*v));
    assert!(spread(lambda(&equal)) < 0.01 && spread(lambda(&unequal)) > 0.02);
    assert!((y[1] - z[1]).abs() < 0.01, "mean fuel is the same: {} {}", y[1], z[1]);
    assert!(z[0] < y[0] + 0.2, "rich and lean cylinders burn less: {} {}", y[0], z[0]);
}

#[test]
fn a_cold_engine_warms_up_and_gains_torque() {
    let engine = RealEngine { warm_up: Some(ThermalSettings::default()), ..RealEngine::default() };
    let options = BedOptions {
        engine,
        tick_s: 0.02,
        outputs: ["coolant", "oil", "wall"].map(str::to_owned).to_vec(),
        ..BedOptions::default()
    };
    let mut b = bed(options);
    let mut y = outputs(&b);
    let rows: Vec<Vec<f64>> = (0..180)
        .map(|_| {
            b.step(&START, 1.0, &mut y).unwrap();
            y.clone()
        })
        .collect();
    let (first, last) = (&rows[2], &rows[179]);
    assert!(last[0] > first[0] + 3.0, "less friction and less wall heat: {} {}", first[0], last[0]);
    assert!(rows.windows(2).all(|w| w[1][5] >= w[0][5] - 1e-6), "coolant rises");
    assert!(last[7] > last[5] && last[5] > 320.0, "walls above coolant: {last:?}");
    // Heat of the gas into the walls is what the masses took up and gave away (oil also has its friction).
    let t = ThermalSettings::default();
    let s = b.bed_state().thermal.unwrap();
    let [cw, cc, co] = t.capacity_j_k;
    let stored = cw * (s.wall_k - t.start_k) + cc * (s.coolant_k - t.start_k) + co * (s.oil_k - t.start_k);
    assert!(stored + s.lost_j > 0.0);
}

#[test]
fn fuel_cut_idle_control_and_breakthrough() {
    let engine = RealEngine {
        idle: Some(IdleSettings::default()),
        catalyst: Some(CatalystSettings { oxygen_g: 0.6, ..CatalystSettings::default() }),
        ..RealEngine::default()
    };
    let names = ["engine_speed", "injected", "lambda_post", "oxygen"];
    let mut b =
        bed(BedOptions { engine, outputs: names.map(str::to_owned).to_vec(), ..dyno(DynoMode::Load) });
    let [speed, injected, post, oxygen] = names.map(|n| output(&b, n));
    let mut y = outputs(&b);
    let mut u = start(&b);
    // Overrun at 2000 rpm: fuel is cut at once, the store fills and oxygen breaks through.
    (u[2], u[3]) = (0.0, -30.0);
    let mut full_at = None;
    for k in 0..150 {
        b.step(&u, 0.02, &mut y).unwrap();
        assert_eq!(y[injected], 0.0);
        // At this flow less than the whole store is usable.
        if y[oxygen] > 0.75 && full_at.is_none() {
            full_at = Some(k);
        }
        if k > 20 && full_at.is_none() {
            assert!(y[post] < 3.0, "the store holds lambda behind: {} at {k}", y[post]);
        }
    }
    assert!(full_at.is_some() && y[post] > 0.8 * y[1] && y[1] > 3.0, "air behind the catalyst: {y:?}");
    // Let it fall: fuel returns below 1300 rpm and idle control catches 800 rpm.
    u[3] = 5.0;
    let mut back = None;
    for k in 0..600 {
        b.step(&u, 0.02, &mut y).unwrap();
        if y[injected] > 0.0 && back.is_none() {
            back = Some(y[speed]);
        }
        if k > 450 {
            assert!((y[speed] - 800.0).abs() < 60.0, "idle: {}", y[speed]);
        }
    }
    assert!((back.unwrap() - 1300.0).abs() < 60.0, "fuel returns at {back:?}");
    // Ten newton metres more, as of a compressor that cuts in, are carried.
    u[3] = 15.0;
    let mut least = 1e9f64;
    for _ in 0..400 {
        b.step(&u, 0.02, &mut y).unwrap();
        least = least.min(y[speed]);
    }
    assert!(least > 601.0 && (y[speed] - 800.0).abs() < 60.0, "load step at idle: {least}, {}", y[speed]);
}

#[test]
fn sensors_of_a_bed_delay_lag_and_quantise_what_the_ideal_bed_reads() {
    let sensors = [
        ("torque", SensorSettings { delay_s: 0.15, ..Default::default() }),
        ("egt", SensorSettings { lag_s: 0.8, quantum: 0.5, ..Default::default() }),
    ];
    let sensors = sensors.into_iter().map(|(n, s)| (n.to_owned(), s)).collect();
    let mut real = bed(BedOptions { sensors, tick_s: 0.01, ..BedOptions::default() });
    let mut ideal = bed(BedOptions::default());
    let (mut y, mut z) = (outputs(&real), outputs(&ideal));
    let mut rng = Rng64::new(2);
    let mut u = START.to_vec();
    let mut torque = Vec::new();
    let mut lag = ideal.engine().outputs().egt_k;
    for k in 0..200 {
        random(&mut rng, &mut u);
        real.step(&u, 0.01, &mut y).unwrap();
        ideal.step(&u, 0.01, &mut z).unwrap();
        torque.push(z[0]);
        if k >= 15 {
            assert_eq!(y[0], torque[k + 1 - 15], "15 samples later, exactly");
        }
        lag = z[3] + (lag - z[3]) * (-0.01f64 / 0.8).exp();
        assert!((y[3] - lag).abs() <= 0.25 + 1e-9 && (y[3] / 0.5).fract() == 0.0, "{} {lag}", y[3]);
    }
}

/// A limit has a bound, and its bounds are the right way round.
#[test]
fn limits_without_a_range_are_refused() {
    for (min, max, words) in
        [(None, None, "neither min nor max"), (Some(2.0), Some(1.0), "min 2 above max 1")]
    {
        let mut bed = BedOptions::default();
        bed.limits.push(LimitSettings { what: "knock".into(), min, max, ..LimitSettings::default() });
        let said = bed.check().unwrap_err().to_string();
        assert!(said.contains("bed.limits knock") && said.contains(words), "{said}");
    }
}
