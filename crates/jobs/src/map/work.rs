//! A steady calibration in memory: measure, learn, optimise, verify.

use std::collections::BTreeMap;
use std::path::Path;

use dynocal_calib::gains::{self, Tuned};
use dynocal_calib::steady::day::{self, DayEnd, DayPoint, Purpose, Task};
use dynocal_calib::steady::layout::Layout;
use dynocal_calib::steady::plan::DayPlan;
use dynocal_calib::steady::station::Station;
use dynocal_ident::plant::Plant;
use dynocal_numerics::watch::Watch;
use dynocal_plant::plants;

use super::bench::Bench;
use super::between::Between;
use super::budget::{Budget, fewest, least_s, verify_share, verify_spare_s};
use super::cells::end_in_words;
use super::channels;
use super::drive::{self, Drive};
use super::error::MapError;
use super::job::Job;
use super::journal::{Journal, digests};
use super::learn;
use super::line_time;
pub use super::on_bed::Given;
use super::on_bed::{self, OnBed};
use super::optimum::{Optimum, static_map};
use super::refine::{Refined, Refinement};
use super::rest::{self, at_rest};
use super::result::{BedTime, MapAxis, Mapped};
use super::setting::{self, envelope};
use super::spec::MapSpec;
use super::walk::{AfterLines, Walk};
use super::{edits, inverse, loops, verdict, verify};

/// All of it on the plant of the spec, or on a bed that is driven through files.
///
/// # Errors
/// [`MapError`]; [`MapError::NeedsMeasurement`] where the bed has to measure first.
pub fn run(job: &Job, watch: Watch) -> Result<Mapped, MapError> {
    if job.spec.plant.name == "bed" {
        return on_bed(job, watch);
    }
    run_on(job, make(&job.spec)?.as_mut(), watch)
}

/// As [`run`], every measured point kept in `folder`: a run that was interrupted goes on where it stopped.
///
/// # Errors
/// [`MapError`].
pub fn run_in(job: &Job, folder: &Path, watch: Watch) -> Result<Mapped, MapError> {
    if job.spec.plant.name == "bed" {
        return on_bed(job, watch);
    }
    run_on_in(job, make(&job.spec)?.as_mut(), Some(folder), watch)
}

/// The same on a plant that is there.
///
/// # Errors
/// [`MapError`].
pub fn run_on(job: &Job, plant: &mut dyn Plant, watch: Watch) -> Result<Mapped, MapError> {
    run_on_in(job, plant, None, watch)
}

/// The day on a plant that is there, kept in `folder` where there is one.
///
/// # Errors
/// [`MapError`].
pub fn run_on_in(
    job: &Job,
    plant: &mut dyn Plant,
    folder: Option<&Path>,
    watch: Watch,
) -> Result<Mapped, MapError> {
    let spec = &job.spec;
    plant.reset(spec.seed);
    channels::has_channels(spec, plant.variables())?;
    let axes = channels::axes(spec);
    let start = channels::start(spec, plant.variables());
    // What the plant lacks is said before it is run.
    channels::layout(spec, &axes, None, plant.variables())?;
    let tuned = tuned(spec, &axes, &start, plant, watch)?;
    let layout = channels::layout(spec, &axes, tuned.as_ref(), plant.variables())?;
    let interrupt = || watch.interrupted();
    let first = channels::first(&layout, &start);
    let driven: Vec<f64> = layout.driven().iter().map(|k| start[*k]).collect();
    let beyond = |name: &str| spec.bed.beyond.get(name).copied().unwrap_or(0.0);
    let approach = &spec.bed.approach;
    let described = plant.describe();
    let mut station = Station::new(plant, &layout, approach, &beyond, (first.clone(), driven), &interrupt);
    let day = Day { job, layout: &layout, axes, tuned, first };
    let Some(folder) = folder else { return day.run(&mut station, watch) };
    // All that a point depends on but the points before it, which are compared one by one.
    let inputs = (
        (&spec.plant, digests(&spec.plant), described),
        (spec.seed, &start, approach, &spec.bed.beyond, &spec.tune, spec.verify.limit),
        &layout,
    );
    let mut journal = Journal::open(&mut station, folder, &inputs, watch)?;
    day.run(&mut journal, watch)
}

/// The same on a bed that measures batches of points from files.
fn on_bed(job: &Job, watch: Watch) -> Result<Mapped, MapError> {
    let spec = &job.spec;
    let variables = on_bed::variables(&spec.problem, &spec.others(), &job.out)?;
    let axes = channels::axes(spec);
    let layout = channels::layout(spec, &axes, None, &variables)?;
    let first = channels::first(&layout, &channels::start(spec, &variables));
    let mut bed = OnBed::new(&layout, &job.out, first.clone());
    let day = Day { job, layout: &layout, axes, tuned: None, first };
    day.run(&mut bed, watch)
}

