//! Networks of section 7.4.2: Tables 7.1, 7.2 and the columns of Table 7.5, on the virtual engine in closed loop and on
//! the stored records of the reference data.

use crate::chapter5::work::engine::{self, SAMPLE_TIME_S};
use crate::chapter5::work::gains::LoopGains;
use crate::chapter5::work::networks::{
    self, Options as Training, Size, Trained, best_of_divisions, best_of_starts,
};
use crate::chapter5::work::published::{NetworkRow, TABLE_7_1, TABLE_7_2, TABLE_7_5};
use crate::chapter5::work::{Chapter5Error, Fitness};
use dynocal_ident::data::Dataset;
use dynocal_report::{Axis, Bars, Cell, Column, Panel, Report, Section, Table, TimePlot};
use serde::{Deserialize, Serialize};
use serde_json::json;

use super::super::asked::Asked;
use super::super::{Check, Options, Task, TaskResult};
use super::engine::{Models, closed_loop_models, closed_loop_spec, digest, stored_files, unseen_records};
use super::{check, percent, plant, reference, result, task};

const SIZES: &str = "layer-sizes";
pub(super) const NETWORKS: [&str; 2] = ["networks-torque", "networks-lambda"];
const STORED: [&str; 2] = ["stored-networks-torque", "stored-networks-lambda"];
const OUTPUTS: [&str; 2] = ["torque", "lambda"];
const UNITS: [&str; 2] = ["Nm^2", ""];
/// R2 on unseen records that the best of eight starts must reach.
const ASKED: [f64; 2] = [99.5, 98.0];
/// Part of a record that is drawn, in samples.
const DRAWN: usize = 700;

/// Both ways of choosing a network.
#[derive(Serialize, Deserialize)]
struct Networks {
    divisions: Trained,
    starts: Trained,
    two_records: Trained,
}

pub(super) fn tasks(o: &Options) -> Vec<Task> {
    let options = Training {
        seed: o.seed,
        evaluations: if o.reduced { 12 } else { 80 },
        patience: if o.reduced { 4 } else { 15 },
    };
    let trainings = if o.reduced { 2 } else { 10 };
    let starts = if o.reduced { 2 } else { 8 };
    let sizes: Vec<usize> = if o.reduced { vec![3, 5] } else { TABLE_7_1.iter().map(|r| r.hidden).collect() };
    let (spec, unseen) = (closed_loop_spec(o), unseen_records(o));
    // As Matlab's training, which stops after six checks without a better score.
    let short = Training { patience: options.patience.min(6), ..options };
    let inputs = json!({ "records": spec, "training": short, "sizes": sizes, "trainings": trainings });
    let of_sizes = spec.clone();
    let mut tasks = vec![task(SIZES, inputs, move |interrupt| {
        let records = engine::closed_loop(&plant, &of_sizes, LoopGains::RETUNED, options.seed, 1, interrupt)?;
        networks::sizes(&records[0], "torque", &sizes, trainings, &short, interrupt)
    })];
    for (name, of) in NETWORKS.into_iter().zip(OUTPUTS) {
        let inputs = json!({ "records": spec, "unseen": unseen, "training": options, "trainings": trainings, "starts": starts });
        let spec = spec.clone();
        tasks.push(task(name, inputs, move |interrupt| {
            // Identification, the unseen ones of the polynomial models, one that selects, one more to identify with.
            let all =
                engine::closed_loop(&plant, &spec, LoopGains::RETUNED, options.seed, 3 + unseen, interrupt)?;
            let [first, others @ .., selection, second] = &all[..] else {
                let expected = 3 + unseen as usize;
                return Err(Chapter5Error::Records { found: all.len(), expected });
            };
            let two = [first.clone(), second.clone()];
            Ok(Networks {
                divisions: best_of_divisions(first, others, of, trainings, &options, interrupt)?,
                starts: best_of_starts(&two[..1], selection, others, of, starts, &options, interrupt)?,
                two_records: best_of_starts(&two, selection, others, of, starts, &options, interrupt)?,
            })
        }));
    }
    if let Some(files) = reference(o).map(|f| stored_files(&f)) {
        for (name, of) in STORED.into_iter().zip(OUTPUTS) {
            let digests: Vec<Option<String>> = files.iter().map(|f| digest(f)).collect();
            let inputs = json!({ "files": digests, "training": options, "starts": starts });
            let files = files.clone();
            tasks.push(task(name, inputs, move |interrupt| {
                let r: Vec<Dataset> = files.iter().map(|f| engine::read(f)).collect::<Result<_, _>>()?;
                best_of_starts(&r[..1], &r[1], &r[2..], of, starts, &options, interrupt)
            }));
        }
    }
    tasks
}

