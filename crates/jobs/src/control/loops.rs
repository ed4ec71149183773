//! The controllers of the loops: gains by set point, predictors in their place, and how much those stand.

use dynocal_control::error::ControlError;
use dynocal_control::interaction::through;
use dynocal_control::poly::{add, multiply};
use dynocal_control::smith::Smith;
use dynocal_control::system::{System, Time, Transfer};
use dynocal_numerics::interval::Interval;

use super::load::{Loaded, without_predicted};
use super::result::{ControlJobError, LoopResult, PredictorResult};
use super::spec::{Job, LoopSpec};

/// Size of the determinant at rest over the most that it can be, below which outputs move together: rounding leaves less.
const SINGULAR: f64 = 1e-9;

/// The controllers of a set point: PIs, with a schedule those of the point, with a predictor what stands in its place.
pub(super) fn controller(
    job: &Job,
    loaded: &Loaded,
    loops: &[LoopResult],
    point: usize,
) -> Result<System, ControlError> {
    let own: Vec<Transfer> =
        job.loops.iter().zip(loops).map(|(spec, l)| own(spec, l, point, loaded.time)).collect();
    match &loaded.decoupler {
        Some(d) => through(d, &own),
        None => System::diagonal(loaded.time, &own),
    }
}

/// The controller of one loop at a set point.
pub(super) fn own(spec: &LoopSpec, l: &LoopResult, point: usize, time: Time) -> Transfer {
    let pid = l.gains_at(point).transfer(time);
    l.predictor.as_ref().map_or(pid.clone(), |p| predicting(&pid, spec, p, time))
}

/// `K F / (1 + K P (1 - F q^d))`: what stands between the measured output and the actuator in (7.28), with the filter F of the prediction
/// error.
fn predicting(k: &Transfer, spec: &LoopSpec, p: &PredictorResult, time: Time) -> Transfer {
    let f = filter(spec, time);
    let samples = (p.delay_s / time.sample_time_s().unwrap_or(1.0)).round() as usize;
    let mut late = vec![0.0; samples];
    late.extend(&f.num);
    let less: Vec<f64> = late.iter().map(|v| -v).collect();
    let known = multiply(&multiply(&k.num, &p.model.num), &add(&f.den, &less));
    Transfer {
        num: multiply(&k.num, &multiply(&p.model.den, &f.num)),
        den: add(&multiply(&k.den, &multiply(&p.model.den, &f.den)), &known),
        delay_s: 0.0,
    }
}

/// Filter of the prediction error as it runs.
fn filter(spec: &LoopSpec, time: Time) -> Transfer {
    match time.sample_time_s().filter(|_| spec.filter_s > 0.0) {
        Some(dt_s) => {
            let share = -(-dt_s / spec.filter_s).exp_m1();
            Transfer::sampled(&[share], &[1.0, share - 1.0])
        }
        None => Transfer::gain(1.0),
    }
}

/// Gains of a schedule: those that each set point alone would have.
pub(super) fn by_point(
    job: &Job,
    scheduled: &[Option<(f64, f64)>],
    sign: f64,
    l: &LoopSpec,
) -> Result<Vec<(f64, f64)>, ControlJobError> {
    if job.schedule.is_empty() {
        return Ok(Vec::new());
    }
    let none = |k: usize| ControlJobError::Loop {
        output: l.output.clone(),
        input: l.input.clone(),
        source: ControlError::Model(format!("no PI keeps what is asked at set point {} alone", k + 1)),
    };
    let own =
        |(k, g): (usize, &Option<(f64, f64)>)| g.map(|g| (g.0 * sign, g.1 * sign)).ok_or_else(|| none(k));
    scheduled.iter().enumerate().map(own).collect()
}

/// The predictor about the first set point's model, and the least that it stands over all of them.
pub(super) fn predictor(
    job: &Job,
    loaded: &Loaded,
    k: usize,
    l: &LoopSpec,
    found: &LoopResult,
) -> Result<PredictorResult, ControlError> {
    let plants = loaded
        .points
        .iter()
        .map(|p| Ok(without_predicted(job, &p.nominal)?.channel(k, k).clone()))
        .collect::<Result<Vec<Transfer>, ControlError>>()?;
    let pid = found.gains().transfer(loaded.time);
    let mut smith = Smith::new(loaded.time, pid, plants[0].clone(), l.extra_delay_s);
    smith.filter = filter(l, loaded.time);
    let mut out = PredictorResult {
        delay_s: l.extra_delay_s,
        above_s: None,
        below_s: None,
        gain: (0.1, 10.0),
        model: plants[0].clone(),
        flow: l.flow.clone(),
    };
    for plant in &plants {
        // Where the loop of a point is not stable at all the margins say so.
        let Ok(d) = smith.delay_interval(plant, 1.0) else { continue };
        out.above_s = [out.above_s, d.above_s].into_iter().flatten().reduce(f64::min);
        out.below_s = [out.below_s, d.below_s].into_iter().flatten().reduce(f64::max);
        let g = smith.gain_interval(plant, 0.0, Interval { lower: 0.1, upper: 10.0 })?;
        out.gain = (out.gain.0.max(g.lower), out.gain.1.min(g.upper));
    }
    Ok(out)
}

/// Refuses plants whose outputs always move together at rest: integrators cannot hold them at demands of their own.
pub(super) fn apart_at_rest(loaded: &Loaded) -> Result<(), ControlJobError> {
    for p in loaded.points.iter().filter(|p| p.nominal.outputs > 1) {
        let g = p.nominal.at(0.0);
        // At most the product of the rows' lengths (Hadamard); integrators are infinite at rest and are left to the search.
        let most: f64 =
            g.data.chunks(g.cols).map(|r| r.iter().map(|v| v.norm_sqr()).sum::<f64>().sqrt()).product();
        if most.is_finite() && most > 0.0 && g.determinant().norm() < SINGULAR * most {
            let text = "the plant is singular at rest: its outputs always move together, whatever the inputs do, so that no loops hold them at demands of their own";
            return Err(ControlJobError::Point {
                point: p.name.clone(),
                source: ControlError::Model(text.into()),
            });
        }
    }
    Ok(())
}
