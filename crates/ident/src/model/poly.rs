//! Polynomial NARX models.
//!
//! ```text
//! y(t) = sum_k theta_k phi_k(t),   phi_k(t) = prod_i u_i(t-l)^q  prod_j y(t-j)^r
//! ```
//!
//! (thesis eqs. 2.3 and 4.17). Linear in the parameters for one-step prediction, recursive in free run. FIR and
//! ARX models are the members of degree 1. A factor may also be a [`Function`] with fixed numbers of a combination of
//! lagged channels, `tanh(2000*x(t-1) - 2000*x(t-2))`.

mod adjoint;
mod filter;
pub mod function;
mod joint;
pub mod products;
mod program;
pub mod regressor;
mod run;
mod shaped;
pub(super) mod spec;
mod text;

use serde::{Deserialize, Serialize};

pub use function::{Function, Shape};
pub use regressor::{Factor, Regressor, Source, StructureError};

use program::{MAX_OUTPUT_LAGS, Program};

/// A polynomial NARX structure with the user's channel names.
///
/// In JSON and TOML the regressors are text:
///
/// ```
/// use dynocal_ident::model::poly::PolyNarx;
/// use dynocal_ident::model::{Model, Run};
///
/// let model = PolyNarx::parse(&["inj", "spark"], "torque", &["1", "inj(t-1)*spark(t-2)", "torque(t-1)"])?;
/// let text = serde_json::to_string(&model).unwrap();
/// assert_eq!(serde_json::from_str::<PolyNarx>(&text).unwrap(), model);
///
/// let u = [1.0, 2.0, 1.0, 3.0, 2.0, 3.0, 2.0, 3.0]; // 4 samples x 2 inputs
/// let run = Run { u: &u, y: &[0.0; 4], start: model.max_lag() };
/// let mut y = [0.0; 4];
/// model.simulate(&[1.0, 0.5, 0.1], &run, &mut y);
/// // y(2) = 1 + 0.5 inj(1) spark(0) + 0.1 y(1) and y(3) = 1 + 0.5 inj(2) spark(1) + 0.1 y(2)
/// assert_eq!(y, [0.0, 0.0, 2.0, 4.2]);
/// # Ok::<(), dynocal_ident::model::poly::StructureError>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(into = "PolyText", try_from = "PolyText")]
pub struct PolyNarx {
    inputs: Vec<String>,
    output: String,
    regressors: Vec<Regressor>,
    program: Program,
}

/// The stored form.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PolyText {
    inputs: Vec<String>,
    output: String,
    regressors: Vec<String>,
}

impl PartialEq for PolyNarx {
    fn eq(&self, other: &Self) -> bool {
        self.inputs == other.inputs && self.output == other.output && self.regressors == other.regressors
    }
}

impl PolyNarx {
    /// A checked structure.
    ///
    /// # Errors
    /// [`StructureError`]: no regressor, one listed twice, a lag or power out of range, or names that the text
    /// form cannot hold.
    pub fn new(
        inputs: Vec<String>,
        output: String,
        regressors: Vec<Regressor>,
    ) -> Result<Self, StructureError> {
        check_names(&inputs, &output)?;
        if regressors.is_empty() {
            return Err(StructureError::Empty { output });
        }
        for (k, r) in regressors.iter().enumerate() {
            r.check(&inputs, &output)?;
            if let Some(first) = regressors[..k].iter().position(|other| other == r) {
                let text = r.format(&inputs, &output);
                return Err(StructureError::Duplicate { text, first: first + 1, second: k + 1 });
            }
        }
        let program = Program::new(inputs.len(), &regressors);
        if program.output_lags.len() > MAX_OUTPUT_LAGS {
            return Err(StructureError::Range {
                text: format!("{output}(t-..)"),
                what: "number of output lags",
                found: program.output_lags.len(),
                expected: format!("at most {MAX_OUTPUT_LAGS}"),
            });
        }
        Ok(Self { inputs, output, regressors, program })
    }

    /// A structure from regressors in text form.
    ///
    /// # Errors
    /// [`StructureError`] naming the regressor and the part that does not fit.
    pub fn parse<A: AsRef<str>, B: AsRef<str>>(
        inputs: &[A],
        output: &str,
        regressors: &[B],
    ) -> Result<Self, StructureError> {
        let inputs: Vec<String> = inputs.iter().map(|s| s.as_ref().to_string()).collect();
        check_names(&inputs, output)?;
        let regressors: Result<Vec<_>, _> =
            regressors.iter().map(|r| Regressor::parse(r.as_ref(), &inputs, output)).collect();
        Self::new(inputs, output.into(), regressors?)
    }

    /// Linear ARX structure with constant (thesis eq. 2.10):
    /// `1`, `u_i(t-nk) .. u_i(t-nk-nb+1)` for each input, `y(t-1) .. y(t-na)`.
    ///
    /// # Errors
    /// [`StructureError`], e.g. a lag out of range.
    pub fn arx(
        inputs: &[String],
        output: &str,
        na: usize,
        nb: usize,
        nk: usize,
        constant: bool,
    ) -> Result<Self, StructureError> {
        let mut regressors = Vec::new();
        if constant {
            regressors.push(Regressor::constant());
        }
        for i in 0..inputs.len() {
            regressors.extend((nk..nk + nb).map(|lag| Regressor::input(i, lag)));
        }
        regressors.extend((1..=na).map(Regressor::output));
        Self::new(inputs.to_vec(), output.into(), regressors)
    }

    /// Names of the inputs, in the order of the columns of `u`.
    pub fn inputs(&self) -> &[String] {
        &self.inputs
    }

    /// Name of the output.
    pub fn output(&self) -> &str {
        &self.output
    }

    /// Regressors, in the order of the parameters.
    pub fn regressors(&self) -> &[Regressor] {
        &self.regressors
    }

    /// Regressors in text form.
    pub fn regressor_texts(&self) -> Vec<String> {
        self.regressors.iter().map(|r| r.format(&self.inputs, &self.output)).collect()
    }
}

impl From<PolyNarx> for PolyText {
    fn from(m: PolyNarx) -> Self {
        let regressors = m.regressor_texts();
        Self { inputs: m.inputs, output: m.output, regressors }
    }
}

impl TryFrom<PolyText> for PolyNarx {
    type Error = StructureError;

    fn try_from(text: PolyText) -> Result<Self, StructureError> {
        Self::parse(&text.inputs, &text.output, &text.regressors)
    }
}

fn check_names(inputs: &[String], output: &str) -> Result<(), StructureError> {
    let fault = |found: &str, expected| Err(StructureError::Name { found: found.into(), expected });
    for (i, name) in inputs.iter().map(String::as_str).chain([output]).enumerate() {
        if name.is_empty() || name.trim() != name || name.contains(['*', '(', ')', '^']) {
            return fault(name, "a name without `*`, `^`, parentheses and outer blanks");
        }
        if inputs.iter().take(i).any(|other| other == name) {
            return fault(name, "a name that is used once only");
        }
    }
    Ok(())
}
