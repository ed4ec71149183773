//! What a slow channel does to the demand, and what the demand is where the channel has come to rest.
//!
//! Maps are for an engine that has come to rest. While oil is colder than it will be, friction takes more, and the engine works as if more were
//! demanded of it: what was measured at y belongs to
//!
//! ```text
//! y - k (T - R(z))            T - R(z): how far the channel is from where it comes to rest ([`super::slow`])
//! ```
//!
//! k is the value with which models of what is minimised say best what they have not seen: the greatest sum over points of the logarithm of the
//! density that a model without the point gives it, by the last Gaussian process among the candidates (the last kind where there is none). It is told from nothing where that sum is greater by 4.5, three standard errors of a
//! parameter. That k is the same everywhere is an assumption: friction grows with the speed, and oil by its temperature.

use dynocal_calib::steady::day::{self, DayPoint, Drift, Purpose};
use dynocal_calib::steady::layout::{Layout, ResponseSource};
use dynocal_ident::data::UnitAfter;
use dynocal_ident::model::response::{Ask, Learn, Prediction, Response};
use dynocal_numerics::interval::Interval;
use dynocal_numerics::watch::Watch;
use dynocal_report::significant;
use serde::Serialize;

use super::choose::Kinds;
use super::drive::record;
use super::error::MapError;
use super::learn::{kinds, table};
use super::slow::{Law, along_lines, between_points};
use super::spec::MapSpec;
use super::windows::Window;

/// What is known of a slow channel.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Rest {
    /// Channel.
    pub channel: String,
    /// Its unit.
    pub unit: String,
    /// Demand that it acts on.
    pub demand: String,
    /// Unit of the demand.
    pub demand_unit: String,
    /// Time constant in s; none where the points do not tell where the channel comes to rest.
    pub tau_s: Option<f64>,
    /// Range of it in the points.
    pub moved: f64,
    /// How far it was away from where it comes to rest in the points, root mean square.
    pub away: f64,
    /// What of the demand one unit of it does; none where that is not told from nothing.
    pub effect: Option<f64>,
    /// Whether the times of the points are known.
    #[serde(skip)]
    timed: bool,
    /// Number of the channel among the responses, and of the demand among the factors.
    #[serde(skip)]
    place: (usize, usize),
    #[serde(skip)]
    law: Option<Law>,
}

/// Effects that are tried first, as what the scatter of the channel does in shares of `SIZE` of the demand's range: on either side of nothing.
const TRIED: [f64; 6] = [0.25, 0.5, 1.0, 2.0, 4.0, 8.0];
const SIZE: f64 = 0.01;
/// Times that the effects around the best one are halved.
const HALVED: usize = 3;
/// Gain in the logarithm of the density from which on an effect is told from nothing: half of three standard errors squared.
const TOLD: f64 = 4.5;

/// What `bed.slow` does, from the points so far; none where it is not asked for, or where no demand is an axis.
///
/// # Errors
/// [`MapError::Interrupted`], keys of the models.
pub(super) fn learn(
    layout: &Layout,
    points: &[DayPoint],
    spec: &MapSpec,
    watch: Watch,
) -> Result<Option<Rest>, MapError> {
    let response = layout.responses.iter().position(|r| spec.bed.slow.as_ref() == Some(&r.name));
    let Some((k, (d, _))) = response.zip(layout.leading_demand()) else { return Ok(None) };
    let (r, f) = (&layout.responses[k], &layout.factors[d]);
    let usable = points.iter().filter(|p| p.purpose != Purpose::Verify && p.point.usable);
    let values = || usable.clone().map(|p| p.point.responses[k]);
    let moved = Interval::spanning(values()).width();
    let axes = layout.factors[..layout.axes].iter();
    let ranges: Vec<Interval> = axes.map(|f| Interval::new(f.lower, f.upper)).collect();
    let law = Law::learn(&ranges, &between_points(layout, points, k, &spec.bed.approach));
    let mut rest = Rest {
        channel: r.name.clone(),
        unit: r.unit.clone(),
        demand: f.name.clone(),
        demand_unit: f.unit.clone(),
        tau_s: law.as_ref().map(|l| l.tau_s),
        moved,
        away: 0.0,
        effect: None,
        timed: points.iter().any(|p| p.point.at_s > 0.0),
        place: (k, d),
        law,
    };
    let Some(law) = &rest.law else { return Ok(Some(rest)) };
    let away: Vec<f64> =
        usable.map(|p| law.away(&p.point.factors[..layout.axes], p.point.responses[k])).collect();
    rest.away = (away.iter().map(|a| a * a).sum::<f64>() / away.len() as f64).sqrt();
    watch.note(&format!("what {} does to {}", r.name, f.name));
    let size = SIZE * (f.upper - f.lower) / rest.away;
    rest.effect = effect(&rest, layout, points, spec, size, watch)?.filter(|e| *e != 0.0);
    Ok(Some(rest))
}

