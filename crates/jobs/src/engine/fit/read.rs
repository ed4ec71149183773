//! A measured map: one steady point a row.

use std::path::Path;

use dynocal_files::table::{Column, Table};
use dynocal_files::units;
use dynocal_plant::driven::Boundary;
use serde::{Deserialize, Serialize};

use crate::engine::EngineJobError;

/// What was measured at a point; none where there is no such column.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// What the engine is driven at.
    pub at: Boundary,
    /// Brake torque \[Nm\].
    pub torque_nm: Option<f64>,
    /// Air \[kg/s\].
    pub air_kg_s: Option<f64>,
    /// Exhaust-manifold temperature \[K\].
    pub exhaust_k: Option<f64>,
    /// Exhaust-manifold pressure \[Pa\].
    pub exhaust_pa: Option<f64>,
    /// Pressure behind the turbine \[Pa\].
    pub system_pa: Option<f64>,
}

/// A map.
#[derive(Clone, Debug)]
pub struct MeasuredMap {
    /// The points, in the order of the file.
    pub points: Vec<Measured>,
    /// What was read from where, and what was assumed where a column is missing.
    pub notes: Vec<String>,
}

/// A column: names that are understood, unit that is worked in.
struct Wanted {
    what: &'static str,
    names: &'static [&'static str],
    unit: &'static str,
    /// Units that are understood.
    expected: &'static str,
}

const SPEED: Wanted = Wanted { what: "speed", names: &["speed"], unit: "rpm", expected: "rpm" };
const INTAKE: Wanted =
    Wanted { what: "p_intake", names: &["p_intake", "map"], unit: "Pa", expected: "Pa, kPa, bar" };
const LAMBDA: Wanted = Wanted { what: "lambda", names: &["lambda"], unit: "-", expected: "-" };
const CHARGE: Wanted = Wanted {
    what: "p_before_throttle",
    names: &["p_before_throttle", "boost"],
    unit: "Pa",
    expected: "Pa, kPa, bar",
};
const CHARGE_T: Wanted =
    Wanted { what: "T_before_throttle", names: &["T_before_throttle"], unit: "K", expected: "K, degC" };
const AMBIENT: Wanted = Wanted {
    what: "p_after_filter",
    names: &["p_after_filter", "p_ambient"],
    unit: "Pa",
    expected: "Pa, kPa, bar",
};
const AMBIENT_T: Wanted = Wanted {
    what: "T_after_filter",
    names: &["T_after_filter", "T_ambient"],
    unit: "K",
    expected: "K, degC",
};
const SPARK: Wanted = Wanted { what: "spark", names: &["spark"], unit: "deg", expected: "deg" };
const INTAKE_CAM: Wanted =
    Wanted { what: "intake_cam", names: &["intake_cam"], unit: "deg", expected: "deg" };
const EXHAUST_CAM: Wanted =
    Wanted { what: "exhaust_cam", names: &["exhaust_cam"], unit: "deg", expected: "deg" };
const TORQUE: Wanted = Wanted { what: "torque", names: &["torque"], unit: "Nm", expected: "Nm" };
const AIR: Wanted = Wanted { what: "air", names: &["air"], unit: "kg/s", expected: "kg/s, g/s, kg/h" };
const EXHAUST_T: Wanted = Wanted {
    what: "T_exhaust_manifold",
    names: &["T_exhaust_manifold", "egt"],
    unit: "K",
    expected: "K, degC",
};
const EXHAUST: Wanted = Wanted {
    what: "p_exhaust_manifold",
    names: &["p_exhaust_manifold", "exhaust"],
    unit: "Pa",
    expected: "Pa, kPa, bar",
};

const SYSTEM: Wanted =
    Wanted { what: "p_exhaust_system", names: &["p_exhaust_system"], unit: "Pa", expected: "Pa, kPa, bar" };

/// Least number of points of a map: a third of them judges some twenty constants.
pub const LEAST_POINTS: usize = 30;

