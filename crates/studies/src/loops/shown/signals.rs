//! Rival records: signals of the library over all channels of a bed.

use dynocal_ident::signal::signal;
use dynocal_numerics::rng::Rng64;
use serde::{Deserialize, Serialize};

use dynocal_calib::loops::LoopError;
use dynocal_calib::loops::bed::TestBed;

/// A kind of record that is not designed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// Uniformly distributed random numbers, one per sample.
    Udrn,
    /// Two levels from a shift register, one bit per sample.
    Prbs,
    /// Random levels, each held.
    Aprbs {
        /// Number of levels.
        levels: usize,
        /// Samples at each.
        hold: usize,
    },
    /// Low-discrepancy levels that fill the box of all channels, held and joined by ramps.
    SpaceFilling {
        /// Samples at each level.
        hold: usize,
        /// Samples from level to level.
        ramp: usize,
    },
}

impl Kind {
    /// Name in tables.
    pub fn name(self) -> String {
        match self {
            Kind::Udrn => "UDRN".into(),
            Kind::Prbs => "PRBS".into(),
            Kind::Aprbs { levels, hold } => format!("APRBS, {levels} levels, hold {hold}"),
            Kind::SpaceFilling { hold, ramp } => format!("space-filling, hold {hold}, ramp {ramp}"),
        }
    }

    /// `samples` rows (N x m) over the channels of `bed`, within their amplitudes.
    ///
    /// # Errors
    /// [`LoopError::Build`] when the numbers do not fit the signal.
    pub fn record(self, bed: &TestBed, samples: usize, rng: &mut Rng64) -> Result<Vec<f64>, LoopError> {
        let (m, dt) = (bed.channels.len(), bed.sample_time_s);
        let mut u = vec![0.0; samples * m];
        let mut column = vec![0.0; samples];
        for (i, c) in bed.channels.iter().enumerate() {
            let mut keys = toml::Table::new();
            let mut set = |key: &str, v: f64| keys.insert(key.into(), toml::Value::Float(v));
            set("lo", c.lower);
            set("hi", c.upper);
            let (name, whole) = match self {
                Kind::Udrn => {
                    set("hold_s", dt);
                    ("udrn", vec![])
                }
                Kind::Prbs => {
                    set("hold_s", dt);
                    ("prbs", vec![("order", 9)])
                }
                Kind::Aprbs { levels, hold } => {
                    set("hold_s", hold as f64 * dt);
                    // Channels do not switch together.
                    set("phase_s", (i % hold.max(1)) as f64 * dt);
                    ("aprbs", vec![("levels", levels)])
                }
                Kind::SpaceFilling { hold, ramp } => {
                    set("hold_s", hold as f64 * dt);
                    set("ramp_s", ramp as f64 * dt);
                    ("space_filling", vec![("channel", i + 1), ("channels", m)])
                }
            };
            for (key, v) in whole {
                keys.insert(key.into(), toml::Value::Integer(v as i64));
            }
            signal(name, &keys)?.fill(&mut column, dt, rng)?;
            column.iter().enumerate().for_each(|(t, v)| u[t * m + i] = *v);
        }
        Ok(u)
    }
}
