//! Missing samples (NaN) and unknown initial states of linear models, eliminated for every theta.
//!
//! The prediction errors are linear in what is not known: missing outputs, missing inputs, states before the first
//! sample. With G their columns and eps the errors for a first guess,
//!
//! ```text
//! z = -(G'G)^-1 G' eps,      eps* = eps + G z = (I - G (G'G)^-1 G') eps
//! ```
//!
//! Missing outputs are random: their integral adds `log det(G_y'G_y)` to minus twice the log-likelihood, so that
//!
//! ```text
//! minimise  det(G_y'G_y)^(1/n) |eps*|^2,     n observed outputs
//! ```
//!
//! is maximum likelihood, the same as a Kalman filter that skips the missing samples. Missing inputs and states are
//! parameters.
//!
//! Reference: R. H. Jones, Maximum likelihood fitting of ARMA models to time series with missing observations,
//! Technometrics 22 (1980); A. J. Isaksson, Identification of ARX-models subject to missing data, IEEE Trans. Autom.
//! Control 38 (1993).

use dynocal_numerics::linalg::{axpy, cholesky, dot, invert_upper, solve_upper, solve_upper_transposed};
use serde::{Deserialize, Serialize};

use super::EstimateError;
use crate::data::DataError;
use crate::experiment::Experiment;
use crate::model::linear::{PredictionErrors, Unknown};

/// Most unknowns of one record: their dense matrix is factorised at every step.
pub const MOST_UNKNOWNS: usize = 2000;
/// Responses end where they have fallen below this share of their largest value.
const NEGLIGIBLE: f64 = 1e-13;
/// Damping of the unit-diagonal G'G: unknowns that the errors hardly depend on keep their first guess.
const DAMPING: f64 = 1e-13;

/// Where samples are missing in one record.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Missing {
    /// Samples without output.
    pub outputs: Vec<usize>,
    /// (input, sample) without input.
    pub inputs: Vec<(usize, usize)>,
}

impl Missing {
    /// Places of NaN in the record.
    pub fn of(e: &Experiment) -> Self {
        let m = e.u.len().checked_div(e.len()).unwrap_or(0);
        let places = |v: &[f64]| -> Vec<usize> { (0..v.len()).filter(|&k| v[k].is_nan()).collect() };
        let mut inputs: Vec<(usize, usize)> = places(&e.u).into_iter().map(|k| (k % m, k / m)).collect();
        inputs.sort_unstable();
        Self { outputs: places(&e.y), inputs }
    }

    /// Whether nothing is missing.
    pub fn is_empty(&self) -> bool {
        self.outputs.is_empty() && self.inputs.is_empty()
    }
}

/// A sample that was missing and what the fit says it was.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Recovered {
    /// Number of the record.
    pub record: usize,
    /// Channel name.
    pub channel: String,
    /// Sample.
    pub sample: usize,
    /// Estimate.
    pub value: f64,
    /// Standard error for given parameters.
    #[serde(deserialize_with = "crate::nullable::number")]
    pub std_error: f64,
}

/// The record with straight lines across its gaps (held at the ends), and where they were.
///
/// ```
/// use dynocal_ident::estimate::missing::bridged;
/// use dynocal_ident::experiment::Experiment;
/// let y = vec![1.0, f64::NAN, f64::NAN, 4.0, f64::NAN];
/// let e = Experiment { name: "a".into(), u: vec![0.0; 5], y, init_samples: 0, weights: vec![] };
/// let (whole, missing) = bridged(&e);
/// assert_eq!(whole.y, [1.0, 2.0, 3.0, 4.0, 4.0]);
/// assert_eq!(missing.outputs, [1, 2, 4]);
/// ```
pub fn bridged(e: &Experiment) -> (Experiment, Missing) {
    let missing = Missing::of(e);
    let mut whole = e.clone();
    if !missing.is_empty() {
        bridge(&mut whole.y, 0, 1);
        let m = e.u.len().checked_div(e.len()).unwrap_or(0);
        (0..m).for_each(|i| bridge(&mut whole.u, i, m));
    }
    (whole, missing)
}

/// Fills the gaps of one channel of a row-major table; a channel without any sample stays as it is.
fn bridge(table: &mut [f64], channel: usize, width: usize) {
    let n = table.len() / width;
    let mut last: Option<usize> = None;
    for t in 0..=n {
        let here = (t < n).then(|| table[t * width + channel]);
        if here.is_some_and(f64::is_nan) {
            continue;
        }
        let from = last.map_or(0, |l| l + 1);
        for gap in from..t {
            let before = last.map(|l| table[l * width + channel]);
            table[gap * width + channel] = match (before, here) {
                (Some(a), Some(b)) => {
                    let l = last.unwrap_or(0);
                    a + (b - a) * (gap - l) as f64 / (t - l) as f64
                }
                (Some(a), None) => a,
                (None, Some(b)) => b,
                (None, None) => f64::NAN,
            };
        }
        last = Some(t);
    }
}

