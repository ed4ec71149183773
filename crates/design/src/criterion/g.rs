//! G: largest variance of the predicted objective output.

use super::{Active, Criterion, Information, Scratch, no_keys, sandwich};
use crate::kernel::{dot, gram_add, mirror};
use dynocal_numerics::registry::{Member, MemberDoc};

/// `J_G = max_t s0(t) M^-1 s0(t)'` (thesis eq. 4.51). The search uses the p-norm over t,
///
/// ```text
/// J_q = (sum_t v_t^q)^(1/q),   dJ_q/dA = -sigma^2 A^-1 (sum_t (v_t / J_q)^(q-1) x_t' x_t) A^-1,   x_t = s0(t) D^-1
/// ```
#[derive(Default)]
pub(super) struct G;

/// Its row in the table.
pub(super) const MEMBER: Member<dyn Criterion> = Member {
    doc: MemberDoc {
        name: "g",
        what: "G-optimal (4.51): largest variance of the predicted output over the objective signal",
        params: &[],
    },
    build: |keys| no_keys::<G>("g", keys),
};

/// Fills `work.v` with the variances v_t over the objective signal; returns the largest and its row.
fn variances(info: &Information, s0: &[f64], work: &mut Scratch) -> (f64, usize) {
    let p = info.p;
    // Rows of L^-1 D^-1: the variance is the squared norm of L^-1 D^-1 s0(t)'.
    for i in 0..p {
        for j in 0..=i {
            work.a[i * p + j] = info.factor_inverse[i * p + j] / info.scale[j];
        }
    }
    let mut worst = (0.0, 0);
    for (t, row) in s0.chunks_exact(p).enumerate() {
        let norm2: f64 = (0..p).map(|i| dot(&work.a[i * p..=i * p + i], &row[..=i]).powi(2)).sum();
        work.v[t] = norm2 * info.noise_variance;
        // NaN must not hide: it compares false, so the test is turned round.
        if work.v[t].is_nan() || work.v[t] > worst.0 {
            worst = (work.v[t], t);
        }
    }
    worst
}

impl Criterion for G {
    fn needs_objective_signal(&self) -> bool {
        true
    }

    fn is_extreme(&self) -> bool {
        true
    }

    /// `z_t = A^-1 x_t'` of the worst points.
    fn active(&self, info: &Information, band: f64, work: &mut Scratch) -> Option<Active> {
        let (p, m) = (info.p, info.objective?);
        let (worst, _) = variances(info, &m.s0, work);
        let n0 = m.s0.len() / p;
        let mut near: Vec<usize> = (0..n0).filter(|t| work.v[*t] >= (1.0 - band) * worst).collect();
        near.sort_by(|a, b| work.v[*b].total_cmp(&work.v[*a]));
        let direction = |t: usize| -> Vec<f64> {
            let x: Vec<f64> = (0..p).map(|k| m.s0[t * p + k] / info.scale[k]).collect();
            info.inverse.chunks_exact(p).map(|row| dot(row, &x)).collect()
        };
        let directions = near.into_iter().map(direction).collect();
        Some(Active { worst, directions, factor: info.noise_variance, spectral: false })
    }

    fn value(&self, info: &Information, work: &mut Scratch) -> f64 {
        let Some(m) = info.objective else { return f64::INFINITY };
        variances(info, &m.s0, work).0
    }

    fn value_gradient(&self, info: &Information, q: f64, work: &mut Scratch, gram_bar: &mut [f64]) -> f64 {
        let Some(m) = info.objective else { return f64::INFINITY };
        let p = info.p;
        let (worst, _) = variances(info, &m.s0, work);
        let n0 = m.s0.len() / p;
        let norm = worst * work.v[..n0].iter().map(|v| (v / worst).powf(q)).sum::<f64>().powf(1.0 / q);
        for (t, row) in m.s0.chunks_exact(p).enumerate() {
            let root = (work.v[t] / norm).powf(0.5 * (q - 1.0));
            for k in 0..p {
                work.rows[t * p + k] = root * row[k] / info.scale[k];
            }
        }
        work.b.fill(0.0);
        gram_add(&work.rows[..n0 * p], p, &mut work.b);
        mirror(&mut work.b, p);
        sandwich(info, &work.b, info.noise_variance, &mut work.a, gram_bar);
        norm
    }
}
