//! MSE: mean squared error of the predictions of a model that leaves terms out.

use super::{Criterion, Information, Scratch, scaled_moments};
use crate::kernel::{axpy, cholesky, dot};
use dynocal_numerics::registry::{self, Member, MemberDoc, ParamDoc};
use serde::Deserialize;

/// The model of the design has its last q parameters in doubt: the model that will be identified leaves them out, and
/// what they do then falls on the others. With the moments of record and objective signal in blocks (1: kept, 2: left out),
///
/// ```text
/// J = (1/N0) [ sigma^2 tr(M11^-1 W11) + sum_j k_j b_j ]
/// b_j = g_j' W11 g_j - 2 g_j' w12_j + w22_jj,    g_j = M11^-1 m12_j
/// k_j = lack sigma^2 N0 / (q r_j),               r_j = w22_jj - w12_j' W11^-1 w12_j
/// ```
///
/// the mean over the objective signal of variance and squared bias (G. E. P. Box and N. R. Draper, J. Am. Stat. Assoc. 54
/// (1959) 622-654). The terms left out are independent, of mean zero, and what the kept ones cannot follow of them over the
/// objective signal is together `lack` times the noise variance, shared equally; the bias is then at least
/// `lack sigma^2`, which a record whose moments are those of the objective signal reaches. A design for variance alone goes to
/// the ends of the box, where a model that is too simple errs most. With no term left out it is V.
#[derive(Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(super) struct Mse {
    left_out: usize,
    lack: f64,
}

impl Default for Mse {
    fn default() -> Self {
        Self { left_out: 0, lack: 1.0 }
    }
}

/// Its row in the table.
pub(super) const MEMBER: Member<dyn Criterion> = Member {
    doc: MemberDoc {
        name: "mse",
        what: "mean squared error of the predicted output when the last terms will be left out of the model",
        params: &[
            ParamDoc {
                name: "left_out",
                unit: "parameters",
                default: "0",
                what: "number of last parameters that the identified model leaves out",
            },
            ParamDoc {
                name: "lack",
                unit: "-",
                default: "1",
                what: "mean square of what they do over the objective signal, as a multiple of the noise variance",
            },
        ],
    },
    build: |keys| {
        let mse: Mse = registry::keys("criterion mse", keys)?;
        if !(mse.lack.is_finite() && mse.lack >= 0.0) {
            return Err(registry::BuildError::Keys {
                member: "criterion mse".into(),
                message: format!("found lack = {}, expected 0 or more", mse.lack),
            });
        }
        Ok(Box::new(mse))
    },
};

/// Least share of a term left out that the kept ones cannot follow: below it the term is one of them.
const LEAST_REST: f64 = 1e-9;

/// `r_j` of the terms from `kept` on, into `rest`, from the scaled moments `w` (p x p). False where W11 is singular: the
/// objective signal does not see all kept parameters.
fn rests(w: &[f64], p: usize, kept: usize, square: &mut [f64], factor: &mut [f64], rest: &mut [f64]) -> bool {
    for i in 0..kept {
        square[i * kept..(i + 1) * kept].copy_from_slice(&w[i * p..i * p + kept]);
    }
    // NaN is no pivot either.
    let regular = cholesky(&square[..kept * kept], kept, &mut factor[..kept * kept]) > 0.0;
    for (j, r) in (kept..p).zip(rest.iter_mut()) {
        // Forward substitution by rows; the solution overwrites the head of `square`, which has been factored.
        let mut followed = 0.0;
        for i in 0..kept {
            let known = dot(&factor[i * kept..i * kept + i], &square[..i]);
            square[i] = (w[i * p + j] - known) / factor[i * kept + i];
            followed += square[i] * square[i];
        }
        *r = (w[j * p + j] - followed).max(LEAST_REST * w[j * p + j]);
    }
    regular
}

/// `out = L11^-T x` or `L11^-1 x` from the inverse of the whole factor, whose leading block is the inverse of L11.
fn back(inverse: &[f64], p: usize, x: &[f64], out: &mut [f64]) {
    out.fill(0.0);
    for (i, v) in x.iter().enumerate() {
        axpy(*v, &inverse[i * p..=i * p + i], &mut out[..=i]);
    }
}

