//! The records that are identified from.

use super::{FuellingError, SteadyPoint, steady};
use crate::fuelling::charge::{Charge, TERMS};
use crate::fuelling::coolant::CoolantLaw;
use dynocal_numerics::linalg::least_squares;

/// What was on the wall before a record began fades within this, five time constants of a film of a cold engine, or this part of a short one, in s.
const FADES_S: f64 = 10.0;
const FADES_PART: f64 = 0.1;
/// Most of the pressure over that before the throttle: waves and noise show some behind an open throttle that is not boosted.
const ABOVE: f64 = 1.05;

/// Channels of a record of holds and steps, sampled together.
#[derive(Clone, Copy, Debug)]
pub struct TransientRecord<'a> {
    /// Sample time in s.
    pub sample_time_s: f64,
    /// Speed in rpm.
    pub speed_rpm: &'a [f64],
    /// Throttle as it was commanded in deg.
    pub throttle_deg: &'a [f64],
    /// Fuel per cycle as it was commanded.
    pub injection: &'a [f64],
    /// Manifold pressure in kPa, after each sample.
    pub map_kpa: &'a [f64],
    /// Lambda as the sensor shows it, after each sample.
    pub lambda: &'a [f64],
    /// Pressure before the throttle in kPa, where it is not measured.
    pub upstream_kpa: f64,
    /// The same as measured, after each sample; none: it stands still.
    pub boost_kpa: Option<&'a [f64]>,
    /// Coolant temperature in degC, if it is to count.
    pub coolant_c: Option<&'a [f64]>,
    /// Places of intake and exhaust cam in deg, after each sample, if they are to count.
    pub cams_deg: Option<[&'a [f64]; 2]>,
}

impl TransientRecord<'_> {
    /// The first sample whose mixture counts: before it shows what was on the wall and in the pipes when the record began, which nobody knows. It was
    /// nine tenths of all squares of records of a cold engine when it counted, and bent film and moments.
    pub(super) fn counts_from(&self) -> usize {
        let length_s = self.lambda.len() as f64 * self.sample_time_s;
        (FADES_S.min(FADES_PART * length_s) / self.sample_time_s) as usize
    }

    /// Coolant temperature of a sample; any number where it does not count.
    pub(super) fn coolant_c(&self, t: usize) -> f64 {
        self.coolant_c.map_or(0.0, |c| c[t])
    }

    /// Places of the cams that are known at the begin of a sample.
    pub(super) fn cams_deg(&self, t: usize) -> Option<[f64; 2]> {
        self.cams_deg.map(|cams| cams.map(|c| c[t.saturating_sub(1)]))
    }

    /// Pressure before the throttle that is known at the begin of a sample.
    pub(super) fn upstream_kpa(&self, t: usize) -> f64 {
        self.boost_kpa.map_or(self.upstream_kpa, |b| b[t.saturating_sub(1)])
    }
}

/// Coolant temperatures count when they differ by this, in K.
const LEAST_RANGE_K: f64 = 10.0;
/// Times that charge and law are taken in turn.
const TURNS: usize = 30;
/// Ridge beside rows of some 10 K.
const RIDGE: f64 = 1e-6;
/// Time without movement after which a record is at rest, in s: charge and throttle are begun from the rests, twenty at least.
pub const STILL_S: f64 = 2.0;
/// Time that is averaged at the end of a rest, in s.
const MEAN_S: f64 = 0.6;
/// Movement that counts as none: of the speed, relative; of the throttle, of the range of the record.
const STILL_SPEED: f64 = 0.01;
const STILL_THROTTLE: f64 = 0.005;
pub(super) fn mean(v: &[f64], r: &std::ops::Range<usize>) -> f64 {
    v[r.clone()].iter().sum::<f64>() / r.len() as f64
}

