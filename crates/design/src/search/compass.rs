//! Cyclic compass search.

use super::chain::Candidate;
use super::{Chain, Search, no_keys};
use dynocal_numerics::registry::{Member, MemberDoc};

/// Pattern search over the coordinates without derivatives: each free value in turn is moved up or down by the
/// mesh, kept where that helps and moved on from there; after a sweep without success the mesh is halved (thesis
/// section 4.6 uses a pattern search). Independent of the gradient, so that it serves as a check on it.
#[derive(Default)]
pub(super) struct Compass;

/// Its row in the table.
pub(super) const MEMBER: Member<dyn Search> = Member {
    doc: MemberDoc {
        name: "compass",
        what: "cyclic pattern search over the free values, without derivatives",
        params: &[],
    },
    build: |keys| no_keys::<Compass>("compass", keys),
};

const LEAST_MESH: f64 = 1e-6;

impl Search for Compass {
    fn run(&self, chain: &mut Chain, x0: &[f64]) {
        let layout = chain.evaluator.layout().clone();
        let (lower, upper) = layout.bounds();
        let (mut x, mut trial) = (x0.to_vec(), chain.scratch());
        layout.repair(&mut x);
        let mut at = chain.value(&x);
        let mut mesh = 0.5;
        while mesh > LEAST_MESH && chain.left() > 2 {
            let mut moved = false;
            for j in 0..x.len() {
                for side in [mesh, -mesh] {
                    let to = (x[j] + side).clamp(lower[j], upper[j]);
                    if chain.left() == 0 || to == x[j] {
                        continue;
                    }
                    trial.copy_from_slice(&x);
                    trial[j] = to;
                    if layout.coupling_violation(&trial) > 0.0 {
                        continue;
                    }
                    let found = chain.value(&trial);
                    if chain.better(found, at) {
                        (x[j], at, moved) = (to, found, true);
                        break;
                    }
                }
            }
            chain.note(at.0, at.1, mesh);
            if !moved {
                mesh *= 0.5;
            }
        }
        let converged = mesh <= LEAST_MESH;
        chain.offer(Candidate { x, f: at.0, violation: at.1, converged, multipliers: None });
    }
}
