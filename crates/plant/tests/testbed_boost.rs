//! The bed of the turbocharged engine: limits of boosted running, cams that follow their schedule, what a real bed adds.

use dynocal_ident::plant::{Causality, Plant, variable_index};
use dynocal_numerics::rng::Rng64;
use dynocal_plant::bed::{BedSettings, EngineBed, LimitSettings};
use dynocal_plant::params::EngineParams;
use dynocal_plant::testbed::guard::Action;
use dynocal_plant::testbed::settings::BedOptions;

fn gtdi(options: BedOptions) -> EngineBed {
    let p = EngineParams::named("gtdi_2l").unwrap();
    let set = BedSettings::of_set("gtdi_2l", &p).unwrap();
    EngineBed::new(&p, BedSettings { options, ..set }).unwrap()
}

fn limit(what: &str, max: Option<f64>, min: Option<f64>, action: Action, within_s: f64) -> LimitSettings {
    LimitSettings { what: what.into(), max, min, action, within_s, ..LimitSettings::default() }
}

#[test]
fn limits_of_combustion_are_not_exceeded_for_longer_than_stated() {
    let ranges = [(20.0, 75.0), (15.0, 45.0), (30.0, 90.0), (1500.0, 3500.0), (0.0, 12.0)];
    let limits = [
        limit("knock", Some(1.0), None, Action::RetardSpark, 0.5),
        limit("egt", Some(980.0), None, Action::Enrich, 0.5),
        limit("burned_share", None, Some(0.5), Action::Enrich, 0.5),
    ];
    kept(&limits, ranges);
}

#[test]
fn limits_of_boost_are_not_exceeded_for_longer_than_stated() {
    let ranges = [(25.0, 55.0), (5.0, 35.0), (20.0, 90.0), (2500.0, 5000.0), (0.0, 12.0)];
    let limits = [
        limit("boost", Some(165.0), None, Action::OpenWastegate, 1.0),
        limit("turbo_speed", Some(130e3), None, Action::OpenWastegate, 2.0),
        limit("pmax", Some(70.0), None, Action::RetardSpark, 0.5),
    ];
    kept(&limits, ranges);
}

/// Drives the free engine and one under `limits` by the same random fuel, spark, throttle, speed, wastegate.
fn kept(limits: &[LimitSettings], ranges: [(f64, f64); 5]) {
    let names: Vec<String> = limits.iter().map(|l| l.what.clone()).collect();
    let inputs = vec!["wastegate".to_owned()];
    // Exhaust temperature is always there.
    let outputs: Vec<String> = names.iter().filter(|n| *n != "egt").cloned().collect();
    let mut y = vec![0.0; 5 + outputs.len()];
    let free = BedOptions { inputs: inputs.clone(), outputs, ..BedOptions::default() };
    let mut beds = [gtdi(free.clone()), gtdi(BedOptions { limits: limits.to_vec(), ..free })];
    let places: Vec<usize> =
        names.iter().map(|n| variable_index(&beds[0], Causality::Output, n).unwrap()).collect();
    let mut u: Vec<f64> = beds[0].variables()[..5].iter().map(|v| v.start).collect();
    let mut rng = Rng64::new(8);
    let h = 0.004;
    let (mut now, mut longest, mut fuelled) = ([[0.0f64; 3]; 2], [[0.0f64; 3]; 2], [9.0f64; 2]);
    let mut seen = Vec::new();
    for k in 0..6_000 {
        // Held for two to four seconds: a shaft needs that to spin up.
        if k % 500 == 0 || (k % 250 == 0 && rng.uniform() < 0.5) {
            for (u, range) in u.iter_mut().zip(ranges) {
                *u = rng.uniform_in(range.0, range.1);
            }
        }
        for (b, bed) in beds.iter_mut().enumerate() {
            bed.step(&u, h, &mut y).unwrap();
            let fuel = bed.engine().state().inputs.injection_mg > 0.0;
            fuelled[b] = if fuel { fuelled[b] + h } else { 0.0 };
            for (i, limit) in limits.iter().enumerate() {
                let counts = limit.what != "burned_share" || fuelled[b] >= 1.0;
                let outside = counts && limit.violated(y[places[i]]).is_some();
                now[b][i] = if outside { now[b][i] + h } else { 0.0 };
                longest[b][i] = longest[b][i].max(now[b][i]);
            }
        }
        seen.extend(beds[1].take_events().into_iter().map(|e| e.what));
    }
    for (i, limit) in limits.iter().enumerate() {
        let (free, kept) = (longest[0][i], longest[1][i]);
        assert!(kept <= limit.within_s + 1e-9, "{}: {kept} s, free {free} s", limit.what);
        assert!(free > limit.within_s, "{} is a limit that matters: {free}", limit.what);
        assert!(seen.iter().any(|w| w.starts_with(&limit.what)), "{} is reported", limit.what);
    }
}

