//! `.msq`: a whole tune. Read with the place of every number, so that a change touches these bytes and no others.

use std::ops::Range;
use std::path::Path;

use dynocal_numerics::registry::nearest;

use super::ini::Held;
use super::{decoded, line_of};
use crate::error::ExportError;

/// A label of the tune that holds numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct Constant {
    /// Name.
    pub name: String,
    /// Unit as in the file.
    pub unit: String,
    /// Decimals that the tool shows.
    pub digits: usize,
    /// Rows; the first belongs to the lowest value of the second axis.
    pub rows: usize,
    /// Columns.
    pub columns: usize,
    /// Values, row by row.
    pub values: Vec<f64>,
    /// Where each value stands in the file.
    places: Vec<Range<usize>>,
    /// Line in the file.
    line: usize,
}

/// A tune as it was read.
#[derive(Clone, Debug, PartialEq)]
pub struct Tune {
    file: String,
    bytes: Vec<u8>,
    /// What the ECU calls itself, e.g. `speeduino 202501`.
    pub signature: String,
    /// Labels with numbers.
    pub constants: Vec<Constant>,
    /// Labels with words: name and words.
    pub options: Vec<(String, String)>,
}

impl Tune {
    /// Reads a tune.
    ///
    /// # Errors
    /// [`ExportError::Malformed`] with file and line.
    pub fn read(path: &Path) -> Result<Self, ExportError> {
        let file = path.display().to_string();
        let bytes = std::fs::read(path).map_err(|e| ExportError::Malformed {
            file: file.clone(),
            line: 0,
            reason: format!("cannot be read: {e}"),
        })?;
        Self::parse(&file, bytes)
    }

    /// The same for bytes that are there; `file` is their name in messages.
    ///
    /// # Errors
    /// [`ExportError::Malformed`].
    pub fn parse(file: &str, bytes: Vec<u8>) -> Result<Self, ExportError> {
        let (text, latin) = decoded(&bytes);
        let bad = |line: usize, reason: String| ExportError::Malformed { file: file.into(), line, reason };
        let document = roxmltree::Document::parse(&text)
            .map_err(|e| bad(e.pos().row as usize, format!("not a tune: {e}")))?;
        let root = document.root_element();
        if root.tag_name().name() != "msq" {
            return Err(bad(1, format!("found the element `{}`, expected `msq`", root.tag_name().name())));
        }
        // Characters of ISO-8859-1 are bytes of the file; those of the text above may take two.
        let extra: Vec<usize> = if latin {
            text.char_indices().filter(|(_, c)| c.len_utf8() > 1).map(|(k, _)| k).collect()
        } else {
            Vec::new()
        };
        let place = |at: usize| at - extra.partition_point(|k| *k < at);
        let (mut constants, mut options) = (Vec::new(), Vec::new());
        let mut signature = String::new();
        for node in root.descendants().filter(roxmltree::Node::is_element) {
            match node.tag_name().name() {
                "versionInfo" => signature = node.attribute("signature").unwrap_or("").into(),
                "constant" | "pcVariable" => {
                    let name = node.attribute("name").unwrap_or("").to_string();
                    let line = line_of(&text, node.range().start);
                    let Some(words) = node.children().find(roxmltree::Node::is_text) else { continue };
                    let content = &text[words.range()];
                    if content.trim_start().starts_with('"') || content.trim_start().starts_with("&quot;") {
                        options.push((name, content.trim().trim_matches('"').to_string()));
                        continue;
                    }
                    let tokens = tokens(content, words.range().start);
                    let values: Option<Vec<f64>> = tokens
                        .iter()
                        .map(|r| text[r.clone()].parse::<f64>().ok().filter(|v| v.is_finite()))
                        .collect();
                    let Some(values) = values else {
                        options.push((name, content.trim().to_string()));
                        continue;
                    };
                    let size = |key: &str| node.attribute(key).map_or(Some(1), |v| v.trim().parse().ok());
                    let (Some(rows), Some(columns)) = (size("rows"), size("cols")) else {
                        return Err(bad(line, format!("`{name}`: rows or cols is not a whole number")));
                    };
                    if Some(values.len()) != usize::checked_mul(rows, columns) {
                        return Err(bad(
                            line,
                            format!("`{name}`: found {} values, expected {rows} x {columns}", values.len()),
                        ));
                    }
                    constants.push(Constant {
                        name,
                        unit: node.attribute("units").unwrap_or("").into(),
                        digits: node
                            .attribute("digits")
                            .and_then(|d| d.parse().ok())
                            .unwrap_or(0usize)
                            .min(9),
                        rows,
                        columns,
                        values,
                        places: tokens.into_iter().map(|r| place(r.start)..place(r.end)).collect(),
                        line,
                    });
                }
                _ => {}
            }
        }
        Ok(Self { file: file.into(), bytes, signature, constants, options })
    }

