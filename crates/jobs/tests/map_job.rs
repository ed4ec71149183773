//! The job `map` on an engine in closed form whose optimum is known, and on beds that fail.

use dynocal_calib::steady::cell::{CellOptimum, Price};
use dynocal_calib::steady::grid::CellState;
use dynocal_files::run_folder::RunFolder;
use dynocal_ident::plant::{Causality, LimitEvent, Plant, PlantError, PlantState, Variable, show};
use dynocal_jobs::export::{self, ExportSpec};
use dynocal_jobs::map::{MapError, Mapped, job, store, work};
use dynocal_jobs::place::Overrides;
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::watch::Watch;

/// How a bed fails.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Fault {
    None,
    /// It refuses to go on after so many seconds.
    Stalls(f64),
    /// Torque swings for ever.
    Swings,
    /// Knock does not depend on anything.
    NoSignal,
}

/// Torque = load eff(spark, cam), behind a lag of 0.3 s:
///
/// ```text
/// eff   = 1 - 0.2 (spark - s0)^2 - 0.1 (cam - c0)^2,   s0 = 0.7 + 0.2 n,  c0 = 0.3 + 0.3 n,   n = speed / 1000 - 1
/// knock = 0.2 + 0.006 torque + 0.6 spark
/// heat  = 500 + 3 torque - 100 spark + 150 cam
/// fuel  = load
/// ```
struct Bench {
    variables: Vec<Variable>,
    noise: f64,
    shift: f64,
    fault: Fault,
    rng: Rng64,
    torque: f64,
    time_s: f64,
    shown: Vec<f64>,
}

const OUTPUTS: [(&str, &str); 4] = [("torque", "Nm"), ("knock", "-"), ("heat", "K"), ("fuel", "kg/h")];

impl Bench {
    fn new(noise: f64, fault: Fault) -> Self {
        let variable = |name: &str, unit: &str, causality, min, max, start| Variable {
            name: name.into(),
            unit: unit.into(),
            causality,
            min,
            max,
            start,
        };
        let mut variables = vec![
            variable("load", "kg/h", Causality::Input, 0.0, 200.0, 50.0),
            variable("spark", "-", Causality::Input, 0.0, 1.0, 0.3),
            variable("cam", "-", Causality::Input, 0.0, 1.0, 0.5),
            variable("speed", "rpm", Causality::Input, 0.0, 1e4, 1500.0),
        ];
        variables.extend(OUTPUTS.map(|(n, u)| variable(n, u, Causality::Output, -1e6, 1e6, 0.0)));
        Self {
            variables,
            noise,
            shift: 0.0,
            fault,
            rng: Rng64::new(0),
            torque: 0.0,
            time_s: 0.0,
            shown: vec![0.0; 4],
        }
    }

    /// Another engine: its best spark lies elsewhere.
    fn shifted(self, shift: f64) -> Self {
        Self { shift, ..self }
    }
}

impl Plant for Bench {
    fn variables(&self) -> &[Variable] {
        &self.variables
    }
    fn reset(&mut self, seed: u64) {
        (self.rng, self.torque, self.time_s) = (Rng64::new(seed), 0.0, 0.0);
        self.shown.fill(0.0);
    }
    fn step(&mut self, u: &[f64], dt_s: f64, y: &mut [f64]) -> Result<(), PlantError> {
        if let Fault::Stalls(s) = self.fault
            && self.time_s > s
        {
            return Err(PlantError::Call("the engine has stalled".into()));
        }
        let [load, spark, cam, speed] = u else { return Err(PlantError::Call("four inputs".into())) };
        let n = speed / 1000.0 - 1.0;
        let (s0, c0) = (0.7 + 0.2 * n + self.shift, 0.3 + 0.3 * n);
        let eff = 1.0 - 0.2 * (spark - s0).powi(2) - 0.1 * (cam - c0).powi(2);
        self.torque += (load * eff - self.torque) * (1.0 - (-dt_s / 0.3f64).exp());
        self.time_s += dt_s;
        let mut scatter = |size: f64| size * self.noise * self.rng.normal();
        let swing = if self.fault == Fault::Swings { 15.0 * (2.0 * self.time_s).sin() } else { 0.0 };
        y[0] = self.torque + swing + scatter(0.5);
        y[1] = match self.fault {
            Fault::NoSignal => 0.97 + scatter(0.05),
            _ => 0.2 + 0.006 * self.torque + 0.6 * spark + scatter(0.02),
        };
        y[2] = 500.0 + 3.0 * self.torque - 100.0 * spark + 150.0 * cam + scatter(2.0);
        y[3] = load + scatter(0.05);
        self.shown.copy_from_slice(y);
        Ok(())
    }
    fn outputs(&self, y: &mut [f64]) -> Result<(), PlantError> {
        show(&self.shown, y)
    }
    fn time_s(&self) -> f64 {
        self.time_s
    }
    fn take_events(&mut self) -> Vec<LimitEvent> {
        Vec::new()
    }
    fn save(&self) -> PlantState {
        PlantState([&[self.torque, self.time_s], &self.shown[..]].concat())
    }
    fn restore(&mut self, state: &PlantState) -> Result<(), PlantError> {
        (self.torque, self.time_s) = (state.0[0], state.0[1]);
        self.shown.copy_from_slice(&state.0[2..]);
        Ok(())
    }
    fn describe(&self) -> String {
        "bench".into()
    }
}

