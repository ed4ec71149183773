//! Fisher information of a model over a record, and what it says about the parameters.

use crate::kernel;
use dynocal_ident::model::{Model, Run};
use dynocal_numerics::status::Status;

/// Relative singular value (columns of unit norm) below which a combination of parameters counts as unseen.
const RANK_TOLERANCE: f64 = 1e-11;

/// What happens before the first sample, and from which sample the information counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Convention {
    /// Nothing is assumed: the first max-lag outputs are given, sensitivities and sums begin after them.
    #[default]
    Trim,
    /// The inputs stood at their first values; all samples count.
    Hold,
    /// The inputs were zero; all samples count.
    Zero,
}

/// The model's output or sensitivities are not finite over the record.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the model diverges over the record: its output or a sensitivity is not finite")]
pub struct Diverged;

/// Raw output sensitivities dy/dtheta (rows x p) of the samples of `u` (N x m) that count under `convention`.
///
/// `start` is the first sample that counts under [`Convention::Trim`], and at least the model's longest lag; with
/// the other conventions that many rows are put before the record and all samples count.
///
/// # Errors
/// [`Diverged`].
pub fn sensitivities(
    model: &dyn Model,
    theta: &[f64],
    u: &[f64],
    m: usize,
    convention: Convention,
    start: usize,
    initial_output: f64,
) -> Result<Vec<f64>, Diverged> {
    simulate(model, theta, u, m, convention, start, initial_output).map(|(_, s)| s)
}

/// Free run (rows that count) and [`sensitivities`].
///
/// # Errors
/// [`Diverged`].
pub fn simulate(
    model: &dyn Model,
    theta: &[f64],
    u: &[f64],
    m: usize,
    convention: Convention,
    start: usize,
    initial_output: f64,
) -> Result<(Vec<f64>, Vec<f64>), Diverged> {
    let start = start.max(model.max_lag());
    let padded: Vec<f64> = match convention {
        Convention::Trim => u.to_vec(),
        Convention::Hold => u[..m].iter().copied().cycle().take(start * m).chain(u.iter().copied()).collect(),
        Convention::Zero => std::iter::repeat_n(0.0, start * m).chain(u.iter().copied()).collect(),
    };
    let (n, p) = (padded.len() / m, model.n_params());
    if n <= start {
        return Ok((Vec::new(), Vec::new()));
    }
    let initial = vec![initial_output; n];
    let (mut y, mut s) = (vec![0.0; n], vec![0.0; n * p]);
    let run = Run { u: &padded, y: &initial, start };
    match model.sensitivities(theta, &run, &mut y, &mut s) {
        Status::Converged => Ok((y.split_off(start), s.split_off(start * p))),
        _ => Err(Diverged),
    }
}

/// What a record tells about the parameters.
#[derive(Clone, Debug)]
pub enum Report {
    /// Every parameter can be estimated.
    Regular(Regular),
    /// Some combination of parameters leaves no trace in the output: no criterion has a value.
    Singular(Singular),
}

/// A regular information matrix.
#[derive(Clone, Debug)]
pub struct Regular {
    /// Lower bounds of the standard deviations of the parameters (p), in raw units: `sqrt((M^-1)_kk)`.
    pub crlb_std: Vec<f64>,
    /// Eigenvalues (p, ascending) of `C^-1 M C^-1` with the reference scales.
    pub scaled_eigenvalues: Vec<f64>,
    /// Lower triangular factor L = R' (p x p) of the column-scaled sensitivities.
    pub factor: Vec<f64>,
    /// Column scales (p).
    pub scale: Vec<f64>,
}

/// A singular information matrix.
#[derive(Clone, Debug)]
pub struct Singular {
    /// Numerical rank.
    pub rank: usize,
    /// Number of parameters.
    pub p: usize,
    /// One entry per direction that cannot be seen: parameters with their shares (of the norm-scaled column), the
    /// largest first, shares below 1 % left out.
    pub unseen: Vec<Vec<ParameterShare>>,
}

/// What a parameter has to do with a direction that cannot be seen. Files hold it as `[parameter, share]`.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
#[serde(into = "(String, f64)")]
pub struct ParameterShare {
    /// Name of the parameter.
    pub parameter: String,
    /// Its component in the direction of unit length, columns scaled to unit norm.
    pub share: f64,
}

