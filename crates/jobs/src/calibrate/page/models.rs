//! Records of the excitation and the models identified from them.

use crate::calibrate::context::ChainError;
use crate::calibrate::excite_step::ExciteResult;
use crate::calibrate::models::ModelsResult;
use crate::calibrate::models::{Candidate, OutputModels};
use crate::calibrate::run::ChainResult;
use dynocal_calib::engine_model::Transform;
use dynocal_files::run_folder::Done;
use dynocal_ident::validate::Seen;
use dynocal_report::{Axis, Bars, Cell, Column, Details, Section, Table};

use super::parts::{Simulated, percent, plot, record, unit};
use crate::calibrate::verdict::word;

/// Step 1: every record, with the free runs of the models of step 2.
pub(super) fn records(excite: &Done<ExciteResult>, r: &ChainResult, dt: f64) -> Result<Section, ChainError> {
    let simulated = r
        .identify
        .as_ref()
        .map(|m| Simulated { torque: &m.result.torque.best().model, lambda: &m.result.lambda.best().model });
    let mut section = Section::new("Excitation").id("excite").text(
        "Closed loop on torque and lambda: amplitude-modulated steps of demanded torque, demanded lambda and spark, displaced in time, over speed sweeps. The models of the next step run free from the first measured samples.",
    );
    section = section.heading("Unseen records");
    for v in &excite.result.validation {
        let title = format!("{}: measured over simulated, unseen", v.name);
        section = section.block(plot(title, &record(&excite.folder, v, dt)?, simulated)?);
    }
    let mut seen = Details::new("Identification records");
    for i in &excite.result.identification {
        let title = format!("{}: measured over simulated, identification", i.name);
        seen = seen.block(plot(title, &record(&excite.folder, i, dt)?, simulated)?);
    }
    seen.open = true;
    Ok(section.block(seen))
}

/// Step 2: all candidates.
pub(super) fn fits(m: &ModelsResult) -> Section {
    let mut section = Section::new("Models")
        .id("models")
        .text("Fit numbers of free runs: the model gets inputs only, after the first measured samples. The best mean R2 on unseen records goes on (stressed rows).");
    for output in [&m.torque, &m.lambda] {
        section = section.block(table(output, &format!("Candidates for {}", output.output)));
    }
    section = section.columns(vec![bars(&m.torque).into(), bars(&m.lambda).into()]);
    for output in [&m.torque, &m.lambda] {
        section = section.block(terms(output, output.best()));
    }
    section
}

/// Candidates of one output, errors first.
pub(super) fn table(m: &OutputModels, caption: &str) -> Table {
    let u = unit(&m.unit);
    let mut table = Table::new(vec![
        Column::text("Model"),
        Column::number("RMSE unseen", u).digits(3),
        Column::number("95 % unseen", u).digits(3),
        Column::number("R2 unseen", "%").digits(4),
        Column::number("RMSE ident.", u).digits(3),
        Column::number("R2 ident.", "%").digits(4),
        Column::number("Terms", ""),
        Column::number("Eval.", ""),
        Column::text("Ended"),
    ])
    .caption(caption);
    for (k, c) in m.candidates.iter().enumerate() {
        let row = row(c);
        table = if k == m.chosen { table.stressed_row(row) } else { table.row(row) };
    }
    table
}

fn row(c: &Candidate) -> Vec<Cell> {
    let number = |v: Option<f64>| v.map_or(Cell::from("diverged"), Cell::from);
    vec![
        c.name.as_str().into(),
        number(root_mean_square(c, Seen::Unseen)),
        number(worst_p95(c, Seen::Unseen)),
        number(percent(mean_r2(c, Seen::Unseen))),
        number(root_mean_square(c, Seen::Identification)),
        number(percent(mean_r2(c, Seen::Identification))),
        c.model.theta.len().into(),
        c.evaluations.into(),
        word(c.status).into(),
    ]
}

fn of(c: &Candidate, data: Seen) -> impl Iterator<Item = &crate::calibrate::models::FreeRunScore> {
    c.scores.iter().filter(move |s| s.data == data)
}

/// Root of the mean squared RMSE over the records of `data` (records are equally long).
fn root_mean_square(c: &Candidate, data: Seen) -> Option<f64> {
    let squares: Option<Vec<f64>> = of(c, data).map(|s| s.rmse.map(|v| v * v)).collect();
    squares.filter(|v| !v.is_empty()).map(|v| (v.iter().sum::<f64>() / v.len() as f64).sqrt())
}

fn worst_p95(c: &Candidate, data: Seen) -> Option<f64> {
    let all: Option<Vec<f64>> = of(c, data).map(|s| s.p95).collect();
    all.and_then(|v| v.into_iter().reduce(f64::max))
}

fn mean_r2(c: &Candidate, data: Seen) -> Option<f64> {
    let all: Option<Vec<f64>> = of(c, data).map(|s| s.r2).collect();
    all.filter(|v| !v.is_empty()).map(|v| v.iter().sum::<f64>() / v.len() as f64)
}

fn bars(m: &OutputModels) -> Bars {
    let value = |c: &Candidate, data| root_mean_square(c, data).unwrap_or(f64::NAN);
    let all = |data| m.candidates.iter().map(|c| value(c, data)).collect::<Vec<f64>>();
    Bars::new(
        format!("Free-run error of {}", m.output),
        Axis::new("RMSE", unit(&m.unit)),
        m.candidates.iter().map(|c| c.name.as_str()),
    )
    .series("unseen", all(Seen::Unseen))
    .series("identification", all(Seen::Identification))
}

/// Terms and parameters of one model, collapsed.
pub(super) fn terms(m: &OutputModels, c: &Candidate) -> Details {
    let left = match c.model.transform {
        Transform::Identity => format!("{}(t)", m.output),
        Transform::Reciprocal => format!("phi(t) = 1/{}(t)", m.output),
    };
    let mut table = Table::new(vec![
        Column::text("Term"),
        Column::number("Parameter", "").digits(6),
        Column::number("Standard error", "").digits(2),
    ])
    .caption(format!("{left} is the sum of these terms"));
    for (k, (term, theta)) in c.model.structure.regressor_texts().iter().zip(&c.model.theta).enumerate() {
        let error = c.std_errors.get(k).copied().flatten();
        table = table.row([term.as_str().into(), (*theta).into(), Cell::from(error)]);
    }
    Details::new(format!("Terms of the chosen {} model ({}): {} parameters", m.output, c.name, c.model.theta.len()))
        .block(dynocal_report::Block::Paragraph {
            text: "Standard errors hold for white equation errors only; the errors of a model that is simpler than the engine are not white, so read them as a lower bound.".into(),
        })
        .block(table)
}
