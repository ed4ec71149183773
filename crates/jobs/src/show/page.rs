//! The page of a measurement file: a table of each group and plots of its first channels.

use dynocal_report::{Axis, Cell, Column, Panel, Report, Section, Series, Table, TimePlot, significant};

use super::{ChannelSummary, Contents, GroupSummary};

/// Channels of a group that are drawn.
const DRAWN: usize = 12;

/// A small page with the channels and their traces.
pub fn page(contents: &Contents) -> Report {
    let mut report = Report::new(contents.file.clone()).subtitle(format!("measurement, {}", contents.format));
    for note in &contents.notes {
        report = report.warning(note.clone());
    }
    for (k, g) in contents.groups.iter().enumerate() {
        report = report.section(section(k, g));
    }
    report
}

fn section(k: usize, g: &GroupSummary) -> Section {
    let title = if g.name.is_empty() { format!("Group {}", k + 1) } else { g.name.clone() };
    let mut section = Section::new(title).text(about(g)).block(table(g));
    // Words have no trace; neither has a channel whose file ended early.
    let whole = |c: &&ChannelSummary| !c.trace.is_empty() && c.trace.len() == g.trace_time.len();
    for c in g.channels.iter().filter(whole).take(DRAWN) {
        section = section.block(plot(g, c));
    }
    let count = g.channels.iter().filter(whole).count();
    if count > DRAWN {
        section = section.text(format!("The first {DRAWN} of {count} channels are drawn."));
    }
    section
}

/// Rows, span and rate of a group in a sentence.
pub fn about(g: &GroupSummary) -> String {
    let mut out = format!("{} rows", g.rows);
    match (g.span_s, g.interval_s) {
        (Some(span), Some(dt)) => {
            out.push_str(&format!(
                ", {} s to {} s by `{}`",
                trimmed(span.lower, 10),
                trimmed(span.upper, 10),
                g.time
            ));
            out.push_str(&format!(
                ", every {} s on average{}",
                trimmed(dt, 6),
                if g.stamps_not_increasing > 0 { " where stamps go forward" } else { "" }
            ));
        }
        _ if g.time.is_empty() => out.push_str(", no time channel"),
        _ if g.rows > 0 => out.push_str(&format!(", time `{}`, which holds no numbers", g.time)),
        _ => out.push_str(&format!(", time `{}`", g.time)),
    }
    if let Some(gap) = g.longest_interval_s {
        out.push_str(&format!(", longest interval {} s", trimmed(gap, 6)));
    }
    if g.stamps_not_increasing > 0 {
        out.push_str(&format!(
            ", {} stamps are not after the one before (experiments one after another, or repeats)",
            g.stamps_not_increasing
        ));
    }
    out
}

/// Characters of a name or of states that a table shows.
const SHOWN: usize = 40;

/// The unit of a channel, or its states where it holds words.
pub fn unit_or_states(c: &ChannelSummary) -> String {
    match &c.words {
        Some((n, first)) => on_a_line(&format!(
            "{}{n} no numbers: {first}",
            if c.unit.is_empty() { String::new() } else { format!("{}; ", c.unit) }
        )),
        None if c.states.is_empty() => c.unit.clone(),
        None => on_a_line(&c.states.join(", ")),
    }
}

/// Text of a file in one line of a table: what is no print becomes its escape, the end of long text three points.
pub fn on_a_line(text: &str) -> String {
    let print = |c: char| match c {
        '\u{fffd}' => vec![c],
        c if c.is_control() => c.escape_default().collect(),
        c => vec![c],
    };
    let all: Vec<char> = text.chars().take(SHOWN + 1).flat_map(print).collect();
    if all.len() <= SHOWN {
        return all.into_iter().collect();
    }
    all[..SHOWN - 3].iter().chain(&['.', '.', '.']).collect()
}

/// Without the zeros that stand for digits.
fn trimmed(x: f64, digits: usize) -> String {
    let number = significant(x, digits);
    if number.contains('.') && !number.contains('e') {
        number.trim_end_matches('0').trim_end_matches('.').to_string()
    } else {
        number
    }
}

fn table(g: &GroupSummary) -> Table {
    let mut table = Table::new(vec![
        Column::text("channel"),
        Column::text("unit"),
        Column::text("rows"),
        Column::text("gaps"),
        Column::number("min", "").digits(6),
        Column::number("max", "").digits(6),
        Column::number("mean", "").digits(6),
    ]);
    for c in &g.channels {
        let number = |x: Option<f64>| Cell::from(x.unwrap_or(f64::NAN));
        let cells: Vec<Cell> = vec![
            c.name.as_str().into(),
            unit_or_states(c).as_str().into(),
            c.rows.to_string().as_str().into(),
            c.gaps.to_string().as_str().into(),
            number(c.min),
            number(c.max),
            number(c.mean),
        ];
        table = table.row(cells);
    }
    table
}

fn plot(g: &GroupSummary, c: &ChannelSummary) -> TimePlot {
    let line = |of: fn(&super::Extremes) -> f64| c.trace.iter().map(of).collect::<Vec<f64>>();
    let panel = Panel::new(c.name.clone(), c.unit.clone());
    let mut plot = TimePlot::new(c.name.clone(), g.trace_time.clone());
    if g.trace_in_rows {
        plot.x = Axis::new("Row", "");
    }
    if g.stretch == 1 {
        return plot.panel(panel.series(Series::new(c.name.clone(), line(|e| e.max))));
    }
    let of = format!("of {} rows", g.stretch);
    plot.panel(
        panel
            .series(Series::new(format!("least {of}"), line(|e| e.min)))
            .series(Series::new(format!("greatest {of}"), line(|e| e.max))),
    )
}
