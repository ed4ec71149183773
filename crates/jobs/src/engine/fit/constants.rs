//! What a fit may move, and within which range.

use dynocal_plant::cams::CamShift;
use dynocal_plant::params::{EngineParams, Manifold};

use super::Compared;

/// A constant of the engine that a map can say something about.
pub struct Constant {
    /// Key as in a parameter file.
    pub key: &'static str,
    /// What it is.
    pub what: &'static str,
    /// Least and greatest value of a real engine.
    pub range: (f64, f64),
    /// Which measured quantity it needs.
    pub needs: Compared,
    /// Its place; none where the engine has no such part.
    pub place: fn(&mut EngineParams) -> Option<&mut f64>,
}

fn shift(p: &mut EngineParams) -> Option<&mut CamShift> {
    p.cams.as_mut()?.shift.as_mut()
}

/// The exhaust manifold where it is one lump with its ports.
fn lumped(p: &mut EngineParams) -> Option<&mut Manifold> {
    p.exhaust_wall.is_none().then_some(&mut p.exhaust_manifold)
}

/// A row of the table.
macro_rules! row {
    ($key:literal, $what:literal, $low:literal, $high:literal, $needs:ident, $place:expr) => {
        Constant { key: $key, what: $what, range: ($low, $high), needs: Compared::$needs, place: $place }
    };
}

/// All of them. Ranges: Heywood 1988 for efficiency, friction and discharge; Woschni's factor as authors have moved it;
/// areas of a turbine and a tailpipe of engines of 1 to 3 l.
pub static CONSTANTS: &[Constant] = &[
    row!("burn.efficiency", "combustion efficiency at lambda 1", 0.88, 0.965, Torque, |p| Some(
        &mut p.burn.efficiency
    )),
    row!("burn.efficiency_bump", "gain of efficiency away from lambda 1", 0.0, 0.035, Torque, |p| Some(
        &mut p.burn.efficiency_bump
    )),
    row!("friction.constant_pa", "friction, constant part", 30e3, 160e3, Torque, |p| Some(
        &mut p.friction.constant_pa
    )),
    row!("friction.linear_pa_s_m", "friction, linear in piston speed", 0.0, 20e3, Torque, |p| Some(
        &mut p.friction.linear_pa_s_m
    )),
    row!("heat.scale", "factor of the heat law", 0.6, 2.2, ExhaustTemperature, |p| Some(&mut p.heat.scale)),
    row!("intake_valve.flow_coefficient", "discharge of the intake valves", 0.35, 0.8, Air, |p| Some(
        &mut p.intake_valve.flow_coefficient
    )),
    row!("intake_valve.duration_deg", "opening of the intake valves", 220.0, 270.0, Air, |p| Some(
        &mut p.intake_valve.duration_deg
    )),
    row!("intake_manifold.ua_w_k", "heat of the intake manifold", 0.0, 30.0, Air, |p| Some(
        &mut p.intake_manifold.ua_w_k
    )),
    row!("exhaust_manifold.ua_w_k", "heat of the exhaust manifold", 1.0, 40.0, ExhaustTemperature, |p| {
        lumped(p).map(|m| &mut m.ua_w_k)
    }),
    row!("exhaust_manifold.wall_k", "wall of the exhaust manifold", 300.0, 800.0, ExhaustTemperature, |p| {
        lumped(p).map(|m| &mut m.wall_k)
    }),
    row!("exhaust_wall.port_w_k", "heat of the exhaust ports", 1.0, 40.0, ExhaustTemperature, |p| Some(
        &mut p.exhaust_wall.as_mut()?.port_w_k
    )),
    row!("exhaust_wall.flow_exponent", "growth of that heat with flow", 0.0, 0.8, ExhaustTemperature, |p| {
        Some(&mut p.exhaust_wall.as_mut()?.flow_exponent)
    }),
    row!("exhaust.turbine_m2", "area of the turbine", 1e-4, 8e-4, ExhaustPressure, |p| Some(
        &mut p.exhaust.turbine_m2
    )),
    row!("exhaust.tailpipe_m2", "area of catalyst and tailpipe", 6e-4, 4e-3, SystemPressure, |p| Some(
        &mut p.exhaust.tailpipe_m2
    )),
    row!("turbocharger.turbine_efficiency", "efficiency of the turbine", 0.4, 0.85, ExhaustPressure, |p| {
        Some(&mut p.turbocharger.as_mut()?.turbine_efficiency)
    }),
    row!("cams.shift.intake_deg", "intake cam, everywhere", -20.0, 30.0, Air, |p| Some(
        &mut shift(p)?.intake_deg
    )),
    row!("cams.shift.exhaust_deg", "exhaust cam, everywhere", -40.0, 15.0, Air, |p| Some(
        &mut shift(p)?.exhaust_deg
    )),
    row!("cams.shift.intake_bell_deg", "intake cam, height of the bell", -10.0, 50.0, Air, |p| Some(
        &mut shift(p)?.intake_bell_deg
    )),
    row!("cams.shift.exhaust_bell_deg", "exhaust cam, height of the bell", -10.0, 40.0, Air, |p| Some(
        &mut shift(p)?.exhaust_bell_deg
    )),
    row!("cams.shift.summit_kpa", "pressure of the summit of the bell", 35.0, 90.0, Air, |p| Some(
        &mut shift(p)?.summit_kpa
    )),
    row!("cams.shift.boost_deg", "cams, boost at low speed", -10.0, 50.0, Air, |p| Some(
        &mut shift(p)?.boost_deg
    )),
];
