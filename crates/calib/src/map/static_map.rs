//! The conventional static map (thesis chapter 6): best spark at each operating point, found on the bed.

use super::{Actuators, FeedforwardMap, MapLimits, Reference};
use crate::control::LoopGains;
use crate::record::{ActuatorLimits, Demand, engine_plan};
use dynocal_ident::plant::{Plant, PlantError};
use dynocal_ident::play::{Band, PlayError, UntilStill, play};
use serde::{Deserialize, Serialize};

/// Operating grid and settling rule of the static calibration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StaticSpec {
    /// Torque grid in Nm.
    pub torque_nm: Vec<f64>,
    /// Speed grid in rpm.
    pub speed_rpm: Vec<f64>,
    /// Longest settling time at one spark in s (the thesis waits 9 s).
    pub settle_s: f64,
    /// Averaging time after it in s.
    pub average_s: f64,
    /// Width of the spark bracket at which the search ends, in deg.
    pub spark_tolerance_deg: f64,
}

impl Default for StaticSpec {
    fn default() -> Self {
        Self {
            torque_nm: vec![20.0, 35.0, 50.0, 65.0, 80.0],
            speed_rpm: vec![1100.0, 1550.0, 2000.0, 2450.0, 2900.0],
            settle_s: 9.0,
            average_s: 1.0,
            spark_tolerance_deg: 1.5,
        }
    }
}

/// Best setting found at one operating point.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StaticPoint {
    /// Torque in Nm.
    pub torque_nm: f64,
    /// Speed in rpm.
    pub speed_rpm: f64,
    /// INJ in mg, SA in deg BTDC, throttle in deg.
    pub actuators: Actuators,
    /// Largest |torque - demand| while averaging, in Nm.
    pub torque_error_nm: f64,
    /// Largest |lambda - 1| while averaging.
    pub lambda_error: f64,
}

/// Look-up tables over torque and speed at lambda 1.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StaticMap {
    /// Torque axis in Nm.
    pub torque_nm: Vec<f64>,
    /// Speed axis in rpm.
    pub speed_rpm: Vec<f64>,
    /// Points, torque index slow, speed index fast.
    pub points: Vec<StaticPoint>,
    /// Bed seconds spent.
    pub bed_s: f64,
}

/// Steady state at one spark: throttle and fuel in the loops, averages after settling.
struct Steady {
    actuators: Actuators,
    torque_error_nm: f64,
    lambda_error: f64,
}

/// A plant with the bed time spent on it.
struct Bed<'a> {
    plant: &'a mut dyn Plant,
    sample_time_s: f64,
    used_s: f64,
}

fn settle(
    bed: &mut Bed,
    spec: &StaticSpec,
    limits: &MapLimits,
    target: (f64, f64),
    start: Actuators,
) -> Result<Steady, PlayError> {
    let (torque_nm, speed_rpm) = target;
    let dt = bed.sample_time_s;
    // A bed engineer goes on when the needles stand still: 0.5 s inside a narrow band ends the wait early.
    let (still, most) = ((0.5 / dt) as usize, (spec.settle_s / dt) as usize);
    let n = (spec.average_s / dt).round().max(1.0) as usize;
    let rows = vec![[start[0], start[1], start[2], speed_rpm]; most + n];
    let demand = vec![Demand { torque_nm, lambda: 1.0 }; most + n];
    let of = |i: usize| (limits.lower[i], limits.upper[i]);
    let actuators = ActuatorLimits { inj_mg: of(0), spark_deg: of(1), throttle_deg: of(2) };
    let plan = engine_plan("static point", dt, &rows, &demand, LoopGains::RETUNED, actuators, 0.0);
    let band = |output: &str, value, half_width| Band { output: output.into(), value, half_width };
    let bands = vec![band("torque", torque_nm, 0.02), band("lambda", 1.0, 2e-4)];
    let mut rest = UntilStill::new(bands, still, n);
    let played = play(bed.plant, &plan, &mut rest)?;
    bed.used_s += played.used_s;
    let played = if rest.reached() { played } else { played.whole()? };
    let last = |name: &str| -> Result<&[f64], PlayError> {
        let values = played.record.values(name)?;
        Ok(&values[values.len().saturating_sub(n)..])
    };
    let mean = |name: &str| Ok::<f64, PlayError>(last(name)?.iter().sum::<f64>() / n as f64);
    let worst = |name: &str, value: f64| {
        Ok::<f64, PlayError>(last(name)?.iter().fold(0.0f64, |a, y| a.max((y - value).abs())))
    };
    let actuators = [mean("inj")?, mean("spark")?, mean("throttle")?];
    Ok(Steady {
        actuators,
        torque_error_nm: worst("torque", torque_nm)?,
        lambda_error: worst("lambda", 1.0)?,
    })
}

