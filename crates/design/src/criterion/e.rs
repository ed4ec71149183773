//! E: the direction in parameter space that is seen worst.

use super::{Criterion, Information, Scratch, no_keys};
use crate::kernel::{gram_add, mirror, svd};
use dynocal_numerics::registry::{Member, MemberDoc};

/// `J_E = 1 / lambda_min(C^-1 M C^-1)` with the reference scales C = diag(c): the variance of the parameter
/// combination that is seen worst, in scaled parameters. The search uses the p-norm over the eigenvalues,
///
/// ```text
/// J_q = (sum_k mu_k^q)^(1/q),   mu_k = 1 / lambda_k
/// ```
#[derive(Default)]
pub(super) struct E;

/// Its row in the table.
pub(super) const MEMBER: Member<dyn Criterion> = Member {
    doc: MemberDoc {
        name: "e",
        what: "E-optimal: largest variance of any unit combination of the scaled parameters, 1 / lambda_min",
        params: &[],
    },
    build: |keys| no_keys::<E>("e", keys),
};

/// Eigenvalues mu_k = 1 / lambda_k (ascending) to `work.v`, eigenvectors to the rows of `work.b`.
fn spectrum(info: &Information, work: &mut Scratch) {
    let p = info.p;
    for i in 0..p {
        let d = info.scale[i] / info.reference_scale[i];
        for j in 0..p {
            work.a[i * p + j] = info.factor[i * p + j] * d;
        }
    }
    svd(&work.a, p, &mut work.c, &mut work.v[..p], &mut work.b);
    for s in &mut work.v[..p] {
        *s = info.noise_variance / (*s * *s);
    }
}

impl Criterion for E {
    fn is_extreme(&self) -> bool {
        true
    }

    fn value(&self, info: &Information, work: &mut Scratch) -> f64 {
        spectrum(info, work);
        work.v[info.p - 1]
    }

    /// `dJ_q/dA_c = -sum_k (mu_k / J_q)^(q-1) mu_k^2 / sigma^2 e_k e_k'`, then from the reference to the used scales.
    fn value_gradient(&self, info: &Information, q: f64, work: &mut Scratch, gram_bar: &mut [f64]) -> f64 {
        let p = info.p;
        spectrum(info, work);
        let worst = work.v[p - 1];
        let norm = worst * work.v[..p].iter().map(|m| (m / worst).powf(q)).sum::<f64>().powf(1.0 / q);
        for k in 0..p {
            let mu = work.v[k];
            let root = (mu / norm).powf(0.5 * (q - 1.0)) * mu / info.noise_variance.sqrt();
            for j in 0..p {
                work.rows[k * p + j] = root * work.b[k * p + j] * info.scale[j] / info.reference_scale[j];
            }
        }
        gram_bar.fill(0.0);
        gram_add(&work.rows[..p * p], p, gram_bar);
        mirror(gram_bar, p);
        gram_bar.iter_mut().for_each(|g| *g = -*g);
        norm
    }
}
