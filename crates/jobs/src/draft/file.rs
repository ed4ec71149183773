//! What a measurement file holds, as far as a spec has to say it.

use std::path::Path;

use dynocal_files::FilesError;
use dynocal_files::dataset::read_table_with;
use dynocal_files::measurement::time_column;
use dynocal_files::table::{Cells, Column, Table};
use dynocal_files::units;
use dynocal_ident::data::Role;

use super::{DraftError, Wishes};

/// A channel of the file that holds numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct FoundChannel {
    /// Column.
    pub column: String,
    /// Name for models: the column where it is a word of letters, digits and `_`.
    pub name: String,
    /// Unit; `-` where the file has none.
    pub unit: String,
    /// Whether the file says the unit.
    pub has_unit: bool,
    /// Least value.
    pub lower: f64,
    /// Greatest value.
    pub upper: f64,
    /// Range without its outermost hundredth at either end: of an output short peaks are left out.
    pub usual: [f64; 2],
    /// Mean of the values that are there.
    pub mean: f64,
    /// Empty cells.
    pub gaps: usize,
    /// What it is by the wishes.
    pub role: Role,
}

/// Time stamps of the file.
#[derive(Clone, Debug, PartialEq)]
pub struct FoundTime {
    /// Column.
    pub column: String,
    /// Unit where the file does not say it.
    pub assumed_unit: Option<&'static str>,
    /// Whether the stamps are uniform.
    pub uniform: bool,
    /// Pause in s that cuts the file into experiments; none where there is none and no stamp goes back.
    pub pause_s: Option<f64>,
}

/// What a file holds.
#[derive(Clone, Debug, PartialEq)]
pub struct Found {
    /// File.
    pub file: String,
    /// Rows.
    pub rows: usize,
    /// Time stamps, of a record that has them.
    pub time: Option<FoundTime>,
    /// Sample time in s; none for steady points.
    pub sample_time_s: Option<f64>,
    /// Channels of numbers that move.
    pub channels: Vec<FoundChannel>,
    /// Columns that are left out, each with why.
    pub left_out: Vec<String>,
    /// What was assumed, in sentences.
    pub notes: Vec<String>,
}

/// Reads `file` and says what it holds.
///
/// # Errors
/// [`DraftError`].
pub fn found(file: &Path, wishes: &Wishes) -> Result<Found, DraftError> {
    found_for(file, wishes, !wishes.steady)
}

/// The same; `timed` says whether rows must be samples in time.
pub(super) fn found_for(file: &Path, wishes: &Wishes, timed: bool) -> Result<Found, DraftError> {
    let table = read_table_with(file, wishes.format, &wishes.read)?;
    let name = file.display().to_string();
    let lacks = |found: String, expected: &str| DraftError::Lacks {
        file: name.clone(),
        found,
        expected: expected.into(),
    };
    let mut notes = Vec::new();
    let stamps = time_column(&table).map(|c| c.name.clone()).filter(|_| !wishes.steady);
    let (time, sample_time_s) = match &stamps {
        Some(column) => {
            let (time, dt) = clock(&table, column)?;
            (Some(time), Some(wishes.sample_time_s.unwrap_or(dt)))
        }
        None => (None, wishes.sample_time_s.filter(|_| !wishes.steady)),
    };
    if sample_time_s.is_none() && timed {
        return Err(lacks(
            "no column of time stamps".into(),
            "one called time (or t, timestamp, zeit, with its unit as `t [ms]` or `t_ms`), --sample-time-s S (samples S apart), or --steady (every row is a steady point)",
        ));
    }
    let (mut channels, mut left_out) = (Vec::new(), Vec::new());
    for c in table.columns.iter().filter(|c| Some(&c.name) != stamps.as_ref()) {
        let wished = |list: &[String]| list.contains(&c.name);
        let wished = wished(&wishes.outputs) || wished(&wishes.inputs) || wished(&wishes.given);
        match channel(&table, c) {
            Ok(_) if !wished && numbers_rows(&table, c) => {
                left_out.push(format!("`{}`: the number of the row", c.name));
            }
            Ok(found) => channels.push(found),
            Err(why) => left_out.push(format!("`{}`: {why}", c.name)),
        }
        let left_out = |why: String| format!("`{}` is left out: {why}: mend the file to have it.", c.name);
        notes.extend(bad_cells(&table, c).map(left_out));
    }
    for wanted in wishes.outputs.iter().chain(&wishes.inputs).chain(&wishes.given) {
        if !channels.iter().any(|c| c.column == *wanted || c.name == *wanted) {
            let column = table.column(wanted)?;
            let why = channel(&table, column).err().unwrap_or_default();
            let why = bad_cells(&table, column).unwrap_or(why);
            return Err(lacks(format!("`{wanted}`: {why}"), "a channel of numbers that moves"));
        }
    }
    roles(&mut channels, wishes);
    if wishes.outputs.is_empty()
        && let Some(last) = channels.iter_mut().rev().find(|c| c.role == Role::Input)
    {
        last.role = Role::Output;
        notes.push(format!(
            "The last channel that moves, `{}`, is taken as the output: name others with --output.",
            last.name
        ));
    }
    let has = |role: Role| channels.iter().any(|c| c.role == role);
    if !has(Role::Input) || !has(Role::Output) {
        let why =
            if left_out.is_empty() { String::new() } else { format!("; left out: {}", left_out.join("; ")) };
        return Err(lacks(
            format!("{} channels of numbers that move{why}", channels.len()),
            "an input and an output",
        ));
    }
    if let Some(c) = channels.iter().find(|c| !c.has_unit) {
        notes.push(format!(
            "`{}` and whatever else has no unit in the file gets the unit `-`: write what it is.",
            c.column
        ));
    }
    let rows = table.rows();
    Ok(Found { file: name, rows, time, sample_time_s, channels, left_out, notes })
}