fn check_one(r: &TransientRecord<'_>) -> Result<(), FuellingError> {
    let n = r.speed_rpm.len();
    let mut channels: Vec<(&'static str, &[f64], f64)> = vec![
        ("speed", r.speed_rpm, 50.0),
        ("throttle", r.throttle_deg, -1e3),
        ("injection", r.injection, 0.0),
        ("map", r.map_kpa, 1.0),
        ("lambda", r.lambda, 0.05),
    ];
    channels.extend(r.coolant_c.map(|c| ("coolant", c, -60.0)));
    channels.extend(r.boost_kpa.map(|b| ("boost", b, 20.0)));
    let [intake, exhaust] = ["intake cam", "exhaust cam"];
    channels.extend(r.cams_deg.iter().flat_map(|[i, e]| [(intake, *i, -720.0), (exhaust, *e, -720.0)]));
    let refused =
        |channel, found: String, expected: String| FuellingError::Channel { channel, found, expected };
    for (name, values, least) in channels {
        if values.len() != n || n < 100 {
            return Err(refused(
                name,
                format!("{} samples", values.len()),
                format!("{} (100 at least)", n.max(100)),
            ));
        }
        if let Some(v) = values.iter().find(|v| !(v.is_finite() && **v >= least)) {
            return Err(refused(name, format!("the value {v}"), format!("numbers of at least {least}")));
        }
    }
    let greatest = r.map_kpa.iter().copied().fold(0.0, f64::max);
    if r.boost_kpa.is_none() && !(ABOVE * r.upstream_kpa > greatest) {
        let found = format!("a pressure of {greatest} kPa");
        return Err(refused(
            "map",
            found,
            format!(
                "at most {ABOVE} times the {} kPa before the throttle: give its channel where the engine is boosted",
                r.upstream_kpa
            ),
        ));
    }
    if !(r.sample_time_s > 0.0 && r.sample_time_s <= 0.05) {
        return Err(refused(
            "time",
            format!("samples of {} s", r.sample_time_s),
            "0.05 s at most: cycles are shorter".into(),
        ));
    }
    Ok(())
}

/// Stretches of [`MEAN_S`] before a movement (or the end) after [`STILL_S`] without any.
pub(super) fn rests(r: &TransientRecord<'_>) -> Vec<std::ops::Range<usize>> {
    let (still, mean) = ((STILL_S / r.sample_time_s) as usize, (MEAN_S / r.sample_time_s).max(1.0) as usize);
    let width =
        |v: &[f64]| v.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(*x), h.max(*x)));
    let (low, high) = width(r.throttle_deg);
    let mut out = Vec::new();
    let mut from = 0;
    for t in 1..=r.speed_rpm.len() {
        let moved = t == r.speed_rpm.len()
            || (r.speed_rpm[t] - r.speed_rpm[from]).abs() > STILL_SPEED * r.speed_rpm[from]
            || (r.throttle_deg[t] - r.throttle_deg[from]).abs() > STILL_THROTTLE * (high - low);
        if moved {
            if t - from >= still {
                out.push(t - mean..t);
            }
            from = t;
        }
    }
    out
}

/// Refuses records that cannot be read together.
pub(super) fn check(records: &[TransientRecord<'_>]) -> Result<(), FuellingError> {
    let Some(first) = records.first() else {
        return Err(FuellingError::Rests { found: 0, expected: TERMS + 5, still_s: STILL_S });
    };
    for (k, r) in records.iter().enumerate() {
        check_one(r)?;
        let of = |r: &TransientRecord<'_>| {
            let given = |is: bool| if is { "with" } else { "without" };
            format!(
                "samples of {} s, {} kPa before the throttle, {} coolant, {} boost, {} cams",
                r.sample_time_s,
                r.upstream_kpa,
                given(r.coolant_c.is_some()),
                given(r.boost_kpa.is_some()),
                given(r.cams_deg.is_some())
            )
        };
        if of(r) != of(first) {
            return Err(FuellingError::Records { number: k + 1, found: of(r), expected: of(first) });
        }
    }
    Ok(())
}

