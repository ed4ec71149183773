//! Information of models with a noise model: against differences, against an independent formula, against noise drawn.

use dynocal_design::channel::Channel;
use dynocal_design::criterion::criterion;
use dynocal_design::information::sensitivities;
use dynocal_design::noise_model::{LinearInformation, NarmaxInformation};
use dynocal_design::problem::{Convention, DesignProblem, Evaluator, Term};
use dynocal_design::search::{DesignOptions, design};
use dynocal_ident::model::linear::{InputOrders, LinearModel, PredictionErrors};
use dynocal_ident::model::narmax::Narmax;
use dynocal_ident::model::{Model, Run};
use dynocal_numerics::rng::Rng64;

const N: usize = 120;

/// Models of two inputs with stable parameters.
fn cases() -> Vec<(&'static str, LinearModel, Vec<f64>)> {
    let general = LinearModel {
        orders: vec![InputOrders { nb: 2, nf: 1, nk: 1 }, InputOrders { nb: 1, nf: 2, nk: 3 }],
        nc: 1,
        nd: 1,
        na: 1,
        ..LinearModel::oe(&["a", "b"], "y", 2, 2, 1)
    };
    // Parameters stand as A, B, C, D, F.
    let dynamics = [0.8, 0.3, -0.5, 0.2];
    vec![
        ("oe", LinearModel::oe(&["a", "b"], "y", 2, 2, 1), [&dynamics[..], &[-0.9, 0.2, -0.4, 0.1]].concat()),
        ("bj", boxed(), boxed_theta()),
        (
            "armax",
            LinearModel::armax(&["a", "b"], "y", 2, 2, 1, 1),
            [&[-1.1, 0.4], &dynamics[..], &[0.6]].concat(),
        ),
        ("general", general, vec![-0.5, 0.8, 0.3, -0.5, 0.4, -0.7, -0.6, -0.8, 0.3]),
    ]
}

/// Box-Jenkins with strongly coloured noise: a record is worth what it tells where the noise is weak.
fn boxed() -> LinearModel {
    LinearModel::bj(&["a", "b"], "y", 2, 1, 1, 2, 1)
}

fn boxed_theta() -> Vec<f64> {
    vec![0.8, 0.3, -0.5, 0.2, 0.7, -0.95, -1.2, 0.4, -0.6, 0.1]
}

/// Places of the parameters of A, B and F.
fn own_places(m: &LinearModel) -> Vec<usize> {
    let first = m.na + m.orders.iter().map(|o| o.nb).sum::<usize>();
    (0..m.n_params()).filter(|k| !(first..first + m.nc + m.nd).contains(k)).collect()
}

fn record(seed: u64) -> Vec<f64> {
    let mut g = Rng64::new(seed);
    (0..2 * N).map(|_| g.uniform_in(-1.0, 1.0)).collect()
}

fn close(what: &str, a: &[f64], b: &[f64], tolerance: f64) {
    assert_eq!(a.len(), b.len(), "{what}");
    let size = b.iter().fold(1e-12f64, |m, v| m.max(v.abs()));
    for (k, (x, y)) in a.iter().zip(b).enumerate() {
        assert!((x - y).abs() <= tolerance * size, "{what} {k}: {x} {y}");
    }
}

fn free_run(m: &LinearModel, theta: &[f64], u: &[f64]) -> Vec<f64> {
    let mut y = vec![0.0; N];
    m.simulate(theta, &Run { u, y: &[0.0; N], start: 0 }, &mut y);
    y
}

/// `-d eps / d theta` by central differences of the prediction errors of the noise-free output, none of our derivatives.
fn by_differences(m: &LinearModel, theta: &[f64], u: &[f64]) -> Vec<f64> {
    let y = free_run(m, theta, u);
    let own = own_places(m);
    let mut s = vec![0.0; N * own.len()];
    let errors = |theta: &[f64]| {
        let mut eps = vec![0.0; N];
        PredictionErrors::new(m, u, &y).errors(theta, &mut eps);
        eps
    };
    for (k, place) in own.iter().enumerate() {
        let mut moved = theta.to_vec();
        let h = 1e-6;
        moved[*place] = theta[*place] + h;
        let up = errors(&moved);
        moved[*place] = theta[*place] - h;
        let down = errors(&moved);
        (0..N).for_each(|t| s[t * own.len() + k] = -(up[t] - down[t]) / (2.0 * h));
    }
    s
}

