//! A: sum of the parameter variances.

use super::{Criterion, Information, Scratch, no_keys, weighted_trace, weighted_trace_gradient};
use dynocal_numerics::registry::{Member, MemberDoc};

/// `J_A = tr M^-1 = sigma^2 sum_k (A^-1)_kk / d_k^2`, in the raw units of the parameters.
#[derive(Default)]
pub(super) struct A;

/// Its row in the table.
pub(super) const MEMBER: Member<dyn Criterion> = Member {
    doc: MemberDoc {
        name: "a",
        what: "A-optimal: tr M^-1, the sum of the parameter variances in raw units: it mixes units, so that the largest number wins",
        params: &[],
    },
    build: |keys| no_keys::<A>("a", keys),
};

impl Criterion for A {
    fn value(&self, info: &Information, _: &mut Scratch) -> f64 {
        weighted_trace(info, |k| info.scale[k].powi(-2))
    }

    fn value_gradient(&self, info: &Information, _: f64, work: &mut Scratch, gram_bar: &mut [f64]) -> f64 {
        weighted_trace_gradient(info, |k| info.scale[k].powi(-2), work, gram_bar)
    }
}
