//! A record in segments, as it was optimised before the whole fitted into a computer (thesis section 7.5).
//!
//! A segment knows nothing of what comes after it. Its last inputs are then chosen for the outputs within it alone, and
//! the next one starts with outputs that its own demand does not continue: spikes, or no solution at all. Two ways out:
//! it looks ahead beyond its end and forgets what it found there, or its last inputs, as far as they act on the next
//! segment, stay those of the start record, so that all segments fit exactly and are independent of each other.

use super::result::PartOutcome;
use super::setup::Setup;
use super::shortfall::shortfalls;
use super::{EndCondition, Found, OptimiseOptions, batch, failed};
use dynocal_numerics::status::Status;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// What happens where two segments meet.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Seam {
    /// Nothing: each segment starts from the start record (as published, thesis section 7.5.2).
    Independent,
    /// The same, and the inputs around each seam are then replaced by their mean over `width_s` (thesis figure 7.11).
    Smoothed {
        /// Width in s.
        width_s: f64,
    },
    /// One after the other, each looking ahead beyond its end.
    LookAhead {
        /// How far in s.
        ahead_s: f64,
    },
    /// Inputs that act on the next segment are those of the start record.
    #[default]
    Pinned,
}

/// Segments of a record.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Segments {
    /// Length in s.
    pub length_s: f64,
    /// Where two meet.
    #[serde(default)]
    pub seam: Seam,
}

/// Optimises segment by segment.
pub(super) fn solve(
    setup: &Setup<'_>,
    options: &OptimiseOptions,
    spec: &Segments,
    interrupt: &dyn Fn() -> bool,
) -> Found {
    let count = |s: f64| (s / setup.sample_time_s).round().max(0.0) as usize;
    let length = count(spec.length_s).max(setup.lag + 1);
    let starts: Vec<usize> = (setup.from..setup.to).step_by(length).collect();
    let segments: Vec<Range<usize>> =
        starts.iter().map(|&a| a..a.saturating_add(length).min(setup.to)).collect();
    match spec.seam {
        Seam::LookAhead { ahead_s } => in_turn(setup, options, &segments, count(ahead_s), interrupt),
        seam => {
            let mut found = side_by_side(setup, options, &segments, seam, interrupt);
            if let Seam::Smoothed { width_s } = seam {
                smooth(setup, &mut found.values, &segments, count(width_s));
            }
            found
        }
    }
}

/// Samples of the program that decides `segment` and looks `ahead` samples beyond it.
fn samples_of(setup: &Setup<'_>, segment: &Range<usize>, ahead: usize) -> Range<usize> {
    let more = setup.samples - setup.to;
    let from = if segment.start == setup.from { 0 } else { segment.start - setup.lag };
    from..segment.end.saturating_add(ahead).min(setup.to) + more
}

fn in_turn(
    setup: &Setup<'_>,
    options: &OptimiseOptions,
    segments: &[Range<usize>],
    ahead: usize,
    interrupt: &dyn Fn() -> bool,
) -> Found {
    let mut found = Found::start(setup);
    for (k, segment) in segments.iter().enumerate() {
        let range = samples_of(setup, segment, ahead);
        let last = k + 1 == segments.len();
        let end = if last { options.end } else { EndCondition::Free };
        let slice = setup.slice(&found.values, range.clone(), end);
        let part = batch(&slice, options, interrupt);
        found.explain(&slice, &range, part.status, options, interrupt);
        // The plan beyond the segment is where the next one starts.
        found.take(setup, segment, &range, segment.start..range.end, &part);
        if part.status == Status::Interrupted {
            break;
        }
    }
    found
}

fn side_by_side(
    setup: &Setup<'_>,
    options: &OptimiseOptions,
    segments: &[Range<usize>],
    seam: Seam,
    interrupt: &dyn Fn() -> bool,
) -> Found {
    let mut found = Found::start(setup);
    for (k, segment) in segments.iter().enumerate() {
        let range = samples_of(setup, segment, 0);
        let end = match k + 1 == segments.len() {
            true => options.end,
            false if seam == Seam::Pinned => EndCondition::Start,
            false => EndCondition::Free,
        };
        let slice = setup.slice(&setup.start, range.clone(), end);
        let part = batch(&slice, options, interrupt);
        found.explain(&slice, &range, part.status, options, interrupt);
        let end = if segment.end == setup.to { setup.samples } else { segment.end };
        found.take(setup, segment, &range, segment.start..end, &part);
        if part.status == Status::Interrupted {
            break;
        }
    }
    found
}

impl Found {
    /// What the first segment that failed cannot meet.
    fn explain(
        &mut self,
        slice: &Setup<'_>,
        range: &Range<usize>,
        status: Status,
        options: &OptimiseOptions,
        interrupt: &dyn Fn() -> bool,
    ) {
        if failed(status) && options.explain && self.shortfalls.is_empty() {
            let before_s = range.start as f64 * slice.sample_time_s;
            self.shortfalls = shortfalls(slice, options, status, before_s, interrupt);
        }
    }

    /// Takes samples `taken` of a part that decided `segment` over the samples `range`.
    fn take(
        &mut self,
        setup: &Setup<'_>,
        segment: &Range<usize>,
        range: &Range<usize>,
        taken: Range<usize>,
        part: &Found,
    ) {
        let width = setup.columns.len();
        let from = (taken.start - range.start) * width;
        self.values[taken.start * width..taken.end * width]
            .copy_from_slice(&part.values[from..from + taken.len() * width]);
        self.iterations += part.iterations;
        if self.status == Status::Converged {
            self.status = part.status;
        }
        let at = |t: usize| t as f64 * setup.sample_time_s;
        self.parts.push(PartOutcome {
            from_s: at(segment.start),
            to_s: at(segment.end),
            status: part.status,
            iterations: part.iterations,
        });
    }
}

/// Replaces the inputs within half a width of each seam by their mean over it.
fn smooth(setup: &Setup<'_>, values: &mut [f64], segments: &[Range<usize>], samples: usize) {
    let width = setup.columns.len();
    for seam in segments.iter().skip(1).map(|s| s.start) {
        let half = samples / 2;
        let (from, to) = (seam.saturating_sub(half).max(setup.from), seam.saturating_add(half).min(setup.to));
        for c in 0..setup.problem.inputs.len() {
            let mean = (from..to).map(|t| values[t * width + c]).sum::<f64>() / (to - from).max(1) as f64;
            (from..to).for_each(|t| values[t * width + c] = mean);
        }
    }
}
