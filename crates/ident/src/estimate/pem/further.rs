//! Further starts for a search that began far from its end: a consistent start needs few steps, and many steps are the
//! sign of a start that may have led to a local minimum.
//!
//! ```text
//! eps = D/C (A y - sum B_i/F_i u_i)     for given C, D, F: linear in A and B
//! ```
//!
//! C, D and F_i are drawn with random stable roots, or kept from the first search; A and B follow by least squares.

use dynocal_numerics::linalg::least_squares;
use dynocal_numerics::lm::LeastSquares;
use dynocal_numerics::rng::Rng64;

use super::problem::PredictionError;
use crate::model::linear::filter::multiply;
use crate::model::linear::{LinearModel, Polynomials};

/// Evaluations above which a first search is doubted.
pub(super) const DOUBTFUL: usize = 10;
/// Most and least further starts; long records get fewer.
const MOST: usize = 64;
const LEAST: usize = 4;
/// Samples times starts.
const EFFORT: usize = 1 << 15;

/// Start points beside `found`, each with its A and B of least squares.
pub(super) fn starts(problem: &mut PredictionError, model: &LinearModel, found: &[f64]) -> Vec<Vec<f64>> {
    let p = model.n_params();
    let most = if problem.has_unknowns() { LEAST } else { MOST };
    let count = (EFFORT / problem.rows.max(1)).clamp(LEAST, most);
    let (mut r, mut jac) = (vec![0.0; problem.rows], vec![0.0; problem.rows * p]);
    let mut out = Vec::with_capacity(count);
    for k in 0..count {
        let mut rng = Rng64::stream(0, k as u64);
        let mut q = model.polynomials(found);
        let with_f = model.orders.iter().any(|o| o.nf > 0);
        // In turn: all anew, the noise model, the response to one input, those to all inputs.
        if k % 4 < 2 || !with_f {
            q.c = random_stable(model.nc, &mut rng);
            q.d = random_stable(model.nd, &mut rng);
        }
        for (i, (f, o)) in q.f.iter_mut().zip(&model.orders).enumerate() {
            if k % 4 == 0 || k % 4 == 3 || (k % 4 == 2 && i == (k / 4) % model.orders.len()) {
                *f = random_stable(o.nf, &mut rng);
            }
        }
        if let Some(theta) = linear_part(problem, model, &mut q, &mut r, &mut jac) {
            out.push(theta);
        }
    }
    out
}

/// A and B by least squares for the C, D and F of `q`.
fn linear_part(
    problem: &mut PredictionError,
    model: &LinearModel,
    q: &mut Polynomials,
    r: &mut [f64],
    jac: &mut [f64],
) -> Option<Vec<f64>> {
    q.a[1..].fill(0.0);
    q.b.iter_mut().for_each(|b| b.fill(0.0));
    let mut theta = model.parameters(q);
    let free = model.na + model.orders.iter().map(|o| o.nb).sum::<usize>();
    if free == 0 {
        return Some(theta);
    }
    if !problem.residual_jacobian(&theta, r, jac) {
        return None;
    }
    let columns: Vec<f64> =
        jac.chunks_exact(theta.len()).flat_map(|row| row[..free].iter().copied()).collect();
    let solved = least_squares(&columns, r.len(), free, r, 0.0).ok()?;
    theta[..free].iter_mut().zip(solved.x).for_each(|(t, x)| *t = -x);
    Some(theta)
}

/// A monic polynomial with random roots inside the circle of radius 0.97.
fn random_stable(order: usize, rng: &mut Rng64) -> Vec<f64> {
    let mut p = vec![1.0];
    while p.len() <= order {
        let radius = 0.97 * rng.uniform().sqrt();
        let factor = if order + 1 - p.len() >= 2 && rng.uniform() < 0.5 {
            vec![1.0, -2.0 * radius * (std::f64::consts::PI * rng.uniform()).cos(), radius * radius]
        } else {
            vec![1.0, if rng.uniform() < 0.7 { -radius } else { radius }]
        };
        p = multiply(&p, &factor);
    }
    p
}
