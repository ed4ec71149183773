//! Faults of a spec of a steady calibration that its types cannot show.

use std::collections::BTreeMap;

use dynocal_design::points::MOST_DIMENSIONS;
use dynocal_files::spec::Faults;
use dynocal_ident::model::response::learner;
use dynocal_numerics::interval::Interval;
use dynocal_plant::plants;

use super::budget::{Budget, least_s};
use super::spec::MapSpec;

/// Most cells of a map.
const MOST_CELLS: usize = 10_000;

/// Reports every fault of `s`.
pub(super) fn check(s: &MapSpec, faults: &mut Faults) {
    faults.range("sample_time_s", s.sample_time_s, 0.001, 10.0, "s");
    plant(s, faults);
    s.problem.check("problem", faults);
    loops(s, faults);
    s.tune.check("tune", s.sample_time_s.clamp(0.001, 10.0), faults);
    axes(s, faults);
    channels(s, faults);
    bed(s, faults);
    models(s, faults);
    faults.range("optimise.probability", s.optimise.probability, 0.5, 0.9999, "");
    faults.range("optimise.caution", s.optimise.caution, 0.0, 10.0, "standard deviations");
    faults.range("optimise.smooth", s.optimise.smooth, 0.0, 0.5, "of what is minimised");
    faults.range("optimise.jump", s.optimise.jump, 0.0, 0.5, "of what is minimised");
    faults.range("optimise.between", s.optimise.between, 0.0, 1.0, "of the inputs that loops drive");
    if let Some(slow) =
        s.bed.slow.as_ref().filter(|_| !s.problem.demand_names().iter().any(|d| s.axes.contains_key(d)))
    {
        faults.push("bed.slow", slow, "a demand among `axes`: what is slow is told by what it does to one");
    }
    if let Some(slow) = s.bed.slow.as_ref().filter(|n| s.problem.demands.iter().any(|d| d.output == **n)) {
        faults.push("bed.slow", format!("`{slow}`"), "an output that no loop holds");
    }
    if let Some(sweep) = &s.bed.sweep {
        faults.range("bed.sweep.pass_s", sweep.pass_s, 1.0, 3600.0, "s");
        faults.range("bed.sweep.turn_s", sweep.turn_s, 0.0, 600.0, "s");
        faults.range("bed.sweep.rest_s", sweep.rest_s, 0.0, 600.0, "s");
        let least_s = WINDOWS * s.bed.approach.window_s;
        if sweep.rest_s > 0.0 && sweep.rest_s < least_s {
            let asked = format!(
                "0, or {least_s} s and more: {WINDOWS} windows (`bed.approach.window_s`), of which the first and those that a rest loses where bed time is short tell nothing"
            );
            faults.push("bed.sweep.rest_s", sweep.rest_s, &asked);
        }
        if sweep.rest_s > 0.0 && sweep.turn_s > 0.0 {
            let none = "0 where lines rest at each value (`rest_s`): nothing is measured on their way back";
            faults.push("bed.sweep.turn_s", sweep.turn_s, none);
        }
        count("bed.sweep.between", sweep.between, 0, 100, faults);
    }
    if let Some(file) = s.edits.as_ref().filter(|f| !f.is_file()) {
        faults.push("edits", file.display(), "a table that is there");
    }
    if s.edits.is_some() && !s.optimise.breakpoints.is_empty() {
        let found = "`edits` beside them";
        let expected = "one of both: which breakpoints stay is chosen after the day, and an edited cell may not be among them";
        faults.push("optimise.breakpoints", found, expected);
    }
    whole(s, faults);
    front(s, faults);
    deliver(s, faults);
    count("optimise.starts", s.optimise.starts, 1, 1000, faults);
    count("verify.points", s.verify.points, 0, 10_000, faults);
    faults.range("verify.limit", s.verify.limit, 0.0, 1.0, "of the limit");
    faults.range("verify.objective", s.verify.objective, 0.0, 10.0, "of what is minimised");
}

/// Least number of windows of a rest along a line.
const WINDOWS: f64 = 4.0;

