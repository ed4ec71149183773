//! Response models of the day: one for each response, chosen by nested validation.

use dynocal_calib::steady::day::{DayPoint, Drift, Purpose, corrected};
use dynocal_calib::steady::layout::{Layout, ResponseChannel, ResponseSource};
use dynocal_ident::model::response::mean_of::together;
use dynocal_ident::model::response::score::{ScorePage, score_learnt};
use dynocal_ident::model::response::{
    Ask, Learnt, Points, Prediction, Response, ResponseError, ResponseModel, learner,
};
use dynocal_numerics::watch::Watch;
use serde::Serialize;

use super::choose::{Chosen, Kinds, choose, errors_of};
use super::error::MapError;
use super::spec::{Errors, ModelsSpec};

/// A response with its model.
#[derive(Clone, Debug, Serialize)]
pub struct Learned {
    /// Response.
    pub response: String,
    /// Unit.
    pub unit: String,
    /// Kind and size.
    pub what: String,
    /// How it was chosen.
    pub choice: String,
    /// Points that it was learnt from.
    pub points: usize,
    /// RMS error on points that had no part in learning and choosing.
    pub rmse: f64,
    /// Factor by which its standard deviations are wider than those of the model alone, so that held-out points lie in their
    /// intervals.
    pub widen: f64,
    /// Standard deviation of the measured response over the points.
    pub spread: f64,
    /// Whether any point stood at the lower and at the upper end of the range of a driven input; both for all other responses.
    pub met: [bool; 2],
    /// Residuals, sections, effects.
    #[serde(skip)]
    pub page: ScorePage,
    /// The model.
    #[serde(skip)]
    pub model: ResponseModel,
    /// Numbers of the candidates that it is the mean of.
    #[serde(skip)]
    pub(super) taken: Vec<usize>,
}

impl Learned {
    /// Share of the variance that the procedure explains on points that had no part in it.
    pub fn explained(&self) -> f64 {
        1.0 - (self.rmse / self.spread).powi(2)
    }
}

impl Response for Learned {
    fn dim(&self) -> usize {
        self.model.dim()
    }

    fn predict(&self, x: &[f64], ask: Ask, out: &mut Prediction) {
        self.model.predict(x, ask, out);
        let squared = self.widen * self.widen;
        if ask >= Ask::Variance {
            out.variance *= squared;
            out.noise *= squared;
        }
        if ask >= Ask::Gradient {
            out.variance_gradient.iter_mut().for_each(|g| *g *= squared);
        }
        if ask >= Ask::Hessian {
            out.variance_hessian.iter_mut().for_each(|h| *h *= squared);
        }
    }

    fn describe(&self) -> String {
        self.what.clone()
    }
}

/// The candidates with the names that reports give them.
pub(super) fn kinds(models: &ModelsSpec) -> Result<Kinds, MapError> {
    let one = |table: &toml::Table| {
        let mut keys = table.clone();
        let kind = keys.remove("kind").and_then(|v| v.as_str().map(str::to_string)).unwrap_or_default();
        let said: Vec<String> = keys.iter().map(|(k, v)| format!("{k} = {v}")).collect();
        let name = if said.is_empty() { kind.clone() } else { format!("{kind} ({})", said.join(", ")) };
        Ok((name, learner(&kind, &keys)?))
    };
    models.candidates.iter().map(one).collect()
}

/// Usable points of the day as a table for response `k`.
pub(super) fn table(layout: &Layout, points: &[DayPoint], drift: &[Drift], k: usize) -> Points {
    let used = points.iter().filter(|p| p.purpose != Purpose::Verify && p.point.usable).map(|p| &p.point);
    Points {
        inputs: layout.factor_names(),
        output: layout.responses[k].name.clone(),
        x: used.clone().flat_map(|p| p.factors.iter().copied()).collect(),
        y: used.map(|p| corrected(p, k, drift)).collect(),
    }
}

/// Share of its range within which a driven input stands at an end.
const AT_END: f64 = 0.01;

/// Whether points, used or not, stood at the ends of the range of response `k`, where that is a driven input. Loops would have gone there had a
/// demand asked for it: what a model says beyond ends that none has seen is a fault of the model.
fn met(layout: &Layout, points: &[DayPoint], k: usize) -> [bool; 2] {
    let ResponseSource::Driven(input) = layout.responses[k].source else { return [true; 2] };
    let i = &layout.problem.inputs[input];
    let near = AT_END * (i.upper - i.lower);
    let stood = |p: &DayPoint| {
        let (u, held_there) = (p.point.responses[k], p.point.saturated.contains(&i.name));
        let lower = u - i.lower < i.upper - u;
        // Not a number where nothing was measured.
        [
            u <= i.lower + near || held_there && lower,
            u >= i.upper - near || held_there && !lower && u.is_finite(),
        ]
    };
    points.iter().map(stood).fold([false; 2], |a, b| [a[0] || b[0], a[1] || b[1]])
}

/// Least share of the variance that a model has to explain on unseen points, or it has not found anything.
const SIGNAL: f64 = 0.1;

