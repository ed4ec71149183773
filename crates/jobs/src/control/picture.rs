//! Curves of the page, computed once with the result.

use dynocal_control::closed::Closed;
use dynocal_control::plane::{Channel, LocusPoint};
use dynocal_control::response::Response;
use dynocal_control::search::Choice;
use dynocal_control::simulate::run;
use dynocal_control::system::System;
use dynocal_control::tune::{Asked, StepRun, followed, step_run};
use dynocal_numerics::interval::Interval;

use super::load::Loaded;
use super::loops::controller;
use super::result::{ControlJobError, LoopResult};
use super::spec::Job;

/// Settling times that a step response shows.
const SHOWN: f64 = 6.0;
/// Most rows of a step response.
const ROWS: usize = 4000;
/// Margins whose loci are drawn: factors of the gain, phases in deg, dampings.
const LOCI: ([f64; 3], [f64; 3], f64) =
    ([1.0, 1.995_262_314_968_88, 3.981_071_705_534_973], [30.0, 45.0, 60.0], 0.4);

/// What the page draws.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Picture {
    pub(super) loops: Vec<LoopPicture>,
    /// Answers of all outputs to a step of each demand, all loops closed: by loop that steps, set point, output.
    pub(super) steps: Vec<Vec<Vec<Vec<f64>>>>,
    pub(super) step_s: f64,
    /// Responses that were measured, by set point.
    pub(super) measured: Vec<Response>,
}

/// Curves of one loop.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct LoopPicture {
    pub(super) plane: Option<Plane>,
    /// For each set point: frequency in rad/s, size in dB and phase in deg of the channel.
    pub(super) bode: Vec<Bode>,
}

/// Response of a channel.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Bode {
    pub(super) w_rad_s: Vec<f64>,
    pub(super) size_db: Vec<f64>,
    pub(super) phase_deg: Vec<f64>,
}

/// The plane of gains with what the search saw.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Plane {
    pub(super) kp_values: Vec<f64>,
    pub(super) ki_values: Vec<f64>,
    /// Worst ratio of asked to had; NaN where not stable.
    pub(super) ratio: Vec<f64>,
    /// Loci of the tightest set point by name.
    pub(super) loci: Vec<(String, Vec<f64>, Vec<f64>)>,
    /// Set point of the loci.
    pub(super) point: String,
}

pub(super) fn drawn(
    job: &Job,
    loaded: &Loaded,
    loops: &[LoopResult],
    choices: Vec<Option<Choice>>,
) -> Result<Picture, ControlJobError> {
    let measured = loaded.measured.iter().map(|m| m.response.clone()).collect();
    let mut out = Picture { measured, ..Picture::default() };
    let mut runs: Vec<StepRun> = Vec::new();
    for (k, (l, choice)) in loops.iter().zip(choices).enumerate() {
        let whole = |s: &System| {
            Channel::new(loaded.time, super::decouple::channel(loaded, s, k).ok()?.scaled(l.sign)).ok()
        };
        // The plane is that of what the controller sees: a predictor's loop without the delay.
        let seen = |s: &System| {
            let own = super::gains::seen_by(job, loaded, s, k, l.sign).ok()?;
            own.with_derivative(l.kd * l.sign, l.derivative_filter_s).ok()
        };
        let channels: Vec<Channel> = loaded.points.iter().filter_map(|p| whole(&p.nominal)).collect();
        let planes: Vec<Channel> = loaded.points.iter().filter_map(|p| seen(&p.nominal)).collect();
        let lags: Vec<_> = l.lags.iter().flatten().copied().collect();
        let r = step_run(&channels, &lags);
        runs.extend(channels.iter().enumerate().map(|(i, c)| followed(c, &l.gains_at(i), r)));
        let bode = channels.iter().map(|c| bode(c, l.sign)).collect();
        let plane = choice.map(|c| plane(l, c, &planes, loaded, &job.asked));
        out.loops.push(LoopPicture { plane, bode });
    }
    // Some times what the slowest loop takes to settle is enough to see it.
    let settled =
        loops.iter().map(|l| l.rules.first().and_then(|t| t.settling_s)).collect::<Option<Vec<f64>>>();
    let shown_s = settled.map_or(f64::INFINITY, |all| SHOWN * all.into_iter().fold(0.0, f64::max));
    let whole_s = runs.iter().map(|r| r.step_s * r.rows as f64).fold(0.0, f64::max).min(shown_s);
    out.step_s = runs.iter().map(|r| r.step_s).fold(f64::INFINITY, f64::min);
    let rows = ((whole_s / out.step_s) as usize).clamp(60, 200_000);
    for k in 0..job.loops.len() {
        let mut points = Vec::new();
        for (i, p) in loaded.points.iter().enumerate() {
            let refused = |source| ControlJobError::Point { point: p.name.clone(), source };
            let controller = controller(job, loaded, loops, i).map_err(refused)?;
            let closed = Closed::in_time(p.nominal.clone(), controller);
            // A delay that is no whole number of samples has no run.
            let found = run(
                &closed,
                out.step_s,
                rows,
                &|_, r| (0..r.len()).for_each(|j| r[j] = f64::from(u8::from(j == k))),
                &|_, d| d.fill(0.0),
            );
            let n = job.loops.len();
            let column = |y: &[f64], o: usize| y.iter().skip(o).step_by(n).copied().collect::<Vec<f64>>();
            points.push(found.map_or(Vec::new(), |f| (0..n).map(|o| column(&f.y, o)).collect()));
        }
        out.steps.push(points);
    }
    thin(&mut out, rows);
    Ok(out)
}