/// The effect with the greatest score, where that is told from none.
fn effect(
    rest: &Rest,
    layout: &Layout,
    points: &[DayPoint],
    spec: &MapSpec,
    size: f64,
    watch: Watch,
) -> Result<Option<f64>, MapError> {
    let kinds = kinds(&spec.models)?;
    let Some(kind) = smooth_kind(&kinds) else { return Ok(None) };
    let score = |effect: f64| {
        if watch.interrupted() {
            return Err(MapError::Interrupted);
        }
        let there = Rest { effect: Some(effect), ..rest.clone() }.points(layout, points);
        Ok((effect, score(layout, &there, kind, watch)))
    };
    let first = TRIED.iter().rev().map(|t| -t).chain([0.0]).chain(TRIED);
    let mut all: Vec<(f64, f64)> = first.map(|t| score(t * size)).collect::<Result<_, MapError>>()?;
    let none = all[TRIED.len()].1;
    let greatest = |all: &[(f64, f64)]| (0..all.len()).max_by(|a, b| all[*a].1.total_cmp(&all[*b].1));
    for _ in 0..HALVED {
        // At the end of what is tried it is no maximum.
        let Some(k) = greatest(&all).filter(|k| (1..all.len() - 1).contains(k)) else { return Ok(None) };
        for place in [k + 1, k] {
            all.insert(place, score(0.5 * (all[place - 1].0 + all[place].0))?);
        }
    }
    Ok(greatest(&all).map(|k| all[k]).filter(|best| best.1 > none + TOLD).map(|best| best.0))
}

/// The last Gaussian process among the candidates (of the default ones that of the logarithm over warped inputs), which changes little where points
/// move a little; else the last one.
fn smooth_kind(kinds: &Kinds) -> Option<&dyn Learn> {
    let process = kinds.iter().rev().find(|(name, _)| name.starts_with("gaussian_process"));
    process.or(kinds.last()).map(|(_, kind)| &**kind)
}

/// Sum over points of the logarithm of the density that models without them give to what is minimised; less than any number where one cannot be
/// learnt.
fn score(layout: &Layout, points: &[DayPoint], kind: &dyn Learn, watch: Watch) -> f64 {
    let weighed = layout.responses.iter().enumerate().filter(|(_, r)| r.weight != 0.0 && !r.slow);
    let one = |(k, _)| {
        let Ok(found) = kind.learn(&table(layout, points, &[], k), watch.interrupt) else {
            return f64::NEG_INFINITY;
        };
        let each = found.left_out.residuals.iter().zip(&found.left_out.variance);
        each.map(|(e, v)| -0.5 * (v.max(f64::MIN_POSITIVE).ln() + e * e / v.max(f64::MIN_POSITIVE))).sum()
    };
    let sum: f64 = weighed.map(one).sum();
    if sum.is_nan() { f64::NEG_INFINITY } else { sum }
}

impl Rest {
    /// What the demand at the factors `x` is where the channel, which is `value`, has come to rest.
    fn demand(&self, x: &[f64], value: f64) -> f64 {
        let (_, d) = self.place;
        let (Some(law), Some(effect)) = (&self.law, self.effect) else { return x[d] };
        let at_rest = x[d] - effect * law.away(&x[..law.axes()], value);
        // None becomes one of the other sign by it.
        if x[d] * at_rest > 0.0 { at_rest } else { x[d] }
    }

    /// Points with the demand as it is at rest, and so with what is derived from it.
    pub(super) fn points(&self, layout: &Layout, points: &[DayPoint]) -> Vec<DayPoint> {
        let mut points = points.to_vec();
        if self.effect.is_none() {
            return points;
        }
        for p in &mut points {
            let p = &mut p.point;
            let mut there = p.factors.clone();
            there[self.place.1] = self.demand(&p.factors, p.responses[self.place.0]);
            derive_again(layout, (&p.factors, &there), &mut p.responses);
            p.factors = there;
        }
        points
    }

    /// Windows with the demand as it is at rest, and so with what is derived from it.
    pub(super) fn windows(&self, layout: &Layout, windows: &mut [Window]) {
        for w in windows {
            let row = &mut w.row;
            let mut there = row.factors.clone();
            there[self.place.1] = self.demand(&row.factors, row.responses[self.place.0]);
            if self.effect.is_some() {
                derive_again(layout, (&row.factors, &there), &mut row.responses);
            }
            row.factors = there;
        }
    }

