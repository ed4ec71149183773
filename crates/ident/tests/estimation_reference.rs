//! Estimates against independent implementations (numpy and scipy, see the reference data's own page).

mod common;

use common::{ch5, column, dataset, engine, own, reference, relative};
use dynocal_ident::data::Role;
use dynocal_ident::estimate::ols::Ols;
use dynocal_ident::estimate::sem::Sem;
use dynocal_ident::estimate::{Estimator, Fit};
use dynocal_ident::experiment::{Experiment, experiments};
use dynocal_ident::model::literature::{self, LiteratureModel};
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::model::{Model, Run};
use dynocal_numerics::status::Status;

fn fit(estimator: &dyn Estimator, model: &PolyNarx, data: &[Experiment]) -> Fit {
    estimator.estimate(model, data, None, &|| false).unwrap()
}

fn free_run_mse(model: &PolyNarx, theta: &[f64], e: &Experiment) -> f64 {
    let mut y = vec![0.0; e.len()];
    model.simulate(theta, &e.run(model), &mut y);
    let first = e.first(model);
    (first..e.len()).map(|t| (y[t] - e.y[t]).powi(2)).sum::<f64>() / (e.len() - first) as f64
}

/// Chapter 5, known system: least squares, its free run, and simulation-error estimation.
#[test]
fn chapter_5_reaches_the_reference_costs() {
    let LiteratureModel { model, .. } = literature::torque_5_3();
    let data = experiments(&[ch5(&own("ch5_ident.csv"))], model.inputs(), model.output()).unwrap();
    let ols = fit(&Ols::default(), &model, &data);
    relative(ols.mse, 0.5837968957849703, 1e-9);
    relative(free_run_mse(&model, &ols.theta, &data[0]), 0.5561114021022748, 1e-9);
    let theta_ols = [-7.132670249647417, 14.712963926617428, -50.95243318146426, 34.77168354910831];
    for (found, expected) in ols.theta.iter().zip(theta_ols) {
        relative(*found, expected, 1e-8);
    }

    let sem = fit(&Sem::default(), &model, &data);
    relative(sem.mse, 0.501210980607983, 1e-9);
    assert_eq!(sem.status, Status::Converged);
    assert!(sem.evaluations <= 10, "{} evaluations", sem.evaluations);
    assert!(sem.warnings.is_empty(), "{:?}", sem.warnings);
    relative(free_run_mse(&model, &sem.theta, &data[0]), sem.mse, 1e-12);
    let theta_sem = [-5.432333523593698, 14.35500479595705, -52.386312835208095, 37.502769134326655];
    for (found, expected) in sem.theta.iter().zip(theta_sem) {
        relative(*found, expected, 1e-5);
    }
}

/// Chapter 5 on the validation records: the same parameters, the reference's free-run errors.
#[test]
fn chapter_5_validates_as_the_reference() {
    let LiteratureModel { model, .. } = literature::torque_5_3();
    let of = |file: &str| {
        let path = reference(&format!("estimation_inputs/{file}.csv"))?;
        Some(experiments(&[ch5(&path)], model.inputs(), model.output()).unwrap().remove(0))
    };
    let Some(ident) = of("ch5_ident") else { return };
    let sem = fit(&Sem::default(), &model, &[ident]);
    let expected = [0.5083216818609799, 0.5344041909436651, 0.4832800133877992];
    for (i, expected) in expected.into_iter().enumerate() {
        let Some(e) = of(&format!("ch5_val{:02}", i + 1)) else { return };
        relative(free_run_mse(&model, &sem.theta, &e), expected, 1e-6);
    }
}

/// The structures (7.8) on the engine record: prediction error and simulation error. First scored sample 3.
#[test]
fn engine_polynomials_reach_the_reference_costs() {
    let Some(path) = reference("estimation_inputs/engine_ident.csv") else { return };
    let record = engine(&path);
    // Reference files: y(t-1) last. (7.8) has it in place 9 (torque) and, as here, last (lambda).
    let cases = [
        (literature::torque_7_8(), "T", 9, 31.26897243308814, 13.78107721879888),
        (literature::lambda_7_8(), "lambda", 6, 0.004232792724751107, 0.0032103592514885564),
    ];
    for (LiteratureModel { model, .. }, file, place, pem_mse, sem_mse) in cases {
        let data = experiments(std::slice::from_ref(&record), model.inputs(), model.output()).unwrap();
        let ols = fit(&Ols::default(), &model, &data);
        let mut theta = column(&reference(&format!("estimation_inputs/poly_{file}_pem.csv")).unwrap());
        let output = theta.pop().unwrap();
        theta.insert(place, output);
        for (found, expected) in ols.theta.iter().zip(&theta) {
            relative(*found, *expected, 1e-7);
        }
        relative(free_run_mse(&model, &ols.theta, &data[0]), pem_mse, 1e-7);
        let sem = fit(&Sem::default(), &model, &data);
        println!("{file}: {} of {sem_mse}, {} evaluations, {:?}", sem.mse, sem.evaluations, sem.status);
        assert!(sem.mse <= sem_mse * (1.0 + 1e-6), "{file}: {} of {sem_mse}", sem.mse);
        relative(sem.mse, sem_mse, 1e-6);
    }
}

