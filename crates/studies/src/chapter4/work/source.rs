//! Where identification and validation signals come from.

use dynocal_design::channel::Channel;
use dynocal_design::criterion::{Criterion, criterion};
use dynocal_design::problem::{Convention, DesignProblem, Term};
use dynocal_design::search::{DesignOptions, design};
use dynocal_ident::model::Model;
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::status::Status;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{Chapter4Error, Output, SAMPLES, START, Setting};

/// A kind of signal.
///
/// The random kinds draw every sample of every channel independently, as the generators of thesis Figures 4.6 and 4.8
/// do; a level may follow itself. (The library's `prbs` and `aprbs` signals differ: a shift register, and never the
/// same level twice.)
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Source {
    /// Two levels: the ends of the box.
    Prbs,
    /// Five equidistant levels.
    Aprbs,
    /// Uniformly distributed values.
    Udrn,
    /// Designed for the torque model, from a uniform random start.
    Design(DesignCriterion),
    /// Designed for both models together, weights of thesis Table 4.16.
    Composite(DesignCriterion),
}

/// Criteria of the designs of the chapter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DesignCriterion {
    /// `-ln det M`, eq. (4.36).
    D,
    /// `tr M^-1`, eq. (4.28).
    A,
    /// Weighted A, eq. (4.35).
    Wa,
    /// Sum of the prediction variances over U0, eq. (4.45).
    I,
    /// Largest prediction variance over U0.
    G,
    /// The same as I with the diagonal of the covariance alone, eq. (4.50).
    Ai,
}

impl DesignCriterion {
    /// All of them.
    pub const ALL: [Self; 6] = [Self::D, Self::A, Self::Wa, Self::I, Self::G, Self::Ai];

    /// Name of the member of the table of criteria.
    pub fn name(self) -> &'static str {
        match self {
            Self::D => "d",
            Self::A => "a",
            Self::Wa => "wa",
            Self::I => "i",
            Self::G => "g",
            Self::Ai => "ai",
        }
    }

    /// Builds it.
    ///
    /// # Errors
    /// Never for the names of this table; the type is that of the table.
    pub fn build(self) -> Result<Box<dyn Criterion>, Chapter4Error> {
        Ok(criterion(self.name(), &toml::Table::new())?)
    }

    /// Weights of torque and lambda in a composite, eq. (4.54) with lambda counted twice (Table 4.16).
    ///
    /// D: `477.91 J_torque + 802.84 J_lambda`. AI: `J_torque / 1.8109e6 + 2 J_lambda / 3945.2`, which is the printed pair
    /// 3945.2 and 3621.8 with the torque criterion in thousands, divided by 3945.2 and 1810.9; other criteria as D.
    fn weights(self) -> (f64, f64) {
        match self {
            Self::Ai => (1.0 / 1.8109e6, 2.0 / 3945.2),
            _ => (477.91, 802.84),
        }
    }
}

impl Source {
    /// Name in tables and of tasks.
    pub fn name(self) -> String {
        match self {
            Source::Prbs => "prbs".into(),
            Source::Aprbs => "aprbs".into(),
            Source::Udrn => "udrn".into(),
            Source::Design(c) => c.name().into(),
            Source::Composite(c) => format!("{}-composite", c.name()),
        }
    }

    /// Whether a search makes it.
    pub fn is_designed(self) -> bool {
        matches!(self, Source::Design(_) | Source::Composite(_))
    }

    /// Number of the kind in streams of noise.
    pub(super) fn number(self) -> u64 {
        match self {
            Source::Prbs => 0,
            Source::Aprbs => 1,
            Source::Udrn => 2,
            Source::Design(c) => 3 + c as u64,
            Source::Composite(c) => 16 + c as u64,
        }
    }

    /// Random stream of the kind: kinds never share numbers.
    fn stream(self) -> u64 {
        match self {
            Source::Prbs => 1,
            Source::Aprbs => 2,
            Source::Udrn => 3,
            Source::Design(_) | Source::Composite(_) => 4,
        }
    }
}

/// A signal.
#[derive(Clone, Debug)]
pub struct Record {
    /// Samples (100 x 3).
    pub u: Vec<f64>,
    /// Objective that the design reached; none for a random signal.
    pub objective: Option<f64>,
}

/// `n` signals of a kind; `set` (from 1 on) tells independent sets of signals apart.
///
/// Number k of a design of the first set starts from random numbers of `seed + k` alone, with the default search and
/// budget, so that one design is one run from one start.
///
/// # Errors
/// [`Chapter4Error`] of a design, or [`Chapter4Error::Interrupted`].
pub fn signals(
    setting: &Setting,
    source: Source,
    n: usize,
    set: u64,
    seed: u64,
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Result<Vec<Record>, Chapter4Error> {
    let start = |k: usize| seed.wrapping_add(set.saturating_sub(1) << 32).wrapping_add(k as u64);
    (0..n)
        .into_par_iter()
        .map(|k| match source {
            Source::Design(c) => {
                let c = c.build()?;
                let terms = vec![term(setting, Output::Torque, c.as_ref(), 1.0, &setting.u0)];
                designed(&problem(setting, terms), start(k), interrupt)
            }
            Source::Composite(c) => {
                let (torque, lambda) = c.weights();
                let c = c.build()?;
                let terms = vec![
                    term(setting, Output::Torque, c.as_ref(), torque, &setting.u0),
                    term(setting, Output::Lambda, c.as_ref(), lambda, &setting.u0),
                ];
                designed(&problem(setting, terms), start(k), interrupt)
            }
            _ => Ok(random(&setting.channels, source, seed, set << 32 | source.stream() << 24 | k as u64)),
        })
        .collect()
}

/// The term of one output: criterion over the objective signal at the printed parameters.
pub(super) fn term<'a>(
    setting: &'a Setting,
    output: Output,
    criterion: &'a dyn Criterion,
    weight: f64,
    objective_signal: &'a [f64],
) -> Term<'a> {
    let m = setting.model(output);
    let model: &dyn Model = &m.model;
    Term {
        objective_signal,
        weight,
        ..Term::new(output.name(), model, &m.theta, m.noise_variance, criterion)
    }
}

/// The design problem of the chapter.
pub(super) fn problem<'a>(setting: &Setting, terms: Vec<Term<'a>>) -> DesignProblem<'a> {
    DesignProblem {
        channels: setting.channels.clone(),
        n_samples: SAMPLES,
        convention: Convention::Trim,
        start: START,
        terms,
    }
}

/// One run of the default search from one start.
pub(super) fn designed(
    problem: &DesignProblem,
    seed: u64,
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Result<Record, Chapter4Error> {
    let options = DesignOptions { seed, ..DesignOptions::default() };
    let found = design(problem, &options, interrupt, &|_| {})?;
    if found.status == Status::Interrupted {
        return Err(Chapter4Error::Interrupted);
    }
    Ok(Record { u: found.u, objective: Some(found.value) })
}

/// A random signal in the boxes of `channels`.
pub(super) fn random(channels: &[Channel], source: Source, seed: u64, stream: u64) -> Record {
    let mut rng = Rng64::stream(seed, stream);
    let mut u = Vec::with_capacity(SAMPLES * channels.len());
    for _ in 0..SAMPLES {
        for c in channels {
            let share = match source {
                Source::Prbs => rng.below(2) as f64,
                Source::Aprbs => rng.below(5) as f64 / 4.0,
                _ => rng.uniform(),
            };
            u.push((1.0 - share) * c.lower + share * c.upper);
        }
    }
    Record { u, objective: None }
}
