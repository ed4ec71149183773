//! How a CSV file is written: guessed from its beginning, said in one line, fixed by keys.
//!
//! The guess never looks at names: the encoding follows from byte-order marks and validity as UTF-8, the separator
//! from the line that repeats its number of cells, the header from the first line of that width without numbers, a row
//! of units from a table of units or from words over columns of numbers, decimal comma and thousands from the form of the numbers.

use serde::{Deserialize, Serialize};

use crate::units;

/// Encoding of a text file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Encoding {
    /// UTF-8, with or without a byte-order mark.
    #[serde(rename = "utf-8")]
    Utf8,
    /// Windows-1252, of which Latin-1 is a part.
    #[serde(rename = "windows-1252", alias = "latin-1", alias = "iso-8859-1")]
    Windows1252,
    /// UTF-16, little endian.
    #[serde(rename = "utf-16le", alias = "utf-16")]
    Utf16Le,
    /// UTF-16, big endian.
    #[serde(rename = "utf-16be")]
    Utf16Be,
}

/// Keys that fix what the guess would decide; what is absent is guessed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CsvKeys {
    /// Encoding.
    pub encoding: Option<Encoding>,
    /// Separator, one character (`\t` for a tab).
    pub separator: Option<char>,
    /// Decimal sign, `.` or `,`.
    pub decimal: Option<char>,
    /// Thousands sign; `none` is said with an empty text.
    pub thousands: Option<String>,
    /// Line of the header, from 1.
    pub header_line: Option<usize>,
    /// Whether the row after the header holds units.
    pub unit_row: Option<bool>,
}

/// How a file is written.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Dialect {
    /// Encoding.
    pub encoding: Encoding,
    /// Separator.
    pub separator: char,
    /// Decimal sign.
    pub decimal: char,
    /// Thousands sign.
    pub thousands: Option<char>,
    /// Line of the header, from 1; what stands above is preamble.
    pub header_line: usize,
    /// Whether the row after the header holds units.
    pub unit_row: bool,
}

impl Dialect {
    /// Whether it is the one that needs no word: UTF-8, commas between cells, decimal points, the header in line 1.
    pub fn is_plain(&self) -> bool {
        let Self { encoding, separator, decimal, thousands, header_line, unit_row } = self;
        (*encoding, *separator, *decimal, *thousands, *header_line, *unit_row)
            == (Encoding::Utf8, ',', '.', None, 1, false)
    }

    /// One line for the user, e.g. `utf-8, separator ;, decimal comma, header in line 3, units below it`.
    pub fn describe(&self) -> String {
        let encoding = match self.encoding {
            Encoding::Utf8 => "UTF-8",
            Encoding::Windows1252 => "Windows-1252",
            Encoding::Utf16Le => "UTF-16 little endian",
            Encoding::Utf16Be => "UTF-16 big endian",
        };
        let separator = match self.separator {
            '\t' => "tab".to_string(),
            ' ' => "blanks".to_string(),
            other => format!("`{other}`"),
        };
        let decimal = if self.decimal == ',' { "comma" } else { "point" };
        let thousands = match self.thousands {
            Some(' ') => ", thousands by blank".to_string(),
            Some(c) => format!(", thousands by `{c}`"),
            None => String::new(),
        };
        let units = if self.unit_row { ", units in the line below" } else { "" };
        format!(
            "{encoding}, separator {separator}, decimal {decimal}{thousands}, header in line {}{units}",
            self.header_line
        )
    }
}

