//! Searches at equal budgets: Figures 4.12 to 4.15.

use crate::chapter4::work::Size;
use crate::chapter4::work::convergence::{Convergence, Path, SEARCHES, converge};
use crate::chapter4::work::source::DesignCriterion;
use dynocal_report::{Axis, Block, Cell, Column, Section, Table, XyPlot};
use rayon::prelude::*;
use serde_json::json;

use super::{Asked, Check, Shared, Task, TaskResult, check, result};

/// Criteria with the evaluations that each start may use: that of the figures gets the thesis' 50 000.
const BUDGETS: [(DesignCriterion, usize); 5] = [
    (DesignCriterion::A, 50_000),
    (DesignCriterion::D, 10_000),
    (DesignCriterion::I, 10_000),
    (DesignCriterion::G, 10_000),
    (DesignCriterion::Ai, 10_000),
];
const STARTS: usize = 4;
/// The thesis' six come first in the table of the chapter.
const OF_THE_THESIS: usize = 6;

fn name(criterion: DesignCriterion) -> String {
    format!("searches-{}", criterion.name())
}

pub(super) fn tasks(shared: &Shared, size: Size, reduced: bool) -> Vec<Task> {
    BUDGETS
        .iter()
        .map(|&(criterion, full)| {
            let (budget, starts) = if reduced { (300, 1) } else { (full, STARTS) };
            let inputs =
                json!({ "searches": SEARCHES, "budget": budget, "starts": starts, "seed": size.seed });
            super::task(shared, name(criterion), inputs, move |l, interrupt| {
                SEARCHES
                    .par_iter()
                    .map(|s| converge(&l.setting, s, criterion, budget, starts, l.size.seed, interrupt))
                    .collect::<Result<Vec<Convergence>, _>>()
            })
        })
        .collect()
}

fn found(results: &[TaskResult], criterion: DesignCriterion) -> Vec<Convergence> {
    result(results, &name(criterion)).unwrap_or_default()
}

/// Distance in the search objective: relative, or absolute in the determinant's logarithm.
fn behind(criterion: DesignCriterion, ours: f64, best: f64) -> f64 {
    if criterion == DesignCriterion::D { ours - best } else { ours / best - 1.0 }
}

pub(super) fn checks(results: &[TaskResult]) -> Vec<Check> {
    let one = |(criterion, budget): (DesignCriterion, usize)| {
        let all = found(results, criterion);
        let end = |s: &str| all.iter().find(|c| c.search == s).and_then(|c| c.median_end());
        let six: Option<Vec<f64>> = SEARCHES[..OF_THE_THESIS].iter().map(|s| end(s)).collect();
        let best = six.and_then(|v| v.into_iter().reduce(f64::min));
        let notes: Vec<String> =
            SEARCHES.iter().map(|s| format!("{s} {:.6}", end(s).unwrap_or(f64::NAN))).collect();
        check(
            format!("searches-{}", criterion.name()),
            format!(
                "Objective {} of the default search against the best of the thesis' six, medians at most {budget} evaluations",
                criterion.name().to_uppercase()
            ),
            Asked::AtMost(0.0),
            end("kicks").zip(best).map(|(ours, best)| behind(criterion, ours, best)),
            if criterion == DesignCriterion::D { "" } else { "relative" },
            notes.join(", "),
        )
    };
    BUDGETS.iter().map(|b| one(*b)).collect()
}

pub(super) fn section(results: &[TaskResult]) -> Section {
    let all = found(results, DesignCriterion::A);
    let mut section = Section::new("Searches at equal budgets").id("searches").text(
        "The thesis' six methods, a cyclic compass, one quasi-Newton run (local) and the default (kicks: local runs with random kicks), all from the same uniform random records. An evaluation is a simulation with its criterion, with or without the exact gradient; the thesis formed gradients by differences, 300 evaluations each, which it did not count. Methods that end by their own rule leave the rest of the budget.",
    );
    section.push(Block::from(table_a(&all)));
    section.push(plot_of(&all, &SEARCHES[..3], "Local methods (Figure 4.12)", Some(400)));
    section.push(plot_of(&all, &SEARCHES[3..], "Global methods, compass, local and the default", None));
    for (search, title, below) in [
        ("annealing", "Simulated annealing (Figure 4.13)", "mean of the trials at each temperature"),
        ("genetic", "Genetic algorithm (Figure 4.14)", "mean of each generation"),
    ] {
        if let Some(path) = first(&all, search) {
            section.push(told_plot(path, title, below));
        }
    }
    if let Some(path) = first(&all, "pattern_search") {
        section.push(pattern_plot(path));
        section.push(Block::from(mesh_table(path)));
    }
    section.push(Block::from(table_rest(results)));
    section
}

