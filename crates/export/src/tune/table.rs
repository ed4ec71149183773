//! `.table`: one table with its axes, the safest thing to hand over.

use std::fmt::Write;

use super::decoded;
use crate::error::ExportError;

/// A table.
#[derive(Clone, Debug, PartialEq)]
pub struct TuneTable {
    /// What enters along x, as the tool calls it.
    pub x_name: String,
    /// Breakpoints along x.
    pub x: Vec<f64>,
    /// What enters along y.
    pub y_name: String,
    /// Breakpoints along y.
    pub y: Vec<f64>,
    /// Values, x fastest; the first row belongs to the first breakpoint of y.
    pub z: Vec<f64>,
}

impl TuneTable {
    /// Reads a table.
    ///
    /// # Errors
    /// [`ExportError::Malformed`].
    pub fn parse(file: &str, bytes: &[u8]) -> Result<Self, ExportError> {
        let (text, _) = decoded(bytes);
        let bad = |line: usize, reason: String| ExportError::Malformed { file: file.into(), line, reason };
        let document = roxmltree::Document::parse(&text)
            .map_err(|e| bad(e.pos().row as usize, format!("not a table: {e}")))?;
        let find = |name: &str| {
            document
                .descendants()
                .find(|n| n.tag_name().name() == name)
                .ok_or_else(|| bad(0, format!("found no element `{name}`")))
        };
        let numbers = |name: &str| -> Result<Vec<f64>, ExportError> {
            let node = find(name)?;
            let line = document.text_pos_at(node.range().start).row as usize;
            let words = node.text().unwrap_or("").split_whitespace();
            words
                .map(|w| {
                    w.parse::<f64>()
                        .ok()
                        .filter(|v| v.is_finite())
                        .ok_or_else(|| bad(line, format!("found `{w}` in `{name}`, expected numbers")))
                })
                .collect()
        };
        let name = |axis: &str| find(axis).map(|n| n.attribute("name").unwrap_or("").to_string());
        let out = Self {
            x_name: name("xAxis")?,
            x: numbers("xAxis")?,
            y_name: name("yAxis")?,
            y: numbers("yAxis")?,
            z: numbers("zValues")?,
        };
        if out.x.is_empty() || out.z.len() != out.x.len() * out.y.len() {
            let found = out.z.len();
            return Err(bad(0, format!("found {found} values, expected {} x {}", out.y.len(), out.x.len())));
        }
        Ok(out)
    }

    /// The file, with values of so many decimals.
    pub fn text(&self, digits: usize) -> String {
        let mut s = String::from("<?xml version=\"1.0\" encoding=\"UTF-8\" standalone=\"no\"?>\n");
        let (cols, rows) = (self.x.len(), self.y.len());
        let _ = writeln!(s, "<tableData xmlns=\"http://www.EFIAnalytics.com/:table\">");
        let _ = writeln!(s, "<bibliography author=\"dynocal\"/>\n<versionInfo fileFormat=\"1.0\"/>");
        let _ = writeln!(s, "<table cols=\"{cols}\" rows=\"{rows}\">");
        let axis = |v: &[f64]| v.iter().map(|x| format!("{x}")).collect::<Vec<_>>().join(" \n         ");
        let escape = crate::format::cdfx::escape;
        let _ = writeln!(
            s,
            "<xAxis cols=\"{cols}\" name=\"{}\">\n         {} \n      </xAxis>",
            escape(&self.x_name),
            axis(&self.x)
        );
        let _ = writeln!(
            s,
            "<yAxis name=\"{}\" rows=\"{rows}\">\n         {} \n      </yAxis>",
            escape(&self.y_name),
            axis(&self.y)
        );
        let _ = writeln!(s, "<zValues cols=\"{cols}\" rows=\"{rows}\">");
        for row in self.z.chunks(cols.max(1)) {
            // The tool itself never writes a value without a decimal.
            let words: Vec<String> = row.iter().map(|v| format!("{v:.*}", digits.max(1))).collect();
            let _ = writeln!(s, "         {} ", words.join(" "));
        }
        s.push_str("      </zValues>\n</table>\n</tableData>\n");
        s
    }
}
