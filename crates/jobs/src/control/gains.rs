//! The gains of a loop on its own channel: the search with draws, rules beside it.

use dynocal_control::error::ControlError;
use dynocal_control::plane::Channel;
use dynocal_control::runtime::PidGains;
use dynocal_control::search::{Choice, choose, choose_pid};
use dynocal_control::system::{System, Time};
use dynocal_control::tune::{self, Lag, StepRun, Tuned, judged, step_run};
use dynocal_report::significant;
use rayon::prelude::*;

use super::decouple;
use super::load::{AtPoint, Loaded, without_predicted};
use super::loops::{by_point, predictor};
use super::result::{ControlJobError, LoopResult};
use super::spec::{Job, LoopSpec};

/// Rounds in which draws that miss are added to what the search sees.
const SCENARIOS: usize = 4;
/// Draws that are added in a round.
const ADDED: usize = 5;

/// The row of the PI that a predictor has to beat.
pub(super) const PI_ALONE: &str = "PI alone, retuned for the whole delay";

/// The channel of a loop, its gain positive.
fn whole(loaded: &Loaded, plant: &System, k: usize, sign: f64) -> Result<Channel, ControlError> {
    Channel::new(loaded.time, decouple::channel(loaded, plant, k)?.scaled(sign))
}

/// What the PI of a loop sees of a plant: a predictor's gains are those of the undelayed loop.
pub(super) fn seen_by(
    job: &Job,
    loaded: &Loaded,
    plant: &System,
    k: usize,
    sign: f64,
) -> Result<Channel, ControlError> {
    match job.loops[k].predictor {
        true => whole(loaded, &without_predicted(job, plant)?, k, sign),
        false => whole(loaded, plant, k, sign),
    }
}

/// Delay of a continuous channel over its shortest lag up to which gains are searched: margins and runs of more would resolve that lag over all of
/// the delay, for hours.
const MOST_DEAD: f64 = 10_000.0;

/// Gains of one loop on its own channel, with those of rules beside.
pub(super) fn one_loop(
    job: &Job,
    loaded: &Loaded,
    k: usize,
    l: &LoopSpec,
) -> Result<(LoopResult, Option<Choice>), ControlJobError> {
    let refused = |source: ControlError| ControlJobError::Loop {
        output: l.output.clone(),
        input: l.input.clone(),
        source,
    };
    // Given gains are judged on any plant.
    if l.gains.is_none() {
        alone_at_rest(loaded, k)?;
    }
    in_time(loaded, k)?;
    let sign = sign(loaded, k, l)?;
    let whole = |s: &System| whole(loaded, s, k, sign);
    let channel = |s: &System| seen_by(job, loaded, s, k, sign);
    let nominal: Vec<Channel> =
        loaded.points.iter().map(|p| channel(&p.nominal)).collect::<Result<_, _>>().map_err(refused)?;
    let draws: Vec<Channel> = loaded
        .points
        .iter()
        .flat_map(|p| &p.draws)
        .map(channel)
        .collect::<Result<_, _>>()
        .map_err(|e| refused(ControlError::Model(format!("a draw of the parameters: {e}"))))?;
    let lags: Vec<Option<Lag>> = nominal.iter().map(|c| tune::lag(c).ok()).collect();
    let known: Vec<Lag> = lags.iter().flatten().copied().collect();
    let r = step_run(&nominal, &known);
    let mut rules = Vec::new();
    let (choice, nominal) = match l.gains {
        Some(g) => {
            let own = PidGains { kp: g.kp * sign, ki: g.ki * sign, kd: g.kd * sign, ..g };
            let with = with_derivative(&nominal, own.kd, own.filter_s).map_err(refused)?;
            rules.push(late(l, judged("given", &own, &with, &job.asked, r)));
            (None, with)
        }
        None => {
            let (found, with, pi) = searched(job, l, nominal, &draws, r).map_err(refused)?;
            let gains = with[0].gains(found.tuned.kp, found.tuned.ki);
            rules.push(late(l, judged("search", &gains, &with, &job.asked, r)));
            if let Some(pi) = pi.filter(|_| gains.kd != 0.0) {
                let alone = PidGains::pi(pi.kp, pi.ki);
                rules.push(late(l, judged("search without a derivative part", &alone, &with, &job.asked, r)));
            }
            (Some(found), with)
        }
    };
    if let Some((simc, lambda)) = slowest(&known) {
        rules.push(late(l, judged("SIMC", &simc, &nominal, &job.asked, r)));
        rules.push(late(l, judged("lambda tuning", &lambda, &nominal, &job.asked, r)));
    }
    if l.predictor {
        let whole: Vec<Channel> =
            loaded.points.iter().map(|p| whole(&p.nominal)).collect::<Result<_, _>>().map_err(refused)?;
        let lags: Vec<Lag> = whole.iter().filter_map(|c| tune::lag(c).ok()).collect();
        let r = step_run(&whole, &lags);
        if let Ok(c) = choose(&whole, &job.asked, r) {
            let gains = PidGains::pi(c.tuned.kp, c.tuned.ki);
            rules.push(judged(PI_ALONE, &gains, &whole, &job.asked, r));
        }
    }
    let own =
        |c: &Channel| choose(std::slice::from_ref(c), &job.asked, r).ok().map(|c| (c.tuned.kp, c.tuned.ki));
    let scheduled =
        if nominal.len() > 1 && l.gains.is_none() { nominal.iter().map(own).collect() } else { Vec::new() };
    let delivered = &rules[0];
    let found = LoopResult {
        output: l.output.clone(),
        input: l.input.clone(),
        kp: delivered.kp * sign,
        ki: delivered.ki * sign,
        kd: delivered.kd * sign,
        derivative_filter_s: delivered.filter_s,
        rule: delivered.rule.clone(),
        sign,
        lags,
        rules,
        by_point: by_point(job, &scheduled, sign, l)?,
        scheduled,
        predictor: None,
    };
    let predictor =
        if l.predictor { Some(predictor(job, loaded, k, l, &found).map_err(refused)?) } else { None };
    Ok((LoopResult { predictor, ..found }, choice))
}