pub(super) fn checks(results: &[TaskResult]) -> Vec<Check> {
    let polynomials = closed_loop_models(results);
    let mut checks = Vec::new();
    for k in 0..2 {
        let found: Option<Networks> = result(results, NETWORKS[k]);
        let place = "new records of the virtual engine";
        checks.push(unseen_check(
            k,
            &format!("{}-one-record", NETWORKS[k]),
            &format!("{place}, identified with 60 s as in the thesis"),
            Asked::Reported,
            found.as_ref().map(|f| &f.starts),
        ));
        checks.push(unseen_check(
            k,
            NETWORKS[k],
            &format!("{place}, identified with two records of 60 s"),
            Asked::AtLeast(ASKED[k]),
            found.as_ref().map(|f| &f.two_records),
        ));
        let polynomial = polynomials.as_ref().map(|p| p.models[k].sem.mean_unseen().mse);
        let network = found.as_ref().map(|f| f.starts.mean_unseen().mse);
        checks.push(check(
            format!("{}-over-polynomial", NETWORKS[k]),
            format!("Mean unseen MSE of {}: network over polynomial by SEM (Table 7.5)", OUTPUTS[k]),
            Asked::Below(1.0),
            network.zip(polynomial).map(|(n, p)| n / p),
            "",
            format!("thesis {:.2}", TABLE_7_5[k].mse / TABLE_7_5[k].polynomial_mse),
        ));
        if results.iter().any(|r| r.name == STORED[k]) {
            let stored: Option<Trained> = result(results, STORED[k]);
            checks.push(unseen_check(
                k,
                STORED[k],
                "engine_val02 (chosen on engine_val01)",
                Asked::AtLeast(ASKED[k]),
                stored.as_ref(),
            ));
        }
    }
    checks
}

fn unseen_check(k: usize, id: &str, records: &str, asked: Asked, found: Option<&Trained>) -> Check {
    let note = found.map_or(String::new(), |f| {
        format!(
            "start {} of {}; identification {:.3} %, selection {:.3} %, unseen {:.3} to {:.3} %",
            f.best + 1,
            f.scores.len(),
            percent(f.identification.r2),
            percent(f.selection.map_or(f64::NAN, |s| s.r2)),
            percent(least(f)),
            percent(f.unseen.iter().map(|u| u.r2).fold(f64::NEG_INFINITY, f64::max)),
        )
    });
    check(
        id,
        format!("Network of {}, best of the starts: mean R2 of the free run on {records}", OUTPUTS[k]),
        asked,
        found.map(|f| percent(f.mean_unseen().r2)),
        "%",
        note,
    )
}

/// R2 of the network of output `k` that two records identified: on the first of them, and its mean on unseen ones.
pub(super) fn best_of_two_records(results: &[TaskResult], k: usize) -> Option<(f64, f64)> {
    let found: Networks = result(results, NETWORKS[k])?;
    Some((found.two_records.identification.r2, found.two_records.mean_unseen().r2))
}

fn least(f: &Trained) -> f64 {
    f.unseen.iter().map(|u| u.r2).fold(f64::INFINITY, f64::min)
}

pub(super) fn sections(report: Report, results: &[TaskResult]) -> Report {
    let found: Vec<Option<Networks>> = NETWORKS.iter().map(|n| result(results, n)).collect();
    let stored: Vec<Option<Trained>> = STORED.iter().map(|n| result(results, n)).collect();
    let mut section = Section::new("Networks of section 7.4: Tables 7.1, 7.2 and 7.5").id("networks").text(
        "Thesis: NARX (7.7), lags 1 to 5 of four inputs and 1 of the output, tanh neurons and a linear output, Levenberg-Marquardt, samples divided at random into 70 % training, 15 % validation, 15 % test; ten trainings, means in Table 7.1, the best in Table 7.2; ten other records in Table 7.5. The columns of Table 7.1 carry no names in the text; they are read as training, validation, test, of torque.",
    ).text(
        "Reading: trained and scored in free run (parallel form) with exact recursive Jacobians; the same records as the polynomial models above. Neighbouring samples of a slow record are nearly equal, so that a random division says little about other records: the second way of choosing takes eight random starts, fits the whole identification record, stops and chooses on a record of its own, and the unseen records decide nothing. One record of 60 s holds twenty operating levels only; the last row fits two such records, as the calibration of this tool does.",
    );
    if let Some(rows) = result::<Vec<Size>>(results, SIZES) {
        section.push(size_table(&rows));
        section.push(size_bars(&rows));
    }
    for k in 0..2 {
        section.push(fit_table(
            k,
            found[k].as_ref(),
            stored[k].as_ref(),
            closed_loop_models(results).as_ref(),
        ));
    }
    if let [Some(torque), Some(lambda)] = &found[..] {
        section.push(traces([&torque.starts, &lambda.starts]));
    }
    report.section(section)
}

