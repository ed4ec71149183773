//! Values as a control unit keeps them: multiples of a resolution.

use super::super::{ActuatorPort, Ports};
use super::{LeadLagMap, LeadLagShape, Steps};
use dynocal_files::spec::Faults;
use dynocal_numerics::interval::Interval;

/// Reports resolutions of what is no actuator, or that are no positive number.
pub(super) fn check(shape: &LeadLagShape, ports: &Ports, key: &str, faults: &mut Faults) {
    for (name, step) in &shape.resolution {
        let key = format!("{key}.resolution.{name}");
        if !ports.actuators.iter().any(|a| a.name == *name) {
            let names =
                ports.actuator_names().iter().map(|n| format!("`{n}`")).collect::<Vec<_>>().join(", ");
            faults.push(&key, name, &format!("an actuator of the map: {names}"));
        } else if !(step.is_finite() && *step > 0.0) {
            faults.push(&key, step, "a step above 0, in the unit of the actuator");
        }
    }
    let lag = shape.lag_resolution_s;
    if !(lag.is_finite() && lag >= 0.0) {
        faults.push(&format!("{key}.lag_resolution_s"), lag, "a step of 0 (none) or more, in s");
    }
}

/// What the keys ask for; none where they ask for nothing.
pub(super) fn steps(shape: &LeadLagShape, ports: &Ports) -> Option<Steps> {
    let of = |a: &ActuatorPort| shape.resolution.get(&a.name).copied().unwrap_or(0.0);
    let asked = !shape.resolution.is_empty() || shape.lag_resolution_s > 0.0;
    asked.then(|| Steps {
        actuators: ports.actuators.iter().map(of).collect(),
        lag_s: shape.lag_resolution_s,
        rounding: Vec::new(),
    })
}

/// The nearest multiple of a step; the value itself without one.
fn to_step(value: f64, step: f64) -> f64 {
    if step > 0.0 { (value / step).round() * step } else { value }
}

impl LeadLagMap {
    /// The map with its tables in multiples of their steps: values at rest in those of their actuator, a slope in steps that make one of
    /// those over the range of its reference, lags in their own. None where no steps are asked for.
    pub(super) fn in_steps(&self) -> Option<Self> {
        let mut map = self.clone();
        let steps = map.steps.as_mut()?;
        steps.rounding.clear();
        for (a, step) in map.actuators.iter_mut().zip(&steps.actuators) {
            let range = Interval::spanning(a.base.iter().copied()).width().max(f64::MIN_POSITIVE);
            let mut most = 0.0f64;
            for v in &mut a.base {
                let rounded = to_step(*v, *step);
                most = most.max((rounded - *v).abs());
                *v = rounded;
            }
            for (slopes, o) in a.slopes.iter_mut().zip(&self.others) {
                let over = self.region[o.place].width();
                let step = if over > 0.0 { step / over } else { 0.0 };
                slopes.iter_mut().for_each(|s| *s = to_step(*s, step));
            }
            a.lag_s.iter_mut().for_each(|t| *t = to_step(*t, steps.lag_s));
            steps.rounding.push(most / range);
        }
        Some(map)
    }
}
