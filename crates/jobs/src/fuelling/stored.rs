//! What is kept of identified fuelling, `fuelling.json`: the model, where it holds, and on which breakpoints it is delivered.

use dynocal_calib::fuelling::Fuelling;
use serde::{Deserialize, Serialize};

use super::result::Seen;
use super::spec::Tables;

/// Schema and version of `fuelling.json`.
pub const FUELLING_SCHEMA: &str = "dynocal/fuelling";
/// See [`FUELLING_SCHEMA`].
pub const FUELLING_VERSION: u32 = 1;

/// Name of the file in a run folder.
pub const FUELLING_FILE: &str = "fuelling.json";

/// Places between two breakpoints at which a table is held against the model.
const BETWEEN: usize = 4;

/// Identified fuelling as it is kept.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StoredFuelling {
    /// Whether it may be used.
    pub valid: bool,
    /// What was identified.
    pub fuelling: Fuelling,
    /// Unit of the injection.
    pub injection_unit: String,
    /// Ranges of the records that identified it.
    pub seen: Seen,
    /// Breakpoints.
    pub tables: Tables,
}

impl StoredFuelling {
    /// Whether what a file holds can be used at all ([`Fuelling::check`]), with ranges that increase.
    ///
    /// # Errors
    /// In words: key, found and expected.
    pub fn check(&self) -> Result<(), String> {
        let ranges = [
            ("speed_rpm", self.seen.speed_rpm),
            ("map_kpa", self.seen.map_kpa),
            ("throttle_deg", self.seen.throttle_deg),
        ];
        for (key, [low, high]) in ranges {
            if !(low < high) {
                return Err(format!("`seen.{key}`: found {low} to {high}, expected numbers that increase"));
            }
        }
        self.fuelling.check()
    }

    /// Charge at the breakpoints, speed fastest, in the unit of the injection.
    pub fn charge(&self) -> Vec<f64> {
        let at = |p: &f64| {
            self.tables.speed_rpm.iter().map(|n| self.fuelling.charge.at(*n, *p)).collect::<Vec<f64>>()
        };
        self.tables.map_kpa.iter().flat_map(at).collect()
    }

