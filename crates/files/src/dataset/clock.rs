//! Sample times and stamps of a table.

use dynocal_ident::data::{Channel, Role};

use super::{STAMPS, Time};
use crate::error::FilesError;
use crate::table::Table;
use crate::units;

/// Sample time of the rows `from..to`, with the stamps checked where there are any, and the stamps as a channel where
/// they are to be kept.
pub(super) fn clock(
    table: &Table,
    time: &Time,
    from: usize,
    to: usize,
) -> Result<(f64, Option<Channel>), FilesError> {
    match time {
        Time::Steady => Ok((1.0, None)),
        Time::Sampled { sample_time_s } => Ok((*sample_time_s, None)),
        Time::Column { column, unit } => {
            let (stamps, scale) = stamps(table, column, unit.as_deref(), from, to)?;
            Ok((uniform(table, column, stamps, scale, from)?, None))
        }
        Time::Stamps { column, unit } => {
            let (stamps, scale) = stamps(table, column, unit.as_deref(), from, to)?;
            increasing(table, column, stamps, scale, from)?;
            let values = stamps.iter().map(|t| t * scale).collect();
            let (name, unit) = (STAMPS.to_string(), "s".to_string());
            Ok((f64::NAN, Some(Channel { name, unit, role: Role::Auxiliary, values })))
        }
    }
}

/// The stamps as they stand in the file and the factor that brings them to s.
fn stamps<'a>(
    table: &'a Table,
    column: &str,
    unit: Option<&str>,
    from: usize,
    to: usize,
) -> Result<(&'a [f64], f64), FilesError> {
    let stamps = table.numbers(column, from, to)?;
    let c = table.column(column)?;
    let found = unit.map(units::normalise).or(c.unit.as_ref().map(|u| u.0.clone()));
    let Some(found) = found else {
        return Err(FilesError::NoTimeUnit { path: table.file.clone(), column: column.into() });
    };
    match units::conversion(&found, "s") {
        Some((scale, _)) => Ok((stamps, scale)),
        None => Err(FilesError::Unit {
            path: table.file.clone(),
            column: column.into(),
            found,
            expected: "s".into(),
            hint: " (or ms, min, h)".into(),
        }),
    }
}

/// Intervals of `stamps * scale` in s, all positive.
fn increasing(
    table: &Table,
    column: &str,
    stamps: &[f64],
    scale: f64,
    from: usize,
) -> Result<Vec<f64>, FilesError> {
    if stamps.len() < 2 {
        return Err(FilesError::Data(dynocal_ident::data::DataError::TooShort {
            record: table.file.clone(),
            found: stamps.len(),
            expected: 2,
            why: format!("two time stamps in `{column}` give the sample time"),
        }));
    }
    let intervals: Vec<f64> = stamps.windows(2).map(|w| (w[1] - w[0]) * scale).collect();
    match intervals.iter().position(|d| *d <= 0.0) {
        None => Ok(intervals),
        Some(k) if intervals[k] == 0.0 => Err(FilesError::RepeatedTime {
            path: table.file.clone(),
            place: table.place(from + k + 1),
            column: column.into(),
            time_s: stamps[k + 1] * scale,
        }),
        Some(k) => Err(FilesError::BackwardTime {
            path: table.file.clone(),
            place: table.place(from + k + 1),
            column: column.into(),
            time_s: stamps[k + 1] * scale,
            before_s: stamps[k] * scale,
        }),
    }
}

/// Common interval of `stamps * scale`, in s.
fn uniform(table: &Table, column: &str, stamps: &[f64], scale: f64, from: usize) -> Result<f64, FilesError> {
    let intervals = increasing(table, column, stamps, scale, from)?;
    // The median is what the record means even when some stamps are wrong.
    let middle = intervals.len() / 2;
    let expected = *intervals.clone().select_nth_unstable_by(middle, f64::total_cmp).1;
    // Stamps are printed with few digits: half a percent of an interval is rounding, not a gap.
    let tolerance = 5e-3 * expected.abs()
        + 4.0 * f64::EPSILON * stamps.iter().fold(0.0_f64, |m, t| m.max(t.abs())) * scale;
    if let Some(k) = intervals.iter().position(|d| (d - expected).abs() > tolerance) {
        return Err(FilesError::NonUniformTime {
            path: table.file.clone(),
            place: table.place(from + k + 1),
            column: column.into(),
            found_s: intervals[k],
            expected_s: expected,
        });
    }
    let mean = (stamps[stamps.len() - 1] - stamps[0]) * scale / (stamps.len() - 1) as f64;
    Ok(round_digits(mean))
}

/// Ten significant digits: the mean of rounded stamps must not turn 0.03 into 0.030000000000000002.
fn round_digits(x: f64) -> f64 {
    format!("{x:.9e}").parse().unwrap_or(x)
}
