//! Linear models with noise models against scipy (exact-gradient prediction error, see the reference data's own
//! page), central differences, and the truth of simulated systems.

mod common;

use common::systems::{System, simulate};
use common::{dataset, reference, relative};
use dynocal_ident::data::{Dataset, Role};
use dynocal_ident::estimate::pem::Pem;
use dynocal_ident::estimate::{EstimateError, Fit};
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::kinds::{MODEL_KINDS, ModelKind, kind};
use dynocal_ident::model::linear::{InputOrders, LinearModel, PredictionErrors};
use dynocal_ident::model::{Model, Run};
use dynocal_numerics::status::Status;

fn fit(model: &LinearModel, data: &[Experiment]) -> Fit {
    Pem::default().estimate(model, data, None, &|| false).unwrap()
}

/// Cases with stored records and their structures.
fn cases() -> Vec<(&'static str, LinearModel)> {
    vec![
        ("arx1", LinearModel::arx(&["u"], "y", 2, 2, 1)),
        ("arx2", LinearModel::arx(&["u"], "y", 3, 2, 3)),
        ("armax1", LinearModel::armax(&["u"], "y", 2, 2, 2, 1)),
        ("armax2", LinearModel::armax(&["u"], "y", 1, 2, 1, 2)),
        ("oe1", LinearModel::oe(&["u"], "y", 2, 2, 1)),
        ("bj1", LinearModel::bj(&["u"], "y", 2, 1, 1, 2, 1)),
        ("cl_arx", LinearModel::arx(&["u"], "y", 2, 2, 1)),
        ("cl_oe", LinearModel::oe(&["u"], "y", 2, 2, 1)),
        ("firarma", LinearModel::bj(&["u"], "y", 2, 1, 1, 0, 1)),
        ("arma1", LinearModel::arma("y", 1, 2)),
    ]
}

fn record(case: &str) -> Option<Dataset> {
    let path = reference(&format!("estimation_inputs/lin_{case}.csv"))?;
    Some(dataset(&path, 1.0, &[("u", "u", Role::Input), ("y", "y", Role::Output)]))
}

fn experiment(model: &LinearModel, d: &Dataset) -> Experiment {
    let u = d.matrix(&model.inputs).unwrap();
    let y = d.values("y").unwrap().to_vec();
    Experiment { name: d.name.clone(), u, y, init_samples: 0, weights: Vec::new() }
}

fn numbers(v: &serde_json::Value) -> Vec<f64> {
    v.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect()
}

/// Cost, parameters and standard errors of every stored case, from the least-squares start and from the reference's
/// own start (its least-squares A and B, nothing else).
#[test]
fn stored_cases_reach_the_reference() {
    let Some(path) = reference("estimation_fuel_reference.json") else { return };
    let json: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    for (case, model) in cases() {
        let Some(d) = record(case) else { return };
        let data = [experiment(&model, &d)];
        let expected = &json["part2"][case]["pem"];
        let (theta, std) = (numbers(&expected["theta"]), numbers(&expected["std"]));
        let v = expected["V"].as_f64().unwrap();
        let found = fit(&model, &data);
        let worst = (0..theta.len()).map(|k| (found.theta[k] - theta[k]).abs() / std[k]).fold(0.0, f64::max);
        println!(
            "{case}: V {:.12} of {v:.12}, {worst:.1e} standard errors, {} evaluations, {:?}",
            found.mse, found.evaluations, found.status
        );
        assert!((found.mse - v).abs() <= 1e-8 * v, "{case}: V {} of {v}", found.mse);
        assert!(worst <= 1e-4, "{case}: {worst} standard errors");
        assert_eq!(found.status, Status::Converged, "{case}");
        assert!(found.warnings.is_empty(), "{case}: {:?}", found.warnings);
        for k in 0..theta.len() {
            // The reference divides by n where the unbiased variance divides by n - p.
            let n_over = ((found.samples - theta.len()) as f64 / found.samples as f64).sqrt();
            relative(found.std_errors[k] * n_over, std[k], 1e-4);
        }
        // A and B (with F = A where there is no A) by plain least squares, no noise model at all.
        let start = plain_start(&model, &numbers(&json["part2"][case]["ls"]));
        let again = Pem::default().estimate(&model, &data, Some(&start), &|| false).unwrap();
        assert!((again.mse - v).abs() <= 1e-8 * v, "{case} from plain least squares: {} of {v}", again.mse);
    }
}

/// `ls` holds A (or F), then B; for a time series the poles of D.
fn plain_start(model: &LinearModel, ls: &[f64]) -> Vec<f64> {
    let mut p = model.polynomials(&vec![0.0; model.n_params()]);
    let Some(o) = model.orders.first() else { return vec![0.0; model.n_params()] };
    let (poles, zeros) = ls.split_at(ls.len() - o.nb);
    if model.na > 0 {
        p.a[1..].copy_from_slice(poles);
    } else if o.nf > 0 {
        p.f[0][1..].copy_from_slice(poles);
    }
    p.b[0][o.nk..].copy_from_slice(zeros);
    model.parameters(&p)
}

