//! Preparation of measured records: repeatable steps between the file and the fit.
//!
//! A step takes the records of all experiments and gives new ones (a step may split one into several) together with a
//! [`Note`] of what it did: enough to read, to repeat on other records and, where that is possible, to undo. What a
//! step learns from the records (a mean, a spread) is applied to others unchanged by [`repeat`], so that a test
//! record gets the numbers of the estimation record and not its own.
//!
//! A missing sample is NaN throughout. Steps that need every sample say which one is missing.
//!
//! ```
//! use dynocal_ident::data::{Channel, Dataset, Role};
//! use dynocal_ident::prepare::{Planned, prepare};
//! let torque = vec![50.0, 51.0, 52.0, 400.0, 54.0, 55.0, f64::NAN, 57.0];
//! let channel = Channel { name: "torque".into(), unit: "Nm".into(), role: Role::Output, values: torque };
//! let (name, origin) = ("run 1".into(), "example".into());
//! let record = Dataset { name, sample_time_s: 0.1, channels: vec![channel], init_samples: 0, origin };
//! let plan = [
//!     Planned::new("hampel", &toml::from_str("half_width = 3")?)?,
//!     Planned::new("missing", &toml::from_str("longest = 2")?)?,
//! ];
//! let (clean, notes) = prepare(&plan, vec![record], &mut |_, _| ())?;
//! assert_eq!(clean[0].channels[0].values, (50..58).map(f64::from).collect::<Vec<_>>());
//! assert_eq!(notes[0].sentences()[0], "run 1, torque: 1 sample interpolated (3)");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod action;
mod common;
mod crank;
mod decimate;
mod delay;
mod event;
pub mod filter;
mod hampel;
mod missing;
mod note;
mod offset;
mod resample;
pub mod residual;
mod scale;
mod window;

use dynocal_numerics::registry::{self, BuildError, Member, MemberDoc};

use crate::data::{DataError, Dataset};

pub use note::{Became, Change, Effect, Note, restore};

/// What a step made of the records.
#[derive(Clone, Debug, Default)]
pub struct Outcome {
    /// The new records.
    pub records: Vec<Dataset>,
    /// What changed where.
    pub changes: Vec<Change>,
    /// What an engineer should know about it, in sentences.
    pub remarks: Vec<String>,
}

/// One step of the preparation.
pub trait Step: Send + Sync {
    /// Applies the step to all records.
    ///
    /// # Errors
    /// [`PrepareError`]: a channel is not there, or a record cannot take the step.
    fn apply(&self, records: Vec<Dataset>) -> Result<Outcome, PrepareError>;

    /// The step with the numbers that it learnt from other records (`changes` of its [`Note`]) held fixed; none
    /// where nothing is learnt.
    fn learnt(&self, _changes: &[Change]) -> Option<Box<dyn Step>> {
        None
    }
}

/// All steps.
pub static STEPS: &[Member<dyn Step>] = &[
    window::MEMBER,
    missing::MEMBER,
    hampel::MEMBER,
    resample::MEMBER,
    event::MEMBER,
    delay::MEMBER,
    filter::MEMBER,
    decimate::MEMBER,
    offset::MEMBER,
    scale::MEMBER,
];

/// Documentation of all steps.
pub fn docs() -> Vec<MemberDoc> {
    STEPS.iter().map(|m| m.doc).collect()
}

/// Records cannot be prepared as asked.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PrepareError {
    /// A record is not what the caller said.
    #[error(transparent)]
    Data(#[from] DataError),
    /// A record cannot take a step.
    #[error("step {step}, {record}: {message}")]
    Step {
        /// Step.
        step: &'static str,
        /// Record name.
        record: String,
        /// What was found and what was expected.
        message: String,
    },
    /// Nothing is left.
    #[error("after the step `{step}` no record is left: {}", .why.join("; "))]
    NothingLeft {
        /// Step.
        step: String,
        /// What the step did.
        why: Vec<String>,
    },
}

