//! The results of a calibration in a few lines for the terminal.

use dynocal_jobs::calibrate::run::ChainResult;

use crate::table;
use dynocal_jobs::calibrate::verdict::stages;

/// Tables of what was found, as far as the run went.
pub(crate) fn results(r: &ChainResult) -> String {
    let parts = [models(r), passes(r), maps(r)];
    let mut text = parts.iter().filter(|p| !p.is_empty()).cloned().collect::<Vec<_>>().join("\n");
    let gains = match r.loops_bed_s() {
        s if s > 0.0 => format!(", {s:.0} s of it for gains, which a static map needs as well"),
        _ => String::new(),
    };
    let of_fuel = match r.fuelling_bed_s() {
        s if s > 0.0 => format!(", {s:.0} s of it for fuel by measured states"),
        _ => String::new(),
    };
    text.push_str(&format!(
        "\nbed time of gains, identification, design, optimisation and points at rest: {:.0} s{gains}{of_fuel}\n",
        r.bed_s()
    ));
    text
}

fn models(r: &ChainResult) -> String {
    let mut rows: Vec<Vec<String>> = Vec::new();
    for (step, m) in stages(r) {
        for o in &m.outputs {
            let best = o.best();
            let r2 = best.unseen_r2.map_or("none".into(), |v| format!("{:.2}", 100.0 * v));
            let size = best.model.parameters.len().to_string();
            rows.push(vec![step.clone(), o.output.clone(), best.name.clone(), size, r2]);
        }
    }
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
    if let Some(fixed) = r.validate.as_ref().and_then(|v| v.result.static_on_record.as_ref()) {
        rows.push(vec!["free inputs of the static map".into(), "-".into(), percent(fixed.ratio)]);
    }
    if let Some(c) = r.validate.as_ref().and_then(|v| v.result.causality.as_ref()) {
        let policy = c.policy.map_or("-".into(), percent);
        rows.push(vec!["free inputs of a causal policy, full form".into(), "-".into(), policy]);
        rows.push(vec!["free inputs of the delivered map".into(), "-".into(), percent(c.delivered)]);
    }
    table::render(&["objective against the start record", "promised [%]", "on the plant [%]"], &rows, &[1, 2])
}

fn maps(r: &ChainResult) -> String {
    let Some(v) = &r.validate else { return String::new() };
    let mut rows = Vec::new();
    for s in &v.result.scores {
        for d in &s.demands {
            rows.push(vec![
                s.scenario.clone(),
                s.map.clone(),
                d.output.clone(),
                format!("{:.4}", d.rms),
                format!("{:.4}", d.offset),
                format!("{:.4}", d.integral_s),
                format!("{:.4}", d.spike()),
                format!("{:.2}", d.settling_s),
            ]);
        }
    }
    let head = [
        "scenario",
        "map",
        "demand",
        "RMS",
        "worst offset",
        "integral per step [s]",
        "spike",
        "settling [s]",
    ];
    table::render(&head, &rows, &[3, 4, 5, 6, 7])
}
