//! Lags and films over a whole record: one after the other in time, with what decays between samples computed once.

use rayon::prelude::*;

use super::Products;
use crate::graph::Op;
use crate::graph::forward::left;

/// Share of a state that is left after each sample, and its derivative with respect to the time constant.
pub(super) type Decay = Vec<[f64; 2]>;

/// Decays at the time constants `tau`, s.
pub(super) fn decay(time_s: &[f64], tau: &[f64]) -> Decay {
    let at = |t: usize| left(if t == 0 { 0.0 } else { time_s[t] - time_s[t - 1] }, tau[t]).into();
    (0..time_s.len()).into_par_iter().map(at).collect()
}

impl Products<'_> {
    /// Decays of all lags and films between labels and output.
    pub(super) fn find_decays(&mut self) {
        for k in (0..self.graph.nodes.len()).filter(|k| self.stage[*k].is_some()) {
            if let Op::Lag(_, tau) | Op::Film(_, _, tau) = self.graph.nodes[k].op {
                self.decays[k] = decay(self.record.time_s, &self.run.values[tau]);
            }
        }
    }

    /// Derivative of node `k` in the direction of which `d` has those of the nodes before; whether it is one of these nodes.
    pub(super) fn remember_forward(&self, k: usize, d: &[Vec<f64>], dy: &mut [f64]) -> bool {
        let values = &self.run.values;
        match self.graph.nodes[k].op {
            _ if dy.is_empty() => return true,
            Op::Lag(x, tau) => {
                let (y, u, du, dtau) = (&values[k], &values[x], &d[x], &d[tau]);
                dy[0] = du[0];
                for t in 1..dy.len() {
                    let [a, by_tau] = self.decays[k][t];
                    dy[t] = a * dy[t - 1] + (1.0 - a) * du[t - 1] + by_tau * (y[t - 1] - u[t - 1]) * dtau[t];
                }
            }
            Op::Film(f, share, tau) => {
                let (fuel, s, tau_s, m) = (&values[f], &values[share], &values[tau], &self.run.film[k]);
                let (df, ds, dtau) = (&d[f], &d[share], &d[tau]);
                let mut dm = 0.0;
                for t in 0..dy.len() {
                    dm = if t == 0 {
                        (ds[0] * fuel[0] + s[0] * df[0]) * tau_s[0] + s[0] * fuel[0] * dtau[0]
                    } else {
                        let [a, by_tau] = self.decays[k][t];
                        let moved = ds[t - 1] * fuel[t - 1] + s[t - 1] * df[t - 1];
                        let held = s[t - 1] * fuel[t - 1] * (1.0 - a - tau_s[t] * by_tau);
                        dm * a + moved * tau_s[t] * (1.0 - a) + (m[t - 1] * by_tau + held) * dtau[t]
                    };
                    dy[t] =
                        (1.0 - s[t]) * df[t] - ds[t] * fuel[t] + (dm - m[t] / tau_s[t] * dtau[t]) / tau_s[t];
                }
            }
            _ => return false,
        }
        true
    }

    /// What reaches node `k` goes on to the nodes that enter it; whether it is one of these nodes.
    pub(super) fn remember_backward(&self, k: usize, bar: &mut [Vec<f64>]) -> bool {
        let values = &self.run.values;
        let (before, own) = bar.split_at_mut(k);
        let own = &mut own[0];
        match self.graph.nodes[k].op {
            _ if own.is_empty() => return true,
            Op::Lag(x, tau) => {
                let (y, u) = (&values[k], &values[x]);
                for t in (1..own.len()).rev() {
                    let (g, [a, by_tau]) = (own[t], self.decays[k][t]);
                    before[x][t - 1] += g * (1.0 - a);
                    before[tau][t] += g * by_tau * (y[t - 1] - u[t - 1]);
                    own[t - 1] += g * a;
                }
                before[x][0] += own[0];
            }
            Op::Film(f, share, tau) => {
                let (fuel, s, tau_s, m) = (&values[f], &values[share], &values[tau], &self.run.film[k]);
                let mut state = 0.0;
                for t in (0..own.len()).rev() {
                    let g = own[t];
                    before[share][t] -= g * fuel[t];
                    before[f][t] += g * (1.0 - s[t]);
                    before[tau][t] -= g * m[t] / (tau_s[t] * tau_s[t]);
                    state += g / tau_s[t];
                    if t == 0 {
                        before[share][0] += state * fuel[0] * tau_s[0];
                        before[f][0] += state * s[0] * tau_s[0];
                        before[tau][0] += state * s[0] * fuel[0];
                        continue;
                    }
                    let [a, by_tau] = self.decays[k][t];
                    let held = s[t - 1] * fuel[t - 1] * (1.0 - a - tau_s[t] * by_tau);
                    before[share][t - 1] += state * fuel[t - 1] * tau_s[t] * (1.0 - a);
                    before[f][t - 1] += state * s[t - 1] * tau_s[t] * (1.0 - a);
                    before[tau][t] += state * (m[t - 1] * by_tau + held);
                    state *= a;
                }
            }
            _ => return false,
        }
        true
    }
}