/// The same as `H^-1 dG/dtheta u` with impulse responses: nothing but the transfer functions and convolutions.
fn by_convolution(m: &LinearModel, theta: &[f64], u: &[f64]) -> Vec<f64> {
    let own = own_places(m);
    let divide = |num: &[f64], den: &[f64]| -> Vec<f64> {
        let mut out = vec![0.0; N];
        for t in 0..N {
            let back: f64 = (1..den.len().min(t + 1)).map(|k| den[k] * out[t - k]).sum();
            out[t] = num.get(t).copied().unwrap_or(0.0) - back;
        }
        out
    };
    let convolve = |a: &[f64], b: &[f64]| -> Vec<f64> {
        (0..N).map(|t| (0..=t).map(|k| a[k] * b[t - k]).sum()).collect()
    };
    let product = |a: &[f64], b: &[f64]| -> Vec<f64> {
        let mut out = vec![0.0; a.len() + b.len() - 1];
        a.iter().enumerate().for_each(|(i, x)| b.iter().enumerate().for_each(|(j, y)| out[i + j] += x * y));
        out
    };
    let p = m.polynomials(theta);
    let whitening = divide(&product(&p.a, &p.d), &p.c);
    let response = |theta: &[f64]| -> Vec<f64> {
        let p = m.polynomials(theta);
        let mut y = vec![0.0; N];
        for i in 0..m.n_inputs() {
            let g = divide(&p.b[i], &product(&p.a, &p.f[i]));
            let x: Vec<f64> = u.iter().skip(i).step_by(m.n_inputs()).copied().collect();
            convolve(&g, &x).iter().zip(&mut y).for_each(|(v, y)| *y += v);
        }
        y
    };
    let mut s = vec![0.0; N * own.len()];
    for (k, place) in own.iter().enumerate() {
        let (mut up, mut down) = (theta.to_vec(), theta.to_vec());
        up[*place] += 1e-6;
        down[*place] -= 1e-6;
        let slope: Vec<f64> =
            response(&up).iter().zip(response(&down)).map(|(a, b)| (a - b) / 2e-6).collect();
        convolve(&whitening, &slope).iter().enumerate().for_each(|(t, v)| s[t * own.len() + k] = *v);
    }
    s
}

#[test]
fn sensitivities_equal_differences_and_convolutions() {
    for (name, m, theta) in cases() {
        let (information, own) = LinearInformation::new(&m, &theta).unwrap();
        assert_eq!(own.len(), own_places(&m).len(), "{name}");
        let u = record(3);
        let s = sensitivities(&information, &own, &u, 2, Convention::Zero, 0, 0.0).unwrap();
        close(&format!("{name} differences"), &s, &by_differences(&m, &theta, &u), 1e-8);
        close(&format!("{name} convolution"), &s, &by_convolution(&m, &theta, &u), 1e-8);
        // Predictions depend on the free run: the noise model is not in it.
        let free = sensitivities(&information.prediction(), &own, &u, 2, Convention::Zero, 0, 0.0).unwrap();
        let quiet = LinearModel { nc: 0, nd: 0, ..m.clone() };
        let places = own_places(&m);
        let run = |theta: &[f64]| {
            let theta: Vec<f64> = places.iter().map(|k| theta[*k]).collect();
            free_run(&quiet, &theta, &u)
        };
        let p = own.len();
        for (k, place) in places.iter().enumerate() {
            let (mut up, mut down) = (theta.clone(), theta.clone());
            up[*place] += 1e-6;
            down[*place] -= 1e-6;
            let slope: Vec<f64> = run(&up).iter().zip(run(&down)).map(|(a, b)| (a - b) / 2e-6).collect();
            let ours: Vec<f64> = free.iter().skip(k).step_by(p).copied().collect();
            close(&format!("{name} free run, parameter {k}"), &ours, &slope, 1e-7);
        }
    }
}

fn problem<'a>(term: Term<'a>) -> DesignProblem<'a> {
    let channels = ["a", "b"].map(|name| Channel::free(name, -1.0, 1.0)).to_vec();
    DesignProblem { channels, n_samples: N, convention: Convention::Zero, start: 0, terms: vec![term] }
}

/// Name, information, the model that predicts (where it is another), parameters.
type Case = (String, Box<dyn Model>, Option<Box<dyn Model>>, Vec<f64>);

