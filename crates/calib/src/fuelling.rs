//! Fuel by measured states: an air charge, a filling and a fuel-film model identified from one transient record, and the causal
//! policy that inverts them.
//!
//! A map of demands alone cannot know what the manifold does; a sensor knows it late. With the speed N, the throttle command
//! theta, the manifold pressure p and the fuel q injected per cycle, all in the units of the channels:
//!
//! ```text
//! charge    c(N, p)                       fuel per cycle that makes lambda 1: polynomial of degree 4           [`Charge`]
//! cams      c goes with the distance of the cams from where they rest at N and p, where the records say it   [`CamLaw`]
//! filling   dp/dt = g (A(theta') psi(p/p0) - c N / 120) + l (p_measured - mean of p over a cycle, prompt or late)   [`Filling`]
//!           theta' is theta behind a lag, at a limited rate where the records show a limit; A is a cubic polynomial; psi the flow function of a nozzle
//! film      df/dt = X q N / 120 - f / tau,   m = (1 - X) q + (120 / N) f / tau                                 [`Film`]
//! coolant   ln(X / (1 - X)), ln tau and ln c go with its temperature, ln c also over N and p, where the records say it [`CoolantLaw`]
//! sensor    phi(t) = m(t) / c(N, p(t + t0 + k 120 / N)),  1 / lambda = phi later by n 120 / N + G / (c N / 120), behind the lag
//!           M / (c N / 120) of a volume and that of the sensor
//! ```
//!
//! The steady ends of holds give c and A to begin with, the pressure of the record g and the lag of the throttle, and the lambda
//! that was measured everything else at once: c, X, tau, t0, k, n, G, M and the lag of the sensor. So the sensor is a part of what
//! is identified, and what the policy controls is the mixture in the cylinder and not what the sensor shows of it. The policy
//! takes the pressure that the filling predicts for the moment at which the present injection meets its air, and injects what
//! leaves the film as it must (inverse of the film); speed, pressure before the throttle and cams go on by their measured slopes until
//! then. A limit of the rate, a film and what cams do are kept only where a paired test over blocks of the records says that they pay,
//! film and cams by blocks that did not fit them, and a film only if its inverse is stable and does not swing. Throttle and filling are taken anew by the charge that the lambda gave, and the
//! charge by them, twice: the policy has one of each. What the identified charge lacks, the sensor says slowly ([`Trim`]). What is
//! given: the pressure before the throttle, that the channel of the manifold is prompt or a sample late, and that air is a gas of two atoms.
//!
//! Film: C. F. Aquino, SAE 810494. Filling of a manifold: E. Hendricks and S. C. Sorenson, SAE 900616.

mod adapt;
mod cams;
mod charge;
mod coolant;
mod feedback;
mod filling;
mod film;
mod film_ends;
mod foresight;
mod identify;
mod learning;
mod policy;
mod speed_density;
mod trim;

pub use adapt::{Adaptation, Left};
pub use cams::{CamBends, CamLaw};
pub use charge::Charge;
pub use coolant::{Air, CoolantLaw};
pub use feedback::Feedback;
pub use filling::{Filling, FillingState};
pub use film::{Film, FilmState};
pub use film_ends::FilmEnds;
pub use identify::{
    FuellingError, STILL_S, SteadyPoint, TransientRecord, identify, identify_with, identify_without_film,
    steady_charge, steady_charge_with,
};
pub use learning::Learning;
pub use policy::{FuelPolicy, Sensed};
pub use speed_density::{Coat, SpeedDensity, SpeedDensityState};
pub use trim::Trim;

use serde::{Deserialize, Serialize};

/// When fuel meets its air, and what the lambda sensor shows of it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Timing {
    /// Constant part of the time from the command of an injection until the pressure that counts for it, t0, in s.
    pub charge_s: f64,
    /// The part that goes with the cycle, k, in cycles.
    pub charge_cycles: f64,
    /// Transport to the sensor, n, in cycles.
    pub transport_cycles: f64,
    /// Transport through volumes, G: fuel at lambda 1 that goes by meanwhile, in the unit of the injection.
    pub transport_fuel: f64,
    /// Mixing in a volume on the way, M: fuel at lambda 1 that goes by in its time constant, in the unit of the injection; 0: none.
    #[serde(default)]
    pub mixing_fuel: f64,
    /// Time constant of the sensor in s.
    pub sensor_lag_s: f64,
}

impl Timing {
    /// Time from the command of an injection until the pressure that counts for it, in s; not negative.
    pub fn ahead_s(&self, speed_rpm: f64) -> f64 {
        (self.charge_s + self.charge_cycles * 120.0 / speed_rpm).max(0.0)
    }

    /// Time from the command of an injection until the sensor begins to show it, in s, at a flow of fuel that makes lambda 1 in
    /// the unit of the injection per s and cylinder.
    pub fn delay_s(&self, speed_rpm: f64, flow: f64) -> f64 {
        self.transport_cycles * 120.0 / speed_rpm + self.transport_fuel / flow.max(1e-9)
    }

    /// Time constants of mixing and sensor together in s, at a flow as in [`Timing::delay_s`].
    pub fn lag_s(&self, flow: f64) -> f64 {
        self.sensor_lag_s + self.mixing_fuel / flow.max(1e-9)
    }

