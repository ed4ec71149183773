//! Head, overview, spec and files.

use super::super::run::ChainResult;
use super::super::summary::Summary;
use super::super::validate_step::DYNAMIC;
use super::super::verdict::{objective_words, word};
use super::parts::{change, unit};
use dynocal_report::{Axis, Bars, Cell, Column, KeyValue, Report, Section, Table, significant};

/// Title, verdict, warnings and facts.
pub(super) fn head(s: &Summary, r: &ChainResult) -> Report {
    let subtitle = match s.steps.last() {
        Some(last) if *last != "validate" => format!("{}: steps up to `{last}`", s.name),
        _ => format!("{}: from the first test signal to the validated dynamic map", s.name),
    };
    let plant = &s.spec.plant;
    let mut report = Report::new(&s.spec.title)
        .subtitle(subtitle)
        .fact(
            "Plant",
            if plant.name == "bed" {
                plant.name.clone()
            } else {
                format!("{}, {}", plant.name, plant.parameters)
            },
        )
        .fact("Seed", s.spec.seed.to_string())
        .fact("Sample time", format!("{} s", s.spec.sample_time_s))
        .fact("Bed time", format!("{:.0} s", r.bed_s()))
        .fact("Status", if s.valid { "valid" } else { "not valid" })
        .fact("Ended", word(s.status));
    let noise = plant.noise_words();
    if !noise.is_empty() && plant.name != "bed" {
        report = report.fact("Sensor noise", noise);
    }
    for paragraph in s.verdict.lines() {
        report = report.verdict(paragraph);
    }
    for warning in s.warnings {
        report = report.warning(warning.as_str());
    }
    report
}

/// The main numbers and the bed times.
pub(super) fn overview(s: &Summary, r: &ChainResult) -> Section {
    let mut items = Vec::new();
    let outputs = r.identify.as_ref().map_or(0, |d| d.result.outputs.len());
    for m in s.models.iter().rev().take(outputs).rev() {
        let best = m.candidates.iter().find(|c| c.name == m.chosen);
        let r2 = best.and_then(|c| c.unseen_r2).map(|v| significant(100.0 * v, 4));
        items.push(KeyValue::new(format!("Free-run R2 of {}, unseen records", m.output), r2, "%"));
    }
    let what = objective_words(s.spec);
    if let Some(p) = s.passes.last() {
        let all_metered = s.spec.problem.meterable().len() == p.meters.len();
        let seen = if all_metered { "Measured" } else { "Played (by the recorded inputs)" };
        let last = if p.usable { "last pass" } else { "last pass, which must not be used" };
        items.push(KeyValue::new(
            format!("Promised change of {what}, {last}"),
            significant(change(p.promised_ratio), 3),
            "%",
        ));
        items.push(KeyValue::new(
            format!("{seen} change of {what}, {last}"),
            significant(change(p.measured_ratio), 3),
            "%",
        ));
    }
    if let Some(b) = s.static_on_record {
        items.push(KeyValue::new(
            "The same with the static map's values of the inputs that no loop drives",
            significant(change(b.ratio), 3),
            "%",
        ));
    }
    if let Some(v) = &r.validate {
        for own in v.result.scores.iter().filter(|m| m.map == DYNAMIC) {
            for d in &own.demands {
                let name = format!("Worst steady {} offset, {}", d.output, own.scenario);
                items.push(KeyValue::new(name, significant(d.offset, 3), unit(&d.unit)));
            }
        }
    }
    let section = Section::new("Result").id("result").key_values(items);
    let (table, bars) = bed(s);
    section.columns(vec![table.into(), bars.into()])
}

fn bed(s: &Summary) -> (Table, Bars) {
    let b = &s.bed;
    let mut needed = vec![
        ("gains of the loops", b.loops_s),
        ("identification", b.identification_s),
        ("design", b.design_s),
        ("optimisation", b.optimisation_s),
        ("points at rest", b.at_rest_s),
    ];
    if s.spec.fuelling.is_some() {
        needed.push(("fuel by measured states", b.fuelling_s));
    }
    let beside = [
        ("validation records", b.validation_records_s),
        ("record that the design is compared with", b.design_comparison_s),
        ("static map", b.static_map_s),
        ("comparison of the maps", b.map_comparison_s),
    ];
    let mut table = Table::new(vec![
        Column::text("Records"),
        Column::number("Bed time", "s").digits(3),
        Column::text("Purpose"),
    ])
    .caption("Bed time, lead-in and settling included");
    for &(name, time_s) in &needed {
        table = table.row([name.into(), time_s.into(), "calibration".into()]);
    }
    table = table.stressed_row([Cell::from("together"), b.total_s.into(), "calibration".into()]);
    for (name, time_s) in beside {
        table = table.row([name.into(), time_s.into(), "proof and comparison".into()]);
    }
    let bars = Bars::new("Bed time", Axis::new("Time", "s"), needed.iter().chain(&beside).map(|b| b.0))
        .series("bed time", needed.iter().chain(&beside).map(|b| b.1).collect::<Vec<f64>>());
    (table, bars)
}

/// The spec as understood.
pub(super) fn spec(s: &Summary) -> Section {
    let text = toml::to_string_pretty(s.spec).unwrap_or_else(|e| format!("the spec cannot be shown: {e}"));
    Section::new("Spec").id("spec").text("The spec as understood, with all defaults filled in.").block(
        dynocal_report::Details::new("Show the spec")
            .block(dynocal_report::Block::Code { caption: "calibrate.toml".into(), text }),
    )
}

/// What lies in the run folder.
pub(super) fn files(s: &Summary) -> Section {
    let mut table = Table::new(vec![Column::text("File"), Column::text("What it is")]);
    for f in s.files {
        table = table.row([f.file.as_str().into(), Cell::from(f.what.as_str())]);
    }
    Section::new("Files").id("files").text("Paths inside the run folder.").block(table)
}
