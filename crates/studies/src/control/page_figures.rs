//! Figures 7.22 to 7.30 on the page, and the tests for control.

use dynocal_report::{Axis, Cell, Column, Panel, Section, Table, TimePlot, XyPlot};

use super::bed::SAMPLE_S;
use super::cycles::CycleCase;
use super::figures::{Figures, channel_name};
use super::runs::{HOLD, Steps};
use super::worth::{TESTS, WorthCase};

pub(super) fn section(engine: &str, f: &Figures) -> Section {
    let mut section = Section::new(format!("{engine}: the figures of section 7.7"))
        .text(format!(
            "Figure 7.22: responses from the demands behind the map, from spectra of the record up to {:.1} Hz, 0.4 of the sampling frequency; the 500 Hz of the thesis are past half of its own. {}",
            f.response.frequency_hz.last().copied().unwrap_or(0.0),
            distortion(f)
        ))
        .block(responses(f, true))
        .block(responses(f, false))
        .block(coherence(f));
    section = section
        .block(steps("Figure 7.24: torque under the loops, mean of the steps", &f.torque))
        .block(steps("Figure 7.24: lambda under the loops, mean of the steps", &f.lambda))
        .block(table(&f.torque.iter().chain(&f.lambda).collect::<Vec<_>>(), &[]));
    section = section
        .block(steps("Figure 7.26: torque held by an estimate of it", &f.estimate.steps))
        .block(estimates(f))
        .block(refined(f))
        .block(horizon(f));
    for l in &f.late {
        let mut shown = l.steps.clone();
        // The undelayed loop first, for comparison.
        shown.insert(0, Steps { name: "undelayed".into(), ..f.lambda[1].clone() });
        section = section
            .block(steps(&format!("Figures 7.29 and 7.30: lambda {} samples late", l.samples), &shown))
            .block(table(&l.steps.iter().collect::<Vec<_>>(), &l.apart));
    }
    section
}

fn distortion(f: &Figures) -> String {
    let one = |(k, d): (usize, &[Option<f64>; 2])| {
        let level = |v: Option<f64>| v.map_or("not above the noise".to_string(), |v| format!("{v:.1} dB"));
        format!("{}: odd distortion {}, even {}", channel_name(k, k), level(d[0]), level(d[1]))
    };
    let all: Vec<String> = f.distortion_db.iter().enumerate().map(one).collect();
    format!("Odd multisines show what is not linear, over the excited lines: {}.", all.join("; "))
}

fn responses(f: &Figures, size: bool) -> XyPlot {
    let r = &f.response;
    let y = if size { Axis::new("size", "dB") } else { Axis::new("phase", "deg") };
    let title = if size { "Figure 7.22: size" } else { "Figure 7.22: phase" };
    let x: Vec<f64> = r.frequency_hz.iter().map(|v| v.log10()).collect();
    let mut plot = XyPlot::new(title, Axis::new("log10 of the frequency in Hz", ""), y);
    for o in 0..2 {
        for i in 0..2 {
            // Phases of what is mostly noise say nothing.
            let value = |k: usize| {
                let g = r.at(k, o, i);
                let clear = g.norm() > 2.0 * r.std_at(k, o, i);
                match (clear, size) {
                    (false, _) => f64::NAN,
                    (true, true) => 20.0 * g.norm().log10(),
                    (true, false) => g.arg().to_degrees(),
                }
            };
            let y: Vec<f64> = (0..x.len()).map(value).collect();
            plot = plot.line(channel_name(o, i), x.clone(), y);
        }
    }
    plot.caption("Drawn where the response is more than two of its standard deviations.")
}

fn coherence(f: &Figures) -> XyPlot {
    let r = &f.response;
    let x: Vec<f64> = r.frequency_hz.iter().map(|v| v.log10()).collect();
    let axes = (Axis::new("log10 of the frequency in Hz", ""), Axis::new("coherence with both demands", ""));
    super::OUTPUTS.iter().enumerate().fold(XyPlot::new("Coherence", axes.0, axes.1), |plot, (o, name)| {
        plot.line(*name, x.clone(), (0..x.len()).map(|k| r.coherence_at(k, o)).collect::<Vec<f64>>())
    })
}

fn steps(title: &str, all: &[Steps]) -> TimePlot {
    let panel = all.iter().fold(Panel::new("response", "share of the step").level("demand", 1.0), |p, s| {
        // A loop that runs away would hide the others.
        p.line(s.name.as_str(), s.response.iter().map(|v| v.clamp(-1.0, 3.0)).collect::<Vec<f64>>())
    });
    TimePlot::sampled(title, SAMPLE_S, HOLD).panel(panel).caption("Values beyond -1 and 3 are drawn there.")
}

fn table(all: &[&Steps], apart: &[f64]) -> Table {
    let head = vec![
        Column::text("Loop"),
        Column::number("Settles within 5 %", "s").digits(3),
        Column::number("Overshoot", "%").digits(3),
        Column::number("Left at the end", "").digits(3),
        Column::number("From the undelayed loop", "%").digits(4),
    ];
    all.iter().enumerate().fold(Table::new(head), |t, (k, s)| {
        t.row(vec![
            Cell::from(s.name.as_str()),
            Cell::from(s.settling_s),
            (100.0 * s.overshoot).into(),
            s.offset.into(),
            Cell::from(apart.get(k).map(|a| 100.0 * a)),
        ])
    })
}

