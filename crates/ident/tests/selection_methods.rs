//! Every method of structure selection against Gram-Schmidt on stored columns and against explicit least squares.

#[path = "common/cubic.rs"]
mod cubic;

use cubic::{TRUE_TERMS, keys, pool, record};
use dynocal_ident::estimate::Estimator;
use dynocal_ident::estimate::ols::Ols;
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::Model;
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::select::forward::{Forward, Rank};
use dynocal_ident::select::frols::{Stop, frols};
use dynocal_ident::select::pool::{Pool, PoolKeys};
use dynocal_ident::select::{Action, Backward, Select, Selection, Simulation, Stepwise};
use dynocal_ident::validate::{Kind, Seen, score};
use dynocal_numerics::linalg::{axpy, dot, least_squares};
use dynocal_numerics::rng::Rng64;

/// Slow, offset channels: neighbouring lags and their products are nearly dependent.
fn slow(n: usize) -> Experiment {
    let mut rng = Rng64::new(3);
    let (mut level, mut y) = (0.0, vec![100.0; n]);
    let u: Vec<f64> = (0..n)
        .map(|_| {
            level += 0.05 * (rng.normal() - 0.1 * level);
            1500.0 + 100.0 * level
        })
        .collect();
    for t in 1..n {
        y[t] = 0.97 * y[t - 1] + 2e-6 * u[t - 1] * u[t - 1] - 1.5 + 0.01 * rng.normal();
    }
    Experiment { name: "slow".into(), u, y, init_samples: 0, weights: Vec::new() }
}

/// Weighted columns of the pool, one by one, and the weighted output.
fn stored(pool: &Pool, data: &[Experiment]) -> (Vec<Vec<f64>>, Vec<f64>) {
    let all: Vec<usize> = (0..pool.candidates().len()).collect();
    let model = pool.structure(&all).unwrap();
    let p = all.len();
    let (mut columns, mut y) = (vec![Vec::new(); p], Vec::new());
    for e in data {
        let mut rows = vec![0.0; e.len() * p];
        model.one_step_jacobian(&vec![0.0; p], &e.run(&model), &mut rows);
        for t in e.first(&model)..e.len() {
            let w = e.weights.get(t).copied().unwrap_or(1.0).sqrt();
            (0..p).for_each(|k| columns[k].push(w * rows[t * p + k]));
            y.push(w * e.y[t]);
        }
    }
    (columns, y)
}

/// Gram-Schmidt on the stored matrix, every column made orthogonal twice: (candidate, ERR, mean squared error).
fn gram_schmidt(pool: &Pool, data: &[Experiment], terms: usize) -> Vec<(usize, f64, f64)> {
    let (mut columns, mut y) = stored(pool, data);
    let (total, n) = (dot(&y, &y), y.len() as f64);
    let length: Vec<f64> = columns.iter().map(|c| dot(c, c)).collect();
    let mut taken: Vec<(usize, f64, f64)> = Vec::new();
    for _ in 0..terms {
        let gain = |k: usize| dot(&columns[k], &y).powi(2) / dot(&columns[k], &columns[k]);
        let free = |k: &usize| {
            taken.iter().all(|t| t.0 != *k) && dot(&columns[*k], &columns[*k]) > 1e-14 * length[*k]
        };
        let best = (0..columns.len()).filter(free).max_by(|&a, &b| gain(a).total_cmp(&gain(b))).unwrap();
        let q = columns[best].clone();
        let qq = dot(&q, &q);
        let g = dot(&q, &y) / qq;
        axpy(-g, &q, &mut y);
        for w in &mut columns {
            for _ in 0..2 {
                axpy(-dot(w, &q) / qq, &q, w);
            }
        }
        taken.push((best, g * g * qq / total, dot(&y, &y) / n));
    }
    taken
}

/// Lagged channels and functions of them up to degree 2.
fn functions() -> Pool {
    let variables = ["tanh(y(t-1))", "pos(u(t-2))"].map(String::from).to_vec();
    PoolKeys { variables, ..keys(2, 2, 2) }.pool(&["u".to_string()], "y").unwrap()
}