#[test]
fn gradients_equal_differences() {
    let d = criterion("d", &Default::default()).unwrap();
    let i = criterion("i", &Default::default()).unwrap();
    let u0 = record(9);
    let texts = ["a(t-1)", "b(t-1)*y(t-1)", "y(t-1)", "a(t-2)^2", "e(t-1)"];
    let narmax = Narmax::parse(&["a", "b"], "y", &texts).unwrap();
    let (of_narmax, narmax_theta) = NarmaxInformation::new(&narmax, &[0.7, 0.2, 0.4, 0.3, -0.5]).unwrap();
    let mut all: Vec<Case> = vec![("narmax".into(), Box::new(of_narmax), None, narmax_theta)];
    for (name, m, theta) in cases() {
        let (information, own) = LinearInformation::new(&m, &theta).unwrap();
        let prediction: Box<dyn Model> = Box::new(information.prediction());
        all.push((name.into(), Box::new(information), Some(prediction), own));
    }
    for (name, model, predictor, theta) in &all {
        for c in [&d, &i] {
            for convention in [Convention::Zero, Convention::Hold, Convention::Trim] {
                let term = Term {
                    predictor: predictor.as_deref(),
                    objective_signal: &u0,
                    initial_output: 0.3,
                    ..Term::new("y", model.as_ref(), theta, 0.2, c.as_ref())
                };
                let p = DesignProblem { convention, ..problem(term) };
                let mut e = Evaluator::new(&p).unwrap();
                let (mut u, mut g) = (record(5), vec![0.0; 2 * N]);
                e.value_gradient(&u, 120.0, &mut g);
                let size = g.iter().fold(0.0f64, |m, v| m.max(v.abs()));
                for k in (0..2 * N).step_by(13) {
                    let before = u[k];
                    u[k] = before + 1e-5;
                    let up = e.value(&u);
                    u[k] = before - 1e-5;
                    let down = e.value(&u);
                    u[k] = before;
                    let difference = (up - down) / 2e-5;
                    assert!(
                        (difference - g[k]).abs() < 1e-6 * size.max(1.0),
                        "{name} {k}: {difference} {}",
                        g[k]
                    );
                }
            }
        }
    }
}

/// The prediction errors of a NARMAX model, written out for this one model.
#[test]
fn sensitivities_of_a_narmax_model_equal_differences() {
    let texts = ["a(t-1)", "b(t-1)*y(t-1)", "y(t-1)", "a(t-2)^2", "e(t-1)"];
    let m = Narmax::parse(&["a", "b"], "y", &texts).unwrap();
    let theta = [0.7, 0.2, 0.4, 0.3, -0.5];
    let (information, own) = NarmaxInformation::new(&m, &theta).unwrap();
    assert_eq!(own, theta[..4]);
    let u = record(4);
    let lag = 2;
    let f = |theta: &[f64], y: &[f64], t: usize| {
        let (a1, a2) = (u[2 * (t - 1)], u[2 * (t - 2)]);
        let b1 = u[2 * (t - 1) + 1];
        theta[0] * a1 + theta[1] * b1 * y[t - 1] + theta[2] * y[t - 1] + theta[3] * a2 * a2
    };
    let mut y = vec![0.1; N];
    (lag..N).for_each(|t| y[t] = f(&theta, &y, t));
    let errors = |theta: &[f64]| {
        let mut eps = vec![0.0; N];
        (lag..N).for_each(|t| eps[t] = y[t] - f(theta, &y, t) - theta[4] * eps[t - 1]);
        eps
    };
    let s = sensitivities(&information, &own, &u, 2, Convention::Trim, 0, 0.1).unwrap();
    for k in 0..4 {
        let (mut up, mut down) = (theta, theta);
        up[k] += 1e-6;
        down[k] -= 1e-6;
        let slope: Vec<f64> =
            errors(&up).iter().zip(errors(&down)).skip(lag).map(|(a, b)| -(a - b) / 2e-6).collect();
        let ours: Vec<f64> = s.iter().skip(k).step_by(4).copied().collect();
        close(&format!("parameter {k}"), &ours, &slope, 1e-8);
    }
    let product = Narmax::parse(&["a"], "y", &["a(t-1)", "a(t-1)*e(t-1)"]).unwrap();
    let refused = NarmaxInformation::new(&product, &[1.0, 0.1]).unwrap_err().to_string();
    assert!(refused.contains("a(t-1)*e(t-1)"), "{refused}");
}

/// `ln det` of the symmetric positive matrix `a` (p x p) by elimination.
fn log_det(mut a: Vec<f64>, p: usize) -> f64 {
    let mut sum = 0.0;
    for k in 0..p {
        sum += a[k * p + k].ln();
        for i in k + 1..p {
            let ratio = a[i * p + k] / a[k * p + k];
            (k..p).for_each(|j| a[i * p + j] -= ratio * a[k * p + j]);
        }
    }
    sum
}

fn gram(s: &[f64], p: usize) -> Vec<f64> {
    let mut g = vec![0.0; p * p];
    for row in s.chunks_exact(p) {
        for i in 0..p {
            (0..p).for_each(|j| g[i * p + j] += row[i] * row[j]);
        }
    }
    g
}

