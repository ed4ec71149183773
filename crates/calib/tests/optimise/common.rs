//! What the tests of the optimisation share.

use dynocal_calib::optimise::program::Program;
use dynocal_calib::problem::CalibrationProblem;
use dynocal_files::csv_io;
use dynocal_ident::data::{Channel, Dataset, Role};
use dynocal_ident::model::literature;
use dynocal_ident::model::poly::PolyNarx;
use dynocal_numerics::nlp::SparseNlp;
use dynocal_numerics::rng::Rng64;
use std::path::Path;

/// A problem without faults.
pub(crate) fn problem(text: &str) -> CalibrationProblem {
    let problem: CalibrationProblem = toml::from_str(text).expect("problem");
    let mut faults = dynocal_files::spec::Faults::default();
    problem.check("", &mut faults);
    assert!(faults.is_empty(), "{faults:?}");
    problem
}

pub(crate) fn channel(name: &str, unit: &str, role: Role, values: Vec<f64>) -> Channel {
    Channel { name: name.into(), unit: unit.into(), role, values }
}

/// An engine record of `n` samples, sampled every 0.03 s.
pub(crate) fn record(n: usize, rng: &mut Rng64) -> Dataset {
    let mut about = |level: f64, spread: f64| -> Vec<f64> {
        (0..n).map(|_| level + spread * rng.uniform_in(-1.0, 1.0)).collect()
    };
    let channels = vec![
        channel("inj", "mg", Role::Input, about(12.0, 1.0)),
        channel("spark", "deg", Role::Input, about(15.0, 0.2)),
        channel("throttle", "deg", Role::Input, about(12.0, 1.0)),
        channel("speed", "rpm", Role::Input, about(2000.0, 100.0)),
        channel("torque", "Nm", Role::Output, about(40.0, 5.0)),
        channel("lambda", "-", Role::Output, about(1.0, 0.05)),
    ];
    let (name, origin) = ("record".into(), "test".into());
    Dataset { name, sample_time_s: 0.03, channels, init_samples: 0, origin }
}

/// Central differences of objective, constraints and Lagrangian gradient at a random point.
pub(crate) fn agrees_with_differences(p: &mut Program) {
    let (n, m) = (p.n(), p.m());
    let mut rng = Rng64::new(9);
    let mut x = vec![0.0; n];
    p.start(&mut x);
    x.iter_mut().for_each(|v| *v += 0.1 * rng.normal() * v.abs().max(0.1));
    let multipliers: Vec<f64> = (0..m).map(|_| rng.normal()).collect();
    let structure = p.jacobian_structure();
    let lagrangian_gradient = |p: &mut Program, x: &[f64]| -> Vec<f64> {
        let (mut g, mut j) = (vec![0.0; n], vec![0.0; structure.len()]);
        p.gradient(x, &mut g);
        p.jacobian(x, &mut j);
        for ((r, c), v) in structure.iter().zip(&j) {
            g[*c] += multipliers[*r] * v;
        }
        g
    };
    let lagrangian = |p: &mut Program, x: &[f64]| -> f64 {
        let mut c = vec![0.0; m];
        p.constraints(x, &mut c);
        p.objective(x) + c.iter().zip(&multipliers).map(|(a, b)| a * b).sum::<f64>()
    };
    let exact = lagrangian_gradient(p, &x);
    let at = p.hessian_structure();
    let mut values = vec![0.0; at.len()];
    p.hessian(&x, 1.0, &multipliers, &mut values);
    let mut hessian = vec![0.0; n * n];
    for (&(r, c), v) in at.iter().zip(&values) {
        assert!(r >= c, "lower triangle only");
        hessian[r * n + c] += v;
        if r != c {
            hessian[c * n + r] += v;
        }
    }
    for k in 0..n {
        let h = 1e-5 * x[k].abs().max(0.1);
        let moved = |by: f64| {
            let mut y = x.clone();
            y[k] += by;
            y
        };
        let (up, down) = (moved(h), moved(-h));
        let slope = (lagrangian(p, &up) - lagrangian(p, &down)) / (2.0 * h);
        let size = exact[k].abs().max(1.0);
        assert!((slope - exact[k]).abs() < 2e-6 * size, "gradient {k}: {slope} {}", exact[k]);
        let (a, b) = (lagrangian_gradient(p, &up), lagrangian_gradient(p, &down));
        for i in 0..n {
            let second = (a[i] - b[i]) / (2.0 * h);
            let got = hessian[i * n + k];
            assert!((second - got).abs() < 2e-6 * got.abs().max(1.0), "Hessian {i} {k}: {second} {got}");
        }
    }
}

fn column(path: &Path) -> Vec<f64> {
    let text = std::fs::read_to_string(path).expect("reference file");
    text.lines().filter_map(|l| l.trim().parse().ok()).collect()
}

/// `engine_opt.csv` with the names of the thesis' problem.
pub(crate) fn engine_record(dir: &Path) -> Dataset {
    let table = csv_io::read(&dir.join("reference/estimation_inputs/engine_opt.csv")).expect("record");
    let get = |name: &str, from: &str, unit: &str, role| {
        channel(name, unit, role, table.numbers(from, 0, table.rows()).expect("numbers").to_vec())
    };
    let channels = vec![
        get("inj", "INJ_mg", "mg", Role::Input),
        get("spark", "SA_deg", "deg", Role::Input),
        get("throttle", "theta_deg", "deg", Role::Input),
        get("speed", "N_rpm", "rpm", Role::Input),
        get("torque", "T_Nm", "Nm", Role::Output),
        get("lambda", "lambda", "-", Role::Output),
    ];
    let (name, origin) = ("engine_opt".into(), "reference".into());
    Dataset { name, sample_time_s: 0.03, channels, init_samples: 0, origin }
}

/// Torque and lambda polynomials (7.8) with the reference's parameters.
pub(crate) fn polynomial(dir: &Path) -> ((PolyNarx, Vec<f64>), (PolyNarx, Vec<f64>)) {
    // The parameter files hold the output coefficient last.
    let reordered = |structure: PolyNarx, file: &str| {
        let values = column(&dir.join("reference/estimation_inputs").join(file));
        let output = format!("{}(t-1)", structure.output());
        let (last, mut others) = (values[values.len() - 1], values.iter());
        let texts = structure.regressor_texts();
        let theta = texts.iter().map(|n| if *n == output { last } else { *others.next().expect("value") });
        let theta = theta.collect();
        (structure, theta)
    };
    (
        reordered(literature::torque_7_8().model, "poly_T_sem.csv"),
        reordered(literature::lambda_7_8().model, "poly_lambda_sem.csv"),
    )
}
