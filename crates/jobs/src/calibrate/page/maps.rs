//! Step 5: the dynamic map in steady state beside the static one.

use super::super::context::Context;
use super::super::invert_step::InvertResult;
use super::super::verdict::word;
use super::parts::{label, percent, unit};
use dynocal_calib::map::MapForm;
use dynocal_calib::map::lead_lag::LeadLagMap;
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
        "Fitted on {} responses of the records {}. {}",
        i.pairs,
        i.records.join(", "),
        made_of(&i.dynamic.form())
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
    let section = at_rest(section, i).block(scores(i));
    match i.dynamic.form() {
        MapForm::Terms(map) => section.block(coefficients(map)),
        MapForm::Tables(map) => section.block(dynamics(map)).block(tables(map)),
        MapForm::Other => section,
    }
}

fn made_of(form: &MapForm) -> String {
    match form {
        MapForm::Terms(_) => "It is a static part plus differences over a window of the filtered demand, which vanish in steady state.".into(),
        MapForm::Tables(map) => {
            let dynamics = if map.actuators.iter().any(|a| a.law.tau_s > 0.0) {
                "and for those that follow a lag, whose time constant is a table as well, with a lead. The dynamics are those that hold the demands best by the identified models, on steps and on random points that are not those of the comparison; at rest they do not speak."
            } else {
                "without a lag: no model of a demand beyond the leading one says that one would pay."
            };
            format!(
                "It is tables of {} by {} breakpoints for each actuator, {dynamics}",
                map.demand.len(),
                map.given.len()
            )
        }
        MapForm::Other => String::new(),
    }
}

/// What the points at rest have told.
fn at_rest(section: Section, i: &InvertResult) -> Section {
    let Some(r) = &i.at_rest else { return section };
    if !r.refused.is_empty() {
        return section.text(format!("It was not moved onto points of the plant: {}.", r.refused));
    }
    let restless = match r.restless {
        0 => String::new(),
        n => format!(" {n} more had not come to rest and were left out."),
    };
    let unreached = match r.unreached {
        0 => String::new(),
        n => format!(
            " At {n} more the demand was not met, or an input that a loop drives stood at its limit: what would hold them is not known, and they were left out."
        ),
    };
    let mut table = Table::new(vec![
        Column::text("Actuator"),
        Column::number("before", "").digits(3),
        Column::number("after", "").digits(3),
        Column::text("unit"),
    ])
    .caption("What the plant took at these points less what the map gives there, root mean square");
    for ((port, before), after) in i.dynamic.ports().actuators.iter().zip(&r.before).zip(&r.after) {
        table = table.row([
            label(&port.name).into(),
            (*before).into(),
            (*after).into(),
            Cell::from(unit(&port.unit)),
        ]);
    }
    section
        .text(format!(
            "Moved onto {} points at rest, {:.0} s of bed: the map drove them while the loops added what was missing, and that was taken into it.{restless}{unreached}",
            r.points.len(),
            r.bed_s
        ))
        .block(table)
}

/// Lags and leads.
fn dynamics(map: &LeadLagMap) -> Table {
    let mut head = vec![
        Column::text("Actuator"),
        Column::number("lag in the middle", "s").digits(3),
        Column::number("least", "s").digits(3),
        Column::number("largest", "s").digits(3),
        Column::number("lead, share of the lag", "-").digits(3),
        Column::number("lost between breakpoints", "%").digits(3),
    ];
    if map.steps.is_some() {
        head.push(Column::number("rounded by", "%").digits(2));
    }
    let rounding = if map.steps.is_some() { " and by rounding" } else { "" };
    let mut table = Table::new(head).caption(format!(
        "Dynamics of the actuators, and the largest difference of their tables half-way between breakpoints from what they were made of{rounding} (of the range of the table)"
    ));
    for (c, ((port, a), loss)) in map.ports.actuators.iter().zip(&map.actuators).zip(&map.loss).enumerate() {
        let rounded = map.steps.as_ref().and_then(|s| s.rounding.get(c));
        let lags = Interval::spanning(a.lag_s.iter().copied());
        let mut cells: Vec<Cell> = vec![
            label(&port.name).into(),
            a.law.tau_s.into(),
            lags.lower.into(),
            lags.upper.into(),
            a.law.lead.into(),
            (100.0 * loss).into(),
        ];
        cells.extend(rounded.map(|r| Cell::from(100.0 * r)));
        table = table.row(cells);
    }
    table
}

/// The numbers that are delivered.
fn tables(map: &LeadLagMap) -> Details {
    let mut details = Details::new("Tables of the dynamic map");
    let lead = &map.ports.demands[0];
    let given = map.ports.given.first();
    for (port, a) in map.ports.actuators.iter().zip(&map.actuators) {
        let parts = [("", unit(&port.unit), &a.base), (", lag", "s", &a.lag_s)];
        for (what, of, values) in parts.into_iter().filter(|p| p.0.is_empty() || a.law.tau_s > 0.0) {
            let name = format!("{}{what} [{of}]", label(&port.name));
            let head = map.given.iter().map(|n| match given {
                Some(g) => Column::number(format!("{} {n:.4}", g.name), unit(&g.unit)).digits(4),
                None => Column::number("value", of).digits(4),
            });
            let first = Column::number(label(&lead.name), unit(&lead.unit)).digits(4);
            let mut table = Table::new([first].into_iter().chain(head).collect()).caption(name);
            for (t, row) in map.demand.iter().zip(values.chunks(map.given.len())) {
                let cells = row.iter().map(|v| Cell::from(*v));
                table = table.row([Cell::from(*t)].into_iter().chain(cells).collect::<Vec<_>>());
            }
            details = details.block(table);
        }
    }
    details
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
