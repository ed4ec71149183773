//! A bed that is driven through files: plans out, records in.

use std::path::{Path, PathBuf};

use dynocal_calib::problem::CalibrationProblem;
use dynocal_calib::steady::day::{DayEnd, DayPoint, Purpose, Task};
use dynocal_calib::steady::layout::{Factor, FactorKind, Layout};
use dynocal_calib::steady::station::{Leg, SteadyPoint, Swept};
use dynocal_files::FilesError;
use dynocal_files::atomic;
use dynocal_files::dataset::{self, ChannelSpec, Missing, Select, Time};
use dynocal_files::measurement;
use dynocal_files::table::Table;
use dynocal_ident::data::{Dataset, Role};
use dynocal_ident::plant::{Causality, Variable};
use dynocal_numerics::watch::Watch;

use super::bench::Bench;
use super::error::MapError;
use super::record;

/// A bed that reads plans and writes what it measured: `RUN/points01.csv` to `RUN/measured/points01.csv`, batch after batch, then
/// `verify`. Its own controllers hold the demands and keep the limits.
pub(super) struct OnBed<'a> {
    layout: &'a Layout,
    folder: &'a Path,
    at: Vec<f64>,
    batches: usize,
    used_s: f64,
    /// First stamp of the day.
    zero_s: Option<f64>,
}

/// Column with the number of a point in its plan.
const NUMBER: &str = "point";
/// Distance from what was asked above which a point lies elsewhere, as a share of the range.
const MISSED: f64 = 0.0125;
/// Share of its range by which a demand is missed where it is that of another plan, or in another unit.
const FAR: f64 = 0.1;
/// Longest day in s: a month.
const LONGEST_S: f64 = 2.6e6;
/// Share of the points elsewhere from which on a record is not that of its plan.
const FOREIGN: f64 = 0.5;

impl<'a> OnBed<'a> {
    pub(super) fn new(layout: &'a Layout, folder: &'a Path, first: Vec<f64>) -> Self {
        Self { layout, folder, at: first, batches: 0, used_s: 0.0, zero_s: None }
    }

    /// Where the records of the bed are.
    pub(super) fn measured(folder: &Path) -> PathBuf {
        folder.join("measured")
    }

    /// The record of the plan `name`; none where the bed has not measured it yet.
    fn record(folder: &Path, name: &str) -> Result<Option<PathBuf>, MapError> {
        let mut found = measurement::called(&Self::measured(folder), name);
        if found.len() > 1 {
            let names: Vec<String> = found.iter().map(|p| p.display().to_string()).collect();
            return Err(MapError::Record(format!(
                "`{}` are all called like the plan `{name}`: leave one",
                names.join("` and `")
            )));
        }
        Ok(found.pop())
    }

    /// Files among the records that are called like no plan so far.
    fn others(&self, measured: &Path) -> String {
        let named = |name: &str| {
            let plans = (1..=self.batches.max(1)).map(|k| format!("points{k:02}"));
            plans.chain(["verify".to_string()]).any(|plan| name.starts_with(&format!("{plan}.")))
        };
        let files = std::fs::read_dir(measured).into_iter().flatten().flatten();
        let names = files.map(|f| f.file_name().to_string_lossy().into_owned());
        let mut others: Vec<String> =
            names.filter(|n| !named(n) && !n.starts_with('.')).map(|n| format!("`{n}`")).collect();
        others.sort();
        others.join(", ")
    }

    fn write_plan(&self, path: &Path, tasks: &[Task]) -> Result<(), MapError> {
        let l = self.layout;
        let demands = l.problem.demands.iter().map(|d| format!("{} [{}]", d.output, d.unit));
        let given = l.problem.given.iter().map(|g| format!("{} [{}]", g.name, g.unit));
        let free = l.factors[l.axes..].iter().map(|f| format!("{} [{}]", f.name, f.unit));
        let head: Vec<String> = demands.chain(given).chain(free).collect();
        let mut text = format!("{NUMBER},purpose,{}\n", head.join(","));
        for (k, Task { purpose, target: x, .. }) in tasks.iter().enumerate() {
            let demands = (0..l.problem.demands.len()).map(|d| l.demand(d, x));
            let given = (0..l.problem.given.len()).map(|g| l.given(g, x));
            let cells: Vec<String> =
                demands.chain(given).chain(x[l.axes..].iter().copied()).map(|v| format!("{v:.6}")).collect();
            let why = match purpose {
                Purpose::Plan => "plan",
                Purpose::Optimum => "optimum",
                Purpose::Repeat => "repeat",
                Purpose::Verify => "verify",
            };
            text.push_str(&format!("{},{why},{}\n", k + 1, cells.join(",")));
        }
        Ok(atomic::write(path, text.as_bytes())?)
    }

