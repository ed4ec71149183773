//! Figures 7.22 to 7.30 on a bed.

use dynocal_control::matrix::Matrix;
use dynocal_control::plane::Channel;
use dynocal_control::response::{Response, Test, frequency_response, odd_multisine};
use dynocal_control::runtime::PidGains;
use dynocal_control::search::choose;
use dynocal_control::system::{System, Transfer};
use dynocal_control::tune::{Asked as Margin, lag, step_run};
use dynocal_ident::excitation::bla::{Realisation, bla};
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::watch::Watch;
use serde::{Deserialize, Serialize};

use super::bed::{Bench, Driven, Record, SAMPLE_S};
use super::estimator::{Estimator, Kind};
use super::horizon::{Reference, reference};
use super::refine::{Round, refined};
use super::runs::{Feedback, Rig, Steps, apart};
use super::{OUTPUTS, PUBLISHED};

/// Extra delays of lambda in samples: the thesis has 5.
const DELAYS: [usize; 3] = [5, 15, 30];
/// Time constant in s of the filtered predictor.
const FILTER_S: f64 = 0.3;
/// Samples of a period of a multisine, periods that are kept, realisations.
const SINES: (usize, usize, usize) = (500, 3, 3);
/// Movement of the demanded torque about the set point that takes it from 10 to 90 Nm, as in the thesis.
const WIDE_NM: f64 = 40.0;
/// Coolant, oil and walls at the start of the drift in K, and its length in s.
const DRIFT: (f64, f64) = (293.15, 3600.0);

/// What is drawn and measured.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Figures {
    /// Outputs by demands, from the record.
    pub(super) response: Response,
    /// For each output by its own demand: levels of odd and even distortion over the excited lines in dB, where they stand out
    /// of the noise.
    pub(super) distortion_db: Vec<[Option<f64>; 2]>,
    pub(super) torque: Vec<Steps>,
    pub(super) lambda: Vec<Steps>,
    pub(super) late: Vec<Late>,
    pub(super) estimate: Estimate,
    pub(super) refined: Vec<Round>,
    pub(super) horizon: Reference,
}

/// Lambda with an extra delay.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Late {
    pub(super) samples: usize,
    pub(super) steps: Vec<Steps>,
    /// Distance of each from the undelayed loop after the pure delay, as a share.
    pub(super) apart: Vec<f64>,
}

/// Torque without a sensor.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Estimate {
    /// Free run on a record that nothing saw, percent and Nm2: (7.24), observer.
    pub(super) fits: [(f64, f64); 2],
    /// The same, fitted and run over the range of the thesis, 10 to 90 Nm.
    pub(super) wide: [(f64, f64); 2],
    /// Scatter of the torque in both records in Nm.
    pub(super) moved_nm: [f64; 2],
    pub(super) steps: Vec<Steps>,
    /// Seconds since a cold start, and the distance of the torque from its demand in Nm by (7.24) and by the observer.
    pub(super) drift: Vec<(f64, [f64; 2])>,
}

pub(super) fn draw(
    bench: &Bench,
    (record, finer): (&Record, &[f64]),
    map: &[f64],
    plant: &System,
    gains: &[PidGains],
    (engine, seed, reduced): (&str, u64, bool),
    watch: Watch,
) -> Result<Figures, String> {
    let rig = Rig { bench, map, plant, gains };
    let count = if reduced { 4 } else { 8 };
    watch.note(&format!("{engine}: responses"));
    let response = measured(record, finer)?;
    let distortion_db = (0..2).map(|k| distortion(&rig, k, seed)).collect::<Result<_, _>>()?;
    let y0 = bench.point().1;
    let sizes = [0.2 * y0[0], 0.04];
    watch.note(&format!("{engine}: steps under the loops"));
    let mut loops = Vec::new();
    for k in 0..2 {
        let published = PUBLISHED[1].1;
        let thesis = PidGains::pi(published[2 * k], published[2 * k + 1]);
        let mut own = Vec::new();
        for (name, f) in [
            ("map alone", Feedback::Map),
            ("PI, ours", Feedback::Pi(gains[k])),
            ("PI, gains of the thesis", Feedback::Pi(thesis)),
        ] {
            own.push(rig.steps(name, k, sizes[k], count, &f, 0)?);
        }
        loops.push(own);
    }
    watch.note(&format!("{engine}: lambda with extra delay"));
    let delays = if reduced { &DELAYS[..1] } else { &DELAYS[..] };
    let undelayed = loops[1][1].clone();
    let late =
        delays.iter().map(|d| late(&rig, *d, sizes[1], count, &undelayed)).collect::<Result<_, _>>()?;
    watch.note(&format!("{engine}: torque without a sensor"));
    let estimate = estimate(&rig, engine, seed, sizes[0], count, reduced)?;
    watch.note(&format!("{engine}: map made again"));
    let refined = refined(&rig, seed, if reduced { 2 } else { 4 })?;
    watch.note(&format!("{engine}: receding horizon"));
    let horizon = reference(&rig, engine, seed, sizes, if reduced { 30.0 } else { 120.0 })?;
    let lambda = loops.pop().unwrap_or_default();
    Ok(Figures {
        refined,
        horizon,
        response,
        distortion_db,
        torque: loops.pop().unwrap_or_default(),
        lambda,
        late,
        estimate,
    })
}

