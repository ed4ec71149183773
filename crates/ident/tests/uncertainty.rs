//! Stated against observed accuracy over many draws of the noise: white and coloured errors, free run and one step,
//! squares and Huber's cost; bands of predictions. The spread of n draws is itself known to `1/sqrt(2n)`.

use dynocal_ident::estimate::bands::band;
use dynocal_ident::estimate::cost::CostKind;
use dynocal_ident::estimate::ols::Ols;
use dynocal_ident::estimate::sem::Sem;
use dynocal_ident::estimate::{CovarianceChoice, CovarianceKind, Estimator, Fit, Minimised};
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::model::{Model, Run};
use dynocal_numerics::rng::Rng64;

const DRAWS: usize = 400;

/// White noise through `1 / (1 - a q^-1)`, of the standard deviation given.
fn coloured(n: usize, a: f64, std: f64, rng: &mut Rng64) -> Vec<f64> {
    let drive = std * (1.0 - a * a).sqrt();
    let mut e = vec![std * rng.normal(); n];
    (1..n).for_each(|t| e[t] = a * e[t - 1] + drive * rng.normal());
    e
}

/// Inputs that are held for some samples: their regressors are correlated over time, as in a test on the bed.
fn held(n: usize, hold: usize, seed: u64) -> Vec<f64> {
    let mut rng = Rng64::new(seed);
    let mut u = vec![0.0; n];
    for t in 0..n {
        u[t] = if t % hold == 0 { rng.uniform_in(-1.0, 1.0) } else { u[t - 1] };
    }
    u
}

/// What kind of noise a draw adds.
#[derive(Clone, Copy)]
enum Noise {
    /// To the output.
    Output { colour: f64 },
    /// To the recursion.
    Equation { colour: f64 },
    /// To the output; one sample in ten is ten times as noisy.
    Outliers,
}

struct Study {
    model: PolyNarx,
    truth: Vec<f64>,
    n: usize,
    std: f64,
}

impl Study {
    fn new(regressors: &[&str], truth: &[f64], n: usize, std: f64) -> Self {
        Self { model: PolyNarx::parse(&["u"], "y", regressors).unwrap(), truth: truth.to_vec(), n, std }
    }

    fn record(&self, noise: Noise, draw: usize) -> Experiment {
        let mut rng = Rng64::stream(11, draw as u64);
        let (u, zeros) = (held(self.n, 5, 3), vec![0.0; self.n]);
        let mut y = vec![0.0; self.n];
        let start = self.model.max_lag();
        self.model.simulate(&self.truth, &Run { u: &u, y: &zeros, start }, &mut y);
        match noise {
            Noise::Output { colour } => {
                let e = coloured(self.n, colour, self.std, &mut rng);
                // The free run starts from measured values: without noise there, the theory is exact.
                (start..self.n).for_each(|t| y[t] += e[t]);
            }
            Noise::Outliers => {
                for v in &mut y[start..] {
                    *v += self.std * rng.normal() * if rng.uniform() < 0.1 { 10.0 } else { 1.0 };
                }
            }
            Noise::Equation { colour } => {
                let e = coloured(self.n, colour, self.std, &mut rng);
                let mut out = vec![0.0; start + 1];
                for t in start..self.n {
                    let window = t - start..t + 1;
                    let run = Run { u: &u[window.clone()], y: &y[window], start };
                    self.model.predict(&self.truth, &run, &mut out);
                    y[t] = out[start] + e[t];
                }
            }
        }
        Experiment { name: "draw".into(), u, y, init_samples: 0, weights: Vec::new() }
    }

    fn fits(&self, noise: Noise, estimator: &dyn Estimator) -> Vec<Fit> {
        (0..DRAWS)
            .map(|d| estimator.estimate(&self.model, &[self.record(noise, d)], None, &|| false).unwrap())
            .collect()
    }
}

/// Mean stated standard error over the observed spread about the mean, per parameter.
fn ratios(fits: &[Fit]) -> Vec<f64> {
    let n = fits.len() as f64;
    (0..fits[0].theta.len())
        .map(|k| {
            let mean = fits.iter().map(|f| f.theta[k]).sum::<f64>() / n;
            let variance = fits.iter().map(|f| (f.theta[k] - mean).powi(2)).sum::<f64>() / (n - 1.0);
            fits.iter().map(|f| f.std_errors[k]).sum::<f64>() / n / variance.sqrt()
        })
        .collect()
}

/// Four times the sampling error of a standard deviation from 400 draws: 14 %.
fn sampling_error(fits: &[Fit]) -> f64 {
    4.0 / (2.0 * fits.len() as f64).sqrt()
}

fn stated_is_observed(fits: &[Fit], what: &str) {
    let r = ratios(fits);
    println!("{what}: stated / observed {r:.3?}");
    assert!(r.iter().all(|r| (r - 1.0).abs() < sampling_error(fits)), "{what}: {r:.3?}");
}

