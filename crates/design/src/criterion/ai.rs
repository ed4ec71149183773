//! AI: the adapted I-optimal criterion.

use super::{Criterion, Information, Scratch, no_keys, weighted_trace, weighted_trace_gradient};
use dynocal_numerics::registry::{Member, MemberDoc};

/// `J_AI = sum_k (M^-1)_kk ||dY0/dtheta_k||^2` (thesis eq. 4.50): parameter variances weighted with the squared
/// norms of the output sensitivities of the objective signal.
#[derive(Default)]
pub(super) struct Ai;

/// Its row in the table.
pub(super) const MEMBER: Member<dyn Criterion> = Member {
    doc: MemberDoc {
        name: "ai",
        what: "adapted I-optimal (4.50): parameter variances weighted with the sensitivities of the objective signal: it neglects the correlation of the parameters, which i has",
        params: &[],
    },
    build: |keys| no_keys::<Ai>("ai", keys),
};

impl Criterion for Ai {
    fn needs_objective_signal(&self) -> bool {
        true
    }

    fn value(&self, info: &Information, _: &mut Scratch) -> f64 {
        let Some(m) = info.objective else { return f64::INFINITY };
        weighted_trace(info, |k| m.gram[k * info.p + k] / info.scale[k].powi(2))
    }

    fn value_gradient(&self, info: &Information, _: f64, work: &mut Scratch, gram_bar: &mut [f64]) -> f64 {
        let Some(m) = info.objective else { return f64::INFINITY };
        weighted_trace_gradient(info, |k| m.gram[k * info.p + k] / info.scale[k].powi(2), work, gram_bar)
    }
}
