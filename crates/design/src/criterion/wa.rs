//! WA: the weighted A criterion of a design's own sensitivities.

use super::{Criterion, Information, Scratch, no_keys};
use crate::kernel::{dot, gram_add, mirror};
use dynocal_numerics::registry::{Member, MemberDoc};

/// `J_WA = sum_k (M^-1)_kk ||dY/dtheta_k||^2` (thesis eq. 4.35) `= sigma^2 sum_k (A^-1)_kk A_kk`, at least
/// sigma^2 p, which it reaches for orthogonal sensitivities.
#[derive(Default)]
pub(super) struct Wa;

/// Its row in the table.
pub(super) const MEMBER: Member<dyn Criterion> = Member {
    doc: MemberDoc {
        name: "wa",
        what: "weighted A-optimal (4.35): parameter variances weighted with the sensitivities of the design itself: blind to amplitude",
        params: &[],
    },
    build: |keys| no_keys::<Wa>("wa", keys),
};

/// `A_kk`, the squared norm of row k of L.
fn diagonal(info: &Information, k: usize) -> f64 {
    let row = &info.factor[k * info.p..k * info.p + k + 1];
    dot(row, row)
}

impl Criterion for Wa {
    fn value(&self, info: &Information, _: &mut Scratch) -> f64 {
        let p = info.p;
        (0..p).map(|k| info.inverse[k * p + k] * diagonal(info, k)).sum::<f64>() * info.noise_variance
    }

    /// `dJ/dA = sigma^2 (diag(A^-1) - A^-1 diag(A) A^-1)`.
    fn value_gradient(&self, info: &Information, _: f64, work: &mut Scratch, gram_bar: &mut [f64]) -> f64 {
        let p = info.p;
        let rows = &mut work.rows[..p * p];
        for k in 0..p {
            let root = diagonal(info, k).sqrt();
            for (r, v) in rows[k * p..(k + 1) * p].iter_mut().zip(&info.inverse[k * p..(k + 1) * p]) {
                *r = root * v;
            }
        }
        gram_bar.fill(0.0);
        gram_add(rows, p, gram_bar);
        mirror(gram_bar, p);
        gram_bar.iter_mut().for_each(|g| *g *= -info.noise_variance);
        for k in 0..p {
            gram_bar[k * p + k] += info.noise_variance * info.inverse[k * p + k];
        }
        self.value(info, work)
    }
}