/// Outputs and inputs as they are named; what a plan demanded and what a meter said beside a record drives nothing.
fn roles(channels: &mut [FoundChannel], wishes: &Wishes) {
    let names: Vec<String> = channels.iter().map(|c| c.name.clone()).collect();
    for c in channels {
        let demanded = names.iter().any(|n| c.name == format!("{n}_demand"));
        let beside = demanded || c.name.ends_with("_measured");
        let is_input = named(c, &wishes.inputs) || named(c, &wishes.given);
        c.role = if named(c, &wishes.outputs) {
            Role::Output
        } else if is_input || (wishes.inputs.is_empty() && !beside) {
            Role::Input
        } else {
            Role::Auxiliary
        };
    }
}

/// Intervals that make a pause.
const PAUSE: f64 = 20.0;

/// Whether a channel is in a list of names.
pub(super) fn named(c: &FoundChannel, names: &[String]) -> bool {
    names.iter().any(|n| *n == c.column || *n == c.name)
}

/// Unit, interval in s and evenness of the stamps.
fn clock(table: &Table, column: &str) -> Result<(FoundTime, f64), DraftError> {
    let unit = table.column(column)?.unit.as_ref().map(|u| u.0.clone());
    let assumed_unit = if unit.is_none() { Some("s") } else { None };
    let scale = units::conversion(unit.as_deref().unwrap_or("s"), "s").map_or(1.0, |c| c.0);
    let stamps = table.numbers(column, 0, table.rows())?;
    let mut intervals: Vec<f64> = stamps.windows(2).map(|w| scale * (w[1] - w[0])).collect();
    let lacks = |found: String| DraftError::Lacks {
        file: table.file.clone(),
        found,
        expected: format!("two rows or more, `{column}` increasing in most of them"),
    };
    if intervals.is_empty() {
        return Err(lacks(format!("{} rows", table.rows())));
    }
    // `identify` refuses stamps twice: which of two rows is meant, nobody knows.
    let repeats = || intervals.iter().enumerate().filter(|(_, d)| **d == 0.0);
    if let Some((first, _)) = repeats().next() {
        return Err(DraftError::Lacks {
            file: table.file.clone(),
            found: format!(
                "{} stamps that repeat the one before, the first in {}",
                repeats().count(),
                table.place(first + 1)
            ),
            expected:
                "each stamp once; `dynocal convert FILE NEW.csv --sample-time-s S` takes one row of each"
                    .into(),
        });
    }
    let middle = intervals.len() / 2;
    let dt = *intervals.select_nth_unstable_by(middle, f64::total_cmp).1;
    if !(dt > 0.0) {
        return Err(lacks(format!("an interval of {dt} s in the middle")));
    }
    // As `identify` takes them: half a percent of an interval is rounding.
    let uniform = intervals.iter().all(|d| (d - dt).abs() <= 5e-3 * dt);
    // Stamps are printed with few digits, so is what is between them.
    let short = |v: f64| format!("{v:.6e}").parse().unwrap_or(v);
    let pause = short(PAUSE * dt);
    let pause_s = intervals.iter().any(|d| *d <= 0.0 || *d > pause).then_some(pause);
    Ok((FoundTime { column: column.into(), assumed_unit, uniform, pause_s }, short(dt)))
}

