//! A spec of `identify`.

use std::fmt::Write as _;

use dynocal_ident::data::Role;

use super::file::Found;
use super::{Draft, DraftError, Wishes, quoted};

pub(super) fn text(f: &Found, path: &str, wishes: &Wishes) -> Result<Draft, DraftError> {
    let mut notes = f.notes.clone();
    let mut out = String::from(
        "# Every key is explained in docs/identify.md; `dynocal list` shows what can be chosen.\n\n",
    );
    let mut line = |text: String| out.push_str(&format!("{text}\n"));
    line("[data]".into());
    line(format!("file = {}", quoted(path)));
    if let Some(format) = wishes.format {
        line(format!("format = {}", quoted(&String::from(format))));
    }
    if let Some(dialect) = &wishes.dialect {
        line(format!("csv = {{ {dialect} }}"));
    }
    if wishes.steady {
        line(
            "steady = true                # every row is a point; the order of the rows says nothing".into(),
        );
    }
    let uneven = f.time.as_ref().is_some_and(|t| !t.uniform);
    match (&f.time, f.sample_time_s) {
        (Some(t), _) => {
            line(format!("time = {}", quoted(&t.column)));
            if let Some(unit) = t.assumed_unit {
                line(format!("time_unit = {}              # the file does not say it", quoted(unit)));
            }
            if let Some(pause) = t.pause_s {
                line(format!(
                    "# Stamps pause or go back: each stretch is an experiment of its own.\ncut = {{ gap_s = {pause:?}, shortest = 50 }}"
                ));
            }
        }
        (None, Some(dt)) => line(format!("sample_time_s = {dt:?}")),
        (None, None) => {}
    }
    if !wishes.steady {
        line("init_samples = 10            # leading samples that enter no score".into());
    }
    if f.channels.iter().any(|c| c.gaps > 0) {
        line("missing = \"mark\"             # there are empty cells: they are missing samples".into());
    }
    for c in &f.channels {
        line("\n[[channels]]".into());
        line(format!("column = {}", quoted(&c.column)));
        if c.name != c.column {
            line(format!("name = {}", quoted(&c.name)));
        }
        let comment = if c.has_unit { "" } else { "                   # the file does not say it" };
        line(format!("unit = {}{comment}", quoted(&c.unit)));
        let role = match c.role {
            Role::Input => "input",
            Role::Output => "output",
            Role::Auxiliary => "auxiliary",
        };
        let gaps = if c.gaps > 0 { format!("; {} cells are empty", c.gaps) } else { String::new() };
        line(format!("role = \"{role}\"{}# {} to {}{gaps}", " ".repeat(20 - role.len()), c.lower, c.upper));
    }
    for why in &f.left_out {
        line(format!("\n# Left out, {why}."));
    }
    if let (true, Some(dt)) = (uneven, f.sample_time_s) {
        notes.push(format!(
            "The stamps are not uniform: the record is sampled anew every {dt} s, the middle of its intervals."
        ));
        line(format!(
            "\n# The stamps are not uniform.\n[[prepare]]\nstep = \"resample\"\nsample_time_s = {dt:?}"
        ));
    }
    model(f, wishes, &mut out);
    Ok(Draft { text: out, notes })
}

/// Split, model and validation.
fn model(f: &Found, wishes: &Wishes, out: &mut String) {
    let outputs: Vec<String> =
        f.channels.iter().filter(|c| c.role == Role::Output).map(|c| quoted(&c.name)).collect();
    let target = match &outputs[..] {
        [one] => format!("target = {one}"),
        all => format!("targets = [{}]", all.join(", ")),
    };
    if wishes.steady {
        let _ = write!(
            out,
            "\n[split]\ntest_every = 3               # every third point is unseen\n\n[model]\n{target}\n\n\
             # The simplest first: one that is as good within one standard error is taken.\n[model.structure]\n\
             name = \"best_of\"\nfolds = 5\nmodels = [\n    {{ kind = \"stepwise_polynomial\", degree = 2 }},\n    \
             {{ kind = \"gaussian_process\" }},\n]\n"
        );
        return;
    }
    let _ = write!(
        out,
        "\n# The first part of the time estimates, the rest is unseen.\n[split]\nfractions = [0.7, 0.3]\n\n\
         # A linear model to begin with, estimated on its free run. na past outputs, nb samples of each input from nk samples\n\
         # back (nk = 0: the output answers within a sample; 1: it does not). A nonlinear one, in place of the line `structure`:\n\
         # select = {{ name = \"forward\", pool = {{ ny = 4, nu = 4, degree = 2 }} }}\n\
         [model]\n{target}\nstructure = {{ name = \"arx\", na = 2, nb = 3, nk = 0 }}\nestimator = {{ name = \"sem\" }}\n"
    );
}
