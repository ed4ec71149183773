//! An optimum in words: what came out, what it costs, what does not fit.

use dynocal_calib::optimise::{GridValue, Shortfall, distance_name};
use dynocal_calib::problem::GivenChannel;
use dynocal_ident::data::UnitAfter;
use dynocal_ident::stored::Outside;
use dynocal_numerics::status::Status;
use dynocal_report::{capital, significant};

use super::result::{Asked, Optimised, PriceLine};

/// Share of samples outside of what a model was identified on from which it is worth a warning, in percent.
const OUTSIDE: f64 = 5.0;
/// Distance of a single sample, in distances of the boundary, from which it is worth one.
const FAR: f64 = 3.0;
/// Most shortfalls that are said one by one.
const SAID: usize = 5;

fn number(v: f64) -> String {
    significant(v, 4)
}

/// Sentences: how it ended, where it fails, what is dear.
pub(super) fn verdict(o: &Optimised) -> Vec<String> {
    let mut out = vec![ended(o)];
    let failed: Vec<_> = o.parts.iter().filter(|p| !p.status.is_success()).collect();
    let in_parts = o.parts.len() > 1 && o.parts.windows(2).all(|w| w[0].to_s <= w[1].from_s + 1e-9);
    if let (true, Some(first)) = (in_parts, failed.first()) {
        let why = match first.status {
            Status::Infeasible => format!(
                "it cannot go on from what the seam at {} s leaves it, or its own end asks too much",
                number(first.from_s)
            ),
            _ => "whether it has a solution is open".into(),
        };
        out.push(format!(
            "{} of {} parts did not end at a solution; the first one is that from {} to {} s ({}): {why}.",
            failed.len(),
            o.parts.len(),
            number(first.from_s),
            number(first.to_s),
            status(first.status)
        ));
    }
    out.extend(o.grid.as_ref().map(on_grid));
    out.extend(worst_first(o).into_iter().take(SAID).map(|s| format!("{}.", capital(&s.sentence()))));
    if o.shortfalls.len() > SAID {
        out.push(format!("{} further stretches are in the table.", o.shortfalls.len() - SAID));
    }
    if o.status == Status::Infeasible && !o.shortfalls.is_empty() {
        out.push(
            "These are the least amounts, in sum, that any inputs miss; the point at which the search gave up, in tables and plots, may miss more and is no plan."
                .into(),
        );
    }
    out.extend(o.asked.iter().filter(|a| !a.kept && o.shortfalls.is_empty()).map(missed));
    let first = o.record.decided.first;
    if first > 0 {
        out.push(format!(
            "Means are those of the decided samples, from {} s on; what outputs do before and at that sample follows from the record and was not judged.",
            number(first as f64 * o.record.sample_time_s)
        ));
    }
    if o.valid {
        out.extend(held(o));
        out.extend(dearest(o));
    }
    out
}

/// What the grid of dynamic programming is worth.
fn on_grid(g: &GridValue) -> String {
    let digits = |v: f64| significant(v, 7);
    format!(
        "The grid has {} cells along each remembered value ({}); the least objective on it, with what misses and increments cost, is {}, to about {}: so far away is that of half the cells.",
        g.cells,
        g.remembered.join(", "),
        digits(g.objective),
        significant(g.error, 2)
    )
}

/// Of each output and each thing asked of it the largest stretch first, those in the order of time, then the others by size.
fn worst_first(o: &Optimised) -> Vec<&Shortfall> {
    let mut all: Vec<&Shortfall> = o.shortfalls.iter().collect();
    all.sort_by(|a, b| b.largest.abs().total_cmp(&a.largest.abs()));
    let mut first: Vec<&Shortfall> = Vec::new();
    let mut others = Vec::new();
    for s in all {
        let seen = first.iter().any(|f| (&f.output, &f.of) == (&s.output, &s.of));
        if seen { others.push(s) } else { first.push(s) }
    }
    first.sort_by(|a, b| a.from_s.total_cmp(&b.from_s));
    first.extend(others);
    first
}

