//! What a job would take: its plan, its memory and its work, before it runs.
//!
//! Memory is that of the largest arrays, work is that of the dominant loops in floating-point operations; both are of the
//! right order of magnitude, no more. A job above [`MOST_BYTES`] is refused before it allocates anything.

use serde::Serialize;

/// Most memory that a job may ask for, in bytes.
pub const MOST_BYTES: f64 = 16e9;

/// A line of a plan.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PlanLine {
    /// What it is about.
    pub what: String,
    /// What will be done.
    pub text: String,
}

/// The plan of a job with an estimate of what it takes.
///
/// ```
/// use dynocal_jobs::estimate::Estimate;
/// let plan = Estimate::new("fit").line("record", "1000 samples").memory(8e3).work(1e6);
/// assert!(plan.allowed().is_ok());
/// assert!(plan.clone().memory(1e15).allowed().is_err());
/// ```
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Estimate {
    /// Name of the run.
    pub name: String,
    /// The plan.
    pub plan: Vec<PlanLine>,
    /// Memory of the largest arrays in bytes.
    pub memory_bytes: f64,
    /// Floating-point operations of the dominant loops.
    pub operations: f64,
}

/// A job asks for more than a machine has.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "{name} would take about {needed_gb:.0} GB of memory, at most {most_gb:.0} GB are allowed: shorten the record, or take fewer channels, parameters or candidates"
)]
pub struct TooLarge {
    /// Name of the run.
    pub name: String,
    /// Memory needed, in 1e9 bytes.
    pub needed_gb: f64,
    /// Memory allowed.
    pub most_gb: f64,
}

impl Estimate {
    /// An empty plan.
    pub fn new(name: impl Into<String>) -> Self {
        Self { name: name.into(), plan: Vec::new(), memory_bytes: 0.0, operations: 0.0 }
    }

    /// Adds a line.
    pub fn line(mut self, what: impl Into<String>, text: impl Into<String>) -> Self {
        self.plan.push(PlanLine { what: what.into(), text: text.into() });
        self
    }

    /// Adds memory that is held at the same time, in bytes.
    pub fn memory(mut self, bytes: f64) -> Self {
        self.memory_bytes += bytes;
        self
    }

    /// Adds work, in floating-point operations.
    pub fn work(mut self, operations: f64) -> Self {
        self.operations += operations;
        self
    }

    /// Whether the job may start.
    ///
    /// # Errors
    /// [`TooLarge`] above [`MOST_BYTES`].
    pub fn allowed(&self) -> Result<(), TooLarge> {
        if self.memory_bytes <= MOST_BYTES {
            return Ok(());
        }
        let (needed_gb, most_gb) = (1e-9 * self.memory_bytes, 1e-9 * MOST_BYTES);
        Err(TooLarge { name: self.name.clone(), needed_gb, most_gb })
    }
}
