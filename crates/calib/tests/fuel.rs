//! The fuel program: derivatives against differences, and the reference record against published optima.

use dynocal_calib::engine_model::{EngineModel, Transform};
use dynocal_calib::fuel::problem::{Equality, FuelProblem, FuelSpec, Source};
use dynocal_calib::fuel::{FuelError, OptimiseSpec, minimise_fuel};
use dynocal_files::csv_io;
use dynocal_ident::data::{Channel, Dataset, Role};
use dynocal_ident::model::literature;
use dynocal_ident::model::poly::PolyNarx;
use dynocal_numerics::nlp::SparseNlp;
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::status::Status;
use std::path::PathBuf;

fn model(output: &str, structure: PolyNarx, theta: Vec<f64>) -> EngineModel {
    EngineModel {
        schema_version: 1,
        output: output.into(),
        transform: Transform::Identity,
        sample_time_s: 0.03,
        origin: "test".into(),
        structure,
        theta,
    }
}

/// Central differences of objective, constraints and Lagrangian gradient at a random point.
#[test]
fn derivatives_agree_with_central_differences() {
    let (torque, lambda) = (literature::torque_7_8(), literature::lambda_7_8());
    let n = 14;
    let mut rng = Rng64::new(5);
    let start: Vec<f64> = (0..3 * n).map(|k| [12.0, 17.0, 11.0][k % 3] + rng.normal()).collect();
    let speed: Vec<f64> = (0..n).map(|t| 1500.0 + 40.0 * t as f64).collect();
    let demand: Vec<f64> = (0..n).map(|t| 40.0 + t as f64).collect();
    let lambda_demand: Vec<f64> = (0..n).map(|t| 1.0 + 0.01 * t as f64).collect();
    let spec = FuelSpec {
        start: &start,
        given: &speed,
        n_given: 1,
        first: 3,
        bounds: [(0.0, 30.0), (5.0, 30.0), (0.0, 90.0)],
        spark_rate_deg: 1.0,
        increment_weight: [2e-2, 1e-2, 3e-2],
    };
    let inputs = || vec![Source::Decision(0), Source::Decision(1), Source::Decision(2), Source::Given(0)];
    let equality = |m: &'static PolyNarx, theta: &'static [f64], demand| Equality {
        model: m,
        theta,
        inputs: inputs(),
        demand,
    };
    let (torque, lambda) = (Box::leak(Box::new(torque)), Box::leak(Box::new(lambda)));
    let equalities = vec![
        equality(&torque.model, &torque.theta, &demand),
        equality(&lambda.model, &lambda.theta, &lambda_demand),
    ];
    let mut p = FuelProblem::new(spec, equalities);
    let (nv, m) = (p.n(), p.m());
    let x: Vec<f64> =
        (0..nv).map(|k| if k < nv - 10 { [11.0, 16.0, 12.0][k % 3] } else { 0.1 } + rng.normal()).collect();
    let multipliers: Vec<f64> = (0..m).map(|_| rng.normal()).collect();

    // Lagrangian gradient from exact pieces.
    let lagrangian_gradient = |p: &mut FuelProblem, x: &[f64]| -> Vec<f64> {
        let structure = p.jacobian_structure();
        let (mut g, mut j) = (vec![0.0; nv], vec![0.0; structure.len()]);
        p.gradient(x, &mut g);
        p.jacobian(x, &mut j);
        for ((r, c), v) in structure.iter().zip(&j) {
            g[*c] += multipliers[*r] * v;
        }
        g
    };
    let lagrangian = |p: &mut FuelProblem, x: &[f64]| -> f64 {
        let mut c = vec![0.0; m];
        p.constraints(x, &mut c);
        p.objective(x) + c.iter().zip(&multipliers).map(|(a, b)| a * b).sum::<f64>()
    };
    let exact = lagrangian_gradient(&mut p, &x);
    let structure = p.hessian_structure();
    let mut values = vec![0.0; structure.len()];
    p.hessian(&x, 1.0, &multipliers, &mut values);
    let mut hessian = vec![0.0; nv * nv];
    for ((r, c), v) in structure.iter().zip(&values) {
        assert!(r >= c, "lower triangle only");
        hessian[r * nv + c] += v;
        if r != c {
            hessian[c * nv + r] += v;
        }
    }
    for k in 0..nv {
        let h = 1e-5;
        let (mut up, mut down) = (x.clone(), x.clone());
        up[k] += h;
        down[k] -= h;
        let slope = (lagrangian(&mut p, &up) - lagrangian(&mut p, &down)) / (2.0 * h);
        assert!(
            (slope - exact[k]).abs() < 1e-6 * exact[k].abs().max(1.0),
            "gradient {k}: {slope} {}",
            exact[k]
        );
        let (a, b) = (lagrangian_gradient(&mut p, &up), lagrangian_gradient(&mut p, &down));
        for i in 0..nv {
            let second = (a[i] - b[i]) / (2.0 * h);
            let got = hessian[i * nv + k];
            assert!((second - got).abs() < 1e-6 * got.abs().max(1.0), "Hessian {i} {k}: {second} {got}");
        }
    }
}

fn reference_dir() -> Option<PathBuf> {
    let dir = std::env::var_os("DYNOCAL_REFERENCE_DIR").map(PathBuf::from);
    if dir.is_none() {
        println!("SKIPPED: DYNOCAL_REFERENCE_DIR is not set");
    }
    dir
}