/// From demands of torque and lambda behind the map that is finer by a matrix than that of the record: d = finer^-1 of its demands.
fn measured(record: &Record, map: &[f64]) -> Result<Response, String> {
    let real = |v: &f64| dynocal_control::matrix::C::new(*v, 0.0);
    let inverse = Matrix { rows: 2, cols: 2, data: map.iter().map(real).collect() };
    let steady = inverse.inverse().ok_or("what makes the map finer has no inverse")?;
    let column = |k: usize| -> Vec<f64> {
        record.u.chunks(2).map(|u| steady.at(k, 0).re * u[0] + steady.at(k, 1).re * u[1]).collect()
    };
    let inputs = [column(0), column(1)];
    let test = Test { inputs: &inputs, outputs: &record.y, demands: None, sample_time_s: SAMPLE_S };
    frequency_response(&test, None).map_err(|e| e.to_string())
}

/// Odd and even distortion of an output by its own demand.
fn distortion(rig: &Rig, k: usize, seed: u64) -> Result<[Option<f64>; 2], String> {
    let (period, kept, realisations) = SINES;
    let y0 = rig.bench.point().1;
    let mut all: Vec<(Vec<f64>, Vec<f64>)> = Vec::new();
    for r in 0..realisations {
        let mut rng = Rng64::stream(seed, 20 + r as u64);
        let size = [0.15 * y0[0], 0.05][k];
        let u = odd_multisine(period, SAMPLE_S, 5.0, size, &mut rng).map_err(|e| e.to_string())?;
        let run = rig.bench.drive((kept + 1) * period, &mut |t, _| {
            let mut d = [0.0; 2];
            d[k] = u[t % period];
            rig.actuators(d, 0.0)
        })?;
        let y = run.shown[period..].iter().map(|s| s[k] - y0[k]).collect();
        all.push((u.repeat(kept), y));
    }
    let each: Vec<Realisation> = all.iter().map(|(u, y)| Realisation { u, y }).collect();
    let found = bla(&each, period, SAMPLE_S).map_err(|e| e.to_string())?;
    let level = |l: &Option<dynocal_ident::excitation::bla::Level>| {
        l.as_ref().filter(|l| l.stands_out()).map(|l| l.db_of(&found.excited))
    };
    Ok([level(&found.odd), level(&found.even)])
}

/// Lambda seen late: the same PI, a predictor, a filtered one, a PI that is tuned for the delay.
fn late(rig: &Rig, samples: usize, size: f64, count: usize, undelayed: &Steps) -> Result<Late, String> {
    let mut delay = vec![0.0; samples];
    delay.push(1.0);
    let whole = rig.plant.channel(1, 1).times(&Transfer::sampled(&delay, &[1.0]));
    let channel = Channel::new(rig.plant.time, whole).map_err(|e| e.to_string())?;
    let lags: Vec<_> = lag(&channel).ok().into_iter().collect();
    let channels = [channel];
    let found =
        choose(&channels, &Margin::default(), step_run(&channels, &lags)).map_err(|e| e.to_string())?;
    let retuned = PidGains::pi(found.tuned.kp, found.tuned.ki);
    let g = rig.gains[1];
    let steps = [
        ("the same PI", Feedback::Pi(g)),
        ("Smith predictor", Feedback::Predicted(g, 0.0)),
        ("Smith predictor, filtered", Feedback::Predicted(g, FILTER_S)),
        ("PI retuned for the delay", Feedback::Pi(retuned)),
    ]
    .into_iter()
    .map(|(name, f)| rig.steps(name, 1, size, count, &f, samples))
    .collect::<Result<Vec<Steps>, String>>()?;
    let apart = steps.iter().map(|s| apart(undelayed, s, samples)).collect();
    Ok(Late { samples, steps, apart })
}

