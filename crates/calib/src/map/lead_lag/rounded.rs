//! Values as a control unit keeps them: multiples of a resolution.

use super::super::{ActuatorPort, Ports};
use super::{LeadLagMap, LeadLagShape, Steps};
use dynocal_files::spec::Faults;
use dynocal_numerics::interval::Interval;

/// Steps of an actuator over its range: at least a millionth, at most a tenth.
const SHARES: [f64; 2] = [1e-6, 0.1];
/// Steps of the lags in s.
const LAG_S: [f64; 2] = [1e-6, 0.1];

/// Reports resolutions of what is no actuator, or that make no table.
pub(super) fn check(shape: &LeadLagShape, ports: &Ports, key: &str, faults: &mut Faults) {
    for (name, step) in &shape.resolution {
        let key = format!("{key}.resolution.{name}");
        let Some(port) = ports.actuators.iter().find(|a| a.name == *name) else {
            let names =
                ports.actuator_names().iter().map(|n| format!("`{n}`")).collect::<Vec<_>>().join(", ");
            faults.push(&key, name, format!("an actuator of the map: {names}"));
            continue;
        };
        let [least, most] = SHARES.map(|s| s * (port.upper - port.lower));
        if !(least <= *step && *step <= most) {
            let expected =
                format!("from {least:e} to {most:e}, a millionth and a tenth of its range, in its unit");
            faults.push(&key, step, expected);
        }
    }
    // Below 0 and what is no number is told with all other times.
    let (lag, [least, most]) = (shape.lag_resolution_s, LAG_S);
    if lag > most || (lag > 0.0 && lag < least) {
        faults.push(
            &format!("{key}.lag_resolution_s"),
            lag,
            format!("0 (any), or from {least:e} to {most} s"),
        );
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

/// The nearest multiple of a step within bounds, where there is one; the value itself without a step.
fn to_step(value: f64, step: f64, bounds: Interval) -> f64 {
    if step <= 0.0 {
        return value;
    }
    // As a ratio of whole numbers where the step is one: 7 / 20 is 0.35, 7 * 0.05 is not.
    let per_one = (1.0 / step).round();
    let exact = per_one >= 1.0 && (1.0 / step - per_one).abs() < 1e-9 * per_one;
    let of = |k: f64| if exact { k / per_one } else { k * step };
    let k = (value / step).round();
    // No negative zero.
    let found = [k, k + 1.0, k - 1.0].into_iter().map(of).find(|v| bounds.lower <= *v && *v <= bounds.upper);
    found.unwrap_or(of(k)) + 0.0
}

impl LeadLagMap {
    /// The map with its tables in multiples of their steps: values at rest in those of their actuator, a slope in steps that make one of
    /// those over the range of its reference, lags in their own. None where no steps are asked for.
    pub(super) fn in_steps(&self) -> Option<Self> {
        let anywhere = Interval::new(f64::NEG_INFINITY, f64::INFINITY);
        let mut map = self.clone();
        let steps = map.steps.as_mut()?;
        steps.rounding.clear();
        for ((a, step), port) in map.actuators.iter_mut().zip(&steps.actuators).zip(&self.ports.actuators) {
            let range = Interval::spanning(a.base.iter().copied()).width().max(f64::MIN_POSITIVE);
            // What each cell changes at most: at rest, and by slopes at the far end of their reference.
            let mut changed = vec![0.0; a.base.len()];
            for (v, moved) in a.base.iter_mut().zip(&mut changed) {
                let rounded = to_step(*v, *step, Interval::new(port.lower, port.upper));
                *moved += (rounded - *v).abs();
                *v = rounded;
            }
            for (slopes, o) in a.slopes.iter_mut().zip(&self.others) {
                let region = self.region[o.place];
                let far = (region.upper - o.rest).max(o.rest - region.lower);
                let step = if region.width() > 0.0 { step / region.width() } else { 0.0 };
                for (s, moved) in slopes.iter_mut().zip(&mut changed) {
                    let rounded = to_step(*s, step, anywhere);
                    *moved += (rounded - *s).abs() * far;
                    *s = rounded;
                }
            }
            a.lag_s.iter_mut().for_each(|t| *t = to_step(*t, steps.lag_s, anywhere));
            steps.rounding.push(changed.into_iter().fold(0.0, f64::max) / range);
        }
        Some(map)
    }
}
