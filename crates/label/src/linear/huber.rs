//! Huber's loss: weights of what lies far outside, and what they leave of the variance.

/// Residual beyond which Huber's loss is a straight line: 1.345 standard deviations, from the median of the absolute residuals.
pub(crate) fn knee(residuals: &[f64]) -> f64 {
    let mut size: Vec<f64> = residuals.iter().map(|r| r.abs()).collect();
    size.sort_by(f64::total_cmp);
    1.345 * 1.4826 * size[size.len() / 2]
}

/// Huber's weights.
pub(crate) fn weights(residuals: &[f64]) -> Vec<f64> {
    let knee = knee(residuals);
    residuals.iter().map(|r| if r.abs() <= knee || knee == 0.0 { 1.0 } else { knee / r.abs() }).collect()
}

/// What the variance `sum w h r^2 / (n - p)` of a fit with Huber's weights h is to be multiplied by, so that `variance H^-1` is the covariance
/// of its values: `K^2 mean(h) sum w (h r)^2 / (m^2 sum w h r^2)`, `K = 1 + p/n (1 - m) / m`, m the share of samples within the knee
/// (P. J. Huber, Robust regression: asymptotics, conjectures and Monte Carlo, Ann. Stat. 1 (1973), 799-821). What lies far outside counts with
/// the knee, and not with its square.
pub(crate) fn variance(residuals: &[f64], first: &[f64], weights: &[f64], parameters: f64) -> f64 {
    let (mut all, mut inside, mut n) = (0.0, 0.0, 0.0);
    let (mut shares, mut square, mut bounded) = (0.0, 0.0, 0.0);
    for ((r, w), wh) in residuals.iter().zip(first).zip(weights).filter(|((_, w), _)| **w > 0.0) {
        let h = wh / w;
        all += w;
        n += 1.0;
        inside += if h >= 1.0 { *w } else { 0.0 };
        shares += wh;
        square += wh * r * r;
        bounded += wh * h * r * r;
    }
    if !(inside > 0.0 && square > 0.0) {
        return 1.0;
    }
    let m = inside / all;
    let k = 1.0 + parameters / n * (1.0 - m) / m;
    k * k * shares / all * bounded / (m * m * square)
}