/// Every stated error is too small, beyond what the draws leave open.
fn stated_is_too_small(fits: &[Fit], what: &str) {
    let r = ratios(fits);
    println!("{what}: stated / observed {r:.3?}");
    assert!(r.iter().all(|r| *r < 1.0 - sampling_error(fits)), "{what}: {r:.3?}");
}

fn share(fits: &[Fit], kind: CovarianceKind) -> f64 {
    fits.iter().filter(|f| f.covariance_kind == kind).count() as f64 / fits.len() as f64
}

fn output_error() -> Study {
    Study::new(&["1", "u(t-1)", "u(t-1)^2", "y(t-1)"], &[0.2, 1.0, -0.5, 0.7], 600, 0.3)
}

#[test]
fn white_output_noise_in_free_run() {
    let study = output_error();
    let fits = study.fits(Noise::Output { colour: 0.0 }, &Sem::default());
    stated_is_observed(&fits, "SEM, white");
    assert!(share(&fits, CovarianceKind::White) > 0.99);
    // Where nothing is correlated the sandwich says the same.
    let robust = Sem { covariance: CovarianceChoice::Robust, ..Sem::default() };
    stated_is_observed(&study.fits(Noise::Output { colour: 0.0 }, &robust), "SEM, white, sandwich");
}

/// Errors that last for ten samples: the white formula promises about half of the spread, the sandwich all of it.
#[test]
fn coloured_output_noise_in_free_run() {
    let study = output_error();
    let noise = Noise::Output { colour: 0.9 };
    let fits = study.fits(noise, &Sem::default());
    stated_is_observed(&fits, "SEM, coloured");
    assert!(share(&fits, CovarianceKind::Robust) > 0.99);
    assert!(fits.iter().all(|f| f.residuals.effective_samples < 0.15 * 600.0));
    let white = Sem { covariance: CovarianceChoice::White, ..Sem::default() };
    stated_is_too_small(&study.fits(noise, &white), "SEM, coloured, white formula");
}

#[test]
fn white_equation_noise_in_one_step() {
    let study = Study::new(&["1", "u(t-1)", "u(t-2)", "y(t-1)"], &[0.2, 1.0, 0.5, 0.7], 600, 0.3);
    let fits = study.fits(Noise::Equation { colour: 0.0 }, &Ols::default());
    stated_is_observed(&fits, "OLS, white");
    assert!(share(&fits, CovarianceKind::White) > 0.99);
}

/// Regressors of inputs alone, coloured noise: least squares stays unbiased, only its white formula is wrong.
#[test]
fn coloured_noise_on_regressors_of_inputs() {
    let study = Study::new(&["1", "u(t-1)", "u(t-3)", "u(t-1)^2"], &[0.2, 1.0, 0.5, -0.7], 600, 0.3);
    let noise = Noise::Output { colour: 0.8 };
    stated_is_observed(&study.fits(noise, &Ols::default()), "OLS of inputs, coloured");
    let white = Ols { covariance: CovarianceChoice::White, ..Ols::default() };
    stated_is_too_small(&study.fits(noise, &white), "OLS of inputs, coloured, white formula");
}

/// Regressors of outputs under coloured equation noise: estimates are biased, and the sandwich states their spread about
/// the biased mean.
#[test]
fn coloured_noise_on_regressors_of_outputs() {
    let mut study = Study::new(&["1", "u(t-1)", "y(t-1)"], &[0.2, 1.0, 0.7], 3000, 0.3);
    let noise = Noise::Equation { colour: 0.7 };
    study.n = 3000;
    stated_is_observed(&study.fits(noise, &Ols::default()), "OLS, coloured");
    let white = Ols { covariance: CovarianceChoice::White, ..Ols::default() };
    stated_is_too_small(&study.fits(noise, &white), "OLS, coloured, white formula");
}

/// Two inputs that differ by a millionth: with the difference as a parameter of its own the estimate is the same, and its
/// covariance follows by `Cov(T theta) = T Cov(theta) T'`. Formed as `(J'J)^-1 M (J'J)^-1` it lost all its digits there, and
/// standard errors came out as zero.
#[test]
fn nearly_equal_inputs_have_the_standard_errors_of_their_difference() {
    const CLOSE: f64 = 1e-6;
    let (n, mut rng) = (2000, Rng64::new(17));
    let (u, v) = (held(n, 5, 18), held(n, 9, 19));
    let noise = coloured(n, 0.8, 0.2, &mut rng);
    let mut y = vec![0.0; n];
    (1..n).for_each(|t| y[t] = u[t - 1] + 0.5 * v[t - 1] + noise[t]);
    let fit = |second: &dyn Fn(usize) -> f64| {
        let rows = (0..n).flat_map(|t| [u[t], second(t)]).collect();
        let e = Experiment { name: "two".into(), u: rows, y: y.clone(), init_samples: 0, weights: vec![] };
        let model = PolyNarx::parse(&["a", "b"], "y", &["a(t-1)", "b(t-1)"]).unwrap();
        let ols = Ols { covariance: CovarianceChoice::Robust, ..Ols::default() };
        ols.estimate(&model, &[e], None, &|| false).unwrap()
    };
    let apart = fit(&|t| v[t]);
    let close = fit(&|t| u[t] + CLOSE * v[t]);
    assert_eq!((close.rank, close.covariance_kind), (2, CovarianceKind::Robust));
    // The same output: b' = b / close, a' = a - b'.
    let c = &apart.covariance;
    let expected = [(c[0] - 2.0 * c[1] / CLOSE + c[3] / CLOSE.powi(2)).sqrt(), apart.std_errors[1] / CLOSE];
    for (found, expected) in close.std_errors.iter().zip(expected) {
        assert!((found / expected - 1.0).abs() < 1e-6, "{found} {expected}");
    }
}

