//! Records of the excitation and the models identified from them.

use super::super::context::Context;
use super::super::error::ChainError;
use super::super::excite_step::ExciteResult;
use super::super::models::{Candidate, FreeRunScore, ModelsResult, OutputModels};
use super::super::run::ChainResult;
use super::super::verdict::word;
use super::parts::{percent, plot, record, unit};
use dynocal_files::run_folder::Done;
use dynocal_ident::validate::Seen;
use dynocal_report::{Axis, Bars, Cell, Column, Details, Section, Table};

/// Step 1: every record, with the free runs of the models of step 2.
pub(super) fn records(
    ctx: &Context,
    excite: &Done<ExciteResult>,
    r: &ChainResult,
) -> Result<Section, ChainError> {
    let models = r.identify.as_ref().map_or(Vec::new(), |m| m.result.chosen());
    let mut section = Section::new("Excitation").id("excite").text(
        "Closed loop on the demanded outputs: amplitude-modulated steps of demands and of the inputs that no loop drives, displaced in time, over sweeps of the given channels. The models of the next step run free over them.",
    );
    section = section.heading("Validation records");
    for (k, v) in excite.result.validation.iter().enumerate() {
        let chooses = k == 0 && excite.result.validation.len() > 1;
        let use_of = if chooses { "chose between the candidates" } else { "unseen" };
        let title = format!("{}: measured over simulated, {use_of}", v.name);
        section = section.block(plot(ctx, title, &record(ctx, &excite.folder, v)?, &models)?);
    }
    let mut seen = Details::new("Identification records");
    for i in &excite.result.identification {
        let title = format!("{}: measured over simulated, identification", i.name);
        seen = seen.block(plot(ctx, title, &record(ctx, &excite.folder, i)?, &models)?);
    }
    seen.open = true;
    Ok(section.block(seen))
}

/// Step 2: all candidates.
pub(super) fn fits(m: &ModelsResult) -> Section {
    let mut section = Section::new("Models")
        .id("models")
        .text("Fit numbers of free runs: the model gets inputs only. The candidate that is best on the record that chooses goes on (stressed rows); the unseen records chose nothing.");
    for output in &m.outputs {
        section = section.block(table(output, &format!("Candidates for {}", output.output)));
    }
    section = section.columns(m.outputs.iter().map(|o| bars(o).into()).collect());
    for output in &m.outputs {
        section = section.block(terms(output, output.best()));
    }
    section
}

/// Which records a number is over.
#[derive(Clone, Copy)]
enum Which {
    Identification,
    Choosing,
    Unseen,
}

fn of(c: &Candidate, which: Which) -> impl Iterator<Item = &FreeRunScore> {
    c.scores.iter().filter(move |s| match which {
        Which::Identification => s.data == Seen::Identification,
        Which::Choosing => s.chooses,
        Which::Unseen => s.data == Seen::Unseen && !s.chooses,
    })
}

/// Candidates of one output, errors first.
pub(super) fn table(m: &OutputModels, caption: &str) -> Table {
    let u = unit(&m.unit);
    let mut table = Table::new(vec![
        Column::text("Model"),
        Column::number("RMSE unseen", u).digits(3),
        Column::number("95 % unseen", u).digits(3),
        Column::number("R2 unseen", "%").digits(4),
        Column::number("R2 choosing", "%").digits(4),
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
        number(root_mean_square(c, Which::Unseen)),
        number(worst_p95(c, Which::Unseen)),
        number(percent(mean_r2(c, Which::Unseen))),
        number(percent(mean_r2(c, Which::Choosing))),
        number(root_mean_square(c, Which::Identification)),
        number(percent(mean_r2(c, Which::Identification))),
        c.model.parameters.len().into(),
        c.evaluations.into(),
        word(c.status).into(),
    ]
}

/// Root of the mean squared RMSE over the records (records are equally long).
fn root_mean_square(c: &Candidate, which: Which) -> Option<f64> {
    let squares: Option<Vec<f64>> = of(c, which).map(|s| s.rmse.map(|v| v * v)).collect();
    squares.filter(|v| !v.is_empty()).map(|v| (v.iter().sum::<f64>() / v.len() as f64).sqrt())
}

fn worst_p95(c: &Candidate, which: Which) -> Option<f64> {
    let all: Option<Vec<f64>> = of(c, which).map(|s| s.p95).collect();
    all.and_then(|v| v.into_iter().reduce(f64::max))
}

fn mean_r2(c: &Candidate, which: Which) -> Option<f64> {
    let all: Option<Vec<f64>> = of(c, which).map(|s| s.r2).collect();
    all.filter(|v| !v.is_empty()).map(|v| v.iter().sum::<f64>() / v.len() as f64)
}

fn bars(m: &OutputModels) -> Bars {
    let value = |c: &Candidate, which| root_mean_square(c, which).unwrap_or(f64::NAN);
    let all = |which| m.candidates.iter().map(|c| value(c, which)).collect::<Vec<f64>>();
    Bars::new(
        format!("Free-run error of {}", m.output),
        Axis::new("RMSE", unit(&m.unit)),
        m.candidates.iter().map(|c| c.name.as_str()),
    )
    .series("unseen", all(Which::Unseen))
    .series("identification", all(Which::Identification))
}

/// Terms and parameters of one model, collapsed.
pub(super) fn terms(m: &OutputModels, c: &Candidate) -> Details {
    let mut table = Table::new(vec![
        Column::text("Parameter"),
        Column::number("Value", "").digits(6),
        Column::number("Standard error", "").digits(2),
    ])
    .caption(format!("Model of {}(t), in its prepared units", c.model.output.name));
    for p in &c.model.parameters {
        table = table.row([p.name.as_str().into(), p.value.into(), Cell::from(p.std_error)]);
    }
    let mut details = Details::new(format!(
        "The chosen {} model ({}): {} parameters",
        m.output,
        c.name,
        c.model.parameters.len()
    ));
    for d in &c.model.derived {
        details = details.block(dynocal_report::Block::Paragraph { text: d.to_string() });
    }
    details
        .block(dynocal_report::Block::Paragraph {
            text: "The errors of a model that is simpler than the plant are not white: read standard errors as a lower bound.".into(),
        })
        .block(table)
}
