//! The scenarios: engine, range of the static map, what is drawn and driven.

use dynocal_jobs::map::spec::MapSpec;
use dynocal_numerics::rng::Rng64;

use super::bed::{Between, Course, Range, bed};
use super::contest::Drive;

/// A scenario of the table of rivals.
pub(super) struct Scenario {
    /// Its number there; [`REAL_SIXTH`]: the sixth one on a real bed.
    pub(super) number: usize,
    /// What names of its checks begin with.
    pub(super) tag: &'static str,
    pub(super) title: &'static str,
    pub(super) engine: &'static str,
    /// Whether the bed is a real one whatever its parameter set has by itself.
    pub(super) real: bool,
    /// Grid of the static map.
    torque_nm: [f64; 5],
    speed_rpm: [f64; 5],
    /// Random points of record and course.
    range: Range,
    /// Coolant at the start in degC, a record and a course each; none: as the bed comes.
    starts_c: &'static [f64],
    /// Steps that are judged: low and high torque in Nm, speed in rpm.
    steps: &'static [([f64; 2], f64)],
    /// Whether random points are judged.
    random: bool,
}

/// Coolant at the start in the second scenario, in degC.
pub(super) const STARTS_C: [f64; 3] = [20.0, 50.0, 90.0];

/// Range of the port-injection engine.
const PORT_RANGE: Range = Range { torque_nm: Between(20.0, 80.0), speed_rpm: Between(1100.0, 2900.0) };
const PORT_TORQUE_NM: [f64; 5] = [20.0, 35.0, 50.0, 65.0, 80.0];
const PORT_SPEED_RPM: [f64; 5] = [1100.0, 1550.0, 2000.0, 2450.0, 2900.0];

/// Number of the sixth scenario on a real bed; and of both.
pub(super) const REAL_SIXTH: usize = 8;
pub(super) const SIXTH: [usize; 2] = [6, REAL_SIXTH];

/// Range of the engine of the thesis, and steps in it.
const THESIS_RANGE: Range = Range { torque_nm: Between(10.0, 90.0), speed_rpm: Between(1000.0, 3000.0) };
const THESIS_STEPS: &[([f64; 2], f64)] =
    &[([30.0, 70.0], 1200.0), ([30.0, 70.0], 2000.0), ([30.0, 70.0], 2800.0), ([20.0, 80.0], 1200.0)];

/// The sixth scenario, over the range that the thesis gives.
const fn sixth(number: usize, tag: &'static str, title: &'static str, real: bool) -> Scenario {
    Scenario {
        number,
        tag,
        title,
        engine: "thesis",
        real,
        torque_nm: [10.0, 30.0, 50.0, 70.0, 90.0],
        speed_rpm: [1000.0, 1500.0, 2000.0, 2500.0, 3000.0],
        range: THESIS_RANGE,
        starts_c: &[],
        steps: THESIS_STEPS,
        random: true,
    }
}

pub(super) const SCENARIOS: [Scenario; 4] = [
    Scenario {
        number: 1,
        tag: "1",
        title: "Warm: steps and random points",
        engine: "pfi_1_6l",
        real: false,
        torque_nm: PORT_TORQUE_NM,
        speed_rpm: PORT_SPEED_RPM,
        range: PORT_RANGE,
        starts_c: &[],
        steps: &[([30.0, 70.0], 2000.0)],
        random: true,
    },
    Scenario {
        number: 2,
        tag: "2",
        title: "Steps with the coolant at 20, 50 and 90 degC at the start",
        engine: "pfi_1_6l",
        real: false,
        torque_nm: PORT_TORQUE_NM,
        speed_rpm: PORT_SPEED_RPM,
        range: PORT_RANGE,
        starts_c: &STARTS_C,
        steps: &[([30.0, 70.0], 2000.0)],
        random: false,
    },
    sixth(6, "6", "The engine of the thesis in its range, ideal bed", false),
    sixth(REAL_SIXTH, "6-real", "The engine of the thesis in its range, real bed", true),
];

