//! Channels that follow from measured ones: monomials, as data.
//!
//! ```text
//! d = factor prod_i c_i^(p_i)        p_i whole numbers
//! ```
//!
//! The duration of a four-stroke cycle `120 speed^-1`, the fuel-air ratio `lambda^-1` and the fuel flow
//! `k inj speed` are all of this kind. What a model reads it reads in other records again, and where the modelled output is
//! a monomial of one channel, that channel follows from the output ([`Derived::inverted`]).

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::data::{Channel, DataError, Dataset, Role};

/// A derived channel.
///
/// ```
/// use dynocal_ident::derived::Derived;
/// let cycle: Derived = toml::from_str("name = 'cycle'\nunit = 's'\nfactor = 120.0\npowers = { speed = -1 }").unwrap();
/// assert_eq!(cycle.value(|_| 1500.0), 0.08);
/// assert_eq!(cycle.inverted(0.08), Some(1500.0));
/// assert_eq!(cycle.to_string(), "cycle = 120 speed^-1");
///
/// // A mass per cylinder and cycle is 3e-5 kg/h per mg and rpm for each cylinder of a four-stroke engine.
/// let fuel = "name = 'fuel'\nunit = 'kg/h'\nfactor = 3e-5\ncylinders = 3\npowers = { inj = 1, speed = 1 }";
/// let fuel: Derived = toml::from_str(fuel).unwrap();
/// assert!((fuel.factor - 9e-5).abs() < 1e-18);
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(from = "Written")]
pub struct Derived {
    /// Name.
    pub name: String,
    /// Unit.
    pub unit: String,
    /// Factor.
    pub factor: f64,
    /// Power of each channel; one that is derived itself comes before this one.
    pub powers: BTreeMap<String, i32>,
}

/// As it is written: what is meant per cylinder is multiplied by the number of cylinders once, when it is read.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Written {
    name: String,
    #[serde(default = "none")]
    unit: String,
    #[serde(default = "one")]
    factor: f64,
    #[serde(default)]
    cylinders: Option<u8>,
    powers: BTreeMap<String, i32>,
}

impl From<Written> for Derived {
    fn from(w: Written) -> Self {
        let Written { name, unit, factor, cylinders, powers } = w;
        Self { name, unit, factor: factor * f64::from(cylinders.unwrap_or(1)), powers }
    }
}

fn one() -> f64 {
    1.0
}

fn none() -> String {
    "-".into()
}

/// Largest absolute power.
pub const MOST_POWER: i32 = 9;

/// A derived channel that cannot be computed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum DerivedError {
    /// Not a monomial of channels.
    #[error("derived channel `{name}`: {message}")]
    Definition {
        /// Name.
        name: String,
        /// What was found and expected.
        message: String,
    },
    /// A channel is not there.
    #[error(transparent)]
    Data(#[from] DataError),
    /// A value that is no number.
    #[error("{record}: `{name}` is {found} at sample {sample}, where {values}: expected a finite number")]
    NotFinite {
        /// Record.
        record: String,
        /// Derived channel.
        name: String,
        /// Sample.
        sample: usize,
        /// Value.
        found: f64,
        /// Values of the channels it follows from.
        values: String,
    },
}

impl Derived {
    /// Checks the definition over the channels that are there before it.
    ///
    /// # Errors
    /// [`DerivedError::Definition`].
    pub fn check(&self, known: &[String]) -> Result<(), DerivedError> {
        let fault = |message: String| Err(DerivedError::Definition { name: self.name.clone(), message });
        if self.name.is_empty() || known.contains(&self.name) {
            return fault("found this name a second time or none, expected a name of its own".into());
        }
        if !(self.factor.is_finite() && self.factor != 0.0) {
            return fault(format!("factor: found {}, expected a finite number other than 0", self.factor));
        }
        if self.powers.is_empty() {
            return fault("powers: found none, expected e.g. { speed = -1 }".into());
        }
        for (channel, power) in &self.powers {
            if !known.contains(channel) {
                let near = dynocal_numerics::registry::nearest(channel, known);
                let hint = near.map(|n| format!(" (did you mean `{n}`?)")).unwrap_or_default();
                return fault(format!(
                    "powers: no channel `{channel}`{hint}; channels are: {}",
                    known.join(", ")
                ));
            }
            if *power == 0 || power.abs() > MOST_POWER {
                return fault(format!(
                    "powers.{channel}: found {power}, expected a whole number from -{MOST_POWER} to {MOST_POWER}, not 0"
                ));
            }
        }
        Ok(())
    }

    /// Its value where `of` says what the channels are.
    pub fn value(&self, of: impl Fn(&str) -> f64) -> f64 {
        self.powers.iter().fold(self.factor, |product, (channel, power)| product * of(channel).powi(*power))
    }

    /// Its derivative with respect to `channel` there: `p d / c`, and for c = 0 its limit.
    pub fn derivative(&self, channel: &str, of: impl Fn(&str) -> f64) -> f64 {
        let Some(&power) = self.powers.get(channel) else { return 0.0 };
        let others = self.powers.iter().filter(|(name, _)| *name != channel);
        let rest = others.fold(self.factor, |product, (name, p)| product * of(name).powi(*p));
        rest * f64::from(power) * of(channel).powi(power - 1)
    }

    /// The only channel that it follows from, where its value gives that channel back (an odd power).
    pub fn source(&self) -> Option<&str> {
        let (channel, power) = self.powers.iter().next()?;
        (self.powers.len() == 1 && power % 2 != 0).then_some(channel)
    }

    /// That channel for a value: `(d / factor)^(1/p)`, with its sign.
    pub fn inverted(&self, value: f64) -> Option<f64> {
        self.source()?;
        let power = *self.powers.values().next()?;
        let ratio = value / self.factor;
        Some(match power {
            1 => ratio,
            -1 => 1.0 / ratio,
            _ => ratio.signum() * ratio.abs().powf(1.0 / f64::from(power)),
        })
    }

