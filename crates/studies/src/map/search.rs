//! Direct search on a ground that is slow to try: a surrogate proposes, the ground decides, and a pattern of steps says when it ends.
//!
//! ```text
//! surrogate   v(u) = expected(u) + c(u)     v: what is minimised, then by how much each limit is passed
//!             c: quadratic about the best point so far, by ridge regression of what was tried less what was expected
//! propose     least cost of the surrogate in a box about the best point; taken where the ground is better there, else the box is halved
//! end         no input by itself, up or down by a step of the pattern, is better on the ground
//! ```
//!
//! What is expected only saves trials: it never decides, and a search whose expectations are wrong ends where one without them does.

use dynocal_design::points::Sobol;
use dynocal_numerics::linalg::{axpy, cholesky, dot, solve_upper, solve_upper_transposed};

/// What is searched, over shares of the ranges of its inputs.
pub(super) trait Ground {
    /// What is minimised at a setting, then by how much each limit is passed in shares of its size; none where it cannot be held.
    fn hold(&mut self, u: &[f64]) -> Result<Option<Vec<f64>>, String>;
    /// What is expected of the same.
    fn expected(&self, u: &[f64]) -> Vec<f64>;
}

/// Where a search ended.
pub(super) struct Found {
    /// Setting.
    pub(super) u: Vec<f64>,
    /// Settings that were held.
    pub(super) tried: usize,
}

/// Most settings of one search.
const MOST: usize = 160;
/// Half width of the first box, of the widest and of the least.
const BOX: [f64; 3] = [0.16, 0.32, 0.02];
/// Steps of the pattern.
const PATTERN: [f64; 2] = [0.08, 0.02];
/// Share of the cost that counts as better: what a point that is held again differs by.
const BETTER: f64 = 1e-4;
/// What passing a limit by all of its size costs, as a multiple of what is minimised.
const PENALTY: f64 = 20.0;
/// Distance about the best point within which the quadratic is trusted, and its ridge.
const NEAR: f64 = 0.3;
const RIDGE: f64 = 1e-3;
/// Points that the descent of the surrogate scatters about its best at once, and within which shares of the box.
const SCATTERED: usize = 64;
const DESCENT: [f64; 5] = [1.0, 0.5, 0.2, 0.08, 0.03];

/// What is minimised, with what passing limits costs.
pub(super) fn cost(values: &[f64]) -> f64 {
    let over: f64 = values[1..].iter().map(|v| v.max(0.0)).sum();
    values[0] * (1.0 + PENALTY * over)
}

struct Tried {
    u: Vec<f64>,
    cost: f64,
    /// What was found less what was expected.
    missed: Vec<f64>,
}

/// Searches from the best of `starts`. None where none of them can be held.
pub(super) fn search(ground: &mut dyn Ground, starts: &[Vec<f64>]) -> Result<Option<Found>, String> {
    let mut way = Way { ground, tried: Vec::new(), asked: Vec::new(), best: 0 };
    for u in starts {
        way.hold(u)?;
    }
    if way.tried.is_empty() {
        return Ok(None);
    }
    let mut width = BOX[0];
    while way.asked.len() < MOST {
        if width >= BOX[2] {
            let u = way.proposed(width);
            let gone = apart(&u, &way.tried[way.best].u);
            width = if gone < 0.1 * BOX[2] {
                0.0
            } else if way.hold(&u)? {
                if gone > 0.9 * width { (2.0 * width).min(BOX[1]) } else { width }
            } else {
                0.5 * width
            };
            continue;
        }
        match way.pattern()? {
            Some(step) => width = 2.0 * step,
            None => break,
        }
    }
    let best = &way.tried[way.best];
    Ok(Some(Found { u: best.u.clone(), tried: way.asked.len() }))
}

struct Way<'a> {
    ground: &'a mut dyn Ground,
    tried: Vec<Tried>,
    /// All that was asked for, what could not be held among it.
    asked: Vec<Vec<f64>>,
    best: usize,
}

