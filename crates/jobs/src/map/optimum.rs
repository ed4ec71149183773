//! The optimum on models: maps over their axes, with all that the spec asks of them; and the same in the form of the house.

use dynocal_calib::map::static_map::{StaticMap, StaticPoint};
use dynocal_calib::map::{ActuatorPort, Port, Ports};
use dynocal_calib::steady::cell::{CellOptimum, Setting};
use dynocal_calib::steady::day::Drift;
use dynocal_calib::steady::envelope::Envelope;
use dynocal_calib::steady::front::Front;
use dynocal_calib::steady::grid::{self, Cell, CellState, corners, interpolate};
use dynocal_calib::steady::layout::Layout;
use dynocal_calib::steady::quantise::quantise;
use dynocal_numerics::status::Status;
use dynocal_numerics::watch::Watch;
use rayon::prelude::*;

use super::cells::{actuators, missed};
use super::edits;
use super::error::MapError;
use super::front::Maps;
use super::lines::{self, Lines};
use super::result::{Delivered, Edit, MapAxis};
use super::spec::MapSpec;
use super::windows::Window;

/// Maps as the models say.
pub(super) struct Optimum {
    pub(super) axes: Vec<MapAxis>,
    grid_axes: Vec<Vec<f64>>,
    pub(super) cells: Vec<Cell>,
    pub(super) front: Option<Front>,
    pub(super) whole: Option<(Status, usize)>,
    pub(super) delivered: Option<Delivered>,
    pub(super) edits: Vec<Edit>,
}

/// Standard deviations of what is minimised that are added to it where no point will test it any more.
const TESTED_NO_MORE: f64 = 2.0;

/// The same where no point will test what is promised any more: an optimum among settings that were never near is not believed.
pub(super) fn careful<'a>(setting: &Setting<'a>) -> Setting<'a> {
    Setting { caution: setting.caution.max(TESTED_NO_MORE), ..setting.clone() }
}

impl Optimum {
    /// The optimum of every cell within the envelope, the trade-off, the coupling, breakpoints and steps, and the edits of the user.
    ///
    /// # Errors
    /// [`MapError`] where edits do not fit, or where the user interrupted.
    pub(super) fn of(
        spec: &MapSpec,
        layout: &Layout,
        setting: &Setting,
        axes: &[MapAxis],
        envelope: &Envelope,
        watch: Watch,
    ) -> Result<Self, MapError> {
        watch.note("the optimum of every cell");
        let mut axes = axes.to_vec();
        let full: Vec<Vec<f64>> = axes.iter().map(|a| a.points.clone()).collect();
        let reached = |at: &[f64]| envelope.contains(at);
        let mut cells = grid::solve(setting, &full, &spec.optimise, &reached, spec.seed, watch.interrupt);
        let maps = Maps { spec, layout, setting, axes: &full };
        let front = maps.front(&mut cells, watch);
        let whole = maps.couple(front.as_ref(), &mut cells, watch);
        let delivered = maps.deliver(front.as_ref(), &mut axes, &mut cells);
        let edited = spec.edits.as_ref().map(|file| edits::read(file, layout, &axes)).transpose()?;
        let edits = edits::hold(&edited.unwrap_or_default(), setting, layout, &mut cells);
        if watch.interrupted() {
            return Err(MapError::Interrupted);
        }
        let grid_axes = axes.iter().map(|a| a.points.clone()).collect();
        Ok(Self { axes, grid_axes, cells, front, whole, delivered, edits })
    }

    /// Whether cell `k` holds an optimum that is not an edit of the user.
    fn moves(&self, k: usize) -> bool {
        let c = &self.cells[k];
        c.state == CellState::Optimal && !self.edits.iter().any(|e| e.at == c.at)
    }

    /// Cells around places, those that hold an optimum which is not an edit of the user.
    pub(super) fn around(&self, places: &[Vec<f64>]) -> Vec<usize> {
        let all = places.iter().flat_map(|at| corners(&self.grid_axes, at));
        let mut which: Vec<usize> = all.map(|(k, _)| k).filter(|k| self.moves(*k)).collect();
        which.sort_unstable();
        which.dedup();
        which
    }

