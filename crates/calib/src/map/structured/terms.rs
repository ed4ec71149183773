//! Terms of the structured inverse as data: a product of scaled references, times a window difference or none.

use super::super::Ports;
use super::StructuredShape;
use dynocal_numerics::interval::Interval;
use serde::{Deserialize, Serialize};

/// How a reference is brought to the order of one.
///
/// A channel whose range is a ratio (positive, largest at least 1.5 times the least: torque, speed) is divided by the middle
/// of its range, `x/m`, and has an inverse `m/x`; any other is counted from its middle in half ranges, `(x - m)/h`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scale {
    /// What is subtracted.
    pub offset: f64,
    /// What the rest is divided by.
    pub unit: f64,
    /// Whether the channel has an inverse.
    pub ratio: bool,
}

/// Ratio of the ends of a range from which on it counts as a ratio.
const RATIO: f64 = 1.5;

impl Scale {
    /// Scale of a channel that lies in `range`.
    pub fn of_range(range: Interval) -> Self {
        let Interval { lower, upper } = range;
        let middle = 0.5 * (lower + upper);
        if lower > 0.0 && upper >= RATIO * lower {
            return Self { offset: 0.0, unit: middle, ratio: true };
        }
        let half = 0.5 * (upper - lower);
        // A channel that does not move has no term that matters; any unit will do.
        Self { offset: middle, unit: if half > 0.0 { half } else { 1.0 }, ratio: false }
    }

    /// Scaled value.
    pub fn plain(&self, x: f64) -> f64 {
        (x - self.offset) / self.unit
    }

    /// Scaled inverse.
    pub fn inverse(&self, x: f64) -> f64 {
        self.unit / x
    }
}

/// A factor of a term: a reference at the present sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Factor {
    /// Scaled reference of this number.
    Plain(usize),
    /// Its scaled inverse.
    Inverse(usize),
}

/// The window difference `x(t+k) - x(t)` of a reference. Files hold it as `[reference, offset]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "(usize, i32)", into = "(usize, i32)")]
pub struct Difference {
    /// Place of the reference x.
    pub reference: usize,
    /// k in samples.
    pub offset: i32,
}

impl From<(usize, i32)> for Difference {
    fn from((reference, offset): (usize, i32)) -> Self {
        Self { reference, offset }
    }
}

impl From<Difference> for (usize, i32) {
    fn from(d: Difference) -> Self {
        (d.reference, d.offset)
    }
}

/// One term: `difference * product of factors`, without a difference the product alone (the static part).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Term {
    /// Window difference; none for a static term.
    pub difference: Option<Difference>,
    /// Factors at sample t.
    pub factors: Vec<Factor>,
}

impl Term {
    /// Name with the references' names, e.g. `d torque(+4) * speed`.
    pub fn name(&self, ports: &Ports) -> String {
        let names = ports.reference_names();
        let mut parts: Vec<String> =
            self.difference.iter().map(|d| format!("d {}({:+})", names[d.reference], d.offset)).collect();
        parts.extend(self.factors.iter().map(|f| match f {
            Factor::Plain(r) => names[*r].clone(),
            Factor::Inverse(r) => format!("1/{}", names[*r]),
        }));
        if parts.is_empty() { "1".into() } else { parts.join(" * ") }
    }
}

/// All terms of a shape over these ports.
///
/// With the leading demand T, operating channels N (given) and further demands L, the static part holds
///
/// ```text
/// 1, T, T^2, T^3;   N, N^2, 1/N, T N, T/N, T^2 N, T^2/N, T N^2   for every N;   N N', T N N' for every pair
/// L, L^2, L T;      L N, L/N, L T N                              for every N;   L L'          for every pair
/// ```
///
/// and each window difference stands alone and times what its gain depends on: T: N, 1/N, T; L: N, T; N: T, 1/N.
pub fn terms(ports: &Ports, scales: &[Scale], shape: &StructuredShape) -> Vec<Term> {
    use Factor::{Inverse, Plain};
    let demands = ports.demands.len();
    let (lead, others): (Vec<usize>, Vec<usize>) = ((0..demands.min(1)).collect(), (1..demands).collect());
    let given: Vec<usize> = (demands..ports.n_references()).collect();
    let inverse = |n: usize| scales[n].ratio.then_some(Inverse(n));
    let mut out = Vec::new();
    let mut push = |difference, factors: Vec<Factor>| out.push(Term { difference, factors });
    push(None, vec![]);
    for &t in &lead {
        (1..=3).for_each(|power| push(None, vec![Plain(t); power]));
    }
    for (k, &n) in given.iter().enumerate() {
        push(None, vec![Plain(n)]);
        push(None, vec![Plain(n), Plain(n)]);
        inverse(n).into_iter().for_each(|i| push(None, vec![i]));
        for &t in &lead {
            for m in [Some(Plain(n)), inverse(n)].into_iter().flatten() {
                push(None, vec![Plain(t), m]);
                push(None, vec![Plain(t), Plain(t), m]);
            }
            push(None, vec![Plain(t), Plain(n), Plain(n)]);
        }
        for &other in &given[..k] {
            push(None, vec![Plain(other), Plain(n)]);
            lead.iter().for_each(|&t| push(None, vec![Plain(t), Plain(other), Plain(n)]));
        }
    }
    for (k, &l) in others.iter().enumerate() {
        push(None, vec![Plain(l)]);
        push(None, vec![Plain(l), Plain(l)]);
        lead.iter().for_each(|&t| push(None, vec![Plain(l), Plain(t)]));
        for &n in &given {
            push(None, vec![Plain(l), Plain(n)]);
            inverse(n).into_iter().for_each(|i| push(None, vec![Plain(l), i]));
            lead.iter().for_each(|&t| push(None, vec![Plain(l), Plain(t), Plain(n)]));
        }
        others[..k].iter().for_each(|&o| push(None, vec![Plain(o), Plain(l)]));
    }
    for (r, port) in ports.references().enumerate() {
        let role = if r == 0 && demands > 0 {
            0
        } else if r < demands {
            1
        } else {
            2
        };
        for &k in shape.offsets_of(&port.name, role) {
            let mut with = vec![vec![]];
            match role {
                0 => {
                    for &n in &given {
                        with.push(vec![Plain(n)]);
                        with.extend(inverse(n).map(|i| vec![i]));
                    }
                    with.push(vec![Plain(r)]);
                }
                1 => {
                    with.extend(given.iter().map(|&n| vec![Plain(n)]));
                    with.extend(lead.iter().map(|&t| vec![Plain(t)]));
                }
                _ => {
                    with.extend(lead.iter().map(|&t| vec![Plain(t)]));
                    with.extend(inverse(r).map(|i| vec![i]));
                }
            }
            with.into_iter().for_each(|factors| push(Some(Difference { reference: r, offset: k }), factors));
        }
    }
    out
}

/// Values of all terms; `at(r, k)` is reference r at offset k from the present sample.
pub fn values(terms: &[Term], scales: &[Scale], at: impl Fn(usize, i32) -> f64, row: &mut Vec<f64>) {
    row.clear();
    row.extend(terms.iter().map(|term| {
        let start = term
            .difference
            .map_or(1.0, |d| (at(d.reference, d.offset) - at(d.reference, 0)) / scales[d.reference].unit);
        term.factors.iter().fold(start, |product, f| {
            product
                * match *f {
                    Factor::Plain(r) => scales[r].plain(at(r, 0)),
                    Factor::Inverse(r) => scales[r].inverse(at(r, 0)),
                }
        })
    }));
}
