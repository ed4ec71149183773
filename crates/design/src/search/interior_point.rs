//! Interior point.

use super::{Chain, Search, bounded, no_keys};
use dynocal_numerics::optim;
use dynocal_numerics::registry::{Member, MemberDoc};

/// The thesis' IP (section 4.3): a primal-dual interior point (Waechter & Biegler 2006) with a damped BFGS Hessian, on the
/// box; rates and outputs through the augmented Lagrangian. Dense, for records of some hundred free values.
#[derive(Default)]
pub(super) struct InteriorPoint;

/// Its row in the table.
pub(super) const MEMBER: Member<dyn Search> = Member {
    doc: MemberDoc {
        name: "interior_point",
        what: "primal-dual interior point with exact gradients, dense (thesis: IP)",
        params: &[],
    },
    build: |keys| no_keys::<InteriorPoint>("interior_point", keys),
};

impl Search for InteriorPoint {
    fn run(&self, chain: &mut Chain, x0: &[f64]) {
        bounded::descend(chain, x0, &optim::InteriorPoint);
    }

    fn most_variables(&self) -> usize {
        1000
    }
}