/// The best setting: spark limited by knock, cam by heat. On the boundary of heat spark and cam trade, so that both are found from
/// the conditions of the first order by a fine search of the closed form.
fn best(torque: f64, speed: f64, shift: f64) -> (f64, f64, f64) {
    let n = speed / 1000.0 - 1.0;
    let (s0, c0) = (0.7 + 0.2 * n + shift, 0.3 + 0.3 * n);
    let mut found = (f64::INFINITY, 0.0, 0.0);
    for i in 0..=2000 {
        let spark = f64::from(i) / 2000.0;
        if 0.2 + 0.006 * torque + 0.6 * spark > 1.0 + 1e-12 {
            break;
        }
        let most = ((720.0 - 500.0 - 3.0 * torque + 100.0 * spark) / 150.0).min(1.0);
        if most < 0.0 {
            continue;
        }
        let cam: f64 = c0.clamp(0.0, most);
        let fuel = torque / (1.0 - 0.2 * (spark - s0).powi(2) - 0.1 * (cam - c0).powi(2));
        if fuel < found.0 {
            found = (fuel, spark, cam);
        }
    }
    found
}

fn text(more: &str) -> String {
    format!(
        r#"
sample_time_s = 0.1
[problem]
minimise = [{{ channel = "fuel", weight = 1.0 }}]
[[problem.derive]]
name = "fuel"
unit = "kg/h"
factor = 1.0
powers = {{ load = 1 }}
[[problem.inputs]]
name = "load"
unit = "kg/h"
lower = 5.0
upper = 150.0
[[problem.inputs]]
name = "spark"
unit = "-"
lower = 0.0
upper = 1.0
[[problem.inputs]]
name = "cam"
unit = "-"
lower = 0.0
upper = 1.0
[[problem.given]]
name = "speed"
unit = "rpm"
lower = 1000.0
upper = 2000.0
[[problem.demands]]
output = "torque"
unit = "Nm"
lower = 20.0
upper = 80.0
[[problem.limits]]
output = "knock"
unit = "-"
upper = 1.0
[[problem.limits]]
output = "heat"
unit = "K"
upper = 720.0
[[loops]]
output = "torque"
input = "load"
gains = {{ ki = 1.0, kp = 0.2 }}
[axes]
torque = [30.0, 50.0, 70.0]
speed = [1100.0, 1500.0, 1900.0]
{more}
"#
    )
}

fn run_with(more: &str, seed: u64, mut plant: Bench) -> Result<Mapped, MapError> {
    let job = job::parse("map.toml", &text(more), &Overrides { seed: Some(seed), out: None }).unwrap();
    work::run_on(&job, &mut plant, Watch::silent())
}

const DAY: &str =
    "[bed]\npoints = 54\nblock = 10\n[bed.approach]\nsettle_s = 12.0\nwindow_s = 1.0\naverage_s = 2.0\n";

