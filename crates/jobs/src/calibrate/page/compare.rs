//! Step 6: the delivered map against its rivals.

use super::super::context::Context;
use super::super::error::ChainError;
use super::super::fuelled::FuelledBy;
use super::super::summary::Summary;
use super::super::validate_step::{Causality, DYNAMIC, ECU_FUEL, OWN_FUEL, SAME_FUEL, ValidateResult};
use super::super::verdict::objective_words;
use super::parts::{change, label, record, unit};
use dynocal_calib::validate::MapScore;
use dynocal_files::run_folder::Done;
use dynocal_ident::data::Dataset;
use dynocal_report::{
    Axis, Bars, Cell, Column, Details, Panel, Role, Section, Series, Table, TimePlot, significant,
};

/// The whole step.
pub(super) fn section(
    ctx: &Context,
    v: &Done<ValidateResult>,
    summary: &Summary,
) -> Result<Section, ChainError> {
    let r = &v.result;
    let mut scenarios: Vec<&str> = Vec::new();
    for s in &r.scores {
        if !scenarios.contains(&s.scenario.as_str()) {
            scenarios.push(&s.scenario);
        }
    }
    // Where engine and fuelling are one plant another rival stands in its place.
    let lag = match r.scores.iter().any(|s| s.map == SAME_FUEL) {
        true => format!(
            "The {SAME_FUEL} says what the dynamics of the delivered map are worth: no lag of a static map with its own fuel is searched, as no model says how that should wait."
        ),
        false => format!(
            "The lag of the lagged static map, {:.3} s, is the best of a line search on the identified models.",
            r.lag_s
        ),
    };
    let mut section = Section::new("Comparison of the maps").id("validate").text(format!(
        "All maps drive the plant open loop. Settling counts from the change of the raw demand, look-ahead included, for every map. {lag}"
    ));
    if let Some(by) = &r.fuelled {
        section = section.text(fuelled(by));
    }
    for scenario in scenarios {
        let scores: Vec<&MapScore> = r.scores.iter().filter(|s| s.scenario == scenario).collect();
        section = section.heading(label(scenario)).block(costs(&scores));
        for k in 0..ctx.channels.demands.len() {
            section = section.block(table(&scores, k));
        }
        if !ctx.spec.problem.limits.is_empty() {
            section = section.block(limits(&scores));
        }
        section = section.columns(bars(ctx, &scores));
        let mut runs = Vec::new();
        for s in &scores {
            let name = format!("{}, {scenario}", s.map);
            if let Some(reference) = r.records.iter().find(|r| r.name == name) {
                runs.push((s.map.as_str(), record(ctx, &v.folder, reference)?));
            }
        }
        if let Some((_, first)) = runs.first() {
            section = section.block(outputs(ctx, scenario, first, &runs)?);
            if let Some(window) = zoom(ctx, first)? {
                section = section.columns(zoomed(ctx, &runs, window)?);
            }
            section = section
                .block(Details::new("Actuators of all maps").block(actuators(ctx, scenario, first, &runs)?));
        }
    }
    if let Some(c) = &r.causality {
        section = section.heading("The price of causality").block(causality(ctx, c));
    }
    Ok(section.block(points(ctx, r)).text(format!(
        "Bed time of the static map: {:.0} s; of this comparison: {:.0} s.",
        summary.bed.static_map_s, summary.bed.map_comparison_s
    )))
}

/// Who injects, and how the ECU was tuned.
fn fuelled(by: &FuelledBy) -> String {
    let closed = by.ecu_closed_s.map_or("no lambda loop, which was no better".to_string(), |s| {
        format!("a lambda loop of {} s", significant(s, 2))
    });
    format!(
        "The fuel of the {DYNAMIC} is given by measured states every {} ms (`{}`), not by its table of the injection. Its fuel and that of the ECU are no open loop: what is measured comes back into them. The {OWN_FUEL} is the same with the table. The {ECU_FUEL} has air charge and film of the same identification, extrapolates the pressure by {} s and has {closed}: the best of two line searches on random points of their own ({:.0} s of bed time).",
        significant(1e3 * by.interval_s, 3),
        by.file,
        significant(by.ecu_ahead_s, 2),
        by.ecu_bed_s
    )
}

/// The same demands by an optimum with preview, a policy without it, and the map that is delivered.
fn causality(ctx: &Context, c: &Causality) -> Table {
    let head = vec![
        Column::text("Inputs that no loop drives"),
        Column::number("Change from the start record", "%").digits(3),
    ];
    let table = Table::new(head).caption(format!(
        "Mean {} on the demands of the last pass, held by loops. From the first to the second: what it costs not to know the future; from there to the third: what tables cost",
        objective_words(ctx.spec)
    ));
    let row = |name: &str, ratio: Option<f64>| vec![Cell::from(name), Cell::from(ratio.map(change))];
    table
        .row(row("optimum of the record, with preview", Some(c.preview)))
        .row(row("causal policy in its full form, without preview", c.policy))
        .stressed_row(row("map that is delivered", Some(c.delivered)))
}