    /// Adds the channel to a record; missing samples stay missing. A channel of that name must not be there.
    ///
    /// # Errors
    /// [`DerivedError`]: a channel is not there, or a value is not finite.
    pub fn add_to(&self, record: &mut Dataset, role: Role) -> Result<(), DerivedError> {
        let known: Vec<String> = record.channels.iter().map(|c| c.name.clone()).collect();
        self.check(&known)?;
        let sources: Vec<(&str, &[f64], i32)> = self
            .powers
            .iter()
            .map(|(name, power)| Ok((name.as_str(), record.values(name)?, *power)))
            .collect::<Result<_, DataError>>()?;
        let mut values = Vec::with_capacity(record.len());
        for t in 0..record.len() {
            let found =
                sources.iter().fold(self.factor, |product, (_, v, power)| product * v[t].powi(*power));
            if !found.is_finite() && sources.iter().all(|(_, v, _)| !v[t].is_nan()) {
                let values: Vec<String> = sources.iter().map(|(n, v, _)| format!("{n} = {}", v[t])).collect();
                return Err(DerivedError::NotFinite {
                    record: record.name.clone(),
                    name: self.name.clone(),
                    sample: t,
                    found,
                    values: values.join(", "),
                });
            }
            values.push(found);
        }
        record.channels.push(Channel { name: self.name.clone(), unit: self.unit.clone(), role, values });
        Ok(())
    }
}

/// `factor prod_i c_i^(p_i)` of channels that are not derived.
#[derive(Clone, Debug, PartialEq)]
pub struct Monomial {
    /// Factor.
    pub factor: f64,
    /// Channels with their powers, none of them 0.
    pub powers: Vec<(String, i32)>,
}

impl Monomial {
    /// Its value where `of` says what the channels are.
    pub fn value(&self, of: impl Fn(&str) -> f64) -> f64 {
        self.powers.iter().fold(self.factor, |v, (name, p)| v * of(name).powi(*p))
    }

    /// `channel` as a monomial of channels that `derive` does not derive: its derivations put into each other.
    pub fn of(channel: &str, derive: &[Derived]) -> Self {
        let mut out = Self { factor: 1.0, powers: vec![(channel.to_string(), 1)] };
        for d in derive.iter().rev() {
            let Some(at) = out.powers.iter().position(|(name, _)| *name == d.name) else { continue };
            let (_, power) = out.powers.remove(at);
            out.factor *= d.factor.powi(power);
            for (name, p) in &d.powers {
                match out.powers.iter_mut().find(|(known, _)| known == name) {
                    Some((_, sum)) => *sum += p * power,
                    None => out.powers.push((name.clone(), p * power)),
                }
            }
            out.powers.retain(|(_, p)| *p != 0);
        }
        out
    }
}

impl std::fmt::Display for Derived {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(f, "{} = {}", self.name, self.factor)?;
        for (channel, power) in &self.powers {
            match power {
                1 => write!(f, " {channel}")?,
                p => write!(f, " {channel}^{p}")?,
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn derived(factor: f64, powers: &[(&str, i32)]) -> Derived {
        let powers = powers.iter().map(|(n, p)| (n.to_string(), *p)).collect();
        Derived { name: "d".into(), unit: "-".into(), factor, powers }
    }

    #[test]
    fn derivatives_agree_with_central_differences() {
        let d = derived(0.3, &[("a", 2), ("b", -3)]);
        let at = |a: f64, b: f64| d.value(|n| if n == "a" { a } else { b });
        let (a, b, h) = (1.7, -0.8, 1e-6);
        let of = |n: &str| if n == "a" { a } else { b };
        let expected = (at(a + h, b) - at(a - h, b)) / (2.0 * h);
        assert!((d.derivative("a", of) - expected).abs() < 1e-8);
        let expected = (at(a, b + h) - at(a, b - h)) / (2.0 * h);
        assert!((d.derivative("b", of) - expected).abs() < 1e-8);
        assert_eq!(d.derivative("c", of), 0.0);
        assert_eq!(derived(2.0, &[("a", 1)]).derivative("a", |_| 0.0), 2.0);
    }

    #[test]
    fn odd_powers_of_one_channel_are_inverted() {
        for power in [-3, -1, 1, 3] {
            let d = derived(-0.4, &[("a", power)]);
            for a in [-1.3, 0.7] {
                let back = d.inverted(d.value(|_| a)).unwrap();
                assert!((back - a).abs() < 1e-14, "{power}: {a} became {back}");
            }
        }
        assert_eq!(derived(1.0, &[("a", 2)]).inverted(4.0), None);
        assert_eq!(derived(1.0, &[("a", 1), ("b", 1)]).inverted(4.0), None);
    }

    #[test]
    fn a_value_that_is_no_number_is_named() {
        let channel = Channel {
            name: "a".into(),
            unit: "-".into(),
            role: Role::Input,
            values: vec![2.0, f64::NAN, 0.0],
        };
        let mut d = Dataset {
            name: "r".into(),
            sample_time_s: 1.0,
            channels: vec![channel],
            init_samples: 0,
            origin: String::new(),
        };
        let fault = derived(1.0, &[("a", -1)]).add_to(&mut d, Role::Input).unwrap_err().to_string();
        assert_eq!(fault, "r: `d` is inf at sample 2, where a = 0: expected a finite number");
        d.channels[0].values.pop();
        derived(1.0, &[("a", -1)]).add_to(&mut d, Role::Input).unwrap();
        assert!(d.channels[1].values[0] == 0.5 && d.channels[1].values[1].is_nan());
    }
}
