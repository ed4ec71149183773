//! Step 6: the delivered map against its rivals.

use crate::calibrate::context::ChainError;
use crate::calibrate::validate_step::{DYNAMIC, ValidateResult};
use dynocal_calib::validate::MapScore;
use dynocal_files::run_folder::Done;
use dynocal_ident::data::Dataset;
use dynocal_report::{Axis, Bars, Cell, Column, Details, Panel, Role, Section, Series, Table, TimePlot};

use super::parts::record;
use crate::calibrate::summary::Summary;

/// The whole step.
pub(super) fn section(v: &Done<ValidateResult>, summary: &Summary, dt: f64) -> Result<Section, ChainError> {
    let r = &v.result;
    let mut scenarios: Vec<&str> = Vec::new();
    for s in &r.scores {
        if !scenarios.contains(&s.scenario.as_str()) {
            scenarios.push(&s.scenario);
        }
    }
    let mut section = Section::new("Comparison of the maps").id("validate").text(
        "All maps drive the engine open loop. Settling counts from the change of the raw demand, look-ahead included, for every map.",
    );
    for scenario in scenarios {
        let scores: Vec<&MapScore> = r.scores.iter().filter(|s| s.scenario == scenario).collect();
        section = section
            .heading(capital(scenario))
            .block(table("Torque: offsets are worst means of the last second of a point", &TORQUE, &scores))
            .block(table("Lambda: the spike is the largest distance from 1", &LAMBDA, &scores))
            .columns(bars(&scores));
        let mut runs = Vec::new();
        for s in &scores {
            let name = format!("{}, {scenario}", s.map);
            if let Some(reference) = r.records.iter().find(|r| r.name == name) {
                runs.push((s.map.as_str(), record(&v.folder, reference, dt)?));
            }
        }
        if let Some((_, first)) = runs.first() {
            section = section.block(outputs(scenario, first, &runs)?);
            if let Some(window) = zoom(first)? {
                section = section.columns(zoomed(&runs, window)?);
            }
            section = section
                .block(Details::new("Actuators of all maps").block(actuators(scenario, first, &runs)?));
        }
    }
    Ok(section.block(points(r)).text(format!(
        "Bed time of the static map: {:.0} s; of this comparison: {:.0} s.",
        summary.bed.static_map_s, summary.bed.map_comparison_s
    )))
}

fn capital(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |c| c.to_uppercase().chain(letters).collect())
}

/// A column: heading, unit, value.
type Number = (&'static str, &'static str, fn(&MapScore) -> Option<f64>);

const TORQUE: [Number; 6] = [
    ("RMS error", "Nm", |s| Some(s.torque_rms_nm)),
    ("Worst offset", "Nm", |s| Some(s.torque_offset_nm)),
    ("Worst settling", "s", |s| Some(s.torque_settling_s)),
    ("Mean settling", "s", |s| Some(s.torque_settling_mean_s)),
    ("Economy", "Nm/mg", |s| Some(s.economy_nm_mg)),
    ("Economy at equal lambda", "Nm/mg", |s| s.economy_equal_lambda_nm_mg),
];
const LAMBDA: [Number; 6] = [
    ("RMS error", "", |s| Some(s.lambda_rms)),
    ("Mean error", "", |s| Some(s.lambda_error_mean)),
    ("Worst offset", "", |s| Some(s.lambda_offset)),
    ("Worst settling", "s", |s| Some(s.lambda_settling_s)),
    ("Spike, lean", "", |s| Some(s.lambda_spike_lean)),
    ("Spike, rich", "", |s| Some(s.lambda_spike_rich)),
];

fn table(caption: &str, columns: &[Number], scores: &[&MapScore]) -> Table {
    let head = columns.iter().map(|(label, unit, _)| Column::number(*label, *unit).digits(3));
    let mut table = Table::new([Column::text("Map")].into_iter().chain(head).collect()).caption(caption);
    for s in scores {
        let numbers = columns.iter().map(|(_, _, value)| Cell::from(value(s)));
        let row: Vec<Cell> = [Cell::from(s.map.as_str())].into_iter().chain(numbers).collect();
        table = if s.map == DYNAMIC { table.stressed_row(row) } else { table.row(row) };
    }
    table
}

fn bars(scores: &[&MapScore]) -> Vec<dynocal_report::Block> {
    let names = || scores.iter().map(|s| s.map.as_str());
    let all = |f: fn(&MapScore) -> f64| scores.iter().map(|s| f(s)).collect::<Vec<f64>>();
    vec![
        Bars::new("Torque error against the raw demand", Axis::new("RMS", "Nm"), names())
            .series("torque", all(|s| s.torque_rms_nm))
            .into(),
        Bars::new("Lambda spike", Axis::new("Largest |lambda - 1|", ""), names())
            .series("lean", all(|s| s.lambda_spike_lean))
            .series("rich", all(|s| s.lambda_spike_rich))
            .into(),
        Bars::new("Settling time of torque", Axis::new("Time", "s"), names())
            .series("worst", all(|s| s.torque_settling_s))
            .series("mean", all(|s| s.torque_settling_mean_s))
            .into(),
    ]
}