#[test]
fn columns_that_are_never_stored_give_the_answer_of_gram_schmidt_on_the_stored_matrix() {
    let mut weighted = record(700, 0.05, 2);
    let mut rng = Rng64::new(9);
    weighted.weights = (0..700).map(|_| rng.uniform_in(0.0, 2.0)).collect();
    let cases = [
        (pool(3, 3, 3), vec![record(900, 0.05, 1), record(400, 0.05, 4)], 15),
        (pool(2, 4, 2), vec![weighted], 12),
        (pool(3, 3, 3), vec![slow(1500)], 6),
        // Functions of lagged channels beside and within products.
        (functions(), vec![record(900, 0.05, 6)], 9),
        // Four factors, and a record that ends within a block of samples.
        (pool(2, 2, 4), vec![record(1029, 0.01, 5)], 10),
    ];
    for (pool, data, terms) in cases {
        let expected = gram_schmidt(&pool, &data, terms);
        let found = frols(pool, &data, Stop::Terms(terms)).unwrap();
        assert_eq!(found.path.len(), terms);
        for (s, (candidate, err, mse)) in found.path.iter().zip(&expected) {
            assert_eq!(s.candidate, *candidate, "{}", s.regressor);
            assert!((s.err - err).abs() <= 1e-10 * err, "{}: {} {err}", s.regressor, s.err);
            assert!((s.mse - mse).abs() <= 1e-10 * mse, "{}: {} {mse}", s.regressor, s.mse);
        }
    }
}

#[test]
fn a_large_pool_gives_the_true_structure_and_the_same_bytes_for_any_number_of_threads() {
    let (pool, data) = (pool(10, 10, 4), [record(4_000, 0.02, 8)]);
    assert_eq!(pool.candidates().len(), 10_626);
    let run = |threads: usize| -> Selection {
        let threads = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        threads.install(|| frols(pool.clone(), &data, Stop::Bic { max_terms: 8 }).unwrap())
    };
    let (one, three) = (run(1), run(3));
    assert_eq!(serde_json::to_string(&one).unwrap(), serde_json::to_string(&three).unwrap());
    let texts = one.model.regressor_texts();
    assert!(TRUE_TERMS.iter().all(|t| texts.contains(&t.to_string())), "{texts:?}");
}

/// Residual sum of squares, parameters and inverse Gram diagonal of some columns, by QR of the stored matrix.
fn explicit(columns: &[Vec<f64>], places: &[usize], y: &[f64]) -> f64 {
    let rows: Vec<f64> = (0..y.len()).flat_map(|t| places.iter().map(move |&k| columns[k][t])).collect();
    least_squares(&rows, y.len(), places.len(), y, 0.0).unwrap().residual_sum_squares
}

#[test]
fn every_number_of_the_path_equals_its_definition_on_explicit_fits() {
    let (pool, data) = (pool(2, 2, 2), [record(90, 0.1, 6)]);
    let (columns, y) = stored(&pool, &data);
    let n = y.len() as f64;
    let found = frols(pool.clone(), &data, Stop::Aic { max_terms: 6, rho: 3.0 }).unwrap();
    let close = |a: f64, b: f64| assert!((a - b).abs() <= 1e-9 * b.abs().max(1.0), "{a} {b}");
    let mut places = Vec::new();
    let mut before = dot(&y, &y);
    for (i, s) in found.path.iter().enumerate() {
        places.push(s.candidate);
        let k = places.len() as f64;
        let rss = explicit(&columns, &places, &y);
        assert_eq!((s.terms, s.action), (i + 1, Action::Entered));
        close(s.mse, rss / n);
        // eqs. (2.38), (2.40): F from the two fits.
        close(s.f, (before - rss) / (rss / (n - k)));
        close(s.fpe, n * (rss / n).ln() + n * ((n + k) / (n - k)).ln());
        close(s.aic, n * (rss / n).ln() + 3.0 * k);
        close(s.bic, n * (rss / n).ln() + k * n.ln());
        // Leave-one-out by leaving out.
        let press: f64 = (0..y.len())
            .map(|out| {
                let kept: Vec<usize> = (0..y.len()).filter(|t| *t != out).collect();
                let rows: Vec<f64> = kept
                    .iter()
                    .flat_map(|&t| places.iter().map(|&k| columns[k][t]).collect::<Vec<_>>())
                    .collect();
                let z: Vec<f64> = kept.iter().map(|&t| y[t]).collect();
                let theta = least_squares(&rows, kept.len(), places.len(), &z, 0.0).unwrap().x;
                let predicted: f64 = places.iter().zip(&theta).map(|(&k, a)| columns[k][out] * a).sum();
                (y[out] - predicted).powi(2)
            })
            .sum();
        close(s.press, press / n);
        before = rss;
    }
    let least = found.path.iter().map(|s| s.aic).fold(f64::INFINITY, f64::min);
    assert_eq!(found.path[found.steps - 1].aic, least);
    for stop in [Stop::Fpe { max_terms: 6 }, Stop::Press { max_terms: 6 }] {
        let other = frols(pool.clone(), &data, stop).unwrap();
        let value =
            |s: &dynocal_ident::select::Step| if matches!(stop, Stop::Fpe { .. }) { s.fpe } else { s.press };
        assert!(other.path.iter().all(|s| value(s) >= value(&other.path[other.steps - 1])));
    }
}