/// Encoding by byte-order mark, else by zero bytes (UTF-16), else by validity as UTF-8.
pub fn guess_encoding(bytes: &[u8]) -> Encoding {
    if bytes.starts_with(b"\xff\xfe") {
        return Encoding::Utf16Le;
    }
    if bytes.starts_with(b"\xfe\xff") {
        return Encoding::Utf16Be;
    }
    let head = &bytes[..bytes.len().min(4096)];
    let zeros = |parity: usize| head.iter().skip(parity).step_by(2).filter(|b| **b == 0).count();
    // ASCII in UTF-16 has a zero in every second byte.
    if head.len() >= 8 && zeros(1) * 4 > head.len() && zeros(0) == 0 {
        return Encoding::Utf16Le;
    }
    if head.len() >= 8 && zeros(0) * 4 > head.len() && zeros(1) == 0 {
        return Encoding::Utf16Be;
    }
    if std::str::from_utf8(bytes).is_ok() { Encoding::Utf8 } else { Encoding::Windows1252 }
}

/// First bytes of files that are often sent in place of a table.
const OTHERS: [(&[u8], &str); 8] = [
    (b"\x89PNG", "a PNG picture"),
    (b"\xff\xd8\xff", "a JPEG picture"),
    (b"GIF8", "a GIF picture"),
    (b"%PDF", "a PDF document"),
    (b"PK\x03\x04", "a ZIP archive (or a spreadsheet: save it as CSV)"),
    (b"\xd0\xcf\x11\xe0", "an old spreadsheet or document (save it as CSV)"),
    (b"7z\xbc\xaf", "a 7z archive"),
    (b"\x7fELF", "a program"),
];

/// What `bytes` are, where they are no text: a format that is none, or bytes that no logger writes.
pub fn no_text(bytes: &[u8], encoding: Encoding) -> Option<String> {
    if let Some((_, what)) = OTHERS.iter().find(|(start, _)| bytes.starts_with(start)) {
        return Some((*what).into());
    }
    if matches!(encoding, Encoding::Utf16Le | Encoding::Utf16Be) {
        return None;
    }
    // Old loggers end a file with 0x1a, and pad it with zeros.
    let body = bytes.trim_ascii_end();
    let end = body.iter().rposition(|b| ![0, 0x1a].contains(b)).map_or(0, |k| k + 1);
    let control = |b: &&u8| **b < 0x20 && !b"\t\n\r\x0b\x0c\x1b".contains(*b);
    let head = &body[..end.min(4096)];
    let found = head.iter().filter(control).count();
    // One odd byte in a word makes no picture of a table.
    if found < 4 || found * 50 <= head.len() {
        return None;
    }
    let first = head.iter().find(control)?;
    Some(format!("bytes such as 0x{first:02x}, which no text has ({found} of the first {})", head.len()))
}

/// What bytes 0x80 to 0x9f are in Windows-1252; the five that are free stay control characters.
const HIGH: [u16; 32] = [
    0x20ac, 0x81, 0x201a, 0x192, 0x201e, 0x2026, 0x2020, 0x2021, 0x2c6, 0x2030, 0x160, 0x2039, 0x152, 0x8d,
    0x17d, 0x8f, 0x90, 0x2018, 0x2019, 0x201c, 0x201d, 0x2022, 0x2013, 0x2014, 0x2dc, 0x2122, 0x161, 0x203a,
    0x153, 0x9d, 0x17e, 0x178,
];

/// The bytes as text; what is no character becomes U+FFFD.
pub fn decode(bytes: &[u8], encoding: Encoding) -> String {
    let units = |big: bool| {
        let pairs = bytes.chunks_exact(2);
        let unit = move |c: &[u8]| {
            if big { u16::from_be_bytes([c[0], c[1]]) } else { u16::from_le_bytes([c[0], c[1]]) }
        };
        char::decode_utf16(pairs.map(unit)).map(|c| c.unwrap_or('\u{fffd}')).collect::<String>()
    };
    let text = match encoding {
        Encoding::Utf8 => String::from_utf8_lossy(bytes).into_owned(),
        Encoding::Utf16Le => units(false),
        Encoding::Utf16Be => units(true),
        Encoding::Windows1252 => bytes
            .iter()
            .map(|b| match b {
                0x80..=0x9f => char::from_u32(u32::from(HIGH[usize::from(b - 0x80)])).unwrap_or('\u{fffd}'),
                _ => char::from(*b),
            })
            .collect(),
    };
    match text.strip_prefix('\u{feff}') {
        Some(rest) => rest.to_string(),
        None => text,
    }
}

