//! Cam positions over speed and load, as an engine controller would hold them: lists at light, part and full load, linear between.

use serde::{Deserialize, Serialize};

/// Maximum opening points over speed, at no load and at full load; linear in between.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CamSchedule {
    /// Speeds \[rpm\], rising.
    pub speed_rpm: Vec<f64>,
    /// Intake at part load (up to `part_load_kpa`) \[deg BTDC firing\], one per speed.
    pub intake_part_deg: Vec<f64>,
    /// Exhaust at part load \[deg ATDC firing\].
    pub exhaust_part_deg: Vec<f64>,
    /// Intake at full load (from `full_load_kpa`) \[deg BTDC firing\].
    pub intake_full_deg: Vec<f64>,
    /// Exhaust at full load \[deg ATDC firing\].
    pub exhaust_full_deg: Vec<f64>,
    /// Intake-manifold pressures of part and full load \[kPa\].
    pub part_load_kpa: f64,
    /// Full load \[kPa\].
    pub full_load_kpa: f64,
    /// Positions towards no load; absent, those of part load hold down to none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub light: Option<LightLoad>,
    /// Added to the lists; absent, nothing is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shift: Option<CamShift>,
}

/// Positions at light load, where residual gas is what limits a stable burn: phasers stand with little or no overlap there (parked).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LightLoad {
    /// Manifold pressure up to which they hold \[kPa\].
    pub load_kpa: f64,
    /// Intake \[deg BTDC firing\], one per speed.
    pub intake_deg: Vec<f64>,
    /// Exhaust \[deg ATDC firing\], one per speed.
    pub exhaust_deg: Vec<f64>,
}

/// A smooth shift over speed and load, c + a (N/N_c)^q e + b r g for each cam: a bell e = exp(-|dp/w_p|^k - |dN/w_N|^k) about
/// (p_c, N_c), a ramp r = 1/(1 + exp((p_b - p)/w_b)) and g = exp(-((N - N_b)/w_g)^2). c and a of both cams, p_c and b say how
/// far overlap is opened at part load (dilution) and under boost at low speed (scavenging).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CamShift {
    /// Constant part of the intake \[deg\]: positive is earlier.
    pub intake_deg: f64,
    /// Of the exhaust \[deg\]: positive is later.
    pub exhaust_deg: f64,
    /// Height of the bell, intake \[deg\].
    pub intake_bell_deg: f64,
    /// Exhaust \[deg\].
    pub exhaust_bell_deg: f64,
    /// Manifold pressure of its summit \[kPa\].
    pub summit_kpa: f64,
    /// Speed of its summit \[rpm\].
    pub summit_rpm: f64,
    /// Its width over pressure \[kPa\].
    pub width_kpa: f64,
    /// Its width over speed, and that of the boost part \[rpm\].
    pub width_rpm: f64,
    /// Power k of the bell, e = exp(-|dp/w_p|^k - |dN/w_N|^k): 2 a Gaussian, 4 flat on top \[-\].
    #[serde(default = "gaussian")]
    pub bell_power: f64,
    /// Exponent q of speed by which the bell grows, (N/N_c)^q: 0 the same overlap in degrees, 1 in time \[-\].
    #[serde(default)]
    pub bell_speed: f64,
    /// Height of the boost part, intake \[deg\].
    pub boost_deg: f64,
    /// Height of that of the exhaust over it \[-\].
    #[serde(default = "one")]
    pub boost_exhaust: f64,
    /// Manifold pressure at which half of it is there \[kPa\].
    pub boost_kpa: f64,
    /// Width of its ramp \[kPa\].
    pub boost_width_kpa: f64,
    /// Speed at which it is highest \[rpm\].
    pub boost_rpm: f64,
    /// Its width over speed \[rpm\]; absent, that of the bell.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub boost_width_rpm: Option<f64>,
}

fn one() -> f64 {
    1.0
}

fn gaussian() -> f64 {
    2.0
}

impl CamShift {
    /// Shift of intake and exhaust \[deg\].
    fn at(&self, speed_rpm: f64, map_kpa: f64) -> (f64, f64) {
        let square = |x: f64| x * x;
        let power = |x: f64| if self.bell_power == 2.0 { square(x) } else { x.abs().powf(self.bell_power) };
        let bell = (-power((map_kpa - self.summit_kpa) / self.width_kpa)
            - power((speed_rpm - self.summit_rpm) / self.width_rpm))
        .exp();
        let bell = if self.bell_speed == 0.0 {
            bell
        } else {
            bell * (speed_rpm / self.summit_rpm.max(1.0)).powf(self.bell_speed)
        };
        let ramp = 1.0 / (1.0 + ((self.boost_kpa - map_kpa) / self.boost_width_kpa).exp());
        let boost = self.boost_deg
            * ramp
            * (-square((speed_rpm - self.boost_rpm) / self.boost_width_rpm.unwrap_or(self.width_rpm))).exp();
        (
            self.intake_deg + bell * self.intake_bell_deg + boost,
            self.exhaust_deg + bell * self.exhaust_bell_deg + self.boost_exhaust * boost,
        )
    }
}

