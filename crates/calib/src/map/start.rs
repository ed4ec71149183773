//! Start inputs of an optimisation: loop-driven actuators that roughly give a reference at given values of the others.
//!
//! A structured inverse of measured records, whose given channels are the operating channels and the inputs that no loop
//! drives. It only has to be close: the demand of the optimisation is the models' own response to it.

use super::structured::{StructuredMap, StructuredShape};
use super::structures::{MapError, Pairs};
use super::{ActuatorPort, Port, Ports, Rows};

/// A fitted start rule.
#[derive(Clone, Debug)]
pub struct StartRule {
    map: StructuredMap,
}

/// Offsets of the leading demand that the rule looks ahead, in samples.
const AHEAD: [i32; 3] = [2, 4, 7];

impl StartRule {
    /// Fits the rule on measured records: rows of (demanded outputs, given channels, free inputs) and rows of the driven
    /// actuators.
    ///
    /// # Errors
    /// [`MapError`].
    pub fn fit(
        demands: &[Port],
        given: &[Port],
        free: &[Port],
        driven: &[ActuatorPort],
        records: &[(Rows, Rows)],
    ) -> Result<Self, MapError> {
        let ports = Ports {
            demands: demands.to_vec(),
            given: given.iter().chain(free).cloned().collect(),
            actuators: driven.to_vec(),
        };
        let mut shape = StructuredShape {
            look_ahead: 0,
            ridge: Some(1e-7),
            steady_weight: 1.0,
            ..StructuredShape::default()
        };
        for (k, port) in ports.references().enumerate() {
            shape.offsets.insert(port.name.clone(), if k == 0 { AHEAD.to_vec() } else { Vec::new() });
        }
        let pairs: Vec<Pairs> =
            records.iter().map(|(response, actuators)| Pairs { response, actuators }).collect();
        Ok(Self { map: StructuredMap::fit(&shape, &ports, &pairs)? })
    }

    /// Driven actuators along rows of (demands, given channels, free inputs).
    pub fn drive(&self, reference: &Rows) -> Rows {
        let width = self.map.ports.actuators.len();
        let mut out = Rows::from_values(width, vec![0.0; reference.len() * width]);
        for t in 0..reference.len() {
            self.map.at(reference, t, out.row_mut(t));
        }
        out
    }
}

/// `target` approached with at most `rate` per sample: a start that respects the limit of the optimisation.
pub fn rate_limited(target: &[f64], rate: f64) -> Vec<f64> {
    let mut now = target.first().copied().unwrap_or(0.0);
    target
        .iter()
        .map(|t| {
            now += (t - now).clamp(-rate, rate);
            now
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rate_limit_holds_and_reaches_the_target() {
        let target: Vec<f64> = (0..200).map(|t| if t < 50 { 5.0 } else { 30.0 }).collect();
        let y = rate_limited(&target, 0.8);
        assert!(y.windows(2).all(|w| (w[1] - w[0]).abs() <= 0.8 + 1e-12));
        assert_eq!(y[199], 30.0);
    }

    /// A rule that leads the response is found from records in which free inputs move too.
    #[test]
    fn finds_a_rule_that_looks_ahead_and_compensates_a_free_input() {
        let port = |name: &str| Port { name: name.into(), unit: "-".into() };
        let driven = ActuatorPort { name: "u".into(), unit: "-".into(), lower: -1e3, upper: 1e3 };
        let record = |phase: f64| {
            let mut rows = Rows::new(3);
            for t in 0..600 {
                let t = t as f64 * 0.05 + phase;
                rows.push(&[5.0 + (1.3 * t).sin(), 20.0 + 5.0 * (0.4 * t).cos(), 3.0 * (2.1 * t).sin()]);
            }
            let u = (0..600)
                .flat_map(|t| {
                    let r = rows.row(t);
                    let ahead = rows.row((t + 4).min(599))[0] - r[0];
                    [2.0 * r[0] + 0.1 * r[0] * r[1] + 0.5 * r[2] + 3.0 * ahead]
                })
                .collect();
            (rows, Rows::from_values(1, u))
        };
        let (known, unseen) = (record(0.0), record(40.0));
        let rule = StartRule::fit(&[port("y")], &[port("n")], &[port("s")], &[driven], &[known]).unwrap();
        let found = rule.drive(&unseen.0);
        for t in 10..550 {
            assert!((found.row(t)[0] - unseen.1.row(t)[0]).abs() < 0.02, "{t}");
        }
    }
}
