//! The kind of a response model for optimisation: those with about the least error in folds, with an error of the whole choice from
//! outer folds.
//!
//! The rule of one standard error (`best_of`) prefers the simpler kind where the errors of the kinds scatter, and one odd point is
//! enough for that. A description loses little by it; an optimum is sought where a rough model errs most, and finds that. The kind of
//! the least error alone has the same fault where others err as little: what it is wrong about shows only in what they say of the same
//! place. So the model is the mean of all kinds whose errors are not told from those of the best,
//!
//! ```text
//! mean(d) <= std(d) / sqrt(n),   d_i = |e_ki| - |e_bi|   on n held-out points, b the kind of the least error
//! ```
//!
//! by their sizes and not by their squares, or one odd point that all miss would make every kind as good as the best; one by one, the better
//! first, as long as the mean of them errs no more than the best alone (root mean square), so that a kind with a gross miss stays out.
//!
//! What they disagree on is part of its variance ([`mean_of`](dynocal_ident::model::response::mean_of)), by which limits are kept
//! and promises are discounted.

use dynocal_ident::model::response::mean_of::together;
use dynocal_ident::model::response::score::{FoldKind, folds};
use dynocal_ident::model::response::{Ask, Learn, Learnt, Points, Prediction, Response, ResponseError};

use super::spec::Errors;

/// An error in words.
fn shown(by: Errors, error: f64) -> String {
    match by {
        _ if !error.is_finite() => "cannot be learnt".into(),
        Errors::Absolute => format!("{error:.4}"),
        Errors::Relative => format!("{:.2} %", 100.0 * error),
    }
}

/// Relative errors where they are asked and the output is positive everywhere.
pub(super) fn errors_of(asked: Errors, y: &[f64]) -> Errors {
    if y.iter().all(|y| *y > 0.0) { asked } else { Errors::Absolute }
}

/// Kinds of response models with their names.
pub(super) type Kinds = Vec<(String, Box<dyn Learn>)>;

/// What was chosen.
pub(super) struct Chosen {
    pub(super) learnt: Learnt,
    /// Error of the whole choice on points that had no part in it; that of the chosen kind in the folds where it was not nested.
    pub(super) rmse: f64,
    /// Factor by which the standard deviations of the model are widened, so that 95 % of the held-out points lie in their intervals.
    pub(super) widen: f64,
    pub(super) words: String,
    /// Numbers of the kinds that were taken.
    pub(super) taken: Vec<usize>,
}

/// Share of held-out points that their intervals have to hold, and its quantile of the normal distribution.
const HELD: f64 = 0.95;
const QUANTILE: f64 = 1.959_963_984_540_054;

/// Chooses among `kinds` (name, kind) by the `errors` of `count` folds and learns the choice on all points.
///
/// A fold of the choice is an outer fold of its test and of the intervals as well: each kind is learnt on it once.
///
/// # Errors
/// [`ResponseError`] when no kind can be learnt.
pub(super) fn choose(
    kinds: &[(String, Box<dyn Learn>)],
    by: Errors,
    points: &Points,
    count: usize,
    nested: bool,
    interrupt: &dyn Fn() -> bool,
) -> Result<Chosen, ResponseError> {
    let parts = folds(points, count, FoldKind::Interleaved);
    let Least { taken: wanted, errors, tests } = least(kinds, by, points, &parts, interrupt)?;
    let (mut taken, mut learnt) = (Vec::new(), Vec::new());
    for k in wanted {
        match kinds[k].1.learn(points, interrupt) {
            Ok(one) => {
                taken.push(k);
                learnt.push(one);
            }
            Err(e) if taken.is_empty() || interrupt() => return Err(e),
            // One that can be learnt without each fold, but not on all points, is no companion.
            Err(_) => {}
        }
    }
    let held_out = joined(&taken, &tests);
    let (mut rmse, mut nested_error, mut same) = (rms(&held_out, Errors::Absolute), 0.0, 0);
    if nested {
        let mut apart: Vec<Tested> = Vec::new();
        for (f, held) in parts.iter().enumerate() {
            let inner = inner_choice(kinds, by, points, held, count, interrupt)?;
            same += usize::from(inner == taken);
            // What can be learnt without this fold, but not without another one, has no tests yet.
            let of_fold = |k: &usize| match &tests[*k] {
                Ok(tests) => Ok(tests[f].clone()),
                Err(_) => tested(&*kinds[*k].1, points, held, interrupt),
            };
            let each = inner.iter().map(of_fold).collect::<Result<Vec<_>, _>>()?;
            apart.extend(mean_tests(&each));
        }
        (rmse, nested_error) = (rms(&apart, Errors::Absolute), rms(&apart, by));
    }
    let learnt = together(learnt);
    let noise = noise(&learnt, points);
    let widen = widen(&held_out, &noise);
    let names: Vec<&str> = kinds.iter().map(|(name, _)| name.as_str()).collect();
    let mut words = format!("`{}`: {}", points.output, in_words(&names, &taken, &errors, by));
    if nested {
        words += &format!(
            " The whole choice, tested on points that had no part in it, has an error of {}; {same} of {} such tests chose the same.",
            shown(by, nested_error),
            parts.len()
        );
    }
    Ok(Chosen { learnt, rmse, widen, words, taken })
}