/// Fewer rows where there are more than a screen shows.
fn thin(out: &mut Picture, rows: usize) {
    let every = rows.div_ceil(ROWS);
    if every > 1 {
        out.step_s *= every as f64;
        for y in out.steps.iter_mut().flatten().flatten() {
            *y = y.iter().step_by(every).copied().collect();
        }
    }
}

fn bode(c: &Channel, sign: f64) -> Bode {
    let mut out = Bode::default();
    let mut last: Option<f64> = None;
    let delay_s = c.transfer.delay_s;
    for w in &c.grid {
        // The rational part is followed from point to point, the delay is added whole: it turns faster than any grid.
        let g = c.transfer.delayed(-delay_s).at(c.time, *w) * sign;
        let mut phase = g.arg().to_degrees();
        if let Some(before) = last {
            phase += 360.0 * ((before - phase) / 360.0).round();
        }
        last = Some(phase);
        out.w_rad_s.push(*w);
        out.size_db.push(20.0 * g.norm().log10());
        out.phase_deg.push(phase - (w * delay_s).to_degrees());
    }
    out
}

/// Values of kp at which the edge of the region of Ms is looked for.
const EDGE: usize = 120;

/// Edge of the largest region that keeps Ms: upwards along kp, and back along its lower end.
fn edge_of_sensitivity(channel: &Channel, kp: Interval, most: f64) -> (Vec<f64>, Vec<f64>) {
    let at = |k: usize| {
        let kp = kp.lower + (kp.upper - kp.lower) * (k as f64 + 0.5) / EDGE as f64;
        let kept = channel.ki_with_sensitivity(kp, most);
        let widest = kept.into_iter().max_by(|a, b| (a.upper - a.lower).total_cmp(&(b.upper - b.lower)))?;
        Some((kp, widest))
    };
    let all: Vec<(f64, Interval)> = (0..EDGE).filter_map(at).collect();
    let upper = all.iter().map(|(kp, i)| (*kp, i.upper));
    let lower = all.iter().rev().map(|(kp, i)| (*kp, i.lower));
    upper.chain(lower).unzip()
}

fn plane(l: &LoopResult, c: Choice, channels: &[Channel], loaded: &Loaded, asked: &Asked) -> Plane {
    let at =
        |m: &Option<dynocal_control::margin::Margins>| m.as_ref().map_or(f64::INFINITY, |m| m.sensitivity);
    let tight = l.rules.first().map_or(0, |t| {
        (0..t.margins.len()).max_by(|a, b| at(&t.margins[*a]).total_cmp(&at(&t.margins[*b]))).unwrap_or(0)
    });
    let channel = &channels[tight.min(channels.len() - 1)];
    let (kp, ki) = (c.kp, c.ki);
    // From rest to where the locus first leaves through ki = 0: what comes after lies inside of it.
    let within = |points: Vec<LocusPoint>| {
        let inside = |p: &LocusPoint| p.kp >= kp.lower && p.kp <= kp.upper && p.ki >= 0.0 && p.ki <= ki.upper;
        let first = points.iter().position(inside).unwrap_or(points.len());
        let left = points[first..].iter().take_while(|p| p.ki >= 0.0);
        let value = |p: &LocusPoint, v: f64| if inside(p) { v } else { f64::NAN };
        left.map(|p| (value(p, p.kp), value(p, p.ki))).unzip::<f64, f64, Vec<f64>, Vec<f64>>()
    };
    let mut loci = Vec::new();
    let mut add = |name: String, points: Vec<LocusPoint>| {
        let (x, y) = within(points);
        loci.push((name, x, y));
    };
    for g in LOCI.0 {
        add(format!("gain margin {:.0} dB", 20.0 * g.log10()), channel.gain_locus(g));
    }
    for p in LOCI.1 {
        add(format!("phase margin {p:.0} deg"), channel.phase_locus(p));
    }
    add(format!("damping {}", LOCI.2), channel.damping_locus(LOCI.2));
    let had = l.rules.first().and_then(|t| t.margins.get(tight)?.as_ref()?.delay_s);
    if let Some(delay_s) = Some(asked.delay_margin_s).filter(|d| *d > 0.0).or(had) {
        add(format!("delay margin {} s", super::words::digits(delay_s)), channel.delay_locus(delay_s));
    }
    let (x, y) = edge_of_sensitivity(channel, kp, asked.sensitivity);
    loci.push((format!("Ms {}", asked.sensitivity), x, y));
    Plane {
        ratio: c.raster.iter().map(|v| v.unwrap_or(f64::NAN)).collect(),
        kp_values: c.kp_values,
        ki_values: c.ki_values,
        loci,
        point: loaded.points[tight.min(loaded.points.len() - 1)].name.clone(),
    }
}
