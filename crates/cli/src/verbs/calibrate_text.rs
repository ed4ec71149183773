//! The results of a calibration in a few lines for the terminal.

use dynocal_jobs::calibrate::run::ChainResult;

use crate::table;
use dynocal_jobs::calibrate::verdict::stages;

/// Tables of what was found, as far as the run went.
pub(crate) fn results(r: &ChainResult) -> String {
    let parts = [models(r), passes(r), maps(r)];
    let mut text = parts.iter().filter(|p| !p.is_empty()).cloned().collect::<Vec<_>>().join("\n");
    text.push_str(&format!("\nbed time of identification, design and optimisation: {:.0} s\n", r.bed_s()));
    text
}

fn models(r: &ChainResult) -> String {
    let rows: Vec<Vec<String>> = stages(r)
        .iter()
        .map(|(step, m)| {
            let best = m.best();
            let r2 = best.unseen_r2.map_or("diverged".into(), |v| format!("{:.2}", 100.0 * v));
            vec![step.clone(), m.output.clone(), best.name.clone(), best.model.theta.len().to_string(), r2]
        })
        .collect();
    if rows.is_empty() {
        return String::new();
    }
    table::render(&["step", "output", "model", "parameters", "unseen free-run R2 [%]"], &rows, &[3, 4])
}

fn passes(r: &ChainResult) -> String {
    let percent = |ratio: f64| format!("{:+.2}", 100.0 * (ratio - 1.0));
    let mut rows: Vec<Vec<String>> = r
        .optimise
        .iter()
        .flat_map(|d| &d.result.passes)
        .map(|p| vec![format!("pass {}", p.pass), percent(p.promised_ratio), percent(p.measured_ratio)])
        .collect();
    if rows.is_empty() {
        return String::new();
    }
    if let Some(v) = &r.validate {
        rows.push(vec!["best spark".into(), "-".into(), percent(v.result.best_spark.ratio)]);
    }
    table::render(&["fuel against the start record", "promised [%]", "measured [%]"], &rows, &[1, 2])
}

fn maps(r: &ChainResult) -> String {
    let Some(v) = &r.validate else { return String::new() };
    let rows: Vec<Vec<String>> = v
        .result
        .scores
        .iter()
        .map(|s| {
            vec![
                s.scenario.clone(),
                s.map.clone(),
                format!("{:.2}", s.torque_rms_nm),
                format!("{:.2}", s.torque_offset_nm),
                format!("{:.4}", s.lambda_offset),
                format!("{:.3}", s.lambda_spike),
                format!("{:.2}", s.torque_settling_s),
            ]
        })
        .collect();
    let head = [
        "scenario",
        "map",
        "torque RMS [Nm]",
        "offset [Nm]",
        "lambda offset",
        "lambda spike",
        "settling [s]",
    ];
    table::render(&head, &rows, &[2, 3, 4, 5, 6])
}
