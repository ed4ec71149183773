//! Step 6: the delivered map against its rivals.

use dynocal_calib::chain::context::ChainError;
use dynocal_calib::chain::validate_step::{DYNAMIC, ValidateResult};
use dynocal_calib::validate::MapScore;
use dynocal_deliver::{Axis, Bars, Cell, Column, Details, Panel, Role, Section, Series, Table, TimePlot};
use dynocal_files::run_folder::Done;
use dynocal_ident::data::Dataset;

use super::parts::record;
use crate::campaign::summary::Summary;

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
        section = section.heading(capital(scenario)).block(table(scenario, &scores)).columns(bars(&scores));
        let mut runs = Vec::new();
        for s in &scores {
            let name = format!("{}, {scenario}", s.map);
            if let Some(reference) = r.records.iter().find(|r| r.name == name) {
                runs.push((s.map.as_str(), record(&v.folder, reference, dt)?));
            }
        }
        if let Some((_, first)) = runs.first() {
            section = section.block(outputs(scenario, first, &runs)?);
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

fn table(scenario: &str, scores: &[&MapScore]) -> Table {
    let mut table = Table::new(vec![
        Column::text("Map"),
        Column::number("Torque RMS", "Nm").digits(3),
        Column::number("Lambda RMS", "").digits(3),
        Column::number("Torque offset", "Nm").digits(3),
        Column::number("Lambda offset", "").digits(3),
        Column::number("Torque settling", "s").digits(3),
        Column::number("mean", "s").digits(3),
        Column::number("Lambda settling", "s").digits(3),
        Column::number("Lambda spike", "").digits(3),
        Column::number("Economy", "Nm/mg").digits(4),
        Column::number("at equal lambda", "Nm/mg").digits(4),
    ])
    .caption(format!(
        "{}: offsets are worst values of the last second, the spike is the largest |lambda - 1|",
        capital(scenario)
    ));
    for s in scores {
        let row = vec![
            s.map.as_str().into(),
            s.torque_rms_nm.into(),
            s.lambda_rms.into(),
            s.torque_offset_nm.into(),
            s.lambda_offset.into(),
            s.torque_settling_s.into(),
            s.torque_settling_mean_s.into(),
            s.lambda_settling_s.into(),
            s.lambda_spike.into(),
            s.economy_nm_mg.into(),
            Cell::from(s.economy_equal_lambda_nm_mg),
        ];
        table = if s.map == DYNAMIC { table.stressed_row(row) } else { table.row(row) };
    }
    table
}

fn bars(scores: &[&MapScore]) -> Vec<dynocal_deliver::Block> {
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

fn actuators(scenario: &str, first: &Dataset, runs: &[(&str, Dataset)]) -> Result<TimePlot, ChainError> {
    let mut plot =
        TimePlot::sampled(format!("{}: actuators", capital(scenario)), first.sample_time_s, first.len());
    for (name, label, unit) in
        [("inj", "Injected mass", "mg"), ("spark", "Spark advance", "°CA"), ("throttle", "Throttle", "°")]
    {
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
        Column::number("Best spark", "°CA").digits(4),
        Column::number("Throttle", "°").digits(4),
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
