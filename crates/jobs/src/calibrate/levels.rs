//! Levels of which every next one tells most: sequential Bayesian I-optimality over what channels are and were.
//!
//! ```text
//! z_k = (x_k, x_(k-1), g_k)                     levels of hold k and of the one before it, given channels, all on -1 .. 1
//! f(z)                                          products of up to three of them, at powers up to three
//! M_k = K + sum_(i <= k) f(z_i) f(z_i)'         K: 0 for the constant and straight lines, 1 for what may be needed
//! x_k = argmin over candidates of tr(M_k^-1 W)  W: mean of f f' over points as random levels give them
//! ```
//!
//! The model that will be fitted is not known yet, so that all terms up to the third degree may be needed: their coefficients have a
//! prior of the size of the noise of a hold (potential terms: W. DuMouchel, B. Jones, Technometrics 36 (1994), 37-47; theirs are made
//! orthogonal to the terms that are needed anyway, these are not: what both explain is then left to the straight lines). One more hold
//! takes `f' M^-1 W M^-1 f / (1 + f' M^-1 f)` off the criterion (Sherman and Morrison).

use dynocal_numerics::rng::Rng64;

/// Most candidates of a hold, and points that say what is asked for.
const CANDIDATES: usize = 128;
const ASKED: usize = 1500;
/// Precision of a term that is needed anyway: nothing is known of it.
const NEEDED: f64 = 1e-6;

/// Records drawn one after the other, each aware of the earlier ones.
pub(super) struct Telling {
    moved: usize,
    levels: usize,
    terms: Vec<[usize; 3]>,
    /// M^-1 and W (p x p).
    inverse: Vec<f64>,
    asked: Vec<f64>,
}

impl Telling {
    /// Of `moved` channels with `levels` equidistant levels and `given` further ones that go evenly through their range.
    pub(super) fn new(moved: usize, given: usize, levels: usize, rng: &mut Rng64) -> Self {
        let n = 2 * moved + given;
        let terms = terms(n);
        let p = terms.len();
        let mut inverse = vec![0.0; p * p];
        for (k, t) in terms.iter().enumerate() {
            let degree = t.iter().filter(|c| **c < n).count();
            inverse[k * p + k] = if degree < 2 { 1.0 / NEEDED } else { 1.0 };
        }
        let mut out = Self { moved, levels, terms, inverse, asked: vec![0.0; p * p] };
        for _ in 0..ASKED {
            let before = first(moved, levels, rng);
            let now = next(&before, levels, rng);
            let given: Vec<f64> = (0..given).map(|_| 2.0 * rng.uniform() - 1.0).collect();
            let f = out.regressors(&[now, before, given].concat());
            for (row, a) in out.asked.chunks_exact_mut(p).zip(&f) {
                row.iter_mut().zip(&f).for_each(|(w, b)| *w += a * b / ASKED as f64);
            }
        }
        out
    }

    fn regressors(&self, z: &[f64]) -> Vec<f64> {
        let at = |c: usize| z.get(c).copied().unwrap_or(1.0);
        self.terms.iter().map(|[a, b, c]| at(*a) * at(*b) * at(*c)).collect()
    }

    /// Levels (holds x channels, on 0 .. 1) of a record with the given channels `given` (holds x given, on 0 .. 1). Of the first hold
    /// the one before is the same: a record begins at rest.
    pub(super) fn record(&mut self, given: &[Vec<f64>], rng: &mut Rng64) -> Vec<Vec<f64>> {
        let mut before: Option<Vec<f64>> = None;
        let mut levels = Vec::with_capacity(given.len());
        for g in given {
            let g: Vec<f64> = g.iter().map(|v| 2.0 * v - 1.0).collect();
            let mut best: Option<(f64, Vec<f64>, Vec<f64>)> = None;
            for _ in 0..CANDIDATES {
                let now = match &before {
                    Some(before) => other(before, self.levels, rng),
                    None => first(self.moved, self.levels, rng),
                };
                let f = self.regressors(&[&now[..], before.as_ref().unwrap_or(&now), &g].concat());
                let seen = product(&self.inverse, &f);
                let gain = dot(&seen, &product(&self.asked, &seen)) / (1.0 + dot(&f, &seen));
                if best.as_ref().is_none_or(|b| gain > b.0) {
                    best = Some((gain, now, seen));
                }
            }
            let Some((_, now, seen)) = best else { break };
            self.add(&now, before.as_ref().unwrap_or(&now), &g, &seen);
            levels.push(now.iter().map(|x| 0.5 * (x + 1.0)).collect());
            before = Some(now);
        }
        levels
    }

    /// A hold that was measured already: levels of it and of the one before, given channels, all on 0 .. 1.
    pub(super) fn know(&mut self, now: &[f64], before: &[f64], given: &[f64]) {
        // Loops pass their demands by a little; far outside a cube says too much.
        let scaled = |v: &[f64]| v.iter().map(|x| (2.0 * x - 1.0).clamp(-1.0, 1.0)).collect::<Vec<f64>>();
        let (now, before, given) = (scaled(now), scaled(before), scaled(given));
        let seen = product(&self.inverse, &self.regressors(&[&now[..], &before, &given].concat()));
        self.add(&now, &before, &given, &seen);
    }

    /// One more hold; `seen` is M^-1 f.
    fn add(&mut self, now: &[f64], before: &[f64], g: &[f64], seen: &[f64]) {
        let f = self.regressors(&[now, before, g].concat());
        let scale = 1.0 / (1.0 + dot(&f, seen));
        for (row, a) in self.inverse.chunks_exact_mut(seen.len()).zip(seen) {
            row.iter_mut().zip(seen).for_each(|(m, b)| *m -= scale * a * b);
        }
    }