/// What the plant of a spec lacks, and edits that do not fit, as far as both can be told without a run: nothing of a bed, or of a program that would have to be started.
///
/// # Errors
/// [`MapError`] with what is missing, and what there is.
pub fn lacks(job: &Job) -> Result<(), MapError> {
    let spec = &job.spec;
    if spec.plant.name != "virtual_engine" {
        return Ok(());
    }
    let plant = make(spec)?;
    channels::has_channels(spec, plant.variables())?;
    let axes = channels::axes(spec);
    let layout = channels::layout(spec, &axes, None, plant.variables())?;
    spec.edits.as_ref().map(|file| edits::read(file, &layout, &axes)).transpose()?;
    Ok(())
}

/// Reads what a bed has measured so far, without running the day. Nothing on other plants.
///
/// # Errors
/// [`MapError`] with file, line and column of what cannot be taken.
pub fn given(job: &Job) -> Result<Vec<Given>, MapError> {
    let spec = &job.spec;
    if spec.plant.name != "bed" {
        return Ok(Vec::new());
    }
    let variables = on_bed::variables(&spec.problem, &spec.others(), &job.out)?;
    let axes = channels::axes(spec);
    let layout = channels::layout(spec, &axes, None, &variables)?;
    spec.edits.as_ref().map(|file| edits::read(file, &layout, &axes)).transpose()?;
    // No day has more batches than points.
    on_bed::given(&layout, &job.out, spec.bed.points)
}

/// What a day begins with.
struct Day<'a> {
    job: &'a Job,
    layout: &'a Layout,
    axes: Vec<MapAxis>,
    tuned: Option<Tuned>,
    first: Vec<f64>,
}

impl Day<'_> {
    fn run(self, bench: &mut dyn Bench, watch: Watch) -> Result<Mapped, MapError> {
        let Self { job, layout, axes, tuned, first } = self;
        let spec = &job.spec;
        // Edits that do not fit are known before the bed is run.
        spec.edits.as_ref().map(|file| edits::read(file, layout, &axes)).transpose()?;
        let mut bed = BedTime { gains_s: tuned.as_ref().map_or(0.0, |t| t.used_s), ..BedTime::default() };
        let grid_axes: Vec<Vec<f64>> = axes.iter().map(|a| a.points.clone()).collect();
        let Times { budget_s, points_s, until_s } = Times::of(spec, &grid_axes, bed.gains_s);
        let (least_s, words) = least_s(spec);
        if spec.plant.name != "bed" && budget_s < least_s {
            let (minutes, gains) = (spec.bed.minutes, bed.gains_s / 60.0);
            return Err(MapError::Minutes { minutes, gains, least: words });
        }
        let (mut points, Refined { rounds, end, enough }) =
            measured(spec, layout, &grid_axes, &first, points_s, bench, watch)?;
        bed.points_s = bench.used_s();
        let rest = rest::learn(layout, &points, spec, watch)?;
        let seen = at_rest(rest.as_ref(), layout, &points);
        let drift = rest::drift(rest.as_ref(), layout, &seen, spec, watch)?;
        let models = learn::learn(layout, &seen, &drift, &spec.models, true, watch)?;
        let envelope = envelope(layout, &seen);
        let setting = setting::setting(layout, &models, None, spec);
        let mut optimum = Optimum::of(spec, layout, &setting, &axes, &envelope, watch)?;
        let mut learnt = drive::learn(layout, &seen, spec, watch)?;
        let of_points = learnt.clone();
        let mut drives: Vec<Drive> = learnt.iter_mut().map(|all| all.remove(0)).collect();
        bench.widen_limits(spec.verify.limit);
        let walk = Walk {
            spec,
            layout,
            setting: &setting,
            models: &models,
            drift: &drift,
            drives: &drives,
            rest: rest.as_ref(),
        };
        let AfterLines { again, walked } = walk.all(&mut optimum, &seen, bench, until_s, watch)?;
        let setting = setting::setting(layout, again.as_ref().unwrap_or(&models), None, spec);
        let (swept, along) = walked.unzip();
        let rest_along = along.flatten().or_else(|| rest.clone());
        let (sweeps, windows) = swept.unzip();
        bed.sweeps_s = bench.used_s() - bed.points_s;
        let windows = windows.unwrap_or_default();
        let lines = optimum.lines(spec, layout, &setting, &drift);
        lines.trim(&windows, &mut drives, learnt)?;
        lines.learn_again(&windows, &mut drives, of_points, &seen, watch)?;
        drive::fill(&drives, layout, &setting, &mut optimum.cells)?;
        optimum.drop_unreached(layout, &setting);
        let Optimum { axes, cells, front, whole, delivered, edits, .. } = optimum;
        let grid_axes: Vec<Vec<f64>> = axes.iter().map(|a| a.points.clone()).collect();
        watch.note(&format!("{} verification points on the bed", spec.verify.points));
        let verification = verify::Verification {
            spec,
            layout,
            setting: &setting,
            drives: &drives,
            axes: &grid_axes,
            cells: &cells,
            rest: rest_along.as_ref(),
        };
        let verified = verification.run(bench, budget_s, &mut points, watch)?;
        bed.verify_s = bench.used_s() - bed.points_s - bed.sweeps_s;
        let between =
            Between { spec, layout, setting: &setting, drives: &drives, axes: &axes, cells: &cells };
        let (map_axes, map_cells) = between.maps()?;
        let map = static_map(spec, layout, &map_axes, &map_cells, bed.all_s());
        let inverses = drives.iter().filter_map(|d| inverse::of(&map, &d.input)).collect();
        let shown = loops::of(&setting, layout, &cells);
        let verified_cells = verify::of_cells(&grid_axes, &verified);
        let mut found = Mapped {
            verb: "map",
            name: job.name.clone(),
            valid: false,
            verdict: String::new(),
            warnings: Vec::new(),
            checks: Vec::new(),
            bed,
            end,
            axes,
            rounds,
            enough,
            whole,
            front,
            delivered,
            edits,
            inverses,
            loops: shown,
            verified_cells,
            drift,
            models: again.unwrap_or(models),
            drives,
            sweeps,
            verified,
            cells,
            tuned,
            rest,
            files: Vec::new(),
            points,
            layout: layout.clone(),
            envelope,
            map,
        };
        verdict::judge(&mut found, spec);
        Ok(found)
    }
}

