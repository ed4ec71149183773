//! A day on the bed: planned points in blocks, a repeated point between them, a budget.
//!
//! What is planned ([`super::plan`]) is measured block by block. The
//! first point of the day is measured again before every block: its scatter is the noise of a point, its trend over the bed time
//! the drift.
//!
//! ```text
//! y_k = a + b t_k + e_k                    repeats of one response: drift b, noise std e
//! y   = measured - b (t - mean t_k)        where |b| > t_0.995 se(b)
//! ```

use dynocal_ident::play::{PlayError, Reason};
use dynocal_numerics::watch::Watch;
use serde::{Deserialize, Serialize};
use statrs::distribution::{ContinuousCDF, StudentsT};

use super::layout::Layout;
use super::plan::DayPlan;
use super::station::{Corner, Station, SteadyPoint};

/// Why a point was measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Purpose {
    /// To learn from, all over the space.
    Plan,
    /// To learn from, where the optimum was expected or the bed had not been ([`super::refine`]).
    Optimum,
    /// The repeated point.
    Repeat,
    /// To verify maps.
    Verify,
}

/// A point of the day.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DayPoint {
    /// Why.
    pub purpose: Purpose,
    /// The point.
    #[serde(flatten)]
    pub point: SteadyPoint,
}

/// What is measured next.
#[derive(Clone, Debug, PartialEq)]
pub struct Task {
    /// Why.
    pub purpose: Purpose,
    /// All factors.
    pub target: Vec<f64>,
    /// Over which place the bed goes there; none: straight ([`super::corner`]).
    pub via: Option<Corner>,
    /// Where the inputs of the loops are expected to stand there, by loop: fed forward on the way, so that the loops have only the rest
    /// to do. A value that is no number, or is not there, is not fed forward.
    pub driven: Vec<f64>,
    /// Factors of the gains of the loops there, by loop ([`super::station::Station::measure`]); 1 where there is none.
    pub gains: Vec<f64>,
}

impl Task {
    /// A point of whose driven inputs nothing is known.
    pub fn new(purpose: Purpose, target: Vec<f64>) -> Self {
        Self { purpose, target, via: None, driven: Vec::new(), gains: Vec::new() }
    }
}

/// Points in a row that cannot be used before the day is given up.
const GIVEN_UP: usize = 8;

/// Why a day ended.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DayEnd {
    /// The plan is done.
    Done,
    /// The bed time is used up.
    BedTime,
    /// Many points in a row could not be used; the notes of the last ones.
    Unusable(String),
    /// The plant refused to go on.
    Refused(String),
}

/// The blocks that are planned before the day begins, with a repeat of `first` before each; the last repeat is that of the last block.
pub fn tasks(layout: &Layout, first: &[f64], plan: &DayPlan) -> Vec<Task> {
    plan.blocks(layout).into_iter().flat_map(|block| with_repeat(first, block)).collect()
}

/// A block with a repeat of `first` before it.
pub fn with_repeat(first: &[f64], block: Vec<Vec<f64>>) -> Vec<Task> {
    let planned = block.into_iter().map(|x| Task::new(Purpose::Plan, x));
    std::iter::once(Task::new(Purpose::Repeat, first.to_vec())).chain(planned).collect()
}

/// What measures the points of a day one after the other.
pub trait Measures {
    /// Goes to the target of `task` and measures there, or as near as the limits allow.
    ///
    /// # Errors
    /// [`PlayError`]: the plan does not fit the plant, the plant refused it, or the user interrupted.
    fn measure(&mut self, task: &Task) -> Result<SteadyPoint, PlayError>;
    /// Bed time so far in s.
    fn bed_s(&self) -> f64;
}

impl Measures for Station<'_> {
    fn measure(&mut self, task: &Task) -> Result<SteadyPoint, PlayError> {
        Station::measure(self, &task.target, task.via.as_ref(), &task.driven, &task.gains)
    }
    fn bed_s(&self) -> f64 {
        self.used_s
    }
}

