//! Statistics under output and rate limits, thesis section 4.9 with Tables 4.12 and 4.13.

use dynocal_design::channel::Channel;
use dynocal_design::problem::{DesignProblem, Evaluator, OutputLimits, Term};
use dynocal_numerics::rng::Rng64;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::models::{identify, told, truth, unseen, validate};
use super::source::{DesignCriterion, Record, Source, designed, problem, random, term};
use super::statistics::Stat;
use super::{Chapter4Error, Output, SAMPLES, START, Setting, Size};

/// Torque noise variance of both tables.
const NOISE: f64 = 80.0;

/// The limits of a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Limits {
    /// Wider boxes and torque between -10 and 40 Nm (Table 4.12).
    Output,
    /// The box (4.16) and a largest step of its range divided by `levels - 1` (Table 4.13).
    Rate {
        /// Levels of the random walk: 9 or 5.
        levels: usize,
    },
}

/// A kind of signal within limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// A random kind, drawn towards the middle of the box until the predicted torque keeps its limits.
    Shrunk(Source),
    /// A random walk with the largest steps, reflected at the box.
    Walk,
    /// An AI-optimal design within the limits.
    Ai,
}

impl Limits {
    /// Kinds of signals that the table compares.
    pub fn kinds(self) -> Vec<Kind> {
        match self {
            Limits::Output => {
                let shrunk = [Source::Prbs, Source::Aprbs, Source::Udrn].map(Kind::Shrunk);
                shrunk.into_iter().chain([Kind::Ai]).collect()
            }
            Limits::Rate { .. } => vec![Kind::Walk, Kind::Ai],
        }
    }

    /// Name in tables and of tasks.
    pub fn name(self) -> String {
        match self {
            Limits::Output => "output-limits".into(),
            Limits::Rate { levels } => format!("rate-limits-{levels}-levels"),
        }
    }

    /// Channels: boxes of section 4.9.1, or rate limits.
    pub fn channels(self, setting: &Setting) -> Vec<Channel> {
        let mut channels = setting.channels.clone();
        match self {
            Limits::Output => {
                let boxes = [(1800.0, 6200.0), (0.35, 0.65), (800.0, 2200.0)];
                channels.iter_mut().zip(boxes).for_each(|(c, b)| (c.lower, c.upper) = b);
            }
            Limits::Rate { levels } => {
                let step = |c: &Channel| (c.upper - c.lower) / (levels.max(2) - 1) as f64;
                channels.iter_mut().for_each(|c| c.rate_per_sample = Some(step(c)));
            }
        }
        channels
    }

    /// The design problem of the table.
    fn problem<'a>(self, setting: &'a Setting, mut term: Term<'a>) -> DesignProblem<'a> {
        if self == Limits::Output {
            term.limits = Some(OutputLimits { lower: TORQUE.0, upper: TORQUE.1, margin: 0.0 });
        }
        DesignProblem { channels: self.channels(setting), ..problem(setting, vec![term]) }
    }
}

/// Torque limits of section 4.9.1 in Nm.
const TORQUE: (f64, f64) = (-10.0, 40.0);

impl Kind {
    /// Name in tables.
    pub fn name(self) -> String {
        match self {
            Kind::Shrunk(source) => source.name(),
            Kind::Walk => "rw".into(),
            Kind::Ai => "ai".into(),
        }
    }

    fn number(self) -> u64 {
        match self {
            Kind::Shrunk(source) => source.number(),
            Kind::Walk => 3,
            Kind::Ai => 4,
        }
    }
}

/// What a kind of signal is worth within the limits.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Row {
    /// Kind of identification signals.
    pub kind: Kind,
    /// Share of the box that the signals use.
    pub share: Option<Stat>,
    /// `J_AI` of the signals.
    pub criterion: Option<Stat>,
    /// Largest violation of a torque or rate limit over all signals, in Nm or as a share of the step.
    pub violation: f64,
    /// Mean R2 in percent on noisy signals of each kind of the table, and its standard error.
    pub r2: Vec<(f64, f64)>,
    /// The first signal (N x 3).
    pub example: Vec<f64>,
}

/// A table.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Constrained {
    /// Limits.
    pub limits: Limits,
    /// Size.
    pub size: Size,
    /// One row per kind of identification signal.
    pub rows: Vec<Row>,
}

struct Made {
    record: Record,
    share: f64,
}