/// What each map costs.
fn costs(scores: &[&MapScore]) -> Table {
    let mut table = Table::new(vec![
        Column::text("Map"),
        Column::number("Objective", "").digits(5),
        Column::number("Economy (6.4)", "").digits(4),
        Column::number("Economy at equal errors", "").digits(4),
    ])
    .caption("What is minimised, mean over the scenario. Compare it at equal errors of the demands only");
    for s in scores {
        let row = vec![
            Cell::from(s.map.as_str()),
            s.objective.into(),
            Cell::from(s.economy),
            Cell::from(s.economy_equal),
        ];
        table = if s.map == DYNAMIC { table.stressed_row(row) } else { table.row(row) };
    }
    table
}

/// What each map leaves of the limits, or passes them by.
fn limits(scores: &[&MapScore]) -> Table {
    let mut table = Table::new(vec![
        Column::text("Map"),
        Column::text("Limit"),
        Column::number("Value", "").digits(4),
        Column::number("Beyond it", "").digits(3),
        Column::number("Samples beyond", "%").digits(3),
    ])
    .caption("Limits of the problem, measured: a negative number beyond is what was left. Up to a fiftieth of a limit counts as scatter");
    for s in scores {
        for l in &s.limits {
            let name = format!(
                "{} {}, {}",
                l.output,
                l.of.replace('_', " "),
                if l.unit == "-" { "no unit" } else { &l.unit }
            );
            let row = vec![
                Cell::from(s.map.as_str()),
                Cell::from(name.as_str()),
                l.limit.into(),
                l.excess.into(),
                (100.0 * l.share).into(),
            ];
            table = if s.map == DYNAMIC { table.stressed_row(row) } else { table.row(row) };
        }
    }
    table
}

/// Scores of one demand.
fn table(scores: &[&MapScore], k: usize) -> Table {
    let (name, u) = scores
        .first()
        .and_then(|s| s.demands.get(k))
        .map_or((String::new(), String::new()), |d| (label(&d.output), unit(&d.unit).to_string()));
    let integral_unit = if u.is_empty() { "s".to_string() } else { format!("{u} s") };
    let mut table = Table::new(vec![
        Column::text("Map"),
        Column::number("RMS error", u.as_str()).digits(3),
        Column::number("Mean error", u.as_str()).digits(3),
        Column::number("Integral per step", integral_unit.as_str()).digits(3),
        Column::number("Worst offset", u.as_str()).digits(3),
        Column::number("Worst settling", "s").digits(3),
        Column::number("Mean settling", "s").digits(3),
        Column::number("Spike above", u.as_str()).digits(3),
        Column::number("Spike below", u.as_str()).digits(3),
    ])
    .caption(format!("{name} against the raw demand: offsets are worst means of the last second of a point, spikes count from the first change"));
    for s in scores {
        let Some(d) = s.demands.get(k) else { continue };
        let row = vec![
            Cell::from(s.map.as_str()),
            d.rms.into(),
            d.mean_error.into(),
            d.integral_s.into(),
            d.offset.into(),
            d.settling_s.into(),
            d.settling_mean_s.into(),
            d.spike_above.into(),
            Cell::from(d.spike_below),
        ];
        table = if s.map == DYNAMIC { table.stressed_row(row) } else { table.row(row) };
    }
    table
}

fn bars(ctx: &Context, scores: &[&MapScore]) -> Vec<dynocal_report::Block> {
    let names = || scores.iter().map(|s| s.map.as_str());
    let mut out = Vec::new();
    for (k, d) in ctx.spec.problem.demands.iter().enumerate() {
        let all = |f: &dyn Fn(&dynocal_calib::validate::DemandScore) -> f64| {
            scores.iter().map(|s| s.demands.get(k).map_or(f64::NAN, f)).collect::<Vec<f64>>()
        };
        let (name, u) = (label(&d.output), unit(&d.unit));
        let bars = if k == 0 {
            Bars::new(format!("{name}: error against the raw demand"), Axis::new("RMS", u), names())
                .series("RMS", all(&|d| d.rms))
        } else {
            Bars::new(format!("{name}: spikes"), Axis::new("Largest distance from the demand", u), names())
                .series("above", all(&|d| d.spike_above))
                .series("below", all(&|d| d.spike_below))
        };
        out.push(bars.into());
    }
    out
}

