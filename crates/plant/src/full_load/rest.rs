//! Whether a point rests although its controller still turns the wastegate.

use crate::outputs::Outputs;

/// Time that is looked at before the end of what is allowed \[s\].
const LAST_S: f64 = 10.0;
/// What may lie between the ends of each: torque \[Nm\], intake pressure \[kPa\], exhaust \[K\], share of the shaft's speed. Torque and exhaust as the
/// controller takes them for still, pressure of half as much torque as it counts for it.
const MOST: [f64; 4] = [0.3, 0.1, 2.0, 2e-3];

/// What the wastegate has to move by meanwhile \[mm\]: of one that hardly turns, nothing follows.
const TURNED_MM: f64 = 0.1;

/// Least and largest values over the last seconds of a point.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Span {
    ends: Option<[(f64, f64); 5]>,
    longest_s: f64,
}

impl Span {
    /// Takes a cycle, `left_s` before the time is over.
    pub(super) fn see(&mut self, left_s: f64, y: &Outputs, wastegate_mm: f64) {
        if left_s > LAST_S {
            return;
        }
        self.longest_s = self.longest_s.max(left_s);
        let now = [y.torque_cycle_nm, y.map_kpa, y.egt_k, y.turbo_rpm, wastegate_mm];
        let ends = self.ends.get_or_insert(now.map(|v| (v, v)));
        for (end, v) in ends.iter_mut().zip(now) {
            *end = (end.0.min(v), end.1.max(v));
        }
    }

    /// Whether nothing moved but the wastegate, which, shut at what torque answered to it, would not make the `missing_nm` either; a time
    /// that was shorter than what is looked at does not tell.
    pub(super) fn rests(&self, missing_nm: f64) -> bool {
        let Some(ends) = self.ends else { return false };
        let shaft = MOST[3] * ends[3].1;
        let most = [MOST[0], MOST[1], MOST[2], shaft];
        let turned_mm = ends[4].1 - ends[4].0;
        let answered_nm = (ends[0].1 - ends[0].0) / turned_mm.max(f64::MIN_POSITIVE) * ends[4].0;
        let spent = turned_mm >= TURNED_MM && answered_nm < missing_nm;
        self.longest_s > 0.9 * LAST_S && spent && ends.iter().zip(most).all(|(e, m)| e.1 - e.0 <= m)
    }
}
