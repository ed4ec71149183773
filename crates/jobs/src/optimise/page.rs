//! The page of an optimisation.

use std::path::Path;

use dynocal_calib::optimise::{Price, distance_name};
use dynocal_files::atomic;
use dynocal_report::{Cell, Column, Panel, Report, Section, Table, TimePlot, render, significant};

use super::result::Optimised;
use super::words::of_words;
use crate::page::PageError;

/// Most samples of a plot.
const DRAWN: usize = 5000;
/// Least price of one percent that is drawn, as a share of the objective at the start.
const SEEN: f64 = 1e-7;
/// Most prices that are drawn over time.
const PRICES: usize = 6;

/// Writes `report.html` into the run folder.
///
/// # Errors
/// [`PageError`].
pub fn write(found: &Optimised, folder: &Path) -> Result<(), PageError> {
    atomic::write(&folder.join("report.html"), render(&report(found))?.as_bytes())?;
    Ok(())
}

/// The page.
pub fn report(found: &Optimised) -> Report {
    let mut report = Report::new(format!("Optimisation: {}", found.name));
    for paragraph in &found.verdict {
        report = report.verdict(paragraph.as_str());
    }
    for warning in found.warnings.iter().filter(|w| !found.verdict.contains(w)) {
        report = report.warning(warning.as_str());
    }
    report = report.section(Section::new("Objective").block(terms(found)));
    if !found.shortfalls.is_empty() {
        report = report.section(shortfalls(found));
    }
    report = report.section(asked(found)).section(time_plots(found));
    if !found.prices.is_empty() {
        report = report.section(prices(found));
    }
    if !found.parts.is_empty() {
        report = report.section(parts(found));
    }
    report.section(models(found))
}

fn terms(found: &Optimised) -> Table {
    let head = vec![
        Column::text("Minimised"),
        Column::text("Unit"),
        Column::number("Weight", "").digits(4),
        Column::number("Mean at the start", "").digits(5),
        Column::number(
            if found.status.is_success() { "Mean at the optimum" } else { "Mean where the search ended" },
            "",
        )
        .digits(5),
        Column::number("Change", "%").digits(3),
    ];
    let change = |start: f64, optimum: f64| (start != 0.0).then(|| 100.0 * (optimum - start) / start.abs());
    found.terms.iter().fold(Table::new(head), |t, x| {
        t.row(vec![
            Cell::from(x.channel.as_str()),
            x.unit.as_str().into(),
            x.weight.into(),
            x.start.into(),
            x.optimum.into(),
            Cell::from(change(x.start, x.optimum)),
        ])
    })
}

fn shortfalls(found: &Optimised) -> Section {
    let head = vec![
        Column::text("Output"),
        Column::text("Misses"),
        Column::number("From", "s").digits(5),
        Column::number("To", "s").digits(5),
        Column::number("By up to", "").digits(4),
        Column::text("Unit"),
        Column::number("At", "s").digits(5),
        Column::text("Inputs at a limit meanwhile"),
    ];
    let table = found.shortfalls.iter().fold(Table::new(head), |t, s| {
        t.row(vec![
            Cell::from(s.output.as_str()),
            s.of.as_str().into(),
            s.from_s.into(),
            s.to_s.into(),
            s.largest.into(),
            s.unit.as_str().into(),
            s.at_s.into(),
            if s.inputs.is_empty() { "none".into() } else { s.inputs.join(", ").as_str().into() },
        ])
    });
    Section::new("Where it cannot be met")
        .text(
            "The same problem with every demand and limit of an output made soft, and the least sum of what is missing: what remains is where the problem fails. Inputs at a limit meanwhile are what holds it back.",
        )
        .block(table)
}

fn asked(found: &Optimised) -> Section {
    let head = vec![
        Column::text("Asked"),
        Column::number("Missed by up to", "").digits(3),
        Column::number("Counts as kept up to", "").digits(3),
        Column::text("Unit"),
        Column::number("At", "s").digits(5),
        Column::text("Kept"),
    ];
    let table = found.asked.iter().fold(Table::new(head), |t, a| {
        let kept = match (a.kept, a.soft) {
            (true, _) => "yes",
            (false, true) => "no (soft)",
            (false, false) => "no",
        };
        let cells = vec![
            Cell::from(of_words(&a.channel, &a.of).as_str()),
            Cell::from(a.largest),
            a.allowed.into(),
            a.unit.as_str().into(),
            Cell::from(a.at_s),
            kept.into(),
        ];
        if a.kept || a.soft { t.row(cells) } else { t.stressed_row(cells) }
    });
    Section::new("What was asked")
        .text(
            if found.status.is_success() {
                "Distances of the free run of the models on the optimal inputs, not of what the search believed."
            } else {
                "Distances of the free run of the models on the inputs with which the search ended, which are no optimum."
            },
        )
        .block(table)
}

