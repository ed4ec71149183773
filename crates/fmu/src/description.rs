//! The description of an FMU: variables, units, capabilities.

use std::collections::BTreeSet;

use roxmltree::{Document, Node};

use crate::error::FmuError;

/// Version of the standard.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Version {
    /// FMI 2.0.
    Two,
    /// FMI 3.0.
    Three,
}

/// What a variable is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Set by the caller.
    Input,
    /// Computed by the unit.
    Output,
    /// Set before the start.
    Parameter,
    /// Anything else.
    Other,
}

/// A floating-point variable.
#[derive(Clone, Debug, PartialEq)]
pub struct FmiVariable {
    /// Name.
    pub name: String,
    /// Value reference.
    pub reference: u32,
    /// What it is for.
    pub role: Role,
    /// Unit, `-` where there is none.
    pub unit: String,
    /// Start value.
    pub start: Option<f64>,
    /// Least allowed value.
    pub min: Option<f64>,
    /// Greatest allowed value.
    pub max: Option<f64>,
}

/// What an FMU says about itself.
#[derive(Clone, Debug, PartialEq)]
pub struct Description {
    /// Version of the standard.
    pub version: Version,
    /// Name of the model.
    pub model: String,
    /// Name of the library and prefix of the sources.
    pub identifier: String,
    /// Identifier that the library checks.
    pub token: String,
    /// Floating-point scalars in the order of the file.
    pub variables: Vec<FmiVariable>,
    /// Whether the state can be taken out as bytes.
    pub serialises: bool,
    /// Step that the unit asks for, in s.
    pub step_s: Option<f64>,
    /// What is left out, in the user's words.
    pub notes: Vec<String>,
}

/// A fault of the description of the FMU `path`.
struct At<'a, 'input> {
    path: &'a str,
    doc: &'a Document<'input>,
}

impl At<'_, '_> {
    fn fault(&self, n: Node, reason: String) -> FmuError {
        let line = self.doc.text_pos_at(n.range().start).row as usize;
        FmuError::Description { path: self.path.into(), line, reason }
    }

    fn need(&self, n: Node, key: &str) -> Result<String, FmuError> {
        let found = n.attribute(key).map(str::to_string);
        found.ok_or_else(|| self.fault(n, format!("<{}> has no `{key}`", n.tag_name().name())))
    }

    /// A finite number, where the attribute is there.
    fn number(&self, n: Node, key: &str) -> Result<Option<f64>, FmuError> {
        let Some(text) = n.attribute(key) else { return Ok(None) };
        match text.trim().parse::<f64>() {
            Ok(x) if x.is_finite() => Ok(Some(x)),
            _ => Err(self.fault(n, format!("found {key}=\"{text}\", expected a finite number"))),
        }
    }
}

fn child<'a, 'input>(n: Node<'a, 'input>, name: &str) -> Option<Node<'a, 'input>> {
    n.children().find(|c| c.has_tag_name(name))
}

