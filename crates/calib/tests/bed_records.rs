//! Records of the virtual engine pass the check of a bed's record; cut, shifted, restamped and broken ones do not, and every
//! fault is named.

use dynocal_ident::data::{Channel, Dataset, Role};
use dynocal_ident::pi::PiGains;
use dynocal_ident::plan::{Plan, PlanChannel, PlanDemand, PlanLimit, PlanLoop};
use dynocal_ident::play::{RecordFault, Unwatched, check_record, play};
use dynocal_ident::signal;
use dynocal_numerics::rng::Rng64;
use dynocal_plant::bed::{BedSettings, EngineBed};
use dynocal_plant::params::EngineParams;

const DT: f64 = 0.03;
/// One minute.
const N: usize = 2000;

fn aprbs(range: (f64, f64), phase_s: f64, rng: &mut Rng64) -> Vec<f64> {
    let text =
        format!("lo = {:?}\nhi = {:?}\nhold_s = 3.0\nphase_s = {phase_s:?}\nlevels = 5", range.0, range.1);
    let mut u = vec![0.0; N];
    signal::signal("aprbs", &toml::from_str(&text).unwrap()).unwrap().fill(&mut u, DT, rng).unwrap();
    u
}

/// Up and down between the ends of the speed range in 8 s each.
fn sweep() -> Vec<f64> {
    (0..N).map(|t| 1000.0 + 2000.0 * (1.0 - (t as f64 * DT / 8.0 % 2.0 - 1.0).abs())).collect()
}

/// Levels of torque, lambda and spark over a speed sweep, torque and lambda in closed loop.
fn closed(seed: u64, gains: [PiGains; 2]) -> Plan {
    let mut rng = Rng64::new(seed);
    let (torque, lambda) = (aprbs((10.0, 90.0), 0.0, &mut rng), aprbs((0.9, 1.1), 1.0, &mut rng));
    let spark = aprbs((5.0, 30.0), 2.0, &mut rng);
    let channels = vec![
        PlanChannel::free("inj", "mg", vec![4.0 + 0.18 * torque[0]; N]).within(1.0, 30.0),
        PlanChannel::free("spark", "deg", spark).within(5.0, 30.0),
        PlanChannel::free("throttle", "deg", vec![5.0 + 0.15 * torque[0]; N]).within(0.0, 60.0),
        PlanChannel::free("speed", "rpm", sweep()),
    ];
    let demand =
        |output: &str, unit: &str, values| PlanDemand { output: output.into(), unit: unit.into(), values };
    let demands = vec![demand("torque", "Nm", torque), demand("lambda", "-", lambda)];
    let [torque, lambda] = gains;
    let loops =
        vec![PlanLoop::closed("torque", "throttle", torque), PlanLoop::closed("lambda", "inj", lambda)];
    Plan::open_loop("closed", DT, channels)
        .with_loops(demands, loops)
        .settled(3.0)
        .recording(&["torque", "lambda"])
}

/// Levels of throttle and spark at one speed, fuel as the throttle asks for.
fn open(seed: u64) -> Plan {
    let mut rng = Rng64::new(seed);
    let throttle = aprbs((12.0, 18.0), 0.0, &mut rng);
    let inj = throttle.iter().map(|a| 16.754 + 1.2 * (a - 15.85)).collect();
    let channels = vec![
        PlanChannel::free("inj", "mg", inj),
        PlanChannel::free("spark", "deg", aprbs((12.0, 25.0), 1.5, &mut rng)),
        PlanChannel::free("throttle", "deg", throttle),
        PlanChannel::free("speed", "rpm", vec![2000.0; N]),
    ];
    Plan::open_loop("open", DT, channels).settled(3.0).recording(&["torque", "lambda"])
}

const RETUNED: [PiGains; 2] = [PiGains { ki: 0.3, kp: 0.2 }, PiGains { ki: -40.0, kp: -8.0 }];
const THESIS: [PiGains; 2] = [PiGains { ki: 0.3, kp: 0.7 }, PiGains { ki: -20.0, kp: -1.5 }];

fn record(plan: &Plan, noise: bool) -> Dataset {
    let mut settings = BedSettings::default();
    if noise {
        (settings.noise.torque_nm, settings.noise.lambda) = (0.5, 0.005);
    }
    let mut bed = EngineBed::new(&EngineParams::thesis(), settings).unwrap();
    play(&mut bed, plan, &mut Unwatched).unwrap().whole().unwrap().record
}

fn plans() -> Vec<Plan> {
    vec![closed(1, RETUNED), closed(2, THESIS), closed(3, RETUNED), open(4), open(5)]
}

/// Outputs `samples` later (earlier where negative), the ends held.
fn shifted(record: &Dataset, samples: isize) -> Dataset {
    let mut out = record.clone();
    for c in out.channels.iter_mut().filter(|c| c.role == Role::Output) {
        let last = c.values.len() as isize - 1;
        c.values = (0..=last).map(|t| c.values[(t - samples).clamp(0, last) as usize]).collect();
    }
    out
}

fn stamped(record: &Dataset, stamps: impl Fn(usize) -> f64) -> Dataset {
    let mut out = record.clone();
    let values = (0..record.len()).map(stamps).collect();
    out.channels.push(Channel { name: "time".into(), unit: "s".into(), role: Role::Auxiliary, values });
    out
}