#[test]
fn forward_enters_by_correlation_until_f_is_too_small() {
    let (pool, data) = (pool(2, 2, 2), [record(300, 0.1, 7)]);
    let (columns, y) = stored(&pool, &data);
    let stop = Stop::F { max_terms: 15, f_to_enter: 6.6 };
    // Eq. (2.34) by hand for the first step after the constant.
    let centred = |v: &[f64]| {
        let mean = v.iter().sum::<f64>() / v.len() as f64;
        v.iter().map(|x| x - mean).collect::<Vec<f64>>()
    };
    let z = centred(&y);
    let correlation = |k: usize| {
        let x = centred(&columns[k]);
        (dot(&x, &z) / (dot(&x, &x) * dot(&z, &z)).sqrt()).abs()
    };
    let best = (1..columns.len()).max_by(|&a, &b| correlation(a).total_cmp(&correlation(b))).unwrap();
    for rank in [Rank::PartialF, Rank::Correlation] {
        let found = Forward { rank, stop }.select(&pool, &data, &|| false).unwrap();
        assert_eq!((found.path[0].regressor.as_str(), found.path[1].candidate), ("1", best));
        assert!(found.path[1..].iter().all(|s| s.f > 6.6));
        let places: Vec<usize> = found.path.iter().map(|s| s.candidate).collect();
        let rss = explicit(&columns, &places, &y);
        let s2 = |after: f64| after / (y.len() - places.len() - 1) as f64;
        let f = |k: usize| {
            let after = explicit(&columns, &[places.as_slice(), &[k]].concat(), &y);
            (rss - after) / s2(after)
        };
        let largest = (0..columns.len()).filter(|k| !places.contains(k)).map(f).fold(0.0, f64::max);
        if rank == Rank::PartialF {
            assert!(largest <= 6.6, "{largest}");
        }
    }
}

#[test]
fn backward_removes_the_smallest_f_of_explicit_fits() {
    let (pool, data) = (pool(2, 2, 2), [record(300, 0.1, 11)]);
    let (columns, y) = stored(&pool, &data);
    let backward =
        Backward { f_to_remove: 6.6, stop: Stop::F { max_terms: 1, f_to_enter: 6.6 }, min_terms: 1 };
    let found = backward.select(&pool, &data, &|| false).unwrap();
    let mut left: Vec<usize> = (0..columns.len()).collect();
    let smallest = |left: &[usize]| -> (usize, f64) {
        let rss = explicit(&columns, left, &y);
        let s2 = rss / (y.len() - left.len()) as f64;
        let f = |k: usize| {
            let others: Vec<usize> = left.iter().copied().filter(|o| *o != k).collect();
            (explicit(&columns, &others, &y) - rss) / s2
        };
        left.iter().map(|&k| (k, f(k))).min_by(|a, b| a.1.total_cmp(&b.1)).unwrap()
    };
    for s in &found.path {
        let (k, f) = smallest(&left);
        assert_eq!((s.candidate, s.action), (k, Action::Removed));
        assert!((s.f - f).abs() <= 1e-7 * f.max(1e-3), "{} {f}", s.f);
        left.retain(|o| *o != k);
        assert!((s.mse * y.len() as f64 - explicit(&columns, &left, &y)).abs() <= 1e-9 * s.mse);
    }
    assert!(found.path.len() >= 5 && smallest(&left).1 >= 6.6);
    assert_eq!(found.model, pool.structure(&left).unwrap());
    // Its PRESS is that of a forward path to the same terms (checked against leaving out above).
    let last = found.path.last().unwrap();
    let forward = frols(&found.model, &padded(&data, pool.max_lag()), Stop::Terms(left.len())).unwrap();
    assert!((last.press - forward.path.last().unwrap().press).abs() < 1e-9 * last.press);
}

