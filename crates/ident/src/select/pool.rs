//! Candidate pools for structure selection.

use std::collections::BTreeMap;

use dynocal_numerics::registry::{ParamDoc, nearest};
use serde::{Deserialize, Serialize};

use super::SelectError;
use crate::estimate::EstimateError;
use crate::model::poly::regressor::{MAX_DEGREE, MAX_LAG};
use crate::model::poly::{PolyNarx, Regressor};

pub use crate::model::poly::products::{dedup, products};

/// Most candidates of a generated pool: ten lags of three channels at degree five have 324 632.
pub const MAX_CANDIDATES: usize = 1_000_000;

/// Candidate regressors of one output, each once.
#[derive(Clone, Debug, PartialEq)]
pub struct Pool {
    inputs: Vec<String>,
    output: String,
    candidates: Vec<Regressor>,
}

impl Pool {
    /// A checked pool; later copies of a candidate are left out.
    ///
    /// # Errors
    /// [`SelectError`]: no candidate, a lag or power out of range, names that the text form cannot hold.
    pub fn new(inputs: &[String], output: &str, candidates: Vec<Regressor>) -> Result<Self, SelectError> {
        // The constant stands for the candidates in the check of the names: a structure of them all would be slow.
        PolyNarx::new(inputs.to_vec(), output.into(), vec![Regressor::constant()])
            .map_err(EstimateError::from)?;
        if candidates.is_empty() {
            return Err(SelectError::Pool {
                message: format!("no candidate for `{output}`, expected at least one"),
            });
        }
        candidates.iter().try_for_each(|r| r.check(inputs, output)).map_err(EstimateError::from)?;
        Ok(Self { inputs: inputs.to_vec(), output: output.into(), candidates: dedup(candidates) })
    }

    /// Names of the inputs.
    pub fn inputs(&self) -> &[String] {
        &self.inputs
    }

    /// Name of the output.
    pub fn output(&self) -> &str {
        &self.output
    }

    /// The candidates.
    pub fn candidates(&self) -> &[Regressor] {
        &self.candidates
    }

    /// Candidate k as text.
    pub fn text(&self, k: usize) -> String {
        self.candidates[k].format(&self.inputs, &self.output)
    }

    /// Place of the constant, if it is a candidate.
    pub fn constant(&self) -> Option<usize> {
        self.candidates.iter().position(|r| r.degree() == 0)
    }

    /// Longest lag of any candidate.
    pub fn max_lag(&self) -> usize {
        self.candidates.iter().flat_map(|r| r.reads()).map(|(_, lag)| lag).max().unwrap_or(0)
    }

    /// The structure of some candidates, in the order of the pool.
    ///
    /// # Errors
    /// [`SelectError`] when there is none.
    pub fn structure(&self, places: &[usize]) -> Result<PolyNarx, SelectError> {
        let mut places = places.to_vec();
        places.sort_unstable();
        let regressors = places.iter().map(|&k| self.candidates[k].clone()).collect();
        let model = PolyNarx::new(self.inputs.clone(), self.output.clone(), regressors);
        Ok(model.map_err(EstimateError::from)?)
    }
}

impl From<&PolyNarx> for Pool {
    fn from(m: &PolyNarx) -> Self {
        let (inputs, candidates) = (m.inputs().to_vec(), m.regressors().to_vec());
        Self { inputs, output: m.output().into(), candidates }
    }
}

/// One number for every input, or a table from input to number.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum PerInput {
    /// The same for every input.
    All(usize),
    /// Input = number; inputs that are not named take no part (number of lags) or the default 1 (first lag).
    Each(BTreeMap<String, usize>),
}

/// A pool as a spec describes it: lags per channel and highest degree.
///
/// ```
/// use dynocal_ident::select::pool::PoolKeys;
/// let keys: PoolKeys = toml::from_str("ny = 10\nnu = 10\ndegree = 4\ncross = true")?;
/// let pool = keys.pool(&["inj".to_string()], "torque")?;
/// assert_eq!(pool.candidates().len(), 10_626);
/// assert_eq!(pool.text(21), "inj(t-1)^2");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PoolKeys {
    /// Output lags 1 to `ny`.
    pub ny: usize,
    /// Number of lags of each input.
    pub nu: PerInput,
    /// First lag of each input.
    pub nk: PerInput,
    /// Highest degree.
    pub degree: u32,
    /// Whether different lagged channels are multiplied; otherwise powers only.
    pub cross: bool,
    /// Whether the constant is a candidate.
    pub constant: bool,
    /// Further variables as text, multiplied like lagged channels.
    pub variables: Vec<String>,
    /// Further candidates as text.
    pub regressors: Vec<String>,
}

impl Default for PoolKeys {
    fn default() -> Self {
        Self {
            ny: 1,
            nu: PerInput::All(2),
            nk: PerInput::All(1),
            degree: 2,
            cross: true,
            constant: true,
            variables: Vec::new(),
            regressors: Vec::new(),
        }
    }
}

/// Documentation of the keys of a pool.
pub static POOL_KEYS: &[ParamDoc] = &[
    ParamDoc { name: "ny", unit: "samples", default: "1", what: "number of output lags, from 1" },
    ParamDoc {
        name: "nu",
        unit: "samples",
        default: "2",
        what: "number of lags of each input: one number, or a table input = number (inputs that are not named are left out)",
    },
    ParamDoc {
        name: "nk",
        unit: "samples",
        default: "1",
        what: "first lag of each input: one number, or a table input = number",
    },
    ParamDoc { name: "degree", unit: "-", default: "2", what: "highest degree of the products" },
    ParamDoc {
        name: "cross",
        unit: "-",
        default: "true",
        what: "whether different lagged channels are multiplied; otherwise powers only",
    },
    ParamDoc { name: "constant", unit: "-", default: "true", what: "whether the constant is a candidate" },
    ParamDoc {
        name: "variables",
        unit: "-",
        default: "[]",
        what: "further variables as text, multiplied like lagged channels, e.g. `sqrt(level(t-1))`",
    },
    ParamDoc {
        name: "regressors",
        unit: "-",
        default: "[]",
        what: "further candidates as text, e.g. `inj(t-1)*spark(t-3)^2`",
    },
];

