//! E: the direction in parameter space that is seen worst.

use super::{Active, Criterion, Information, Scratch, no_keys};
use crate::kernel::{multiply, svd};
use dynocal_numerics::registry::{Member, MemberDoc};

/// `J_E = 1 / lambda_min(C^-1 M C^-1)` with the reference scales C = diag(c): the variance of the parameter
/// combination that is seen worst, in scaled parameters. The search uses the p-norm over the eigenvalues,
///
/// ```text
/// J_q = (sum_k mu_k^q)^(1/q),   mu_k = 1 / lambda_k
/// ```
#[derive(Default)]
pub(super) struct E;

/// Its row in the table.
pub(super) const MEMBER: Member<dyn Criterion> = Member {
    doc: MemberDoc {
        name: "e",
        what: "E-optimal: largest variance of any unit combination of the scaled parameters, 1 / lambda_min",
        params: &[],
    },
    build: |keys| no_keys::<E>("e", keys),
};

/// Eigenvalues mu_k = 1 / lambda_k (ascending) to `work.v`, eigenvectors to the rows of `work.b`.
fn spectrum(info: &Information, work: &mut Scratch) {
    let p = info.p;
    for i in 0..p {
        let d = info.scale[i] / info.reference_scale[i];
        for j in 0..p {
            work.a[i * p + j] = info.factor[i * p + j] * d;
        }
    }
    svd(&work.a, p, &mut work.c, &mut work.v[..p], &mut work.b);
    for s in &mut work.v[..p] {
        *s = info.noise_variance / (*s * *s);
    }
}

impl Criterion for E {
    fn is_extreme(&self) -> bool {
        true
    }

    /// `z_k = A^-1 D^-1 C e_k` of the eigenvectors e_k of the largest mu.
    fn active(&self, info: &Information, band: f64, work: &mut Scratch) -> Option<Active> {
        let p = info.p;
        spectrum(info, work);
        let worst = work.v[p - 1];
        let direction = |k: usize| -> Vec<f64> {
            let e: Vec<f64> =
                (0..p).map(|j| work.b[k * p + j] * info.reference_scale[j] / info.scale[j]).collect();
            info.inverse.chunks_exact(p).map(|row| crate::kernel::dot(row, &e)).collect()
        };
        let near = (0..p).rev().filter(|k| work.v[*k] >= (1.0 - band) * worst);
        let directions = near.map(direction).collect();
        Some(Active { worst, directions, factor: info.noise_variance, spectral: true })
    }

    fn value(&self, info: &Information, work: &mut Scratch) -> f64 {
        spectrum(info, work);
        work.v[info.p - 1]
    }

    /// With `B = sigma^2 C D^-1 A^-1 D^-1 C`, whose eigenvalues are the mu_k, `J_q = (tr B^q)^(1/q)` and `dJ_q/dA =
    /// -J_q^(1-q) / sigma^2 D C^-1 B^(q+1) C^-1 D`: a dozen products in place of a decomposition. The order is rounded
    /// to a whole number.
    fn value_gradient(&self, info: &Information, q: f64, work: &mut Scratch, gram_bar: &mut [f64]) -> f64 {
        let (p, q) = (info.p, q.round().max(1.0));
        let ratio = |k: usize| info.reference_scale[k] / info.scale[k];
        let b = &mut work.rows[..p * p];
        for i in 0..p {
            for j in 0..p {
                b[i * p + j] = info.noise_variance * ratio(i) * info.inverse[i * p + j] * ratio(j);
            }
        }
        let size = (0..p).map(|k| b[k * p + k]).sum::<f64>();
        b.iter_mut().for_each(|v| *v /= size);
        let log_scale = power(b, p, q as u32, &mut work.a, &mut work.b, &mut work.c);
        let trace = (0..p).map(|k| work.b[k * p + k]).sum::<f64>();
        let norm = ((trace.ln() + log_scale) / q).exp();
        multiply(&work.b, b, p, gram_bar);
        // In units of B over its trace: J_q^(1-q) B^(q+1) = size^2 norm b^(q+1) / tr(b^q).
        let factor = -norm * size * size / (trace * info.noise_variance);
        for i in 0..p {
            for j in 0..p {
                gram_bar[i * p + j] *= factor / (ratio(i) * ratio(j));
            }
        }
        norm * size
    }
}

/// `result = b^q`, divided by `exp` of what is returned, by repeated squaring; every power is brought to trace 1.
fn power(b: &[f64], p: usize, mut q: u32, square: &mut [f64], result: &mut [f64], work: &mut [f64]) -> f64 {
    let normalise = |m: &mut [f64]| {
        let trace: f64 = (0..p).map(|k| m[k * p + k]).sum();
        m.iter_mut().for_each(|v| *v /= trace);
        trace.ln()
    };
    square.copy_from_slice(b);
    let (mut first, mut log_square, mut log_result) = (true, 0.0, 0.0);
    loop {
        if q & 1 == 1 {
            if first {
                result.copy_from_slice(square);
            } else {
                multiply(result, square, p, work);
                result.copy_from_slice(work);
            }
            first = false;
            log_result += log_square + normalise(result);
        }
        q >>= 1;
        if q == 0 {
            return log_result;
        }
        multiply(square, square, p, work);
        square.copy_from_slice(work);
        log_square = 2.0 * log_square + normalise(square);
    }
}