/// Cells between runs of blanks; a unit in brackets belongs to the name before it.
pub fn between_blanks(line: &str) -> Vec<String> {
    let mut out: Vec<String> = Vec::new();
    for word in line.split_whitespace() {
        let unit =
            (word.starts_with('[') && word.ends_with(']')) || (word.starts_with('(') && word.ends_with(')'));
        match out.last_mut() {
            Some(name) if unit => *name = format!("{name} {word}"),
            _ => out.push(word.to_string()),
        }
    }
    out
}

/// Cells of one line; quotes keep separators, doubled quotes are one.
fn cells(line: &str, separator: char) -> Vec<(String, bool)> {
    if separator == ' ' {
        return between_blanks(line).into_iter().map(|c| (c, false)).collect();
    }
    let mut out = Vec::new();
    let (mut cell, mut quoted, mut was_quoted) = (String::new(), false, false);
    let mut chars = line.chars().peekable();
    while let Some(c) = chars.next() {
        match c {
            '"' if quoted && chars.peek() == Some(&'"') => {
                cell.push('"');
                chars.next();
            }
            '"' if quoted => quoted = false,
            '"' if cell.trim().is_empty() => (quoted, was_quoted) = (true, true),
            c if c == separator && !quoted => {
                out.push((std::mem::take(&mut cell).trim().to_string(), was_quoted));
                was_quoted = false;
            }
            c => cell.push(c),
        }
    }
    out.push((cell.trim().to_string(), was_quoted));
    out
}

/// Whether a cell is a number in some habit: digits, one sign, signs of decimals and thousands, an exponent.
fn looks_numeric(cell: &str) -> bool {
    cell.starts_with(|c: char| c.is_ascii_digit() || "+-.,".contains(c))
        && cell.contains(|c: char| c.is_ascii_digit())
        && cell.chars().all(|c| c.is_ascii_digit() || "+-.,eE'\u{a0}\u{202f} ".contains(c))
}

/// Whether a cell is a date or a time of day, which no column is called: digits around at least two of `-`, `/`, `.`, or a colon.
pub fn is_stamp(cell: &str) -> bool {
    let marks = |of: &str| cell.chars().filter(|c| of.contains(*c)).count();
    cell.starts_with(|c: char| c.is_ascii_digit())
        && cell.chars().all(|c| c.is_ascii_digit() || "-/.:,+ TZ".contains(c))
        && (marks(":") >= 1 || marks("-") == 2 || marks("/") == 2 || marks(".") == 2)
}

/// Lines that the guess looks at.
const HEAD: usize = 400;

/// Guesses the dialect of `text`; keys that are given are taken as they are.
pub fn guess(text: &str, encoding: Encoding, keys: &CsvKeys) -> Dialect {
    let lines: Vec<&str> = text.lines().take(HEAD).collect();
    let (separator, width) = match keys.separator {
        Some(s) => (s, mode(&lines, s).0),
        None => separator(&lines),
    };
    let header = keys.header_line.unwrap_or_else(|| header_line(&lines, separator, width));
    let names = lines.get(header.wrapping_sub(1)).map(|l| cells(l, separator)).unwrap_or_default();
    let has_brackets = names.iter().any(|(n, _)| units::split_header(n).1.is_some());
    let unit_row = keys.unit_row.unwrap_or_else(|| {
        let rows = |from: usize| lines.iter().skip(from).map(|l| cells(l, separator));
        let below = lines.get(header).map(|l| cells(l, separator));
        !has_brackets
            && below.is_some_and(|row| {
                is_unit_row(&row, names.len()) || stands_over_numbers(&row, names.len(), rows(header + 1))
            })
    });
    let from = header + usize::from(unit_row);
    let body: Vec<(String, bool)> = lines.iter().skip(from).flat_map(|l| cells(l, separator)).collect();
    let (decimal, thousands) = signs(&body, separator);
    let decimal = keys.decimal.unwrap_or(decimal);
    let thousands = match &keys.thousands {
        Some(t) => t.chars().next(),
        None => thousands.filter(|t| *t != decimal),
    };
    Dialect {
        encoding: keys.encoding.unwrap_or(encoding),
        separator,
        decimal,
        thousands,
        header_line: header,
        unit_row,
    }
}