/// Reads a map. Needed are speed, intake pressure, lambda and torque; the rest is used where it is there.
///
/// # Errors
/// [`EngineJobError`]: the file, a column that is missing or in another unit, a cell that is no number, too few rows.
pub fn read(path: &Path) -> Result<MeasuredMap, EngineJobError> {
    let table = dynocal_files::dataset::read_table(path, None)?;
    let file = path.display().to_string();
    let rows = table.rows();
    let mut notes = table.notes.clone();
    let get = |w: &Wanted| find(&file, &table, w);
    let need = |w: &Wanted| get(w)?.ok_or_else(|| missing(&file, &table, w));
    let (speed, intake, lambda, torque) = (need(&SPEED)?, need(&INTAKE)?, need(&LAMBDA)?, need(&TORQUE)?);
    if rows < LEAST_POINTS {
        let expected = format!("at least {LEAST_POINTS}");
        return Err(EngineJobError::Number { name: format!("{file}: rows"), found: rows as f64, expected });
    }
    let mut or =
        |w: &Wanted, instead: &dyn Fn(usize) -> f64, text: &str| -> Result<Vec<f64>, EngineJobError> {
            Ok(get(w)?.unwrap_or_else(|| {
                notes.push(format!("no column {}: {text}", w.what));
                (0..rows).map(instead).collect()
            }))
        };
    let ambient = or(&AMBIENT, &|_| 101_325.0, "101.325 kPa around the engine")?;
    let ambient_k = or(&AMBIENT_T, &|_| 298.15, "298.15 K around the engine")?;
    let charge =
        or(&CHARGE, &|k| intake[k].max(ambient[k]), "the charge pipe at ambient or intake pressure")?;
    let charge_k = or(&CHARGE_T, &|k| ambient_k[k], "the charge as cool as the ambient air")?;
    let (spark, intake_cam, exhaust_cam) = (get(&SPARK)?, get(&INTAKE_CAM)?, get(&EXHAUST_CAM)?);
    if spark.is_none() {
        notes.push(
            "no column spark: best spark (50 % burned at 8 deg) less the retard table of a production engine"
                .into(),
        );
    }
    let schedule = "cams of the schedule, whose constants are inferred";
    match (&intake_cam, &exhaust_cam) {
        (Some(_), Some(_)) => {}
        (None, None) => notes.push(format!("no columns intake_cam and exhaust_cam: {schedule}")),
        (Some(_), None) => notes.push(format!("intake_cam is not used without exhaust_cam: {schedule}")),
        (None, Some(_)) => notes.push(format!("exhaust_cam is not used without intake_cam: {schedule}")),
    }
    let (air, exhaust_k) = (get(&AIR)?, get(&EXHAUST_T)?);
    let (exhaust, system) = (get(&EXHAUST)?, get(&SYSTEM)?);
    for (column, w) in [(&air, &AIR), (&exhaust_k, &EXHAUST_T), (&exhaust, &EXHAUST), (&system, &SYSTEM)] {
        if column.is_none() {
            notes.push(format!("no column {}: not compared", w.what));
        }
    }
    let at = |v: &Option<Vec<f64>>, k: usize| v.as_ref().map(|v| v[k]);
    let points = (0..rows)
        .map(|k| Measured {
            at: Boundary {
                speed_rpm: speed[k],
                charge_pa: charge[k],
                charge_k: charge_k[k],
                intake_pa: intake[k],
                lambda: lambda[k],
                ambient_pa: ambient[k],
                ambient_k: ambient_k[k],
                spark_deg: at(&spark, k),
                cams_deg: at(&intake_cam, k).zip(at(&exhaust_cam, k)).map(|(i, e)| [i, e]),
            },
            torque_nm: Some(torque[k]),
            air_kg_s: at(&air, k),
            exhaust_k: at(&exhaust_k, k),
            exhaust_pa: at(&exhaust, k),
            system_pa: at(&system, k),
        })
        .collect();
    check(&file, &table, points, notes)
}

