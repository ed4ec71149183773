//! One score page for every kind of response model.

use dynocal_numerics::rng::Rng64;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::points::range;
use super::{Ask, Learn, LeftOut, Points, Prediction, Response, ResponseError, ResponseModel};

/// Two-sided 95 % of a normal distribution.
const BAND: f64 = 1.959_963_984_540_054;
/// Points of an intersection plot.
const CURVE: usize = 41;
/// Operating points to a fold from which on all points of one stay together.
const TOGETHER: usize = 5;
/// Stream of the generator that deals the points to the folds.
const DEAL: u64 = 6 << 32;
/// Draws of the sensitivity indices.
const DRAWS: usize = 2048;

/// How points are held out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FoldKind {
    /// Dealt by a seeded shuffle, all points of one operating point together where there are five operating points or more to a
    /// fold (of fewer, a fold would take the corners of a plan away): held-out points have neighbours in the fit, but no copies,
    /// whatever the order of the table is.
    #[default]
    Shuffled,
    /// Every k-th point. In a table of five loads at each speed, five folds are its five loads.
    Interleaved,
    /// Blocks of consecutive rows: what lies between or beyond what was measured, in tables that are in order.
    Blocks,
}

/// Rows (from 0) of each fold: at least two folds and at most one an operating point.
pub fn folds(points: &Points, count: usize, kind: FoldKind) -> Vec<Vec<usize>> {
    let n = points.len();
    let number_of = |places: &[usize]| places.iter().max().map_or(0, |k| k + 1);
    let together = Some(points.operating_points())
        .filter(|p| kind == FoldKind::Shuffled && number_of(p) >= TOGETHER * count);
    let places = together.unwrap_or_else(|| (0..n).collect());
    let different = number_of(&places);
    let count = count.clamp(2, different.max(2));
    let turn = if kind == FoldKind::Shuffled { shuffled(different, DEAL) } else { (0..different).collect() };
    let of = |i: usize| match kind {
        FoldKind::Shuffled | FoldKind::Interleaved => turn[places[i]] % count,
        FoldKind::Blocks => i * count / n.max(1),
    };
    (0..count).map(|k| (0..n).filter(|i| of(*i) == k).collect()).collect()
}

/// The numbers from 0 to n - 1 in an order that the seed gives.
pub(super) fn shuffled(n: usize, seed: u64) -> Vec<usize> {
    let mut order: Vec<usize> = (0..n).collect();
    let mut rng = Rng64::stream(0, seed);
    for i in (1..n).rev() {
        order.swap(i, rng.below(i + 1));
    }
    order
}

/// Errors on points that had no part in a fit.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Unseen {
    /// Number of points.
    pub points: usize,
    /// Root mean square of the errors, in the unit of the output.
    pub rmse: f64,
    /// The same over the range of the measured output.
    pub of_range: f64,
    /// Share of the points inside the 95 % band of a measurement.
    pub coverage: f64,
    /// Mean of the squared errors over their predicted variances: 1 where the variance is right.
    pub variance_ratio: f64,
}

impl Unseen {
    /// From errors and predicted variances of measurements.
    pub fn of(errors: &[f64], variance: &[f64], output_range: f64) -> Self {
        let n = errors.len().max(1) as f64;
        let rmse = (errors.iter().map(|e| e * e).sum::<f64>() / n).sqrt();
        let pairs = || errors.iter().zip(variance);
        let inside = pairs().filter(|(e, v)| e.abs() <= BAND * v.max(0.0).sqrt()).count();
        let ratio = pairs().map(|(e, v)| e * e / v.max(f64::MIN_POSITIVE)).sum::<f64>() / n;
        Self {
            points: errors.len(),
            rmse,
            of_range: rmse / output_range,
            coverage: inside as f64 / n,
            variance_ratio: ratio,
        }
    }

    /// A model on points that it has not seen.
    pub fn on(model: &dyn Response, points: &Points) -> Self {
        let (errors, variance) = errors(model, points);
        Self::of(&errors, &variance, points.output_range())
    }
}

/// Measured minus predicted, and the predicted variance of a measurement.
pub fn errors(model: &dyn Response, points: &Points) -> (Vec<f64>, Vec<f64>) {
    let mut at = Prediction::new(points.dim());
    let each = (0..points.len()).map(|i| {
        model.predict(points.row(i), Ask::Variance, &mut at);
        (points.y[i] - at.mean, at.variance + at.noise)
    });
    each.unzip()
}

