//! A spec of `calibrate` on a bed: plans are written, measured records are read.

use std::fmt::Write as _;

use dynocal_ident::data::Role;

use super::file::{Found, FoundChannel, named};
use super::{Draft, DraftError, Wishes, quoted, rounded};

/// Roles of the channels.
pub(super) struct Roles<'a> {
    pub(super) inputs: Vec<&'a FoundChannel>,
    pub(super) given: Vec<&'a FoundChannel>,
    pub(super) demands: Vec<&'a FoundChannel>,
}

pub(super) fn text(f: &Found, path: &str, wishes: &Wishes) -> Result<Draft, DraftError> {
    let roles = roles(f, wishes)?;
    let mut notes = f.notes.clone();
    let dt = f.sample_time_s.filter(|dt| (0.005..=0.5).contains(dt));
    if dt.is_none() {
        notes.push("A calibration samples every 0.005 to 0.5 s: the spec has 0.05 s.".into());
    }
    let dt = dt.unwrap_or(0.05);
    let mut out = format!(
        "# Every key is explained in docs/calibrate.md, the way to work with a bed in docs/bed.md. Ranges are those of\n# {path}; those of demands and given channels leave out the outermost hundredth at either end.\n\nseed = 1\nsample_time_s = {dt:?}\n\n[plant]\nname = \"bed\"                 # plans are written as files, records are read from RUN/measured\n\n[problem]\n"
    );
    let (fuel, derive) = objective(&roles);
    let _ = write!(out, "minimise = [{{ channel = {}, weight = 1.0 }}]\n{derive}", quoted(&fuel));
    notes.push(format!("`{fuel}` is minimised: write what should be."));
    problem(&roles, &mut out, &mut notes);
    let start: Vec<String> =
        roles.inputs.iter().map(|c| format!("{} = {}", c.name, rounded(c.mean, c.mean < 0.0))).collect();
    let _ = write!(out, "\n[excite]\nstart = {{ {} }}   # means of the file\n", start.join(", "));
    let rows = format!(
        "\n# Steady points of the static map that the dynamic one is compared with.\n[validate.static_map]\ndemand = [{}]\ngiven = [{}]\n",
        thirds(roles.demands[0]),
        thirds(roles.given[0])
    );
    out.push_str(&rows);
    Ok(Draft { text: out, notes })
}

/// Tables of inputs, given channels, demands and loops.
pub(super) fn problem(roles: &Roles<'_>, out: &mut String, notes: &mut Vec<String>) {
    for c in &roles.inputs {
        let _ = write!(
            out,
            "\n[[problem.inputs]]\nname = {}\nunit = {}\nlower = {}\nupper = {}\n# rate_per_s = ..            # fastest change, where the actuator has one\n",
            quoted(&c.name),
            quoted(&c.unit),
            rounded(c.lower, false),
            rounded(c.upper, true)
        );
    }
    for (table, key, list) in [("given", "name", &roles.given), ("demands", "output", &roles.demands)] {
        for c in list {
            // Peaks of a transient are no demands.
            let [lower, upper] = c.usual;
            let _ = write!(
                out,
                "\n[[problem.{table}]]\n{key} = {}\nunit = {}\nlower = {}\nupper = {}\n",
                quoted(&c.name),
                quoted(&c.unit),
                rounded(lower, false),
                rounded(upper, true)
            );
        }
    }
    for (d, i) in pairs(roles) {
        let _ = write!(
            out,
            "\n[[loops]]                    # which input holds which demand; gains are found on the bed\noutput = {}\ninput = {}\n",
            quoted(&d.name),
            quoted(&i.name)
        );
        notes.push(format!(
            "`{}` is held by `{}`: exchange them in [[loops]] where that is wrong.",
            d.name, i.name
        ));
    }
}

/// Which input holds which demand: the throttle torque and the injected mass lambda where they are there, others in order.
pub(super) fn pairs<'a>(r: &Roles<'a>) -> Vec<(&'a FoundChannel, &'a FoundChannel)> {
    const USUAL: [(&str, &str); 2] = [("torque", "throttle"), ("lambda", "inj")];
    let mut free = r.inputs.clone();
    let usual =
        |d: &FoundChannel| USUAL.iter().find(|(output, _)| *output == d.name).map(|(_, input)| *input);
    let mut out: Vec<(&FoundChannel, Option<&FoundChannel>)> = Vec::new();
    for d in &r.demands {
        let place = usual(d).and_then(|name| free.iter().position(|i| i.name == name));
        out.push((d, place.map(|k| free.remove(k))));
    }
    let mut rest = free.into_iter();
    out.into_iter().filter_map(|(d, i)| Some((d, i.or_else(|| rest.next())?))).collect()
}

/// A quarter, the middle and three quarters of a range.
fn thirds(c: &FoundChannel) -> String {
    let [lower, upper] = c.usual;
    let at = |share: f64| rounded(lower + share * (upper - lower), false);
    format!("{}, {}, {}", at(0.25), at(0.5), at(0.75))
}

/// Channel that a bed imposes where none is named.
pub(super) const IMPOSED: &str = "speed";
/// What is minimised where it can be derived.
const FUEL: &str = "fuel";

pub(super) fn roles<'a>(f: &'a Found, wishes: &Wishes) -> Result<Roles<'a>, DraftError> {
    let lacks = |found: String, expected: &str| DraftError::Lacks {
        file: f.file.clone(),
        found,
        expected: expected.into(),
    };
    let demands: Vec<&FoundChannel> = f.channels.iter().filter(|c| c.role == Role::Output).collect();
    let imposed = if wishes.given.is_empty() { vec![IMPOSED.to_string()] } else { wishes.given.clone() };
    let given: Vec<&FoundChannel> =
        f.channels.iter().filter(|c| c.role == Role::Input && named(c, &imposed)).collect();
    // Fuel that is metered is no input: it is what is minimised.
    let metered = |c: &FoundChannel| c.name == FUEL && !named(c, &wishes.inputs);
    let inputs: Vec<&FoundChannel> =
        f.channels.iter().filter(|c| c.role == Role::Input && !named(c, &imposed) && !metered(c)).collect();
    if given.is_empty() {
        return Err(lacks(
            format!("no channel `{}` that moves", imposed.join("`, `")),
            "--given NAME: the operating channel that the bed imposes, e.g. the speed",
        ));
    }
    if inputs.len() < demands.len() {
        return Err(lacks(
            format!("{} inputs for {} demands", inputs.len(), demands.len()),
            "an input for every demand, since each is held by a loop",
        ));
    }
    Ok(Roles { inputs, given, demands })
}

/// What is minimised: fuel from an injected mass and the speed where both are there, else the first input.
pub(super) fn objective(r: &Roles<'_>) -> (String, String) {
    let injected = r.inputs.iter().find(|c| c.unit == "mg");
    let speed = r.given.iter().find(|c| c.unit == "rpm");
    let taken = r.demands.iter().chain(&r.inputs).any(|c| c.name == FUEL);
    match (injected, speed) {
        (Some(i), Some(n)) if !taken => (
            FUEL.into(),
            format!(
                "\n[[problem.derive]]           # four-stroke engine, injected mass per cylinder and cycle (thesis eq. 7.11)\nname = \"fuel\"\nunit = \"kg/h\"\nfactor = 3e-5\ncylinders = 4\npowers = {{ {} = 1, {} = 1 }}\n",
                i.name, n.name
            ),
        ),
        _ => (r.inputs[0].name.clone(), String::new()),
    }
}