/// Largest difference of an input.
fn apart(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

impl Way<'_> {
    /// Holds a setting; whether it is the best so far.
    fn hold(&mut self, u: &[f64]) -> Result<bool, String> {
        if self.asked.iter().any(|a| apart(a, u) < 1e-6) {
            return Ok(false);
        }
        self.asked.push(u.to_vec());
        let Some(values) = self.ground.hold(u)? else { return Ok(false) };
        let missed = values.iter().zip(self.ground.expected(u)).map(|(v, e)| v - e).collect();
        let cost = cost(&values);
        if !cost.is_finite() {
            return Ok(false);
        }
        self.tried.push(Tried { u: u.to_vec(), cost, missed });
        let last = self.tried.len() - 1;
        let better = last > 0 && cost < self.tried[self.best].cost * (1.0 - BETTER);
        if better {
            self.best = last;
        }
        Ok(better)
    }

    /// One input after the other up and down about the best point; the step that was better.
    fn pattern(&mut self) -> Result<Option<f64>, String> {
        let middle = self.tried[self.best].u.clone();
        for step in PATTERN {
            for i in 0..middle.len() {
                for sign in [1.0, -1.0] {
                    let mut u = middle.clone();
                    u[i] = (u[i] + sign * step).clamp(0.0, 1.0);
                    if self.asked.len() < MOST && self.hold(&u)? {
                        return Ok(Some(step));
                    }
                }
            }
        }
        Ok(None)
    }

    /// Least cost of the surrogate in the box about the best point.
    fn proposed(&self, width: f64) -> Vec<f64> {
        let middle = &self.tried[self.best].u;
        let surrogate = Surrogate::of(&self.tried, middle);
        let within = |u: &[f64]| -> Vec<f64> {
            u.iter().zip(middle).map(|(u, m)| u.clamp(m - width, m + width).clamp(0.0, 1.0)).collect()
        };
        let value = |u: &[f64]| cost(&surrogate.at(&*self.ground, u));
        let mut best = (value(middle), middle.clone());
        let Some(mut sequence) = Sobol::new(middle.len(), self.tried.len() as u64) else { return best.1 };
        // Scattered points, not one input after the other: along a limit two inputs have to move at once.
        for share in DESCENT {
            let mut moved = true;
            while moved {
                moved = false;
                let about = best.1.clone();
                for _ in 0..SCATTERED {
                    let shares = sequence.next_point();
                    let u = about.iter().zip(shares).map(|(m, s)| m + share * width * (2.0 * s - 1.0));
                    let u = within(&u.collect::<Vec<f64>>());
                    let v = value(&u);
                    // Steps that gain nothing do not go on for ever.
                    if v < best.0 - 1e-6 * best.0.abs() {
                        (best, moved) = ((v, u), true);
                    }
                }
            }
        }
        best.1
    }
}

/// What is expected, corrected by a quadratic through what was tried: kernel (1 + a'b / r^2)^2, ridge wider with the distance.
struct Surrogate<'a> {
    tried: &'a [Tried],
    middle: &'a [f64],
    /// Weights of the points, those of a value one after the other.
    weights: Vec<Vec<f64>>,
}

impl<'a> Surrogate<'a> {
    fn of(tried: &'a [Tried], middle: &'a [f64]) -> Self {
        let n = tried.len();
        let mut new = Self { tried, middle, weights: Vec::new() };
        let mut matrix: Vec<f64> = (0..n * n).map(|k| new.kernel(&tried[k / n].u, &tried[k % n].u)).collect();
        for (i, t) in tried.iter().enumerate() {
            let away = dot(&new.centred(&t.u), &new.centred(&t.u));
            matrix[i * n + i] += RIDGE * (1.0 + away).powi(2);
        }
        if cholesky(&mut matrix, n).is_err() {
            return new;
        }
        for v in 0..tried[0].missed.len() {
            let mut w: Vec<f64> = tried.iter().map(|t| t.missed[v]).collect();
            let solved =
                solve_upper_transposed(&matrix, n, &mut w).and_then(|()| solve_upper(&matrix, n, &mut w));
            if solved.is_err() {
                w.fill(0.0);
            }
            new.weights.push(w);
        }
        new
    }

