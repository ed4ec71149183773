//! Warped inputs: a model is learnt over w(x), so that what changes fast at small values changes evenly.
//!
//! ```text
//! sqrt    w(x) = sqrt((x + s) / 2),  s = sqrt(x^2 + 4 c^2)     the square root where x is well above c, defined everywhere
//!         w' = w / (2 s),            w'' = w (s - 2 x) / (4 s^3)
//! asinh   w(x) = asinh(x / c),       s = sqrt(x^2 + c^2)       linear below c, the logarithm above it
//!         w' = 1 / s,                w'' = -x / s^3
//! ```
//!
//! A stationary covariance takes it that a response changes as much over a tenth of a range at its lower as at its upper end. An engine
//! does not: what 10 Nm more ask is another thing at 30 than at 150.
//!
//! Source: J. Snoek, K. Swersky, R. Zemel, R. Adams, Input warping for Bayesian optimization of non-stationary functions, Proc. ICML
//! (2014), who estimate the warp; here it is a choice between fixed ones.

use serde::{Deserialize, Serialize};

use super::points::Points;
use super::{Ask, Prediction};

/// Which warp of the inputs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WarpChoice {
    /// None.
    #[default]
    None,
    /// Square root of all inputs that are sizes: positive, and nowhere next to zero.
    Sqrt,
    /// Inverse hyperbolic sine of all inputs, over the size that they have on average.
    Asinh,
}

/// A warp with its numbers.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Stored")]
pub struct Warp {
    /// Which one.
    pub choice: WarpChoice,
    /// c of each input (d), in its unit; 0: this input is taken as it is. Empty without a warp.
    pub scales: Vec<f64>,
}

/// A warp as it is read.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Stored {
    choice: WarpChoice,
    scales: Vec<f64>,
}

impl TryFrom<Stored> for Warp {
    type Error = String;

    fn try_from(Stored { choice, scales }: Stored) -> Result<Self, String> {
        match scales.iter().find(|c| !(c.is_finite() && **c >= 0.0)) {
            Some(c) => Err(format!("found {c} among the scales of a warp, expected 0 or positive numbers")),
            None => Ok(Self { choice, scales }),
        }
    }
}

/// Least share that the smallest of the values of a size has in the largest. What is sampled down to zero (a spark from 0 to 35 deg) is no size: its
/// root would change most where the zero of a scale happens to be.
const SIZE: f64 = 0.05;
/// c of a size as a share of its least value: there w is the square root within half a percent.
const BELOW: f64 = 0.1;

impl Warp {
    /// The warp of points that passed [`Points::check`].
    pub fn of(choice: WarpChoice, points: &Points) -> Self {
        let column = |j: usize| points.column(j);
        let scale = |j: usize| match choice {
            WarpChoice::None => 0.0,
            WarpChoice::Sqrt => {
                let (low, high) =
                    column(j).fold((f64::INFINITY, 0.0f64), |(low, high), x| (low.min(x), high.max(x)));
                if low >= SIZE * high && low > 0.0 { BELOW * low } else { 0.0 }
            }
            // Zero in all points: nothing to warp.
            WarpChoice::Asinh => column(j).map(f64::abs).sum::<f64>() / points.len() as f64,
        };
        let scales: Vec<f64> = (0..points.dim()).map(scale).collect();
        // Without an input that is warped it is none.
        if scales.iter().all(|c| *c == 0.0) { Self::default() } else { Self { choice, scales } }
    }

    /// Whether nothing is changed.
    pub fn is_none(&self) -> bool {
        self.scales.iter().all(|c| *c == 0.0)
    }

    /// Whether there is one scale an input, or no warp at all.
    pub(super) fn fits(&self, d: usize) -> bool {
        self.scales.len() == d || self.scales.is_empty()
    }

    /// w, w' and w'' of input `j` at `x`.
    pub fn at(&self, j: usize, x: f64) -> [f64; 3] {
        let c = self.scales.get(j).copied().unwrap_or(0.0);
        match self.choice {
            _ if c == 0.0 => [x, 1.0, 0.0],
            WarpChoice::None => [x, 1.0, 0.0],
            WarpChoice::Sqrt => {
                let s = x.hypot(2.0 * c);
                // c^2 / w^2 = (s - x) / 2: without a difference of numbers of the same size below zero.
                let w = if x >= 0.0 { (0.5 * (x + s)).sqrt() } else { c / (0.5 * (s - x)).sqrt() };
                [w, w / (2.0 * s), w * (s - 2.0 * x) / (4.0 * s * s * s)]
            }
            WarpChoice::Asinh => {
                let s = x.hypot(c);
                [(x / c).asinh(), 1.0 / s, -x / (s * s * s)]
            }
        }
    }

    /// Slope w' where an input is w.
    pub(super) fn slope_of(&self, j: usize, w: f64) -> f64 {
        let c = self.scales.get(j).copied().unwrap_or(0.0);
        match self.choice {
            _ if c == 0.0 => 1.0,
            WarpChoice::None => 1.0,
            // x = w^2 - c^2 / w^2, s = w^2 + c^2 / w^2.
            WarpChoice::Sqrt => w / (2.0 * (w * w + (c / w).powi(2))),
            WarpChoice::Asinh => 1.0 / (c * w.cosh()),
        }
    }

    /// Turns derivatives over w(x) into derivatives over x.
    ///
    /// ```text
    /// f_j = f_wj w_j',    f_jl = f_wjwl w_j' w_l' + [j = l] f_wj w_j''
    /// ```
    pub fn back(&self, x: &[f64], ask: Ask, at: &mut Prediction) {
        if ask < Ask::Gradient || self.is_none() {
            return;
        }
        let d = x.len();
        for j in 0..d {
            let [_, slope, second] = self.at(j, x[j]);
            if ask == Ask::Hessian {
                for l in 0..d {
                    // Row and column: the entry of the diagonal twice.
                    for place in [j * d + l, l * d + j] {
                        at.hessian[place] *= slope;
                        at.variance_hessian[place] *= slope;
                    }
                }
                at.hessian[j * d + j] += at.gradient[j] * second;
                at.variance_hessian[j * d + j] += at.variance_gradient[j] * second;
            }
            at.gradient[j] *= slope;
            at.variance_gradient[j] *= slope;
        }
    }

    /// Words between the kind of a model and what follows.
    pub(super) fn words(&self) -> &'static str {
        match self.choice {
            _ if self.is_none() => "",
            WarpChoice::None => "",
            WarpChoice::Sqrt => " over the roots of the inputs",
            WarpChoice::Asinh => " over the inverse hyperbolic sines of the inputs",
        }
    }
}
