//! Linear models about set points, out of stored dynamic models.
//!
//! ```text
//! y(t) = f(u, y):   rest y0 = f(u0, .., y0),    A(q) dy = sum_i B_i(q) du_i,
//! A = 1 - sum_j df/dy(t-j) q^j,    B_i = sum_k df/du_i(t-k) q^k     with exact derivatives, in the user's units
//! ```

use std::collections::BTreeMap;

use dynocal_ident::model::Run;
use dynocal_ident::stored::StoredModel;
use dynocal_numerics::rng::Rng64;
use serde::{Deserialize, Serialize};

use crate::error::ControlError;
use crate::system::{System, Time, Transfer};

/// Longest free run to rest, in samples.
const LONGEST: usize = 20_000;

/// A plant about a set point.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AtPoint {
    /// Channels of the point with their values.
    pub point: BTreeMap<String, f64>,
    /// Outputs at rest, in the order of the models.
    pub rest: Vec<f64>,
    /// The linear model: outputs of the models by the inputs that are moved.
    pub system: System,
    /// Largest size of a pole; 1 and more does not come to rest by itself.
    pub slowest_pole: f64,
    /// What was said of the point: it, or where a model comes to rest at it, is outside of what the model was identified on.
    pub warnings: Vec<String>,
}

/// Linear model of `models` (one for each output) from `moved` inputs about `point`, which has a value for every measured
/// input of the models.
///
/// # Errors
/// [`ControlError::Model`] naming the model and what is missing: channels, rest, sample times that differ.
pub fn about(
    models: &[&StoredModel],
    moved: &[String],
    point: &BTreeMap<String, f64>,
) -> Result<AtPoint, ControlError> {
    let sample_time_s = models.first().map_or(1.0, |m| m.sample_time_s);
    let (mut rest, mut channels, mut warnings) = (Vec::new(), Vec::new(), Vec::new());
    for model in models {
        let output = model.user_output().name;
        if (model.sample_time_s / sample_time_s - 1.0).abs() > 1e-9 {
            return Err(ControlError::Model(format!(
                "the model of `{output}` is sampled at {} s, that of `{}` at {sample_time_s} s: models of one loop need one sample time",
                model.sample_time_s,
                models[0].user_output().name
            )));
        }
        warnings.extend(outside(model, point));
        let one = single(model, moved, point)?;
        warnings.extend(rests_outside(model, one.rest));
        rest.push(one.rest);
        channels.extend(one.channels);
    }
    let time = Time::Sampled { sample_time_s };
    let system = System::new(time, models.len(), moved.len(), channels)?;
    let roots = system.poles.iter().flat_map(|p| crate::poly::roots(p).unwrap_or_default());
    let slowest_pole = roots.map(|r| 1.0 / r.norm()).fold(0.0, f64::max);
    Ok(AtPoint { point: point.clone(), rest, system, slowest_pole, warnings })
}

struct Single {
    rest: f64,
    channels: Vec<Transfer>,
}

fn single(
    model: &StoredModel,
    moved: &[String],
    point: &BTreeMap<String, f64>,
) -> Result<Single, ControlError> {
    let output = model.user_output().name;
    let refused = |text: String| ControlError::Model(format!("the model of `{output}`: {text}"));
    let driven = model.driven().map_err(|e| ControlError::Model(e.to_string()))?;
    let pointwise = model.pointwise().map_err(|e| ControlError::Model(e.to_string()))?;
    let names: Vec<String> = model.measured_inputs().into_iter().map(|q| q.name).collect();
    let row: Vec<f64> = names
        .iter()
        .map(|n| {
            let missing = || refused(format!("the set point has no value for its input `{n}`"));
            point.get(n).copied().filter(|v| v.is_finite()).ok_or_else(missing)
        })
        .collect::<Result<_, _>>()?;
    let paths = pointwise.paths(&names).map_err(|n| refused(format!("no channel `{n}`")))?;
    let u: Vec<f64> = paths.iter().map(|p| p.value(&row)).collect();
    let (lag, l) = (driven.model.max_lag(), driven.model.output_lag());
    // Started where its output was seen, so that of several rests the one is found that was measured.
    let seen = model.seen.iter().find(|s| s.name == output).map_or(0.0, |s| 0.5 * (s.minimum + s.maximum));
    let start = pointwise.from_user(seen);
    let rest = at_rest(&driven, &u, if start.is_finite() { start } else { 0.0 }).ok_or_else(|| {
        refused(format!("it does not come to rest at the set point within {LONGEST} samples"))
    })?;
    let window = driven.model.window().to_vec();
    let (w, n) = (window.len(), window.len() + l);
    let (mut grad, mut hess) = (vec![0.0; n], vec![0.0; n * n]);
    let rows: Vec<f64> = u.iter().copied().cycle().take(u.len() * (lag + 1)).collect();
    let y = vec![rest; lag + 1];
    driven.model.joint_derivatives(
        &driven.theta,
        &Run { u: &rows, y: &y, start: lag },
        lag,
        &mut grad,
        &mut hess,
    );
    let (to_user, _) = pointwise.output_slopes(rest);
    let den: Vec<f64> = std::iter::once(1.0).chain(grad[w..].iter().map(|g| -g)).collect();
    let longest = window.iter().map(|(_, k)| *k).max().unwrap_or(0);
    let channel = |name: &String| {
        let mut num = vec![0.0; longest + 1];
        if let Some(c) = names.iter().position(|n| n == name) {
            for ((input, k), g) in window.iter().zip(&grad) {
                num[*k] += g * paths[*input].slope(&row, c) * to_user;
            }
        }
        Transfer::sampled(&num, &den)
    };
    let channels: Vec<Transfer> = moved.iter().map(channel).collect();
    match channels.iter().flat_map(|g| g.num.iter().chain(&g.den)).all(|v| v.is_finite()) {
        true => Ok(Single { rest: pointwise.to_user(rest), channels }),
        false => Err(refused("its derivatives at the set point are no numbers".into())),
    }
}

