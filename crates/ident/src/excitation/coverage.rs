//! Which part of the input space a record visits.

use dynocal_numerics::interval::Interval;
use serde::Serialize;

/// Cells along one input.
pub const CELLS: usize = 20;
/// Cells along each input of a pair.
pub const PAIR_CELLS: usize = 10;

/// Coverage of one input.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Coverage {
    /// Input.
    pub input: String,
    /// Least value recorded.
    pub minimum: f64,
    /// Greatest value recorded.
    pub maximum: f64,
    /// Range that counts: as declared, or from least to greatest value.
    pub range: Interval,
    /// Share of the [`CELLS`] equal cells of the range that hold at least one sample.
    pub occupied: f64,
    /// Share of the range between least and greatest value.
    pub span: f64,
    /// Share of the samples outside the range.
    pub outside: f64,
}

/// Coverage of two inputs together.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PairCoverage {
    /// One input.
    pub a: String,
    /// The other.
    pub b: String,
    /// Share of the [`PAIR_CELLS`] x [`PAIR_CELLS`] cells between least and greatest value of both that hold at least
    /// one sample.
    pub occupied: f64,
    /// The same of those cells that the two inputs could reach if every value of one met every value of the other:
    /// small where the inputs were moved together.
    pub of_reachable: f64,
    /// Samples per cell, row by row of `a`.
    pub counts: Vec<usize>,
}

/// Coverage of the input `name` by `values`; `range` where its limits are declared. Missing samples do not count; none
/// without a sample.
///
/// ```
/// use dynocal_ident::excitation::coverage::coverage;
/// use dynocal_numerics::interval::Interval;
/// let u: Vec<f64> = (0..50).map(f64::from).collect();
/// let c = coverage("u", &u, Some(Interval::new(0.0, 100.0))).unwrap();
/// assert_eq!((c.occupied, c.span, c.outside), (0.5, 0.49, 0.0));
/// ```
pub fn coverage(name: &str, values: &[f64], range: Option<Interval>) -> Option<Coverage> {
    let known = || values.iter().copied().filter(|v| !v.is_nan());
    let n = known().count();
    let (minimum, maximum) =
        known().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
    if n == 0 {
        return None;
    }
    let range = range.unwrap_or(Interval::new(minimum, maximum));
    let mut seen = [false; CELLS];
    known().filter_map(|v| cell(v, range, CELLS)).for_each(|k| seen[k] = true);
    let width = range.width();
    let inside = (maximum.min(range.upper) - minimum.max(range.lower)).max(0.0);
    Some(Coverage {
        input: name.into(),
        minimum,
        maximum,
        range,
        occupied: share(&seen),
        span: if width > 0.0 { inside / width } else { 1.0 },
        outside: known().filter(|v| !range.contains(*v)).count() as f64 / n as f64,
    })
}

/// Coverage of two inputs together, between their least and greatest values.
pub fn pair_coverage(a: &Coverage, b: &Coverage, values_a: &[f64], values_b: &[f64]) -> PairCoverage {
    let mut counts = vec![0; PAIR_CELLS * PAIR_CELLS];
    let (span_a, span_b) = (Interval::new(a.minimum, a.maximum), Interval::new(b.minimum, b.maximum));
    let (mut rows, mut columns) = ([false; PAIR_CELLS], [false; PAIR_CELLS]);
    for (x, y) in values_a.iter().zip(values_b) {
        if let (Some(i), Some(j)) = (cell(*x, span_a, PAIR_CELLS), cell(*y, span_b, PAIR_CELLS)) {
            counts[i * PAIR_CELLS + j] += 1;
            (rows[i], columns[j]) = (true, true);
        }
    }
    let occupied = counts.iter().filter(|c| **c > 0).count() as f64 / counts.len() as f64;
    let reachable = share(&rows) * share(&columns);
    PairCoverage {
        a: a.input.clone(),
        b: b.input.clone(),
        occupied,
        of_reachable: if reachable > 0.0 { occupied / reachable } else { 0.0 },
        counts,
    }
}

/// Cell of `v` among `cells` equal ones; a range of one value has one cell in use.
fn cell(v: f64, range: Interval, cells: usize) -> Option<usize> {
    if !range.contains(v) {
        return None;
    }
    let width = range.width() / cells as f64;
    Some(if width > 0.0 { (((v - range.lower) / width) as usize).min(cells - 1) } else { 0 })
}

fn share(seen: &[bool]) -> f64 {
    seen.iter().filter(|s| **s).count() as f64 / seen.len() as f64
}
