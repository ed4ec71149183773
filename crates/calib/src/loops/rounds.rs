//! Identify, design, measure, again: the iterative design of thesis Figure 4.2 and its sequential form.

use dynocal_design::problem::OutputLimits;
use dynocal_design::search::{DesignOptions, DesignOutcome};
use dynocal_ident::data::Dataset;
use dynocal_ident::plant::Plant;
use dynocal_ident::validate::cross::Blocks;
use dynocal_numerics::interval::Interval;
use serde::{Deserialize, Serialize};

use super::LoopError;
use super::bed::TestBed;
use super::margin::held_out_margins;
use super::model::mean_square;
use super::plan::{Aim, Known, Structure, know, next_record};
use super::stop::{Forecast, Stage, forecast};
use super::variance::{relative_variance, with_record};

/// Limits of a measured output and the rate of violations that is accepted.
#[derive(Clone, Debug, PartialEq)]
pub struct Limit {
    /// Output of the plant.
    pub output: String,
    /// Least value.
    pub lower: f64,
    /// Largest value.
    pub upper: f64,
    /// Accepted share of violations among samples that are predicted to be at a limit.
    pub rate: f64,
    /// Factor on the margins of the first designed record, which leaves the region of the first records: a schedule of
    /// limits, conservative at first (thesis section 4.4).
    pub caution: f64,
}

/// A loop of designed records.
#[derive(Clone, Copy)]
pub struct Rounds<'a> {
    /// What is moved.
    pub bed: &'a TestBed,
    /// What is identified; all of it counts in the design.
    pub structures: &'a [Structure<'a>],
    /// What records are designed for.
    pub aim: &'a Aim,
    /// Samples of a designed record.
    pub samples: usize,
    /// Most rounds.
    pub rounds: usize,
    /// Limits of outputs.
    pub limits: &'a [Limit],
}

/// The limits of an output with their margins taken off.
#[derive(Clone, Debug, PartialEq)]
pub struct KeptLimits {
    /// Output.
    pub output: String,
    /// Least and largest prediction that is allowed, in the unit of the output.
    pub kept: Interval,
}

/// One designed and measured record.
#[derive(Clone, Debug)]
pub struct Round {
    /// The design.
    pub design: DesignOutcome,
    /// What the predictions of the limited outputs had to keep to.
    pub limits: Vec<KeptLimits>,
    /// What the record was expected to be worth, where held-out records were given.
    pub forecast: Option<Forecast>,
    /// Held-out state of the campaign before the record, where held-out records were given.
    pub stage: Option<Stage>,
    /// Estimates before the record.
    pub known: Vec<Known>,
}

/// Records, rounds and what is known at the end.
#[derive(Clone, Debug)]
pub struct Campaign {
    /// All records: the initial ones, then one per round.
    pub records: Vec<Dataset>,
    /// The rounds.
    pub rounds: Vec<Round>,
    /// Estimates from all records.
    pub known: Vec<Known>,
    /// Whether the stop rule ended the campaign.
    pub stopped: bool,
}

/// When a sequential campaign ends.
#[derive(Clone, Copy, Debug)]
pub struct StopRule<'a> {
    /// Records that no model is identified from.
    pub held_out: &'a [Dataset],
    /// Variance of their measurement noise where it is known, else 0.
    pub noise: f64,
    /// Expected reduction of the mean squared error, as a share of the present one, below which a record is not run.
    pub threshold: f64,
}

/// How a campaign treats time and earlier records.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
enum Course {
    /// Every record is designed for itself and starts from rest; records are pooled for identification.
    Separate,
    /// Every record adds to the earlier ones and goes on where the last one ended.
    Continuous,
}

