//! A cycle from a file with time and speed.

use std::path::Path;

use dynocal_files::table::{Column, Table};
use dynocal_plant::vehicle::DriveCycle;

use super::MOST_SECONDS;
use crate::engine::EngineJobError;

/// Reads a cycle: a column in s, and one in m/s, km/h or mph; `seconds` cuts it off. What was decided or lost while the file
/// was read goes to `tell`.
///
/// # Errors
/// [`EngineJobError`]: file, columns, units, times that do not rise, a cycle longer than [`MOST_SECONDS`].
pub fn read(path: &Path, seconds: Option<f64>, tell: &dyn Fn(&str)) -> Result<DriveCycle, EngineJobError> {
    let data = dynocal_files::dataset::read_table(path, None)?;
    data.notes.iter().for_each(|n| tell(n));
    let file = path.display().to_string();
    let column = |what, accepted: &[&str], expected| {
        let is = |c: &&Column| c.unit.as_ref().is_some_and(|(u, _)| accepted.contains(&u.as_str()));
        data.columns.iter().find(is).ok_or_else(|| missing(&file, &data, what, expected))
    };
    let time = column("time", &["s"], "s (time_s, or time [s])")?;
    let speed = column("speed", &["m/s", "km/h", "mph"], "m/s, km/h or mph (speed_mps, or speed [km/h])")?;
    let factor = match speed.unit.as_ref().map_or("", |(u, _)| u.as_str()) {
        "km/h" => 1.0 / 3.6,
        "mph" => 0.447_04,
        _ => 1.0,
    };
    let times = data.numbers(&time.name, 0, data.rows())?;
    let speeds = data.numbers(&speed.name, 0, data.rows())?.iter().map(|v| v * factor).collect();
    let cycle = DriveCycle::new(times.to_vec(), speeds)
        .map_err(|source| EngineJobError::Cycle { file: file.clone(), source })?;
    let cycle = match seconds {
        Some(found) if found.is_nan() || found < 2.0 => {
            return Err(EngineJobError::Number {
                name: "--seconds".into(),
                found,
                expected: "at least 2".into(),
            });
        }
        Some(s) => cycle.shortened(s),
        None => cycle,
    };
    if cycle.duration_s() > MOST_SECONDS {
        let expected =
            format!("at most {MOST_SECONDS} (a gap in the time stamps? --seconds cuts a cycle off)");
        let name = format!("{file}: length of the cycle in s:");
        return Err(EngineJobError::Number { name, found: cycle.duration_s(), expected });
    }
    Ok(cycle)
}

/// Says which units the columns have when none fits.
fn missing(file: &str, data: &Table, what: &'static str, expected: &'static str) -> EngineJobError {
    let file = file.to_string();
    if let Some(c) = data.columns.iter().find(|c| c.name.to_lowercase().starts_with(what)) {
        let found = c.unit.as_ref().map_or("no unit".into(), |(u, _)| u.clone());
        return EngineJobError::Unit { file, column: c.name.clone(), found, expected };
    }
    let names: Vec<&str> = data.columns.iter().map(|c| c.name.as_str()).collect();
    EngineJobError::Column { file, what, columns: names.join(", "), expected }
}