/// Fuel that the engine takes at a setting in closed form.
fn fuel(torque: f64, speed: f64, spark: f64, cam: f64, shift: f64) -> f64 {
    let n = speed / 1000.0 - 1.0;
    let (s0, c0) = (0.7 + 0.2 * n + shift, 0.3 + 0.3 * n);
    torque / (1.0 - 0.2 * (spark - s0).powi(2) - 0.1 * (cam - c0).powi(2))
}

#[test]
fn maps_are_near_the_known_optimum_and_keep_their_limits() {
    for (seed, noise, shift) in [(1, 0.0, 0.0), (2, 1.0, 0.0), (3, 1.0, -0.2)] {
        let found = run_with(DAY, seed, Bench::new(noise, Fault::None).shifted(shift)).unwrap();
        assert_eq!(found.cells.len(), 9);
        // Where limits keep the bed away cells are filled and marked; everything else holds an optimum.
        let optimal: Vec<_> = found.cells.iter().filter(|c| c.state == CellState::Optimal).collect();
        assert!(optimal.len() >= 6, "seed {seed}: {:?}", found.warnings);
        assert!(
            found.cells.iter().all(|c| c.state != CellState::Infeasible),
            "seed {seed}: {:?}",
            found.warnings
        );
        for c in optimal {
            let (torque, speed) = (c.at[0], c.at[1]);
            let (spark, cam) = (c.optimum.x[2], c.optimum.x[3]);
            let (least, ..) = best(torque, speed, shift);
            let got = fuel(torque, speed, spark, cam, shift);
            assert!(got <= 1.01 * least, "seed {seed} at {torque} Nm, {speed} rpm: {got} against {least}");
            let knock = 0.2 + 0.006 * torque + 0.6 * spark;
            let heat = 500.0 + 3.0 * torque - 100.0 * spark + 150.0 * cam;
            assert!(
                knock <= 1.02 && heat <= 725.0,
                "seed {seed} at {torque} Nm, {speed} rpm: {knock} {heat}"
            );
        }
        assert!(found.valid, "seed {seed}: {} {:?}", found.verdict, found.warnings);
        // At 50 Nm and 1900 rpm the best spark, 0.88, lies beyond what knock allows, 0.83: the limit has a price.
        // With noise that is worth less than what the models do not know.
        if noise == 0.0 {
            let cell = found.cells.iter().find(|c| c.at == [50.0, 1900.0]).unwrap();
            let knock = found.layout.responses.iter().position(|r| r.name == "knock").unwrap();
            let saves = |p: &Price| p.response == knock && p.saves > 1e-3;
            assert!(cell.optimum.prices.iter().any(saves), "seed {seed}: {:?}", cell.optimum.prices);
        }
        // Bed time is counted: all that the plant has seen.
        assert!(found.bed.all_s() > 48.0 * 3.0 && found.bed.all_s() < 48.0 * 30.0, "{:?}", found.bed);
    }
}