fn outputs(
    ctx: &Context,
    scenario: &str,
    first: &Dataset,
    runs: &[(&str, Dataset)],
) -> Result<TimePlot, ChainError> {
    let title = format!("{}: measured with every map", label(scenario));
    let mut plot = TimePlot::sampled(title, first.sample_time_s, first.len());
    for name in ctx.channels.outputs() {
        let mut panel = Panel::new(label(&name), unit(ctx.spec.problem.unit(&name).unwrap_or("-")));
        if let Ok(demand) = first.values(&format!("{name}_demand")) {
            panel = panel.series(Series::new("demand", demand.to_vec()).role(Role::Demand).held());
        }
        for (map, run) in runs {
            panel = panel.line(*map, run.values(&name)?.to_vec());
        }
        plot = plot.panel(panel);
    }
    for g in &ctx.spec.problem.given {
        plot = plot.panel(
            Panel::new(label(&g.name), unit(&g.unit)).line(g.name.clone(), first.values(&g.name)?.to_vec()),
        );
    }
    Ok(plot)
}

/// Seconds shown before and after a change of the demand.
const ZOOM_S: (f64, f64) = (0.3, 2.7);

/// Samples around the two largest changes of the leading demand, up and down.
fn zoom(ctx: &Context, run: &Dataset) -> Result<Option<[usize; 2]>, ChainError> {
    let Some(lead) = ctx.channels.demands.first() else { return Ok(None) };
    let demand = run.values(&format!("{lead}_demand"))?;
    let step = |t: &usize| demand[*t] - demand[*t - 1];
    let by = |a: &usize, b: &usize| step(a).total_cmp(&step(b)).then(b.cmp(a));
    let (up, down) = (
        (1..demand.len()).max_by(by),
        (1..demand.len()).max_by(|a, b| step(b).total_cmp(&step(a)).then(b.cmp(a))),
    );
    Ok(up.zip(down).map(|(u, d)| [u, d]))
}

/// Demanded outputs of all maps around two changes.
fn zoomed(
    ctx: &Context,
    runs: &[(&str, Dataset)],
    at: [usize; 2],
) -> Result<Vec<dynocal_report::Block>, ChainError> {
    let mut blocks = Vec::new();
    for (switch, title) in at.into_iter().zip(["Largest step up", "Largest step down"]) {
        let Some((_, first)) = runs.first() else { continue };
        let dt = first.sample_time_s;
        let from = switch.saturating_sub((ZOOM_S.0 / dt) as usize);
        let to = (switch + (ZOOM_S.1 / dt) as usize).min(first.len());
        let time: Vec<f64> = (from..to).map(|t| dt * t as f64).collect();
        let mut plot = TimePlot::new(title, time);
        for d in &ctx.spec.problem.demands {
            let demand = first.values(&format!("{}_demand", d.output))?[from..to].to_vec();
            let mut panel = Panel::new(label(&d.output), unit(&d.unit))
                .series(Series::new("demand", demand).role(Role::Demand).held());
            for (map, run) in runs {
                panel = panel.line(*map, run.values(&d.output)?[from..to].to_vec());
            }
            plot = plot.panel(panel);
        }
        blocks.push(plot.into());
    }
    Ok(blocks)
}

fn actuators(
    ctx: &Context,
    scenario: &str,
    first: &Dataset,
    runs: &[(&str, Dataset)],
) -> Result<TimePlot, ChainError> {
    let title = format!("{}: actuators", label(scenario));
    let mut plot = TimePlot::sampled(title, first.sample_time_s, first.len());
    for i in &ctx.spec.problem.inputs {
        let mut panel = Panel::new(label(&i.name), unit(&i.unit));
        for (map, run) in runs {
            panel = panel.held(*map, run.values(&i.name)?.to_vec());
        }
        plot = plot.panel(panel);
    }
    Ok(plot)
}

fn points(ctx: &Context, r: &ValidateResult) -> Details {
    let ports = &r.static_map.ports;
    let mut head: Vec<Column> = Vec::new();
    head.extend(ports.demands.first().map(|d| Column::number(label(&d.name), unit(&d.unit))));
    head.extend(ports.given.first().map(|g| Column::number(label(&g.name), unit(&g.unit))));
    head.extend(ports.actuators.iter().map(|a| Column::number(label(&a.name), unit(&a.unit)).digits(4)));
    head.extend(
        ports.demands.iter().map(|d| Column::number(format!("{} error", d.name), unit(&d.unit)).digits(2)),
    );
    head.push(Column::text("Missed"));
    let searched: Vec<&str> = ctx.channels.free.iter().map(|k| ctx.channels.inputs[*k].as_str()).collect();
    let mut table = Table::new(head).caption(format!(
        "Points of the static map: {} searched downhill and by parabolas at held demands",
        searched.join(", ")
    ));
    for p in &r.static_map.points {
        let mut row = vec![Cell::from(p.demand)];
        if !ports.given.is_empty() {
            row.push(p.given.into());
        }
        row.extend(p.actuators.iter().map(|v| Cell::from(*v)));
        row.extend(p.errors.iter().map(|v| Cell::from(*v)));
        row.push(Cell::from(p.missed.as_str()));
        table = table.row(row);
    }
    Details::new(format!("Points of the static map ({})", r.static_map.points.len())).block(table)
}
