//! The car, its driver and drive cycles: analytic coast-down, energy balance, the figures of the road-load page.

use dynocal_plant::engine::VirtualEngine;
use dynocal_plant::params::EngineParams;
use dynocal_plant::vehicle::*;

fn time_to_50_mph(units: LoadUnits) -> f64 {
    let mut car = Car::thesis();
    car.road_load.units = units;
    let mut state = car.at_rest();
    let dt = 0.001;
    let mut t = 0.0;
    while state.speed_mps < 50.0 * 0.44704 {
        car.step(&mut state, 100.0, 0.0, dt);
        t += dt;
        assert!(t < 60.0);
    }
    t
}

#[test]
fn a_constant_100_nm_reaches_50_mph_within_the_thesis_20_seconds() {
    // Independent integration of eq. (3.5): 19.2 s, 15.2 s and 16.1 s for the three readings of Table 3.3.
    for (units, expected) in
        [(LoadUnits::LbfMph, 19.2), (LoadUnits::NewtonMps, 15.2), (LoadUnits::NewtonKmh, 16.1)]
    {
        let found = time_to_50_mph(units);
        assert!((found - expected).abs() < 0.1, "{units:?}: {found}");
    }
}

#[test]
fn coasting_follows_the_closed_solution() {
    // m_e dv/dt = -(A + B v + C v^2): arctangent in v when 4AC > B^2.
    let car = Car::thesis();
    let [a, b, c] = car.road_load.si();
    let inertia = car.inertia_kg_m2 / car.tyre_radius_m.powi(2);
    let root = (4.0 * a * c - b * b).sqrt();
    let angle = |v: f64| ((2.0 * c * v + b) / root).atan();
    let time = |from: f64, to: f64| inertia * 2.0 / root * (angle(from) - angle(to));
    let mut state = CarState { speed_mps: 30.0, gear: 4, distance_m: 0.0 };
    let dt = 0.01;
    for _ in 0..2000 {
        car.step(&mut state, 0.0, 0.0, dt);
    }
    assert!((time(30.0, state.speed_mps) - 20.0).abs() < 1e-4, "{}", time(30.0, state.speed_mps));
}

#[test]
fn engine_work_is_kinetic_energy_plus_resistance() {
    let car = Car::thesis();
    let inertia = car.inertia_kg_m2 / car.tyre_radius_m.powi(2);
    let residual = |dt: f64| {
        let mut s = car.at_rest();
        let (mut work, mut lost) = (0.0, 0.0);
        for _ in 0..(10.0 / dt) as usize {
            let (before, ratio) = (s.speed_mps, car.ratio(s.gear));
            car.step(&mut s, 80.0, 0.0, dt);
            let mean = 0.5 * (before + s.speed_mps);
            work += 80.0 * ratio / car.tyre_radius_m * mean * dt;
            lost += car.resistance_n(mean) * mean * dt;
        }
        (work - lost - 0.5 * inertia * s.speed_mps.powi(2)).abs() / work
    };
    assert!(residual(0.01) < 1e-7);
}

#[test]
fn gears_follow_speed_with_hysteresis_and_never_hunt() {
    let car = Car::thesis();
    let mph = 0.44704;
    assert_eq!(car.gear_for(9.9 * mph, 0), 0);
    assert_eq!(car.gear_for(10.0 * mph, 0), 1);
    assert_eq!(car.gear_for(45.0 * mph, 0), 4);
    assert_eq!(car.gear_for(39.0 * mph, 4), 4);
    assert_eq!(car.gear_for(37.9 * mph, 4), 3);
    for speed in 0..600 {
        let v = 0.05 * f64::from(speed);
        let g = (0..5).map(|g| car.gear_for(v, g)).collect::<Vec<_>>();
        assert!(g.iter().all(|&g| car.gear_for(v, g) == g));
    }
}