/// The commonest number of cells and how many lines have it.
fn mode(lines: &[&str], separator: char) -> (usize, usize) {
    let mut widths: Vec<usize> =
        lines.iter().filter(|l| !l.trim().is_empty()).map(|l| cells(l, separator).len()).collect();
    widths.sort_unstable();
    widths.chunk_by(|a, b| a == b).map(|c| (c[0], c.len())).max_by_key(|(w, n)| (*n, *w)).unwrap_or((1, 0))
}

/// The separator whose commonest width is shared by most lines (of more than one cell), the rarer sign first: a file
/// with semicolons may hold commas in its numbers, not the other way round.
fn separator(lines: &[&str]) -> (char, usize) {
    // A header alone decides where it can: the first line with a candidate of its own.
    let mut best = (',', 1, 0);
    for s in [';', '\t', ',', '|'] {
        let (width, count) = mode(lines, s);
        if width > 1 && count > best.2 {
            best = (s, width, count);
        }
    }
    if best.2 == 0 {
        // Columns between blanks, where a line of as many names says so; else blanks may stand for thousands.
        let (width, _) = mode(lines, ' ');
        let named = |l: &&str| {
            let c = cells(l, ' ');
            c.len() == width && c.iter().all(|(n, _)| !looks_numeric(n))
        };
        if width > 1 && lines.iter().any(named) {
            return (' ', width);
        }
    }
    (best.0, best.1)
}

/// The first line of the common width in which no cell is empty or a number; the first line where there is none.
fn header_line(lines: &[&str], separator: char, width: usize) -> usize {
    let named = |line: &str| {
        let c = cells(line, separator);
        c.len() == width && c.iter().all(|(n, _)| !n.is_empty() && !looks_numeric(n))
    };
    lines
        .iter()
        .position(|l| named(l))
        .or_else(|| lines.iter().position(|l| !l.trim().is_empty()))
        .unwrap_or(0)
        + 1
}

fn is_unit_row(row: &[(String, bool)], width: usize) -> bool {
    let bare = |c: &str| c.trim_matches(['[', ']', '(', ')']).trim().to_string();
    row.len() == width
        && row.iter().any(|(c, _)| units::is_known(&bare(c)) && !c.is_empty())
        && row.iter().all(|(c, _)| {
            c.is_empty() || c == "-" || units::is_known(&bare(c)) || (c.starts_with('[') && c.ends_with(']'))
        })
}

/// Whether words stand over columns of numbers: units that no table knows. Every word of the row has at least two rows below it, all
/// numbers or stamps (or empty), and none of them is a gap.
fn stands_over_numbers(
    row: &[(String, bool)],
    width: usize,
    below: impl Iterator<Item = Vec<(String, bool)>>,
) -> bool {
    let word = |c: &str| !looks_numeric(c) && c.chars().any(char::is_alphabetic) && !is_gap(c);
    let bare = |c: &str| c.is_empty() || c == "-" || c == "%";
    if row.len() != width || !row.iter().any(|(c, _)| word(c)) || !row.iter().all(|(c, _)| word(c) || bare(c))
    {
        return false;
    }
    let mut numbers = vec![0; width];
    for cells in below.filter(|c| c.len() == width) {
        for ((n, (cell, _)), (unit, _)) in numbers.iter_mut().zip(&cells).zip(row) {
            let stamp = cell.starts_with(|c: char| c.is_ascii_digit()) && cell.contains(':');
            if looks_numeric(cell) || stamp {
                *n += 1;
            } else if word(unit) && !cell.is_empty() && !is_gap(cell) {
                return false;
            }
        }
    }
    numbers.iter().zip(row).all(|(n, (c, _))| *n >= 2 || !word(c))
}

