//! A charge that adapts to the engine that is driven.
//!
//! What a model is identified from is one engine; engines of its kind breathe otherwise, and otherwise at each speed and load. One
//! factor ([`super::Trim`]) cannot follow that. With phi what the sensor must show by the identified charge (transport, mixing and lag are in
//! it) and lambda what it shows, ln(phi lambda) is the logarithm of the charge over the identified one at the speed and pressure of
//! the gas at the sensor, whatever the fuel has been: an estimate and no loop. It is taken as
//!
//! ```text
//! ln(phi lambda) = h' theta + e,    h = hats over speed and pressure at the gas, behind the lag of the sensor
//! theta ~ N(0, s^2 exp(-|x_i - x_j|^2 / 2))   over the nodes,    forgotten with the memory T:   d theta = -theta / T dt + noise
//! e of the size that the model leaves of its own records, as often independent as its correlation there says
//! ```
//!
//! and theta is followed by the recursion of R. E. Kalman (J. Basic Eng. 82, 1960). Distances are in half widths of the records: what is seen
//! at one point counts for its neighbours until these are seen themselves. Errors beyond three standard deviations count as three;
//! where they last, the engine has become another, and all is learnt anew from where it stands.
//! The adaptive tables of production ECUs learn at rest only, and each cell for itself.

use serde::{Deserialize, Serialize};

/// Nodes along speed and along pressure.
const ALONG: usize = 5;
const NODES: usize = ALONG * ALONG;
/// Most of the logarithm: a quarter more or less fuel, as sensors and injectors fail beyond.
const MOST: f64 = 0.223;
/// Standard deviations that an error counts at most.
const ROBUST: f64 = 3.0;
/// So many times the time between two independent errors may all be beyond that: one in a million of normal ones is by chance.
const LASTING: f64 = 4.0;
/// Lags of the sensor after which it shows nothing of what was before.
const LAGS: f64 = 5.0;
/// Time between two steps of forgetting in s.
const FORGET_S: f64 = 1.0;

/// How a charge adapts.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Adaptation {
    /// Standard deviation of the logarithm of the charge over the identified one, between engines of a kind.
    pub spread: f64,
    /// Time in s after which what was learnt and is not seen again counts no more.
    pub memory_s: f64,
}

impl Default for Adaptation {
    /// A tenth, as parts, sensors and injectors of a kind are apart together, and an hour.
    fn default() -> Self {
        Self { spread: 0.1, memory_s: 3600.0 }
    }
}

/// What a model leaves of its own records in ln(phi lambda).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Left {
    /// Standard deviation by the median of the size.
    pub scale: f64,
    /// Time between two independent errors: twice the integral of the autocorrelation, in s.
    pub apart_s: f64,
}

impl Left {
    /// Of the errors of records.
    pub(super) fn of(records: &[(Vec<f64>, usize)], dt_s: f64) -> Option<Self> {
        let mut sizes: Vec<f64> = records.iter().flat_map(|r| r.0.iter().map(|e| e.abs())).collect();
        sizes.sort_unstable_by(f64::total_cmp);
        // Median of the size of a normal variable over its standard deviation.
        let scale = (sizes.get(sizes.len() / 2)? / 0.6745).max(1e-6);
        let most = ROBUST * scale;
        let clipped: Vec<Vec<f64>> =
            records.iter().map(|r| r.0.iter().map(|e| e.clamp(-most, most)).collect()).collect();
        let at = |lag: usize| -> f64 {
            clipped.iter().map(|e| e.iter().zip(e.iter().skip(lag)).map(|(a, b)| a * b).sum::<f64>()).sum()
        };
        let (none, longest) = (at(0).max(f64::MIN_POSITIVE), sizes.len() / 4);
        // Up to the first lag at which errors agree no more: what is beyond is chance.
        let later: f64 = (1..longest).map(|lag| at(lag) / none).take_while(|r| *r > 0.05).sum();
        Some(Self { scale, apart_s: dt_s * (1.0 + 2.0 * later) })
    }
}

/// Weights of the nodes at a point in half widths of the records.
fn hats([n, p]: [f64; 2]) -> [(usize, f64); 4] {
    let along = |v: f64| {
        let x = 0.5 * (v.clamp(-1.0, 1.0) + 1.0) * (ALONG - 1) as f64;
        let k = (x as usize).min(ALONG - 2);
        (k, x - k as f64)
    };
    let ((i, a), (j, b)) = (along(n), along(p));
    let at = i * ALONG + j;
    [
        (at, (1.0 - a) * (1.0 - b)),
        (at + 1, (1.0 - a) * b),
        (at + ALONG, a * (1.0 - b)),
        (at + ALONG + 1, a * b),
    ]
}

