//! One measuring channel: transport, lag, drift, noise, quantisation.

use super::delay::DelayLine;
use super::dynamics::Lag;
use dynocal_numerics::rng::Rng64;
use serde::{Deserialize, Serialize};

/// What a channel does to a quantity, in this order. All zero: ideal.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SensorSettings {
    /// Constant transport delay \[s\].
    pub delay_s: f64,
    /// Gas between its source and the sensor \[g\]: a delay of this mass over the exhaust flow.
    pub transport_g: f64,
    /// Time constant of the sensor \[s\] (thermocouple, lambda sensor).
    pub lag_s: f64,
    /// Standard deviation of white noise \[unit\].
    pub noise: f64,
    /// Standard deviation that drift reaches \[unit\]: an Ornstein-Uhlenbeck process that starts at zero.
    pub drift: f64,
    /// Time constant of the drift \[s\].
    pub drift_s: f64,
    /// Step of the converter \[unit\]; readings are multiples of it.
    pub quantum: f64,
}

impl Default for SensorSettings {
    /// Ideal.
    fn default() -> Self {
        Self {
            delay_s: 0.0,
            transport_g: 0.0,
            lag_s: 0.0,
            noise: 0.0,
            drift: 0.0,
            drift_s: 600.0,
            quantum: 0.0,
        }
    }
}

/// Least exhaust flow for which a delay line of `transport_g` is exact \[g/s\].
pub const LEAST_FLOW_G_S: f64 = 0.5;

impl SensorSettings {
    /// Whether the channel has dynamics (drift, noise and quantisation act on samples alone).
    pub fn is_static(&self) -> bool {
        self.delay_s == 0.0 && self.transport_g == 0.0 && self.lag_s == 0.0
    }

    /// The channel at rest at `value`, for ticks of at least `tick_s`.
    pub fn at(&self, value: f64, tick_s: f64) -> SensorState {
        let line = |stretch: f64, least: f64| {
            (stretch > 0.0).then(|| DelayLine::new(stretch, (stretch / least).ceil() as usize + 3, value))
        };
        SensorState {
            delay: line(self.delay_s, 0.5 * tick_s),
            transport: line(self.transport_g, 0.5 * LEAST_FLOW_G_S * tick_s),
            lag: Lag::new(value),
            drift: 0.0,
            sum: 0.0,
            weight: 0.0,
            ticks: 0.0,
        }
    }
}

/// What moves in a channel.
#[derive(Debug, Clone, PartialEq)]
pub struct SensorState {
    delay: Option<DelayLine>,
    transport: Option<DelayLine>,
    lag: Lag,
    drift: f64,
    sum: f64,
    weight: f64,
    ticks: f64,
}

impl SensorState {
    /// One tick: `value` is the mean of the quantity over `h_s` at an exhaust flow of `flow_g_s`.
    pub fn tick(&mut self, settings: &SensorSettings, value: f64, flow_g_s: f64, h_s: f64) {
        let mut x = value;
        if let Some(line) = &mut self.transport {
            // Backflow stops the gas on its way, it does not turn it round.
            x = line.push(x, flow_g_s.max(0.0) * h_s);
        }
        if let Some(line) = &mut self.delay {
            x = line.push(x, h_s);
        }
        x = self.lag.step(x, settings.lag_s, h_s);
        self.sum += x * h_s;
        self.weight += h_s;
        self.ticks += 1.0;
    }

    /// Reading at the end of a sample of `dt_s`, before the converter: the mean over it, or its last value, with drift
    /// and noise from the stream `(seed, number)`.
    pub fn read(&mut self, settings: &SensorSettings, mean: bool, stream: (u64, u64), dt_s: f64) -> f64 {
        // A single tick is its own mean, exactly.
        let mut x = if mean && self.ticks > 1.0 { self.sum / self.weight } else { self.lag.value };
        (self.sum, self.weight, self.ticks) = (0.0, 0.0, 0.0);
        if settings.drift > 0.0 || settings.noise > 0.0 {
            let mut rng = Rng64::stream(stream.0, stream.1);
            let keep = (-dt_s / settings.drift_s).exp();
            self.drift = keep * self.drift + settings.drift * (1.0 - keep * keep).sqrt() * rng.normal();
            x += self.drift + settings.noise * rng.normal();
        }
        x
    }

    /// Present value behind the lag.
    pub fn value(&self) -> f64 {
        self.lag.value
    }

    pub(crate) fn visit(&mut self, f: &mut impl FnMut(&mut f64)) {
        for line in [&mut self.delay, &mut self.transport].into_iter().flatten() {
            line.visit(f);
        }
        [&mut self.lag.value, &mut self.drift, &mut self.sum, &mut self.weight, &mut self.ticks]
            .into_iter()
            .for_each(&mut *f);
    }
}

/// The nearest multiple of `quantum`; `x` itself without one.
///
/// ```
/// use dynocal_plant::testbed::sensor::quantise;
/// assert_eq!(quantise(1.26, 0.5), 1.5);
/// assert_eq!(quantise(1.26, 0.0), 1.26);
/// ```
pub fn quantise(x: f64, quantum: f64) -> f64 {
    if quantum > 0.0 { (x / quantum).round() * quantum } else { x }
}
