//! Every q-th sample, after a low pass without phase.
//!
//! ```text
//! y(k) = sum_i h(i) x(q k + i),   i = -25 q .. 25 q,   h: sinc with Kaiser window, sum h = 1
//! ```
//!
//! The pass band ends at 0.8 of the new half sample rate; from there on to 1.0 the gain falls to -80 dB, so that
//! nothing is folded back. Both ends are continued by their odd mirror image. (J. F. Kaiser, Proc. IEEE ISCAS 1974,
//! 20-23, for window shape and length.)

use std::f64::consts::PI;

use dynocal_numerics::registry::{self, Member, MemberDoc, ParamDoc};
use serde::Deserialize;

use super::common::{change, chosen, complete, fault, key_fault, uniform};
use super::{Effect, Outcome, PrepareError, Step};
use crate::data::{Dataset, Role};

const NAME: &str = "decimate";

pub(super) const MEMBER: Member<dyn Step> = Member {
    doc: MemberDoc {
        name: NAME,
        what: "keeps every n-th sample, after a zero-phase low pass against aliasing",
        params: &[
            ParamDoc {
                name: "factor",
                unit: "-",
                default: "",
                what: "one sample of so many is kept, 2 to 1000",
            },
            ParamDoc {
                name: "low_pass",
                unit: "-",
                default: "true",
                what: "false keeps the samples as they are: what lies above the new half sample rate is folded back",
            },
        ],
    },
    build: |keys| {
        let step: Decimate = registry::keys(NAME, keys)?;
        if !(2..=1000).contains(&step.factor) {
            return Err(key_fault(NAME, format!("found factor = {}, expected 2 to 1000", step.factor)));
        }
        Ok(Box::new(step))
    },
};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Decimate {
    factor: usize,
    #[serde(default = "yes")]
    low_pass: bool,
}

fn yes() -> bool {
    true
}

/// Half length of the low pass in new samples: 80 dB within a fifth of the new half sample rate.
const HALF: usize = 25;
/// Shape of the Kaiser window for 80 dB: `0.1102 (80 - 8.7)`.
const BETA: f64 = 7.857;

impl Step for Decimate {
    fn apply(&self, records: Vec<Dataset>) -> Result<Outcome, PrepareError> {
        let h = low_pass(self.factor);
        let mut outcome = Outcome::default();
        for mut record in records {
            let dt_s = uniform(NAME, &record)?;
            let samples_before = record.len();
            let all = chosen(&record, None, &[Role::Input, Role::Output, Role::Auxiliary])?;
            for c in all {
                let values = &record.channels[c].values;
                // What is only recorded beside (a time, a counter) is picked, so that it stays what it is.
                record.channels[c].values = if self.low_pass && record.channels[c].role != Role::Auxiliary {
                    self.filtered(&record, c, &h)?
                } else {
                    values.iter().copied().step_by(self.factor).collect()
                };
            }
            let to_s = dt_s * self.factor as f64;
            record.sample_time_s = to_s;
            record.init_samples = record.init_samples.div_ceil(self.factor);
            let samples_after = record.len();
            let effect =
                Effect::Resampled { from_s: dt_s, to_s, start_s: 0.0, samples_before, samples_after };
            outcome.changes.push(change(&record, None, effect));
            outcome.records.push(record);
        }
        if !self.low_pass {
            let message = "decimated without low pass: faster parts of the signals are folded back";
            outcome.remarks.push(message.into());
        }
        Ok(outcome)
    }
}

impl Decimate {
    fn filtered(&self, record: &Dataset, c: usize, h: &[f64]) -> Result<Vec<f64>, PrepareError> {
        let x = complete(NAME, record, c)?;
        let (n, half) = (x.len(), h.len() / 2);
        if n <= half {
            let message =
                format!("{n} samples are too few for the low pass, at least {} are needed", half + 1);
            return Err(fault(NAME, record, message));
        }
        let mirrored = |t: isize| match t {
            t if t < 0 => 2.0 * x[0] - x[t.unsigned_abs()],
            t if t as usize >= n => 2.0 * x[n - 1] - x[2 * (n - 1) - t as usize],
            t => x[t as usize],
        };
        let at = |t: usize| -> f64 {
            if t >= half && t + half < n {
                return dynocal_numerics::linalg::dot(h, &x[t - half..=t + half]);
            }
            h.iter().enumerate().map(|(i, h)| h * mirrored(t as isize + i as isize - half as isize)).sum()
        };
        Ok((0..n).step_by(self.factor).map(at).collect())
    }
}

/// Low pass to 0.9 (middle of the transition) of the new half sample rate, 2 HALF q + 1 coefficients of sum one.
fn low_pass(q: usize) -> Vec<f64> {
    let half = (HALF * q) as isize;
    let cut = 0.9 / q as f64;
    let one = |i: isize| {
        let x = i as f64;
        let sinc = if i == 0 { cut } else { (PI * cut * x).sin() / (PI * x) };
        sinc * bessel_0(BETA * (1.0 - (x / half as f64).powi(2)).sqrt()) / bessel_0(BETA)
    };
    let h: Vec<f64> = (-half..=half).map(one).collect();
    let sum: f64 = h.iter().sum();
    h.into_iter().map(|v| v / sum).collect()
}

/// Modified Bessel function of the first kind of order zero, by its power series.
fn bessel_0(x: f64) -> f64 {
    let (mut sum, mut term, mut k) = (1.0, 1.0, 1.0);
    while term > 1e-17 * sum {
        term *= (0.5 * x / k).powi(2);
        sum += term;
        k += 1.0;
    }
    sum
}