/// What was taken, and why.
fn in_words(names: &[&str], taken: &[usize], errors: &[f64], by: Errors) -> String {
    let each: Vec<String> =
        names.iter().zip(errors).map(|(name, e)| format!("{name} {}", shown(by, *e))).collect();
    let each = each.join(", ");
    match taken {
        [one] => format!("{} is taken, as it has the least error in the folds ({each}).", names[*one]),
        [best, others @ ..] => {
            let others: Vec<&str> = others.iter().map(|k| names[*k]).collect();
            format!(
                "the mean of {} and {} is taken: the first has the least error in the folds, the others are not told from it ({each}).",
                names[*best],
                others.join(", ")
            )
        }
        [] => format!("nothing is taken ({each})."),
    }
}

/// The kinds that would have been chosen without the rows `held`; a single kind is no choice.
fn inner_choice(
    kinds: &[(String, Box<dyn Learn>)],
    by: Errors,
    points: &Points,
    held: &[usize],
    count: usize,
    interrupt: &dyn Fn() -> bool,
) -> Result<Vec<usize>, ResponseError> {
    if kinds.len() == 1 {
        return Ok(vec![0]);
    }
    let part = without(points, held);
    let inner = folds(&part, count, FoldKind::Interleaved);
    Ok(least(kinds, by, &part, &inner, interrupt)?.taken)
}

/// Standard deviation of a measurement about the function at each point, as the model of all points says.
fn noise(learnt: &Learnt, points: &Points) -> Vec<f64> {
    let mut at = Prediction::new(points.dim());
    let one = |i: usize| {
        learnt.model.predict(points.row(i), Ask::Variance, &mut at);
        at.noise.max(0.0).sqrt()
    };
    (0..points.len()).map(one).collect()
}

/// By how much intervals are too narrow on held-out points: the smallest factor, at least one, with which `HELD` of them and one
/// more are inside (V. Vovk, A. Gammerman, G. Shafer, Algorithmic Learning in a Random World, 2005: cross-conformal prediction with
/// normalised errors). A model of few points may run through all of them and call itself exact: no deviation counts as less than the `noise` that
/// the model of all points has there, or the factor would be the fault of a model that is not used.
fn widen(tests: &[Tested], noise: &[f64]) -> f64 {
    let deviation = |t: &Tested| t.variance.sqrt().max(noise[t.row]).max(f64::MIN_POSITIVE);
    let mut shares: Vec<f64> = tests.iter().map(|t| t.error.abs() / deviation(t)).collect();
    shares.sort_by(f64::total_cmp);
    let rank = (HELD * (shares.len() + 1) as f64).ceil() as usize;
    let quantile = shares[rank.clamp(1, shares.len()) - 1] / QUANTILE;
    if quantile.is_finite() { quantile.max(1.0) } else { 1.0 }
}

/// A point that had no part in learning.
#[derive(Clone)]
struct Tested {
    row: usize,
    measured: f64,
    /// Measured less predicted.
    error: f64,
    /// Variance of that, as the model knows itself.
    variance: f64,
}

