//! How loops act on each other: relative gain array, and decouplers, `u = D d`, that stand between controllers and plant.
//!
//! ```text
//! static   D = G(0)^-1 with each column over its own entry on the diagonal
//! dynamic  D_jj = 1, the others FIR: for each j least squares of the answers of the other outputs to a step of d_j,
//!          min sum_t sum_{i != j} [s_ij(t) + sum_k (s_ik * D_kj)(t)]^2,  s the step responses of the plant
//! ```
//!
//! A filter of finite length is causal and stable whatever zeros and delays the plant has, where the quotient of channels would be neither:
//! what cannot be cancelled in time is left, as little of it as the length allows.
//!
//! `RGA = G(0) .* (G(0)^-1)'` (E. H. Bristol, IEEE Trans. Automatic Control 11 (1966) 133-134): 1 where a loop sees the same gain
//! with the others open and closed, negative where it changes its sign.

use dynocal_numerics::linalg::{cholesky, solve_upper, solve_upper_transposed};

use crate::error::ControlError;
use crate::matrix::Matrix;
use crate::poly::{add, multiply};
use crate::system::{System, Time, Transfer};

/// Share of the mean square of a regressor that is added to the diagonal: a filter that no step tells stays small.
const RIDGE: f64 = 1e-11;
/// Most samples of the step responses.
const LONGEST: usize = 4000;

/// Relative gains at an angular frequency (0: at rest), outputs by inputs, row-major: real parts.
///
/// # Errors
/// [`ControlError::Shape`] for a plant that is not square, [`ControlError::Singular`] for one without inverse.
pub fn relative_gains(plant: &System, w_rad_s: f64) -> Result<Vec<f64>, ControlError> {
    let g = response(plant, w_rad_s)?;
    let inverse = inverse(&g, w_rad_s)?;
    let n = g.rows;
    Ok((0..n * n).map(|k| (g.data[k] * inverse.at(k % n, k / n)).re).collect())
}

/// `D = G(0)^-1 diag(G(0))`: before the plant it leaves each output its own input at rest, row-major.
///
/// # Errors
/// As of [`relative_gains`].
pub fn decoupler(plant: &System) -> Result<Vec<f64>, ControlError> {
    let g = response(plant, 0.0)?;
    let n = g.rows;
    let own: Vec<_> = (0..n).map(|k| g.at(k, k)).collect();
    Ok(inverse(&g, 0.0)?.times(&Matrix::diagonal(&own)).data.iter().map(|v| v.re).collect())
}

/// The static decoupler as a system, each controller's own input left as it is.
///
/// # Errors
/// As of [`relative_gains`], and an input that its own loop does not move.
pub fn static_decoupler(plant: &System) -> Result<System, ControlError> {
    let d = decoupler(plant)?;
    let n = plant.inputs;
    for k in 0..n {
        if !(d[k * n + k].abs() > 1e-9) {
            let what = format!("the decoupler: own part of input {}", k + 1);
            return Err(ControlError::number(what, d[k * n + k], "not 0: pair outputs and inputs otherwise"));
        }
    }
    let own = (0..n * n).map(|k| Transfer::gain(d[k] / d[(k % n) * n + k % n])).collect();
    System::new(plant.time, n, n, own)
}

/// The dynamic decoupler of a sampled plant that comes to rest, its filters of `taps` samples.
///
/// # Errors
/// [`ControlError`]: a continuous plant, one that is not square or does not come to rest, filters without a sample.
pub fn dynamic_decoupler(plant: &System, taps: usize) -> Result<System, ControlError> {
    let n = plant.inputs;
    // Shape and steady gains are asked for there.
    static_decoupler(plant)?;
    if plant.time.sample_time_s().is_none() || taps == 0 {
        return Err(ControlError::shape(
            "a dynamic decoupler",
            format!("{:?}, {taps} taps", plant.time),
            "a sampled plant and one tap at least",
        ));
    }
    let rows = horizon(plant, taps)?;
    let steps: Vec<Vec<f64>> = plant.channels.iter().map(|g| step(g, plant.time, rows)).collect();
    let mut channels = vec![Transfer::gain(0.0); n * n];
    for j in 0..n {
        channels[j * n + j] = Transfer::gain(1.0);
        let others: Vec<usize> = (0..n).filter(|k| *k != j).collect();
        for (k, filter) in others.iter().zip(filters(&steps, n, j, &others, taps)?) {
            channels[k * n + j] = Transfer::sampled(&filter, &[1.0]);
        }
    }
    System::new(plant.time, n, n, channels)
}

