//! What can be read from a bed by name: outputs beyond the standard five, and the quantities of limits.

use super::state::BedState;
use crate::engine::VirtualEngine;
use crate::outputs::Outputs;

/// Everything that a quantity may be computed from.
pub(crate) struct Readings<'a> {
    pub(crate) y: &'a Outputs,
    pub(crate) engine: &'a VirtualEngine,
    pub(crate) bed: &'a BedState,
    /// Lambda, mean of the tick.
    pub(crate) lambda: f64,
}

/// One quantity.
pub(crate) struct Quantity {
    pub(crate) name: &'static str,
    pub(crate) unit: &'static str,
    pub(crate) range: (f64, f64),
    pub(crate) what: &'static str,
    /// Value, true and present.
    pub(crate) value: fn(&Readings<'_>) -> f64,
    /// Read as the mean over a sample (otherwise its last value).
    pub(crate) mean: bool,
    /// Means nothing without fuel.
    pub(crate) needs_fuel: bool,
}

const fn quantity(
    name: &'static str,
    unit: &'static str,
    range: (f64, f64),
    what: &'static str,
    value: fn(&Readings<'_>) -> f64,
) -> Quantity {
    Quantity { name, unit, range, what, value, mean: false, needs_fuel: false }
}

/// Number of outputs that every bed has: the first rows of the table.
pub(crate) const STANDARD: usize = 5;

/// All quantities, the standard outputs first.
pub(crate) static QUANTITIES: &[Quantity] = &[
    quantity("torque", "Nm", (-100.0, 500.0), "Torque sensor: 720 deg mean and lag", |r| r.y.torque_nm),
    Quantity {
        mean: true,
        needs_fuel: true,
        ..quantity("lambda", "-", (0.0, 9.99), "Lambda of the exhaust manifold", |r| r.lambda)
    },
    quantity("map", "kPa", (0.0, 300.0), "Intake manifold pressure, cycle mean", |r| r.y.map_kpa),
    quantity("egt", "K", (200.0, 1500.0), "Exhaust gas temperature, weighted with the flow", |r| r.y.egt_k),
    quantity("fuel", "kg/h", (0.0, 100.0), "Fuel that the injectors give, thesis eq. 7.11", |r| {
        r.y.fuel_kg_h
    }),
    quantity("engine_speed", "rpm", (0.0, 7000.0), "Speed of the shaft", |r| r.bed.dyno.speed_rpm()),
    quantity("load", "Nm", (-1000.0, 1000.0), "Torque of the dynamometer", |r| r.bed.dyno.load_nm),
    quantity("boost", "kPa", (0.0, 400.0), "Pressure before the throttle", |r| r.y.boost_kpa),
    quantity("exhaust", "kPa", (0.0, 500.0), "Exhaust manifold pressure, cycle mean", |r| r.y.exhaust_kpa),
    quantity("air", "g/s", (-50.0, 300.0), "Air flow, cycle mean", |r| r.y.air_g_s),
    quantity("pmax", "bar", (0.0, 250.0), "Peak pressure of the last cycles, highest cylinder", |r| {
        r.engine.cycle_log().iter().map(|c| 1e-5 * c.peak_pa).fold(0.0, f64::max)
    }),
    quantity("imep", "bar", (-5.0, 40.0), "Indicated mean effective pressure, gross", |r| r.y.imep_bar),
    Quantity {
        needs_fuel: true,
        ..quantity(
            "cov_imep",
            "%",
            (0.0, 100.0),
            "Coefficient of variation of the gross IMEP, rms of the cylinders, last 50 cycles",
            |r| 100.0 * rms_variation(r.engine),
        )
    },
    quantity("ca50", "deg", (-60.0, 120.0), "Angle of 50 % burned", |r| r.y.ca50_deg),
    quantity("residual", "-", (0.0, 1.0), "Residual fraction", |r| r.y.residual),
    Quantity {
        needs_fuel: true,
        ..quantity(
            "burned_share",
            "-",
            (0.0, 1.0),
            "Share of the fuel that can burn which burns, least cylinder",
            |r| least_burned_share(r.engine),
        )
    },
    quantity("knock", "-", (0.0, 1e3), "Knock integral, worst of the last cycles; 1 is the onset", |r| {
        r.y.knock
    }),
    quantity("turbo_speed", "rpm", (0.0, 4e5), "Speed of the turbocharger", |r| r.y.turbo_rpm),
    quantity("surge", "-", (0.0, 1.0), "Share of the cycle in which the compressor surged", |r| r.y.surge),
    quantity("egr_rate", "-", (0.0, 1.0), "Recirculated gas over recirculated gas and air", |r| r.y.egr_rate),
    quantity("no", "ppm", (0.0, 2e4), "Nitric oxide before the catalyst, wet", |r| r.y.no_ppm),
    quantity("co", "%", (0.0, 30.0), "Carbon monoxide before the catalyst", |r| r.y.co_pct),
    quantity("hc", "ppm", (0.0, 1e6), "Unburned fuel before the catalyst, C1", |r| r.y.hc_ppm),
    quantity("throttle_angle", "deg", (0.0, 90.0), "Throttle behind its actuator", |r| r.bed.throttle.value),
    quantity("wastegate_bore", "mm", (0.0, 28.0), "Wastegate behind its actuator", |r| r.bed.wastegate.value),
    quantity("spark_angle", "deg", (-10.0, 55.0), "Spark after back-off", |r| {
        r.engine.state().inputs.spark_deg
    }),
    quantity("injected", "mg", (0.0, 120.0), "Fuel after loops, cut-off and back-off", |r| {
        r.engine.state().inputs.injection_mg
    }),
    quantity("wall", "K", (200.0, 700.0), "Cylinder walls (warm-up)", |r| {
        r.bed.thermal.map_or(r.engine.params().heat.wall_k, |t| t.wall_k)
    }),
    quantity("coolant", "K", (200.0, 500.0), "Coolant (warm-up)", |r| {
        r.bed.thermal.map_or(363.15, |t| t.coolant_k)
    }),
    quantity("oil", "K", (200.0, 500.0), "Oil (warm-up)", |r| r.bed.thermal.map_or(363.15, |t| t.oil_k)),
    quantity("manifold_wall", "K", (200.0, 1600.0), "Wall of the exhaust manifold", |r| {
        r.engine.manifold_wall_k()
    }),
    quantity("lambda_post", "-", (0.0, 9.99), "Lambda behind the catalyst", |r| {
        r.bed.catalyst.map_or(r.lambda, |c| c.lambda)
    }),
    quantity("catalyst", "K", (200.0, 1600.0), "Brick of the catalyst, mean of its cells", |r| {
        r.bed.catalyst.map_or(r.y.exhaust_k, |c| c.mean_k())
    }),
    quantity("catalyst_inlet", "K", (200.0, 1600.0), "First cell of the catalyst", |r| {
        r.bed.catalyst.map_or(r.y.exhaust_k, |c| c.brick_k[0])
    }),
    quantity("conversion", "-", (0.0, 1.0), "Share of the unburned gas that the catalyst converts", |r| {
        r.bed.catalyst.map_or(0.0, |c| c.conversion)
    }),
    quantity("oxygen", "-", (0.0, 1.0), "Filling of the catalyst's oxygen store", |r| {
        r.bed.catalyst.map_or(0.5, |c| c.filling)
    }),
];

/// Fuel latched to burn over the fuel that could burn with the air there is, least cylinder of the last latches.
fn least_burned_share(engine: &VirtualEngine) -> f64 {
    let afr = engine.params().gas.afr_stoich;
    let share = |c: &crate::state::Cylinder| {
        let fuel = c.trapped_kg * (1.0 - c.residual) / (1.0 + c.lambda * afr);
        let limited = fuel * c.lambda.min(1.0);
        if limited > 0.0 { c.burnable_kg / limited } else { 1.0 }
    };
    engine.state().cylinders.iter().map(share).fold(1.0, f64::min)
}

/// Coefficient of variation of the gross work from cycle to cycle, root mean square of the cylinders \[-\];
/// 1 at most, as without work it has no bound.
fn rms_variation(engine: &VirtualEngine) -> f64 {
    let squares = engine.state().cylinders.iter().map(|c| c.variation.coefficient().powi(2));
    (0.25 * squares.sum::<f64>()).sqrt().min(1.0)
}

/// Row of a name.
pub(crate) fn find(name: &str) -> Option<usize> {
    QUANTITIES.iter().position(|q| q.name == name)
}

/// Name, unit and meaning of every quantity of a bed.
pub fn quantities() -> impl Iterator<Item = (&'static str, &'static str, &'static str)> {
    QUANTITIES.iter().map(|q| (q.name, q.unit, q.what))
}
