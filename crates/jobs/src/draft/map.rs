//! A spec of `map` on a bed: plans of points are written, measured points are read.

use std::fmt::Write as _;

use super::calibrate::{Roles, objective, pairs, problem, roles};
use super::file::{Found, FoundChannel};
use super::{Draft, DraftError, Wishes, quoted, rounded};

/// Values of an axis.
const AXIS: usize = 5;
/// Points of the day: so many for each factor of the test, and at least and at most.
const POINTS_PER_FACTOR: usize = 18;
const POINTS: [usize; 2] = [45, 140];

pub(super) fn text(f: &Found, path: &str, wishes: &Wishes) -> Result<Draft, DraftError> {
    let roles = roles(f, wishes)?;
    let driven: Vec<&FoundChannel> = pairs(&roles).into_iter().map(|(_, input)| input).collect();
    let free: Vec<&FoundChannel> =
        roles.inputs.iter().filter(|i| !driven.iter().any(|d| d.name == i.name)).copied().collect();
    if free.is_empty() {
        return Err(DraftError::Lacks {
            file: f.file.clone(),
            found: format!("{} inputs for {} demands", roles.inputs.len(), roles.demands.len()),
            expected: "one input more than demands: each demand is held by one, and the others are optimised"
                .into(),
        });
    }
    let mut notes = f.notes.clone();
    if !f.left_out.is_empty() {
        notes.push(format!("Left out: {}.", f.left_out.join("; ")));
    }
    if wishes.inputs.is_empty() {
        let names: Vec<String> = roles.inputs.iter().map(|c| format!("`{}`", c.name)).collect();
        notes.push(format!(
            "{} are taken as inputs that may move: name those that do with --input (and what the bed imposes with --given), and make limits or outputs of what is only measured.",
            names.join(", ")
        ));
    }
    let mut out = format!(
        "# Every key is explained in docs/map.md. Ranges are those of\n# {path}; those of demands and given channels leave out the outermost hundredth at either end.\n\nseed = 1\n\n[plant]\nname = \"bed\"                 # plans of points are written as files, what is measured is read from RUN/measured\n"
    );
    let _ = write!(
        out,
        "\n[axes]                       # values of the axes of the maps: one demand, one given channel, or both\n"
    );
    let (demand, given) = (roles.demands[0], roles.given[0]);
    for c in [demand, given] {
        let _ = writeln!(out, "{} = [{}]", key(&c.name), values(c));
    }
    held(&roles, &mut out);
    let (minimised, derive) = minimised(&roles, &driven);
    let _ = write!(
        out,
        "\n[problem]\nminimise = [{{ channel = {}, weight = 1.0 }}]\n{derive}",
        quoted(&minimised)
    );
    notes.push(format!("`{minimised}` is minimised: write what should be."));
    problem(&roles, &mut out, &mut notes);
    out.push_str(
        "\n# Limits of outputs that the bed measures, kept in every cell:\n# [[problem.limits]]\n# output = \"egt\"\n# unit = \"K\"\n# upper = 1150.0\n",
    );
    let factors = free.len() + 2;
    let points = (POINTS_PER_FACTOR * factors).clamp(POINTS[0], POINTS[1]);
    let _ = write!(
        out,
        "\n[bed]\npoints = {points}                  # to learn from, repeats and verification together\n\n[verify]\npoints = 8                   # of the finished maps, that no model has seen\n\n# Steps of the ECU: the maps then hold multiples of them that keep the limits.\n# [optimise.resolution]\n"
    );
    for c in &free {
        let _ = writeln!(out, "# {} = {}", key(&c.name), rounded(0.01 * (c.upper - c.lower), true));
    }
    let names: Vec<String> = free.iter().map(|c| format!("`{}`", c.name)).collect();
    notes.push(format!(
        "{} {} optimised in every cell.",
        names.join(", "),
        if names.len() == 1 { "is" } else { "are" }
    ));
    Ok(Draft { text: out, notes })
}

/// A name as the key of a table.
fn key(name: &str) -> String {
    let plain = name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-');
    if plain && !name.is_empty() { name.into() } else { quoted(name) }
}

/// Even values over the usual range; its ends are rounded outwards where the range of the problem is, so that all lie within.
fn values(c: &FoundChannel) -> String {
    let [lower, upper] = c.usual;
    let each = (0..AXIS).map(|k| {
        let share = k as f64 / (AXIS - 1) as f64;
        rounded(lower + share * (upper - lower), 2 * k >= AXIS)
    });
    let mut all: Vec<String> = each.collect();
    // A narrow range has fewer values of three digits than that.
    all.dedup();
    all.join(", ")
}

/// Values of the demands and given channels that are no axes.
fn held(roles: &Roles<'_>, out: &mut String) {
    let others: Vec<&FoundChannel> =
        roles.demands.iter().skip(1).chain(roles.given.iter().skip(1)).copied().collect();
    if others.is_empty() {
        return;
    }
    out.push_str("\n[held]                       # what is no axis: means of the file\n");
    for c in others {
        let [lower, upper] = c.usual;
        let _ = writeln!(out, "{} = {}", key(&c.name), rounded(c.mean.clamp(lower, upper), false));
    }
}

/// What is minimised, as for a dynamic calibration; where that is an input, one that a loop drives.
fn minimised(roles: &Roles<'_>, driven: &[&FoundChannel]) -> (String, String) {
    let (name, derive) = objective(roles);
    if derive.is_empty() { (driven[0].name.clone(), derive) } else { (name, derive) }
}