    /// Channels that a record has to have: what is set as it was, inputs that the bed drives, responses.
    fn channels(&self) -> Vec<ChannelSpec> {
        let l = self.layout;
        let one = |name: &str, unit: &str, role| ChannelSpec {
            column: name.into(),
            name: name.into(),
            unit: Some(unit.into()),
            convert: true,
            role,
        };
        let inputs = l.problem.inputs.iter().map(|i| one(&i.name, &i.unit, Role::Input));
        let given = l.problem.given.iter().map(|g| one(&g.name, &g.unit, Role::Input));
        let demands = l.problem.demands.iter().map(|d| one(&d.output, &d.unit, Role::Output));
        let mut all: Vec<ChannelSpec> = inputs.chain(given).chain(demands).collect();
        for r in &l.responses {
            let derived = l.problem.derive.iter().any(|d| d.name == r.name);
            if !all.iter().any(|c| c.name == r.name) && (!derived || l.recorded().contains(&r.name)) {
                all.push(one(&r.name, &r.unit, Role::Output));
            }
        }
        all
    }

    /// Rows of the record by number of the point.
    fn rows(&self, table: &Table, count: usize) -> Result<Vec<Option<usize>>, MapError> {
        let rows = table.rows();
        if table.column(NUMBER).is_err() {
            if rows == count {
                return Ok((0..count).map(Some).collect());
            }
            return Err(MapError::Record(format!(
                "{}: {rows} rows, expected {count} as in the plan, or a column `{NUMBER}` with the numbers of its points",
                table.file
            )));
        }
        let mut places = vec![None; count];
        for (row, v) in table.numbers(NUMBER, 0, rows)?.iter().enumerate() {
            let number = *v as usize;
            let fits = *v == number as f64 && (1..=count).contains(&number);
            if !fits || places[number - 1].is_some() {
                return Err(MapError::Record(format!(
                    "{}, {}, column `{NUMBER}`: found {v}, expected each whole number from 1 to {count} once at most",
                    table.file,
                    table.place(row)
                )));
            }
            places[number - 1] = Some(row);
        }
        Ok(places)
    }

    /// Bed time of each row in s, from the first stamp of the day; none without stamps.
    fn times(&mut self, table: &Table) -> Result<Option<Vec<f64>>, MapError> {
        let Some(column) = measurement::time_column(table) else { return Ok(None) };
        let unit = column.unit.as_ref().map_or("s", |(u, _)| u.as_str());
        let scale = match unit {
            "s" => 1.0,
            "ms" => 1e-3,
            "min" => 60.0,
            "h" => 3600.0,
            _ => {
                return Err(MapError::Record(format!(
                    "{}, column `{}`: found unit `{unit}`, expected s, ms, min or h",
                    table.file, column.name
                )));
            }
        };
        let mut all: Vec<f64> =
            table.numbers(&column.name, 0, table.rows())?.iter().map(|t| t * scale).collect();
        let first = all.iter().copied().fold(f64::INFINITY, f64::min);
        let zero = *self.zero_s.get_or_insert(first);
        all.iter_mut().for_each(|t| *t -= zero);
        if let Some(row) = all.iter().position(|t| *t > LONGEST_S) {
            return Err(MapError::Record(format!(
                "{}, {}, column `{}`: found {:e} s after the begin of the day, expected at most {LONGEST_S:e}; leave the column out where stamps cannot be trusted",
                table.file,
                table.place(row),
                column.name,
                all[row]
            )));
        }
        if first - zero < self.used_s {
            return Err(MapError::Record(format!(
                "{}, column `{}`: begins {:.1} s after the begin of the day, found earlier than the end of the record before ({:.1} s), expected stamps that go on from file to file; leave the column out where they do not",
                table.file,
                column.name,
                first - zero,
                self.used_s
            )));
        }
        Ok(Some(all))
    }

    /// Where a point lies elsewhere than asked, in words; none where it was set as asked. `demanded`: share of its range by which a demand may be missed.
    fn elsewhere(&self, asked: &[f64], factors: &[f64], demanded: f64) -> Option<String> {
        let away = |((f, a), x): ((&Factor, &f64), &f64)| {
            let share = if matches!(f.kind, FactorKind::Demand(_)) { demanded } else { MISSED };
            ((x - a).abs() > share * (f.upper - f.lower))
                .then(|| format!("`{}` was {x:.4} {} where {a:.4} was asked", f.name, f.unit))
        };
        let all: Vec<String> = self.layout.factors.iter().zip(asked).zip(factors).filter_map(away).collect();
        (!all.is_empty()).then(|| all.join(", "))
    }

