//! What leaves the job: the controller as a file, and what records show beside the models that were made of them.

use std::f64::consts::TAU;

use dynocal_control::predictor::PredictedModel;
use dynocal_control::stored::{Schedule, ScheduleAxis, StoredController, StoredLoop};

use super::load::Loaded;
use super::loops::own;
use super::result::{ControlJobError, LoopResult, MeasuredResult};
use super::spec::{Job, LoopSpec, Plants, Point};

/// Coherence from which a measured point says something of a model.
const CLEAR: f64 = 0.8;

/// Standard deviations beyond which no scatter of a few hundred frequencies reaches: there the model is wrong.
const SURE: f64 = 10.0;

/// The controller of sampled plants.
pub(super) fn controller(job: &Job, loaded: &Loaded, loops: &[LoopResult]) -> Option<StoredController> {
    // A controller file has loops that each move their own input.
    let sample_time_s = loaded.time.sample_time_s().filter(|_| loaded.decoupler.is_none())?;
    let one = |(k, (spec, l)): (usize, (&LoopSpec, &LoopResult))| {
        let (output_unit, input_unit) = loaded.units.get(k).cloned().unwrap_or(("-".into(), "-".into()));
        let predictor = l.predictor.as_ref().map(|p| {
            let samples = (p.delay_s / sample_time_s).round();
            PredictedModel {
                model: p.model.clone(),
                delay_samples: samples,
                longest_samples: 4 * samples as usize,
                filter_s: spec.filter_s,
                flow: spec.flow.clone(),
            }
        });
        StoredLoop {
            output: l.output.clone(),
            output_unit,
            input: l.input.clone(),
            input_unit,
            gains: l.gains(),
            schedule: schedule(job, loaded, l),
            limits: spec.limits,
            start: spec.start,
            predictor,
        }
    };
    let loops = job.loops.iter().zip(loops).enumerate().map(one).collect();
    Some(StoredController { sample_time_s, loops, catalyst: job.catalyst })
}

fn points(job: &Job) -> &[Point] {
    match &job.plants {
        Plants::Models { points, .. } | Plants::Bed { points, .. } => points,
        _ => &[],
    }
}

/// Points of the axes of a schedule, rising.
fn axes(job: &Job) -> Vec<Vec<f64>> {
    let along = |c: &String| {
        let mut x: Vec<f64> = points(job).iter().filter_map(|p| p.values.get(c).copied()).collect();
        x.sort_by(f64::total_cmp);
        x.dedup();
        x
    };
    job.schedule.iter().map(along).collect()
}

/// Place of each combination of the axes in the list of set points, the last axis fastest; none where one is missing.
fn places(job: &Job) -> Option<Vec<usize>> {
    let axes = axes(job);
    let count: usize = axes.iter().map(Vec::len).product();
    let at = |mut k: usize| {
        let mut values = vec![0.0; axes.len()];
        for (a, v) in axes.iter().zip(&mut values).rev() {
            *v = a[k % a.len()];
            k /= a.len();
        }
        let there = |p: &Point| {
            job.schedule.iter().zip(&values).all(|(c, v)| p.values.get(c).is_some_and(|x| x == v))
        };
        points(job).iter().position(there)
    };
    if count == points(job).len() { (0..count).map(at).collect() } else { None }
}

/// Refuses set points that make no grid.
///
/// # Errors
/// [`ControlJobError::Schedule`].
pub(super) fn grid(job: &Job) -> Result<(), ControlJobError> {
    if job.schedule.is_empty() || places(job).is_some() {
        return Ok(());
    }
    let sizes: Vec<String> = axes(job).iter().map(|a| a.len().to_string()).collect();
    Err(ControlJobError::Schedule {
        channels: job.schedule.join(", "),
        points: points(job).len(),
        expected: sizes.join(" x "),
    })
}

fn schedule(job: &Job, loaded: &Loaded, l: &LoopResult) -> Option<Schedule> {
    if l.by_point.is_empty() {
        return None;
    }
    let places = places(job)?;
    let axis = |(channel, points): (&String, Vec<f64>)| ScheduleAxis {
        channel: channel.clone(),
        unit: loaded.channels.get(channel).cloned().unwrap_or_else(|| "-".into()),
        points,
    };
    Some(Schedule {
        axes: job.schedule.iter().zip(axes(job)).map(axis).collect(),
        kp: places.iter().map(|k| l.by_point[*k].0).collect(),
        ki: places.iter().map(|k| l.by_point[*k].1).collect(),
    })
}

/// Measured margins under the gains, and how far the models are from what was measured.
pub(super) fn measured(job: &Job, loaded: &Loaded, loops: &[LoopResult]) -> Vec<MeasuredResult> {
    let one = |(point, m): (usize, &super::records::Measured)| {
        let r = &m.response;
        let plant = &loaded.points[point].nominal;
        let dt_s = r.sample_time_s;
        // Controllers see what is behind the decoupler.
        let seen = loaded.decoupler.as_ref().map_or(r.clone(), |d| r.behind(d));
        let margins = |(k, l): (usize, &LoopResult)| {
            // From the measurement to the actuator, and what the loop has beyond the record.
            let later = job.reaction_samples as f64 * dt_s + job.loops[k].extra_delay_s;
            let c = own(&job.loops[k], l, point, loaded.time).delayed(later);
            seen.margins(k, k, &c, 0.0, job.draws, job.seed)
        };
        // By clear frequency, in standard deviations and over the size of the response.
        let off = |k: usize| -> Vec<(f64, f64)> {
            let later = job.reaction_samples as f64 * dt_s + job.loops[k].extra_delay_s;
            let own = |f: usize| {
                let w = TAU * r.frequency_hz[f];
                let model = plant.channel(k, k).delayed(-later).at(loaded.time, w);
                let distance = (model - r.at(f, k, k)).norm();
                (distance / r.std_at(f, k, k), distance / r.at(f, k, k).norm())
            };
            (0..r.frequency_hz.len()).filter(|f| r.coherence_at(*f, k) > CLEAR).map(own).collect()
        };
        let distance = |k: usize| off(k).iter().map(|o| o.0).reduce(f64::max);
        let sure = |k: usize| off(k).iter().filter(|o| o.0 > SURE).map(|o| o.1).reduce(f64::max);
        MeasuredResult {
            point: loaded.points[point].name.clone(),
            segments: r.segments,
            highest_hz: r.frequency_hz.last().copied().unwrap_or(0.0),
            models: m.models.clone(),
            distortion: m.distortion.clone(),
            margins: loops.iter().enumerate().map(margins).collect(),
            distance: (0..loops.len()).map(distance).collect(),
            wrong: (0..loops.len()).map(sure).collect(),
        }
    };
    loaded.measured.iter().enumerate().map(one).collect()
}
