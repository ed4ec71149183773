//! The oxygen in a catalyst, estimated from the lambda before it, and a trim of that lambda that holds it at a target.
//!
//! ```text
//! dO/dt = 0.23 m_air (1 - 1/lambda) + bias m_air,    0 <= O <= C(m_air),   C = C0 / (1 + m_air / m_half)
//! behind the brick lambda leaves 1 when the store is full (lean) or empty (rich): then O is known
//! trim = clip(k (target - O / C)) - bias / 0.23
//! ```
//!
//! The bias stands for an error of the front sensor, which the integrator would add up: whatever the store was thought to hold
//! when it broke through, over the air since it was last known, is the bias that explains it; a stated share of that is learnt, up to
//! what the trim can take off. Before the first break-through nobody knows what the store holds: that one says nothing of the bias.
//! With a memory the capacity is estimated beside the bias: from one end to the next
//!
//! ```text
//! sum 0.23 m_air (1 - 1/lambda) dt = g C0 - bias sum m_air dt,    g = e_now - e_before,   e = 1 / (1 + m_air / m_half) full, 0 empty
//! ```
//!
//! is one equation; least squares over the last ones, what is given for C0 and no bias being the equations before the first.
//! A break-through is counted when the rear sensor leaves its band: the score of a controller. (Form of the store: E. P. Brandt,
//! Y. Wang, J. W. Grizzle, IEEE Trans. Control Systems Technology 8 (2000) 767-776.)

use serde::{Deserialize, Serialize};

use crate::error::ControlError;

/// Lambda that no flame has: below it the front sensor shows nothing.
pub const LEAST_LAMBDA: f64 = 0.3;
/// Air in g since the store was last known, without which a break-through says nothing of the bias.
pub const LEAST_AIR_G: f64 = 1e-6;
/// Mass fraction of oxygen in air, as the balance takes it.
pub const OXYGEN: f64 = 0.23;

/// What is known of a catalyst and its sensors.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OxygenSettings {
    /// Oxygen that it stores without flow in g.
    pub capacity_g: f64,
    /// Flow of air in g/s at which half of it is usable; infinite: always all.
    pub half_g_s: f64,
    /// Band of the rear lambda about 1 outside of which the store is full or empty.
    pub rear_band: f64,
    /// Filling that is held.
    pub target: f64,
    /// Trim of lambda for a filling that is wrong by all of the store.
    pub gain: f64,
    /// Largest trim of lambda either way.
    pub most: f64,
    /// Share of the bias that a break-through shows that is learnt, 0 to 1.
    pub learn: f64,
    /// Passages from one end of the store to the next over which capacity and bias are estimated together; 0: the capacity is
    /// `capacity_g`, the bias is learnt by `learn`.
    #[serde(default)]
    pub memory: f64,
}

/// What passages from one end of the store to the next say: least squares of capacity and bias.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Passages {
    /// Products of the regressors `g`, `-air_g`: own, mixed, own.
    pub normal: [f64; 3],
    /// Products with what the front sensor says was taken.
    pub right: [f64; 2],
    /// Capacity without flow in g.
    pub capacity_g: f64,
    /// Where the store was last known: usable share of the capacity when full, 0 empty; none before the first end.
    pub end: Option<f64>,
    /// Oxygen in g by the front sensor since.
    pub taken_g: f64,
}

/// What the observer remembers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct OxygenState {
    /// Oxygen in g.
    pub oxygen_g: f64,
    /// Bias of the front sensor in g of oxygen for each g of air.
    pub bias: f64,
    /// Air in g since the store was last known.
    pub air_g: f64,
    /// Whether the rear sensor was outside of its band.
    pub outside: bool,
    /// Break-throughs, lean and rich.
    pub breaks: [u32; 2],
    /// Capacity and bias together.
    pub passages: Passages,
}

/// Observer and rear trim.
///
/// ```
/// use dynocal_control::oxygen::{OxygenObserver, OxygenSettings};
/// // 1 g of store, 10 g/s of air at lambda 1.05: empty to full in 9.13 s.
/// let s = OxygenSettings { capacity_g: 1.0, half_g_s: f64::INFINITY, rear_band: 0.01, target: 0.5, gain: 0.02, most: 0.02, learn: 0.3, memory: 0.0 };
/// let mut store = OxygenObserver::new(s, 0.0)?;
/// let mut time_s = 0.0;
/// while store.filling(10.0) < 1.0 {
///     store.step(1.05, 1.0, 10.0, 0.01);
///     time_s += 0.01;
/// }
/// assert!((time_s - 9.13f64).abs() < 0.011);
/// # Ok::<(), dynocal_control::error::ControlError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OxygenObserver {
    settings: OxygenSettings,
    state: OxygenState,
}

impl OxygenObserver {
    /// A store of which `filling` is thought to be full.
    ///
    /// # Errors
    /// [`ControlError::Number`]: settings that cannot be.
    pub fn new(settings: OxygenSettings, filling: f64) -> Result<Self, ControlError> {
        let s = settings;
        let positive = [("capacity_g", s.capacity_g), ("half_g_s", s.half_g_s), ("rear_band", s.rear_band)];
        for (what, v) in positive {
            if !(v > 0.0) || (what == "capacity_g" && !v.is_finite()) {
                return Err(ControlError::number(what, v, "a positive number"));
            }
        }
        for (what, v) in [("target", s.target), ("learn", s.learn), ("filling", filling)] {
            if !(0.0..=1.0).contains(&v) {
                return Err(ControlError::number(what, v, "0 to 1"));
            }
        }
        for (what, v) in [("gain", s.gain), ("most", s.most), ("memory", s.memory)] {
            if !(v >= 0.0 && v.is_finite()) {
                return Err(ControlError::number(what, v, "0 or a positive number"));
            }
        }
        let oxygen_g = filling * s.capacity_g;
        let passages = Passages::before_any(s.capacity_g);
        let state = OxygenState { oxygen_g, bias: 0.0, air_g: 0.0, outside: false, breaks: [0; 2], passages };
        Ok(Self { settings, state })
    }