    /// A record most of whose points lie elsewhere is that of another plan, or has channels that are not what they are called.
    fn belongs(&self, table: &Table, points: &[DayPoint], asked: &[Task]) -> Result<(), MapError> {
        let measured = points.iter().zip(asked).filter(|(p, _)| p.point.factors[0].is_finite());
        // A bed that does not hold its demands is no other bed.
        let away = |(p, t): (&DayPoint, &Task)| self.elsewhere(&t.target, &p.point.factors, FAR);
        let away: Vec<String> = measured.clone().filter_map(away).collect();
        let count = measured.count();
        if away.len() as f64 > FOREIGN * count as f64 {
            return Err(MapError::Record(format!(
                "{}: {} of {} measured points were set elsewhere than planned, first: {}. Is it the record of another plan (seed or spec changed), or are channels or units exchanged?",
                table.file,
                away.len(),
                count,
                away[0]
            )));
        }
        Ok(())
    }

    /// The channels of a record.
    fn values(&self, table: &Table) -> Result<Dataset, MapError> {
        let layout = dataset::Layout {
            channels: self.channels(),
            time: Time::Steady,
            missing: Missing::Mark,
            ..dataset::Layout::default()
        };
        let all = dataset::datasets(table, &layout, &Select::All)?.remove(0);
        record::in_size(table, &all)?;
        Ok(all)
    }

    /// The points of `tasks` as the record at `path` has them; `earlier` are those of the day before.
    fn read(
        &mut self,
        path: &Path,
        tasks: &[Task],
        earlier: &[DayPoint],
        watch: Watch,
    ) -> Result<Vec<DayPoint>, MapError> {
        let table = dataset::read_table(path, None)?;
        table.notes.iter().for_each(|n| watch.note(n));
        for c in self.channels() {
            if table.column(&c.column)?.unit.is_none() {
                let unit = c.unit.unwrap_or_default();
                watch.note(&format!("{}: column `{}` has no unit: taken as {unit}", table.file, c.column));
            }
        }
        let all = self.values(&table)?;
        let stamps = self.times(&table)?;
        let rows = self.rows(&table, tasks.len())?;
        let mut points = Vec::new();
        for (Task { purpose, target: asked, .. }, row) in tasks.iter().zip(rows) {
            let at_s = row.and_then(|r| Some(stamps.as_ref()?[r]));
            let point = match row {
                Some(row) => match record::doubt(&all, row, self.layout) {
                    Some(note) => SteadyPoint { note, at_s: at_s.unwrap_or(0.0), ..self.absent(asked) },
                    None => self.point(asked, &one_row(&all, row), at_s.unwrap_or(0.0))?,
                },
                None => self.absent(asked),
            };
            if let Some(row) = row.filter(|_| !point.usable) {
                watch.note(&format!("{}, {}: {}", table.file, table.place(row), point.note));
            }
            points.push(DayPoint { purpose: *purpose, point });
        }
        self.belongs(&table, &points, tasks)?;
        self.leave_odd(earlier, &mut points, watch);
        for p in &mut points {
            let Some(words) = self.elsewhere(&p.point.asked, &p.point.factors, MISSED) else { continue };
            if p.purpose == Purpose::Verify {
                (p.point.usable, p.point.note) = (false, words);
            } else {
                // Learnt from where it was; what was asked for was not reached.
                (p.point.asked, p.point.note) = (p.point.factors.clone(), words);
            }
        }
        Ok(points)
    }

    /// Points with a response that nothing measured beside those of the day are not learnt from, and verify nothing.
    fn leave_odd(&self, earlier: &[DayPoint], points: &mut [DayPoint], watch: Watch) {
        for (k, r) in self.layout.responses.iter().enumerate() {
            let usable = earlier.iter().chain(points.iter()).filter(|p| p.point.usable);
            let all: Vec<f64> = usable.map(|p| p.point.responses[k]).filter(|v| v.is_finite()).collect();
            for (i, p) in points.iter_mut().enumerate().filter(|(_, p)| p.point.usable) {
                let value = p.point.responses[k];
                if record::odd(value, &all) {
                    let note =
                        format!("`{}` is {value} {}, far off all others: not believed", r.name, r.unit);
                    watch.note(&format!("point {}: {note}", i + 1));
                    (p.point.usable, p.point.note) = (false, note);
                }
            }
        }
    }

