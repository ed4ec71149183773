//! The best spark of a sweep, by smoothing.

use dynocal_numerics::linalg::least_squares;

/// Coefficients of the smoothing polynomial: of the fourth degree, as the sweeps are nearly parabolas with a flat end.
const COEFFICIENTS: usize = 5;
/// Step in deg with which the least of the smoothed fuel is sought.
const STEP_DEG: f64 = 0.05;

/// A polynomial of the spark by least squares, over sparks shifted and scaled to -1 to 1.
struct Smooth {
    middle: f64,
    half: f64,
    coefficients: Vec<f64>,
}

impl Smooth {
    fn of(sparks: &[f64], y: &[f64]) -> Option<Self> {
        let (low, high) = ends(sparks)?;
        let (middle, half) = (0.5 * (low + high), (0.5 * (high - low)).max(1e-9));
        let rows: Vec<f64> = sparks.iter().flat_map(|s| powers((s - middle) / half)).collect();
        let fit = least_squares(&rows, sparks.len(), COEFFICIENTS, y, 0.0).ok()?;
        Some(Self { middle, half, coefficients: fit.x })
    }

    fn at(&self, spark: f64) -> f64 {
        let p = powers((spark - self.middle) / self.half);
        self.coefficients.iter().zip(p).map(|(c, p)| c * p).sum()
    }
}

fn powers(x: f64) -> [f64; COEFFICIENTS] {
    std::array::from_fn(|k| x.powi(k as i32))
}

fn ends(sparks: &[f64]) -> Option<(f64, f64)> {
    let low = sparks.iter().copied().reduce(f64::min)?;
    let high = sparks.iter().copied().reduce(f64::max)?;
    Some((low, high))
}

/// What a smoothed sweep says.
pub(super) struct BestSpark {
    pub(super) spark_deg: f64,
    pub(super) inj_mg: f64,
    pub(super) throttle_deg: f64,
    /// Mean rise of the fuel 3 deg beside the best, in percent; none where that is beyond the sweep.
    pub(super) rise_percent: Option<f64>,
}

/// The spark of least smoothed fuel over sparks in deg, injected fuel in mg and throttle in deg; none for fewer settings than
/// coefficients.
pub(super) fn best_spark(sparks: &[f64], inj_mg: &[f64], throttle_deg: &[f64]) -> Option<BestSpark> {
    if sparks.len() <= COEFFICIENTS {
        return None;
    }
    let (fuel, throttle) = (Smooth::of(sparks, inj_mg)?, Smooth::of(sparks, throttle_deg)?);
    let (low, high) = ends(sparks)?;
    let steps = ((high - low) / STEP_DEG).round() as usize;
    let place = |k: usize| low + (high - low) * k as f64 / steps.max(1) as f64;
    let spark = (0..=steps).map(place).min_by(|a, b| fuel.at(*a).total_cmp(&fuel.at(*b)))?;
    let beside = [spark - 3.0, spark + 3.0];
    let inside = beside.iter().all(|s| (low..=high).contains(s));
    let rise = || 100.0 * (0.5 * (fuel.at(beside[0]) + fuel.at(beside[1])) / fuel.at(spark) - 1.0);
    Some(BestSpark {
        spark_deg: spark,
        inj_mg: fuel.at(spark),
        throttle_deg: throttle.at(spark),
        rise_percent: inside.then(rise),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A parabola with its least at 19 deg, rising by 1 % in 3 deg, is found with what it needs there.
    #[test]
    fn the_least_of_a_parabola_is_found() {
        let sparks: Vec<f64> = (5..=40).map(f64::from).collect();
        let inj: Vec<f64> = sparks.iter().map(|s| 17.0 * (1.0 + 0.01 * ((s - 19.0) / 3.0).powi(2))).collect();
        let throttle: Vec<f64> = inj.iter().map(|i| 0.7 * i).collect();
        let best = best_spark(&sparks, &inj, &throttle).unwrap();
        assert!((best.spark_deg - 19.0).abs() <= 0.5 * STEP_DEG, "{}", best.spark_deg);
        assert!((best.inj_mg - 17.0).abs() < 1e-3 && (best.throttle_deg - 0.7 * best.inj_mg).abs() < 1e-9);
        assert!((best.rise_percent.unwrap() - 1.0).abs() < 1e-3);
        assert!(best_spark(&sparks[..5], &inj[..5], &throttle[..5]).is_none());
    }
}
