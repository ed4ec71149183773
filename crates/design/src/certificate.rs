//! A bound that no record within the limits can pass, for D-designs of polynomial models.
//!
//! For N rows s(t) that count, prior information P and any positive definite G (p x p), concavity of ln det and the
//! inequality of arithmetic and geometric means give
//!
//! ```text
//! ln det M <= ln det G + p ln( tr(G^-1 M) / p ),    tr(G^-1 M) <= tr(G^-1 P) + N / sigma^2 max_x phi(x)' G^-1 phi(x)
//! ```
//!
//! with the maximum over all regressor windows x (Kiefer & Wolfowitz, The equivalence of two extremum problems, 1960).
//! It is sharp at the D-optimal design measure over the windows, which is sought by multiplicative updates (Silvey,
//! Titterington & Torsney 1978) with windows added where the variance is largest. The maximum is taken over a finite
//! set that majorises the continuous one (module `windows`), so that the bound holds up to rounding whether or not
//! the measure is optimal.
//!
//! Past outputs with constant coefficients, `s(t) = phi(t) + sum_j a_j s(t-j)`, make `S = F Phi` with the
//! triangular Toeplitz matrix F of 1 / (1 - sum a_j q^-j). Because an orthonormal basis of p columns sees at most the p
//! largest eigenvalues of F'F,
//!
//! ```text
//! ln det S'S <= ln det Phi'Phi + sum_{i <= p} ln lambda_i(F'F)
//! ```
//!
//! What the bound leaves out: that neighbouring windows share samples, rates, holds, and the output limits but for the
//! range of past outputs. The efficiency stated is therefore one that the record reaches at least.

mod measure;
mod windows;

use crate::problem::{Convention, DesignProblem, Term};
use dynocal_ident::model::form::Form;
use dynocal_ident::model::poly::{PolyNarx, Source};
use dynocal_numerics::linalg::symmetric_eigenvalues;
use windows::Windows;

/// An upper bound on the information of any record, and how near a record comes.
#[derive(Clone, Debug, PartialEq)]
pub struct Certificate {
    /// No record within the limits has a J_D = -ln det M below this.
    pub bound: f64,
    /// J_D of the record.
    pub value: f64,
    /// D-efficiency that the record reaches at least: `exp((bound - value) / p)`.
    pub efficiency: f64,
    /// Part of the bound that the past outputs take: `sum ln lambda_i(F'F)`.
    pub feedback: f64,
    /// Windows over which the maximum was taken.
    pub windows: usize,
    /// By how much the bound could still fall with a better measure over the same windows.
    pub slack: f64,
}

/// There is no bound for this problem.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NoCertificate {
    /// Not a design of one model under the criterion `d`.
    #[error("an optimality certificate is for the criterion `d` of one model, found {found}")]
    Criterion {
        /// What was found.
        found: String,
    },
    /// Not a polynomial model.
    #[error("{term}: an optimality certificate is for polynomial models")]
    Model {
        /// Name of the term.
        term: String,
    },
    /// A regressor that the bound does not cover.
    #[error("no optimality certificate: regressor `{regressor}` {what}")]
    Regressor {
        /// Its text.
        regressor: String,
        /// What is wrong with it.
        what: &'static str,
    },
    /// The recursion may amplify without bound.
    #[error(
        "no optimality certificate: the coefficients of the past outputs sum to {sum} in size, expected below 1"
    )]
    Feedback {
        /// Sum of their absolute values.
        sum: f64,
    },
    /// Too many windows to look at all of them.
    #[error("no optimality certificate: {samples} samples per window make {windows:e} windows")]
    Windows {
        /// Samples of a window.
        samples: usize,
        /// Windows.
        windows: f64,
    },
}

/// Records up to this length get the eigenvalues of their feedback, longer ones a bound of them.
const EIGENVALUES: usize = 400;

/// Bounds J_D over all records that `problem` admits, beside the value of one of them (J_D of
/// [`crate::search::DesignOutcome::value`]).
///
/// # Errors
/// [`NoCertificate`] where the criterion, the model or the size of its windows leaves no bound.
///
/// ```
/// use dynocal_design::certificate::certify;
/// use dynocal_design::channel::Channel;
/// use dynocal_design::criterion::criterion;
/// use dynocal_design::problem::{Convention, DesignProblem, Term};
/// use dynocal_ident::model::poly::PolyNarx;
///
/// // Three taps of one input within +-10: no record of 97 rows beats orthogonal columns of tens, M = 9700 I.
/// let fir = PolyNarx::parse(&["u"], "y", &["u(t-1)", "u(t-2)", "u(t-3)"]).unwrap();
/// let d = criterion("d", &Default::default()).unwrap();
/// let problem = DesignProblem {
///     channels: vec![Channel::free("u", -10.0, 10.0)],
///     n_samples: 100,
///     convention: Convention::Trim,
///     start: 3,
///     terms: vec![Term::new("y", &fir, &[1.0, 0.5, 0.2], 1.0, d.as_ref())],
/// };
/// let found = certify(&problem, -3.0 * 9600f64.ln()).unwrap();
/// assert!((found.bound + 3.0 * 9700f64.ln()).abs() < 1e-9);
/// assert!((found.efficiency - 96.0 / 97.0).abs() < 1e-9);
/// ```
pub fn certify(problem: &DesignProblem, value: f64) -> Result<Certificate, NoCertificate> {
    let term = the_term(problem)?;
    let form: &dyn Form = term.model;
    let Some(model) = form.polynomial() else {
        return Err(NoCertificate::Model { term: term.name.into() });
    };
    let inputs = ranges(problem);
    let feedback = coefficients(model, term.theta);
    let output = output_range(model, term, &inputs, &feedback)?;
    let windows = Windows::new(model, &inputs, output)?;
    let rows =
        problem.n_samples - if problem.convention == Convention::Trim { problem.padding().1 } else { 0 };
    let p = model.regressors().len();
    let amplified = amplification(&feedback, rows, p);
    // Prior information is not amplified: then the largest eigenvalue takes the place of the p largest.
    let (gain, share) = if term.prior.is_empty() {
        (1.0, amplified.iter().map(|l| l.ln()).sum())
    } else {
        (amplified.first().copied().unwrap_or(1.0), 0.0)
    };
    let mut prior = vec![0.0; p * p];
    crate::kernel::gram_add(term.prior, p, &mut prior);
    crate::kernel::mirror(&mut prior, p);
    prior.iter_mut().for_each(|v| *v /= term.noise_variance);
    let found = measure::largest_log_det(&windows, p, gain * rows as f64 / term.noise_variance, &prior);
    let bound = -(found.log_det + share);
    Ok(Certificate {
        bound,
        value,
        efficiency: ((bound - value) / p as f64).exp(),
        feedback: if term.prior.is_empty() { share } else { p as f64 * gain.ln() },
        windows: windows.size() as usize,
        slack: found.slack,
    })
}

