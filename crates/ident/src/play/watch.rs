//! Who watches a plan: the trait, and watchdogs without models.

use super::{Course, PlayError, Reason, Stop};
use crate::plan::Plan;
use crate::plant::LimitEvent;

/// Watches a plan while it is played. Every method may do nothing.
pub trait Watchdog {
    /// Before anything is applied: names are there, rows are not. Returns the least number of settling samples that the
    /// watchdog needs.
    ///
    /// # Errors
    /// [`PlayError`] when the watchdog does not go with plan or plant.
    fn prepare(&mut self, _plan: &Plan, _course: &Course) -> Result<usize, PlayError> {
        Ok(0)
    }

    /// The plant has settled at the first row; the plan begins.
    ///
    /// # Errors
    /// [`PlayError::Unsafe`] when it must not begin from there.
    fn begin(&mut self, _course: &Course) -> Result<(), PlayError> {
        Ok(())
    }

    /// What speaks against applying `next_u` (m) from now on.
    fn before(&mut self, _course: &Course, _next_u: &[f64]) -> Option<Stop> {
        None
    }

    /// What speaks against going on after the last row of `course` and the limits that the plant reported during it.
    fn after(&mut self, _course: &Course, _events: &[LimitEvent]) -> Option<Stop> {
        None
    }

    /// Inputs to drive after a stop, rows x m row-major; none: the plant is left where it is.
    fn way_back(&mut self, _course: &Course) -> Vec<f64> {
        Vec::new()
    }
}

/// Nobody watches: the plan ends early only where the plant refuses it.
#[derive(Clone, Copy, Debug, Default)]
pub struct Unwatched;

impl Watchdog for Unwatched {}

/// Another watchdog with a way to interrupt: the plan ends, and the other one knows the way back.
pub struct Interruptible<'a> {
    /// Whether to stop.
    pub interrupt: &'a dyn Fn() -> bool,
    /// Who watches.
    pub watchdog: &'a mut dyn Watchdog,
}

impl Watchdog for Interruptible<'_> {
    fn prepare(&mut self, plan: &Plan, course: &Course) -> Result<usize, PlayError> {
        self.watchdog.prepare(plan, course)
    }

    fn begin(&mut self, course: &Course) -> Result<(), PlayError> {
        self.watchdog.begin(course)
    }

    fn before(&mut self, course: &Course, next_u: &[f64]) -> Option<Stop> {
        if (self.interrupt)() {
            return Some(Stop::new("user", Reason::Interrupted));
        }
        self.watchdog.before(course, next_u)
    }

    fn after(&mut self, course: &Course, events: &[LimitEvent]) -> Option<Stop> {
        self.watchdog.after(course, events)
    }

    fn way_back(&mut self, course: &Course) -> Vec<f64> {
        self.watchdog.way_back(course)
    }
}

/// Ends a plan when the needles stand still: every output of `bands` within its band about a value for `still` samples,
/// and then `more` samples for the average.
///
/// The plant stays where it is, so that the next plan goes on from there.
#[derive(Clone, Debug)]
pub struct UntilStill {
    /// Outputs with the value and half width of their bands.
    pub bands: Vec<Band>,
    /// Samples that all outputs must be within.
    pub still: usize,
    /// Samples that are played after them.
    pub more: usize,
    /// Places of the outputs.
    places: Vec<usize>,
    quiet: usize,
    left: Option<usize>,
}

/// An output that is waited for.
#[derive(Clone, Debug, PartialEq)]
pub struct Band {
    /// Output.
    pub output: String,
    /// Value that it should come to.
    pub value: f64,
    /// Half width.
    pub half_width: f64,
}

impl UntilStill {
    /// Waits for `bands` over `still` samples, then `more`.
    pub fn new(bands: Vec<Band>, still: usize, more: usize) -> Self {
        Self { bands, still, more, places: Vec::new(), quiet: 0, left: None }
    }

    /// Whether the outputs came to rest.
    pub fn reached(&self) -> bool {
        self.left.is_some()
    }
}

impl Watchdog for UntilStill {
    fn prepare(&mut self, _plan: &Plan, course: &Course) -> Result<usize, PlayError> {
        (self.quiet, self.left) = (0, None);
        let place = |b: &Band| {
            course.outputs.iter().position(|o| *o == b.output).ok_or_else(|| PlayError::Model {
                output: b.output.clone(),
                reason: format!("there is no such output; outputs are: {}", course.outputs.join(", ")),
            })
        };
        self.places = self.bands.iter().map(place).collect::<Result<_, _>>()?;
        Ok(0)
    }

    fn after(&mut self, course: &Course, _events: &[LimitEvent]) -> Option<Stop> {
        if let Some(left) = &mut self.left {
            *left = left.saturating_sub(1);
        } else {
            let y = course.output(course.rows());
            let pairs = self.bands.iter().zip(&self.places);
            let inside = pairs.clone().all(|(b, i)| (y[*i] - b.value).abs() < b.half_width);
            self.quiet = if inside { self.quiet + 1 } else { 0 };
            if self.quiet >= self.still {
                self.left = Some(self.more);
            }
        }
        (self.left == Some(0)).then(|| Stop::new("", Reason::Still))
    }
}