fn size_table(rows: &[Size]) -> Table {
    let parts = ["training", "validation", "test"];
    let mut columns = vec![Column::text("Layers"), Column::number("Weights", "")];
    columns.extend(parts.iter().map(|p| Column::number(format!("Thesis, {p}"), "Nm^2").digits(4)));
    for p in parts {
        columns.push(Column::number(format!("ours, {p}"), "Nm^2").digits(3));
        columns.push(Column::number("SE", "").digits(2));
    }
    let n = rows.first().and_then(|r| r.mse[0]).map_or(0, |s| s.n);
    let mut table = Table::new(columns)
        .caption(format!("Table 7.1: mean squared free-run error of torque over {n} trainings"));
    for row in rows {
        let known = TABLE_7_1.iter().find(|t| t.hidden == row.hidden);
        let mut cells: Vec<Cell> = vec![format!("{} 1", row.hidden).into(), row.weights.into()];
        cells.extend((0..3).map(|i| Cell::from(known.map(|t| t.mse[i]))));
        for part in row.mse {
            cells.push(part.map(|s| s.mean).into());
            cells.push(part.map(|s| s.se).into());
        }
        table = table.row(cells);
    }
    table
}

fn size_bars(rows: &[Size]) -> Bars {
    let mut bars = Bars::new(
        "Layer size and free-run error",
        Axis::new("MSE of torque", "Nm^2"),
        rows.iter().map(|r| format!("{} neurons", r.hidden)),
    )
    .caption("Means over the trainings of each size.");
    for (i, name) in ["training", "validation", "test"].into_iter().enumerate() {
        let values: Vec<f64> = rows.iter().map(|r| r.mse[i].map_or(f64::NAN, |s| s.mean)).collect();
        bars = bars.series(name, values);
    }
    bars
}

fn fit_table(
    k: usize,
    found: Option<&Networks>,
    stored: Option<&Trained>,
    polynomials: Option<&Models>,
) -> Table {
    let unit = UNITS[k];
    let pair = |name: &str| {
        [Column::number(format!("{name}: MSE"), unit).digits(4), Column::number("R2", "%").digits(5)]
    };
    let mut columns = vec![Column::text("Model")];
    columns.extend(pair("Identification"));
    columns.extend(pair("Unseen, mean"));
    columns.push(Column::number("least R2", "%").digits(4));
    let mut table = Table::new(columns).caption(format!("Tables 7.2 and 7.5: {}, free run", OUTPUTS[k]));
    let known = |row: &NetworkRow| -> Vec<Cell> { vec![row.mse.into(), row.r2.into()] };
    let mut thesis: Vec<Cell> = vec!["thesis, network".into()];
    thesis.extend(known(&TABLE_7_2[k]));
    thesis.extend(known(&TABLE_7_5[k]));
    thesis.push(Cell::Empty);
    table = table.row(thesis);
    let row = |name: &str, identification: Fitness, unseen: &[Fitness]| -> Vec<Cell> {
        let mean = Fitness::mean(unseen);
        vec![
            name.into(),
            identification.mse.into(),
            percent(identification.r2).into(),
            mean.mse.into(),
            percent(mean.r2).into(),
            percent(unseen.iter().map(|u| u.r2).fold(f64::INFINITY, f64::min)).into(),
        ]
    };
    if let Some(f) = found {
        let d = &f.divisions;
        table = table.row(row(
            "ours, best of the random divisions on its test samples",
            d.identification,
            &d.unseen,
        ));
        let s = &f.starts;
        table = table.stressed_row(row(
            "ours, best of the starts on a record of its own",
            s.identification,
            &s.unseen,
        ));
    }
    if let Some(f) = found {
        let t = &f.two_records;
        table = table.stressed_row(row(
            "ours, the same with two identification records",
            t.identification,
            &t.unseen,
        ));
    }
    if let Some(p) = polynomials {
        let sem = &p.models[k].sem;
        table = table.row(row("ours, polynomial (7.8) by SEM", sem.free_run, &sem.unseen));
    }
    if let Some(s) = stored {
        table = table.row(row("stored records, best of the starts", s.identification, &s.unseen));
    }
    table
}

fn traces(found: [&Trained; 2]) -> TimePlot {
    let n = DRAWN.min(found[0].unseen_measured.len());
    let mut plot =
        TimePlot::sampled("Free runs of the networks over the first unseen record", SAMPLE_TIME_S, n);
    for (k, f) in found.into_iter().enumerate() {
        plot = plot.panel(
            Panel::new(OUTPUTS[k], ["Nm", ""][k])
                .measured(f.unseen_measured[..n].to_vec())
                .simulated(f.unseen_trace[..n].to_vec()),
        );
    }
    plot
}