fn the_term<'t, 'a>(problem: &'t DesignProblem<'a>) -> Result<&'t Term<'a>, NoCertificate> {
    let mut with = problem.terms.iter().filter(|t| t.criterion.is_some());
    match (with.next(), with.next()) {
        (Some(t), None) if t.criterion.is_some_and(|c| c.is_log_det()) => Ok(t),
        (Some(t), None) => Err(NoCertificate::Criterion { found: format!("another one for {}", t.name) }),
        (Some(_), Some(_)) => Err(NoCertificate::Criterion { found: "several models".into() }),
        (None, _) => Err(NoCertificate::Criterion { found: "none".into() }),
    }
}

/// Ranges of the channels, with what stands before the record.
fn ranges(problem: &DesignProblem) -> Vec<(f64, f64)> {
    let zero = problem.convention == Convention::Zero;
    let of = |c: &crate::channel::Channel| match zero {
        true => (c.lower.min(0.0), c.upper.max(0.0)),
        false => (c.lower, c.upper),
    };
    problem.channels.iter().map(of).collect()
}

/// (lag, coefficient) of the past outputs.
fn coefficients(model: &PolyNarx, theta: &[f64]) -> Vec<(usize, f64)> {
    let of = |r: &dynocal_ident::model::poly::Regressor| {
        r.factors().iter().find(|f| f.source == Source::Output).map(|f| f.lag)
    };
    model.regressors().iter().zip(theta).filter_map(|(r, th)| of(r).map(|lag| (lag, *th))).collect()
}

/// A range that every past output stays in: with e(t) the part without past outputs, `|y - c| <= r` carries over
/// from sample to sample for `c = mid(e) / (1 - sum a)` and `r >= half(e) / (1 - sum |a|)`.
fn output_range(
    model: &PolyNarx,
    term: &Term,
    inputs: &[(f64, f64)],
    feedback: &[(usize, f64)],
) -> Result<(f64, f64), NoCertificate> {
    if feedback.is_empty() {
        return Ok((0.0, 0.0));
    }
    let sum: f64 = feedback.iter().map(|(_, a)| a.abs()).sum();
    if sum.is_nan() || sum >= 1.0 {
        return Err(NoCertificate::Feedback { sum });
    }
    // With outputs at zero, theta' phi is the part without them.
    let windows = Windows::new(model, inputs, (0.0, 0.0))?;
    let (low, high) = measure::range(&windows, term.theta);
    let centre = 0.5 * (low + high) / (1.0 - feedback.iter().map(|(_, a)| a).sum::<f64>());
    let radius = (0.5 * (high - low) / (1.0 - sum)).max((term.initial_output - centre).abs());
    let mut range = (centre - radius, centre + radius);
    if let Some(l) = term.limits {
        // A record within its limits keeps its outputs there; the initial ones are what they are.
        let room = 1e-6 * (l.upper - l.lower);
        range.0 = range.0.max(l.lower + l.margin - room).min(term.initial_output);
        range.1 = range.1.min(l.upper - l.margin + room).max(term.initial_output);
    }
    Ok(range)
}

/// The p largest eigenvalues of F'F for `rows` rows, in falling order.
fn amplification(feedback: &[(usize, f64)], rows: usize, p: usize) -> Vec<f64> {
    if feedback.is_empty() {
        return vec![1.0; p];
    }
    let sum: f64 = feedback.iter().map(|(_, a)| a.abs()).sum();
    let all = || vec![(1.0 - sum).powi(-2); p];
    if rows > EIGENVALUES || rows < p {
        return all();
    }
    // F = C^-1 with ones on the diagonal of C and -a_j below it: the reciprocal of the least eigenvalues of C C'.
    let mut c = vec![0.0; rows * rows];
    for t in 0..rows {
        c[t * rows + t] = 1.0;
        for (lag, a) in feedback.iter().filter(|(lag, _)| *lag <= t) {
            c[t * rows + t - lag] -= a;
        }
    }
    let mut product = vec![0.0; rows * rows];
    for i in 0..rows {
        for j in 0..=i {
            let v = crate::kernel::dot(&c[i * rows..(i + 1) * rows], &c[j * rows..(j + 1) * rows]);
            (product[i * rows + j], product[j * rows + i]) = (v, v);
        }
    }
    match symmetric_eigenvalues(&product, rows) {
        Ok(mut e) => {
            e.sort_by(f64::total_cmp);
            e[..p].iter().map(|v| 1.0 / v).collect()
        }
        Err(_) => all(),
    }
}
