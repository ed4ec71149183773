//! What measures steady points: a plant that answers while they are approached, or a bed that is driven through files ([`super::on_bed`]).

use dynocal_calib::steady::day::{self, DayEnd, DayPoint, Task};
use dynocal_calib::steady::station::{Leg, Station, Swept, Touched};
use dynocal_ident::play::PlayError;
use dynocal_numerics::watch::Watch;

use super::error::{MapError, stopped};

/// What measures points.
pub(super) trait Bench {
    /// Measures `tasks` in their order until `bed_s` is used up, adding to `points`; why it ended.
    fn run(
        &mut self,
        tasks: Vec<Task>,
        bed_s: f64,
        points: &mut Vec<DayPoint>,
        watch: Watch,
    ) -> Result<DayEnd, MapError>;
    /// Goes along a line of the maps; none where the bed cannot.
    fn sweep(&mut self, from: &[f64], legs: &[Leg], watch: Watch) -> Result<Option<Swept>, MapError>;
    /// Whether more points can be measured at once, without a plan that is carried out elsewhere.
    fn goes_on(&self) -> bool {
        true
    }
    /// Factors where it stands.
    fn stands_at(&self) -> &[f64];
    /// Bed time so far in s.
    fn used_s(&self) -> f64;
    /// From now on limits may be passed by a share of their size on the way.
    fn widen_limits(&mut self, share: f64);
}

impl Bench for Station<'_> {
    fn run(
        &mut self,
        tasks: Vec<Task>,
        bed_s: f64,
        points: &mut Vec<DayPoint>,
        watch: Watch,
    ) -> Result<DayEnd, MapError> {
        day::run(self, tasks, bed_s, points, watch).map_err(stopped(watch))
    }
    fn sweep(&mut self, from: &[f64], legs: &[Leg], watch: Watch) -> Result<Option<Swept>, MapError> {
        swept(Station::sweep(self, from, legs), watch).map(Some)
    }
    fn stands_at(&self) -> &[f64] {
        self.at()
    }
    fn used_s(&self) -> f64 {
        self.used_s
    }
    fn widen_limits(&mut self, share: f64) {
        self.widen(share);
    }
}

/// A plant that refuses ends a line; anything else is an error.
pub(super) fn swept(found: Result<Swept, PlayError>, watch: Watch) -> Result<Swept, MapError> {
    found.or_else(|e| {
        let words = day::refused(e).map_err(stopped(watch))?;
        let touched =
            Touched { output: String::new(), value: f64::NAN, limit: f64::NAN, factors: Vec::new(), words };
        Ok(Swept { rows: Vec::new(), clock_s: None, touched: Some(touched), used_s: 0.0 })
    })
}
