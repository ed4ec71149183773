//! The kind of a response model for optimisation: least error in folds, with an error of the whole choice from outer folds.
//!
//! The rule of one standard error (`best_of`) prefers the simpler kind where the errors of the kinds scatter, and one odd point is
//! enough for that. A description loses little by it; an optimum is sought where a rough model errs most, and finds that.

use dynocal_ident::model::response::score::{FoldKind, folds};
use dynocal_ident::model::response::{Ask, Learn, Learnt, Points, Prediction, Response, ResponseError};

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

/// Chooses among `kinds` (name, kind) by `count` folds and learns the choice on all points.
///
/// # Errors
/// [`ResponseError`] when no kind can be learnt.
pub(super) fn choose(
    kinds: &[(String, Box<dyn Learn>)],
    points: &Points,
    count: usize,
    nested: bool,
    interrupt: &dyn Fn() -> bool,
) -> Result<Chosen, ResponseError> {
    let (chosen, errors) = least(kinds, points, count, interrupt)?;
    let name = |k: usize| kinds[k].0.clone();
    let (mut rmse, mut same) = (errors[chosen], 0);
    if nested {
        let mut squares = 0.0;
        let outer = folds(points, count, FoldKind::Interleaved);
        for held in &outer {
            let part = without(points, held);
            let (inner, _) = least(kinds, &part, count, interrupt)?;
            same += usize::from(inner == chosen);
            squares += squares_of(&*kinds[inner].1, &part, points, held, interrupt)?;
        }
        rmse = (squares / points.len() as f64).sqrt();
    }
    let each: Vec<String> = errors.iter().enumerate().map(|(k, e)| format!("{} {e:.4}", name(k))).collect();
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

/// The kind of least error in folds, and the errors of all; those that cannot be learnt have an infinite one.
fn least(
    kinds: &[(String, Box<dyn Learn>)],
    points: &Points,
    count: usize,
    interrupt: &dyn Fn() -> bool,
) -> Result<(usize, Vec<f64>), ResponseError> {
    let parts = folds(points, count, FoldKind::Interleaved);
    let (mut errors, mut why) = (Vec::new(), None);
    for (_, kind) in kinds {
        let each =
            parts.iter().map(|held| squares_of(&**kind, &without(points, held), points, held, interrupt));
        match each.sum::<Result<f64, ResponseError>>() {
            Ok(sum) => errors.push((sum / points.len() as f64).sqrt()),
            Err(e) => {
                errors.push(f64::INFINITY);
                why = Some(e);
            }
        }
    }
    let best = (0..errors.len()).filter(|k| errors[*k].is_finite());
    match (best.min_by(|a, b| errors[*a].total_cmp(&errors[*b])), why) {
        (Some(best), _) => Ok((best, errors)),
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

/// Sum of the squared errors of `kind`, learnt on `part`, at the rows `held`.
fn squares_of(
    kind: &dyn Learn,
    part: &Points,
    points: &Points,
    held: &[usize],
    interrupt: &dyn Fn() -> bool,
) -> Result<f64, ResponseError> {
    let learnt = kind.learn(part, interrupt)?;
    let mut at = Prediction::new(points.dim());
    let square = |i: &usize| {
        learnt.model.predict(points.row(*i), Ask::Mean, &mut at);
        (points.y[*i] - at.mean).powi(2)
    };
    Ok(held.iter().map(square).sum())
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
        let found = choose(&kinds(), &points, 5, true, &|| false).unwrap();
        assert!(found.words.contains("degree 2 is taken"), "{}", found.words);
        // The odd point is in one fold and cannot be told beforehand: 0.5 / sqrt(30).
        assert!(found.rmse > 0.08 && found.rmse < 0.12, "{}", found.rmse);
        assert!(found.widen >= 1.0 && found.widen.is_finite());
    }
}
