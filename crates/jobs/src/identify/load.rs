//! From files to the parts of the data: estimation, selection, test.

use std::path::Path;

use dynocal_files::dataset::{Layout, Select, datasets, read_table_with};
use dynocal_files::run_folder::digest;
use dynocal_files::split;
use dynocal_files::table::Table;
use dynocal_files::{FilesError, csv_io};
use dynocal_ident::data::{DataError, Dataset};
use dynocal_ident::stored::StoredModel;
use dynocal_ident::validate::Seen;

use super::error::IdentifyError;
use super::spec::{DeriveSpec, Job, Source, Split, TestSet};

/// Records with one purpose.
#[derive(Clone, Debug)]
pub struct Part {
    /// `estimation`, `selection`, `test`, or the name of a test set.
    pub name: String,
    /// Whether the estimate sees it.
    pub seen: Seen,
    /// Records.
    pub records: Vec<Dataset>,
    /// What was decided or lost while its files were read, with the file.
    pub notes: Vec<String>,
}

/// What any of the models has seen of any of the records.
pub(super) fn seen_by(models: &[StoredModel], records: &[Dataset]) -> Seen {
    let all: Vec<Seen> = models.iter().flat_map(|m| records.iter().map(|d| m.has_seen(d))).collect();
    [Seen::Identification, Seen::Selection].into_iter().find(|s| all.contains(s)).unwrap_or(Seen::Unseen)
}

/// All parts, the estimation first.
///
/// # Errors
/// [`IdentifyError`]: files, columns, units; a part that holds nothing.
pub fn parts(job: &Job, note: &dyn Fn(&str)) -> Result<Vec<Part>, IdentifyError> {
    let mut found = [Vec::new(), Vec::new(), Vec::new()];
    let several = job.sources.len() > 1;
    let mut notes = Vec::new();
    for source in &job.sources {
        let table = read_source(source, &job.layout, note, &mut notes)?;
        for (part, mut records) in found.iter_mut().zip(split_table(job, &table)?) {
            if several {
                let stem = stem(source);
                records.iter_mut().for_each(|d| d.name = format!("{stem}-{}", d.name));
            }
            part.append(&mut records);
        }
    }
    let names = ["estimation", "selection", "test"];
    // A model that is only scored has seen none of them.
    let names = if job.saved.is_empty() { names } else { ["record", "selection", "test"] };
    let seen = seen_of_file(job, &found)?;
    let mut parts: Vec<Part> = names
        .iter()
        .zip(seen)
        .zip(found)
        .filter(|(_, records)| !records.is_empty())
        .map(|((name, seen), records)| Part { name: (*name).into(), seen, records, notes: Vec::new() })
        .collect();
    // What estimates is never taken from what tests.
    if parts.first().is_none_or(|p| p.name != names[0]) {
        let record = job.sources.iter().map(stem).collect::<Vec<_>>().join(", ");
        let why = format!("the split leaves nothing for the {}", names[0]);
        return Err(DataError::TooShort { record, found: 0, expected: 1, why }.into());
    }
    // The files of the parts are the same: their notes are told once.
    if let Some(first) = parts.first_mut() {
        first.notes = notes;
    }
    for test in &job.tests {
        // Other columns of the same file are other data.
        let same = job.sources.iter().find(|s| same_file(&s.file, &test.source.file));
        if let Some(same) = same.filter(|_| test.columns.is_empty()) {
            return Err(IdentifyError::SameFile {
                test: test.name.clone(),
                file: same.file.display().to_string(),
            });
        }
        parts.push(test_set(job, test, note)?);
    }
    completed(job, parts)
}

/// What the parameters have seen of the parts of a file. Of models that are only scored: what they remember of their records; where they
/// were written before they did, the file counts, and a cut that the spec has is taken for that of the estimate.
fn seen_of_file(job: &Job, found: &[Vec<Dataset>; 3]) -> Result<[Seen; 3], FilesError> {
    let as_cut = [Seen::Identification, Seen::Selection, Seen::Unseen];
    if job.saved.is_empty() {
        return Ok(as_cut);
    }
    let mut seen = [0, 1, 2].map(|k| seen_by(&job.saved, &found[k]));
    let older: Vec<&String> =
        job.saved.iter().filter(|m| m.estimated_on.is_none()).flat_map(|m| &m.files).collect();
    for source in job.sources.iter().filter(|_| !older.is_empty()) {
        if older.contains(&&digest_of_file(&source.file)?) {
            seen = [0, 1, 2].map(|k| if seen[k] == Seen::Unseen { as_cut[k] } else { seen[k] });
        }
    }
    Ok(seen)
}

