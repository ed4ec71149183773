//! From the document to the page: check, number the plots, fill the template.

use std::collections::BTreeMap;

use minijinja::syntax::SyntaxConfig;
use minijinja::value::{Serde, Value};
use minijinja::{Environment, context};
use serde::Serialize;

use crate::model::{Align, Block, Cell, Check, KeyValue, Report, Table};
use crate::numbers::{significant, trimmed};
use crate::plots::{Bars, HeatMap, TimePlot, XyPlot};
use crate::view::{self, PlotView};

const TEMPLATE: &str = include_str!("../assets/template.html");
const STYLE: &str = include_str!("../assets/report.css");
const SCRIPT: &str = include_str!("../assets/report.js");
const CHARTS: &str = include_str!("../assets/charts.js");
const UPLOT_STYLE: &str = include_str!("../assets/uplot/uPlot.min.css");
const UPLOT_SCRIPT: &str = include_str!("../assets/uplot/uPlot.iife.min.js");

/// Significant digits of numbers in tables and checks, unless the column says otherwise.
const TABLE_DIGITS: usize = 5;

/// Why a document cannot be shown.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// A line is not as long as its axis.
    #[error("plot `{plot}`, `{series}`: found {found} values, expected {expected}")]
    Length {
        /// Title of the plot.
        plot: String,
        /// Label of the line.
        series: String,
        /// Number of values.
        found: usize,
        /// Length of the axis.
        expected: usize,
    },
    /// A plot has nothing to show.
    #[error("plot `{plot}`: found no {what}, expected at least one")]
    Empty {
        /// Title of the plot.
        plot: String,
        /// What is missing.
        what: &'static str,
    },
    /// An axis does not increase strictly, or is not finite.
    #[error(
        "plot `{plot}`, axis `{axis}`: found {found} after {previous} at index {index}, expected a larger number"
    )]
    NotIncreasing {
        /// Title of the plot.
        plot: String,
        /// Label of the axis.
        axis: String,
        /// Index of the offending value.
        index: usize,
        /// The offending value.
        found: f64,
        /// The value before it.
        previous: f64,
    },
    /// A row has too few or too many cells.
    #[error("table `{table}`, row {row}: found {found} cells, expected {expected}")]
    RaggedTable {
        /// Caption of the table.
        table: String,
        /// Index of the row.
        row: usize,
        /// Number of cells.
        found: usize,
        /// Number of columns.
        expected: usize,
    },
    /// The data could not be written as JSON.
    #[error("report data: {0}")]
    Json(#[from] serde_json::Error),
    /// The template failed; a fault of this crate.
    #[error("report template: {0}")]
    Template(#[from] minijinja::Error),
}

/// Text for the page, escaped; what stands between two backticks is set as code, as on a terminal it is told by them.
fn words(text: &str) -> Value {
    let escaped = |text: &str| {
        text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
    };
    let parts: Vec<&str> = text.split('`').collect();
    let mut html = String::with_capacity(text.len() + 16);
    for (k, part) in parts.iter().enumerate() {
        // An odd backtick at the end opens nothing.
        let is_code = k % 2 == 1 && k + 1 < parts.len();
        match (is_code, k % 2) {
            (true, _) => html.push_str(&format!("<code>{}</code>", escaped(part))),
            (false, 1) => html.push_str(&format!("`{}", escaped(part))),
            _ => html.push_str(&escaped(part)),
        }
    }
    Value::from_safe_string(html)
}

/// One element of the flattened page; containers become a pair of marks, so that the template needs no recursion.
#[derive(Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
enum Item<'a> {
    Section { id: String, title: &'a str },
    SectionEnd,
    Heading { id: String, title: &'a str },
    Paragraph { text: &'a str },
    KeyValues { items: Vec<(&'a str, String, &'a str)> },
    Table { caption: &'a str, head: Vec<Head<'a>>, rows: Vec<Row> },
    Plot { id: String, class: &'static str, title: &'a str, caption: &'a str, note: String },
    Code { caption: &'a str, text: &'a str },
    Columns,
    ColumnsEnd,
    Details { summary: &'a str, open: bool },
    DetailsEnd,
}

#[derive(Serialize)]
struct Head<'a> {
    label: &'a str,
    unit: &'a str,
    right: bool,
}

#[derive(Serialize)]
struct Row {
    stressed: bool,
    cells: Vec<String>,
}

/// Entry of the table of contents.
#[derive(Serialize)]
struct Entry<'a> {
    id: String,
    title: &'a str,
    sub: bool,
}

/// A line of the checks table, as text.
#[derive(Serialize)]
struct CheckView<'a> {
    id: &'a str,
    what: &'a str,
    asked: String,
    measured: String,
    unit: &'a str,
    verdict: &'static str,
    note: &'a str,
}

/// The page while it grows.
#[derive(Default)]
struct Page<'a> {
    items: Vec<Item<'a>>,
    contents: Vec<Entry<'a>>,
    plots: Vec<String>,
    canvases: usize,
    anchors: BTreeMap<String, usize>,
}

/// Renders the document as one self-contained HTML page. Equal documents give equal bytes.
///
/// # Errors
/// Names the plot or table, what was found and what was expected: lines of another length than their axis, axes that
/// do not increase, plots without content, ragged tables. Non-finite values are not an error: they are gaps in plots
/// and are written as such in tables.
pub fn render(doc: &Report) -> Result<String, RenderError> {
    let mut page = Page::default();
    for section in &doc.sections {
        let id = page.anchor(if section.id.is_empty() { &section.title } else { &section.id });
        page.contents.push(Entry { id: id.clone(), title: &section.title, sub: false });
        page.items.push(Item::Section { id, title: &section.title });
        page.blocks(&section.blocks)?;
        page.items.push(Item::SectionEnd);
    }
    // `<` never stands in the data, so that no text can end the script element.
    let data = format!("[{}]", page.plots.join(",\n")).replace('<', "\\u003c");

    let mut environment = Environment::new();
    environment.set_syntax(SyntaxConfig::builder().trim_blocks(true).lstrip_blocks(true).build()?);
    environment.add_filter("words", words);
    environment.add_template("report.html", TEMPLATE)?; // the ending switches HTML escaping on
    let html = environment.get_template("report.html")?.render(context! {
        title => &doc.title,
        subtitle => &doc.subtitle,
        facts => Value::from(Serde(key_values(&doc.facts))),
        verdict => Value::from(Serde(&doc.verdict)),
        warnings => Value::from(Serde(&doc.warnings)),
        checks => Value::from(Serde(doc.checks.iter().map(CheckView::new).collect::<Vec<_>>())),
        holding => doc.checks.iter().filter(|c| c.holds == Some(true)).count(),
        failing => doc.checks.iter().filter(|c| c.holds == Some(false)).count(),
        contents => Value::from(Serde(&page.contents)),
        items => Value::from(Serde(&page.items)),
        canvases => page.canvases,
        data => data,
        style => STYLE,
        script => SCRIPT,
        charts => CHARTS,
        uplot_style => UPLOT_STYLE,
        uplot_script => UPLOT_SCRIPT,
    })?;
    Ok(html)
}

impl<'a> Page<'a> {
    fn blocks(&mut self, blocks: &'a [Block]) -> Result<(), RenderError> {
        for block in blocks {
            self.block(block)?;
        }
        Ok(())
    }

    fn block(&mut self, block: &'a Block) -> Result<(), RenderError> {
        match block {
            Block::Paragraph { text } => self.items.push(Item::Paragraph { text }),
            Block::Heading { text } => {
                let id = self.anchor(text);
                self.contents.push(Entry { id: id.clone(), title: text, sub: true });
                self.items.push(Item::Heading { id, title: text });
            }
            Block::KeyValues { items } => {
                self.items.push(Item::KeyValues { items: key_values(items) });
            }
            Block::Table(table) => self.items.push(table_view(table)?),
            Block::TimePlot(plot) => self.time_plot(plot)?,
            Block::XyPlot(plot) => {
                check_xy(plot)?;
                self.plot("xy", &plot.title, &plot.caption, 1, |id| view::xy(id, plot))?;
            }
            Block::HeatMap(map) => {
                check_heat(map)?;
                self.plot("heat", &map.title, &map.caption, 1, |id| view::heat(id, map))?;
            }
            Block::Bars(bars) => {
                check_bars(bars)?;
                self.plot("bars", &bars.title, &bars.caption, 1, |id| view::bars(id, bars))?;
            }
            Block::Code { caption, text } => self.items.push(Item::Code { caption, text }),
            Block::Columns { blocks } => {
                self.items.push(Item::Columns);
                self.blocks(blocks)?;
                self.items.push(Item::ColumnsEnd);
            }
            Block::Details(details) => {
                self.items.push(Item::Details { summary: &details.summary, open: details.open });
                self.blocks(&details.blocks)?;
                self.items.push(Item::DetailsEnd);
            }
        }
        Ok(())
    }

    fn time_plot(&mut self, plot: &'a TimePlot) -> Result<(), RenderError> {
        check_time(plot)?;
        let n = plot.time.len();
        let bin = view::bin_for(n);
        self.plot("time", &plot.title, &plot.caption, plot.panels.len(), |id| view::time(id, plot, bin))?;
        if let (Some(Item::Plot { note, .. }), true) = (self.items.last_mut(), bin > 0) {
            *note = format!("Drawn from {n} samples as smallest and largest value of every {bin}.");
        }
        Ok(())
    }

    /// Places a plot and adds its data; `canvases` is the number of canvases that the script must draw for it.
    fn plot(
        &mut self,
        class: &'static str,
        title: &'a str,
        caption: &'a str,
        canvases: usize,
        view: impl FnOnce(String) -> PlotView<'a>,
    ) -> Result<(), RenderError> {
        let id = format!("plot-{}", self.plots.len() + 1);
        self.plots.push(serde_json::to_string(&view(id.clone()))?);
        self.canvases += canvases;
        self.items.push(Item::Plot { id, class, title, caption, note: String::new() });
        Ok(())
    }

    /// A unique anchor made of the letters and digits of a title.
    fn anchor(&mut self, title: &str) -> String {
        let mut slug = String::new();
        for c in title.chars() {
            if c.is_ascii_alphanumeric() {
                slug.push(c.to_ascii_lowercase());
            } else if !slug.is_empty() && !slug.ends_with('-') {
                slug.push('-');
            }
        }
        let slug = slug.trim_end_matches('-');
        // The page's own ids are `top`, `warnings`, `checks`, `data` and `plot-N`: they are never given away.
        let reserved =
            matches!(slug, "" | "top" | "warnings" | "checks" | "data") || slug.starts_with("plot-");
        let slug = if reserved { format!("section-{slug}") } else { slug.to_owned() };
        let uses = self.anchors.entry(slug.clone()).or_insert(0);
        *uses += 1;
        if *uses == 1 { slug } else { format!("{slug}--{uses}") }
    }
}

impl<'a> CheckView<'a> {
    fn new(check: &'a Check) -> Self {
        CheckView {
            id: &check.id,
            what: &check.what,
            asked: if check.asked == Cell::Empty { String::new() } else { single(&check.asked) },
            measured: single(&check.measured),
            unit: &check.unit,
            verdict: match check.holds {
                Some(true) => "holds",
                Some(false) => "fails",
                None => "reported",
            },
            note: &check.note,
        }
    }
}

fn key_values(items: &[KeyValue]) -> Vec<(&str, String, &str)> {
    items.iter().map(|i| (i.key.as_str(), single(&i.value), shown_unit(&i.unit))).collect()
}

fn table_view(table: &Table) -> Result<Item<'_>, RenderError> {
    let expected = table.columns.len();
    let mut rows = Vec::with_capacity(table.rows.len());
    for (row, cells) in table.rows.iter().enumerate() {
        if cells.len() != expected {
            let (table, found) = (table.caption.clone(), cells.len());
            return Err(RenderError::RaggedTable { table, row, found, expected });
        }
        let cells = cells.iter().zip(&table.columns);
        let cells =
            cells.map(|(cell, column)| cell_text(cell, column.digits.unwrap_or(TABLE_DIGITS))).collect();
        rows.push(Row { stressed: table.stressed.contains(&row), cells });
    }
    let head = table.columns.iter();
    let head = head
        .map(|c| Head { label: &c.label, unit: shown_unit(&c.unit), right: c.align == Align::Right })
        .collect();
    Ok(Item::Table { caption: &table.caption, head, rows })
}