/// Best spark at one operating point by golden section on fuel, finished by a parabola through the best three.
///
/// Fuel over spark at held torque and lambda has one minimum, so a bracket never loses it.
///
/// # Errors
/// [`PlayError`] of the player.
fn best_spark(
    bed: &mut Bed,
    spec: &StaticSpec,
    limits: &MapLimits,
    target: (f64, f64),
    start: Actuators,
) -> Result<StaticPoint, PlayError> {
    let mut seen: Vec<(f64, Steady)> = Vec::new();
    let mut warm = start;
    let mut evaluate = |spark: f64, seen: &mut Vec<(f64, Steady)>| -> Result<f64, PlayError> {
        warm[1] = spark;
        let s = settle(bed, spec, limits, target, warm)?;
        warm = s.actuators;
        let fuel = s.actuators[0];
        seen.push((spark, s));
        Ok(fuel)
    };
    let golden = 0.5 * (5f64.sqrt() - 1.0);
    let (mut lo, mut hi) = (limits.lower[1], limits.upper[1]);
    let (mut a, mut b) = (hi - golden * (hi - lo), lo + golden * (hi - lo));
    let (mut fa, mut fb) = (evaluate(a, &mut seen)?, evaluate(b, &mut seen)?);
    while hi - lo > spec.spark_tolerance_deg {
        if fa <= fb {
            (hi, b, fb) = (b, a, fa);
            a = hi - golden * (hi - lo);
            fa = evaluate(a, &mut seen)?;
        } else {
            (lo, a, fa) = (a, b, fb);
            b = lo + golden * (hi - lo);
            fb = evaluate(b, &mut seen)?;
        }
    }
    if let Some(spark) = parabola_minimum(&seen) {
        evaluate(spark.clamp(limits.lower[1], limits.upper[1]), &mut seen)?;
    }
    // The parabola point is taken only if it is no worse than the best of the bracket.
    let best = seen
        .into_iter()
        .min_by(|x, y| x.1.actuators[0].total_cmp(&y.1.actuators[0]))
        .map(|(_, s)| s)
        .ok_or_else(|| PlantError::Call("best spark: no point was measured".into()))?;
    Ok(StaticPoint {
        torque_nm: target.0,
        speed_rpm: target.1,
        actuators: best.actuators,
        torque_error_nm: best.torque_error_nm,
        lambda_error: best.lambda_error,
    })
}

/// Abscissa of the vertex of the parabola through the three points of least fuel, if it opens upwards.
fn parabola_minimum(seen: &[(f64, Steady)]) -> Option<f64> {
    let mut points: Vec<(f64, f64)> = seen.iter().map(|(x, s)| (*x, s.actuators[0])).collect();
    points.sort_by(|a, b| a.1.total_cmp(&b.1));
    let [(x0, y0), (x1, y1), (x2, y2)] = *points.get(..3)? else { return None };
    let (d1, d2) = ((y1 - y0) / (x1 - x0), (y2 - y0) / (x2 - x0));
    let curvature = (d2 - d1) / (x2 - x1);
    (curvature > 0.0 && curvature.is_finite()).then(|| 0.5 * (x0 + x1 - d1 / curvature))
}

