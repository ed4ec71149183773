//! Regressors: products of lagged inputs and outputs and of functions of them, and their text form.

use super::function::{Function, delay};
use super::text::{Context, Parsed};

/// Longest lag that a structure may have, in samples: a typing error must not become a huge window.
pub const MAX_LAG: usize = 10_000;
/// Highest total degree of a regressor.
pub const MAX_DEGREE: u32 = 12;

/// What a factor reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Source {
    /// Input number i (zero-based, order of the model's inputs).
    Input(usize),
    /// The model's output.
    Output,
}

/// One factor of a regressor: `source(t - lag)^power`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Factor {
    /// What is read.
    pub source: Source,
    /// Delay in samples; at least 1 for the output.
    pub lag: usize,
    /// Power, at least 1.
    pub power: u32,
}

/// A product of factors and functions; no factor is the constant regressor `1`.
///
/// Factors are kept sorted and merged, so that equal products compare equal.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Regressor {
    factors: Vec<Factor>,
    functions: Vec<Function>,
}

/// A model structure is not well formed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum StructureError {
    /// The text is not a regressor.
    #[error("regressor `{text}`: found `{found}`, expected {expected}")]
    Syntax {
        /// The whole regressor.
        text: String,
        /// The part that does not fit.
        found: String,
        /// What belongs there.
        expected: &'static str,
    },
    /// A name is neither an input nor the output.
    #[error("regressor `{text}`: no channel `{found}`{}; channels are: {}", hint(.nearest), .known.join(", "))]
    UnknownChannel {
        /// The whole regressor.
        text: String,
        /// Name found.
        found: String,
        /// Nearest known name.
        nearest: Option<String>,
        /// Inputs, then the output.
        known: Vec<String>,
    },
    /// A lag, power or degree outside what the model can hold.
    #[error("regressor `{text}`: found {what} {found}, expected {expected}")]
    Range {
        /// The whole regressor.
        text: String,
        /// `lag`, `power`, `degree` or `input number`.
        what: &'static str,
        /// Value.
        found: usize,
        /// Range in words.
        expected: String,
    },
    /// The same product twice: its two parameters could not be told apart.
    #[error("regressor `{text}` is listed twice (places {first} and {second})")]
    Duplicate {
        /// The regressor.
        text: String,
        /// First place, one-based.
        first: usize,
        /// Second place, one-based.
        second: usize,
    },
    /// A channel name that the text form could not read back, or that is used twice.
    #[error("channel name `{found}`: expected {expected}")]
    Name {
        /// The name.
        found: String,
        /// What is allowed.
        expected: &'static str,
    },
    /// Parameters that do not belong to the structure.
    #[error("the model of `{output}` from {} has {found} parameters, its structure {expected}", .inputs.join(", "))]
    Parameters {
        /// Output name.
        output: String,
        /// Parameters found.
        found: usize,
        /// Parameters of the structure.
        expected: usize,
        /// Inputs.
        inputs: Vec<String>,
    },
    /// Orders that do not belong to the inputs one to one.
    #[error("the model of `{output}` has orders for {found} inputs, expected {expected}: {}", .inputs.join(", "))]
    Orders {
        /// Output name.
        output: String,
        /// Inputs with orders.
        found: usize,
        /// Inputs.
        expected: usize,
        /// Their names.
        inputs: Vec<String>,
    },
    /// A structure that holds what it learns, before it has learnt it.
    #[error("the model of `{output}` has not been learnt: `{kind}` is estimated by `learn`")]
    NotLearnt {
        /// Output name.
        output: String,
        /// Kind.
        kind: String,
    },
    /// No regressor at all.
    #[error("the model of `{output}` has no regressor")]
    Empty {
        /// Output name.
        output: String,
    },
}

fn hint(nearest: &Option<String>) -> String {
    nearest.as_ref().map(|n| format!(" (did you mean `{n}`?)")).unwrap_or_default()
}

impl Regressor {
    /// The constant regressor.
    pub fn constant() -> Self {
        Self { factors: Vec::new(), functions: Vec::new() }
    }

    /// The product of `factors`; equal sources and lags are merged by adding their powers.
    pub fn new(mut factors: Vec<Factor>) -> Self {
        factors.retain(|f| f.power > 0);
        factors.sort_unstable();
        let mut merged: Vec<Factor> = Vec::with_capacity(factors.len());
        for f in factors {
            match merged.last_mut() {
                Some(last) if last.source == f.source && last.lag == f.lag => last.power += f.power,
                _ => merged.push(f),
            }
        }
        Self { factors: merged, functions: Vec::new() }
    }

