//! The page of a fit.

use dynocal_report::{Axis, Block, Cell, Check, Column, Report, Section, Table, XyPlot, significant};

use super::{Compare, Compared, FitResult, Score};

/// The page: what was asked and what came out, the constants with their intervals, measured against simulated.
pub fn report(found: &FitResult) -> Report {
    let title = format!("Engine fitted to a measured map, from the set {}", found.set);
    let mut report = Report::new(title).subtitle(
        "Two thirds of the points are fitted, every third one judges. Each point is driven at its speed, charge and intake pressure and lambda.",
    );
    for warning in &found.warnings {
        report = report.warning(warning.as_str());
    }
    for s in &found.scores {
        report = report.check(check(s));
    }
    let cams = found.constants.iter().any(|c| c.key.starts_with("cams."));
    let mut assumed = Section::new("Assumed");
    for note in &found.notes {
        assumed = assumed.text(note.as_str());
    }
    if cams {
        assumed = assumed.text("Cam positions were not measured: the schedule is inferred from the air, and stands for whatever else moves the air over load and speed.");
    }
    report.section(constants(found)).section(scores(found)).section(plots(found)).section(assumed)
}

fn check(s: &Score) -> Check {
    let id = format!("fit-{}", s.quantity.replace(' ', "-"));
    Check::new(id, format!("Root mean square error of {} on {} points not fitted", s.quantity, s.points))
        .asked(format!("at most {}", s.asked))
        .measured(significant(s.judged, 3))
        .unit(s.unit)
        .holds(s.judged <= s.asked)
}

fn constants(found: &FitResult) -> Section {
    let head = vec![
        Column::text("Constant"),
        Column::text("What"),
        Column::number("Least", "").digits(3),
        Column::number("Greatest", "").digits(3),
        Column::number("Before", "").digits(4),
        Column::number("Fitted", "").digits(4),
        Column::number("95 % half width", "").digits(2),
        Column::text("Note"),
    ];
    let table = found.constants.iter().fold(Table::new(head), |t, c| {
        t.row(vec![
            Cell::from(c.key),
            c.what.into(),
            c.range.lower.into(),
            c.range.upper.into(),
            c.start.into(),
            c.value.into(),
            Cell::from(c.half_width),
            c.note.unwrap_or_default().into(),
        ])
    });
    let condition = found.condition.map_or_else(
        || "not all constants are determined".to_owned(),
        |c| {
            format!(
                "condition of the derivatives, each constant's column of unit length: {}",
                significant(c, 3)
            )
        },
    );
    let n = found.fitted_points;
    Section::new("Constants")
        .text(format!("From the derivatives at the end of the search, over the {n} points that were fitted; {condition}. Intervals hold for independent errors of equal weight; errors of the model are not independent, so that they are too narrow."))
        .block(table)
}

fn scores(found: &FitResult) -> Section {
    let head = vec![
        Column::text("Quantity"),
        Column::text("Unit"),
        Column::number("Asked", "").digits(3),
        Column::number("Before", "").digits(3),
        Column::number("Fitted points", "").digits(3),
        Column::number("Judged points", "").digits(3),
        Column::number("Mean error", "").digits(2),
        Column::number("Largest error", "").digits(3),
    ];
    let table = found.scores.iter().fold(Table::new(head), |t, s| {
        t.row(vec![
            Cell::from(s.quantity),
            s.unit.into(),
            s.asked.into(),
            s.before.into(),
            s.fitted.into(),
            s.judged.into(),
            s.bias.into(),
            s.worst.into(),
        ])
    });
    Section::new("Errors").text("Root mean squares.").block(table)
}

/// Name, unit, quantity, and its measured and simulated value at a point.
type Plotted = (&'static str, &'static str, Compared, fn(&Compare) -> Option<(f64, f64)>);

/// Simulated over measured.
fn plots(found: &FitResult) -> Section {
    let rows: [Plotted; 5] = [
        ("Torque", "Nm", Compared::Torque, |c| Some((c.measured.torque_nm?, c.answer.torque_nm))),
        ("Air", "g/s", Compared::Air, |c| Some((1e3 * c.measured.air_kg_s?, 1e3 * c.answer.air_kg_s))),
        ("Exhaust temperature", "K", Compared::ExhaustTemperature, |c| {
            Some((c.measured.exhaust_k?, c.answer.exhaust_k))
        }),
        ("Exhaust pressure", "kPa", Compared::ExhaustPressure, |c| {
            Some((1e-3 * c.measured.exhaust_pa?, 1e-3 * c.answer.exhaust_pa))
        }),
        ("Pressure behind the turbine", "kPa", Compared::SystemPressure, |c| {
            Some((1e-3 * c.measured.system_pa?, 1e-3 * c.answer.system_pa))
        }),
    ];
    let plot = |(name, unit, q, pair): &Plotted| -> Option<Block> {
        let of = |judged: bool| -> (Vec<f64>, Vec<f64>) {
            found.points.iter().filter(|c| c.judged == judged).filter_map(pair).unzip()
        };
        let ((x0, y0), (x1, y1)) = (of(false), of(true));
        let all = || x0.iter().chain(&x1).copied();
        let (low, high) = (all().fold(f64::INFINITY, f64::min), all().fold(f64::NEG_INFINITY, f64::max));
        if !(low < high) {
            return None;
        }
        let (_, asked, error) = q.asked();
        let plot = XyPlot::new(*name, Axis::new("measured", *unit), Axis::new("simulated", *unit))
            .line("equal", vec![low, high], vec![low, high])
            .points("fitted", x0, y0)
            .points("judged", x1, y1)
            .caption(format!("Asked: {asked} {error} root mean square."));
        Some(plot.into())
    };
    rows.iter().filter_map(plot).fold(Section::new("Points"), Section::block)
}