/// Iterative design (thesis Figure 4.2): from the `initial` records on, every round identifies from all records,
/// designs the next and measures it.
///
/// Each record starts from rest at its first row. With [`Aim::adds`] the design adds to what the earlier records tell;
/// without, it is designed for itself as the thesis does.
///
/// # Errors
/// [`LoopError`] of the plant, an estimation or a design.
pub fn iterate(
    plant: &mut dyn Plant,
    rounds: &Rounds,
    initial: Vec<Dataset>,
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Result<Campaign, LoopError> {
    run(plant, rounds, initial, Course::Separate, None, interrupt)
}

/// Sequential design: every round designs the next stretch of one long test given all data so far, and goes on from
/// where the plant is. With a [`StopRule`] it ends when the next stretch is expected to be worth too little.
///
/// # Errors
/// [`LoopError`] of the plant, an estimation or a design.
pub fn sequential(
    plant: &mut dyn Plant,
    rounds: &Rounds,
    initial: Vec<Dataset>,
    stop: Option<StopRule>,
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Result<Campaign, LoopError> {
    run(plant, rounds, initial, Course::Continuous, stop, interrupt)
}

fn run(
    plant: &mut dyn Plant,
    spec: &Rounds,
    initial: Vec<Dataset>,
    course: Course,
    stop: Option<StopRule>,
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Result<Campaign, LoopError> {
    let mut campaign = Campaign { records: initial, rounds: Vec::new(), known: Vec::new(), stopped: false };
    let mut history = Vec::new();
    let aim = Aim { adds: course == Course::Continuous || spec.aim.adds, ..spec.aim.clone() };
    for k in 0..spec.rounds {
        let known = know(spec.bed, spec.structures, &campaign.records)?;
        let bed = bed_now(spec.bed, &campaign.records, course)?;
        let limits = limits(spec, &campaign.records, k)?;
        let narrowed: Vec<(&str, OutputLimits)> = limits
            .iter()
            .map(|l| {
                (l.output.as_str(), OutputLimits { lower: l.kept.lower, upper: l.kept.upper, margin: 0.0 })
            })
            .collect();
        let search =
            DesignOptions { seed: spec.aim.search.seed.wrapping_add(1000 * k as u64), ..aim.search.clone() };
        let aim = Aim { search, ..aim.clone() };
        let design = next_record(&bed, spec.structures, &known, &aim, spec.samples, &narrowed, interrupt)?;
        let (stage, expected) = match &stop {
            Some(rule) => {
                let (stage, planned) = outlook(spec, &aim, &campaign.records, &design.u, rule)?;
                // The free run of an early estimate may diverge: it says nothing but that testing must go on.
                let usable = stage.held_out.is_finite() && planned.is_finite();
                let expected = match usable {
                    true => {
                        history.push(stage);
                        Some(forecast(&history, planned, rule.noise, rule.threshold)?)
                    }
                    false => None,
                };
                (Some(stage), expected)
            }
            None => (None, None),
        };
        let end = expected.is_some_and(|f| f.stop);
        if !end {
            campaign.records.push(bed.measure(plant, &format!("round{:02}", k + 1), &design.u)?);
        }
        campaign.rounds.push(Round { design, limits, forecast: expected, stage, known });
        if end {
            campaign.stopped = true;
            break;
        }
    }
    campaign.known = know(spec.bed, spec.structures, &campaign.records)?;
    Ok(campaign)
}

/// The bed as the next record finds it: a continuous test goes on from the last row, at the rates of the channels.
fn bed_now(bed: &TestBed, records: &[Dataset], course: Course) -> Result<TestBed, LoopError> {
    let (Course::Continuous, Some(last)) = (course, records.last()) else { return Ok(bed.clone()) };
    let mut now = TestBed { settle_s: 0.0, ..bed.clone() };
    for c in &mut now.channels {
        c.before = last.values(&c.name)?.last().copied();
    }
    Ok(now)
}

/// Share of the range of an output that both margins take at most: a poor first model leaves something to design in.
const MOST_OF_RANGE: f64 = 0.8;

/// Limits of the predictions with margins from held-out blocks of the records so far.
fn limits(spec: &Rounds, records: &[Dataset], round: usize) -> Result<Vec<KeptLimits>, LoopError> {
    let mut out = Vec::new();
    for l in spec.limits {
        let Some(s) = spec.structures.iter().find(|s| s.output == l.output) else { continue };
        let data = spec.bed.experiments(records, s.output)?;
        let margins = held_out_margins(s.model, &data, l.rate, &Blocks::default())?;
        let asked = if round == 0 { l.caution } else { 1.0 };
        let most =
            MOST_OF_RANGE * (l.upper - l.lower) / (margins.lower + margins.upper).max(f64::MIN_POSITIVE);
        let factor = asked.min(most);
        let kept = Interval::new(l.lower + factor * margins.lower, l.upper - factor * margins.upper);
        out.push(KeptLimits { output: l.output.clone(), kept });
    }
    Ok(out)
}

/// Held-out state of the first structure, and its relative variance after the planned record `u`.
fn outlook(
    spec: &Rounds,
    aim: &Aim,
    records: &[Dataset],
    u: &[f64],
    rule: &StopRule,
) -> Result<(Stage, f64), LoopError> {
    let s = Structure::new(spec.structures[0].output, spec.structures[0].used());
    let known = &know(spec.bed, &[s], records)?[0];
    let held_out = spec.bed.experiments(rule.held_out, s.output)?;
    let variance = |factor: &[f64]| relative_variance(s.model, known, factor, &aim.objective);
    let stage = Stage {
        held_out: mean_square(s.model, &known.fit.theta, &held_out),
        variance: variance(&known.information)?,
        residual: known.fit.noise_variance,
        parameters: s.model.n_params(),
    };
    Ok((stage, variance(&with_record(s.model, known, u)?)?))
}
