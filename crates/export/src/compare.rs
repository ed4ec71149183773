//! Two sets of characteristics beside each other: what only one has, and how far the others differ.
//!
//! Curves and maps are compared where both are defined, at the points of both axes. Between them both are (bi)linear, and so is
//! their difference in every cell of that grid: its largest value stands at a point of the grid, so that the largest difference
//! found is the largest of all.

use dynocal_files::units;
use serde::Serialize;

use crate::characteristic::{Axis, Characteristic};
use crate::evaluate::lookup;
use crate::package::Extrapolation;

/// The largest difference of a characteristic.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Largest {
    /// Where, in the axes of the first (or the index in a block of values).
    pub at: Vec<f64>,
    /// Value of the first.
    pub first: f64,
    /// Value of the second, in the unit of the first.
    pub second: f64,
}

/// A characteristic that both have.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// Name.
    pub name: String,
    /// Unit of the numbers: that of the first.
    pub unit: String,
    /// Points that were compared.
    pub points: usize,
    /// Points at which the two differ.
    pub differing: usize,
    /// Root mean square of the difference over the points; none where nothing could be compared.
    pub rms: Option<f64>,
    /// The largest difference; none where all are equal.
    pub largest: Option<Largest>,
    /// What else differs (axes, units, ranges), and why nothing was compared.
    pub remarks: Vec<String>,
}

impl Difference {
    /// Whether values, axes and units are the same.
    pub fn is_equal(&self) -> bool {
        self.points > 0 && self.differing == 0 && self.remarks.is_empty()
    }
}

/// Two sets beside each other.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Comparison {
    /// Characteristics that both have, in the order of the first.
    pub both: Vec<Difference>,
    /// Names that only the first has.
    pub only_first: Vec<String>,
    /// Names that only the second has.
    pub only_second: Vec<String>,
}

/// Compares two sets by the names of their characteristics (two single ones whatever their names). Units of the second are
/// converted where that is exact.
///
/// # Examples
/// ```
/// use dynocal_export::characteristic::{Axis, Characteristic};
/// use dynocal_export::compare::compare;
/// let curve = |points: &[f64], values: &[f64]| Characteristic {
///     name: "K".into(),
///     description: String::new(),
///     unit: "mg".into(),
///     axes: vec![Axis {
///         name: "speed".into(),
///         description: String::new(),
///         unit: "rpm".into(),
///         input: "speed".into(),
///         points: points.to_vec(),
///         shared: false,
///     }],
///     values: values.to_vec(),
///     limits: None,
/// };
/// // A line, and the same line with a kink at 2000: other axes, one of three points differs.
/// let found = compare(&[curve(&[1000.0, 3000.0], &[10.0, 30.0])], &[curve(&[1000.0, 2000.0, 3000.0], &[10.0, 25.0, 30.0])]);
/// let k = &found.both[0];
/// assert_eq!((k.points, k.differing), (3, 1));
/// assert_eq!(k.largest.as_ref().map(|l| (l.at[0], l.first, l.second)), Some((2000.0, 20.0, 25.0)));
/// ```
pub fn compare(first: &[Characteristic], second: &[Characteristic]) -> Comparison {
    // Two files of one map each: whatever they are called, they are meant.
    if let ([a], [b]) = (first, second)
        && a.name != b.name
    {
        let mut only = difference(a, b);
        only.remarks.insert(0, format!("called `{}` and `{}`", a.name, b.name));
        return Comparison { both: vec![only], ..Comparison::default() };
    }
    let of = |all: &[Characteristic], name: &str| all.iter().position(|c| c.name == name);
    let mut out = Comparison::default();
    for a in first {
        match of(second, &a.name) {
            Some(k) => out.both.push(difference(a, &second[k])),
            None => out.only_first.push(a.name.clone()),
        }
    }
    let lone = second.iter().filter(|b| of(first, &b.name).is_none());
    out.only_second = lone.map(|b| b.name.clone()).collect();
    out
}

fn difference(a: &Characteristic, b: &Characteristic) -> Difference {
    let mut out = Difference {
        name: a.name.clone(),
        unit: a.unit.clone(),
        points: 0,
        differing: 0,
        rms: None,
        largest: None,
        remarks: Vec::new(),
    };
    match points(a, b, &mut out.remarks) {
        Ok(pairs) => tally(&pairs, &mut out),
        Err(why) => out.remarks.push(format!("not compared: {why}")),
    }
    out
}

