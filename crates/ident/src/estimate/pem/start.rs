//! The least-squares start of prediction-error estimation.
//!
//! 1. ARX of high order: innovations `e = A_h y - sum B_h,i u_i`, noise-free responses `yhat_i = B_h,i / A_h u_i`.
//! 2. Deterministic part: without F, least squares of y with the innovations as known inputs (Hannan-Rissanen) or
//!    of the noise-free response; with F, each `yhat_i` reduced to `B_i/F_i u_i` (Steiglitz-McBride).
//! 3. Noise part: least squares of `v = A y - sum B_i/F_i u_i` on its own past and that of the innovations.

use dynocal_numerics::linalg::{LinalgError, cholesky, gram_upper, least_squares, solve_upper};

use crate::experiment::Experiment;
use crate::model::linear::filter::{filter, stabilised};
use crate::model::linear::{LinearModel, Polynomials};

/// Passes of the reduction to B/F.
const REDUCTION_PASSES: usize = 4;

/// One signal per experiment.
type Signals = Vec<Vec<f64>>;

/// Start parameters (p each) with stable C and F.
pub(super) fn least_squares_starts(
    model: &LinearModel,
    data: &[&Experiment],
) -> Result<Vec<Vec<f64>>, LinalgError> {
    let mut p = model.polynomials(&vec![0.0; model.n_params()]);
    let with_f = model.orders.iter().any(|o| o.nf > 0);
    if model.nc + model.nd == 0 && !with_f {
        // ARX: the errors are linear in the parameters, the first step of the search is the answer.
        return Ok(vec![model.parameters(&p)]);
    }
    let s = Records::new(model, data);
    let long = s.high_order(model)?;
    if with_f {
        for i in 0..model.n_inputs() {
            s.reduce(model, i, &long.responses[i], &mut p)?;
        }
        s.noise_part(model, &long.innovations, &mut p)?;
    } else if model.nd == 0 {
        s.hannan_rissanen(model, &long.innovations, &mut p)?;
    } else {
        s.common_denominator(model, &long.responses, &mut p)?;
        s.noise_part(model, &long.innovations, &mut p)?;
    }
    p.c = stabilised(&p.c);
    Ok(vec![model.parameters(&p)])
}

/// Terms `sign * signal(t - first) ..` of a regression.
struct Lagged<'a> {
    signals: &'a Signals,
    sign: f64,
    first: usize,
    count: usize,
}

/// What the high-order model gives.
struct LongModel {
    innovations: Signals,
    /// Noise-free response to each input.
    responses: Vec<Signals>,
}

/// All records, one signal per channel.
struct Records {
    y: Signals,
    u: Vec<Signals>,
}

impl Records {
    fn new(model: &LinearModel, data: &[&Experiment]) -> Self {
        let m = model.n_inputs();
        let channel =
            |i: usize| data.iter().map(|e| e.u.iter().skip(i).step_by(m).copied().collect()).collect();
        Self { y: data.iter().map(|e| e.y.clone()).collect(), u: (0..m).map(channel).collect() }
    }

    fn high_order(&self, model: &LinearModel) -> Result<LongModel, LinalgError> {
        let (m, samples) = (model.n_inputs(), self.y.iter().map(Vec::len).sum::<usize>());
        // Long enough to whiten, short enough to leave eight samples per coefficient.
        let order = (10 + 2 * model.max_lag()).min(samples / (8 * (m + 1))).max(1);
        let mut terms = vec![Lagged { signals: &self.y, sign: -1.0, first: 1, count: order }];
        for (u, o) in self.u.iter().zip(&model.orders) {
            terms.push(Lagged { signals: u, sign: 1.0, first: o.nk, count: order });
        }
        let found = regress(&self.y, &terms)?;
        let a = monic(&found[..order]);
        let mut innovations = through(&a, &[1.0], &self.y);
        let stable_a = stabilised(&a);
        let mut responses = Vec::with_capacity(m);
        for (i, o) in model.orders.iter().enumerate() {
            let b = delayed(o.nk, &found[(1 + i) * order..(2 + i) * order]);
            subtract(&mut innovations, &through(&b, &[1.0], &self.u[i]));
            responses.push(through(&b, &stable_a, &self.u[i]));
        }
        Ok(LongModel { innovations, responses })
    }

    /// `y = (1 - A) y + B u + (C - 1) e`, least squares in A, B and C.
    fn hannan_rissanen(
        &self,
        model: &LinearModel,
        innovations: &Signals,
        p: &mut Polynomials,
    ) -> Result<(), LinalgError> {
        let mut terms = vec![Lagged { signals: &self.y, sign: -1.0, first: 1, count: model.na }];
        for (u, o) in self.u.iter().zip(&model.orders) {
            terms.push(Lagged { signals: u, sign: 1.0, first: o.nk, count: o.nb });
        }
        terms.push(Lagged { signals: innovations, sign: 1.0, first: 1, count: model.nc });
        let found = regress(&self.y, &terms)?;
        p.c = monic(&found[found.len() - model.nc..]);
        self.take_a_and_b(model, &found, p);
        Ok(())
    }

    /// A and B from the noise-free response.
    fn common_denominator(
        &self,
        model: &LinearModel,
        responses: &[Signals],
        p: &mut Polynomials,
    ) -> Result<(), LinalgError> {
        let mut total: Signals = self.y.iter().map(|y| vec![0.0; y.len()]).collect();
        for part in responses {
            for (sum, signal) in total.iter_mut().zip(part) {
                sum.iter_mut().zip(signal).for_each(|(s, v)| *s += v);
            }
        }
        let mut terms = vec![Lagged { signals: &total, sign: -1.0, first: 1, count: model.na }];
        for (u, o) in self.u.iter().zip(&model.orders) {
            terms.push(Lagged { signals: u, sign: 1.0, first: o.nk, count: o.nb });
        }
        let found = regress(&total, &terms)?;
        self.take_a_and_b(model, &found, p);
        Ok(())
    }