/// How the bed time of a day is divided, in s.
struct Times {
    /// All that there is.
    budget_s: f64,
    /// For the points, those of the verification among them.
    points_s: f64,
    /// When lines of the maps have to end.
    until_s: f64,
}

impl Times {
    /// What is left of the minutes of a spec after the gains of the loops.
    fn of(spec: &MapSpec, axes: &[Vec<f64>], gains_s: f64) -> Self {
        let budget_s = 60.0 * spec.bed.minutes - gains_s;
        // The verification comes last, and none of its points begins that may pass the end of the bed time.
        let kept_s = line_time::expected_s(spec, axes) + verify_spare_s(spec);
        // Its last point is one of the day's, too.
        let n = spec.bed.points as f64;
        let last_s = |points_s: f64| if spec.verify.points == 0 { 0.0 } else { points_s / n };
        let points_s = ((budget_s - kept_s) / (1.0 - last_s(1.0))).max(0.0);
        let verify_s = verify_share(spec) * points_s - last_s(points_s) + verify_spare_s(spec);
        Self { budget_s, points_s, until_s: budget_s - verify_s }
    }
}

/// The points of the day: planned ones, then batches that follow the optimum; why it ended.
fn measured(
    spec: &MapSpec,
    layout: &Layout,
    axes: &[Vec<f64>],
    first: &[f64],
    budget_s: f64,
    bench: &mut dyn Bench,
    watch: Watch,
) -> Result<(Vec<DayPoint>, Refined), MapError> {
    let budget = Budget::of(spec)
        .ok_or_else(|| MapError::Budget { points: spec.bed.points, least: Budget::least(spec) })?;
    let [planned_repeats, _] = budget.repeats;
    watch.note(&format!("{} points on the bed, {} of them to verify", spec.bed.points, spec.verify.points));
    // The verification comes out of the same bed time, and so do the points that follow the optimum: as much as their share.
    let until_s = |points: usize| points as f64 / (budget.before() + spec.verify.points) as f64 * budget_s;
    let (points, block) = (budget.planned, spec.bed.block);
    let plan = DayPlan { points, block, seed: spec.seed, kind: spec.bed.plan, order: spec.bed.order };
    let planned_s = until_s(budget.planned + planned_repeats);
    let (mut points, end) = planned(&plan, layout, axes, first, planned_s, bench, watch)?;
    enough(spec, &points, &end)?;
    if budget.followed == 0 || !matches!(end, DayEnd::Done | DayEnd::BedTime) {
        return Ok((points, Refined { rounds: Vec::new(), end, enough: None }));
    }
    let (most, bed_s) = (budget.before(), until_s(budget.before()));
    let refinement = Refinement { spec, layout, axes, first, most, bed_s };
    let refined = refinement.run(bench, &mut points, watch)?;
    Ok((points, refined))
}

