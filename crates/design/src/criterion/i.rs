//! I: summed variance of the predicted objective output.

use super::{Criterion, Information, Scratch, no_keys, sandwich, scaled_moments};
use crate::kernel::dot;
use dynocal_numerics::registry::{Member, MemberDoc};

/// `J_I = tr(S0 M^-1 S0') = sigma^2 tr(A^-1 W)` with the moment matrix `W = D^-1 S0'S0 D^-1`, which is formed once
/// from the objective signal: the cost does not grow with its length (thesis section 4.8.2).
#[derive(Default)]
pub(super) struct I;

/// Its row in the table.
pub(super) const MEMBER: Member<dyn Criterion> = Member {
    doc: MemberDoc {
        name: "i",
        what: "I-optimal: summed variance of the predicted output over the objective signal",
        params: &[],
    },
    build: |keys| no_keys::<I>("i", keys),
};

impl Criterion for I {
    fn needs_objective_signal(&self) -> bool {
        true
    }

    fn value(&self, info: &Information, work: &mut Scratch) -> f64 {
        let Some(m) = info.objective else { return f64::INFINITY };
        scaled_moments(&m.gram, info.scale, &mut work.a);
        dot(info.inverse, &work.a) * info.noise_variance
    }

    fn value_gradient(&self, info: &Information, _: f64, work: &mut Scratch, gram_bar: &mut [f64]) -> f64 {
        let value = self.value(info, work);
        if value.is_finite() {
            sandwich(info, &work.a, info.noise_variance, &mut work.b, gram_bar);
        }
        value
    }
}
