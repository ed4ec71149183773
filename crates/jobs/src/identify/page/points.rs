//! What the points of a steady table say of its models: scores, candidates, effects, sections with bands, residuals.

use dynocal_ident::model::response::score::{Intersection, ScorePage, Unseen};
use dynocal_report::{Axis, Bars, Block, Cell, Column, Section, Table, XyPlot};

use crate::identify::points::PointsPage;
use crate::identify::result::{Identified, Modelled};

/// The sections of all models that have points.
pub(super) fn sections(found: &Identified) -> Vec<Section> {
    let with = || found.models.iter().filter_map(|m| Some((m, m.points.as_ref()?)));
    if with().next().is_none() {
        return Vec::new();
    }
    let mut scores = Section::new("Points that had no part in the fit").text(
        "Left out: each point predicted from all others, structure and hyperparameters kept. Folds: everything is learnt again \
         without each of them. A 95 % band should hold 95 % of the points, and the squared errors should be as large as \
         predicted (ratio 1; more: the model is too sure of itself).",
    );
    let mut effects = Section::new("What the models do").text(
        "Sections through the median of the points with the 95 % band of the response (not of a measurement). Effects are shares \
         of the variance of the response over the box of the points: of the input alone (main), and with all its interactions \
         (total), from 2048 draws: good to some two percent.",
    );
    let mut residuals = Section::new("Left-out errors").text(
        "Measured against predicted from the other points, and the errors over every input: a bend is a missing term, a funnel is \
         noise that varies.",
    );
    for (m, p) in with() {
        scores.push(table(m, &p.scores));
        if let Some(choice) = candidates(m, p) {
            scores =
                scores.text(p.choice.as_ref().map(|c| c.words.clone()).unwrap_or_default()).block(choice);
        }
        effects = effects.heading(m.target.as_str()).block(bars(m, &p.scores));
        for pair in p.scores.intersections.chunks(2) {
            effects = effects.columns(pair.iter().map(|s| section(m, s).into()).collect());
        }
        residuals = residuals.heading(m.target.as_str());
        for pair in clouds(m, &p.scores).chunks(2) {
            residuals = residuals.columns(pair.to_vec());
        }
    }
    vec![scores, effects, residuals]
}

fn table(m: &Modelled, s: &ScorePage) -> Table {
    let mut table = Table::new(vec![
        Column::text("Points"),
        Column::number("Number", "-"),
        Column::number("RMSE", m.unit.as_str()),
        Column::number("RMSE over the range", "%"),
        Column::number("In the 95 % band", "%"),
        Column::number("Ratio", "-"),
    ])
    .caption(format!("{}: {}", m.target, s.what));
    let rows = [("left out", Some(&s.left_out)), ("folds", s.folds.as_ref()), ("unseen", s.unseen.as_ref())];
    for (name, u) in rows.into_iter().filter_map(|(name, u)| Some((name, u?))) {
        table = table.row(row(name, u));
    }
    table
}

fn row(name: &str, u: &Unseen) -> Vec<Cell> {
    vec![
        name.into(),
        u.points.into(),
        u.rmse.into(),
        (100.0 * u.of_range).into(),
        (100.0 * u.coverage).into(),
        u.variance_ratio.into(),
    ]
}

fn candidates(m: &Modelled, p: &PointsPage) -> Option<Table> {
    let choice = p.choice.as_ref()?;
    let mut table = Table::new(vec![
        Column::text("Candidate"),
        Column::number("RMSE in the folds", m.unit.as_str()),
        Column::number("Standard error", m.unit.as_str()),
        Column::text(""),
    ]);
    for (k, c) in choice.candidates.iter().enumerate() {
        let remark = match (&c.failed, k == choice.chosen) {
            (Some(why), _) => why.as_str(),
            (None, true) => "taken",
            (None, false) => "",
        };
        let known = |v: f64| v.is_finite().then_some(v);
        let cells: [Cell; 4] =
            [c.name.as_str().into(), known(c.rmse).into(), known(c.standard_error).into(), remark.into()];
        table = if k == choice.chosen { table.stressed_row(cells) } else { table.row(cells) };
    }
    Some(table)
}

fn bars(m: &Modelled, s: &ScorePage) -> Bars {
    let names: Vec<&str> = s.sensitivity.iter().map(|i| i.input.as_str()).collect();
    // An estimated share may fall a little below zero.
    let share = |v: f64| 100.0 * v.max(0.0);
    Bars::new(format!("Effects on {}", m.target), Axis::new("Share of the variance", "%"), names)
        .series("main", s.sensitivity.iter().map(|i| share(i.main)).collect::<Vec<f64>>())
        .series("total", s.sensitivity.iter().map(|i| share(i.total)).collect::<Vec<f64>>())
}

fn section(m: &Modelled, s: &Intersection) -> XyPlot {
    let bound =
        |sign: f64| -> Vec<f64> { s.mean.iter().zip(&s.half_width).map(|(y, w)| y + sign * w).collect() };
    XyPlot::new(
        format!("{} over {}", m.target, s.input),
        Axis::new(s.input.as_str(), ""),
        Axis::new(m.target.as_str(), m.unit.as_str()),
    )
    .band("95 % band", s.x.clone(), bound(-1.0), bound(1.0))
    .line(m.target.as_str(), s.x.clone(), s.mean.clone())
}

fn clouds(m: &Modelled, s: &ScorePage) -> Vec<Block> {
    let axis = |what: &str| Axis::new(format!("{} {what}", m.target), m.unit.as_str());
    let ends = |v: &[f64]| {
        v.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), y| (low.min(*y), high.max(*y)))
    };
    let (low, high) = ends(&s.measured);
    let agreement = XyPlot::new(format!("{}, left out", m.target), axis("measured"), axis("predicted"))
        .points("points", s.measured.clone(), s.predicted.clone())
        .line("agreement", vec![low, high], vec![low, high]);
    let over = s.inputs.iter().map(|c| {
        XyPlot::new(
            format!("Errors over {}", c.input),
            Axis::new(c.input.as_str(), ""),
            Axis::new(format!("Error of {}", m.target), m.unit.as_str()),
        )
        .points("points", c.x.clone(), s.residuals.clone())
        .into()
    });
    [agreement.into()].into_iter().chain(over).collect()
}