fn systems() -> Vec<(&'static str, System)> {
    let o = |nb, nf, nk| InputOrders { nb, nf, nk };
    let two = |na, orders: [InputOrders; 2], nc, nd| LinearModel {
        inputs: vec!["a".into(), "b".into()],
        output: "y".into(),
        na,
        orders: orders.to_vec(),
        nc,
        nd,
    };
    let system = |model, theta: &[f64], noise_std, feedback| System {
        model,
        theta: theta.to_vec(),
        noise_std,
        feedback,
    };
    vec![
        ("oe2", system(LinearModel::oe(&["u"], "y", 1, 1, 2), &[0.2, -0.95], 0.3, 0.0)),
        (
            "bj2",
            system(
                LinearModel::bj(&["u"], "y", 2, 1, 2, 1, 2),
                &[0.3, 0.2, -0.5, -1.2, 0.4, -0.85],
                0.4,
                0.0,
            ),
        ),
        (
            "closed loop armax",
            system(LinearModel::armax(&["u"], "y", 2, 2, 2, 1), &[-1.5, 0.7, 1.0, 0.5, -1.0, 0.2], 0.5, 0.3),
        ),
        (
            "armax, two inputs",
            system(two(2, [o(2, 0, 1), o(1, 0, 4)], 1, 0), &[-1.2, 0.5, 1.0, 0.4, -0.6, 0.6], 0.5, 0.0),
        ),
        (
            "oe, two inputs",
            system(two(0, [o(2, 2, 1), o(1, 1, 0)], 0, 0), &[1.0, 0.5, 0.7, -1.5, 0.7, -0.9], 1.0, 0.0),
        ),
        (
            "bj, two inputs",
            system(
                two(0, [o(1, 1, 1), o(2, 2, 3)], 1, 1),
                &[1.0, 0.6, 0.3, 0.5, -0.8, -0.8, -1.3, 0.6],
                0.5,
                0.0,
            ),
        ),
        ("armarx", system(two(1, [o(1, 0, 1), o(1, 0, 2)], 1, 1), &[-0.7, 1.0, 0.5, 0.5, -0.6], 0.5, 0.0)),
    ]
}

/// The estimate is nearer to the truth than four standard errors, at a cost not above that of the truth.
#[test]
fn simulated_systems_are_found() {
    for (name, s) in systems() {
        for seed in 0..4 {
            let e = simulate(&s, 2000, seed);
            let found = fit(&s.model, std::slice::from_ref(&e));
            let mut eps = vec![0.0; e.len()];
            assert!(PredictionErrors::new(&s.model, &e.u, &e.y).errors(&s.theta, &mut eps));
            let truth = eps.iter().map(|v| v * v).sum::<f64>() / e.len() as f64;
            // The errors at the truth are the noise itself: filters at rest are exact here.
            relative(truth, s.noise_std * s.noise_std, 0.15);
            assert_eq!(found.status, Status::Converged, "{name} {seed}: {:?}", found.warnings);
            assert!(found.mse <= truth, "{name} {seed}: V {} above {truth} of the truth", found.mse);
            for k in 0..s.theta.len() {
                let off = (found.theta[k] - s.theta[k]).abs() / found.std_errors[k];
                assert!(off < 4.0, "{name} {seed}: {} off by {off} standard errors", found.names[k]);
            }
        }
    }
}

#[test]
fn gradient_agrees_with_central_differences() {
    for (name, s) in systems() {
        let e = simulate(&s, 150, 9);
        let (n, p) = (e.len(), s.model.n_params());
        let mut errors = PredictionErrors::new(&s.model, &e.u, &e.y);
        let theta: Vec<f64> = s.theta.iter().map(|v| 0.9 * v + 0.01).collect();
        let (mut eps, mut jac) = (vec![0.0; n], vec![0.0; n * p]);
        assert!(errors.jacobian(&theta, &mut eps, &mut jac));
        let (mut up, mut down) = (vec![0.0; n], vec![0.0; n]);
        for k in 0..p {
            let h = 1e-6;
            let moved = |d: f64| -> Vec<f64> {
                theta.iter().enumerate().map(|(j, v)| if j == k { v + d } else { *v }).collect()
            };
            errors.errors(&moved(h), &mut up);
            errors.errors(&moved(-h), &mut down);
            for t in 0..n {
                let difference = (up[t] - down[t]) / (2.0 * h);
                let found = jac[t * p + k];
                assert!(
                    (found - difference).abs() <= 1e-7 * (1.0 + found.abs()),
                    "{name} {k} {t}: {found} against {difference}"
                );
            }
        }
    }
}