impl Tested {
    /// Size of the error, by what errors count.
    fn size(&self, by: Errors) -> f64 {
        match by {
            Errors::Absolute => self.error.abs(),
            Errors::Relative => (self.error / self.measured).abs(),
        }
    }
}

/// Of each kind the points of each fold.
type Tests = Vec<Result<Vec<Vec<Tested>>, ResponseError>>;

/// The tests of the mean of several kinds from their own, in the same order of points.
fn mean_tests(each: &[Vec<Tested>]) -> Vec<Tested> {
    let count = each.len() as f64;
    let one = |(i, t): (usize, &Tested)| {
        let all = || each.iter().map(|tests| &tests[i]);
        let error = all().map(|t| t.error).sum::<f64>() / count;
        let variance = all().map(|t| t.variance + (t.error - error).powi(2)).sum::<f64>() / count;
        Tested { error, variance, ..t.clone() }
    };
    each[0].iter().enumerate().map(one).collect()
}

/// All tests of the mean of the kinds `taken`.
fn joined(taken: &[usize], tests: &Tests) -> Vec<Tested> {
    let flat = |k: &usize| tests[*k].as_ref().ok().map(|t| t.concat());
    mean_tests(&taken.iter().filter_map(flat).collect::<Vec<_>>())
}

fn rms(tests: &[Tested], by: Errors) -> f64 {
    (tests.iter().map(|t| t.size(by).powi(2)).sum::<f64>() / tests.len() as f64).sqrt()
}

/// Which kinds err least on points that were held out, and what all of them did.
struct Least {
    /// The kind of the least error, and those that are not told from it.
    taken: Vec<usize>,
    /// Errors of all kinds; those that cannot be learnt have an infinite one.
    errors: Vec<f64>,
    tests: Tests,
}

fn least(
    kinds: &[(String, Box<dyn Learn>)],
    by: Errors,
    points: &Points,
    parts: &[Vec<usize>],
    interrupt: &dyn Fn() -> bool,
) -> Result<Least, ResponseError> {
    let of_kind = |(_, kind): &(String, Box<dyn Learn>)| -> Result<Vec<Vec<Tested>>, ResponseError> {
        parts.iter().map(|held| tested(&**kind, points, held, interrupt)).collect()
    };
    let tests: Tests = kinds.iter().map(of_kind).collect();
    let sizes = |tests: &Result<Vec<Vec<Tested>>, ResponseError>| -> Option<Vec<f64>> {
        let all = tests.as_ref().ok()?;
        Some(all.iter().flatten().map(|t| t.size(by)).collect())
    };
    let sizes: Vec<Option<Vec<f64>>> = tests.iter().map(sizes).collect();
    let root = |sizes: &Option<Vec<f64>>| match sizes {
        Some(s) => (s.iter().map(|e| e * e).sum::<f64>() / points.len() as f64).sqrt(),
        None => f64::INFINITY,
    };
    let errors: Vec<f64> = sizes.iter().map(root).collect();
    let finite = || (0..errors.len()).filter(|k| errors[*k].is_finite());
    let Some(best) = finite().min_by(|a, b| errors[*a].total_cmp(&errors[*b])) else {
        return Err(tests.into_iter().filter_map(Result::err).next_back().unwrap_or_else(|| {
            ResponseError::Key {
                model: "choice",
                key: "candidates",
                found: "none whose errors are finite".into(),
                expected: "at least one".into(),
            }
        }));
    };
    let mut others: Vec<usize> = finite().filter(|k| *k != best).collect();
    others.sort_by(|a, b| errors[*a].total_cmp(&errors[*b]));
    let mut taken = vec![best];
    for k in others {
        let (Some(own), Some(least)) = (&sizes[k], &sizes[best]) else { continue };
        // One that errs as another to the last digit is the same model, as one whose warp finds nothing to warp: it has no second voice.
        if taken.iter().any(|t| sizes[*t].as_ref() == Some(own)) {
            continue;
        }
        let more: Vec<usize> = taken.iter().copied().chain([k]).collect();
        if not_told_from(own, least) && rms(&joined(&more, &tests), by) <= errors[best] {
            taken = more;
        }
    }
    Ok(Least { taken, errors, tests })
}