    /// What the table loses: the largest relative difference between its bilinear interpolation and the charge of the model, at five
    /// by five places of each cell. None where the charge is not positive.
    pub fn loss(&self) -> Option<f64> {
        let (speed, map, values) = (&self.tables.speed_rpm, &self.tables.map_kpa, self.charge());
        let mut worst = 0.0_f64;
        for (j, p) in map.windows(2).enumerate() {
            for (i, n) in speed.windows(2).enumerate() {
                let at = |di: usize, dj: usize| values[(j + dj) * speed.len() + i + di];
                for k in 0..=BETWEEN * (BETWEEN + 2) {
                    let share = |k: usize| k as f64 / BETWEEN as f64;
                    let (x, y) = (share(k % (BETWEEN + 1)), share(k / (BETWEEN + 1)));
                    let low = at(0, 0) + x * (at(1, 0) - at(0, 0));
                    let high = at(0, 1) + x * (at(1, 1) - at(0, 1));
                    let truth = self.fuelling.charge.at(n[0] + x * (n[1] - n[0]), p[0] + y * (p[1] - p[0]));
                    if !(truth > 0.0) {
                        return None;
                    }
                    worst = worst.max(((low + y * (high - low)) / truth - 1.0).abs());
                }
            }
        }
        Some(worst)
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use dynocal_calib::fuelling::{Charge, Filling, Film, FilmEnds, Timing};

    /// The charge 1e-4 n p: bilinear, so that tables lose nothing; with p squared the loss is that of a chord of a parabola.
    pub(crate) fn stored(truth: impl Fn(f64, f64) -> f64) -> StoredFuelling {
        let points: Vec<[f64; 3]> = (0..100)
            .map(|k| (1000.0 + 300.0 * f64::from(k % 10), 20.0 + 8.0 * f64::from(k / 10)))
            .map(|(n, p)| [n, p, truth(n, p)])
            .collect();
        StoredFuelling {
            valid: true,
            fuelling: Fuelling {
                sample_time_s: 0.01,
                charge: Charge::fit(&points).unwrap(),
                filling: Filling {
                    upstream_kpa: 101.325,
                    throttle_deg: 1.0,
                    area: vec![0.0, 1.0, 0.0, 0.0],
                    gain: 1.0,
                    throttle_lag_s: 0.05,
                    throttle_rate_deg_s: None,
                    sensor_lag_s: 0.0,
                    correction_per_s: 0.5,
                },
                film: Film { share: 0.2, tau_s: 0.3 },
                timing: Timing {
                    charge_s: 0.0,
                    charge_cycles: 0.5,
                    transport_cycles: 1.0,
                    transport_fuel: 1.0,
                    mixing_fuel: 0.5,
                    sensor_lag_s: 0.1,
                },
                coolant: None,
                film_ends: None,
                trim: None,
                left: None,
                rms: 0.01,
                pressure_rms_kpa: 0.1,
            },
            injection_unit: "mg".into(),
            seen: Seen {
                speed_rpm: [1000.0, 3700.0],
                map_kpa: [20.0, 92.0],
                throttle_deg: [5.0, 40.0],
                coolant_c: None,
                cams_deg: None,
            },
            tables: Tables {
                speed_rpm: vec![1000.0, 2000.0, 3700.0],
                map_kpa: vec![40.0, 60.0, 80.0],
                coolant_c: vec![],
            },
        }
    }

    #[test]
    fn what_was_written_by_hand_is_named() {
        let good = stored(|n, p| 1e-4 * n * p);
        assert_eq!(good.check(), Ok(()));
        let said = |change: &dyn Fn(&mut StoredFuelling)| {
            let mut s = good.clone();
            change(&mut s);
            s.check().unwrap_err()
        };
        type Change = fn(&mut StoredFuelling);
        fn ends(share: [f64; 2], half_rpm: f64) -> Option<FilmEnds> {
            Some(FilmEnds { speed_rpm: [2000.0, half_rpm], pressure_kpa: [50.0, 20.0], share, tau: [0.0; 2] })
        }
        let changes: [(&str, Change); 9] = [
            ("film_ends", |s| s.fuelling.film_ends = ends([40.0, 0.0], 900.0)),
            ("film_ends", |s| s.fuelling.film_ends = ends([f64::NAN, 0.0], 900.0)),
            ("film_ends.speed_rpm", |s| s.fuelling.film_ends = ends([0.1, 0.0], 0.0)),
            ("charge.coefficients", |s| s.fuelling.charge.coefficients.clear()),
            ("filling.area", |s| s.fuelling.filling.area.truncate(1)),
            ("film.share", |s| s.fuelling.film.share = 1.0),
            ("film.tau_s", |s| s.fuelling.film.tau_s = -1.0),
            ("filling.gain", |s| s.fuelling.filling.gain = f64::NAN),
            ("seen.speed_rpm", |s| s.seen.speed_rpm = [3000.0, 1000.0]),
        ];
        for (key, change) in changes {
            let text = said(&change);
            assert!(text.starts_with(&format!("`{key}`: found ")) && text.contains("expected"), "{text}");
        }
    }

    #[test]
    fn a_table_of_a_bilinear_charge_loses_nothing() {
        let s = stored(|n, p| 1e-4 * n * p);
        assert!(s.loss().unwrap() < 1e-6, "{:?}", s.loss());
        assert!((s.charge()[4] - 1e-4 * 2000.0 * 60.0).abs() < 1e-5, "{:?}", s.charge());
    }

    #[test]
    fn a_chord_of_a_parabola_is_off_by_its_middle() {
        // (h / 2)^2 above p^2 at the middle of 40 to 60, where 50^2 is true.
        let s = stored(|_, p| 1e-3 * p * p);
        assert!((s.loss().unwrap() - 100.0 / 2500.0).abs() < 1e-5, "{:?}", s.loss());
    }
}