fn with(record: &Dataset, channel: &str, change: impl Fn(usize, f64) -> f64) -> Dataset {
    let mut out = record.clone();
    for c in out.channels.iter_mut().filter(|c| c.name == channel) {
        c.values = c.values.iter().enumerate().map(|(t, v)| change(t, *v)).collect();
    }
    out
}

#[test]
fn what_the_engine_plays_passes_and_what_is_broken_is_named() {
    for (plan, noise) in plans().into_iter().flat_map(|p| [(p.clone(), false), (p, true)]) {
        let good = record(&plan, noise);
        let said = |record: &Dataset| -> Vec<String> {
            check_record(&plan, record).iter().map(ToString::to_string).collect()
        };
        assert_eq!(said(&good), Vec::<String>::new(), "{} with noise {noise}", plan.name);
        assert_eq!(said(&stamped(&good, |t| t as f64 * DT)), Vec::<String>::new());

        // Cut at 42 of 60 s.
        let cut = good.part(0, 1400, "cut".into());
        let faults = check_record(&plan, &cut);
        assert!(
            matches!(faults[..], [RecordFault::Length { found: 1400, expected: 2000, .. }]),
            "{faults:?}"
        );
        assert_eq!(faults[0].to_string(), "it has 1400 samples (42.00 s), the plan has 2000 (60.00 s)");

        // Outputs shifted by 1 s, either way.
        for samples in [33, -33] {
            let late = said(&shifted(&good, samples));
            for output in ["torque", "lambda"] {
                assert!(late.iter().any(|f| f.contains(&format!("`{output}`"))), "{samples} {late:?}");
            }
        }

        // Stamps of another clock, of another sample time, and with a gap.
        let faults = check_record(&plan, &stamped(&good, |t| 123.0 + t as f64 * DT));
        assert_eq!(faults, [RecordFault::Start { found_s: 123.0 }]);
        let faults = check_record(&plan, &stamped(&good, |t| t as f64 * 0.05));
        assert!(matches!(faults[..], [RecordFault::Interval { .. }]), "{faults:?}");
        let gap = |t: usize| t as f64 * DT + if t == 700 { 0.012 } else { 0.0 };
        let faults = check_record(&plan, &stamped(&good, gap));
        assert!(matches!(faults[..], [RecordFault::Stamp { sample: 700, .. }]), "{faults:?}");

        // Torque 9999: once, for a while, all the time.
        for (from, to) in [(700, 701), (700, 1000), (0, N)] {
            let broken =
                said(&with(&good, "torque", |t, v| if (from..to).contains(&t) { 9999.0 } else { v }));
            // For a while it is implausible and stands still, and both are said.
            let named =
                !broken.is_empty() && broken.iter().all(|f| f.contains("`torque`") && f.contains("9999"));
            assert!(named, "{from} to {to}: {broken:?}");
        }

        // Inputs that were not driven as planned, and what is not there at all.
        let spark = said(&with(&good, "spark", |t, v| if t > 1000 { v + 2.0 } else { v }));
        assert!(spark.len() == 1 && spark[0].contains("`spark` is not as planned in 9"), "{spark:?}");
        let speed = said(&with(&good, "speed", |_, v| v / 60.0));
        assert!(speed[0].contains("`speed` is not as planned"), "{speed:?}");
        let mut lacking = good.clone();
        lacking.channels.retain(|c| c.name != "lambda");
        assert!(said(&lacking)[0].starts_with("there is no channel `lambda`; channels are: inj, spark"));
        let nan = said(&with(&good, "lambda", |t, v| if t == 9 { f64::NAN } else { v }));
        assert_eq!(nan, ["`lambda` has no value at 0.270 s (sample 9)"]);
        let held = said(&with(&good, "lambda", |t, v| if t < 500 { v } else { 1.02 }));
        assert!(held.len() == 1 && held[0].contains("`lambda` stands at 1.02 from 15.00 s"), "{held:?}");
    }
}

/// Loop inputs have their range, outputs their limits, and units are compared.
#[test]
fn ranges_limits_and_units_are_compared() {
    let plan = closed(1, RETUNED).with_limits(vec![PlanLimit::upper("torque", "Nm", 200.0, 1.0)]);
    let good = record(&plan, false);
    let wide = check_record(&plan, &with(&good, "throttle", |t, v| if t == 50 { 75.0 } else { v }));
    assert!(
        wide.iter().any(|f| matches!(f, RecordFault::OutsideRange { found, .. } if *found == 75.0)),
        "{wide:?}"
    );
    let passed = check_record(&plan, &with(&good, "torque", |t, v| if t == 50 { 201.0 } else { v }));
    let limit = |f: &RecordFault| matches!(f, RecordFault::Limit { limit, found, .. } if (*limit, *found) == (200.0, 201.0));
    assert!(passed.iter().any(limit), "{passed:?}");
    let mut other = good;
    other.channels[4].unit = "lbft".into();
    let said: Vec<String> = check_record(&plan, &other).iter().map(ToString::to_string).collect();
    assert_eq!(said, ["`torque` is in lbft, the plan has it in Nm"]);
}