    /// Seeks the optimum again of the cells around places that lines `missed`, `within` what the demand reaches at the end of its input. One that
    /// has none was not reached, and neither was any where cells are coupled, or where nothing is known of that end; edits stay. The others: whether they
    /// are reached lines will show.
    pub(super) fn within_reach(
        &mut self,
        spec: &MapSpec,
        layout: &Layout,
        (setting, within): (&Setting, Option<&Setting>),
        missed: &[Vec<f64>],
        watch: Watch,
    ) -> Vec<usize> {
        let which = self.around(missed);
        // By themselves cells would break what couples them.
        let coupled = spec.optimise.whole.is_some() || spec.optimise.front.is_some();
        let Some(within) = within.filter(|_| !coupled) else {
            grid::unreached(setting, &self.grid_axes, &which, &mut self.cells);
            return Vec::new();
        };
        let steps = Self::steps(spec, layout);
        let one = |k: &usize| {
            let cell = &self.cells[*k];
            let warm = std::slice::from_ref(&cell.optimum.x);
            let found = within.optimise(&cell.at, spec.optimise.starts, warm, spec.seed, watch.interrupt);
            let mut found =
                if steps.iter().any(Option::is_some) { quantise(within, &found, &steps) } else { found };
            // Cells have as many responses as the setting that they were first sought with.
            found.responses.truncate(setting.models.len());
            found.deviations.truncate(setting.models.len());
            found
        };
        let optima: Vec<CellOptimum> = which.iter().map(one).collect();
        let hoped = which.iter().zip(&optima).filter(|(_, o)| o.feasible).map(|(k, _)| *k).collect();
        let lost = which.iter().zip(&optima).filter(|(_, o)| !o.feasible);
        let lost: Vec<usize> = lost.map(|(k, _)| *k).collect();
        grid::replace(setting, &self.grid_axes, &which, optima, &mut self.cells);
        grid::unreached(setting, &self.grid_axes, &lost, &mut self.cells);
        hoped
    }

    /// Seeks cells again with what lines showed of what is minimised, in `setting`, with the care of [`careful`] for what they would move to. Cells move that save more by it than `optimise.smooth` and than
    /// the jumps to their neighbours cost more by it (`optimise.jump`), or that do not keep their limits where they are; their number. The others stay, as do edits, and
    /// all where cells are coupled; what is expected there is said anew.
    pub(super) fn seek_again(
        &mut self,
        spec: &MapSpec,
        layout: &Layout,
        setting: &Setting,
        watch: Watch,
    ) -> usize {
        let coupled = spec.optimise.whole.is_some() || spec.optimise.front.is_some();
        let (steps, careful) = (Self::steps(spec, layout), careful(setting));
        let which: Vec<usize> =
            (0..self.cells.len()).filter(|k| self.cells[*k].state != CellState::Filled).collect();
        let one = |k: &usize| {
            let cell = &self.cells[*k];
            let mut here = setting.judge(&cell.optimum.x, cell.optimum.status, None);
            here.prices.iter_mut().zip(&cell.optimum.prices).for_each(|(new, old)| new.saves = old.saves);
            if coupled || !self.moves(*k) {
                return (here, None);
            }
            let warm = std::slice::from_ref(&cell.optimum.x);
            let found = careful.optimise(&cell.at, spec.optimise.starts, warm, spec.seed, watch.interrupt);
            let found =
                if steps.iter().any(Option::is_some) { quantise(&careful, &found, &steps) } else { found };
            let there = Some(found).filter(|f| f.feasible);
            (here, there)
        };
        let found: Vec<(CellOptimum, Option<CellOptimum>)> = which.par_iter().map(one).collect();
        // Jumps where all have moved that may, over those where none has.
        let (mut now, mut then): (Vec<Vec<f64>>, Vec<Vec<f64>>) =
            self.cells.iter().map(|c| (c.optimum.x.clone(), c.optimum.x.clone())).unzip();
        for (k, (here, there)) in which.iter().zip(&found) {
            now[*k].clone_from(&here.x);
            then[*k].clone_from(&there.as_ref().unwrap_or(here).x);
        }
        let jumps = |k: usize, x: &[Vec<f64>]| -> f64 {
            let optimal = |j: &usize| self.cells[*j].state == CellState::Optimal;
            let pair = |j: usize| -> f64 {
                let share = |i: usize| (x[k][i] - x[j][i]) / setting.ranges[i].width();
                (setting.axes..setting.dim()).map(|i| share(i).powi(2)).sum()
            };
            grid::neighbours(&self.grid_axes, k).into_iter().filter(optimal).map(pair).sum()
        };
        let taken = |(k, (here, there)): (&usize, (CellOptimum, Option<CellOptimum>))| {
            let Some(there) = there else { return (here, false) };
            let costs =
                spec.optimise.smooth + spec.optimise.jump * (jumps(*k, &then) - jumps(*k, &now)).max(0.0);
            // Where a cell stands a line will test it; only what it would move to is a promise.
            let saves = setting.cost(&here) - careful.cost(&there);
            let moves = !here.feasible || saves > costs * here.objective.abs();
            (if moves { there } else { here }, moves)
        };
        let taken: Vec<(CellOptimum, bool)> = which.iter().zip(found).map(taken).collect();
        let moved = taken.iter().filter(|t| t.1).count();
        let optima = taken.into_iter().map(|t| t.0).collect();
        grid::replace(setting, &self.grid_axes, &which, optima, &mut self.cells);
        moved
    }

