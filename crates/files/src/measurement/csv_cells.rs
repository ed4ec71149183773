//! Cells that are no plain numbers: time stamps and switch states.

use crate::table::{Cells, Column, UnitSource};

/// Words for a closed and an open switch, without case.
const STATES: [(&str, &str); 6] =
    [("on", "off"), ("true", "false"), ("yes", "no"), ("ein", "aus"), ("ja", "nein"), ("active", "inactive")];

/// Turns a column of text into numbers where every cell is a stamp (seconds since the first) or one of two switch
/// states (1 and 0); says what was done.
pub(crate) fn interpret(column: &mut Column) -> Option<String> {
    let Cells::Text(cells) = &column.cells else { return None };
    if let Some((values, on, off)) = switch(cells) {
        column.cells = Cells::Number(values);
        return Some(format!("column `{}`: {on} is 1, {off} is 0", column.name));
    }
    let (values, kind) = stamps(cells)?;
    let note =
        format!("column `{}`: {kind} as seconds since its first value, {}", column.name, cells.first()?);
    column.cells = Cells::Number(values);
    column.unit = Some(("s".into(), UnitSource::Bracket));
    Some(note)
}

fn switch(cells: &[String]) -> Option<(Vec<f64>, &'static str, &'static str)> {
    let first = cells.iter().find(|c| !c.is_empty())?;
    let pair =
        STATES.iter().find(|(on, off)| first.eq_ignore_ascii_case(on) || first.eq_ignore_ascii_case(off))?;
    let value = |c: &String| match c {
        c if c.is_empty() => Some(f64::NAN),
        c if c.eq_ignore_ascii_case(pair.0) => Some(1.0),
        c if c.eq_ignore_ascii_case(pair.1) => Some(0.0),
        _ => None,
    };
    Some((cells.iter().map(value).collect::<Option<Vec<_>>>()?, pair.0, pair.1))
}

fn stamps(cells: &[String]) -> Option<(Vec<f64>, &'static str)> {
    if let Some(clock) = cells.iter().map(|c| clock(c)).collect::<Option<Vec<f64>>>() {
        return Some((since_first(&clock, true), "a clock"));
    }
    let parsed = cells.iter().map(|c| date_time(c)).collect::<Option<Vec<Instant>>>()?;
    let day = parsed.first()?.day;
    // Days are subtracted as whole numbers first: seconds since 1970 would cost the last three digits.
    let seconds: Vec<f64> = parsed.iter().map(|i| (i.day - day) as f64 * 86400.0 + i.second).collect();
    Some((since_first(&seconds, false), "dates and times"))
}

/// Seconds since the first; a clock that jumps back by more than half a day has passed midnight.
fn since_first(seconds: &[f64], wraps: bool) -> Vec<f64> {
    let (mut days, mut last) = (0.0, seconds.first().copied().unwrap_or(0.0));
    let first = last;
    seconds
        .iter()
        .map(|s| {
            if wraps && last - s > 43200.0 {
                days += 86400.0;
            }
            last = *s;
            // Stamps have at most nanoseconds: the binary noise of the difference is taken off.
            ((s + days - first) * 1e9).round() / 1e9
        })
        .collect()
}

/// `hh:mm:ss.fff` in seconds of the day; a decimal comma is read as well.
fn clock(text: &str) -> Option<f64> {
    let mut parts = text.trim().split(':');
    let hours: u32 = digits(parts.next()?, 1, 2)?;
    let minutes: u32 = digits(parts.next()?, 2, 2)?;
    let second = parts.next().unwrap_or("0").replace(',', ".");
    let whole = second.split('.').next()?;
    let ok = parts.next().is_none()
        && (1..=2).contains(&whole.len())
        && second.starts_with(|c: char| c.is_ascii_digit());
    let second: f64 = second.parse().ok()?;
    (ok && hours < 24 && minutes < 60 && second < 61.0)
        .then(|| f64::from(hours) * 3600.0 + f64::from(minutes) * 60.0 + second)
}

fn digits(text: &str, least: usize, most: usize) -> Option<u32> {
    let fits = (least..=most).contains(&text.len()) && text.bytes().all(|b| b.is_ascii_digit());
    if fits { text.parse().ok() } else { None }
}

