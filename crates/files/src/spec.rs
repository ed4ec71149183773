//! TOML specs: read as typed, then checked as meant, with every fault named at once.
//!
//! The typed form is a serde struct with `deny_unknown_fields` (no `flatten` or `untagged`: they lose the place in
//! the file). Keys that must be there are `Option`s that the check asks for with [`Faults::required`], so that one
//! missing key does not hide other faults. The check turns the typed form into the form that the work takes.

use std::fmt;
use std::path::Path;

use dynocal_ident::data::UnitAfter;
use dynocal_numerics::registry::nearest;
use serde::de::DeserializeOwned;
use toml::Spanned;
use toml::de::{DeTable, DeValue, Deserializer};

use crate::error::{FilesError, reason};

/// One fault of a spec.
#[derive(Clone, Debug, PartialEq)]
pub struct Fault {
    /// Line in the file, from 1, where the key stands.
    pub line: Option<usize>,
    /// Key with its tables, e.g. `channels[2].unit`; empty for the whole file.
    pub key: String,
    /// What is there.
    pub found: String,
    /// What should be there, with its unit.
    pub expected: String,
    /// A known key or name that is near, if any.
    pub nearest: Option<String>,
}

/// All faults of a spec.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub struct SpecError {
    /// Spec file.
    pub file: String,
    /// Faults in the order of the file.
    pub faults: Vec<Fault>,
}

impl fmt::Display for SpecError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let n = self.faults.len();
        write!(f, "{} has {n} fault{}", self.file, if n == 1 { "" } else { "s" })?;
        for fault in self.faults.iter().take(MOST_FAULTS) {
            write!(f, "\n  {}", self.file)?;
            if let Some(line) = fault.line {
                write!(f, ":{line}")?;
            }
            write!(f, ": ")?;
            if !fault.key.is_empty() {
                write!(f, "`{}`: ", brief(&fault.key))?;
            }
            write!(f, "found {}, expected {}", fault.found, fault.expected)?;
            if let Some(near) = &fault.nearest {
                write!(f, " (did you mean `{near}`?)")?;
            }
        }
        match n.saturating_sub(MOST_FAULTS) {
            0 => Ok(()),
            more => write!(f, "\n  and {more} more"),
        }
    }
}

