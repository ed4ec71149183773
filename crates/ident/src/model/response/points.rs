//! Steady points: a table without time. Rows are operating points, columns are named inputs and one output.

use dynocal_numerics::linalg::{axpy, dot};
use serde::{Deserialize, Serialize};

use super::LeftOut;
use super::scaling::{Scaling, mean_std};
use crate::data::Dataset;

/// Steady points of one output: `x` is n x d row-major, `y` has n entries.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Points {
    /// Names of the inputs (d).
    pub inputs: Vec<String>,
    /// Name of the output.
    pub output: String,
    /// Inputs, n x d row-major.
    pub x: Vec<f64>,
    /// Output (n).
    pub y: Vec<f64>,
}

/// Points that no response model can be learnt from.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PointsError {
    /// A channel that the table does not have.
    #[error(transparent)]
    Data(#[from] crate::data::DataError),
    /// Table and names do not fit.
    #[error("{output}: {found} input values for {points} points, expected {expected} ({inputs} inputs each)")]
    Shape {
        /// Output.
        output: String,
        /// Values found.
        found: usize,
        /// Points.
        points: usize,
        /// Values expected.
        expected: usize,
        /// Inputs.
        inputs: usize,
    },
    /// A value is not finite.
    #[error("{channel}: point {row} (counted from 1) is {found}, expected a finite number")]
    NotFinite {
        /// Channel.
        channel: String,
        /// Row, one-based.
        row: usize,
        /// The value.
        found: f64,
    },
    /// An input does not move.
    #[error(
        "input `{channel}` is {value} at all {points} points: nothing can be learnt about it; leave it out"
    )]
    Constant {
        /// Channel.
        channel: String,
        /// Its value.
        value: f64,
        /// Points.
        points: usize,
    },
    /// The output does not move.
    #[error("output `{channel}` is {value} at all {points} points: there is nothing to learn")]
    ConstantOutput {
        /// Channel.
        channel: String,
        /// Its value.
        value: f64,
        /// Points.
        points: usize,
    },
    /// Squares of the deviations from the mean are no numbers.
    #[error(
        "`{channel}` spreads by {found:e} (standard deviation): its squares are too small or too large for a number; give it in another unit"
    )]
    Spread {
        /// Channel.
        channel: String,
        /// Standard deviation.
        found: f64,
    },
    /// An input follows from others.
    #[error(
        "input `{channel}` follows from the other inputs ({others}) at all {points} points, as a sum of multiples of them: what each does cannot be told; leave one out"
    )]
    Dependent {
        /// Input.
        channel: String,
        /// Those that it follows from.
        others: String,
        /// Points.
        points: usize,
    },
    /// Too few points.
    #[error("{output}: {}, expected at least {expected} for {} and {what}", counted(*found, "point"), counted(*inputs, "input"))]
    TooFew {
        /// Output.
        output: String,
        /// Points found.
        found: usize,
        /// Points needed.
        expected: usize,
        /// Inputs.
        inputs: usize,
        /// Model.
        what: String,
    },
}

/// Points that share all their inputs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Replicates {
    /// Rows (from 0) of each group of two or more points with equal inputs.
    pub groups: Vec<Vec<usize>>,
    /// Rows whose inputs and output both equal those of an earlier row: copies, not repeated measurements.
    pub copies: Vec<usize>,
}

impl Points {
    /// `inputs` and `output` of a table.
    ///
    /// # Errors
    /// [`PointsError`]: unknown channels, channels of different length, values that are not finite.
    pub fn of_table(table: &Dataset, inputs: &[String], output: &str) -> Result<Self, PointsError> {
        let columns = inputs.iter().map(|name| table.channel(name)).collect::<Result<Vec<_>, _>>()?;
        let y = table.channel(output)?.values.clone();
        let mut x = Vec::with_capacity(y.len() * columns.len());
        for row in 0..y.len() {
            x.extend(columns.iter().map(|c| c.values.get(row).copied().unwrap_or(f64::NAN)));
        }
        let points = Self { inputs: inputs.to_vec(), output: output.into(), x, y };
        points.check_finite()?;
        Ok(points)
    }

