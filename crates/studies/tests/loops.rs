//! Loops of design and measurement on systems with known answers, and the engine with held lambda.

use dynocal_calib::loops::bed::TestBed;
use dynocal_calib::loops::lambda_hold::{FuelMap, HoldSpec, LambdaHeld};
use dynocal_calib::loops::model::{identify, information};
use dynocal_calib::loops::plan::{Aim, Structure, know};
use dynocal_calib::loops::rehearsal::{Input, ModelPlant};
use dynocal_calib::loops::robust::{Ensemble, Risk, Stable, draws};
use dynocal_calib::loops::{Limit, LoopError, Rounds, StopRule, iterate, sequential};
use dynocal_design::channel::Channel;
use dynocal_design::criterion::criterion;
use dynocal_design::problem::{Convention, DesignProblem, Term};
use dynocal_design::search::DesignOptions;
use dynocal_ident::data::Dataset;
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::plant::{Causality, Plant};
use dynocal_numerics::interval::Interval;
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::status::Status;
use dynocal_plant::bed::{BedSettings, EngineBed};
use dynocal_plant::params::EngineParams;
use dynocal_studies::loops::shown::known::{Known, RobustSize, SequentialSize, compare};
use dynocal_studies::loops::shown::signals::Kind;

const TERMS: [&str; 5] = ["1", "u(t-1)", "u(t-2)", "u(t-1)^2", "y(t-1)"];
const THETA: [f64; 5] = [0.2, 1.0, 0.5, -0.3, 0.4];

fn model() -> PolyNarx {
    PolyNarx::parse(&["u"], "y", &TERMS).unwrap()
}

fn plant(noise: f64) -> ModelPlant {
    let u = Input { name: "u".into(), unit: "-".into(), min: -1.0, max: 1.0, start: 0.0 };
    ModelPlant::new(Box::new(model()), THETA.to_vec(), "y", vec![u], noise).unwrap()
}

fn bed() -> TestBed {
    let channel = Channel { rate_per_sample: Some(0.7), hold: 2, ..Channel::free("u", -1.0, 1.0) };
    TestBed { channels: vec![channel], sample_time_s: 0.1, settle_s: 2.0 }
}

fn aim(criterion: &str, objective: Vec<f64>) -> Aim {
    let search = DesignOptions { evaluations: 200, ..DesignOptions::default() };
    Aim { criterion: criterion.into(), keys: toml::Table::new(), objective, adds: true, search, robust: None }
}

fn first(plant: &mut ModelPlant, samples: usize) -> Vec<Dataset> {
    let free = TestBed { channels: vec![Channel::free("u", -1.0, 1.0)], ..bed() };
    let u = Kind::Udrn.record(&free, samples, &mut Rng64::new(3)).unwrap();
    vec![free.measure(plant, "first", &u).unwrap()]
}

/// Row t holds u(t) and y(t), and y(t) depends on u(t-1): without noise the parameters come back exactly.
#[test]
fn records_of_a_model_give_its_parameters_back() {
    let records = first(&mut plant(0.0), 60);
    let data = bed().experiments(&records, "y").unwrap();
    let found = identify(&model(), &data).unwrap();
    for (a, b) in found.theta.iter().zip(THETA) {
        assert!((a - b).abs() < 1e-7, "{:?}", found.theta);
    }
    // The record begins at rest at its first row: y = g(u) / (1 - a).
    let (u, y) = (data[0].u[0], data[0].y[0]);
    let rest = (THETA[0] + (THETA[1] + THETA[2]) * u + THETA[3] * u * u) / (1.0 - THETA[4]);
    assert!((y - rest).abs() < 1e-6, "{y} {rest}");
}

#[test]
fn a_rehearsal_continues_exactly_from_a_saved_state() {
    let mut p = plant(0.3);
    p.reset(7);
    let mut y = [0.0];
    let mut run = |p: &mut ModelPlant, n: usize| -> Vec<f64> {
        (0..n)
            .map(|t| {
                p.step(&[(0.3 * t as f64).sin()], 0.1, &mut y).unwrap();
                y[0]
            })
            .collect()
    };
    run(&mut p, 5);
    let state = p.save();
    let expected = run(&mut p, 10);
    p.restore(&state).unwrap();
    assert_eq!(run(&mut p, 10), expected);
    assert!(p.step(&[1.5], 0.1, &mut [0.0]).unwrap_err().to_string().contains("outside -1 to 1"));
    assert!(p.restore(&dynocal_ident::plant::PlantState(vec![1.0])).is_err());
}