/// Parts whose records are checked against each other, with their derived channels.
pub(super) fn completed(job: &Job, mut parts: Vec<Part>) -> Result<Vec<Part>, IdentifyError> {
    alike(&parts)?;
    for record in parts.iter_mut().flat_map(|p| &mut p.records) {
        derive(&job.derive, record)?;
    }
    Ok(parts)
}

/// Adds the derived channels.
fn derive(channels: &[DeriveSpec], record: &mut Dataset) -> Result<(), IdentifyError> {
    for d in channels {
        d.channel.add_to(record, d.role)?;
    }
    Ok(())
}

/// Whether two paths lead to one file.
fn same_file(a: &Path, b: &Path) -> bool {
    match (a.canonicalize(), b.canonicalize()) {
        (Ok(a), Ok(b)) => a == b,
        _ => a == b,
    }
}

fn stem(source: &Source) -> String {
    let name = source.file.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    name.split('.').next().unwrap_or(&name).to_string()
}

/// Reads a file, says so, and keeps what was decided on the way in, also where it is cut.
fn read_source(
    source: &Source,
    layout: &Layout,
    note: &dyn Fn(&str),
    notes: &mut Vec<String>,
) -> Result<Table, IdentifyError> {
    note(&format!("reading {}", source.file.display()));
    let mut table = read_table_with(&source.file, source.format, &source.keys)?;
    if let Some(cut) = &layout.cut {
        table.notes.push(split::experiments(&table, cut)?.note);
    }
    let name = source.file.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    for text in &table.notes {
        note(text);
        notes.push(format!("{name}: {text}"));
    }
    Ok(table)
}

fn split_table(job: &Job, table: &Table) -> Result<[Vec<Dataset>; 3], IdentifyError> {
    let read = |s: &Select| datasets(table, &job.layout, s);
    match &job.split {
        Split::Rows { estimation, selection, test } => {
            let whole = |s: &Select| -> Result<Vec<Dataset>, IdentifyError> {
                let records = read(s)?;
                Ok(if job.is_steady() { one_table(records) } else { records })
            };
            let maybe = |s: &Option<Select>| s.as_ref().map_or(Ok(Vec::new()), whole);
            Ok([whole(estimation)?, maybe(selection)?, maybe(test)?])
        }
        Split::Shares { fractions, blocks } => Ok(shares(&read(&Select::All)?, fractions, *blocks)),
        Split::Every { every } => {
            let all = one_table(read(&Select::All)?);
            let tests = |row: &usize| row % every == every - 1;
            let of = |test: bool| all.iter().map(|d| rows(d, |row| tests(row) == test)).collect();
            Ok([of(false), Vec::new(), of(true)])
        }
    }
}

fn test_set(job: &Job, test: &TestSet, note: &dyn Fn(&str)) -> Result<Part, IdentifyError> {
    let mut notes = Vec::new();
    let mut layout: Layout = job.layout.clone();
    for c in &mut layout.channels {
        if let Some(column) = test.columns.get(&c.name) {
            c.column.clone_from(column);
        }
    }
    if let Some(n) = test.init_samples {
        layout.init_samples = n;
    }
    layout.cut = layout.cut.filter(|_| test.cut);
    let table = read_source(&test.source, &layout, note, &mut notes)?;
    // A test file need not have the trajectories of the estimation file.
    if layout.trajectory.as_ref().is_some_and(|c| table.column(c).is_err()) {
        layout.trajectory = None;
    }
    let records = datasets(&table, &layout, &Select::All)?;
    Ok(Part { name: test.name.clone(), seen: seen_by(&job.saved, &records), records, notes })
}

/// Every record cut into `blocks` blocks that are dealt to the three parts so that their shares come out; neighbours of
/// one part stay one record.
fn shares(records: &[Dataset], fractions: &[f64; 3], blocks: usize) -> [Vec<Dataset>; 3] {
    let mut out = [Vec::new(), Vec::new(), Vec::new()];
    for d in records {
        for (part, from, to) in deal(d.len(), fractions, blocks) {
            let name = format!("{}-{from}", d.name);
            out[part].push(cut(d, from, to, if (from, to) == (0, d.len()) { d.name.clone() } else { name }));
        }
    }
    out
}