    /// Number of points n.
    pub fn len(&self) -> usize {
        self.y.len()
    }

    /// Whether there is no point.
    pub fn is_empty(&self) -> bool {
        self.y.is_empty()
    }

    /// Number of inputs d.
    pub fn dim(&self) -> usize {
        self.inputs.len()
    }

    /// Inputs of point i (d).
    pub fn row(&self, i: usize) -> &[f64] {
        &self.x[i * self.dim()..(i + 1) * self.dim()]
    }

    /// Column of input j (n).
    pub fn column(&self, j: usize) -> impl Iterator<Item = f64> + Clone + '_ {
        self.x.iter().skip(j).step_by(self.dim().max(1)).copied()
    }

    /// The points of some rows, in the order given.
    pub fn rows(&self, rows: &[usize]) -> Self {
        let x = rows.iter().flat_map(|i| self.row(*i).iter().copied()).collect();
        Self {
            inputs: self.inputs.clone(),
            output: self.output.clone(),
            x,
            y: rows.iter().map(|i| self.y[*i]).collect(),
        }
    }

    /// Largest minus smallest output.
    pub fn output_range(&self) -> f64 {
        let (low, high) = range(self.y.iter().copied());
        high - low
    }

    /// Checks shape, finite values, moving channels and a least number of points for `what`.
    ///
    /// # Errors
    /// [`PointsError`], which names the channel and the row.
    pub fn check(&self, least: usize, what: &str) -> Result<(), PointsError> {
        self.check_finite()?;
        if self.len() < least.max(2) {
            return Err(PointsError::TooFew {
                output: self.output.clone(),
                found: self.len(),
                expected: least.max(2),
                inputs: self.dim(),
                what: what.into(),
            });
        }
        for (j, channel) in self.inputs.iter().enumerate() {
            if is_constant(self.column(j)) {
                let (channel, value, points) = (channel.clone(), self.x[j], self.len());
                return Err(PointsError::Constant { channel, value, points });
            }
        }
        if is_constant(self.y.iter().copied()) {
            let (channel, value, points) = (self.output.clone(), self.y[0], self.len());
            return Err(PointsError::ConstantOutput { channel, value, points });
        }
        for (j, channel) in self.inputs.iter().enumerate() {
            check_spread(channel, self.column(j))?;
        }
        check_spread(&self.output, self.y.iter().copied())
    }

    /// Checks that no input is a linear function of the others at all points, to nine digits.
    ///
    /// # Errors
    /// [`PointsError::Dependent`] with the input and those that it follows from.
    pub fn check_independent(&self) -> Result<(), PointsError> {
        self.check_independent_as(&Scaling::of(self))
    }

    /// The same of the scaled inputs, which may be warped.
    pub(super) fn check_independent_as(&self, scaling: &Scaling) -> Result<(), PointsError> {
        let columns = (0..self.dim()).map(|j| {
            let scaled = |x: f64| (scaling.warp.at(j, x)[0] - scaling.mean[j]) / scaling.std[j];
            self.column(j).map(scaled).collect::<Vec<f64>>()
        });
        let mut basis: Vec<Vec<f64>> = Vec::new();
        for (j, mut column) in columns.enumerate() {
            let whole = dot(&column, &column);
            // Twice, as one pass leaves rounding behind.
            let mut shares = vec![0.0; basis.len()];
            for _ in 0..2 {
                for (share, b) in shares.iter_mut().zip(&basis) {
                    let along = dot(b, &column);
                    axpy(-along, b, &mut column);
                    *share += along * along / whole;
                }
            }
            let rest = dot(&column, &column);
            if rest <= DEPENDENT * whole {
                let of = self.inputs[..j].iter().zip(&shares).filter(|(_, s)| **s > DEPENDENT);
                let others: Vec<String> = of.map(|(name, _)| format!("`{name}`")).collect();
                let (channel, others) = (self.inputs[j].clone(), others.join(", "));
                return Err(PointsError::Dependent { channel, others, points: self.len() });
            }
            let length = rest.sqrt();
            column.iter_mut().for_each(|v| *v /= length);
            basis.push(column);
        }
        Ok(())
    }

    fn check_finite(&self) -> Result<(), PointsError> {
        let (n, d) = (self.len(), self.dim());
        if self.x.len() != n * d || d == 0 {
            let output = self.output.clone();
            return Err(PointsError::Shape {
                output,
                found: self.x.len(),
                points: n,
                expected: n * d,
                inputs: d,
            });
        }
        let bad_x =
            self.x.iter().position(|v| !v.is_finite()).map(|k| (&self.inputs[k % d], k / d, self.x[k]));
        let bad_y = self.y.iter().position(|v| !v.is_finite()).map(|k| (&self.output, k, self.y[k]));
        match bad_x.or(bad_y) {
            Some((channel, row, found)) => {
                Err(PointsError::NotFinite { channel: channel.clone(), row: row + 1, found })
            }
            None => Ok(()),
        }
    }

    /// Groups of points with exactly equal inputs, in the order of their first rows.
    pub fn replicates(&self) -> Replicates {
        let mut order: Vec<usize> = (0..self.len()).collect();
        let compare = |a: &usize, b: &usize| {
            let pairs = self.row(*a).iter().zip(self.row(*b));
            pairs.map(|(x, y)| x.total_cmp(y)).find(|o| o.is_ne()).unwrap_or(std::cmp::Ordering::Equal)
        };
        order.sort_by(|a, b| compare(a, b).then(a.cmp(b)));
        let (mut groups, mut copies) = (Vec::new(), Vec::new());
        for group in order.chunk_by(|a, b| compare(a, b).is_eq()).filter(|g| g.len() > 1) {
            let seen = |k: usize| group[..k].iter().any(|i| self.y[*i] == self.y[group[k]]);
            copies.extend((1..group.len()).filter(|k| seen(*k)).map(|k| group[k]));
            groups.push(group.to_vec());
        }
        groups.sort();
        copies.sort_unstable();
        Replicates { groups, copies }
    }

    /// The operating point of each row: equal numbers where all inputs are equal, counted by first rows.
    pub fn operating_points(&self) -> Vec<usize> {
        let mut first: Vec<usize> = (0..self.len()).collect();
        for group in self.replicates().groups {
            group.iter().for_each(|i| first[*i] = group[0]);
        }
        let mut number = vec![0; self.len()];
        let mut next = 0;
        for i in 0..self.len() {
            if first[i] == i {
                number[i] = next;
                next += 1;
            } else {
                number[i] = number[first[i]];
            }
        }
        number
    }

    /// What an engineer should look at before the points are believed: copies of rows, inputs that follow from others, and points
    /// that lie far from what the others predict (`left_out`).
    pub fn warnings(&self, left_out: &LeftOut) -> Vec<String> {
        let copies = self.replicates().copies;
        let mut out = Vec::new();
        if !copies.is_empty() {
            let rows = if copies.len() == 1 {
                format!("row {} repeats", copies[0] + 1)
            } else {
                format!("rows {} repeat", rows_in_words(&copies))
            };
            out.push(format!(
                "{rows} inputs and output of an earlier row exactly: copies of a row make the noise look smaller than it is; \
                 take them out unless they were measured (rows of the points that it was learnt from)"
            ));
        }
        out.extend(self.check_independent().err().map(|e| e.to_string()));
        out.extend(self.suspects(left_out));
        out
    }

    /// A sentence on points that lie both far outside of the other left-out errors and of their own standard deviation.
    fn suspects(&self, left_out: &LeftOut) -> Option<String> {
        let mut sizes: Vec<f64> = left_out.residuals.iter().map(|e| e.abs()).collect();
        sizes.sort_by(f64::total_cmp);
        let half = *sizes.get(sizes.len() / 2)?;
        let far = |i: usize| {
            let (e, v) = (left_out.residuals[i].abs(), left_out.variance[i]);
            e > FAR * half && e * e > ALONE * ALONE * v
        };
        let mut rows: Vec<usize> = (0..self.len().min(left_out.variance.len())).filter(|i| far(*i)).collect();
        rows.sort_by(|a, b| left_out.residuals[*b].abs().total_cmp(&left_out.residuals[*a].abs()));
        let first = *rows.first()?;
        let (measured, error) = (self.y[first], left_out.residuals[first]);
        let others = if rows.len() > 1 {
            format!(" (so do rows {})", rows_in_words(&rows[1..]))
        } else {
            String::new()
        };
        let at = self.inputs.iter().zip(self.row(first)).map(|(name, x)| format!("{name} {}", four(*x)));
        Some(format!(
            "row {} does not fit the others: measured {} at {}, predicted from them {}, while half of all points lie within \
             {}{others}: measure it again or take it out (rows of the points that it was learnt from)",
            first + 1,
            four(measured),
            at.collect::<Vec<String>>().join(", "),
            four(measured - error),
            four(half)
        ))
    }

    /// Sentences on duplicates, for reports; none where all points differ.
    pub fn notes(&self) -> Vec<String> {
        let found = self.replicates();
        let mut notes = Vec::new();
        if !found.groups.is_empty() {
            let points: usize = found.groups.iter().map(Vec::len).sum();
            notes.push(format!(
                "{}: {points} points lie at {} repeated operating points (first: rows {})",
                self.output,
                found.groups.len(),
                rows_in_words(&found.groups[0])
            ));
        }
        notes
    }
}