/// All records keep the limits of the bed, are pooled, and the parameters' variance falls with every round.
#[test]
fn rounds_pool_their_records_within_the_limits_of_the_bed() {
    let (bed, m, aim) = (bed(), model(), aim("d", Vec::new()));
    let structures = [Structure::new("y", &m)];
    let rounds =
        Rounds { bed: &bed, structures: &structures, aim: &aim, samples: 40, rounds: 3, limits: &[] };
    let mut p = plant(0.2);
    let initial = first(&mut p, 30);
    let done = iterate(&mut p, &rounds, initial, &|| false).unwrap();
    assert_eq!((done.records.len(), done.rounds.len(), done.stopped), (4, 3, false));
    let volume = |factor: &[f64]| (0..5).map(|k| factor[k * 6].abs().ln()).sum::<f64>();
    let mut before = f64::NEG_INFINITY;
    for (round, record) in done.rounds.iter().zip(&done.records[1..]) {
        assert!(bed.keeps_limits(record.values("u").unwrap()));
        assert_eq!(record.values("u").unwrap(), &round.design.u[..]);
        let now = volume(&round.known[0].information);
        assert!(now > before);
        before = now;
    }
    let interrupted = iterate(&mut p, &rounds, done.records, &|| true);
    assert!(matches!(interrupted, Err(LoopError::Interrupted)));
}

/// A sequential test goes on where it stands, at the rate of the channel; a rule that asks for all stops before measuring.
#[test]
fn a_sequential_test_goes_on_where_it_stands_and_stops_when_told() {
    let m = model();
    let bed = bed();
    let objective = Kind::Udrn.record(&bed, 60, &mut Rng64::new(5)).unwrap();
    let aim = aim("i", objective);
    let structures = [Structure::new("y", &m)];
    let rounds =
        Rounds { bed: &bed, structures: &structures, aim: &aim, samples: 30, rounds: 3, limits: &[] };
    let run = |threshold: f64| {
        let mut p = plant(0.2);
        let initial = first(&mut p, 30);
        let held_out = first(&mut plant(0.2), 80);
        let rule = StopRule { held_out: &held_out, noise: 0.04, threshold };
        sequential(&mut p, &rounds, initial, Some(rule), &|| false).unwrap()
    };
    let done = run(0.0);
    assert_eq!(done.records.len(), 4);
    for pair in done.records.windows(2) {
        let (last, next) = (pair[0].values("u").unwrap(), pair[1].values("u").unwrap());
        assert!((next[0] - last[last.len() - 1]).abs() <= 0.7 + 1e-9);
        // No pause: the first output of a stretch follows from the end of the one before.
        assert!((pair[1].values("y").unwrap()[0] - pair[0].values("y").unwrap()[last.len() - 1]).abs() < 3.0);
    }
    for r in &done.rounds {
        let f = r.forecast.unwrap();
        assert!(f.reduction > 0.0 && f.floor >= 0.0 && !f.stop, "{f:?}");
    }
    let ended = run(1.1);
    assert_eq!((ended.records.len(), ended.rounds.len(), ended.stopped), (1, 1, true));
}

