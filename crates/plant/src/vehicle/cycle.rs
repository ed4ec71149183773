//! A drive cycle: demanded speed over time.

use serde::{Deserialize, Serialize};

/// What is wrong with a drive cycle.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CycleError {
    /// Too short or of unequal columns.
    #[error(
        "drive cycle with {times} times and {speeds} speeds: expected two columns of equal length, at least 2 rows"
    )]
    Shape {
        /// Number of times.
        times: usize,
        /// Number of speeds.
        speeds: usize,
    },
    /// A row that cannot be driven.
    #[error("row {row} of the drive cycle: time {time_s} s, speed {speed_mps} m/s: expected {expected}")]
    Row {
        /// Row, counted from 1.
        row: usize,
        /// Time.
        time_s: f64,
        /// Speed.
        speed_mps: f64,
        /// What was expected.
        expected: &'static str,
    },
}

/// Demanded speed over time, linear between its rows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DriveCycle {
    time_s: Vec<f64>,
    speed_mps: Vec<f64>,
}

impl DriveCycle {
    /// A cycle from its columns, time from its first row on.
    ///
    /// # Errors
    /// [`CycleError`] for unequal columns, times that do not rise, and speeds that are negative, above 100 m/s or
    /// not finite.
    pub fn new(time_s: Vec<f64>, speed_mps: Vec<f64>) -> Result<Self, CycleError> {
        if time_s.len() != speed_mps.len() || time_s.len() < 2 {
            return Err(CycleError::Shape { times: time_s.len(), speeds: speed_mps.len() });
        }
        for i in 0..time_s.len() {
            let row = |expected| CycleError::Row {
                row: i + 1,
                time_s: time_s[i],
                speed_mps: speed_mps[i],
                expected,
            };
            if !time_s[i].is_finite() || (i > 0 && time_s[i] <= time_s[i - 1]) {
                return Err(row("a time after that of the row before"));
            }
            if !(0.0..=100.0).contains(&speed_mps[i]) {
                return Err(row("a speed of 0 to 100 m/s"));
            }
        }
        Ok(Self { time_s, speed_mps })
    }

    /// Duration \[s\].
    pub fn duration_s(&self) -> f64 {
        self.time_s[self.time_s.len() - 1] - self.time_s[0]
    }

    /// Speed \[m/s\] `t_s` seconds after the start; that of the ends outside.
    pub fn speed_mps(&self, t_s: f64) -> f64 {
        let t = self.time_s[0] + t_s;
        let i = self.time_s.partition_point(|&x| x <= t).clamp(1, self.time_s.len() - 1);
        let (t0, t1) = (self.time_s[i - 1], self.time_s[i]);
        let share = ((t - t0) / (t1 - t0)).clamp(0.0, 1.0);
        self.speed_mps[i - 1] + share * (self.speed_mps[i] - self.speed_mps[i - 1])
    }

    /// Distance \[m\], the integral of the polygon.
    pub fn distance_m(&self) -> f64 {
        let pairs = self.time_s.windows(2).zip(self.speed_mps.windows(2));
        pairs.map(|(t, v)| 0.5 * (t[1] - t[0]) * (v[0] + v[1])).sum()
    }

    /// The first `seconds` of the cycle.
    pub fn shortened(&self, seconds: f64) -> Self {
        let end = self.time_s[0] + seconds;
        let n = self.time_s.partition_point(|&t| t <= end).max(2);
        Self { time_s: self.time_s[..n].to_vec(), speed_mps: self.speed_mps[..n].to_vec() }
    }
}