/// Rest under constant inputs: a free run until it stands still.
fn at_rest(driven: &dynocal_ident::model::form::Driven, u: &[f64], start: f64) -> Option<f64> {
    let lag = driven.model.max_lag();
    let mut last = start;
    let block = (20 * (lag + 1)).max(500);
    let rows: Vec<f64> = u.iter().copied().cycle().take(u.len() * block).collect();
    for _ in 0..LONGEST / block + 1 {
        let before = vec![last; block];
        let mut y = vec![0.0; block];
        driven.model.simulate(&driven.theta, &Run { u: &rows, y: &before, start: lag }, &mut y);
        let end = *y.last()?;
        if !end.is_finite() {
            return None;
        }
        // Held at its end it must stay there: then it is a rest and no turning point.
        if (end - last).abs() <= 1e-10 * (1.0 + end.abs()) {
            return Some(end);
        }
        last = end;
    }
    None
}

fn outside(model: &StoredModel, point: &BTreeMap<String, f64>) -> Vec<String> {
    let beyond = |s: &&dynocal_ident::stored::Seen| {
        let slack = 1e-9 * (s.maximum - s.minimum).abs();
        point.get(&s.name).is_some_and(|v| *v < s.minimum - slack || *v > s.maximum + slack)
    };
    let words = |s: &dynocal_ident::stored::Seen| {
        format!(
            "`{}` = {} {} lies outside of what the model of `{}` was identified on ({} to {})",
            s.name,
            point[&s.name],
            s.unit,
            model.user_output().name,
            s.minimum,
            s.maximum
        )
    };
    model.seen.iter().filter(beyond).map(words).collect()
}

/// Inputs may each be in their range while all of them together were never there: the output tells.
fn rests_outside(model: &StoredModel, rest: f64) -> Option<String> {
    let output = model.user_output().name;
    let s = model.seen.iter().find(|s| s.name == output)?;
    let slack = 1e-9 * (s.maximum - s.minimum).abs();
    let out = !(rest >= s.minimum - slack && rest <= s.maximum + slack);
    out.then(|| {
        format!(
            "`{output}` comes to rest at {rest:.4} {}, outside of what its model was identified on ({} to {}): no record was near this set point",
            s.unit, s.minimum, s.maximum
        )
    })
}

/// A model with parameters drawn from their estimated distribution; none where the model keeps no covariance.
pub fn drawn(model: &StoredModel, seed: u64, draw: u64) -> Option<StoredModel> {
    let covariance = model.covariance()?;
    let p = model.parameters.len();
    let factor = factor(&covariance, p);
    let mut rng = Rng64::stream(seed, draw);
    let z: Vec<f64> = (0..p).map(|_| rng.normal()).collect();
    let mut out = model.clone();
    for (i, parameter) in out.parameters.iter_mut().enumerate() {
        parameter.value += (0..=i).map(|j| factor[i * p + j] * z[j]).sum::<f64>();
    }
    Some(out)
}

/// Lower factor of a covariance that may be singular: directions without variance do not move.
fn factor(c: &[f64], n: usize) -> Vec<f64> {
    let mut l = vec![0.0f64; n * n];
    for j in 0..n {
        let own: f64 = c[j * n + j] - (0..j).map(|k| l[j * n + k].powi(2)).sum::<f64>();
        if !(own > 1e-12 * c[j * n + j].abs()) {
            continue;
        }
        l[j * n + j] = own.sqrt();
        for i in j + 1..n {
            let sum: f64 = (0..j).map(|k| l[i * n + k] * l[j * n + k]).sum();
            l[i * n + j] = (c[i * n + j] - sum) / l[j * n + j];
        }
    }
    l
}