/// Rows counted from 1, at most eight of them.
fn rows_in_words(rows: &[usize]) -> String {
    let head: Vec<String> = rows.iter().take(8).map(|r| (r + 1).to_string()).collect();
    let more = if rows.len() > 8 { format!(" and {} more", rows.len() - 8) } else { String::new() };
    head.join(", ") + &more
}

/// Share of its variance that is left of an input which follows from others to nine digits.
const DEPENDENT: f64 = 1e-18;
/// A point does not fit the others when its left-out error is this many times as large as half of them are (five standard
/// deviations of a normal distribution), and this many of its own standard deviations.
const FAR: f64 = 8.0;
const ALONE: f64 = 4.0;
/// Standard deviations whose fourth powers are numbers.
const SPREADS: [f64; 2] = [1e-75, 1e75];

fn check_spread(channel: &str, values: impl Iterator<Item = f64> + Clone) -> Result<(), PointsError> {
    let (low, high) = range(values.clone());
    let (_, std) = mean_std(values);
    // The range stands in where the squares have no value.
    let found = if std.is_finite() { std.min(high - low) } else { high - low };
    if (SPREADS[0]..=SPREADS[1]).contains(&found) {
        return Ok(());
    }
    Err(PointsError::Spread { channel: channel.into(), found })
}

/// Four significant digits: fixed notation from 1e-3 to 1e6, otherwise with an exponent.
pub(super) fn four(value: f64) -> String {
    let exponent = value.abs().log10().floor();
    if value == 0.0 || !value.is_finite() {
        format!("{value}")
    } else if (-3.0..6.0).contains(&exponent) {
        format!("{value:.*}", (3.0 - exponent).max(0.0) as usize)
    } else {
        format!("{value:.3e}")
    }
}

/// A number of things.
pub(super) fn counted(count: usize, thing: &str) -> String {
    if count == 1 { format!("1 {thing}") } else { format!("{count} {thing}s") }
}

/// Smallest and largest of some values.
pub fn range(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)))
}

/// Whether the values differ by no more than rounding.
fn is_constant(values: impl Iterator<Item = f64>) -> bool {
    let (low, high) = range(values);
    high - low <= 1e-12 * high.abs().max(low.abs())
}
