//! A measurement file in another format: merged, renamed, in other units.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::path::Path;

use dynocal_files::FilesError;
use dynocal_files::dataset::Format;
use dynocal_files::measurement::mat;
use dynocal_files::measurement::merge::{self, Keys};
use dynocal_files::measurement::{self, Raster, ReadKeys, WriteFile};
use dynocal_files::table::{Cells, Column, UnitSource, rename};
use dynocal_files::units;
use dynocal_numerics::registry::nearest;

/// How a file is converted.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Conversion {
    /// Format of the input, where neither its first bytes nor its name tell it.
    pub format: Option<Format>,
    /// Dialect of the input, other names of its channels, and how its rasters are merged.
    pub read: ReadKeys,
    /// Whether rasters are merged even where the output can hold several.
    pub merge: bool,
    /// Channels to keep, by their new names; empty for all.
    pub channels: Vec<String>,
    /// Channel (by its new name) and unit.
    pub units: BTreeMap<String, String>,
}

/// Converts `from` into `to` and says what was decided and lost. Stamps are written in s.
///
/// # Errors
/// [`FilesError`]: unreadable or broken input, an output whose format is not written or whose ending is not known, no raster
/// with a time channel, an unknown channel, a unit of another dimension.
///
/// # Examples
/// ```
/// use dynocal_jobs::convert::{Conversion, convert};
/// let tmp = tempfile::tempdir().unwrap();
/// let (from, to) = (tmp.path().join("bed.csv"), tmp.path().join("bed.mf4"));
/// dynocal_files::atomic::write(&from, b"time [ms],trq [lb ft]\n0,100\n20,101\n").unwrap();
/// let how = Conversion { units: [("trq".into(), "Nm".into())].into(), ..Conversion::default() };
/// assert!(convert(&from, &to, &how).unwrap()[0].contains("lbf ft converted to Nm"));
/// ```
pub fn convert(from: &Path, to: &Path, how: &Conversion) -> Result<Vec<String>, FilesError> {
    let (write, several) = writer(to)?;
    let name = how.format.map(String::from);
    let source = measurement::open(from, name.as_deref(), &how.read)?;
    let mut notes = source.notes().to_vec();
    // The raster that gives the time is needed whether its channels are kept or not.
    let all = how.channels.is_empty() || how.read.merge.raster.is_some();
    let offered = RefCell::new(Vec::new());
    let keep = |name: &str| {
        offered.borrow_mut().push(name.to_string());
        all || is_kept(name, how)
    };
    let mut found = measurement::recording_of(source.as_ref(), &keep)?;
    notes.append(&mut found.notes);
    let offered = offered.into_inner();
    if offered.is_empty() {
        return Err(FilesError::Schema {
            path: source.file().into(),
            found: "no group with samples and a time channel".into(),
            expected: format!("at least one ({})", notes.join("; ")),
        });
    }
    let mut rasters = found.rasters;
    notes.extend(rename(&mut columns(&mut rasters), &how.read.alias));
    for wanted in &how.channels {
        if !names(&rasters).contains(wanted) {
            return Err(no_column(source.file(), wanted, offered));
        }
    }
    if how.merge || (rasters.len() > 1 && !several) {
        rasters = vec![merged(source.file(), &rasters, &how.read.merge, &mut notes)?];
    }
    if !how.channels.is_empty() {
        rasters.iter_mut().for_each(|r| r.columns.retain(|c| how.channels.contains(&c.name)));
        rasters.retain(|r| !r.columns.is_empty());
    }
    for (name, unit) in &how.units {
        if !names(&rasters).contains(name) {
            return Err(no_column(source.file(), name, names(&rasters)));
        }
        for column in columns(&mut rasters).into_iter().filter(|c| c.name == *name) {
            notes.push(to_unit(source.file(), column, unit)?);
        }
    }
    if to.extension().is_some_and(|e| e == "mat") {
        // MATLAB has its own rules for names.
        let own = names(&rasters).into_iter().map(|n| (mat::identifier(&n), n)).filter(|(m, n)| m != n);
        notes.extend(own.map(|(m, n)| format!("channel `{n}` is called `{m}` there")));
    }
    write(to, &rasters)?;
    Ok(notes)
}

/// What writes the format of the ending of `to`, and whether it holds several rasters.
fn writer(to: &Path) -> Result<(WriteFile, bool), FilesError> {
    let path = to.display().to_string();
    let known = measurement::endings;
    let row = measurement::by_ending(to)
        .ok_or_else(|| FilesError::Format { path: path.clone(), known: known() })?;
    let reason = format!("{} is read, not written", row.doc.name);
    Ok((row.write.ok_or(FilesError::Write { path, reason })?, row.several))
}

/// Whether a channel is asked for by its name in the file or by the one that it gets.
fn is_kept(name: &str, how: &Conversion) -> bool {
    let is = |c: &String| c == name || how.read.alias.get(c).is_some_and(|a| a.iter().any(|n| n == name));
    how.channels.iter().any(is)
}

fn columns(rasters: &mut [Raster]) -> Vec<&mut Column> {
    rasters.iter_mut().flat_map(|r| &mut r.columns).collect()
}

fn names(rasters: &[Raster]) -> Vec<String> {
    rasters.iter().flat_map(|r| &r.columns).map(|c| c.name.clone()).collect()
}

fn no_column(file: &str, name: &str, known: Vec<String>) -> FilesError {
    FilesError::NoColumn { path: file.into(), found: name.into(), nearest: nearest(name, &known), known }
}

/// One raster of all.
fn merged(
    file: &str,
    rasters: &[Raster],
    keys: &Keys,
    notes: &mut Vec<String>,
) -> Result<Raster, FilesError> {
    let mut table = merge::merge(file, rasters, keys)?;
    notes.append(&mut table.notes);
    match table.columns.remove(0).cells {
        Cells::Number(time_s) => Ok(Raster { name: "merged".into(), time_s, columns: table.columns }),
        Cells::Text(_) => {
            Err(FilesError::Merge { path: file.into(), reason: "the common time is no number".into() })
        }
    }
}

fn to_unit(file: &str, column: &mut Column, unit: &str) -> Result<String, FilesError> {
    let name = column.name.clone();
    let wanted = units::normalise(unit);
    let unit = Some((wanted.clone(), UnitSource::Bracket));
    let Some((found, _)) = std::mem::replace(&mut column.unit, unit) else {
        return Ok(format!("channel `{name}`: the file gives no unit, taken as {wanted}"));
    };
    let refuse = |hint: String| FilesError::Unit {
        path: file.into(),
        column: name.clone(),
        found: found.clone(),
        expected: wanted.clone(),
        hint,
    };
    let Some((scale, offset)) = units::conversion(&found, &wanted) else {
        return Err(refuse(match (units::dimension(&found), units::dimension(&wanted)) {
            (Some(a), Some(b)) => format!(": {a} cannot become {b}"),
            _ => String::new(),
        }));
    };
    match &mut column.cells {
        Cells::Number(v) => v.iter_mut().for_each(|x| *x = *x * scale + offset),
        Cells::Text(_) => return Err(refuse(": the channel holds words".into())),
    }
    let plus = if offset == 0.0 { String::new() } else { format!(", plus {offset}") };
    Ok(format!("channel `{name}`: {found} converted to {wanted} (times {scale}{plus})"))
}