/// Heat falls with spark and rises with cam: it is traded against fuel, and maps are taken where it has 98 % of what the map of
/// least fuel has.
#[test]
fn maps_are_taken_from_a_front() {
    let front = "[optimise.front]\nagainst = \"heat\"\npoints = 5\ntake = 0.98\n";
    let found = run_with(&format!("{DAY}{front}"), 1, Bench::new(0.0, Fault::None)).unwrap();
    let f = found.front.as_ref().unwrap();
    let taken = f.taken.as_ref().expect("within reach");
    assert!(f.points.len() >= 3 && f.unit == "K", "{f:?}");
    assert!(f.points.windows(2).all(|w| w[0].other > w[1].other && w[0].minimised < w[1].minimised));
    let share = taken.other / f.points[0].other;
    assert!((0.978..=0.98).contains(&share), "{share}");
    // The engine itself: less heat, more fuel in the cells, by what the front promises.
    let mean = |cells: &[CellOptimum], of: &dyn Fn(f64, f64, f64, f64) -> f64| {
        let all: Vec<f64> = cells.iter().map(|c| of(c.x[0], c.x[1], c.x[2], c.x[3])).collect();
        all.iter().sum::<f64>() / all.len() as f64
    };
    let heat = |t: f64, _: f64, spark: f64, cam: f64| 500.0 + 3.0 * t - 100.0 * spark + 150.0 * cam;
    let burnt = |t: f64, n: f64, spark: f64, cam: f64| fuel(t, n, spark, cam, 0.0);
    let ratio = mean(&taken.cells, &heat) / mean(&f.points[0].cells, &heat);
    assert!((0.97..0.985).contains(&ratio), "{ratio}");
    let more = mean(&taken.cells, &burnt) / mean(&f.points[0].cells, &burnt) - 1.0;
    let promised = taken.minimised / f.points[0].minimised - 1.0;
    assert!(more > 0.0 && (more - promised).abs() < 0.005, "{more} where {promised} was promised");
    // The maps are those of the point that was taken.
    let optimal = found.cells.iter().filter(|c| c.state == CellState::Optimal);
    let maps: Vec<CellOptimum> = optimal.map(|c| c.optimum.clone()).collect();
    for of in [&heat as &dyn Fn(f64, f64, f64, f64) -> f64, &burnt] {
        assert!((mean(&maps, of) / mean(&taken.cells, of) - 1.0).abs() < 1e-12);
    }
    // Out of reach is said, and the maps are not valid.
    let far =
        run_with(&format!("{DAY}{}", front.replace("0.98", "0.1")), 1, Bench::new(0.0, Fault::None)).unwrap();
    assert!(!far.valid && far.front.unwrap().taken.is_none());
    let unknown =
        run_with(&format!("{DAY}{}", front.replace("heat", "smoke")), 1, Bench::new(0.0, Fault::None));
    let said = unknown.map(|m| m.verdict).unwrap_err().to_string();
    assert!(said.contains("`smoke`") && said.contains("heat [K]"), "{said}");
}

/// Maps as an ECU holds them: fewer breakpoints, spark and cam in steps, and what is lost said.
#[test]
fn maps_have_the_breakpoints_and_steps_of_an_ecu() {
    let asked = "[optimise.breakpoints]\nspeed = 2\n[optimise.resolution]\nspark = 0.05\ncam = 0.1\n";
    let found = run_with(&format!("{DAY}{asked}"), 1, Bench::new(0.0, Fault::None)).unwrap();
    assert_eq!(found.axes[1].points, [1100.0, 1900.0]);
    assert_eq!((found.cells.len(), found.map.points.len(), found.map.given.len()), (6, 6, 2));
    let whole = |v: f64| (v - v.round()).abs() < 1e-9;
    for c in &found.cells {
        assert!(whole(c.optimum.x[2] / 0.05) && whole(c.optimum.x[3] / 0.1), "{:?}", c.optimum.x);
        // As short as the steps are.
        for v in &c.optimum.x[2..] {
            assert!(format!("{v}").split('.').nth(1).is_none_or(|d| d.len() <= 2), "{v}");
        }
    }
    let d = found.delivered.as_ref().unwrap();
    assert!(d.full_cells == 9 && d.mean_loss > -0.01 && d.mean_loss <= d.largest_loss, "{d:?}");
    assert!(d.largest_loss < 0.02, "best spark and cam lie nearly on a plane: {d:?}");
    let fault = |more: &str| {
        let text = text(&format!("{DAY}{more}"));
        job::parse("map.toml", &text, &Overrides::default()).map(|_| ()).unwrap_err().to_string()
    };
    let e = fault(
        "[optimise.breakpoints]\nspeed = 9\nsped = 2\n[optimise.resolution]\nload = 1.0\nspark = 0.0\n",
    );
    for said in
        ["optimise.breakpoints.speed", "sped", "optimise.resolution.load", "optimise.resolution.spark"]
    {
        assert!(e.contains(said), "{said}: {e}");
    }
}

/// What a bed writes for a plan: the engine in closed form at every row, its loops holding torque.
fn played(plan: &str, skip: usize, begin_s: usize) -> String {
    let mut lines = plan.lines();
    let head = lines.next().unwrap();
    assert_eq!(head, "point,purpose,torque [Nm],speed [rpm],spark [-],cam [-]");
    let mut out = String::from(
        "point,time [s],load [kg/h],spark [-],cam [-],speed [rpm],torque [Nm],knock [-],heat [K],fuel [kg/h]\n",
    );
    for (row, line) in lines.enumerate().skip(skip) {
        let cells: Vec<&str> = line.split(',').collect();
        let [torque, speed, spark, cam] = [2, 3, 4, 5].map(|k: usize| cells[k].parse::<f64>().unwrap());
        let load = fuel(torque, speed, spark, cam, 0.0);
        let knock = 0.2 + 0.006 * torque + 0.6 * spark;
        let heat = 500.0 + 3.0 * torque - 100.0 * spark + 150.0 * cam;
        let time = begin_s + 20 * row;
        out += &format!("{},{time},{load},{spark},{cam},{speed},{torque},{knock},{heat},{load}\n", cells[0]);
    }
    out
}

