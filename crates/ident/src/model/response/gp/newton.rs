//! Maximum of the likelihood by damped Newton steps on the average information.
//!
//! ```text
//! (J + m (diag J + 1)) s = g      on the parameters that are not held at a bound,   |s|_inf <= 2
//! gain = g's - s'J s / 2,         taken where the likelihood rises by at least a ten-thousandth of it
//! ```
//!
//! J is never indefinite, so every step climbs; where the likelihood is nearly quadratic a handful of steps is enough. The
//! search ends where the next step promises less than `Effort` asks for.
//!
//! Sources: A. R. Gilmour, R. Thompson, B. R. Cullis, Average information REML, Biometrics 51 (1995), 1440-1450; J. Nocedal,
//! S. J. Wright, Numerical Optimization, 2nd ed. (2006), chapter 4.

use dynocal_numerics::linalg::{cholesky, dot, norm_inf, solve_upper, solve_upper_transposed};

use super::fit::{Found, LENGTHS, NOISE};
use super::likelihood::{Problem, Work};
use super::slopes::Slopes;

/// How far a search goes.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Effort {
    /// Enough to tell the starts apart.
    Coarse,
    /// To the maximum.
    Fine,
}

impl Effort {
    /// Promised rise of the log likelihood below which the search ends, and most likelihoods.
    fn limits(self) -> (f64, usize) {
        match self {
            Self::Coarse => (1e-2, 60),
            Self::Fine => (1e-6, 200),
        }
    }
}

/// Largest change of a logarithm in one step.
const LONGEST: f64 = 2.0;
/// Damping at the start, and its ends; beyond the upper one no step climbs.
const DAMPING: f64 = 1e-2;
const LEAST_DAMPING: f64 = 1e-8;
const MOST_DAMPING: f64 = 1e8;

/// Maximises the likelihood over log lengths and log noise ratio. `None` where there is none at the start.
pub(super) fn maximise(
    problem: &Problem<'_>,
    start: &[f64],
    effort: Effort,
    interrupt: &dyn Fn() -> bool,
) -> Option<Found> {
    let d = problem.dim();
    let bound =
        |k: usize| if k < d { [LENGTHS[0].ln(), LENGTHS[1].ln()] } else { [NOISE[0].ln(), NOISE[1].ln()] };
    let clip = |x: &[f64]| -> Vec<f64> {
        x.iter().enumerate().map(|(k, v)| v.clamp(bound(k)[0], bound(k)[1])).collect()
    };
    let (tolerance, most) = effort.limits();
    let mut work = Work::new(problem.n());
    let mut x = clip(start);
    let mut now = problem.factored(&x[..d], x[d].exp(), None, &mut work)?;
    let mut slopes = problem.slopes(&x[..d], x[d].exp(), &now, &mut work)?;
    let mut evaluations = 1;
    let mut damping = DAMPING;
    while evaluations < most && damping <= MOST_DAMPING && !interrupt() {
        let free: Vec<usize> = (0..=d)
            .filter(|k| {
                let ([low, high], g) = (bound(*k), slopes.gradient[*k]);
                !(x[*k] <= low && g < 0.0 || x[*k] >= high && g > 0.0)
            })
            .collect();
        let Some(step) = step(&slopes, &free, damping) else { break };
        let trial = clip(&x.iter().zip(&step).map(|(x, s)| x + s).collect::<Vec<f64>>());
        let gain = promised(&slopes, &trial.iter().zip(&x).map(|(t, x)| t - x).collect::<Vec<f64>>());
        // A damped step that promises little says nothing about the maximum.
        if gain < tolerance && damping <= DAMPING {
            break;
        }
        evaluations += 1;
        let found = problem.factored(&trial[..d], trial[d].exp(), None, &mut work);
        let rise = found.as_ref().map_or(f64::NEG_INFINITY, |f| f.value - now.value);
        if let Some(found) = found
            && rise > 1e-4 * gain.max(0.0)
        {
            let share = rise / gain;
            damping = if share > 0.75 {
                0.1 * damping
            } else if share < 0.25 {
                4.0 * damping
            } else {
                damping
            };
            damping = damping.max(LEAST_DAMPING);
            let Some(next) = problem.slopes(&trial[..d], trial[d].exp(), &found, &mut work) else { break };
            (x, now, slopes) = (trial, found, next);
            if rise < tolerance && gain < 10.0 * tolerance {
                break;
            }
        } else {
            if gain < tolerance {
                break;
            }
            damping *= 10.0;
        }
    }
    Some(Found { kernel: problem.kernel, theta: x, log_likelihood: now.value, evaluations })
}

/// The damped step (d + 1), zero where a parameter is held.
fn step(slopes: &Slopes, free: &[usize], damping: f64) -> Option<Vec<f64>> {
    let (p, k) = (slopes.gradient.len(), free.len());
    let mut matrix = vec![0.0; k * k];
    let mut s: Vec<f64> = free.iter().map(|i| slopes.gradient[*i]).collect();
    for (a, i) in free.iter().enumerate() {
        for (b, j) in free.iter().enumerate() {
            matrix[a * k + b] = slopes.information[i * p + j];
        }
        matrix[a * k + a] += damping * (slopes.information[i * p + i] + 1.0);
    }
    cholesky(&mut matrix, k).ok()?;
    solve_upper_transposed(&matrix, k, &mut s).ok()?;
    solve_upper(&matrix, k, &mut s).ok()?;
    let longest = norm_inf(&s);
    if longest > LONGEST {
        s.iter_mut().for_each(|s| *s *= LONGEST / longest);
    }
    let mut step = vec![0.0; p];
    free.iter().zip(&s).for_each(|(i, s)| step[*i] = *s);
    Some(step)
}

/// `g's - s'J s / 2`.
fn promised(slopes: &Slopes, s: &[f64]) -> f64 {
    let curved: f64 = slopes.information.chunks_exact(s.len()).zip(s).map(|(row, v)| v * dot(row, s)).sum();
    dot(&slopes.gradient, s) - 0.5 * curved
}