/// What is said about one candidate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScorePage {
    /// Kind and size.
    pub what: String,
    /// Left-out points in closed form (PRESS is their sum of squares).
    pub left_out: Unseen,
    /// Sum of squares of the left-out residuals.
    pub press: f64,
    /// Folds, each learnt again with everything that is chosen from data; none where a choice was validated by folds of its own.
    pub folds: Option<Unseen>,
    /// Points that were kept apart, where there are any.
    pub unseen: Option<Unseen>,
    /// Measured output, and its prediction from the other points: one entry per point.
    pub measured: Vec<f64>,
    /// That prediction.
    pub predicted: Vec<f64>,
    /// Left-out residuals (measured minus predicted).
    pub residuals: Vec<f64>,
    /// The inputs that they are drawn over, one entry per point each.
    pub inputs: Vec<InputColumn>,
    /// Sections through the middle of the points.
    pub intersections: Vec<Intersection>,
    /// Which input moves the output, alone and together with others.
    pub sensitivity: Vec<Sensitivity>,
    /// Sentences of the fit.
    pub notes: Vec<String>,
}

/// One input of all points.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct InputColumn {
    /// Input.
    pub input: String,
    /// Its values.
    pub x: Vec<f64>,
}

/// The response over one input, the others at the median of the points.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Intersection {
    /// Input.
    pub input: String,
    /// Its values.
    pub x: Vec<f64>,
    /// Response.
    pub mean: Vec<f64>,
    /// Half width of the 95 % band of the response.
    pub half_width: Vec<f64>,
}

/// Shares of the variance of the response over the box of the points.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sensitivity {
    /// Input.
    pub input: String,
    /// Main effect: what this input explains alone.
    pub main: f64,
    /// Total effect: what goes if it is known together with all its interactions.
    pub total: f64,
}

/// Learns a kind on all points and in folds, and scores it.
///
/// # Errors
/// [`ResponseError`] when the fit on all points fails, or one of the folds.
pub fn score_page(
    kind: &dyn Learn,
    points: &Points,
    unseen: Option<&Points>,
    count: usize,
    how: FoldKind,
    interrupt: &dyn Fn() -> bool,
) -> Result<(ResponseModel, ScorePage), ResponseError> {
    let learnt = kind.learn(points, interrupt)?;
    let held = by_folds(kind, points, count, how, interrupt)?;
    let page = score_learnt(&learnt.model, &learnt.left_out, points, unseen, Some(held), learnt.notes);
    Ok((learnt.model, page))
}

/// Learns without each of `count` folds in turn.
///
/// # Errors
/// [`ResponseError`] when one of the folds cannot be learnt.
pub fn by_folds(
    kind: &dyn Learn,
    points: &Points,
    count: usize,
    how: FoldKind,
    interrupt: &dyn Fn() -> bool,
) -> Result<Unseen, ResponseError> {
    let held = held_out(kind, points, &folds(points, count, how), interrupt)?;
    Ok(Unseen::of(&held.errors, &held.variance, points.output_range()))
}

/// The page of a model that was learnt already.
pub fn score_learnt(
    model: &ResponseModel,
    left_out: &LeftOut,
    points: &Points,
    unseen: Option<&Points>,
    folds: Option<Unseen>,
    notes: Vec<String>,
) -> ScorePage {
    let LeftOut { residuals, variance } = left_out.clone();
    let column = |j: usize| InputColumn { input: points.inputs[j].clone(), x: points.column(j).collect() };
    ScorePage {
        what: model.describe(),
        left_out: Unseen::of(&residuals, &variance, points.output_range()),
        press: residuals.iter().map(|e| e * e).sum(),
        folds,
        unseen: unseen.map(|p| Unseen::on(model, p)),
        measured: points.y.clone(),
        predicted: points.y.iter().zip(&residuals).map(|(y, e)| y - e).collect(),
        residuals,
        inputs: (0..points.dim()).map(column).collect(),
        intersections: intersections(model, points),
        sensitivity: sensitivity(model, points, 0),
        notes,
    }
}

/// Errors of all held-out points, fold by fold.
pub(super) struct Held {
    pub(super) errors: Vec<f64>,
    pub(super) variance: Vec<f64>,
    /// Mean squared error of each fold.
    pub(super) by_fold: Vec<f64>,
}