/// A right structure: measured outputs pass the limits at most at about the stated rate.
#[test]
fn a_right_structure_keeps_its_output_limits_at_the_stated_rate() {
    let (bed, m, aim) = (bed(), model(), aim("d", Vec::new()));
    let structures = [Structure::new("y", &m)];
    let limits = [Limit { output: "y".into(), lower: -1.0, upper: 1.5, rate: 0.1, caution: 1.0 }];
    let rounds =
        Rounds { bed: &bed, structures: &structures, aim: &aim, samples: 60, rounds: 3, limits: &limits };
    let (mut beyond, mut all) = (0, 0);
    for seed in 0..6 {
        let mut p = plant(0.2);
        p.reset(seed);
        let initial = first(&mut p, 80);
        let done = iterate(&mut p, &rounds, initial, &|| false).unwrap();
        for (round, record) in done.rounds.iter().zip(&done.records[1..]) {
            let Interval { lower, upper } = round.limits[0].kept;
            assert!(lower > -1.0 && upper < 1.5);
            // Limits hold or the design says that they do not.
            let distance = round.design.safety[0].worst.unwrap().distance;
            let held = distance >= -1e-6 * (upper - lower) - 1e-12;
            assert_eq!(held, round.design.status != Status::Infeasible, "{distance}");
            let y = record.values("y").unwrap();
            beyond += y.iter().filter(|v| **v > 1.5 || **v < -1.0).count();
            all += y.len();
        }
    }
    // Not all samples are at a limit, so that the share of all is below the rate.
    assert!(beyond as f64 <= 0.1 * all as f64, "{beyond} of {all}");
}

/// Without output terms information does not depend on the parameters: all losses of a record are equal.
#[test]
fn a_finite_response_has_the_same_loss_everywhere() {
    let fir = PolyNarx::parse(&["u"], "y", &["1", "u(t-1)", "u(t-2)"]).unwrap();
    let d = criterion("d", &toml::Table::new()).unwrap();
    let theta = [0.0, 1.0, 0.5];
    let problem = DesignProblem {
        channels: vec![Channel::free("u", -1.0, 1.0)],
        n_samples: 30,
        convention: Convention::Hold,
        start: 0,
        terms: vec![Term::new("y", &fir, &theta, 0.3, d.as_ref())],
    };
    let mut covariance = vec![0.0; 9];
    (0..3).for_each(|k| covariance[k * 4] = 0.2);
    let u: Vec<f64> = (0..50).map(|t| (t as f64).sin()).collect();
    let stable = Stable { u: &u, initial_output: 0.0, bound: 1e3 };
    let drawn = draws(&fir, &theta, &covariance, 5, 1, stable).unwrap();
    let options = DesignOptions { evaluations: 200, ..DesignOptions::default() };
    let ensemble = Ensemble::new(&problem, &drawn, &options, &|| false).unwrap();
    let losses = ensemble.losses(&u[..30]).unwrap();
    assert!(losses.iter().all(|l| (l - losses[0]).abs() < 1e-12 && *l > 0.0), "{losses:?}");
    assert!((Risk::Mean.of(&losses) - Risk::Cvar(0.2).of(&losses)).abs() < 1e-12);
}

/// Mean and covariance of many draws are those asked for, within five standard errors.
#[test]
fn draws_have_their_distribution() {
    let fir = PolyNarx::parse(&["u"], "y", &["1", "u(t-1)"]).unwrap();
    let (theta, covariance) = ([3.0, -1.0], [4.0, 0.9, 0.9, 0.25]);
    let stable = Stable { u: &[0.0; 4], initial_output: 0.0, bound: 1e9 };
    let n = 4000;
    let all = draws(&fir, &theta, &covariance, n, 9, stable).unwrap();
    let mean = |f: &dyn Fn(&[f64]) -> f64| all.iter().map(|d| f(d)).sum::<f64>() / n as f64;
    for i in 0..2 {
        let slack = 5.0 * (covariance[i * 3] / n as f64).sqrt();
        assert!((mean(&|d| d[i]) - theta[i]).abs() < slack);
        for j in 0..2 {
            let found = mean(&|d| (d[i] - theta[i]) * (d[j] - theta[j]));
            let var = covariance[i * 3] * covariance[j * 3] + covariance[i * 2 + j].powi(2);
            assert!((found - covariance[i * 2 + j]).abs() < 5.0 * (var / n as f64).sqrt(), "{i} {j} {found}");
        }
    }
    let singular = draws(&fir, &theta, &[1.0, 0.0, 0.0, 0.0], 2, 1, stable).unwrap_err().to_string();
    assert!(singular.contains("u(t-1)"), "{singular}");
}

