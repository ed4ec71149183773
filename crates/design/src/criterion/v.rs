//! V: mean variance of the predicted objective output.

use super::i::I;
use super::{Criterion, Information, Scratch, no_keys};
use dynocal_numerics::registry::{Member, MemberDoc};

/// `J_V = J_I / N0`: the mean prediction variance over the N0 points of the objective signal, in squared output
/// units, so that it can be compared with sigma^2.
#[derive(Default)]
pub(super) struct V;

/// Its row in the table.
pub(super) const MEMBER: Member<dyn Criterion> = Member {
    doc: MemberDoc {
        name: "v",
        what: "V-optimal: mean variance of the predicted output over the objective signal (I divided by its length)",
        params: &[],
    },
    build: |keys| no_keys::<V>("v", keys),
};

fn points(info: &Information) -> f64 {
    info.objective.map_or(1.0, |m| (m.s0.len() / info.p) as f64)
}

impl Criterion for V {
    fn needs_objective_signal(&self) -> bool {
        true
    }

    fn value(&self, info: &Information, work: &mut Scratch) -> f64 {
        I.value(info, work) / points(info)
    }

    fn value_gradient(&self, info: &Information, q: f64, work: &mut Scratch, gram_bar: &mut [f64]) -> f64 {
        let value = I.value_gradient(info, q, work, gram_bar);
        let n = points(info);
        gram_bar.iter_mut().for_each(|g| *g /= n);
        value / n
    }
}