/// Models of all responses but a slow one; `nested`: the choice of their kinds is tested on points that had no part in it.
///
/// # Errors
/// [`MapError::Learn`], and [`MapError::NoSignal`] for a response that is minimised or may touch its limit and does not depend on
/// what is moved as far as the points show.
pub(super) fn learn(
    layout: &Layout,
    points: &[DayPoint],
    drift: &[Drift],
    spec: &ModelsSpec,
    nested: bool,
    watch: Watch,
) -> Result<Vec<Learned>, MapError> {
    let (kinds, mut all) = (kinds(spec)?, Vec::new());
    // What is slow has not come to rest where it was measured: no model expects it. It is the last one.
    for (k, r) in layout.responses.iter().enumerate().filter(|(_, r)| !r.slow) {
        if watch.interrupted() {
            return Err(MapError::Interrupted);
        }
        watch.note(&format!("response model of {}", r.name));
        let table = table(layout, points, drift, k);
        let refused = |source: ResponseError| MapError::Learn { response: r.name.clone(), source };
        let driven = matches!(r.source, ResponseSource::Driven(_));
        // An opening goes through a decade: a model that is some degrees off everywhere knows nothing of the lower end of its range.
        let asked = if driven { Errors::Relative } else { spec.errors };
        let by = if driven || r.weight != 0.0 { errors_of(asked, &table.y) } else { Errors::Absolute };
        let Chosen { learnt, rmse, widen, words, taken } =
            choose(&kinds, by, &table, spec.folds, nested, watch.interrupt).map_err(refused)?;
        let n = table.len() as f64;
        let mean = table.y.iter().sum::<f64>() / n;
        let spread = (table.y.iter().map(|y| (y - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
        let page = score_learnt(&learnt.model, &learnt.left_out, &table, None, None, learnt.notes.clone());
        let found = Learned {
            response: r.name.clone(),
            unit: r.unit.clone(),
            what: page.what.clone(),
            choice: words,
            points: table.len(),
            rmse,
            widen,
            spread,
            met: met(layout, points, k),
            page,
            model: learnt.model,
            taken,
        };
        let near = |limit: f64| (limit - mean).abs() < 6.0 * spread;
        // The map of an input that a loop drives is trimmed by its loop: a rough model is said, not refused.
        let matters = !driven && (r.weight != 0.0 || [r.lower, r.upper].into_iter().flatten().any(near));
        if matters && found.explained() < SIGNAL {
            return Err(MapError::NoSignal {
                response: r.name.clone(),
                unit: r.unit.clone(),
                rmse,
                spread,
                points: table.len(),
            });
        }
        all.push(found);
    }
    Ok(all)
}

/// Models of what is minimised, of the same kinds learnt once more with points of lines: `points` are all of them, `more` the number of the new ones. The others
/// stay. What is said of their errors, and how much their intervals are widened, is by points that had no part in it: those of lines stand beside each other, and
/// folds of them would choose the kind that follows lines.
///
/// # Errors
/// [`MapError::Interrupted`].
pub(super) fn again(
    models: &[Learned],
    layout: &Layout,
    points: &[DayPoint],
    more: usize,
    drift: &[Drift],
    spec: &ModelsSpec,
    watch: Watch,
) -> Result<Vec<Learned>, MapError> {
    let kinds = kinds(spec)?;
    let one = |(k, (r, before)): (usize, (&ResponseChannel, &Learned))| {
        if r.weight == 0.0 {
            return Ok(before.clone());
        }
        watch.note(&format!("response model of {} with what lines showed", r.name));
        let table = table(layout, points, drift, k);
        let learnt: Result<Vec<Learnt>, _> =
            before.taken.iter().map(|kind| kinds[*kind].1.learn(&table, watch.interrupt)).collect();
        if watch.interrupted() {
            return Err(MapError::Interrupted);
        }
        // What cannot be learnt with them stays what it was.
        let Some(learnt) = learnt.ok().filter(|all| !all.is_empty()).map(together) else {
            return Ok(before.clone());
        };
        let page = score_learnt(&learnt.model, &learnt.left_out, &table, None, None, learnt.notes.clone());
        Ok(Learned {
            what: page.what.clone(),
            choice: format!("{} It was learnt again with {more} points of lines.", before.choice),
            points: table.len(),
            page,
            model: learnt.model,
            ..before.clone()
        })
    };
    layout.responses.iter().zip(models).enumerate().map(one).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use dynocal_calib::problem::CalibrationProblem;
    use dynocal_calib::steady::station::SteadyPoint;

    /// An end is met where something stood at it, whether the point was used or not, and where that is known by its value alone.
    #[test]
    fn an_end_at_which_nothing_stood_is_not_met() {
        let problem = CalibrationProblem::thesis();
        let i = problem.inputs[0].clone();
        let driven = ResponseChannel {
            name: i.name.clone(),
            unit: i.unit.clone(),
            source: ResponseSource::Driven(0),
            lower: Some(i.lower),
            upper: Some(i.upper),
            weight: 0.0,
            slow: false,
        };
        let output = ResponseChannel { source: ResponseSource::Output, ..driven.clone() };
        let layout = Layout {
            problem,
            loops: Vec::new(),
            factors: Vec::new(),
            axes: 0,
            held: std::collections::BTreeMap::new(),
            responses: vec![driven, output],
            sample_time_s: 0.1,
        };
        let at = |share: f64, saturated: bool| {
            let point = SteadyPoint {
                asked: Vec::new(),
                factors: Vec::new(),
                responses: vec![i.lower + share * (i.upper - i.lower), 0.0],
                errors: Vec::new(),
                usable: false,
                note: String::new(),
                touched: Vec::new(),
                saturated: if saturated { vec![i.name.clone()] } else { Vec::new() },
                at_s: 0.0,
                used_s: 0.0,
            };
            DayPoint { purpose: Purpose::Plan, point }
        };
        let of = |points: &[DayPoint]| met(&layout, points, 0);
        assert_eq!(of(&[at(0.3, false), at(0.9, false), at(f64::NAN, true)]), [false, false]);
        assert_eq!(of(&[at(0.3, false), at(0.9, true)]), [false, true]);
        assert_eq!(of(&[at(0.004, false), at(0.9, false)]), [true, false]);
        assert_eq!(met(&layout, &[], 1), [true, true]);
    }
}
