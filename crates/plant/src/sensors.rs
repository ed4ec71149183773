//! Seeded white sensor noise, separate from the engine: noise never alters the state of the engine.

use dynocal_numerics::rng::Rng64;
use serde::{Deserialize, Serialize};

/// Standard deviations of the white noise of each sensor.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NoiseLevels {
    /// Torque \[Nm\].
    pub torque_nm: f64,
    /// Lambda \[-\].
    pub lambda: f64,
}

/// Noise source: sample number n of a seed is always the same number, whatever was drawn before.
#[derive(Debug, Clone)]
pub struct SensorNoise {
    levels: NoiseLevels,
    seed: u64,
    samples: u64,
}

impl SensorNoise {
    /// Noise with the given levels and seed.
    pub fn new(levels: NoiseLevels, seed: u64) -> Self {
        Self { levels, seed, samples: 0 }
    }

    /// Start over with `seed`.
    pub fn reset(&mut self, seed: u64) {
        self.seed = seed;
        self.samples = 0;
    }

    /// Seed and number of samples drawn.
    pub fn position(&self) -> (u64, u64) {
        (self.seed, self.samples)
    }

    /// Continue at a position given by [`Self::position`].
    pub fn set_position(&mut self, seed: u64, samples: u64) {
        self.seed = seed;
        self.samples = samples;
    }

    /// Noise of torque \[Nm\] and lambda \[-\] for the next sample.
    pub fn next_sample(&mut self) -> (f64, f64) {
        self.samples += 1;
        if self.levels == NoiseLevels::default() {
            return (0.0, 0.0);
        }
        // A stream of its own per sample makes the position a plain number that can be saved.
        let mut rng = Rng64::stream(self.seed, self.samples);
        let torque = self.levels.torque_nm * rng.normal();
        (torque, self.levels.lambda * rng.normal())
    }
}