/// The program of all cells.
fn whole(s: &MapSpec, faults: &mut Faults) {
    let Some(w) = &s.optimise.whole else { return };
    faults.range("optimise.whole.smooth", w.smooth, 0.0, 100.0, "");
    let free = free_inputs(s);
    for (name, step) in &w.steps {
        let key = format!("optimise.whole.steps.{name}");
        if !free.contains(name) {
            faults.unknown(&key, name, &free);
        } else if !(*step > 0.0 && step.is_finite()) {
            faults.push(&key, step, "a step above 0");
        }
    }
    let axes: Vec<String> = s.axes.keys().cloned().collect();
    for (name, ways) in &w.monotone {
        let key = format!("optimise.whole.monotone.{name}");
        if !free.contains(name) {
            faults.unknown(&key, name, &free);
        }
        for axis in ways.keys().filter(|a| !axes.contains(a)) {
            faults.unknown(&format!("{key}.{axis}"), axis, &axes);
        }
        if s.optimise.resolution.contains_key(name) {
            faults.push(
                &key,
                "a way",
                "no `optimise.resolution` of the same input: rounding does not keep it",
            );
        }
    }
    let cells: usize = s.axes.values().map(Vec::len).product();
    let sound =
        w.residence.iter().all(|r| *r >= 0.0 && r.is_finite()) && w.residence.iter().sum::<f64>() > 0.0;
    if !w.residence.is_empty() && (w.residence.len() != cells || !sound) {
        let found = format!("{} numbers", w.residence.len());
        faults.push(
            "optimise.whole.residence",
            found,
            format!("{cells} numbers from 0, one for each cell, not all 0"),
        );
    }
}

/// The trade-off.
fn front(s: &MapSpec, faults: &mut Faults) {
    let Some(f) = &s.optimise.front else { return };
    count("optimise.front.points", f.points, 2, 1000, faults);
    if let Some(take) = f.take.filter(|t| !(*t > 0.0 && *t < 1.0)) {
        faults.push(
            "optimise.front.take",
            take,
            "a share above 0 and below 1 of what the map of the least objective has",
        );
    }
    let factors = || s.problem.given_names().into_iter().chain(s.problem.demand_names());
    if factors().chain(free_inputs(s)).any(|n| n == f.against) {
        let expected = "an output that is not demanded, a derived channel, or an input that a loop drives";
        faults.push("optimise.front.against", format!("`{}`", f.against), expected);
    }
    if s.problem.minimise.iter().any(|m| m.channel == f.against) && s.problem.minimise.len() == 1 {
        faults.push(
            "optimise.front.against",
            format!("`{}`", f.against),
            "something else than what is minimised",
        );
    }
    let other = |m: &&str| **m != f.against;
    if let [one] = s.problem.minimise.iter().map(|m| m.channel.as_str()).filter(other).collect::<Vec<_>>()[..]
        && s.problem.minimise.len() == 1
        && same_in_a_cell(s, one, &f.against)
    {
        faults.push(
            "optimise.front.against",
            format!("`{}`, which is a multiple of `{one}` in every cell", f.against),
            "something that can be traded against what is minimised",
        );
    }
}

/// Whether two channels are the same powers of what moves within a cell: one is then a multiple of the other there.
fn same_in_a_cell(s: &MapSpec, a: &str, b: &str) -> bool {
    let fixed: Vec<String> = s.problem.demand_names().into_iter().chain(s.problem.given_names()).collect();
    let powers = |name: &str| {
        let mut found = powers_of(s, name, 0);
        found.retain(|channel, power| *power != 0 && !fixed.contains(channel));
        found
    };
    let (a, b) = (powers(a), powers(b));
    !a.is_empty() && a == b
}

/// A channel as a product of powers of channels that do not follow from others.
fn powers_of(s: &MapSpec, name: &str, depth: usize) -> BTreeMap<String, i64> {
    let derived = s.problem.derive.iter().find(|d| d.name == name);
    let Some(d) = derived.filter(|_| depth <= s.problem.derive.len()) else {
        return BTreeMap::from([(name.to_string(), 1)]);
    };
    let mut all = BTreeMap::new();
    for (channel, power) in &d.powers {
        for (base, p) in powers_of(s, channel, depth + 1) {
            *all.entry(base).or_insert(0) += i64::from(*power) * p;
        }
    }
    all
}