    fn centred(&self, u: &[f64]) -> Vec<f64> {
        u.iter().zip(self.middle).map(|(u, m)| (u - m) / NEAR).collect()
    }

    fn kernel(&self, a: &[f64], b: &[f64]) -> f64 {
        (1.0 + dot(&self.centred(a), &self.centred(b))).powi(2)
    }

    fn at(&self, ground: &dyn Ground, u: &[f64]) -> Vec<f64> {
        let mut values = ground.expected(u);
        let kernel: Vec<f64> = self.tried.iter().map(|t| self.kernel(u, &t.u)).collect();
        let mut correction = vec![0.0; self.weights.len()];
        for (c, w) in correction.iter_mut().zip(&self.weights) {
            *c = dot(&kernel, w);
        }
        axpy(1.0, &correction, &mut values[..correction.len()]);
        values
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A valley in four inputs that is turned against them, with a limit that cuts it, and expectations that err by `wrong`.
    struct Valley {
        wrong: f64,
        refuses: bool,
    }

    impl Valley {
        fn values(u: &[f64]) -> Vec<f64> {
            let a = [u[0] - 0.7, u[1] - 0.4, u[2] - 0.3, u[3] - 0.9];
            let turned = [a[0] + a[1], a[0] - a[1], a[2] + 0.5 * a[3], a[3]];
            let fuel =
                5.0 * (1.0 + turned.iter().zip([0.3, 0.05, 0.2, 0.1]).map(|(t, w)| w * t * t).sum::<f64>());
            vec![fuel, (0.9 * u[0] + 0.3 * u[2] - 0.6) / 0.6]
        }
    }

    impl Ground for Valley {
        fn hold(&mut self, u: &[f64]) -> Result<Option<Vec<f64>>, String> {
            Ok((!self.refuses || u[3] < 0.8).then(|| Self::values(u)))
        }
        fn expected(&self, u: &[f64]) -> Vec<f64> {
            let mut v = Self::values(u);
            v[0] += self.wrong * (u[0] * u[1] - u[2] + 0.5 * u[3] * u[3]);
            v[1] += self.wrong * 0.1 * (u[3] - u[0]);
            v
        }
    }

    /// Least cost on a fine random scatter about the end, and the end's own.
    fn beaten(u: &[f64], most: f64) -> (f64, f64) {
        let mut sequence = Sobol::new(4, 5).unwrap();
        let near = (0..4000).map(|_| sequence.next_point());
        let near = near.map(|s| {
            u.iter().zip(s).map(|(u, s)| (u + 0.1 * (s - 0.5)).clamp(0.0, 1.0)).collect::<Vec<f64>>()
        });
        let least =
            near.filter(|u| u[3] < most).map(|u| cost(&Valley::values(&u))).fold(f64::INFINITY, f64::min);
        (least, cost(&Valley::values(u)))
    }

    /// Whatever is expected, the end is a valley of the ground; good expectations make it cheap.
    #[test]
    fn wrong_expectations_cost_trials_and_not_the_optimum() {
        let start = vec![vec![0.3, 0.8, 0.7, 0.2]];
        let mut tried = Vec::new();
        for wrong in [0.0, 0.2, -2.0] {
            let found = search(&mut Valley { wrong, refuses: false }, &start).unwrap().unwrap();
            let (least, own) = beaten(&found.u, 2.0);
            assert!(own < least * 1.0005, "{wrong}: {own} against {least}");
            tried.push(found.tried);
        }
        assert!(tried[0] <= 40 && tried.iter().all(|t| *t < MOST), "{tried:?}");
    }

    /// Settings that cannot be held are walked around; where none can be held there is no end.
    #[test]
    fn what_cannot_be_held_is_no_optimum() {
        let mut valley = Valley { wrong: 0.1, refuses: true };
        let found = search(&mut valley, &[vec![0.3, 0.8, 0.7, 0.2]]).unwrap().unwrap();
        let (least, own) = beaten(&found.u, 0.8);
        assert!(found.u[3] < 0.8 && own < least * 1.003, "{own} against {least}");
        assert!(search(&mut valley, &[vec![0.5, 0.5, 0.5, 0.9]]).unwrap().is_none());
    }
}
