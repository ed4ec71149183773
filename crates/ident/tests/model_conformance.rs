//! What every model structure must do: exact derivatives and one meaning of free run and prediction.

use std::sync::Arc;

use dynocal_ident::model::form::Form;
use dynocal_ident::model::kinds::MODEL_KINDS;
use dynocal_ident::model::neural::{MeanOfNetworks, NeuralNarx};
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::model::{Model, Run, literature};
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::status::Status;

const N: usize = 150;

struct Case {
    name: String,
    form: Arc<dyn Form>,
    theta: Vec<f64>,
    u: Vec<f64>,
    y0: Vec<f64>,
}

impl Case {
    fn model(&self) -> &dyn Model {
        let mean = || self.form.is_a::<MeanOfNetworks>().map(|m| m as &dyn Model);
        self.form.dynamics().or_else(mean).unwrap()
    }

    fn run(&self) -> Run<'_> {
        Run { u: &self.u, y: &self.y0, start: self.model().max_lag() }
    }
}

/// Every row of the table with channels that suit it, and one structure with all that a polynomial can hold.
fn cases() -> Vec<Case> {
    let mut cases = Vec::new();
    let rows = MODEL_KINDS
        .iter()
        .filter(|m| m.form.narx)
        .flat_map(|m| variants(m.doc.name).into_iter().map(move |keys| (m, keys)));
    for (i, (member, keys)) in rows.enumerate() {
        let inputs: Vec<String> = ["a", "b", "c", "d"].iter().map(|s| s.to_string()).collect();
        let form = (member.build)(&keys).unwrap().form(&inputs, "y", &[]).unwrap();
        let model = form.dynamics().unwrap();
        let mut rng = Rng64::stream(11, i as u64);
        let u: Vec<f64> = (0..N * 4).map(|_| rng.uniform_in(-1.0, 1.0)).collect();
        let y0: Vec<f64> = (0..N).map(|_| rng.uniform_in(-0.5, 0.5)).collect();
        // Small parameters keep every structure stable on inputs in [-1, 1].
        let p = model.n_params() as f64;
        let theta = (0..model.n_params()).map(|_| rng.uniform_in(-0.9, 0.9) / p.sqrt()).collect();
        let name = format!("{} {keys}", member.doc.name);
        cases.push(Case { name, form, theta, u, y0 });
    }
    cases.push(functions());
    cases.push(mean_of_networks());
    cases
}

/// Three networks of one layout with parameters of their own.
fn mean_of_networks() -> Case {
    let net = NeuralNarx::new(&["a", "b", "c", "d"], "y", 3, 2, 2).unwrap();
    let net = net.with_ranges(&[[-1.0, 2.0], [-0.5, 0.5], [-1.0, 1.0], [-2.0, 1.0]], [-3.0, 1.0]).unwrap();
    let form = MeanOfNetworks::new(net, 3).unwrap();
    let mut rng = Rng64::stream(13, 0);
    let mut draw = |n: usize, half: f64| (0..n).map(|_| rng.uniform_in(-half, half)).collect::<Vec<f64>>();
    let (u, y0, theta) = (draw(N * 4, 1.0), draw(N, 0.5), draw(form.n_params(), 0.3));
    Case { name: "mean of networks".into(), form: Arc::new(form), theta, u, y0 }
}

/// Functions of inputs, of outputs and of both, alone and in products. The kinks of `abs` and `pos` lie outside of
/// what the signals reach, where central differences would average over them.
fn functions() -> Case {
    let texts = [
        "y(t-1)",
        "sqrt(a(t) + 2)",
        "tanh(3*y(t-1) - 3*y(t-2) + a(t-1))",
        "b(t-1)^2*abs(y(t-1) + 0.25*c(t-2) + 5)^2",
        "y(t-3)*pos(4 - a(t-1) - y(t-1))*sqrt(3 + y(t-2))",
        "sin(2*b(t))*cos(c(t-1) - y(t-4))*y(t-1)^2",
        "exp(-1.5*d(t-2))",
    ];
    let model = PolyNarx::parse(&["a", "b", "c", "d"], "y", &texts).unwrap();
    let mut rng = Rng64::stream(12, 0);
    let mut draw = |n: usize, half: f64| (0..n).map(|_| rng.uniform_in(-half, half)).collect::<Vec<f64>>();
    let (u, y0) = (draw(N * 4, 1.0), draw(N, 0.5));
    let theta = vec![0.4, 0.2, 0.15, 0.004, 0.02, 0.2, 0.05];
    Case { name: "functions".into(), form: Arc::new(model), theta, u, y0 }
}