    fn take_a_and_b(&self, model: &LinearModel, found: &[f64], p: &mut Polynomials) {
        p.a = monic(&found[..model.na]);
        let mut next = model.na;
        for (b, o) in p.b.iter_mut().zip(&model.orders) {
            *b = delayed(o.nk, &found[next..next + o.nb]);
            next += o.nb;
        }
    }

    /// B_i and F_i from the noise-free response to input i: `F yhat = B u`, each pass filtered by the last 1/F.
    fn reduce(
        &self,
        model: &LinearModel,
        i: usize,
        response: &Signals,
        p: &mut Polynomials,
    ) -> Result<(), LinalgError> {
        let o = model.orders[i];
        for _ in 0..if o.nf > 0 { REDUCTION_PASSES } else { 1 } {
            let (y, u) = (through(&[1.0], &p.f[i], response), through(&[1.0], &p.f[i], &self.u[i]));
            let found = regress(
                &y,
                &[
                    Lagged { signals: &y, sign: -1.0, first: 1, count: o.nf },
                    Lagged { signals: &u, sign: 1.0, first: o.nk, count: o.nb },
                ],
            )?;
            p.f[i] = stabilised(&monic(&found[..o.nf]));
            p.b[i] = delayed(o.nk, &found[o.nf..]);
        }
        Ok(())
    }

    /// C and D of `D v = C e` with known innovations.
    fn noise_part(
        &self,
        model: &LinearModel,
        innovations: &Signals,
        p: &mut Polynomials,
    ) -> Result<(), LinalgError> {
        if model.nc + model.nd == 0 {
            return Ok(());
        }
        let mut v = through(&p.a, &[1.0], &self.y);
        for (i, u) in self.u.iter().enumerate() {
            subtract(&mut v, &through(&p.b[i], &p.f[i], u));
        }
        let found = regress(
            &v,
            &[
                Lagged { signals: innovations, sign: 1.0, first: 1, count: model.nc },
                Lagged { signals: &v, sign: -1.0, first: 1, count: model.nd },
            ],
        )?;
        p.c = monic(&found[..model.nc]);
        p.d = monic(&found[model.nc..]);
        Ok(())
    }
}

/// Least squares of `target` on lagged signals, from the first sample that has all of them.
fn regress(target: &Signals, terms: &[Lagged]) -> Result<Vec<f64>, LinalgError> {
    let width: usize = terms.iter().map(|l| l.count).sum();
    let first = terms.iter().filter(|l| l.count > 0).map(|l| l.first + l.count - 1).max().unwrap_or(0);
    let rows: usize = target.iter().map(|y| y.len().saturating_sub(first)).sum();
    if width == 0 || rows == 0 {
        return Ok(vec![0.0; width]);
    }
    // Regressors and, in the last column, the target.
    let mut a = Vec::with_capacity(rows * (width + 1));
    for (record, y) in target.iter().enumerate() {
        for t in first..y.len() {
            for l in terms {
                let x = &l.signals[record];
                a.extend((l.first..l.first + l.count).map(|lag| l.sign * x[t - lag]));
            }
            a.push(y[t]);
        }
    }
    if let Some(x) = normal_equations(&a, rows, width) {
        return Ok(x);
    }
    let b: Vec<f64> = a.iter().skip(width).step_by(width + 1).copied().collect();
    let a: Vec<f64> = a.chunks_exact(width + 1).flat_map(|row| row[..width].iter().copied()).collect();
    Ok(least_squares(&a, rows, width, &b, 0.0)?.x)
}

/// Least squares by the Cholesky factor of `[A b]'[A b]`: a start needs few digits, and this is several times faster than
/// an orthogonal factorisation. `None` when fewer than five digits would be left.
fn normal_equations(a: &[f64], rows: usize, width: usize) -> Option<Vec<f64>> {
    let w = width + 1;
    let mut gram = vec![0.0; w * w];
    gram_upper(a, rows, w, &mut gram).ok()?;
    let mut factor = gram.clone();
    cholesky(&mut factor, w).ok()?;
    if (0..width).any(|k| factor[k * w + k].powi(2) < 1e-10 * gram[k * w + k]) {
        return None;
    }
    let r: Vec<f64> = (0..width).flat_map(|i| factor[i * w..i * w + width].iter().copied()).collect();
    let mut x: Vec<f64> = (0..width).map(|i| factor[i * w + width]).collect();
    solve_upper(&r, width, &mut x).ok()?;
    x.iter().all(|v| v.is_finite()).then_some(x)
}

fn through(num: &[f64], den: &[f64], signals: &Signals) -> Signals {
    let filtered = |x: &Vec<f64>| {
        let mut out = vec![0.0; x.len()];
        filter(num, den, x, &mut out);
        out
    };
    signals.iter().map(filtered).collect()
}

fn subtract(a: &mut Signals, b: &Signals) {
    for (x, y) in a.iter_mut().zip(b) {
        x.iter_mut().zip(y).for_each(|(x, y)| *x -= y);
    }
}

fn monic(v: &[f64]) -> Vec<f64> {
    std::iter::once(1.0).chain(v.iter().copied()).collect()
}

/// Coefficients behind `nk` zeros.
fn delayed(nk: usize, v: &[f64]) -> Vec<f64> {
    std::iter::repeat_n(0.0, nk).chain(v.iter().copied()).collect()
}
