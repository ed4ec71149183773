//! The optimum of a cell on known responses: closed forms, prices, conflicts.

use dynocal_calib::steady::cell::{Setting, Side};
use dynocal_calib::steady::grid::{CellState, GridSpec, interpolate, solve};
use dynocal_ident::model::response::{Ask, Prediction, Response};

/// A quadratic `c + g'x + x'Hx/2` with variance `v0 + v1 |x - centre|^2`.
struct Quadratic {
    constant: f64,
    gradient: Vec<f64>,
    hessian: Vec<f64>,
    variance: [f64; 2],
    centre: Vec<f64>,
}

impl Quadratic {
    fn new(constant: f64, gradient: &[f64], diagonal: &[f64]) -> Self {
        let d = gradient.len();
        let mut hessian = vec![0.0; d * d];
        (0..d).for_each(|i| hessian[i * d + i] = diagonal[i]);
        Self { constant, gradient: gradient.to_vec(), hessian, variance: [0.0; 2], centre: vec![0.0; d] }
    }
}

impl Response for Quadratic {
    fn dim(&self) -> usize {
        self.gradient.len()
    }
    fn predict(&self, x: &[f64], _ask: Ask, out: &mut Prediction) {
        let d = x.len();
        *out = Prediction::new(d);
        out.mean = self.constant;
        out.variance = self.variance[0];
        for i in 0..d {
            let slope: f64 = (0..d).map(|j| self.hessian[i * d + j] * x[j]).sum();
            out.mean += x[i] * (self.gradient[i] + 0.5 * slope);
            out.gradient[i] = self.gradient[i] + slope;
            let away = x[i] - self.centre[i];
            out.variance += self.variance[1] * away * away;
            out.variance_gradient[i] = 2.0 * self.variance[1] * away;
            out.variance_hessian[i * d + i] = 2.0 * self.variance[1];
        }
        out.hessian.copy_from_slice(&self.hessian);
    }
    fn describe(&self) -> String {
        "quadratic".into()
    }
}

fn setting<'a>(models: Vec<&'a dyn Response>, sides: Vec<Side>, d: usize) -> Setting<'a> {
    let mut weights = vec![0.0; models.len()];
    weights[0] = 1.0;
    Setting { models, weights, sides, z: 0.0, caution: 0.0, ranges: vec![(-5.0, 5.0); d], axes: 1 }
}

fn upper(response: usize, limit: f64) -> Side {
    Side { response, limit, sign: 1.0, scale: 2.0 }
}

/// minimise (x - 2)^2 + (y - 1)^2 + a subject to x <= 1 + a, -y <= -2: x = 1 + a, y = 2; prices 2 (1 - a) and 2.
#[test]
fn two_limits_act_and_their_prices_are_the_multipliers() {
    let fuel = Quadratic::new(5.0, &[1.0, -4.0, -2.0], &[0.0, 2.0, 2.0]);
    let knock = Quadratic::new(0.0, &[-1.0, 1.0, 0.0], &[0.0; 3]);
    let heat = Quadratic::new(0.0, &[0.0, 0.0, 1.0], &[0.0; 3]);
    let sides = vec![upper(1, 1.0), Side { response: 2, limit: 2.0, sign: -1.0, scale: 0.5 }, upper(2, 40.0)];
    let s = setting(vec![&fuel, &knock, &heat], sides, 3);
    for a in [-0.5, 0.0, 0.5] {
        let o = s.optimise(&[a], 3, &[], 1, &|| false);
        assert!(o.feasible && o.status.is_success(), "{o:?}");
        assert!((o.x[1] - (1.0 + a)).abs() < 1e-5 && (o.x[2] - 2.0).abs() < 1e-5, "{:?}", o.x);
        let expected = [2.0 * (1.0 - a), 2.0, 0.0];
        for (p, e) in o.prices.iter().zip(expected) {
            assert!((p.saves - e).abs() < 1e-4, "{:?} {expected:?}", o.prices);
        }
        // A price is what a unit of room saves: the derivative of the optimal value.
        let objective = (a - 1.0f64).powi(2) + 1.0 + a;
        assert!((o.objective - objective).abs() < 1e-5);
    }
}

/// A limit with uncertainty: x + z s <= 1 with constant s, and with s that grows away from a centre.
#[test]
fn a_limit_is_kept_with_its_standard_deviations() {
    let fuel = Quadratic::new(0.0, &[0.0, -1.0], &[0.0, 0.0]);
    let mut knock = Quadratic::new(0.0, &[0.0, 1.0], &[0.0, 0.0]);
    knock.variance = [0.04, 0.0];
    let mut s = setting(vec![&fuel, &knock], vec![upper(1, 1.0)], 2);
    s.z = 1.5;
    let o = s.optimise(&[0.0], 2, &[], 1, &|| false);
    assert!((o.x[1] - 0.7).abs() < 1e-5, "{:?}", o.x);
    let mut growing = Quadratic::new(0.0, &[0.0, 1.0], &[0.0, 0.0]);
    growing.variance = [0.0, 0.25];
    let mut s = setting(vec![&fuel, &growing], vec![upper(1, 1.0)], 2);
    s.z = 2.0;
    // x + 2 * 0.5 |x| = 1 on the right of the centre.
    let o = s.optimise(&[0.0], 2, &[], 1, &|| false);
    assert!((o.x[1] - 0.5).abs() < 1e-5, "{:?}", o.x);
}

