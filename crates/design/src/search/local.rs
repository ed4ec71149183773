//! One local run.

use super::{Chain, Search, no_keys};
use dynocal_numerics::registry::{Member, MemberDoc};

/// One run of the bounded quasi-Newton method from the start.
#[derive(Default)]
pub(super) struct Local;

/// Its row in the table.
pub(super) const MEMBER: Member<dyn Search> = Member {
    doc: MemberDoc { name: "local", what: "one bounded quasi-Newton run from the start", params: &[] },
    build: |keys| no_keys::<Local>("local", keys),
};

impl Search for Local {
    fn run(&self, chain: &mut Chain, x0: &[f64]) {
        let budget = chain.left();
        let found = chain.refine(x0, budget, false, None);
        chain.offer(found);
    }
}
