//! What the design is worth, and how it was found.

use crate::design::result::{Bound, Designed, MedianRange};
use dynocal_report::{Axis, Cell, Column, Section, Table, XyPlot};

/// Efficiencies first, criterion values after them.
pub(super) fn section(found: &Designed) -> Section {
    let spread = |v: MedianRange| {
        let median = Some(v.median).filter(|v| v.is_finite());
        [Cell::from(median), format!("{:.1} to {:.1}", v.least, v.greatest).into()]
    };
    let mut rivals = Table::new(vec![
        Column::text("Model"),
        Column::text("Signal"),
        Column::number("D-efficiency", "%").digits(3),
        Column::text("least to greatest"),
        Column::number("I-efficiency", "%").digits(3),
        Column::text("least to greatest"),
        Column::number("Bed time for the same I", "s").digits(3),
        Column::number("Drawn anew", "%").digits(3),
    ])
    .caption("Random signals within the same limits; the design is 100 %");
    for e in &found.efficiencies {
        let [d, d_range] = spread(e.d_percent);
        let [i, i_range] = spread(e.i_percent);
        rivals = rivals.row(vec![
            e.model.as_str().into(),
            format!("{} ({} of them)", e.rival, e.signals).into(),
            d,
            d_range,
            i,
            i_range,
            Cell::from(Some(e.same_error_samples * found.sample_time_s).filter(|v| v.is_finite())),
            Cell::from(Some(e.drawn_anew_percent).filter(|v| v.is_finite())),
        ]);
    }
    let mut criteria = Table::new(vec![
        Column::text("Model"),
        Column::text("Criterion"),
        Column::number("Weight", ""),
        Column::number("Value", "").digits(7),
    ])
    .caption("Criteria at the design (smaller is better)");
    for c in &found.criteria {
        criteria = criteria.row(vec![
            c.model.as_str().into(),
            c.criterion.as_str().into(),
            c.weight.into(),
            c.value.into(),
        ]);
    }
    let section = Section::new("What the design is worth")
        .text(
            "D: with an efficiency of 50 % a signal has to be twice as long for the same volume of the confidence \
             ellipsoid of the parameters. I: the same for the mean variance of the predictions over the objective signal. \
             The bed time is what the best of the signals needs for the mean variance of the design if it goes on as it \
             began. Where an output passes its limits, blocks of a signal are drawn anew until all predictions keep them; the \
             share of its values that were drawn anew stands in the last column.",
        )
        .block(rivals)
        .text(format!("Objective signal: {}.", found.objective))
        .block(criteria);
    match &found.certificate {
        Some(bound) => section.text(certificate(bound)),
        None => section,
    }
}

fn certificate(found: &Bound) -> String {
    match (found.bound, found.efficiency_percent) {
        (Some(bound), Some(percent)) => format!(
            "Certificate: no record within the amplitude limits has a J_D below {bound:.2} (equivalence theorem); the \
             design reaches a D-efficiency of {percent:.1} % of that bound at least. The bound leaves out rates, holds and \
             regions, and no record need reach it."
        ),
        _ => format!(
            "No certificate of optimality: {}.",
            found.none_because.as_deref().unwrap_or("none is known")
        ),
    }
}

/// Convergence of the best start.
pub(super) fn search(found: &Designed) -> Section {
    let at = |f: &dyn Fn(&dynocal_numerics::status::Iterate) -> f64| -> Vec<f64> {
        found.history.iter().map(f).collect()
    };
    let plot = XyPlot::new(
        "Convergence of the best start",
        Axis::new("Evaluations", ""),
        Axis::new("Weighted criterion", ""),
    )
    .line("best so far", at(&|h| h.evaluations as f64), at(&|h| h.objective))
    .caption(format!(
        "From {:.6} at the start to {:.6}; {} evaluations in all",
        found.start_value, found.value, found.evaluations
    ));
    Section::new("Search").block(plot)
}