/// The same result for any number of threads.
#[test]
fn comparisons_do_not_depend_on_threads() {
    let size = SequentialSize {
        seed: 4,
        seeds: 3,
        initial: 40,
        samples: 20,
        rounds: 2,
        held_out: 40,
        evaluations: 60,
    };
    let robust = RobustSize {
        seed: 4,
        seeds: 1,
        initial: 60,
        samples: 30,
        draws: 3,
        fresh: 3,
        share: 0.4,
        evaluations: 60,
    };
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let known = Known::new(0.2).unwrap();
            (compare(&known, size, 2, &|| false).unwrap(), known.robust(robust).unwrap())
        })
    };
    assert_eq!(run(1), run(3));
}

/// Lambda of the engine stays at 1 under random inputs, the test sees no fuel, and a saved state continues exactly.
#[test]
fn the_fuel_holds_lambda_while_the_air_moves() {
    let engine = || -> Box<dyn Plant> {
        Box::new(EngineBed::new(&EngineParams::thesis(), BedSettings::default()).unwrap())
    };
    let spec = HoldSpec { settle_s: 2.0, ..HoldSpec::default() };
    let fuel = FuelMap::learn(engine(), &spec).unwrap();
    let mut held = LambdaHeld::new(engine(), spec, fuel).unwrap();
    let names: Vec<&str> = held
        .variables()
        .iter()
        .filter(|v| v.causality == Causality::Input)
        .map(|v| v.name.as_str())
        .collect();
    assert_eq!(names, ["spark", "throttle", "speed"]);
    let channels = vec![
        Channel::free("speed", 2000.0, 4000.0),
        Channel::free("spark", 10.0, 30.0),
        Channel::free("throttle", 2.0, 8.0),
    ];
    let bed = TestBed { channels, sample_time_s: 0.3, settle_s: 3.0 };
    let u = Kind::Udrn.record(&bed, 40, &mut Rng64::new(2)).unwrap();
    let record = bed.measure(&mut held, "random", &u).unwrap();
    let lambda = record.values("lambda").unwrap();
    let rms = (lambda.iter().map(|l| (l - 1.0).powi(2)).sum::<f64>() / 40.0).sqrt();
    assert!(rms < 0.02 && lambda.iter().all(|l| (l - 1.0).abs() < 0.08), "{rms}");
    let state = held.save();
    let mut y = [0.0; 5];
    held.step(&[20.0, 5.0, 3000.0], 0.3, &mut y).unwrap();
    held.restore(&state).unwrap();
    let mut again = [0.0; 5];
    held.step(&[20.0, 5.0, 3000.0], 0.3, &mut again).unwrap();
    assert_eq!(y, again);
    assert!(held.step(&[20.0, 5.0, 3000.0], 0.04, &mut y).is_err(), "no multiple of the loop's sample time");
}

/// Unknown inputs, wrong shapes and unknown criteria are refused in words.
#[test]
fn wrong_calls_are_refused() {
    let (bed, m) = (bed(), model());
    let mut p = plant(0.1);
    let stranger = TestBed { channels: vec![Channel::free("boost", 0.0, 1.0)], ..bed.clone() };
    let said = stranger.measure(&mut p, "x", &[0.5; 4]).unwrap_err().to_string();
    assert!(said.contains("boost") && said.contains('u'), "{said}");
    assert!(matches!(bed.measure(&mut p, "x", &[]), Err(LoopError::Shape { .. })));
    let records = first(&mut p, 30);
    let structures = [Structure::new("y", &m)];
    let aim = aim("z", Vec::new());
    let rounds =
        Rounds { bed: &bed, structures: &structures, aim: &aim, samples: 20, rounds: 1, limits: &[] };
    assert!(matches!(iterate(&mut p, &rounds, records.clone(), &|| false), Err(LoopError::Build(_))));
    let missing = [Structure::new("torque", &m)];
    assert!(matches!(know(&bed, &missing, &records), Err(LoopError::Data(_))));
    let data = bed.experiments(&records, "y").unwrap();
    assert!(information(&m, &[0.0, 1.0, 0.0, 0.0, 1e30], &data).is_err(), "a diverging model");
}