/// Breakpoints and steps of the ECU.
fn deliver(s: &MapSpec, faults: &mut Faults) {
    let axes: Vec<String> = s.axes.keys().cloned().collect();
    for (name, n) in &s.optimise.breakpoints {
        let key = format!("optimise.breakpoints.{name}");
        match s.axes.get(name) {
            Some(a) => count(&key, *n, 2, a.len().max(2), faults),
            None => faults.unknown(&key, name, &axes),
        }
    }
    let free = free_inputs(s);
    for (name, step) in &s.optimise.resolution {
        let key = format!("optimise.resolution.{name}");
        let width = s.problem.inputs.iter().find(|i| i.name == *name).map(|i| i.upper - i.lower);
        match width.filter(|_| free.contains(name)) {
            Some(width) => {
                if !(*step >= 1e-6 * width && *step <= width) {
                    faults.push(&key, step, format!("a step from {} to {width}", 1e-6 * width));
                }
                if s.optimise.whole.as_ref().is_some_and(|w| w.steps.contains_key(name)) {
                    let expected = "no `optimise.whole.steps` of the same input: rounding does not keep them";
                    faults.push(&key, step, expected);
                }
            }
            None => faults.unknown(&key, name, &free),
        }
    }
}

/// Inputs that no loop drives.
fn free_inputs(s: &MapSpec) -> Vec<String> {
    let driven = |name: &str| s.loops.iter().any(|l| l.input == name);
    s.problem.input_names().into_iter().filter(|i| !driven(i)).collect()
}

fn count(key: &str, value: usize, least: usize, most: usize, faults: &mut Faults) {
    if !(least..=most).contains(&value) {
        faults.push(key, value, format!("a whole number from {least} to {most}"));
    }
}

fn plant(s: &MapSpec, faults: &mut Faults) {
    for f in plants::check(&s.plant) {
        if f.known.is_empty() {
            faults.push(&f.key, f.found, f.expected);
        } else {
            faults.unknown(&f.key, &f.found, &f.known);
        }
    }
    let Some(member) = plants::find(&s.plant.name) else { return };
    if member.make.is_none() && s.plant.name != "bed" {
        let expected = "a plant that answers while points are approached";
        faults.push("plant.name", format!("`{}`", s.plant.name), expected);
    }
    if let Some(only_s) = member.sample_time_s.filter(|only_s| (s.sample_time_s - only_s).abs() > 1e-9) {
        faults.push("sample_time_s", s.sample_time_s, format!("{only_s} s, that of `{}`", s.plant.name));
    }
}

/// Every demand has a loop in its place, every loop an input of its own, gains for all or none.
fn loops(s: &MapSpec, faults: &mut Faults) {
    let (inputs, demands) = (s.problem.input_names(), s.problem.demand_names());
    for (k, l) in s.loops.iter().enumerate() {
        let key = |part: &str| format!("loops[{k}].{part}");
        if !demands.contains(&l.output) {
            faults.unknown(&key("output"), &l.output, &demands);
        }
        if !inputs.contains(&l.input) {
            faults.unknown(&key("input"), &l.input, &inputs);
        }
        if s.loops[..k].iter().any(|o| o.input == l.input || o.output == l.output) {
            let found = format!("`{}` by `{}`", l.output, l.input);
            faults.push(&key("input"), found, "an output and an input that no other loop has");
        }
        if l.gains.is_some() != s.loops[0].gains.is_some() {
            let expected = "gains for all loops or for none: those that are found are found together";
            faults.push(&key("gains"), "gains for some of the loops", expected);
        }
        if let Some(g) = l.gains.filter(|g| [g.ki, g.kp].iter().any(|v| !(v.abs() <= 1e6)) || g.ki == 0.0) {
            faults.push(&key("gains"), format!("ki = {}, kp = {}", g.ki, g.kp), "finite gains, ki not 0");
        }
    }
    for d in demands.iter().filter(|d| !s.loops.iter().any(|l| l.output == **d)) {
        faults.push(
            "loops",
            format!("none for `{d}`"),
            format!("a loop for every demand: {{ output = \"{d}\", input = .. }}"),
        );
    }
}

