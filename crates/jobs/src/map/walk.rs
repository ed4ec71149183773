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
        if let Some(mut hoped) = self.kept_within(optimum, points, &swept.1, watch)? {
            let lines = optimum.lines(spec, layout, setting, drift);
            let windows = lines.again(bench, (drives, &before), until_s, &mut swept, watch)?;
            to_rest(&mut swept.1[windows..]);
            // What these miss is not sought again: no line would show it any more.
            hoped.extend(optimum.around(&self.missed(&swept.1, windows)));
            optimum.drop_unshown(&swept.1, layout, setting, &hoped);
        }
        Ok(Some((swept, rest)))
    }

    /// Places that `windows` from number `from` on have missed.
    fn missed(&self, windows: &[Window], from: usize) -> Vec<Vec<f64>> {
        let found = missed(self.layout, &windows[from..]);
        found.iter().map(|k| windows[from + k].asked(self.layout)).collect()
    }

    /// Seeks cells again around places that `windows` have missed: those that were found, which count only where lines show them; none where nothing was
    /// missed.
    fn kept_within(
        &self,
        optimum: &mut Optimum,
        points: &[DayPoint],
        windows: &[Window],
        watch: Watch,
    ) -> Result<Option<Vec<usize>>, MapError> {
        let Self { spec, layout, setting, models, .. } = *self;
        let missed = self.missed(windows, 0);
        if missed.is_empty() {
            return Ok(None);
        }
        let reach = Reach::learn(layout, points, windows, &spec.models, watch)?;
        let within = reach.as_ref().map(|r| setting::setting(layout, models, Some(r), spec));
        Ok(Some(optimum.within_reach(spec, layout, (setting, within.as_ref()), &missed, watch)))
    }
}