/// Filters from demand `j` to the other inputs, by the normal equations.
fn filters(
    steps: &[Vec<f64>],
    n: usize,
    j: usize,
    others: &[usize],
    taps: usize,
) -> Result<Vec<Vec<f64>>, ControlError> {
    let (rows, p) = (steps[0].len(), others.len() * taps);
    let (mut a, mut b) = (vec![0.0; p * p], vec![0.0; p]);
    let mut x = vec![0.0; p];
    for i in others {
        for t in 0..rows {
            for (k, other) in others.iter().enumerate() {
                for l in 0..taps {
                    x[k * taps + l] = if t >= l { steps[i * n + other][t - l] } else { 0.0 };
                }
            }
            for r in 0..p {
                b[r] -= x[r] * steps[i * n + j][t];
                (0..=r).for_each(|c| a[r * p + c] += x[r] * x[c]);
            }
        }
    }
    let mean = (0..p).map(|r| a[r * p + r]).sum::<f64>() / p as f64;
    for r in 0..p {
        a[r * p + r] += RIDGE * mean;
        (0..r).for_each(|c| a[c * p + r] = a[r * p + c]);
    }
    let singular =
        |_| ControlError::Singular { what: "the plant's step responses".into(), frequency_rad_s: 0.0 };
    cholesky(&mut a, p).map_err(singular)?;
    solve_upper_transposed(&a, p, &mut b).map_err(singular)?;
    solve_upper(&a, p, &mut b).map_err(singular)?;
    Ok(b.chunks(taps).map(<[f64]>::to_vec).collect())
}

/// Samples in which the slowest pole fades, and the filters beside.
fn horizon(plant: &System, taps: usize) -> Result<usize, ControlError> {
    let roots = plant.poles.iter().flat_map(|p| crate::poly::roots(p).unwrap_or_default());
    let slowest = roots.map(|r| 1.0 / r.norm()).fold(0.0, f64::max);
    if !(slowest < 1.0 - 1e-9) {
        return Err(ControlError::number(
            "the largest pole of the plant",
            slowest,
            "below 1: a dynamic decoupler is made for plants that come to rest",
        ));
    }
    let fade = if slowest > 0.0 { (-5.0 / slowest.ln()) as usize } else { 0 };
    let lags = plant.channels.iter().map(|g| g.num.len()).max().unwrap_or(0);
    Ok((fade + lags + 2 * taps).min(LONGEST))
}

/// Step response of a sampled channel; a delay counts in whole samples.
fn step(g: &Transfer, time: Time, rows: usize) -> Vec<f64> {
    let late = time.sample_time_s().map_or(0, |dt_s| (g.delay_s / dt_s).round() as usize);
    let mut y = vec![0.0; rows];
    for t in 0..rows {
        let moved: f64 = g.num.iter().take((t + 1).saturating_sub(late)).sum();
        let kept: f64 = g.den.iter().enumerate().skip(1).take(t).map(|(k, a)| a * y[t - k]).sum();
        y[t] = (moved - kept) / g.den[0];
    }
    y
}

/// Channel from demand `k` to output `k` behind a decoupler: `sum_i G_ki D_ik`.
///
/// # Errors
/// [`ControlError::Shape`]: delays that differ between the summed channels of a continuous plant.
pub fn behind(plant: &System, decoupler: &System, k: usize) -> Result<Transfer, ControlError> {
    let mut sum: Option<Transfer> = None;
    for i in 0..plant.inputs {
        let (g, d) = (plant.channel(k, i), decoupler.channel(i, k));
        if g.is_zero() || d.is_zero() {
            continue;
        }
        let one = whole(g.times(d), plant.time);
        sum = Some(match sum {
            None => one,
            Some(s) if s.delay_s != one.delay_s => {
                return Err(ControlError::shape(
                    "delays of the channels that a decoupler adds up",
                    format!("{} and {} s", s.delay_s, one.delay_s),
                    "one delay for each output",
                ));
            }
            // Channels of one output mostly share their denominator: it is not squared.
            Some(s) if s.den == one.den => Transfer { num: add(&s.num, &one.num), ..s },
            Some(s) => Transfer {
                num: add(&multiply(&s.num, &one.den), &multiply(&one.num, &s.den)),
                den: multiply(&s.den, &one.den),
                delay_s: s.delay_s,
            },
        });
    }
    Ok(sum.unwrap_or(Transfer::gain(0.0)))
}