impl PoolKeys {
    /// The candidates for these channels: constant, then by degree, inputs before the output.
    ///
    /// # Errors
    /// [`SelectError`]: an unknown input, more than [`MAX_CANDIDATES`] candidates, lags out of range.
    pub fn pool(&self, inputs: &[String], output: &str) -> Result<Pool, SelectError> {
        self.check(inputs)?;
        let mut variables = Vec::new();
        for (i, name) in inputs.iter().enumerate() {
            let first = lookup(&self.nk, name, 1);
            variables.extend((first..first + lookup(&self.nu, name, 0)).map(|lag| Regressor::input(i, lag)));
        }
        variables.extend((1..=self.ny).map(Regressor::output));
        for text in &self.variables {
            variables.push(Regressor::parse(text, inputs, output).map_err(EstimateError::from)?);
        }
        let mut candidates = if self.constant { vec![Regressor::constant()] } else { Vec::new() };
        if self.cross {
            candidates.extend(products(&variables, self.degree));
        } else {
            for d in 1..=self.degree {
                candidates.extend(variables.iter().map(|v| (1..d).fold(v.clone(), |r, _| r.times(v))));
            }
        }
        for text in &self.regressors {
            candidates.push(Regressor::parse(text, inputs, output).map_err(EstimateError::from)?);
        }
        Pool::new(inputs, output, candidates)
    }

    /// Names, lags and size, before anything of that size is built.
    fn check(&self, inputs: &[String]) -> Result<(), SelectError> {
        let fault = |message| Err(SelectError::Pool { message });
        for (key, table) in [("nu", &self.nu), ("nk", &self.nk)] {
            let PerInput::Each(table) = table else { continue };
            if let Some(name) = table.keys().find(|k| !inputs.contains(k)) {
                let hint =
                    nearest(name, inputs).map(|n| format!(" (did you mean `{n}`?)")).unwrap_or_default();
                return fault(format!("{key}: no input `{name}`{hint}; inputs are: {}", inputs.join(", ")));
            }
        }
        let mut variables = self.ny.saturating_add(self.variables.len());
        let mut longest = self.ny;
        for name in inputs {
            let (first, lags) = (lookup(&self.nk, name, 1), lookup(&self.nu, name, 0));
            variables = variables.saturating_add(lags);
            longest = longest.max(first.saturating_add(lags).saturating_sub(1));
        }
        if longest > MAX_LAG {
            return fault(format!("the longest lag is {longest}, expected at most {MAX_LAG} samples"));
        }
        if !(1..=MAX_DEGREE).contains(&self.degree) {
            return fault(format!("degree is {}, expected 1 to {MAX_DEGREE}", self.degree));
        }
        // C(V + d, d), without overflow.
        let degree = u128::from(self.degree);
        let count = if self.cross {
            (1..=degree).fold(1, |c: u128, d| c.saturating_mul(variables as u128 + d) / d)
        } else {
            degree * variables as u128
        };
        if count > MAX_CANDIDATES as u128 {
            return fault(format!(
                "{variables} lagged channels at degree {degree} have {count} products, expected at most \
                 {MAX_CANDIDATES}: take fewer lags, a lower degree, or `cross = false`"
            ));
        }
        Ok(())
    }
}

fn lookup(per: &PerInput, name: &str, otherwise: usize) -> usize {
    match per {
        PerInput::All(n) => *n,
        PerInput::Each(table) => table.get(name).copied().unwrap_or(otherwise),
    }
}

/// What a pool holds, over the inputs of one model.
#[derive(Clone, Debug, Default)]
pub struct PoolSpec {
    /// Lagged inputs (input, lag) whose products of degree 1 and 2 are candidates.
    pub lagged: Vec<(usize, usize)>,
    /// Lagged inputs whose products of degree 3 are candidates as well.
    pub cubic: Vec<(usize, usize)>,
    /// Output lags that enter alone.
    pub output_lags: Vec<usize>,
    /// Lagged inputs that multiply each of these output lags.
    pub output_times: Vec<(usize, usize)>,
}

impl PoolSpec {
    /// The candidates: constant, degree 1 and 2, degree 3 of the chosen ones, output lags alone and multiplied.
    pub fn candidates(&self) -> Vec<Regressor> {
        let inputs = |pairs: &[(usize, usize)]| -> Vec<Regressor> {
            pairs.iter().map(|&(i, lag)| Regressor::input(i, lag)).collect()
        };
        let mut pool = vec![Regressor::constant()];
        pool.extend(products(&inputs(&self.lagged), 2));
        pool.extend(products(&inputs(&self.cubic), 3).into_iter().filter(|r| r.degree() == 3));
        for &lag in &self.output_lags {
            let y = Regressor::output(lag);
            pool.extend(inputs(&self.output_times).iter().map(|r| r.times(&y)));
            pool.push(y);
        }
        dedup(pool)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pool_has_each_candidate_once() {
        let spec = PoolSpec {
            lagged: vec![(0, 1), (0, 2), (1, 1)],
            cubic: vec![(0, 1), (1, 1)],
            output_lags: vec![1, 2],
            output_times: vec![(0, 1)],
        };
        let pool = spec.candidates();
        assert_eq!(pool.len(), 1 + 3 + 6 + 4 + 2 * 2);
        assert_eq!(dedup(pool.clone()), pool);
    }
}
