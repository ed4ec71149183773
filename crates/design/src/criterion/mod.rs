//! Optimality criteria: the contract and its table.
//!
//! With raw output sensitivities S (N x p), positive numbers d (p) and noise variance sigma^2,
//!
//! ```text
//! M = S'S / sigma^2                      Fisher information (thesis eq. 4.23)
//! A = D^-1 S'S D^-1 = L L',  D = diag(d) equilibrated Gram matrix, L = R' of S D^-1 = Q R
//! M^-1 = sigma^2 D^-1 A^-1 D^-1          bound of the parameter covariance
//! ```
//!
//! A criterion is a scalar J(M) that is minimised. It returns its exact gradient dJ/dA; the chain rule to the
//! sensitivities is the same for all of them, `dJ/dS = 2 S D^-1 (dJ/dA) D^-1`, and is applied once by the caller.
//! Every value is that of the raw parameters and does not depend on d.
//!
//! To add a criterion: one file with the implementation and its `MEMBER`, one `mod` line and one row here.

use dynocal_numerics::registry::{self, BuildError, Member};

mod a;
mod ai;
mod d;
mod e;
mod g;
mod i;
mod mse;
mod v;
mod wa;

/// What a criterion sees of a design: the information through triangular factors of the column-scaled
/// sensitivities, never through an inverse of a badly scaled matrix.
#[derive(Clone, Copy, Debug)]
pub struct Information<'a> {
    /// Number of parameters p.
    pub p: usize,
    /// Lower triangular factor L = R' (p x p row-major), `A = L L'`.
    pub factor: &'a [f64],
    /// L^-1 (p x p row-major, lower triangular).
    pub factor_inverse: &'a [f64],
    /// A^-1 (p x p row-major, symmetric).
    pub inverse: &'a [f64],
    /// Column scales d (p): raw sensitivity = scaled times d.
    pub scale: &'a [f64],
    /// The user's reference scales c (p), in which parameters count alike; only criterion `e` depends on them.
    pub reference_scale: &'a [f64],
    /// Noise variance sigma^2.
    pub noise_variance: f64,
    /// Moments of the objective signal U0, where there is one.
    pub objective: Option<&'a Moments>,
}

/// Output sensitivities of the objective signal U0 and their moments, formed once per problem.
#[derive(Clone, Debug)]
pub struct Moments {
    /// Raw sensitivities S0 (N0 x p row-major), rows that count only.
    pub s0: Vec<f64>,
    /// S0'S0 (p x p).
    pub gram: Vec<f64>,
}

impl Moments {
    /// Moments of the raw sensitivities `s0` (N0 x p row-major).
    pub fn new(s0: Vec<f64>, p: usize) -> Self {
        let mut gram = vec![0.0; p * p];
        crate::kernel::gram_add(&s0, p, &mut gram);
        crate::kernel::mirror(&mut gram, p);
        Self { s0, gram }
    }
}

/// Work space of one criterion, grown on first use and then reused.
#[derive(Clone, Debug, Default)]
pub struct Scratch {
    /// Rows (N0 x p, at least p x p).
    pub rows: Vec<f64>,
    /// First square matrix (p x p).
    pub a: Vec<f64>,
    /// Second square matrix (p x p).
    pub b: Vec<f64>,
    /// Third square matrix (p x p).
    pub c: Vec<f64>,
    /// One number per row of the objective signal or per parameter.
    pub v: Vec<f64>,
}

impl Scratch {
    /// Makes room for p parameters and an objective signal of `n0` rows.
    pub fn fit(&mut self, p: usize, n0: usize) {
        self.rows.resize(n0.max(p) * p, 0.0);
        for m in [&mut self.a, &mut self.b, &mut self.c] {
            m.resize(p * p, 0.0);
        }
        self.v.resize(n0.max(p), 0.0);
    }
}

/// The pieces of a maximum or an extreme eigenvalue that are nearly as large as the worst; the derivative of each in A
/// has rank one, `dJ_k/dA = -factor z_k z_k'`.
#[derive(Clone, Debug)]
pub struct Active {
    /// Value of the worst piece, J.
    pub worst: f64,
    /// Directions z_k (p each), the worst first.
    pub directions: Vec<Vec<f64>>,
    /// Factor of the derivative.
    pub factor: f64,
    /// Whether pieces mix, `-factor sum_ij Z_ij z_i z_j'` with Z >= 0 of trace one, as those of an eigenvalue do.
    pub spectral: bool,
}

/// An optimality criterion: a scalar of the information that is minimised, with its exact gradient.
pub trait Criterion: Send + Sync {
    /// Whether it needs an objective signal U0 ([`Information::objective`]).
    fn needs_objective_signal(&self) -> bool {
        false
    }