    /// The file as it is now.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// The label `name`.
    ///
    /// # Errors
    /// [`ExportError::Form`] with a name that is near.
    pub fn constant(&self, name: &str) -> Result<&Constant, ExportError> {
        self.constants.iter().find(|c| c.name == name).ok_or_else(|| {
            let known: Vec<String> = self.constants.iter().map(|c| c.name.clone()).collect();
            let near = nearest(name, &known).map(|n| format!(" (did you mean `{n}`?)")).unwrap_or_default();
            ExportError::form(name, format!("{} holds no label of this name with numbers{near}", self.file))
        })
    }

    /// A tune with other values of the label `name`; all other bytes are those of this one, and so are the values that stay.
    ///
    /// # Errors
    /// [`ExportError`]: no such label, another number of values, a value that the ECU cannot hold (`held`, else as many
    /// decimals as the file shows).
    pub fn with(&self, name: &str, values: &[f64], held: Option<&Held>) -> Result<Self, ExportError> {
        let c = self.constant(name)?;
        if values.len() != c.values.len() {
            let reason = format!("found {} values, expected {} x {}", values.len(), c.rows, c.columns);
            return Err(ExportError::form(name, reason));
        }
        let mut bytes = Vec::with_capacity(self.bytes.len());
        let mut from = 0;
        for (k, (&new, old)) in values.iter().zip(&c.values).enumerate() {
            let place = &c.places[k];
            // An equal value keeps its bytes, however it was written.
            if new == *old {
                continue;
            }
            let where_ = format!("{}, line {}, `{name}`, value {}", self.file, c.line, k + 1);
            match held {
                Some(held) => held.check(new).map_err(|why| ExportError::form(&where_, why))?,
                None => check_digits(new, c.digits).map_err(|why| ExportError::form(&where_, why))?,
            }
            let token = &self.bytes[place.clone()];
            let shown = token.iter().position(|b| *b == b'.').map_or(0, |dot| token.len() - dot - 1);
            let needed = held.map_or(c.digits, Held::decimals);
            bytes.extend_from_slice(&self.bytes[from..place.start]);
            bytes.extend_from_slice(format!("{new:.*}", shown.max(needed)).as_bytes());
            from = place.end;
        }
        bytes.extend_from_slice(&self.bytes[from..]);
        Self::parse(&self.file, bytes)
    }
}

fn check_digits(value: f64, digits: usize) -> Result<(), String> {
    let scaled = value * 10f64.powi(digits as i32);
    if value.is_finite() && (scaled - scaled.round()).abs() < 1e-6 * scaled.abs().max(1.0) {
        return Ok(());
    }
    Err(format!("found {value}, expected a number of {digits} decimals, as the file has of this label"))
}

/// Places of what stands between white space.
fn tokens(content: &str, offset: usize) -> Vec<Range<usize>> {
    let mut out = Vec::new();
    let mut start = None;
    for (k, c) in content.char_indices() {
        match (c.is_whitespace(), start) {
            (false, None) => start = Some(k),
            (true, Some(s)) => {
                out.push(offset + s..offset + k);
                start = None;
            }
            _ => {}
        }
    }
    out.extend(start.map(|s| offset + s..offset + content.len()));
    out
}