    /// The points of a plan that is there; none where it is not, or is not one of this layout.
    fn planned(&self, plan: &Path) -> Option<Vec<Task>> {
        let table = dataset::read_table(plan, None).ok()?;
        let verify = plan.file_stem().is_some_and(|s| s == "verify");
        let purpose = if verify { Purpose::Verify } else { Purpose::Plan };
        let column = |f: &Factor| table.numbers(&f.name, 0, table.rows()).ok();
        let columns: Vec<&[f64]> = self.layout.factors.iter().map(column).collect::<Option<_>>()?;
        let task = |row: usize| Task::new(purpose, columns.iter().map(|c| c[row]).collect());
        Some((0..table.rows()).map(task).collect())
    }

    fn point(&self, asked: &[f64], row: &Dataset, at_s: f64) -> Result<SteadyPoint, MapError> {
        let l = self.layout;
        let gaps: Vec<&str> =
            row.channels.iter().filter(|c| !c.values[0].is_finite()).map(|c| c.name.as_str()).collect();
        if !gaps.is_empty() {
            let note = format!("no number for `{}`", gaps.join("`, `"));
            return Ok(SteadyPoint { note, at_s, ..self.absent(asked) });
        }
        let refused = |e: dynocal_ident::derived::DerivedError| MapError::Record(e.to_string());
        let (factors, responses) = l.means(row).map_err(refused)?;
        let mut note = String::new();
        let mut errors = Vec::new();
        for (k, d) in l.problem.demands.iter().enumerate() {
            let error =
                row.values(&d.output).map_err(|e| MapError::Record(e.to_string()))?[0] - l.demand(k, asked);
            let held = !l.factors.iter().any(|f| f.name == d.output);
            if held && error.abs() > MISSED * (d.upper - d.lower) {
                note = format!("`{}` is {error:.4} {} away from what was asked", d.output, d.unit);
            }
            errors.push(error);
        }
        let usable = note.is_empty();
        let (touched, saturated) = (Vec::new(), Vec::new());
        let asked = asked.to_vec();
        Ok(SteadyPoint {
            asked,
            factors,
            responses,
            errors,
            usable,
            note,
            touched,
            saturated,
            at_s,
            used_s: 0.0,
        })
    }

    fn absent(&self, asked: &[f64]) -> SteadyPoint {
        SteadyPoint {
            asked: asked.to_vec(),
            factors: vec![f64::NAN; self.layout.factors.len()],
            responses: vec![f64::NAN; self.layout.responses.len()],
            errors: vec![f64::NAN; self.layout.problem.demands.len()],
            usable: false,
            note: "the record of the bed has no such point".into(),
            touched: Vec::new(),
            saturated: Vec::new(),
            at_s: self.used_s,
            used_s: 0.0,
        }
    }
}

/// What a bed has: the channels of the problem, and those of its first record that meter what is minimised or stand against it.
pub(super) fn variables(
    problem: &CalibrationProblem,
    others: &[&String],
    folder: &Path,
) -> Result<Vec<Variable>, MapError> {
    let variable = |name: &str, unit: &str, causality, lower: f64, upper: f64| Variable {
        name: name.into(),
        unit: unit.into(),
        causality,
        min: lower,
        max: upper,
        start: 0.5 * (lower + upper),
    };
    let output = |name: &str, unit: &str| variable(name, unit, Causality::Output, f64::MIN, f64::MAX);
    let derived = |name: &str| problem.derive.iter().any(|d| d.name == name);
    let inputs =
        problem.inputs.iter().map(|i| variable(&i.name, &i.unit, Causality::Input, i.lower, i.upper));
    let given = problem.given.iter().map(|g| variable(&g.name, &g.unit, Causality::Input, g.lower, g.upper));
    let demands = problem.demands.iter().map(|d| output(&d.output, &d.unit));
    let limits = problem.limits.iter().filter(|l| !derived(&l.output)).map(|l| output(&l.output, &l.unit));
    let mut all: Vec<Variable> = inputs.chain(given).chain(demands).chain(limits).collect();
    let found = measurement::called(&OnBed::measured(folder), "points01");
    let table = found.first().map(|f| dataset::read_table(f, None)).transpose()?;
    let meters = problem.minimise.iter().map(|m| &m.channel).chain(others.iter().copied());
    for name in meters {
        let column = table.as_ref().and_then(|t| t.column(name).ok());
        // Before the first record nothing is known of meters: what is not derived is asked for.
        if all.iter().any(|v| v.name == *name) || (column.is_none() && derived(name)) {
            continue;
        }
        let unit = problem.unit(name).map(str::to_string);
        let of_file = column.and_then(|c| c.unit.as_ref().map(|(u, _)| u.clone()));
        all.push(output(name, &unit.or(of_file).unwrap_or_else(|| "-".into())));
    }
    Ok(all)
}