/// Ends of the box of both cams \[deg\].
const BOX_DEG: (f64, f64) = (180.0, 300.0);

/// Time of a phaser \[s\]: a few tenths of a second.
const PHASER_S: f64 = 0.3;

/// Highest speed of a schedule \[rpm\].
pub const MOST_RPM: f64 = 20_000.0;
/// Highest pressure of a schedule \[kPa\].
pub const MOST_KPA: f64 = 1000.0;

impl CamSchedule {
    /// Intake \[deg BTDC\] and exhaust \[deg ATDC\] opening points at a speed \[rpm\] and manifold pressure \[kPa\].
    pub fn at(&self, speed_rpm: f64, map_kpa: f64) -> (f64, f64) {
        let load =
            ((map_kpa - self.part_load_kpa) / (self.full_load_kpa - self.part_load_kpa)).clamp(0.0, 1.0);
        let over = |part: &[f64], full: &[f64], light: Option<&Vec<f64>>| {
            let (a, b) = (self.speed(part, speed_rpm), self.speed(full, speed_rpm));
            match (&self.light, light) {
                (Some(l), Some(list)) if map_kpa < self.part_load_kpa => {
                    let off =
                        ((self.part_load_kpa - map_kpa) / (self.part_load_kpa - l.load_kpa)).clamp(0.0, 1.0);
                    a + off * (self.speed(list, speed_rpm) - a)
                }
                _ => a + load * (b - a),
            }
        };
        let light = self.light.as_ref();
        let intake = over(&self.intake_part_deg, &self.intake_full_deg, light.map(|l| &l.intake_deg));
        let exhaust = over(&self.exhaust_part_deg, &self.exhaust_full_deg, light.map(|l| &l.exhaust_deg));
        match &self.shift {
            None => (intake, exhaust),
            Some(shift) => {
                let (i, e) = shift.at(speed_rpm, map_kpa);
                let held = |deg: f64| deg.clamp(BOX_DEG.0, BOX_DEG.1);
                (held(intake + i), held(exhaust + e))
            }
        }
    }

    /// Moves positions (intake, exhaust) \[deg\] towards those of the schedule, as far as phasers turn in a cycle of `cycle_s`.
    #[must_use]
    pub fn follow(&self, now: (f64, f64), speed_rpm: f64, map_kpa: f64, cycle_s: f64) -> (f64, f64) {
        let (intake, exhaust) = self.at(speed_rpm, map_kpa);
        let share = (cycle_s / PHASER_S).min(1.0);
        (now.0 + share * (intake - now.0), now.1 + share * (exhaust - now.1))
    }

    /// Linear over speed, held at the ends.
    fn speed(&self, y: &[f64], speed_rpm: f64) -> f64 {
        let x = &self.speed_rpm;
        let k = x.partition_point(|v| *v <= speed_rpm).clamp(1, x.len() - 1);
        let w = ((speed_rpm - x[k - 1]) / (x[k] - x[k - 1])).clamp(0.0, 1.0);
        y[k - 1] + w * (y[k] - y[k - 1])
    }

    /// Whether the lists fit: as long as the speeds, two or more, rising from 0 to [`MOST_RPM`]; inside the box of the inputs;
    /// pressures rising from 0 to [`MOST_KPA`].
    pub fn fits(&self) -> bool {
        let n = self.speed_rpm.len();
        let mut lists = vec![
            &self.intake_part_deg,
            &self.exhaust_part_deg,
            &self.intake_full_deg,
            &self.exhaust_full_deg,
        ];
        lists.extend(self.light.iter().flat_map(|l| [&l.intake_deg, &l.exhaust_deg]));
        n >= 2
            && self.speed_rpm.windows(2).all(|w| w[1] > w[0])
            && self.speed_rpm.iter().all(|v| (0.0..=MOST_RPM).contains(v))
            && lists.iter().all(|l| l.len() == n && l.iter().all(|v| (180.0..=300.0).contains(v)))
            && self.full_load_kpa > self.part_load_kpa
            && self.part_load_kpa >= 0.0
            && self.light.as_ref().is_none_or(|l| l.load_kpa >= 0.0 && l.load_kpa < self.part_load_kpa)
            && self.full_load_kpa <= MOST_KPA
    }
}