fn first<'a>(all: &'a [Convergence], search: &str) -> Option<&'a Path> {
    all.iter().find(|c| c.search == search).and_then(|c| c.paths.first())
}

fn table_a(all: &[Convergence]) -> Table {
    let after = [50, 200, 1000, 5000, 20_000, 50_000];
    let mut columns = vec![Column::text("Search"), Column::number("Start", "").digits(4)];
    columns.extend(after.map(|n| Column::number(format!("after {n}"), "").digits(4)));
    columns.push(Column::number("Evaluations used", "").digits(5));
    let mut table = Table::new(columns).caption(
        "J_A of the torque model, best so far, median of the starts (thesis: 1671.8 and 3271 after 50 000 evaluations of a pattern search)",
    );
    for c in all {
        let mut row = vec![Cell::from(c.search.as_str()), c.median_after(0).into()];
        row.extend(after.map(|n| Cell::from(if n <= c.budget { c.median_after(n) } else { None })));
        row.push(c.median_evaluations().into());
        table = table.row(row);
    }
    table
}

fn table_rest(results: &[TaskResult]) -> Table {
    let rest = &BUDGETS[1..];
    let mut columns = vec![Column::text("Search")];
    for (criterion, _) in rest {
        columns.push(Column::number(format!("J_{}", criterion.name().to_uppercase()), "").digits(6));
        columns.push(Column::number("evaluations", "").digits(5));
    }
    let mut table =
        Table::new(columns).caption("The other criteria: median at the end of at most 10 000 evaluations");
    for search in SEARCHES {
        let mut row = vec![Cell::from(search)];
        for (criterion, _) in rest {
            let all = found(results, *criterion);
            let own = all.iter().find(|c| c.search == search);
            row.push(own.and_then(|c| c.median_end()).into());
            row.push(own.and_then(|c| c.median_evaluations()).into());
        }
        table = table.row(row);
    }
    table
}

const LOGARITHM: &str = "log10 J_A";

fn logarithms(points: impl Iterator<Item = (usize, f64)>) -> (Vec<f64>, Vec<f64>) {
    points.filter(|p| p.1 > 0.0).map(|(n, v)| (n as f64, v.log10())).unzip()
}

/// Best so far against evaluations, the first start; a method that ended keeps its value.
fn plot_of(all: &[Convergence], searches: &[&str], title: &str, most: Option<usize>) -> XyPlot {
    // Gradient methods end where the others have hardly begun: together they need a logarithmic axis.
    let along = |n: f64| if most.is_some() { n } else { n.log10() };
    let axis = if most.is_some() { "Evaluations" } else { "log10 evaluations" };
    let mut plot = XyPlot::new(title, Axis::new(axis, ""), Axis::new(LOGARITHM, ""));
    for search in searches {
        let Some(c) = all.iter().find(|c| c.search == *search) else { continue };
        let Some(path) = c.paths.first() else { continue };
        let end = c.budget.min(most.unwrap_or(c.budget));
        let shown = path.best.iter().copied().filter(|b| b.0 > 0 && b.0 <= end);
        let (mut x, mut y) = logarithms(shown);
        if let Some(last) = y.last().copied() {
            x.push(end as f64);
            y.push(last);
        }
        x.iter_mut().for_each(|n| *n = along(*n));
        plot = plot.line(*search, x, y);
    }
    plot.caption("Best objective so far, first start")
}

fn told_plot(path: &Path, title: &str, below: &str) -> XyPlot {
    let (x, y) = logarithms(path.told.iter().map(|t| (t.0, t.1)));
    let (bx, by) = logarithms(path.best.iter().copied());
    XyPlot::new(title, Axis::new("Evaluations", ""), Axis::new(LOGARITHM, "")).line(below, x, y).line(
        "best so far",
        bx,
        by,
    )
}

fn pattern_plot(path: &Path) -> XyPlot {
    let (x, y) = logarithms(path.told.iter().map(|t| (t.0, t.1)));
    XyPlot::new("Pattern search (Figure 4.15)", Axis::new("Evaluations", ""), Axis::new(LOGARITHM, "")).line(
        "objective",
        x,
        y,
    )
}

/// How fine the mesh became: a mesh that never shrinks means that full steps still helped when the budget ended.
fn mesh_table(path: &Path) -> Table {
    let meshes = path.told.iter().map(|t| t.2);
    let (least, largest) = meshes.clone().fold((f64::INFINITY, 0.0f64), |(l, u), m| (l.min(m), u.max(m)));
    Table::new(vec![
        Column::text("Mesh of the pattern search"),
        Column::number("share of the box", "").digits(3),
    ])
    .row([Cell::from("largest"), largest.into()])
    .row([Cell::from("least"), least.into()])
    .row([Cell::from("at the end of the budget"), path.told.last().map(|t| t.2).into()])
}