impl From<ParameterShare> for (String, f64) {
    fn from(p: ParameterShare) -> Self {
        (p.parameter, p.share)
    }
}

impl std::fmt::Display for ParameterShare {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:+.2} {}", self.share, self.parameter)
    }
}

impl std::fmt::Display for Singular {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "singular: rank {} of {}; not seen:", self.rank, self.p)?;
        for (i, d) in self.unseen.iter().enumerate() {
            let terms: Vec<String> = d.iter().take(6).map(ToString::to_string).collect();
            let dots = if d.len() > 6 { " ..." } else { "" };
            write!(f, "{} {}{dots}", if i > 0 { ";" } else { "" }, terms.join(" "))?;
        }
        Ok(())
    }
}

/// Information report of raw sensitivities `s` (rows x p) of `model` with noise variance sigma^2.
///
/// `reference_scale` (p, or empty for ones) sets the scales of the eigenvalues only; the rank is taken with columns
/// of unit norm, so that it does not depend on units.
///
/// ```
/// use dynocal_design::information::{Report, report};
/// # let model = dynocal_ident::model::literature::torque_4_17().model;
/// // Two equal rows of one-parameter-at-a-time information: everything else is unseen.
/// let p = dynocal_ident::model::Model::n_params(&model);
/// let mut s = vec![0.0; 2 * p];
/// s[0] = 1.0;
/// s[p] = 1.0;
/// let Report::Singular(found) = report(&model, &s, 1.0, &[]) else { panic!("must be singular") };
/// assert_eq!(found.rank, 1);
/// ```
pub fn report(model: &dyn Model, s: &[f64], noise_variance: f64, reference_scale: &[f64]) -> Report {
    let p = model.n_params();
    let rows = s.len() / p;
    let norms: Vec<f64> =
        (0..p).map(|k| s.chunks_exact(p).map(|r| r[k] * r[k]).sum::<f64>().sqrt()).collect();
    // A column of zeros keeps scale 1 and shows as a zero singular value.
    let scale: Vec<f64> = norms.iter().map(|n| if *n > 0.0 { *n } else { 1.0 }).collect();
    let mut tall = vec![0.0; rows * p];
    for (t, row) in s.chunks_exact(p).enumerate() {
        for k in 0..p {
            tall[k * rows + t] = row[k] / scale[k];
        }
    }
    let square = || vec![0.0; p * p];
    let (mut factor, mut work, mut v, mut sigma) = (square(), square(), square(), vec![0.0; p]);
    kernel::qr_factor(&mut tall, rows, p, &mut factor);
    kernel::svd(&factor, p, &mut work, &mut sigma, &mut v);
    let floor = RANK_TOLERANCE * sigma[0];
    let rank = sigma.iter().filter(|s| **s > floor).count();
    if rank < p {
        let unseen = (rank..p).map(|k| direction(model, &v[k * p..(k + 1) * p])).collect();
        return Report::Singular(Singular { rank, p, unseen });
    }
    let mut inverse = square();
    kernel::invert_lower(&factor, p, &mut inverse);
    let crlb_std = (0..p)
        .map(|k| {
            let column2: f64 = (k..p).map(|i| inverse[i * p + k].powi(2)).sum();
            (noise_variance * column2).sqrt() / scale[k]
        })
        .collect();
    for i in 0..p {
        let d = scale[i] / reference_scale.get(i).copied().unwrap_or(1.0);
        for j in 0..p {
            work[i * p + j] = factor[i * p + j] * d;
        }
    }
    kernel::svd(&work.clone(), p, &mut work, &mut sigma, &mut v);
    let scaled_eigenvalues = sigma.iter().rev().map(|s| s * s / noise_variance).collect();
    Report::Regular(Regular { crlb_std, scaled_eigenvalues, factor, scale })
}

fn direction(model: &dyn Model, v: &[f64]) -> Vec<ParameterShare> {
    let mut d: Vec<ParameterShare> = v
        .iter()
        .enumerate()
        .filter(|(_, c)| c.abs() > 0.01)
        .map(|(k, c)| ParameterShare { parameter: model.param_name(k), share: *c })
        .collect();
    d.sort_by(|a, b| b.share.abs().total_cmp(&a.share.abs()));
    d
}
