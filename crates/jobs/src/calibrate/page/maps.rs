//! Step 5: the dynamic map in steady state beside the static one.

use super::super::context::Context;
use super::super::invert_step::InvertResult;
use super::super::verdict::word;
use super::parts::{label, percent, unit};
use dynocal_calib::map::static_map::StaticMap;
use dynocal_calib::map::structured::StructuredMap;
use dynocal_calib::validate::reference_row;
use dynocal_numerics::interval::Interval;
use dynocal_report::{Axis, Block, Cell, Column, Details, HeatMap, Section, Table};

/// Points of the drawn grid along the given channel and the leading demand.
const GRID: (usize, usize) = (19, 13);

/// The whole step.
pub(super) fn section(ctx: &Context, i: &InvertResult, rival: Option<&StaticMap>) -> Section {
    let mut section = Section::new("Dynamic map").id("maps").text(format!(
        "Fitted on {} responses of the records {}. It is a static part plus differences over a window of the filtered demand, which vanish in steady state.",
        i.pairs,
        i.records.join(", ")
    ));
    if !i.left_out.is_empty() {
        section = section.text(format!("Left out: {}.", i.left_out.join("; ")));
    }
    if let Some(grid) = Grid::over(ctx) {
        for (c, port) in i.dynamic.ports().actuators.iter().enumerate() {
            let (name, u) = (label(&port.name), unit(&port.unit));
            let dynamic = grid.values(|r| i.dynamic.steady(r)[c]);
            let fixed = rival.map(|rival| {
                let mut at = vec![0.0; rival.ports.actuators.len()];
                grid.values(|r| {
                    rival.at(r, &mut at);
                    at[c]
                })
            });
            // Equal colours are equal values in both.
            let both = dynamic.iter().chain(fixed.iter().flatten()).filter(|v| v.is_finite());
            let (low, high) =
                both.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
            let map = |title: String, z: Vec<f64>| {
                let axis = Axis::new(name.clone(), u);
                let map = HeatMap::new(title, grid.x.clone(), grid.y.clone(), (axis, z)).contours();
                if low < high { map.range(low, high) } else { map }
            };
            let mut blocks: Vec<Block> =
                vec![map(format!("{name}: dynamic map at rest"), dynamic.clone()).into()];
            if let (Some(rival), Some(fixed)) = (rival, fixed) {
                let difference: Vec<f64> = dynamic.iter().zip(&fixed).map(|(a, b)| a - b).collect();
                let (x, y): (Vec<f64>, Vec<f64>) = rival.points.iter().map(|p| (p.given, p.demand)).unzip();
                blocks.push(map(format!("{name}: static map"), fixed).overlay("grid points", x, y).into());
                let axis = Axis::new(format!("{name}, difference"), u);
                let title = format!("{name}: dynamic minus static");
                blocks.push(
                    HeatMap::new(title, grid.x.clone(), grid.y.clone(), (axis, difference))
                        .diverging()
                        .into(),
                );
            }
            section = section.columns(blocks);
        }
    }
    let section = section.block(scores(i));
    match i.dynamic.terms() {
        Some(map) => section.block(coefficients(map)),
        None => section,
    }
}

/// The drawn plane: given channel and leading demand, everything else in its middle.
struct Grid {
    x: (Axis, Vec<f64>),
    y: (Axis, Vec<f64>),
    rows: Vec<Vec<f64>>,
}

impl Grid {
    /// None where the problem has no given channel.
    fn over(ctx: &Context) -> Option<Self> {
        let (problem, scenario) = (&ctx.spec.problem, &ctx.spec.validate.scenario);
        let axis = |r: Interval, n: usize| -> Vec<f64> {
            (0..n).map(|k| r.lower + r.width() * k as f64 / (n - 1) as f64).collect()
        };
        let (given, demand) = (problem.given.first()?, problem.demands.first()?);
        let x = axis(scenario.given_range(problem)?, GRID.0);
        let y = axis(scenario.demand_range(problem), GRID.1);
        let rows = y.iter().flat_map(|t| x.iter().map(|n| reference_row(problem, *t, Some(*n)))).collect();
        Some(Self {
            x: (Axis::new(label(&given.name), unit(&given.unit)), x),
            y: (Axis::new(label(&demand.output), unit(&demand.unit)), y),
            rows,
        })
    }

    fn values(&self, mut map: impl FnMut(&[f64]) -> f64) -> Vec<f64> {
        self.rows.iter().map(|r| map(r)).collect()
    }
}

fn scores(i: &InvertResult) -> Table {
    let mut table = Table::new(vec![
        Column::text("Map"),
        Column::text("Actuator"),
        Column::text("Estimator"),
        Column::number("R2", "%").digits(4),
        Column::text("Ended"),
    ])
    .caption("Fit of the inverse maps on their own data (identification, simulated actuator)");
    for s in &i.scores {
        let r2 = percent(s.r2).map_or(Cell::from("unstable or constant"), Cell::from);
        table = table.row([
            s.map.as_str().into(),
            s.actuator.as_str().into(),
            s.estimator.as_str().into(),
            r2,
            Cell::from(word(s.status)),
        ]);
    }
    table
}

fn coefficients(d: &StructuredMap) -> Details {
    let head = d.ports.actuators.iter().map(|a| Column::number(label(&a.name), unit(&a.unit)).digits(5));
    let scales: Vec<String> = d
        .ports
        .references()
        .zip(&d.scales)
        .map(|(p, s)| match s.ratio {
            true => format!("{} in units of {:.5} {}", p.name, s.unit, unit(&p.unit)),
            false => format!("{} less {:.5} in units of {:.5} {}", p.name, s.offset, s.unit, unit(&p.unit)),
        })
        .collect();
    let mut table =
        Table::new([Column::text("Term")].into_iter().chain(head).collect()).caption(scales.join("; "));
    for (k, name) in d.term_names().iter().enumerate() {
        let values = d.coefficients.iter().map(|c| Cell::from(c.get(k).copied()));
        table = table.row([Cell::from(name.as_str())].into_iter().chain(values).collect::<Vec<_>>());
    }
    Details::new(format!("Coefficients of the dynamic map ({} terms for each actuator)", d.terms.len()))
        .block(table)
}
