//! Slow trim by the lambda sensor that transients do not spoil.
//!
//! What the sensor must show of the fuel that was injected is known from the model, with transport, mixing and lag (the predictor of
//! O. J. M. Smith, Chem. Eng. Progress 53, 1957, 217-219). With phi that prediction by the identified charge, without any trim, and
//! lambda what is measured, phi lambda is the charge over the identified one, whatever the trim has been: an estimate without a
//! loop, which no gain makes unstable as long as delays are right. Its logarithm k is followed by
//!
//! ```text
//! dk/dt = s asinh((ln(phi lambda) - k) / s) / T
//! ```
//!
//! with s the usual size of what the model leaves of the record, so that a moment that the model does not know moves k little.
//! T is the one of a row for which k of the record's past says most of what the charge in the cylinder lacks now.

use super::Fuelling;
use super::adapt::{AdaptState, Adaptation, Left};
use super::coolant::Air;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Time constants that are tried, in s: twice the one before.
const LEAST_S: f64 = 0.1;
const TRIED: usize = 9;
/// Most of the trim: a quarter more or less fuel, as sensors and injectors fail beyond.
const MOST: f64 = 0.223;
/// Cycles after one without fuel whose gas tells nothing of the charge: residual gas is air, and half of it goes in each. The lag of the
/// sensor is within them.
const CLEAN_CYCLES: f64 = 10.0;
/// Time constants of the volume on the way that are waited for besides: less than a hundredth of its gas is of the cut then.
const CLEAN_LAGS: f64 = 5.0;
/// Longest delay that is followed, in s.
const DELAY_S: f64 = 2.0;

/// How the trim follows.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Trim {
    /// Time constant T in s.
    pub time_s: f64,
    /// Size s of what the model leaves.
    pub scale: f64,
}

impl Trim {
    /// The next k.
    ///
    /// ```
    /// use dynocal_calib::fuelling::Trim;
    /// let trim = Trim { time_s: 1.0, scale: 0.002 };
    /// // Three per cent that stay are there after eight seconds, and a tenth of a second of 20 % moves it by a thousandth.
    /// let there = (0..800).fold(0.0, |k, _| trim.follow(k, 0.03, 0.01));
    /// assert!((there - 0.03_f64).abs() < 1e-3);
    /// let moved = (0..10).fold(0.0, |k, _| trim.follow(k, 0.2, 0.01));
    /// assert!(moved < 1.1e-3);
    /// ```
    pub fn follow(&self, k: f64, measured: f64, dt_s: f64) -> f64 {
        let step = -(-dt_s / self.time_s).exp_m1() * self.scale * ((measured - k) / self.scale).asinh();
        (k + step).clamp(-MOST, MOST)
    }

    /// The trim that leaves least of the residuals of records, each with the number of samples that they are late; none where
    /// no trim leaves less.
    pub(super) fn suited(records: &[(Vec<f64>, usize)], dt_s: f64) -> Option<Self> {
        let mut sizes: Vec<f64> = records.iter().flat_map(|r| r.0.iter().map(|e| e.abs())).collect();
        sizes.sort_unstable_by(f64::total_cmp);
        // Median of the size of a normal variable over its standard deviation.
        let scale = (sizes.get(sizes.len() / 2)? / 0.6745).max(1e-6);
        let left = |trim: Option<Trim>| -> f64 {
            let of = |(errors, late): &(Vec<f64>, usize)| {
                let mut k = 0.0;
                let ahead = errors.iter().skip(*late);
                let each = ahead.zip(errors).map(|(next, e)| {
                    k = trim.map_or(0.0, |t| t.follow(k, *e, dt_s));
                    (next - k).abs()
                });
                each.sum::<f64>()
            };
            records.iter().map(of).sum()
        };
        let tried = (0..TRIED).map(|k| Trim { time_s: LEAST_S * f64::from(1 << k as u32), scale });
        let best = tried.min_by(|a, b| left(Some(*a)).total_cmp(&left(Some(*b))))?;
        (left(Some(best)) < left(None)).then_some(best)
    }
}