struct Instant {
    day: i64,
    second: f64,
}

/// `2026-05-01T12:00:00.5+02:00`, with a blank for the T, or `01.05.2026 12:00:00,5`.
fn date_time(text: &str) -> Option<Instant> {
    let (date, time) = text.trim().split_once(['T', ' '])?;
    let (year, month, day) = if let [y, m, d] = date.split('-').collect::<Vec<_>>()[..] {
        (digits(y, 4, 4)?, digits(m, 2, 2)?, digits(d, 2, 2)?)
    } else if let [d, m, y] = date.split('.').collect::<Vec<_>>()[..] {
        (digits(y, 4, 4)?, digits(m, 1, 2)?, digits(d, 1, 2)?)
    } else {
        return None;
    };
    if !(1..=12).contains(&month) || !(1..=31).contains(&day) {
        return None;
    }
    let (time, shift) = zone(time.trim())?;
    Some(Instant {
        day: days(i64::from(year), i64::from(month), i64::from(day)),
        second: clock(time)? - shift,
    })
}

/// Splits the zone off a time; its offset in seconds.
fn zone(time: &str) -> Option<(&str, f64)> {
    if let Some(t) = time.strip_suffix('Z') {
        return Some((t, 0.0));
    }
    match time.rfind(['+', '-']) {
        None => Some((time, 0.0)),
        Some(at) => {
            let (h, m) = time[at + 1..]
                .split_once(':')
                .or_else(|| time.get(at + 1..at + 3).zip(time.get(at + 3..)))?;
            let m = if m.is_empty() { 0 } else { digits(m, 2, 2)? };
            let seconds = f64::from(digits(h, 2, 2)? * 3600 + m * 60);
            Some((&time[..at], if time[at..].starts_with('-') { -seconds } else { seconds }))
        }
    }
}

/// Days since 1970-01-01 of a Gregorian date (Howard Hinnant's algorithm, years counted from March).
fn days(year: i64, month: i64, day: i64) -> i64 {
    let y = if month <= 2 { year - 1 } else { year };
    let era = y.div_euclid(400);
    let year_of_era = y.rem_euclid(400);
    let day_of_year = (153 * ((month + 9) % 12) + 2) / 5 + day - 1;
    era * 146_097 + year_of_era * 365 + year_of_era / 4 - year_of_era / 100 + day_of_year - 719_468
}

#[cfg(test)]
mod tests {
    use super::*;

    fn column(cells: &[&str]) -> Column {
        let cells = Cells::Text(cells.iter().map(|c| (*c).to_string()).collect());
        Column { name: "x".into(), unit: None, cells }
    }

    #[test]
    fn stamps_become_seconds() {
        let cases: [(&[&str], &[f64]); 4] = [
            (&["2026-02-28T23:59:59.5Z", "2026-03-01T00:00:00.25Z"], &[0.0, 0.75]),
            (&["2024-02-28 23:00:00", "2024-03-01 00:00:00"], &[0.0, 90_000.0]),
            (&["23:59:59,990", "00:00:00,010"], &[0.0, 0.02]),
            (&["01.05.2026 12:00:00", "01.05.2026 12:00:01"], &[0.0, 1.0]),
        ];
        for (cells, want) in cases {
            let mut c = column(cells);
            assert!(interpret(&mut c).is_some(), "{cells:?}");
            assert_eq!(c.cells, Cells::Number(want.to_vec()), "{cells:?}");
        }
        let mut zones = column(&["2026-05-01T12:00:00+02:00", "2026-05-01T10:00:01Z"]);
        interpret(&mut zones);
        assert_eq!(zones.cells, Cells::Number(vec![0.0, 1.0]));
        let mut words = column(&["12:00", "noon"]);
        assert!(interpret(&mut words).is_none());
    }

    #[test]
    fn switches_become_one_and_zero() {
        let mut c = column(&["On", "off", "", "ON"]);
        assert_eq!(interpret(&mut c).unwrap(), "column `x`: on is 1, off is 0");
        let Cells::Number(v) = c.cells else { panic!("no numbers") };
        assert_eq!([v[0], v[1], v[3]], [1.0, 0.0, 1.0]);
        assert!(v[2].is_nan());
        assert!(interpret(&mut column(&["On", "Standby"])).is_none());
    }
}
