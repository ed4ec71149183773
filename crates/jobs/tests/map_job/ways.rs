//! Over which places the bed goes to its points.

use dynocal_calib::steady::cell::{Setting, Side};
use dynocal_calib::steady::corner::corner;
use dynocal_calib::steady::station::{ApproachSpec, Corner, Station};
use dynocal_ident::model::response::{Ask, Prediction, Response};
use dynocal_numerics::interval::Interval;

use super::engine::{Bench, DAY, Fault, fuel, run_with};

/// The bed goes over the corner that it is told: what is met there is met, and a way over a harmless one is as long as its parts.
#[test]
fn a_point_is_approached_over_its_corner() {
    let layout = run_with(DAY, 1, Bench::new(0.0, Fault::None)).unwrap().layout;
    let approach = ApproachSpec { window_s: 1.0, average_s: 2.0, ..ApproachSpec::default() };
    let (from, to) = ([20.0, 1500.0, 0.9, 0.5], [60.0, 1500.0, 0.6, 0.5]);
    let load = |x: &[f64; 4]| vec![fuel(x[0], x[1], x[2], x[3], 0.0)];
    let over = |via: Option<[f64; 4]>| {
        let mut bench = Bench::new(0.0, Fault::None);
        let mut station =
            Station::new(&mut bench, &layout, &approach, &|_| 0.0, (from.to_vec(), load(&from)), &|| false);
        let via = via.map(|at| Corner { driven: load(&at), at: at.to_vec(), from: from.to_vec() });
        station.measure(&to, via.as_ref(), &load(&to), &[]).unwrap()
    };
    // 60 Nm with a spark of 0.9 would knock (1.1); from 43 Nm on it does.
    let (straight, spark_first, load_first) =
        (over(None), over(Some([20.0, 1500.0, 0.6, 0.5])), over(Some([60.0, 1500.0, 0.9, 0.5])));
    for p in [&straight, &spark_first] {
        assert!(p.usable && p.touched.is_empty() && p.errors[0].abs() < 0.5, "{p:?}");
    }
    // A ramp of 0.3 of the 12 s of a whole range before that of the load.
    let longer_s = spark_first.used_s - straight.used_s;
    assert!((longer_s - 0.3 * 12.0).abs() < 1.5, "{longer_s}");
    let met = &load_first.touched[0];
    assert!(met.output == "knock" && met.factors[2] == 0.9 && (met.factors[0] - 43.3).abs() < 4.0, "{met:?}");
    assert!(
        load_first.usable && load_first.factors[2] == 0.9 && load_first.factors[0] < 43.3,
        "{load_first:?}"
    );
}

/// Half way from an early spark at light load to a late one at full load something may be passed that is kept at both ends.
#[test]
fn a_corner_is_taken_where_the_straight_way_passes_a_limit() {
    /// 1 - ((x - 50) / 30)^2 - (spark - 0.5)^2 / 0.16 over torque, speed, spark, cam; the load before it.
    struct Hill(bool);
    impl Response for Hill {
        fn dim(&self) -> usize {
            4
        }
        fn predict(&self, x: &[f64], _ask: Ask, out: &mut Prediction) {
            *out = Prediction::new(4);
            out.mean = if self.0 {
                1.0 - ((x[0] - 50.0) / 30.0).powi(2) - (x[2] - 0.5).powi(2) / 0.16
            } else {
                x[0]
            };
        }
        fn describe(&self) -> String {
            "hill".into()
        }
    }
    let layout = run_with(DAY, 1, Bench::new(0.0, Fault::None)).unwrap().layout;
    let (load, hill) = (Hill(false), Hill(true));
    let knock = layout.responses.iter().position(|r| r.name == "knock").unwrap();
    let mut models: Vec<&dyn Response> = vec![&load; layout.responses.len()];
    models[knock] = &hill;
    let side = |response: usize, limit: f64| Side { response, limit, sign: 1.0, scale: 1.0, caution: 1.0 };
    let setting = |limit: f64| Setting {
        models: models.clone(),
        weights: vec![0.0; models.len()],
        // The load stands at its end nearly everywhere: that harms nothing on the way.
        sides: vec![side(0, 25.0), side(knock, limit)],
        z: 1.0,
        caution: 0.0,
        ranges: layout.factors.iter().map(|f| Interval::new(f.lower, f.upper)).collect(),
        axes: layout.axes,
    };
    let (low, high) = ([20.0, 1500.0, 0.9, 0.5], [80.0, 1500.0, 0.1, 0.5]);
    let spark_first = Some(vec![20.0, 1500.0, 0.1, 0.5]);
    // At the ends -1, half way 1; over either corner 0 at most, and the first of two equal ones is taken.
    assert_eq!(corner(&setting(0.5), &layout, &low, &high), spark_first);
    assert_eq!(corner(&setting(1.5), &layout, &low, &high), None);
    // What is passed at an end is passed anyway.
    assert_eq!(corner(&setting(0.5), &layout, &[50.0, 1500.0, 0.5, 0.5], &high), None);
    // Where no way keeps the limit the one that passes it least is taken.
    assert_eq!(corner(&setting(-0.1), &layout, &low, &high), spark_first);
}
