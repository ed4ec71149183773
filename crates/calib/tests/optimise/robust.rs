//! Robust: limits hold for every draw of the models.

use dynocal_calib::optimise::model::OutputModel;
use dynocal_calib::optimise::{OptimiseOptions, Optimum, Robust, optimise_models, optimise_record};
use dynocal_calib::problem::CalibrationProblem;
use dynocal_ident::data::{Channel, Dataset, Role};
use dynocal_ident::estimate::ParameterDistribution;
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::stored::{Quantity, StoredModel};
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::status::Status;

/// Steady gains 2.0; 2.5, 1.6, 3.0.
const ESTIMATE: [f64; 2] = [1.0, 0.5];
const DRAWS: [[f64; 2]; 3] = [[1.0, 0.6], [0.8, 0.5], [1.2, 0.6]];

fn heat() -> PolyNarx {
    PolyNarx::parse(&["u"], "heat", &["u(t-1)", "heat(t-1)"]).expect("structure")
}

fn problem(minimised: &str) -> CalibrationProblem {
    let text = format!(
        r#"
        inputs = [{{ name = "u", unit = "kW", lower = 0.0, upper = 20.0 }}]
        limits = [{{ output = "heat", unit = "K", upper = 12.0 }}]
        minimise = [{minimised}]
        "#
    );
    toml::from_str(&text).expect("problem")
}

fn start() -> Dataset {
    let channel = |name: &str, unit: &str, role, v| Channel {
        name: name.into(),
        unit: unit.into(),
        role,
        values: vec![v; 80],
    };
    Dataset {
        name: "start".into(),
        sample_time_s: 1.0,
        channels: vec![channel("u", "kW", Role::Input, 1.0), channel("heat", "K", Role::Output, 2.0)],
        init_samples: 0,
        origin: "test".into(),
    }
}

fn options(robust: bool) -> OptimiseOptions {
    let robust = robust.then_some(Robust { draws: 3, seed: 0 });
    OptimiseOptions { robust, ..OptimiseOptions::default() }
}

fn solve(problem: &CalibrationProblem, robust: bool) -> Optimum {
    let structure = heat();
    let draws = DRAWS.iter().map(|d| d.to_vec()).collect();
    let model = OutputModel { draws, ..OutputModel::plain("heat", &structure, &ESTIMATE, &["u"]) };
    let found = optimise_models(problem, &[model], &start(), &options(robust), &|| false).expect("solved");
    assert_eq!(found.status, Status::Converged);
    found
}

