//! Inverse maps: what an input that a loop drives gives of its demand.
//!
//! ```text
//! u = f(y, z)     the map: a throttle from torque and speed
//! y = g(u, z)     its inverse: f(g(u, z), z) = u, straight between the values of f along y
//! ```
//!
//! An ECU needs both: the throttle that a torque takes, and the torque that a driver's throttle asks for. Where f does not rise along
//! y (or does not fall), one u has several y; the least of them is taken, and it is said. Beyond the ends of a column the inverse is held. Of
//! all values that the map has the axis takes those between which the inverse is straight with the least error ([`Tables`]), as many as that takes.

use dynocal_calib::map::static_map::StaticMap;
use dynocal_calib::steady::breakpoints::Tables;
use serde::Serialize;

/// Error of the inverse, as a share of what y goes through, above which it takes more values of u.
const STRAIGHT: f64 = 0.005;

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
    let columns: Vec<Column> = (0..map.given.len()).map(|g| column(map, k, g)).collect();
    let mut all: Vec<f64> = columns.iter().flat_map(|c| c.u.iter().copied()).collect();
    all.sort_by(f64::total_cmp);
    all.dedup();
    if all.len() < 2 || all.iter().any(|u| !u.is_finite()) {
        return None;
    }
    let full: Vec<f64> = all.iter().flat_map(|u| columns.iter().map(|c| c.inverted(*u))).collect();
    let given = map.ports.given.first();
    let mut found = Inverse {
        input: actuator.name.clone(),
        input_unit: actuator.unit.clone(),
        output: demand.name.clone(),
        output_unit: demand.unit.clone(),
        given: given.map_or(String::new(), |g| g.name.clone()),
        given_unit: given.map_or(String::new(), |g| g.unit.clone()),
        inputs: all,
        givens: map.given.clone(),
        values: full,
        error: 0.0,
        several: columns.iter().zip(&map.given).filter(|(c, _)| !c.one_way()).map(|(_, g)| *g).collect(),
    };
    found.thin(&columns, map.demand.len());
    Some(found)
}

impl Inverse {
    /// Leaves out values of the input between which the inverse is straight enough: as many stay as there are of y at first, then half as many more.
    fn thin(&mut self, columns: &[Column], least: usize) {
        let (all, full) = (std::mem::take(&mut self.inputs), std::mem::take(&mut self.values));
        let across = self.givens.len();
        let y = full.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
        let axes = if across > 1 { vec![all.clone(), self.givens.clone()] } else { vec![all.clone()] };
        let tables = Tables { axes, layers: vec![full.clone()], weights: vec![1.0; full.len()] };
        let mut n = least.clamp(2, all.len());
        loop {
            let kept = &tables.choose(&[n, across])[0];
            self.inputs = kept.iter().map(|i| all[*i]).collect();
            self.values = kept.iter().flat_map(|i| full[i * across..(i + 1) * across].to_vec()).collect();
            self.error = self.misses(columns);
            if self.error <= STRAIGHT * (y.1 - y.0) || n == all.len() {
                return;
            }
            n = (n + n.div_ceil(2)).min(all.len());
        }
    }

    /// Largest difference of what it gives for the inputs of the map from what they hold, where the map goes one way.
    fn misses(&self, columns: &[Column]) -> f64 {
        let one = |(g, c): (usize, &Column)| {
            let off = c.y.iter().zip(&c.u).map(|(y, u)| (self.at(*u, g) - y).abs());
            off.fold(0.0, f64::max)
        };
        columns.iter().enumerate().filter(|(_, c)| c.one_way()).map(one).fold(0.0, f64::max)
    }

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

/// The map at one place of the other axis, without what was not reached there.
struct Column {
    y: Vec<f64>,
    u: Vec<f64>,
}

fn column(map: &StaticMap, actuator: usize, given: usize) -> Column {
    let at = |d: &usize| &map.points[d * map.given.len() + given];
    let mut all: Vec<usize> = (0..map.demand.len()).filter(|d| at(d).missed.is_empty()).collect();
    if all.len() < 2 {
        all = (0..map.demand.len()).collect();
    }
    Column {
        y: all.iter().map(|d| map.demand[*d]).collect(),
        u: all.iter().map(|d| at(d).actuators[actuator]).collect(),
    }
}

impl Column {
    /// Whether the input rises, or falls, all the way.
    fn one_way(&self) -> bool {
        let way = (self.u[self.u.len() - 1] - self.u[0]).signum();
        self.u.windows(2).all(|w| (w[1] - w[0]) * way > 0.0)
    }

    /// The least y at which the straight lines through the column have the value `u`; the nearest end where they have it nowhere.
    fn inverted(&self, u: f64) -> f64 {
        for (w, y) in self.u.windows(2).zip(self.y.windows(2)) {
            let inside = (w[0].min(w[1])..=w[0].max(w[1])).contains(&u);
            if inside && w[0] != w[1] {
                return y[0] + (u - w[0]) / (w[1] - w[0]) * (y[1] - y[0]);
            }
            if inside {
                return y[0];
            }
        }
        let nearest = self.u.iter().enumerate().min_by(|a, b| (a.1 - u).abs().total_cmp(&(b.1 - u).abs()));
        nearest.map_or(f64::NAN, |(i, _)| self.y[i])
    }
}
