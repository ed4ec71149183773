//! Transport delay: what enters leaves after a given stretch of a coordinate that only grows, time or transported mass.
//!
//! With s = t the delay is constant. With s = integral of the mass flow the line is a plug flow of constant content M:
//! y(t) = u(t_0) with the integral of the flow from t_0 to t equal to M, so that the delay is M/flow when the flow is
//! constant and follows exactly when it is not.

/// A delay line; inputs are held between calls.
#[derive(Debug, Clone, PartialEq)]
pub struct DelayLine {
    stretch: f64,
    /// Coordinate at which each value began, and the value; a ring.
    ring: Vec<(f64, f64)>,
    /// Oldest entry that may still be needed, and number of entries in use.
    head: usize,
    used: usize,
    s: f64,
}

impl DelayLine {
    /// A line of `stretch` (seconds, or kilograms) filled with `value`. It holds `capacity` inputs: stretch over the
    /// least advance of a step, and two; with less flow the oldest inputs are lost.
    pub fn new(stretch: f64, capacity: usize, value: f64) -> Self {
        let mut ring = vec![(0.0, value); capacity.max(2)];
        ring[0] = (f64::NEG_INFINITY, value);
        Self { stretch, ring, head: 0, used: 1, s: 0.0 }
    }

    /// Empties the line and fills it with `value`.
    pub fn fill(&mut self, value: f64) {
        self.ring.fill((0.0, value));
        self.ring[0] = (f64::NEG_INFINITY, value);
        (self.head, self.used, self.s) = (0, 1, 0.0);
    }

    /// Holds `value` while the coordinate advances by `advance` (s or kg, not negative); returns what leaves at the end.
    ///
    /// ```
    /// use dynocal_plant::testbed::delay::DelayLine;
    /// let mut line = DelayLine::new(0.03, 8, 0.0);
    /// let y: Vec<f64> = (1..=6).map(|k| line.push(f64::from(k), 0.01)).collect();
    /// assert_eq!(y, [0.0, 0.0, 1.0, 2.0, 3.0, 4.0]);
    /// ```
    pub fn push(&mut self, value: f64, advance: f64) -> f64 {
        let n = self.ring.len();
        if advance > 0.0 {
            if self.used == n {
                self.head = (self.head + 1) % n;
                self.used -= 1;
            }
            self.ring[(self.head + self.used) % n] = (self.s, value);
            self.used += 1;
            self.s += advance;
        }
        // Sums of steps carry rounding: a value that begins within it has arrived.
        let at = self.s - self.stretch + 1e-9 * self.stretch;
        while self.used > 1 && self.ring[(self.head + 1) % n].0 <= at {
            self.head = (self.head + 1) % n;
            self.used -= 1;
        }
        let out = self.ring[self.head].1;
        // The coordinate starts over before it grows so large that differences lose digits.
        if self.s > 1e4 * self.stretch.max(1e-12) {
            self.ring.iter_mut().for_each(|e| e.0 -= self.s);
            self.s = 0.0;
        }
        out
    }

    /// Visits every number in a fixed order.
    pub(crate) fn visit(&mut self, f: &mut impl FnMut(&mut f64)) {
        for (s, value) in &mut self.ring {
            // The first entry has always begun; a saved state holds finite numbers.
            let mut begun = s.max(-1e300);
            f(&mut begun);
            *s = begun;
            f(value);
        }
        f(&mut self.s);
        for index in [&mut self.head, &mut self.used] {
            let mut x = *index as f64;
            f(&mut x);
            // A foreign state must not point outside the ring.
            *index = (x.max(0.0) as usize).min(self.ring.len());
        }
        self.head %= self.ring.len();
        self.used = self.used.max(1);
    }
}
