//! Guard: the optimum stays where its models were identified.

use dynocal_calib::optimise::model::OutputModel;
use dynocal_calib::optimise::{Guard, OptimiseOptions, Optimum, distance_name, optimise_models};
use dynocal_calib::problem::CalibrationProblem;
use dynocal_ident::data::{Channel, Dataset, Role};
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::validate::boundary::{BoundaryKeys, BoundaryModel, RegionKind, Space, coverage, learn};
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::status::Status;

const THETA: [f64; 3] = [0.5, 0.5, 0.5];

/// Heat of two burners, the second one cheaper; records have both between a half and one and a half of their start.
fn heat() -> PolyNarx {
    PolyNarx::parse(&["a", "b"], "heat", &["a(t-1)", "b(t-1)", "heat(t-1)"]).expect("structure")
}

fn problem() -> CalibrationProblem {
    let text = r#"
        inputs = [{ name = "a", unit = "kW", lower = 0.0, upper = 9.0 }, { name = "b", unit = "kW", lower = 0.0, upper = 6.0 }]
        demands = [{ output = "heat", unit = "kW", lower = 0.0, upper = 11.0 }]
        minimise = [{ channel = "a", weight = 2.0 }, { channel = "b", weight = 1.0 }]
    "#;
    toml::from_str(text).expect("problem")
}

fn boundary(kind: RegionKind) -> BoundaryModel {
    let mut rng = Rng64::new(11);
    let n = 600;
    let u: Vec<f64> = (0..n).flat_map(|_| [rng.uniform_in(2.0, 6.0), rng.uniform_in(0.5, 1.5)]).collect();
    let mut y = vec![5.0; n];
    (1..n).for_each(|t| y[t] = 0.5 * (u[2 * t - 2] + u[2 * t - 1] + y[t - 1]));
    let data = [Experiment { name: "seen".into(), u, y, init_samples: 0, weights: vec![] }];
    let keys = BoundaryKeys { kind, ..BoundaryKeys::default() };
    learn(Space::of(&heat()), &data, &keys).expect("boundary")
}

fn start(b: f64) -> Dataset {
    let channel =
        |name: &str, role, v| Channel { name: name.into(), unit: "kW".into(), role, values: vec![v; 60] };
    Dataset {
        name: "start".into(),
        sample_time_s: 1.0,
        channels: vec![
            channel("a", Role::Input, 4.0),
            channel("b", Role::Input, b),
            channel("heat", Role::Output, 4.0 + b),
        ],
        init_samples: 0,
        origin: "test".into(),
    }
}

fn solve(start: &Dataset, known: Option<&BoundaryModel>, guard: Option<Guard>) -> Optimum {
    let structure = heat();
    let model =
        OutputModel { boundary: known, ..OutputModel::plain("heat", &structure, &THETA, &["a", "b"]) };
    let options = OptimiseOptions { guard, ..OptimiseOptions::default() };
    optimise_models(&problem(), &[model], start, &options, &|| false).expect("solved")
}

/// Distances of the optimum by the boundary itself.
fn distances(known: &BoundaryModel, found: &Optimum) -> Vec<f64> {
    let (a, b) = (found.input("a").expect("a"), found.input("b").expect("b"));
    let u: Vec<f64> = a.iter().zip(b).flat_map(|(a, b)| [*a, *b]).collect();
    coverage(known, &u, &found.demands[0].values, 0).distances
}

fn hard(distance: f64) -> Option<Guard> {
    Some(Guard { distance, soft_weight: None })
}

#[test]
fn the_optimum_stays_where_the_model_was_identified() {
    let (known, start) = (boundary(RegionKind::Leverage), start(1.0));
    let free = solve(&start, Some(&known), None);
    let far = distances(&known, &free).into_iter().fold(0.0, f64::max);
    assert!(far > 2.0, "without a guard it leaves: {far}");
    let kept = solve(&start, Some(&known), hard(1.0));
    assert_eq!(kept.status, Status::Converged);
    let by_boundary = distances(&known, &kept);
    let said = kept.outputs.iter().find(|c| c.name == distance_name("heat")).expect("distance");
    for (t, (d, own)) in by_boundary.iter().zip(&said.values).enumerate().skip(2) {
        assert!(*d <= 1.0 + 1e-6 && (d - own).abs() < 1e-7, "sample {t}: {d} {own}");
    }
    let used = by_boundary.iter().skip(10).fold(0.0f64, |m, d| m.max(*d));
    assert!(used > 0.999, "the guard is what stops it: {used}");
    assert!(kept.start_objective > kept.objective && kept.objective > free.objective);
    assert!(kept.violations.iter().all(|v| v.largest < 1e-6), "{:?}", kept.violations);
}