/// What has been learnt.
#[derive(Clone, Debug)]
pub(super) struct AdaptState {
    law: Adaptation,
    left: Left,
    theta: [f64; NODES],
    /// Covariance, and that of before anything was seen.
    covariance: Vec<f64>,
    prior: Vec<f64>,
    /// Weights of the nodes in the gas of the volume on the way, and in what the sensor shows.
    mixed: [f64; NODES],
    shown: [f64; NODES],
    /// Time in s before the sensor shows what is known of, time for which errors have been beyond what is expected, and time since
    /// the last step of forgetting.
    blind_s: f64,
    beyond_s: f64,
    forgotten_s: f64,
}

impl AdaptState {
    pub(super) fn new(law: Adaptation, left: Left) -> Self {
        let place = |k: usize| {
            let along = |i: usize| 2.0 * i as f64 / (ALONG - 1) as f64 - 1.0;
            [along(k / ALONG), along(k % ALONG)]
        };
        let between = |i: usize, j: usize| {
            let ([a, b], [c, d]) = (place(i), place(j));
            law.spread.powi(2) * (-0.5 * ((a - c).powi(2) + (b - d).powi(2))).exp()
        };
        let prior: Vec<f64> = (0..NODES * NODES).map(|k| between(k / NODES, k % NODES)).collect();
        Self {
            law,
            left,
            theta: [0.0; NODES],
            covariance: prior.clone(),
            prior,
            mixed: [0.0; NODES],
            shown: [0.0; NODES],
            blind_s: f64::INFINITY,
            beyond_s: 0.0,
            forgotten_s: 0.0,
        }
    }

    /// Logarithm of the charge over the identified one at a point in half widths of the records.
    pub(super) fn at(&self, scaled: [f64; 2]) -> f64 {
        hats(scaled).iter().map(|(k, w)| w * self.theta[*k]).sum::<f64>().clamp(-MOST, MOST)
    }

    /// A transport and a lag in s are to go by before anything is learnt: what was before the first sample is not known.
    pub(super) fn begun(&mut self, delay_s: f64, lag_s: f64) {
        self.blind_s = delay_s + LAGS * lag_s;
    }

    /// The sensor moves on by the gas of these points, each with its share, through the lags of the volume and its own.
    pub(super) fn passed(&mut self, points: [([f64; 2], f64); 2], [mix, follow]: [f64; 2]) {
        self.mixed.iter_mut().for_each(|h| *h *= 1.0 - mix);
        for (scaled, share) in points {
            for (k, w) in hats(scaled) {
                self.mixed[k] += mix * share * w;
            }
        }
        for (h, m) in self.shown.iter_mut().zip(&self.mixed) {
            *h += follow * (m - *h);
        }
    }

    /// ln(phi lambda) is seen; gives what is not explained.
    pub(super) fn measured(&mut self, seen: f64, dt_s: f64) -> f64 {
        if self.blind_s > 0.0 {
            self.blind_s -= dt_s;
            return seen;
        }
        self.forgotten_s += dt_s;
        if self.forgotten_s >= FORGET_S {
            self.forget();
        }
        let h = &self.shown;
        let mut gain = [0.0; NODES];
        for (g, row) in gain.iter_mut().zip(self.covariance.chunks_exact(NODES)) {
            *g = row.iter().zip(h).map(|(c, h)| c * h).sum();
        }
        let known: f64 = gain.iter().zip(h).map(|(g, h)| g * h).sum::<f64>().max(0.0);
        let noise = self.left.scale.powi(2);
        let error = seen - self.theta.iter().zip(h).map(|(t, h)| t * h).sum::<f64>();
        let most = ROBUST * (known + noise).sqrt();
        self.beyond_s = if error.abs() > most { self.beyond_s + dt_s } else { 0.0 };
        if self.beyond_s > LASTING * self.left.apart_s.max(dt_s) {
            self.beyond_s = 0.0;
            self.covariance.copy_from_slice(&self.prior);
        }
        let per = 1.0 / (known + noise * (self.left.apart_s / dt_s).max(1.0));
        for (t, g) in self.theta.iter_mut().zip(&gain) {
            *t += per * g * error.clamp(-most, most);
        }
        for (row, a) in self.covariance.chunks_exact_mut(NODES).zip(&gain) {
            for (c, b) in row.iter_mut().zip(&gain) {
                *c -= per * a * b;
            }
        }
        error
    }