/// Gains of a predictor are judged on its undelayed loop; what is measured settles one delay later.
fn late(l: &LoopSpec, mut judged: Tuned) -> Tuned {
    if l.predictor {
        judged.settling_s = judged.settling_s.map(|s| s + l.extra_delay_s);
    }
    judged
}

fn with_derivative(channels: &[Channel], kd: f64, filter_s: f64) -> Result<Vec<Channel>, ControlError> {
    channels.iter().map(|c| c.with_derivative(kd, filter_s)).collect()
}

/// The search of a loop: its choice, the channels with the derivative part that was found, and the best PI beside one.
fn searched(
    job: &Job,
    l: &LoopSpec,
    nominal: Vec<Channel>,
    draws: &[Channel],
    r: StepRun,
) -> Result<(Choice, Vec<Channel>, Option<Tuned>), ControlError> {
    if !l.derivative {
        return Ok((scenarios(job, nominal.clone(), draws, r)?, nominal, None));
    }
    let found = choose_pid(&nominal, &job.asked, l.derivative_filter_s, r)?;
    let with = with_derivative(&nominal, found.kd, found.filter_s)?;
    let draws = with_derivative(draws, found.kd, found.filter_s)?;
    Ok((scenarios(job, with.clone(), &draws, r)?, with, found.pi))
}

/// Refuses channels that run away by themselves: the sign of their gain at rest says nothing of the PI that holds them.
fn alone_at_rest(loaded: &Loaded, k: usize) -> Result<(), ControlJobError> {
    for p in &loaded.points {
        let poles = dynocal_control::poly::roots(&p.nominal.channel(k, k).den).unwrap_or_default();
        let runs_away = |z: &dynocal_control::matrix::C| match loaded.time {
            Time::Continuous => z.re > 1e-9 * z.norm(),
            // Roots in z^-1.
            Time::Sampled { .. } => z.norm() < 1.0 - 1e-9,
        };
        if poles.iter().any(runs_away) {
            let text = "the channel of a loop is unstable by itself; loops are tuned for channels that come to rest or integrate";
            return Err(ControlJobError::Point {
                point: p.name.clone(),
                source: ControlError::Model(text.into()),
            });
        }
    }
    Ok(())
}

/// Refuses delays that are a slip of units.
fn in_time(loaded: &Loaded, k: usize) -> Result<(), ControlJobError> {
    for p in loaded.points.iter().filter(|_| loaded.time == Time::Continuous) {
        let channel = p.nominal.channel(k, k);
        let poles = dynocal_control::poly::roots(&channel.den).unwrap_or_default();
        let fastest = poles.iter().map(|z| z.norm()).fold(0.0, f64::max);
        if channel.delay_s * fastest > MOST_DEAD {
            let text = format!(
                "the channel of a loop is late by {} s, {:.0} times its shortest lag of {} s: more than {MOST_DEAD} times is not searched; check the unit of its delay",
                significant(channel.delay_s, 3),
                channel.delay_s * fastest,
                significant(1.0 / fastest, 3)
            );
            return Err(ControlJobError::Point { point: p.name.clone(), source: ControlError::Model(text) });
        }
    }
    Ok(())
}

/// The smallest gains that the rules give over the set points.
fn slowest(lags: &[Lag]) -> Option<(PidGains, PidGains)> {
    let least = |of: &dyn Fn(&Lag) -> PidGains| {
        let each: Vec<PidGains> = lags.iter().map(of).collect();
        let smallest = |part: &dyn Fn(&PidGains) -> f64| each.iter().map(part).fold(f64::INFINITY, f64::min);
        PidGains::pi(smallest(&|g| g.kp), smallest(&|g| g.ki))
    };
    (!lags.is_empty()).then(|| (least(&|l| tune::simc(l, None)), least(&|l| tune::lambda(l, None))))
}