/// Measures `tasks` one after the other until `bed_s` is used up, adding to `points`; why it ended.
///
/// # Errors
/// [`PlayError`]: the plan does not fit the plant, or the user interrupted.
pub fn run(
    station: &mut dyn Measures,
    tasks: Vec<Task>,
    bed_s: f64,
    points: &mut Vec<DayPoint>,
    watch: Watch,
) -> Result<DayEnd, PlayError> {
    let (n, mut unusable) = (tasks.len(), 0);
    for (k, task) in tasks.into_iter().enumerate() {
        if station.bed_s() >= bed_s {
            return Ok(DayEnd::BedTime);
        }
        watch.fraction(k as f64 / n as f64);
        let point = match station.measure(&task) {
            Ok(point) => point,
            Err(e) => return refused(e).map(DayEnd::Refused),
        };
        unusable = if point.usable { 0 } else { unusable + 1 };
        points.push(DayPoint { purpose: task.purpose, point });
        if unusable >= GIVEN_UP {
            let notes: Vec<&str> = points.iter().rev().take(3).map(|p| p.point.note.as_str()).collect();
            return Ok(DayEnd::Unusable(notes.join(" | ")));
        }
    }
    Ok(DayEnd::Done)
}

/// A plant that refuses ends the day; anything else is an error.
pub fn refused(e: PlayError) -> Result<String, PlayError> {
    match &e {
        PlayError::Ended { stop, .. } if matches!(stop.reason, Reason::Refused(_)) => Ok(stop.to_string()),
        PlayError::Plant(p) => Ok(p.to_string()),
        _ => Err(e),
    }
}

/// What the repeats of one response say.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Drift {
    /// Response.
    pub response: String,
    /// Unit.
    pub unit: String,
    /// Repeats.
    pub repeats: usize,
    /// Mean.
    pub mean: f64,
    /// Scatter of a point about the trend: standard deviation.
    pub noise: f64,
    /// Drift per hour.
    pub per_hour: f64,
    /// Standard error of the drift per hour.
    pub per_hour_error: f64,
    /// Whether the drift is told from scatter with 99 %, and the points were corrected for it.
    pub corrected: bool,
    /// Mean bed time of the repeats in s: where the correction is zero.
    pub mean_s: f64,
}

/// Quantile of Student's t beyond which a drift is no scatter.
const TOLD: f64 = 0.995;

/// Drift of every response from the usable repeats; none with fewer than four of them, or where their times are not known.
pub fn drift(layout: &Layout, points: &[DayPoint]) -> Vec<Drift> {
    let repeats: Vec<&SteadyPoint> =
        points.iter().filter(|p| p.purpose == Purpose::Repeat && p.point.usable).map(|p| &p.point).collect();
    let n = repeats.len();
    if n < 4 {
        return Vec::new();
    }
    let count = n as f64;
    let mean_s = repeats.iter().map(|p| p.at_s).sum::<f64>() / count;
    let spread = repeats.iter().map(|p| (p.at_s - mean_s).powi(2)).sum::<f64>();
    if spread == 0.0 {
        return Vec::new();
    }
    let one = |(k, r): (usize, &super::layout::ResponseChannel)| {
        let mean = repeats.iter().map(|p| p.responses[k]).sum::<f64>() / count;
        let slope = repeats.iter().map(|p| (p.at_s - mean_s) * (p.responses[k] - mean)).sum::<f64>() / spread;
        let rest = repeats.iter().map(|p| (p.responses[k] - mean - slope * (p.at_s - mean_s)).powi(2));
        let noise = (rest.sum::<f64>() / (count - 2.0)).sqrt();
        let error = noise / spread.sqrt();
        let t = StudentsT::new(0.0, 1.0, count - 2.0).map_or(f64::INFINITY, |t| t.inverse_cdf(TOLD));
        Drift {
            response: r.name.clone(),
            unit: r.unit.clone(),
            repeats: n,
            mean,
            noise,
            per_hour: 3600.0 * slope,
            per_hour_error: 3600.0 * error,
            corrected: slope.abs() > t * error && slope.is_finite(),
            mean_s,
        }
    };
    layout.responses.iter().enumerate().map(one).collect()
}

/// Response number `k` of a point less the drift that was found.
pub fn corrected(point: &SteadyPoint, k: usize, drift: &[Drift]) -> f64 {
    let value = point.responses[k];
    match drift.get(k).filter(|d| d.corrected) {
        Some(d) => value - d.per_hour / 3600.0 * (point.at_s - d.mean_s),
        None => value,
    }
}
