//! Sequential quadratic programming.

use super::{Chain, Search, bounded, no_keys};
use dynocal_numerics::optim::SequentialQuadratic;
use dynocal_numerics::registry::{Member, MemberDoc};

/// The thesis' SQP (section 4.3): quadratic programs with a damped BFGS Hessian on the box (Nocedal & Wright 2006,
/// chapter 18); rates and outputs through the augmented Lagrangian.
#[derive(Default)]
pub(super) struct Sqp;

/// Its row in the table.
pub(super) const MEMBER: Member<dyn Search> = Member {
    doc: MemberDoc {
        name: "sqp",
        what: "sequential quadratic programming with exact gradients (thesis: SQP)",
        params: &[],
    },
    build: |keys| no_keys::<Sqp>("sqp", keys),
};

impl Search for Sqp {
    fn run(&self, chain: &mut Chain, x0: &[f64]) {
        bounded::descend(chain, x0, &SequentialQuadratic::default());
    }
}