/// The sign of a channel at rest, the same at all set points and for all draws.
fn sign(loaded: &Loaded, k: usize, l: &LoopSpec) -> Result<f64, ControlJobError> {
    let mut first: Option<(f64, &str)> = None;
    for p in &loaded.points {
        let mut nominal: Option<f64> = None;
        for s in std::iter::once(&p.nominal).chain(&p.draws) {
            let channel = decouple::channel(loaded, s, k)
                .map_err(|source| ControlJobError::Point { point: p.name.clone(), source })?;
            let gain = channel.steady_gain(s.time);
            if !(gain.abs() > 0.0) {
                let source = ControlError::Model(format!(
                    "`{}` does nothing to `{}` at rest (gain {gain})",
                    l.input, l.output
                ));
                return Err(ControlJobError::Point { point: p.name.clone(), source });
            }
            let own = *nominal.get_or_insert(gain);
            if own.signum() != gain.signum() {
                let source = ControlError::Model(format!(
                    "the sign of what `{}` does to `{}` at rest is not known: {own:.3e}, and {gain:.3e} for a draw of the model's parameters; test it with a larger step or for longer, or pair the loops otherwise",
                    l.input, l.output
                ));
                return Err(ControlJobError::Point { point: p.name.clone(), source });
            }
            match first {
                None => first = Some((gain, &p.name)),
                Some((before, at)) if before.signum() != gain.signum() => {
                    return Err(ControlJobError::Sign {
                        output: l.output.clone(),
                        input: l.input.clone(),
                        first: before,
                        at_first: at.into(),
                        second: gain,
                        at_second: p.name.clone(),
                    });
                }
                Some(_) => {}
            }
        }
    }
    Ok(first.map_or(1.0, |(gain, _)| gain.signum()))
}

/// The search on the nominal channels, and again with the draws that its gains miss most.
fn scenarios(
    job: &Job,
    mut seen: Vec<Channel>,
    draws: &[Channel],
    r: StepRun,
) -> Result<Choice, ControlError> {
    let mut left: Vec<&Channel> = draws.iter().collect();
    let mut before: Option<Choice> = None;
    loop {
        let found = match (choose(&seen, &job.asked, r), before) {
            (Ok(found), _) => found,
            // No gains serve the models and these draws together: those of the models stand, and are judged over all draws.
            (Err(_), Some(before)) => return Ok(before),
            (Err(e), None) => return Err(e),
        };
        let of = |c: &&Channel| {
            let m = c.margins(found.tuned.kp, found.tuned.ki);
            m.map_or(f64::INFINITY, |m| job.asked.violation(&m))
        };
        let missed: Vec<f64> = left.par_iter().map(of).collect();
        let mut order: Vec<usize> = (0..left.len()).filter(|k| missed[*k] > 1.0).collect();
        if order.is_empty() || !found.kept || seen.len() > SCENARIOS * ADDED + draws.len() {
            return Ok(found);
        }
        order.sort_by(|a, b| missed[*b].total_cmp(&missed[*a]));
        order.truncate(ADDED);
        seen.extend(order.iter().map(|k| left[*k].clone()));
        order.sort_unstable();
        for k in order.iter().rev() {
            left.remove(*k);
        }
        before = Some(found);
    }
}

/// The gains that were made smaller, judged alone as those of the rules are: before these, as what is delivered.
pub(super) fn smaller_rules(
    loaded: &Loaded,
    job: &Job,
    loops: &mut [LoopResult],
) -> Result<(), ControlJobError> {
    for (k, l) in loops.iter_mut().enumerate() {
        let channel = |p: &AtPoint| seen_by(job, loaded, &p.nominal, k, l.sign);
        let channels = loaded.points.iter().map(channel).collect::<Result<Vec<_>, _>>();
        let channels = channels.map_err(|source| ControlJobError::Loop {
            output: l.output.clone(),
            input: l.input.clone(),
            source,
        })?;
        let lags: Vec<_> = l.lags.iter().flatten().copied().collect();
        let gains = PidGains { kp: l.kp * l.sign, ki: l.ki * l.sign, kd: l.kd * l.sign, ..l.gains() };
        let run = step_run(&channels, &lags);
        let own = judged("search, made smaller", &gains, &channels, &job.asked, run);
        l.rules.insert(0, late(&job.loops[k], own));
        if l.predictor.is_some() {
            l.predictor = Some(predictor(job, loaded, k, &job.loops[k], l).map_err(|source| {
                ControlJobError::Loop { output: l.output.clone(), input: l.input.clone(), source }
            })?);
        }
    }
    Ok(())
}
