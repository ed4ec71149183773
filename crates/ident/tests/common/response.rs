//! What every response model must hold.

use dynocal_ident::model::response::{Ask, Prediction, Response};

/// Gradients and Hessians of mean and variance against central differences at x with a relative step; `first` and `second` are the relative
/// tolerances of gradients and Hessians, `rounding` that of a variance (of a process: that of its signal's variance).
pub(crate) fn check_response(
    model: &dyn Response,
    x: &[f64],
    step: f64,
    first: f64,
    second: f64,
    rounding: f64,
) {
    let d = x.len();
    let (mut at, mut up, mut down) = (Prediction::new(d), Prediction::new(d), Prediction::new(d));
    model.predict(x, Ask::Hessian, &mut at);
    let largest = |v: &[f64], least: f64| v.iter().fold(least, |m: f64, v| m.max(v.abs()));
    let size = |v: &[f64]| largest(v, 1e-6);
    // The rounding of a variance is divided by the step of a difference.
    let variance_size = |v: &[f64], tolerance: f64| largest(v, 3e-3) + rounding / step / tolerance;
    let close = |found: f64, expected: f64, scale: f64, tolerance: f64, what: &str| {
        assert!(
            (found - expected).abs() <= tolerance * scale,
            "{}: {what}: {found}, by differences {expected}",
            model.describe()
        );
    };
    for j in 0..d {
        let h = step * (1.0 + x[j].abs());
        let moved =
            |sign: f64| -> Vec<f64> { (0..d).map(|k| if k == j { x[k] + sign * h } else { x[k] }).collect() };
        model.predict(&moved(1.0), Ask::Gradient, &mut up);
        model.predict(&moved(-1.0), Ask::Gradient, &mut down);
        let of = |a: f64, b: f64| (a - b) / (2.0 * h);
        close(at.gradient[j], of(up.mean, down.mean), size(&at.gradient), first, "gradient");
        let variance = of(up.variance, down.variance);
        close(
            at.variance_gradient[j],
            variance,
            variance_size(&at.variance_gradient, first),
            first,
            "variance gradient",
        );
        for k in 0..d {
            let hessian = of(up.gradient[k], down.gradient[k]);
            close(at.hessian[j * d + k], hessian, size(&at.hessian), second, "Hessian");
            let variance = of(up.variance_gradient[k], down.variance_gradient[k]);
            close(
                at.variance_hessian[j * d + k],
                variance,
                variance_size(&at.variance_hessian, second),
                second,
                "variance Hessian",
            );
        }
    }
}
