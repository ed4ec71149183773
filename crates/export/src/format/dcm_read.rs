//! Reads DCM 2.x, strict where other readers let faults pass: counts, missing `END`, axes that do not increase, numbers
//! that are none, unknown keywords and versions are refused with their line.

use crate::characteristic::{Axis, Characteristic};
use crate::error::ExportError;
use crate::package::Package;

/// Reads a file; the encoding (UTF-8 with or without mark, else Windows-1252) is told in the description.
///
/// # Errors
/// [`ExportError::Malformed`] with the line.
pub(crate) fn read(file: &str, bytes: &[u8]) -> Result<Package, ExportError> {
    let encoding = dynocal_files::measurement::csv_dialect::guess_encoding(bytes);
    let text = dynocal_files::measurement::csv_dialect::decode(bytes, encoding);
    let mut reader = Reader { file, lines: Vec::new(), at: 0, axes: Vec::new(), words: Vec::new() };
    reader.lines = text.lines().enumerate().map(|(k, l)| (k + 1, l.trim())).collect();
    let mut package = reader.file()?;
    package.provenance.run = format!("{file} (read as {encoding:?})");
    Ok(package)
}

struct Reader<'a> {
    file: &'a str,
    lines: Vec<(usize, &'a str)>,
    at: usize,
    axes: Vec<Axis>,
    /// Objects that hold words, which no characteristic of ours does.
    words: Vec<String>,
}

/// An object while its lines are read.
#[derive(Default)]
struct Object {
    line: usize,
    description: String,
    units: [String; 3],
    shared: [Option<String>; 2],
    x: Vec<f64>,
    y: Vec<f64>,
    values: Vec<f64>,
    /// Values that stood before each ST/Y, to check the rows of a map.
    rows: Vec<usize>,
    text: bool,
}

/// Blanks separate words; quoted text is one word.
fn words(line: &str) -> Vec<String> {
    let (mut out, mut word, mut quoted) = (Vec::new(), String::new(), false);
    let mut any = false;
    for c in line.chars() {
        match c {
            '"' => (quoted, any) = (!quoted, true),
            c if c.is_whitespace() && !quoted => {
                if any || !word.is_empty() {
                    out.push(std::mem::take(&mut word));
                }
                any = false;
            }
            c => word.push(c),
        }
    }
    if any || !word.is_empty() {
        out.push(word);
    }
    out
}

