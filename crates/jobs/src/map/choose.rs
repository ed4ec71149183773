//! The kind of a response model for optimisation: least error in folds, with an error of the whole choice from outer folds.
//!
//! The rule of one standard error (`best_of`) prefers the simpler kind where the errors of the kinds scatter, and one odd point is
//! enough for that. A description loses little by it; an optimum is sought where a rough model errs most, and finds that.

use dynocal_ident::model::response::score::{FoldKind, folds};
use dynocal_ident::model::response::{Ask, Learn, Learnt, Points, Prediction, Response, ResponseError};

use super::spec::Errors;

/// An error in words.
fn shown(by: Errors, error: f64) -> String {
    match by {
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
    let Least { best: chosen, errors, absolute, tests } = least(kinds, by, points, &parts, interrupt)?;
    let name = |k: usize| kinds[k].0.clone();
    let (mut rmse, mut same) = (absolute, 0);
    if nested {
        let mut squares = 0.0;
        for (f, held) in parts.iter().enumerate() {
            let inner = inner_choice(kinds, by, points, held, count, interrupt)?;
            same += usize::from(inner == chosen);
            squares += match &tests[inner] {
                Ok(tests) => squares_of(&tests[f]).0,
                // It can be learnt without this fold, but not without another one.
                Err(_) => squares_of(&tested(&*kinds[inner].1, points, held, interrupt)?).0,
            };
        }
        rmse = (squares / points.len() as f64).sqrt();
    }
    let each: Vec<String> =
        errors.iter().enumerate().map(|(k, e)| format!("{} {}", name(k), shown(by, *e))).collect();
    let said = if nested {
        format!(
            " The whole choice, tested on points that had no part in it, has an error of {rmse:.4}; {same} of {count} such tests chose the same."
        )
    } else {
        String::new()
    };
    let words = format!(
        "`{}`: {} is taken, as it has the least error in the folds ({}).{said}",
        points.output,
        name(chosen),
        each.join(", ")
    );
    let learnt = kinds[chosen].1.learn(points, interrupt)?;
    let noise = noise(&learnt, points);
    let widen = tests[chosen].as_ref().map_or(1.0, |tests| widen(tests, &noise));
    Ok(Chosen { learnt, rmse, widen, words })
}

/// The kind that would have been chosen without the rows `held`; a single kind is no choice.
fn inner_choice(
    kinds: &[(String, Box<dyn Learn>)],
    by: Errors,
    points: &Points,
    held: &[usize],
    count: usize,
    interrupt: &dyn Fn() -> bool,
) -> Result<usize, ResponseError> {
    if kinds.len() == 1 {
        return Ok(0);
    }
    let part = without(points, held);
    let inner = folds(&part, count, FoldKind::Interleaved);
    Ok(least(kinds, by, &part, &inner, interrupt)?.best)
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
fn widen(tests: &[Vec<Tested>], noise: &[f64]) -> f64 {
    let all = tests.iter().flatten();
    let deviation = |t: &Tested| t.deviation.max(noise[t.row]).max(f64::MIN_POSITIVE);
    let mut shares: Vec<f64> = all.map(|t| t.error.abs() / deviation(t)).collect();
    shares.sort_by(f64::total_cmp);
    let rank = (HELD * (shares.len() + 1) as f64).ceil() as usize;
    let quantile = shares[rank.clamp(1, shares.len()) - 1] / QUANTILE;
    if quantile.is_finite() { quantile.max(1.0) } else { 1.0 }
}

/// A point that had no part in learning.
struct Tested {
    row: usize,
    measured: f64,
    /// Measured less predicted.
    error: f64,
    /// Standard deviation of that, as the model knows itself.
    deviation: f64,
}

/// Which kind errs least on points that were held out, and what all of them did.
struct Least {
    best: usize,
    /// Errors of all kinds; those that cannot be learnt have an infinite one.
    errors: Vec<f64>,
    /// Absolute error of the best.
    absolute: f64,
    /// Of each kind the points of each fold.
    tests: Vec<Result<Vec<Vec<Tested>>, ResponseError>>,
}

fn least(
    kinds: &[(String, Box<dyn Learn>)],
    by: Errors,
    points: &Points,
    parts: &[Vec<usize>],
    interrupt: &dyn Fn() -> bool,
) -> Result<Least, ResponseError> {
    let root = |sum: f64| (sum / points.len() as f64).sqrt();
    let of_kind = |(_, kind): &(String, Box<dyn Learn>)| -> Result<Vec<Vec<Tested>>, ResponseError> {
        parts.iter().map(|held| tested(&**kind, points, held, interrupt)).collect()
    };
    let tests: Vec<_> = kinds.iter().map(of_kind).collect();
    let error = |tests: &Result<Vec<Vec<Tested>>, ResponseError>| match tests {
        Ok(tests) => {
            let sums: Vec<(f64, f64)> = tests.iter().map(|t| squares_of(t)).collect();
            (root(sums.iter().map(|s| s.0).sum()), root(sums.iter().map(|s| s.1).sum()))
        }
        Err(_) => (f64::INFINITY, f64::INFINITY),
    };
    let both: Vec<(f64, f64)> = tests.iter().map(error).collect();
    let errors: Vec<f64> = both.iter().map(|e| if by == Errors::Relative { e.1 } else { e.0 }).collect();
    let finite = (0..errors.len()).filter(|k| errors[*k].is_finite());
    match finite.min_by(|a, b| errors[*a].total_cmp(&errors[*b])) {
        Some(best) => Ok(Least { best, absolute: both[best].0, errors, tests }),
        None => {
            Err(tests.into_iter().filter_map(Result::err).next_back().unwrap_or_else(|| ResponseError::Key {
                model: "choice",
                key: "candidates",
                found: "none whose errors are finite".into(),
                expected: "at least one".into(),
            }))
        }
    }
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
        Tested { row: *i, measured, error: measured - at.mean, deviation: at.measured_std() }
    };
    Ok(held.iter().map(one).collect())
}

/// Sums of squared errors: absolute, and as shares of what was measured.
fn squares_of(tests: &[Tested]) -> (f64, f64) {
    tests.iter().fold((0.0, 0.0), |(absolute, relative), t| {
        (absolute + t.error.powi(2), relative + (t.error / t.measured).powi(2))
    })
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
        assert!(absolute.contains("cubic is taken") && !absolute.contains(" %"), "{absolute}");
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
        let test =
            |row, error: f64| Tested { row, measured: 1.0, error, deviation: 0.5 * error.abs() / QUANTILE };
        let tests = vec![(0..40).map(|i| test(i, 0.1 + 0.01 * i as f64)).collect::<Vec<Tested>>()];
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
