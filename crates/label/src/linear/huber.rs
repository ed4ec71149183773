//! Huber's loss: `r^2` up to a knee, a straight line beyond. Residuals count in the size that their weights give them, `sqrt(w) r`, so that
//! one knee serves rows of different units whose weights are one over a variance.

/// Samples within the knee of a normal distribution: 1.345 standard deviations, at which the loss keeps 95 % of the efficiency of squares.
const KNEE: f64 = 1.345;
/// Standard deviation of a normal distribution over the median of its sizes.
const MEDIAN: f64 = 1.4826;

/// The knee, from the median of the sizes of the residuals that count.
pub fn knee(residuals: &[f64], weights: &[f64]) -> f64 {
    let counted = residuals.iter().zip(weights).filter(|(_, w)| **w > 0.0);
    let mut size: Vec<f64> = counted.map(|(r, w)| (w.sqrt() * r).abs()).collect();
    if size.is_empty() {
        return 0.0;
    }
    let middle = size.len() / 2;
    KNEE * MEDIAN * *size.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// Loss of one sample: `w r^2`, beyond the knee `knee (2 sqrt(w) |r| - knee)`. Without a knee, or with one of 0, always the square.
pub fn loss(r: f64, w: f64, knee: Option<f64>) -> f64 {
    let size = w.sqrt() * r.abs();
    match knee {
        Some(knee) if knee > 0.0 && size > knee => knee * (2.0 * size - knee),
        _ => w * r * r,
    }
}

/// Share of its weight that a sample has in the equations.
pub(crate) fn share(r: f64, w: f64, knee: Option<f64>) -> f64 {
    let size = w.sqrt() * r.abs();
    match knee {
        Some(knee) if knee > 0.0 && size > knee => knee / size,
        _ => 1.0,
    }
}

/// Share of the samples that lie within the knee, by weight.
pub(crate) fn within(residuals: &[f64], weights: &[f64], knee: f64) -> f64 {
    let (mut inside, mut all) = (0.0, 0.0);
    for (r, w) in residuals.iter().zip(weights) {
        all += w;
        inside += if share(*r, *w, Some(knee)) >= 1.0 { *w } else { 0.0 };
    }
    if all > 0.0 && inside > 0.0 { inside / all } else { 1.0 }
}

/// What is left of pseudo measurements, `psi(r) / m`, psi the residual cut at the knee and m the share within it: least squares on these have
/// Huber's fit for their solution, its covariance for theirs, and a score of cross-validation that outliers do not inflate (D. D. Cox,
/// Asymptotics for M-type smoothing splines, Ann. Stat. 11 (1983), 530-551).
pub(crate) fn pseudo(residuals: &[f64], weights: &[f64]) -> Vec<f64> {
    let knee = knee(residuals, weights);
    let m = within(residuals, weights, knee);
    residuals.iter().zip(weights).map(|(r, w)| r * share(*r, *w, Some(knee)) / m).collect()
}

/// What the variance `sum w h r^2 / (n - p)` of a fit with the shares h is to be multiplied by, so that `variance H^-1` is the covariance
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