fn write(path: &std::path::Path, text: String) {
    dynocal_files::atomic::write(path, text.as_bytes()).unwrap();
}

/// A bed that is driven through files alone: the plan, batches that follow the optimum, the verification; every call goes on.
#[test]
fn a_bed_measures_the_day_from_files() {
    let tmp = tempfile::tempdir().unwrap();
    let out = tmp.path().join("run");
    let over = Overrides { seed: Some(1), out: Some(out.clone()) };
    let spec = format!("{}[plant]\nname = \"bed\"\n", text(DAY));
    let job = job::parse("map.toml", &spec, &over).unwrap();
    let mut asked = Vec::new();
    let found = loop {
        match dynocal_jobs::map::run(&job, Watch::silent()) {
            Ok((found, _)) => break found,
            Err(MapError::NeedsMeasurement { plan, measured, channels, .. }) => {
                assert!(asked.len() < 12 && channels.contains("heat [K]"), "{asked:?} {channels}");
                let plan = std::fs::read_to_string(&plan).unwrap();
                // The bed could not measure the first point of the first plan.
                let skip = usize::from(asked.is_empty());
                write(std::path::Path::new(&measured), played(&plan, skip, 2000 * asked.len()));
                asked.push(
                    std::path::Path::new(&measured).file_stem().unwrap().to_string_lossy().into_owned(),
                );
            }
            Err(e) => panic!("{e}"),
        }
    };
    assert!(asked.len() > 2 && asked[0] == "points01" && asked[asked.len() - 1] == "verify", "{asked:?}");
    assert!(found.valid, "{} {:?}", found.verdict, found.warnings);
    assert_eq!(found.points.iter().filter(|p| !p.point.usable).count(), 1);
    for c in found.cells.iter().filter(|c| c.state == CellState::Optimal) {
        let (least, ..) = best(c.at[0], c.at[1], 0.0);
        let got = fuel(c.at[0], c.at[1], c.optimum.x[2], c.optimum.x[3], 0.0);
        assert!(got <= 1.01 * least, "{:?}: {got} against {least}", c.at);
    }
    // Records that do not fit are refused with what is wrong.
    let first = out.join("measured/points01.csv");
    let good = std::fs::read_to_string(&first).unwrap();
    let wrong = |text: String| {
        write(&first, text);
        dynocal_jobs::map::run(&job, Watch::silent()).map(|_| ()).unwrap_err().to_string()
    };
    let e = wrong(good.replacen("\n2,", "\n99,", 1));
    assert!(e.contains("points01.csv, line 2") && e.contains("99"), "{e}");
    // What can be said without running the day, `--check` says.
    let e = work::given(&job).unwrap_err().to_string();
    assert!(e.contains("points01.csv, line 2") && e.contains("99"), "{e}");
    let heat = good.lines().next().unwrap().split(',').position(|h| h == "heat [K]").unwrap();
    let huge = |(k, line): (usize, &str)| {
        let mut cells: Vec<&str> = line.split(',').collect();
        if k == 3 {
            cells[heat] = "6e300";
        }
        cells.join(",")
    };
    let e = wrong(good.lines().enumerate().map(huge).collect::<Vec<_>>().join("\n"));
    assert!(e.contains("points01.csv, line 4, column `heat`: found 6e300"), "{e}");
    write(&first, good.clone());
    let given = work::given(&job).unwrap();
    assert_eq!(given.len(), asked.len(), "{given:?}");
    let e = wrong(good.replacen("heat [K]", "heat [degC]", 1).replacen("knock", "nock", 1));
    assert!(e.contains("knock"), "{e}");
    // Another unit of time is another unit: 20 min apart, and the next file begins before this one ends.
    let e = wrong(good.replacen("time [s]", "time [min]", 1));
    assert!(e.contains("points02.csv") && e.contains("go on from file to file"), "{e}");
    // Spark that was never set as asked: the record of another plan, or a scale.
    let halved = |line: &str| -> String {
        let cells: Vec<&str> = line.split(',').collect();
        let spark: f64 = cells[3].parse().unwrap_or(f64::NAN);
        if spark.is_finite() {
            line.replacen(cells[3], &(0.5 * spark).to_string(), 1)
        } else {
            line.to_string()
        }
    };
    let e = wrong(good.lines().map(halved).collect::<Vec<_>>().join("\n"));
    assert!(e.contains("set elsewhere than planned") && e.contains("`spark`"), "{e}");
    // A verification that stood still verifies nothing.
    write(&first, good.clone());
    let verify = out.join("measured/verify.csv");
    let rows = std::fs::read_to_string(&verify).unwrap();
    let kept: Vec<&str> = rows.lines().nth(1).unwrap().splitn(3, ',').collect();
    let still = |(k, line): (usize, &str)| match k {
        0 => line.to_string(),
        _ => format!("{},{},{}", line.split(',').next().unwrap(), line.split(',').nth(1).unwrap(), kept[2]),
    };
    write(&verify, rows.lines().enumerate().map(still).collect::<Vec<_>>().join("\n"));
    let e = dynocal_jobs::map::run(&job, Watch::silent()).map(|_| ()).unwrap_err().to_string();
    assert!(e.contains("verify.csv") && e.contains("set elsewhere than planned"), "{e}");
    let two_rows: Vec<&str> = good.lines().take(3).collect();
    let e = wrong(two_rows.join("\n").replace("point,", "number,"));
    assert!(e.contains("2 rows, expected"), "{e}");
}

