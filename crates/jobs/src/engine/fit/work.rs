//! The search, and what it found.

use std::path::Path;

use dynocal_numerics::interval::Interval;
use dynocal_numerics::linalg::{cholesky, cholesky_inverse, symmetric_eigenvalues};
use dynocal_numerics::lm::{LeastSquares, LmOptions, levenberg_marquardt_interruptible};
use dynocal_numerics::status::Status;
use dynocal_numerics::watch::Watch;
use dynocal_plant::driven::{Answer, drive};
use dynocal_plant::engine::VirtualEngine;
use dynocal_plant::error::PlantError;
use dynocal_plant::params::EngineParams;
use rayon::prelude::*;

use super::constants::{CONSTANTS, Constant};
use super::problem::{Problem, bare, from, mean_square};
use super::read::{Measured, MeasuredMap, read};
use super::{COMPARED, Compare, Compared, FitResult, Fitted, JUDGED_OF_THREE, Score, Spec};
use crate::engine::{Engine, EngineJobError};

/// Two-sided 95 % of a normal distribution.
const NORMAL_95: f64 = 1.96;
/// Part of its range that an interval may reach to either side before the constant counts as not found.
const WIDE: f64 = 0.25;

/// Fits the engine to the map.
///
/// # Errors
/// [`EngineJobError`]: the map, a point at which the engine fails, an interruption.
pub fn run(engine: &Engine, spec: &Spec, watch: Watch) -> Result<FitResult, EngineJobError> {
    let map = read(&spec.map)?;
    let before = compare(&engine.params, &map.points, watch)?;
    let constants = movable(&engine.params, &map);
    let fitted: Vec<Measured> = before.iter().filter(|c| !c.judged).map(|c| c.measured).collect();
    let mut problem = Problem::new(&engine.params, constants.clone(), fitted, watch);
    let start = problem.start();
    let options = LmOptions {
        max_evaluations: spec.evaluations,
        cost_tolerance: 1e-4,
        gradient_tolerance: 1e-3,
        initial_radius: 1.0,
        ..LmOptions::default()
    };
    let found = levenberg_marquardt_interruptible(&mut problem, &start, &options, watch.interrupt);
    if watch.interrupted() {
        return Err(EngineJobError::Interrupted);
    }
    if let (false, Some(e)) = (found.cost.is_finite(), problem.error.take()) {
        return Err(e.into());
    }
    let (widths, condition) = half_widths(&mut problem, &found.x);
    let params = problem.params(&found.x);
    let after = compare(&params, &map.points, watch)?;
    let constants = described(&engine.params, &params, &constants, &widths);
    let m = problem.residuals().max(1) as f64;
    let first = found.history.first().map_or(f64::NAN, |h| h.objective / m);
    let scores = scores(&before, &after);
    let mut result = FitResult {
        set: engine.set.clone(),
        constants,
        status: found.status,
        evaluations: found.evaluations,
        cost: (first, found.cost / m),
        fitted_points: problem.points(),
        condition,
        notes: map.notes,
        warnings: Vec::new(),
        points: after,
        params: Some(params),
        scores,
    };
    result.warnings = warnings(&result);
    Ok(result)
}

/// Errors of a set as it is, on a map that it is not fitted to; the rows that judge and the others apart.
///
/// # Errors
/// As [`run`].
pub fn judge(
    engine: &Engine,
    map: &Path,
    watch: Watch,
) -> Result<(Vec<Score>, Vec<Compare>), EngineJobError> {
    let map = read(map)?;
    let points = compare(&engine.params, &map.points, watch)?;
    Ok((scores(&points, &points), points))
}

/// Constants that the engine has and about which the map says something.
fn movable(params: &EngineParams, map: &MeasuredMap) -> Vec<&'static Constant> {
    let mut p = params.clone();
    let first = &map.points[0];
    let cams = first.at.cams_deg.is_some();
    CONSTANTS
        .iter()
        .filter(|c| {
            c.needs.measured(first) && !(cams && c.key.starts_with("cams.")) && (c.place)(&mut p).is_some()
        })
        .collect()
}

/// All points of the map on an engine with these constants.
fn compare(params: &EngineParams, points: &[Measured], watch: Watch) -> Result<Vec<Compare>, EngineJobError> {
    let engine = VirtualEngine::new(&bare(params.clone()))?;
    let one = |e: &mut VirtualEngine, (k, m): (usize, &Measured)| -> Result<Option<Compare>, PlantError> {
        if watch.interrupted() {
            return Ok(None);
        }
        from(e, &engine, None)?;
        let answer = drive(e, &m.at)?;
        Ok(Some(Compare { row: k + 1, judged: k % 3 == JUDGED_OF_THREE, measured: *m, answer }))
    };
    let all: Option<Vec<Compare>> =
        points.par_iter().enumerate().map_init(|| engine.clone(), one).collect::<Result<_, _>>()?;
    all.ok_or(EngineJobError::Interrupted)
}