    /// Steps of the free inputs in the ECU.
    fn steps(spec: &MapSpec, layout: &Layout) -> Vec<Option<f64>> {
        let free = &layout.factors[layout.axes..];
        free.iter().map(|f| spec.optimise.resolution.get(&f.name).copied()).collect()
    }

    /// Those of the cells `hoped` for that no window shows: each demand followed and each input with room, at the settings of the maps and nearer to the
    /// cell than to any other. They were not reached.
    pub(super) fn drop_unshown(
        &mut self,
        lines: &[Window],
        layout: &Layout,
        setting: &Setting,
        hoped: &[usize],
    ) {
        let shows = |w: &Window, k: usize| {
            let at = w.asked(layout);
            let here = interpolate(&self.grid_axes, &self.cells, &at);
            let near = corners(&self.grid_axes, &at).iter().any(|(j, weight)| *j == k && *weight >= 0.5);
            near && !w.halfway
                && w.row.followed.iter().all(|f| *f)
                && !w.row.at_end.contains(&true)
                && lines::beside(layout, &w.row.factors, &here)
        };
        let unshown = hoped.iter().filter(|k| self.moves(**k) && !lines.iter().any(|w| shows(w, **k)));
        let unshown: Vec<usize> = unshown.copied().collect();
        grid::unreached(setting, &self.grid_axes, &unshown, &mut self.cells);
    }

    /// Marks cells as not reached for which the maps of driven inputs, as they stand in the cells, have to go past the end of a range by
    /// more than their standard deviation: what lines found near there is in them. All cells that were not reached are filled again.
    pub(super) fn drop_unreached(&mut self, layout: &Layout, setting: &Setting) {
        let past = |c: &Cell| {
            let each = layout.driven().into_iter().enumerate();
            let mut each = each.map(|(l, k)| (&layout.problem.inputs[k], l));
            each.any(|(i, l)| {
                let (u, sd) = (c.optimum.responses[l], c.optimum.deviations[l]);
                u - sd > i.upper || u + sd < i.lower
            })
        };
        let which: Vec<usize> =
            (0..self.cells.len()).filter(|k| self.moves(*k) && past(&self.cells[*k])).collect();
        grid::unreached(setting, &self.grid_axes, &which, &mut self.cells);
    }

    /// Its lines on the bed.
    pub(super) fn lines<'a>(
        &'a self,
        spec: &'a MapSpec,
        layout: &'a Layout,
        setting: &'a Setting<'a>,
        drift: &'a [Drift],
    ) -> Lines<'a> {
        Lines { spec, layout, setting, axes: &self.grid_axes, cells: &self.cells, drift }
    }
}

/// The maps in the form of the house: demand slow, given channel fast.
pub(super) fn static_map(
    spec: &MapSpec,
    layout: &Layout,
    axes: &[MapAxis],
    cells: &[Cell],
    bed_s: f64,
) -> StaticMap {
    let p = &spec.problem;
    let port = |name: &str, unit: &str| Port { name: name.into(), unit: unit.into() };
    let axis = |known: &[String]| axes.iter().find(|a| known.contains(&a.name));
    let (demand, given) = (axis(&p.demand_names()), axis(&p.given_names()));
    // The leading demand and the given channel of a map are its axes: they come first.
    let first = |name: Option<&MapAxis>, all: Vec<Port>| -> Vec<Port> {
        let leads = |p: &Port| name.is_some_and(|a| a.name == p.name);
        let (mut lead, rest): (Vec<Port>, Vec<Port>) = all.into_iter().partition(|p| leads(p));
        lead.extend(rest);
        lead
    };
    let actuator = |i: &dynocal_calib::problem::InputChannel| ActuatorPort {
        name: i.name.clone(),
        unit: i.unit.clone(),
        lower: i.lower,
        upper: i.upper,
    };
    let ports = Ports {
        demands: first(demand, p.demands.iter().map(|d| port(&d.output, &d.unit)).collect()),
        given: first(given, p.given.iter().map(|g| port(&g.name, &g.unit)).collect()),
        actuators: p.inputs.iter().map(actuator).collect(),
    };
    let points = cells.iter().map(|c| {
        let along = |a: Option<&MapAxis>| {
            a.and_then(|a| axes.iter().position(|o| o.name == a.name)).map_or(0.0, |k| c.at[k])
        };
        StaticPoint {
            demand: along(demand),
            given: along(given),
            actuators: actuators(layout, c),
            errors: Vec::new(),
            objective: c.optimum.objective,
            missed: missed(layout, c),
        }
    });
    StaticMap {
        ports,
        demand: demand.map_or(vec![0.0], |a| a.points.clone()),
        given: given.map_or(vec![0.0], |a| a.points.clone()),
        points: points.collect(),
        bed_s,
    }
}
