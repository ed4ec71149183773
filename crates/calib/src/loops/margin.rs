//! How far a predicted output keeps from its limits so that the measured one passes them at a stated rate.
//!
//! The covariance of the parameters is no guide where the structure is wrong: errors are taken from blocks that the
//! model has not seen, and near the limit only, because that is where a designed record goes.

use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::Model;
use dynocal_ident::validate::cross::{Blocks, folds};
use dynocal_ident::validate::{Kind, output};
use serde::{Deserialize, Serialize};

use super::LoopError;
use super::model::identify;

/// Distances to keep, in the unit of the output.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Margins {
    /// Above the lower limit.
    pub lower: f64,
    /// Below the upper limit.
    pub upper: f64,
}

/// Share of the samples, those nearest to a limit, whose errors speak for it.
const NEAR: f64 = 0.3;

/// Margins for which the share of samples beyond a limit, among samples predicted to be at it, is at most `rate`.
///
/// With the errors e = y - yhat of a free run over the `n` held-out samples (blocks of `records`) whose predictions come
/// nearest to the upper limit, the margin is their order statistic number `ceil((n + 1)(1 - rate))`, the largest where
/// `n` is too small for the rate: the split-conformal quantile, which assumes only that the samples of the design
/// are exchangeable with them. The lower limit in the same way; a margin is never negative.
///
/// # Errors
/// [`LoopError::Number`] for a rate outside 0 to 1; [`LoopError`] for records too short to be cut into blocks.
pub fn held_out_margins(
    model: &dyn Model,
    records: &[Experiment],
    rate: f64,
    blocks: &Blocks,
) -> Result<Margins, LoopError> {
    if !(rate > 0.0 && rate < 1.0) {
        return Err(LoopError::Number { what: "rate of violations", found: rate, expected: "0 to 1" });
    }
    let mut pairs = Vec::new();
    for (fitted, held_out) in folds(records, model.max_lag(), blocks)? {
        let theta = identify(model, &fitted)?.theta;
        for e in &held_out {
            let y = output(model, &theta, e, Kind::FreeRun);
            pairs.extend((e.first(model)..e.len()).map(|t| (y[t], e.y[t] - y[t])));
        }
    }
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
    let near = ((NEAR * pairs.len() as f64).ceil() as usize).clamp(1, pairs.len());
    let below = pairs[..near].iter().map(|p| -p.1).collect();
    let above = pairs[pairs.len() - near..].iter().map(|p| p.1).collect();
    Ok(Margins { lower: conformal(below, rate).max(0.0), upper: conformal(above, rate).max(0.0) })
}

/// Order statistic number `ceil((n + 1)(1 - rate))`, at most the last.
fn conformal(mut errors: Vec<f64>, rate: f64) -> f64 {
    errors.sort_by(f64::total_cmp);
    let n = errors.len();
    let k = ((n + 1) as f64 * (1.0 - rate)).ceil() as usize;
    errors[k.clamp(1, n) - 1]
}

#[cfg(test)]
mod tests {
    use super::*;
    use dynocal_ident::model::poly::PolyNarx;
    use dynocal_numerics::rng::Rng64;

    #[test]
    fn order_statistics_are_the_conformal_ones() {
        let errors: Vec<f64> = (1..=19).map(f64::from).collect();
        assert_eq!(conformal(errors.clone(), 0.05), 19.0);
        assert_eq!(conformal(errors.clone(), 0.10), 18.0);
        assert_eq!(conformal(errors, 0.001), 19.0);
    }

    /// A right structure with uniform noise in [-1, 1]: fresh samples pass prediction plus margin at the stated rate.
    #[test]
    fn fresh_samples_pass_the_margin_at_the_stated_rate() {
        let model = PolyNarx::parse(&["u"], "y", &["1", "u(t-1)"]).unwrap();
        let record = |seed: u64, n: usize| {
            let mut g = Rng64::new(seed);
            let u: Vec<f64> = (0..n).map(|_| g.uniform()).collect();
            let y =
                (0..n).map(|t| if t > 0 { 3.0 * u[t - 1] } else { 0.0 } + g.uniform_in(-1.0, 1.0)).collect();
            Experiment { name: "r".into(), u, y, init_samples: 1, weights: Vec::new() }
        };
        let (mut beyond, mut all) = (0, 0);
        for seed in 0..40 {
            let data = [record(seed, 200)];
            let margins = held_out_margins(&model, &data, 0.1, &Blocks::default()).unwrap();
            let theta = identify(&model, &data).unwrap().theta;
            let fresh = record(1000 + seed, 200);
            let y = output(&model, &theta, &fresh, Kind::FreeRun);
            beyond += (1..200).filter(|t| fresh.y[*t] > y[*t] + margins.upper).count();
            all += 199;
        }
        let rate = f64::from(beyond as u32) / f64::from(all);
        // Five standard errors of 40 quantiles of 60 errors each.
        assert!((rate - 0.1).abs() < 0.035, "{rate}");
    }

    #[test]
    fn a_rate_of_nothing_is_refused() {
        let model = PolyNarx::parse(&["u"], "y", &["1"]).unwrap();
        assert!(held_out_margins(&model, &[], 0.0, &Blocks::default()).is_err());
        assert!(held_out_margins(&model, &[], 0.1, &Blocks::default()).is_err());
    }
}