#[test]
fn equal_seeds_give_equal_days_and_other_seeds_other_ones() {
    let day = |seed| {
        serde_json::to_string(&run_with(DAY, seed, Bench::new(1.0, Fault::None)).unwrap().points).unwrap()
    };
    let one = day(5);
    assert_eq!(one, day(5));
    assert_ne!(one, day(6));
}

/// Ctrl-C after a dozen points, then the same again: the day is the one that was never interrupted.
#[test]
fn an_interrupted_day_goes_on_where_it_stopped() {
    let read = |seed| job::parse("map.toml", &text(DAY), &Overrides { seed: Some(seed), out: None }).unwrap();
    let said = |m: &Mapped| serde_json::to_string(&(&m.points, &m.cells, &m.verified)).unwrap();
    let bench = || Bench::new(0.0, Fault::None);
    let whole = said(&work::run_on(&read(1), &mut bench(), Watch::silent()).unwrap());
    let tmp = tempfile::tempdir().unwrap();
    let file = tmp.path().join("day.jsonl");
    let lines = || std::fs::read_to_string(&file).map_or(0, |t| t.lines().count());
    let stop = || lines() > 12;
    let early = Watch { interrupt: &stop, ..Watch::silent() };
    let e = work::run_on_in(&read(1), &mut bench(), Some(tmp.path()), early).unwrap_err();
    assert!(matches!(e, MapError::Interrupted), "{e}");
    assert_eq!(lines(), 13, "a head and twelve points");
    let go_on = |seed| {
        let notes = std::sync::Mutex::new(Vec::new());
        let note = |n: &str| notes.lock().unwrap().push(n.to_string());
        let watch = Watch { note: &note, ..Watch::silent() };
        let found = work::run_on_in(&read(seed), &mut bench(), Some(tmp.path()), watch).unwrap();
        (said(&found), notes.into_inner().unwrap().join("\n"))
    };
    let (found, notes) = go_on(1);
    assert!(notes.contains("12 points are those of the earlier run"), "{notes}");
    assert!(found == whole, "the same day");
    // A line that was cut off is measured again.
    let text = std::fs::read_to_string(&file).unwrap();
    let points = text.lines().count() - 1;
    write(&file, text[..text.len() - 30].to_string());
    let (found, notes) = go_on(1);
    assert!(notes.contains(&format!("{} points are those", points - 1)) && found == whole, "{notes}");
    // Nothing of another seed is taken.
    let (found, notes) = go_on(2);
    assert!(!notes.contains("earlier run") && found != whole, "{notes}");
}