/// Steady points that are given, then the rests of all records.
pub(super) fn rested(
    records: &[TransientRecord<'_>],
    steady: &[SteadyPoint],
) -> Result<Vec<SteadyPoint>, FuellingError> {
    check(records)?;
    steady.iter().enumerate().try_for_each(|(k, p)| steady::check(k, p, &records[0]))?;
    let mut out = steady.to_vec();
    for r in records {
        let fuel: Vec<f64> = r.injection.iter().zip(r.lambda).map(|(q, lambda)| q * lambda).collect();
        out.extend(rests(r).iter().map(|s| SteadyPoint {
            speed_rpm: mean(r.speed_rpm, s),
            map_kpa: mean(r.map_kpa, s),
            throttle_deg: mean(r.throttle_deg, s),
            fuel: mean(&fuel, s),
            coolant_c: r.coolant_c.map_or(0.0, |c| mean(c, s)),
            upstream_kpa: r.boost_kpa.map_or(r.upstream_kpa, |b| mean(b, s)),
            cams_deg: r.cams_deg.map(|cams| cams.map(|c| mean(c, s))),
        }));
    }
    let expected = TERMS + 5;
    if out.len() < expected {
        return Err(FuellingError::Rests { found: out.len(), expected, still_s: STILL_S });
    }
    Ok(out)
}

/// The law of the coolant with nothing in it yet; none where the temperatures do not differ.
fn empty_law(records: &[TransientRecord<'_>]) -> Option<CoolantLaw> {
    let all = || records.iter().filter_map(|r| r.coolant_c).flatten().copied();
    let low = all().fold(f64::INFINITY, f64::min);
    let high = all().fold(f64::NEG_INFINITY, f64::max);
    (high - low >= LEAST_RANGE_K).then_some(CoolantLaw {
        at_c: 0.5 * (low + high),
        range_c: [low, high],
        share_per_k: 0.0,
        tau_per_k: 0.0,
        charge_per_k: 0.0,
        charge_ends_per_k: [0.0; 2],
    })
}

/// Charge and its law by the rests: each in turn with the other held.
pub(super) fn charge_at_rest(
    records: &[TransientRecord<'_>],
    rested: &[SteadyPoint],
) -> Result<(Charge, Option<CoolantLaw>), FuellingError> {
    let first: Vec<[f64; 3]> = rested.iter().map(|r| [r.speed_rpm, r.map_kpa, r.fuel]).collect();
    let mut charge = Charge::fit(&first)?;
    let Some(mut law) = empty_law(records) else {
        return Ok((charge, None));
    };
    let mut rows = Vec::with_capacity(3 * rested.len());
    let mut left = Vec::with_capacity(rested.len());
    for _ in 0..TURNS {
        rows.clear();
        left.clear();
        for r in rested {
            let k = r.coolant_c - law.at_c;
            let at = charge.scaled(r.speed_rpm, r.map_kpa);
            rows.extend([k, k * at[0], k * at[1]]);
            let air = charge.at(r.speed_rpm, r.map_kpa) * law.charge_factor_at(r.coolant_c, at);
            left.push((r.fuel / air).max(1e-3).ln());
        }
        let by = least_squares(&rows, rested.len(), 3, &left, RIDGE)?.x;
        law.charge_per_k += by[0];
        law.charge_ends_per_k.iter_mut().zip(&by[1..]).for_each(|(v, d)| *v += d);
        let cooled = |r: &SteadyPoint| {
            let heat = law.charge_factor_at(r.coolant_c, charge.scaled(r.speed_rpm, r.map_kpa));
            [r.speed_rpm, r.map_kpa, r.fuel / heat]
        };
        charge = charge.again(&rested.iter().map(cooled).collect::<Vec<_>>())?;
    }
    Ok((charge, Some(law)))
}
