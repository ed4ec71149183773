//! The part of the day that follows the optimum: models and maps so far, the next points, until promises are kept.

use dynocal_calib::steady::cell::Setting;
use dynocal_calib::steady::corner::corner;
use dynocal_calib::steady::day::{DayEnd, DayPoint, Purpose, Task};
use dynocal_calib::steady::envelope::Envelope;
use dynocal_calib::steady::grid::{self, GridSpec};
use dynocal_calib::steady::layout::Layout;
use dynocal_calib::steady::refine::{HOPE, Known, Left};
use dynocal_calib::steady::station::Corner;
use dynocal_design::points::short_ways;
use dynocal_ident::model::response::{Ask, Prediction, Response};
use dynocal_numerics::status::Status;
use dynocal_numerics::watch::Watch;
use serde::Serialize;

use super::bench::Bench;
use super::error::MapError;
use super::learn::{self, Learned};
use super::rest::{self, at_rest};
use super::setting::{envelope, setting};
use super::spec::MapSpec;

/// A batch of points at the expected optimum.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Round {
    /// Points that were chosen.
    pub points: usize,
    /// Those that could be used.
    pub usable: usize,
    /// Cells that the bed had not reached and might be sent to before this batch.
    pub untried: usize,
    /// Root mean square error of what was promised where it was measured as asked, as a share of what is minimised; none where
    /// nothing was promised.
    pub error: Option<f64>,
    /// Mean error of the same, with its sign: positive where more was measured than promised.
    pub bias: Option<f64>,
    /// What more points might have been worth before this batch; none where no cell held an optimum.
    pub left: Option<Left>,
    /// Bed time at its end in s.
    pub at_s: f64,
}

/// The batches of a day.
pub(super) struct Refined {
    pub(super) rounds: Vec<Round>,
    pub(super) end: DayEnd,
    /// What more points might be worth, where that was little enough to end the refinement.
    pub(super) enough: Option<Left>,
}

/// What comes next.
struct Next {
    targets: Vec<Vec<f64>>,
    /// Cells that the bed has not reached and may be sent to.
    untried: usize,
    /// What more points may be worth.
    worth: Option<Left>,
}

/// What the refinement needs.
pub(super) struct Refinement<'a> {
    pub(super) spec: &'a MapSpec,
    pub(super) layout: &'a Layout,
    pub(super) axes: &'a [Vec<f64>],
    /// First point of the day, which is repeated.
    pub(super) first: &'a [f64],
    /// Points that the day may have when this ends, repeats among them.
    pub(super) most: usize,
    /// Bed time after which no further point begins.
    pub(super) bed_s: f64,
}