/// The same records with more samples that only initialise.
fn padded(data: &[Experiment], init_samples: usize) -> Vec<Experiment> {
    data.iter().map(|e| Experiment { init_samples, ..e.clone() }).collect()
}

#[test]
fn backward_names_dependent_candidates_first_and_refuses_more_candidates_than_samples() {
    let mut e = record(200, 0.1, 12);
    // A second input that is a copy of the first.
    e.u = e.u.iter().flat_map(|v| [*v, *v]).collect();
    let pool = PolyNarx::parse(&["u", "v"], "y", &["u(t-1)", "v(t-1)", "y(t-1)", "y(t-2)"]).unwrap();
    let backward =
        Backward { f_to_remove: 4.0, stop: Stop::F { max_terms: 1, f_to_enter: 4.0 }, min_terms: 1 };
    let found = backward.select(&Pool::from(&pool), &[e.clone()], &|| false).unwrap();
    assert!(["u(t-1)", "v(t-1)"].contains(&found.path[0].regressor.as_str()));
    assert_eq!((found.path[0].err, found.terms), (0.0, 3));
    let wide = keys(5, 5, 4).pool(&["u".into(), "v".into()], "y").unwrap();
    let error = backward.select(&wide, &[e], &|| false).unwrap_err().to_string();
    assert!(
        error.contains("195 usable samples") && error.contains("3876 candidates, all of which are in"),
        "{error}"
    );
}

/// A proxy that is best alone goes out once the two that it stands for are in.
#[test]
fn stepwise_removes_what_later_terms_make_superfluous() {
    let n = 400;
    let mut rng = Rng64::new(21);
    let (mut u, mut y) = (Vec::new(), vec![0.0; n]);
    for t in 0..n {
        let (a, b) = (rng.normal(), rng.normal());
        u.extend([a, b, a + b + 0.1 * rng.normal()]);
        y[t] = a + 1.2 * b + 0.05 * rng.normal();
    }
    let e = Experiment { name: "proxy".into(), u, y, init_samples: 0, weights: Vec::new() };
    let pool = PolyNarx::parse(&["a", "b", "proxy"], "y", &["1", "a(t)", "b(t)", "proxy(t)"]).unwrap();
    let found = Stepwise { f_to_enter: 10.0, f_to_remove: 9.0, ..Stepwise::default() }
        .select(&Pool::from(&pool), &[e], &|| false)
        .unwrap();
    assert_eq!(found.path[1].regressor, "proxy(t)");
    let removed: Vec<&str> =
        found.path.iter().filter(|s| s.action == Action::Removed).map(|s| s.regressor.as_str()).collect();
    assert_eq!(removed, ["proxy(t)"]);
    assert_eq!(found.model.regressor_texts(), ["1", "a(t)", "b(t)"]);
}

/// How often each method holds all true terms, and how many others, over 40 records.
#[test]
fn true_terms_are_recovered_by_every_method_that_judges_one_step_prediction() {
    let pool = pool(2, 2, 3);
    // A wrong term enters when its F exceeds 10.8 (0.1 %) or ln 2000 = 7.6 (0.6 %): 1.2 or 7 in 40 records for some 30
    // free candidates, more where a wrong term is taken before the true ones that it stands for. PRESS, like AIC, is
    // known to take more. Candidates as they are (eq. 2.34) mislead where output lags are correlated: the best
    // one may not reach the F to enter while another would. And backward, where cubic terms of y(t-1) and y(t-2) explain
    // each other, a true one may be the first to go. Nothing is asked of these two here; their steps are tested above.
    let methods: [(&str, &str, Option<[usize; 2]>); 6] = [
        ("frols", "stop = \"bic\"\nmax_terms = 12", Some([38, 20])),
        ("frols", "stop = \"press\"\nmax_terms = 12", Some([38, 400])),
        ("forward", "f_to_enter = 10.8", Some([38, 10])),
        ("forward", "f_to_enter = 10.8\nrank = \"correlation\"", None),
        ("backward", "f_to_remove = 10.8", None),
        ("stepwise", "f_to_enter = 10.8\nf_to_remove = 10.0", Some([38, 10])),
    ];
    for (name, text, asked) in methods {
        let method = dynocal_ident::select::selection(name, &toml::from_str(text).unwrap()).unwrap();
        let (mut kept, mut extra) = (0, 0);
        for seed in 0..40 {
            let found = method.select(&pool, &[record(2000, 0.05, 100 + seed)], &|| false).unwrap();
            let texts = found.model.regressor_texts();
            let hits = TRUE_TERMS.iter().filter(|t| texts.contains(&t.to_string())).count();
            kept += usize::from(hits == TRUE_TERMS.len());
            extra += texts.iter().filter(|t| *t != "1").count() - hits;
        }
        println!("{name} {text:?}: {kept} of 40 hold all true terms, {extra} terms too many");
        assert!(
            asked.is_none_or(|[least, most]| kept >= least && extra <= most),
            "{name} {text}: {kept} {extra}"
        );
    }
}