    /// What the store holds at most at a flow of air in g/s.
    pub fn capacity_g(&self, air_g_s: f64) -> f64 {
        self.state.passages.capacity_g * self.usable(air_g_s)
    }

    /// Share of the store that a flow of air in g/s leaves usable.
    fn usable(&self, air_g_s: f64) -> f64 {
        1.0 / (1.0 + air_g_s.max(0.0) / self.settings.half_g_s)
    }

    /// Share of the store that is full, 0 to 1.
    pub fn filling(&self, air_g_s: f64) -> f64 {
        (self.state.oxygen_g / self.capacity_g(air_g_s)).clamp(0.0, 1.0)
    }

    /// Trim of the demanded lambda after a sample of `dt_s` with the lambdas before and behind and the flow of air in g/s.
    /// Sensors that show no number leave it what it is.
    pub fn step(&mut self, front: f64, rear: f64, air_g_s: f64, dt_s: f64) -> f64 {
        let s = self.settings;
        if front.is_finite() && front > LEAST_LAMBDA && air_g_s.is_finite() {
            let air_g = air_g_s.max(0.0) * dt_s;
            let capacity_g = self.capacity_g(air_g_s);
            let told = OXYGEN * (1.0 - 1.0 / front) * air_g;
            self.state.oxygen_g =
                (self.state.oxygen_g + told + self.state.bias * air_g).clamp(0.0, capacity_g);
            self.state.air_g += air_g;
            self.state.passages.taken_g += told;
            if rear.is_finite() {
                self.seen(rear, self.usable(air_g_s));
            }
        }
        let held = (s.gain * (s.target - self.filling(air_g_s))).clamp(-s.most, s.most);
        (held - self.state.bias / OXYGEN).clamp(-2.0 * s.most, 2.0 * s.most)
    }

    /// The rear sensor: a store that breaks through is full or empty.
    fn seen(&mut self, rear: f64, usable: f64) {
        let outside = (rear - 1.0).abs() > self.settings.rear_band;
        if outside {
            let lean = rear > 1.0;
            let end = if lean { usable } else { 0.0 };
            if !self.state.outside {
                self.state.breaks[usize::from(!lean)] += 1;
                if self.settings.memory > 0.0 {
                    let (capacity_g, bias) = (self.settings.capacity_g, self.state.bias);
                    let air_g = self.state.air_g;
                    self.state.bias =
                        self.state.passages.ended(end, air_g, self.settings.memory, capacity_g, bias);
                } else if self.state.passages.end.is_some() && self.state.air_g > LEAST_AIR_G {
                    let known_g = self.state.passages.capacity_g * end;
                    let shown = (known_g - self.state.oxygen_g) / self.state.air_g;
                    let most = 2.0 * self.settings.most * OXYGEN;
                    self.state.bias = (self.state.bias + self.settings.learn * shown).clamp(-most, most);
                }
            }
            let passages = &mut self.state.passages;
            (passages.end, passages.taken_g) = (Some(end), 0.0);
            (self.state.oxygen_g, self.state.air_g) = (passages.capacity_g * end, 0.0);
        }
        self.state.outside = outside;
    }

    /// What it remembers.
    pub fn state(&self) -> OxygenState {
        self.state
    }

    /// Goes on from a saved state.
    pub fn restore(&mut self, state: OxygenState) {
        self.state = state;
    }
}

/// What is known before the first passage: the capacity to half of itself, the bias to a hundredth of the oxygen; a passage tells the
/// sum to a tenth of the capacity.
const KNOWN: (f64, f64, f64) = (0.5, 0.01, 0.1);
/// Least capacity as a share of the one that is given: a store that has died is not divided by.
const LEAST: f64 = 0.05;

impl Passages {
    fn before_any(capacity_g: f64) -> Self {
        Self { normal: [0.0; 3], right: [0.0; 2], capacity_g, end: None, taken_g: 0.0 }
    }

    /// At an end after `air_g`: takes the passage in and gives the bias.
    fn ended(&mut self, end: f64, air_g: f64, memory: f64, given_g: f64, bias: f64) -> f64 {
        let Some(before) = self.end else { return bias };
        let (keep, x) = (1.0 - 1.0 / (1.0 + memory), [end - before, -air_g]);
        for (k, v) in [x[0] * x[0], x[0] * x[1], x[1] * x[1]].into_iter().enumerate() {
            self.normal[k] = keep * self.normal[k] + v;
        }
        (0..2).for_each(|k| self.right[k] = keep * self.right[k] + x[k] * self.taken_g);
        let noise = (KNOWN.2 * given_g).powi(2);
        let known = [noise / (KNOWN.0 * given_g).powi(2), noise / (KNOWN.1 * OXYGEN).powi(2)];
        let [a, b, c] = [self.normal[0] + known[0], self.normal[1], self.normal[2] + known[1]];
        let r = [self.right[0] + known[0] * given_g, self.right[1]];
        let det = a * c - b * b;
        if !(det > 0.0) {
            return bias;
        }
        self.capacity_g = ((c * r[0] - b * r[1]) / det).max(LEAST * given_g);
        (a * r[1] - b * r[0]) / det
    }
}