    /// This regressor times `functions`; equal functions are merged by adding their powers.
    pub fn with_functions(mut self, functions: &[Function]) -> Self {
        self.functions.extend(functions.iter().filter(|f| f.power > 0).cloned());
        self.functions.sort();
        let mut merged: Vec<Function> = Vec::with_capacity(self.functions.len());
        for f in self.functions {
            match merged.last_mut() {
                Some(last) if (last.shape, &last.reads, last.offset) == (f.shape, &f.reads, f.offset) => {
                    last.power += f.power;
                }
                _ => merged.push(f),
            }
        }
        Self { factors: self.factors, functions: merged }
    }

    /// `input_i(t - lag)`.
    pub fn input(i: usize, lag: usize) -> Self {
        Self::new(vec![Factor { source: Source::Input(i), lag, power: 1 }])
    }

    /// `output(t - lag)`.
    pub fn output(lag: usize) -> Self {
        Self::new(vec![Factor { source: Source::Output, lag, power: 1 }])
    }

    /// The product of two regressors.
    pub fn times(&self, other: &Self) -> Self {
        Self::new(self.factors.iter().chain(&other.factors).copied().collect())
            .with_functions(&self.functions)
            .with_functions(&other.functions)
    }

    /// Plain factors, sorted: inputs by number, then lag; the output last. Not all of the regressor where
    /// [`Regressor::functions`] is not empty.
    pub fn factors(&self) -> &[Factor] {
        &self.factors
    }

    /// Factors that are functions, sorted.
    pub fn functions(&self) -> &[Function] {
        &self.functions
    }

    /// Everything that is read, as (source, lag).
    pub fn reads(&self) -> impl Iterator<Item = (Source, usize)> {
        let inside = self.functions.iter().flat_map(|f| f.reads.iter().map(|r| (r.source, r.lag)));
        self.factors.iter().map(|f| (f.source, f.lag)).chain(inside)
    }

    /// Sum of the powers.
    pub fn degree(&self) -> u32 {
        self.factors.iter().map(|f| f.power).chain(self.functions.iter().map(|f| f.power)).sum()
    }

    /// Whether a factor reads the output.
    pub fn reads_output(&self) -> bool {
        self.reads().any(|(source, _)| source == Source::Output)
    }

    /// Text form with the user's channel names, e.g. `inj(t-1)*spark(t-3)^2`, `speed(t)`, `1`.
    pub fn format(&self, inputs: &[String], output: &str) -> String {
        let name = |source| match source {
            Source::Input(i) => inputs.get(i).map_or("?", String::as_str),
            Source::Output => output,
        };
        let plain = self.factors.iter().map(|f| {
            let power = if f.power == 1 { String::new() } else { format!("^{}", f.power) };
            format!("{}({}){power}", name(f.source), delay(f.lag))
        });
        let functions = self.functions.iter().map(|f| f.format(|s| name(s).to_string()));
        let parts: Vec<String> = plain.chain(functions).collect();
        if parts.is_empty() { "1".into() } else { parts.join("*") }
    }

    /// Reads the text form.
    ///
    /// # Errors
    /// [`StructureError::Syntax`] or [`StructureError::UnknownChannel`] with the part that does not fit.
    pub fn parse(text: &str, inputs: &[String], output: &str) -> Result<Self, StructureError> {
        let trimmed = text.trim();
        if trimmed == "1" {
            return Ok(Self::constant());
        }
        let (mut factors, mut functions) = (Vec::new(), Vec::new());
        for parsed in (Context { text: trimmed, inputs, output }).factors()? {
            match parsed {
                Parsed::Plain(f) => factors.push(f),
                Parsed::Function(f) => functions.push(f),
            }
        }
        let regressor = Self::new(factors).with_functions(&functions);
        regressor.check(inputs, output)?;
        Ok(regressor)
    }

    /// Checks lags, powers and input numbers.
    ///
    /// # Errors
    /// [`StructureError::Range`].
    pub fn check(&self, inputs: &[String], output: &str) -> Result<(), StructureError> {
        let text = || self.format(inputs, output);
        for (source, lag) in self.reads() {
            let least = usize::from(source == Source::Output);
            if lag < least || lag > MAX_LAG {
                let expected = format!("{least} to {MAX_LAG} samples");
                return Err(StructureError::Range { text: text(), what: "lag", found: lag, expected });
            }
            if let Source::Input(i) = source
                && i >= inputs.len()
            {
                let expected = format!("below {}", inputs.len());
                return Err(StructureError::Range { text: text(), what: "input number", found: i, expected });
            }
        }
        if self.degree() > MAX_DEGREE {
            let found = self.degree() as usize;
            let expected = format!("at most {MAX_DEGREE}");
            return Err(StructureError::Range { text: text(), what: "degree", found, expected });
        }
        Ok(())
    }
}