/// Keys under which a structure is tried.
fn variants(name: &str) -> Vec<toml::Table> {
    let texts: &[&str] = match name {
        "polynomial" => &[
            "regressors = ['1', 'a(t)^3*b(t-2)', 'a(t-1)*y(t-1)^2', 'y(t-1)*y(t-3)^2*c(t-1)', 'y(t-2)^3', 'c(t-3)']",
        ],
        "poly_arx" => &["degree = 3\noutput_products = true"],
        // Two output lags and ranges that are not [-1, 1], so that no scale can be forgotten.
        "neural" => &[
            "hidden = 4\noutput_lags = 2\nranges = { a = [-1.0, 2.0], b = [-0.5, 0.5], y = [-3.0, 1.0] }",
            "hidden = [4, 3]\ninput_lags = 2\noutput_lags = 3\ndirect = true\nactivation = 'sigmoid'
             lags = { a = [0, 1], c = [3, 4], d = [1, 0] }\nranges = { d = [0.0, 3.0], y = [-1.0, 2.0] }",
            "hidden = [3, 2, 3]\ninput_lags = 1\noutput_lags = 2\nactivation = 'softplus'\nranges = { y = [-2.0, 1.0] }",
            "hidden = 5\ninput_lags = 1\noutput_lags = 0\ndirect = true",
        ],
        _ => &[""],
    };
    texts.iter().map(|text| text.parse().unwrap()).collect()
}

fn close(a: f64, b: f64, relative: f64, scale: f64, what: &str) {
    assert!((a - b).abs() <= relative * (scale + a.abs().max(b.abs())), "{what}: {a} against {b}");
}

#[test]
fn sensitivities_agree_with_central_differences() {
    for c in cases() {
        let (p, run) = (c.model().n_params(), c.run());
        let (mut y, mut s) = (vec![0.0; N], vec![0.0; N * p]);
        assert_eq!(c.model().sensitivities(&c.theta, &run, &mut y, &mut s), Status::Converged, "{}", c.name);
        let mut free = vec![0.0; N];
        c.model().simulate(&c.theta, &run, &mut free);
        assert_eq!(y, free, "{}: sensitivities must see the free run", c.name);
        assert!(s[..run.start * p].iter().all(|v| *v == 0.0), "{}", c.name);
        let (mut up, mut down) = (vec![0.0; N], vec![0.0; N]);
        for k in 0..p {
            let h = 1e-6;
            let mut theta = c.theta.clone();
            theta[k] += h;
            c.model().simulate(&theta, &run, &mut up);
            theta[k] -= 2.0 * h;
            c.model().simulate(&theta, &run, &mut down);
            for t in 0..N {
                close(
                    s[t * p + k],
                    (up[t] - down[t]) / (2.0 * h),
                    1e-7,
                    1.0,
                    &format!("{} s_{k}({t})", c.name),
                );
            }
        }
    }
}

/// Block by block, whatever their length, and also where the structure has no path of its own.
#[test]
fn blocks_are_the_rows_of_the_sensitivities() {
    for c in cases() {
        let (p, run) = (c.model().n_params(), c.run());
        let (mut y, mut s) = (vec![0.0; N], vec![0.0; N * p]);
        c.model().sensitivities(&c.theta, &run, &mut y, &mut s);
        for rows in [1, 7, 64, 2 * N] {
            let (mut next, mut buffer) = (run.start, vec![0.0; N]);
            let status =
                c.model().sensitivity_blocks(&c.theta, &run, rows, &mut buffer, &mut |t, outputs, block| {
                    assert_eq!(t, next, "{}", c.name);
                    assert_eq!(outputs, &y[t..t + outputs.len()], "{} {rows}", c.name);
                    assert_eq!(block, &s[t * p..(t + outputs.len()) * p], "{} {rows}", c.name);
                    next += outputs.len();
                });
            assert_eq!((status, next), (Status::Converged, N), "{}", c.name);
        }
    }
}