#[test]
fn cams_follow_their_schedule_unless_they_are_inputs() {
    let p = EngineParams::named("gtdi_2l").unwrap();
    let schedule = p.cams.clone().unwrap();
    let mut bed = gtdi(BedOptions::default());
    let mut u: Vec<f64> = bed.variables()[..4].iter().map(|v| v.start).collect();
    let mut y = [0.0; 5];
    u[3] = 3500.0;
    (0..100).for_each(|_| bed.step(&u, 0.03, &mut y).unwrap());
    let found = bed.engine().state().inputs;
    let at = schedule.at(3500.0, bed.engine().outputs().map_kpa);
    assert!(
        (found.intake_mop_deg_btdc - at.0).abs() < 0.1 && (found.exhaust_mop_deg_atdc - at.1).abs() < 0.1
    );
    let inputs = ["intake_cam", "exhaust_cam", "egr"].map(str::to_owned).to_vec();
    let mut bed = gtdi(BedOptions { inputs, ..BedOptions::default() });
    let mut u: Vec<f64> = bed.variables()[..7].iter().map(|v| v.start).collect();
    (u[4], u[5], u[6]) = (220.0, 260.0, 8.0);
    bed.step(&u, 0.03, &mut y).unwrap();
    let found = bed.engine().state().inputs;
    assert_eq!((found.intake_mop_deg_btdc, found.exhaust_mop_deg_atdc, found.egr_mm), (220.0, 260.0, 8.0));
}

#[test]
fn the_set_comes_with_its_real_bed_at_its_start_point() {
    let p = EngineParams::named("gtdi_2l").unwrap();
    let set = BedSettings::of_set("gtdi_2l", &p).unwrap();
    let real = &set.options.engine;
    assert!(real.warm_up.is_some() && real.catalyst.is_some() && real.idle.is_some());
    assert!(real.scatter.heat > 0.0 && real.fuel_imbalance > 0.0 && set.options.throttle.lag_s > 0.0);
    assert_eq!(
        BedSettings::of_set("thesis", &EngineParams::thesis()).unwrap().options,
        BedOptions::default()
    );
    let mut bed = EngineBed::new(&p, set).unwrap();
    bed.reset(3);
    let u: Vec<f64> = bed.variables()[..4].iter().map(|v| v.start).collect();
    let mut y = [0.0; 5];
    let (mut torque, mut lambda, n) = (0.0, 0.0, 200);
    let mut work = Vec::new();
    for _ in 0..n {
        bed.step_angle(&u, 720.0, &mut y).unwrap();
        torque += y[0] / f64::from(n);
        lambda += y[1] / f64::from(n);
        work.push(bed.engine().cycle_log()[0].gross_work_j);
    }
    // Warm-up is not over at 90 degC oil, cylinders differ: near the point of the ideal engine, not on it.
    assert!((torque - 50.0).abs() < 3.0 && (lambda - 1.0).abs() < 0.02, "{torque} {lambda}");
    // COV of gross IMEP from scatter of heat (1.2 %) and burn (5 %): class value 1 to 2 %.
    let mean = work.iter().sum::<f64>() / work.len() as f64;
    let cov = (work.iter().map(|w| (w - mean).powi(2)).sum::<f64>() / work.len() as f64).sqrt() / mean;
    assert!(cov > 0.009 && cov < 0.02, "{cov}");
}

#[test]
fn a_real_bed_stands_random_inputs_over_the_whole_box_in_every_mode() {
    use dynocal_plant::testbed::dynamometer::DynoMode;
    for (mode, seed) in [(DynoMode::Speed, 1), (DynoMode::InertialSpeed, 2), (DynoMode::Load, 3)] {
        let mut options = BedOptions::real();
        options.dynamometer.mode = mode;
        options.inputs = ["wastegate", "egr", "intake_cam"].map(str::to_owned).to_vec();
        options.outputs =
            ["engine_speed", "pmax", "catalyst", "coolant", "oxygen"].map(str::to_owned).to_vec();
        let mut bed = gtdi(options);
        bed.reset(seed);
        let (inputs, outputs): (Vec<_>, Vec<_>) =
            bed.variables().to_vec().into_iter().partition(|v| v.causality == Causality::Input);
        let mut rng = Rng64::new(seed);
        let mut u: Vec<f64> = inputs.iter().map(|v| v.start).collect();
        let mut y = vec![0.0; outputs.len()];
        for _ in 0..400 {
            for (u, v) in u.iter_mut().zip(&inputs) {
                if rng.uniform() < 0.1 {
                    *u = rng.uniform_in(v.min, v.max);
                }
            }
            bed.step(&u, 0.02, &mut y).unwrap();
            assert!(y.iter().all(|v| v.is_finite()), "{mode:?}: {y:?}");
            bed.engine().check_state().unwrap();
            assert!(y[5] > 599.0 && y[5] < 6501.0 && (0.0..=1.0).contains(&y[9]), "{mode:?}: {y:?}");
            assert!(y[7] > 250.0 && y[7] < 1600.0 && y[8] > 290.0 && y[8] < 400.0, "{mode:?}: {y:?}");
        }
    }
}

/// A standard output that is named among the others is there once.
#[test]
fn a_standard_output_may_be_named() {
    let outputs = ["egt", "knock"].map(str::to_owned).to_vec();
    let bed = gtdi(BedOptions { outputs, ..BedOptions::default() });
    let outputs = bed.variables().iter().filter(|v| v.causality == Causality::Output);
    let names: Vec<&str> = outputs.map(|v| v.name.as_str()).collect();
    assert_eq!(names, ["torque", "lambda", "map", "egt", "fuel", "knock"]);
}
