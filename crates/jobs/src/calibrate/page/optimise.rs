//! Step 4: what was promised and what was measured.

use super::super::context::Context;
use super::super::error::ChainError;
use super::super::optimise_step::{OptimiseResult, Pass};
use super::super::validate_step::StaticOnRecord;
use super::super::verdict::{objective_words, word};
use super::models::{table, terms};
use super::parts::{change, plot, record, unit};
use dynocal_files::run_folder::Done;
use dynocal_report::{Axis, Bars, Cell, Column, Details, Section, Table};

/// The whole step.
pub(super) fn section(
    ctx: &Context,
    o: &Done<OptimiseResult>,
    fixed: Option<&StaticOnRecord>,
) -> Result<Section, ChainError> {
    let passes = &o.result.passes;
    let what = objective_words(ctx.spec);
    let mut section = Section::new("Optimisation over a record").id("optimise").text(format!(
        "Least {what} of a record at equal demanded outputs at every sample. The demand is the models' response to a feasible start; start and optimum are measured with small loops that hold it. A pass whose optimum must not be used is left out of the map and of the next models; where no pass may be used the map is made from the last one, only to be looked at."
    ));
    section =
        section.block(promise(ctx, passes, fixed)).block(bars(&what, passes, fixed)).block(misses(passes));
    let spec = &ctx.spec.optimise;
    if passes.iter().any(|p| !p.learned.trials.is_empty()) {
        section = section.block(trials(passes));
    }
    for p in passes.iter().filter(|p| !p.learned.ended.is_empty()) {
        section = section.text(format!("Learning of pass {} ended early: {}.", p.pass, p.learned.ended));
    }
    if let Some(most) = spec.within_points.filter(|_| passes.len() < spec.passes) {
        section = section.text(format!(
            "The last of {} passes was number {}: its optimum was measured within {most} points of its promise.",
            spec.passes,
            passes.len()
        ));
    }
    for p in passes {
        let models = p.models.chosen();
        section = section.heading(format!("Pass {}", p.pass));
        let titles = [
            format!("Pass {}, optimum: demand, measured and re-identified models", p.pass),
            format!("Pass {}, start: demand, measured and re-identified models", p.pass),
        ];
        // The optimum is what the pass is about; it comes before its start.
        for (reference, title) in p.records.iter().rev().zip(titles) {
            section = section.block(plot(ctx, title, &record(ctx, &o.folder, reference)?, &models)?);
        }
    }
    if let Some(last) = passes.last() {
        let mut details = Details::new("Models after the last pass: candidates and terms");
        for m in &last.models.outputs {
            details =
                details.block(table(m, &format!("Candidates for {}", m.output))).block(terms(m, m.best()));
        }
        section = section.block(details);
    }
    Ok(section)
}

fn promise(ctx: &Context, passes: &[Pass], fixed: Option<&StaticOnRecord>) -> Table {
    let u = ctx.spec.problem.minimise.first().and_then(|t| ctx.spec.problem.unit(&t.channel)).unwrap_or("");
    let mut table = Table::new(vec![
        Column::text("Record"),
        Column::number("Start", unit(u)).digits(5),
        Column::number("Optimum", unit(u)).digits(5),
        Column::number("Promised", "%").digits(3),
        Column::number(seen(ctx, passes), "%").digits(3),
        Column::number("Gap", "points").digits(2),
        Column::text("Ended"),
        Column::number("Iterations", ""),
        Column::text("Used"),
    ])
    .caption(format!(
        "Promised change from start to optimum against what came out. Start and optimum are {}",
        source(ctx, passes)
    ));
    for p in passes {
        table = table.row([
            named(p).into(),
            p.measured_start.into(),
            p.measured.into(),
            change(p.promised_ratio).into(),
            change(p.measured_ratio).into(),
            (100.0 * (p.promised_ratio - p.measured_ratio).abs()).into(),
            word(p.status).into(),
            p.iterations.into(),
            Cell::from(if p.usable { "yes".to_string() } else { format!("no: {}", p.reason) }),
        ]);
    }
    if let (Some(b), Some(last)) = (fixed, passes.last()) {
        table = table.row([
            Cell::from("free inputs of the static map"),
            last.measured_start.into(),
            b.objective.into(),
            Cell::Empty,
            change(b.ratio).into(),
            Cell::Empty,
            Cell::Empty,
            Cell::Empty,
            Cell::Empty,
        ]);
    }
    table
}