    /// What gas in the volume on the way follows in `dt_s` of a step in what flows in, and that by the logarithm of the flow.
    fn mixed(&self, flow: f64, dt_s: f64) -> (f64, f64) {
        if self.mixing_fuel <= 0.0 {
            return (1.0, 0.0);
        }
        let passed = dt_s * flow.max(1e-9) / self.mixing_fuel;
        (-(-passed).exp_m1(), passed * (-passed).exp())
    }
}

/// What is identified.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fuelling {
    /// Sample time of the record in s.
    pub sample_time_s: f64,
    /// Air charge.
    pub charge: Charge,
    /// Manifold.
    pub filling: Filling,
    /// Film.
    pub film: Film,
    /// What speed and pressure do to it, where the records say it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub film_ends: Option<FilmEnds>,
    /// Timing.
    pub timing: Timing,
    /// What the coolant does to film and charge, where the records say it.
    pub coolant: Option<CoolantLaw>,
    /// Trim by the lambda sensor, where one leaves less of the records.
    pub trim: Option<Trim>,
    /// What is left of the records; none in files that do not say it.
    #[serde(default)]
    pub left: Option<Left>,
    /// Root of the mean squared error of 1 / lambda over the record, errors beyond 0.05 by their logarithm, those of its beginning as 0.
    pub rms: f64,
    /// Root of the mean squared error of the pressure over the record in kPa.
    pub pressure_rms_kpa: f64,
}

impl Fuelling {
    /// What a model that was written by somebody else may lack: as many coefficients as there are terms, a film and times that a
    /// controller can have.
    ///
    /// # Errors
    /// In words: key, found and expected.
    pub fn check(&self) -> Result<(), String> {
        let (c, f) = (&self.charge, &self.filling);
        for (key, found, expected) in [
            ("charge.coefficients", c.coefficients.len(), charge::TERMS),
            ("filling.area", f.area.len(), filling::TERMS),
        ] {
            if found != expected {
                return Err(format!("`{key}`: found {found} numbers, expected {expected}"));
            }
        }
        let positive = |v: f64| v > 0.0;
        let some = |v: f64| v >= 0.0;
        let half = self.film_ends.map_or([1.0; 2], |e| [e.speed_rpm[1], e.pressure_kpa[1]]);
        for (key, found, fits, expected) in [
            ("sample_time_s", self.sample_time_s, positive(self.sample_time_s), "a positive number"),
            ("filling.upstream_kpa", f.upstream_kpa, positive(f.upstream_kpa), "a positive number"),
            ("filling.gain", f.gain, positive(f.gain), "a positive number"),
            ("filling.throttle_lag_s", f.throttle_lag_s, some(f.throttle_lag_s), "a number from 0"),
            ("filling.sensor_lag_s", f.sensor_lag_s, some(f.sensor_lag_s), "a number from 0"),
            (
                "film.share",
                self.film.share,
                (0.0..1.0).contains(&self.film.share),
                "a number from 0 to below 1",
            ),
            ("film.tau_s", self.film.tau_s, positive(self.film.tau_s), "a positive number"),
            ("film_ends.speed_rpm", half[0], positive(half[0]), "a positive half width"),
            ("film_ends.pressure_kpa", half[1], positive(half[1]), "a positive half width"),
            ("timing.mixing_fuel", self.timing.mixing_fuel, some(self.timing.mixing_fuel), "a number from 0"),
            (
                "timing.sensor_lag_s",
                self.timing.sensor_lag_s,
                some(self.timing.sensor_lag_s),
                "a number from 0",
            ),
        ] {
            if !(fits && found.is_finite()) {
                return Err(format!("`{key}`: found {found}, expected {expected}"));
            }
        }
        let Some(ends) = &self.film_ends else { return Ok(()) };
        for coolant_c in self.coolant.map_or(vec![0.0], |law| law.range_c.to_vec()) {
            for [n, p] in ends.corners() {
                let film = self.film_of(coolant_c, n, p);
                if !((0.0..1.0).contains(&film.share) && film.tau_s > 0.0 && film.tau_s.is_finite()) {
                    return Err(format!(
                        "`film_ends`: found a film of share {} and {} s at {n} rpm and {p} kPa, expected a share from 0 to below 1 and a positive time",
                        film.share, film.tau_s
                    ));
                }
            }
        }
        Ok(())
    }

    /// The charge at a coolant temperature and places of the cams, if they are measured.
    pub fn air(&self, coolant_c: f64, cams_deg: Option<[f64; 2]>) -> Air<'_> {
        Air::new(&self.charge, self.coolant.as_ref(), coolant_c, cams_deg)
    }

    /// The film at a coolant temperature, in the middle of speed and pressure.
    pub fn film_at(&self, coolant_c: f64) -> Film {
        self.coolant.map_or(self.film, |law| law.film(self.film, coolant_c))
    }

    /// The film at a coolant temperature, a speed and a manifold pressure.
    pub fn film_of(&self, coolant_c: f64, speed_rpm: f64, pressure_kpa: f64) -> Film {
        let middle = self.film_at(coolant_c);
        self.film_ends.map_or(middle, |ends| ends.film(middle, speed_rpm, pressure_kpa))
    }

    /// The film with all that is known of it.
    pub fn coat(&self) -> Coat {
        Coat { film: self.film, law: self.coolant, ends: self.film_ends }
    }
}