/// What the guard and the draws of the models held the optimum to.
fn held(o: &Optimised) -> Vec<String> {
    let mut out = Vec::new();
    let passed = |name: &String| o.asked.iter().any(|a| a.channel == *name && !a.kept);
    let names: Vec<String> = o.models.iter().map(|m| distance_name(&m.output)).collect();
    if let Some(guard) = o.guard.filter(|_| !names.iter().any(passed)) {
        let names: Vec<String> = names.iter().map(|n| format!("`{n}`")).collect();
        out.push(format!(
            "The guard holds: {} (distance of lagged inputs and outputs from what the model was identified on, 1 is the boundary) at most {}, or what the start has where that is more.",
            names.join(", "),
            number(guard.distance),
        ));
    }
    if let Some(robust) = o.robust.filter(|_| !o.problem.limits.is_empty()) {
        out.push(format!(
            "Every limit of an output that has no price holds for the models as estimated and for {} draws of their parameters.",
            robust.draws
        ));
    }
    out.extend(o.spreads.iter().map(|s| {
        let diverged = match s.diverged {
            0 => String::new(),
            n => format!("; {n} of the draws diverge"),
        };
        format!(
            "The demand of {} is met by its model as estimated; over the draws it is missed by {}{unit} RMS, at most by {}{unit}{diverged}.",
            s.output,
            number(s.rms),
            number(s.largest),
            unit = UnitAfter(&s.unit)
        )
    }));
    out
}

/// How a search ended.
fn status(s: Status) -> &'static str {
    match s {
        Status::Converged => "solved",
        Status::Stalled => "no step improves any more",
        Status::Limit => "out of iterations or of steps of restorations",
        Status::Infeasible => "infeasible",
        Status::Diverged => "values that are not finite",
        Status::Interrupted => "interrupted",
    }
}

fn ended(o: &Optimised) -> String {
    let record = format!("{} s", number(o.record.samples as f64 * o.record.sample_time_s));
    let change =
        o.objective.change_percent.map_or(String::new(), |c| format!(" ({}{} %)", plus(c), number(c)));
    let (start, end) = (number(o.objective.start), number(o.objective.optimum));
    let what = match &o.terms[..] {
        [t] if t.weight == 1.0 => {
            format!("mean {} goes from {start} to {end}{}{change}", t.channel, UnitAfter(&t.unit))
        }
        _ => format!("the objective goes from {start} to {end}{change}"),
    };
    match (o.valid, o.status) {
        (true, _) if o.asked.iter().any(|a| !a.kept) => {
            format!(
                "Solved over {record}: {what}, and everything asked is kept but what may give way at a price."
            )
        }
        (true, _) => format!("Solved over {record}: {what}, and everything asked is kept."),
        (false, Status::Converged) => {
            format!("The search over {record} ended at an optimum that misses what was asked: {what}.")
        }
        (false, Status::Infeasible) if in_parts(o) => {
            let bad = o.parts.iter().filter(|p| p.status == Status::Infeasible).count();
            format!(
                "Gone through in parts, {record} was not solved: in {bad} of {} parts no inputs within their limits give what is asked from where that part begins. At once (way = \"batch\") there may be some.",
                o.parts.len()
            )
        }
        (false, Status::Infeasible) => {
            format!(
                "Over {record} the search found no inputs within their limits that give what is asked, and none near its end that miss less: as far as a local search tells, the problem is infeasible there (`starts` of the batch tries from elsewhere)."
            )
        }
        (false, s) => format!(
            "The search over {record} did not end at an optimum ({}, {} iterations); do not use the plan as it is.",
            status(s),
            o.iterations
        ),
    }
}

/// Whether the parts are stretches of the record, not starts of the whole.
fn in_parts(o: &Optimised) -> bool {
    o.parts.len() > 1 && o.parts.iter().any(|p| p.from_s > o.parts[0].from_s)
}