fn ahead(inverse: &[f64], p: usize, x: &[f64], out: &mut [f64]) {
    for (i, o) in out.iter_mut().enumerate() {
        *o = dot(&inverse[i * p..=i * p + i], &x[..=i]);
    }
}

impl Mse {
    /// Value, and into `bar` (p x p) where given the gradient. Moments and products use `work`.
    fn evaluate(&self, info: &Information, work: &mut Scratch, mut bar: Option<&mut [f64]>) -> f64 {
        let Some(m) = info.objective else { return f64::INFINITY };
        let (p, n0) = (info.p, (m.s0.len() / info.p) as f64);
        if self.left_out >= p {
            return f64::INFINITY;
        }
        let kept = p - self.left_out;
        let (sigma2, inverse) = (info.noise_variance, info.factor_inverse);
        let Scratch { rows, a: w, b: product, c: solved, v } = work;
        scaled_moments(&m.gram, info.scale, w);
        if let Some(bar) = bar.as_deref_mut() {
            bar.fill(0.0);
        }
        // Variance: columns of X = A11^-1 W11, whose trace it is; its gradient is -sigma^2 X A11^-1.
        let (half, rest) = rows.split_at_mut(p);
        let (g, rest) = rest.split_at_mut(p);
        let (h, rest_of) = rest.split_at_mut(p);
        if !rests(w, p, kept, product, solved, &mut rest_of[..self.left_out]) {
            return f64::INFINITY;
        }
        let mut value = 0.0;
        for i in 0..kept {
            ahead(inverse, p, &w[i * p..i * p + kept], &mut half[..kept]);
            back(inverse, p, &half[..kept], &mut solved[i * p..i * p + kept]);
            value += sigma2 * solved[i * p + i];
        }
        if let Some(bar) = bar.as_deref_mut() {
            // `solved` row i is A11^-1 W11[:, i], so its columns are rows of W11 A11^-1.
            for j in 0..kept {
                (0..kept).for_each(|i| v[i] = solved[i * p + j]);
                ahead(inverse, p, &v[..kept], &mut half[..kept]);
                back(inverse, p, &half[..kept], &mut product[..kept]);
                axpy(-sigma2, &product[..kept], &mut bar[j * p..j * p + kept]);
            }
        }
        // Squared bias of every term left out.
        for j in kept..p {
            let doubt = self.lack * sigma2 * n0 / (self.left_out as f64 * rest_of[j - kept]);
            back(inverse, p, &info.factor[j * p..j * p + kept], &mut g[..kept]);
            for i in 0..kept {
                v[i] = dot(&w[i * p..i * p + kept], &g[..kept]) - w[i * p + j];
            }
            let cross: f64 = (0..kept).map(|i| g[i] * w[i * p + j]).sum();
            value += doubt * (dot(&g[..kept], &v[..kept]) - cross + w[j * p + j]);
            if let Some(bar) = bar.as_deref_mut() {
                ahead(inverse, p, &v[..kept], &mut half[..kept]);
                back(inverse, p, &half[..kept], &mut h[..kept]);
                for i in 0..kept {
                    axpy(-doubt * h[i], &g[..kept], &mut bar[i * p..i * p + kept]);
                    axpy(-doubt * g[i], &h[..kept], &mut bar[i * p..i * p + kept]);
                    bar[i * p + j] += doubt * h[i];
                    bar[j * p + i] += doubt * h[i];
                }
            }
        }
        if let Some(bar) = bar {
            bar.iter_mut().for_each(|b| *b /= n0);
        }
        value / n0
    }
}

impl Criterion for Mse {
    fn needs_objective_signal(&self) -> bool {
        true
    }

    fn value(&self, info: &Information, work: &mut Scratch) -> f64 {
        work.rows.resize(work.rows.len().max(4 * info.p), 0.0);
        self.evaluate(info, work, None)
    }

    fn value_gradient(&self, info: &Information, _: f64, work: &mut Scratch, gram_bar: &mut [f64]) -> f64 {
        work.rows.resize(work.rows.len().max(4 * info.p), 0.0);
        self.evaluate(info, work, Some(gram_bar))
    }
}
