//! `dynocal signal SPEC.toml`: test signals for several channels together, with how they correlate and what of the
//! input space they cover.

use std::path::{Path, PathBuf};

use dynocal_files::run_folder::RunFolder;
use dynocal_files::spec::{Faults, load};
use dynocal_files::{atomic, csv_io};
use dynocal_ident::data::{Channel, Dataset, Role};
use dynocal_ident::excitation::correlation::{InputCorrelation, correlation};
use dynocal_ident::excitation::coverage::{Coverage, PAIR_CELLS, PairCoverage, coverage, pair_coverage};
use dynocal_ident::signal::analysis::{Analysis, analyse};
use dynocal_ident::signal::signal;
use dynocal_numerics::registry::BuildError;
use dynocal_numerics::rng::Rng64;
use dynocal_report::{Axis, Cell, Column, HeatMap, Report, Section, Table, XyPlot, render};
use serde::{Deserialize, Serialize};

use super::signal::{LAGS, MOST_SAMPLES, analysed};
use crate::common::Common;
use crate::failure::{Exit, Failure};
use crate::table;
use crate::terminal::{print, say};

/// Points of a pair that are drawn.
const DRAWN: usize = 4000;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Typed {
    name: Option<String>,
    out: Option<PathBuf>,
    length_s: Option<f64>,
    sample_time_s: Option<f64>,
    seed: Option<u64>,
    channels: Option<Vec<TypedChannel>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TypedChannel {
    name: Option<String>,
    unit: Option<String>,
    signal: Option<toml::Table>,
}

/// The request as understood.
#[derive(Serialize)]
struct Request {
    name: String,
    samples: usize,
    sample_time_s: f64,
    seed: u64,
    channels: Vec<Wanted>,
    #[serde(skip)]
    out: PathBuf,
}

#[derive(Serialize)]
struct Wanted {
    name: String,
    unit: String,
    signal: String,
    keys: toml::Table,
}

#[derive(Serialize)]
struct Summary<'a> {
    verb: &'static str,
    name: &'a str,
    valid: bool,
    warnings: &'a [String],
    signals: &'a Request,
    analyses: &'a [Analysis],
    coverage: &'a [Coverage],
    pairs: &'a [PairCoverage],
    correlations: &'a [InputCorrelation],
    files: [&'static str; 2],
}

/// The signals with what is known about them.
struct Made {
    columns: Vec<Vec<f64>>,
    analyses: Vec<Analysis>,
    coverage: Vec<Coverage>,
    pairs: Vec<PairCoverage>,
    correlations: Vec<InputCorrelation>,
    warnings: Vec<String>,
}

pub(super) fn run(path: &Path, common: &Common) -> Result<Exit, Failure> {
    let stem = path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    let folder = path.parent().unwrap_or(Path::new("")).to_path_buf();
    let request = load(path, |t: &Typed, faults| check(t, &folder, &stem, common, faults))?;
    let made = make(&request)?;
    let run_folder = RunFolder::open(&request.out, "signal", &request)?;
    let channel = |(w, values): (&Wanted, &Vec<f64>)| Channel {
        name: w.name.clone(),
        unit: w.unit.clone(),
        role: Role::Input,
        values: values.clone(),
    };
    let data = Dataset {
        name: request.name.clone(),
        sample_time_s: request.sample_time_s,
        channels: request.channels.iter().zip(&made.columns).map(channel).collect(),
        init_samples: 0,
        origin: format!("signals with seed {}", request.seed),
    };
    csv_io::write_dataset(&request.out.join("signal.csv"), &data)?;
    atomic::write(&request.out.join("report.html"), render(&report(&request, &made))?.as_bytes())?;
    let summary = run_folder.write_summary(&Summary {
        verb: "signal",
        name: &request.name,
        valid: true,
        warnings: &made.warnings,
        signals: &request,
        analyses: &made.analyses,
        coverage: &made.coverage,
        pairs: &made.pairs,
        correlations: &made.correlations,
        files: ["signal.csv", "report.html"],
    })?;
    for warning in &made.warnings {
        say(&format!("warning: {warning}"));
    }
    common.print_summary(&summary)?;
    if common.shows_text() {
        print(&text(&request, &made))?;
        let files = ["signal.csv", "report.html"].map(|f| request.out.join(f).display().to_string());
        print(&format!("\n{}\n", files.join("\n")))?;
    }
    Ok(Exit::Done)
}

fn check(t: &Typed, folder: &Path, stem: &str, common: &Common, faults: &mut Faults) -> Option<Request> {
    let dt = faults.required("sample_time_s", &t.sample_time_s, "sample time, s");
    let length = faults.required("length_s", &t.length_s, "length, s");
    dt.into_iter().for_each(|v| faults.positive("sample_time_s", v, "s"));
    let samples = dt.zip(length).map_or(2.0, |(dt, length)| (length / dt).round());
    if !(2.0..=MOST_SAMPLES).contains(&samples) {
        faults.push("length_s", format!("{samples} samples"), format!("2 to {MOST_SAMPLES:e} samples"));
    }
    let typed = t.channels.as_deref().unwrap_or(&[]);
    if typed.is_empty() {
        faults.push(
            "channels",
            "nothing",
            "a table [[channels]] with name, unit and signal for every channel",
        );
    }
    let mut channels: Vec<Wanted> = Vec::new();
    for (k, c) in typed.iter().enumerate() {
        let key = |name: &str| format!("channels[{}].{name}", k + 1);
        let name = faults.required(&key("name"), &c.name, "name of the column");
        let unit = faults.required(&key("unit"), &c.unit, "a unit, `-` for none");
        let expected = "a table like { name = \"aprbs\", lo = 10, hi = 90 } (see `dynocal list signals`)";
        let table = faults.required(&key("signal"), &c.signal, expected);
        let (Some(name), Some(unit), Some(mut keys)) = (name, unit, table) else { continue };
        if channels.iter().any(|c| c.name == name) || name == "time" {
            faults.push(&key("name"), format!("`{name}` again"), "a name of its own");
        }
        let Some(toml::Value::String(member)) = keys.remove("name") else {
            faults.push(&key("signal.name"), "no text", "a name (see `dynocal list signals`)");
            continue;
        };
        match signal(&member, &keys) {
            Ok(_) => channels.push(Wanted { name, unit, signal: member, keys }),
            Err(BuildError::UnknownMember { found, known, .. }) => {
                faults.unknown(&key("signal.name"), &found, &known);
            }
            Err(e) => faults.push(&key("signal"), e, "keys as `dynocal list signals` shows them"),
        }
    }
    let name = t.name.clone().unwrap_or_else(|| stem.into());
    let out = common.out.clone().or_else(|| t.out.as_ref().map(|o| folder.join(o)));
    Some(Request {
        out: out.unwrap_or_else(|| Path::new("runs").join(&name)),
        name,
        samples: samples as usize,
        sample_time_s: dt?,
        seed: common.seed.or(t.seed).unwrap_or(1),
        channels,
    })
}

fn make(request: &Request) -> Result<Made, Failure> {
    let dt_s = request.sample_time_s;
    let (mut columns, mut analyses) = (Vec::new(), Vec::new());
    for (i, w) in request.channels.iter().enumerate() {
        let mut u = vec![0.0; request.samples];
        let mut rng = Rng64::stream(request.seed, i as u64);
        signal(&w.signal, &w.keys)?.fill(&mut u, dt_s, &mut rng)?;
        let lags = LAGS.min(request.samples / 2);
        analyses.push(analyse(&u, dt_s, lags).ok_or_else(|| super::signal::not_finite(&w.signal))?);
        columns.push(u);
    }
    let coverage: Vec<Coverage> =
        request.channels.iter().zip(&columns).filter_map(|(w, u)| coverage(&w.name, u, None)).collect();
    let (mut pairs, mut correlations, mut warnings) = (Vec::new(), Vec::new(), Vec::new());
    for b in 1..coverage.len() {
        for a in 0..b {
            pairs.push(pair_coverage(&coverage[a], &coverage[b], &columns[a], &columns[b]));
            let of = |i: usize| (request.channels[i].name.as_str(), &columns[i][..]);
            let Some(c) = correlation(of(a), of(b), LAGS.min(request.samples / 2)) else { continue };
            if c.r.abs() > c.bound.max(0.3) {
                warnings.push(format!(
                    "`{}` and `{}` move together (correlation {:.2}, independent ones stay within {:.2}): their effects are \
                     hard to tell apart",
                    c.a, c.b, c.r, c.bound
                ));
            }
            correlations.push(c);
        }
    }
    Ok(Made { columns, analyses, coverage, pairs, correlations, warnings })
}

fn text(request: &Request, made: &Made) -> String {
    let number = |v: f64| dynocal_report::significant(v, 4);
    let rows: Vec<Vec<String>> = request
        .channels
        .iter()
        .zip(&made.analyses)
        .map(|(w, a)| {
            let crest = a.crest_factor.map_or("none".into(), number);
            vec![
                w.name.clone(),
                w.unit.clone(),
                w.signal.clone(),
                number(a.minimum),
                number(a.maximum),
                crest,
            ]
        })
        .collect();
    let mut out =
        table::render(&["channel", "unit", "signal", "least", "greatest", "crest factor"], &rows, &[3, 4, 5]);
    let rows: Vec<Vec<String>> = made
        .correlations
        .iter()
        .map(|c| {
            let pair = made.pairs.iter().find(|p| p.a == c.a && p.b == c.b);
            let cells = pair.map_or("none".into(), |p| format!("{:.0}", 100.0 * p.occupied));
            vec![format!("{}, {}", c.a, c.b), format!("{:.3}", c.r), format!("{:.3}", c.bound), cells]
        })
        .collect();
    if !rows.is_empty() {
        out += "\n";
        out += &table::render(
            &["channels", "correlation", "95 % bound", "cells visited [%]"],
            &rows,
            &[1, 2, 3],
        );
    }
    out
}

fn report(request: &Request, made: &Made) -> Report {
    let mut report = Report::new(format!("Test signals: {}", request.name))
        .fact("Sample time", format!("{} s", request.sample_time_s))
        .fact("Seed", request.seed.to_string());
    for warning in &made.warnings {
        report = report.warning(warning.as_str());
    }
    if !made.pairs.is_empty() {
        report = report.section(together(request, made));
    }
    for ((w, u), a) in request.channels.iter().zip(&made.columns).zip(&made.analyses) {
        let section = Section::new(format!("{} ({})", w.name, w.signal));
        report = report.section(analysed(section, (&w.name, &w.unit), request.sample_time_s, u, a));
    }
    report
}

/// Correlation and coverage of pairs.
fn together(request: &Request, made: &Made) -> Section {
    let mut table = Table::new(vec![
        Column::text("Channels"),
        Column::number("Correlation (2.45)", "").digits(3),
        Column::number("95 % bound", "").digits(3),
        Column::number("Largest at any lag", "").digits(3),
        Column::number("Lag", "s").digits(3),
        Column::number("Cells visited", "%").digits(3),
    ]);
    for p in &made.pairs {
        let c = made.correlations.iter().find(|c| c.a == p.a && c.b == p.b);
        table = table.row(vec![
            format!("{}, {}", p.a, p.b).into(),
            Cell::from(c.map(|c| c.r)),
            Cell::from(c.map(|c| c.bound)),
            Cell::from(c.map(|c| c.r_max)),
            Cell::from(c.map(|c| c.lag as f64 * request.sample_time_s)),
            (100.0 * p.occupied).into(),
        ]);
    }
    let mut section = Section::new("Channels together")
        .text(
            "Independent channels stay within the bound, which takes their own autocorrelation (thesis eq. 2.46) into \
             account. Cells: of a grid of ten by ten between least and greatest values.",
        )
        .block(table);
    let find = |name: &str| request.channels.iter().position(|c| c.name == name).unwrap_or(0);
    for p in &made.pairs {
        let (a, b) = (find(&p.a), find(&p.b));
        let axis = |i: usize| Axis::new(&request.channels[i].name, &request.channels[i].unit);
        let drawn = |i: usize| made.columns[i][..made.columns[i].len().min(DRAWN)].to_vec();
        let points = XyPlot::new(format!("{} and {}: samples", p.a, p.b), axis(a), axis(b)).points(
            "samples",
            drawn(a),
            drawn(b),
        );
        let moves = |i: usize| made.analyses[i].maximum > made.analyses[i].minimum;
        if !(moves(a) && moves(b)) {
            section = section.block(points);
            continue;
        }
        let middles = |i: usize| -> Vec<f64> {
            let (lo, hi) = (made.analyses[i].minimum, made.analyses[i].maximum);
            (0..PAIR_CELLS).map(|k| lo + (k as f64 + 0.5) / PAIR_CELLS as f64 * (hi - lo)).collect()
        };
        // Counts come row by row of `a`, the map takes them row by row of its vertical axis.
        let counts = (0..PAIR_CELLS * PAIR_CELLS)
            .map(|k| p.counts[(k % PAIR_CELLS) * PAIR_CELLS + k / PAIR_CELLS] as f64)
            .collect();
        let map = HeatMap::new(
            format!("{} and {}: coverage", p.a, p.b),
            (axis(a), middles(a)),
            (axis(b), middles(b)),
            (Axis::new("samples per cell", ""), counts),
        );
        section = section.columns(vec![points.into(), map.into()]);
    }
    section
}