/// Pieces `(part, from, to)` of a record of `n` samples.
fn deal(n: usize, fractions: &[f64; 3], blocks: usize) -> Vec<(usize, usize, usize)> {
    let at = |share: f64| (share * n as f64).round() as usize;
    if blocks <= 1 {
        let (a, b) = (at(fractions[0]), at(fractions[0] + fractions[1]));
        return [(0, 0, a), (1, a, b), (2, b, n)].into_iter().filter(|(_, from, to)| from < to).collect();
    }
    let mut dealt = [0usize; 3];
    let mut pieces: Vec<(usize, usize, usize)> = Vec::new();
    for k in 0..blocks {
        let (from, to) = (k * n / blocks, (k + 1) * n / blocks);
        // The part that lags most behind its share gets the block.
        let behind = |p: usize| fractions[p] * to as f64 - dealt[p] as f64;
        let part = (1..3).fold(0, |best, p| if behind(p) > behind(best) { p } else { best });
        dealt[part] += to - from;
        match pieces.last_mut() {
            Some(last) if last.0 == part => last.2 = to,
            _ if from < to => pieces.push((part, from, to)),
            _ => {}
        }
    }
    pieces
}

/// The points of a steady table belong together, however its rows were dealt out.
fn one_table(records: Vec<Dataset>) -> Vec<Dataset> {
    let mut all = records.into_iter();
    let Some(mut first) = all.next() else { return Vec::new() };
    for other in all {
        for (c, more) in first.channels.iter_mut().zip(other.channels) {
            c.values.extend(more.values);
        }
        first.origin = format!("{}; {}", first.origin, other.origin);
    }
    vec![first]
}

/// Some rows of a table.
fn rows(d: &Dataset, take: impl Fn(&usize) -> bool) -> Dataset {
    let mut part = d.clone();
    for c in &mut part.channels {
        c.values = (0..d.len()).filter(&take).map(|row| c.values[row]).collect();
    }
    part
}

fn cut(d: &Dataset, from: usize, to: usize, name: String) -> Dataset {
    let mut piece = Dataset { name, channels: Vec::new(), ..d.clone() };
    for c in &d.channels {
        let values = c.values[from..to].to_vec();
        piece.channels.push(dynocal_ident::data::Channel {
            name: c.name.clone(),
            unit: c.unit.clone(),
            role: c.role,
            values,
        });
    }
    piece.origin = format!("{}, samples {from} to {}", d.origin, to.saturating_sub(1));
    piece
}

/// Units are the same in all records, or the numbers mean different things.
fn alike(parts: &[Part]) -> Result<(), IdentifyError> {
    let mut all = parts.iter().flat_map(|p| &p.records);
    let Some(first) = all.next() else { return Ok(()) };
    for d in all {
        for c in &d.channels {
            let expected = first.channel(&c.name)?;
            if c.unit != expected.unit {
                return Err(IdentifyError::Unit {
                    record: d.name.clone(),
                    channel: c.name.clone(),
                    found: c.unit.clone(),
                    expected: expected.unit.clone(),
                    other: first.name.clone(),
                });
            }
        }
    }
    Ok(())
}

/// Digest of a data file.
///
/// # Errors
/// That of reading it.
pub(super) fn digest_of_file(path: &Path) -> Result<String, FilesError> {
    let bytes = std::fs::read(path).map_err(|_| missing(path))?;
    Ok(digest(&bytes))
}

/// The reader knows best how to say what is wrong with a file that cannot even be opened.
fn missing(path: &Path) -> FilesError {
    match csv_io::read(path) {
        Err(e) => e,
        Ok(_) => FilesError::Read { path: path.display().to_string(), reason: "it changed meanwhile".into() },
    }
}

#[cfg(test)]
mod tests {
    use super::deal;

    #[test]
    fn shares_in_order_and_in_blocks() {
        assert_eq!(deal(100, &[0.7, 0.15, 0.15], 1), [(0, 0, 70), (1, 70, 85), (2, 85, 100)]);
        assert_eq!(deal(10, &[0.5, 0.0, 0.5], 1), [(0, 0, 5), (2, 5, 10)]);
        for blocks in [2, 7, 20, 33] {
            let pieces = deal(1000, &[0.7, 0.15, 0.15], blocks);
            // Every sample once, in order; shares right to within two blocks.
            assert_eq!((pieces[0].1, pieces[pieces.len() - 1].2), (0, 1000));
            assert!(pieces.windows(2).all(|w| w[0].2 == w[1].1 && w[0].0 != w[1].0), "{pieces:?}");
            for (part, share) in [(0, 700.0), (1, 150.0), (2, 150.0)] {
                let got: usize = pieces.iter().filter(|p| p.0 == part).map(|p| p.2 - p.1).sum();
                assert!((got as f64 - share).abs() <= 2000.0 / blocks as f64, "{blocks} {part} {got}");
            }
        }
    }
}