/// First and last hundredth of values; all of them where these are one.
fn usual(values: &[f64]) -> [f64; 2] {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let at = |share: f64| sorted[(share * (sorted.len() - 1) as f64).round() as usize];
    if at(0.01) < at(0.99) { [at(0.01), at(0.99)] } else { [at(0.0), at(1.0)] }
}

/// A channel of numbers that moves, or why it is none.
fn channel(table: &Table, c: &Column) -> Result<FoundChannel, String> {
    let values = match &c.cells {
        Cells::Text(_) if table.numbers_or_missing(&c.name, 0, table.rows()).is_err() => {
            let first = c.cells.label(0);
            let row = if units::is_known(&first) { " (a row of units? --csv 'unit_row = true')" } else { "" };
            return Err(format!("words, e.g. `{first}`{row}"));
        }
        _ => table.numbers_or_missing(&c.name, 0, table.rows()).map_err(|e| e.to_string())?,
    };
    let there: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    let (lower, upper) =
        there.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, u), v| (l.min(*v), u.max(*v)));
    if there.is_empty() {
        return Err("no value".into());
    }
    if lower >= upper {
        return Err(format!("constant, {lower}"));
    }
    let aside = units::from_parentheses(&c.name);
    let unit = c.unit.as_ref().map(|u| u.0.clone()).or(aside.clone());
    let name = if aside.is_some() { c.name.split('(').next().unwrap_or(&c.name) } else { &c.name };
    Ok(FoundChannel {
        column: c.name.clone(),
        name: word(name),
        has_unit: unit.is_some(),
        unit: unit.unwrap_or_else(|| "-".into()),
        lower,
        upper,
        usual: usual(&there),
        mean: there.iter().sum::<f64>() / there.len() as f64,
        gaps: values.len() - there.len(),
        role: Role::Input,
    })
}

/// Whether a column numbers the rows: points have numbers, and nothing moves with them. One that is called so, with whole numbers; or one without a unit that counts from 0 or 1.
fn numbers_rows(table: &Table, c: &Column) -> bool {
    let Ok(values) = table.numbers_or_missing(&c.name, 0, table.rows()) else { return false };
    let called =
        ["point", "nr", "no", "number", "index", "row"].iter().any(|n| c.name.eq_ignore_ascii_case(n));
    let whole = values.iter().all(|v| v.fract() == 0.0);
    let counts =
        values.len() > 2 && [0.0, 1.0].contains(&values[0]) && values.windows(2).all(|w| w[1] == w[0] + 1.0);
    called && whole || counts && c.unit.is_none()
}

/// A column of numbers but for some cells, which leave it out: that is a fault of the file rather than a column of words.
fn bad_cells(table: &Table, c: &Column) -> Option<String> {
    let Cells::Text(cells) = &c.cells else { return None };
    let Err(FilesError::Cell { place, found, .. }) = table.numbers_or_missing(&c.name, 0, cells.len()) else {
        return None;
    };
    let numbers = cells.iter().filter(|t| t.trim().replacen(',', ".", 1).parse::<f64>().is_ok()).count();
    (2 * numbers > cells.len()).then(|| {
        format!(
            "{} of its {} cells are no numbers, the first `{found}` in {place}",
            cells.len() - numbers,
            cells.len()
        )
    })
}

/// A name that a regressor may hold.
fn word(column: &str) -> String {
    let fits = |c: char| c.is_ascii_alphanumeric() || c == '_';
    let mut name: String = column.chars().map(|c| if fits(c) { c } else { '_' }).collect();
    while name.contains("__") {
        name = name.replace("__", "_");
    }
    let name = name.trim_matches('_').to_string();
    if name.starts_with(|c: char| c.is_ascii_digit()) || name.is_empty() { format!("c{name}") } else { name }
}
