//! The part of an ECU definition (`.ini`) that says what a label can hold, which axes a table has, and which table the tool analyses.

use std::collections::BTreeMap;

use super::decoded;

/// What the ECU can hold in a label: `value = (raw + offset) scale`, raw a whole number of its type.
#[derive(Clone, Debug, PartialEq)]
pub struct Held {
    /// Name.
    pub name: String,
    /// Unit.
    pub unit: String,
    /// Least and greatest raw value of its type; none of a floating one.
    pub raw: Option<(f64, f64)>,
    /// See above.
    pub scale: f64,
    /// See above.
    pub offset: f64,
    /// Least value that is allowed, where the file gives a number.
    pub least: Option<f64>,
    /// Greatest value that is allowed, where the file gives a number.
    pub greatest: Option<f64>,
    /// Rows and columns; 1 and 1 of a scalar, 1 and n of a curve.
    pub shape: (usize, usize),
}

impl Held {
    /// Whether the ECU can hold `value`.
    ///
    /// # Errors
    /// Why not, in words.
    pub fn check(&self, value: f64) -> Result<(), String> {
        if !value.is_finite() {
            return Err(format!("found {value}, expected a finite number"));
        }
        let slack = 1e-9 * value.abs().max(1.0);
        let (least, greatest) = self.range();
        if value < least - slack || value > greatest + slack {
            return Err(format!(
                "found {value}, expected {least} to {greatest} {}, as the ECU holds",
                self.unit
            ));
        }
        let raw = value / self.scale - self.offset;
        if self.raw.is_some() && (raw - raw.round()).abs() > 1e-6 * raw.abs().max(1.0) {
            return Err(format!(
                "found {value}, expected whole steps of {} {}, as the ECU holds",
                self.scale, self.unit
            ));
        }
        Ok(())
    }

    /// Least and greatest value, of its type and of the file.
    pub fn range(&self) -> (f64, f64) {
        let (lo, hi) = self.raw.unwrap_or((f64::NEG_INFINITY, f64::INFINITY));
        let of = |raw: f64| (raw + self.offset) * self.scale;
        let (a, b) = (of(lo).min(of(hi)), of(lo).max(of(hi)));
        (self.least.map_or(a, |l| l.max(a)), self.greatest.map_or(b, |g| g.min(b)))
    }

    /// Step between two values; none of a floating label.
    pub fn step(&self) -> Option<f64> {
        self.raw.map(|_| self.scale.abs())
    }

    /// Decimals that a step has.
    pub fn decimals(&self) -> usize {
        (0..9).find(|d| (self.scale * 10f64.powi(*d)).fract().abs() < 1e-9).unwrap_or(6) as usize
    }
}

/// A table of the ECU: names of labels, and the channels that enter.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TableDef {
    /// Its own name.
    pub name: String,
    /// Label of the breakpoints along x, and the channel that enters.
    pub x: (String, String),
    /// The same along y.
    pub y: (String, String),
    /// Label of the values.
    pub z: String,
}

/// What was read.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Definition {
    /// Labels, by name.
    pub labels: BTreeMap<String, Held>,
    /// Tables.
    pub tables: Vec<TableDef>,
    /// Table that the tool analyses, table of its target, lambda channel, trim channel.
    pub analyse: Option<[String; 4]>,
    /// What a channel is called in a log, by its name in this file.
    pub logged: BTreeMap<String, String>,
}

impl Definition {
    /// Reads a definition. Of `#if NAME` the first branch counts where `symbols` has the name, else the other one. A line that does
    /// not follow the format is passed over: such files hold much that is for the tool alone.
    pub fn parse(bytes: &[u8], symbols: &[&str]) -> Self {
        let (text, _) = decoded(bytes);
        let mut out = Self::default();
        let mut section = String::new();
        // Whether each open branch counts, and whether it is in doubt at all.
        let mut branches: Vec<bool> = Vec::new();
        for line in text.lines() {
            let line = without_comment(line).trim();
            if let Some(rest) = line.strip_prefix("#if") {
                branches.push(symbols.contains(&rest.trim()));
                continue;
            }
            match line {
                "#else" => {
                    if let Some(b) = branches.last_mut() {
                        *b = !*b;
                    }
                    continue;
                }
                "#endif" => {
                    branches.pop();
                    continue;
                }
                _ => {}
            }
            if !branches.iter().all(|b| *b) || line.is_empty() {
                continue;
            }
            if let Some(name) = line.strip_prefix('[').and_then(|l| l.strip_suffix(']')) {
                section = name.to_string();
                continue;
            }
            let Some((key, value)) = line.split_once('=') else { continue };
            out.line(&section, key.trim(), &fields(value));
        }
        out
    }