fn plus(v: f64) -> &'static str {
    if v > 0.0 { "+" } else { "" }
}

fn missed(a: &Asked) -> String {
    let name = of_words(&a.channel, &a.of);
    let at = a.at_s.map_or(String::new(), |t| format!(" at {} s", number(t)));
    let soft = if a.soft { " (it is soft)" } else { "" };
    match a.largest {
        Some(l) => format!("The {name} is missed by up to {}{}{at}{soft}.", number(l), UnitAfter(&a.unit)),
        None => format!("The free run of {} on the optimal inputs diverges{at}.", a.channel),
    }
}

/// `upper limit of spark`, `demand of torque`.
pub(super) fn of_words(channel: &str, of: &str) -> String {
    match of {
        "demand" => format!("demand of {channel}"),
        "rate" => format!("rate limit of {channel}"),
        "mean_upper" => format!("limit of the mean of {channel}"),
        of => format!("{of} limit of {channel}"),
    }
}

/// The three things that cost most.
fn dearest(o: &Optimised) -> Option<String> {
    let cost = |p: &&PriceLine| p.per_percent.abs() > 1e-5 * o.objective.start.abs().max(f64::MIN_POSITIVE);
    let said: Vec<String> = o.prices.iter().filter(cost).take(3).map(price).collect();
    (!said.is_empty()).then(|| format!("What weighs most in what is minimised: {}.", said.join("; ")))
}

fn price(p: &PriceLine) -> String {
    let unit = UnitAfter(&p.unit);
    format!(
        "{}{unit} more of the {} change it by {}{}",
        number(p.percent_of_size),
        of_words(&p.channel, &p.of),
        plus(p.per_percent),
        number(p.per_percent)
    )
}

/// Where the record leaves the range that the spec gives of a channel that is not chosen.
fn beyond_range(o: &Optimised, g: &GivenChannel) -> Option<String> {
    let values = o.start.values(&g.name).ok()?;
    let far = |v: f64| (g.lower - v).max(v - g.upper);
    let (t, v) = values.iter().copied().enumerate().max_by(|a, b| far(a.1).total_cmp(&far(b.1)))?;
    (far(v) > 1e-6 * (g.upper - g.lower)).then(|| {
        format!(
            "{} of the record leaves the range that the spec gives, {} to {}{}: {} at {} s",
            g.name,
            number(g.lower),
            number(g.upper),
            UnitAfter(&g.unit),
            number(v),
            number(t as f64 * o.record.sample_time_s)
        )
    })
}

/// Where the optimum leaves what the models know, and what the record did not have.
pub(super) fn warnings(o: &Optimised, from_rest: &[String], outside: Vec<Outside>) -> Vec<String> {
    let mut out = Vec::new();
    for c in o.coverage.iter().filter(|c| c.optimum_percent > OUTSIDE || c.worst > FAR) {
        out.push(format!(
            "{} % of the optimum lie outside of what the model of {} was identified on ({} % of the start), at {} s by a factor of {}: what it promises there is extrapolation",
            number(c.optimum_percent),
            c.output,
            number(c.start_percent),
            number(c.at_s),
            number(c.worst)
        ));
    }
    out.extend(o.problem.given.iter().filter_map(|g| beyond_range(o, g)));
    let stopped = o.parts.iter().filter(|p| p.status == Status::Interrupted).count();
    if o.status.is_success() && stopped > 0 {
        out.push(format!("interrupted: the best of {} starts that ended is shown", o.parts.len() - stopped));
    }
    let mut said: Vec<String> = outside.iter().map(|s| s.sentence()).collect();
    said.sort();
    said.dedup();
    out.extend(said);
    if !from_rest.is_empty() {
        out.push(format!("the record has no {}: its model starts from rest", from_rest.join(", ")));
    }
    out
}
