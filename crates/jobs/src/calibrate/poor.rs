//! Models that no optimum is sought on.

use super::models::{Candidate, ModelsResult};
use super::spec::CalibrateSpec;
use dynocal_ident::validate::Seen;
use dynocal_report::significant;

/// Why no optimum is sought on models: one of a demanded output says less of unseen records than the mean of that output does, or runs away on
/// all of them. None where all say more, or where `optimise.force` goes on all the same. Models of limits are judged by what is measured of the
/// optimum.
pub(super) fn refused(spec: &CalibrateSpec, models: &ModelsResult) -> Option<String> {
    if spec.optimise.force {
        return None;
    }
    let demanded = spec.problem.demand_names();
    let of_demands = models.outputs.iter().filter(|o| demanded.contains(&o.output));
    let poor: Vec<String> =
        of_demands.filter_map(|o| Some(format!("the {} model {}", o.output, fault(o.best())?))).collect();
    (!poor.is_empty()).then(|| {
        format!(
            "No optimum is sought: {}. The campaign needs more of its records, or others (`excite.identification_records`, `excite.record_s`, `excite.signal`); `optimise.force = true` goes on with these models.",
            poor.join("; ")
        )
    })
}

fn fault(c: &Candidate) -> Option<String> {
    let unseen: Vec<Option<f64>> =
        c.scores.iter().filter(|s| s.data == Seen::Unseen && !s.chooses).map(|s| s.r2).collect();
    let ran: Vec<f64> = unseen.iter().flatten().copied().collect();
    if unseen.is_empty() {
        return None;
    }
    if ran.is_empty() {
        return Some("runs away on all unseen records".into());
    }
    let mean = ran.iter().sum::<f64>() / ran.len() as f64;
    (mean < 0.0).then(|| {
        format!(
            "is worse than the mean of its output: free-run R2 {} % on unseen records",
            significant(100.0 * mean, 3)
        )
    })
}
