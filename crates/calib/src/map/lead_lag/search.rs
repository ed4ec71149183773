//! Search of the dynamics: lag, its powers of both axes and lead of each actuator, by what a judge says of the map.

use super::super::Judge;
use super::{LagLaw, LeadLagMap, PAYS};

/// Longest lag that is looked for, in s.
pub(super) const LONGEST_S: f64 = 0.6;
/// Steps of the line search of the lag that all followers share at first.
pub(super) const STEPS: u32 = 30;
/// Times that the steps of the search of each actuator's own dynamics are halved.
const HALVINGS: u32 = 4;

impl LeadLagMap {
    /// The table of lags of a law.
    pub(super) fn lags(&self, law: &LagLaw) -> Vec<f64> {
        let middle = |axis: &[f64]| 0.5 * (axis[0] + axis[axis.len() - 1]);
        let (t0, n0) = (middle(&self.demand), middle(&self.given));
        // A channel that reaches zero or changes its sign has no powers.
        let power = |ratio: f64, p: f64| if ratio > 0.0 && ratio.is_finite() { ratio.powf(p) } else { 1.0 };
        let cells = self.demand.iter().flat_map(|t| self.given.iter().map(move |n| (*t, *n)));
        cells
            .map(|(t, n)| {
                let tau = law.tau_s * power(n0 / n, law.by_given) * power(t / t0, law.by_demand);
                tau.clamp(0.0, 2.0 * LONGEST_S)
            })
            .collect()
    }

    /// Actuators that do not lead.
    pub(super) fn followers(&self, leader: usize) -> Vec<usize> {
        (0..self.actuators.len()).filter(|c| *c != leader).collect()
    }

    /// One lag of all that follow, inverse to the given channel, by a line search from 0 to 0.6 s: what it costs, and the map. None where
    /// nothing of it can be judged.
    pub(super) fn one_lag(&self, judge: Judge, followers: &[usize]) -> Option<(f64, Self)> {
        let mut best = (f64::INFINITY, self.clone());
        for k in 0..=STEPS {
            let law = LagLaw { tau_s: LONGEST_S * f64::from(k) / f64::from(STEPS), ..LagLaw::NONE };
            let map = self.with(&followers.iter().map(|c| (*c, law)).collect::<Vec<_>>());
            let value = judge(&map);
            if value < best.0 {
                best = (value, map);
            }
        }
        best.0.is_finite().then_some(best)
    }

    /// From a map and what it costs: dynamics of some actuators, each with the most of its lead, by steps that are halved.
    pub(super) fn searched(mut best: (f64, Self), judge: Judge, actuators: &[(usize, f64)]) -> (f64, Self) {
        for halving in 0..HALVINGS {
            for &(c, most_lead) in actuators {
                let size = 0.5f64.powi(halving as i32);
                for law in neighbours(best.1.actuators[c].law, size, most_lead) {
                    let map = best.1.with(&[(c, law)]);
                    let value = judge(&map);
                    if value < (1.0 - PAYS) * best.0 {
                        best = (value, map);
                    }
                }
            }
        }
        best
    }

    /// The map with other dynamics of some actuators.
    pub(super) fn with(&self, laws: &[(usize, LagLaw)]) -> Self {
        let mut map = self.clone();
        for (c, law) in laws {
            map.actuators[*c].lag_s = self.lags(law);
            map.actuators[*c].law = *law;
        }
        map
    }
}

/// Changes of a law that the search tries, at steps of `size` (1, then halves of it), up to a lead.
fn neighbours(law: LagLaw, size: f64, most_lead: f64) -> impl Iterator<Item = LagLaw> {
    let changes = [(0.03, 0.0, 0.0, 0.0), (0.0, 0.4, 0.0, 0.0), (0.0, 0.0, 0.2, 0.0), (0.0, 0.0, 0.0, 0.2)];
    changes.into_iter().flat_map(move |(tau, given, demand, lead)| {
        [size, -size].map(|s| LagLaw {
            tau_s: (law.tau_s + s * tau).clamp(0.0, LONGEST_S),
            by_given: (law.by_given + s * given).clamp(-1.0, 3.0),
            by_demand: (law.by_demand + s * demand).clamp(-1.0, 1.0),
            lead: (law.lead + s * lead).clamp(0.0, most_lead),
        })
    })
}