/// The steady input is what the limit allows the draw with the largest gain: 12 / 3, against 12 / 2 of the estimate alone.
#[test]
fn a_limit_holds_for_the_worst_draw() {
    let most = problem(r#"{ channel = "u", weight = -1.0 }"#);
    let steady = |found: &Optimum| found.input("u").expect("u")[60];
    assert!((steady(&solve(&most, false)) - 6.0).abs() < 1e-4);
    let found = solve(&most, true);
    assert!((steady(&found) - 4.0).abs() < 1e-4, "{}", steady(&found));
    let names: Vec<&str> = found.outputs.iter().map(|c| c.name.as_str()).collect();
    assert_eq!(names, ["heat", "heat_least", "heat_greatest"]);
    let at = |name: &str| found.outputs.iter().find(|c| c.name == name).expect("channel").values[60];
    assert!((at("heat_least") - 6.4).abs() < 1e-3 && (at("heat") - 8.0).abs() < 1e-3);
    assert!((at("heat_greatest") - 12.0).abs() < 1e-4);
    assert_eq!(found.violations.iter().filter(|v| v.channel == "heat").count(), 1);
    assert!(found.violation("heat") < 1e-6);
}

/// The price of a limit over all draws is the slope of the optimum.
#[test]
fn the_price_of_a_robust_limit_is_the_slope() {
    let with = |upper: f64| {
        let mut p = problem(r#"{ channel = "u", weight = -1.0 }"#);
        p.limits[0].upper = Some(upper);
        solve(&p, true)
    };
    let slope = (with(12.1).objective - with(11.9).objective) / 0.2;
    let found = with(12.0);
    let price = found.prices.iter().find(|p| p.channel == "heat" && p.of == "upper").expect("price").price;
    assert!((price - slope).abs() < 1e-4 * slope.abs(), "{price} {slope}");
}

/// What is minimised is the mean over estimate and draws.
#[test]
fn what_is_minimised_is_the_mean_over_the_draws() {
    let p = problem(r#"{ channel = "heat" }"#);
    let found = solve(&p, true);
    let [term] = &found.terms[..] else { panic!("{:?}", found.terms) };
    assert!((term.weight - 1.0).abs() < 1e-12);
    // The start holds u = 1: means of four first-order responses from 2 towards their gains, from the first sample that it reaches.
    let start = |[b, a]: [f64; 2]| {
        let mut y = 2.0;
        let run = (1..80).map(|_| {
            y = b + a * y;
            y
        });
        run.skip(1).sum::<f64>() / 78.0
    };
    let mean = (start(ESTIMATE) + DRAWS.iter().map(|d| start(*d)).sum::<f64>()) / 4.0;
    assert!((term.start - mean).abs() < 1e-9, "{} {mean}", term.start);
    assert!((found.start_objective - mean).abs() < 1e-9);
}

fn stored(correlation: Option<Vec<f64>>) -> StoredModel {
    let quantity = |name: &str, unit: &str| Quantity { name: name.into(), unit: unit.into() };
    let mut model =
        StoredModel::new(heat(), &ESTIMATE, vec![quantity("u", "kW")], quantity("heat", "K"), 1.0)
            .expect("model");
    model.parameters.iter_mut().zip([0.1, 0.05]).for_each(|(p, s)| p.std_error = Some(s));
    model.correlation = correlation;
    model
}

/// Draws of a stored model follow its covariance; without correlations they are refused.
#[test]
fn stored_models_are_drawn_by_their_covariance() {
    let model = stored(Some(vec![-0.9]));
    let c = model.covariance().expect("covariance");
    for (found, expected) in c.iter().zip([0.01, -0.0045, -0.0045, 0.0025]) {
        assert!((found - expected).abs() < 1e-15, "{c:?}");
    }
    let mut again = stored(None);
    again.correlate(&c);
    assert!((again.correlation.as_ref().expect("known")[0] + 0.9).abs() < 1e-12);
    let p = problem(r#"{ channel = "u", weight = -1.0 }"#);
    let options =
        OptimiseOptions { robust: Some(Robust { draws: 8, seed: 3 }), ..OptimiseOptions::default() };
    let found = optimise_record(&p, &[&model], &start(), &options, &|| false).expect("solved");
    // The same draws by hand: the largest steady gain decides.
    let mut rng = Rng64::stream(3, 0);
    let d = ParameterDistribution::new(&ESTIMATE, &c).expect("positive");
    let draws: Vec<Vec<f64>> = (0..8).map(|_| d.draw(&mut rng)).collect();
    let gain = |t: &[f64]| t[0] / (1.0 - t[1]);
    let worst = draws.iter().map(|t| gain(t)).fold(gain(&ESTIMATE), f64::max);
    let steady = found.input("u").expect("u")[60];
    assert!((steady - 12.0 / worst).abs() < 1e-3, "{steady} {worst}");
    let refused = optimise_record(&p, &[&stored(None)], &start(), &options, &|| false).unwrap_err();
    assert!(
        refused.to_string().contains("does not say how its parameters depend on each other"),
        "{refused}"
    );
    assert!(stored(Some(vec![0.1, 0.2])).check().is_err());
    assert!(stored(Some(vec![1.5])).check().is_err());
}

/// A channel of the user whose name looks like a copy is none.
#[test]
fn channels_of_the_user_are_not_taken_for_copies() {
    let mut p = problem(r#"{ channel = "u", weight = -1.0 }, { channel = "cost#2" }"#);
    let more: CalibrationProblem = toml::from_str(
        r#"
        inputs = [{ name = "u", unit = "kW", lower = 0.0, upper = 20.0 }]
        minimise = [{ channel = "u" }]
        derive = [{ name = "cost#2", unit = "-", factor = 0.25, powers = { u = 1 } }]
        "#,
    )
    .expect("problem");
    p.derive = more.derive;
    let found = solve(&p, true);
    let names: Vec<&str> = found.terms.iter().map(|t| t.channel.as_str()).collect();
    assert_eq!(names, ["u", "cost#2"]);
    assert!((found.terms[1].optimum - 0.25 * found.terms[0].optimum).abs() < 1e-9);
}

/// Draws of a demanded output are told: the demand is met by the estimate alone.
#[test]
fn draws_of_a_demanded_output_are_told() {
    let p: CalibrationProblem = toml::from_str(
        r#"
        inputs = [{ name = "u", unit = "kW", lower = 0.0, upper = 20.0 }]
        demands = [{ output = "heat", unit = "K", lower = 0.0, upper = 20.0 }]
        minimise = [{ channel = "u" }]
        "#,
    )
    .expect("problem");
    let found = solve(&p, true);
    let [s] = &found.spreads[..] else { panic!("{:?}", found.spreads) };
    // The demand is the response to u = 1 from its steady state, 2 K; the draws go to 2.5, 1.6 and 3 K.
    assert!((s.largest - 1.0).abs() < 1e-3 && s.diverged == 0, "{s:?}");
    let rms = (0.5f64.powi(2) / 3.0 + 0.4f64.powi(2) / 3.0 + 1.0 / 3.0).sqrt();
    assert!((s.rms - rms).abs() < 0.03, "{} {rms}", s.rms);
}