    fn line(&mut self, section: &str, key: &str, f: &[String]) {
        let at = |k: usize| f.get(k).cloned().unwrap_or_default();
        match (section, key) {
            ("Constants" | "PcVariables", _) => {
                if let Some(held) = held(key, f) {
                    self.labels.insert(key.to_string(), held);
                }
            }
            ("TableEditor", "table") => self.tables.push(TableDef { name: at(0), ..TableDef::default() }),
            ("TableEditor", "xBins" | "yBins" | "zBins") => {
                let Some(table) = self.tables.last_mut() else { return };
                match key {
                    "xBins" => table.x = (at(0), at(1)),
                    "yBins" => table.y = (at(0), at(1)),
                    _ => table.z = at(0),
                }
            }
            ("VeAnalyze", "veAnalyzeMap") => self.analyse = Some([at(0), at(1), at(2), at(3)]),
            ("Datalog", "entry") => {
                self.logged.insert(at(0), at(1));
            }
            _ => {}
        }
    }
}

/// A label of `[Constants]`; none of what is no number (bits, text).
fn held(name: &str, f: &[String]) -> Option<Held> {
    let array = match f.first()?.as_str() {
        "scalar" => false,
        "array" => true,
        _ => return None,
    };
    let raw = match f.get(1)?.as_str() {
        "U08" => Some((0.0, 255.0)),
        "S08" => Some((-128.0, 127.0)),
        "U16" => Some((0.0, 65_535.0)),
        "S16" => Some((-32_768.0, 32_767.0)),
        "U32" => Some((0.0, 4_294_967_295.0)),
        "S32" => Some((-2_147_483_648.0, 2_147_483_647.0)),
        "F32" => None,
        _ => return None,
    };
    // The variables of the tool have no place in the memory of the ECU.
    let place = usize::from(f.get(2).is_some_and(|p| p.parse::<f64>().is_ok()));
    let shape = if array { shape(f.get(2 + place)?)? } else { (1, 1) };
    let rest = &f[(2 + place + usize::from(array)).min(f.len())..];
    let number = |k: usize| rest.get(k).and_then(|t| t.parse::<f64>().ok()).filter(|v| v.is_finite());
    let scale = number(1).filter(|s| *s != 0.0)?;
    let unit = rest.first().filter(|u| !u.starts_with('{')).cloned().unwrap_or_default();
    Some(Held {
        name: name.into(),
        unit,
        raw,
        scale,
        offset: number(2).unwrap_or(0.0),
        least: number(3),
        greatest: number(4),
        shape,
    })
}

/// `[16x16]` as rows and columns, `[16]` as one row.
fn shape(text: &str) -> Option<(usize, usize)> {
    let inner = text.trim().strip_prefix('[')?.strip_suffix(']')?;
    match inner.split_once('x') {
        Some((a, b)) => Some((a.trim().parse().ok()?, b.trim().parse().ok()?)),
        None => Some((1, inner.trim().parse().ok()?)),
    }
}

fn without_comment(line: &str) -> &str {
    let mut quoted = false;
    for (k, c) in line.char_indices() {
        match c {
            '"' => quoted = !quoted,
            ';' if !quoted => return &line[..k],
            _ => {}
        }
    }
    line
}

/// What stands between commas, not those within quotes, braces or brackets; without the quotes.
fn fields(text: &str) -> Vec<String> {
    let (mut out, mut word, mut depth, mut quoted) = (Vec::new(), String::new(), 0i32, false);
    for c in text.chars() {
        match c {
            '"' => quoted = !quoted,
            '{' | '[' | '(' if !quoted => depth += 1,
            '}' | ']' | ')' if !quoted => depth -= 1,
            _ => {}
        }
        if c == ',' && !quoted && depth <= 0 {
            out.push(word.trim().to_string());
            word.clear();
        } else if c != '"' {
            word.push(c);
        }
    }
    out.push(word.trim().to_string());
    out
}
