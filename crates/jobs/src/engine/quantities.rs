//! What is read at a steady point: the columns of tables, files and pages.

use dynocal_files::csv_io;
use dynocal_plant::full_load::REACHED_NM;
use dynocal_plant::inputs::Inputs;
use dynocal_plant::outputs::Outputs;
use dynocal_plant::params::EngineParams;
use serde::Serialize;

use super::EngineJobError;

/// Inputs and outputs of one point.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Point {
    /// What was set.
    pub inputs: Inputs,
    /// What came out.
    pub outputs: Outputs,
}

impl Point {
    /// As it is shown: what this engine lacks, and a consumption of no power, are no numbers.
    pub fn shown(&self, params: &EngineParams) -> Self {
        let mut p = *self;
        let has = |name: &str| params.lacks(name).is_none();
        let clear = |absent: bool, values: &mut [&mut f64]| {
            if absent {
                values.iter_mut().for_each(|v| **v = f64::NAN);
            }
        };
        let (u, y) = (&mut p.inputs, &mut p.outputs);
        clear(!has("wastegate"), &mut [&mut u.wastegate_mm, &mut y.turbo_rpm]);
        clear(!has("egr"), &mut [&mut u.egr_mm, &mut y.egr_rate]);
        clear(!has("knock"), &mut [&mut y.knock]);
        clear(!has("no"), &mut [&mut y.no_ppm, &mut y.co_pct, &mut y.hc_ppm]);
        // A torque that cannot be told from none leaves no power that fuel could be related to.
        clear(y.torque_nm < REACHED_NM, &mut [&mut y.bsfc_g_kwh]);
        p
    }
}

/// A column of the table of points.
#[derive(Clone, Copy)]
pub struct Quantity {
    /// Name.
    pub name: &'static str,
    /// Unit.
    pub unit: &'static str,
    /// Significant digits that are shown.
    pub digits: usize,
    /// Its value at a point.
    pub value: fn(&Point) -> f64,
}

impl Quantity {
    /// Name with unit.
    pub fn title(&self) -> String {
        format!("{} [{}]", self.name, self.unit)
    }

    /// The value at a point as text.
    pub fn text(&self, p: &Point) -> String {
        match (self.value)(p) {
            none if none.is_nan() => "-".into(),
            value => dynocal_report::significant(value, self.digits),
        }
    }
}

const fn row(name: &'static str, unit: &'static str, digits: usize, value: fn(&Point) -> f64) -> Quantity {
    Quantity { name, unit, digits, value }
}

/// All columns, inputs first.
pub static QUANTITIES: &[Quantity] = &[
    row("speed", "rpm", 4, |p| p.inputs.speed_rpm),
    row("throttle", "deg", 4, |p| p.inputs.throttle_deg),
    row("spark", "deg", 4, |p| p.inputs.spark_deg),
    row("inj", "mg", 4, |p| p.inputs.injection_mg),
    row("intake_cam", "deg", 4, |p| p.inputs.intake_mop_deg_btdc),
    row("exhaust_cam", "deg", 4, |p| p.inputs.exhaust_mop_deg_atdc),
    row("wastegate", "mm", 3, |p| p.inputs.wastegate_mm),
    row("egr", "mm", 3, |p| p.inputs.egr_mm),
    row("wiebe_m", "-", 3, |p| p.inputs.wiebe_m),
    row("torque", "Nm", 5, |p| p.outputs.torque_nm),
    row("lambda", "-", 4, |p| p.outputs.lambda),
    row("map", "kPa", 4, |p| p.outputs.map_kpa),
    row("egt", "degC", 4, |p| p.outputs.egt_k - 273.15),
    row("air", "g/s", 4, |p| p.outputs.air_g_s),
    row("fuel", "kg/h", 4, |p| p.outputs.fuel_kg_h),
    row("bsfc", "g/kWh", 4, |p| p.outputs.bsfc_g_kwh),
    row("imep", "bar", 4, |p| p.outputs.imep_bar),
    row("pmep", "bar", 3, |p| p.outputs.pmep_bar),
    row("fmep", "bar", 3, |p| p.outputs.fmep_bar),
    row("pmax", "bar", 4, |p| p.outputs.pmax_bar),
    row("ca50", "deg", 3, |p| p.outputs.ca50_deg),
    row("burn_10_90", "deg", 4, |p| p.outputs.burn_deg),
    row("residual", "-", 3, |p| p.outputs.residual),
    row("vol_eff", "-", 3, |p| p.outputs.volumetric_efficiency),
    row("boost", "kPa", 4, |p| p.outputs.boost_kpa),
    row("exhaust", "kPa", 4, |p| p.outputs.exhaust_kpa),
    row("turbo", "rpm", 4, |p| p.outputs.turbo_rpm),
    row("knock", "-", 3, |p| p.outputs.knock),
    row("egr_rate", "-", 3, |p| p.outputs.egr_rate),
    row("no", "ppm", 3, |p| p.outputs.no_ppm),
    row("co", "%", 3, |p| p.outputs.co_pct),
    row("hc", "ppm", 3, |p| p.outputs.hc_ppm),
];

/// The column of that name.
pub fn find(name: &str) -> Option<&'static Quantity> {
    QUANTITIES.iter().find(|q| q.name == name)
}

/// Writes all columns of `points` to a CSV file.
///
/// # Errors
/// [`EngineJobError::Files`].
pub fn csv(path: &std::path::Path, points: &[Point]) -> Result<(), EngineJobError> {
    let values: Vec<Vec<f64>> = QUANTITIES.iter().map(|q| points.iter().map(q.value).collect()).collect();
    let columns: Vec<(&str, &str, &[f64])> =
        QUANTITIES.iter().zip(&values).map(|(q, v)| (q.name, q.unit, v.as_slice())).collect();
    csv_io::write_columns(path, &columns)?;
    Ok(())
}