    /// Whether J > 0 always; the search then works on ln J, which is better scaled.
    fn is_positive(&self) -> bool {
        true
    }

    /// Whether J is a maximum or an extreme eigenvalue, which the search approaches through p-norms of rising
    /// order.
    fn is_extreme(&self) -> bool {
        false
    }

    /// Whether J is -ln det M, for which an upper bound of all designs can be computed
    /// ([`crate::certificate::certify`]).
    fn is_log_det(&self) -> bool {
        false
    }

    /// For a criterion that [`Criterion::is_extreme`]: its pieces of at least `1 - band` of the worst.
    fn active(&self, _info: &Information, _band: f64, _work: &mut Scratch) -> Option<Active> {
        None
    }

    /// Exact value J. Infinite where a needed objective signal is missing.
    fn value(&self, info: &Information, work: &mut Scratch) -> f64;

    /// Value and dJ/dA (p x p symmetric) of J, or, where [`Criterion::is_extreme`], of its p-norm of order
    /// `sharpness`, which is never below J.
    fn value_gradient(
        &self,
        info: &Information,
        sharpness: f64,
        work: &mut Scratch,
        gram_bar: &mut [f64],
    ) -> f64;
}

/// All criteria.
pub static CRITERIA: &[Member<dyn Criterion>] =
    &[d::MEMBER, a::MEMBER, wa::MEMBER, e::MEMBER, g::MEMBER, i::MEMBER, v::MEMBER, ai::MEMBER, mse::MEMBER];

/// Builds the criterion `name` from the keys of a spec.
///
/// # Errors
/// [`BuildError`] with the nearest known name.
///
/// ```
/// let d = dynocal_design::criterion::criterion("d", &Default::default()).unwrap();
/// assert!(!d.needs_objective_signal());
/// assert!(dynocal_design::criterion::criterion("z", &Default::default()).is_err());
/// ```
pub fn criterion(name: &str, keys: &toml::Table) -> Result<Box<dyn Criterion>, BuildError> {
    registry::build("criterion", CRITERIA, name, keys)
}

/// Refuses keys of a criterion that has none.
fn no_keys<T: Criterion + Default + 'static>(
    name: &str,
    keys: &toml::Table,
) -> Result<Box<dyn Criterion>, BuildError> {
    match keys.keys().next() {
        None => Ok(Box::new(T::default())),
        Some(k) => Err(BuildError::Keys {
            member: format!("criterion {name}"),
            message: format!("unknown key `{k}`; this criterion has no keys"),
        }),
    }
}

/// `sigma^2 sum_k w_k (A^-1)_kk` of a diagonal weight.
fn weighted_trace(info: &Information, weight: impl Fn(usize) -> f64) -> f64 {
    let p = info.p;
    (0..p).map(|k| weight(k) * info.inverse[k * p + k]).sum::<f64>() * info.noise_variance
}

/// Value and gradient of [`weighted_trace`]: `dJ/dA = -sigma^2 A^-1 W A^-1`, formed as a Gram matrix of the rows
/// `sqrt(w_k) A^-1[k, :]`, which is half the work of two products. Weights must not be negative.
fn weighted_trace_gradient(
    info: &Information,
    weight: impl Fn(usize) -> f64,
    work: &mut Scratch,
    gram_bar: &mut [f64],
) -> f64 {
    let p = info.p;
    let rows = &mut work.rows[..p * p];
    let mut trace = 0.0;
    for k in 0..p {
        let w = weight(k);
        let root = w.sqrt();
        trace += w * info.inverse[k * p + k];
        for (r, v) in rows[k * p..(k + 1) * p].iter_mut().zip(&info.inverse[k * p..(k + 1) * p]) {
            *r = root * v;
        }
    }
    gram_bar.fill(0.0);
    crate::kernel::gram_add(rows, p, gram_bar);
    crate::kernel::mirror(gram_bar, p);
    gram_bar.iter_mut().for_each(|g| *g *= -info.noise_variance);
    trace * info.noise_variance
}

/// `D^-1 W D^-1` of the raw moment matrix W.
fn scaled_moments(gram: &[f64], scale: &[f64], out: &mut [f64]) {
    let p = scale.len();
    for i in 0..p {
        for j in 0..p {
            out[i * p + j] = gram[i * p + j] / (scale[i] * scale[j]);
        }
    }
}

/// `gram_bar = -factor A^-1 W A^-1` for a full symmetric W.
fn sandwich(info: &Information, w: &[f64], factor: f64, product: &mut [f64], gram_bar: &mut [f64]) {
    crate::kernel::multiply(w, info.inverse, info.p, product);
    crate::kernel::multiply(info.inverse, product, info.p, gram_bar);
    gram_bar.iter_mut().for_each(|g| *g *= -factor);
}
