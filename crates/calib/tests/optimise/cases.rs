//! Optimisation over a record: derivatives against differences, small cases with known answers, and the reference record
//! against published optima.

use crate::common::{agrees_with_differences, channel, problem, record};
use dynocal_calib::optimise::model::{OutputModel, OutputWay, Source};
use dynocal_calib::optimise::program::Program;
use dynocal_calib::optimise::{
    EndCondition, History, OptimiseError, OptimiseOptions, optimise_models, optimise_record, parts,
};
use dynocal_calib::problem::CalibrationProblem;
use dynocal_ident::data::{Dataset, Role};
use dynocal_ident::derived::Derived;
use dynocal_ident::derived::Monomial;
use dynocal_ident::model::literature;
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::stored::{Quantity, Seen, StoredModel};
use dynocal_numerics::nlp::SparseNlp;
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::status::Status;

const ENGINE: [&str; 4] = ["inj", "spark", "throttle", "speed"];

/// The thesis' models with a demanded output each; held and rate-limited inputs.
#[test]
fn derivatives_of_demanded_outputs_agree_with_differences() {
    let (torque, lambda) = (literature::torque_7_8(), literature::lambda_7_8());
    let models = [
        OutputModel::plain("torque", &torque.model, &torque.theta, &ENGINE),
        OutputModel::plain("lambda", &lambda.model, &lambda.theta, &ENGINE),
    ];
    let start = record(14, &mut Rng64::new(5));
    for history in [History::Fixed, History::Free] {
        let options = OptimiseOptions { history, ..OptimiseOptions::default() };
        let p = CalibrationProblem::thesis();
        agrees_with_differences(&mut Program::new(parts(&p, &models, &start, &options).expect("parts")));
    }
}

/// Free and limited outputs with their recursion, an output behind a reciprocal, a model that reads another's output, a
/// derived input, products in objective and mean limit, soft limits.
#[test]
fn derivatives_of_free_outputs_agree_with_differences() {
    let p = problem(
        r#"
        minimise = [{ channel = "consumption", weight = 2.0 }, { channel = "phi_like", weight = 0.3 }]
        inputs = [
            { name = "inj", unit = "mg", lower = 0.0, upper = 30.0, increment_weight = 0.02 },
            { name = "spark", unit = "deg", lower = 5.0, upper = 30.0, rate_per_s = 20.0 },
            { name = "throttle", unit = "deg", lower = 0.0, upper = 90.0, rate_per_s = 50.0, increment_weight = 0.01 },
        ]
        given = [{ name = "speed", unit = "rpm", lower = 500.0, upper = 4000.0 }]
        demands = [{ output = "torque", unit = "Nm", lower = 0.0, upper = 100.0 }]
        limits = [
            { output = "lambda", unit = "-", lower = 0.7, upper = 1.4 },
            { output = "heat", unit = "K", upper = 900.0, soft_weight = 3.0 },
            { output = "phi_like", unit = "-", mean_upper = 2.0 },
            { output = "heat_mean", unit = "K/rpm", mean_upper = 1.0 },
        ]
        derive = [
            { name = "phi_like", unit = "-", powers = { lambda = -1, inj = 2 } },
            { name = "consumption", unit = "-", factor = 0.1, powers = { inj = 1, speed = 1, torque = -1 } },
            { name = "heat_mean", unit = "K/rpm", powers = { heat = 1, speed = -1 } },
        ]
        "#,
    );
    let torque = literature::torque_7_8();
    let phi = PolyNarx::parse(
        &["inj", "charge", "speed"],
        "lambda",
        &[
            "inj(t-1)",
            "inj(t-1)*charge(t-2)",
            "lambda(t-1)",
            "lambda(t-1)^2*inj(t-1)",
            "lambda(t-2)*lambda(t-1)",
        ],
    )
    .expect("structure");
    let heat = PolyNarx::parse(
        &["lambda", "spark", "throttle"],
        "heat",
        &[
            "lambda(t-1)*spark(t-1)",
            "throttle(t)",
            "lambda(t)",
            "heat(t-1)",
            "tanh(0.1*heat(t-2) + 0.2*spark(t-1))",
        ],
    )
    .expect("structure");
    let charge = Monomial { factor: 1e-3, powers: vec![("throttle".into(), 2), ("speed".into(), 1)] };
    let models = [
        OutputModel::plain("torque", &torque.model, &torque.theta, &ENGINE),
        OutputModel {
            output: "lambda".into(),
            model: &phi,
            theta: &[0.02, 1e-4, 0.4, 1e-3, 0.1],
            inputs: vec![
                Source { offset: 10.0, scale: 3.0, ..Source::plain("inj") },
                Source { monomial: charge, offset: 1.0, scale: 2.0 },
                Source::plain("speed"),
            ],
            way: OutputWay { factor: 1.0, power: -1, offset: 0.1, scale: 1.2 },
            boundary: None,
            draws: Vec::new(),
        },
        OutputModel::plain("heat", &heat, &[0.3, 0.1, 2.0, 0.5, 0.2], &["lambda", "spark", "throttle"]),
    ];
    let mut start = record(14, &mut Rng64::new(6));
    start.channels.push(channel("heat", "K", Role::Output, vec![20.0; 14]));
    let options = OptimiseOptions::default();
    agrees_with_differences(&mut Program::new(parts(&p, &models, &start, &options).expect("parts")));
}