fn time_plots(found: &Optimised) -> Section {
    let (o, p) = (&found.optimum, &found.problem);
    let n = found.record.samples.min(DRAWN);
    let cut = |v: &[f64]| v[..v.len().min(n)].to_vec();
    let start = |name: &str| found.start.values(name).map(cut).unwrap_or_default();
    let mut plot = TimePlot::sampled("Inputs and outputs", o.sample_time_s, n);
    for (c, i) in o.inputs.iter().zip(&p.inputs) {
        let panel = Panel::new(c.name.as_str(), c.unit.as_str())
            .held("start", start(&c.name))
            .held("optimum", cut(&c.values))
            .level("lower", i.lower)
            .level("upper", i.upper);
        plot = plot.panel(panel);
    }
    for c in &o.responses {
        let mut panel = Panel::new(c.name.as_str(), c.unit.as_str());
        match o.demands.iter().find(|d| d.name == c.name) {
            Some(d) => panel = panel.demand(cut(&d.values)),
            // The distances of a guard are no channels of the record.
            None if found.start.values(&c.name).is_err() => {}
            None => panel = panel.line("start", start(&c.name)),
        }
        panel = panel.simulated(cut(&c.values));
        let extreme = |side: &str| o.outputs.iter().find(|e| e.name == format!("{}_{side}", c.name));
        if let (Some(least), Some(greatest)) = (extreme("least"), extreme("greatest")) {
            panel = panel.band("all draws", cut(&least.values), cut(&greatest.values));
        }
        let limit = p.limits.iter().find(|l| l.output == c.name);
        let guard = found.guard.filter(|_| found.models.iter().any(|m| distance_name(&m.output) == c.name));
        let upper = limit.and_then(|l| l.upper).or(guard.map(|g| g.distance));
        for (name, level) in [("lower", limit.and_then(|l| l.lower)), ("upper", upper)] {
            if let Some(v) = level {
                panel = panel.level(name, v);
            }
        }
        plot = plot.panel(panel);
    }
    for g in &p.given {
        plot = plot.panel(Panel::new(g.name.as_str(), g.unit.as_str()).held("given", start(&g.name)));
    }
    if found.parts.len() > 1 && found.parts.len() <= 100 {
        for part in found.parts.iter().filter(|p| !p.status.is_success()) {
            plot = plot.mark(part.from_s, "no solution from here");
        }
    }
    if n < found.record.samples {
        let text = format!("The first {n} of {} samples; all are in optimum.csv.", found.record.samples);
        plot = plot.caption(text);
    }
    Section::new("Inputs and outputs").block(plot)
}

fn prices(found: &Optimised) -> Section {
    let head = vec![
        Column::text("One more of the"),
        Column::text("Unit"),
        Column::number("Changes it by", "").digits(4),
        Column::number("One percent of its size", "").digits(4),
        Column::number("changes it by", "").digits(4),
    ];
    let table = found.prices.iter().fold(Table::new(head), |t, x| {
        t.row(vec![
            Cell::from(of_words(&x.channel, &x.of).as_str()),
            x.unit.as_str().into(),
            x.price.into(),
            x.percent_of_size.into(),
            x.per_percent.into(),
        ])
    });
    let section = Section::new("What demands and limits cost")
        .text(format!(
            "Derivatives of what is minimised{}: what one unit more of a demand (at all samples), of a limit or of a rate changes while the same limits stay active. A limit that nothing touches costs nothing.",
            found.objective.minimised.map_or(String::new(), |m| format!(
                " ({} at the optimum: the objective over the record and its extension, with smoothing and what is soft; the objective alone is {})",
                significant(m, 5),
                significant(found.objective.optimum, 5)
            ))
        ))
        .block(table);
    match price_plot(found) {
        Some(plot) => section.block(plot),
        None => section,
    }
}

/// The dearest prices over time.
fn price_plot(found: &Optimised) -> Option<TimePlot> {
    let o = &found.optimum;
    let n = found.record.samples.min(DRAWN);
    // What is left of barriers that nothing touches is no price.
    let seen = SEEN * found.objective.start.abs();
    let drawn: Vec<&Price> = found
        .prices
        .iter()
        .filter(|x| x.per_percent.abs() > seen)
        .filter_map(|x| o.prices.iter().find(|p| p.channel == x.channel && p.of == x.of))
        .filter(|p| p.by_sample.len() >= n && p.by_sample.iter().any(|v| *v != 0.0))
        .take(PRICES)
        .collect();
    (!drawn.is_empty()).then(|| {
        let plot = TimePlot::sampled("Prices by sample", o.sample_time_s, n).caption(
            "Change of what is minimised (a mean over the record) for one unit more at that sample alone; all are in prices.csv.",
        );
        drawn.iter().fold(plot, |plot, p| {
            let unit = format!("objective/({})", p.unit);
            plot.panel(Panel::new(of_words(&p.channel, &p.of), unit).line("price", p.by_sample[..n].to_vec()))
        })
    })
}

fn parts(found: &Optimised) -> Section {
    let head = vec![
        Column::number("From", "s").digits(5),
        Column::number("To", "s").digits(5),
        Column::text("Ended"),
        Column::number("Iterations", ""),
    ];
    let failed = found.parts.iter().filter(|p| !p.status.is_success()).count();
    let text = format!(
        "{} parts, {failed} without a solution; those are shown, and the first ten.",
        found.parts.len()
    );
    let shown = found.parts.iter().enumerate().filter(|(k, p)| *k < 10 || !p.status.is_success());
    let table = shown.fold(Table::new(head), |t, (_, p)| {
        let status = format!("{:?}", p.status).to_lowercase();
        t.row(vec![p.from_s.into(), p.to_s.into(), Cell::from(status.as_str()), (p.iterations as f64).into()])
    });
    Section::new("Parts").text(text).block(table)
}

fn models(found: &Optimised) -> Section {
    let head = vec![
        Column::text("Output"),
        Column::text("Unit"),
        Column::text("Driven by"),
        Column::number("Parameters", ""),
        Column::number("Outside of what it was identified on: start", "%").digits(3),
        Column::number("optimum", "%").digits(3),
        Column::text("File"),
    ];
    let table = found.models.iter().fold(Table::new(head), |t, m| {
        let left = found.coverage.iter().find(|c| c.output == m.output);
        t.row(vec![
            Cell::from(m.output.as_str()),
            m.unit.as_str().into(),
            m.inputs.join(", ").as_str().into(),
            (m.parameters as f64).into(),
            Cell::from(left.map(|c| c.start_percent)),
            Cell::from(left.map(|c| c.optimum_percent)),
            m.file.as_str().into(),
        ])
    });
    Section::new("Models").block(table)
}