/// Length of a course; the full one or the reduced one.
fn length(reduced: bool, full: usize, short: usize) -> usize {
    if reduced { short } else { full }
}

impl Scenario {
    /// By its number.
    pub(super) fn of(number: usize) -> Option<&'static Self> {
        SCENARIOS.iter().find(|s| s.number == number)
    }

    /// Short and long name of each judged course.
    pub(super) fn courses(&self) -> Vec<(String, String)> {
        if !self.starts_c.is_empty() {
            let named = |c: &f64| (format!("{c}"), format!("steps, coolant at {c} degC at the start"));
            return self.starts_c.iter().map(named).collect();
        }
        let one = self.steps.len() == 1;
        let named = |([low, high], speed): &([f64; 2], f64)| {
            let id = if one { "steps".into() } else { format!("{low}-{high}-{speed}") };
            (id, format!("steps of {low} and {high} Nm at {speed} rpm"))
        };
        let mut out: Vec<_> = self.steps.iter().map(named).collect();
        if self.random {
            out.push(("random".into(), "random points".into()));
        }
        out
    }

    /// First records, records that ours drives, and judged courses.
    pub(super) fn drives(&self, engine: &str, seed: u64, reduced: bool) -> Result<[Vec<Drive>; 3], String> {
        let mut rng = Rng64::stream(seed, self.number as u64);
        let real = self.real;
        let on = |start_c: Option<f64>, course: Course| {
            bed(engine, start_c, real).map(|bed| Drive { bed, course }).map_err(|e| e.to_string())
        };
        let steps = |torque: [f64; 2], speed| Course::steps(length(reduced, 4, 2), torque, speed);
        let (mut records, mut judged) = (Vec::new(), Vec::new());
        for start_c in self.starts_c {
            let record = Course::random(length(reduced, 39, 20), 3.0, &self.range, &mut rng);
            records.push(on(Some(*start_c), record)?);
            for (torque, speed) in self.steps {
                judged.push(on(Some(*start_c), steps(*torque, *speed))?);
            }
        }
        if self.starts_c.is_empty() {
            let record = Course::random(length(reduced, 60, 40), 3.0, &self.range, &mut rng);
            records.push(on(None, record)?);
            for (torque, speed) in self.steps {
                judged.push(on(None, steps(*torque, *speed))?);
            }
            if self.random {
                let random = Course::random(length(reduced, 40, 6), 6.0, &self.range, &mut rng);
                judged.push(on(None, random)?);
            }
        }
        // Drawn last: the courses are those of before. Records and what is driven again are 600 s at most.
        let full = if self.starts_c.is_empty() { 60 } else { 25 };
        let warm = std::iter::repeat_n(None, if self.starts_c.is_empty() { 2 } else { 0 });
        let starts = self.starts_c.iter().map(|c| Some(*c)).chain(warm);
        let repeated = starts
            .map(|c| on(c, Course::random(length(reduced, full, 20), 3.0, &self.range, &mut rng)))
            .collect::<Result<_, _>>()?;
        Ok([records, repeated, judged])
    }

    /// Engine and range of the static map; the range of the problem goes a little beyond the grid.
    pub(super) fn range(&self, engine: &str, spec: &mut MapSpec) {
        spec.plant.parameters = engine.into();
        if self.real {
            spec.plant.bed.insert("real".into(), true.into());
        }
        spec.axes.insert("torque".into(), self.torque_nm.to_vec());
        spec.axes.insert("speed".into(), self.speed_rpm.to_vec());
        for d in spec.problem.demands.iter_mut().filter(|d| d.output == "torque") {
            (d.lower, d.upper) = (self.torque_nm[0] - 3.0, self.torque_nm[4] + 5.0);
        }
        for g in spec.problem.given.iter_mut().filter(|g| g.name == "speed") {
            (g.lower, g.upper) = (self.speed_rpm[0] - 50.0, self.speed_rpm[4] + 100.0);
        }
    }
}
