//! Regressors: products of lagged inputs and outputs, and their text form.

use dynocal_numerics::registry::nearest;

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

/// A product of factors; no factor is the constant regressor `1`.
///
/// Factors are kept sorted and merged, so that equal products compare equal.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Regressor {
    factors: Vec<Factor>,
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
        Self { factors: Vec::new() }
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
        Self { factors: merged }
    }

    /// `input_i(t - lag)`.
    pub fn input(i: usize, lag: usize) -> Self {
        Self { factors: vec![Factor { source: Source::Input(i), lag, power: 1 }] }
    }

    /// `output(t - lag)`.
    pub fn output(lag: usize) -> Self {
        Self { factors: vec![Factor { source: Source::Output, lag, power: 1 }] }
    }

    /// The product of two regressors.
    pub fn times(&self, other: &Self) -> Self {
        Self::new(self.factors.iter().chain(&other.factors).copied().collect())
    }

    /// Factors, sorted: inputs by number, then lag; the output last.
    pub fn factors(&self) -> &[Factor] {
        &self.factors
    }

    /// Sum of the powers.
    pub fn degree(&self) -> u32 {
        self.factors.iter().map(|f| f.power).sum()
    }

    /// Whether a factor reads the output.
    pub fn reads_output(&self) -> bool {
        self.factors.iter().any(|f| f.source == Source::Output)
    }

    /// Text form with the user's channel names, e.g. `inj(t-1)*spark(t-3)^2`, `speed(t)`, `1`.
    pub fn format(&self, inputs: &[String], output: &str) -> String {
        if self.factors.is_empty() {
            return "1".into();
        }
        let parts: Vec<String> = self
            .factors
            .iter()
            .map(|f| {
                let name = match f.source {
                    Source::Input(i) => inputs.get(i).map_or("?", String::as_str),
                    Source::Output => output,
                };
                let lag = if f.lag == 0 { String::new() } else { format!("-{}", f.lag) };
                let power = if f.power == 1 { String::new() } else { format!("^{}", f.power) };
                format!("{name}(t{lag}){power}")
            })
            .collect();
        parts.join("*")
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
        let factors: Result<Vec<Factor>, StructureError> =
            trimmed.split('*').map(|part| parse_factor(part.trim(), trimmed, inputs, output)).collect();
        let regressor = Self::new(factors?);
        regressor.check(inputs, output)?;
        Ok(regressor)
    }

    /// Checks lags, powers and input numbers.
    ///
    /// # Errors
    /// [`StructureError::Range`].
    pub fn check(&self, inputs: &[String], output: &str) -> Result<(), StructureError> {
        let text = || self.format(inputs, output);
        for f in &self.factors {
            let least = usize::from(f.source == Source::Output);
            if f.lag < least || f.lag > MAX_LAG {
                let expected = format!("{least} to {MAX_LAG} samples");
                return Err(StructureError::Range { text: text(), what: "lag", found: f.lag, expected });
            }
            if let Source::Input(i) = f.source
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

/// `name(t-lag)^power`.
fn parse_factor(part: &str, text: &str, inputs: &[String], output: &str) -> Result<Factor, StructureError> {
    let syntax =
        |found: &str, expected| StructureError::Syntax { text: text.into(), found: found.into(), expected };
    let open = part.find('(').ok_or_else(|| syntax(part, "`name(t-lag)` or `name(t-lag)^power`"))?;
    let close = part.find(')').filter(|c| *c > open).ok_or_else(|| syntax(part, "a closing `)`"))?;
    let (name, delay, rest) = (part[..open].trim(), part[open + 1..close].trim(), part[close + 1..].trim());
    let source = match inputs.iter().position(|n| n == name) {
        Some(i) => Source::Input(i),
        None if name == output => Source::Output,
        None => {
            let known: Vec<String> = inputs.iter().cloned().chain([output.to_string()]).collect();
            let nearest = nearest(name, &known);
            return Err(StructureError::UnknownChannel {
                text: text.into(),
                found: name.into(),
                nearest,
                known,
            });
        }
    };
    let delay = delay.strip_prefix('t').ok_or_else(|| syntax(delay, "`t` or `t-lag`"))?.trim();
    let lag = match delay.strip_prefix('-') {
        Some(digits) => digits.trim().parse().map_err(|_| syntax(digits, "a lag in samples"))?,
        None if delay.is_empty() => 0,
        None => return Err(syntax(delay, "`t` or `t-lag`")),
    };
    let power = match rest.strip_prefix('^') {
        Some(digits) => digits
            .trim()
            .parse()
            .ok()
            .filter(|p| (1..=MAX_DEGREE).contains(p))
            .ok_or_else(|| syntax(digits, "a power from 1 to 12"))?,
        None if rest.is_empty() => 1,
        None => return Err(syntax(rest, "`^power` or `*`")),
    };
    Ok(Factor { source, lag, power })
}
