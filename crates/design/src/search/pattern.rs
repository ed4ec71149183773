//! Pattern search as the thesis used it.

use super::chain::Candidate;
use super::{Chain, Search, no_keys};
use dynocal_numerics::registry::{Member, MemberDoc};

/// The thesis' PS (section 4.3), with the usual settings of its toolbox: polls along the 2n coordinate directions in a
/// fixed order, takes the first better point, begins again at the first direction with the mesh doubled, and halves it
/// after a poll without success; the first mesh is the whole box. Without derivatives. `compass` goes on with the next
/// direction instead and is far better at equal evaluations.
#[derive(Default)]
pub(super) struct Pattern;

/// Its row in the table.
pub(super) const MEMBER: Member<dyn Search> = Member {
    doc: MemberDoc {
        name: "pattern_search",
        what: "generalised pattern search, 2n directions, first success taken, without derivatives (thesis: PS)",
        params: &[],
    },
    build: |keys| no_keys::<Pattern>("pattern_search", keys),
};

const LEAST_MESH: f64 = 1e-6;

impl Search for Pattern {
    fn run(&self, chain: &mut Chain, x0: &[f64]) {
        let layout = chain.evaluator.layout().clone();
        let (lower, upper) = layout.bounds();
        let n = x0.len();
        let (mut x, mut trial) = (x0.to_vec(), chain.scratch());
        layout.repair(&mut x);
        let mut at = chain.value(&x);
        let mut mesh = 1.0;
        while mesh > LEAST_MESH && chain.left() > 0 {
            let mut success = false;
            for direction in 0..2 * n {
                let (j, side) = (direction % n, if direction < n { mesh } else { -mesh });
                let to = (x[j] + side).clamp(lower[j], upper[j]);
                if to == x[j] {
                    continue;
                }
                trial.copy_from_slice(&x);
                trial[j] = to;
                if layout.rate_violation(&trial) > 0.0 {
                    continue;
                }
                if chain.left() == 0 {
                    break;
                }
                let found = chain.value(&trial);
                if chain.better(found, at) {
                    (x[j], at, success) = (to, found, true);
                    break;
                }
            }
            chain.note(at.0, at.1, mesh);
            let candidate =
                Candidate { x: x.clone(), f: at.0, violation: at.1, converged: false, multipliers: None };
            chain.offer(candidate);
            mesh = if success { (2.0 * mesh).min(1.0) } else { 0.5 * mesh };
        }
        if let Some(best) = &mut chain.best {
            best.converged |= mesh <= LEAST_MESH;
        }
    }
}
