//! One input of a structure as a function of a row of measured channels.
//!
//! ```text
//! x(u) = (factor prod_c u_c^(p_c) - offset) / scale
//! ```

use super::pointwise::Affine;
use crate::derived::Monomial;

/// An input of the structure over rows of channels, which stand by place and not by name: a look-up by name costs more than
/// the product.
#[derive(Clone, Debug, PartialEq)]
pub struct Path {
    factor: f64,
    /// Places of channels with their powers.
    powers: Vec<(usize, i32)>,
    way: Affine,
}

impl Path {
    /// From a monomial of `channels`; the name of the first channel that is not among them as an error.
    pub(super) fn new(monomial: Monomial, way: Affine, channels: &[String]) -> Result<Self, String> {
        let place = |(name, power): (String, i32)| match channels.iter().position(|c| *c == name) {
            Some(k) => Ok((k, power)),
            None => Err(name),
        };
        let powers = monomial.powers.into_iter().map(place).collect::<Result<_, _>>()?;
        Ok(Self { factor: monomial.factor, powers, way })
    }

    /// Whether channel `c` moves it.
    pub fn reads(&self, c: usize) -> bool {
        self.powers.iter().any(|(k, _)| *k == c)
    }

    /// Its value.
    pub fn value(&self, row: &[f64]) -> f64 {
        (self.product(row, &[]) - self.way.offset) / self.way.scale
    }

    /// Its derivative with respect to channel `c`.
    pub fn slope(&self, row: &[f64], c: usize) -> f64 {
        self.product(row, &[c]) / self.way.scale
    }

    /// Its second derivative with respect to channels `a` and `b`.
    pub fn bend(&self, row: &[f64], a: usize, b: usize) -> f64 {
        self.product(row, &[a, b]) / self.way.scale
    }

    /// The product, derived once by each channel of `by`; 0 where one of them is not in it.
    fn product(&self, row: &[f64], by: &[usize]) -> f64 {
        if by.iter().any(|c| !self.reads(*c)) {
            return 0.0;
        }
        self.powers.iter().fold(self.factor, |product, &(k, power)| {
            let times = by.iter().filter(|c| **c == k).count() as i32;
            let lost: i32 = (0..times).map(|n| power - n).product();
            // x^p derived more often than p times is 0, whatever x is.
            if lost == 0 { 0.0 } else { product * f64::from(lost) * row[k].powi(power - times) }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `(0.3 a^2/b - 1)/4`, with its derivatives by hand, also where `a = 0`.
    #[test]
    fn derivatives_are_those_of_the_monomial() {
        let monomial = Monomial { factor: 0.3, powers: vec![("a".into(), 2), ("b".into(), -1)] };
        let channels = ["b".to_string(), "c".into(), "a".into()];
        let path = Path::new(monomial.clone(), Affine { offset: 1.0, scale: 4.0 }, &channels).unwrap();
        for (a, b) in [(1.7, -0.8), (0.0, 2.0)] {
            let row = [b, 9.0, a];
            let close =
                |found: f64, expected: f64| assert!((found - expected).abs() < 1e-14, "{found} {expected}");
            close(path.value(&row), (0.3 * a * a / b - 1.0) / 4.0);
            close(path.slope(&row, 2), 0.6 * a / b / 4.0);
            close(path.slope(&row, 0), -0.3 * a * a / (b * b) / 4.0);
            close(path.slope(&row, 1), 0.0);
            close(path.bend(&row, 2, 2), 0.6 / b / 4.0);
            close(path.bend(&row, 0, 2), -0.6 * a / (b * b) / 4.0);
            close(path.bend(&row, 0, 0), 0.6 * a * a / (b * b * b) / 4.0);
            close(path.bend(&row, 1, 2), 0.0);
        }
        assert_eq!(
            Path::new(monomial, Affine { offset: 0.0, scale: 1.0 }, &channels[..2]),
            Err("a".to_string())
        );
    }
}
