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
    let keys = match spec.excite.identification_files.is_empty() {
        true => "`excite.identification_records`, `excite.record_s`, `excite.signal`",
        false => "`excite.identification_files`",
    };
    (!poor.is_empty()).then(|| {
        format!(
            "No optimum is sought on these models: {}. They need more records, or others ({keys}); `optimise.force = true` goes on with them.",
            poor.join("; ")
        )
    })
}

fn fault(c: &Candidate) -> Option<String> {
    let mut unseen = c.scores.iter().filter(|s| s.data == Seen::Unseen && !s.chooses).peekable();
    match c.unseen_r2 {
        Some(r2) => worse_than_mean(r2),
        None if unseen.peek().is_some() && unseen.all(|s| s.r2.is_none()) => {
            Some("runs away on all unseen records".into())
        }
        None => None,
    }
}

/// What is said of a model that says less of unseen records than the mean of its output.
pub(super) fn worse_than_mean(r2: f64) -> Option<String> {
    (r2 < 0.0).then(|| {
        format!(
            "is worse than the mean of its output: free-run R2 {} % on unseen records",
            significant(100.0 * r2, 3)
        )
    })
}