/// A spec cannot be read, or has faults.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LoadError {
    /// The file itself.
    #[error(transparent)]
    File(#[from] FilesError),
    /// Its content.
    #[error(transparent)]
    Spec(#[from] SpecError),
}

/// Collects faults while a spec is checked.
#[derive(Clone, Debug, Default)]
pub struct Faults(Vec<Fault>);

impl Faults {
    /// Adds a fault of `key`.
    pub fn push(&mut self, key: &str, found: impl fmt::Display, expected: impl fmt::Display) {
        self.0.push(Fault {
            line: None,
            key: key.into(),
            found: brief(&found.to_string()),
            expected: brief(&expected.to_string()),
            nearest: None,
        });
    }

    /// Adds a fault of `key` whose value `found` is none of `known`.
    pub fn unknown(&mut self, key: &str, found: &str, known: &[String]) {
        let expected = match known {
            [] => "nothing: there is nothing to choose from".to_string(),
            _ => format!("one of {}", known.join(", ")),
        };
        self.push(key, format!("`{found}`"), expected);
        if let Some(fault) = self.0.last_mut() {
            fault.nearest = nearest(found, known);
        }
    }

    /// The value of a key that must be there; `expected` says what (with unit).
    pub fn required<T: Clone>(&mut self, key: &str, value: &Option<T>, expected: &str) -> Option<T> {
        if value.is_none() {
            self.push(key, "nothing", expected);
        }
        value.clone()
    }

    /// Checks `lo <= value <= hi` (NaN fails).
    pub fn range(&mut self, key: &str, value: f64, lo: f64, hi: f64, unit: &str) {
        if !(lo <= value && value <= hi) {
            self.push(key, value, format!("{lo} to {hi}{}", UnitAfter(unit)));
        }
    }

    /// Checks that `value` is positive and finite.
    pub fn positive(&mut self, key: &str, value: f64, unit: &str) {
        if !(value > 0.0 && value.is_finite()) {
            self.push(
                key,
                value,
                if unit == "-" { "a positive number".into() } else { format!("a positive number, {unit}") },
            );
        }
    }

    /// The fault that was found first.
    pub fn first(&self) -> Option<&Fault> {
        self.0.first()
    }

    /// Whether there is no fault.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

/// Reads the spec at `path` as `T` and checks it.
///
/// # Errors
/// [`LoadError`] with all faults.
pub fn load<T, C>(path: &Path, check: impl FnOnce(&T, &mut Faults) -> Option<C>) -> Result<C, LoadError>
where
    T: DeserializeOwned,
{
    let file = path.display().to_string();
    let text = std::fs::read_to_string(path)
        .map_err(|e| FilesError::Read { path: file.clone(), reason: reason(&e) })?;
    if text.trim().is_empty() {
        return Err(FilesError::Empty { path: file, expected: "a spec in TOML" }.into());
    }
    Ok(parse(&file, &text, check)?)
}

/// As [`load`], from text; `file` is its name for messages.
///
/// # Errors
/// [`SpecError`] with all faults.
///
/// # Examples
/// ```
/// #[derive(serde::Deserialize)]
/// #[serde(deny_unknown_fields)]
/// struct Typed {
///     sample_time_s: Option<f64>,
///     estimator: Option<String>,
/// }
/// let text = "sample_time_s = -1.0\nestimater = \"sem\"\n";
/// let error = dynocal_files::spec::parse("a.toml", text, |t: &Typed, faults| {
///     let dt = faults.required("sample_time_s", &t.sample_time_s, "sample time, s")?;
///     faults.positive("sample_time_s", dt, "s");
///     Some(dt)
/// })
/// .unwrap_err();
/// let message = error.to_string();
/// assert!(message.contains("a.toml:1: `sample_time_s`: found -1, expected a positive number, s"));
/// assert!(message.contains("a.toml:2: `estimater`") && message.contains("did you mean `estimator`?"));
/// ```
pub fn parse<T, C>(
    file: &str,
    text: &str,
    check: impl FnOnce(&T, &mut Faults) -> Option<C>,
) -> Result<C, SpecError>
where
    T: DeserializeOwned,
{
    let fail = |faults: Vec<Fault>| Err(SpecError { file: file.into(), faults });
    let whole = match DeTable::parse(text) {
        Ok(d) => d,
        Err(e) => return fail(vec![syntax_fault(text, &e)]),
    };
    let mut document = whole.clone();
    let mut faults = Faults::default();
    let mut removed: Vec<String> = Vec::new();
    // serde stops at the first fault, so each faulty key is taken out and the rest read again.
    let typed = loop {
        match T::deserialize(Deserializer::from(document.clone())) {
            Ok(t) => break Some(t),
            Err(e) => match take_out(text, &mut document, &e, &mut removed, &mut faults) {
                true => {}
                false => break None,
            },
        }
    };
    let checked = typed.and_then(|t| {
        let mut meant = Faults::default();
        let c = check(&t, &mut meant);
        // What was taken out is already reported, so that it is missing is no second fault.
        let within = |key: &str, r: &str| {
            key.strip_prefix(r).is_some_and(|rest| rest.is_empty() || rest.starts_with(['.', '[']))
        };
        meant.0.retain(|f| !removed.iter().any(|r| within(&f.key, r)));
        faults.0.extend(meant.0);
        c
    });
    for fault in faults.0.iter_mut().filter(|f| f.line.is_none() && !f.key.is_empty()) {
        fault.line = line_of_key(text, whole.get_ref(), &fault.key);
    }
    faults.0.sort_by_key(|f| f.line.unwrap_or(usize::MAX));
    match checked {
        Some(c) if faults.is_empty() => Ok(c),
        _ => {
            if faults.is_empty() {
                faults.push("", "an incomplete spec", "all keys that the verb needs");
            }
            fail(faults.0)
        }
    }
}

fn syntax_fault(text: &str, e: &toml::de::Error) -> Fault {
    let line = e.span().map(|s| line_at(text, s.start));
    let shown = line.and_then(|l| text.lines().nth(l - 1)).unwrap_or("").trim();
    Fault {
        line,
        key: String::new(),
        found: brief(&format!("`{shown}`")),
        expected: format!("valid TOML ({})", e.message().replace('\n', ", ")),
        nearest: None,
    }
}

/// Records the fault `e` and removes its key; false when reading cannot go on.
fn take_out(
    text: &str,
    document: &mut Spanned<DeTable<'_>>,
    e: &toml::de::Error,
    removed: &mut Vec<String>,
    faults: &mut Faults,
) -> bool {
    let message = e.message();
    let place = e.span().and_then(|span| {
        let mut best = None;
        find(document.get_ref(), "", &span, &mut best);
        best.map(|(_, key)| key)
    });
    let line = e.span().map(|s| line_at(text, s.start));
    let key = place.clone().unwrap_or_default();
    let mut fault = Fault { line, key, found: String::new(), expected: message.into(), nearest: None };
    let known = backquoted(message);
    let missing = message.starts_with("missing field");
    if message.starts_with("unknown field") {
        let known = &known[1.min(known.len())..];
        fault.found = "an unknown key".into();
        fault.expected = format!("one of {}", known.join(", "));
        fault.nearest = nearest(fault.key.rsplit('.').next().unwrap_or(""), known);
    } else if message.starts_with("unknown variant") && !known.is_empty() {
        fault.found = format!("`{}`", known[0]);
        fault.expected = format!("one of {}", known[1..].join(", "));
        fault.nearest = nearest(&known[0], &known[1..]);
    } else if missing && !known.is_empty() {
        let name =
            if fault.key.is_empty() { known[0].clone() } else { format!("{}.{}", fault.key, known[0]) };
        if removed.contains(&name) {
            return false;
        }
        fault.key = name;
        fault.found = "nothing".into();
        fault.expected = "this key".into();
    } else {
        (fault.found, fault.expected) = plain(message);
    }
    (fault.found, fault.expected) = (brief(&fault.found), brief(&fault.expected));
    faults.0.push(fault);
    match place {
        Some(p) => {
            let gone = remove(document.get_mut(), &p);
            // An item of an array took its whole array with it.
            let whole = if p.ends_with(']') { p.rsplit_once('[').map(|(a, _)| a.to_string()) } else { None };
            removed.push(whole.unwrap_or(p));
            gone
        }
        None => false,
    }
}

/// Digits of a number in a row from which on it is shortened, and most characters of a text in a message.
const MOST_DIGITS: usize = 22;
/// Most characters of what was found or expected.
const MOST_SHOWN: usize = 2000;
/// Most faults of a spec that are shown.
const MOST_FAULTS: usize = 60;

/// A text for a message: numbers of many digits as powers of ten, what is long cut in its middle.
///
/// ```
/// use dynocal_files::spec::brief;
/// assert_eq!(brief(&format!("found {}, expected 1", 1.5e300)), "found 1.500e300, expected 1");
/// assert_eq!(brief(&format!("found {}", 2.25e-300)), "found 2.250e-300");
/// assert_eq!(brief("0.00012 of 123456789"), "0.00012 of 123456789");
/// assert!(brief(&"ab ".repeat(100_000)).chars().count() < 2500);
/// ```
pub fn brief(text: &str) -> String {
    let mut out = String::with_capacity(text.len().min(2 * MOST_SHOWN));
    let mut rest = text;
    while let Some(at) = rest.find(|c: char| c.is_ascii_digit()) {
        let (before, from) = rest.split_at(at);
        out.push_str(before);
        let end = from.find(|c: char| !(c.is_ascii_digit() || c == '.')).unwrap_or(from.len());
        let (number, after) = from.split_at(end);
        let digits = number.bytes().filter(u8::is_ascii_digit).count();
        match number.parse::<f64>() {
            Ok(v) if digits > MOST_DIGITS && v.is_finite() && v != 0.0 => out.push_str(&format!("{v:.3e}")),
            _ => out.push_str(number),
        }
        rest = after;
    }
    out.push_str(rest);
    let length = out.chars().count();
    if length <= MOST_SHOWN {
        return out;
    }
    let head: String = out.chars().take(2 * MOST_SHOWN / 3).collect();
    let tail: String = out.chars().skip(length - MOST_SHOWN / 4).collect();
    format!("{head} .. ({length} characters) .. {tail}")
}

/// What a reading fault says, in words for people: what was found and what was expected.
///
/// ```
/// use dynocal_files::spec::plain;
/// let (found, expected) = plain("invalid type: string \"two\", expected u64");
/// assert_eq!((found.as_str(), expected.as_str()), ("the text \"two\"", "a whole number, 0 or more"));
/// let (found, expected) = plain("invalid length 1, expected a tuple of size 2");
/// assert_eq!((found.as_str(), expected.as_str()), ("a list of 1", "a list of 2 values"));
/// ```
pub fn plain(message: &str) -> (String, String) {
    let message = message.lines().next().unwrap_or("");
    let (found, expected) = match message.split_once(", expected ") {
        Some(parts) => parts,
        None if message.contains("out of range") || message.contains("did not match any variant") => {
            ("a value of another kind", "a value as the documentation of the key shows it")
        }
        None => (message, "another value"),
    };
    let found = found.trim_start_matches("invalid type: ").trim_start_matches("invalid value: ");
    let found = match found.split_once(' ') {
        Some(("string", text)) => format!("the text {text}"),
        Some(("integer" | "boolean", value)) => value.trim_matches('`').to_string(),
        Some(("floating", value)) => value.trim_start_matches("point ").trim_matches('`').to_string(),
        Some(("invalid", length)) if length.starts_with("length ") => format!("a list of {}", &length[7..]),
        Some(("unit", _)) => "nothing".into(),
        _ => match found {
            "map" => "a table".into(),
            "sequence" => "a list".into(),
            other => other.to_string(),
        },
    };
    (found, wanted(expected))
}

/// The expectation of a reader in the words of a user.
fn wanted(expected: &str) -> String {
    if let Some(size) =
        expected.strip_prefix("a tuple of size ").or(expected.strip_prefix("an array of length "))
    {
        return format!("a list of {} values", size.split(' ').next().unwrap_or(size));
    }
    let word = expected.split([' ', ',']).next().unwrap_or("");
    match (word, expected) {
        ("f64" | "f32", _) => "a number".into(),
        ("u64" | "u32" | "u16" | "u8" | "usize", _) => "a whole number, 0 or more".into(),
        ("i64" | "i32" | "i16" | "i8" | "isize", _) => "a whole number".into(),
        ("bool", _) | (_, "a boolean") => "true or false".into(),
        ("struct" | "internally" | "map", _) | (_, "a map") => "a table { key = value, .. }".into(),
        ("sequence", _) | (_, "a sequence") => "a list [ .. ]".into(),
        ("enum", _) | (_, "a string" | "variant identifier" | "string or table" | "path string") => {
            "a text in quotes".into()
        }
        _ => expected.into(),
    }
}

fn backquoted(message: &str) -> Vec<String> {
    message.split('`').skip(1).step_by(2).map(str::to_string).collect()
}

fn line_at(text: &str, offset: usize) -> usize {
    1 + text.as_bytes().iter().take(offset).filter(|b| **b == b'\n').count()
}

/// The innermost key whose own span or value holds `span`, as (length of the span, path).
fn find(table: &DeTable<'_>, path: &str, span: &std::ops::Range<usize>, best: &mut Option<(usize, String)>) {
    let mut offer = |s: std::ops::Range<usize>, key: &str| {
        let holds = s.start <= span.start && span.end <= s.end;
        if holds && best.as_ref().is_none_or(|b| s.len() <= b.0) {
            *best = Some((s.len(), key.to_string()));
        }
    };
    for (k, v) in table {
        let key = join(path, k.get_ref());
        offer(k.span(), &key);
        offer(v.span(), &key);
    }
    for (k, v) in table {
        let key = join(path, k.get_ref());
        find_value(v, &key, span, best);
    }
}

fn find_value(
    v: &Spanned<DeValue<'_>>,
    key: &str,
    span: &std::ops::Range<usize>,
    best: &mut Option<(usize, String)>,
) {
    if let Some(t) = v.get_ref().as_table() {
        find(t, key, span, best);
    }
    for (i, item) in v.get_ref().as_array().into_iter().flat_map(|a| a.iter()).enumerate() {
        let s = item.span();
        let key = format!("{key}[{}]", i + 1);
        if s.start <= span.start && span.end <= s.end && best.as_ref().is_none_or(|b| s.len() <= b.0) {
            *best = Some((s.len(), key.clone()));
        }
        find_value(item, &key, span, best);
    }
}

fn join(path: &str, key: &str) -> String {
    if path.is_empty() { key.into() } else { format!("{path}.{key}") }
}

/// Removes the key at `path` (`a.b[2].c`, items from 1); an item of an array takes its whole array with it.
fn remove(table: &mut DeTable<'_>, path: &str) -> bool {
    let (head, rest) = path.split_once('.').map_or((path, None), |(h, r)| (h, Some(r)));
    let (name, item) = match head.split_once('[') {
        Some((n, i)) => (n, i.trim_end_matches(']').parse::<usize>().ok()),
        None => (head, None),
    };
    let Some(key) = table.keys().find(|k| k.get_ref() == name).cloned() else { return false };
    let (Some(rest), Some(value)) = (rest, table.get_mut(&key)) else { return table.remove(&key).is_some() };
    match (value.get_mut(), item) {
        (DeValue::Table(t), None) => remove(t, rest),
        (DeValue::Array(a), Some(i)) => match a.get_mut(i.wrapping_sub(1)).map(Spanned::get_mut) {
            Some(DeValue::Table(t)) => remove(t, rest),
            _ => false,
        },
        _ => false,
    }
}

/// Line (from 1) of a key in TOML text, or of the nearest table around it; none where the text is no TOML.
pub fn line_of(text: &str, key: &str) -> Option<usize> {
    line_of_key(text, DeTable::parse(text).ok()?.get_ref(), key)
}

/// Line of the key, or of the nearest table around it that is in the file.
fn line_of_key(text: &str, root: &DeTable<'_>, path: &str) -> Option<usize> {
    let mut table = root;
    let mut line = None;
    for part in path.split('.') {
        let (name, item) = match part.split_once('[') {
            Some((n, i)) => (n, i.trim_end_matches(']').parse::<usize>().ok()),
            None => (part, None),
        };
        let Some((k, v)) = table.iter().find(|(k, _)| k.get_ref() == name) else { break };
        line = Some(line_at(text, k.span().start));
        let mut v = v;
        if let (Some(i), Some(a)) = (item, v.get_ref().as_array()) {
            let Some(inner) = a.get(i.wrapping_sub(1)) else { break };
            line = Some(line_at(text, inner.span().start));
            v = inner;
        }
        match v.get_ref().as_table() {
            Some(t) => table = t,
            None => break,
        }
    }
    line
}