fn cell_text(cell: &Cell, digits: usize) -> String {
    match cell {
        Cell::Number(value) => significant(*value, digits),
        Cell::Text(text) => text.clone(),
        Cell::Empty => "–".to_owned(),
    }
}

/// A unit beside a number; `-` is none.
fn shown_unit(unit: &str) -> &str {
    if unit == "-" { "" } else { unit }
}

/// A cell outside a table.
fn single(cell: &Cell) -> String {
    match cell {
        Cell::Number(value) => trimmed(*value, TABLE_DIGITS),
        _ => cell_text(cell, TABLE_DIGITS),
    }
}

fn check_time(plot: &TimePlot) -> Result<(), RenderError> {
    some(&plot.title, "sample", plot.time.len())?;
    some(&plot.title, "panel", plot.panels.len())?;
    increasing(&plot.title, &plot.x.label, &plot.time)?;
    for panel in &plot.panels {
        for series in &panel.series {
            length(&plot.title, &series.label, series.values.len(), plot.time.len())?;
        }
    }
    Ok(())
}

fn check_xy(plot: &XyPlot) -> Result<(), RenderError> {
    some(&plot.title, "series", plot.series.len())?;
    plot.series.iter().try_for_each(|s| length(&plot.title, &s.label, s.y.len(), s.x.len()))
}