fn axes(s: &MapSpec, faults: &mut Faults) {
    let (demands, given) = (s.problem.demand_names(), s.problem.given_names());
    let known: Vec<String> = demands.iter().chain(&given).cloned().collect();
    let (mut of_demands, mut of_given, mut cells) = (0, 0, 1usize);
    for (name, values) in &s.axes {
        let key = format!("axes.{name}");
        if !known.contains(name) {
            faults.unknown(&key, name, &known);
            continue;
        }
        of_demands += usize::from(demands.contains(name));
        of_given += usize::from(given.contains(name));
        let demand = s.problem.demands.iter().find(|d| d.output == *name).map(|d| (d.lower, d.upper));
        let range = demand.or(s.problem.given.iter().find(|g| g.name == *name).map(|g| (g.lower, g.upper)));
        let (lower, upper) = range.unwrap_or((0.0, 0.0));
        // As far apart as they can be told from each other.
        let increasing = values.windows(2).all(|w| w[1] - w[0] > 1e-6 * (upper - lower));
        let inside = values.iter().all(|v| (lower..=upper).contains(v));
        if values.len() < 2 || !increasing || !inside {
            faults.push(
                &key,
                format!("{values:?}"),
                format!("two or more increasing numbers in {lower} to {upper}"),
            );
        }
        cells = cells.saturating_mul(values.len().max(1));
    }
    if of_demands > 1 || of_given > 1 || of_demands + of_given == 0 {
        let found = s.axes.keys().cloned().collect::<Vec<_>>().join(", ");
        faults.push("axes", found, "one demand, one given channel, or one of each");
    }
    if cells > MOST_CELLS {
        faults.push("axes", format!("{cells} cells"), format!("at most {MOST_CELLS}"));
    }
}

/// Channels that tables are keyed by.
fn channels(s: &MapSpec, faults: &mut Faults) {
    let inputs = s.problem.input_names();
    let free = free_inputs(s);
    if free.is_empty() {
        faults.push(
            "loops",
            "every input driven by a loop",
            "at least one input that is free to be optimised",
        );
    }
    if free.len() + s.axes.len() > MOST_DIMENSIONS {
        let found = format!("{} axes and free inputs", free.len() + s.axes.len());
        faults.push("problem.inputs", found, format!("at most {MOST_DIMENSIONS}"));
    }
    let held: Vec<String> = s.problem.demand_names().into_iter().chain(s.problem.given_names()).collect();
    for (name, value) in &s.held {
        if !held.contains(name) {
            faults.unknown(&format!("held.{name}"), name, &held);
        }
        if s.axes.contains_key(name) {
            faults.push(&format!("held.{name}"), "an axis", "a demand or given channel that is no axis");
        }
        let demands = s.problem.demands.iter().map(|d| (&d.output, d.lower, d.upper, &d.unit));
        let given = s.problem.given.iter().map(|g| (&g.name, g.lower, g.upper, &g.unit));
        if let Some((_, lower, upper, unit)) = demands.chain(given).find(|c| c.0 == name) {
            faults.range(&format!("held.{name}"), *value, lower, upper, unit);
        }
    }
    for (name, value) in &s.start {
        match s.problem.inputs.iter().find(|i| i.name == *name) {
            Some(i) => faults.range(&format!("start.{name}"), *value, i.lower, i.upper, &i.unit),
            None => faults.unknown(&format!("start.{name}"), name, &inputs),
        }
    }
    for (name, Interval { lower: a, upper: b }) in &s.bed.ranges {
        let key = format!("bed.ranges.{name}");
        match s.problem.inputs.iter().find(|i| i.name == *name && free.contains(name)) {
            Some(i) if !(i.lower <= *a && a < b && *b <= i.upper) => {
                let expected =
                    format!("two numbers within {} to {} {}, the lower first", i.lower, i.upper, i.unit);
                faults.push(&key, format!("{a} to {b}"), expected);
            }
            Some(_) => {}
            None => faults.unknown(&key, name, &free),
        }
    }
    let limited: Vec<String> = s.problem.limits.iter().map(|l| l.output.clone()).collect();
    for (name, value) in &s.bed.beyond {
        if !limited.contains(name) {
            faults.unknown(&format!("bed.beyond.{name}"), name, &limited);
        }
        faults.range(&format!("bed.beyond.{name}"), *value, 0.0, 1e9, "of the output");
    }
    for (k, m) in s.problem.minimise.iter().enumerate() {
        if free.contains(&m.channel) || held.contains(&m.channel) {
            let expected = "a driven input, a limited output, or a derived channel: a factor cannot be minimised by itself";
            faults.push(&format!("problem.minimise[{k}].channel"), format!("`{}`", m.channel), expected);
        }
    }
}