/// Makes the signals of every kind within `limits`, identifies a model from each and validates all on all.
///
/// # Errors
/// [`Chapter4Error`].
///
/// ```
/// use dynocal_studies::chapter4::work::constrained::{Limits, constrained};
/// use dynocal_studies::chapter4::work::{Setting, Size};
/// let size = Size { identification: 2, validation: 2, designed: 2, seed: 1 };
/// let found = constrained(&Setting::new()?, Limits::Rate { levels: 5 }, size, &|| false)?;
/// assert!(found.rows.iter().all(|r| r.violation <= 1e-9));
/// # Ok::<(), dynocal_studies::chapter4::work::Chapter4Error>(())
/// ```
pub fn constrained(
    setting: &Setting,
    limits: Limits,
    size: Size,
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Result<Constrained, Chapter4Error> {
    let kinds = limits.kinds();
    let mut validation = Vec::new();
    for &kind in &kinds {
        let n = if kind == Kind::Ai { size.designed } else { size.validation };
        let made = make(setting, limits, kind, n, 2, size.seed, interrupt)?;
        let records: Vec<Record> = made.into_iter().map(|m| m.record).collect();
        let stream = 9 << 40 | kind.number() << 32;
        validation.push(unseen(setting, Output::Torque, NOISE, &records, (size.seed, stream))?);
    }
    let mut rows = Vec::new();
    for &kind in &kinds {
        let made = make(setting, limits, kind, size.identification, 1, size.seed, interrupt)?;
        let shares: Vec<f64> = made.iter().map(|m| m.share).collect();
        let records: Vec<Record> = made.into_iter().map(|m| m.record).collect();
        let told = told(setting, Output::Torque, &records)?;
        let stream = 8 << 40 | kind.number() << 32;
        let models = identify(setting, Output::Torque, NOISE, &records, &told, (size.seed, stream))?;
        let r2 = validation.iter().map(|v| validate(setting, Output::Torque, &models, v).r2).collect();
        rows.push(Row {
            kind,
            share: matches!(kind, Kind::Shrunk(_)).then(|| Stat::of(&shares)).flatten(),
            criterion: criterion(setting, limits, &records)?,
            violation: violation(setting, limits, &records)?,
            r2,
            example: records.first().map_or_else(Vec::new, |r| r.u.clone()),
        });
        if interrupt() {
            return Err(Chapter4Error::Interrupted);
        }
    }
    Ok(Constrained { limits, size, rows })
}

fn make(
    setting: &Setting,
    limits: Limits,
    kind: Kind,
    n: usize,
    set: u64,
    seed: u64,
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Result<Vec<Made>, Chapter4Error> {
    let channels = limits.channels(setting);
    let one = |k: usize| -> Result<Made, Chapter4Error> {
        let stream = (set << 32) | ((32 + kind.number()) << 24) | k as u64;
        match kind {
            Kind::Shrunk(source) => shrink(setting, &channels, random(&channels, source, seed, stream)),
            Kind::Walk => Ok(Made { record: walk(&channels, &mut Rng64::stream(seed, stream)), share: 1.0 }),
            Kind::Ai => {
                let ai = DesignCriterion::Ai.build()?;
                let term = term(setting, Output::Torque, ai.as_ref(), 1.0, &setting.u0);
                let start = seed.wrapping_add((set - 1) << 32).wrapping_add(k as u64);
                let record = designed(&limits.problem(setting, term), start, interrupt)?;
                Ok(Made { record, share: 1.0 })
            }
        }
    };
    (0..n).into_par_iter().map(one).collect()
}

/// Largest share of the box about its middle at which the predicted torque keeps its limits (the thesis tunes by hand).
fn shrink(setting: &Setting, channels: &[Channel], record: Record) -> Result<Made, Chapter4Error> {
    let m = channels.len();
    let at = |share: f64| -> Vec<f64> {
        let middle = |i: usize| 0.5 * (channels[i].lower + channels[i].upper);
        record.u.iter().enumerate().map(|(k, v)| middle(k % m) + share * (v - middle(k % m))).collect()
    };
    let keeps = |u: &[f64]| -> Result<bool, Chapter4Error> {
        let (y, _) = truth(setting, Output::Torque, u)?;
        Ok(y[START..].iter().all(|y| (TORQUE.0..=TORQUE.1).contains(y)))
    };
    let (mut low, mut high) = (0.0, 1.0);
    if keeps(&record.u)? {
        return Ok(Made { record, share: 1.0 });
    }
    for _ in 0..30 {
        let share = 0.5 * (low + high);
        if keeps(&at(share))? { low = share } else { high = share }
    }
    Ok(Made { record: Record { u: at(low), objective: None }, share: low })
}

/// Random directions with the largest steps, turned round where the box would be left (thesis Figure 4.9); it starts at
/// a random multiple of the step.
fn walk(channels: &[Channel], rng: &mut Rng64) -> Record {
    let m = channels.len();
    let mut u = vec![0.0; SAMPLES * m];
    for (i, c) in channels.iter().enumerate() {
        let step = c.rate_per_sample.unwrap_or(c.upper - c.lower);
        let steps = ((c.upper - c.lower) / step).round() as usize;
        let mut level = rng.below(steps + 1);
        for t in 0..SAMPLES {
            u[t * m + i] = (c.lower + level as f64 * step).min(c.upper);
            let up = rng.below(2) == 1;
            level = match (up, level) {
                (true, l) if l == steps => l - 1,
                (false, 0) => 1,
                (true, l) => l + 1,
                (false, l) => l - 1,
            };
        }
    }
    Record { u, objective: None }
}

fn criterion(setting: &Setting, limits: Limits, records: &[Record]) -> Result<Option<Stat>, Chapter4Error> {
    let ai = DesignCriterion::Ai.build()?;
    let term = term(setting, Output::Torque, ai.as_ref(), 1.0, &setting.u0);
    let mut evaluator = Evaluator::new(&limits.problem(setting, term))?;
    Ok(Stat::of(&records.iter().map(|r| evaluator.value(&r.u)).collect::<Vec<f64>>()))
}

fn violation(setting: &Setting, limits: Limits, records: &[Record]) -> Result<f64, Chapter4Error> {
    let channels = limits.channels(setting);
    let m = channels.len();
    let mut worst = 0.0f64;
    for r in records {
        if limits == Limits::Output {
            let (y, _) = truth(setting, Output::Torque, &r.u)?;
            worst = y[START..].iter().fold(worst, |w, y| w.max(TORQUE.0 - y).max(y - TORQUE.1));
            continue;
        }
        for (i, c) in channels.iter().enumerate() {
            let step = c.rate_per_sample.unwrap_or(f64::INFINITY);
            let moves = (1..SAMPLES).map(|t| (r.u[t * m + i] - r.u[(t - 1) * m + i]).abs() / step - 1.0);
            worst = moves.fold(worst, f64::max);
        }
    }
    Ok(worst)
}