/// y(t) = y(t-1)/2 + u(t-1), so that a steady u gives 2 u. Least mean of u with y >= 3: u = 1.5 wherever y is reached.
#[test]
fn a_limited_output_sits_at_its_limit() {
    let p = problem(
        r#"
        minimise = [{ channel = "u" }]
        inputs = [{ name = "u", unit = "-", lower = 0.0, upper = 5.0 }]
        limits = [{ output = "y", unit = "-", lower = 3.0 }]
        "#,
    );
    let y = PolyNarx::parse(&["u"], "y", &["u(t-1)", "y(t-1)"]).expect("structure");
    let models = [OutputModel::plain("y", &y, &[1.0, 0.5], &["u"])];
    let mut start = record(40, &mut Rng64::new(7));
    start.channels =
        vec![channel("u", "-", Role::Input, vec![2.0; 40]), channel("y", "-", Role::Output, vec![4.0; 40])];
    let found = optimise_models(&p, &models, &start, &OptimiseOptions::default(), &|| false).expect("solved");
    assert_eq!(found.status, Status::Converged);
    let (u, y) = (found.input("u").expect("u"), &found.outputs[0].values);
    // From y(1) = 4: one step of u = 1 leads to the limit, 1.5 holds it.
    assert!((u[1] - 1.0).abs() < 1e-5 && (u[20] - 1.5).abs() < 1e-5, "{u:?}");
    assert!(y.iter().skip(2).all(|v| (v - 3.0).abs() < 1e-5), "{y:?}");
    assert!(found.violation("y") < 1e-6);
}

/// The same with a soft limit: its price decides. One unit of y less saves half a unit of u.
#[test]
fn a_soft_limit_is_kept_when_its_price_is_right() {
    let of = |price: f64| {
        let text = format!(
            r#"
            minimise = [{{ channel = "u" }}]
            inputs = [{{ name = "u", unit = "-", lower = 0.0, upper = 5.0 }}]
            limits = [{{ output = "y", unit = "-", lower = 3.0, soft_weight = {price} }}]
            "#
        );
        let p = problem(&text);
        let y = PolyNarx::parse(&["u"], "y", &["u(t-1)", "y(t-1)"]).expect("structure");
        let models = [OutputModel::plain("y", &y, &[1.0, 0.5], &["u"])];
        let mut start = record(60, &mut Rng64::new(7));
        start.channels = vec![
            channel("u", "-", Role::Input, vec![2.0; 60]),
            channel("y", "-", Role::Output, vec![4.0; 60]),
        ];
        optimise_models(&p, &models, &start, &OptimiseOptions::default(), &|| false).expect("solved")
    };
    let (dear, cheap) = (of(0.6), of(0.4));
    assert!((dear.outputs[0].values[30] - 3.0).abs() < 1e-4 && cheap.outputs[0].values[30] < 1e-3);
}

