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
    let (chosen, errors, absolute) = least(kinds, by, points, count, interrupt)?;
    let name = |k: usize| kinds[k].0.clone();
    let (mut rmse, mut same) = (absolute, 0);
    if nested {
        let mut squares = 0.0;
        let outer = folds(points, count, FoldKind::Interleaved);
        for held in &outer {
            let part = without(points, held);
            let (inner, ..) = least(kinds, by, &part, count, interrupt)?;
            same += usize::from(inner == chosen);
            squares += squares_of(&*kinds[inner].1, &part, points, held, interrupt)?.0;
        }
        rmse = (squares / points.len() as f64).sqrt();
    }
    let each: Vec<String> =
        errors.iter().enumerate().map(|(k, e)| format!("{} {}", name(k), shown(by, *e))).collect();
    let tested = if nested {
        format!(
            " The whole choice, tested on points that had no part in it, has an error of {rmse:.4}; {same} of {count} such tests chose the same."
        )
    } else {
        String::new()
    };
    let words = format!(
        "`{}`: {} is taken, as it has the least error in the folds ({}).{tested}",
        points.output,
        name(chosen),
        each.join(", ")
    );
    let widen = widen(&*kinds[chosen].1, points, count, interrupt)?;
    let learnt = kinds[chosen].1.learn(points, interrupt)?;
    Ok(Chosen { learnt, rmse, widen, words })
}

/// By how much intervals are too narrow on held-out points: the smallest factor, at least one, with which `HELD` of them and one
/// more are inside (V. Vovk, A. Gammerman, G. Shafer, Algorithmic Learning in a Random World, 2005: cross-conformal prediction with
/// normalised errors).
fn widen(
    kind: &dyn Learn,
    points: &Points,
    count: usize,
    interrupt: &dyn Fn() -> bool,
) -> Result<f64, ResponseError> {
    let mut at = Prediction::new(points.dim());
    let mut shares = Vec::new();
    for held in folds(points, count, FoldKind::Interleaved) {
        let learnt = kind.learn(&without(points, &held), interrupt)?;
        for i in held {
            learnt.model.predict(points.row(i), Ask::Variance, &mut at);
            shares.push((points.y[i] - at.mean).abs() / at.measured_std().max(f64::MIN_POSITIVE));
        }
    }
    shares.sort_by(f64::total_cmp);
    let rank = (HELD * (shares.len() + 1) as f64).ceil() as usize;
    let quantile = shares[rank.clamp(1, shares.len()) - 1] / QUANTILE;
    Ok(if quantile.is_finite() { quantile.max(1.0) } else { 1.0 })
}

/// The kind of least error in folds, the errors of all, those that cannot be learnt having an infinite one, and the absolute error of
/// that kind.
fn least(
    kinds: &[(String, Box<dyn Learn>)],
    by: Errors,
    points: &Points,
    count: usize,
    interrupt: &dyn Fn() -> bool,
) -> Result<(usize, Vec<f64>, f64), ResponseError> {
    let parts = folds(points, count, FoldKind::Interleaved);
    let (mut errors, mut absolute, mut why) = (Vec::new(), Vec::new(), None);
    let root = |sum: f64| (sum / points.len() as f64).sqrt();
    for (_, kind) in kinds {
        let each =
            parts.iter().map(|held| squares_of(&**kind, &without(points, held), points, held, interrupt));
        match each.collect::<Result<Vec<_>, ResponseError>>() {
            Ok(sums) => {
                let relative = root(sums.iter().map(|s| s.1).sum());
                absolute.push(root(sums.iter().map(|s| s.0).sum()));
                errors.push(if by == Errors::Relative { relative } else { absolute[absolute.len() - 1] });
            }
            Err(e) => {
                absolute.push(f64::INFINITY);
                errors.push(f64::INFINITY);
                why = Some(e);
            }
        }
    }
    let best = (0..errors.len()).filter(|k| errors[*k].is_finite());
    match (best.min_by(|a, b| errors[*a].total_cmp(&errors[*b])), why) {
        (Some(best), _) => Ok((best, errors, absolute[best])),
        (None, Some(e)) => Err(e),
        (None, None) => Err(ResponseError::Key {
            model: "choice",
            key: "candidates",
            found: "none whose errors are finite".into(),
            expected: "at least one".into(),
        }),
    }
}

fn without(points: &Points, held: &[usize]) -> Points {
    let rest: Vec<usize> = (0..points.len()).filter(|i| !held.contains(i)).collect();
    points.rows(&rest)
}

/// Sums of the squared errors of `kind`, learnt on `part`, at the rows `held`: absolute, and as shares of what was measured.
fn squares_of(
    kind: &dyn Learn,
    part: &Points,
    points: &Points,
    held: &[usize],
    interrupt: &dyn Fn() -> bool,
) -> Result<(f64, f64), ResponseError> {
    let learnt = kind.learn(part, interrupt)?;
    let mut at = Prediction::new(points.dim());
    let (mut absolute, mut relative) = (0.0, 0.0);
    for i in held {
        learnt.model.predict(points.row(*i), Ask::Mean, &mut at);
        let error = points.y[*i] - at.mean;
        absolute += error.powi(2);
        relative += (error / points.y[*i]).powi(2);
    }
    Ok((absolute, relative))
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
        let (_, errors, _) = least(&kinds, Errors::Relative, &points, 5, &|| false).unwrap();
        assert!(errors[0] > 0.04 && errors[0] < 0.09 && errors[1] > 0.3, "{errors:?}");
    }
}