/// x >= 2 and x <= -1 cannot both be: the least sum of violations in scales 2 and 2 lies anywhere between, 3 apart.
#[test]
fn limits_that_conflict_are_named_with_their_distance() {
    let fuel = Quadratic::new(0.0, &[0.0, 1.0], &[0.0, 0.0]);
    let x = Quadratic::new(0.0, &[0.0, 1.0], &[0.0, 0.0]);
    let low = Side { response: 1, limit: 2.0, sign: -1.0, scale: 2.0 };
    let s = setting(vec![&fuel, &x], vec![upper(1, -1.0), low], 2);
    let o = s.optimise(&[0.0], 3, &[], 1, &|| false);
    assert!(!o.feasible);
    let sum: f64 = o.prices.iter().map(|p| p.passed.max(0.0)).sum();
    assert!((sum - 3.0).abs() < 1e-3, "{:?}", o.prices);
}

/// Of two valleys the deeper one is found from whatever seed, with the interior point started in several places.
#[test]
fn several_starts_find_the_deeper_valley() {
    struct Valleys;
    impl Response for Valleys {
        fn dim(&self) -> usize {
            2
        }
        fn predict(&self, x: &[f64], _ask: Ask, out: &mut Prediction) {
            *out = Prediction::new(2);
            let v = x[1];
            // (v^2 - 4)^2 / 16 + 0.3 v
            out.mean = (v * v - 4.0).powi(2) / 16.0 + 0.3 * v;
            out.gradient[1] = (v * v - 4.0) * v / 4.0 + 0.3;
            out.hessian[3] = (3.0 * v * v - 4.0) / 4.0;
        }
        fn describe(&self) -> String {
            "two valleys".into()
        }
    }
    for seed in 0..20 {
        let o = setting(vec![&Valleys], Vec::new(), 2).optimise(&[0.0], 4, &[], seed, &|| false);
        assert!(o.x[1] < -1.9, "seed {seed}: {:?}", o.x);
    }
}

/// Optimum x = 1 + a b: the map holds it in every cell that is reached; where it is not, neighbours fill it and it is marked.
#[test]
fn a_map_holds_the_optimum_of_each_cell_and_marks_what_was_not_reached() {
    struct Bowl;
    impl Response for Bowl {
        fn dim(&self) -> usize {
            3
        }
        fn predict(&self, x: &[f64], _ask: Ask, out: &mut Prediction) {
            *out = Prediction::new(3);
            let e = x[2] - (1.0 + x[0] * x[1]);
            out.mean = 10.0 + e * e;
            out.gradient.copy_from_slice(&[-2.0 * e * x[1], -2.0 * e * x[0], 2.0 * e]);
            out.hessian[8] = 2.0;
        }
        fn describe(&self) -> String {
            "bowl".into()
        }
    }
    let axes = vec![vec![0.0, 0.5, 1.0], vec![-1.0, 0.0, 1.0, 2.0]];
    let mut s = setting(vec![&Bowl], Vec::new(), 3);
    s.axes = 2;
    let spec = GridSpec { smooth: 0.0, ..GridSpec::default() };
    let reached = |at: &[f64]| !(at[0] > 0.9 && at[1] > 1.5);
    let cells = solve(&s, &axes, &spec, &reached, 1, &|| false);
    assert_eq!(cells.len(), 12);
    for c in &cells[..11] {
        assert_eq!(c.state, CellState::Optimal);
        assert!((c.optimum.x[2] - (1.0 + c.at[0] * c.at[1])).abs() < 1e-5, "{c:?}");
    }
    assert_eq!(cells[11].state, CellState::Filled);
    // The mean of its neighbours, (0.5, 2) and (1, 1).
    assert!((cells[11].optimum.x[2] - 2.0).abs() < 1e-5);
    // Bilinear in the axes, so that interpolation is exact.
    let x = interpolate(&axes, &cells, &[0.25, 0.7]);
    assert!((x[2] - (1.0 + 0.25 * 0.7)).abs() < 1e-5, "{x:?}");
    // A smoother map costs no more than it may.
    let smooth = solve(&s, &axes, &GridSpec { smooth: 0.01, ..spec }, &reached, 1, &|| false);
    let rough = |cells: &[dynocal_calib::steady::grid::Cell]| -> f64 {
        let v = |i: usize, j: usize| cells[4 * i + j].optimum.x[2];
        (0..3)
            .map(|i| (1..3).map(|j| (v(i, j - 1) - 2.0 * v(i, j) + v(i, j + 1)).powi(2)).sum::<f64>())
            .sum::<f64>()
            + (0..4).map(|j| (v(0, j) - 2.0 * v(1, j) + v(2, j)).powi(2)).sum::<f64>()
    };
    assert!(smooth[..11].iter().all(|c| c.optimum.objective <= c.best + 0.01 * 10.1));
    assert!(rough(&smooth) <= rough(&cells) + 0.1);
}
