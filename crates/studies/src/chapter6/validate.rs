//! Validation as in 6.7: the map alone drives the engine over random points, each held for six seconds.

use dynocal_numerics::rng::Rng64;
use serde::{Deserialize, Serialize};

use super::bed::{Actuators, Bed, SAMPLE_S, SPARKS};
use super::ways::{Cell, Made};

/// Seconds that a random point is held.
const HOLD_S: f64 = 6.0;
/// Time at the end of a hold whose mean is the final value, in s.
const FINAL_S: f64 = 1.0;
/// A response has settled when it stays this near to its final value: Nm and lambda.
const BAND: [f64; 2] = [1.0, 0.01];

/// Table 6.1 and eq. (6.4), with the greatest of all holds.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Validated {
    /// Holds.
    pub(super) holds: usize,
    pub(super) torque: Response,
    pub(super) lambda: Response,
    /// Sum of torque over sum of injected fuel in Nm/mg with the sparks of the map.
    pub(super) economy: f64,
    /// The same with random sparks at equal fuel and throttle.
    pub(super) economy_random: f64,
    /// Holds in which the random spark gave the greater mean torque at the end.
    pub(super) random_better: usize,
    /// Largest difference of final lambda between both.
    pub(super) lambda_apart: f64,
}

/// Greatest over all holds.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub(super) struct Response {
    /// Last time outside of the band about the final value, in s.
    pub(super) settling_s: f64,
    /// Torque: how far it goes beyond its final value in the direction of the step. Lambda: distance from 1.
    pub(super) overshoot: f64,
    /// Final value less demand.
    pub(super) offset: f64,
}

/// A random operating point.
struct Point {
    torque_nm: f64,
    speed_rpm: f64,
    random_spark_deg: f64,
}

/// The map over `holds` random points inside of its grid.
///
/// # Errors
/// What the bed says.
pub(super) fn validate(made: &Made, holds: usize, seed: u64) -> Result<Validated, String> {
    let grid = Grid::of(made);
    let mut rng = Rng64::stream(seed, 61);
    let points: Vec<Point> = (0..holds)
        .map(|_| Point {
            torque_nm: rng.uniform_in(grid.torques[0], grid.torques[grid.torques.len() - 1]),
            speed_rpm: rng.uniform_in(grid.speeds[0], grid.speeds[grid.speeds.len() - 1]),
            random_spark_deg: rng.uniform_in(SPARKS[0], SPARKS[1]),
        })
        .collect();
    let n = (HOLD_S / SAMPLE_S).round() as usize;
    let best = drive(&grid, &points, n, false)?;
    let random = drive(&grid, &points, n, true)?;
    let mut out = Validated {
        holds,
        torque: Response::default(),
        lambda: Response::default(),
        economy: best.economy(),
        economy_random: random.economy(),
        random_better: 0,
        lambda_apart: 0.0,
    };
    // The first hold begins with the engine as it stood.
    for k in 1..holds {
        let of = |record: &[f64]| record[k * n..(k + 1) * n].to_vec();
        let (torque, lambda) = (of(&best.torque), of(&best.lambda));
        let before = best.torque[k * n - 1];
        out.torque.join(torque_response(&torque, before, points[k].torque_nm));
        out.lambda.join(lambda_response(&lambda));
        let (shaken, apart) = (of(&random.torque), of(&random.lambda));
        out.random_better += usize::from(last_mean(&shaken) > last_mean(&torque));
        out.lambda_apart = out.lambda_apart.max((last_mean(&apart) - last_mean(&lambda)).abs());
    }
    Ok(out)
}

impl Response {
    fn join(&mut self, other: Response) {
        self.settling_s = self.settling_s.max(other.settling_s);
        self.overshoot = self.overshoot.max(other.overshoot);
        self.offset = self.offset.max(other.offset.abs());
    }
}

fn last_mean(y: &[f64]) -> f64 {
    let n = (FINAL_S / SAMPLE_S).round() as usize;
    y[y.len() - n..].iter().sum::<f64>() / n as f64
}

fn settling_s(y: &[f64], last: f64, band: f64) -> f64 {
    y.iter().rposition(|v| (v - last).abs() > band).map_or(0.0, |k| (k + 1) as f64 * SAMPLE_S)
}

fn torque_response(y: &[f64], before: f64, demand: f64) -> Response {
    let last = last_mean(y);
    let way = (last - before).signum();
    let beyond = y.iter().map(|v| way * (v - last)).fold(0.0, f64::max);
    Response { settling_s: settling_s(y, last, BAND[0]), overshoot: beyond, offset: last - demand }
}