/// Words that stand where a value is missing: those of spreadsheets and of data bases.
pub fn is_gap(cell: &str) -> bool {
    const WORDS: [&str; 8] = ["nan", "null", "none", "n/a", "na", "nil", "-", "--"];
    let fault = cell.starts_with('#') && (cell.ends_with('!') || cell.ends_with('?') || cell.ends_with("/A"));
    fault || WORDS.iter().any(|w| cell.eq_ignore_ascii_case(w))
}

/// Decimal and thousands sign from the form of the numbers.
fn signs(body: &[(String, bool)], separator: char) -> (char, Option<char>) {
    let numbers: Vec<&str> = body
        .iter()
        .filter(|(c, quoted)| looks_numeric(c) && (separator != ',' || *quoted || !c.contains(',')))
        .map(|(c, _)| c.as_str())
        .collect();
    let digits_after = |c: &str, sign: char| c.rsplit_once(sign).map(|(_, r)| r.len());
    let both = |a: char, b: char| {
        numbers.iter().any(|n| n.rfind(a).is_some_and(|i| n.rfind(b).is_some_and(|j| i < j)))
    };
    let groups = |n: &str, sign: char| {
        let decimals: Vec<char> = ['.', ','].into_iter().filter(|c| *c != sign).collect();
        let (whole, rest) = n.split_once(decimals.as_slice()).unwrap_or((n, ""));
        let mut parts = whole.trim_start_matches(['+', '-']).split(sign);
        let first = parts.next().unwrap_or("");
        (1..=3).contains(&first.len()) && parts.all(|p| p.len() == 3) && !rest.contains(sign)
    };
    let grouped = |sign: char| {
        let mut with = numbers.iter().filter(|n| n.contains(sign)).peekable();
        with.peek().is_some() && with.all(|n| groups(n, sign))
    };
    let blank = ['\'', '\u{a0}', '\u{202f}', ' '].into_iter().find(|s| grouped(*s));
    let has = |sign: char| numbers.iter().any(|n| n.contains(sign));
    if both('.', ',') {
        return (',', Some('.'));
    }
    if both(',', '.') {
        return ('.', Some(','));
    }
    if has(',') && !has('.') {
        // 1,234 in quotes of a comma-separated file is a thousand; with another separator a comma is a decimal sign
        // unless one number has two of them.
        let repeated = grouped(',') && numbers.iter().any(|n| n.matches(',').count() > 1);
        let always_three = numbers.iter().filter_map(|n| digits_after(n, ',')).all(|d| d == 3);
        return if repeated || (separator == ',' && always_three) { ('.', Some(',')) } else { (',', blank) };
    }
    if grouped('.') && numbers.iter().any(|n| n.matches('.').count() > 1) {
        return (',', Some('.'));
    }
    if has(',') && separator != ',' {
        return (',', blank);
    }
    ('.', blank)
}

/// A number in this dialect; `None` for other text. An empty cell is NaN.
pub fn number(text: &str, dialect: &Dialect) -> Option<f64> {
    let text = text.trim();
    if text.is_empty() {
        return Some(f64::NAN);
    }
    let plain = dialect.decimal == '.' && dialect.thousands.is_none();
    if plain || !text.starts_with(|c: char| c.is_ascii_digit() || "+-.,".contains(c)) {
        return within_double(text);
    }
    let mut bare = String::with_capacity(text.len());
    for c in text.chars() {
        if Some(c) == dialect.thousands {
            continue;
        }
        bare.push(if c == dialect.decimal { '.' } else { c });
    }
    within_double(&bare)
}

/// Infinity is a number where it is written so; digits beyond the largest double are none.
fn within_double(text: &str) -> Option<f64> {
    let value: f64 = text.parse().ok()?;
    (value.is_finite() || !text.contains(|c: char| c.is_ascii_digit())).then_some(value)
}
