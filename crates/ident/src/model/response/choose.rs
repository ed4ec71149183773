//! Choice among candidates by nested validation with the rule of one standard error.
//!
//! Inner folds: each candidate's mean squared error over the folds, with its standard error. The first candidate of the list
//! (the simplest comes first) whose error is at most the least one plus one standard error of that one is taken. Outer folds:
//! the same choice without each of them in turn, tested on it. That error is of the whole procedure: many candidates on few
//! points find one that fits by chance, and only the outer folds show it.
//!
//! Sources: L. Breiman, J. Friedman, R. Olshen, C. Stone, Classification and Regression Trees (1984), section 3.4.3; G. C.
//! Cawley, N. L. C. Talbot, On over-fitting in model selection, JMLR 11 (2010), 2079-2107.

use serde::{Deserialize, Serialize};

use super::points::four;
use super::score::{FoldKind, folds, held_out};
use super::{Ask, Learn, Learnt, Points, Prediction, Response, ResponseError};

/// A kind with the name that the report gives it.
pub struct Candidate {
    /// Name.
    pub name: String,
    /// Kind and keys.
    pub kind: Box<dyn Learn>,
}

/// Error of a candidate in the inner folds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CandidateError {
    /// Name.
    pub name: String,
    /// Root of the mean squared error over the folds, in the unit of the output.
    pub rmse: f64,
    /// Standard error of that number.
    pub standard_error: f64,
    /// Why it could not be learnt, where it could not.
    pub failed: Option<String>,
}

/// What was chosen, and why.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Choice {
    /// Place in the list of candidates.
    pub chosen: usize,
    /// All candidates.
    pub candidates: Vec<CandidateError>,
    /// Root mean square error of the whole procedure on points that had no part in it.
    pub nested_rmse: f64,
    /// Name that each outer fold chose.
    pub outer: Vec<String>,
    /// The result in words.
    pub words: String,
}

/// Chooses by `count` inner and outer folds and learns the choice on all points.
///
/// # Errors
/// [`ResponseError`] when no candidate can be learnt.
pub fn choose(
    candidates: &[Candidate],
    points: &Points,
    count: usize,
    how: FoldKind,
    interrupt: &dyn Fn() -> bool,
) -> Result<(Learnt, Choice), ResponseError> {
    let (chosen, errors) = by_one_standard_error(candidates, points, count, how, interrupt)?;
    let (mut squares, mut outer) = (0.0, Vec::new());
    let mut at = Prediction::new(points.dim());
    for held in folds(points, count, how) {
        let rest: Vec<usize> = (0..points.len()).filter(|i| !held.contains(i)).collect();
        let part = points.rows(&rest);
        let (inner, _) = by_one_standard_error(candidates, &part, count, how, interrupt)?;
        let learnt = candidates[inner].kind.learn(&part, interrupt)?;
        outer.push(candidates[inner].name.clone());
        for i in held {
            learnt.model.predict(points.row(i), Ask::Mean, &mut at);
            squares += (points.y[i] - at.mean).powi(2);
        }
    }
    let nested_rmse = (squares / points.len() as f64).sqrt();
    let words = in_words(&points.output, candidates, chosen, &errors, nested_rmse, &outer);
    let learnt = candidates[chosen].kind.learn(points, interrupt)?;
    Ok((learnt, Choice { chosen, candidates: errors, nested_rmse, outer, words }))
}

/// The inner choice.
fn by_one_standard_error(
    candidates: &[Candidate],
    points: &Points,
    count: usize,
    how: FoldKind,
    interrupt: &dyn Fn() -> bool,
) -> Result<(usize, Vec<CandidateError>), ResponseError> {
    let parts = folds(points, count, how);
    let mut errors = Vec::new();
    // Mean squared error and its standard error.
    let mut squares: Vec<Option<(f64, f64)>> = Vec::new();
    let mut last = None;
    for candidate in candidates {
        let name = candidate.name.clone();
        match held_out(&*candidate.kind, points, &parts, interrupt) {
            Ok(held) => {
                let k = held.by_fold.len() as f64;
                let mean = held.by_fold.iter().sum::<f64>() / k;
                let spread = held.by_fold.iter().map(|m| (m - mean).powi(2)).sum::<f64>() / (k - 1.0);
                let error = (spread / k).sqrt();
                squares.push(Some((mean, error)));
                // Of the root, to first order.
                let standard_error = 0.5 * error / mean.sqrt().max(f64::MIN_POSITIVE);
                errors.push(CandidateError { name, rmse: mean.sqrt(), standard_error, failed: None });
            }
            Err(e) => {
                squares.push(None);
                let failed = Some(e.to_string());
                errors.push(CandidateError {
                    name,
                    rmse: f64::INFINITY,
                    standard_error: f64::INFINITY,
                    failed,
                });
                last = Some(e);
            }
        }
    }
    let best = squares.iter().flatten().copied().min_by(|a, b| a.0.total_cmp(&b.0));
    match (best, last) {
        (Some((mean, error)), _) => {
            let within = |s: &Option<(f64, f64)>| s.is_some_and(|(m, _)| m <= mean + error);
            Ok((squares.iter().position(within).unwrap_or(0), errors))
        }
        (None, Some(e)) => Err(e),
        (None, None) => Err(ResponseError::Key {
            model: "choice",
            key: "candidates",
            found: "none".into(),
            expected: "at least one".into(),
        }),
    }
}

fn in_words(
    output: &str,
    candidates: &[Candidate],
    chosen: usize,
    errors: &[CandidateError],
    nested_rmse: f64,
    outer: &[String],
) -> String {
    let least = (0..errors.len()).min_by(|a, b| errors[*a].rmse.total_cmp(&errors[*b].rmse)).unwrap_or(0);
    let name = &candidates[chosen].name;
    let same = outer.iter().filter(|o| *o == name).count();
    let why = if least == chosen {
        format!("it has the least error in the folds ({})", four(errors[chosen].rmse))
    } else {
        format!(
            "its error in the folds ({}) is within one standard error of the least ({}, {}), and it is simpler",
            four(errors[chosen].rmse),
            four(errors[least].rmse),
            candidates[least].name
        )
    };
    format!(
        "`{output}`: {name} is taken, as {why}. The whole choice, tested on points that had no part in it, has an error of \
         {}; {same} of {} such tests chose the same.",
        four(nested_rmse),
        outer.len()
    )
}