fn check_heat(map: &HeatMap) -> Result<(), RenderError> {
    some(&map.title, "column", map.x_values.len())?;
    some(&map.title, "row", map.y_values.len())?;
    increasing(&map.title, &map.x.label, &map.x_values)?;
    increasing(&map.title, &map.y.label, &map.y_values)?;
    length(&map.title, &map.z.label, map.z_values.len(), map.x_values.len() * map.y_values.len())?;
    map.overlays.iter().try_for_each(|o| length(&map.title, &o.label, o.y.len(), o.x.len()))
}

fn check_bars(bars: &Bars) -> Result<(), RenderError> {
    some(&bars.title, "category", bars.categories.len())?;
    some(&bars.title, "series", bars.series.len())?;
    bars.series.iter().try_for_each(|s| length(&bars.title, &s.label, s.values.len(), bars.categories.len()))
}

fn some(plot: &str, what: &'static str, found: usize) -> Result<(), RenderError> {
    if found > 0 { Ok(()) } else { Err(RenderError::Empty { plot: plot.to_owned(), what }) }
}

fn length(plot: &str, series: &str, found: usize, expected: usize) -> Result<(), RenderError> {
    if found == expected {
        return Ok(());
    }
    Err(RenderError::Length { plot: plot.to_owned(), series: series.to_owned(), found, expected })
}

fn increasing(plot: &str, axis: &str, values: &[f64]) -> Result<(), RenderError> {
    let mut previous = f64::NEG_INFINITY;
    for (index, &found) in values.iter().enumerate() {
        if !(found.is_finite() && found > previous) {
            let (plot, axis) = (plot.to_owned(), axis.to_owned());
            return Err(RenderError::NotIncreasing { plot, axis, index, found, previous });
        }
        previous = found;
    }
    Ok(())
}