struct Linear {
    case: &'static str,
    orders: (usize, usize, usize),
    simulation: bool,
    /// In the order A (or F), B of `1 + a_1 q^-1 + ..`.
    theta: &'static [f64],
    std: &'static [f64],
    v: f64,
}

/// Linear cases with all filters at rest: ARX by least squares, output error by simulation error.
#[test]
fn linear_cases_reach_the_reference_costs_and_standard_errors() {
    let cases = [
        Linear {
            case: "arx1",
            orders: (2, 2, 1),
            simulation: false,
            theta: &[-1.5050990318063453, 0.7032165177512613, 0.9889033104802945, 0.4943425724622457],
            std: &[0.005013996107366978, 0.004581939470306278, 0.014905131691445427, 0.01884058697961153],
            v: 0.23723916735751238,
        },
        Linear {
            case: "arx2",
            orders: (3, 2, 3),
            simulation: false,
            theta: &[
                -0.8841039257695108,
                0.17911138768016754,
                -0.03174604536770882,
                0.40912655914882495,
                0.30647767076314913,
            ],
            std: &[
                0.017642514233411875,
                0.023836641290607988,
                0.013250547166070393,
                0.006829671701535484,
                0.009950063575214376,
            ],
            v: 0.09301589327986394,
        },
        Linear {
            case: "oe1",
            orders: (2, 2, 1),
            simulation: true,
            theta: &[-1.498762830131595, 0.7001445542213424, 0.9831312179634747, 0.518703967505067],
            std: &[0.002704094976184259, 0.0020646375964004458, 0.015917823319472987, 0.02194488683163934],
            v: 0.9708220639831583,
        },
        Linear {
            case: "cl_arx",
            orders: (2, 2, 1),
            simulation: false,
            theta: &[-1.5036586599021702, 0.6998335880226204, 1.0137724704700217, 0.500570393005753],
            std: &[0.00601971958987057, 0.006411681791680491, 0.015172173052652664, 0.017326818689033963],
            v: 0.2522640611928382,
        },
        Linear {
            case: "cl_oe",
            orders: (2, 2, 1),
            simulation: true,
            theta: &[-1.4984660879840905, 0.6978681453485118, 0.996060782068582, 0.5075261189658993],
            std: &[0.00318728966401567, 0.0030545259067428538, 0.00969771561237242, 0.011972078075497015],
            v: 0.4798208099218398,
        },
    ];
    for c in &cases {
        let Some(path) = reference(&format!("estimation_inputs/lin_{}.csv", c.case)) else { return };
        let record = dataset(&path, 1.0, &[("u", "u", Role::Input), ("y", "y", Role::Output)]);
        let (na, nb, nk) = c.orders;
        let model = PolyNarx::arx(&["u".into()], "y", na, nb, nk, false).unwrap();
        let data = experiments(&[record], model.inputs(), "y").unwrap();
        let data = [data[0].at_rest(model.max_lag())];
        let estimator: Box<dyn Estimator> =
            if c.simulation { Box::new(Sem::default()) } else { Box::new(Ols::default()) };
        let found = fit(estimator.as_ref(), &model, &data);
        assert_eq!(found.samples, 2000, "{}", c.case);
        assert!(found.mse <= c.v * (1.0 + 1e-8), "{}: V {} of {}", c.case, found.mse, c.v);
        // Our order: B, then y(t-1).. with the sign turned.
        for k in 0..na + nb {
            let (i, sign) = if k < na { (nb + k, -1.0) } else { (k - na, 1.0) };
            let error = (sign * found.theta[i] - c.theta[k]).abs();
            assert!(error <= 1e-4 * c.std[k], "{} theta {k}: {error} of std {}", c.case, c.std[k]);
            // The reference divides by n where the unbiased variance divides by n - p.
            let n_over = ((found.samples - found.theta.len()) as f64 / found.samples as f64).sqrt();
            relative(found.std_errors[i] * n_over, c.std[k], 1e-4);
        }
    }
}

/// Prediction on the measured output, for completeness against the free run of the same model.
#[test]
fn least_squares_minimises_the_prediction_error() {
    let LiteratureModel { model, .. } = literature::torque_5_3();
    let data = experiments(&[ch5(&own("ch5_ident.csv"))], model.inputs(), model.output()).unwrap();
    let ols = fit(&Ols::default(), &model, &data);
    let e = &data[0];
    let run: Run = e.run(&model);
    let mse = |theta: &[f64]| {
        let mut y = vec![0.0; e.len()];
        model.predict(theta, &run, &mut y);
        (7..e.len()).map(|t| (y[t] - e.y[t]).powi(2)).sum::<f64>() / (e.len() - 7) as f64
    };
    relative(mse(&ols.theta), ols.mse, 1e-12);
    for k in 0..ols.theta.len() {
        for sign in [-1.0, 1.0] {
            let mut theta = ols.theta.clone();
            theta[k] += sign * 0.01 * ols.std_errors[k];
            assert!(mse(&theta) > ols.mse);
        }
    }
}
