//! Step 5: the dynamic map in steady state beside the static one.

use crate::calibrate::invert_step::InvertResult;
use dynocal_calib::map::static_map::StaticMap;
use dynocal_calib::map::structured::term_names;
use dynocal_calib::map::{Actuators, Reference};
use dynocal_calib::validate::ValidateSpec;
use dynocal_report::{Axis, Block, Cell, Column, Details, HeatMap, Section, Table};

use super::parts::percent;
use crate::calibrate::verdict::word;

/// Points of the drawn grid along speed and torque.
const GRID: (usize, usize) = (19, 13);
const ACTUATORS: [(&str, &str); 3] =
    [("Injected mass", "mg"), ("Spark advance", "deg BTDC"), ("Throttle", "deg")];

/// The whole step.
pub(super) fn section(i: &InvertResult, rival: Option<&StaticMap>, scenario: &ValidateSpec) -> Section {
    let mut section = Section::new("Dynamic map").id("maps").text(format!(
        "Fitted on {} responses of the records {}. It is a static part plus differences over a window of the filtered demand, which vanish in steady state.",
        i.pairs,
        i.records.join(", ")
    ));
    let grid = Grid::over(scenario);
    for (c, (name, unit)) in ACTUATORS.iter().enumerate() {
        let dynamic = grid.values(|r| i.dynamic.steady(r), c);
        let map = |title: String, z: Vec<f64>| {
            HeatMap::new(title, grid.x(), grid.y(), (Axis::new(*name, *unit), z)).contours()
        };
        let mut blocks: Vec<Block> =
            vec![map(format!("{name}: dynamic map at rest"), dynamic.clone()).into()];
        if let Some(rival) = rival {
            let fixed = grid.values(|r| rival.at(&r), c);
            let difference: Vec<f64> = dynamic.iter().zip(&fixed).map(|(a, b)| a - b).collect();
            let (x, y) = points(rival);
            blocks.push(map(format!("{name}: static map"), fixed).overlay("grid points", x, y).into());
            let axis = Axis::new(format!("{name}, difference"), *unit);
            let title = format!("{name}: dynamic minus static");
            blocks.push(HeatMap::new(title, grid.x(), grid.y(), (axis, difference)).diverging().into());
        }
        section = section.columns(blocks);
    }
    section.block(scores(i)).block(coefficients(i))
}

struct Grid {
    speed_rpm: Vec<f64>,
    torque_nm: Vec<f64>,
}

impl Grid {
    fn over(s: &ValidateSpec) -> Self {
        let axis = |(a, b): (f64, f64), n: usize| -> Vec<f64> {
            (0..n).map(|k| a + (b - a) * k as f64 / (n - 1) as f64).collect()
        };
        Self { speed_rpm: axis(s.speed_rpm, GRID.0), torque_nm: axis(s.torque_nm, GRID.1) }
    }

    fn x(&self) -> (Axis, Vec<f64>) {
        (Axis::new("Speed", "rpm"), self.speed_rpm.clone())
    }

    fn y(&self) -> (Axis, Vec<f64>) {
        (Axis::new("Torque", "Nm"), self.torque_nm.clone())
    }

    fn values(&self, map: impl Fn(Reference) -> Actuators, c: usize) -> Vec<f64> {
        let at = |torque_nm: f64, speed_rpm: f64| map(Reference { torque_nm, lambda: 1.0, speed_rpm })[c];
        self.torque_nm
            .iter()
            .flat_map(|t| self.speed_rpm.iter().map(|n| at(*t, *n)).collect::<Vec<f64>>())
            .collect()
    }
}

fn points(map: &StaticMap) -> (Vec<f64>, Vec<f64>) {
    map.points.iter().map(|p| (p.speed_rpm, p.torque_nm)).unzip()
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
        let r2 = percent(s.r2).map_or(Cell::from("unstable"), Cell::from);
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

fn coefficients(i: &InvertResult) -> Details {
    let d = &i.dynamic;
    let mut table = Table::new(vec![
        Column::text("Term"),
        Column::number("INJ", "mg").digits(5),
        Column::number("Spark", "deg BTDC").digits(5),
        Column::number("Throttle", "deg").digits(5),
    ])
    .caption("T in units of 50 Nm, N of 2000 rpm, L = (lambda - 1) / 0.1");
    for (k, name) in term_names(&d.shape).iter().enumerate() {
        let value = |c: usize| Cell::from(d.coefficients[c].get(k).copied());
        table = table.row([name.as_str().into(), value(0), value(1), value(2)]);
    }
    Details::new(format!(
        "Coefficients of the dynamic map ({} terms for each actuator)",
        d.coefficients[0].len()
    ))
    .block(table)
}