impl Reader<'_> {
    fn fault<T>(&self, line: usize, reason: impl Into<String>) -> Result<T, ExportError> {
        Err(ExportError::Malformed { file: self.file.into(), line, reason: reason.into() })
    }

    /// The next line that is no comment; lines `*SSTX name` are kept, because they say which axis is shared.
    fn next(&mut self) -> Option<(usize, String)> {
        while let Some((number, line)) = self.lines.get(self.at) {
            self.at += 1;
            let comment = line.starts_with(['*', '!', '.'])
                && !line.starts_with("*SSTX ")
                && !line.starts_with("*SSTY ");
            if !line.is_empty() && !comment {
                return Some((*number, (*line).to_string()));
            }
        }
        None
    }

    fn file(&mut self) -> Result<Package, ExportError> {
        let Some((line, first)) = self.next() else { return self.fault(1, "the file is empty") };
        let version = words(&first);
        match version.iter().map(String::as_str).collect::<Vec<_>>()[..] {
            ["KONSERVIERUNG_FORMAT", v] if v.starts_with("2.") => {}
            ["KONSERVIERUNG_FORMAT", v] => {
                return self.fault(line, format!("found version {v}, expected 2.x"));
            }
            _ => return self.fault(line, format!("found `{first}`, expected KONSERVIERUNG_FORMAT 2.0")),
        }
        let mut package = Package { name: "dcm".into(), ..Default::default() };
        while let Some((line, text)) = self.next() {
            let word = words(&text);
            match word.first().map_or("", String::as_str) {
                "MODULKOPF" => {}
                "FUNKTIONEN" => {
                    let lines = self.block(line)?;
                    if let Some(f) = lines.iter().find(|l| l.first().is_some_and(|w| w == "FKT")) {
                        package.name = f.get(1).cloned().unwrap_or_default();
                        package.description = f.get(3).cloned().unwrap_or_default();
                    }
                }
                "VARIANTENKODIERUNG" => drop(self.block(line)?),
                _ => package.characteristics.extend(self.object(line, &word)?),
            }
        }
        self.link(&mut package)?;
        package.left_out = self.words.iter().map(|name| format!("`{name}`: it holds words")).collect();
        Ok(package)
    }

    /// Lines to END.
    fn block(&mut self, start: usize) -> Result<Vec<Vec<String>>, ExportError> {
        let mut out = Vec::new();
        loop {
            match self.next() {
                Some((_, l)) if l == "END" => return Ok(out),
                Some((_, l)) => out.push(words(&l)),
                None => return self.fault(start, "the block has no END"),
            }
        }
    }

    fn object(&mut self, line: usize, head: &[String]) -> Result<Option<Characteristic>, ExportError> {
        let kind = head[0].as_str();
        let axes = match kind {
            "FESTWERT" | "FESTWERTEBLOCK" | "TEXTSTRING" => 0,
            "KENNLINIE" | "FESTKENNLINIE" | "GRUPPENKENNLINIE" | "STUETZSTELLENVERTEILUNG" => 1,
            "KENNFELD" | "FESTKENNFELD" | "GRUPPENKENNFELD" => 2,
            _ => return self.fault(line, format!("unknown keyword `{kind}`")),
        };
        let Some(name) = head.get(1) else { return self.fault(line, format!("{kind} has no name")) };
        let sizes: Vec<usize> =
            head[2..].iter().filter(|w| *w != "@").filter_map(|w| w.parse().ok()).collect();
        let wanted = if kind == "FESTWERTEBLOCK" { 1 } else { axes };
        if sizes.len() < wanted || sizes.iter().any(|s| *s == 0 || *s > 1_000_000) {
            return self.fault(
                line,
                format!("{kind} {name}: found the sizes {sizes:?}, expected {wanted} positive numbers"),
            );
        }
        let object = self.body(line, kind, name)?;
        if kind == "TEXTSTRING" || object.text {
            self.words.push(name.clone());
            return Ok(None);
        }
        self.check(kind, name, &sizes, &object)?;
        let [unit_x, unit_y, unit] = object.units;
        let axis = |k: usize, points: Vec<f64>, unit: String| Axis {
            name: object.shared[k].clone().unwrap_or_else(|| format!("{name}_{}", ["x", "y"][k])),
            description: String::new(),
            unit,
            input: String::new(),
            points,
            shared: kind.starts_with("GRUPPEN"),
        };
        if kind == "STUETZSTELLENVERTEILUNG" {
            let mut a = axis(0, object.x, unit_x);
            (a.name, a.description, a.shared) = (name.clone(), object.description, true);
            self.axes.push(a);
            return Ok(None);
        }
        let mut all = vec![axis(0, object.x, unit_x), axis(1, object.y, unit_y)];
        all.truncate(axes);
        Ok(Some(Characteristic {
            name: name.clone(),
            description: object.description,
            unit,
            axes: all,
            values: object.values,
            limits: None,
        }))
    }

    fn body(&mut self, line: usize, kind: &str, name: &str) -> Result<Object, ExportError> {
        let mut o = Object { line, ..Default::default() };
        loop {
            let Some((line, text)) = self.next() else {
                return self.fault(o.line, format!("{kind} {name} has no END"));
            };
            let word = words(&text);
            let second = word.get(1).cloned().unwrap_or_default();
            match word.first().map_or("", String::as_str) {
                "END" => return Ok(o),
                "*SSTX" => o.shared[0] = Some(second),
                "*SSTY" => o.shared[1] = Some(second),
                "LANGNAME" => o.description = second,
                "DISPLAYNAME" | "VAR" | "FUNKTION" => {}
                "EINHEIT_X" => o.units[0] = second,
                "EINHEIT_Y" => o.units[1] = second,
                "EINHEIT_W" => o.units[2] = second,
                "ST/X" => self.append(line, &word[1..], &mut o.x)?,
                "ST/Y" => {
                    o.rows.push(o.values.len());
                    self.append(line, &word[1..], &mut o.y)?;
                }
                "WERT" => self.append(line, &word[1..], &mut o.values)?,
                "TEXT" | "ST_TX/X" | "ST_TX/Y" => o.text = true,
                other => {
                    return self
                        .fault(line, format!("{kind} {name}: unknown keyword `{other}` (is END missing?)"));
                }
            }
        }
    }

    fn append(&self, line: usize, cells: &[String], to: &mut Vec<f64>) -> Result<(), ExportError> {
        for cell in cells {
            let value = match cell.to_ascii_lowercase().as_str() {
                "true" => 1.0,
                "false" => 0.0,
                hex if hex.starts_with("0x") => match u64::from_str_radix(&hex[2..], 16) {
                    Ok(v) => v as f64,
                    Err(_) => return self.fault(line, format!("found `{cell}`, expected a number")),
                },
                plain => match plain.parse::<f64>() {
                    Ok(v) if v.is_finite() => v,
                    _ => {
                        return self.fault(
                            line,
                            format!("found `{cell}`, expected a finite number with a decimal point"),
                        );
                    }
                },
            };
            to.push(value);
        }
        Ok(())
    }

    fn check(&self, kind: &str, name: &str, sizes: &[usize], o: &Object) -> Result<(), ExportError> {
        let fault = |what: &str, found: usize, expected: usize| {
            self.fault(o.line, format!("{kind} {name}: found {found} {what}, expected {expected}"))
        };
        let axis = kind == "STUETZSTELLENVERTEILUNG";
        let (nx, ny) = (sizes.first().copied().unwrap_or(1), sizes.get(1).copied().unwrap_or(1));
        let has_axes = axis || kind.contains("KENN");
        if has_axes && o.x.len() != nx {
            return fault("ST/X values", o.x.len(), nx);
        }
        if kind.contains("KENNFELD") {
            if o.y.len() != ny {
                return fault("ST/Y values", o.y.len(), ny);
            }
            if let Some(k) = (0..ny).find(|k| o.rows.get(*k) != Some(&(k * nx))) {
                return fault("values before a row", o.rows.get(k).copied().unwrap_or(0), k * nx);
            }
        }
        let wanted = match kind {
            _ if axis => 0,
            "FESTWERT" => 1,
            _ => sizes.iter().fold(1usize, |a, s| a.saturating_mul(*s)),
        };
        if o.values.len() != wanted {
            return fault("WERT values", o.values.len(), wanted);
        }
        for (points, letter) in [(&o.x, "X"), (&o.y, "Y")] {
            if let Some(w) = points.windows(2).find(|w| !(w[1] > w[0])) {
                return self.fault(
                    o.line,
                    format!(
                        "{kind} {name}: ST/{letter} goes from {} to {}, expected increasing points",
                        w[0], w[1]
                    ),
                );
            }
        }
        Ok(())
    }

    /// Shared axes take points and description from their distribution, which must agree.
    fn link(&self, package: &mut Package) -> Result<(), ExportError> {
        for axis in package.characteristics.iter_mut().flat_map(|c| &mut c.axes).filter(|a| a.shared) {
            match self.axes.iter().find(|d| d.name == axis.name) {
                Some(d) if d.points != axis.points => {
                    return self
                        .fault(0, format!("axis `{}` has other points in its distribution", axis.name));
                }
                Some(d) => axis.description.clone_from(&d.description),
                None if axis.name.ends_with("_x") || axis.name.ends_with("_y") => axis.shared = false,
                None => return self.fault(0, format!("axis `{}` has no STUETZSTELLENVERTEILUNG", axis.name)),
            }
        }
        Ok(())
    }
}
