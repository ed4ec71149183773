//! The way to a point: straight, or straight to a corner and straight from there.
//!
//! ```text
//! x(s) = x_0 + s / c (x_c - x_0)                  0 <= s <= c      x_c: the corner, c: its share of the way
//! x(s) = x_c + (s - c) / (1 - c) (x_1 - x_c)      c <= s <= 1
//! ```
//!
//! Lengths are those of ramps: the largest change of a factor as a share of its range.

use crate::steady::layout::Factor;

/// A place on the way to a point.
#[derive(Clone, Debug, PartialEq)]
pub struct Corner {
    /// All factors.
    pub at: Vec<f64>,
    /// Where the way was to begin: a bed that stands far from there goes straight.
    pub from: Vec<f64>,
    /// Where the inputs of the loops are expected to stand there, by loop; not fed forward where there is none, or no number.
    pub driven: Vec<f64>,
}

/// How far from where its way was to begin a corner is gone over, in shares of the ranges: about as far as a bed backs off.
const NEAR: f64 = 0.2;

/// From where the bed stands over at most one corner to a target.
pub(super) struct Route<'a> {
    places: Vec<Place<'a>>,
}

/// A place on the way.
struct Place<'a> {
    /// Its share of the way.
    share: f64,
    at: &'a [f64],
    /// The driven inputs that are expected there.
    driven: &'a [f64],
}

impl<'a> Route<'a> {
    /// From `origin` over the corner to the target, each with the driven inputs.
    pub(super) fn new(
        factors: &[Factor],
        origin: (&'a [f64], &'a [f64]),
        via: Option<&'a Corner>,
        target: (&'a [f64], &'a [f64]),
    ) -> Self {
        let place = |share: f64, (at, driven): (&'a [f64], &'a [f64])| Place { share, at, driven };
        let mut places = vec![place(0.0, origin)];
        if let Some(c) = via {
            let (first, second) = (length(factors, origin.0, &c.at), length(factors, &c.at, target.0));
            // A corner at either end is none; that of another way may be a detour past a limit.
            if first > 0.0 && second > 0.0 && length(factors, origin.0, &c.from) <= NEAR {
                places.push(place(first / (first + second), (&c.at, &c.driven)));
            }
        }
        places.push(place(1.0, target));
        Self { places }
    }

    /// Places on both sides of a share of the way, and how far it is from the first to the second.
    fn around(&self, s: f64) -> (&Place<'a>, &Place<'a>, f64) {
        let last = self.places.len() - 1;
        let k = self.places[1..last].iter().take_while(|p| p.share <= s).count();
        let (a, b) = (&self.places[k], &self.places[k + 1]);
        (a, b, (s - a.share) / (b.share - a.share))
    }

    /// Factors at a share of the way.
    pub(super) fn at(&self, s: f64) -> Vec<f64> {
        let (a, b, share) = self.around(s);
        a.at.iter().zip(b.at).map(|(a, b)| a + share * (b - a)).collect()
    }

    /// Where the inputs of the loops are expected at a share of the way; as they stand `now` where nothing is known.
    pub(super) fn driven(&self, s: f64, now: &[f64]) -> Vec<f64> {
        let (a, b, share) = self.around(s);
        let known = |of: &[f64], l: usize| of.get(l).copied().filter(|v| v.is_finite());
        let one = |(l, now): (usize, &f64)| match known(a.driven, l).zip(known(b.driven, l)) {
            Some((a, b)) => a + share * (b - a),
            // At the end nothing before it matters.
            None => known(b.driven, l).filter(|_| share >= 1.0).unwrap_or(*now),
        };
        now.iter().enumerate().map(one).collect()
    }

    /// Shares at the ends of the straight parts from one share of the way to another, in the order in which they are gone along.
    pub(super) fn ends(&self, from: f64, to: f64) -> Vec<f64> {
        let between = |c: &f64| (from.min(to) < *c) && (*c < from.max(to));
        let mut all: Vec<f64> = self.places.iter().map(|p| p.share).filter(between).collect();
        if to < from {
            all.reverse();
        }
        all.push(to);
        all
    }
}

/// Length of a straight way.
pub(super) fn length(factors: &[Factor], from: &[f64], to: &[f64]) -> f64 {
    let each = from.iter().zip(to).zip(factors).map(|((a, b), f)| (b - a).abs() / (f.upper - f.lower));
    each.fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::steady::layout::FactorKind;

    fn factors() -> Vec<Factor> {
        let one = |k: usize| Factor {
            name: k.to_string(),
            unit: "-".into(),
            lower: 0.0,
            upper: 10.0,
            kind: FactorKind::Free(k),
        };
        (0..2).map(one).collect()
    }

    #[test]
    fn a_way_over_a_corner_is_gone_along_by_the_lengths_of_its_parts() {
        let corner = Corner { at: vec![0.0, 2.0], from: vec![0.0, 0.0], driven: vec![5.0, f64::NAN] };
        let (factors, to) = (factors(), ([6.0, 2.0], [9.0, 9.0]));
        let route = Route::new(&factors, (&[0.0, 0.0], &[1.0, 1.0]), Some(&corner), (&to.0, &to.1));
        assert_eq!(route.at(0.0), [0.0, 0.0]);
        assert_eq!(route.at(0.125), [0.0, 1.0]);
        assert_eq!(route.at(0.25), [0.0, 2.0]);
        assert_eq!(route.at(0.5), [2.0, 2.0]);
        assert_eq!(route.at(1.0), [6.0, 2.0]);
        assert_eq!(route.driven(0.125, &[8.0, 8.0]), [3.0, 8.0]);
        assert_eq!(route.driven(0.625, &[8.0, 8.0]), [7.0, 8.0]);
        assert_eq!(route.driven(1.0, &[8.0, 8.0]), [9.0, 9.0]);
        assert_eq!(route.ends(0.0, 1.0), [0.25, 1.0]);
        assert_eq!(route.ends(0.8, 0.1), [0.25, 0.1]);
        assert_eq!(route.ends(0.8, 0.6), [0.6]);
    }

    #[test]
    fn a_corner_at_an_end_or_of_another_way_is_none() {
        let factors = factors();
        for (at, from) in [([0.0, 0.0], 0.0), ([6.0, 2.0], 0.0), ([0.0, 2.0], 2.1)] {
            let corner = Corner { at: at.to_vec(), from: vec![from, 0.0], driven: vec![5.0] };
            let route = Route::new(&factors, (&[0.0, 0.0], &[]), Some(&corner), (&[6.0, 2.0], &[]));
            assert_eq!((route.at(0.5), route.ends(0.0, 1.0)), (vec![3.0, 1.0], vec![1.0]));
        }
    }
}
