//! A controller with all that is needed to run it elsewhere: what the job `control` writes and `export` reads.

use serde::{Deserialize, Serialize};

use crate::error::ControlError;
use crate::oxygen::{OxygenObserver, OxygenSettings};
use crate::predictor::{PredictedModel, Predictor};
use crate::runtime::{ActuatorLimits, Pid, PidGains};

/// Schema of a controller file.
pub const CONTROLLER_SCHEMA: &str = "dynocal/controller";
/// Its version.
pub const CONTROLLER_VERSION: u32 = 1;

/// Gains over scheduling channels: values row-major, the last axis fastest; linear between, constant outside.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Schedule {
    /// Scheduling channels with their unit and points, one or two.
    pub axes: Vec<ScheduleAxis>,
    /// Proportional gains.
    pub kp: Vec<f64>,
    /// Integral gains.
    pub ki: Vec<f64>,
}

/// One axis of a schedule.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScheduleAxis {
    /// Channel.
    pub channel: String,
    /// Unit.
    pub unit: String,
    /// Points, rising.
    pub points: Vec<f64>,
}

/// One loop that runs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StoredLoop {
    /// What it holds.
    pub output: String,
    /// Unit of it.
    pub output_unit: String,
    /// By what.
    pub input: String,
    /// Unit of it.
    pub input_unit: String,
    /// Gains.
    pub gains: PidGains,
    /// Gains by operating point instead; none: one set everywhere.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub schedule: Option<Schedule>,
    /// Limits of the actuator.
    pub limits: ActuatorLimits,
    /// Actuator before the first step.
    pub start: f64,
    /// Smith predictor about it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub predictor: Option<PredictedModel>,
}

/// Loops of one sample time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StoredController {
    /// Sample time in s.
    pub sample_time_s: f64,
    /// Loops.
    pub loops: Vec<StoredLoop>,
    /// Observer of the oxygen in a catalyst, with the trim of lambda that holds it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub catalyst: Option<OxygenSettings>,
}

impl Schedule {
    /// Gains at values of the axes.
    pub fn at(&self, values: &[f64]) -> (f64, f64) {
        let (mut kp, mut ki) = (self.kp.clone(), self.ki.clone());
        // The last axis first: each round leaves values over the axes before it.
        for (axis, v) in self.axes.iter().zip(values).rev() {
            let x = &axis.points;
            let n = x.len();
            let k = x.partition_point(|p| p <= v).clamp(1, n.max(2) - 1);
            let share = if n < 2 { 0.0 } else { ((v - x[k - 1]) / (x[k] - x[k - 1])).clamp(0.0, 1.0) };
            let along = |g: &[f64]| -> Vec<f64> {
                g.chunks(n).map(|r| if n < 2 { r[0] } else { r[k - 1] + share * (r[k] - r[k - 1]) }).collect()
            };
            (kp, ki) = (along(&kp), along(&ki));
        }
        (kp[0], ki[0])
    }

    fn check(&self, what: &str) -> Result<(), ControlError> {
        let count: usize = self.axes.iter().map(|a| a.points.len()).product();
        if self.axes.is_empty() || self.axes.len() > 2 || self.kp.len() != count || self.ki.len() != count {
            let found = format!("{} axes, {} and {} gains", self.axes.len(), self.kp.len(), self.ki.len());
            return Err(ControlError::shape(
                format!("the schedule of {what}"),
                found,
                format!("one or two axes with {count} gains each"),
            ));
        }
        for a in &self.axes {
            if a.points.is_empty() || !a.points.windows(2).all(|p| p[0] < p[1]) {
                let found = format!("{:?}", a.points);
                return Err(ControlError::shape(
                    format!("points of the axis `{}`", a.channel),
                    found,
                    "rising numbers",
                ));
            }
        }
        match self.kp.iter().chain(&self.ki).find(|g| !g.is_finite()) {
            Some(g) => {
                Err(ControlError::number(format!("a gain of the schedule of {what}"), *g, "a finite number"))
            }
            None => Ok(()),
        }
    }
}

impl StoredController {
    /// Whether every loop can run.
    ///
    /// # Errors
    /// [`ControlError`] with the first that cannot.
    pub fn check(&self) -> Result<(), ControlError> {
        for (k, l) in self.loops.iter().enumerate() {
            if self.loops[..k].iter().any(|o| o.input == l.input) {
                return Err(ControlError::shape(
                    "the actuator of a loop",
                    format!("`{}` twice", l.input),
                    "each once",
                ));
            }
            if let Some(s) = &l.schedule {
                s.check(&l.output)?;
            }
            match &l.predictor {
                Some(p) => {
                    Predictor::new(l.gains, l.limits, self.sample_time_s, l.start, p)?;
                    if p.flow.is_none() && p.delay_samples.fract() != 0.0 {
                        return Err(ControlError::number(
                            format!("the delay of the predictor of `{}` in samples", l.output),
                            p.delay_samples,
                            "a whole number in a file",
                        ));
                    }
                }
                None => {
                    Pid::new(l.gains, l.limits, self.sample_time_s, l.start)?;
                }
            }
        }
        if let Some(c) = self.catalyst {
            OxygenObserver::new(c, c.target)?;
            if !c.half_g_s.is_finite() {
                return Err(ControlError::number(
                    "half_g_s of the catalyst",
                    c.half_g_s,
                    "a finite number in a file",
                ));
            }
            if c.memory > 0.0 {
                return Err(ControlError::number(
                    "memory of the catalyst",
                    c.memory,
                    "0 in a file: capacity and bias together are learnt only by the observer that runs here",
                ));
            }
        }
        if self.loops.is_empty() {
            return Err(ControlError::shape("a controller", "no loop", "one at least"));
        }
        Ok(())
    }
}