#[test]
fn inputs_that_act_after_the_end_are_held_or_those_of_the_start() {
    let p = problem(
        r#"
        minimise = [{ channel = "u" }, { channel = "v" }]
        inputs = [
            { name = "u", unit = "-", lower = 0.0, upper = 5.0 },
            { name = "v", unit = "-", lower = 0.0, upper = 5.0 },
        ]
        demands = [{ output = "y", unit = "-", lower = 0.0, upper = 9.0 }]
        "#,
    );
    // u acts after three samples only: its last two values have no effect within the record.
    let y = PolyNarx::parse(&["u", "v"], "y", &["u(t-3)", "v(t-1)", "y(t-1)"]).expect("structure");
    let models = [OutputModel::plain("y", &y, &[1.0, 0.6, 0.5], &["u", "v"])];
    let mut start = record(30, &mut Rng64::new(7));
    start.channels = vec![
        channel("u", "-", Role::Input, vec![1.0; 30]),
        channel("v", "-", Role::Input, vec![2.0; 30]),
        channel("y", "-", Role::Output, vec![4.4; 30]),
    ];
    let solve = |end, extend_s| {
        let options = OptimiseOptions { end, extend_s, ..OptimiseOptions::default() };
        optimise_models(&p, &models, &start, &options, &|| false).expect("solved")
    };
    let free = solve(EndCondition::Free, 0.0);
    let u = free.input("u").expect("u");
    assert!((u[15] - 2.2).abs() < 1e-5 && u[27] == u[26] && u[29] == u[26], "{u:?}");
    let pinned = solve(EndCondition::Start, 0.0);
    assert_eq!(&pinned.input("u").expect("u")[27..], [1.0; 3]);
    let continued = solve(EndCondition::Free, 0.3);
    assert_eq!(continued.inputs[0].values.len(), 30);
    assert!(continued.input("u").expect("u")[3..].iter().all(|u| (u - 2.2).abs() < 1e-5));
}

#[test]
fn what_does_not_belong_together_is_named() {
    let (t, l) = (literature::torque_7_8(), literature::lambda_7_8());
    let torque = OutputModel::plain("torque", &t.model, &t.theta, &ENGINE);
    let lambda = OutputModel::plain("lambda", &l.model, &l.theta, &ENGINE);
    let p = CalibrationProblem::thesis();
    let start = record(60, &mut Rng64::new(1));
    let solve = |models: &[OutputModel], start: &_| {
        optimise_models(&p, models, start, &OptimiseOptions::default(), &|| false).unwrap_err()
    };
    let both = [torque.clone(), lambda.clone()];
    let mut outside = start.clone();
    outside.channels[0].values[7] = 35.0;
    let error = solve(&both, &outside);
    assert!(matches!(error, OptimiseError::Start { .. }));
    let text = error.to_string();
    assert!(text.contains("inj is 35 mg at sample 7") && text.contains("0 to 30"), "{text}");

    assert!(
        solve(&both[..1], &start)
            .to_string()
            .contains("no model computes `lambda`, which the problem demands")
    );
    let twice = [torque.clone(), lambda.clone(), torque.clone()];
    assert!(solve(&twice, &start).to_string().contains("the second one of that output"));
    let other = OutputModel::plain("knock", &t.model, &t.theta, &ENGINE);
    assert!(solve(&[torque.clone(), lambda.clone(), other], &start).to_string().contains("does not name"));
    let unknown = OutputModel::plain("torque", &t.model, &t.theta, &["inj", "spark", "pedal", "speed"]);
    assert!(solve(&[unknown, lambda.clone()], &start).to_string().contains("reads `pedal`"));
    let ring = OutputModel::plain("torque", &t.model, &t.theta, &["inj", "spark", "lambda", "speed"]);
    let back = OutputModel::plain("lambda", &l.model, &l.theta, &["inj", "torque", "throttle", "speed"]);
    assert!(solve(&[ring, back], &start).to_string().contains("in a ring"));
    let short = start.part(0, 5, "short".into());
    assert!(solve(&both, &short).to_string().contains("has 5 samples"));

    let mut wild = t.theta.clone();
    let at = t.model.regressor_texts().iter().position(|r| r == "torque(t-1)").expect("output term");
    wild[at] = 1e200;
    let unstable = OutputModel::plain("torque", &t.model, &wild, &ENGINE);
    let text = solve(&[unstable, lambda], &start).to_string();
    assert!(text.contains("torque model is unstable in free run"), "{text}");
}