fn estimates(f: &Figures) -> Table {
    let head = vec![
        Column::text("What holds torque"),
        Column::number("Free run, unseen", "%").digits(4),
        Column::number("mean squared error", "Nm2").digits(4),
        Column::number("over 10 to 90 Nm", "%").digits(4),
        Column::number("mean squared error", "Nm2").digits(4),
        Column::number("Left at the end of steps", "Nm").digits(3),
        Column::number("after a cold start, first part", "Nm").digits(3),
        Column::number("last part", "Nm").digits(3),
    ];
    let e = &f.estimate;
    e.steps.iter().enumerate().fold(Table::new(head), |t, (k, s)| {
        let own = k.checked_sub(1);
        let drift = |d: Option<&(f64, [f64; 2])>| Cell::from(own.and_then(|o| d.map(|d| d.1[o])));
        t.row(vec![
            Cell::from(s.name.as_str()),
            Cell::from(own.map(|o| e.fits[o].0)),
            Cell::from(own.map(|o| e.fits[o].1)),
            Cell::from(own.map(|o| e.wide[o].0)),
            Cell::from(own.map(|o| e.wide[o].1)),
            s.offset.into(),
            drift(e.drift.first()),
            drift(e.drift.last()),
        ])
    })
}

/// What could be had of the same model.
fn horizon(f: &Figures) -> Table {
    let head = vec![
        Column::text("Both demands step at random"),
        Column::number("Torque off, mean", "Nm").digits(4),
        Column::number("Lambda off, mean", "").digits(4),
    ];
    f.horizon.kept.iter().fold(Table::new(head), |t, k| {
        t.row(vec![Cell::from(k.name.as_str()), k.off[0].into(), k.off[1].into()])
    })
}

/// (7.34): round by round.
fn refined(f: &Figures) -> Table {
    let head = vec![
        Column::text("Map"),
        Column::number("Feedback adds to torque", "Nm").digits(3),
        Column::number("to lambda", "").digits(3),
        Column::number("Map alone: torque off", "%").digits(3),
        Column::number("lambda off", "%").digits(3),
    ];
    f.refined.iter().enumerate().fold(Table::new(head), |t, (k, r)| {
        let name = if k == 0 { "inverted steady gains".to_string() } else { format!("made again, {k}") };
        t.row(vec![
            Cell::from(name.as_str()),
            r.added[0].into(),
            r.added[1].into(),
            r.off_pct[0].into(),
            r.off_pct[1].into(),
        ])
    })
}

pub(super) fn worth(all: &[WorthCase]) -> Section {
    let mut head = vec![Column::number("Seed", "")];
    head.extend(TESTS.iter().map(|t| Column::number(*t, "").digits(4)));
    let table = all.iter().fold(Table::new(head), |t, c| {
        let mut row = vec![Cell::from(c.seed as f64)];
        row.extend(c.losses.iter().map(|l| Cell::from(*l)));
        t.row(row)
    });
    Section::new("Which test gives the safest controller")
        .text("A linear plant, tests of equal length, 40 estimates from each with the same noise, a PI that is best for each estimate: the mean of what it costs on the plant beyond the best PI. The design for the controller makes the expected loss small to second order, with its exact gradient; all designs know the plant.")
        .block(table)
}

pub(super) fn drives(all: &[CycleCase]) -> Section {
    let head = vec![
        Column::text("Cycle"),
        Column::text("Engine"),
        Column::text("Fuel by"),
        Column::number("Fuel", "g").digits(5),
        Column::number("Lambda within 1 %", "% of the fuelled time").digits(4),
        Column::number("Lambda off", "%, mean").digits(3),
        Column::number("Torque off", "Nm").digits(3),
        Column::number("Behind the catalyst beyond 1 %", "% of the fuelled time").digits(3),
        Column::number("Break-throughs", ""),
        Column::number("CO", "g/km").digits(3),
        Column::number("HC", "g/km").digits(3),
        Column::number("NO", "g/km").digits(3),
        Column::number("Outside of the cycle's band", "steps"),
    ];
    let mut table = Table::new(head);
    for c in all {
        for d in &c.drives {
            let mut row = vec![
                Cell::from(c.cycle.as_str()),
                c.driven_engine.as_str().into(),
                d.name.as_str().into(),
                d.fuel_g.into(),
                (100.0 * d.within).into(),
                (100.0 * d.off).into(),
                d.torque_nm.into(),
                (100.0 * d.broken).into(),
                Cell::from(f64::from(d.breaks)),
            ];
            row.extend(d.tailpipe_g_km.map(Cell::from));
            row.push(Cell::from(d.outside as f64));
            table = table.row(row);
        }
    }
    let found = all.first().map_or([f64::NAN; 3], |c| c.found_s);
    Section::new("Model in the loop")
        .text(format!("A car with a driver follows the cycle. Maps, the identified model and what was tuned are those of the first engine; the others are like it, not equal. Line searches on a record found an extrapolation of {} s for the ECU and closed loops of {} s about it and of {} s about the dynamic map. Throttle and spark are those of the static map for all. Without feedback neither lambda nor torque is trimmed; with feedback torque has the same integral trim everywhere. The PI of the static map and all predictors have the gains of SIMC for a lag of 0.1 s, the PI for a usual transport, the predictors for 0.08 s and with a transport that goes by the measured air where air is measured, else by the air that their own fuel burns. Every loop holds still while its sensor shows gas of a fuel cut. Behind the catalyst carbon monoxide and hydrocarbons pass while lambda there is below 0.99, nitric oxide while it is above 1.01, else what the brick's temperature leaves; the catalyst starts cold, the engine warm.", found[0], found[1], found[2]))
        .block(table)
}
