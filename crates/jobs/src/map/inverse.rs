//! Inverse maps: what an input that a loop drives gives of its demand.
//!
//! ```text
//! u = f(y, z)     the map: a throttle from torque and speed
//! y = g(u, z)     its inverse: f(g(u, z), z) = u, straight between the values of f along y
//! ```
//!
//! An ECU needs both: the throttle that a torque takes, and the torque that a driver's throttle asks for. Where f does not rise along
//! y (or does not fall), one u has several y; the least of them is taken, and it is said. Beyond the ends of a column the inverse is held.

use dynocal_calib::map::static_map::StaticMap;
use serde::Serialize;

/// Times as many values of u as the map has of y, at most.
const FINER: usize = 2;

/// The inverse of the map of a driven input.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Inverse {
    /// The input, now an axis.
    pub input: String,
    /// Its unit.
    pub input_unit: String,
    /// What it holds, now a value.
    pub output: String,
    /// Its unit.
    pub output_unit: String,
    /// The other axis with its unit; empty where there is none.
    pub given: String,
    /// Its unit.
    pub given_unit: String,
    /// Values of the input.
    pub inputs: Vec<f64>,
    /// Values of the other axis.
    pub givens: Vec<f64>,
    /// Values of the output, the other axis fastest.
    pub values: Vec<f64>,
    /// Largest difference, over the values of the map where it goes one way, of what the inverse gives for its input from what it holds.
    pub error: f64,
    /// Places along the other axis at which the map does not rise or fall all the way.
    pub several: Vec<f64>,
}

/// Inverse of the map of actuator `name`, which holds the leading demand of `map`; none where its demand is no axis.
pub fn of(map: &StaticMap, name: &str) -> Option<Inverse> {
    let k = map.ports.actuators.iter().position(|a| a.name == name)?;
    let (demand, actuator) = (map.ports.demands.first()?, &map.ports.actuators[k]);
    if map.demand.len() < 2 {
        return None;
    }
    let columns: Vec<Vec<f64>> = (0..map.given.len())
        .map(|g| (0..map.demand.len()).map(|d| map.points[d * map.given.len() + g].actuators[k]).collect())
        .collect();
    let ends =
        columns.iter().flatten().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
    if !(ends.1 > ends.0 && ends.0.is_finite() && ends.1.is_finite()) {
        return None;
    }
    // As many values as there are, denser where those of the map are.
    let mut all: Vec<f64> = columns.iter().flatten().copied().collect();
    all.sort_by(f64::total_cmp);
    all.dedup();
    let n = (FINER * map.demand.len()).min(all.len());
    let inputs: Vec<f64> = (0..n).map(|i| all[i * (all.len() - 1) / (n - 1)]).collect();
    let values = inputs.iter().flat_map(|u| columns.iter().map(|c| inverted(c, &map.demand, *u))).collect();
    let mut found = Inverse {
        input: actuator.name.clone(),
        input_unit: actuator.unit.clone(),
        output: demand.name.clone(),
        output_unit: demand.unit.clone(),
        given: map.ports.given.first().map_or(String::new(), |g| g.name.clone()),
        given_unit: map.ports.given.first().map_or(String::new(), |g| g.unit.clone()),
        inputs,
        givens: map.given.clone(),
        values,
        error: 0.0,
        several: Vec::new(),
    };
    for (g, column) in columns.iter().enumerate() {
        let way = (column[column.len() - 1] - column[0]).signum();
        if column.windows(2).any(|w| (w[1] - w[0]) * way <= 0.0) {
            found.several.push(map.given[g]);
            continue;
        }
        for (y, u) in map.demand.iter().zip(column) {
            found.error = found.error.max((found.at(*u, g) - y).abs());
        }
    }
    Some(found)
}

impl Inverse {
    /// Value at `u` in the column of the other axis number `g`, straight between the values of the input.
    fn at(&self, u: f64, g: usize) -> f64 {
        let columns = self.givens.len();
        let column: Vec<f64> = (0..self.inputs.len()).map(|i| self.values[i * columns + g]).collect();
        let i = self.inputs.partition_point(|v| *v <= u).clamp(1, self.inputs.len() - 1);
        let share = ((u - self.inputs[i - 1]) / (self.inputs[i] - self.inputs[i - 1])).clamp(0.0, 1.0);
        column[i - 1] + share * (column[i] - column[i - 1])
    }

    /// As a table: the input down, the other axis across.
    pub fn csv(&self) -> String {
        let head: Vec<String> = self
            .givens
            .iter()
            .map(|g| match self.given.as_str() {
                "" => format!("{} [{}]", self.output, self.output_unit),
                name => format!("{} at {name} {g} {} [{}]", self.output, self.given_unit, self.output_unit),
            })
            .collect();
        let mut text = format!("{} [{}],{}\n", self.input, self.input_unit, head.join(","));
        for (u, row) in self.inputs.iter().zip(self.values.chunks(self.givens.len())) {
            let cells: Vec<String> = row.iter().map(|v| format!("{v:.6}")).collect();
            text += &format!("{u:.6},{}\n", cells.join(","));
        }
        text
    }
}

/// The least y of `along` at which the straight lines through `column` have the value `u`; the nearest end where they have it nowhere.
fn inverted(column: &[f64], along: &[f64], u: f64) -> f64 {
    for (w, y) in column.windows(2).zip(along.windows(2)) {
        let inside = (w[0].min(w[1])..=w[0].max(w[1])).contains(&u);
        if inside && w[0] != w[1] {
            return y[0] + (u - w[0]) / (w[1] - w[0]) * (y[1] - y[0]);
        }
        if inside {
            return y[0];
        }
    }
    let nearest = column.iter().enumerate().min_by(|a, b| (a.1 - u).abs().total_cmp(&(b.1 - u).abs()));
    nearest.map_or(f64::NAN, |(i, _)| along[i])
}
