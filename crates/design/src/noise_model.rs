//! Models with a noise model as a design sees them: in their own parameters, through the inverse of the noise model.
//!
//! What a record tells about a model is in its prediction errors, not in its free run. With the errors
//! `eps = D/C (A y - sum_i B_i/F_i u_i)` of a linear model,
//!
//! ```text
//! M = 1/sigma^2 sum_t E[psi psi'],   psi = -d eps/d theta = psi_u + psi_e
//!
//! psi_u of a_j   - D/C        y(t-j)          y the response to the inputs alone
//!          b_i,j   D/(C F_i)  u_i(t-nk-j)
//!          f_i,j - D/(C F_i)  w_i(t-j)        w_i = B_i/F_i u_i
//! ```
//!
//! `psi_u` is what a record can change; it is `H^-1 dG/dtheta u` of the transfer functions G to the output and H of the
//! noise (L. Ljung, System Identification (1999), eqs. (9.52), (13.29)). `psi_e`, driven by the noise, adds the same to
//! every record: [`LinearInformation::noise_rows`]. Parameters of C and D are seen by `psi_e` alone and are no part of a
//! design.
//!
//! A prediction of the free run depends on the parameters through `dG/dtheta u` without the inverse of H: that is
//! [`LinearInformation::prediction`].

mod linear;
mod narmax;

pub use linear::LinearInformation;
pub use narmax::{NarmaxInformation, NoInformation};

/// Why these models are in no file.
const VIEW: &str = "a model with the information of a design is kept as the model that it is of";

/// `x = num / den x` of the samples from `start` on, at rest before; `den` is monic. `work` is a copy.
fn filter_from(num: &[f64], den: &[f64], start: usize, x: &mut [f64], work: &mut Vec<f64>) {
    work.clear();
    work.extend_from_slice(x);
    for t in start..x.len() {
        let reach = t - start;
        let ahead: f64 = num.iter().enumerate().take(reach + 1).map(|(k, c)| c * work[t - k]).sum();
        let back: f64 = den.iter().enumerate().take(reach + 1).skip(1).map(|(k, c)| c * x[t - k]).sum();
        x[t] = ahead - back;
    }
}

/// The transpose of [`filter_from`].
fn filter_back(num: &[f64], den: &[f64], start: usize, x: &mut [f64], work: &mut Vec<f64>) {
    let n = x.len();
    for t in (start..n).rev() {
        let later: f64 = den.iter().enumerate().take(n - t).skip(1).map(|(k, c)| c * x[t + k]).sum();
        x[t] -= later;
    }
    work.clear();
    work.extend_from_slice(x);
    for t in start..n {
        x[t] = num.iter().enumerate().take(n - t).map(|(k, c)| c * work[t + k]).sum();
    }
}

/// Product of two polynomials.
fn multiply(a: &[f64], b: &[f64]) -> Vec<f64> {
    let mut out = vec![0.0; (a.len() + b.len()).saturating_sub(1)];
    for (i, x) in a.iter().enumerate() {
        b.iter().enumerate().for_each(|(j, y)| out[i + j] += x * y);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_transposed_filter_is_the_transpose() {
        let (num, den, start, n) = ([1.0, 0.4, -0.2], [1.0, -0.7, 0.1], 2, 9);
        let column = |k: usize, back: bool| -> Vec<f64> {
            let mut x: Vec<f64> = (0..n).map(|t| f64::from(u8::from(t == k))).collect();
            let mut work = Vec::new();
            if back {
                filter_back(&num, &den, start, &mut x, &mut work);
            } else {
                filter_from(&num, &den, start, &mut x, &mut work);
            }
            x
        };
        for i in start..n {
            for j in start..n {
                assert!((column(j, false)[i] - column(i, true)[j]).abs() < 1e-14, "{i} {j}");
            }
        }
    }
}