/// The unknowns of one record, with their columns at the parameters of the last refresh.
pub(super) struct Unknowns {
    /// What and from which sample; missing outputs that are scored come first.
    places: Vec<(Unknown, usize)>,
    /// How many of them are scored missing outputs.
    scored_outputs: usize,
    /// First scored row.
    first: usize,
    /// First row and entries of each column, weighted.
    columns: Vec<(usize, Vec<f64>)>,
    /// Length of each column; its Gram matrix is taken in these units.
    scale: Vec<f64>,
    /// Cholesky factor of the unit-diagonal G'G.
    factor: Vec<f64>,
    z: Vec<f64>,
}

impl Unknowns {
    /// For a record whose rows from `first` on are scored; `states` are unknown initial states at that row.
    ///
    /// # Errors
    /// [`EstimateError::Missing`] when there are more than [`MOST_UNKNOWNS`]; [`DataError::TooShort`] when a channel has no
    /// sample at all.
    pub(super) fn new(
        e: &Experiment,
        channels: &[String],
        missing: &Missing,
        first: usize,
        mut states: Vec<(Unknown, usize)>,
    ) -> Result<Self, EstimateError> {
        let nothing = |channel: &str| DataError::TooShort {
            record: e.name.clone(),
            found: 0,
            expected: 1,
            why: format!("every sample of `{channel}` is missing"),
        };
        if missing.outputs.len() == e.len() {
            return Err(nothing(&channels[channels.len() - 1]).into());
        }
        for (i, channel) in channels[..channels.len() - 1].iter().enumerate() {
            if missing.inputs.iter().filter(|(k, _)| *k == i).count() == e.len() {
                return Err(nothing(channel).into());
            }
        }
        let (early, scored): (Vec<usize>, Vec<usize>) = missing.outputs.iter().partition(|t| **t < first);
        let scored_outputs = scored.len();
        let mut places: Vec<(Unknown, usize)> = scored.into_iter().map(|t| (Unknown::Output, t)).collect();
        places.extend(missing.inputs.iter().map(|(i, t)| (Unknown::Input(*i), *t)));
        places.extend(early.into_iter().map(|t| (Unknown::Output, t)));
        places.append(&mut states);
        let n = places.len();
        if n > MOST_UNKNOWNS {
            return Err(EstimateError::Missing { record: e.name.clone(), found: n, most: MOST_UNKNOWNS });
        }
        Ok(Self {
            places,
            scored_outputs,
            first,
            columns: vec![(0, Vec::new()); n],
            scale: vec![1.0; n],
            factor: vec![0.0; n * n],
            z: vec![0.0; n],
        })
    }

    pub(super) fn is_empty(&self) -> bool {
        self.places.is_empty()
    }

    /// Number of unknowns that cost a degree of freedom: all but the missing outputs.
    pub(super) fn parameters(&self) -> usize {
        self.places.len() - self.scored_outputs
    }

    /// Columns and factor at the parameters of the last evaluation of `errors`; `false` when they are not finite.
    pub(super) fn refresh(&mut self, errors: &PredictionErrors, e: &Experiment) -> bool {
        let mut known: Vec<(Unknown, Vec<f64>)> = Vec::new();
        for k in 0..self.places.len() {
            let (what, at) = self.places[k];
            let found = known.iter().position(|(w, _)| *w == what).unwrap_or_else(|| {
                known.push((what, shortened(errors.unit_response(what))));
                known.len() - 1
            });
            self.columns[k] = column(&known[found].1, at, self.first, e);
        }
        let n = self.places.len();
        for (s, (_, c)) in self.scale.iter_mut().zip(&self.columns) {
            let size = dot(c, c).sqrt();
            *s = if size > 0.0 { size } else { 1.0 };
        }
        for i in 0..n {
            for j in i..n {
                let product = overlap(&self.columns[i], &self.columns[j]);
                self.factor[i * n + j] = product / (self.scale[i] * self.scale[j]);
            }
            // A column of zeros (an input whose effect comes after the record) keeps its guess.
            self.factor[i * n + i] = 1.0 + DAMPING;
        }
        cholesky(&mut self.factor, n).is_ok()
    }