/// Channel `k` of a sampled plant of two inputs and outputs as its own loop sees it while the other loop is closed by `other`:
/// `G_kk - G_kj C / (1 + C G_jj) G_jk`. A predictor of loop `k` whose model has the other loop open takes what that one answers for a
/// disturbance.
///
/// ```
/// use dynocal_control::interaction::beside_closed;
/// use dynocal_control::system::{System, Time, Transfer};
/// let lag = |k: f64| Transfer::sampled(&[0.0, 0.5 * k], &[1.0, -0.5]);
/// let plant = System::new(Time::Sampled { sample_time_s: 0.1 }, 2, 2, vec![lag(1.0), lag(0.4), lag(0.5), lag(1.0)])?;
/// // An integrating controller holds the other output at rest: the gain is G_00 - G_01 G_10 / G_11.
/// let seen = beside_closed(&plant, &Transfer::sampled(&[0.1], &[1.0, -1.0]), 0)?;
/// assert!((seen.steady_gain(plant.time) - 0.8).abs() < 1e-12);
/// # Ok::<(), dynocal_control::error::ControlError>(())
/// ```
///
/// # Errors
/// [`ControlError::Shape`]: other than two inputs and outputs, delays that are not of whole samples.
pub fn beside_closed(plant: &System, other: &Transfer, k: usize) -> Result<Transfer, ControlError> {
    let refused = |found: String| {
        ControlError::shape(
            "channel beside a closed loop",
            found,
            "a sampled plant of two inputs and outputs, delays of whole samples",
        )
    };
    if (plant.inputs, plant.outputs) != (2, 2) || k > 1 {
        return Err(refused(format!("{} inputs, {} outputs, loop {k}", plant.inputs, plant.outputs)));
    }
    let j = 1 - k;
    let c = whole(other.clone(), plant.time);
    let channel = |o, i| whole(plant.channel(o, i).clone(), plant.time);
    let [own, there, back, loop_of] = [channel(k, k), channel(j, k), channel(k, j), channel(j, j)];
    if let Some(late) = [&c, &own, &there, &back, &loop_of].into_iter().find(|g| g.delay_s != 0.0) {
        return Err(refused(format!("a delay of {} s", late.delay_s)));
    }
    // With one denominator for each output, as linear models have it, those of the other output drop out.
    let shared = there.den == loop_of.den && own.den == back.den;
    let closed = |g: &Transfer| add(&multiply(&c.den, &g.den), &multiply(&c.num, &g.num));
    let (num, den) = if shared {
        let rest = closed(&loop_of);
        let through = multiply(&multiply(&c.num, &there.num), &back.num);
        (add(&multiply(&own.num, &rest), &negative(&through)), multiply(&own.den, &rest))
    } else {
        let rest = multiply(&multiply(&closed(&loop_of), &there.den), &back.den);
        let through = multiply(&multiply(&multiply(&c.num, &there.num), &back.num), &loop_of.den);
        let num = add(&multiply(&own.num, &rest), &negative(&multiply(&through, &own.den)));
        (num, multiply(&own.den, &rest))
    };
    Ok(Transfer { num, den, delay_s: 0.0 })
}

fn negative(c: &[f64]) -> Vec<f64> {
    c.iter().map(|v| -v).collect()
}

/// A sampled channel with its delay as leading zeros, where it is whole.
fn whole(g: Transfer, time: Time) -> Transfer {
    let Some(samples) = time.sample_time_s().map(|dt_s| g.delay_s / dt_s) else { return g };
    if (samples - samples.round()).abs() > 1e-6 {
        return g;
    }
    let mut num = vec![0.0; samples.round() as usize];
    num.extend(&g.num);
    Transfer { num, den: g.den, delay_s: 0.0 }
}

/// `u = D d` with `d` of the controllers, as one controller.
///
/// # Errors
/// As of [`System::new`].
pub fn through(decoupler: &System, own: &[Transfer]) -> Result<System, ControlError> {
    let mut out = decoupler.before(own)?;
    // The integrators are those of the controllers, each once, however many inputs they move.
    out.poles = own.iter().map(|c| c.den.clone()).collect();
    Ok(out)
}

fn response(plant: &System, w_rad_s: f64) -> Result<Matrix, ControlError> {
    if plant.outputs != plant.inputs {
        let found = format!("{} x {}", plant.outputs, plant.inputs);
        return Err(ControlError::shape("the plant", found, "as many outputs as inputs"));
    }
    let g = match plant.time {
        _ if w_rad_s != 0.0 => plant.at(w_rad_s),
        Time::Continuous | Time::Sampled { .. } => plant.at(0.0),
    };
    match g.data.iter().find(|v| !v.norm().is_finite()) {
        Some(v) => Err(ControlError::number(
            "a gain at rest (the plant integrates: give a frequency)",
            v.norm(),
            "a finite number",
        )),
        None => Ok(g),
    }
}

fn inverse(g: &Matrix, w: f64) -> Result<Matrix, ControlError> {
    let singular = || ControlError::Singular { what: "the plant".into(), frequency_rad_s: w };
    let scale = g.data.iter().map(|v| v.norm()).fold(0.0, f64::max);
    // What rounding leaves of a determinant is no gain.
    let (det, inverse) = g.solved();
    if det.norm() <= 1e-12 * scale.powi(g.rows as i32) {
        return Err(singular());
    }
    inverse.ok_or_else(singular)
}
