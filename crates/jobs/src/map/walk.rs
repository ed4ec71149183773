//! Along the finished maps on the bed, and once more where they had to become others.
//!
//! Where lines show that a demand is not reached, its cells are sought again within what is ([`super::reach`]), and the parts of the lines that
//! are others by it are gone along once more: what was measured there says nothing of the new ones.

use dynocal_calib::steady::cell::Setting;
use dynocal_calib::steady::day::{DayPoint, Drift};
use dynocal_calib::steady::layout::Layout;
use dynocal_numerics::watch::Watch;

use super::bench::Bench;
use super::drive::Drive;
use super::error::MapError;
use super::learn::Learned;
use super::lines::Gone;
use super::optimum::Optimum;
use super::reach::Reach;
use super::rest::Rest;
use super::setting;
use super::spec::MapSpec;
use super::windows::{Window, missed};

/// The maps with their models, along which the bed goes.
pub(super) struct Walk<'a> {
    pub(super) spec: &'a MapSpec,
    pub(super) layout: &'a Layout,
    pub(super) setting: &'a Setting<'a>,
    pub(super) models: &'a [Learned],
    pub(super) drift: &'a [Drift],
    pub(super) drives: &'a [Drive],
    /// What is known of a slow channel.
    pub(super) rest: Option<&'a Rest>,
}

/// What lines showed, the demand as it is where a slow channel has come to rest, and what is known of that by them.
pub(super) type Walked = (Gone, Option<Rest>);

impl Walk<'_> {
    /// Along the lines of the maps; `points` as they are at rest. Where they show that a demand is not reached, its cells are sought again within what is, and the parts of the
    /// lines that are others by it are gone along once more.
    ///
    /// # Errors
    /// [`MapError`].
    pub(super) fn swept(
        &self,
        optimum: &mut Optimum,
        points: &[DayPoint],
        bench: &mut dyn Bench,
        until_s: f64,
        watch: Watch,
    ) -> Result<Option<Walked>, MapError> {
        let Self { spec, layout, setting, drift, drives, .. } = *self;
        let lines = optimum.lines(spec, layout, setting, drift);
        let Some((mut swept, before)) = lines.run(bench, drives, until_s, watch)? else { return Ok(None) };
        let rest = self.rest.map(|r| r.along(layout, &swept.1));
        let to_rest = |windows: &mut [Window]| rest.iter().for_each(|r| r.windows(windows));
        to_rest(&mut swept.1);
        if let Some(hoped) = self.kept_within(optimum, points, &swept.1, 0, watch)? {
            let lines = optimum.lines(spec, layout, setting, drift);
            let windows = lines.again(bench, (drives, &before), until_s, &mut swept, watch)?;
            to_rest(&mut swept.1[windows..]);
            self.kept_within(optimum, points, &swept.1, windows, watch)?;
            optimum.drop_unshown(&swept.1[windows..], layout, setting, &hoped);
        }
        Ok(Some((swept, rest)))
    }

    /// Seeks cells again around places that `windows` from number `from` on have missed; none where there are none. Where what was reached says too
    /// little to keep within it, a cell is taken to where its input has room as far as the model of it knows, while lines are to be gone along again:
    /// those cells, which count only if these show them.
    fn kept_within(
        &self,
        optimum: &mut Optimum,
        points: &[DayPoint],
        windows: &[Window],
        from: usize,
        watch: Watch,
    ) -> Result<Option<Vec<usize>>, MapError> {
        let Self { spec, layout, setting, models, .. } = *self;
        let found = missed(layout, &windows[from..]);
        let missed: Vec<Vec<f64>> = found.iter().map(|k| windows[from + k].asked(layout)).collect();
        if missed.is_empty() {
            return Ok(None);
        }
        let reach = Reach::learn(layout, points, windows, &spec.models, watch)?;
        let within = reach.as_ref().map(|r| setting::setting(layout, models, Some(r), spec));
        let with_room = (from == 0).then(|| setting::with_room(layout, models, spec));
        let settings = (setting, within.as_ref(), with_room.as_ref());
        Ok(Some(optimum.within_reach(spec, layout, settings, &missed, watch)))
    }
}
