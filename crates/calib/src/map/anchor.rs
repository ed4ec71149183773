//! Moves the part of a map that holds at rest onto points that were measured at rest.
//!
//! ```text
//! u_i - u(r_i) = sum_k d_k phi_k(T_i, N_i)          by least squares with a ridge, for every actuator
//! ```
//!
//! phi: the static terms of the leading demand T and the given channels N ([`super::structured::terms`]). Of the ridges of a
//! grid that one is taken which predicts each point best from the others; where none of them predicts better than no
//! correction at all, there is none. That is the refinement of thesis 7.8.2 with the steady part of (7.34).

use super::SteadyPoint;
use super::structured::terms::{self, Factor, Scale, Term};
use dynocal_numerics::linalg;

/// Powers of ten of the ridge per point that are compared, the largest first.
const POWERS: std::ops::RangeInclusive<i32> = -8..=0;

/// Places of the terms that speak at rest and do not read demands but the leading one.
pub(super) fn at_rest(terms: &[Term], demands: usize) -> Vec<usize> {
    let plain = |f: &Factor| match *f {
        Factor::Plain(r) | Factor::Inverse(r) => r == 0 || r >= demands,
    };
    let rests = |t: &Term| t.difference.is_none() && t.factors.iter().all(plain);
    (0..terms.len()).filter(|k| rests(&terms[*k])).collect()
}

/// What moves a map onto points.
pub(super) struct Moved {
    /// Coefficients of the terms by actuator; zeros where it is better to stay.
    pub(super) coefficients: Vec<Vec<f64>>,
    /// What is missed of each point by actuator, each predicted by the others; by the map as it is where that stays.
    pub(super) missed: Vec<Vec<f64>>,
}

/// Coefficients of `terms` for every actuator that move `predicted` onto the points; none where points left out say that it is
/// better to stay, for every actuator, or there are no more points than terms.
pub(super) fn correction(
    terms: &[Term],
    scales: &[Scale],
    points: &[SteadyPoint],
    predicted: impl Fn(&[f64]) -> Vec<f64>,
) -> Option<Moved> {
    let (n, p) = (points.len(), terms.len());
    let actuators = points.first()?.actuators.len();
    if n <= p {
        return None;
    }
    let (mut x, mut row) = (Vec::with_capacity(n * p), Vec::new());
    for point in points {
        terms::values(terms, scales, |r, _| point.reference[r], &mut row);
        x.extend_from_slice(&row);
    }
    let at: Vec<Vec<f64>> = points.iter().map(|q| predicted(&q.reference)).collect();
    let (mut coefficients, mut missed, mut any) = (Vec::new(), Vec::new(), false);
    for c in 0..actuators {
        let y: Vec<f64> = points.iter().zip(&at).map(|(q, u)| q.actuators[c] - u[c]).collect();
        let mut best = (squares(&y), None);
        for power in POWERS.rev() {
            let ridge = 10f64.powi(power);
            let left = left_out(&x, p, &y, ridge);
            let sum = squares(&left);
            if sum < best.0 {
                best = (sum, Some((ridge, left)));
            }
        }
        let fit = best.1.and_then(|(ridge, left)| {
            let fit = linalg::least_squares(&x, n, p, &y, ridge * n as f64).ok()?;
            fit.x.iter().all(|v| v.is_finite()).then_some((fit.x, left))
        });
        any |= fit.is_some();
        let (own, left) = fit.unwrap_or_else(|| (vec![0.0; p], y));
        coefficients.push(own);
        missed.push(left);
    }
    any.then_some(Moved { coefficients, missed })
}

/// Sum of squares; infinite where one is no number.
fn squares(v: &[f64]) -> f64 {
    let sum: f64 = v.iter().map(|e| e * e).sum();
    if sum.is_nan() { f64::INFINITY } else { sum }
}

/// Errors of all points, each predicted by the others; infinite where they do not determine it.
fn left_out(x: &[f64], p: usize, y: &[f64], ridge: f64) -> Vec<f64> {
    let n = y.len();
    let one = |k: usize| {
        let rows: Vec<f64> = [&x[..k * p], &x[(k + 1) * p..]].concat();
        let rest: Vec<f64> = [&y[..k], &y[k + 1..]].concat();
        match linalg::least_squares(&rows, n - 1, p, &rest, ridge * (n - 1) as f64) {
            Ok(fit) => y[k] - linalg::dot(&x[k * p..(k + 1) * p], &fit.x),
            Err(_) => f64::INFINITY,
        }
    };
    (0..n).map(one).collect()
}

#[cfg(test)]
mod tests {
    use super::super::{Port, Ports};
    use super::*;
    use dynocal_numerics::interval::Interval;

    fn of_thesis() -> (Vec<Term>, Vec<Scale>) {
        let port = |name: &str| Port { name: name.into(), unit: "-".into() };
        let ports = Ports {
            demands: vec![port("torque"), port("lambda")],
            given: vec![port("speed")],
            actuators: Vec::new(),
        };
        let scales: Vec<Scale> =
            [(10.0, 90.0), (0.9, 1.1), (1000.0, 3000.0)].map(|r| Scale::of_range(Interval::from(r))).into();
        let all = terms::terms(&ports, &scales, &Default::default());
        let own = at_rest(&all, 2);
        (own.iter().map(|k| all[*k].clone()).collect(), scales)
    }

    fn points(u: impl Fn(f64, f64, usize) -> Vec<f64>) -> Vec<SteadyPoint> {
        let (torque, speed) = ([15.0, 32.0, 50.0, 68.0, 85.0], [1100.0, 1550.0, 2000.0, 2450.0, 2900.0]);
        let at = |k: usize| (torque[k / 5], speed[k % 5]);
        (0..25)
            .map(|k| SteadyPoint {
                reference: vec![at(k).0, 1.0, at(k).1],
                actuators: u(at(k).0, at(k).1, k),
            })
            .collect()
    }

    /// A miss that lies in the terms is taken away between the points as well.
    #[test]
    fn a_miss_of_the_terms_is_taken_away_everywhere() {
        let (terms, scales) = of_thesis();
        assert_eq!(terms.len(), 12);
        let miss = |t: f64, n: f64| 0.4 - 0.01 * t + 120.0 / n + 1e-7 * t * t * n;
        let points = points(|t, n, _| vec![miss(t, n), 0.0]);
        let Moved { coefficients: moved, missed } =
            correction(&terms, &scales, &points, |_| vec![0.0, 0.0]).unwrap();
        assert!(missed[0].iter().all(|e| e.abs() < 1e-3) && missed[1].iter().all(|e| *e == 0.0));
        let mut row = Vec::new();
        for (t, n) in [(20.0, 1300.0), (60.0, 2700.0), (44.0, 1800.0)] {
            terms::values(&terms, &scales, |r, _| [t, 1.0, n][r], &mut row);
            let got = linalg::dot(&row, &moved[0]);
            assert!((got - miss(t, n)).abs() < 1e-4, "{t} {n}: {got} {}", miss(t, n));
        }
        assert!(moved[1].iter().all(|v| *v == 0.0));
    }

    /// What no other point confirms moves nothing.
    #[test]
    fn scatter_moves_nothing() {
        let (terms, scales) = of_thesis();
        let sign = |k: usize| if k.is_multiple_of(2) { 1.0 } else { -1.0 };
        let points = points(|_, _, k| vec![sign(k)]);
        assert!(correction(&terms, &scales, &points, |_| vec![0.0]).is_none());
        assert!(correction(&terms, &scales, &[], |_| vec![0.0]).is_none());
    }
}
