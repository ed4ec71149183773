//! What is exported in one go: characteristics, programs and where they came from.

use serde::{Deserialize, Serialize};

use crate::characteristic::{Axis, Characteristic};
use crate::error::ExportError;
use crate::program::Program;

/// Range of a channel in which something is valid.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ValidRange {
    /// Channel.
    pub channel: String,
    /// Unit.
    pub unit: String,
    /// Lower end.
    pub lower: f64,
    /// Upper end.
    pub upper: f64,
}

/// Where an export came from; written as a comment into every format.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Provenance {
    /// Run or file.
    pub run: String,
    /// Digest of the spec.
    pub spec_digest: String,
    /// Version of the program.
    pub version: String,
    /// Digest of all that the step of the run read, data among it.
    pub data_digest: String,
    /// File that holds it in the run.
    pub file: String,
    /// Its digest.
    pub file_digest: String,
    /// Where it is valid.
    pub validity: Vec<ValidRange>,
}

impl Provenance {
    /// Lines of a comment, ASCII.
    pub fn lines(&self) -> Vec<String> {
        let mut out = vec![format!("Exported by dynocal {}", self.version)];
        let mut say = |what: &str, value: &str| {
            if !value.is_empty() {
                out.push(format!("{what}: {value}"));
            }
        };
        say("Run", &self.run);
        say("Spec digest", &self.spec_digest);
        say("Data digest", &self.data_digest);
        say("File", &self.file);
        say("File digest", &self.file_digest);
        for r in &self.validity {
            out.push(format!("Learnt with {} from {} to {} {}", r.channel, r.lower, r.upper, r.unit));
        }
        out.iter().map(|l| ascii(l).replace("*/", "* /")).collect()
    }
}

/// `text` in ASCII on one line: the characters of units are spelt out, others become `?`.
pub fn ascii(text: &str) -> String {
    text.replace("°C", "degC")
        .replace("°F", "degF")
        .replace('°', "deg")
        .replace(['µ', 'μ'], "u")
        .replace('³', "3")
        .replace('²', "2")
        .replace('·', "*")
        .chars()
        .map(|c| {
            if c.is_ascii_graphic() || c == ' ' {
                c
            } else if c.is_whitespace() {
                ' '
            } else {
                '?'
            }
        })
        .collect()
}

/// What a look-up gives outside its axes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Extrapolation {
    /// The value at the edge, as ECUs do.
    #[default]
    Clip,
    /// The line through the last two points, as Simulink does by default.
    Linear,
}

/// Everything that one export holds.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Package {
    /// Name, a C identifier.
    pub name: String,
    /// One line.
    pub description: String,
    /// Where it came from.
    pub provenance: Provenance,
    /// Outside the axes.
    pub extrapolation: Extrapolation,
    /// Scalars, curves, maps.
    pub characteristics: Vec<Characteristic>,
    /// What is computed sample by sample.
    pub program: Option<Program>,
    /// What a file that was read holds beside, and why it is not here; not written anywhere.
    #[serde(skip)]
    pub left_out: Vec<String>,
}

impl Package {
    /// Checks everything: names that are used twice, shared axes that differ, characteristics, program.
    ///
    /// # Errors
    /// [`ExportError::Form`] with the first fault.
    pub fn check(&self) -> Result<(), ExportError> {
        for (k, c) in self.characteristics.iter().enumerate() {
            c.check()?;
            if self.characteristics[..k].iter().any(|o| o.name == c.name) {
                return Err(ExportError::form(
                    &c.name,
                    "found this name twice, expected one characteristic of a name",
                ));
            }
        }
        self.shared_axes()?;
        self.program.as_ref().map_or(Ok(()), |p| p.check(&self.characteristics))
    }

    /// Shared axes, each once, in the order of use.
    ///
    /// # Errors
    /// [`ExportError::Form`] where one name stands for different points.
    pub fn shared_axes(&self) -> Result<Vec<&Axis>, ExportError> {
        let mut out: Vec<&Axis> = Vec::new();
        for axis in self.characteristics.iter().flat_map(|c| &c.axes).filter(|a| a.shared) {
            match out.iter().find(|o| o.name == axis.name) {
                Some(o) if o.points != axis.points || o.unit != axis.unit => {
                    return Err(ExportError::form(
                        &axis.name,
                        "found two shared axes of this name with different points",
                    ));
                }
                Some(_) => {}
                None => out.push(axis),
            }
        }
        Ok(out)
    }
}