/// 0 degC in K.
const ZERO_CELSIUS_K: f64 = 273.15;

/// Greatest openings that cams of the engine can have, before and after dead centre \[deg\].
const MOP_DEG: (f64, f64) = (180.0, 300.0);

/// Values that no point of an engine has.
fn check(
    file: &str,
    table: &Table,
    points: Vec<Measured>,
    notes: Vec<String>,
) -> Result<MeasuredMap, EngineJobError> {
    for (k, m) in points.iter().enumerate() {
        let b = &m.at;
        let rows = [
            ("speed in rpm", b.speed_rpm, 600.0, 6500.0),
            ("intake pressure in Pa", b.intake_pa, 1e4, 5e5),
            ("pressure before the throttle in Pa", b.charge_pa, 5e4, 5e5),
            ("temperature before the throttle in K", b.charge_k, 230.0, 450.0),
            ("lambda", b.lambda, 0.5, 2.0),
            ("ambient pressure in Pa", b.ambient_pa, 5e4, 1.2e5),
            ("ambient temperature in K", b.ambient_k, 230.0, 350.0),
            ("spark in deg", b.spark_deg.unwrap_or(0.0), -10.0, 55.0),
            ("intake_cam in deg", b.cams_deg.map_or(MOP_DEG.0, |c| c[0]), MOP_DEG.0, MOP_DEG.1),
            ("exhaust_cam in deg", b.cams_deg.map_or(MOP_DEG.0, |c| c[1]), MOP_DEG.0, MOP_DEG.1),
            ("torque in Nm", m.torque_nm.unwrap_or(0.0), -500.0, 2000.0),
            ("air in kg/s", m.air_kg_s.unwrap_or(0.1), 1e-4, 1.0),
            ("exhaust temperature in K", m.exhaust_k.unwrap_or(900.0), 300.0, 1600.0),
            ("exhaust pressure in Pa", m.exhaust_pa.unwrap_or(1e5), 5e4, 1e6),
            ("pressure behind the turbine in Pa", m.system_pa.unwrap_or(1e5), 5e4, 1e6),
        ];
        for (name, found, low, high) in rows {
            if !(low..=high).contains(&found) {
                let name = format!("{file}: {}: {name}", table.place(k));
                let celsius = name.ends_with(" in K") && (low..=high).contains(&(found + ZERO_CELSIUS_K));
                let hint = if celsius { "; is the column in degC?" } else { "" };
                return Err(EngineJobError::Number {
                    name,
                    found,
                    expected: format!("{low} to {high}{hint}"),
                });
            }
        }
    }
    Ok(MeasuredMap { points, notes })
}

/// The column in the unit that is worked in.
fn find(file: &str, table: &Table, w: &Wanted) -> Result<Option<Vec<f64>>, EngineJobError> {
    let named = |c: &&Column| w.names.iter().any(|n| c.name.eq_ignore_ascii_case(n));
    let Some(column) = table.columns.iter().find(named) else { return Ok(None) };
    let values = table.numbers(&column.name, 0, table.rows())?;
    let from = column.unit.as_ref().map_or("-", |(u, _)| u.as_str());
    let converted = units::conversion(from, w.unit).or_else(|| (from == w.unit).then_some((1.0, 0.0)));
    let Some((factor, offset)) = converted else {
        return Err(EngineJobError::Unit {
            file: file.into(),
            column: column.name.clone(),
            found: if column.unit.is_some() { from.into() } else { "no unit".into() },
            expected: w.expected,
        });
    };
    Ok(Some(values.iter().map(|v| factor * v + offset).collect()))
}

fn missing(file: &str, table: &Table, w: &Wanted) -> EngineJobError {
    let names: Vec<&str> = table.columns.iter().map(|c| c.name.as_str()).collect();
    EngineJobError::Column {
        file: file.into(),
        what: w.what,
        columns: names.join(", "),
        expected: w.expected,
    }
}