    /// tr(M^-1 W).
    #[cfg(test)]
    fn criterion(&self) -> f64 {
        dot(&self.inverse, &self.asked)
    }
}

/// Most terms: beyond, the time of a hold and the memory, both of their square, are felt.
const MOST_TERMS: usize = 2000;

/// Terms of `n` coordinates up to degree three, or two where these would be too many. Coordinate n is the constant 1.
fn terms(n: usize) -> Vec<[usize; 3]> {
    let mut all = Vec::new();
    for a in 0..=n {
        for b in a..=n {
            all.extend((b..=n).map(|c| [a, b, c]));
        }
    }
    if all.len() > MOST_TERMS {
        all.retain(|t| t[2] == n);
    }
    all
}

fn product(m: &[f64], x: &[f64]) -> Vec<f64> {
    m.chunks_exact(x.len()).map(|row| dot(row, x)).collect()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Levels on -1 .. 1.
fn first(moved: usize, levels: usize, rng: &mut Rng64) -> Vec<f64> {
    (0..moved).map(|_| level(rng.below(levels), levels)).collect()
}

fn level(k: usize, levels: usize) -> f64 {
    2.0 * k as f64 / (levels - 1) as f64 - 1.0
}

/// Any level of every channel, but not those of all as they were.
fn other(before: &[f64], levels: usize, rng: &mut Rng64) -> Vec<f64> {
    loop {
        let now = first(before.len(), levels, rng);
        if now.iter().zip(before).any(|(a, b)| a != b) {
            return now;
        }
    }
}

/// Another level of every channel, all others equally likely, as random levels are drawn.
fn next(before: &[f64], levels: usize, rng: &mut Rng64) -> Vec<f64> {
    let place = |b: &f64| (0.5 * (b + 1.0) * (levels - 1) as f64).round() as usize;
    before.iter().map(|b| level((place(b) + 1 + rng.below(levels - 1)) % levels, levels)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn holds_that_are_chosen_tell_more_than_random_ones() {
        let (moved, levels) = (2, 5);
        for seed in 0..5 {
            let mut rng = Rng64::new(seed);
            let mut own = Telling::new(moved, 1, levels, &mut rng);
            let mut random = Telling::new(moved, 1, levels, &mut Rng64::new(seed));
            let given: Vec<Vec<f64>> = (0..40).map(|k| vec![(k % 7) as f64 / 6.0]).collect();
            own.record(&given, &mut rng);
            let mut before = first(moved, levels, &mut rng);
            for g in &given {
                let now = next(&before, levels, &mut rng);
                let share = |v: &[f64]| v.iter().map(|x| 0.5 * (x + 1.0)).collect::<Vec<f64>>();
                random.know(&share(&now), &share(&before), g);
                before = now;
            }
            assert!(
                own.criterion() < 0.8 * random.criterion(),
                "{seed}: {} {}",
                own.criterion(),
                random.criterion()
            );
        }
    }

    /// What is kept through the holds, chosen and known ones, is the inverse of the information of them all.
    #[test]
    fn the_inverse_is_that_of_the_information() {
        let mut rng = Rng64::new(3);
        let mut own = Telling::new(1, 1, 5, &mut rng);
        let p = own.terms.len();
        let mut information = vec![0.0; p * p];
        (0..p).for_each(|k| information[k * p + k] = 1.0 / own.inverse[k * p + k]);
        let mut holds = vec![([0.2], [0.7], [0.4]), ([0.9], [0.2], [0.1])];
        for (now, before, given) in &holds {
            own.know(now, before, given);
        }
        let given: Vec<Vec<f64>> = (0..12).map(|k| vec![f64::from(k) / 11.0]).collect();
        let mut before = None::<f64>;
        for (x, g) in own.record(&given, &mut rng).iter().zip(&given) {
            holds.push(([x[0]], [before.unwrap_or(x[0])], [g[0]]));
            before = Some(x[0]);
        }
        for (now, before, given) in &holds {
            let f = own.regressors(&[now[0], before[0], given[0]].map(|x| 2.0 * x - 1.0));
            for i in 0..p {
                (0..p).for_each(|j| information[i * p + j] += f[i] * f[j]);
            }
        }
        for i in 0..p {
            for j in 0..p {
                let column: Vec<f64> = (0..p).map(|k| own.inverse[k * p + j]).collect();
                let unit = dot(&information[i * p..(i + 1) * p], &column);
                assert!((unit - f64::from(u8::from(i == j))).abs() < 1e-6, "{i} {j}: {unit}");
            }
        }
    }

    /// Channels move apart from each other even where each has two levels, and never all stand still.
    #[test]
    fn two_levels_are_enough_to_tell_channels_apart() {
        let mut rng = Rng64::new(5);
        let record = Telling::new(2, 1, 2, &mut rng).record(&vec![vec![0.3]; 30], &mut rng);
        assert!(record.windows(2).all(|w| w[0] != w[1]));
        let corner = |x: &Vec<f64>| 2 * (x[0] > 0.5) as usize + (x[1] > 0.5) as usize;
        let mut seen = [0; 4];
        record.iter().for_each(|x| seen[corner(x)] += 1);
        assert!(seen.iter().filter(|n| **n > 1).count() > 2, "{seen:?}");
    }

    #[test]
    fn terms_are_those_of_a_polynomial() {
        // (n + 3 choose 3), and (n + 2 choose 2) where that is too many.
        assert_eq!(terms(7).len(), 120);
        assert_eq!(terms(30).len(), 496);
    }
}
