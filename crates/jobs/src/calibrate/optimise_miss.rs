//! How far an optimum is from its demands, on the models and as it was measured.

use super::context::Context;
use super::error::ChainError;
use super::optimise_plan::{VIOLATION, range_of};
use dynocal_calib::optimise::Optimum;
use dynocal_ident::data::Dataset;
use serde::{Deserialize, Serialize};

/// RMS of the measured leading demand from which on a pass must not be used, as a share of the demand's range.
const FAR_LEAD: f64 = 0.08;
/// The same of further demands, whose range is narrow beside what transients do.
const FAR: f64 = 0.3;
/// Mean distance of a measured demand from which on a pass must not be used, as a share of its range.
const OFFSET: f64 = 0.03;

/// By how much a demand was missed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Miss {
    /// Output.
    pub output: String,
    /// Its unit.
    pub unit: String,
    /// Largest violation of the demand, or of the limits, by the free run of the model; none for an output without a model, which
    /// the fuelling holds.
    pub violation: Option<f64>,
    /// Whether its limits are soft: then they may be passed.
    #[serde(default)]
    pub soft: bool,
    /// Root mean square of (measured - demanded) of the measured optimum; none for an output without a demand.
    pub measured_rms: Option<f64>,
    /// Mean of (measured - demanded).
    pub measured_mean: Option<f64>,
}

/// The largest measured distance from a demand, as a share of the one from which on a pass must not be used; NaN where one is no number.
pub(super) fn share(ctx: &Context, misses: &[Miss]) -> f64 {
    let all = misses.iter().map(|m| m.share(ctx));
    all.fold(0.0, |most: f64, s| if most.is_nan() || s.is_nan() { f64::NAN } else { most.max(s) })
}

impl Miss {
    /// Whether what was measured is so far from the demand that a pass must not be used.
    pub(super) fn is_far(&self, ctx: &Context) -> bool {
        let share = self.share(ctx);
        share.is_nan() || share > 1.0
    }

    /// Whether the models themselves miss the demand, or pass a limit that binds, by more than counts as none.
    pub(super) fn missed_on_models(&self, ctx: &Context) -> bool {
        let most = VIOLATION * range_of(ctx, &self.output);
        !self.soft && self.violation.is_some_and(|v| v.is_nan() || v > most)
    }

    /// Measured distance from the demand as a share of the one from which on a pass must not be used; 0 without a demand.
    pub(super) fn share(&self, ctx: &Context) -> f64 {
        let range = range_of(ctx, &self.output);
        let far = if ctx.channels.demands.first() == Some(&self.output) { FAR_LEAD } else { FAR };
        let of = |v: Option<f64>, most: f64| v.map_or(0.0, |v| v.abs() / (most * range));
        let (rms, mean) = (of(self.measured_rms, far), of(self.measured_mean, OFFSET));
        if rms.is_nan() || mean.is_nan() { f64::NAN } else { rms.max(mean) }
    }
}

/// By output how far the models and what was measured are from the demands of an optimum.
///
/// # Errors
/// [`ChainError`] when the record lacks a channel.
pub(super) fn misses(ctx: &Context, optimum: &Optimum, run: &Dataset) -> Result<Vec<Miss>, ChainError> {
    let unit = |name: &str| ctx.spec.problem.unit(name).unwrap_or("-").to_string();
    // Root mean square and mean of measured less demanded.
    let errors = |output: &str, demand: &[f64]| -> Result<[f64; 2], ChainError> {
        let pairs = run.values(output)?.iter().zip(demand).skip(optimum.first);
        let errors: Vec<f64> = pairs.map(|(y, d)| y - d).collect();
        let n = errors.len().max(1) as f64;
        let squares = errors.iter().map(|e| e * e).sum::<f64>();
        Ok([(squares / n).sqrt(), errors.iter().sum::<f64>() / n])
    };
    let mut out = Vec::new();
    for output in ctx.channels.outputs() {
        let demand = optimum.demands.iter().find(|d| d.name == output);
        let measured = demand.map(|d| errors(&output, &d.values)).transpose()?;
        out.push(Miss {
            unit: unit(&output),
            violation: Some(optimum.violation(&output)),
            soft: ctx.spec.problem.limits.iter().any(|l| l.output == output && l.soft_weight.is_some()),
            measured_rms: measured.map(|m| m[0]),
            measured_mean: measured.map(|m| m[1]),
            output,
        });
    }
    // What the fuelling holds has no model that could miss its demand.
    for (output, given) in ctx.held() {
        let [rms, mean] = errors(output, run.values(&given.name)?)?;
        out.push(Miss {
            output: output.into(),
            unit: given.unit.clone(),
            violation: None,
            soft: false,
            measured_rms: Some(rms),
            measured_mean: Some(mean),
        });
    }
    Ok(out)
}
