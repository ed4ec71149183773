//! Steady points of an engine beside its records.

use super::record::TransientRecord;
use super::{FuellingError, Loss};
use crate::fuelling::Fuelling;

/// Time of a record that a steady point counts as in s.
const COUNTS_S: f64 = 1.0;

/// A steady point of the engine: means of a stretch at rest, or what a bed has measured of it beside the records.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SteadyPoint {
    /// Speed in rpm.
    pub speed_rpm: f64,
    /// Manifold pressure in kPa.
    pub map_kpa: f64,
    /// Throttle as it was commanded in deg.
    pub throttle_deg: f64,
    /// Fuel per cycle that makes lambda 1, in the unit of the injection.
    pub fuel: f64,
    /// Coolant temperature in degC; any number where the records do not count it.
    pub coolant_c: f64,
    /// Pressure before the throttle in kPa.
    pub upstream_kpa: f64,
    /// Places of intake and exhaust cam in deg, where the records count them.
    pub cams_deg: Option<[f64; 2]>,
}

/// Refuses a steady point that cannot be.
pub(super) fn check(k: usize, p: &SteadyPoint, like: &TransientRecord<'_>) -> Result<(), FuellingError> {
    let number = k + 1;
    let refused = |channel, found: String, expected: String| {
        let found = format!("{found} at steady point {number}");
        Err(FuellingError::Channel { channel, found, expected })
    };
    let mut channels = vec![
        ("speed", p.speed_rpm, 50.0),
        ("map", p.map_kpa, 1.0),
        ("throttle", p.throttle_deg, -1e3),
        ("injection", p.fuel, 1e-9),
        ("coolant", p.coolant_c, -60.0),
        ("boost", p.upstream_kpa, 20.0),
    ];
    if let Some([intake, exhaust]) = p.cams_deg {
        channels.extend([("intake cam", intake, -720.0), ("exhaust cam", exhaust, -720.0)]);
    }
    for (channel, value, least) in channels {
        if !(value.is_finite() && value >= least) {
            return refused(channel, format!("the value {value}"), format!("a number of at least {least}"));
        }
    }
    let given = |is: bool| if is { "places of the cams" } else { "no places of the cams" };
    if p.cams_deg.is_some() != like.cams_deg.is_some() {
        let expected = format!("{}, as in the records", given(like.cams_deg.is_some()));
        return refused("cams", given(p.cams_deg.is_some()).into(), expected);
    }
    Ok(())
}

impl SteadyPoint {
    /// 1 / lambda that the fuel which makes lambda 1 would have by a model, less 1.
    fn unexplained(&self, f: &Fuelling) -> f64 {
        self.fuel / f.air(self.coolant_c, self.cams_deg).at(self.speed_rpm, self.map_kpa) - 1.0
    }
}

/// Weight of a point beside samples.
fn weight(f: &Fuelling) -> f64 {
    (COUNTS_S / f.sample_time_s).sqrt()
}

/// What the fuel of points is beside that of the model, as it counts.
pub(super) fn unexplained(points: &[SteadyPoint], f: &Fuelling, loss: Loss, out: &mut [f64]) {
    let weight = weight(f);
    out.iter_mut().zip(points).for_each(|(e, at)| *e = weight * loss.of(at.unexplained(f)));
}

/// Its derivatives by the coefficients of the charge, one column each, from row `first` on.
pub(super) fn unexplained_slopes(
    points: &[SteadyPoint],
    f: &Fuelling,
    loss: Loss,
    first: usize,
    out: &mut [Vec<f64>],
) {
    let weight = weight(f);
    for (k, at) in points.iter().enumerate() {
        let left = at.unexplained(f);
        let share = weight * loss.slope(left) * (1.0 + left) / f.charge.at(at.speed_rpm, at.map_kpa);
        let terms = f.charge.terms(at.speed_rpm, at.map_kpa);
        out.iter_mut().zip(terms).for_each(|(column, term)| column[first + k] = -share * term);
    }
}
