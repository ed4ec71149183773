//! Whether a point moves although its controller still turns something.

use crate::outputs::Outputs;

/// Time that is looked at before the end of what is allowed \[s\].
const LAST_S: f64 = 10.0;
/// What may lie between the ends of each: torque \[Nm\], intake pressure \[kPa\], exhaust \[K\], share of the shaft's speed. Torque and exhaust as the
/// controller takes them for still, pressure of half as much torque as it counts for it.
const MOST: [f64; 4] = [0.3, 0.1, 2.0, 2e-3];

/// Least and largest values over the last seconds of a point.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Span {
    ends: Option<[(f64, f64); 4]>,
    longest_s: f64,
}

impl Span {
    /// Takes a cycle, `left_s` before the time is over.
    pub(super) fn see(&mut self, left_s: f64, y: &Outputs) {
        if left_s > LAST_S {
            return;
        }
        self.longest_s = self.longest_s.max(left_s);
        let now = [y.torque_cycle_nm, y.map_kpa, y.egt_k, y.turbo_rpm];
        let ends = self.ends.get_or_insert(now.map(|v| (v, v)));
        for (end, v) in ends.iter_mut().zip(now) {
            *end = (end.0.min(v), end.1.max(v));
        }
    }

    /// Whether nothing moved; a time that was shorter than what is looked at does not tell.
    pub(super) fn rests(&self) -> bool {
        let Some(ends) = self.ends else { return false };
        let shaft = MOST[3] * ends[3].1;
        let most = [MOST[0], MOST[1], MOST[2], shaft];
        self.longest_s > 0.9 * LAST_S && ends.iter().zip(most).all(|(e, m)| e.1 - e.0 <= m)
    }
}