fn column(path: &std::path::Path) -> Vec<f64> {
    let text = std::fs::read_to_string(path).expect("reference file");
    text.lines().filter(|l| !l.trim().is_empty()).map(|l| l.trim().parse().expect("number")).collect()
}

/// `engine_opt.csv` with the stored polynomial models; the rate limit holds from the first decided sample on.
#[test]
fn reference_record_reaches_the_published_optimum() {
    let Some(dir) = reference_dir() else { return };
    let inputs = dir.join("reference/estimation_inputs");
    let table = csv_io::read(&inputs.join("engine_opt.csv")).expect("record");
    let get = |name: &str| table.numbers(name, 0, table.rows()).expect("numbers").to_vec();
    let channel = |name: &str, from: &str, role| Channel {
        name: name.into(),
        unit: "-".into(),
        role,
        values: get(from),
    };
    let record = Dataset {
        name: "engine_opt".into(),
        sample_time_s: 0.03,
        channels: vec![
            channel("inj", "INJ_mg", Role::Input),
            channel("spark", "SA_deg", Role::Input),
            channel("throttle", "theta_deg", Role::Input),
            channel("speed", "N_rpm", Role::Input),
            channel("torque", "T_Nm", Role::Output),
            channel("lambda", "lambda", Role::Output),
        ],
        init_samples: 0,
        origin: "reference".into(),
    };
    // The parameter files hold the output coefficient last.
    let reordered = |structure: &PolyNarx, file: &str| -> Vec<f64> {
        let mut values = column(&inputs.join(file)).into_iter();
        let names = structure.regressor_texts();
        let output = format!("{}(t-1)", structure.output());
        let rest: Vec<f64> = values.by_ref().collect();
        let mut others = rest[..rest.len() - 1].iter();
        names
            .iter()
            .map(|n| if *n == output { rest[rest.len() - 1] } else { *others.next().expect("value") })
            .collect()
    };
    let (t, l) = (literature::torque_7_8().model, literature::lambda_7_8().model);
    let torque = model("torque", t.clone(), reordered(&t, "poly_T_sem.csv"));
    let lambda = model("lambda", l.clone(), reordered(&l, "poly_lambda_sem.csv"));
    let spec = OptimiseSpec { increment_weight: [0.0; 3], ..OptimiseSpec::default() };
    let out = minimise_fuel(&spec, &torque, &lambda, &record, &|| false).expect("solved");
    assert_eq!(out.status, Status::Converged);
    assert!((out.start_fuel_kg_h - 2.5130714915357815).abs() < 1e-9, "{}", out.start_fuel_kg_h);
    assert!(out.fuel_kg_h <= 2.3903178, "{}", out.fuel_kg_h);
    // Nothing below the tight solution of an independent solver is possible but by violation.
    assert!(out.fuel_kg_h > 2.390317721415519 - 1e-6);
    assert!(out.torque_violation_nm < 1e-6 && out.lambda_violation < 1e-6);
    let spark: Vec<f64> = out.inputs.iter().skip(1).step_by(3).copied().collect();
    let steepest = spark.windows(2).skip(out.first - 1).map(|w| (w[1] - w[0]).abs()).fold(0.0, f64::max);
    assert!(steepest <= 1.0 + 1e-7, "{steepest}");
}

fn flat_record(inj_mg: f64) -> Dataset {
    let n = 60;
    let channel = |name: &str, unit: &str, role, value: f64| Channel {
        name: name.into(),
        unit: unit.into(),
        role,
        values: vec![value; n],
    };
    Dataset {
        name: "flat".into(),
        sample_time_s: 0.03,
        channels: vec![
            channel("inj", "mg", Role::Input, inj_mg),
            channel("spark", "deg", Role::Input, 15.0),
            channel("throttle", "deg", Role::Input, 12.0),
            channel("speed", "rpm", Role::Input, 2000.0),
            channel("torque", "Nm", Role::Output, 40.0),
            channel("lambda", "-", Role::Output, 1.0),
        ],
        init_samples: 0,
        origin: "test".into(),
    }
}

#[test]
fn a_start_outside_the_limits_is_named() {
    let (t, l) = (literature::torque_7_8(), literature::lambda_7_8());
    let (torque, lambda) = (model("torque", t.model, t.theta), model("lambda", l.model, l.theta));
    let error =
        minimise_fuel(&OptimiseSpec::default(), &torque, &lambda, &flat_record(35.0), &|| false).unwrap_err();
    assert!(matches!(error, FuelError::Start { .. }));
    let text = error.to_string();
    assert!(text.contains("inj is 35 mg") && text.contains("0 to 30"), "{text}");
}

#[test]
fn an_unstable_model_is_named() {
    let (mut t, l) = (literature::torque_7_8(), literature::lambda_7_8());
    let at = t.model.regressor_texts().iter().position(|r| r == "torque(t-1)").expect("output term");
    t.theta[at] = 1e200;
    let (torque, lambda) = (model("torque", t.model, t.theta), model("lambda", l.model, l.theta));
    let error =
        minimise_fuel(&OptimiseSpec::default(), &torque, &lambda, &flat_record(12.0), &|| false).unwrap_err();
    assert!(error.to_string().contains("torque model is unstable in free run"), "{error}");
}