#[test]
fn one_step_jacobian_agrees_with_central_differences() {
    for c in cases() {
        let (p, run) = (c.model().n_params(), c.run());
        let mut s = vec![1.0; N * p];
        c.model().one_step_jacobian(&c.theta, &run, &mut s);
        let (mut up, mut down) = (vec![0.0; N], vec![0.0; N]);
        for k in 0..p {
            let h = 1e-5;
            let mut theta = c.theta.clone();
            theta[k] += h;
            c.model().predict(&theta, &run, &mut up);
            theta[k] -= 2.0 * h;
            c.model().predict(&theta, &run, &mut down);
            for t in 0..N {
                close(s[t * p + k], (up[t] - down[t]) / (2.0 * h), 1e-8, 1.0, &format!("{} {k} {t}", c.name));
            }
        }
    }
}

/// d/de of y_bar'y + s_bar'S along a direction in u equals u_bar'direction.
#[test]
fn adjoint_is_the_transpose_of_the_input_derivative() {
    for (i, c) in cases().into_iter().enumerate() {
        let (p, m, run) = (c.model().n_params(), c.model().n_inputs(), c.run());
        let mut rng = Rng64::stream(5, i as u64);
        let mut draw = |n: usize| -> Vec<f64> { (0..n).map(|_| rng.uniform_in(-1.0, 1.0)).collect() };
        let (y_bar, s_bar, direction) = (draw(N), draw(N * p), draw(N * m));
        let functional = |u: &[f64], with_s: bool| -> f64 {
            let (mut y, mut s) = (vec![0.0; N], vec![0.0; N * p]);
            c.model().sensitivities(&c.theta, &Run { u, ..run }, &mut y, &mut s);
            let rows = run.start..N;
            let first: f64 = rows.map(|t| y_bar[t] * y[t]).sum();
            let second: f64 = (run.start * p..N * p).map(|j| s_bar[j] * s[j]).sum();
            if with_s { first + second } else { first }
        };
        let (mut y, mut s) = (vec![0.0; N], vec![0.0; N * p]);
        c.model().sensitivities(&c.theta, &run, &mut y, &mut s);
        for with_s in [true, false] {
            let h = 1e-5;
            let moved = |h: f64| -> Vec<f64> { c.u.iter().zip(&direction).map(|(u, d)| u + h * d).collect() };
            let difference = (functional(&moved(h), with_s) - functional(&moved(-h), with_s)) / (2.0 * h);
            let mut u_bar = vec![0.0; N * m];
            let (s, s_bar) = if with_s { (&s[..], &s_bar[..]) } else { (&[][..], &[][..]) };
            c.model().sensitivity_adjoint(&c.theta, &run, &y, s, &y_bar, s_bar, &mut u_bar);
            let product: f64 = u_bar.iter().zip(&direction).map(|(a, b)| a * b).sum();
            close(product, difference, 1e-7, 1.0, &format!("{} with_s {with_s}", c.name));
        }
    }
}

/// Each input alone, so that no error can hide in a sum.
#[test]
fn adjoint_of_single_samples_agrees_with_central_differences() {
    for c in cases() {
        let (p, m, run) = (c.model().n_params(), c.model().n_inputs(), c.run());
        let (mut y, mut s) = (vec![0.0; N], vec![0.0; N * p]);
        c.model().sensitivities(&c.theta, &run, &mut y, &mut s);
        let weight = |j: usize| ((j % 7) as f64 - 3.0) / 3.0;
        let y_bar: Vec<f64> = (0..N).map(weight).collect();
        let s_bar: Vec<f64> = (0..N * p).map(weight).collect();
        let mut u_bar = vec![0.0; N * m];
        c.model().sensitivity_adjoint(&c.theta, &run, &y, &s, &y_bar, &s_bar, &mut u_bar);
        for place in [run.start * m, run.start * m + 1, 40 * m + 2, 100 * m + 1, (N - 2) * m] {
            let functional = |h: f64| -> f64 {
                let mut u = c.u.clone();
                u[place] += h;
                let (mut y, mut s) = (vec![0.0; N], vec![0.0; N * p]);
                c.model().sensitivities(&c.theta, &Run { u: &u, ..run }, &mut y, &mut s);
                let first: f64 = (run.start..N).map(|t| y_bar[t] * y[t]).sum();
                first + (run.start * p..N * p).map(|j| s_bar[j] * s[j]).sum::<f64>()
            };
            let difference = (functional(1e-5) - functional(-1e-5)) / 2e-5;
            close(u_bar[place], difference, 1e-7, 1.0, &format!("{} u[{place}]", c.name));
        }
    }
}

