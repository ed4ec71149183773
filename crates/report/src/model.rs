//! The report document: what the caller fills.
//!
//! Everything here is plain data. Texts are plain text (they are escaped, never interpreted as HTML); a line break in
//! a paragraph stays a line break.

use serde::{Deserialize, Serialize};

use crate::plots::{Bars, HeatMap, TimePlot, XyPlot};

/// A whole report, in reading order: verdict, warnings, checks, then the sections.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Report {
    /// Main heading and title of the page.
    pub title: String,
    /// One line below the title.
    pub subtitle: String,
    /// Facts about the run shown in the page head (spec, seed, version, ...).
    pub facts: Vec<KeyValue>,
    /// What came out, against what, and what to do next: the first that is read, a paragraph each.
    pub verdict: Vec<String>,
    /// What the reader must know before trusting the rest.
    pub warnings: Vec<String>,
    /// Every number the run stands for, with what was asked.
    pub checks: Vec<Check>,
    /// The body.
    pub sections: Vec<Section>,
}

impl Report {
    /// An empty report with a title.
    pub fn new(title: impl Into<String>) -> Self {
        Report { title: title.into(), ..Report::default() }
    }
    /// Sets the line below the title.
    pub fn subtitle(mut self, text: impl Into<String>) -> Self {
        self.subtitle = text.into();
        self
    }
    /// Adds a fact to the page head.
    pub fn fact(mut self, key: impl Into<String>, value: impl Into<Cell>) -> Self {
        self.facts.push(KeyValue::new(key, value, ""));
        self
    }
    /// Adds a paragraph of the verdict.
    pub fn verdict(mut self, text: impl Into<String>) -> Self {
        self.verdict.push(text.into());
        self
    }
    /// Adds a warning.
    pub fn warning(mut self, text: impl Into<String>) -> Self {
        self.warnings.push(text.into());
        self
    }
    /// Adds a check.
    pub fn check(mut self, check: Check) -> Self {
        self.checks.push(check);
        self
    }
    /// Adds a section.
    pub fn section(mut self, section: Section) -> Self {
        self.sections.push(section);
        self
    }
}

/// One line of the checks table; the same fields as `checks` in `summary.json`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Check {
    /// Short stable name.
    pub id: String,
    /// What is checked, in words.
    pub what: String,
    /// The demand, as a number or as text such as `<= 1.5`.
    pub asked: Cell,
    /// The number of this run.
    pub measured: Cell,
    /// Unit of `asked` and `measured`; empty for none.
    pub unit: String,
    /// Whether the demand is met; `None` for a number that is reported without a demand.
    pub holds: Option<bool>,
    /// Remark, for instance the data the number comes from.
    pub note: String,
}

impl Check {
    /// A check that reports only, until [`Check::holds`] is called.
    pub fn new(id: impl Into<String>, what: impl Into<String>) -> Self {
        Check { id: id.into(), what: what.into(), ..Check::default() }
    }
    /// Sets the demand.
    pub fn asked(mut self, asked: impl Into<Cell>) -> Self {
        self.asked = asked.into();
        self
    }
    /// Sets the measured value.
    pub fn measured(mut self, measured: impl Into<Cell>) -> Self {
        self.measured = measured.into();
        self
    }
    /// Sets the unit.
    pub fn unit(mut self, unit: impl Into<String>) -> Self {
        self.unit = unit.into();
        self
    }
    /// Sets the verdict.
    pub fn holds(mut self, holds: bool) -> Self {
        self.holds = Some(holds);
        self
    }
    /// Sets the remark.
    pub fn note(mut self, note: impl Into<String>) -> Self {
        self.note = note.into();
        self
    }
}

/// A section with a heading that appears in the table of contents.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Section {
    /// Heading.
    pub title: String,
    /// Anchor; derived from the title when empty.
    pub id: String,
    /// Content in reading order.
    pub blocks: Vec<Block>,
}

impl Section {
    /// An empty section.
    pub fn new(title: impl Into<String>) -> Self {
        Section { title: title.into(), ..Section::default() }
    }
    /// Sets the anchor (letters, digits and `-` survive).
    pub fn id(mut self, id: impl Into<String>) -> Self {
        self.id = id.into();
        self
    }
    /// Adds a paragraph.
    pub fn text(self, text: impl Into<String>) -> Self {
        self.block(Block::Paragraph { text: text.into() })
    }
    /// Adds a subheading, which also appears in the table of contents.
    pub fn heading(self, text: impl Into<String>) -> Self {
        self.block(Block::Heading { text: text.into() })
    }
    /// Adds a list of key, value and unit.
    pub fn key_values(self, items: Vec<KeyValue>) -> Self {
        self.block(Block::KeyValues { items })
    }
    /// Adds preformatted text, such as a spec.
    pub fn code(self, caption: impl Into<String>, text: impl Into<String>) -> Self {
        self.block(Block::Code { caption: caption.into(), text: text.into() })
    }
    /// Adds blocks that stand side by side where the page is wide enough.
    pub fn columns(self, blocks: Vec<Block>) -> Self {
        self.block(Block::Columns { blocks })
    }
    /// Adds any block.
    pub fn block(mut self, block: impl Into<Block>) -> Self {
        self.blocks.push(block.into());
        self
    }
    /// Adds any block in place, for loops.
    pub fn push(&mut self, block: impl Into<Block>) {
        self.blocks.push(block.into());
    }
}