impl Refinement<'_> {
    /// Batch after batch, until what was promised is kept, or more points would be worth less than is asked.
    ///
    /// # Errors
    /// [`MapError`].
    pub(super) fn run(
        &self,
        bench: &mut dyn Bench,
        points: &mut Vec<DayPoint>,
        watch: Watch,
    ) -> Result<Refined, MapError> {
        let mut rounds = Vec::new();
        // A batch ends with a repeat.
        while points.len() + 1 < self.most {
            let left = self.most - points.len() - 1;
            let rest = rest::learn(self.layout, points, self.spec, watch)?;
            let seen = at_rest(rest.as_ref(), self.layout, points);
            let drift = rest::drift(rest.as_ref(), self.layout, &seen, self.spec, watch)?;
            let models = learn::learn(self.layout, &seen, &drift, &self.spec.models, false, watch)?;
            let Next { targets, untried, worth } =
                self.targets(&models, &seen, left, rounds.len(), bench.stands_at(), watch);
            if watch.interrupted() {
                return Err(MapError::Interrupted);
            }
            if let Some(worth) = worth.filter(|w| untried == 0 && w.is_enough(&self.spec.bed.refine)) {
                return Ok(Refined { rounds, end: DayEnd::Done, enough: Some(worth) });
            }
            if targets.is_empty() {
                break;
            }
            let begun = points.len();
            let tasks = self.tasks(targets, bench.stands_at(), &models);
            let end = bench.run(tasks, self.bed_s, points, watch)?;
            let batch = at_rest(rest.as_ref(), self.layout, &points[begun..]);
            let mut round = self.judge(&models, &batch, untried);
            (round.at_s, round.left) = (bench.used_s(), worth);
            let enough = round.error.is_some_and(|e| e <= self.spec.bed.refine.tolerance) && untried == 0;
            rounds.push(round);
            if end != DayEnd::Done {
                return Ok(Refined { rounds, end, enough: None });
            }
            if enough {
                break;
            }
        }
        Ok(Refined { rounds, end: DayEnd::Done, enough: None })
    }

    /// The points of a batch and a repeat, from where the bed stands `now`: with what the models expect their loops to set, and over places at which
    /// they expect limits to be kept. The way there is known better than at the begin of the day.
    fn tasks(&self, targets: Vec<Vec<f64>>, now: &[f64], models: &[Learned]) -> Vec<Task> {
        let setting = setting(self.layout, models, None, self.spec);
        let mut at = Prediction::new(now.len());
        let mut expected = |x: &[f64]| -> Vec<f64> {
            let one = |(l, k): (usize, &usize)| {
                models[l].predict(x, Ask::Mean, &mut at);
                let i = &self.layout.problem.inputs[*k];
                at.mean.clamp(i.lower, i.upper)
            };
            self.layout.driven().iter().enumerate().map(one).collect()
        };
        let mut from = now.to_vec();
        let repeat = (Purpose::Repeat, self.first.to_vec());
        let all = targets.into_iter().map(|x| (Purpose::Optimum, x)).chain([repeat]);
        let one = |(purpose, target): (Purpose, Vec<f64>)| {
            let via = corner(&setting, self.layout, &from, &target);
            let via = via.map(|at| Corner { driven: expected(&at), at, from: from.clone() });
            from.clone_from(&target);
            Task { via, driven: expected(&target), ..Task::new(purpose, target) }
        };
        all.map(one).collect()
    }

    /// The next points in an order of short ways.
    fn targets(
        &self,
        models: &[Learned],
        points: &[DayPoint],
        left: usize,
        round: usize,
        now: &[f64],
        watch: Watch,
    ) -> Next {
        let envelope: Envelope = envelope(self.layout, points);
        let wide = Setting { caution: HOPE, ..setting(self.layout, models, None, self.spec) };
        let setting = setting(self.layout, models, None, self.spec);
        let reached = |at: &[f64]| envelope.contains(at);
        let seed = self.spec.seed.wrapping_add(round as u64);
        let cells =
            grid::solve(&setting, self.axes, &self.spec.optimise, &reached, self.spec.seed, watch.interrupt);
        // Where the optimum may lie is asked of each cell by itself.
        let alone = GridSpec { jump: 0.0, ..self.spec.optimise.clone() };
        let hopeful = grid::solve(&wide, self.axes, &alone, &reached, self.spec.seed, watch.interrupt);
        let used = || points.iter().filter(|p| p.point.usable);
        let factors = |p: &DayPoint| p.point.factors.clone();
        let measured: Vec<Vec<f64>> = used().map(factors).collect();
        let with_room: Vec<Vec<f64>> = used().filter(|p| p.point.saturated.is_empty()).map(factors).collect();
        let asked: Vec<Vec<f64>> =
            points.iter().map(|p| p.point.asked[..self.layout.axes].to_vec()).collect();
        let known = Known {
            setting: &setting,
            axes: self.axes,
            cells: &cells,
            hopeful: &hopeful,
            envelope: &envelope,
            measured: &measured,
            with_room: &with_room,
            asked: &asked,
        };
        let untried = known.untried().len();
        let next = known.next(self.spec.bed.refine.batch.min(left), seed, watch.interrupt);
        let unit: Vec<Vec<f64>> = next.iter().map(|x| self.layout.to_unit(x)).collect();
        let order = short_ways(&unit, &self.layout.to_unit(now));
        let targets = order.into_iter().map(|k| next[k].clone()).collect();
        Next { targets, untried, worth: Left::of(&cells, &hopeful) }
    }

    /// What was promised for a batch beside what was measured.
    fn judge(&self, models: &[Learned], batch: &[DayPoint], untried: usize) -> Round {
        let setting = setting(self.layout, models, None, self.spec);
        let chosen: Vec<_> = batch.iter().filter(|p| p.purpose == Purpose::Optimum).collect();
        let usable = chosen.iter().filter(|p| p.point.usable).count();
        let kept = chosen.iter().filter(|p| p.point.usable && p.point.touched.is_empty());
        let errors = kept.map(|p| {
            let promised = setting.judge(&p.point.factors, Status::Stalled, None).objective;
            let measured: f64 = p.point.responses.iter().zip(&setting.weights).map(|(r, w)| w * r).sum();
            (measured - promised) / promised.abs()
        });
        let errors: Vec<f64> = errors.filter(|e| e.is_finite()).collect();
        let n = errors.len() as f64;
        let mean = |v: f64| (n > 0.0).then(|| v / n);
        Round {
            points: chosen.len(),
            usable,
            untried,
            error: mean(errors.iter().map(|e| e * e).sum()).map(f64::sqrt),
            bias: mean(errors.iter().sum()),
            left: None,
            at_s: 0.0,
        }
    }
}
