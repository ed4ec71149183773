use super::super::steady;
use super::*;

/// Steady points of the truth at pressures that the record does not reach.
fn above(truth: &Fuelling) -> Vec<SteadyPoint> {
    let speeds = [1300.0, 1800.0, 2300.0, 2700.0];
    let points = speeds.iter().flat_map(|n| [70.0, 78.0, 86.0, 94.0].map(|p| (*n, p)));
    let of = |(speed_rpm, map_kpa): (f64, f64)| {
        let fuel = truth.charge.at(speed_rpm, map_kpa);
        // The throttle that lets the flow through: by halving.
        let (mut low, mut high) = (0.0, 60.0);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            let flows = truth.filling.inflow(middle, map_kpa, 101.325);
            *(if flows < fuel * speed_rpm / 120.0 { &mut low } else { &mut high }) = middle;
        }
        SteadyPoint {
            speed_rpm,
            map_kpa,
            throttle_deg: high,
            fuel,
            coolant_c: 90.0,
            upstream_kpa: 101.325,
            cams_deg: None,
        }
    };
    points.map(of).collect()
}

/// What a record does not reach its steady points say; what it says itself stays.
#[test]
fn steady_points_say_what_a_record_does_not_reach() {
    let truth = truth();
    let channels = record(&truth, 40);
    let records = [view(&channels)];
    let most = channels[3].iter().copied().fold(0.0, f64::max);
    assert!(most < 80.0, "{most}");
    let found = identify_with(&records, &above(&truth), &|| false).unwrap();
    let (charge, _) = steady_charge_with(&records, &above(&truth)).unwrap();
    for (n, p) in [(1500.0, 84.0), (2500.0, 92.0), (2000.0, 40.0)] {
        let is = truth.charge.at(n, p);
        for (what, at) in [("identified", found.charge.at(n, p)), ("at rest", charge.at(n, p))] {
            // A throttle that is not quite the one of the rests moves the pressure of the model, not that of the points.
            assert!((at / is - 1.0).abs() < 1e-2, "{what}, {n} rpm, {p} kPa: {at}, planted {is}");
        }
    }
    let near = |a: f64, b: f64| (a / b - 1.0).abs();
    assert!(near(found.film.share, truth.film.share) < 0.05, "{:?}", found.film);
    assert!((found.timing.ahead_s(2000.0) - truth.timing.ahead_s(2000.0)).abs() < 2e-3, "{:?}", found.timing);
}

/// The derivatives by the coefficients of the charge are those of differences.
#[test]
fn slopes_of_points_are_those_of_differences() {
    let truth = truth();
    let mut f = truth.clone();
    f.charge.coefficients.iter_mut().enumerate().for_each(|(k, c)| *c += 0.02 * (k as f64 - 4.0));
    let points = above(&truth);
    let loss = Loss::CHOOSING;
    let n = f.charge.coefficients.len();
    let mut exact = vec![vec![0.0; 3 + points.len()]; n];
    steady::unexplained_slopes(&points, &f, loss, 3, &mut exact);
    let errors = |f: &Fuelling| {
        let mut out = vec![0.0; points.len()];
        steady::unexplained(&points, f, loss, &mut out);
        out
    };
    for (k, column) in exact.iter().enumerate() {
        let moved = |h: f64| {
            let mut f = f.clone();
            f.charge.coefficients[k] += h;
            errors(&f)
        };
        let (up, down) = (moved(1e-5), moved(-1e-5));
        for i in 0..points.len() {
            let slope = (up[i] - down[i]) / 2e-5;
            assert!(
                (column[3 + i] - slope).abs() < 1e-6 * slope.abs().max(1.0),
                "{k} {i}: {} {slope}",
                column[3 + i]
            );
        }
    }
}

/// Points that cannot be are refused with their number.
#[test]
fn steady_points_that_cannot_be_are_refused() {
    let truth = truth();
    let channels = record(&truth, 40);
    let refused = |change: fn(&mut SteadyPoint)| {
        let mut points = above(&truth);
        change(&mut points[4]);
        identify_with(&[view(&channels)], &points, &|| false).unwrap_err().to_string()
    };
    for (e, words) in [
        (refused(|p| p.fuel = 0.0), "`injection` has the value 0 at steady point 5"),
        (refused(|p| p.map_kpa = f64::NAN), "`map` has the value NaN at steady point 5"),
        (
            refused(|p| p.cams_deg = Some([240.0; 2])),
            "`cams` has places of the cams at steady point 5, expected no places",
        ),
    ] {
        assert!(e.contains(words), "{e}");
    }
}