/// A record of the closed loop with demands and spark that move at random.
fn closed_record(rig: &Rig, rows: usize, seed: u64, torque_nm: f64) -> Result<Driven, String> {
    use dynocal_control::runtime::{ActuatorLimits, Pid};
    let mut rng = Rng64::stream(seed, 31);
    let y0 = rig.bench.point().1;
    let wide = ActuatorLimits { lower: -1e6, upper: 1e6, rate_per_s: None };
    let pid = |g: PidGains| Pid::new(g, wide, SAMPLE_S, 0.0).map_err(|e| e.to_string());
    let mut loops = [pid(rig.gains[0])?, pid(rig.gains[1])?];
    let (mut left, mut demand) = ([0usize; 3], [0.0; 3]);
    let reach = [torque_nm, 0.05, 4.0];
    rig.bench.drive(rows, &mut |_, shown| {
        for k in 0..3 {
            if left[k] == 0 {
                left[k] = 50 + rng.below(150);
                demand[k] = reach[k] * rng.uniform_in(-1.0, 1.0);
            }
            left[k] -= 1;
        }
        let d = [0, 1].map(|k| demand[k] + loops[k].step(0.0, demand[k] - (shown[k] - y0[k])));
        rig.actuators(d, demand[2])
    })
}

fn estimate(
    rig: &Rig,
    engine: &str,
    seed: u64,
    size: f64,
    count: usize,
    reduced: bool,
) -> Result<Estimate, String> {
    let rows = if reduced { 3000 } else { 15_000 };
    let narrow_nm = 0.4 * rig.bench.point().1[0];
    let (seen, unseen) =
        (closed_record(rig, rows, seed, narrow_nm)?, closed_record(rig, rows, seed + 1000, narrow_nm)?);
    let (first, second) =
        (closed_record(rig, rows, seed, WIDE_NM)?, closed_record(rig, rows, seed + 1000, WIDE_NM)?);
    let over = |kind| Ok::<_, String>(Estimator::fitted(kind, &first)?.fit(&second));
    let (published, observer) =
        (Estimator::fitted(Kind::Published, &seen)?, Estimator::fitted(Kind::Observer, &seen)?);
    let steps = vec![
        rig.steps("torque sensor", 0, size, count, &Feedback::Pi(rig.gains[0]), 0)?,
        rig.estimated_steps("estimate (7.24)", size, count, &published)?,
        rig.estimated_steps("observer", size, count, &observer)?,
    ];
    let drift = drift(rig, engine, seed, [&published, &observer], if reduced { 60.0 } else { DRIFT.1 })?;
    Ok(Estimate {
        fits: [published.fit(&unseen), observer.fit(&unseen)],
        wide: [over(Kind::Published)?, over(Kind::Observer)?],
        moved_nm: [moved_nm(&unseen), moved_nm(&second)],
        steps,
        drift,
    })
}

/// Scatter of the torque over a record in Nm.
fn moved_nm(record: &Driven) -> f64 {
    let n = record.shown.len() as f64;
    let mean = record.shown.iter().map(|s| s[0]).sum::<f64>() / n;
    (record.shown.iter().map(|s| (s[0] - mean).powi(2)).sum::<f64>() / n).sqrt()
}

/// Mean distance from a constant demand over each of twelve parts of the time after a cold start.
fn drift(
    rig: &Rig,
    engine: &str,
    seed: u64,
    estimators: [&Estimator; 2],
    length_s: f64,
) -> Result<Vec<(f64, [f64; 2])>, String> {
    let cold = Bench::new(engine, seed, Some(DRIFT.0))?;
    let wanted_nm = rig.bench.point().1[0];
    let from_nm = cold.point().1[0];
    let own = Rig { bench: &cold, ..*rig };
    let rows = (length_s / SAMPLE_S) as usize;
    let part = rows / 12;
    let mut out: Vec<(f64, [f64; 2])> =
        (0..12).map(|k| ((k as f64 + 0.5) * part as f64 * SAMPLE_S, [0.0; 2])).collect();
    for (e, estimator) in estimators.into_iter().enumerate() {
        let run = own.estimated(rows, estimator, &|_| wanted_nm - from_nm)?;
        for (k, (_, off)) in out.iter_mut().enumerate() {
            let mean = run.torque_nm[k * part..(k + 1) * part].iter().sum::<f64>() / part as f64;
            off[e] = mean - wanted_nm;
        }
    }
    Ok(out)
}

/// Names of the channels from demands to outputs.
pub(super) fn channel_name(o: usize, i: usize) -> String {
    format!("{} by demanded {}", OUTPUTS[o], OUTPUTS[i])
}
