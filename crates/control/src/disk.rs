//! Disk margins: gain and phase of all loops at once.
//!
//! ```text
//! each loop is multiplied by f = (1 + (1-sigma)/2 delta) / (1 - (1+sigma)/2 delta),   |delta| < alpha
//! sigma = 0 balanced (S - T),  1: S,  -1: T
//! 1 / alpha = max over frequency of mu(M)
//! outputs: M = (I + G C)^-1 + (sigma-1)/2 I          inputs: M = (I + C G)^-1 + (sigma-1)/2 I
//! both:    M = [ -T_i  -S_i C ; G S_i  -T_o ] + (1+sigma)/2 I
//! ```
//!
//! The upper bound of mu guarantees `alpha`, on the frequencies that were looked at; the lower bound has a perturbation that
//! destabilises at `alpha_lost`.
//!
//! P. Seiler, A. Packard, P. Gahinet, An introduction to disk margins, IEEE Control Systems 40 (2020) 78-95.

use serde::{Deserialize, Serialize};

use crate::closed::{Closed, Responses};
use crate::error::ControlError;
use crate::margin::{Side, peak};
use crate::matrix::{C, Matrix, ONE};
use crate::mu;

/// Frequencies at which the upper bound is made best after the balance: those that can still be the peak.
const REFINED: usize = 60;

/// Where perturbations act.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Place {
    /// All inputs of the plant at once.
    Inputs,
    /// All outputs at once.
    Outputs,
    /// All inputs and outputs at once.
    Both,
}

/// A disk margin.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DiskMargin {
    /// Skew sigma.
    pub skew: f64,
    /// Radius of the disk that is guaranteed.
    pub alpha: f64,
    /// Frequency of the peak, rad/s.
    pub peak_rad_s: f64,
    /// Radius at which a perturbation that was found makes the loop unstable.
    pub alpha_lost: f64,
    /// Frequency of that perturbation, rad/s.
    pub lost_rad_s: f64,
    /// The perturbation delta of each place there: real and imaginary part.
    pub perturbation: Vec<(f64, f64)>,
    /// Guaranteed: every gain may fall to this factor.
    pub gain_down: f64,
    /// Guaranteed: every gain may grow to this factor; none: any.
    pub gain_up: Option<f64>,
    /// Guaranteed: every phase may move by that much, in deg.
    pub phase_deg: f64,
    /// Frequencies that were looked at.
    pub frequencies: usize,
}

/// Disk margin of loop `k` alone, the others closed.
///
/// # Errors
/// As of [`disk`].
pub fn of_loop(closed: &Closed, side: Side, k: usize, skew: f64) -> Result<DiskMargin, ControlError> {
    margin(closed, skew, &|r: &Responses| {
        let s = match side {
            Side::Inputs => r.at_inputs.at(k, k),
            Side::Outputs => r.at_outputs.at(k, k),
        };
        Matrix { rows: 1, cols: 1, data: vec![s + (skew - 1.0) / 2.0] }
    })
}

/// Disk margin of all loops at once.
///
/// ```
/// use dynocal_control::closed::Closed;
/// use dynocal_control::disk::{Place, disk};
/// use dynocal_control::system::{System, Time, Transfer};
/// let l = Transfer::continuous(&[25.0], &[1.0, 10.0, 10.0, 10.0], 0.0);
/// let plant = System::single(Time::Continuous, l)?;
/// let loop_ = Closed::new(plant, System::single(Time::Continuous, Transfer::gain(1.0))?)?;
/// let found = disk(&loop_, Place::Outputs, 0.0)?;
/// // Seiler, Packard, Gahinet: 0.46, gains from 0.63 to 1.59.
/// assert!((found.alpha - 0.458).abs() < 1e-3 && (found.gain_down - 0.627).abs() < 1e-3);
/// # Ok::<(), dynocal_control::error::ControlError>(())
/// ```
///
/// # Errors
/// [`ControlError::Unstable`] for a loop that is not stable, [`ControlError::Number`] for a skew outside of -1 to 1.
pub fn disk(closed: &Closed, place: Place, skew: f64) -> Result<DiskMargin, ControlError> {
    margin(closed, skew, &|r: &Responses| matrix(r, place, skew))
}