/// Two burners, the cheaper one at its limit: every price is known by hand.
#[test]
fn prices_are_the_slopes_of_the_optimum() {
    let of = |limit: f64, demand: f64| {
        let p = problem(&format!(
            r#"
            minimise = [{{ channel = "a", weight = 2.0 }}, {{ channel = "b" }}]
            inputs = [
                {{ name = "a", unit = "kW", lower = 0.0, upper = 9.0 }},
                {{ name = "b", unit = "kW", lower = 0.0, upper = {limit} }},
            ]
            demands = [{{ output = "heat", unit = "kW", lower = 0.0, upper = 20.0 }}]
            "#
        ));
        let heat =
            PolyNarx::parse(&["a", "b"], "heat", &["a(t-1)", "b(t-1)", "heat(t-1)"]).expect("structure");
        let models = [OutputModel::plain("heat", &heat, &[0.5, 0.5, 0.5], &["a", "b"])];
        let mut start = record(50, &mut Rng64::new(7));
        start.channels = vec![
            channel("a", "kW", Role::Input, vec![demand - 1.0; 50]),
            channel("b", "kW", Role::Input, vec![1.0; 50]),
            channel("heat", "kW", Role::Output, vec![demand; 50]),
        ];
        optimise_models(&p, &models, &start, &OptimiseOptions::default(), &|| false).expect("solved")
    };
    let found = of(2.0, 5.0);
    let price = |of: &str, channel: &str| {
        found.prices.iter().find(|p| p.of == of && p.channel == channel).expect("price").price
    };
    // One more unit of b replaces one of a.
    assert!((price("upper", "b") - -1.0).abs() < 1e-5, "{}", price("upper", "b"));
    assert!(price("upper", "a").abs() < 1e-5 && price("lower", "a").abs() < 1e-5);
    // One unit more heat at all samples but the first: 2 units of a at once, then 1; a costs 2; 48 samples are decided.
    let expected = 2.0 * (2.0 + 47.0) / 48.0;
    assert!((price("demand", "heat") - expected).abs() < 1e-5, "{}", price("demand", "heat"));
    // And as the solution itself changes.
    let slope = (of(2.1, 5.0).objective - found.objective) / 0.1;
    assert!((slope - price("upper", "b")).abs() < 1e-4, "{slope}");
}

/// Means with a limit, and the price of the limit.
#[test]
fn a_limited_mean_is_kept_and_has_its_price() {
    let of = |upper: f64| {
        let p = problem(&format!(
            r#"
            minimise = [{{ channel = "b" }}]
            inputs = [
                {{ name = "a", unit = "kW", lower = 0.0, upper = 9.0 }},
                {{ name = "b", unit = "kW", lower = 0.0, upper = 9.0 }},
            ]
            demands = [{{ output = "heat", unit = "kW", lower = 0.0, upper = 20.0 }}]
            limits = [{{ output = "smoke", unit = "g", mean_upper = {upper} }}]
            "#
        ));
        let heat = PolyNarx::parse(&["a", "b"], "heat", &["a(t-1)", "b(t-1)"]).expect("structure");
        let smoke = PolyNarx::parse(&["a"], "smoke", &["a(t-1)^2", "smoke(t-1)"]).expect("structure");
        let models = [
            OutputModel::plain("heat", &heat, &[1.0, 1.0], &["a", "b"]),
            OutputModel::plain("smoke", &smoke, &[0.5, 0.5], &["a"]),
        ];
        let mut start = record(80, &mut Rng64::new(7));
        start.channels = vec![
            channel("a", "kW", Role::Input, vec![1.0; 80]),
            channel("b", "kW", Role::Input, vec![3.0; 80]),
            channel("heat", "kW", Role::Output, vec![4.0; 80]),
            channel("smoke", "g", Role::Output, vec![1.0; 80]),
        ];
        optimise_models(&p, &models, &start, &OptimiseOptions::default(), &|| false).expect("solved")
    };
    let (found, more) = (of(4.0), of(4.01));
    assert_eq!(found.status, Status::Converged);
    assert!(found.violations.iter().all(|v| v.largest < 1e-6), "{:?}", found.violations);
    let smoke = found.outputs.iter().find(|c| c.name == "smoke").expect("smoke");
    let mean = smoke.values[2..].iter().sum::<f64>() / 78.0;
    assert!((mean - 4.0).abs() < 1e-6, "{mean}");
    let price = found.prices.iter().find(|p| p.of == "mean_upper").expect("price").price;
    let slope = (more.objective - found.objective) / 0.01;
    assert!(price < 0.0 && (slope - price).abs() < 1e-3 * price.abs(), "{slope} {price}");
}

