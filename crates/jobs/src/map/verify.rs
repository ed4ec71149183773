//! The verification run: the finished maps at operating points that no model has seen.

use dynocal_calib::steady::cell::{Setting, deviations};
use dynocal_calib::steady::corner::corner;
use dynocal_calib::steady::day::{DayPoint, Purpose, Task};
use dynocal_calib::steady::grid::{Cell, CellState, corners, interpolate};
use dynocal_calib::steady::layout::Layout;
use dynocal_calib::steady::station::{Corner, SteadyPoint};
use dynocal_design::points::{Sobol, short_ways};
use dynocal_ident::model::response::{Ask, Prediction};
use dynocal_numerics::watch::Watch;

use super::bench::Bench;
use super::budget::longest_s;
use super::cells::end_in_words;
use super::drive::{Drive, Driven};
use super::error::MapError;
use super::rest::{Rest, at_rest};
use super::result::{Deviation, Verified};
use super::schedule::{Schedule, slopes};
use super::spec::MapSpec;

/// Quantile of a two-sided 95 %.
const BAND: f64 = 0.975;

/// What is verified.
pub(super) struct Verification<'a> {
    pub(super) spec: &'a MapSpec,
    pub(super) layout: &'a Layout,
    pub(super) setting: &'a Setting<'a>,
    /// Maps of the inputs that loops drive, in the order of the loops.
    pub(super) drives: &'a [Drive],
    pub(super) axes: &'a [Vec<f64>],
    pub(super) cells: &'a [Cell],
    /// What is known of a slow channel: what is promised holds for where it has come to rest.
    pub(super) rest: Option<&'a Rest>,
}