    /// `v <- (I - G (G'G)^-1 G') v` for column `k` of the row-major `rows`; the coefficients stay in `z`.
    pub(super) fn project(&mut self, rows: &mut [f64], width: usize, k: usize) {
        let (n, end) = (self.places.len(), rows.len());
        for (z, ((first, c), s)) in self.z.iter_mut().zip(self.columns.iter().zip(&self.scale)) {
            let part = rows[(first * width + k).min(end)..].iter().step_by(width);
            *z = c.iter().zip(part).map(|(a, b)| a * b).sum::<f64>() / s;
        }
        let solved = solve_upper_transposed(&self.factor, n, &mut self.z).is_ok()
            && solve_upper(&self.factor, n, &mut self.z).is_ok();
        for (z, ((first, c), s)) in self.z.iter_mut().zip(self.columns.iter().zip(&self.scale)) {
            *z = if solved { -*z / s } else { 0.0 };
            let part = rows[(first * width + k).min(end)..].iter_mut().step_by(width);
            part.zip(c).for_each(|(v, c)| *v += *z * c);
        }
    }

    /// Writes the solution of the last projection into `errors`.
    pub(super) fn apply(&self, errors: &mut PredictionErrors) {
        for ((what, sample), z) in self.places.iter().zip(&self.z) {
            if z.is_finite() {
                errors.add(*what, *sample, *z);
            }
        }
    }

    /// `log det(G_y'G_y)` of the scored missing outputs.
    pub(super) fn log_det(&self) -> f64 {
        let n = self.places.len();
        2.0 * (0..self.scored_outputs).map(|i| (self.factor[i * n + i] * self.scale[i]).ln()).sum::<f64>()
    }

    /// Adds the gradient of [`Unknowns::log_det`] to `gradient` (p).
    pub(super) fn add_log_det_gradient(
        &self,
        errors: &PredictionErrors,
        e: &Experiment,
        gradient: &mut [f64],
    ) {
        let (n, k) = (self.places.len(), self.scored_outputs);
        if k == 0 {
            return;
        }
        let r: Vec<f64> = (0..k).flat_map(|i| self.factor[i * n..i * n + k].iter().copied()).collect();
        let mut inverse = vec![0.0; k * k];
        if invert_upper(&r, k, &mut inverse).is_err() {
            return;
        }
        for (parameter, response) in errors.output_response_gradient() {
            let response = shortened(response);
            let mut sum = 0.0;
            for i in 0..k {
                let moved = column(&response, self.places[i].1, self.first, e);
                for j in 0..k {
                    let product = overlap(&moved, &self.columns[j]);
                    if product != 0.0 {
                        let from = i.max(j);
                        let w = dot(&inverse[i * k + from..(i + 1) * k], &inverse[j * k + from..(j + 1) * k]);
                        sum += w * product / (self.scale[i] * self.scale[j]);
                    }
                }
            }
            gradient[parameter] += 2.0 * sum;
        }
    }

    /// Solution of the last projection with standard errors in units of the noise: what, sample, change of the guess,
    /// standard error.
    pub(super) fn solution(&self) -> Vec<(Unknown, usize, f64, f64)> {
        let n = self.places.len();
        let mut inverse = vec![0.0; n * n];
        let sound = invert_upper(&self.factor, n, &mut inverse).is_ok();
        (0..n)
            .map(|i| {
                let variance = dot(&inverse[i * n..(i + 1) * n], &inverse[i * n..(i + 1) * n]);
                let seen = sound && self.columns[i].1.iter().any(|v| *v != 0.0);
                let std = if seen { variance.sqrt() / self.scale[i] } else { f64::NAN };
                (self.places[i].0, self.places[i].1, self.z[i], std)
            })
            .collect()
    }
}

/// A response without its negligible end.
fn shortened(mut response: Vec<f64>) -> Vec<f64> {
    let largest = response.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
    let kept = response.iter().rposition(|v| v.abs() > NEGLIGIBLE * largest).map_or(0, |k| k + 1);
    response.truncate(kept);
    response
}

/// The response that begins at sample `at`: its first scored row and weighted entries.
fn column(response: &[f64], at: usize, first: usize, e: &Experiment) -> (usize, Vec<f64>) {
    let begin = at.max(first);
    let end = (at + response.len()).min(e.len());
    let entries = (begin..end).map(|t| e.weight(t).sqrt() * response[t - at]).collect();
    (begin.min(e.len()), entries)
}

/// Scalar product of two columns.
fn overlap(a: &(usize, Vec<f64>), b: &(usize, Vec<f64>)) -> f64 {
    let from = a.0.max(b.0);
    let to = (a.0 + a.1.len()).min(b.0 + b.1.len());
    if from >= to { 0.0 } else { dot(&a.1[from - a.0..to - a.0], &b.1[from - b.0..to - b.0]) }
}

/// Adds `gain` times the columns: `rows[t] += gain direction[k] rows[t]` for the scale factor of the likelihood.
pub(super) fn scale_rows(r: &mut [f64], jac: &mut [f64], gain: f64, direction: &[f64]) {
    for (row, r) in jac.chunks_exact_mut(direction.len()).zip(r.iter_mut()) {
        row.iter_mut().for_each(|v| *v *= gain);
        *r *= gain;
        axpy(*r, direction, row);
    }
}