/// A design for coloured noise against 200 random records, judged by the prediction errors of the library of models. The
/// design for the response without its noise model loses against the best of them, which is why this is needed.
#[test]
fn a_box_jenkins_design_beats_the_best_of_200_random_records() {
    let (m, theta) = (boxed(), boxed_theta());
    let own = own_places(&m);
    let p = own.len();
    let judge = |u: &[f64]| {
        let y = free_run(&m, &theta, u);
        let (mut eps, mut jac) = (vec![0.0; N], vec![0.0; N * theta.len()]);
        assert!(PredictionErrors::new(&m, u, &y).jacobian(&theta, &mut eps, &mut jac));
        let rows: Vec<f64> = jac.chunks_exact(theta.len()).flat_map(|r| own.iter().map(|k| r[*k])).collect();
        log_det(gram(&rows, p), p)
    };
    let d = criterion("d", &Default::default()).unwrap();
    let (information, own_theta) = LinearInformation::new(&m, &theta).unwrap();
    let (response, expanded) = m.deterministic(&theta).unwrap();
    let options = DesignOptions { evaluations: 2000, starts: 2, ..Default::default() };
    let of = |model: &dyn Model, theta: &[f64]| {
        let found =
            design(&problem(Term::new("y", model, theta, 1.0, d.as_ref())), &options, &|| false, &|_| {});
        judge(&found.unwrap().u)
    };
    let (right, wrong) = (of(&information, &own_theta), of(&response, &expanded));
    let mut g = Rng64::new(11);
    let random = (0..200).map(|k| {
        // Uniform values and steps of five levels, held for one to eight samples.
        let hold = 1 + k % 8;
        let mut value = |k: usize| {
            if k.is_multiple_of(2) { g.uniform_in(-1.0, 1.0) } else { g.below(5) as f64 / 2.0 - 1.0 }
        };
        let blocks: Vec<f64> = (0..2 * N.div_ceil(hold)).map(|_| value(k)).collect();
        let u: Vec<f64> = (0..N).flat_map(|t| [blocks[t / hold * 2], blocks[t / hold * 2 + 1]]).collect();
        judge(&u)
    });
    let best = random.fold(f64::NEG_INFINITY, f64::max);
    let efficiency = |v: f64| 100.0 * ((v - right) / p as f64).exp();
    println!(
        "best random {:.1} %, design without the noise model {:.1} %",
        efficiency(best),
        efficiency(wrong)
    );
    assert!(right > best + 0.1 * p as f64, "{right} {best}");
    assert!(right > wrong);
}

/// Information about A, B of an ARMAX model from many noisy records against what is said of one.
#[test]
fn what_the_noise_tells_is_what_noisy_records_tell() {
    let (_, m, theta) = cases().remove(2);
    let (information, own) = LinearInformation::new(&m, &theta).unwrap();
    let (p, q) = (own.len(), theta.len());
    let sigma = 0.7;
    let u = record(8);
    let mut rows = sensitivities(&information, &own, &u, 2, Convention::Zero, 0, 0.0).unwrap();
    rows.extend(information.noise_rows(&own, N, sigma * sigma).unwrap());
    let said = gram(&rows, p);
    let mut g = Rng64::new(1);
    let records = 2000;
    let mut mean = vec![0.0; q * q];
    let polynomials = m.polynomials(&theta);
    for _ in 0..records {
        // A y = B u + C e with noise from long before the record.
        let before = 200;
        let e: Vec<f64> = (0..N + before).map(|_| sigma * g.normal()).collect();
        let mut v = vec![0.0; N + before];
        for t in 0..N + before {
            let ahead: f64 = polynomials.c.iter().enumerate().take(t + 1).map(|(k, c)| c * e[t - k]).sum();
            let back: f64 =
                polynomials.a.iter().enumerate().take(t + 1).skip(1).map(|(k, a)| a * v[t - k]).sum();
            v[t] = ahead - back;
        }
        let y = free_run(&m, &theta, &u);
        let y: Vec<f64> =
            v.iter().enumerate().map(|(t, v)| v + if t < before { 0.0 } else { y[t - before] }).collect();
        let long: Vec<f64> = vec![0.0; 2 * before].into_iter().chain(u.iter().copied()).collect();
        let (mut eps, mut jac) = (vec![0.0; N + before], vec![0.0; (N + before) * q]);
        assert!(PredictionErrors::new(&m, &long, &y).jacobian(&theta, &mut eps, &mut jac));
        let found = gram(&jac[before * q..], q);
        mean.iter_mut().zip(found).for_each(|(m, v)| *m += v / records as f64);
    }
    // The parameter of C eliminated.
    let places = own_places(&m);
    let c = (0..q).find(|k| !places.contains(k)).unwrap();
    let left = |i: usize, j: usize| mean[i * q + j] - mean[i * q + c] * mean[c * q + j] / mean[c * q + c];
    for (i, a) in places.iter().enumerate() {
        for (j, b) in places.iter().enumerate() {
            // The mean of 2000 records of 120 samples scatters by less than 1 % of the diagonal.
            let size = (said[i * p + i] * said[j * p + j]).sqrt();
            assert!(
                (said[i * p + j] - left(*a, *b)).abs() < 0.03 * size,
                "{i} {j}: {} {}",
                said[i * p + j],
                left(*a, *b)
            );
        }
    }
}