/// M of a place.
pub fn matrix(r: &Responses, place: Place, skew: f64) -> Matrix {
    let shifted = |s: &Matrix| s.sum(ONE, &Matrix::identity(s.rows), C::new((skew - 1.0) / 2.0, 0.0));
    match place {
        Place::Inputs => shifted(&r.at_inputs),
        Place::Outputs => shifted(&r.at_outputs),
        Place::Both => both(r, (1.0 + skew) / 2.0),
    }
}

fn both(r: &Responses, shift: f64) -> Matrix {
    let (m, p) = (r.at_inputs.rows, r.at_outputs.rows);
    let sc = r.at_inputs.times(&r.controller);
    let gs = r.plant.times(&r.at_inputs);
    let mut out = Matrix::zeros(m + p, m + p);
    for i in 0..m + p {
        for j in 0..m + p {
            // -T = S - I.
            let unit = if i == j { ONE } else { C::new(0.0, 0.0) };
            *out.at_mut(i, j) = match (i < m, j < m) {
                (true, true) => r.at_inputs.at(i, j) - unit,
                (true, false) => -sc.at(i, j - m),
                (false, true) => gs.at(i - m, j),
                (false, false) => r.at_outputs.at(i - m, j - m) - unit,
            } + unit * shift;
        }
    }
    out
}

fn margin(closed: &Closed, skew: f64, of: &dyn Fn(&Responses) -> Matrix) -> Result<DiskMargin, ControlError> {
    if !(-1.0..=1.0).contains(&skew) {
        return Err(ControlError::number("the skew of a disk margin", skew, "a number from -1 to 1"));
    }
    let state = closed.unstable();
    if !state.is_stable() {
        return Err(ControlError::Unstable { what: "the closed loop".into(), poles: state.words() });
    }
    let at = |w: f64| closed.at(w).map(|r| of(&r));
    let grid = &closed.grid;
    let matrices: Vec<Matrix> = closed.responses()?.iter().map(of).collect();
    let quick: Vec<f64> = matrices.iter().map(mu::upper_quick).collect();
    // The balance is an upper bound itself: once it is below the best of those made better, nothing else can be the peak.
    let mut order: Vec<usize> = (0..grid.len()).collect();
    order.sort_by(|a, b| quick[*b].total_cmp(&quick[*a]));
    let mut values = quick.clone();
    let mut best = 0.0f64;
    for k in order.into_iter().take(REFINED) {
        if quick[k] <= best {
            break;
        }
        values[k] = mu::upper(&matrices[k]);
        best = best.max(values[k]);
    }
    let upper = |w: f64| at(w).map_or(f64::NAN, |m| mu::upper(&m));
    let (peak_rad_s, peak_value) = peak(grid, &values, &upper);
    let found = at(peak_rad_s).map(|m| mu::lower(&m))?;
    Ok(described(skew, peak_value, peak_rad_s, &found, grid.len()))
}

fn described(skew: f64, peak: f64, peak_rad_s: f64, lost: &mu::Lower, frequencies: usize) -> DiskMargin {
    let alpha = 1.0 / peak;
    let (gain_down, gain_up) = gains(alpha, skew);
    DiskMargin {
        skew,
        alpha,
        peak_rad_s,
        alpha_lost: 1.0 / lost.value,
        lost_rad_s: peak_rad_s,
        perturbation: lost.perturbation.iter().map(|v| (v.re, v.im)).collect(),
        gain_down,
        gain_up,
        phase_deg: phase_deg(gain_down, gain_up),
        frequencies,
    }
}

/// Least and greatest gain of a disk of radius alpha; none: any.
pub fn gains(alpha: f64, skew: f64) -> (f64, Option<f64>) {
    let down = (2.0 - alpha * (1.0 - skew)) / (2.0 + alpha * (1.0 + skew));
    let below = 2.0 - alpha * (1.0 + skew);
    (down, (below > 0.0).then(|| (2.0 + alpha * (1.0 - skew)) / below))
}

/// Phase of that disk in deg: where its edge has size 1.
fn phase_deg(down: f64, up: Option<f64>) -> f64 {
    let cosine = match up {
        Some(up) => (1.0 + down * up) / (down + up),
        None => down,
    };
    cosine.clamp(-1.0, 1.0).acos().to_degrees()
}
