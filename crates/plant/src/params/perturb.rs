//! Engines like a given one, but not the same: what is tuned on one can be tried on others.

use crate::error::PlantError;
use crate::params::EngineParams;
use dynocal_numerics::rng::Rng64;

/// Greatest relative change of most parameters.
pub const SHARE: f64 = 0.2;

/// A parameter that is varied: key, share of [`SHARE`], place.
type Row = (&'static str, f64, fn(&mut EngineParams) -> Option<&mut f64>);

/// Volumes, burn, residuals, friction, heat, actuators and sensor. Those in which a fifth would make another kind of
/// engine (valve timing, efficiency, throttle slope, which acts by its square) move less.
static ROWS: &[Row] = &[
    ("charge_pipe_m3", 1.0, |p| Some(&mut p.charge_pipe_m3)),
    ("intake_manifold.volume_m3", 1.0, |p| Some(&mut p.intake_manifold.volume_m3)),
    ("exhaust_manifold.volume_m3", 1.0, |p| Some(&mut p.exhaust_manifold.volume_m3)),
    ("catalyst.volume_m3", 1.0, |p| Some(&mut p.catalyst.volume_m3)),
    ("burn.duration_deg", 1.0, |p| Some(&mut p.burn.duration_deg)),
    ("burn.delay_deg", 1.0, |p| Some(&mut p.burn.delay_deg)),
    ("burn.speed_exponent", 1.0, |p| Some(&mut p.burn.speed_exponent)),
    ("burn.mass_exponent", 1.0, |p| Some(&mut p.burn.mass_exponent)),
    ("burn.residual_exponent", 1.0, |p| Some(&mut p.burn.residual_exponent)),
    ("burn.efficiency", 0.15, |p| Some(&mut p.burn.efficiency)),
    ("intake_valve.duration_deg", 0.15, |p| Some(&mut p.intake_valve.duration_deg)),
    ("exhaust_valve.duration_deg", 0.15, |p| Some(&mut p.exhaust_valve.duration_deg)),
    ("exhaust.turbine_m2", 1.0, |p| Some(&mut p.exhaust.turbine_m2)),
    ("exhaust.tailpipe_m2", 1.0, |p| Some(&mut p.exhaust.tailpipe_m2)),
    ("heat.scale", 1.0, |p| Some(&mut p.heat.scale)),
    ("friction.constant_pa", 1.0, |p| Some(&mut p.friction.constant_pa)),
    ("friction.peak_share", 1.0, |p| Some(&mut p.friction.peak_share)),
    ("friction.linear_pa_s_m", 1.0, |p| Some(&mut p.friction.linear_pa_s_m)),
    ("friction.quadratic_pa_s2_m2", 1.0, |p| Some(&mut p.friction.quadratic_pa_s2_m2)),
    ("throttle.diameter0_m", 1.0, |p| Some(&mut p.throttle.diameter0_m)),
    ("throttle.slope_m_per_deg", 0.5, |p| Some(&mut p.throttle.slope_m_per_deg)),
    ("injection.rate_kg_s", 1.0, |p| Some(&mut p.injection.rate_kg_s)),
    ("injection.evaporation_s", 1.0, |p| Some(&mut p.injection.evaporation_s)),
    ("port.share", 1.0, |p| p.port.as_mut().map(|f| &mut f.share)),
    ("port.tau_s", 1.0, |p| p.port.as_mut().map(|f| &mut f.tau_s)),
    ("turbocharger.inertia_kg_m2", 1.0, |p| p.turbocharger.as_mut().map(|t| &mut t.inertia_kg_m2)),
    ("turbocharger.flow_coefficient", 0.5, |p| p.turbocharger.as_mut().map(|t| &mut t.flow_coefficient)),
    ("turbocharger.turbine_efficiency", 0.25, |p| p.turbocharger.as_mut().map(|t| &mut t.turbine_efficiency)),
    ("knock.delay_factor", 1.0, |p| p.knock.as_mut().map(|k| &mut k.delay_factor)),
    ("torque_lag_s", 1.0, |p| Some(&mut p.torque_lag_s)),
];

/// `base` with each parameter of the list times a factor of its own, drawn uniformly within the stated share.
///
/// # Errors
/// [`PlantError`] when the result is no engine any more.
///
/// ```
/// use dynocal_plant::params::{EngineParams, perturb::perturbed};
/// let base = EngineParams::thesis();
/// let other = perturbed(&base, 7)?;
/// assert_eq!(other, perturbed(&base, 7)?);
/// assert!((other.intake_manifold.volume_m3 / base.intake_manifold.volume_m3 - 1.0).abs() <= 0.2);
/// assert_ne!(other, perturbed(&base, 8)?);
/// # Ok::<(), dynocal_plant::error::PlantError>(())
/// ```
pub fn perturbed(base: &EngineParams, seed: u64) -> Result<EngineParams, PlantError> {
    let mut p = base.clone();
    let mut rng = Rng64::new(seed);
    for (_, share, place) in ROWS {
        let limit = SHARE * share;
        // Drawn for every row, so that a seed means the same whatever parts the engine has.
        let factor = 1.0 + rng.uniform_in(-limit, limit);
        if let Some(value) = place(&mut p) {
            *value *= factor;
        }
    }
    // No engine burns more than its fuel.
    p.burn.efficiency = p.burn.efficiency.min(1.0 - p.burn.efficiency_bump);
    p.check()?;
    Ok(p)
}

/// Keys that are varied, and by how much at most.
pub fn varied() -> impl Iterator<Item = (&'static str, f64)> {
    ROWS.iter().map(|r| (r.0, SHARE * r.1))
}

/// Splits `perturbed:SEED` or `perturbed:SET:SEED` into set and seed; none when `name` is no such name.
///
/// ```
/// use dynocal_plant::params::perturb::parse;
/// assert_eq!(parse("perturbed:7"), Some(("thesis", 7)));
/// assert_eq!(parse("perturbed:pfi_1_6l:3"), Some(("pfi_1_6l", 3)));
/// assert_eq!(parse("thesis"), None);
/// ```
pub fn parse(name: &str) -> Option<(&str, u64)> {
    let rest = name.strip_prefix("perturbed:")?;
    let (set, seed) = rest.rsplit_once(':').unwrap_or(("thesis", rest));
    Some((set, seed.parse().ok()?))
}