/// A limit beyond reach: y follows u with at most u = 5, so 2 u = 10 is the most; 12 is asked from the start on.
#[test]
fn a_limit_beyond_reach_names_time_amount_and_input() {
    let p = problem(
        r#"
        minimise = [{ channel = "u" }]
        inputs = [{ name = "u", unit = "bar", lower = 0.0, upper = 5.0 }]
        limits = [{ output = "y", unit = "K", lower = 12.0 }]
        "#,
    );
    let y = PolyNarx::parse(&["u"], "y", &["u(t-1)", "y(t-1)"]).expect("structure");
    let models = [OutputModel::plain("y", &y, &[1.0, 0.5], &["u"])];
    let mut start = record(40, &mut Rng64::new(7));
    start.channels =
        vec![channel("u", "bar", Role::Input, vec![2.0; 40]), channel("y", "K", Role::Output, vec![4.0; 40])];
    let found = optimise_models(&p, &models, &start, &OptimiseOptions::default(), &|| false).expect("set up");
    assert_eq!(found.status, Status::Infeasible);
    let [s] = &found.shortfalls[..] else { panic!("{:?}", found.shortfalls) };
    // y(2) = 4 / 2 + 5 = 7 misses most.
    assert!(
        (s.from_s - 0.06).abs() < 1e-9 && (s.largest - -5.0).abs() < 1e-4 && (s.at_s - 0.06).abs() < 1e-9,
        "{s:?}"
    );
    assert_eq!(s.inputs, ["u at 5 bar"]);
    assert!(
        s.sentence().contains("y goes below its lower limit from 0.06 to 1.17 s by up to 5.0000 K"),
        "{}",
        s.sentence()
    );
}

/// A stored model of 1/lambda that reads the cycle duration gives what the same structure gives with its ways by hand.
#[test]
fn stored_models_give_what_their_structures_give() {
    let p = problem(
        r#"
        minimise = [{ channel = "inj" }]
        inputs = [{ name = "inj", unit = "mg", lower = 0.0, upper = 30.0 }]
        given = [{ name = "speed", unit = "rpm", lower = 500.0, upper = 4000.0 }]
        limits = [{ output = "lambda", unit = "-", lower = 0.8, upper = 0.95 }]
        "#,
    );
    let structure = PolyNarx::parse(&["inj", "cycle"], "phi", &["inj(t-1)", "cycle(t-1)", "phi(t-1)"])
        .expect("structure");
    let theta = [0.04, 1.0, 0.5];
    let quantity = |name: &str, unit: &str| Quantity { name: name.into(), unit: unit.into() };
    let derived = |name: &str, unit: &str, factor, channel: &str| Derived {
        name: name.into(),
        unit: unit.into(),
        factor,
        powers: [(channel.to_string(), -1)].into(),
    };
    let mut stored = StoredModel::new(
        structure.clone(),
        &theta,
        vec![quantity("inj", "mg"), quantity("cycle", "s")],
        quantity("phi", "-"),
        0.03,
    )
    .expect("model");
    stored.derived = vec![derived("cycle", "s", 120.0, "speed"), derived("phi", "-", 1.0, "lambda")];
    stored.seen =
        ["speed", "lambda"].map(|name| seen(name, if name == "speed" { "rpm" } else { "-" })).into();
    let cycle = Monomial { factor: 120.0, powers: vec![("speed".into(), -1)] };
    let plain = OutputModel {
        output: "lambda".into(),
        model: &structure,
        theta: &theta,
        inputs: vec![Source::plain("inj"), Source { monomial: cycle, offset: 0.0, scale: 1.0 }],
        way: OutputWay { power: -1, ..OutputWay::PLAIN },
        boundary: None,
        draws: Vec::new(),
    };
    let start = record(60, &mut Rng64::new(3));
    let options = OptimiseOptions::default();
    let by_hand = optimise_models(&p, &[plain], &start, &options, &|| false).expect("solved");
    let found = optimise_record(&p, &[&stored], &start, &options, &|| false).expect("solved");
    assert_eq!(found, by_hand);
    assert_eq!(found.status, Status::Converged);
    assert!(
        found.outputs[0].values[10..].iter().all(|l| (l - 0.95).abs() < 1e-4),
        "{:?}",
        found.outputs[0].values
    );
    let mut other = start.clone();
    other.channels[0].unit = "kg".into();
    let error = optimise_record(&p, &[&stored], &other, &options, &|| false).unwrap_err();
    assert!(
        error.to_string().contains("`inj` is in `kg`, the model of `lambda` takes it in `mg`"),
        "{error}"
    );
}