#[test]
fn a_car_at_rest_stays_at_rest_and_never_rolls_back() {
    let car = Car { grade: 0.1, ..Car::thesis() };
    let mut s = car.at_rest();
    for _ in 0..100 {
        car.step(&mut s, 0.0, 0.0, 0.02);
    }
    assert_eq!((s.speed_mps, s.distance_m), (0.0, 0.0));
}

#[test]
fn regulated_cycles_are_followed_within_their_tolerance() {
    let Some(folder) = std::env::var_os("DYNOCAL_REFERENCE_DIR") else {
        println!("SKIPPED: DYNOCAL_REFERENCE_DIR is not set");
        return;
    };
    // Distances as the provenance page gives them.
    for (name, km) in [("wltc_class3b", 23.266), ("us06", 12.888), ("udds", 11.990), ("nedc", 11.013)] {
        let path = std::path::Path::new(&folder).join(format!("data/drive_cycles/{name}.csv"));
        let text = std::fs::read_to_string(path).expect("drive cycle");
        let rows = text.lines().skip(1).map(|l| {
            let mut c = l.split(',').map(|x| x.parse::<f64>().expect("number"));
            (c.next().expect("time"), c.next().expect("speed"))
        });
        let (t, v) = rows.unzip();
        let cycle = DriveCycle::new(t, v).expect("cycle");
        assert!((cycle.distance_m() / 1e3 - km).abs() < 0.01, "{name}: {}", cycle.distance_m());
        let mut source = IdealTorque::new(-20.0, 300.0);
        let log =
            drive(&Car::thesis(), &cycle, &mut source, DriveOptions::default(), &|| false).expect("drive");
        assert_eq!(log.outside, 0, "{name}: rms {}", log.rms_error_mps());
        assert!((log.distance_m / cycle.distance_m() - 1.0).abs() < 0.005, "{name}");
    }
}

#[test]
fn bad_cycles_are_refused_with_their_row() {
    let bad =
        |t: &[f64], v: &[f64]| DriveCycle::new(t.to_vec(), v.to_vec()).expect_err("refused").to_string();
    assert!(bad(&[0.0, 1.0, 1.0], &[0.0; 3]).contains("row 3"));
    assert!(bad(&[0.0, 1.0], &[0.0, f64::NAN]).contains("row 2"));
    assert!(bad(&[0.0, 1.0], &[-1.0, 0.0]).contains("row 1"));
    assert!(bad(&[0.0], &[0.0]).contains("at least 2 rows"));
}

#[test]
fn the_virtual_engine_drives_a_car() {
    let engine = VirtualEngine::new(&EngineParams::thesis()).expect("engine");
    let grid = SteadyGrid::measure(&engine, &[800.0, 1500.0, 2500.0, 3500.0], 5).expect("grid");
    let (least, most) = grid.limits_nm(2000.0);
    assert!(least < -5.0 && most > 110.0, "{least} {most}");
    let mut source = EngineInCar::with_grid(engine, grid);
    // Launch, cruise, overrun, standstill.
    let cycle = DriveCycle::new(vec![0.0, 2.0, 14.0, 24.0, 34.0, 40.0], vec![0.0, 0.0, 14.0, 14.0, 0.0, 0.0])
        .expect("cycle");
    let car = Car::thesis();
    let log = drive(&car, &cycle, &mut source, DriveOptions::default(), &|| false).expect("drive");
    assert_eq!(log.outside, 0, "rms {}", log.rms_error_mps());
    let cut = log.power.iter().filter(|p| p.inj_mg == 0.0).count();
    assert!(cut > 50, "overrun without fuel cut-off: {cut} steps");
    // Fuel is at least the mechanical work through a 40 % efficient engine, and no more than through a 10 % one.
    let heat_j = log.fuel_g * 43.0e3;
    let efficiency = log.engine_work_j / heat_j;
    assert!((0.05..0.40).contains(&efficiency), "{efficiency}");
}