/// What a bed has measured of a plan, as far as it can be told without running the day.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Given {
    /// The record.
    pub file: String,
    /// Its points.
    pub points: usize,
    /// Those of them that can be used.
    pub usable: usize,
}

/// Reads what is measured so far of a day on a bed, as far as it can be read without running the day.
pub(super) fn given(layout: &Layout, folder: &Path, batches: usize) -> Result<Vec<Given>, MapError> {
    let (mut bed, mut points) = (OnBed::new(layout, folder, Vec::new()), Vec::new());
    let names = (1..=batches).map(|k| format!("points{k:02}")).chain(["verify".to_string()]);
    let mut out = Vec::new();
    for name in names {
        let Some(file) = OnBed::record(folder, &name)? else { continue };
        let table = dataset::read_table(&file, None)?;
        let usable = if let Some(tasks) = bed.planned(&folder.join(format!("{name}.csv"))) {
            let read = bed.read(&file, &tasks, &points, Watch::silent())?;
            bed.used_s = read.iter().map(|p| p.point.at_s).fold(bed.used_s, f64::max);
            points.extend(read);
            points.iter().rev().take(tasks.len()).filter(|p| p.point.usable).count()
        } else {
            // Without its plan nothing is known of what was asked for.
            let all = bed.values(&table)?;
            bed.times(&table)?;
            let whole = |row: &usize| all.channels.iter().all(|c| c.values[*row].is_finite());
            let fits = |row: &usize| record::doubt(&all, *row, layout).is_none();
            (0..table.rows()).filter(whole).filter(fits).count()
        };
        out.push(Given { file: file.display().to_string(), points: table.rows(), usable });
    }
    Ok(out)
}

/// One row of a table of points.
fn one_row(all: &Dataset, row: usize) -> Dataset {
    let mut one = all.clone();
    one.channels.iter_mut().for_each(|c| c.values = vec![c.values[row]]);
    one
}

impl Bench for OnBed<'_> {
    fn run(
        &mut self,
        tasks: Vec<Task>,
        _bed_s: f64,
        points: &mut Vec<DayPoint>,
        watch: Watch,
    ) -> Result<DayEnd, MapError> {
        if tasks.is_empty() {
            return Ok(DayEnd::Done);
        }
        let verify = tasks.iter().all(|t| t.purpose == Purpose::Verify);
        self.batches += usize::from(!verify);
        let name = if verify { "verify".to_string() } else { format!("points{:02}", self.batches) };
        let (plan, measured) = (self.folder.join(format!("{name}.csv")), Self::measured(self.folder));
        self.write_plan(&plan, &tasks)?;
        std::fs::create_dir_all(&measured)
            .map_err(|e| FilesError::Write { path: measured.display().to_string(), reason: e.to_string() })?;
        let Some(file) = Self::record(self.folder, &name)? else {
            let one = |c: &ChannelSpec| format!("{} [{}]", c.name, c.unit.as_deref().unwrap_or("-"));
            let channels: Vec<String> = self.channels().iter().map(one).collect();
            return Err(MapError::NeedsMeasurement {
                count: tasks.len(),
                plan: plan.display().to_string(),
                measured: measured.join(format!("{name}.csv")).display().to_string(),
                channels: channels.join(", "),
                others: self.others(&measured),
            });
        };
        let read = self.read(&file, &tasks, points, watch)?;
        self.used_s = read.iter().map(|p| p.point.at_s).fold(self.used_s, f64::max);
        if let Some(last) = read.iter().rev().find(|p| p.point.usable) {
            self.at.clone_from(&last.point.factors);
        }
        points.extend(read);
        Ok(DayEnd::Done)
    }
    fn sweep(&mut self, _from: &[f64], _legs: &[Leg], _watch: Watch) -> Result<Option<Swept>, MapError> {
        Ok(None)
    }
    fn goes_on(&self) -> bool {
        false
    }
    fn stands_at(&self) -> &[f64] {
        &self.at
    }
    fn used_s(&self) -> f64 {
        self.used_s
    }
    fn widen_limits(&mut self, _share: f64) {}
}
