//! A trim learnt from lines whose windows do not all weigh alike.

use dynocal_calib::steady::trim::{Along, Trim, Way, finer};
use dynocal_numerics::rng::Rng64;

/// Measurements that scatter ten times as much where they weigh a hundredth do not disturb the others: the scatter is that of weight 1,
/// and the correction is better than with equal weights.
#[test]
fn what_weighs_little_does_not_disturb() {
    let mut rng = Rng64::new(8);
    let axes = finer(&[vec![0.0, 1.0, 2.0, 3.0]], 1);
    let mut weighed = Along::default();
    for k in 0..400 {
        let x = 3.0 * rng.uniform();
        let (size, weight) = if x > 2.0 { (0.1, 0.01) } else { (0.01, 1.0) };
        let up = if k % 2 == 0 { 1.0 } else { -1.0 };
        let way = Way { up, since_s: 1e6, before: [(0.0, 0.0); 2], window_s: 1.0 };
        weighed.push(vec![x], way, 0.1 * (1.5 * x).sin() + size * rng.normal(), weight);
    }
    let equal = Along { weight: vec![1.0; 400], ..weighed.clone() };
    let error = |t: &Trim| {
        let each = (0..20).map(|k| f64::from(k) / 10.0).map(|x| (t.at(&[x]) - 0.1 * (1.5 * x).sin()).powi(2));
        (each.sum::<f64>() / 20.0).sqrt()
    };
    let (a, b) = (Trim::learn(&axes, &weighed).unwrap(), Trim::learn(&axes, &equal).unwrap());
    assert!((a.scatter / 0.01 - 1.0).abs() < 0.15 && a.rest > 0.04, "{} {}", a.scatter, a.rest);
    assert!(error(&a) < error(&b), "{} {}", error(&a), error(&b));
}