/// The map of the load holds torque alone: it is the load that the closed form takes at the settings of the cells.
#[test]
fn the_map_of_a_driven_input_is_that_of_the_closed_form() {
    let found = run_with(DAY, 1, Bench::new(0.0, Fault::None)).unwrap();
    let d = &found.drives[0];
    assert!(d.input == "load" && d.relative && !d.rough() && d.error < 0.01, "{}", d.words());
    for c in found.cells.iter().filter(|c| c.state == CellState::Optimal) {
        let load = fuel(c.at[0], c.at[1], c.optimum.x[2], c.optimum.x[3], 0.0);
        let (got, d) = (c.optimum.responses[0], c.optimum.deviations[0]);
        assert!(
            (got / load - 1.0).abs() < 0.01 && d > 0.0 && d < 0.05 * load,
            "{:?}: {got} against {load}",
            c.at
        );
    }
    let place = found.map.ports.actuators.iter().position(|a| a.name == "load").unwrap();
    assert!(
        found.map.points.iter().zip(&found.cells).all(|(p, c)| p.actuators[place] == c.optimum.responses[0])
    );
    // Channels that it cannot follow from are named.
    for (more, says) in [
        ("load = [\"fuel\"]", "a channel that does not follow from `load` itself"),
        ("load = [\"nock\"]", "nock"),
        ("load = []", "0 channels"),
        ("spark = [\"knock\"]", "spark"),
    ] {
        let text = text(&format!("{DAY}[models.over]\n{more}\n"));
        let e = job::parse("map.toml", &text, &Overrides::default()).map(|_| ()).unwrap_err().to_string();
        assert!(e.contains("models.over") && e.contains(says), "{more}: {e}");
    }
}

/// A bed on which every setting gives the same point: copies are no knowledge.
#[test]
fn points_that_are_all_the_same_are_refused_with_their_numbers() {
    let tmp = tempfile::tempdir().unwrap();
    let over = Overrides { seed: Some(1), out: Some(tmp.path().join("run")) };
    let job = job::parse("map.toml", &format!("{}[plant]\nname = \"bed\"\n", text(DAY)), &over).unwrap();
    let Err(MapError::NeedsMeasurement { plan, measured, .. }) =
        dynocal_jobs::map::run(&job, Watch::silent())
    else {
        panic!("a bed has to measure first")
    };
    let good = played(&std::fs::read_to_string(plan).unwrap(), 0, 0);
    let first: Vec<&str> = good.lines().nth(1).unwrap().splitn(3, ',').collect();
    let copy = |(k, line): (usize, &str)| match k {
        0 => line.to_string(),
        _ => format!("{k},{},{}", line.split(',').nth(1).unwrap(), first[2]),
    };
    write(std::path::Path::new(&measured), good.lines().enumerate().map(copy).collect::<Vec<_>>().join("\n"));
    let e = dynocal_jobs::map::run(&job, Watch::silent()).map(|_| ()).unwrap_err().to_string();
    assert!(e.contains("points01.csv") && e.contains("set elsewhere than planned"), "{e}");
}

#[test]
fn a_bed_that_stalls_is_said_to_have_stalled() {
    let early = run_with(DAY, 1, Bench::new(0.1, Fault::Stalls(30.0))).unwrap_err().to_string();
    assert!(early.contains("the engine has stalled") && early.contains("points can be used"), "{early}");
    // After enough points there is a map, but not one to be used.
    let late = run_with(DAY, 1, Bench::new(0.1, Fault::Stalls(300.0))).unwrap();
    assert!(!late.valid && late.verdict.contains("must not be used"), "{}", late.verdict);
    assert!(late.warnings.iter().any(|w| w.contains("stalled")), "{:?}", late.warnings);
}

#[test]
fn points_that_never_settle_are_not_learnt_from() {
    let e = run_with(DAY, 1, Bench::new(0.1, Fault::Swings)).unwrap_err().to_string();
    assert!(e.contains("0 of ") && (e.contains("not at rest") || e.contains("oscillates")), "{e}");
}

