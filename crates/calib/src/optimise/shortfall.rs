//! Where and by how much a problem cannot be solved: the same program with every demand and output limit made soft, so
//! that it always has a solution, and the least sum of what is missing.
//!
//! ```text
//! minimise   mean_t sum_i |y_i(t) - demand_i(t)| / range_i  +  mean_t sum_l max(0, beyond_l(t)) / size_l
//! ```
//!
//! A sum of sizes, unlike one of squares, leaves everything exact that can be: what remains is where the problem fails.

use super::limits::Asked;
use super::setup::Setup;
use super::{Found, OptimiseOptions, batch};
use dynocal_ident::data::UnitAfter;
use dynocal_numerics::status::Status;
use serde::{Deserialize, Serialize};

/// Weight of the objective proper beside the missing amounts: enough to decide where they leave a choice.
const OBJECTIVE_SHARE: f64 = 1e-4;
/// Missing amounts below this share of an output's range are rounding of the search.
const SEEN: f64 = 1e-5;
/// Distance from a bound, relative to the width, at which an input counts as being there.
const AT_BOUND: f64 = 1e-3;

/// A stretch of time in which an output misses what is asked of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Shortfall {
    /// Output.
    pub output: String,
    /// Its unit.
    pub unit: String,
    /// What it misses: `demand`, `lower` or `upper`.
    pub of: String,
    /// First moment in s.
    pub from_s: f64,
    /// Last moment in s.
    pub to_s: f64,
    /// Largest amount that is missing; negative where the output is too small.
    pub largest: f64,
    /// Moment of the largest in s.
    pub at_s: f64,
    /// Inputs at a limit of theirs meanwhile, as `spark at 30 deg` or `spark at 33.3 deg/s`.
    pub inputs: Vec<String>,
}

impl Shortfall {
    /// In words.
    pub fn sentence(&self) -> String {
        let inputs = match self.inputs.is_empty() {
            true => "no input at a limit".into(),
            false => self.inputs.join(", "),
        };
        let misses = match (self.of.as_str(), self.largest < 0.0) {
            ("demand", true) => "stays below its demand",
            ("demand", false) => "goes above its demand",
            (_, true) => "goes below its lower limit",
            (_, false) => "goes above its upper limit",
        };
        format!(
            "{} {misses} from {:.2} to {:.2} s by up to {}{} (at {:.2} s), with {inputs}",
            self.output,
            self.from_s,
            self.to_s,
            amount(self.largest.abs()),
            UnitAfter(&self.unit),
            self.at_s
        )
    }
}

/// Four digits of a number.
fn amount(v: f64) -> String {
    if v >= 1e-3 { format!("{v:.4}") } else { format!("{v:.3e}") }
}

/// Stretches in which the problem cannot be met, in the order of time; `before_s` is the time before its first sample.
///
/// A search that ended for another reason than that it found no way (`status`) says nothing about one: the objective is left
/// out then, so that anything missing means that there is none. Where this search does not end either, nothing is said.
pub(super) fn shortfalls(
    setup: &Setup<'_>,
    options: &OptimiseOptions,
    status: Status,
    before_s: f64,
    interrupt: &dyn Fn() -> bool,
) -> Vec<Shortfall> {
    let share = if status == Status::Infeasible { OBJECTIVE_SHARE } else { 0.0 };
    let elastic = setup.elastic(1.0, share);
    let found = batch(&elastic, options, interrupt);
    if status != Status::Infeasible && !found.status.is_success() {
        return Vec::new();
    }
    let mut out = Vec::new();
    for asked in elastic.asked() {
        let missing = missing(&elastic, &found, &asked);
        let seen = |t: usize| t >= elastic.first_equation() && missing[t].abs() > SEEN * asked.size;
        for gap in dynocal_ident::data::runs(elastic.samples, seen) {
            let worst = (gap.from..gap.to)
                .fold(gap.from, |a, b| if missing[b].abs() > missing[a].abs() { b } else { a });
            let at = |t: usize| before_s + t as f64 * setup.sample_time_s;
            out.push(Shortfall {
                output: asked.output.clone(),
                unit: setup.problem.unit(&asked.output).unwrap_or("-").into(),
                of: asked.of.into(),
                from_s: at(gap.from),
                to_s: at(gap.to - 1),
                largest: missing[worst],
                at_s: at(worst),
                inputs: at_limits(&elastic, &found, gap.from.saturating_sub(setup.lag), gap.to),
            });
        }
    }
    out.sort_by(|a, b| a.from_s.total_cmp(&b.from_s));
    out
}

/// Values (samples x columns of `setup`) that miss nothing of what is asked, where a search for the least missing amounts ends at such:
/// the problem is not infeasible then, whatever the search for the optimum said, and may begin there.
pub(super) fn met(
    setup: &Setup<'_>,
    options: &OptimiseOptions,
    interrupt: &dyn Fn() -> bool,
) -> Option<Vec<f64>> {
    let elastic = setup.elastic(1.0, 0.0);
    let mut found = batch(&elastic, options, interrupt);
    let soft =
        |output: &String| setup.problem.limits.iter().any(|l| l.output == *output && l.soft_weight.is_some());
    let kept = |asked: &Asked| {
        let missing = missing(&elastic, &found, asked);
        asked.of != "demand" && soft(&asked.output)
            || missing[elastic.first_equation()..].iter().all(|m| m.abs() <= SEEN * asked.size)
    };
    if !found.status.is_success() || !elastic.asked().iter().all(kept) {
        return None;
    }
    elastic.narrowed(setup, &mut found);
    Some(found.values)
}

/// What is missing of something asked at each sample: below 0 under it, above 0 beyond it.
fn missing(elastic: &Setup<'_>, found: &Found, asked: &Asked) -> Vec<f64> {
    let beyond = |t: usize| found.values[t * elastic.columns.len() + asked.column] - asked.values[t];
    let of = |t: usize| match asked.of {
        "lower" => beyond(t).min(0.0),
        "upper" => beyond(t).max(0.0),
        _ => beyond(t),
    };
    (0..elastic.samples).map(of).collect()
}

/// Inputs that are at a bound or at their rate limit somewhere in `from..to`.
fn at_limits(setup: &Setup<'_>, found: &Found, from: usize, to: usize) -> Vec<String> {
    let width = setup.columns.len();
    let mut out = Vec::new();
    for (c, input) in setup.problem.inputs.iter().enumerate() {
        let value = |t: usize| found.values[t * width + c];
        let near = AT_BOUND * (input.upper - input.lower);
        for bound in [input.lower, input.upper] {
            if (from..to).any(|t| (value(t) - bound).abs() <= near) {
                out.push(format!("{} at {bound} {}", input.name, input.unit));
            }
        }
        if let Some(rate) = input.rate_per_s {
            let step = rate * setup.sample_time_s;
            if (from.max(1)..to).any(|t| (value(t) - value(t - 1)).abs() >= (1.0 - AT_BOUND) * step) {
                out.push(format!("{} at {rate:.4} {}/s", input.name, input.unit));
            }
        }
    }
    out
}