    fn forget(&mut self) {
        let keep = (-self.forgotten_s / self.law.memory_s).exp();
        self.forgotten_s = 0.0;
        self.theta.iter_mut().for_each(|t| *t *= keep);
        for (c, p) in self.covariance.iter_mut().zip(&self.prior) {
            *c = keep * keep * *c + (1.0 - keep * keep) * p;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dynocal_numerics::rng::Rng64;

    fn surface([n, p]: [f64; 2]) -> f64 {
        0.05 + 0.03 * n - 0.06 * p + 0.02 * n * p
    }

    /// Held points of an engine that is a surface apart: seen ones are known to a fraction of the noise, and what was not seen for sixty
    /// memories is as before.
    #[test]
    fn a_surface_is_learnt_where_it_is_seen_and_forgotten() {
        let law = Adaptation { spread: 0.1, memory_s: 10_000.0 };
        let mut state = AdaptState::new(law, Left { scale: 0.01, apart_s: 0.02 });
        let mut rng = Rng64::stream(3, 0);
        let mut at = [0.0; 2];
        for t in 0..20_000 {
            if t % 200 == 0 {
                // The upper right quarter is never seen.
                at = [rng.uniform_in(-1.0, 1.0), rng.uniform_in(-1.0, 1.0)];
                if at[0] > 0.2 && at[1] > 0.2 {
                    at = [-at[0], at[1]];
                }
            }
            state.blind_s = 0.0;
            state.passed([(at, 0.5), (at, 0.5)], [1.0, 0.2]);
            state.measured(surface(at) + 0.01 * rng.normal(), 0.02);
        }
        for seen in [[-0.5, -0.5], [0.0, 0.0], [0.7, -0.6], [-0.8, 0.7]] {
            assert!(
                (state.at(seen) - surface(seen)).abs() < 6e-3,
                "{seen:?}: {}",
                state.at(seen) - surface(seen)
            );
        }
        let unseen = [0.9, 0.9];
        // Neighbours say something of it.
        assert!(
            (state.at(unseen) - surface(unseen)).abs() < 0.6 * surface([1.0, -1.0]),
            "{}",
            state.at(unseen)
        );
        let (least, most) = (0..NODES).fold((f64::INFINITY, 0.0_f64), |(l, m), k| {
            let v = state.covariance[k * NODES + k];
            (l.min(v), m.max(v))
        });
        assert!(least > 0.0 && most <= 0.0100001, "{least} {most}");
        for _ in 0..60 {
            state.forgotten_s = law.memory_s;
            state.forget();
        }
        assert!(state.at([0.0, 0.0]).abs() < 1e-12);
        assert!(state.covariance.iter().zip(&state.prior).all(|(c, p)| (c - p).abs() < 1e-12));
    }

    /// One sample of nonsense moves it by three standard deviations at most, values that are no number not at all.
    #[test]
    fn a_sensor_that_fails_for_a_sample_is_survived() {
        let mut state = AdaptState::new(Adaptation::default(), Left { scale: 0.005, apart_s: 0.1 });
        state.begun(0.0, 0.0);
        for _ in 0..500 {
            state.passed([([0.0, 0.0], 1.0), ([0.0, 0.0], 0.0)], [1.0, 0.3]);
            state.measured(0.03, 0.02);
        }
        let before = state.at([0.0, 0.0]);
        state.measured(-3.0, 0.02);
        assert!((before - 0.03).abs() < 5e-4 && (state.at([0.0, 0.0]) - before).abs() < 1e-3, "{before}");
        // An error that lasts is another engine.
        for _ in 0..200 {
            state.measured(-0.1, 0.02);
        }
        assert!((state.at([0.0, 0.0]) + 0.1).abs() < 2e-3, "{}", state.at([0.0, 0.0]));
    }

    /// White errors are apart by a sample, those of a lag of T by 2 T.
    #[test]
    fn errors_are_as_often_independent_as_they_are() {
        let mut rng = Rng64::stream(4, 0);
        let white: Vec<f64> = (0..20_000).map(|_| 0.01 * rng.normal()).collect();
        let mut last = 0.0;
        let keep = (-0.02_f64 / 0.5).exp();
        let slow: Vec<f64> = (0..60_000)
            .map(|_| {
                last = keep * last + (1.0 - keep * keep).sqrt() * 0.01 * rng.normal();
                last
            })
            .collect();
        let white = Left::of(&[(white, 0)], 0.02).unwrap();
        let slow = Left::of(&[(slow, 0)], 0.02).unwrap();
        assert!((white.scale / 0.01 - 1.0).abs() < 0.03 && white.apart_s < 0.021, "{white:?}");
        assert!((slow.scale / 0.01 - 1.0).abs() < 0.15 && (slow.apart_s - 1.0).abs() < 0.25, "{slow:?}");
    }
}