#[test]
fn a_response_without_signal_is_refused_with_its_numbers() {
    let day = DAY.replace("[bed]\n", "[bed]\nbeyond = { knock = 1.0 }\n");
    let e = run_with(&day, 1, Bench::new(1.0, Fault::NoSignal)).map(|m| m.verdict).unwrap_err();
    assert!(matches!(&e, MapError::NoSignal { response, .. } if response == "knock"), "{e}");
}

/// Heat at most 560 K while 70 Nm alone give 500 + 210 - 100: no setting keeps it, and the day itself is stopped by it.
#[test]
fn an_empty_feasible_region_names_its_limits() {
    let text = text(&DAY.replace("[bed]\n", "[bed]\nbeyond = { heat = 500.0, knock = 1.0 }\n"));
    let text = text.replace("upper = 720.0", "upper = 560.0");
    let job = job::parse("map.toml", &text, &Overrides { seed: Some(1), out: None }).unwrap();
    let found = work::run_on(&job, &mut Bench::new(0.0, Fault::None), Watch::silent()).unwrap();
    assert!(!found.valid);
    let high: Vec<&String> = found.warnings.iter().filter(|w| w.contains("torque 70")).collect();
    assert!(high.iter().any(|w| w.contains("`heat`") && w.contains("above 560")), "{:?}", found.warnings);
    // 700 - 100 + ... with spark as far as knock lets it go: 0.63 at 70 Nm leaves 500 + 210 - 63 = 647, 87 K too much.
    let c = found.cells.iter().find(|c| c.at == [70.0, 1500.0]).unwrap();
    let worst = c.optimum.prices.iter().map(|p| p.passed).fold(f64::NEG_INFINITY, f64::max);
    assert!((40.0..95.0).contains(&worst), "{worst}");
}

#[test]
fn the_run_folder_holds_maps_that_leave_in_the_formats_of_ecus() {
    let tmp = tempfile::tempdir().unwrap();
    let out = tmp.path().join("run");
    let overrides = Overrides { seed: Some(1), out: Some(out.clone()) };
    let job = job::parse("map.toml", &text(DAY), &overrides).unwrap();
    let found = work::run_on(&job, &mut Bench::new(0.5, Fault::None), Watch::silent()).unwrap();
    let folder = RunFolder::open(&job.out, dynocal_jobs::map::KIND, &job.spec).unwrap();
    let found = store::write(&folder, &job, found).unwrap();
    assert!(found.files.iter().all(|f| out.join(f).is_file()), "{:?}", found.files);
    let page = std::fs::read_to_string(out.join("report.html")).unwrap();
    assert!(page.contains("keep limits and promise"));
    for (format, ending) in [("dcm", "dcm"), ("cdfx", "cdfx"), ("c", "c"), ("csv", "csv")] {
        let to = tmp.path().join(format);
        let spec = ExportSpec { to: vec![format.into()], ..ExportSpec::default() };
        let exported = export::run(&out, &to, &spec).unwrap();
        assert!(
            exported.files.iter().any(|f| f.extension().is_some_and(|e| e == ending)),
            "{format}: {:?}",
            exported.files
        );
    }
    let (maps, _) = export::characteristics(&out).unwrap();
    let spark = maps.iter().find(|m| m.name == "SPARK_MAP").unwrap();
    let expected: Vec<f64> = found.cells.iter().map(|c| c.optimum.x[2].clamp(0.0, 1.0)).collect();
    assert_eq!(spark.values.len(), 9);
    // Cells lie with the speed fast, and so does the map of the export.
    assert!(
        spark.values.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-9),
        "{:?} {expected:?}",
        spark.values
    );
}

/// A value that is held has to lie in the range of its channel.
#[test]
fn a_held_value_out_of_its_range_is_refused() {
    let text = text(DAY).replace("[axes]\ntorque = [30.0, 50.0, 70.0]\n", "[held]\ntorque = HELD\n[axes]\n");
    for (held, fine) in [("50.0", true), ("-1e308", false), ("nan", false), ("81.0", false)] {
        let read = job::parse("map.toml", &text.replace("HELD", held), &Overrides::default());
        assert_eq!(read.is_ok(), fine, "{held}");
        if let Err(e) = read {
            assert!(e.to_string().contains("`held.torque`") && e.to_string().contains("20 to 80 Nm"), "{e}");
        }
    }
}
