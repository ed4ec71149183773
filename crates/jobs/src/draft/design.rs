//! A spec of `design` for stored models, within the ranges that the file covers.

use std::fmt::Write as _;
use std::path::Path;

use dynocal_files::json;
use dynocal_ident::stored::{MODEL_SCHEMA, MODEL_VERSION, StoredModel};

use super::file::{Found, named};
use super::{Draft, DraftError, Wishes, quoted, relative, rounded};

/// Samples of the record.
const SAMPLES: f64 = 400.0;
/// Samples of the least hold.
const HOLD: f64 = 10.0;

pub(super) fn text(f: &Found, path: &str, folder: &Path, wishes: &Wishes) -> Result<Draft, DraftError> {
    let lacks = |found: String, expected: String| DraftError::Lacks { file: f.file.clone(), found, expected };
    if wishes.models.is_empty() {
        return Err(lacks(
            "no model".into(),
            "--model FILE (repeated for several): a design is one for models. `dynocal new identify` and `dynocal identify` make a first one, runs/NAME/steps/01-identify/model.json".into(),
        ));
    }
    let models = wishes
        .models
        .iter()
        .map(|p| Ok((relative(p, folder), json::read_versioned(p, MODEL_SCHEMA, MODEL_VERSION)?)))
        .collect::<Result<Vec<(String, StoredModel)>, DraftError>>()?;
    let dt = models[0].1.sample_time_s;
    let mut out = format!(
        "# Every key is explained in docs/design.md. Ranges are those of {}.\n\nlength_s = {:?}\nsample_time_s = {dt:?}          # that of the model\nseed = 1\nrivals = 20                  # random records of each kind that the design is compared with\n",
        f.file,
        SAMPLES * dt
    );
    let mut done: Vec<String> = Vec::new();
    for q in models.iter().flat_map(|(_, m)| m.measured_inputs()) {
        if done.contains(&q.name) {
            continue;
        }
        let Some(c) = f.channels.iter().find(|c| named(c, std::slice::from_ref(&q.name))) else {
            return Err(lacks(
                format!("no channel `{}` that moves", q.name),
                "every input of the models, under the name that the models have for it".into(),
            ));
        };
        let _ = write!(
            out,
            "\n[[channels]]\nname = {}\nunit = {}\nlower = {}\nupper = {}\nhold_s = {:?}               # least time at a value\n# rate_per_s = ..            # fastest change, where the actuator has one\n",
            quoted(&q.name),
            quoted(&q.unit),
            rounded(c.lower, false),
            rounded(c.upper, true),
            HOLD * dt
        );
        done.push(q.name);
    }
    let mut notes = vec![format!(
        "Inputs may go where the file has been, one by one; where only some corners are allowed write [[regions]]. Read {path}."
    )];
    for (file, m) in &models {
        let y = m.user_output();
        let _ = write!(out, "\n[[models]]\nfile = {}\ncriterion = \"d\"\n", quoted(file));
        let Some(c) = f.channels.iter().find(|c| named(c, std::slice::from_ref(&y.name))) else { continue };
        let _ = writeln!(
            out,
            "# limits = {{ lower = {}, upper = {} }}   # {} of {} so far; a margin is needed, see docs/design.md",
            rounded(c.lower, false),
            rounded(c.upper, true),
            y.unit,
            y.name
        );
    }
    notes.push("No output is limited: take the comment from `limits` where one must be.".into());
    out.push_str("\n[search]\nstarts = 2\nevaluations = 1000\n");
    Ok(Draft { text: out, notes })
}