impl Description {
    /// Parses `modelDescription.xml`; `path` is the FMU for messages.
    ///
    /// # Errors
    /// [`FmuError::Description`].
    pub fn parse(path: &str, xml: &str) -> Result<Self, FmuError> {
        let doc = Document::parse(xml.trim_start_matches('\u{feff}')).map_err(|e| FmuError::Description {
            path: path.into(),
            line: e.pos().row as usize,
            reason: e.to_string(),
        })?;
        let at = At { path, doc: &doc };
        let root = doc.root_element();
        let version = match root.attribute("fmiVersion") {
            Some("2.0") => Version::Two,
            Some(v) if v.starts_with("3.") => Version::Three,
            other => {
                let found = other.unwrap_or("none");
                return Err(at.fault(root, format!("found fmiVersion {found}, expected 2.0 or 3.0")));
            }
        };
        let two = version == Version::Two;
        let simulation = child(root, "CoSimulation").ok_or_else(|| {
            at.fault(root, "found no <CoSimulation>: model exchange is not supported".into())
        })?;
        let serialises = if two { "canSerializeFMUstate" } else { "canSerializeFMUState" };
        let experiment = child(root, "DefaultExperiment");
        let mut out = Self {
            version,
            model: at.need(root, "modelName")?,
            identifier: at.need(simulation, "modelIdentifier")?,
            token: at.need(root, if two { "guid" } else { "instantiationToken" })?,
            variables: Vec::new(),
            serialises: matches!(simulation.attribute(serialises), Some("true" | "1")),
            step_s: match at.number(simulation, "fixedInternalStepSize")? {
                None => experiment.map(|n| at.number(n, "stepSize")).transpose()?.flatten(),
                step => step,
            },
            notes: Vec::new(),
        };
        if out.identifier.is_empty() || !out.identifier.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
        {
            let found = format!("found the model identifier `{}`, expected a name of C", out.identifier);
            return Err(at.fault(simulation, found));
        }
        let mut names = BTreeSet::new();
        for n in child(root, "ModelVariables").iter().flat_map(|l| l.children()).filter(Node::is_element) {
            let Some(variable) = variable(&at, n, version, &mut out.notes)? else { continue };
            if !names.insert(variable.name.clone()) {
                return Err(at.fault(n, format!("found the variable `{}` twice", variable.name)));
            }
            out.variables.push(variable);
        }
        if !out.variables.iter().any(|v| v.role == Role::Output) {
            return Err(at.fault(root, "found no floating-point output".into()));
        }
        Ok(out)
    }
}

/// A floating-point scalar; `None` for what is something else, which is noted where it is an input or an output.
fn variable(
    at: &At,
    n: Node,
    version: Version,
    notes: &mut Vec<String>,
) -> Result<Option<FmiVariable>, FmuError> {
    let name = at.need(n, "name")?;
    let role = match n.attribute("causality") {
        Some("input") => Role::Input,
        Some("output") => Role::Output,
        Some("parameter") => Role::Parameter,
        _ => Role::Other,
    };
    let (real, simple) = match version {
        Version::Two => (child(n, "Real"), "Real"),
        Version::Three => (Some(n).filter(|n| n.has_tag_name("Float64")), "Float64Type"),
    };
    let array = child(n, "Dimension").is_some();
    let Some(real) = real.filter(|_| !array) else {
        if matches!(role, Role::Input | Role::Output) {
            notes.push(format!("`{name}` is no floating-point scalar and is left out"));
        }
        return Ok(None);
    };
    let reference = at.need(n, "valueReference")?;
    let reference = reference
        .parse()
        .map_err(|_| at.fault(n, format!("`{name}`: found the value reference `{reference}`")))?;
    // What a variable does not say itself, its declared type may.
    let declared = declared_type(at, real, simple)?;
    let number = |key: &str| match at.number(real, key)? {
        None => declared.map(|d| at.number(d, key)).transpose().map(Option::flatten),
        own => Ok(own),
    };
    let (start, min, max) = (at.number(real, "start")?, number("min")?, number("max")?);
    if let (Some(a), Some(b)) = (min, max)
        && a > b
    {
        return Err(at.fault(n, format!("`{name}`: found min {a} above max {b}")));
    }
    let unit = real.attribute("unit").or_else(|| declared.and_then(|d| d.attribute("unit")));
    let unit = unit.filter(|u| !u.is_empty()).unwrap_or("-").to_string();
    Ok(Some(FmiVariable { name, reference, role, unit, start, min, max }))
}

/// The type that `real` refers to: in FMI 2.0 a <SimpleType> with a child <Real>, in FMI 3.0 a <Float64Type>.
fn declared_type<'a, 'input>(
    at: &At<'a, 'input>,
    real: Node,
    simple: &str,
) -> Result<Option<Node<'a, 'input>>, FmuError> {
    let Some(name) = real.attribute("declaredType") else { return Ok(None) };
    let named = |n: &Node<'a, 'input>| n.attribute("name") == Some(name);
    let types = child(at.doc.root_element(), "TypeDefinitions");
    let found = types.and_then(|t| t.children().find(named));
    let found = found.and_then(|n| if simple == "Real" { child(n, simple) } else { Some(n) });
    found.map(Some).ok_or_else(|| at.fault(real, format!("found no type `{name}` with numbers")))
}