/// Whether errors are no more than one standard error of their differences above the least ones, in the mean of their sizes.
fn not_told_from(own: &[f64], least: &[f64]) -> bool {
    let n = own.len() as f64;
    let differences = || own.iter().zip(least).map(|(a, b)| a - b);
    let mean = differences().sum::<f64>() / n;
    let variance = differences().map(|d| (d - mean).powi(2)).sum::<f64>() / (n - 1.0);
    variance.is_finite() && mean <= (variance / n).sqrt()
}

fn without(points: &Points, held: &[usize]) -> Points {
    let rest: Vec<usize> = (0..points.len()).filter(|i| !held.contains(i)).collect();
    points.rows(&rest)
}

/// `kind`, learnt without the rows `held`, at these rows.
fn tested(
    kind: &dyn Learn,
    points: &Points,
    held: &[usize],
    interrupt: &dyn Fn() -> bool,
) -> Result<Vec<Tested>, ResponseError> {
    let learnt = kind.learn(&without(points, held), interrupt)?;
    let mut at = Prediction::new(points.dim());
    let one = |i: &usize| {
        learnt.model.predict(points.row(*i), Ask::Variance, &mut at);
        let measured = points.y[*i];
        Tested { row: *i, measured, error: measured - at.mean, variance: at.measured_std().powi(2) }
    };
    Ok(held.iter().map(one).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use dynocal_ident::model::response::learner;

    fn kinds() -> Kinds {
        [1i64, 2]
            .map(|degree| {
                let keys = toml::Table::from_iter([("degree".to_string(), degree.into())]);
                (format!("degree {degree}"), learner("stepwise_polynomial", &keys).unwrap())
            })
            .into()
    }

    /// A parabola with one wild point: the errors of the folds scatter so much that a line is within one standard error.
    #[test]
    fn one_odd_point_does_not_make_a_line_of_a_parabola() {
        let x: Vec<f64> = (0..30).map(|i| f64::from(i) / 29.0).collect();
        let mut y: Vec<f64> = x.iter().map(|x| (x - 0.5).powi(2)).collect();
        y[13] += 0.5;
        let points = Points { inputs: vec!["spark".into()], output: "fuel".into(), x, y };
        let found = choose(&kinds(), Errors::Absolute, &points, 5, true, &|| false).unwrap();
        assert!(found.words.contains("degree 2 is taken"), "{}", found.words);
        // The odd point is in one fold and cannot be told beforehand: 0.5 / sqrt(30).
        assert!(found.rmse > 0.08 && found.rmse < 0.12, "{}", found.rmse);
        assert!(found.widen >= 1.0 && found.widen.is_finite());
    }

    /// A line and an exponential err alike on what lies between them: the model is their mean, and beyond the points, where they part, it says so.
    #[test]
    fn kinds_that_are_not_told_apart_are_averaged_and_their_disagreement_counts() {
        let mut rng = dynocal_numerics::rng::Rng64::new(3);
        let x: Vec<f64> = (0..40).map(|i| f64::from(i) / 39.0).collect();
        let between = |x: f64| 0.5 * (1.0 + 5.0 * x + (6.0_f64.ln() * x).exp());
        let y: Vec<f64> = x.iter().map(|x| between(*x) + 0.2 * rng.normal()).collect();
        let points = Points { inputs: vec!["spark".into()], output: "fuel".into(), x, y };
        let line = toml::Table::from_iter([("degree".to_string(), 1.into())]);
        let mut log = line.clone();
        log.insert("transform".into(), "log".into());
        let named = |name: &str, keys: &toml::Table| {
            (name.to_string(), learner("stepwise_polynomial", keys).unwrap())
        };
        let kinds: Kinds = vec![named("line", &line), named("exponential", &log)];
        let found = choose(&kinds, Errors::Absolute, &points, 5, true, &|| false).unwrap();
        assert!(
            found.words.contains("the mean of ") && found.words.contains("not told from it"),
            "{}",
            found.words
        );
        let mut at = [0, 1, 2].map(|_| Prediction::new(1));
        for x in [0.4, 3.0] {
            found.learnt.model.predict(&[x], Ask::Variance, &mut at[0]);
            for (k, (_, kind)) in kinds.iter().enumerate() {
                kind.learn(&points, &|| false).unwrap().model.predict(&[x], Ask::Variance, &mut at[1 + k]);
            }
            let [mean, a, b] = &at;
            assert!((mean.mean - 0.5 * (a.mean + b.mean)).abs() < 1e-9);
            let apart = 0.25 * (a.mean - b.mean).powi(2);
            assert!((mean.variance - 0.5 * (a.variance + b.variance) - apart).abs() < 1e-9);
        }
        // The line goes to 16, the exponential to 200.
        assert!(at[0].variance > 0.01, "{}", at[0].variance);
    }

    /// Two kinds alike but for one gross miss: by the sizes of their errors they are not told apart, but the mean of them is worse than the better
    /// one, and that is taken alone.
    #[test]
    fn a_kind_with_one_gross_miss_is_no_companion() {
        /// A line, and beside the point 0.9 something else.
        struct Missing;
        impl Learn for Missing {
            fn learn(&self, points: &Points, interrupt: &dyn Fn() -> bool) -> Result<Learnt, ResponseError> {
                let mut bent = points.clone();
                if !points.x.iter().any(|x| (x - 0.9).abs() < 1e-9) {
                    bent.y.iter_mut().for_each(|y| *y += 3.0);
                }
                let line = toml::Table::from_iter([("degree".to_string(), 1.into())]);
                learner("stepwise_polynomial", &line).unwrap().learn(&bent, interrupt)
            }
        }
        let mut rng = dynocal_numerics::rng::Rng64::new(5);
        let x: Vec<f64> = (0..41).map(|i| f64::from(i) / 40.0).collect();
        let y: Vec<f64> = x.iter().map(|x| 2.0 + x + 0.05 * rng.normal()).collect();
        let points = Points { inputs: vec!["spark".into()], output: "fuel".into(), x, y };
        let (name, one) = kinds().swap_remove(0);
        let kinds: Kinds = vec![(name, one), ("missing".into(), Box::new(Missing))];
        // Each point is a fold of its own, so that one point only is missed.
        let found = choose(&kinds, Errors::Absolute, &points, 41, false, &|| false).unwrap();
        assert!(found.words.contains("degree 1 is taken"), "{}", found.words);
    }

    /// Errors that are a little larger everywhere are told from the least; as many that are larger by chance are not.
    #[test]
    fn kinds_are_told_apart_by_pairs_of_errors() {
        let least: Vec<f64> = (0..50).map(|i| 1.0 + 0.5 * f64::from(i % 7)).collect();
        let larger: Vec<f64> = least.iter().map(|e| 1.05 * e).collect();
        let other: Vec<f64> = (0..50).map(|i| 1.0 + 0.5 * f64::from((i + 3) % 7)).collect();
        assert!(!not_told_from(&larger, &least));
        assert!(not_told_from(&other, &least) && not_told_from(&least, &least));
    }

    /// Two kinds over a range of decades, `y = exp(4 x + 0.8 x^2)` from 1 to 121. A line of the logarithm misses it by the same share
    /// everywhere, 0.8 (x^2 - x + 1/6): 6 % rms, 16 units at the top. A cubic of the value itself misses it by units everywhere: nothing at
    /// the top, multiples of the least values.
    #[test]
    fn absolute_and_relative_errors_choose_differently() {
        let x: Vec<f64> = (0..40).map(|i| f64::from(i) / 39.0).collect();
        let y: Vec<f64> = x.iter().map(|x| (4.0 * x + 0.8 * x * x).exp()).collect();
        let points = Points { inputs: vec!["torque".into()], output: "fuel".into(), x, y };
        let log = toml::Table::from_iter([
            ("transform".to_string(), "log".into()),
            ("degree".to_string(), 1.into()),
        ]);
        let cubic = toml::Table::from_iter([("degree".to_string(), 3.into())]);
        let kinds: Kinds = [("log", log), ("cubic", cubic)]
            .map(|(name, keys)| (name.to_string(), learner("stepwise_polynomial", &keys).unwrap()))
            .into();
        assert_eq!(errors_of(Errors::Relative, &points.y), Errors::Relative);
        assert_eq!(errors_of(Errors::Relative, &[1.0, 0.0]), Errors::Absolute);
        let by = |errors: Errors| choose(&kinds, errors, &points, 5, true, &|| false).unwrap().words;
        let (relative, absolute) = (by(Errors::Relative), by(Errors::Absolute));
        assert!(relative.contains("log is taken") && relative.contains(" %"), "{relative}");
        assert!(absolute.contains("the mean of cubic and log") && !absolute.contains(" %"), "{absolute}");
        let parts = folds(&points, 5, FoldKind::Interleaved);
        let Least { errors, .. } = least(&kinds, Errors::Relative, &points, &parts, &|| false).unwrap();
        assert!(errors[0] > 0.04 && errors[0] < 0.09 && errors[1] > 0.3, "{errors:?}");
    }

    /// A fold that runs through its points and calls itself exact does not make the intervals of the model of all points worthless. In six
    /// inputs forty points are few: a process with long lengths may go through all of them.
    #[test]
    fn a_fold_that_thinks_itself_exact_does_not_widen_without_bound() {
        let kinds: Kinds =
            vec![("process".into(), learner("gaussian_process", &toml::Table::new()).unwrap())];
        for seed in 1..7 {
            let mut rng = dynocal_numerics::rng::Rng64::new(seed);
            let x: Vec<f64> = (0..480).map(|_| rng.uniform()).collect();
            let of = |r: &[f64]| 850.0 + 140.0 * r[0] + 230.0 * r[1] - 110.0 * r[2] + 60.0 * r[5];
            let y: Vec<f64> = x.chunks(6).map(|r| of(r) + 2.0 * rng.normal()).collect();
            let inputs = (0..6).map(|i| format!("x{i}")).collect();
            let points = Points { inputs, output: "egt".into(), x, y };
            let found = choose(&kinds, Errors::Absolute, &points, 2, false, &|| false).unwrap();
            // 2 K of noise, and what forty points leave of seven coefficients.
            assert!(found.rmse < 4.0 && found.widen < 4.0, "seed {seed}: {} {}", found.rmse, found.widen);
        }
    }

    /// What the folds show is what widens: a deviation that is half of the error.
    #[test]
    fn intervals_are_widened_by_what_the_folds_show() {
        let test = |row, error: f64| Tested {
            row,
            measured: 1.0,
            error,
            variance: (0.5 * error / QUANTILE).powi(2),
        };
        let tests: Vec<Tested> = (0..40).map(|i| test(i, 0.1 + 0.01 * i as f64)).collect();
        assert!((widen(&tests, &[0.0; 40]) - 2.0).abs() < 1e-12);
        let wide = widen(&tests, &[1.0; 40]);
        assert!(wide == 1.0, "{wide}");
    }

    /// Counts what is learnt.
    struct Counted(std::sync::Arc<std::sync::atomic::AtomicUsize>, Box<dyn Learn>);

    impl Learn for Counted {
        fn learn(&self, points: &Points, interrupt: &dyn Fn() -> bool) -> Result<Learnt, ResponseError> {
            self.0.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            self.1.learn(points, interrupt)
        }
    }

    /// A single kind is no choice: its folds are the test. They and all points are learnt once; the error is the one of the folds.
    #[test]
    fn one_kind_is_learnt_once_for_each_fold() {
        let x: Vec<f64> = (0..30).map(|i| f64::from(i) / 29.0).collect();
        let y: Vec<f64> = x.iter().map(|x| (5.0 * x).sin()).collect();
        let points = Points { inputs: vec!["spark".into()], output: "fuel".into(), x, y };
        let count = std::sync::Arc::new(std::sync::atomic::AtomicUsize::new(0));
        let (_, one) = kinds().into_iter().last().unwrap();
        let kinds: Kinds = vec![("counted".into(), Box::new(Counted(count.clone(), one)))];
        let tested = choose(&kinds, Errors::Absolute, &points, 5, true, &|| false).unwrap();
        assert_eq!(count.swap(0, std::sync::atomic::Ordering::Relaxed), 6);
        assert!(tested.words.contains("5 of 5 such tests chose the same"), "{}", tested.words);
        let plain = choose(&kinds, Errors::Absolute, &points, 5, false, &|| false).unwrap();
        assert!((tested.rmse - plain.rmse).abs() < 1e-15 && tested.widen == plain.widen);
    }
}