fn lambda_response(y: &[f64]) -> Response {
    let last = last_mean(y);
    let spike = y.iter().map(|v| (v - 1.0).abs()).fold(0.0, f64::max);
    Response { settling_s: settling_s(y, last, BAND[1]), overshoot: spike, offset: last - 1.0 }
}

/// What was recorded.
struct Driven {
    torque: Vec<f64>,
    lambda: Vec<f64>,
    inj: Vec<f64>,
}

impl Driven {
    /// Eq. (6.4) in Nm/mg.
    fn economy(&self) -> f64 {
        self.torque.iter().sum::<f64>() / self.inj.iter().sum::<f64>()
    }
}

fn drive(grid: &Grid, points: &[Point], n: usize, random: bool) -> Result<Driven, String> {
    let mut values: [Vec<f64>; 3] = std::array::from_fn(|_| Vec::with_capacity(n * points.len()));
    let mut speed = Vec::with_capacity(n * points.len());
    for p in points {
        let mut u = grid.at(p.torque_nm, p.speed_rpm);
        if random {
            u.spark_deg = p.random_spark_deg;
        }
        for (v, u) in values.iter_mut().zip(u.values()) {
            v.extend(std::iter::repeat_n(u, n));
        }
        speed.extend(std::iter::repeat_n(p.speed_rpm, n));
    }
    let inj = values[0].clone();
    let record = Bed::new()?.drive(values, speed)?;
    let of = |name: &str| record.values(name).map(<[f64]>::to_vec).map_err(|e| e.to_string());
    Ok(Driven { torque: of("torque")?, lambda: of("lambda")?, inj })
}

/// The cells as tables over torque and speed.
struct Grid<'a> {
    torques: Vec<f64>,
    speeds: Vec<f64>,
    cells: &'a [Cell],
}

impl<'a> Grid<'a> {
    fn of(made: &'a Made) -> Self {
        let mut torques: Vec<f64> = made.cells.iter().map(|c| c.at.torque_nm).collect();
        torques.dedup();
        let speeds =
            made.cells.iter().take(made.cells.len() / torques.len()).map(|c| c.at.speed_rpm).collect();
        Self { torques, speeds, cells: &made.cells }
    }

    /// Bilinear between the cells.
    fn at(&self, torque_nm: f64, speed_rpm: f64) -> Actuators {
        let ((i, a), (j, b)) = (locate(&self.torques, torque_nm), locate(&self.speeds, speed_rpm));
        let cell = |i: usize, j: usize| self.cells[i * self.speeds.len() + j].u.values();
        let corners = [cell(i, j), cell(i, j + 1), cell(i + 1, j), cell(i + 1, j + 1)];
        let between = |k: usize| {
            let [p00, p01, p10, p11] = corners.map(|p| p[k]);
            (1.0 - a) * ((1.0 - b) * p00 + b * p01) + a * ((1.0 - b) * p10 + b * p11)
        };
        Actuators::of(&[between(0), between(1), between(2)])
    }
}

/// Interval of an axis of two values or more, and the place in it.
fn locate(axis: &[f64], x: f64) -> (usize, f64) {
    let k = axis.partition_point(|v| *v <= x).clamp(1, axis.len() - 1) - 1;
    (k, ((x - axis[k]) / (axis[k + 1] - axis[k])).clamp(0.0, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// First-order response from 0 to 10 with a demand of 10.5: outside of 1 Nm until tau ln 10, no overshoot, half a Nm short.
    #[test]
    fn the_measures_of_a_first_order_response_are_known() {
        let tau = 0.5;
        let y: Vec<f64> = (0..200).map(|k| 10.0 * (1.0 - (-(k as f64) * SAMPLE_S / tau).exp())).collect();
        let r = torque_response(&y, 0.0, 10.5);
        assert!((r.settling_s - tau * 10f64.ln()).abs() < 2.0 * SAMPLE_S, "{}", r.settling_s);
        assert!(r.overshoot < 1e-3 && (r.offset + 0.5).abs() < 1e-3, "{r:?}");
        // Downwards the same.
        let down: Vec<f64> = y.iter().map(|v| 10.0 - v).collect();
        let d = torque_response(&down, 10.0, 0.0);
        assert!((d.settling_s - r.settling_s).abs() < 1e-12 && d.overshoot < 1e-3);
        let spike: Vec<f64> = (0..200).map(|k| if k == 3 { 1.2 } else { 1.004 }).collect();
        let l = lambda_response(&spike);
        assert!((l.overshoot - 0.2).abs() < 1e-12 && (l.offset - 0.004).abs() < 1e-12);
        assert!((l.settling_s - 4.0 * SAMPLE_S).abs() < 1e-12);
    }
}