    /// The same with where the channel comes to rest along the maps, as lines tell it.
    pub(super) fn along(&self, layout: &Layout, windows: &[Window]) -> Self {
        let ranges = layout.factors[..layout.axes].iter().map(|f| Interval::new(f.lower, f.upper));
        let ranges: Vec<Interval> = ranges.collect();
        let law = Law::learn(&ranges, &along_lines(windows, self.place.0, layout.axes));
        match law {
            Some(law) => Self { tau_s: Some(law.tau_s), law: Some(law), ..self.clone() },
            None => self.clone(),
        }
    }

    /// What was found, in words.
    pub fn words(&self) -> String {
        let Self { channel, demand, .. } = self;
        let unit = UnitAfter(&self.unit);
        let Some(tau_s) = self.tau_s else {
            return format!(
                "`{channel}` moved by {}{unit} in the points: where it comes to rest is not told by that{}, and nothing of what it does is taken out.",
                significant(self.moved, 2),
                if self.timed { "" } else { " without the times of the points" }
            );
        };
        let moves = format!(
            "`{channel}` comes to rest in {} s and was {}{unit} away from that in the points (root mean square).",
            significant(tau_s, 2),
            significant(self.away, 2)
        );
        match self.effect {
            Some(k) => format!(
                "{moves} One {} more of it counts as {} {} less of `{demand}`: maps are for where it has come to rest.",
                self.unit,
                significant(k, 2),
                self.demand_unit
            ),
            None => format!(
                "{moves} What that does to `{demand}` is not told from nothing, and nothing is taken out."
            ),
        }
    }
}

/// Derived responses as they are where the factors are others (before, then).
fn derive_again(layout: &Layout, (before, then): (&[f64], &[f64]), responses: &mut [f64]) {
    let derived = layout.responses.iter().enumerate().filter(|(_, r)| r.source == ResponseSource::Derived);
    for (k, r) in derived {
        let of = |x: &[f64]| {
            let record = record(layout, &[(x, responses)]);
            layout.problem.values(&r.name, &record).ok().and_then(|v| v.first().copied())
        };
        let share = of(then).zip(of(before)).map(|(now, before)| now / before);
        responses[k] *= share.filter(|s| s.is_finite()).unwrap_or(1.0);
    }
}

/// Points with the demand as it is where a slow channel has come to rest, where one is known.
pub(super) fn at_rest(rest: Option<&Rest>, layout: &Layout, points: &[DayPoint]) -> Vec<DayPoint> {
    rest.map_or_else(|| points.to_vec(), |r| r.points(layout, points))
}

/// Drift by the repeats among `points`, which are as they are at rest: a demand that is another one by what a slow channel did is no drift. Responses are
/// taken along their slopes over the demand, by models of them, to the mean demand of the repeats.
///
/// # Errors
/// [`MapError::Interrupted`], keys of the models.
pub(super) fn drift(
    rest: Option<&Rest>,
    layout: &Layout,
    points: &[DayPoint],
    spec: &MapSpec,
    watch: Watch,
) -> Result<Vec<Drift>, MapError> {
    let Some(rest) = rest.filter(|r| r.effect.is_some()) else { return Ok(day::drift(layout, points)) };
    let kinds = kinds(&spec.models)?;
    let Some(kind) = smooth_kind(&kinds) else { return Ok(day::drift(layout, points)) };
    let d = rest.place.1;
    let mut repeats: Vec<DayPoint> =
        points.iter().filter(|p| p.purpose == Purpose::Repeat && p.point.usable).cloned().collect();
    let mean = repeats.iter().map(|p| p.point.factors[d]).sum::<f64>() / repeats.len().max(1) as f64;
    let mut at = Prediction::new(layout.factors.len());
    for (k, _) in layout.responses.iter().enumerate().filter(|(_, r)| !r.slow) {
        if watch.interrupted() {
            return Err(MapError::Interrupted);
        }
        // What cannot be learnt stays as it was measured.
        let Ok(found) = kind.learn(&table(layout, points, &[], k), watch.interrupt) else { continue };
        for p in &mut repeats {
            found.model.predict(&p.point.factors, Ask::Gradient, &mut at);
            p.point.responses[k] += at.gradient[d] * (mean - p.point.factors[d]);
        }
    }
    Ok(day::drift(layout, &repeats))
}