/// Half widths of the intervals of 95 % in z: 1.96 sqrt(s^2 (J'J)^-1_kk), s^2 the sum of squares over the degrees of freedom;
/// infinite where the derivatives do not determine a constant. With them the condition of J, its columns of unit length: how far the
/// constants stand in for each other.
fn half_widths(problem: &mut Problem, z: &[f64]) -> (Vec<f64>, Option<f64>) {
    let (n, m) = (problem.n(), problem.residuals());
    let (mut r, mut jac) = (vec![0.0; m], vec![0.0; m * n]);
    if m <= n || !problem.residual_jacobian(z, &mut r, &mut jac) {
        return (vec![f64::INFINITY; n], None);
    }
    let s2 = mean_square(&r) * m as f64 / (m - n) as f64;
    let mut gram = vec![0.0; n * n];
    for row in jac.chunks_exact(n) {
        for i in 0..n {
            for j in i..n {
                gram[i * n + j] += row[i] * row[j];
            }
        }
    }
    let condition = condition(&gram, n);
    // A little on the diagonal keeps the factor of a singular matrix, whose widths are then very large.
    for i in 0..n {
        gram[i * n + i] += 1e-9 + 1e-12 * gram[i * n + i];
    }
    let (mut work, mut inverse) = (vec![0.0; n * n], vec![0.0; n * n]);
    let solved = cholesky(&mut gram, n).and_then(|()| cholesky_inverse(&gram, n, &mut work, &mut inverse));
    let widths = match solved {
        Ok(()) => (0..n).map(|i| NORMAL_95 * (s2 * inverse[i * n + i]).sqrt()).collect(),
        Err(_) => vec![f64::INFINITY; n],
    };
    (widths, condition)
}

/// Condition of J from the upper half of J'J, columns of unit length: the root of its greatest over its least eigenvalue; none
/// where a column vanishes or an eigenvalue is lost in rounding.
fn condition(gram: &[f64], n: usize) -> Option<f64> {
    let length: Vec<f64> = (0..n).map(|i| gram[i * n + i].sqrt()).collect();
    if length.iter().any(|l| !(*l > 0.0)) {
        return None;
    }
    let scaled: Vec<f64> = (0..n * n)
        .map(|k| {
            let (i, j) = (k / n, k % n);
            gram[i.min(j) * n + i.max(j)] / (length[i] * length[j])
        })
        .collect();
    let values = symmetric_eigenvalues(&scaled, n).ok()?;
    let (least, most) = values.iter().fold((f64::INFINITY, 0.0f64), |(a, b), v| (a.min(*v), b.max(*v)));
    (least > 1e-12).then(|| (most / least).sqrt())
}

/// The constants before and after, with intervals.
fn described(
    before: &EngineParams,
    after: &EngineParams,
    constants: &[&'static Constant],
    half_z: &[f64],
) -> Vec<Fitted> {
    let (mut p0, mut p1) = (before.clone(), after.clone());
    let one = |(c, half_z): (&&'static Constant, &f64)| {
        let at = |p: &mut EngineParams| (c.place)(p).map_or(f64::NAN, |v| *v);
        let (start, value) = (at(&mut p0), at(&mut p1));
        let (low, high) = c.range;
        let half = 0.5 * (high - low);
        let sine = ((value - low) / half - 1.0).clamp(-1.0, 1.0);
        let width = half * (1.0 - sine * sine).sqrt() * half_z;
        let at_end = (value - low).min(high - value) < 0.005 * (high - low);
        let wide = !(width < WIDE * (high - low));
        let note = match (at_end, wide) {
            (true, _) => {
                Some("stands at the end of its range: the points ask for more than the constant may give")
            }
            (_, true) => Some("these points do not determine it"),
            _ => None,
        };
        let half_width = (!at_end && !wide).then_some(width);
        Fitted { key: c.key, what: c.what, range: Interval::new(low, high), start, value, half_width, note }
    };
    constants.iter().zip(half_z).map(one).collect()
}

/// Errors of each quantity that was measured.
fn scores(before: &[Compare], after: &[Compare]) -> Vec<Score> {
    let errors = |of: &[Compare], judged: bool, q: Compared| -> Vec<f64> {
        let one = |c: &Compare| (c.judged == judged).then(|| q.error(&c.answer, &c.measured)).flatten();
        of.iter().filter_map(one).collect()
    };
    let rms = |e: &[f64]| (e.iter().map(|v| v * v).sum::<f64>() / e.len().max(1) as f64).sqrt();
    let score = |q: &Compared| {
        let judged = errors(after, true, *q);
        let (quantity, asked, unit) = q.asked();
        (!judged.is_empty()).then(|| Score {
            quantity,
            unit,
            asked,
            points: judged.len(),
            before: rms(&errors(before, true, *q)),
            fitted: rms(&errors(after, false, *q)),
            judged: rms(&judged),
            bias: judged.iter().sum::<f64>() / judged.len() as f64,
            worst: judged.iter().copied().fold(0.0, |w: f64, e| if e.abs() > w.abs() { e } else { w }),
        })
    };
    COMPARED.iter().filter_map(score).collect()
}

/// What stands in the way of trusting the result.
fn warnings(found: &FitResult) -> Vec<String> {
    let mut all = Vec::new();
    for s in found.scores.iter().filter(|s| !(s.judged <= s.asked)) {
        let Score { quantity, judged, unit, asked, .. } = s;
        all.push(format!("{quantity}: {judged:.2} {unit} on the judged points, asked {asked} {unit}"));
    }
    let moving = found.points.iter().filter(|c| !c.answer.settled).count();
    if moving > 0 {
        all.push(format!("{moving} of {} points did not stand still", found.points.len()));
    }
    let surplus = |a: &Answer| a.surplus.abs() > 0.02;
    let short = found.points.iter().filter(|c| surplus(&c.answer) && c.answer.surplus < 0.0).count();
    if short > 0 {
        all.push(format!("{short} points ask for more boost than the turbine gives with the wastegate shut"));
    }
    if !found.status.is_success() {
        let n = found.evaluations;
        all.push(match found.status {
            Status::Limit => format!(
                "the search used up its {n} evaluations before it converged: give it more with --evaluations"
            ),
            Status::Diverged => {
                "the search could not begin: the engine cannot be computed with the constants it starts from"
                    .into()
            }
            _ => format!("the search did not converge, it ended after {n} evaluations"),
        });
    }
    all
}
