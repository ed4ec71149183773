//! What a spec of a steady table may hold: points without time have no lags, no order and no start.

use dynocal_files::spec::Faults;
use dynocal_ident::model::kinds;

use super::model::Target;
use super::typed::Typed;
use super::validation::Validation;

/// Folds of the score page where the spec does not say.
const FOLDS: usize = 5;

/// Names every key that needs time, and every structure that does; sets what is usual for points.
pub(super) fn check(t: &Typed, targets: Option<&[Target]>, validate: &mut Validation, faults: &mut Faults) {
    let d = t.data.as_ref();
    let timed = [
        ("data.trajectory", d.is_some_and(|d| d.trajectory.is_some())),
        ("data.cut", d.is_some_and(|d| d.cut.is_some())),
        ("data.init_samples", d.is_some_and(|d| d.init_samples.is_some())),
        ("data.multisine_period", d.is_some_and(|d| d.multisine_period.is_some())),
        ("data.missing", d.is_some_and(|d| d.missing.is_some())),
        ("prepare", t.prepare.as_ref().is_some_and(|p| !p.is_empty())),
        ("validate.k_steps", !validate.k_steps.is_empty()),
        ("validate.initial", validate.initial.is_some()),
        ("model.warm_start_samples", t.model.as_ref().is_some_and(|m| m.warm_start_samples.is_some())),
    ];
    for (key, _) in timed.iter().filter(|(_, given)| *given) {
        faults.push(
            key,
            "a value",
            "nothing: the table is steady (data.steady), its rows have no order in time",
        );
    }
    for target in targets.unwrap_or_default() {
        if let Some(lag) = lag(target) {
            let found =
                format!("`{}`, which reads {lag} samples before the present one", target.structure.name);
            let names = kinds::MODEL_KINDS.iter().filter(|k| k.form.name == "response").map(|k| k.doc.name);
            let expected = format!(
                "a structure without lags for a steady table: {}, or a polynomial of present values",
                names.collect::<Vec<_>>().join(", ")
            );
            faults.push("model.structure", found, expected);
        }
    }
    validate.stability_runs = 0;
    if t.validate.as_ref().is_none_or(|v| v.folds.is_none()) {
        validate.folds = FOLDS;
    }
}

/// Longest lag of a structure, where it has one. A pool of terms has lags, or nothing to select.
fn lag(t: &Target) -> Option<usize> {
    if t.select.as_ref().is_some_and(|s| s.pool.is_some()) {
        return Some(1);
    }
    let form =
        kinds::kind(&t.structure.name, &t.structure.keys).ok()?.form(&t.inputs, &t.target, &[]).ok()?;
    (form.memory() > 0).then(|| form.memory())
}