/// A sample as it was fuelled.
#[derive(Clone, Copy, Debug)]
struct Fuelled {
    /// Fuel in the cylinder per cycle.
    fuel: f64,
    speed_rpm: f64,
    pressure_kpa: f64,
    /// What the coolant multiplies the charge by, in the middle and to the ends of speed and pressure.
    factor: f64,
    ends: [f64; 2],
    cams_deg: Option<[f64; 2]>,
    /// Cycles since the last one without an injection.
    cycles: f64,
}

/// What the trim knows at a sample.
#[derive(Clone, Debug)]
pub(super) struct TrimState {
    /// Samples before, newest first.
    past: VecDeque<Fuelled>,
    longest: usize,
    /// 1 / lambda in the volume on the way, and as the sensor must show it.
    mixed: f64,
    shown: f64,
    k: f64,
    /// Cycles since a cut of the gas that comes to the volume, and those from which on it is believed.
    clean: f64,
    clean_from: f64,
    /// What is learnt over speed and pressure, if anything is to be.
    adapted: Option<Box<AdaptState>>,
}

impl TrimState {
    pub(super) fn at_rest(dt_s: f64) -> Self {
        let longest = (DELAY_S / dt_s).ceil() as usize + 2;
        Self {
            past: VecDeque::with_capacity(longest),
            longest,
            mixed: 1.0,
            shown: 1.0,
            k: 0.0,
            clean: f64::INFINITY,
            clean_from: CLEAN_CYCLES,
            adapted: None,
        }
    }

    /// The charge is learnt over speed and pressure too.
    pub(super) fn adapt(&mut self, law: Adaptation, left: Left) {
        self.adapted = Some(Box::new(AdaptState::new(law, left)));
    }

    /// What the identified charge is to be multiplied by at a speed and a pressure in half widths of its records.
    pub(super) fn factor(&self, scaled: [f64; 2]) -> f64 {
        let learnt = self.adapted.as_ref().map_or(0.0, |a| a.at(scaled));
        (self.k + learnt).clamp(-MOST, MOST).exp()
    }

    /// What the sensor showed at the end of the last sample.
    pub(super) fn measured(&mut self, trim: Option<&Trim>, lambda: f64, dt_s: f64) {
        let found = (self.shown * lambda).ln();
        if self.past.is_empty() || !found.is_finite() || self.clean < self.clean_from {
            return;
        }
        // The trim follows what is not learnt.
        let left = self.adapted.as_mut().map_or(found, |a| a.measured(found, dt_s));
        if let Some(trim) = trim {
            self.k = trim.follow(self.k, left, dt_s);
        }
    }

    /// This sample puts `fuel` into the cylinder, with an injection or from the wall alone; the sensor moves on by it.
    pub(super) fn fuelled(
        &mut self,
        f: &Fuelling,
        air: Air<'_>,
        fuel: f64,
        (speed_rpm, pressure_kpa): (f64, f64),
        injected: bool,
    ) {
        let dt_s = f.sample_time_s;
        let first = self.past.is_empty();
        self.past.truncate(self.longest - 1);
        let Air { factor, ends, cams_deg, .. } = air;
        let before = self.past.front().map_or(f64::INFINITY, |p| p.cycles);
        let cycles = if injected { before + dt_s * speed_rpm / 120.0 } else { 0.0 };
        self.past.push_front(Fuelled { fuel, speed_rpm, pressure_kpa, factor, ends, cams_deg, cycles });
        let flow = air.flow(speed_rpm, pressure_kpa);
        let delay = f.timing.delay_s(speed_rpm, flow) / dt_s;
        let (young, part) = (delay as usize, delay.fract());
        let phi = (1.0 - part) * self.phi(f, young) + part * self.phi(f, young + 1);
        let [mix, follow] = match first {
            true => [1.0; 2],
            false => [f.timing.mixed(flow, dt_s).0, -(-dt_s / f.timing.sensor_lag_s).exp_m1()],
        };
        self.mixed += mix * (phi - self.mixed);
        self.shown += follow * (self.mixed - self.shown);
        self.clean = self.ago(young + 1).cycles;
        // A time constant of the volume in cycles is its fuel over that of a cycle.
        let volume = f.timing.mixing_fuel / air.at(speed_rpm, pressure_kpa).max(1e-9);
        self.clean_from = CLEAN_CYCLES + CLEAN_LAGS * volume;
        if let Some(mut adapted) = self.adapted.take() {
            let points =
                [(young, 1.0 - part), (young + 1, part)].map(|(age, share)| (self.met(f, age), share));
            if first {
                adapted.begun(delay * dt_s, f.timing.lag_s(flow));
            }
            adapted.passed(points, [mix, follow]);
            self.adapted = Some(adapted);
        }
    }