/// Whether what is minimised was measured, or follows from the inputs that were played.
fn seen(ctx: &Context, passes: &[Pass]) -> &'static str {
    let all_metered = passes.iter().all(|p| p.unmetered(&ctx.spec.problem).is_empty());
    if all_metered { "Measured" } else { "Played" }
}

/// Where the objective of the records comes from.
fn source(ctx: &Context, passes: &[Pass]) -> String {
    let Some(last) = passes.last() else { return "as measured".into() };
    let unmetered = last.unmetered(&ctx.spec.problem);
    if !unmetered.is_empty() {
        return format!("by the recorded inputs ({} has no meter)", unmetered.join(", "));
    }
    let errors: Vec<String> = last
        .meters
        .iter()
        .map(|m| format!("its mean is {:+.2} % beside {} by the recorded inputs", 100.0 * m.error, m.channel))
        .collect();
    if errors.is_empty() { "as measured".into() } else { format!("by the meter: {}", errors.join("; ")) }
}

fn bars(what: &str, passes: &[Pass], fixed: Option<&StaticOnRecord>) -> Bars {
    let mut names = Vec::new();
    let mut changes = Vec::new();
    for p in passes {
        names.extend([format!("pass {}, promised", p.pass), format!("pass {}, measured", p.pass)]);
        changes.extend([change(p.promised_ratio), change(p.measured_ratio)]);
    }
    if let Some(b) = fixed {
        names.push("free inputs of the static map, measured".into());
        changes.push(change(b.ratio));
    }
    Bars::new(format!("{what} against the start record"), Axis::new("Change", "%"), names)
        .series("change", changes)
}

/// What learning on the plant made of records that it did not follow.
fn trials(passes: &[Pass]) -> Table {
    let mut table = Table::new(vec![
        Column::text("Record"),
        Column::text("Output"),
        Column::number("RMS measured", "").digits(3),
        Column::number("Mean measured", "").digits(3),
        Column::text("Unit"),
        Column::number("Largest distance of the record", "of what may be").digits(2),
        Column::text("Counts"),
    ])
    .caption(
        "Optima that the plant did not follow: inputs of the loops were corrected by what was missed, of the start alike, and played again. The record whose worst output is nearest to its demand counts, for all numbers above; what was promised stays. Distances are shares of the one from which on a pass must not be used",
    );
    for p in passes {
        for t in p.learned.trials.iter().flat_map(|t| [&t.start, &t.optimum]) {
            let counts = p.records.iter().any(|r| r.name == t.record.name);
            for m in t.misses.iter().filter(|m| m.measured_rms.is_some()) {
                table = table.row([
                    t.record.name.as_str().into(),
                    m.output.as_str().into(),
                    Cell::from(m.measured_rms),
                    Cell::from(m.measured_mean),
                    Cell::from(unit(&m.unit)),
                    Cell::from(t.share),
                    Cell::from(if counts { "yes" } else { "no" }),
                ]);
            }
        }
    }
    table
}

/// A pass as its rows are named.
fn named(p: &Pass) -> String {
    match p.learned.trials.len() {
        0 | 1 => format!("pass {}", p.pass),
        2 => format!("pass {}, learned in one trial", p.pass),
        n => format!("pass {}, learned in {} trials", p.pass, n - 1),
    }
}

fn misses(passes: &[Pass]) -> Table {
    let mut table = Table::new(vec![
        Column::text("Pass"),
        Column::text("Output"),
        Column::number("On the models", "").digits(2),
        Column::number("RMS measured", "").digits(3),
        Column::number("Mean measured", "").digits(3),
        Column::text("Unit"),
    ])
    .caption(
        "Distance from the demands (or limits): largest of the models' free run, and of the measured optimum",
    );
    for p in passes {
        for m in &p.misses {
            table = table.row([
                p.pass.into(),
                m.output.as_str().into(),
                Cell::from(m.violation),
                Cell::from(m.measured_rms),
                Cell::from(m.measured_mean),
                Cell::from(unit(&m.unit)),
            ]);
        }
    }
    table
}