/// The NARX form responds to the inputs as the parts `B_i/F_i u_i` do.
#[test]
fn deterministic_part_is_the_noise_free_response() {
    for (name, s) in systems() {
        let quiet =
            System { noise_std: 0.0, model: s.model.clone(), theta: s.theta.clone(), feedback: s.feedback };
        let e = simulate(&quiet, 200, 3);
        let (narx, theta) = s.model.deterministic(&s.theta).unwrap();
        let padded = e.at_rest(narx.max_lag());
        let mut y = vec![0.0; padded.len()];
        let run: Run = padded.run(&narx);
        narx.simulate(&theta, &run, &mut y);
        for (t, (found, expected)) in y.iter().zip(&padded.y).enumerate() {
            assert!((found - expected).abs() < 1e-9, "{name} at {t}: {found} against {expected}");
        }
    }
}

/// Two records are one likelihood; initialising samples run through the filters and are not scored.
#[test]
fn several_records_and_initial_samples() {
    let (_, s) = systems().remove(2);
    let (a, mut b) = (simulate(&s, 1200, 1), simulate(&s, 900, 2));
    b.init_samples = 100;
    let both = fit(&s.model, &[a.clone(), b.clone()]);
    assert_eq!(both.samples, 2000);
    let mut cost = 0.0;
    for (e, first) in [(&a, 0), (&b, 100)] {
        let mut eps = vec![0.0; e.len()];
        PredictionErrors::new(&s.model, &e.u, &e.y).errors(&both.theta, &mut eps);
        cost += eps[first..].iter().map(|v| v * v).sum::<f64>();
    }
    relative(both.mse, cost / 2000.0, 1e-12);
    for k in 0..s.theta.len() {
        assert!((both.theta[k] - s.theta[k]).abs() < 4.0 * both.std_errors[k], "{}", both.names[k]);
    }
}

#[test]
fn unfit_tasks_are_errors_with_names() {
    let (_, s) = systems().remove(0);
    let mut e = simulate(&s, 50, 1);
    let pem = |model: &LinearModel, e: &Experiment, start: Option<&[f64]>| {
        Pem::default().estimate(model, std::slice::from_ref(e), start, &|| false)
    };
    assert!(matches!(pem(&s.model, &e, Some(&[1.0])), Err(EstimateError::Start { found: 1, expected: 2 })));
    let mut wrong = s.model.clone();
    wrong.inputs.push("v".into());
    assert!(pem(&wrong, &e, None).unwrap_err().to_string().contains("orders for 1 inputs, expected 2: u, v"));
    e.y[7] = f64::INFINITY;
    let text = pem(&s.model, &e, None).unwrap_err().to_string();
    assert!(text.contains("channel `y`, sample 7"), "{text}");
    e.y.truncate(2);
    e.u.truncate(2);
    assert!(pem(&s.model, &e, None).unwrap_err().to_string().contains("2 parameters"));
}

/// Every row of the table: its defaults are what it documents, it knows no other keys, and it is estimated.
#[test]
fn every_linear_structure_is_built_and_estimated() {
    let inputs: Vec<String> = ["a", "b"].map(String::from).to_vec();
    let of = |member: &ModelKind, keys: &toml::Table| -> LinearModel {
        let form = (member.build)(keys).unwrap().form(&inputs, "y", &[]).unwrap();
        form.is_a::<LinearModel>().unwrap().clone()
    };
    for member in MODEL_KINDS.iter().filter(|m| m.form.name == "linear") {
        let name = member.doc.name;
        let plain = of(member, &toml::Table::new());
        // The documented defaults, written out, give the same model.
        let mut keys = toml::Table::new();
        for p in member.doc.params {
            keys.insert(p.name.into(), toml::Value::Integer(p.default.parse().unwrap()));
        }
        assert_eq!(of(member, &keys), plain, "{name}");
        keys.insert("order".into(), 1.into());
        let fault = (member.build)(&keys).err().unwrap().to_string();
        assert!(fault.contains("`order`") && fault.contains(name), "{fault}");
        // Polynomials with small roots: every order is stable and excited. The general form is over-parametrised when A
        // and F stand together, so only its cost is judged.
        let theta: Vec<f64> = (0..plain.n_params()).map(|k| 0.3 + 0.05 * (k % 3) as f64).collect();
        let s = System { model: plain.clone(), theta, noise_std: 0.2, feedback: 0.0 };
        let e = simulate(&s, 1500, 6);
        let mut eps = vec![0.0; e.len()];
        assert!(PredictionErrors::new(&plain, &e.u, &e.y).errors(&s.theta, &mut eps), "{name}");
        let truth = eps.iter().map(|v| v * v).sum::<f64>() / e.len() as f64;
        let found = fit(&plain, std::slice::from_ref(&e));
        assert!(found.mse <= truth && found.mse > 0.9 * truth, "{name}: {} and {truth}", found.mse);
    }
    let keys: toml::Table = "nf = { a = 1, c = 2 }".parse().unwrap();
    let fault = kind("oe", &keys).unwrap().form(&inputs, "y", &[]).unwrap_err().to_string();
    assert!(fault.contains("no channel `c`") && fault.contains("a, b"), "{fault}");
    assert!(kind("armaxx", &toml::Table::new()).err().unwrap().to_string().contains("`armax`"));
}