impl StaticMap {
    /// Calibrates one row of the grid (all speeds of one torque) on `plant`: its points and the bed time in s.
    ///
    /// # Errors
    /// [`PlayError`] of the player.
    pub fn calibrate_row(
        plant: &mut dyn Plant,
        sample_time_s: f64,
        spec: &StaticSpec,
        limits: &MapLimits,
        torque_nm: f64,
    ) -> Result<(Vec<StaticPoint>, f64), PlayError> {
        let mut bed = Bed { plant, sample_time_s, used_s: 0.0 };
        let mut start = [4.0 + 0.18 * torque_nm, 20.0, 5.0 + 0.15 * torque_nm];
        let mut points = Vec::new();
        for &speed in &spec.speed_rpm {
            let point = best_spark(&mut bed, spec, limits, (torque_nm, speed), start)?;
            start = point.actuators;
            points.push(point);
        }
        Ok((points, bed.used_s))
    }

    /// Puts the rows of the grid together.
    pub fn from_rows(spec: &StaticSpec, rows: Vec<Vec<StaticPoint>>, bed_s: f64) -> Self {
        Self {
            torque_nm: spec.torque_nm.clone(),
            speed_rpm: spec.speed_rpm.clone(),
            points: rows.into_iter().flatten().collect(),
            bed_s,
        }
    }

    /// Bilinear interpolation, held at the edges of the grid.
    pub fn at(&self, r: &Reference) -> Actuators {
        let (i, a) = locate(&self.torque_nm, r.torque_nm);
        let (j, b) = locate(&self.speed_rpm, r.speed_rpm);
        let columns = self.speed_rpm.len();
        let point = |i: usize, j: usize| &self.points[i * columns + j].actuators;
        let (i1, j1) = ((i + 1).min(self.torque_nm.len() - 1), (j + 1).min(columns - 1));
        std::array::from_fn(|c| {
            (1.0 - a) * ((1.0 - b) * point(i, j)[c] + b * point(i, j1)[c])
                + a * ((1.0 - b) * point(i1, j)[c] + b * point(i1, j1)[c])
        })
    }
}

/// Interval of `axis` that holds `x` and the position in it (0 to 1, clamped).
fn locate(axis: &[f64], x: f64) -> (usize, f64) {
    let last = axis.len() - 1;
    if last == 0 || x <= axis[0] {
        return (0, 0.0);
    }
    if x >= axis[last] {
        return (last, 0.0);
    }
    let i = axis.partition_point(|v| *v <= x) - 1;
    (i, (x - axis[i]) / (axis[i + 1] - axis[i]))
}

impl FeedforwardMap for StaticMap {
    fn name(&self) -> &str {
        "static map"
    }

    fn drive(&self, demand: &[Reference], _sample_time_s: f64) -> Vec<Actuators> {
        demand.iter().map(|r| self.at(r)).collect()
    }

    fn latency_s(&self, _sample_time_s: f64) -> f64 {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bilinear data are reproduced exactly, edges are held.
    #[test]
    fn interpolation_is_exact_for_bilinear_tables() {
        let f = |t: f64, n: f64| [0.2 * t + 1e-3 * n, 30.0 - 0.1 * t, 1e-4 * t * n];
        let spec = StaticSpec::default();
        let rows = spec
            .torque_nm
            .iter()
            .map(|&t| {
                spec.speed_rpm
                    .iter()
                    .map(|&n| StaticPoint {
                        torque_nm: t,
                        speed_rpm: n,
                        actuators: f(t, n),
                        torque_error_nm: 0.0,
                        lambda_error: 0.0,
                    })
                    .collect()
            })
            .collect();
        let map = StaticMap::from_rows(&spec, rows, 0.0);
        let at = |t, n| map.at(&Reference { torque_nm: t, lambda: 1.0, speed_rpm: n });
        for (t, n) in [(20.0, 1100.0), (33.3, 1234.0), (80.0, 2900.0), (64.9, 2449.0)] {
            let (got, want) = (at(t, n), f(t, n));
            assert!((0..3).all(|c| (got[c] - want[c]).abs() < 1e-12), "{t} {n}: {got:?} {want:?}");
        }
        assert_eq!(at(5.0, 800.0), f(20.0, 1100.0));
    }
}