/// Scale and offset from the unit of `b` to that of `a`; a unit that nobody said is taken as the other.
fn to_unit(what: &str, b: &str, a: &str, remarks: &mut Vec<String>) -> Result<(f64, f64), String> {
    let plain = |u: &str| if u.trim().is_empty() { "-".to_string() } else { units::normalise(u) };
    let (from, to) = (plain(b), plain(a));
    if from == to {
        return Ok((1.0, 0.0));
    }
    let found = match units::conversion(&from, &to) {
        Some(found) => found,
        // No unit, or none of the table: the numbers themselves are compared, and that is said.
        None if [&from, &to].iter().any(|u| u.as_str() == "-" || units::dimension(u).is_none()) => (1.0, 0.0),
        None => return Err(format!("{what}: `{from}` cannot become `{to}`")),
    };
    remarks.push(format!("{what}: units `{to}` and `{from}`"));
    Ok(found)
}

/// A point, the value of the first there, and that of the second.
type Pair = (Vec<f64>, f64, f64);

fn points(a: &Characteristic, b: &Characteristic, remarks: &mut Vec<String>) -> Result<Vec<Pair>, String> {
    let (scale, offset) = to_unit("values", &b.unit, &a.unit, remarks)?;
    if a.axes.len() != b.axes.len() {
        return Err(format!("{} and {} axes", a.axes.len(), b.axes.len()));
    }
    if a.axes.is_empty() {
        if a.len() != b.len() {
            return Err(format!("{} and {} values", a.len(), b.len()));
        }
        let pair = |(k, (x, y)): (usize, (&f64, &f64))| (vec![k as f64], *x, y * scale + offset);
        return Ok(a.values.iter().zip(&b.values).enumerate().map(pair).collect());
    }
    // The second over the axes of the first.
    let mut moved = b.clone();
    for (mine, other) in a.axes.iter().zip(&mut moved.axes) {
        let (scale, offset) = to_unit(&format!("axis `{}`", mine.name), &other.unit, &mine.unit, remarks)?;
        other.points.iter_mut().for_each(|p| *p = *p * scale + offset);
    }
    let grid: Vec<Vec<f64>> = a
        .axes
        .iter()
        .zip(&moved.axes)
        .map(|(mine, other)| common(mine, other, remarks))
        .collect::<Result<_, _>>()?;
    let mut out = Vec::new();
    let at = |u: &[f64]| {
        let second = lookup(&moved, u, Extrapolation::Clip) * scale + offset;
        (u.to_vec(), lookup(a, u, Extrapolation::Clip), second)
    };
    match grid.as_slice() {
        [x] => x.iter().for_each(|x| out.push(at(&[*x]))),
        [x, y] => y.iter().for_each(|y| x.iter().for_each(|x| out.push(at(&[*x, *y])))),
        more => return Err(format!("{} axes, expected two at most", more.len())),
    }
    Ok(out)
}

/// The points of both axes where both are defined.
fn common(a: &Axis, b: &Axis, remarks: &mut Vec<String>) -> Result<Vec<f64>, String> {
    let ends = |p: &[f64]| (p[0], p[p.len() - 1]);
    let ((a0, a1), (b0, b1)) = (ends(&a.points), ends(&b.points));
    let (low, high) = (a0.max(b0), a1.min(b1));
    // Points that a conversion of units moved by a rounding error are equal.
    let near = |x: f64, y: f64| (x - y).abs() <= 1e-12 * (a1 - a0).abs().max(x.abs());
    let same = a.points.len() == b.points.len() && a.points.iter().zip(&b.points).all(|(x, y)| near(*x, *y));
    if same {
        return Ok(a.points.clone());
    }
    if low > high {
        return Err(format!("axis `{}`: {a0} to {a1} and {b0} to {b1} have nothing in common", a.name));
    }
    let mut text = format!("axis `{}`: {} and {} points", a.name, a.points.len(), b.points.len());
    if !near(a0, b0) || !near(a1, b1) {
        text.push_str(&format!(", {a0} to {a1} and {b0} to {b1}; compared on {low} to {high}"));
    }
    remarks.push(text);
    let mut all: Vec<f64> = a.points.iter().chain(&b.points).copied().collect();
    all.push(low);
    all.push(high);
    all.retain(|p| (low..=high).contains(p));
    all.sort_by(f64::total_cmp);
    all.dedup_by(|x, y| near(*x, *y));
    Ok(all)
}

fn tally(pairs: &[Pair], out: &mut Difference) {
    let (mut sum, mut most) = (0.0, 0.0);
    // Rounding of a conversion or of the interpolation is no difference.
    let rounding = 1e-12 * pairs.iter().fold(0.0f64, |m, p| m.max(p.1.abs()).max(p.2.abs()));
    for (at, first, second) in pairs {
        let d = (second - first).abs();
        sum += d * d;
        if d > rounding {
            out.differing += 1;
            if d > most {
                most = d;
                out.largest = Some(Largest { at: at.clone(), first: *first, second: *second });
            }
        }
    }
    out.points = pairs.len();
    out.rms = (!pairs.is_empty()).then(|| (sum / pairs.len() as f64).sqrt());
}