fn outputs(scenario: &str, first: &Dataset, runs: &[(&str, Dataset)]) -> Result<TimePlot, ChainError> {
    let mut torque = Panel::new("Torque", "Nm");
    if let Ok(demand) = first.values("torque_demand") {
        torque = torque.series(Series::new("demand", demand.to_vec()).role(Role::Demand).held());
    }
    let mut lambda = Panel::new("Lambda", "");
    for (map, run) in runs {
        torque = torque.line(*map, run.values("torque")?.to_vec());
        lambda = lambda.line(*map, run.values("lambda")?.to_vec());
    }
    let speed = Panel::new("Speed", "rpm").line("speed", first.values("speed")?.to_vec());
    Ok(TimePlot::sampled(
        format!("{}: measured with every map", capital(scenario)),
        first.sample_time_s,
        first.len(),
    )
    .panel(torque)
    .panel(lambda)
    .panel(speed))
}

/// Seconds shown before and after a change of the demand.
const ZOOM_S: (f64, f64) = (0.3, 2.7);

/// Samples around the two largest changes of the demanded torque, up and down.
fn zoom(run: &Dataset) -> Result<Option<[usize; 2]>, ChainError> {
    let demand = run.values("torque_demand")?;
    let step = |t: &usize| demand[*t] - demand[*t - 1];
    let by = |a: &usize, b: &usize| step(a).total_cmp(&step(b)).then(b.cmp(a));
    let (up, down) = (
        (1..demand.len()).max_by(by),
        (1..demand.len()).max_by(|a, b| step(b).total_cmp(&step(a)).then(b.cmp(a))),
    );
    Ok(up.zip(down).map(|(u, d)| [u, d]))
}

/// Torque and lambda of all maps around two changes.
fn zoomed(runs: &[(&str, Dataset)], at: [usize; 2]) -> Result<Vec<dynocal_report::Block>, ChainError> {
    let mut blocks = Vec::new();
    for (switch, title) in at.into_iter().zip(["Largest step up", "Largest step down"]) {
        let Some((_, first)) = runs.first() else { continue };
        let dt = first.sample_time_s;
        let from = switch.saturating_sub((ZOOM_S.0 / dt) as usize);
        let to = (switch + (ZOOM_S.1 / dt) as usize).min(first.len());
        let time: Vec<f64> = (from..to).map(|t| dt * t as f64).collect();
        let demand = first.values("torque_demand")?[from..to].to_vec();
        let mut torque =
            Panel::new("Torque", "Nm").series(Series::new("demand", demand).role(Role::Demand).held());
        let mut lambda = Panel::new("Lambda", "");
        for (map, run) in runs {
            torque = torque.line(*map, run.values("torque")?[from..to].to_vec());
            lambda = lambda.line(*map, run.values("lambda")?[from..to].to_vec());
        }
        blocks.push(TimePlot::new(title, time).panel(torque).panel(lambda).into());
    }
    Ok(blocks)
}

fn actuators(scenario: &str, first: &Dataset, runs: &[(&str, Dataset)]) -> Result<TimePlot, ChainError> {
    let mut plot =
        TimePlot::sampled(format!("{}: actuators", capital(scenario)), first.sample_time_s, first.len());
    for (name, label, unit) in [
        ("inj", "Injected mass", "mg"),
        ("spark", "Spark advance", "deg BTDC"),
        ("throttle", "Throttle", "deg"),
    ] {
        let mut panel = Panel::new(label, unit);
        for (map, run) in runs {
            panel = panel.held(*map, run.values(name)?.to_vec());
        }
        plot = plot.panel(panel);
    }
    Ok(plot)
}

fn points(r: &ValidateResult) -> Details {
    let mut table = Table::new(vec![
        Column::number("Torque", "Nm"),
        Column::number("Speed", "rpm"),
        Column::number("INJ", "mg").digits(4),
        Column::number("Best spark", "deg BTDC").digits(4),
        Column::number("Throttle", "deg").digits(4),
        Column::number("Torque error", "Nm").digits(2),
        Column::number("Lambda error", "").digits(2),
    ])
    .caption("Points of the static map: best spark by a bracketing search at constant torque and lambda 1");
    for p in &r.static_map.points {
        let [inj, spark, throttle] = p.actuators;
        table = table.row([
            p.torque_nm.into(),
            p.speed_rpm.into(),
            inj.into(),
            spark.into(),
            throttle.into(),
            p.torque_error_nm.into(),
            Cell::from(p.lambda_error),
        ]);
    }
    Details::new(format!("Points of the static map ({})", r.static_map.points.len())).block(table)
}