#[test]
fn free_run_equals_prediction_on_its_own_output() {
    for c in cases() {
        let run = c.run();
        let (mut y, mut yhat) = (vec![0.0; N], vec![0.0; N]);
        c.model().simulate(&c.theta, &run, &mut y);
        c.model().predict(&c.theta, &Run { y: &y, ..run }, &mut yhat);
        // What does not go on from its last outputs says so.
        assert_eq!(y == yhat, c.form.goes_on_from_outputs(), "{}", c.name);
        let mut again = vec![0.0; N];
        c.model().simulate(&c.theta, &run, &mut again);
        assert_eq!(y, again, "{}: same input, same bytes", c.name);
    }
}

#[test]
fn window_derivatives_agree_with_prediction_and_differences() {
    for c in cases() {
        let (m, run, w) = (c.model().n_inputs(), c.run(), c.model().window().len());
        let mut yhat = vec![0.0; N];
        c.model().predict(&c.theta, &run, &mut yhat);
        let (mut grad, mut hess) = (vec![0.0; w], vec![0.0; w * w]);
        let (mut up, mut down, mut unused) = (vec![0.0; w], vec![0.0; w], vec![0.0; w * w]);
        for t in [run.start, 77, N - 1] {
            let value = c.model().window_derivatives(&c.theta, &run, t, &mut grad, &mut hess);
            close(value, yhat[t], 1e-13, 1.0, &c.name);
            for (a, &(input, lag)) in c.model().window().iter().enumerate() {
                let h = 1e-5;
                let mut u = c.u.clone();
                u[(t - lag) * m + input] += h;
                let plus =
                    c.model().window_derivatives(&c.theta, &Run { u: &u, ..run }, t, &mut up, &mut unused);
                u[(t - lag) * m + input] -= 2.0 * h;
                let minus =
                    c.model().window_derivatives(&c.theta, &Run { u: &u, ..run }, t, &mut down, &mut unused);
                close(grad[a], (plus - minus) / (2.0 * h), 1e-8, 1.0, &format!("{} grad {a}", c.name));
                for b in 0..w {
                    let difference = (up[b] - down[b]) / (2.0 * h);
                    close(hess[a * w + b], difference, 1e-8, 1.0, &format!("{} hess {a} {b}", c.name));
                }
            }
        }
    }
}

/// Gradient and Hessian over inputs and past outputs: the parts over inputs are those of the window, the rest agrees with
/// differences.
#[test]
fn joint_derivatives_agree_with_prediction_and_differences() {
    for c in cases() {
        let (m, run, w, l) =
            (c.model().n_inputs(), c.run(), c.model().window().len(), c.model().output_lag());
        let n = w + l;
        let mut yhat = vec![0.0; N];
        c.model().predict(&c.theta, &run, &mut yhat);
        let (mut grad, mut hess) = (vec![0.0; n], vec![0.0; n * n]);
        let (mut up, mut down, mut unused) = (vec![0.0; n], vec![0.0; n], vec![0.0; n * n]);
        for t in [run.start, 77, N - 1] {
            let value = c.model().joint_derivatives(&c.theta, &run, t, &mut grad, &mut hess);
            close(value, yhat[t], 1e-13, 1.0, &c.name);
            for a in 0..n {
                let h = 1e-5;
                let mut moved = |by: f64, g: &mut [f64]| {
                    let (mut u, mut y) = (c.u.clone(), run.y.to_vec());
                    match c.model().window().get(a) {
                        Some(&(input, lag)) => u[(t - lag) * m + input] += by,
                        None => y[t - (a - w + 1)] += by,
                    }
                    c.model().joint_derivatives(&c.theta, &Run { u: &u, y: &y, ..run }, t, g, &mut unused)
                };
                let (plus, minus) = (moved(h, &mut up), moved(-h, &mut down));
                close(grad[a], (plus - minus) / (2.0 * h), 1e-8, 1.0, &format!("{} grad {a}", c.name));
                for b in 0..n {
                    let difference = (up[b] - down[b]) / (2.0 * h);
                    close(hess[a * n + b], difference, 1e-8, 1.0, &format!("{} hess {a} {b}", c.name));
                }
            }
        }
    }
}