impl Verification<'_> {
    /// Measures the points until the bed time is used up.
    pub(super) fn run(
        &self,
        bench: &mut dyn Bench,
        bed_s: f64,
        points: &mut Vec<DayPoint>,
        watch: Watch,
    ) -> Result<Vec<Verified>, MapError> {
        let place = |at: Vec<f64>| interpolate(self.axes, self.cells, &at[..self.layout.axes]);
        let targets: Vec<Vec<f64>> = self.places(bench.stands_at()).into_iter().map(place).collect();
        let begun = points.len();
        let schedule = Schedule::of(self.layout, self.setting, self.drives, self.cells)?;
        let mut from = bench.stands_at().to_vec();
        let task = |x: &Vec<f64>| {
            let gains = schedule.at(self.layout, self.setting, self.drives, std::slice::from_ref(x))?;
            let gains = gains.iter().map(|g| g[0]).collect();
            let via = self.via(&from, x);
            from.clone_from(x);
            Ok(Task { purpose: Purpose::Verify, target: x.clone(), via, driven: self.say(x)?, gains })
        };
        let tasks = targets.iter().map(task).collect::<Result<Vec<Task>, MapError>>()?;
        // The day ends with these points: none begins that may pass the end of the bed time.
        let longest_s = longest_s(self.spec);
        let end = bench.run(tasks.clone(), bed_s - longest_s, points, watch)?;
        let latest = self.wait_longer(bench, &tasks, begun, bed_s - longest_s, points, watch)?;
        let missed = |at: &[f64], note: String| Verified {
            at: at[..self.layout.axes].to_vec(),
            measured: false,
            note,
            deviations: Vec::new(),
            objective: None,
            kept: false,
        };
        let points = at_rest(self.rest, self.layout, points);
        let one = |(k, at): (usize, &Vec<f64>)| match latest[k].map(|place| &points[place].point) {
            Some(p) if p.usable && p.touched.is_empty() => self.judge(p),
            Some(p) => missed(at, p.note.clone()),
            None => missed(at, end_in_words(&end)),
        };
        Ok(targets.iter().enumerate().map(one).collect())
    }

    /// What the maps of the driven inputs say: it is fed forward, as an ECU will, so that the loops have only the rest to do.
    fn say(&self, x: &[f64]) -> Result<Vec<f64>, MapError> {
        let one = |d: &Drive| d.say(self.layout, self.setting, &[x.to_vec()]);
        self.drives.iter().map(|d| Ok(one(d)?.first().copied().unwrap_or(f64::NAN))).collect()
    }

    /// Over which place the bed goes from one setting to another.
    fn via(&self, from: &[f64], to: &[f64]) -> Option<Corner> {
        let over = corner(self.setting, self.layout, from, to);
        // A place at which the maps say nothing is gone over without them.
        over.map(|at| Corner { driven: self.say(&at).unwrap_or_default(), at, from: from.to_vec() })
    }

    /// Measures points once more that had not come to rest, where points and bed time are left. Where each of them stands among the points
    /// at last; none that was not begun.
    fn wait_longer(
        &self,
        bench: &mut dyn Bench,
        tasks: &[Task],
        begun: usize,
        until_s: f64,
        points: &mut Vec<DayPoint>,
        watch: Watch,
    ) -> Result<Vec<Option<usize>>, MapError> {
        let mut latest: Vec<Option<usize>> =
            (0..tasks.len()).map(|k| Some(begun + k).filter(|p| *p < points.len())).collect();
        if !bench.goes_on() {
            return Ok(latest);
        }
        let restless = |p: &SteadyPoint| !p.usable && p.touched.is_empty();
        let again: Vec<usize> = (0..tasks.len())
            .filter(|k| latest[*k].is_some_and(|p| restless(&points[p].point)))
            .take(self.spec.bed.points.saturating_sub(points.len()))
            .collect();
        let before = points.len();
        let mut from = bench.stands_at().to_vec();
        let task = |k: &usize| {
            let via = self.via(&from, &tasks[*k].target);
            from.clone_from(&tasks[*k].target);
            Task { via, ..tasks[*k].clone() }
        };
        let once_more = again.iter().map(task).collect();
        bench.run(once_more, until_s, points, watch)?;
        for (place, k) in (before..points.len()).zip(again) {
            latest[k] = Some(place);
        }
        Ok(latest)
    }

    /// Points between the cells whose neighbours are optima, in an order of short ways (axes, then where the free inputs stand).
    fn places(&self, now: &[f64]) -> Vec<Vec<f64>> {
        let n = self.layout.axes;
        let Some(mut sequence) = Sobol::new(n, self.spec.seed.wrapping_add(1)) else { return Vec::new() };
        let mut found: Vec<Vec<f64>> = Vec::new();
        // A map without any optimum has no place to verify.
        for _ in 0..200 * self.spec.verify.points {
            if found.len() == self.spec.verify.points {
                break;
            }
            // Within the axes: beyond them there is no map.
            let ranges = self.axes.iter().zip(sequence.next_point());
            let at: Vec<f64> = ranges.map(|(a, u)| a[0] + u * (a[a.len() - 1] - a[0])).collect();
            let around = corners(self.axes, &at);
            if around.iter().all(|(k, _)| self.cells[*k].state == CellState::Optimal) {
                found.push(at);
            }
        }
        let whole: Vec<Vec<f64>> = found.iter().map(|at| interpolate(self.axes, self.cells, at)).collect();
        let unit: Vec<Vec<f64>> = whole.iter().map(|x| self.layout.to_unit(x)).collect();
        let order = short_ways(&unit, &self.layout.to_unit(now));
        order.into_iter().map(|k| whole[k].clone()).collect()
    }

    /// What the inputs that loops drive should be where it was measured, as far as their maps know.
    fn driven(&self, point: &SteadyPoint) -> Vec<Driven> {
        // What a map cannot say here is left to the models over the factors.
        let one = |d: &Drive| {
            d.at(self.layout, self.setting, &[&point.factors])
                .ok()
                .and_then(|v| v.first().copied())
                .unwrap_or(Driven { value: f64::NAN, deviation: f64::NAN })
        };
        self.drives.iter().map(one).collect()
    }

    /// What the deviation of the input of loop `l` does to its demand; none where response `l` is none.
    fn at_demand(&self, l: usize, point: &SteadyPoint, measured: f64, promised: f64) -> Option<f64> {
        let drive = self.drives.get(l)?;
        let at = std::slice::from_ref(&point.factors);
        let slope = slopes(self.layout, self.setting, l, drive, at).ok()?;
        Some(drive.missed_by(measured, promised) / slope.first()?)
    }

    /// What was measured beside what was promised where it was measured.
    fn judge(&self, point: &SteadyPoint) -> Verified {
        let mut at = Prediction::new(self.layout.factors.len());
        let driven = self.driven(point);
        let band = deviations(BAND);
        let (mut all, mut kept) = (Vec::new(), true);
        let (mut promised, mut variance, mut measured) = (0.0, 0.0, 0.0);
        for (k, r) in self.layout.responses.iter().enumerate().filter(|(_, r)| !r.slow) {
            self.setting.models[k].predict(&point.factors, Ask::Variance, &mut at);
            let value = point.responses[k];
            let above = r.upper.map(|u| (value - u, u.abs()));
            let below = r.lower.map(|l| (l - value, l.abs()));
            let worst = [above, below].into_iter().flatten().max_by(|a, b| a.0.total_cmp(&b.0));
            kept &= worst.is_none_or(|(passed, size)| passed <= self.spec.verify.limit * size);
            let here = Driven { value: at.mean, deviation: at.measured_std() };
            let here = driven.get(k).copied().filter(|d| d.value.is_finite()).unwrap_or(here);
            all.push(Deviation {
                response: r.name.clone(),
                promised: here.value,
                half_width: band * here.deviation,
                measured: value,
                passed: worst.map(|w| w.0),
                at_demand: self.at_demand(k, point, value, here.value),
            });
            promised += r.weight * at.mean;
            variance += r.weight * r.weight * (at.variance + at.noise);
            measured += r.weight * value;
        }
        kept &= (measured - promised).abs() <= self.spec.verify.objective * promised.abs();
        Verified {
            at: point.factors[..self.layout.axes].to_vec(),
            measured: true,
            note: point.note.clone(),
            deviations: all,
            objective: Some([promised, band * variance.sqrt(), measured]),
            kept,
        }
    }
}

/// What the verification says of each cell of the maps: whether all points next to it (the cell is a corner of where they lie) keep limits
/// and promise; none where there is no such point.
pub(super) fn of_cells(axes: &[Vec<f64>], verified: &[Verified]) -> Vec<Option<bool>> {
    let mut said = vec![None; axes.iter().map(Vec::len).product()];
    for v in verified {
        for (k, _) in corners(axes, &v.at) {
            said[k] = Some(said[k].unwrap_or(true) && v.kept);
        }
    }
    said
}
