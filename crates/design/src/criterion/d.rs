//! D: volume of the confidence ellipsoid.

use super::{Criterion, Information, Scratch, no_keys};
use dynocal_numerics::registry::{Member, MemberDoc};

/// `J_D = -ln det M` (thesis eq. 4.36) `= p ln sigma^2 - 2 sum ln(L_kk d_k)`.
#[derive(Default)]
pub(super) struct D;

/// Its row in the table.
pub(super) const MEMBER: Member<dyn Criterion> = Member {
    doc: MemberDoc {
        name: "d",
        what: "D-optimal: -ln det M, the volume of the confidence ellipsoid of the parameters",
        params: &[],
    },
    build: |keys| no_keys::<D>("d", keys),
};

impl Criterion for D {
    fn is_positive(&self) -> bool {
        false
    }

    fn is_log_det(&self) -> bool {
        true
    }

    fn value(&self, info: &Information, _: &mut Scratch) -> f64 {
        let p = info.p;
        let half: f64 = (0..p).map(|k| (info.factor[k * p + k] * info.scale[k]).ln()).sum();
        p as f64 * info.noise_variance.ln() - 2.0 * half
    }

    fn value_gradient(&self, info: &Information, _: f64, work: &mut Scratch, gram_bar: &mut [f64]) -> f64 {
        for (g, v) in gram_bar.iter_mut().zip(info.inverse) {
            *g = -v;
        }
        self.value(info, work)
    }
}