/// The thesis model written out by hand, another way round (per sample, from the equation).
#[test]
fn torque_4_17_is_the_printed_equation() {
    let lit = literature::torque_4_17();
    let mut rng = Rng64::new(3);
    let n = 100;
    let u: Vec<f64> = (0..n)
        .flat_map(|_| {
            [rng.uniform_in(2000.0, 6000.0), rng.uniform_in(0.4, 0.6), rng.uniform_in(1000.0, 2000.0)]
        })
        .collect();
    let (u1, u2, u3) = (|t: usize| u[t * 3], |t: usize| u[t * 3 + 1], |t: usize| u[t * 3 + 2]);
    let th = &lit.theta;
    let mut expected = vec![0.0; n];
    for t in 10..n {
        expected[t] = th[0]
            + u1(t) * (th[1] + th[2] * u2(t - 10) + th[3] * u3(t) + th[4] * u3(t - 3) + th[21] * u1(t - 6))
            + u1(t - 10)
                * (th[5] * u2(t - 10) + th[6] * u3(t - 9) + th[7] * u1(t - 10) + th[13] + th[20] * u1(t - 6))
            + u2(t - 10) * (th[8] * u2(t - 10) + th[9] * u3(t - 9) + th[12] * u3(t) + th[16] * u3(t - 5))
            + u3(t) * (th[10] * u3(t) + th[14] * u3(t - 5))
            + u3(t - 2) * (th[11] * u3(t - 4) + th[17] * u3(t - 9) + th[18] * u3(t - 6))
            + th[15] * u3(t - 1) * u3(t - 10)
            + th[19] * u1(t - 6) * u2(t - 7)
            + th[22] * expected[t - 10];
    }
    let mut y = vec![0.0; n];
    lit.model.simulate(th, &Run { u: &u, y: &vec![0.0; n], start: 10 }, &mut y);
    for t in 0..n {
        close(y[t], expected[t], 1e-12, 100.0, &format!("y({t})"));
    }
}

/// A window too wide to be transposed takes the other path of the kernel and must give the same numbers.
#[test]
fn wide_windows_agree_with_a_direct_sum() {
    let inputs: Vec<String> = (0..30).map(|i| format!("u{i}")).collect();
    let model = PolyNarx::parse(&inputs, "y", &["u0(t-40)*u29(t)", "u7(t-3)", "y(t-1)"]).unwrap();
    let mut rng = Rng64::new(9);
    let n = 130;
    let u: Vec<f64> = (0..n * 30).map(|_| rng.normal()).collect();
    let theta = [0.3, -0.4, 0.5];
    let (mut y, mut s) = (vec![0.0; n], vec![0.0; n * 3]);
    let zeros = vec![0.0; n];
    model.sensitivities(&theta, &Run { u: &u, y: &zeros, start: 40 }, &mut y, &mut s);
    let mut expected = 0.0;
    for t in 40..n {
        let (a, b) = (u[(t - 40) * 30] * u[t * 30 + 29], u[(t - 3) * 30 + 7]);
        let s2 = expected + 0.5 * if t > 40 { s[(t - 1) * 3 + 2] } else { 0.0 };
        expected = 0.3 * a - 0.4 * b + 0.5 * expected;
        close(y[t], expected, 1e-14, 1.0, "y");
        close(s[t * 3 + 2], s2, 1e-13, 1.0, "dy/dtheta_3");
    }
}

#[test]
fn an_unstable_free_run_is_reported() {
    let model = PolyNarx::parse(&["u"], "y", &["u(t-1)", "y(t-1)^2"]).unwrap();
    let (u, y0) = (vec![1.0; 60], vec![0.0; 60]);
    let run = Run { u: &u, y: &y0, start: 1 };
    let (mut y, mut s) = (vec![0.0; 60], vec![0.0; 120]);
    assert_eq!(model.simulate(&[1.0, 2.0], &run, &mut y), Status::Diverged);
    assert!(y[59].is_nan() && y[1] == 1.0 && y[2] == 3.0);
    assert_eq!(model.sensitivities(&[1.0, 2.0], &run, &mut y, &mut s), Status::Diverged);
}
