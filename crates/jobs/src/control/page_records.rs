//! What records show on the page: responses without a model, their coherence, margins with and without a model.

use dynocal_report::{Axis, Cell, Column, Section, Table, XyPlot};

use super::decouple::Decoupled;
use super::result::Controlled;
use super::spec::Decoupler;

pub(super) fn section(found: &Controlled) -> Section {
    let mut section = Section::new("What the records show")
        .text(format!(
            "Spectra of the records, without a model, up to {:.4} Hz: 0.4 of the sampling frequency. Frequencies beyond half of it, such as the 500 Hz of the thesis, do not exist in a record. Coherence is the share of an output's power that follows from the inputs (the demands, in closed loop); measured margins are those of one channel with the other loops open, their intervals hold nine tenths of draws. Frequencies at which the deviation is more than a third of the response, or whose neighbours are mostly such, are left out of them: an empty cell is a margin that lies beyond.",
            found.measured.iter().map(|m| m.highest_hz).fold(f64::INFINITY, f64::min)
        ))
        .block(table(found));
    if found.measured.iter().any(|m| !m.distortion.iter().all(Option::is_none)) {
        section = section.block(distortion(found));
    }
    for k in 0..found.loops.len() {
        section = section.block(sizes(found, k)).block(coherence(found, k));
    }
    section
}

fn table(found: &Controlled) -> Table {
    let head = vec![
        Column::text("Record"),
        Column::text("Loop"),
        Column::number("Segments", ""),
        Column::text("Orders of A and B"),
        Column::number("Free run on the half that chose them", "%").digits(4),
        Column::number("Model off by at most", "std").digits(3),
        Column::number("Gain margin, measured", "").digits(4),
        Column::text("interval"),
        Column::number("Phase margin, measured", "deg").digits(4),
        Column::text("interval"),
    ];
    let interval = |v: Option<(f64, f64)>| {
        let text = |v: f64| dynocal_report::significant(v, 4);
        v.map_or("-".to_string(), |(a, b)| format!("{} to {}", text(a), text(b)))
    };
    let mut table = Table::new(head);
    for m in &found.measured {
        for (k, l) in found.loops.iter().enumerate() {
            let ((a, b), r2) = m.models[k];
            let own = &m.margins[k];
            table = table.row(vec![
                Cell::from(m.point.as_str()),
                l.output.as_str().into(),
                Cell::from(m.segments as f64),
                format!("{a}, {b}").as_str().into(),
                r2.into(),
                Cell::from(m.distance[k]),
                Cell::from(own.found.gain_up),
                interval(own.gain_up).as_str().into(),
                Cell::from(own.found.phase_deg),
                interval(own.phase_deg).as_str().into(),
            ]);
        }
    }
    table
}

/// What multisines show that is not linear.
fn distortion(found: &Controlled) -> Table {
    let head = vec![
        Column::text("Set point"),
        Column::text("Loop"),
        Column::text("Odd distortion over the excited lines"),
        Column::text("Even distortion"),
    ];
    let level = |v: Option<f64>| v.map_or("not above the noise".to_string(), |v| format!("{v:.1} dB"));
    let mut table = Table::new(head);
    for m in &found.measured {
        for (l, d) in found.loops.iter().zip(&m.distortion) {
            let Some(d) = d else { continue };
            table = table.row(vec![
                Cell::from(m.point.as_str()),
                format!("{} by {}", l.output, l.input).as_str().into(),
                level(d.odd_db).as_str().into(),
                level(d.even_db).as_str().into(),
            ]);
        }
    }
    table
}

/// What a decoupler leaves.
pub(super) fn decoupler(found: &Controlled, d: &Decoupled) -> Section {
    let head = vec![
        Column::text("Set point"),
        Column::number("Other outputs at rest, without", "% of the own").digits(3),
        Column::number("with it", "% of the own").digits(3),
    ];
    let table = found.points.iter().zip(&d.left).fold(Table::new(head), |t, (p, (without, with))| {
        t.row(vec![Cell::from(p.as_str()), (100.0 * without).into(), (100.0 * with).into()])
    });
    let kind = match d.kind {
        Decoupler::Static => {
            "Gains between the controllers and the inputs leave each output its own demand at rest"
                .to_string()
        }
        Decoupler::Dynamic => format!(
            "Filters of {} samples between the controllers and the inputs keep the other outputs still after a step of a demand, as far as zeros and delays of the plant let them",
            d.filters.iter().map(Vec::len).max().unwrap_or(0)
        ),
    };
    Section::new("The decoupler")
        .text(format!("{kind}. It is made for the nominal plant of {}, and all margins are those of the plant with it: of each loop at the outputs of the plant, disk margins of inputs at the inputs of the plant itself. Its coefficients are in decoupler.csv; controller.json has loops that each move one input and is not written.", d.point))
        .block(table)
}

fn log_hz(frequency_hz: &[f64]) -> Vec<f64> {
    frequency_hz.iter().map(|f| f.log10()).collect()
}

fn sizes(found: &Controlled, k: usize) -> XyPlot {
    let l = &found.loops[k];
    let title = format!("Measured size of {} by {}", l.output, l.input);
    let mut plot = XyPlot::new(title, Axis::new("log10 of the frequency in Hz", ""), Axis::new("size", "dB"));
    for (m, r) in found.measured.iter().zip(&found.picture.measured) {
        let db: Vec<f64> = (0..r.frequency_hz.len()).map(|f| 20.0 * r.at(f, k, k).norm().log10()).collect();
        plot = plot.points(m.point.as_str(), log_hz(&r.frequency_hz), db);
    }
    for (name, b) in found.points.iter().zip(&found.picture.loops[k].bode) {
        let hz: Vec<f64> = b.w_rad_s.iter().map(|w| w / std::f64::consts::TAU).collect();
        let first =
            found.picture.measured.first().and_then(|r| r.frequency_hz.first()).copied().unwrap_or(0.0);
        let from = hz.partition_point(|f| *f < first);
        plot = plot.line(format!("model of {name}"), log_hz(&hz[from..]), b.size_db[from..].to_vec());
    }
    plot
}

fn coherence(found: &Controlled, k: usize) -> XyPlot {
    let l = &found.loops[k];
    let title = format!("Coherence of {}", l.output);
    let axes = (Axis::new("log10 of the frequency in Hz", ""), Axis::new("coherence", ""));
    found.measured.iter().zip(&found.picture.measured).fold(
        XyPlot::new(title, axes.0, axes.1),
        |plot, (m, r)| {
            let y = (0..r.frequency_hz.len()).map(|f| r.coherence_at(f, k)).collect::<Vec<f64>>();
            plot.line(m.point.as_str(), log_hz(&r.frequency_hz), y)
        },
    )
}