#[test]
fn hubers_cost_states_its_accuracy_among_outliers() {
    let study = output_error();
    let huber = Sem { cost: CostKind::Huber, ..Sem::default() };
    let fits = study.fits(Noise::Outliers, &huber);
    stated_is_observed(&fits, "SEM, Huber, outliers");
    let squared = study.fits(Noise::Outliers, &Sem::default());
    let spread = |fits: &[Fit], k: usize| {
        let mean = fits.iter().map(|f| f.theta[k]).sum::<f64>() / fits.len() as f64;
        (fits.iter().map(|f| (f.theta[k] - mean).powi(2)).sum::<f64>() / fits.len() as f64).sqrt()
    };
    for k in 0..4 {
        let gain = spread(&squared, k) / spread(&fits, k);
        assert!(gain > 1.5, "parameter {k}: squares only {gain} times as wide");
    }
}

/// Bands at 95 %: of the model for the noise-free output, of the measurement for a new one. Errors along one record hang
/// together, so that 400 draws count as about 400 samples (1.1 %) and not more.
#[test]
fn bands_hold_what_they_promise() {
    let study = output_error();
    let mut rng = Rng64::new(5);
    let clean = |e: &Experiment| {
        let mut y = vec![0.0; e.len()];
        study.model.simulate(&study.truth, &e.run(&study.model), &mut y);
        y
    };
    let u = held(200, 7, 99);
    let other = Experiment { name: "new".into(), u, y: vec![0.0; 200], init_samples: 0, weights: Vec::new() };
    let truth = clean(&other);
    let (mut model_hits, mut measured_hits, mut total) = (0usize, 0usize, 0usize);
    for d in 0..DRAWS {
        let data = [study.record(Noise::Output { colour: 0.0 }, d)];
        let fit = Sem::default().estimate(&study.model, &data, None, &|| false).unwrap();
        let b = band(&study.model, &fit, &data, &other, Minimised::FreeRun);
        let ((low, high), (below, above)) = (b.of_model(0.95), b.of_measurement(0.95));
        for t in b.start..200 {
            model_hits += usize::from(low[t] <= truth[t] && truth[t] <= high[t]);
            let measured = truth[t] + study.std * rng.normal();
            measured_hits += usize::from(below[t] <= measured && measured <= above[t]);
            total += 1;
        }
    }
    let (model, measured) = (model_hits as f64 / total as f64, measured_hits as f64 / total as f64);
    println!("inside of the band of the model {model:.4}, of the measurement {measured:.4}");
    assert!((model - 0.95).abs() < 0.035 && (measured - 0.95).abs() < 0.006, "{model} {measured}");
}

/// One step and free run of the same fit have bands of their own kind; measured values before the start have no spread.
#[test]
fn bands_know_their_kind() {
    let study = Study::new(&["u(t-1)", "y(t-1)"], &[1.0, 0.9], 800, 0.3);
    let data = [study.record(Noise::Equation { colour: 0.0 }, 1)];
    let fit = Ols::default().estimate(&study.model, &data, None, &|| false).unwrap();
    let step = band(&study.model, &fit, &data, &data[0], Minimised::OneStep);
    let free = band(&study.model, &fit, &data, &data[0], Minimised::FreeRun);
    assert_eq!(step.noise_variance, fit.noise_variance);
    // var of a first-order process: s2 / (1 - 0.81) = 5.3 s2; 800 samples of it know that to some 20 %.
    let ratio = free.noise_variance / step.noise_variance;
    assert!(ratio > 3.0 && ratio < 8.5, "{ratio}");
    assert_eq!((step.std_model[0], step.y[0]), (0.0, data[0].y[0]));
    let (low, high) = step.of_measurement(0.95);
    let inside = (1..800).filter(|t| low[*t] <= data[0].y[*t] && data[0].y[*t] <= high[*t]).count();
    assert!((inside as f64 / 799.0 - 0.95).abs() < 0.03, "{inside}");
}