/// Learns without each fold in turn and predicts it.
pub(super) fn held_out(
    kind: &dyn Learn,
    points: &Points,
    folds: &[Vec<usize>],
    interrupt: &dyn Fn() -> bool,
) -> Result<Held, ResponseError> {
    let parts = folds.iter().enumerate().map(|(k, held)| {
        let rest: Vec<usize> = (0..points.len()).filter(|i| !held.contains(i)).collect();
        let in_fold = |source| ResponseError::Fold {
            fold: k + 1,
            folds: folds.len(),
            points: rest.len(),
            source: Box::new(source),
        };
        let learnt = kind.learn(&points.rows(&rest), interrupt).map_err(in_fold)?;
        Ok(errors(&learnt.model, &points.rows(held)))
    });
    let parts = parts.collect::<Result<Vec<_>, ResponseError>>()?;
    let mean_square = |e: &[f64]| e.iter().map(|e| e * e).sum::<f64>() / e.len().max(1) as f64;
    let by_fold = parts.iter().map(|(e, _)| mean_square(e)).collect();
    let (errors, variance): (Vec<_>, Vec<_>) = parts.into_iter().unzip();
    Ok(Held { errors: errors.concat(), variance: variance.concat(), by_fold })
}

/// Sections along every input through the median of the points.
pub fn intersections(model: &dyn Response, points: &Points) -> Vec<Intersection> {
    let d = points.dim();
    let median = |j: usize| {
        let mut column: Vec<f64> = points.column(j).collect();
        column.sort_by(f64::total_cmp);
        column[column.len() / 2]
    };
    let middle: Vec<f64> = (0..d).map(median).collect();
    let mut at = Prediction::new(d);
    let section = |j: usize| {
        let (low, high) = range(points.column(j));
        let mut section = Intersection {
            input: points.inputs[j].clone(),
            x: Vec::with_capacity(CURVE),
            mean: Vec::with_capacity(CURVE),
            half_width: Vec::with_capacity(CURVE),
        };
        let mut x = middle.clone();
        for i in 0..CURVE {
            x[j] = low + (high - low) * i as f64 / (CURVE - 1) as f64;
            model.predict(&x, Ask::Variance, &mut at);
            section.x.push(x[j]);
            section.mean.push(at.mean);
            section.half_width.push(BAND * at.variance.sqrt());
        }
        section
    };
    (0..d).map(section).collect()
}

/// Sobol indices of the mean response for independent inputs, uniform over the box of the points:
///
/// ```text
/// main_j = 1 - E (f(B) - f(A_B,j))^2 / (2 var f),   total_j = E (f(A) - f(A_B,j))^2 / (2 var f)
/// ```
///
/// A, B are independent draws and A_B,j is A with input j from B. Source: M. J. W. Jansen, Analysis of variance designs for
/// model output, Comput. Phys. Commun. 117 (1999), 35-43.
pub fn sensitivity(model: &dyn Response, points: &Points, seed: u64) -> Vec<Sensitivity> {
    let d = points.dim();
    let limits: Vec<(f64, f64)> = (0..d).map(|j| range(points.column(j))).collect();
    let mut rng = Rng64::new(seed);
    let mut draw = || -> Vec<f64> {
        (0..DRAWS)
            .flat_map(|_| limits.iter().map(|(l, h)| rng.uniform_in(*l, *h)).collect::<Vec<f64>>())
            .collect()
    };
    let (a, b) = (draw(), draw());
    let evaluate = |x: &[f64]| -> Vec<f64> {
        x.par_chunks_exact(d)
            .map_init(
                || Prediction::new(d),
                |at, x| {
                    model.predict(x, Ask::Mean, at);
                    at.mean
                },
            )
            .collect()
    };
    let (fa, fb) = (evaluate(&a), evaluate(&b));
    let both: Vec<f64> = fa.iter().chain(&fb).copied().collect();
    let mean = both.iter().sum::<f64>() / both.len() as f64;
    let variance = both.iter().map(|f| (f - mean).powi(2)).sum::<f64>() / both.len() as f64;
    let half = |x: &[f64], y: &[f64]| -> f64 {
        x.iter().zip(y).map(|(x, y)| (x - y).powi(2)).sum::<f64>() / (2.0 * DRAWS as f64 * variance)
    };
    let index = |j: usize| {
        let mut mixed = a.clone();
        (0..DRAWS).for_each(|i| mixed[i * d + j] = b[i * d + j]);
        let fm = evaluate(&mixed);
        Sensitivity { input: points.inputs[j].clone(), main: 1.0 - half(&fb, &fm), total: half(&fa, &fm) }
    };
    (0..d).map(index).collect()
}