#[test]
fn simulation_takes_the_candidate_with_the_least_free_run_error() {
    let (pool, data) = (pool(2, 2, 2), [record(500, 0.1, 31)]);
    let all = pool.candidates().len();
    let method = Simulation {
        max_terms: 4,
        among: all,
        selection: 0.0,
        min_improvement: 0.0,
        ..Simulation::default()
    };
    let found = method.select(&pool, &data, &|| false).unwrap();
    let padded = padded(&data, pool.max_lag());
    let free_run = |places: &[usize]| -> f64 {
        let model = pool.structure(places).unwrap();
        let fit = Ols::default().estimate(&model, &padded, None, &|| false).unwrap();
        score(&model, &fit.theta, &padded, Kind::FreeRun, Seen::Unseen).mse
    };
    let mut places: Vec<usize> = Vec::new();
    for s in &found.path {
        let best = (0..all)
            .filter(|k| !places.contains(k))
            .map(|k| free_run(&[places.as_slice(), &[k]].concat()))
            .filter(|v| v.is_finite())
            .fold(f64::INFINITY, f64::min);
        places.push(s.candidate);
        assert!(
            (s.free_run.unwrap() - best).abs() <= 1e-9 * best,
            "{}: {:?} {best}",
            s.regressor,
            s.free_run
        );
    }
}

/// Measured output with white noise: one-step prediction prefers many output lags, the free run the true terms.
#[test]
fn under_output_noise_the_free_run_methods_give_the_better_free_run() {
    let records: Vec<Experiment> = (0..3)
        .map(|seed| {
            let mut e = record(1200, 0.0, 40 + seed);
            let mut rng = Rng64::new(50 + seed);
            e.y.iter_mut().for_each(|v| *v += 0.2 * rng.normal());
            e
        })
        .collect();
    let pool = pool(3, 3, 2);
    let error = |name: &str, text: &str| {
        let method = dynocal_ident::select::selection(name, &toml::from_str(text).unwrap()).unwrap();
        let found = method.select(&pool, &records[..2], &|| false).unwrap();
        let sem = dynocal_ident::estimate::sem::Sem::default();
        let fit = sem.estimate(&found.model, &records[..2], None, &|| false).unwrap();
        // The truth of the third record, without noise.
        let truth = record(1200, 0.0, 42).y;
        let y = dynocal_ident::validate::output(&found.model, &fit.theta, &records[2], Kind::FreeRun);
        let mse = truth.iter().zip(&y).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / truth.len() as f64;
        println!("{name} {text}: {} terms, {mse:.3e}", found.terms);
        mse
    };
    let one_step = error("frols", "stop = \"terms\"\nmax_terms = 5");
    let forward = error("simulation", "max_terms = 5\nestimator = \"sem\"");
    let down = error("prune", "from = 15\nmin_terms = 5");
    assert!(forward < one_step && down < one_step, "{one_step} {forward} {down}");
}

#[test]
fn the_path_of_pruning_ends_in_the_chosen_structure() {
    let (pool, data) = (pool(2, 2, 2), [record(600, 0.05, 61)]);
    let method =
        dynocal_ident::select::selection("prune", &toml::from_str("from = 9\nmin_terms = 3").unwrap())
            .unwrap();
    let found = method.select(&pool, &data, &|| false).unwrap();
    assert_eq!(found.path.len(), 9 + 6);
    assert_eq!(found.first(&pool, found.steps).unwrap(), found.model);
    assert!((3..=9).contains(&found.terms));
    let errors: Vec<f64> = found.path[8..].iter().map(|s| s.free_run.unwrap()).collect();
    assert!(errors.iter().all(|e| *e >= found.path[found.steps - 1].free_run.unwrap()));
    assert!(found.path[..8].iter().all(|s| s.free_run.is_none()));
}