fn seen(name: &str, unit: &str) -> Seen {
    Seen { name: name.into(), unit: unit.into(), minimum: 0.0, maximum: 1.0 }
}

/// An output at rest spreads by the last digit of its record alone; that is no size of a variable. The optimum, which moves it far
/// from its rest, does not depend on that digit.
#[test]
fn an_output_at_rest_has_the_size_of_its_value() {
    let p = problem(
        r#"
        minimise = [{ channel = "u", weight = 1.0 }, { channel = "y", weight = -0.5 }]
        inputs = [{ name = "u", unit = "-", lower = 0.0, upper = 3.0, rate_per_s = 2.0 }]
        given = [{ name = "g", unit = "-", lower = 0.0, upper = 2.0 }]
        limits = [{ output = "y", unit = "-", mean_upper = 1.6 }, { output = "z", unit = "-", lower = 0.5, upper = 1.3 }]
        "#,
    );
    let y = PolyNarx::parse(&["u", "g"], "y", &["y(t-1)", "u(t-1)", "g(t-1)*u(t-1)^2"]).expect("y");
    let z = PolyNarx::parse(&["u", "y"], "z", &["z(t-1)", "u(t-1)", "y(t-1)^2"]).expect("z");
    let models = [
        OutputModel::plain("y", &y, &[0.6, 0.5, -0.1], &["u", "g"]),
        OutputModel::plain("z", &z, &[0.5, 0.3, 0.2], &["u", "y"]),
    ];
    // At u = 1, g = 1 both models rest at 1.
    let n = 60;
    let solved = |jitter: f64| {
        let at_rest = |k: usize| 1.0 + jitter * (k % 2) as f64;
        let swing = (0..n).map(|k| 1.0 + 0.5 * (0.3 * k as f64).sin()).collect();
        let start = Dataset {
            name: "rest".into(),
            sample_time_s: 0.1,
            channels: vec![
                channel("u", "-", Role::Input, vec![1.0; n]),
                channel("g", "-", Role::Input, swing),
                channel("y", "-", Role::Output, (0..n).map(at_rest).collect()),
                channel("z", "-", Role::Output, (0..n).map(at_rest).collect()),
            ],
            init_samples: 0,
            origin: "test".into(),
        };
        let options = OptimiseOptions::default();
        let program = Program::new(parts(&p, &models, &start, &options).expect("parts"));
        let mut sizes = vec![1.0; program.n()];
        program.sizes(&mut sizes);
        let least = sizes.iter().copied().fold(f64::INFINITY, f64::min);
        assert!(least > 1e-3, "size {least:e} with jitter {jitter:e}");
        let found = optimise_models(&p, &models, &start, &options, &|| false).expect("solved");
        assert_eq!(found.status, Status::Converged, "jitter {jitter:e}");
        found.objective
    };
    let (still, shaken) = (solved(0.0), solved(f64::EPSILON));
    assert!((still - shaken).abs() < 1e-7 * still.abs().max(1.0), "{still} {shaken}");
}
