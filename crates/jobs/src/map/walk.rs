//! Along the finished maps on the bed, and once more where they had to become others.
//!
//! Some of the lines come first. What they show of what is minimised is learnt ([`super::learn::again`]), and cells are sought again with it
//! ([`Optimum::seek_again`]) before the bed goes along the others: an optimum lies where models promise too much, and no point may have tested it.
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
use super::learn::{self, Learned};
use super::line::Line;
use super::lines;
use super::optimum::{Optimum, careful};
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
pub(super) type Walked = (lines::Gone, Option<Rest>);

/// The first lines, as they were measured.
struct Begun {
    gone: lines::Gone,
    lines: Vec<Line>,
    /// What they showed, the demand as it is where a slow channel has come to rest: windows, and points of them.
    windows: Vec<Window>,
    points: Vec<DayPoint>,
}

/// All that came of going along the maps.
pub(super) struct AfterLines {
    /// The models with what is minimised learnt again; none where the first lines showed nothing of it.
    pub(super) again: Option<Vec<Learned>>,
    /// Nothing where the bed cannot, or where no lines are asked for.
    pub(super) walked: Option<Walked>,
}

impl Walk<'_> {
    /// Along the first lines, what they show of what is minimised learnt with the points `seen`, cells sought again with it, and along the others.
    ///
    /// # Errors
    /// [`MapError`].
    pub(super) fn all(
        &self,
        optimum: &mut Optimum,
        seen: &[DayPoint],
        bench: &mut dyn Bench,
        until_s: f64,
        watch: Watch,
    ) -> Result<AfterLines, MapError> {
        let Self { spec, layout, .. } = *self;
        let Some(begun) = self.begun(optimum, bench, until_s, watch)? else {
            return Ok(AfterLines { again: None, walked: None });
        };
        let again = if begun.points.is_empty() {
            None
        } else {
            let (all, shown) = ([seen, &begun.points].concat(), begun.points.len());
            Some(learn::again(self.models, layout, &all, shown, self.drift, &spec.models, watch)?)
        };
        let models = again.as_deref().unwrap_or(self.models);
        let setting = setting::setting(layout, models, None, spec);
        if again.is_some() {
            let moved = optimum.seek_again(spec, layout, &setting, watch);
            if watch.interrupted() {
                return Err(MapError::Interrupted);
            }
            watch.note(&format!("{moved} cells are others by what the first lines showed"));
        }
        let walk = Walk { setting: &setting, models, ..*self };
        let walk = Walk { drives: &walk.fed(optimum, &begun)?, ..walk };
        let walked = walk.swept(optimum, begun, seen, bench, until_s, watch)?;
        Ok(AfterLines { again, walked: Some(walked) })
    }

    /// Along the first lines of the maps.
    ///
    /// # Errors
    /// [`MapError`].
    fn begun(
        &self,
        optimum: &Optimum,
        bench: &mut dyn Bench,
        until_s: f64,
        watch: Watch,
    ) -> Result<Option<Begun>, MapError> {
        let Self { spec, layout, setting, drift, drives, .. } = *self;
        let maps = optimum.lines(spec, layout, setting, drift);
        let Some((gone, lines)) = maps.begin(bench, drives, until_s, watch)? else { return Ok(None) };
        // What is known of a slow channel is learnt from all lines in the end.
        let mut windows = gone.1.clone();
        if let Some(rest) = self.rest {
            rest.along(layout, &windows).windows(layout, &mut windows);
        }
        let points = maps.points(&windows);
        Ok(Some(Begun { gone, lines, windows, points }))
    }

    /// Maps of the driven inputs as the first lines trim them: fed forward, they leave the loops less to do on the others.
    ///
    /// # Errors
    /// [`MapError`].
    fn fed(&self, optimum: &Optimum, begun: &Begun) -> Result<Vec<Drive>, MapError> {
        let Self { spec, layout, setting, drift, drives, .. } = *self;
        let (mut fed, none) = (drives.to_vec(), vec![Vec::new(); drives.len()]);
        optimum.lines(spec, layout, setting, drift).trim(&begun.windows, &mut fed, none)?;
        Ok(fed)
    }

    /// Along the other lines of the maps, and once more along parts whose maps are others by now; `points` as they are at rest. Where lines show that a demand is not
    /// reached, its cells are sought again within what is.
    ///
    /// # Errors
    /// [`MapError`].
    fn swept(
        &self,
        optimum: &mut Optimum,
        Begun { gone: mut swept, lines: mut before, .. }: Begun,
        points: &[DayPoint],
        bench: &mut dyn Bench,
        until_s: f64,
        watch: Watch,
    ) -> Result<Walked, MapError> {
        let Self { spec, layout, setting, drift, drives, .. } = *self;
        let lines = optimum.lines(spec, layout, setting, drift);
        lines.go_on(bench, (drives, &mut before), until_s, &mut swept, watch)?;
        let rest = self.rest.map(|r| r.along(layout, &swept.1));
        let to_rest = |windows: &mut [Window]| rest.iter().for_each(|r| r.windows(layout, windows));
        to_rest(&mut swept.1);
        let hoped = self.kept_within(optimum, points, &swept.1, watch)?;
        if watch.interrupted() {
            return Err(MapError::Interrupted);
        }
        let lines = optimum.lines(spec, layout, setting, drift);
        let windows = lines.again(bench, (drives, &before), until_s, &mut swept, watch)?;
        to_rest(&mut swept.1[windows..]);
        // What these miss is not sought again: no line would show it any more.
        let mut unsure = optimum.around(&self.missed(optimum, &swept.1, windows));
        unsure.extend(hoped.into_iter().flatten());
        optimum.drop_unshown(&swept.1, layout, setting, &unsure);
        Ok((swept, rest))
    }

    /// Places of the maps that `windows` from number `from` on have missed: not those at settings which the maps have left since.
    fn missed(&self, optimum: &Optimum, windows: &[Window], from: usize) -> Vec<Vec<f64>> {
        let lines = optimum.lines(self.spec, self.layout, self.setting, self.drift);
        let found = missed(self.layout, &windows[from..]).into_iter().map(|k| &windows[from + k]);
        found.filter(|w| !w.halfway && lines.asks_for(w)).map(|w| w.asked(self.layout)).collect()
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
        let missed = self.missed(optimum, windows, 0);
        if missed.is_empty() {
            return Ok(None);
        }
        let reach = Reach::learn(layout, points, windows, &spec.models, watch)?;
        let within = reach.as_ref().map(|r| careful(&setting::setting(layout, models, Some(r), spec)));
        Ok(Some(optimum.within_reach(spec, layout, (setting, within.as_ref()), &missed, watch)))
    }
}
