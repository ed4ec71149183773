//! Which point next.
//!
//! ```text
//! spread            v(x)                                            the least known place
//! integrated        mean over the region of c(x, r)^2 / (v(x) + noise(x))      what one measurement at x takes off the
//!                                                                   variance everywhere; c the covariance of f(x), f(r)
//! improvement       s [u Phi(u) + phi(u)],  u = (best - m(x)) / s   expected improvement of a minimum
//! feasible          prod_k Phi((limit_k - m_k(x)) / s_k)            limits that hold with a stated probability
//! ```
//!
//! A batch is chosen one by one: each chosen point is taken in with the value that is expected there (the mean), which leaves
//! the mean and lowers the variance around it.
//!
//! Sources: D. A. Cohn, Neural network exploration using optimal experiment design, Neural Networks 9 (1996) (integrated
//! variance); D. R. Jones, M. Schonlau, W. J. Welch, Efficient global optimization of expensive black-box functions, J. Global
//! Optim. 13 (1998); D. Ginsbourger, R. Le Riche, L. Carraro, Kriging is well-suited to parallelize optimization (2010)
//! (kriging believer).

use rayon::prelude::*;
use statrs::distribution::{Continuous, ContinuousCDF, Normal};

use super::gp::GpModel;
use super::{Ask, Prediction, Response};

/// What the next point is to serve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Aim {
    /// The place where the response is known least.
    Spread,
    /// Least mean variance over the reference points.
    IntegratedVariance,
    /// A lower minimum than the best so far.
    Minimum {
        /// The best value so far.
        best: f64,
    },
}

/// An upper limit of another output, known by a model of its own.
#[derive(Clone, Copy)]
pub struct Limit<'a> {
    /// Model of the limited output.
    pub model: &'a GpModel,
    /// Its upper limit.
    pub upper: f64,
}

/// A point that was chosen.
#[derive(Clone, Debug, PartialEq)]
pub struct Chosen {
    /// Place in the list of candidates.
    pub candidate: usize,
    /// Value of the aim there, in its own unit.
    pub value: f64,
    /// Probability that all limits hold there (1 without limits).
    pub probability: f64,
}

/// Chooses `count` of the candidates (row by row), one after the other. `reference` are the points over which a variance is
/// integrated (row by row). Candidates whose limits hold with less than `probability` are left out; where none is left, fewer
/// points are given.
pub fn next_points(
    model: &GpModel,
    aim: Aim,
    candidates: &[f64],
    reference: &[f64],
    limits: &[Limit<'_>],
    probability: f64,
    count: usize,
) -> Vec<Chosen> {
    let d = model.dim();
    let rows: Vec<&[f64]> = candidates.chunks_exact(d).collect();
    let safe: Vec<f64> = rows
        .par_iter()
        .map_init(|| Prediction::new(d), |at, x| limits.iter().map(|l| holds(l, x, at)).product())
        .collect();
    let mut believer = model.clone();
    let mut chosen: Vec<Chosen> = Vec::new();
    while chosen.len() < count {
        let values: Vec<f64> = rows
            .par_iter()
            .map_init(|| Prediction::new(d), |at, x| value(&believer, aim, x, reference, at))
            .collect();
        let open = |i: &usize| safe[*i] >= probability && chosen.iter().all(|c| c.candidate != *i);
        let Some(best) =
            (0..rows.len()).filter(open).max_by(|a, b| values[*a].total_cmp(&values[*b]).then(b.cmp(a)))
        else {
            break;
        };
        chosen.push(Chosen { candidate: best, value: values[best], probability: safe[best] });
        if chosen.len() < count {
            let mut at = Prediction::new(d);
            believer.predict(rows[best], Ask::Mean, &mut at);
            // What the model expects lies in the range of its transform.
            if believer.add(rows[best], at.mean).is_err() {
                break;
            }
        }
    }
    chosen
}

/// Probability that the limit holds at x, of the response itself.
fn holds(limit: &Limit<'_>, x: &[f64], at: &mut Prediction) -> f64 {
    limit.model.predict(x, Ask::Variance, at);
    let std = at.variance.sqrt();
    if std > 0.0 {
        normal().cdf((limit.upper - at.mean) / std)
    } else {
        f64::from(u8::from(at.mean <= limit.upper))
    }
}

fn value(model: &GpModel, aim: Aim, x: &[f64], reference: &[f64], at: &mut Prediction) -> f64 {
    model.predict(x, Ask::Variance, at);
    match aim {
        Aim::Spread => at.variance,
        Aim::IntegratedVariance => {
            let own = at.variance + at.noise;
            model.covariances(x, reference).iter().map(|c| c * c / own).sum::<f64>()
                / (reference.len() / x.len()).max(1) as f64
        }
        Aim::Minimum { best } => expected_improvement(best, at.mean, at.variance.sqrt()),
    }
}

/// `E max(best - f, 0)` for f ~ N(mean, std^2).
///
/// ```
/// use dynocal_ident::model::response::sequential::expected_improvement;
/// // At the mean: std / sqrt(2 pi).
/// assert!((expected_improvement(1.0, 1.0, 2.0) - 0.797_884_560_802_865).abs() < 1e-12);
/// assert_eq!(expected_improvement(1.0, 0.25, 0.0), 0.75);
/// ```
pub fn expected_improvement(best: f64, mean: f64, std: f64) -> f64 {
    if std <= 0.0 {
        return (best - mean).max(0.0);
    }
    let u = (best - mean) / std;
    std * (u * normal().cdf(u) + normal().pdf(u))
}

fn normal() -> Normal {
    Normal::standard()
}