fn bed(s: &MapSpec, faults: &mut Faults) {
    let a = &s.bed.approach;
    let most = 10_000;
    count("bed.points", s.bed.points, 10, most, faults);
    if (10..=most).contains(&s.bed.points) && s.verify.points <= most && Budget::of(s).is_none() {
        let why = "points to learn from, repeats and verification together";
        faults.push("bed.points", s.bed.points, format!("at least {}: {why}", Budget::least(s)));
    }
    count("bed.block", s.bed.block, 1, 10_000, faults);
    let r = &s.bed.refine;
    faults.range("bed.refine.share", r.share, 0.0, 0.9, "of the points");
    count("bed.refine.batch", r.batch, 1, 1000, faults);
    faults.range("bed.refine.tolerance", r.tolerance, 0.0, 1.0, "of what is minimised");
    faults.range("bed.refine.gain", r.gain, 0.0, 1e9, "of what is minimised");
    faults.range("bed.refine.interval", r.interval, 0.0, 1e9, "of what is minimised");
    let minutes = (0.1..=10_000.0).contains(&s.bed.minutes);
    faults.range("bed.minutes", s.bed.minutes, 0.1, 10_000.0, "min");
    // Of a bed that is driven through files minutes do not bind.
    if minutes && s.plant.name != "bed" && s.axes.values().all(|a| a.len() > 1) {
        let (least_s, words) = least_s(s);
        if 60.0 * s.bed.minutes < least_s {
            let tune = if s.loops.iter().all(|l| l.gains.is_some()) {
                ""
            } else {
                ", and gains that are found on the bed come on top"
            };
            faults.push("bed.minutes", s.bed.minutes, format!("at least {words}{tune}"));
        }
    }
    faults.range("bed.approach.ramp_s", a.ramp_s, 0.0, 3600.0, "s");
    faults.range("bed.approach.settle_s", a.settle_s, 4.0 * s.sample_time_s, 3600.0, "s");
    faults.range("bed.approach.window_s", a.window_s, 2.0 * s.sample_time_s, 0.5 * a.settle_s, "s");
    faults.range("bed.approach.average_s", a.average_s, s.sample_time_s, 3600.0, "s");
    faults.range("bed.approach.backoff", a.backoff, 0.01, 1.0, "of the way");
    count("bed.approach.backoffs", a.backoffs, 0, 100, faults);
}

/// Channels that maps of driven inputs may follow from.
fn over(s: &MapSpec, faults: &mut Faults) {
    let driven: Vec<String> = s.loops.iter().map(|l| l.input.clone()).collect();
    let p = &s.problem;
    let limited = p.limits.iter().map(|l| l.output.clone());
    let minimised = p.minimise.iter().map(|m| m.channel.clone());
    let given = p.input_names().into_iter().chain(p.given_names()).chain(p.demand_names());
    let measured: Vec<String> = given.chain(limited).chain(minimised).collect();
    let derived = p.derive.iter().map(|d| d.name.clone());
    let known: Vec<String> = measured.iter().cloned().chain(derived).collect();
    for (input, channels) in &s.models.over {
        let key = format!("models.over.{input}");
        if !driven.contains(input) {
            faults.unknown(&key, input, &driven);
        }
        if channels.is_empty() || channels.len() > MOST_DIMENSIONS {
            faults.push(
                &key,
                format!("{} channels", channels.len()),
                format!("1 to {MOST_DIMENSIONS} channels"),
            );
        }
        for (k, name) in channels.iter().enumerate() {
            let at = format!("{key}[{k}]");
            let powers = powers_of(s, name, 0);
            if !known.contains(name) {
                faults.unknown(&at, name, &known);
            } else if powers.contains_key(input) {
                faults.push(
                    &at,
                    format!("`{name}`"),
                    format!("a channel that does not follow from `{input}` itself"),
                );
            } else if let Some(missing) = powers.keys().find(|c| !measured.contains(c)) {
                let found = format!("`{name}`, which needs `{missing}`");
                faults.push(
                    &at,
                    found,
                    "channels that are moved, limited or minimised: the models know no other",
                );
            }
        }
    }
}

fn models(s: &MapSpec, faults: &mut Faults) {
    over(s, faults);
    count("models.folds", s.models.folds, 2, 50, faults);
    if s.models.candidates.is_empty() {
        faults.push(
            "models.candidates",
            "none",
            "at least one table with a `kind` (see `dynocal list models`)",
        );
        return;
    }
    if let Err(e) = learner("best_of", &s.models.choice_keys(s.models.folds.clamp(2, 50))) {
        faults.push(
            "models.candidates",
            e,
            "tables with a `kind` and its keys, as `dynocal list models` shows them",
        );
    }
}
