//! Trust-region-reflective search.

use super::{Chain, Search, bounded, no_keys};
use dynocal_numerics::optim;
use dynocal_numerics::registry::{Member, MemberDoc};

/// The thesis' TRR (section 4.3): a quadratic model in a trust region, scaled by and reflected at the box (Coleman & Li
/// 1996), with a limited-memory SR1 model from the exact gradients.
#[derive(Default)]
pub(super) struct TrustRegion;

/// Its row in the table.
pub(super) const MEMBER: Member<dyn Search> = Member {
    doc: MemberDoc {
        name: "trust_region",
        what: "trust-region-reflective method with exact gradients (thesis: TRR)",
        params: &[],
    },
    build: |keys| no_keys::<TrustRegion>("trust_region", keys),
};

impl Search for TrustRegion {
    fn run(&self, chain: &mut Chain, x0: &[f64]) {
        bounded::descend(chain, x0, &optim::TrustRegion::default());
    }
}