/// The planned points, block by block where later ones are chosen inside of what was reached; a repeat before each block and at the end.
fn planned(
    plan: &DayPlan,
    layout: &Layout,
    axes: &[Vec<f64>],
    first: &[f64],
    bed_s: f64,
    bench: &mut dyn Bench,
    watch: Watch,
) -> Result<(Vec<DayPoint>, DayEnd), MapError> {
    let last = || Task::new(Purpose::Repeat, first.to_vec());
    let (mut tasks, mut points) = (day::tasks(layout, first, plan), Vec::new());
    if !plan.kind.follows_the_envelope() {
        tasks.push(last());
        let end = bench.run(tasks, bed_s, &mut points, watch)?;
        return Ok((points, end));
    }
    let (mut begun, mut number) = (plan.points.min(plan.block.max(1)), 1);
    loop {
        if begun == plan.points {
            tasks.push(last());
        }
        let end = bench.run(tasks, bed_s, &mut points, watch)?;
        if begun == plan.points || end != DayEnd::Done {
            return Ok((points, end));
        }
        let there: Vec<Vec<f64>> =
            points.iter().filter(|p| p.point.usable).map(|p| p.point.factors.clone()).collect();
        let state = (number, plan.points - begun, bench.stands_at());
        let block = plan.next_block(layout, axes, &there, &envelope(layout, &points), state);
        if block.is_empty() {
            return Ok((points, end));
        }
        (begun, number) = (begun + block.len(), number + 1);
        tasks = day::with_repeat(first, block);
    }
}

fn make(spec: &MapSpec) -> Result<Box<dyn Plant>, MapError> {
    let refused =
        || dynocal_ident::plant::PlantError::Call(format!("plant `{}` is run outside", spec.plant.name));
    let make = plants::find(&spec.plant.name).and_then(|p| p.make).ok_or_else(refused)?;
    Ok(make(&spec.plant, true)?)
}

/// Gains at the ends of the axes where the spec gives none.
fn tuned(
    spec: &MapSpec,
    axes: &[MapAxis],
    start: &[f64],
    plant: &mut dyn Plant,
    watch: Watch,
) -> Result<Option<Tuned>, MapError> {
    if spec.loops.iter().all(|l| l.gains.is_some()) {
        return Ok(None);
    }
    watch.note("gains of the loops");
    let layout = channels::layout(spec, axes, None, plant.variables())?;
    let driven: Vec<f64> = layout.driven().iter().map(|k| start[*k]).collect();
    // The inner part of each axis: its ends may be out of reach.
    let inner = |f: &dynocal_calib::steady::layout::Factor| {
        let room = 0.125 * (f.upper - f.lower);
        [f.lower + room, f.upper - room]
    };
    let mut corners = vec![channels::first(&layout, start)];
    for k in 0..layout.axes {
        let ends = inner(&layout.factors[k]);
        corners = corners
            .iter()
            .flat_map(|x| {
                ends.map(|e| {
                    let mut x = x.clone();
                    x[k] = e;
                    x
                })
            })
            .collect();
    }
    let plans: Vec<_> = corners
        .iter()
        .enumerate()
        .map(|(k, x)| layout.plan(&format!("gains{:02}", k + 1), x, x, &driven, 0, 2))
        .collect();
    Ok(Some(gains::tune(plant, &plans, &spec.tune, spec.seed, &|| watch.interrupted())?))
}

/// Usable points for each factor, and at least so many for the envelope.
fn enough(spec: &MapSpec, points: &[DayPoint], end: &DayEnd) -> Result<(), MapError> {
    let learnt = || points.iter().filter(|p| p.purpose != Purpose::Verify);
    let usable = learnt().filter(|p| p.point.usable).count();
    let least = fewest(spec);
    if usable >= least {
        return Ok(());
    }
    let mut notes: BTreeMap<&str, usize> = BTreeMap::new();
    for p in learnt().filter(|p| !p.point.usable) {
        *notes.entry(p.point.note.as_str()).or_default() += 1;
    }
    let notes: Vec<String> = notes.iter().take(5).map(|(note, n)| format!("{note} ({n} times)")).collect();
    let end = end_in_words(end);
    Err(MapError::TooFew { usable, measured: learnt().count(), least, end, notes: notes.join("; ") })
}