/// A step with its name and keys as the spec gives them.
pub struct Planned {
    /// Name in [`STEPS`].
    pub name: String,
    /// Keys of the step.
    pub keys: toml::Table,
    step: Box<dyn Step>,
}

impl Planned {
    /// Builds the step `name` from the keys of a spec.
    ///
    /// # Errors
    /// [`BuildError`] with the nearest known name, or the key that does not fit.
    pub fn new(name: &str, keys: &toml::Table) -> Result<Self, BuildError> {
        let step = registry::build("preparation step", STEPS, name, keys)?;
        Ok(Self { name: name.into(), keys: keys.clone(), step })
    }
}

/// Applies the steps in order. `watch(k, records)` sees the records before the first step (k = 0) and after the k-th.
///
/// # Errors
/// [`PrepareError`] of the first step that fails; infinite samples and channels without any sample are refused.
pub fn prepare(
    plan: &[Planned],
    mut records: Vec<Dataset>,
    watch: &mut dyn FnMut(usize, &[Dataset]),
) -> Result<(Vec<Dataset>, Vec<Note>), PrepareError> {
    for record in &records {
        record.check_marked()?;
        if record.is_empty() {
            let why = "a record holds at least one sample".into();
            return Err(
                DataError::TooShort { record: record.name.clone(), found: 0, expected: 1, why }.into()
            );
        }
    }
    watch(0, &records);
    let mut notes = Vec::with_capacity(plan.len());
    for (k, planned) in plan.iter().enumerate() {
        let before = note::Size::of(&records);
        let outcome = planned.step.apply(records)?;
        records = outcome.records;
        let note = Note {
            step: planned.name.clone(),
            keys: planned.keys.clone(),
            before,
            after: note::Size::of(&records),
            changes: outcome.changes,
            remarks: outcome.remarks,
        };
        if records.is_empty() {
            return Err(PrepareError::NothingLeft { step: note.step.clone(), why: note.sentences() });
        }
        notes.push(note);
        watch(k + 1, &records);
    }
    Ok((records, notes))
}

/// The same steps for other records: what was learnt (means, scales, nominal speeds) stays as the notes say.
///
/// # Errors
/// [`BuildError`]; none for notes that [`prepare`] gave for this plan.
pub fn repeat(plan: &[Planned], notes: &[Note]) -> Result<Vec<Planned>, BuildError> {
    let one = |(planned, note): (&Planned, &Note)| match planned.step.learnt(&note.changes) {
        Some(step) => Ok(Planned { name: planned.name.clone(), keys: planned.keys.clone(), step }),
        None => Planned::new(&planned.name, &planned.keys),
    };
    plan.iter().zip(notes).map(one).collect()
}

/// Steps that repeat what `notes` say, for records that need not have all channels of the estimation: what concerns a
/// channel that is not `present` is left out, and a step that only concerns such.
///
/// # Errors
/// [`BuildError`] for notes that no step of this crate gave.
pub fn again(notes: &[Note], present: &[String]) -> Result<Vec<Planned>, BuildError> {
    let mut plan = Vec::new();
    for note in notes {
        let here = |c: &&Change| c.channel.as_ref().is_none_or(|name| present.contains(name));
        let changes: Vec<Change> = note.changes.iter().filter(here).cloned().collect();
        let mut keys = note.keys.clone();
        if let Some(toml::Value::Array(channels)) = keys.get_mut("channels") {
            channels.retain(|c| c.as_str().is_some_and(|c| present.iter().any(|p| p == c)));
            if channels.is_empty() {
                continue;
            }
        }
        let learnt = Planned::new(&note.step, &note.keys)?.step.learnt(&changes);
        let nothing = changes.is_empty() && note.changes.iter().any(|c| c.channel.is_some());
        plan.push(match learnt {
            Some(_) if nothing => continue,
            Some(step) => Planned { name: note.step.clone(), keys, step },
            None => Planned::new(&note.step, &keys)?,
        });
    }
    Ok(plan)
}