/// One element of a section.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Block {
    /// Running text.
    Paragraph {
        /// Plain text.
        text: String,
    },
    /// Subheading.
    Heading {
        /// Plain text.
        text: String,
    },
    /// Key, value, unit.
    KeyValues {
        /// The entries.
        items: Vec<KeyValue>,
    },
    /// Table with units in the head.
    Table(Table),
    /// Stacked panels over one time axis.
    TimePlot(TimePlot),
    /// Curves and points over a common x axis.
    XyPlot(XyPlot),
    /// Colour map over two axes, with optional contours.
    HeatMap(HeatMap),
    /// Comparison of a few numbers.
    Bars(Bars),
    /// Preformatted text.
    Code {
        /// Heading of the box; may be empty.
        caption: String,
        /// Text, kept as it is.
        text: String,
    },
    /// Blocks side by side.
    Columns {
        /// The blocks, left to right.
        blocks: Vec<Block>,
    },
    /// Blocks behind a line that opens on click.
    Details(Details),
}

/// Collapsible blocks.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Details {
    /// The visible line.
    pub summary: String,
    /// Whether it is open at first.
    pub open: bool,
    /// The content.
    pub blocks: Vec<Block>,
}

impl Details {
    /// Closed, with a visible line.
    pub fn new(summary: impl Into<String>) -> Self {
        Details { summary: summary.into(), ..Details::default() }
    }
    /// Adds a block.
    pub fn block(mut self, block: impl Into<Block>) -> Self {
        self.blocks.push(block.into());
        self
    }
}

/// A name with its value.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct KeyValue {
    /// Name.
    pub key: String,
    /// Value, already text or a number.
    pub value: Cell,
    /// Unit; empty for none.
    pub unit: String,
}

impl KeyValue {
    /// A name with its value and unit.
    pub fn new(key: impl Into<String>, value: impl Into<Cell>, unit: impl Into<String>) -> Self {
        KeyValue { key: key.into(), value: value.into(), unit: unit.into() }
    }
}

/// A table; numbers are aligned right and written with the digits of their column.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Table {
    /// Heading of the table; may be empty.
    pub caption: String,
    /// Columns, left to right.
    pub columns: Vec<Column>,
    /// Rows; each has as many cells as there are columns.
    pub rows: Vec<Vec<Cell>>,
    /// Rows to stress, by index.
    pub stressed: Vec<usize>,
}

impl Table {
    /// A table without rows.
    pub fn new(columns: Vec<Column>) -> Self {
        Table { columns, ..Table::default() }
    }
    /// Sets the heading.
    pub fn caption(mut self, caption: impl Into<String>) -> Self {
        self.caption = caption.into();
        self
    }
    /// Adds a row.
    pub fn row(mut self, cells: impl Into<Vec<Cell>>) -> Self {
        self.rows.push(cells.into());
        self
    }
    /// Adds a row that stands out, such as the winner.
    pub fn stressed_row(mut self, cells: impl Into<Vec<Cell>>) -> Self {
        self.stressed.push(self.rows.len());
        self.row(cells)
    }
}

/// Head of a column.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Column {
    /// Heading.
    pub label: String,
    /// Unit, shown below the heading; empty for none.
    pub unit: String,
    /// Alignment of the cells.
    pub align: Align,
    /// Significant digits of numbers in this column; 5 when not given.
    pub digits: Option<usize>,
}

impl Column {
    /// A column of words.
    pub fn text(label: impl Into<String>) -> Self {
        Column { label: label.into(), ..Column::default() }
    }
    /// A column of numbers.
    pub fn number(label: impl Into<String>, unit: impl Into<String>) -> Self {
        Column { label: label.into(), unit: unit.into(), align: Align::Right, digits: None }
    }
    /// Sets the significant digits.
    pub fn digits(mut self, digits: usize) -> Self {
        self.digits = Some(digits);
        self
    }
}

/// Alignment of a column.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Align {
    /// For words.
    #[default]
    Left,
    /// For numbers.
    Right,
}

/// Content of a table cell, or of a check. In JSON a number, a string, or null.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Cell {
    /// A number; non-finite ones are shown as such.
    Number(f64),
    /// Words.
    Text(String),
    /// Nothing, shown as a dash.
    #[default]
    Empty,
}

impl From<f64> for Cell {
    fn from(value: f64) -> Self {
        Cell::Number(value)
    }
}
impl From<usize> for Cell {
    fn from(value: usize) -> Self {
        Cell::Text(value.to_string())
    }
}
impl From<&str> for Cell {
    fn from(text: &str) -> Self {
        Cell::Text(text.to_owned())
    }
}
impl From<String> for Cell {
    fn from(text: String) -> Self {
        Cell::Text(text)
    }
}
impl<T: Into<Cell>> From<Option<T>> for Cell {
    fn from(value: Option<T>) -> Self {
        value.map_or(Cell::Empty, Into::into)
    }
}

macro_rules! block_from {
    ($($kind:ident),*) => {$(
        impl From<$kind> for Block {
            fn from(block: $kind) -> Self {
                Block::$kind(block)
            }
        }
    )*};
}
block_from!(Table, TimePlot, XyPlot, HeatMap, Bars, Details);
