//! What identified fuelling injects behind a map, by its own model of throttle and manifold: dynamics of the map are chosen by it, without
//! the plant.

use dynocal_calib::fuelling::{FillingState, FuelPolicy, Fuelling, Sensed};
use dynocal_calib::map::Rows;

/// Time in s in which the manifold of the model comes to rest before a scenario.
const REST_S: f64 = 5.0;
/// Pressure in kPa that it begins at.
const BEGIN_KPA: f64 = 50.0;

/// A model of the injection, with places among the inputs of a problem and its references.
#[derive(Clone, Copy)]
pub(super) struct FuelOnModel<'a> {
    pub(super) fuelling: &'a Fuelling,
    /// Inputs: throttle, injection.
    pub(super) throttle: usize,
    pub(super) injection: usize,
    /// References: speed, lambda.
    pub(super) speed: usize,
    pub(super) lambda: usize,
    /// Most of an injection.
    pub(super) most: f64,
}

impl FuelOnModel<'_> {
    /// Puts the mean injection of each sample into a drive.
    pub(super) fn inject(&self, drive: &mut Rows, reference: &Rows, sample_time_s: f64) {
        let f = self.fuelling;
        let dt_s = f.sample_time_s;
        let count = (sample_time_s / dt_s).round().max(1.0) as usize;
        let coolant_c = f.coolant.map_or(f64::NAN, |law| law.at_c);
        let mut policy = FuelPolicy::new(f.clone(), self.most);
        let mut manifold: Option<FillingState> = None;
        let mut sample = |throttle_deg: f64, speed_rpm: f64, lambda: f64| {
            let state = manifold.get_or_insert_with(|| FillingState::at_rest(BEGIN_KPA, throttle_deg, dt_s));
            let map_kpa = state.shown_kpa();
            let held = (speed_rpm, throttle_deg, f.filling.upstream_kpa);
            // What the channel would show is what the model shows: nothing is corrected.
            state.step(&f.filling, f.air(coolant_c, None), held, map_kpa, dt_s);
            let sensed = Sensed {
                speed_rpm,
                throttle_deg,
                map_kpa,
                upstream_kpa: None,
                coolant_c,
                cams_deg: None,
                lambda: None,
            };
            policy.step(&sensed, lambda)
        };
        let rest = (REST_S / dt_s) as usize;
        for t in 0..drive.len() {
            let (throttle, r) = (drive.row(t)[self.throttle], reference.row(t));
            let (speed, lambda) = (r[self.speed], r[self.lambda]);
            (0..if t == 0 { rest } else { 0 }).for_each(|_| {
                sample(throttle, speed, lambda);
            });
            let sum: f64 = (0..count).map(|_| sample(throttle, speed, lambda)).sum();
            drive.row_mut(t)[self.injection] = sum / count as f64;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fuelling::stored::tests::stored;

    /// A throttle of 8 mg/s a degree before the nozzle, and a charge of 0.2 mg/kPa.
    fn fuelling() -> Fuelling {
        let mut f = stored(|_, p| 0.2 * p).fuelling;
        (f.filling.area, f.filling.gain) = (vec![0.0, 8.0, 0.0, 0.0], 2.0);
        (f.film.share, f.timing.charge_cycles) = (0.0, 0.0);
        f
    }

    /// At rest what leaves is what flows in, 8 mg/s a degree times sqrt(1.4) (2 / 2.4)^3 as long as the throttle is choked; lambda divides
    /// it; after a step it follows the manifold, not the throttle.
    #[test]
    fn the_injection_is_that_of_the_manifold() {
        let f = fuelling();
        let model = FuelOnModel { fuelling: &f, throttle: 1, injection: 0, speed: 2, lambda: 1, most: 60.0 };
        let (mut reference, mut drive) = (Rows::new(3), Rows::new(2));
        for t in 0..200 {
            reference.push(&[50.0, if t < 150 { 1.0 } else { 0.9 }, 1500.0]);
            drive.push(&[1.0, if t < 20 { 10.0 } else { 14.0 }]);
        }
        model.inject(&mut drive, &reference, 0.03);
        let choked = 1.4f64.sqrt() * (2.0f64 / 2.4).powi(3);
        let at_rest = |throttle: f64| 8.0 * choked * throttle * 120.0 / 1500.0;
        let given = drive.column(0);
        assert!((given[10] / at_rest(10.0) - 1.0).abs() < 0.01, "{} {}", given[10], at_rest(10.0));
        assert!((given[140] / at_rest(14.0) - 1.0).abs() < 0.01, "{} {}", given[140], at_rest(14.0));
        assert!((given[199] / given[140] - 1.0 / 0.9).abs() < 1e-3);
        assert!(given[21] < 0.5 * (given[10] + given[140]), "{}", given[21]);
    }
}