/// Its price is the slope of the optimum over the distance.
#[test]
fn the_price_of_the_guard_is_the_slope_of_the_optimum() {
    let (known, start) = (boundary(RegionKind::Leverage), start(1.0));
    let at = |distance| solve(&start, Some(&known), hard(distance));
    let step = 1e-3;
    let slope = (at(1.0 + step).objective - at(1.0 - step).objective) / (2.0 * step);
    let found = at(1.0);
    let name = distance_name("heat");
    let prices: Vec<_> = found.prices.iter().filter(|p| p.channel == name).collect();
    assert_eq!(prices.len(), 1, "{prices:?}");
    assert!((prices[0].price - slope).abs() < 1e-3 * slope.abs(), "{} {slope}", prices[0].price);
    assert!(slope < 0.0);
}

/// A start that lies outside is not called infeasible; the optimum goes no further than it.
#[test]
fn a_start_outside_is_the_limit_there() {
    let (known, start) = (boundary(RegionKind::Leverage), start(3.0));
    let found = solve(&start, Some(&known), hard(1.0));
    assert_eq!(found.status, Status::Converged);
    let before = known_distance(&known, 4.0, 3.0);
    assert!(before > 1.5, "{before}");
    let after = distances(&known, &found);
    assert!(after.iter().skip(2).all(|d| *d <= before + 1e-6), "{before} {after:?}");
}

fn known_distance(known: &BoundaryModel, a: f64, b: f64) -> f64 {
    use dynocal_ident::validate::boundary::Boundary;
    known.distance(&[a, b, a + b])
}

/// A soft guard whose price is above the slope of the optimum is kept, a cheaper one is not.
#[test]
fn a_soft_guard_is_kept_at_its_price() {
    let (known, start) = (boundary(RegionKind::Leverage), start(1.0));
    let worst = |weight| {
        let guard = Some(Guard { distance: 1.0, soft_weight: Some(weight) });
        distances(&known, &solve(&start, Some(&known), guard)).into_iter().fold(0.0, f64::max)
    };
    assert!(worst(50.0) < 1.0 + 1e-5, "{}", worst(50.0));
    assert!(worst(1e-3) > 1.5, "{}", worst(1e-3));
}

#[test]
fn a_guard_needs_a_boundary_that_it_can_use() {
    let refused = |known: Option<&BoundaryModel>| {
        let structure = heat();
        let model =
            OutputModel { boundary: known, ..OutputModel::plain("heat", &structure, &THETA, &["a", "b"]) };
        let options = OptimiseOptions { guard: hard(1.0), ..OptimiseOptions::default() };
        optimise_models(&problem(), &[model], &start(1.0), &options, &|| false).unwrap_err().to_string()
    };
    assert!(refused(None).contains("the model of `heat` has none"), "{}", refused(None));
    // A file may hold any space.
    let mut other = boundary(RegionKind::Leverage);
    other.space.inputs[0].0 = 9;
    assert!(refused(Some(&other)).contains("not of its inputs and outputs"), "{}", refused(Some(&other)));
    let mut short = boundary(RegionKind::Leverage);
    short.space.outputs.clear();
    assert!(refused(Some(&short)).contains("not of its inputs and outputs"), "{}", refused(Some(&short)));
    let hull = boundary(RegionKind::Hull);
    assert!(refused(Some(&hull)).contains("has one of another kind"), "{}", refused(Some(&hull)));
}

/// Channels of the record tighten the limits of an output sample by sample.
#[test]
fn an_output_keeps_the_limit_of_each_sample() {
    let mut problem = problem();
    problem.demands.clear();
    problem.minimise = toml::from_str::<CalibrationProblem>(
        r#"
        inputs = [{ name = "a", unit = "kW", lower = 0.0, upper = 9.0 }]
        minimise = [{ channel = "heat", weight = -1.0 }]
        "#,
    )
    .expect("problem")
    .minimise;
    problem.limits = vec![dynocal_calib::problem::LimitChannel {
        output: "heat".into(),
        unit: "kW".into(),
        lower: None,
        upper: Some(8.0),
        mean_upper: None,
        soft_weight: None,
    }];
    let mut record = start(1.0);
    let values: Vec<f64> = (0..60).map(|t| if t < 30 { 9.0 } else { 6.0 }).collect();
    record.channels.push(Channel {
        name: "heat_upper".into(),
        unit: "kW".into(),
        role: Role::Auxiliary,
        values: values.clone(),
    });
    let structure = heat();
    let model = OutputModel::plain("heat", &structure, &THETA, &["a", "b"]);
    let found =
        optimise_models(&problem, &[model], &record, &OptimiseOptions::default(), &|| false).expect("solved");
    assert_eq!(found.status, Status::Converged);
    let heat = &found.outputs[0].values;
    for t in 5..60 {
        let limit = values[t].min(8.0);
        assert!((heat[t] - limit).abs() < 1e-5, "sample {t}: {} of {limit}", heat[t]);
    }
    assert!(found.violation("heat") < 1e-6);
}