    /// Speed and pressure, in half widths of the records, of the air that what was injected `age` samples ago has met.
    fn met(&self, f: &Fuelling, age: usize) -> [f64; 2] {
        let (young, part) = self.met_age(f, age);
        let mix =
            |of: fn(&Fuelled) -> f64| (1.0 - part) * of(self.ago(young)) + part * of(self.ago(young + 1));
        f.charge.scaled(mix(|p| p.speed_rpm), mix(|p| p.pressure_kpa))
    }

    /// A sample before; what is older than all as the oldest.
    fn ago(&self, age: usize) -> &Fuelled {
        &self.past[age.min(self.past.len() - 1)]
    }

    /// Samples since what was injected `age` samples ago met its air, and the part of one.
    fn met_age(&self, f: &Fuelling, age: usize) -> (usize, f64) {
        let ahead =
            (f.timing.charge_s + f.timing.charge_cycles * 120.0 / self.ago(age).speed_rpm) / f.sample_time_s;
        // What is not there yet is as it is now.
        let met = (age as f64 - ahead).max(0.0);
        (met as usize, met.fract())
    }

    /// 1 / lambda by the identified charge of what was injected `age` samples ago.
    fn phi(&self, f: &Fuelling, age: usize) -> f64 {
        let at = |age: usize| self.ago(age);
        let then = at(age);
        let (young, part) = self.met_age(f, age);
        let mix = |of: fn(&Fuelled) -> f64| (1.0 - part) * of(at(young)) + part * of(at(young + 1));
        let cams = |k: usize| {
            let (a, b) = at(young).cams_deg.zip(at(young + 1).cams_deg)?;
            Some((1.0 - part) * a[k] + part * b[k])
        };
        let cams_deg = cams(0).zip(cams(1)).map(|(a, b)| [a, b]);
        let air = Air { charge: &f.charge, factor: then.factor, ends: then.ends, cams_deg };
        then.fuel / air.at(mix(|p| p.speed_rpm), mix(|p| p.pressure_kpa))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Errors that stay for seconds are worth a trim, errors that are new in each sample are not.
    #[test]
    fn the_record_says_whether_to_trim_and_how_fast() {
        let mut rng = dynocal_numerics::rng::Rng64::stream(5, 0);
        let slow: Vec<f64> = (0..20).flat_map(|_| vec![0.01 * rng.normal(); 300]).collect();
        let noisy: Vec<f64> = slow.iter().map(|e| e + 0.05 * rng.normal()).collect();
        let white: Vec<f64> = slow.iter().map(|_| 0.01 * rng.normal()).collect();
        let fast = Trim::suited(&[(slow, 10)], 0.01).unwrap();
        let behind_noise = Trim::suited(&[(noisy, 10)], 0.01).unwrap();
        assert!(fast.time_s < behind_noise.time_s, "{fast:?} {behind_noise:?}");
        let none = Trim::suited(&[(white, 10)], 0.01);
        assert!(none.is_none_or(|t| t.time_s > 4.0 * behind_noise.time_s), "{none:?}");
        assert!((behind_noise.scale / 0.051 - 1.0).abs() < 0.15, "{behind_noise:?}");
    }
}
